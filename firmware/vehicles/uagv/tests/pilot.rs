//! Modes and commands of the controller.

use control::mode::Mode;
use control::position::{Position, Velocity};
use firmware::actuator::CommandHold;
use firmware::buttons::{Button, Buttons, Edge};
use firmware::e2e;
use firmware::pilot::{Change, Inputs, Reason};
use network::Message as _;
use ttcan::Health;
use uagv::NODES;
use uagv::Pilot;
use uagv::messages::{Command, LogControl, LogGuidance, Mode as Named};
use uagv::wire::{self, Record};

fn inputs(fixed: bool) -> Inputs {
    Inputs {
        position: fixed.then_some(Position::new(1000, 1000)),
        velocity: Some(Velocity::new(1000, 0)),
        pot: Some(2048),
        fixed,
        in_schedule: true,
        may_move: true,
        joystick: (2048, 2048),
    }
}

/// A steering that does what it is told.
#[derive(Default)]
struct Wheels {
    /// Angle, deg, positive to the right.
    angle: f64,
}

impl Wheels {
    /// The potentiometer's reading after a step with this command.
    fn follow(&mut self, command: &Command) -> Option<u16> {
        self.angle += f64::from(command.steering_rate.0) / 100.0 * 0.1;
        self.angle = self.angle.clamp(-25.0, 25.0);
        Some((2048.0 + 40.0 * self.angle) as u16)
    }
}

fn press(pilot: &mut Pilot, button: Button) {
    pilot.button(button, Edge::Pressed);
    pilot.button(button, Edge::Released);
}

fn step(pilot: &mut Pilot, inputs: &Inputs) -> (Command, Option<Change>) {
    let (decision, change) = pilot.step(inputs, &Buttons::default());
    pilot.predict();
    let command = wire::command(&decision, &mut e2e::Sender::default(), 7);
    (Command::decode(&command).unwrap(), change)
}

#[test]
fn a_run_needs_two_presses_and_a_fix_and_ends_with_it() {
    let mut pilot = Pilot::new().unwrap();
    let (command, _) = step(&mut pilot, &inputs(false));
    assert_eq!(command.mode, Named::Idle);
    for _ in 0..2 {
        press(&mut pilot, Button::C);
        let (command, _) = step(&mut pilot, &inputs(false));
        assert_eq!(command.mode, Named::AutonomousReady);
        assert!(!command.drive_enabled && !command.steering_enabled);
    }
    press(&mut pilot, Button::C);
    let (command, change) = step(&mut pilot, &inputs(true));
    assert_eq!(command.mode, Named::AutonomousRun);
    assert_eq!(change.unwrap().reason, Reason::ButtonC);
    let (command, _) = step(&mut pilot, &inputs(true));
    // One metre right of the line: steer left.
    assert!(command.steering_rate.0 < 0 && command.speed.0 > 0);
    // The receiver is silent, which is not bridged.
    let silent = Inputs {
        velocity: None,
        ..inputs(false)
    };
    let _ = step(&mut pilot, &silent);
    let (command, change) = step(&mut pilot, &silent);
    assert_eq!(command.mode, Named::AutonomousReady);
    assert_eq!(command.speed.0, 0);
    assert_eq!(change.unwrap().reason, Reason::FixLost);
}

/// A second without a fixed solution is bridged while velocities come. Then the run ends.
#[test]
fn a_moment_without_a_fix_is_bridged() {
    let mut pilot = Pilot::new().unwrap();
    let mut north = 1000;
    let mut drive = |pilot: &mut Pilot, fixed: bool| {
        north += 100;
        let inputs = Inputs {
            position: fixed.then_some(Position::new(north, 0)),
            ..inputs(fixed)
        };
        step(pilot, &inputs)
    };
    for _ in 0..2 {
        press(&mut pilot, Button::C);
        let _ = drive(&mut pilot, true);
    }
    for _ in 0..30 {
        let _ = drive(&mut pilot, true);
    }
    for pause in [1, 5, 10] {
        for _ in 0..pause {
            let (command, _) = drive(&mut pilot, false);
            assert_eq!(command.mode, Named::AutonomousRun);
            assert!(command.speed.0 > 50, "{pause}: {}", command.speed.0);
        }
        for _ in 0..20 {
            let (command, _) = drive(&mut pilot, true);
            assert_eq!(command.mode, Named::AutonomousRun);
        }
    }
    for _ in 0..10 {
        let (command, _) = drive(&mut pilot, false);
        assert_eq!(command.mode, Named::AutonomousRun);
    }
    let (command, change) = drive(&mut pilot, false);
    assert_eq!((command.mode, command.speed.0), (Named::AutonomousReady, 0));
    assert_eq!(change.unwrap().reason, Reason::FixLost);
    // It is not begun without one.
    press(&mut pilot, Button::C);
    let (command, _) = drive(&mut pilot, false);
    assert_eq!(command.mode, Named::AutonomousReady);
}

/// Message 452 has the command, message 453 what the law asked for.
#[test]
fn the_control_input_is_logged_before_limits() {
    let mut pilot = Pilot::new().unwrap();
    let mut sender = e2e::Sender::default();
    let mut largest = (0, 0);
    let mut wheels = Wheels::default();
    let mut pot = Some(2048);
    for index in 0..30 {
        if index < 2 {
            press(&mut pilot, Button::C);
        }
        // Five metres right of the line.
        let inputs = Inputs {
            position: Some(Position::new(1000 + 100 * index, 5000)),
            pot,
            ..inputs(true)
        };
        let (decision, _) = pilot.step(&inputs, &Buttons::default());
        pilot.predict();
        let sent = wire::command(&decision, &mut sender, 7);
        pot = wheels.follow(&Command::decode(&sent).unwrap());
        let record = Record::of(&decision, &[Health::Healthy; NODES]);
        let input = LogControl::decode(&record.control).unwrap().control_input.0;
        let command = LogGuidance::decode(&record.guidance).unwrap();
        let command = i32::from(command.steering_rate_command.0);
        if input.abs() > i32::abs(largest.0) {
            largest = (input, command);
        }
    }
    // 1/256 deg/s, and 0.01 deg/s of which 2500 is the limit.
    let (input, command) = largest;
    let shown = (f64::from(input) / 256.0, f64::from(command) / 100.0);
    assert!(
        input < -30 * 256,
        "U {} deg/s, command {} deg/s",
        shown.0,
        shown.1
    );
    assert!((-2500..0).contains(&command), "{} deg/s", shown.1);
    // By hand the law commands nothing.
    let mut pilot = Pilot::new().unwrap();
    press(&mut pilot, Button::B);
    let by_hand = Inputs {
        joystick: (4095, 2048),
        ..inputs(true)
    };
    let (decision, _) = pilot.step(&by_hand, &Buttons::default());
    pilot.predict();
    let logged =
        LogControl::decode(&Record::of(&decision, &[Health::Healthy; NODES]).control).unwrap();
    assert_eq!(logged.control_input.0, 0);
    let command = wire::command(&decision, &mut sender, 7);
    assert!(Command::decode(&command).unwrap().steering_rate.0 > 2000);
}

/// The gps node keeps its position window empty as soon as the fix is gone, and says so in
/// the reference: a flag without a position is a lost frame.
#[test]
fn one_lost_position_frame_does_not_end_a_run_two_do() {
    let mut pilot = Pilot::new().unwrap();
    let on_the_line = Inputs {
        position: Some(Position::new(1000, 0)),
        ..inputs(true)
    };
    for _ in 0..2 {
        press(&mut pilot, Button::C);
        let _ = step(&mut pilot, &on_the_line);
    }
    let lost = Inputs {
        position: None,
        ..inputs(true)
    };
    for _ in 0..3 {
        let (command, _) = step(&mut pilot, &lost);
        assert_eq!(command.mode, Named::AutonomousRun);
        let (command, _) = step(&mut pilot, &on_the_line);
        assert_eq!(command.mode, Named::AutonomousRun);
    }
    let _ = step(&mut pilot, &lost);
    let (command, change) = step(&mut pilot, &lost);
    assert_eq!((command.mode, command.speed.0), (Named::AutonomousReady, 0));
    assert_eq!(change.unwrap().reason, Reason::FixLost);
}

#[test]
fn a_run_ends_at_the_end_of_the_path() {
    let mut pilot = Pilot::new().unwrap();
    let at = |north| Inputs {
        position: Some(Position::new(north, 0)),
        ..inputs(true)
    };
    for _ in 0..2 {
        press(&mut pilot, Button::C);
        let _ = step(&mut pilot, &at(242_000));
    }
    let (command, _) = step(&mut pilot, &at(242_100));
    assert_eq!(command.mode, Named::AutonomousRun);
    let changes: std::vec::Vec<_> = (1..20)
        .filter_map(|tenth| step(&mut pilot, &at(242_100 + 100 * tenth)).1)
        .collect();
    assert_eq!(changes.len(), 1, "{changes:?}");
    assert_eq!(
        (changes[0].mode, changes[0].reason),
        (Mode::AutonomousReady, Reason::PathEnd)
    );
    let beyond = at(244_100);
    let (command, _) = step(&mut pilot, &beyond);
    assert!(!command.drive_enabled && command.speed.0 == 0);
}

#[test]
fn a_run_out_of_the_fence_is_a_fault_and_a_drive_by_joystick_is_not() {
    let mut pilot = Pilot::new().unwrap();
    let _ = step(&mut pilot, &inputs(true));
    for _ in 0..2 {
        press(&mut pilot, Button::C);
        let _ = step(&mut pilot, &inputs(true));
    }
    assert_eq!(pilot.mode(), Mode::AutonomousRun);
    pilot.set_strays(Some(Reason::Fence));
    let (command, change) = step(&mut pilot, &inputs(true));
    assert!(!command.drive_enabled && command.speed.0 == 0);
    let change = change.unwrap();
    assert_eq!((change.mode, change.reason), (Mode::Fault, Reason::Fence));
    // Back by hand.
    press(&mut pilot, Button::A);
    let _ = step(&mut pilot, &inputs(true));
    press(&mut pilot, Button::B);
    let _ = step(&mut pilot, &inputs(true));
    assert_eq!(pilot.mode(), Mode::Manual);
    let _ = step(&mut pilot, &inputs(true));
    assert_eq!(pilot.mode(), Mode::Manual);
    // No run begins there.
    press(&mut pilot, Button::C);
    let _ = step(&mut pilot, &inputs(true));
    assert_eq!(pilot.mode(), Mode::AutonomousReady);
    press(&mut pilot, Button::C);
    let (command, change) = step(&mut pilot, &inputs(true));
    assert!(!command.drive_enabled);
    assert_eq!(change.unwrap().reason, Reason::Fence);
    pilot.set_strays(None);
    press(&mut pilot, Button::A);
    let _ = step(&mut pilot, &inputs(true));
    for _ in 0..2 {
        press(&mut pilot, Button::C);
        let _ = step(&mut pilot, &inputs(true));
    }
    assert_eq!(pilot.mode(), Mode::AutonomousRun);
}

#[test]
fn the_joystick_drives_without_a_fix_and_the_stop_wins() {
    let mut pilot = Pilot::new().unwrap();
    let _ = step(&mut pilot, &inputs(false));
    press(&mut pilot, Button::B);
    let forward = Inputs {
        joystick: (2048, 4095),
        ..inputs(false)
    };
    let (command, _) = step(&mut pilot, &forward);
    assert_eq!((command.mode, command.speed.0), (Named::Manual, 200));
    press(&mut pilot, Button::Joystick);
    press(&mut pilot, Button::A);
    let (command, change) = step(&mut pilot, &inputs(false));
    assert_eq!(command.mode, Named::EmergencyStop);
    assert!(command.emergency_stop && !command.drive_enabled);
    assert_eq!(change.unwrap().reason, Reason::ButtonD);
    press(&mut pilot, Button::B);
    let (command, _) = step(&mut pilot, &inputs(false));
    assert_eq!(command.mode, Named::EmergencyStop);
    press(&mut pilot, Button::A);
    let (command, _) = step(&mut pilot, &inputs(false));
    assert_eq!(command.mode, Named::Idle);
}

#[test]
fn every_edge_of_d_and_of_the_joystick_stops_and_only_a_releases() {
    for button in [Button::D, Button::Joystick] {
        for edge in [Edge::Pressed, Edge::Released] {
            let mut pilot = Pilot::new().unwrap();
            press(&mut pilot, Button::B);
            let _ = step(&mut pilot, &inputs(true));
            pilot.button(button, edge);
            let (command, _) = step(&mut pilot, &inputs(true));
            assert!(command.emergency_stop && !command.drive_enabled);
            for other in [Button::B, Button::C] {
                press(&mut pilot, other);
                let (command, _) = step(&mut pilot, &inputs(true));
                assert_eq!(command.mode, Named::EmergencyStop);
            }
            press(&mut pilot, Button::A);
            let (command, _) = step(&mut pilot, &inputs(true));
            assert_eq!(command.mode, Named::Idle);
        }
    }
}

#[test]
fn a_toggled_output_that_falls_ends_driving_and_starts_and_releases_nothing() {
    let remote = [Button::A, Button::B, Button::C];
    for button in remote {
        let mut pilot = Pilot::new().unwrap();
        let fall = |pilot: &mut Pilot| {
            pilot.button(button, Edge::Fallen);
            step(pilot, &inputs(true)).0.mode
        };
        assert_eq!(fall(&mut pilot), Named::Idle);
        press(&mut pilot, Button::C);
        let _ = step(&mut pilot, &inputs(true));
        assert_eq!(fall(&mut pilot), Named::AutonomousReady);
        press(&mut pilot, Button::C);
        let (command, _) = step(&mut pilot, &inputs(true));
        assert_eq!(command.mode, Named::AutonomousRun);
        assert_eq!(fall(&mut pilot), Named::Idle);
        press(&mut pilot, Button::B);
        let _ = step(&mut pilot, &inputs(true));
        assert_eq!(fall(&mut pilot), Named::Idle);
        press(&mut pilot, Button::D);
        let _ = step(&mut pilot, &inputs(true));
        assert_eq!(fall(&mut pilot), Named::EmergencyStop);
    }
}

#[test]
fn a_latching_remote_control_starts_a_run_by_c_a_c() {
    let mut pilot = Pilot::new().unwrap();
    let mut select = |button, steps| {
        pilot.button(button, Edge::Selected);
        let (command, _) = step(&mut pilot, &inputs(true));
        for _ in 1..steps {
            let _ = step(&mut pilot, &inputs(true));
        }
        command.mode
    };
    assert_eq!(select(Button::C, 5), Named::AutonomousReady);
    // Too late.
    assert_eq!(select(Button::A, 25), Named::Idle);
    assert_eq!(select(Button::C, 5), Named::AutonomousReady);
    assert_eq!(select(Button::A, 5), Named::Idle);
    assert_eq!(select(Button::C, 5), Named::AutonomousRun);
    assert_eq!(select(Button::A, 5), Named::Idle);
    assert_eq!(select(Button::C, 5), Named::AutonomousReady);
    assert_eq!(select(Button::B, 5), Named::Manual);
    assert_eq!(select(Button::A, 5), Named::Idle);
    assert_eq!(select(Button::C, 5), Named::AutonomousReady);
}

#[test]
fn moving_without_steering_angle_is_a_fault() {
    let mut pilot = Pilot::new().unwrap();
    let _ = step(&mut pilot, &inputs(true));
    press(&mut pilot, Button::B);
    let blind = Inputs {
        pot: None,
        ..inputs(true)
    };
    let modes: std::vec::Vec<_> = (0..4).map(|_| step(&mut pilot, &blind).0.mode).collect();
    assert_eq!(
        modes,
        [Named::Manual, Named::Manual, Named::Fault, Named::Fault]
    );
}

#[test]
fn without_its_time_master_the_vehicle_stops_and_waits_for_the_operator() {
    let mut pilot = Pilot::new().unwrap();
    let _ = step(&mut pilot, &inputs(true));
    let backup = Inputs {
        may_move: false,
        ..inputs(true)
    };
    for (button, presses, mode) in [
        (Button::B, 1, Mode::Manual),
        (Button::C, 2, Mode::AutonomousRun),
    ] {
        // It does not begin to drive under a backup.
        for _ in 0..presses {
            press(&mut pilot, button);
            let (command, _) = step(&mut pilot, &backup);
            assert!(!command.drive_enabled && !command.steering_enabled);
        }
        assert_eq!(pilot.mode(), Mode::Fault);
        press(&mut pilot, Button::A);
        let _ = step(&mut pilot, &inputs(true));
        for _ in 0..presses {
            press(&mut pilot, button);
            let _ = step(&mut pilot, &inputs(true));
        }
        assert_eq!(pilot.mode(), mode);
        let (command, change) = step(&mut pilot, &backup);
        assert!(!command.drive_enabled && !command.steering_enabled);
        assert_eq!(change.unwrap().reason, Reason::MasterLost);
        // The master is back: only a release leads out of the fault.
        press(&mut pilot, button);
        let (command, _) = step(&mut pilot, &inputs(true));
        assert_eq!(command.mode, Named::Fault);
        press(&mut pilot, Button::A);
        let (command, _) = step(&mut pilot, &inputs(true));
        assert_eq!(command.mode, Named::Idle);
    }
}

#[test]
fn every_command_passes_the_actuators_judgement() {
    let mut pilot = Pilot::new().unwrap();
    let mut sender = e2e::Sender::default();
    let mut hold = CommandHold::<Command>::new(firmware::e2e::Secret::None);
    let mut command = |pilot: &mut Pilot, inputs: &Inputs| {
        let (decision, _) = pilot.step(inputs, &Buttons::default());
        pilot.predict();
        wire::command(&decision, &mut sender, 7)
    };
    let _ = hold.receive(&command(&mut pilot, &inputs(true)), 7);
    for (index, button) in [
        Button::B,
        Button::A,
        Button::C,
        Button::C,
        Button::D,
        Button::A,
    ]
    .into_iter()
    .cycle()
    .take(600)
    .enumerate()
    {
        if index % 5 == 0 {
            press(&mut pilot, button);
        }
        let command = command(&mut pilot, &inputs(index % 7 != 0));
        assert!(hold.receive(&command, 7).is_ok());
    }
}

/// Starts a run and steps on with inputs made from the step's number and the reading of a potentiometer that follows
/// the commands, until the mode changes. Returns the step and the change.
fn run(most: u32, mut made: impl FnMut(i32, Option<u16>) -> Inputs) -> Option<(u32, Change)> {
    let mut pilot = Pilot::new().unwrap();
    let mut wheels = Wheels::default();
    let mut pot = Some(2048);
    for _ in 0..2 {
        press(&mut pilot, Button::C);
        let _ = step(&mut pilot, &made(0, pot));
    }
    for index in 0..most {
        let (command, change) = step(&mut pilot, &made(index.cast_signed(), pot));
        pot = wheels.follow(&command);
        if let Some(change) = change {
            return Some((index, change));
        }
    }
    None
}

/// What a vehicle measures that drives along its line, so far right of it, mm.
fn beside(index: i32, east: i32, pot: Option<u16>) -> Inputs {
    Inputs {
        position: Some(Position::new(1000 + 100 * index, east)),
        pot,
        ..inputs(true)
    }
}

#[test]
fn a_run_ends_when_the_vehicle_does_not_do_what_it_is_told() {
    let ended = |found: Option<(u32, Change)>, reason| {
        let (at, change) = found.unwrap();
        assert_eq!((change.mode, change.reason), (Mode::Fault, reason), "{at}");
        at
    };
    assert_eq!(run(300, |index, pot| beside(index, 0, pot)), None);
    // The potentiometer is frozen, or shows the other side.
    let at = run(100, |index, _| beside(index, 1000, Some(2048)));
    assert!(ended(at, Reason::Steering) <= 12);
    let reversed = |pot: Option<u16>| pot.map(|count| 4096 - count);
    let at = run(100, |index, pot| beside(index, 1000, reversed(pot)));
    assert!(ended(at, Reason::Steering) <= 12);
    // The vehicle stands.
    let at = run(100, |_, pot| Inputs {
        velocity: Some(Velocity::new(3, -2)),
        ..beside(0, 0, pot)
    });
    assert!(ended(at, Reason::Speed) <= 20);
    // It runs away: 2 m/s in place of 1 m/s.
    let at = run(100, |index, pot| Inputs {
        velocity: Some(Velocity::new(2500, 0)),
        ..beside(5 * index / 2, 0, pot)
    });
    assert!(ended(at, Reason::Speed) <= 40);
    // Positions, but no velocity: three seconds, or three metres at 1 m/s.
    let at = run(100, |index, pot| Inputs {
        velocity: None,
        ..beside(index, 0, pot)
    });
    assert!((28..=36).contains(&ended(at, Reason::NoHeading)));
    // The wheels are turned, and the course stays.
    let at = run(200, |index, _| beside(index, 0, Some(2048 + 400)));
    assert!(matches!(
        at.unwrap().1.reason,
        Reason::Course | Reason::Steering
    ));
    // On the line for 5 s, and then beside it.
    let at = run(100, |index, pot| {
        beside(index, if index < 50 { 0 } else { 1500 }, pot)
    });
    let at = ended(at, Reason::OffPath);
    assert!((54..=60).contains(&at), "{at}");
}

#[test]
fn the_joystick_ends_a_run_when_it_is_moved_for_two_steps() {
    let with = |from: u32, until: u32, axes: (u16, u16)| {
        run(40, move |index, pot| Inputs {
            joystick: if (from..until).contains(&index.cast_unsigned()) {
                axes
            } else {
                (2048, 2048)
            },
            ..beside(index, 0, pot)
        })
    };
    let (at, change) = with(5, 40, (2048, 3200)).unwrap();
    assert_eq!(at, 6);
    assert_eq!(
        (change.mode, change.reason),
        (Mode::AutonomousReady, Reason::Joystick)
    );
    assert_eq!(with(5, 40, (900, 2048)).unwrap().0, 6);
    assert_eq!(with(5, 6, (2048, 3200)), None, "one sample is no movement");
    assert_eq!(with(5, 40, (2200, 1900)), None, "the joystick is at rest");
}
