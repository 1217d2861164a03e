//! Global time over changes of the master: on every node it runs on, or references announce the step.

mod support;

use fugit::ExtU64;
use proptest::prelude::*;
use support::{CONTROLLER, GPS, Uagv, UagvBus, at, crystal, is_reference, uagv, vehicle};
use ttcan::simulation::{Application, Fate, Quiet, SimTime};
use ttcan::{ClockState, Frame, Id, MasterState, NodeId, SyncState};

/// Changes of a clock's error that corrections never make, in microseconds.
const STEP: i64 = 300;

/// Whether a reference announces a discontinuity.
fn announces(frame: &Frame) -> bool {
    frame.data()[5] & 0x40 != 0
}

/// Global time of a node less true time, in microseconds.
fn error<A: Application>(bus: &UagvBus<A>, node: usize) -> Option<i64> {
    let time = bus.node(node).global_time(bus.stamp(node))?;
    Some(time.as_micros() as i64 - (bus.now().ticks() / 1000) as i64)
}

/// Watches the global times of all nodes, every millisecond.
#[derive(Default)]
struct Watch {
    errors: [Option<i64>; 4],
    /// Nodes that were started again with a time of their own, and have no other one yet.
    started: [bool; 4],
    /// The steps that no reference announced: node, time in ms, and step in us.
    silent: Vec<(usize, u64, i64)>,
    /// The largest announced step, us.
    announced: i64,
}

impl Watch {
    fn run_until<A: Application>(&mut self, bus: &mut UagvBus<A>, end: SimTime) {
        while bus.now() < end {
            bus.run_millis(1);
            self.look(bus);
        }
    }

    fn look<A: Application>(&mut self, bus: &UagvBus<A>) {
        for node in 0..4 {
            let powered = bus.is_powered(node);
            let now = powered.then(|| error(bus, node)).flatten();
            let before = std::mem::replace(&mut self.errors[node], now);
            if self.started[node] {
                self.started[node] = bus.node(node).status().clock == ClockState::Own;
                continue;
            }
            let (Some(before), Some(now)) = (before, now) else {
                continue;
            };
            let step = now - before;
            if step.abs() <= STEP {
                continue;
            }
            // The bit comes with the reference that tells the new time, or with the one before.
            let recent = bus.traffic.iter().rev().filter(|sent| {
                bus.now().ticks() < sent.end.ticks() + 205_000_000 && is_reference(sent)
            });
            let said = recent
                .filter(|sent| !sent.fate.is_error())
                .any(|sent| announces(&sent.frame));
            if said {
                self.announced = self.announced.max(step.abs());
            } else {
                self.silent
                    .push((node, bus.now().ticks() / 1_000_000, step));
            }
        }
    }
}

fn current<A: Application>(bus: &UagvBus<A>) -> Vec<usize> {
    let leads = |node: &usize| bus.node(*node).status().master == MasterState::Current;
    (0..4)
        .filter(|node| bus.is_powered(*node))
        .filter(leads)
        .collect()
}

#[test]
fn global_time_runs_on_when_the_best_ranked_master_returns() {
    let mut fallen = Vec::new();
    let mut slowest = 0;
    for back in 0..140 {
        for pause in [0, 1973] {
            let mut bus = vehicle(Quiet, back);
            for node in 0..4 {
                bus.start(node);
            }
            let mut watch = Watch::default();
            bus.run_until(at(1050));
            bus.crash(0, uagv(GPS));
            bus.run_until(at(1950 + pause + back));
            watch.look(&bus);
            bus.start(0);
            let from = bus.now();
            while current(&bus) != [0] {
                bus.run_millis(1);
                watch.look(&bus);
                slowest = slowest.max((bus.now() - from).to_millis());
                assert!(slowest < 700, "the best-ranked master leads again");
            }
            let end = at(bus.now().ticks() / 1_000_000 + 900);
            watch.run_until(&mut bus, end);
            let worst = watch.silent.iter().max_by_key(|(_, _, step)| step.abs());
            fallen.extend(worst.copied());
            assert_eq!(watch.announced, 0, "there is no need to set the time");
        }
    }
    println!("the master leads again within {slowest} ms");
    assert!(fallen.is_empty(), "{} of 280: {fallen:?}", fallen.len());
}

/// It has heard one reference, which tells the time to a millisecond and a half.
#[test]
fn a_returning_master_that_must_lead_at_once_announces_its_time() {
    let mut bus = vehicle(Quiet, 4);
    for node in 0..4 {
        bus.start(node);
    }
    bus.run_until(at(1050));
    bus.crash(0, uagv(GPS));
    bus.run_until(at(3000));
    bus.start(0);
    let mut watch = Watch::default();
    while bus.node(0).counters().references == 0 {
        bus.run_millis(1);
        watch.look(&bus);
    }
    let before = error(&bus, 2).expect("it has a time");
    bus.crash(1, uagv(CONTROLLER));
    watch.run_until(&mut bus, at(5000));
    assert_eq!(current(&bus), [0]);
    assert_eq!(watch.silent, []);
    let steps = [2, 3].map(|node| error(&bus, node).expect("it has a time") - before);
    println!("the step is {steps:?} us");
    for node in [2, 3] {
        assert!((-100..1600).contains(&steps[node - 2]), "{steps:?} us");
        assert_eq!(bus.node(node).counters().missed_references, 0);
    }
}

/// A frame that none of the masters sent is on the bus when the second reference is due that the one which came
/// back could hear. If it ended within the 64 us for which a reference waits for the bus, both would begin behind it.
#[test]
fn a_returning_master_waits_behind_a_frame_for_the_time() {
    for early in (0..440_u64).step_by(40) {
        let mut bus = vehicle(Quiet, early);
        for node in 0..4 {
            bus.start(node);
        }
        bus.run_until(at(1050));
        bus.crash(0, uagv(GPS));
        bus.run_until(at(3030));
        bus.start(0);
        while bus.node(0).counters().references == 0 {
            bus.run_millis(1);
        }
        let mut watch = Watch::default();
        watch.look(&bus);
        let begun = bus.traffic.iter().rev().find(|sent| is_reference(sent));
        let due = begun.expect("a reference").start + 100u64.millis();
        bus.run_until(due - early.micros());
        let long = Frame::new(Id::standard(0x7F0).expect("11 bits"), &[0; 8]).expect("8 bytes");
        bus.inject(3, long);
        watch.run_until(&mut bus, due + 5u64.millis());
        assert_eq!(current(&bus), [1], "{early} us before");
        watch.run_until(&mut bus, at(4000));
        assert_eq!(current(&bus), [0], "{early} us before");
        assert_eq!(
            (watch.announced, watch.silent),
            (0, vec![]),
            "{early} us before"
        );
    }
}

/// Joins two buses with the same nodes, each of which is powered on one of them.
fn joined(one: &UagvBus<Quiet>, other: &UagvBus<Quiet>) -> UagvBus<Quiet> {
    let mut bus = vehicle(Quiet, 5);
    bus.run_until(one.now());
    for node in 0..4 {
        let from = if one.is_powered(node) { one } else { other };
        bus.start(node);
        let state: Uagv = from.node(node).clone();
        bus.with(node, |node, _| *node = state);
    }
    bus
}

/// Two halves of a network that were apart, each with a master and a time of its own.
#[test]
fn a_master_announces_its_time_to_nodes_that_followed_another_one() {
    let mut silent = Vec::new();
    for late in 0..100 {
        let mut whole = vehicle(Quiet, 6);
        for node in 1..4 {
            whole.start(node);
        }
        whole.run_until(at(1999));
        let (mut one, mut other) = (vehicle(Quiet, 7), vehicle(Quiet, 8));
        one.run_until(at(1999));
        // The best-ranked master starts with a node beside it, and hears nothing of the others.
        for node in [0, 3] {
            one.start(node);
        }
        other.run_until(at(1999));
        for node in [1, 2] {
            other.start(node);
            let state = whole.node(node).clone();
            other.with(node, |node, _| *node = state);
        }
        one.run_until(at(3600 + late));
        other.run_until(at(3600 + late));
        // The frames on the bus are lost where it is joined.
        let mut bus = joined(&one, &other);
        let mut watch = Watch::default();
        watch.look(&bus);
        watch.run_until(&mut bus, at(5500));
        for node in 0..4 {
            assert_eq!(bus.node(node).status().sync, SyncState::InSchedule);
            let apart = error(&bus, node).unwrap() - error(&bus, 0).unwrap();
            assert!(apart.abs() < 100, "{late}: node {node}, {apart} us");
        }
        silent.extend(watch.silent.iter().map(|step| (late, *step)));
    }
    assert!(silent.is_empty(), "{} silent: {silent:?}", silent.len());
}

/// All frames are delivered but those that one node misses in a span of time, in ms.
struct Deaf {
    node: usize,
    from: u64,
    to: u64,
}

impl Application for Deaf {
    fn fate(&mut self, _: usize, _: &Frame, now: SimTime) -> Fate {
        if (at(self.from)..at(self.to)).contains(&now) {
            Fate::MissedBy(self.node)
        } else {
            Fate::Delivered
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// Masters stop and start in any order, and a node misses the frames of two basic cycles
    /// meanwhile.
    #[test]
    fn global_time_runs_on_or_a_step_is_announced(
        changes in prop::collection::vec((0..2usize, 30u64..900), 1..12),
        node in 0..4usize,
        from in 1500u64..6000,
        length in 0u64..195,
        crystals in prop::collection::vec(-50_000i32..=50_000, 4),
        seed: u64,
    ) {
        let deaf = Deaf { node, from, to: from + length };
        let mut bus = UagvBus::new(250_000, deaf, seed);
        for (node, ppb) in crystals.iter().enumerate() {
            bus.add(uagv(NodeId(node as u16)), crystal(*ppb, (seed as u32).wrapping_mul(node as u32 + 1)));
            bus.start(node);
        }
        let mut watch = Watch::default();
        watch.run_until(&mut bus, at(1400));
        for (master, pause) in changes {
            if bus.is_powered(master) {
                let id = if master == 0 { GPS } else { CONTROLLER };
                bus.crash(master, uagv(id));
            } else {
                bus.start(master);
            }
            // After a severe error the application starts its node again.
            for node in 0..4 {
                if bus.is_powered(node) && bus.node(node).status().sync == SyncState::Off {
                    bus.start(node);
                    watch.started[node] = true;
                }
            }
            let end = at(bus.now().ticks() / 1_000_000 + pause);
            watch.run_until(&mut bus, end);
        }
        prop_assert!(watch.silent.is_empty(), "{:?}", watch.silent);
    }
}
