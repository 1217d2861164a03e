//! A foreign node sends commands: they never move the motors.

use firmware::e2e;
use furrow_tests::Journey;
use furrow_tests::nodes;
use furrow_tests::time::{at, seconds, span};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use world::SimTime;

use crate::attacker::Attacker;
use crate::{assert_never_reset, mode, next_cycle, running};

/// Time from the start of the reference message to the command's window, s.
const WINDOW: f64 = 0.007;
/// After the genuine frame in the same window; that frame takes at most 540 us.
const BEHIND: f64 = WINDOW + 0.000_56;
/// In a free window.
const ELSEWHERE: f64 = 0.030;

/// The commands of a run, as an eavesdropper records them.
fn recorded(journey: &Journey) -> Vec<[u8; 8]> {
    let traffic = journey.traffic();
    let frames = traffic
        .genuine(300)
        .filter(|frame| frame.data[4] == mode::RUN);
    frames.map(|frame| frame.bytes()).collect()
}

/// A vehicle at rest in idle, and the commands recorded during its earlier run.
fn standing() -> (Journey, Vec<[u8; 8]>) {
    let mut journey = running("[[press]]\nat = \"3.05 s\"\nbutton = \"A\"");
    let commands = recorded(&journey);
    assert!(commands.len() >= 10);
    journey.to(3.5);
    assert_eq!(journey.mode(), Some(mode::IDLE));
    assert!(
        journey
            .stopped(at(3.4))
            .is_some_and(|stopped| stopped <= at(3.4))
    );
    (journey, commands)
}

/// Asserts that no motor has moved since the given time.
fn assert_still(journey: &Journey, since: SimTime) {
    for node in [nodes::STEERING, nodes::DRIVE] {
        let moved = journey.last_moved(node);
        assert!(moved < Some(since), "{node:?} moved at {moved:?}");
    }
}

/// Number of foreign frames that were sent successfully.
fn foreign(journey: &Journey) -> usize {
    let traffic = journey.traffic();
    let frames = traffic.frames.iter();
    frames
        .filter(|frame| frame.node.is_none() && frame.complete && frame.id == 300)
        .count()
}

#[test]
fn replayed_flipped_and_spoofed_commands_move_nothing() {
    let (mut journey, commands) = standing();
    let attacker = Attacker::on(&mut journey);
    let since = journey.vehicle.now();
    let mut sent = 0;
    for cycle in 0..24_usize {
        let begin = next_cycle(&mut journey);
        let old = commands[cycle % commands.len()];
        let data = match cycle / 8 {
            // The recorded commands in their own order.
            0 => old,
            // The controller's current command with inverted bits: the enable bits, and others.
            1 => {
                let mut data = journey.command(begin).expect("a command");
                data[5] ^= 0b11;
                data[2] ^= 1 << (cycle % 8);
                data
            }
            // Made-up commands: full speed, with the next counter value.
            _ => {
                let counter = journey.command(begin).expect("a command")[6].wrapping_add(2);
                [0, 0, 200, 0, mode::MANUAL, 3, counter, cycle as u8]
            }
        };
        attacker.send(&mut journey, begin + span(BEHIND), 300, &data);
        attacker.send(&mut journey, begin + span(ELSEWHERE), 300, &data);
        sent += 2;
    }
    let end = journey.vehicle.now() + span(0.3);
    journey.run_until(end);
    assert!(foreign(&journey) >= sent - 2, "{}", foreign(&journey));
    assert_still(&journey, since);
    assert_never_reset(&journey);
    journey.assert_in_place();
}

#[test]
fn a_recorded_run_moves_nothing_when_the_controller_is_gone() {
    let (mut journey, commands) = standing();
    let attacker = Attacker::on(&mut journey);
    journey.vehicle.node_mut(nodes::CONTROLLER).hold_reset();
    let since = journey.vehicle.now();
    for data in commands.iter().take(12) {
        let begin = next_cycle(&mut journey);
        attacker.send(&mut journey, begin + span(WINDOW + 0.000_01), 300, data);
    }
    let end = journey.vehicle.now() + span(0.2);
    journey.run_until(end);
    assert!(foreign(&journey) >= 10, "{}", foreign(&journey));
    assert_still(&journey, since);
}

#[test]
fn foreign_commands_during_a_run_change_no_motor_beyond_it() {
    let mut journey = running("");
    let attacker = Attacker::on(&mut journey);
    for cycle in 0..10_u8 {
        let begin = next_cycle(&mut journey);
        let genuine = journey.command(begin).expect("a command");
        let mut data = genuine;
        data[..4].copy_from_slice(&[0xC4, 0x09, 200, 0]);
        data[6] = data[6].wrapping_add(1 + cycle % 3);
        // Before the genuine frame, which it delays, or after it.
        let place = if cycle < 5 { BEHIND } else { WINDOW - 0.000_6 };
        attacker.send(&mut journey, begin + span(place), 300, &data);
    }
    assert!(foreign(&journey) >= 9);
    // 1 m/s is commanded; 2 m/s would be full effort.
    let efforts = journey.vehicle.world().efforts().iter();
    let most = efforts
        .filter(|change| change.node == nodes::DRIVE && change.at > at(3.0))
        .map(|change| change.effort)
        .fold(0.0, f64::max);
    assert!(most < 0.7, "{most}");
}

/// System time of the basic cycle whose reference began at this instant.
fn system_time(journey: &Journey, begin: SimTime) -> u32 {
    let traffic = journey.traffic();
    let mut references = traffic.genuine(100);
    let reference = references.find(|frame| frame.start == begin);
    furrow_tests::time::system_time(&reference.expect("a reference").bytes())
}

/// Sends full commands with the right check value for two seconds, each in its basic cycle, with the
/// controller gone: all that a node on the bus can know that has these sources but no key.
fn forge(journey: &mut Journey) -> SimTime {
    let attacker = Attacker::on(journey);
    journey.vehicle.node_mut(nodes::CONTROLLER).hold_reset();
    journey.run_until(journey.vehicle.now() + span(1.0));
    let since = journey.vehicle.now();
    for counter in 0..20 {
        let begin = next_cycle(journey);
        let mut data = [0xC4, 0x09, 200, 0, mode::MANUAL, 3, counter, 0];
        data[7] = e2e::check_value(300, system_time(journey, begin), &data);
        attacker.send(journey, begin + span(WINDOW + 0.000_01), 300, &data);
    }
    journey.run_until(journey.vehicle.now() + span(0.2));
    assert!(foreign(journey) >= 19, "{}", foreign(journey));
    since
}

/// Without a key the check value is all that protects a command, and it needs no secret.
#[test]
fn without_a_key_who_knows_the_sources_drives_the_vehicle() {
    let mut journey = running("");
    let since = forge(&mut journey);
    assert!(journey.last_moved(nodes::DRIVE) > Some(since));
    assert!(journey.last_moved(nodes::STEERING) > Some(since));
}

#[test]
fn with_a_key_who_knows_the_sources_moves_nothing() {
    let mut journey = running("key = true");
    let since = forge(&mut journey);
    assert_still(&journey, since);
    assert_never_reset(&journey);
}

/// Forged and replayed commands at any time of the basic cycle, many of them in the command's window.
/// With the environment variable `ATTEMPTS` there are more.
#[test]
fn no_forged_or_replayed_command_moves_a_motor() {
    const IN_A_CYCLE: usize = 20;
    let attempts = std::env::var("ATTEMPTS").map_or(1000, |text| text.parse().expect("a number"));
    let mut journey = running("key = true\n[[press]]\nat = \"3.05 s\"\nbutton = \"A\"");
    let traffic = journey.traffic();
    let run: Vec<[u8; 8]> = traffic.genuine(300).map(|frame| frame.bytes()).collect();
    journey.to(3.5);
    let attacker = Attacker::on(&mut journey);
    let since = journey.vehicle.now();
    let mut random = ChaCha8Rng::seed_from_u64(300);
    let mut below = |limit: usize| random.next_u32() as usize % limit;
    let mut counter = 0_u8;
    for cycle in 0..attempts / IN_A_CYCLE {
        // Every other stretch without the controller, whose frames hold the window.
        let controller = journey.vehicle.node_mut(nodes::CONTROLLER);
        match cycle % 40 {
            20 => controller.hold_reset(),
            0 if cycle > 0 => controller.release_reset(),
            _ => {}
        }
        let begin = next_cycle(&mut journey);
        let time = system_time(&journey, begin);
        let genuine = journey.command(begin).expect("a command");
        for index in 0..IN_A_CYCLE {
            let mut data = match below(4) {
                0 => run[below(run.len())],
                1 => genuine,
                _ => [0xC4, 0x09, 200, 0, mode::MANUAL, 3, below(256) as u8, 0],
            };
            // One in each cycle takes the command's window, the others come at any other time.
            let aimed = index == 0;
            let sealed = aimed && below(4) > 0;
            if sealed {
                counter = counter.wrapping_add(1);
                (data[5], data[6]) = (3, counter);
                data[7] = e2e::check_value(300, time, &data);
            } else if below(2) == 0 {
                data[below(8)] ^= 1 << below(8);
            }
            let at = if aimed {
                WINDOW + 0.000_01
            } else {
                0.008 + 1e-6 * below(91_000) as f64
            };
            attacker.send(&mut journey, begin + span(at), 300, &data);
        }
    }
    let end = journey.vehicle.now() + span(0.3);
    journey.run_until(end);
    assert!(foreign(&journey) >= attempts / 2, "{}", foreign(&journey));
    assert_still(&journey, since);
}

/// Forged commands in the place of every second true one stop the actuators, although one lost
/// command does not. When they cease, the vehicle can be used again.
#[test]
fn a_burst_of_forged_commands_is_a_safe_stop() {
    let mut journey = running("key = true");
    let attacker = Attacker::on(&mut journey);
    for counter in 0..10 {
        let begin = next_cycle(&mut journey);
        let mut data = [0xC4, 0x09, 200, 0, mode::MANUAL, 3, counter, 0];
        data[7] = e2e::check_value(300, system_time(&journey, begin), &data);
        // Some bits before the controller, which then leaves its window empty.
        attacker.send(&mut journey, begin + span(WINDOW - 0.000_01), 300, &data);
        next_cycle(&mut journey);
    }
    let end = journey.vehicle.now();
    let stopped = journey.stopped(at(3.0)).expect("a stop");
    assert!(stopped < at(3.5), "{}", seconds(stopped));
    let console = journey.console(nodes::DRIVE);
    assert!(console.contains(" refused 1"), "{console}");
    journey.run_until(end + span(1.0));
    let refused = |journey: &Journey| {
        let console = journey.console(nodes::DRIVE);
        let (_, last) = console.rsplit_once(" refused ").expect("a line");
        last.lines().next().map(str::to_owned)
    };
    let after = refused(&journey);
    journey.run_until(end + span(2.0));
    assert_eq!(refused(&journey), after, "the true commands pass again");
    assert_never_reset(&journey);
}

/// Noise that a motor driver reads as full reverse stays no longer than until the next sample of an
/// actuator node.
#[test]
fn a_byte_that_noise_put_on_a_motors_line_is_overwritten_within_ten_milliseconds() {
    for (node, name, within) in [
        (nodes::DRIVE, "drive", 0.0105),
        (nodes::STEERING, "steering", 0.0055),
    ] {
        let mut longest: f64 = 0.0;
        let mut read = 0;
        let times: Vec<f64> = (0..10).map(|k| 3.0 + 0.0917 * f64::from(k)).collect();
        let noise: Vec<String> = times
            .iter()
            .map(|at| format!("{{ node = \"{name}\", at = \"{at} s\", byte = 0 }}"))
            .collect();
        let mut journey = running(&format!("wire = [{}]", noise.join(", ")));
        journey.to(4.2);
        let efforts = journey.vehicle.world().efforts();
        for hit in &times {
            // A driver that was commanded full reverse already is not changed by the noise.
            let Some(hit) = efforts
                .iter()
                .position(|change| change.node == node && (seconds(change.at) - hit).abs() < 1e-6)
            else {
                continue;
            };
            read += 1;
            let end = efforts[hit + 1..].iter().find(|change| change.node == node);
            let end = end.map_or(4.2, |change| seconds(change.at));
            longest = longest.max(end - seconds(efforts[hit].at));
        }
        assert!(read >= 8, "{name}: {read} of 10");
        assert!(longest < within, "{name}: {longest} s");
    }
}
