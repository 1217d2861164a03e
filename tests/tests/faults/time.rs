//! Who sends references of its own: with a key no actuator moves by a time that is not proven, and
//! time does not go back.

use campaign::traffic::Sent;
use firmware::selftest::KEY;
use furrow_tests::Journey;
use furrow_tests::nodes;
use furrow_tests::time::{at, seconds, span, system_time};
use uagv::messages::SelfTestRequest;
use world::SimTime;

use crate::attacker::Attacker;
use crate::{first_after, mode, running};

/// The system time that a reference tells, ms.
fn told(reference: &Sent) -> u32 {
    system_time(&reference.bytes())
}

/// Takes the place of the time master: destroys its references and those of the backup from `from` to
/// `until`, and sends references with the right time and marks, but without the key.
fn lead(journey: &mut Journey, from: SimTime, until: SimTime) {
    lead_as(journey, 100, 0.1, from, until);
}

/// The same as the master of this reference, whose basic cycles are this long, s.
fn lead_as(journey: &mut Journey, reference: u16, cycle: f64, from: SimTime, until: SimTime) {
    let attacker = Attacker::on(journey);
    for id in [100, 101] {
        attacker.suppress(journey, Some(id), from, until);
    }
    let traffic = journey.traffic();
    let last = traffic.genuine(100).last().expect("a reference");
    let (mut start, mut data) = (last.start, last.bytes());
    let mut time = told(last);
    loop {
        start += span(cycle);
        time += 100;
        if start >= until {
            return;
        }
        data[1..5].copy_from_slice(&time.to_be_bytes());
        data[5] = 0;
        // 100 ms are 1696 us more than a multiple of 2048 us.
        let mark = u16::from_be_bytes([data[6], data[7]]).wrapping_add(1696 * 32);
        data[6..].copy_from_slice(&mark.to_be_bytes());
        if start >= from {
            attacker.send(journey, start, reference, &data);
        }
    }
}

/// How long the motors go on after the second reference of a foreign time master, s; `None` if they do
/// to its end.
fn driven_under_a_foreign_master(key: &str) -> Option<f64> {
    let mut journey = Journey::of(&format!(
        "{key}\n[[press]]\nat = \"1 s\"\nbutton = \"B\"\n\
         [[joystick]]\nat = \"1.2 s\"\nforward = \"50 %\"\nright = \"10 %\""
    ));
    journey.to(3.0);
    assert_eq!(journey.mode(), Some(mode::MANUAL));
    let from = at(3.0) + span(0.05);
    lead(&mut journey, from, at(4.5));
    journey.to(4.4);
    let traffic = journey.traffic();
    let frames = traffic.frames.iter();
    // The first one comes at the same time as that of the master, which destroys both.
    let foreign: Vec<&Sent> = frames
        .filter(|frame| frame.node.is_none() && frame.complete)
        .collect();
    assert!(foreign.len() >= 10);
    let stopped = journey.stopped(from)?;
    (stopped < at(4.3)).then(|| seconds(stopped) - seconds(foreign[1].end))
}

#[test]
fn no_motor_moves_under_a_foreign_time_master() {
    assert_eq!(driven_under_a_foreign_master(""), None, "without a key");
    let stopped = driven_under_a_foreign_master("key = true");
    println!("stopped {stopped:?} s after the second foreign reference");
    assert!(stopped.is_some_and(|stopped| stopped < 0.001));
}

/// The time master has followed a backup whose time ran 200 ppm too fast. Nobody would correct its rate, so it would lead
/// at that one from then on, and leave the receiver's epochs behind.
#[test]
fn a_master_that_followed_a_wrong_rate_leads_at_that_of_its_crystal() {
    let mut journey = Journey::of("key = true");
    journey.to(3.0);
    let (from, until) = (at(3.05), at(4.0));
    lead_as(&mut journey, 101, 0.1 * (1.0 - 200e-6), from, until);
    journey.to(5.5);
    let traffic = journey.traffic();
    let foreign = traffic.frames.iter().filter(|frame| frame.node.is_none());
    let followed = foreign.filter(|frame| frame.complete && frame.id == 101);
    assert!(followed.count() >= 8);
    let references: Vec<&Sent> = traffic.between(100, at(4.7), at(5.5)).collect();
    assert!(references.len() >= 7);
    // A reference tells when the one before began, in 1/32 us; whole multiples of 2048 us are left out.
    let mark = |reference: &Sent| {
        let [.., high, low] = reference.bytes();
        u16::from_be_bytes([high, low])
    };
    for three in references.windows(3) {
        let told = mark(three[2]).wrapping_sub(mark(three[1]));
        let told = f64::from(told) / 32e6 + 48.0 * 2048e-6;
        let passed = seconds(three[1].start) - seconds(three[0].start);
        // Crystals are off by up to 50 ppm, and a stamp by 2 us.
        let ppm = (told / passed - 1.0) * 1e6;
        assert!(ppm.abs() < 100.0, "{ppm}");
    }
}

/// Somebody silences the bus and then plays back a second of the run, with the references of then.
#[test]
fn a_run_that_is_played_back_with_its_time_moves_nothing() {
    let mut journey = running("key = true\n[[press]]\nat = \"3.05 s\"\nbutton = \"A\"");
    let traffic = journey.traffic();
    let record = |id| traffic.genuine(id).filter(|frame| frame.start > at(2.0));
    let frames: Vec<(SimTime, u16, Vec<u8>)> = [100, 300]
        .into_iter()
        .flat_map(|id| record(id).map(move |frame| (frame.start, id, frame.data.clone())))
        .collect();
    assert!(frames.len() >= 18);
    journey.to(3.6);
    let attacker = Attacker::on(&mut journey);
    let since = journey.vehicle.now();
    attacker.suppress(&mut journey, None, since, at(6.0));
    for (start, id, data) in &frames {
        // 2.5 s later, when all nodes have lost the schedule.
        attacker.send(&mut journey, *start + span(2.5), *id, data);
    }
    journey.to(7.0);
    for node in [nodes::STEERING, nodes::DRIVE] {
        let moved = journey.last_moved(node);
        assert!(moved < Some(since), "{node:?} moved at {moved:?}");
    }
    // Whoever leads goes on with the time that it had before, and the vehicle can be used again.
    let before = told(&first_after(&journey, 100, at(3.4)));
    let after = first_after(&journey, 100, at(6.0));
    assert!(told(&after) > before && after.start < at(7.0));
    assert_eq!(journey.mode(), Some(mode::IDLE));
}

/// Resets both potential time masters and no other node, and asserts that the vehicle can be driven
/// again under the time that they had, with `more` in the scenario.
fn masters_go_on(more: &str) {
    let mut journey = running(&format!(
        "key = true\n\
         reset = [\n\
         {{ node = \"gps\", at = \"3.2 s\", until = \"3.7 s\" }},\n\
         {{ node = \"controller\", at = \"3.2 s\", until = \"3.7 s\" }},\n\
         ]\n\
         [[press]]\nat = \"8 s\"\nbutton = \"B\"\n\
         [[joystick]]\nat = \"8.2 s\"\nforward = \"50 %\"\n{more}"
    ));
    journey.to(10.0);
    let traffic = journey.traffic();
    let before = traffic.genuine(100).filter(|frame| frame.start < at(3.2));
    let before = told(before.last().expect("a reference"));
    let after = told(&first_after(&journey, 100, at(3.7)));
    println!("{before} ms, then {after} ms");
    assert!(after > before);
    assert_eq!(journey.mode(), Some(mode::MANUAL));
    assert!(journey.effort(nodes::DRIVE, at(9.9)) > 0.2);
}

#[test]
fn masters_that_start_again_go_on_with_the_time() {
    masters_go_on("");
}

/// Then nobody tells the time of week to the master.
#[test]
fn masters_that_start_again_without_a_receiver_go_on_with_the_time() {
    masters_go_on("[[stream]]\nfrom = \"3.1 s\"\nfault = \"silence\"");
}

/// Lets the vehicle drive and stand again, keeps both time masters off the bus, and plays the references and commands
/// of the drive. `begin` is what happens just before, at 4.5 s, and `more` stands in the scenario.
fn played_in_the_same_run(more: &str, begin: impl FnOnce(&mut Journey)) {
    let mut journey = running(&format!(
        "key = true\n\
         [[press]]\nat = \"3.05 s\"\nbutton = \"A\"\n\
         [[reset]]\nnode = \"gps\"\nat = \"4.7 s\"\n\
         [[reset]]\nnode = \"controller\"\nat = \"4.7 s\"\n{more}"
    ));
    let traffic = journey.traffic();
    let record = |id| traffic.genuine(id).filter(|frame| frame.start > at(1.0));
    let frames: Vec<(SimTime, u16, Vec<u8>)> = [100, 300]
        .into_iter()
        .flat_map(|id| record(id).map(move |frame| (frame.start, id, frame.data.clone())))
        .collect();
    assert!(frames.len() >= 38);
    journey.to(4.5);
    let since = journey.vehicle.now();
    for node in [nodes::STEERING, nodes::DRIVE] {
        assert_eq!(journey.effort(node, since), 0.0);
    }
    begin(&mut journey);
    journey.to(6.0);
    let attacker = Attacker::on(&mut journey);
    for (start, id, data) in &frames {
        attacker.send(&mut journey, *start + span(5.5), *id, data);
    }
    journey.to(9.0);
    for node in [nodes::STEERING, nodes::DRIVE] {
        let moved = journey.last_moved(node);
        assert!(moved < Some(since), "{node:?} moved at {moved:?}");
    }
}

/// The program on the bus that asks for a self-test needs no key.
#[test]
fn a_run_that_is_played_back_after_a_request_to_start_again_moves_nothing() {
    played_in_the_same_run("", |journey| {
        crate::selftest::ask(
            journey,
            SelfTestRequest {
                round: 7,
                key: KEY,
                start_again: true,
            },
        );
    });
}

#[test]
fn a_run_that_is_played_back_to_an_actuator_that_was_reset_moves_nothing() {
    let reset = "[[reset]]\nnode = \"drive\"\nat = \"4.7 s\"\nuntil = \"4.8 s\"\n";
    played_in_the_same_run(reset, |_| {});
}

/// Somebody without the key destroys one reference and sends another one in its place, which tells a time of days
/// later. A command that the controller sealed for that time would be true.
#[test]
fn a_forged_reference_of_a_later_time_does_not_lock_true_commands_out() {
    let mut journey = running(
        "key = true\n\
         [[press]]\nat = \"3.05 s\"\nbutton = \"A\"\n\
         [[press]]\nat = \"5 s\"\nbutton = \"B\"\n\
         [[joystick]]\nat = \"5.2 s\"\nforward = \"50 %\"",
    );
    journey.to(4.0);
    let traffic = journey.traffic();
    let last = traffic.genuine(100).last().expect("a reference");
    let (mut start, mut data) = (last.start, last.bytes());
    let time = told(last).wrapping_add(1_000_000_000);
    while start < at(4.1) {
        start += span(0.1);
        let mark = u16::from_be_bytes([data[6], data[7]]).wrapping_add(1696 * 32);
        data[6..].copy_from_slice(&mark.to_be_bytes());
    }
    data[1..5].copy_from_slice(&time.to_be_bytes());
    let attacker = Attacker::on(&mut journey);
    // It begins before the true one, which has to wait, and is destroyed then.
    for id in [100, 101] {
        attacker.suppress(&mut journey, Some(id), start, start + span(0.05));
    }
    attacker.send(&mut journey, start - span(0.000_3), 100, &data);
    journey.to(7.0);
    assert_eq!(journey.mode(), Some(mode::MANUAL));
    assert!(journey.effort(nodes::DRIVE, at(6.9)) > 0.2);
    // Nor can whoever recorded it play a command at that time: there is none.
    let traffic = journey.traffic();
    let forged = traffic
        .frames
        .iter()
        .find(|frame| frame.node.is_none() && frame.complete);
    let from = forged.expect("the attacker's reference").end;
    assert_eq!(traffic.between(300, from, from + span(0.05)).count(), 0);
}
