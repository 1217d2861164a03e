//! How the actuator nodes act on commands.

use firmware::actuator::{CommandHold, Drive, Refusal, Times, steering_effort};
use firmware::e2e::{self, Secret};
use network::Message as _;
use proptest::prelude::*;
use uagv::messages::{CentidegreesPerSecond, CentimetresPerSecond, Command, Mode};
use uagv::{Steering, Uagv, design};

fn command(rate: i16, speed: i16) -> Command {
    Command {
        steering_rate: CentidegreesPerSecond(rate),
        speed: CentimetresPerSecond(speed),
        mode: Mode::Manual,
        steering_enabled: true,
        drive_enabled: true,
        emergency_stop: false,
        counter: 0,
        check: 0,
    }
}

fn sealed(sender: &mut e2e::Sender, command: &Command) -> [u8; 8] {
    let mut data = command.encode();
    sender.seal::<Command>(7, &mut data);
    data
}

#[test]
fn an_old_sample_stays_old_when_the_counter_comes_round() {
    let times = Times::new(design::COMMAND_TIMEOUT, 18);
    let mut steering = Steering::new(times, Secret::None);
    steering.sample(2048, 0);
    assert!(steering.has_sample(times.sample));
    assert!(!steering.has_sample(times.sample + 1));
    assert!(!steering.has_sample(0));
}

/// `boards/GETTING_STARTED.md` says how long guesses take with so many.
#[test]
fn a_command_has_room_for_a_code_of_26_bits() {
    assert_eq!(e2e::mask::<Command>().count_ones(), 26);
}

#[test]
fn nothing_moves_before_the_second_good_frame() {
    let mut sender = e2e::Sender::default();
    let mut hold = CommandHold::<Command>::new(Secret::None);
    assert!(hold.command().is_none());
    assert!(
        hold.receive(&sealed(&mut sender, &command(100, 50)), 7)
            .is_err()
    );
    assert!(hold.command().is_none());
    assert!(
        hold.receive(&sealed(&mut sender, &command(100, 50)), 7)
            .is_ok()
    );
    assert_eq!(hold.command().unwrap().speed, CentimetresPerSecond(50));
    hold.expire();
    assert!(hold.command().is_none());
    assert_eq!(
        hold.receive(&sealed(&mut sender, &command(100, 50)), 7),
        Err(Refusal::Protection(e2e::Refusal::First))
    );
}

#[test]
fn impossible_commands_are_refused() {
    let mut sender = e2e::Sender::default();
    let mut hold = CommandHold::<Command>::new(Secret::None);
    let _ = hold.receive(&sealed(&mut sender, &command(0, 0)), 7);
    let mut refuse =
        |command: &Command| hold.receive(&sealed(&mut sender, command), 7).unwrap_err();
    assert_eq!(refuse(&command(2501, 0)), Refusal::Limits);
    assert_eq!(refuse(&command(0, -201)), Refusal::Limits);
    let idle = Command {
        mode: Mode::Idle,
        ..command(0, 0)
    };
    assert_eq!(refuse(&idle), Refusal::Mode);
    let stopped = Command {
        emergency_stop: true,
        ..command(0, 0)
    };
    assert_eq!(refuse(&stopped), Refusal::Mode);
    assert_eq!(hold.receive(&[0; 7], 7), Err(Refusal::Malformed));
    assert!(hold.command().is_none());
}

proptest! {
    /// Any bytes at all: a command in force always keeps the limits.
    #[test]
    fn whatever_arrives_a_command_in_force_keeps_the_limits(
        frames in proptest::collection::vec(any::<[u8; 8]>(), 1..20), seal: bool,
    ) {
        let mut sender = e2e::Sender::default();
        let mut hold = CommandHold::<Command>::new(Secret::None);
        for mut frame in frames {
            if seal {
                sender.seal::<Command>(7, &mut frame);
            }
            let _ = hold.receive(&frame, 7);
            if let Some(command) = hold.command() {
                prop_assert!(command.steering_rate.0.abs() <= 2500);
                prop_assert!(command.speed.0.abs() <= 200);
            }
        }
    }

    /// No command ever drives the wheels further out at or beyond an end stop.
    #[test]
    fn the_end_stops_hold(rate in -2500i16..=2500, beyond in 0.0f32..0.2, left: bool) {
        let angle = design::LIMITS.steering_angle + beyond;
        let angle = if left { -angle } else { angle };
        let effort = steering_effort::<Uagv>(Some(&command(rate, 0)), Some(angle));
        prop_assert!(effort * angle <= 0.0);
    }

    /// Integrated at 200 Hz with the actuator's own characteristic, the angle never passes a
    /// stop.
    #[test]
    fn the_wheels_stay_within_their_limits(rate in -2500i16..=2500, start in -0.43f32..0.43) {
        let mut angle = start;
        for _ in 0..400 {
            let effort = steering_effort::<Uagv>(Some(&command(rate, 0)), Some(angle));
            angle += design::STEERING.rate(effort) * 0.005;
            prop_assert!(angle.abs() <= design::LIMITS.steering_angle + 1e-4);
        }
    }

    #[test]
    fn the_drive_slews_up_and_never_down(speeds in proptest::collection::vec(-200i16..=200, 1..40)) {
        let mut drive = Drive::<Uagv>::new();
        let mut last = 0.0f32;
        for speed in speeds {
            drive.effort(Some(&command(0, speed)), 0.1);
            let now = drive.speed();
            prop_assert!(now.abs() <= last.abs() + design::ACCELERATION * 0.1 + 1e-5);
            let wanted = f32::from(speed) / 100.0;
            prop_assert!(now.abs() <= wanted.abs() + 1e-5 && now * wanted >= 0.0);
            last = now;
        }
        prop_assert_eq!(drive.effort(None::<&Command>, 0.1), 0.0);
    }
}

#[test]
fn without_command_or_angle_the_steering_stands_still() {
    assert_eq!(steering_effort::<Uagv>(None::<&Command>, Some(0.0)), 0.0);
    assert_eq!(steering_effort::<Uagv>(Some(&command(1000, 0)), None), 0.0);
    let disabled = Command {
        steering_enabled: false,
        ..command(1000, 0)
    };
    assert_eq!(steering_effort::<Uagv>(Some(&disabled), Some(0.0)), 0.0);
}

/// A command that the controller may send is one that the actuators obey.
#[test]
fn controller_and_actuators_have_the_same_limits() {
    assert_eq!(design::SETTINGS.limits, design::LIMITS);
}
