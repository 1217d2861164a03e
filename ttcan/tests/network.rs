//! Four nodes on a bus: schedule, global time, masters, faults.

mod support;

use support::{
    ALARM, BUTTON, CONTROLLER, DRIVE, GPS, MATRIX, SCHEDULE, STEERING, Uagv, UagvBus,
    assert_in_place, at, config, crystal, is_reference, uagv, vehicle,
};
use ttcan::simulation::{Application, Bus, Crystal, Fate, Quiet, SimTime, delivered};
use ttcan::{
    Action, ErrorLevel, Event, Fault, Frame, GlobalTime, Grant, Health, Id, MasterState,
    MatrixConfig, Micros, Node, NodeId, QueueError, Reception, ReferenceFormat, Severe, Stamp,
    SyncState, SystemMatrix, TransmitOutcome, Window,
};

const ALL: [usize; 4] = [0, 1, 2, 3];

fn power_on<A: Application>(bus: &mut UagvBus<A>) {
    for node in ALL {
        bus.start(node);
    }
}

/// Largest difference between the global times of the powered nodes now, in
/// microseconds.
fn disagreement<A: Application>(bus: &UagvBus<A>) -> f64 {
    let times: Vec<u64> = (0..4)
        .filter(|node| bus.is_powered(*node))
        .map(|node| {
            let time = bus.node(node).global_time(bus.stamp(node));
            time.expect("the node has a time").raw()
        })
        .collect();
    let (first, last) = (times.iter().min(), times.iter().max());
    (last.unwrap() - first.unwrap()) as f64 / 65536.0
}

#[test]
fn every_message_comes_in_its_window() {
    let mut bus = vehicle(Quiet, 1);
    power_on(&mut bus);
    bus.run_until(at(10_000));
    assert_in_place(&bus.traffic);
    for window in MATRIX.config().windows {
        if let ttcan::WindowKind::Exclusive { id, .. } = window.kind {
            let count = delivered(&bus.traffic, id).count();
            assert!((96..=99).contains(&count), "{}: {count}", window.name);
        }
    }
    for node in ALL {
        let status = bus.node(node).status();
        assert_eq!(status.sync, SyncState::InSchedule);
        assert_eq!(status.error_level, ErrorLevel::None);
        assert_eq!(status.master_rank, Some(0));
        for peer in 0..4 {
            if peer != node {
                assert_eq!(bus.node(node).peer(NodeId(peer as u16)), Health::Healthy);
            }
        }
    }
    assert_eq!(bus.node(0).status().master, MasterState::Current);
    assert_eq!(bus.node(1).status().master, MasterState::Backup);
    assert_eq!(bus.node(2).status().master, MasterState::Follower);
}

#[test]
fn frames_start_within_8_us_of_their_mark() {
    let mut bus = vehicle(Quiet, 2);
    power_on(&mut bus);
    bus.run_until(at(60_000));
    let mut mark = None;
    let mut latest = 0i64;
    for sent in bus.traffic.iter().filter(|sent| sent.start > at(1000)) {
        if is_reference(sent) {
            mark = Some(sent.start.ticks());
        } else if let Some(mark) = mark {
            let into = ((sent.start.ticks() - mark) % 1_000_000) as i64;
            let from_mark = if into > 500_000 {
                into - 1_000_000
            } else {
                into
            };
            latest = latest.max(from_mark.abs());
        }
    }
    assert!(latest <= 8000, "{latest} ns");
}

/// What the README says about global time: the differences of 99 % of the instants, and the largest
/// one, in microseconds.
const AGREEMENT: (f64, f64) = (0.35, 0.45);

#[test]
fn nodes_agree_on_global_time() {
    let mut bus = vehicle(Quiet, 3);
    power_on(&mut bus);
    bus.run_until(at(1300));
    let mut errors: Vec<f64> = (0..6000)
        .map(|_| {
            bus.run_millis(10);
            disagreement(&bus)
        })
        .collect();
    errors.sort_by(f64::total_cmp);
    let p99 = errors[errors.len() * 99 / 100];
    let worst = errors[errors.len() - 1];
    println!("global time: p99 {p99:.3} us, worst {worst:.3} us");
    assert!(p99 <= AGREEMENT.0, "{p99} us");
    assert!(worst <= AGREEMENT.1, "{worst} us");
    let claim = format!(
        "at most {} us for 99 % of the time after the first 1.3 s, and by at most {} us",
        AGREEMENT.0, AGREEMENT.1
    );
    let readme = include_str!("../README.md").split_whitespace();
    let readme = readme.collect::<Vec<_>>().join(" ");
    assert!(readme.contains(&claim), "the README says: {claim}");
}

#[test]
fn the_backup_takes_over_and_the_master_returns_without_a_gap() {
    let mut bus = vehicle(Quiet, 4);
    power_on(&mut bus);
    bus.run_until(at(2050));
    bus.crash(0, uagv(GPS));
    bus.run_until(at(4000));
    assert_eq!(bus.node(1).status().master, MasterState::Current);
    for node in 1..4 {
        let status = bus.node(node).status();
        assert_eq!(status.sync, SyncState::InSchedule);
        assert_eq!(status.missed_references, 0);
        assert_eq!(bus.node(node).counters().missed_references, 0);
        assert_eq!(bus.node(node).peer(GPS), Health::Dead);
    }
    bus.start(0);
    bus.run_until(at(6000));
    assert_eq!(bus.node(0).status().master, MasterState::Current);
    assert_eq!(bus.node(1).status().master, MasterState::Backup);
    assert_in_place(&bus.traffic);
    let references: Vec<_> = bus
        .traffic
        .iter()
        .filter(|sent| is_reference(sent))
        .collect();
    for pair in references.windows(2) {
        let gap = (pair[1].start.ticks() - pair[0].start.ticks()) as f64 / 1000.0;
        assert!((99_800.0..100_150.0).contains(&gap), "{gap} us");
    }
    // No healthy node missed a window.
    for id in [206, 300, 450, 210] {
        let id = Id::standard(id).unwrap();
        let frames: Vec<_> = delivered(&bus.traffic, id).collect();
        for pair in frames.windows(2) {
            let gap = pair[1].start.ticks() - pair[0].start.ticks();
            assert!(gap < 101_000_000, "{id} {gap} ns");
        }
    }
    assert!(disagreement(&bus) < 2.0);
}

#[test]
fn any_order_of_power_on_ends_in_the_same_schedule() {
    for order in [
        [0, 1, 2, 3],
        [3, 2, 1, 0],
        [1, 0, 3, 2],
        [2, 3, 1, 0],
        [1, 2, 3, 0],
    ] {
        for pause in [0, 7, 100, 233] {
            let mut bus = vehicle(Quiet, 5);
            for node in order {
                bus.start(node);
                bus.run_millis(pause);
            }
            bus.run_millis(1500);
            assert_in_place(&bus.traffic);
            for node in ALL {
                let status = bus.node(node).status();
                assert_eq!(status.sync, SyncState::InSchedule, "{order:?} {pause}");
                assert_eq!(status.master_rank, Some(0), "{order:?} {pause}");
            }
        }
    }
}

#[test]
fn without_any_master_the_initial_watch_reports_and_nothing_is_sent() {
    let mut bus = vehicle(Quiet, 6);
    bus.start(2);
    bus.start(3);
    bus.run_until(at(2000));
    assert!(bus.traffic.is_empty());
    for node in [2, 3] {
        let status = bus.node(node).status();
        assert!(status.initial_watch);
        assert_eq!(status.error_level, ErrorLevel::None);
        assert!(!bus.node(node).is_alive());
    }
}

#[test]
fn when_references_cease_all_stop_and_can_start_again() {
    let mut bus = vehicle(Quiet, 7);
    power_on(&mut bus);
    bus.run_until(at(2050));
    bus.crash(0, uagv(GPS));
    bus.crash(1, uagv(CONTROLLER));
    let before = bus.traffic.len();
    bus.run_until(at(2303));
    assert!(!bus.node(2).is_alive(), "two references are missing");
    assert_eq!(
        bus.node(2).window(3).unwrap().missed,
        0,
        "no window without a cycle"
    );
    bus.run_until(at(3000));
    for node in [2, 3] {
        assert_eq!(
            bus.node(node).status().error_level,
            ErrorLevel::Severe(Severe::Watch)
        );
    }
    // The rest of the current basic cycle, and nothing after it.
    assert!(
        bus.traffic.len() <= before + 2,
        "{:?}",
        &bus.traffic[before..]
    );
    for node in ALL {
        bus.start(node);
    }
    bus.run_until(at(4000));
    for node in ALL {
        assert!(bus.node(node).is_alive());
    }
}

/// Loses or destroys frames, chosen by their running number.
struct Faulty {
    destroyed: fn(&Frame, SimTime) -> Fate,
}

impl Application for Faulty {
    fn fate(&mut self, _: usize, frame: &Frame, now: SimTime) -> Fate {
        (self.destroyed)(frame, now)
    }
}

/// The controller receives nothing for some milliseconds.
struct DeafController {
    from: u64,
    to: u64,
}

impl Application for DeafController {
    fn fate(&mut self, _: usize, _: &Frame, now: SimTime) -> Fate {
        if during(now, self.from, self.to) {
            Fate::MissedBy(1)
        } else {
            Fate::Delivered
        }
    }
}

fn during(now: SimTime, from: u64, to: u64) -> bool {
    (at(from)..at(to)).contains(&now)
}

/// Reading a received frame takes a processor time. The reference of a backup that
/// waits behind the master's would start three bits after it.
#[test]
fn a_backup_that_is_slow_to_read_sends_no_second_reference() {
    for slowest in [800, 12_000, 30_000, 48_000] {
        let mut bus = Bus::new(250_000, Quiet, 7);
        for node in 0..4 {
            let crystal = Crystal {
                interrupt: (200, if node == 1 { slowest } else { 800 }),
                ..crystal(0, 0)
            };
            bus.add(uagv(NodeId(node)), crystal);
        }
        power_on(&mut bus);
        bus.run_until(at(10_000));
        let second = bus
            .traffic
            .iter()
            .filter(|sent| is_reference(sent) && sent.sender == 1);
        assert_eq!(second.count(), 0, "interrupts after up to {slowest} ns");
    }
}

#[test]
fn a_destroyed_reference_is_sent_again_at_once() {
    fn fate(frame: &Frame, now: SimTime) -> Fate {
        let hit = frame.id().raw() == 100 && during(now, 1000, 1201);
        if hit && now.ticks() % 100_000_000 < 1_300_000 {
            Fate::Destroyed
        } else {
            Fate::Delivered
        }
    }
    let mut bus = vehicle(Faulty { destroyed: fate }, 8);
    power_on(&mut bus);
    bus.run_until(at(3000));
    assert_in_place(&bus.traffic);
    assert!(bus.node(0).counters().repeated_references > 0);
    for node in ALL {
        assert_eq!(bus.node(node).counters().missed_references, 0);
        assert_eq!(bus.node(node).status().master_rank, Some(0));
    }
}

#[test]
fn a_silent_command_is_noticed_within_two_cycles() {
    fn fate(frame: &Frame, now: SimTime) -> Fate {
        if frame.id().raw() == 300 && during(now, 1000, 1500) {
            Fate::Destroyed
        } else {
            Fate::Delivered
        }
    }
    let mut bus = vehicle(Faulty { destroyed: fate }, 9);
    power_on(&mut bus);
    bus.run_until(at(1000));
    let steering = |bus: &UagvBus<Faulty>| bus.node(2).window(3).unwrap();
    assert_eq!(steering(&bus).missed, 0);
    bus.run_until(at(1130));
    assert_eq!(steering(&bus).missed, 2);
    assert_eq!(steering(&bus).status_count, 2);
    bus.run_until(at(1490));
    assert_eq!(bus.node(2).status().error_level, ErrorLevel::Warning);
    bus.run_until(at(2500));
    assert_eq!(steering(&bus).missed, 0);
    assert_eq!(bus.node(2).status().error_level, ErrorLevel::None);
    assert_eq!(bus.node(2).counters().missed_messages, 5);
    assert_eq!(bus.node(1).counters().transmit_errors, 5);
}

#[test]
fn a_sender_that_never_succeeds_stops_sending_data() {
    fn fate(frame: &Frame, now: SimTime) -> Fate {
        if frame.id().raw() == 210 && during(now, 1000, 2000) {
            Fate::Destroyed
        } else {
            Fate::Delivered
        }
    }
    let mut bus = vehicle(Faulty { destroyed: fate }, 10);
    power_on(&mut bus);
    bus.run_until(at(2500));
    assert_eq!(bus.node(3).status().error_level, ErrorLevel::Error);
    let tries = |bus: &UagvBus<Faulty>| {
        let id = Id::standard(210).unwrap();
        bus.traffic
            .iter()
            .filter(|sent| sent.frame.id() == id)
            .count()
    };
    let before = tries(&bus);
    bus.run_until(at(3000));
    assert_eq!(tries(&bus), before);
    assert!(bus.node(3).counters().suppressed > 0);
    bus.with(3, |node, _| node.clear_errors());
    bus.run_until(at(3500));
    assert_eq!(tries(&bus), before + 5);
    assert_eq!(bus.node(3).status().error_level, ErrorLevel::None);
}

#[test]
fn a_late_message_uses_the_arbitrating_window_when_it_may() {
    fn fate(frame: &Frame, now: SimTime) -> Fate {
        let in_window = now.ticks() % 100_000_000 < 9_000_000;
        if frame.id().raw() == 206 && during(now, 1000, 1200) && in_window {
            Fate::Destroyed
        } else {
            Fate::Delivered
        }
    }
    let mut bus = vehicle(Faulty { destroyed: fate }, 11);
    // Basic cycles begin with the master's start. Its windows are early in each
    // 100 ms of true time.
    power_on(&mut bus);
    bus.run_until(at(3000));
    assert_in_place(&bus.traffic);
    assert!(bus.node(2).counters().events_sent >= 1);
    assert!(bus.node(0).counters().events >= 1);
}

#[test]
fn events_go_by_priority_within_their_lifetime() {
    let mut bus = vehicle(Quiet, 12);
    power_on(&mut bus);
    bus.run_until(at(1060));
    let alarm = Frame::new(ALARM, &[1; 8]).unwrap();
    let button = Frame::new(BUTTON, &[2; 8]).unwrap();
    let life = Micros::millis(200);
    let brief = Micros::millis(1);
    let queue = |bus: &mut UagvBus<Quiet>, frame, lifetime| {
        bus.with(3, |node, now| node.queue_event(frame, now, lifetime))
    };
    queue(&mut bus, button, life).unwrap();
    queue(&mut bus, button, brief).unwrap();
    bus.run_millis(2);
    for _ in 0..3 {
        queue(&mut bus, alarm, life).unwrap();
    }
    assert_eq!(queue(&mut bus, alarm, life), Err(QueueError::Full));
    let steering = Frame::new(Id::standard(206).unwrap(), &[0; 2]).unwrap();
    assert_eq!(queue(&mut bus, steering, life), Err(QueueError::NotAnEvent));
    let forever = Micros::secs(100);
    assert_eq!(queue(&mut bus, alarm, forever), Err(QueueError::Lifetime));
    bus.run_until(at(1600));
    assert_in_place(&bus.traffic);
    let events: Vec<u32> = bus
        .traffic
        .iter()
        .filter(|sent| [ALARM, BUTTON].contains(&sent.frame.id()))
        .map(|sent| sent.frame.id().raw())
        .collect();
    // There is room for four frames of at most 540 us in 3 ms. The lower identifier
    // is sent first.
    assert_eq!(events, [0x20, 0x20, 0x20, 0x21]);
    assert_eq!(bus.node(3).counters().events_expired, 1);
    assert_eq!(bus.node(3).counters().events_refused, 1);
    assert_eq!(bus.node(2).counters().events, 4);
}

#[test]
fn a_newer_event_takes_the_place_of_one_that_waits() {
    let mut bus = vehicle(Quiet, 12);
    power_on(&mut bus);
    bus.run_until(at(1060));
    let life = Micros::millis(200);
    let alarm = |value| Frame::new(ALARM, &[value; 8]).unwrap();
    let replace = |bus: &mut UagvBus<Quiet>, frame| {
        bus.with(3, |node, now| node.replace_event(frame, now, life))
    };
    let none = Err(QueueError::NoneWaits);
    assert_eq!(replace(&mut bus, alarm(1)), none);
    for value in [2, 3] {
        bus.with(3, |node, now| {
            node.queue_event(alarm(value), now, life).unwrap();
        });
    }
    let other = Frame::new(BUTTON, &[9; 8]).unwrap();
    bus.with(3, |node, now| {
        node.queue_event(other, now, Micros::millis(1)).unwrap();
    });
    assert!(bus.node(3).has_event(ALARM));
    assert_eq!(replace(&mut bus, alarm(4)), Ok(()));
    assert_eq!(replace(&mut bus, alarm(5)), Ok(()));
    // It lives from now on, not from when the one before was enqueued.
    bus.run_millis(2);
    assert_eq!(replace(&mut bus, other), Ok(()));
    let steering = Frame::new(Id::standard(206).unwrap(), &[0; 2]).unwrap();
    assert_eq!(replace(&mut bus, steering), Err(QueueError::NotAnEvent));
    bus.run_until(at(1600));
    assert_in_place(&bus.traffic);
    let events: Vec<(u32, u8)> = bus
        .traffic
        .iter()
        .filter(|sent| [ALARM, BUTTON].contains(&sent.frame.id()))
        .map(|sent| (sent.frame.id().raw(), sent.frame.data()[0]))
        .collect();
    assert_eq!(events, [(0x20, 2), (0x20, 5), (0x21, 9)]);
    assert!(!bus.node(3).has_event(ALARM) && !bus.node(3).has_event(BUTTON));
    assert_eq!(bus.node(3).counters().events_sent, 3);
    assert_eq!(replace(&mut bus, alarm(6)), none);
}

/// A message that is being sent cannot be replaced: the newer one would follow it at once.
#[test]
fn an_event_in_transmission_is_not_replaced() {
    use ttcan::{Action, TransmitOutcome};
    let life = Micros::millis(250);
    let alarm = |value| Frame::new(ALARM, &[value; 8]).unwrap();
    for outcome in [TransmitOutcome::Sent, TransmitOutcome::ArbitrationLost] {
        let mut bus = vehicle(Quiet, 23);
        power_on(&mut bus);
        bus.run_until(at(1005));
        bus.with(3, |node, now| {
            node.queue_event(alarm(1), now, life).unwrap();
            let mut due = now;
            loop {
                match node.poll(due) {
                    Some(Action::TransmitEvent(_)) => break,
                    Some(_) => node.handle_transmit(TransmitOutcome::Aborted, due),
                    None => due = node.next_deadline().unwrap(),
                }
            }
            let replaced = node.replace_event(alarm(2), due, life);
            assert_eq!(replaced, Err(QueueError::NoneWaits));
            assert!(node.has_event(ALARM));
            node.handle_transmit(outcome, due);
            let waits = outcome != TransmitOutcome::Sent;
            assert_eq!(node.has_event(ALARM), waits);
            assert_eq!(node.replace_event(alarm(3), due, life).is_ok(), waits);
            let again = node.poll(due);
            assert_eq!(again, waits.then_some(Action::TransmitEvent(alarm(3))));
        });
    }
}

#[test]
fn a_lost_node_and_a_babbling_one_are_told_apart() {
    let mut bus = vehicle(Quiet, 13);
    power_on(&mut bus);
    bus.run_until(at(1050));
    // The speed message is 20 ms late in each basic cycle.
    bus.crash(3, uagv(DRIVE));
    let speed = Frame::new(Id::standard(210).unwrap(), &[0; 4]).unwrap();
    for cycle in 0..4 {
        bus.run_until(at(1130 + 100 * cycle));
        bus.inject(0, speed);
    }
    bus.run_until(at(1500));
    assert_eq!(bus.node(2).peer(DRIVE), Health::Lost);
    assert_eq!(bus.node(2).peer(GPS), Health::Healthy);
    for _ in 0..10 {
        bus.run_millis(1);
        bus.inject(0, speed);
    }
    bus.run_millis(2);
    assert_eq!(bus.node(2).peer(DRIVE), Health::Babbling);
    assert!(bus.node(2).counters().misplaced >= 14);
}

#[test]
fn foreign_and_wrong_frames_are_counted_and_survived() {
    #[derive(Default)]
    struct Faults(Vec<(usize, Fault)>);
    impl Application for Faults {
        fn received(&mut self, node: usize, _: &Frame, reception: Reception, _: SimTime) {
            if let Reception::Fault(fault) = reception {
                self.0.push((node, fault));
            }
        }
        fn payload(&mut self, node: usize, _: &Grant) -> Option<[u8; 8]> {
            (node != 3).then_some([0xFF; 8])
        }
    }
    let mut bus = vehicle(Faults::default(), 14);
    power_on(&mut bus);
    bus.run_until(at(1000));
    bus.application.0.clear();
    let reference = bus.node(0).reference_mark().unwrap();
    let into = bus.stamp(0).ticks_since(reference) as u64 / 18_000;
    // 500 us after the beginning of the speed window, which its node leaves empty.
    bus.run_millis(100 - into + 9);
    let id = |raw| Id::standard(raw).unwrap();
    bus.inject(0, Frame::new(id(210), &[0; 3]).unwrap());
    bus.run_millis(1);
    bus.inject(0, Frame::new(id(0x700), &[]).unwrap());
    bus.run_millis(10);
    bus.inject(0, Frame::new(id(101), &[0; 8]).unwrap());
    bus.run_millis(10);
    bus.inject(0, Frame::new(id(103), &[0; 8]).unwrap());
    bus.run_millis(10);
    bus.inject(0, Frame::new(id(100), &[0; 2]).unwrap());
    bus.run_millis(10);
    let seen: Vec<Fault> = bus
        .application
        .0
        .iter()
        .filter(|(node, _)| *node == 2)
        .map(|(_, fault)| *fault)
        .collect();
    assert_eq!(
        seen,
        [
            Fault::Length,
            Fault::Foreign,
            Fault::UntimelyReference,
            Fault::UnknownMaster,
            Fault::MalformedReference,
        ]
    );
    bus.run_until(at(3000));
    for node in ALL {
        assert!(bus.node(node).is_alive());
        assert_eq!(bus.node(node).counters().missed_references, 0);
    }
}

#[test]
fn a_gap_rests_until_its_event() {
    let mut bus = vehicle(Quiet, 15);
    power_on(&mut bus);
    bus.run_until(at(1000));
    assert!(bus.with(1, |node, _| node.request_gap()).is_err());
    bus.with(0, |node, _| node.request_gap()).unwrap();
    bus.run_until(at(1600));
    for node in ALL {
        assert_eq!(bus.node(node).status().sync, SyncState::InGap);
        assert!(bus.node(node).is_alive());
    }
    let before = bus.traffic.len();
    bus.run_until(at(3000));
    assert_eq!(bus.traffic.len(), before, "the bus rests");
    bus.with(0, |node, now| node.end_gap(now)).unwrap();
    bus.run_until(at(3003));
    assert!(bus.traffic.len() > before);
    bus.run_until(at(3900));
    assert_in_place(&bus.traffic);
    for node in ALL {
        assert_eq!(bus.node(node).status().sync, SyncState::InSchedule);
    }
    assert!(disagreement(&bus) < 2.0);
}

#[test]
fn a_master_that_dies_in_a_gap_is_replaced_after_the_longest_gap() {
    let mut bus = vehicle(Quiet, 16);
    power_on(&mut bus);
    bus.run_until(at(1000));
    bus.with(0, |node, _| node.request_gap()).unwrap();
    bus.run_until(at(1600));
    bus.crash(0, uagv(GPS));
    bus.run_until(at(12_000));
    for node in [1, 2, 3] {
        assert!(bus.node(node).is_alive());
        assert_eq!(bus.node(node).status().sync, SyncState::InSchedule);
    }
}

#[test]
fn global_time_leaps_everywhere_when_the_master_sets_it() {
    let mut bus = vehicle(Quiet, 17);
    power_on(&mut bus);
    bus.run_until(at(2000));
    let noon = GlobalTime::from_micros(43_200_000_000);
    bus.with(0, |node, now| node.set_global_time(now, noon))
        .unwrap();
    bus.run_until(at(3000));
    for node in ALL {
        let time = bus.node(node).global_time(bus.stamp(node)).unwrap();
        let since = time.since(noon) as f64 / 65536.0;
        assert!((since - 1_000_000.0).abs() < 100.0, "{since}");
    }
    assert!(disagreement(&bus) < 2.0);
    for node in 1..4 {
        assert_eq!(
            bus.node(node).counters().time_steps,
            2,
            "the first time and the leap"
        );
    }
}

#[test]
fn time_holds_over_a_missing_master() {
    let mut bus = vehicle(Quiet, 18);
    power_on(&mut bus);
    bus.run_until(at(3050));
    let steering = |bus: &UagvBus<Quiet>| {
        let time = bus.node(2).global_time(bus.stamp(2)).unwrap();
        time.raw() as f64 / 65536.0
    };
    let own = |bus: &UagvBus<Quiet>| {
        let time = bus.node(0).global_time(bus.stamp(0)).unwrap();
        time.raw() as f64 / 65536.0
    };
    let before = steering(&bus) - own(&bus);
    bus.crash(1, uagv(CONTROLLER));
    // Without references, the time of the other nodes runs on at the measured rate.
    // Without that rate, 81 ppm would make 24 us here.
    let rate = bus.node(2).rate();
    assert!(
        (-90 * 4295..-70 * 4295).contains(&rate)
            || (70 * 4295..90 * 4295).contains(&rate)
            || (10 * 4295..30 * 4295).contains(&rate.abs()),
        "{rate}"
    );
    bus.run_until(at(3090));
    let after = steering(&bus) - own(&bus);
    assert!((after - before).abs() < 0.5, "{before} {after}");
}

#[test]
fn drift_beyond_the_limit_is_refused_and_reported() {
    let mut bus = vehicle(Quiet, 19);
    power_on(&mut bus);
    bus.run_until(at(3000));
    bus.drift(2, 900_000);
    bus.run_until(at(3300));
    assert!(bus.node(2).counters().drift_refused > 0);
    assert_eq!(bus.node(2).status().clock, ttcan::ClockState::Suspended);
    bus.drift(2, 0);
    bus.run_until(at(5000));
    assert_eq!(bus.node(2).status().clock, ttcan::ClockState::Locked);
    assert!(disagreement(&bus) < 2.0);
}

#[test]
fn a_master_that_hears_nothing_gives_way_and_stops() {
    // It began the schedule, and the better-ranked master joins that.
    let mut bus = vehicle(DeafController { from: 0, to: 1400 }, 20);
    for node in [1, 2, 3] {
        bus.start(node);
    }
    bus.run_until(at(350));
    assert_eq!(bus.node(1).status().master, MasterState::Current);
    bus.start(0);
    bus.run_until(at(1390));
    assert_eq!(bus.node(0).status().master, MasterState::Current);
    let status = bus.node(1).status();
    assert_eq!(status.error_level, ErrorLevel::Severe(Severe::Watch));
    bus.run_until(at(1500));
    bus.start(1);
    bus.run_until(at(1810));
    assert_eq!(bus.node(1).status().master, MasterState::Backup);
    for node in ALL {
        assert!(bus.node(node).is_alive());
    }
}

#[test]
fn a_backup_that_heard_nothing_for_two_cycles_follows_again_within_one() {
    let deaf = DeafController {
        from: 1000,
        to: 1250,
    };
    let mut bus = vehicle(deaf, 20);
    power_on(&mut bus);
    bus.run_until(at(1360));
    assert_eq!(bus.node(0).status().master, MasterState::Current);
    assert_eq!(bus.node(1).status().master, MasterState::Backup);
    bus.run_until(at(2500));
    for node in ALL {
        assert!(bus.node(node).is_alive());
    }
}

#[test]
fn a_backup_that_hears_nothing_stops_and_sends_no_reference() {
    let deaf = DeafController {
        from: 1000,
        to: 1600,
    };
    let mut bus = vehicle(deaf, 20);
    power_on(&mut bus);
    bus.run_until(at(2500));
    let status = bus.node(1).status();
    assert_eq!(status.sync, SyncState::Off);
    assert_eq!(status.error_level, ErrorLevel::Severe(Severe::Watch));
    let mut references = bus.traffic.iter().filter(|sent| is_reference(sent));
    assert!(references.all(|sent| sent.sender == 0));
    for node in [0, 2, 3] {
        assert!(bus.node(node).is_alive());
    }
}

#[test]
fn an_application_that_stops_silences_its_node() {
    let config = ttcan::NodeConfig {
        application_watchdog: Some(Micros::millis(50)),
        ..support::config(STEERING)
    };
    let mut bus = vehicle(Quiet, 21);
    let watched = support::Uagv::new(support::SCHEDULE.view(), config).unwrap();
    bus.crash(2, watched);
    power_on(&mut bus);
    for _ in 0..50 {
        bus.run_millis(40);
        bus.with(2, |node, now| node.feed_watchdog(now));
    }
    assert!(bus.node(2).is_alive());
    bus.run_millis(500);
    assert_eq!(
        bus.node(2).status().error_level,
        ErrorLevel::Severe(Severe::ApplicationWatchdog)
    );
    assert_eq!(bus.node(0).peer(STEERING), Health::Dead);
    assert!(bus.node(0).is_alive());
}

#[test]
fn bus_off_silences_until_the_application_starts_again() {
    let mut bus = vehicle(Quiet, 22);
    power_on(&mut bus);
    bus.run_until(at(1000));
    bus.with(3, |node, _| node.handle_bus_off());
    bus.run_until(at(1500));
    assert_eq!(
        bus.node(3).status().error_level,
        ErrorLevel::Severe(Severe::BusOff)
    );
    bus.start(3);
    bus.run_until(at(2000));
    assert!(bus.node(3).is_alive());
}

#[test]
fn a_master_trims_its_cycle_and_the_others_follow() {
    let mut bus = vehicle(Quiet, 7);
    power_on(&mut bus);
    bus.run_until(at(2000));
    let begun = bus.traffic.len();
    for cycle in 1..=50 {
        bus.with(0, |node, _| node.trim_cycle(100))
            .expect("node 0 is the master");
        bus.run_until(at(2000 + 100 * cycle));
    }
    assert!(bus.with(1, |node, _| node.trim_cycle(1)).is_err());
    assert_in_place(&bus.traffic);
    let starts: Vec<u64> = bus
        .traffic
        .iter()
        .skip(begun)
        .filter(|sent| is_reference(sent))
        .map(|sent| sent.start.ticks())
        .collect();
    // From the second one on, every basic cycle is 8 us longer than 100 ms of the
    // master's crystal, which is 31 ppm fast; give or take a bit time.
    let gaps: Vec<f64> = starts
        .windows(2)
        .skip(2)
        .map(|pair| (pair[1] - pair[0]) as f64 / 1000.0)
        .collect();
    let mean = gaps.iter().sum::<f64>() / gaps.len() as f64;
    assert!((mean - 100_004.9).abs() < 0.5, "{mean}");
    assert!(gaps.iter().all(|gap| (gap - mean).abs() < 5.0), "{gaps:?}");
    for node in ALL {
        let status = bus.node(node).status();
        assert_eq!(status.sync, SyncState::InSchedule);
        assert_eq!(status.master_rank, Some(0));
        assert_eq!(bus.node(node).counters().missed_references, 0);
    }
}

#[test]
fn a_mailbox_that_is_taken_does_not_keep_the_node_busy() {
    use ttcan::{Action, Stamp, TransmitOutcome};
    // A single master whose controller refuses every request.
    let mut node = uagv(GPS);
    node.start(Stamp(0));
    let mut requests = 0;
    while let Some(due) = node.next_deadline().filter(|due| due.0 < 18 * 400_000) {
        while let Some(action) = node.poll(due) {
            if matches!(action, Action::TransmitReference(_)) {
                requests += 1;
                node.handle_transmit(TransmitOutcome::Aborted, due);
            }
        }
    }
    // One request every 16 bit times, from the end of the first silent basic cycle
    // on.
    assert!((4000..5000).contains(&requests), "{requests}");

    // An event message is tried once in each arbitrating window.
    let mut bus = vehicle(Quiet, 23);
    power_on(&mut bus);
    bus.run_until(at(1005));
    let alarm = Frame::new(ALARM, &[1; 8]).unwrap();
    let life = Micros::millis(250);
    let tries = bus.with(3, |node, now| {
        node.queue_event(alarm, now, life).unwrap();
        let mut tries = 0;
        while let Some(due) = node
            .next_deadline()
            .filter(|due| due.ticks_since(now) < 18 * 105_000)
        {
            while let Some(action) = node.poll(due) {
                if matches!(action, Action::TransmitEvent(_)) {
                    tries += 1;
                }
                if matches!(action, Action::TransmitEvent(_) | Action::Transmit(_)) {
                    node.handle_transmit(TransmitOutcome::Aborted, due);
                }
            }
        }
        tries
    });
    assert_eq!(tries, 1);
}

#[test]
fn global_time_outlives_the_wrap_of_its_coarse_part() {
    let mut bus = vehicle(Quiet, 24);
    power_on(&mut bus);
    bus.run_until(at(1000));
    // The coarse time wraps 2^32 ms after the epoch.
    let wrap = GlobalTime::from_micros((1 << 32) * 1000);
    bus.with(0, |node, now| {
        node.set_global_time(now, wrap.offset(-(1_500_000 << 16)))
    })
    .unwrap();
    bus.run_until(at(4000));
    for node in ALL {
        let time = bus.node(node).global_time(bus.stamp(node)).unwrap();
        assert!(time > wrap);
        assert!(bus.node(node).counters().time_steps <= 2);
        assert_eq!(bus.node(node).counters().drift_refused, 0);
    }
    assert!(disagreement(&bus) < 2.0);
}

#[test]
fn nodes_agree_while_their_crystals_warm_up() {
    let mut bus = vehicle(Quiet, 25);
    power_on(&mut bus);
    bus.run_until(at(1300));
    let mut worst = 0f64;
    // The rates change by up to 0.2 ppm per second, in different directions.
    for step in 0..300 {
        for (node, start) in [31_000, -50_000, 50_000, -12_345].into_iter().enumerate() {
            let slope = [20, -20, 15, -10][node];
            bus.drift(node, start + slope * step);
        }
        bus.run_millis(100);
        worst = worst.max(disagreement(&bus));
    }
    assert!(worst <= 2.0, "{worst} us");
}

/// A node on an RC oscillator that is 3000 ppm off. Until it has measured its rate,
/// the beginning of its window is too uncertain.
#[test]
fn a_node_on_an_rc_oscillator_waits_until_it_knows_its_rate() {
    for ppb in [3_000_000, -3_000_000, 9_000_000] {
        for first in [false, true] {
            let mut bus = UagvBus::new(250_000, Quiet, 17);
            for node in 0..4 {
                let node = NodeId(node);
                let rc = node == DRIVE;
                let mut config = config(node);
                if rc {
                    config.drift_limit_ppm = 10_000;
                }
                let node = Uagv::new(SCHEDULE.view(), config).unwrap();
                bus.add(node, crystal(if rc { ppb } else { 20_000 }, 5));
            }
            if first {
                bus.start(3);
                bus.run_millis(500);
            }
            for node in 0..3 {
                bus.start(node);
            }
            if !first {
                bus.run_millis(930);
                bus.start(3);
            }
            for _ in 0..30 {
                // Enqueues an event message for every arbitrating window.
                bus.with(3, |node, now| {
                    let frame = Frame::new(ALARM, &[1]).unwrap();
                    let _ = node.queue_event(frame, now, Micros::millis(90));
                });
                bus.run_millis(50);
            }
            assert_in_place(&bus.traffic);
            let mine = |id| delivered(&bus.traffic, id).filter(|sent| sent.sender == 3);
            let references: Vec<_> = bus
                .traffic
                .iter()
                .filter(|sent| is_reference(sent))
                .collect();
            for sent in mine(ALARM) {
                let mark = references
                    .iter()
                    .rfind(|mark| mark.start <= sent.start)
                    .unwrap();
                let after = sent.start.ticks() - mark.start.ticks();
                assert!(
                    after >= 10_995_000,
                    "{ppb}: an event {after} ns after the mark"
                );
            }
            assert!(mine(ALARM).count() > 8);
            // Only the window of the basic cycle that measures the rate is lost.
            let sent = mine(Id::constant::<210>()).count() as u32;
            let status = bus.node(3).counters();
            assert!(sent + 2 >= status.references - 1, "{sent}: {status:?}");
            assert_eq!(bus.node(3).status().error_level, ErrorLevel::None);
        }
    }
}

/// A frame that is still in the mailbox when the node stops would go out when the controller joins
/// the bus again, with contents of long ago.
#[test]
fn a_node_that_stops_withdraws_its_frame_before_it_starts_again() {
    let start = Stamp(1_000_000);
    let mut node = uagv(GPS);
    node.start(start);
    let due = node.next_deadline().unwrap();
    assert!(matches!(node.poll(due), Some(Action::TransmitReference(_))));
    node.handle_bus_off();
    assert_eq!(node.poll(due), Some(Action::Silence));
    let again = due.after(3_600_000);
    node.start(again);
    assert_eq!(node.poll(again), Some(Action::Abort));
    assert_eq!(node.poll(again), None);
    // The same when the report comes while the node is off: there is nothing left to withdraw.
    let mut node = uagv(GPS);
    node.start(start);
    assert!(node.poll(due).is_some());
    node.handle_bus_off();
    assert_eq!(node.poll(due), Some(Action::Silence));
    node.handle_transmit(TransmitOutcome::Aborted, due);
    assert_eq!(node.counters().stray_reports, 0);
    node.start(again);
    assert_eq!(node.poll(again), None);
}

const FOUR_CYCLES: SystemMatrix = SystemMatrix::constant(MatrixConfig {
    bit_rate: 250_000,
    basic_cycle: Micros::millis(10),
    cycles: 4,
    reference: Id::constant::<100>(),
    reference_format: ReferenceFormat::LEVEL_1,
    masters: &[NodeId(0)],
    transmit_enable_bits: 16,
    sync_uncertainty: Micros::micros(20),
    longest_gap: Micros::micros(0),
    windows: &[Window::arbitrating(
        "events",
        Micros::millis(3),
        Micros::millis(2),
    )],
    events: &[
        Event::new("first", Id::constant::<0x20>(), 8, NodeId(1)).every(4, 2),
        Event::new("second", Id::constant::<0x21>(), 8, NodeId(1)).every(4, 2),
        Event::new("third", Id::constant::<0x22>(), 8, NodeId(2)),
    ],
});
ttcan::schedule!(static FOUR = FOUR_CYCLES);

/// A schedule counts on it that a message is on the bus in its basic cycles only, though an
/// arbitrating window is open in all of them.
#[test]
fn events_go_in_their_basic_cycles() {
    type Four = Node<'static, { FOUR_CYCLES.window_count() }, { FOUR_CYCLES.node_count() }, 4>;
    let mut bus = Bus::new(250_000, Quiet, 3);
    for node in 0..3 {
        let node = NodeId(node);
        let phase = 5000 * u32::from(node.0);
        bus.add(
            Four::new(FOUR.view(), config(node)).unwrap(),
            crystal(10_000, phase),
        );
    }
    for node in 0..3 {
        bus.start(node);
    }
    bus.run_millis(200);
    for round in 0..37 {
        for (node, id) in [(1, 0x20), (1, 0x21), (2, 0x22)] {
            let frame = Frame::new(Id::standard(id).unwrap(), &[round; 8]).unwrap();
            let life = Micros::millis(80);
            bus.with(node, |node, now| node.queue_event(frame, now, life))
                .unwrap();
        }
        bus.run_millis(51);
    }
    let (mut cycle, mut sent) = (0, [[0; 4]; 3]);
    for traffic in &bus.traffic {
        match traffic.frame.id().raw() {
            100 => cycle = usize::from(traffic.frame.data()[0] & 63),
            id => sent[id as usize - 0x20][cycle] += 1,
        }
    }
    assert_eq!(sent[0], [0, 0, 37, 0]);
    assert_eq!(sent[1], [0, 0, 37, 0]);
    // A message of every basic cycle goes in the next one.
    assert!(sent[2].iter().all(|count| *count >= 8), "{sent:?}");
    assert_eq!(bus.node(1).counters().events_expired, 0);
}
