//! Rows guide a run while there is no fix: the pilot with frames of the rows node, sound and not.

use control::calibration::{Actuator, Potentiometer};
use control::controller::Settings;
use control::feedback::Limits;
use control::mode::Mode;
use control::position::{Position, Velocity};
use control::row::RowPose;
use control::takeover::{Guide, Presence, RowSighting, TakeoverSettings};
use firmware::buttons::{Button, Buttons, Edge};
use firmware::e2e;
use firmware::guide::ByRows;
use firmware::machine::Machine;
use firmware::pilot::{Decision, Inputs, Pilot, Reason};
use firmware::steering::Furrow;
use uagv::Uagv;
// Any protected message in place of that of the rows node, which this network does not have.
use uagv::messages::Command as Protected;

/// The machine of the manifest with guidance by rows.
struct Rows;

impl Machine for Rows {
    const LIMITS: Limits<f32> = Uagv::LIMITS;
    const ACCELERATION: f32 = Uagv::ACCELERATION;
    const POTENTIOMETER: Potentiometer<f32> = Uagv::POTENTIOMETER;
    const STEERING: Actuator<f32> = Uagv::STEERING;
    const DRIVE: Actuator<f32> = Uagv::DRIVE;
    const FULL_BYTE_IS_FORWARD: bool = Uagv::FULL_BYTE_IS_FORWARD;
    const ROUTE: [Position; 2] = Uagv::ROUTE;
    const PERIOD: f32 = Uagv::PERIOD;
    const INTERVAL: f32 = Uagv::INTERVAL;
    const SETTINGS: Settings<f32> = Uagv::SETTINGS;
    type Law = Furrow;
    const LAW: () = ();
    type Guide = ByRows;
    const GUIDE: TakeoverSettings<f32> = TakeoverSettings {
        speed: 0.5,
        longest_age: 0.3,
        longest_way: 20.0,
        settle: 1.0,
        take_back: 0.05,
        half_width: 0.55,
        tolerance: 0.02,
    };
}

const ID: u16 = <Protected as network::Message>::ID;

/// What becomes of the data of a sound frame before it is received.
type Spoil = fn([u8; 8]) -> Option<[u8; 8]>;

/// A vehicle that drives along its line, and its rows node.
struct Drive {
    pilot: Pilot<Rows>,
    buttons: Buttons,
    sender: e2e::Sender,
    /// System time of the cycle, ms.
    time: u32,
    north: f32,
    speed: f32,
    fixed: bool,
    spoil: Spoil,
}

impl Drive {
    /// A run that has begun, beside rows that are known.
    fn running() -> Self {
        let mut drive = Self {
            pilot: Pilot::new().unwrap(),
            buttons: Buttons::default(),
            sender: e2e::Sender::default(),
            time: 5000,
            north: 0.0,
            speed: 0.0,
            fixed: true,
            spoil: Some,
        };
        for step in 0..40 {
            if step < 2 {
                drive.press(Button::C);
            }
            drive.step();
        }
        assert_eq!(drive.pilot.mode(), Mode::AutonomousRun);
        assert_eq!(drive.guide(), Guide::Satellites);
        drive
    }

    /// The same without a fix, guided by the rows.
    fn in_rows() -> Self {
        let mut drive = Self::running();
        drive.fixed = false;
        for _ in 0..10 {
            drive.step();
        }
        assert_eq!(drive.guide(), Guide::Rows);
        drive
    }

    fn press(&mut self, button: Button) {
        self.pilot.button(button, Edge::Pressed);
        self.pilot.button(button, Edge::Released);
    }

    fn guide(&self) -> Guide {
        self.pilot.guide().takeover().guide()
    }

    fn step(&mut self) -> (Decision, Option<Reason>) {
        let mut data = [0; 8];
        // Made late in the cycle before.
        self.sender.seal::<Protected>(self.time, &mut data);
        self.time += 100;
        let frame = (self.spoil)(data);
        let data = frame.as_ref().map(<[u8; 8]>::as_slice);
        self.pilot
            .guide_mut()
            .see::<Protected>(data, self.time, |_| {
                Some(RowSighting {
                    presence: Presence::Following,
                    pose: RowPose {
                        offset: 0.0,
                        heading: 0.0,
                        half_width: 0.55,
                    },
                    deviation: 0.02,
                })
            });
        self.north += self.speed * 0.1;
        let inputs = Inputs {
            position: self
                .fixed
                .then_some(Position::new((self.north * 1e3) as i32, 0)),
            velocity: self
                .fixed
                .then_some(Velocity::new((self.speed * 1e3) as i32, 0)),
            pot: Some(2048),
            fixed: self.fixed,
            in_schedule: true,
            may_move: true,
            ..Inputs::default()
        };
        let (decision, change) = self.pilot.step(&inputs, &self.buttons);
        self.pilot.predict();
        self.speed = decision.command.speed;
        (decision, change.map(|change| change.reason))
    }

    /// Steps until the run ends, and why.
    fn end(&mut self) -> (usize, Option<Reason>) {
        for steps in 1..100 {
            let (decision, reason) = self.step();
            if decision.mode != Mode::AutonomousRun {
                assert!(!decision.moving && decision.command.speed == 0.0);
                return (steps, reason);
            }
        }
        panic!("the run does not end");
    }
}

#[test]
fn rows_go_on_with_a_run_without_a_fix_and_give_it_back() {
    let mut drive = Drive::running();
    assert!((drive.speed - 1.0).abs() < 1e-6);
    drive.fixed = false;
    for _ in 0..50 {
        let (decision, _) = drive.step();
        assert_eq!(decision.mode, Mode::AutonomousRun);
        assert!(decision.moving);
    }
    assert!((drive.speed - 0.5).abs() < 1e-6);
    drive.fixed = true;
    let mut before = 0.0;
    let mut guides = Vec::new();
    for _ in 0..60 {
        let (decision, _) = drive.step();
        assert_eq!(decision.mode, Mode::AutonomousRun);
        let step = (decision.command.steering_rate - before).abs();
        assert!(step <= Uagv::SETTINGS.slew.steering * Uagv::PERIOD + 1e-6);
        before = decision.command.steering_rate;
        if guides.last() != Some(&drive.guide()) {
            guides.push(drive.guide());
        }
    }
    assert_eq!(guides, [Guide::Rows, Guide::Returning, Guide::Satellites]);
    assert!((drive.speed - 1.0).abs() < 1e-6);
}

#[test]
fn a_run_ends_with_the_fix_if_the_rows_are_unknown() {
    let mut drive = Drive::running();
    drive.spoil = |_| None;
    for _ in 0..5 {
        drive.step();
    }
    drive.fixed = false;
    assert_eq!(drive.end(), (1, Some(Reason::FixLost)));
    // Without the run the rows do not guide, nor do they when they come back.
    drive.spoil = Some;
    drive.press(Button::C);
    for _ in 0..20 {
        let (decision, _) = drive.step();
        assert_eq!(decision.mode, Mode::AutonomousReady);
    }
}

/// Messages that are missing, altered, of another identifier, repeated or of a counter that stands still
/// are as none: the vehicle stops after the longest age of the last sound one.
#[test]
fn unsound_messages_end_the_run() {
    fn sealed(counter: u8, id: u16, mut data: [u8; 8]) -> Option<[u8; 8]> {
        data[6] = counter;
        data[7] = e2e::check_value(id, 0, &data);
        Some(data)
    }
    let spoils: [Spoil; 5] = [
        |_| None,
        |mut data| {
            data[0] ^= 1;
            Some(data)
        },
        |mut data| {
            data[6] = data[6].wrapping_add(1);
            Some(data)
        },
        // A sound frame of another time, and a frame with a forged counter.
        |data| sealed(data[6], ID, data),
        |data| sealed(7, 207, data),
    ];
    for (index, spoil) in spoils.into_iter().enumerate() {
        let mut drive = Drive::in_rows();
        drive.spoil = spoil;
        let (steps, reason) = drive.end();
        assert!((3..=4).contains(&steps), "{index}: {steps}");
        assert_eq!(reason, Some(Reason::FixLost), "{index}");
    }
}

#[test]
fn a_counter_that_stands_still_ends_the_run() {
    let mut drive = Drive::in_rows();
    // The node makes the same message again and again, each with the check value of its cycle.
    let mut steps = 0;
    while drive.pilot.mode() == Mode::AutonomousRun {
        drive.sender = e2e::Sender::default();
        drive.step();
        steps += 1;
        assert!(steps < 10);
    }
    assert!((3..=5).contains(&steps), "{steps}");
}

#[test]
fn one_lost_message_does_no_harm() {
    let mut drive = Drive::in_rows();
    for step in 0..60 {
        drive.spoil = if step % 6 == 0 { |_| None } else { Some };
        let (decision, _) = drive.step();
        assert_eq!(decision.mode, Mode::AutonomousRun);
    }
}

#[test]
fn the_operator_stays_above_the_rows() {
    let mut drive = Drive::in_rows();
    drive.press(Button::D);
    assert_eq!(drive.end(), (1, Some(Reason::ButtonD)));
    assert_eq!(drive.pilot.mode(), Mode::EmergencyStop);
    let mut drive = Drive::in_rows();
    drive.press(Button::C);
    assert_eq!(drive.end(), (1, Some(Reason::ButtonC)));
    let mut drive = Drive::in_rows();
    drive.press(Button::A);
    assert_eq!(drive.end(), (1, Some(Reason::ButtonA)));
}

#[test]
fn the_way_without_a_fix_ends() {
    let mut drive = Drive::in_rows();
    let (mut steps, mut reason) = (0, None);
    while drive.pilot.mode() == Mode::AutonomousRun {
        reason = drive.step().1;
        steps += 1;
        assert!(steps < 1000);
    }
    // 20 m at 0.5 m/s, of which a little is driven before.
    assert!((370..405).contains(&steps), "{steps}");
    assert_eq!(reason, Some(Reason::FixLost));
}
