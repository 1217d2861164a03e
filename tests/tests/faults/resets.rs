//! Nodes that are held in reset or stall, and that come back.

use furrow_tests::Journey;
use furrow_tests::nodes;
use furrow_tests::time::{at, seconds, span};
use network::Message as _;
use twin::ResetCause;
use uagv::messages::GpsStatus;
use vehicle_model::NodeIndex;
use world::SimTime;

use crate::{
    RUNNING, assert_never_reset, assert_steady, first_after, last_before, mode, next_cycle, running,
};

const BASIC_PERIOD: f64 = 0.1;

/// A driving vehicle whose `node` is held in reset from 3.23 s to 4.03 s.
fn without(node: NodeIndex) -> Journey {
    let mut journey = running(&format!(
        "reset = [{{ node = \"{}\", at = \"3.23 s\", until = \"4.03 s\" }}]",
        nodes::name(node)
    ));
    journey.to(4.0);
    journey
}

#[test]
fn the_gps_node_in_reset_hands_the_schedule_over_and_takes_it_back() {
    let mut journey = without(nodes::GPS);
    let stopped = journey.stopped(at(3.23)).expect("the motors stop");
    assert!(stopped <= at(3.43), "{} s", seconds(stopped));
    let last = last_before(&journey, 100, at(3.3));
    let next = first_after(&journey, 101, at(3.23));
    // One basic cycle and the backup's offset of 16 us; the clocks agree within 20 us.
    let silence = next.start - last.start;
    println!(
        "next reference {:.1} us after the last",
        silence.as_ticks() as f64 * 1e-6
    );
    assert!(silence < span(BASIC_PERIOD + 0.000_036));
    // The running nodes send in every window, also in the basic cycles of the takeover.
    let traffic = journey.traffic();
    let begins = journey.matrix().references(&traffic);
    let references: Vec<_> = begins.iter().map(|begin| begin.start).collect();
    let near = references.windows(2).filter(|pair| pair[0] >= last.start);
    for pair in near {
        for id in [206, 300, 450, 451, 452, 453] {
            assert_eq!(traffic.between(id, pair[0], pair[1]).count(), 1, "{id}");
        }
    }
    assert_steady(
        &journey,
        &[101, 206, 300, 450, 453],
        seconds(next.start),
        4.0,
    );
    journey.to(6.0);
    // The node comes back as the master with the better rank, without a gap in the references.
    let back = first_after(&journey, 100, at(4.03));
    let before = last_before(&journey, 101, back.start);
    assert!(back.start - before.start < span(1.02 * BASIC_PERIOD));
    assert_eq!(journey.traffic().between(101, back.end, at(6.0)).count(), 0);
    assert_steady(
        &journey,
        &[100, 200, 206, 300],
        seconds(back.start) + 0.3,
        6.0,
    );
    // The vehicle does not start to drive without a request.
    assert!(journey.last_moved(nodes::DRIVE) < Some(stopped));
    assert!(matches!(journey.mode(), Some(mode::READY | mode::FAULT)));
    journey.assert_in_place();
}

#[test]
fn without_the_controller_both_motors_stop() {
    let mut journey = without(nodes::CONTROLLER);
    let last = last_before(&journey, 300, at(3.3));
    let stopped = journey.stopped(at(3.23)).expect("the motors stop");
    // Two commands are missing at the end of the window of the second.
    assert!(stopped < last.start + span(2.0 * BASIC_PERIOD + 0.001));
    assert!(journey.last_moved(nodes::DRIVE) < Some(stopped));
    assert_steady(&journey, &[100, 201, 206], 3.0, 4.0);
    journey.to(5.0);
    let back = first_after(&journey, 300, at(4.03));
    assert!(
        back.start < at(4.03 + 3.0 * BASIC_PERIOD),
        "{} s",
        seconds(back.start)
    );
    assert_eq!(back.data[4], mode::IDLE);
    assert_steady(&journey, &[300, 450, 453], seconds(back.start), 5.0);
    assert!(journey.last_moved(nodes::DRIVE) < Some(stopped));
    journey.assert_in_place();
}

#[test]
fn without_the_steering_node_the_vehicle_does_not_drive() {
    let mut journey = without(nodes::STEERING);
    // Resetting the node opens its relay. The drive must not continue without steering.
    assert_eq!(journey.effort(nodes::STEERING, at(3.2301)), 0.0);
    let last = last_before(&journey, 206, at(3.3));
    let moved = journey.last_moved(nodes::DRIVE).expect("it drove");
    assert!(
        moved < last.start + span(4.5 * BASIC_PERIOD),
        "{} s",
        seconds(moved)
    );
    assert_eq!(journey.effort(nodes::DRIVE, at(4.0)), 0.0);
    assert_eq!(journey.mode(), Some(mode::FAULT));
    journey.to(5.0);
    let back = first_after(&journey, 206, at(4.03));
    assert!(
        back.start < at(4.03 + 3.0 * BASIC_PERIOD),
        "{} s",
        seconds(back.start)
    );
    let moved = journey.last_moved(nodes::STEERING);
    assert!(moved < Some(at(3.23)), "{moved:?}");
    assert_steady(&journey, &[206], seconds(back.start), 5.0);
    assert_steady(&journey, &[100, 300], 1.0, 5.0);
    journey.assert_in_place();
}

#[test]
fn the_drive_node_in_reset_stops_at_once_and_follows_again() {
    let mut journey = without(nodes::DRIVE);
    assert!(journey.effort(nodes::DRIVE, at(3.2299)) > 0.2);
    assert_eq!(journey.effort(nodes::DRIVE, at(3.2301)), 0.0);
    assert_steady(&journey, &[100, 206, 300], 1.0, 4.0);
    journey.to(5.0);
    // After the reset the drive node first stops its motor. Then it needs the schedule and two
    // commands.
    let drive = |from: f64, until: f64| {
        let changes = journey.vehicle.world().efforts().iter();
        changes
            .filter(|change| change.node == nodes::DRIVE)
            .find(|change| (at(from)..at(until)).contains(&change.at))
            .copied()
    };
    assert_eq!(drive(3.24, 4.03), None, "a node in reset says nothing");
    let first = drive(4.03, 4.2).expect("a stop after the start");
    assert_eq!((first.effort, first.byte), (0.0, 127));
    let again = drive(seconds(first.at) + 0.001, 5.0).expect("it follows again");
    assert!(again.effort > 0.0);
    assert!(
        again.at < at(4.03 + 5.0 * BASIC_PERIOD),
        "{} s",
        seconds(again.at)
    );
    assert_eq!(journey.mode(), Some(mode::RUN));
    journey.assert_in_place();
}

/// A driving vehicle in which the core of `node` stalls, run until one second after the watchdog's
/// reset, with the times of the stall and the reset. The frequency of the watchdog's oscillator may
/// deviate by a factor of two.
fn stalled(node: NodeIndex, nominal: f64) -> (Journey, f64, f64) {
    let mut journey = running("");
    next_cycle(&mut journey);
    campaign::stall(&mut journey.vehicle, node).expect("programs that the parts allow");
    let stalled = seconds(journey.vehicle.now());
    journey.to(stalled + 2.0 * nominal + 0.2);
    let resets = journey.vehicle.node(node).resets();
    assert_eq!(resets.len(), 2, "{node:?}: {resets:?}");
    let (reset, cause) = resets[1];
    assert_eq!(cause, ResetCause::Watchdog);
    let reset = seconds(reset);
    assert!((0.5 * nominal..2.0 * nominal).contains(&(reset - stalled)));
    journey.to(reset + 1.0);
    assert_eq!(journey.vehicle.node(node).resets().len(), 2);
    journey.assert_in_place();
    (journey, stalled, reset)
}

#[test]
fn a_stalled_steering_node_is_reset_by_its_watchdog_and_rejoins_in_three_periods() {
    let (journey, stalled, reset) = stalled(nodes::STEERING, 0.05);
    let back = first_after(&journey, 206, at(reset));
    assert!(
        back.start < at(reset + 3.0 * BASIC_PERIOD),
        "{} s",
        seconds(back.start) - reset
    );
    assert_steady(&journey, &[206], seconds(back.start), reset + 1.0);
    assert!(reset < stalled + 2.0 * BASIC_PERIOD);
    assert_eq!(journey.effort(nodes::STEERING, at(reset + 1e-4)), 0.0);
    // The node reports why it started: cause 4 is the independent watchdog.
    let report = first_after(&journey, 513, at(reset));
    assert_eq!(report.data[0] & 0xF, 4);
}

#[test]
fn a_stalled_drive_node_stops_within_two_periods_and_follows_again() {
    let (journey, stalled, reset) = stalled(nodes::DRIVE, 0.05);
    assert!(journey.effort(nodes::DRIVE, at(stalled)) > 0.2);
    assert!(reset < stalled + 2.0 * BASIC_PERIOD);
    assert_eq!(journey.effort(nodes::DRIVE, at(reset + 1e-4)), 0.0);
    assert!(journey.effort(nodes::DRIVE, at(reset + 0.9)) > 0.2);
    assert_eq!(first_after(&journey, 514, at(reset)).data[0] & 0xF, 4);
}

#[test]
fn a_stalled_controller_is_reset_by_its_watchdog_and_rejoins_in_three_periods() {
    let (journey, _, reset) = stalled(nodes::CONTROLLER, 0.5);
    let back = first_after(&journey, 300, at(reset));
    assert!(
        back.start < at(reset + 3.0 * BASIC_PERIOD),
        "{} s",
        seconds(back.start) - reset
    );
    assert_steady(&journey, &[300, 450], seconds(back.start), reset + 1.0);
    assert_eq!(back.data[4], mode::IDLE);
    // A core that stalls in a task of low priority still sends commands until the reset.
    let last = last_before(&journey, 300, at(reset)).start;
    let stopped = journey.stopped(last).expect("the motors stop");
    assert!(stopped < last + span(2.1 * BASIC_PERIOD));
    assert_eq!(first_after(&journey, 512, at(reset)).data[0] & 0xF, 4);
}

/// The watchdog's oscillator is anywhere in the range of the data sheets: 17 to 47 kHz on the F446,
/// 30 to 50 kHz on the F303.
#[test]
fn the_watchdogs_hold_over_the_whole_range_of_their_oscillators() {
    type End = fn(&twin::part::Part) -> u32;
    let ends: [End; 2] = [|part| part.lsi.max_hz, |part| part.lsi.min_hz];
    for end in ends {
        let mut journey = Journey::of(&format!("start.east = \"0.3 m\"\n{RUNNING}"));
        for node in nodes::ALL {
            let hertz = end(journey.vehicle.sled(node).part);
            journey.vehicle.node_mut(node).set_watchdog_clock(hertz);
        }
        journey.to(3.0);
        assert_never_reset(&journey);
        // The stalled node's watchdog bites in the time that its oscillator makes of the nominal
        // one, less the time since it was last fed.
        let part = journey.vehicle.sled(nodes::DRIVE).part;
        let timeout = 0.05 * f64::from(part.lsi.hz) / f64::from(end(part));
        next_cycle(&mut journey);
        campaign::stall(&mut journey.vehicle, nodes::DRIVE).expect("programs that the parts allow");
        let stalled = seconds(journey.vehicle.now());
        journey.to(stalled + 0.1);
        let resets = journey.vehicle.node(nodes::DRIVE).resets();
        let [_, (reset, ResetCause::Watchdog)] = resets else {
            panic!("{resets:?}");
        };
        let after = seconds(*reset) - stalled;
        println!("{} Hz: reset {after:.4} s after the stall", end(part));
        assert!(
            (timeout - 0.015..timeout + 0.001).contains(&after),
            "{after} s"
        );
        assert_eq!(
            journey.effort(nodes::DRIVE, at(seconds(*reset) + 1e-4)),
            0.0
        );
    }
}

#[test]
fn a_node_whose_supply_dips_lets_go_of_its_motor_and_starts_as_after_power_on() {
    for node in [nodes::DRIVE, nodes::GPS] {
        let name = nodes::name(node);
        let mut journey = running(&format!(
            "brownout = [{{ node = \"{name}\", at = \"3.2 s\", until = \"3.25 s\" }}]"
        ));
        journey.to(5.0);
        if node == nodes::GPS {
            assert!(journey.stopped(at(3.2)).is_some_and(|stop| stop < at(3.45)));
        } else {
            // The other nodes go on, and the steering with them.
            let rests = |when| journey.effort(nodes::DRIVE, at(when)) == 0.0;
            assert!([3.21, 3.25, 3.3, 3.35, 3.4].into_iter().all(rests));
        }
        let resets = journey.vehicle.node(node).resets();
        let causes: Vec<_> = resets.iter().skip(1).map(|(_, cause)| *cause).collect();
        // The F446 watches its supply, and starts anew before it is gone.
        let expected = if node == nodes::GPS {
            &[ResetCause::Software, ResetCause::PowerOn][..]
        } else {
            &[ResetCause::PowerOn]
        };
        assert_eq!(causes, expected);
        assert_steady(&journey, &[100, 206, 300], 4.2, 5.0);
        journey.assert_in_place();
    }
}

/// Without supervision the F446 would run on down to 1.7 V. Its flash would be read too early below
/// 2.7 V, which ends the run.
#[test]
fn a_node_does_not_run_with_less_supply_than_its_flash_needs() {
    let mut journey = running(
        "brownout = [{ node = \"gps\", at = \"3.2 s\", until = \"3.25 s\", lowest = \"2.6 V\" }]",
    );
    journey.to(5.0);
    let resets = journey.vehicle.node(nodes::GPS).resets();
    let (first, cause) = resets[1];
    assert!((3.2..3.2002).contains(&seconds(first)), "{resets:?}");
    assert_eq!(cause, ResetCause::Software);
    let (last, _) = resets[resets.len() - 1];
    assert!((3.25 - 0.03..3.2502).contains(&seconds(last)), "{resets:?}");
    let report = first_after(&journey, GpsStatus::ID, at(3.25));
    let report = GpsStatus::decode(&report.data).expect("a status");
    assert_eq!(report.fault, uagv::messages::Fault::SupplyLow);
    assert_steady(&journey, &[100, 206, 300], 4.2, 5.0);
    journey.assert_in_place();
}

/// A run ends when the flash is read with less supply than the fast clock needs. Before the clock is
/// fast, a low supply is found at the latest when the node is about to start it.
#[test]
fn a_node_whose_supply_falls_while_it_starts_begins_anew_at_once() {
    let fast = seconds(fast_clock(nodes::GPS)) * 1e3;
    for (falls, within) in [
        (fast / 5.0, fast),
        (fast - 0.5, 1.0),
        (fast, 0.2),
        (fast + 1.0, 0.2),
        (fast + 3.0, 0.2),
        (fast + 6.0, 0.2),
    ] {
        let mut journey = Journey::of(&format!(
            "brownout = [{{ node = \"gps\", at = \"{falls} ms\", until = \"60 ms\", \
             lowest = \"2.6 V\" }}]"
        ));
        journey.to(0.1);
        let resets = journey.vehicle.node(nodes::GPS).resets();
        let (first, cause) = resets[1];
        assert_eq!(cause, ResetCause::Software, "{falls} ms");
        let after = seconds(first) * 1e3 - falls;
        assert!((0.0..within).contains(&after), "{falls} ms: {after} ms");
    }
}

/// When this node's core first runs from its PLL.
fn fast_clock(node: NodeIndex) -> SimTime {
    // RCC_CFGR: its field SWS, and the PLL in it.
    const CONFIGURATION: u32 = 0x4002_3808;
    const STATUS: u32 = 0b11 << 2;
    const PLL: u32 = 0b10 << 2;
    let mut journey = Journey::of("");
    let power_on = journey.vehicle.node(node).resets()[0].0;
    for step in 1..=2_000 {
        let now = power_on + span(f64::from(step) * 25e-6);
        journey.run_until(now);
        let mcu = journey.vehicle.node_mut(node);
        let configuration = mcu.read_register(CONFIGURATION).expect("a register");
        if configuration & STATUS == PLL {
            return now;
        }
    }
    panic!("no fast clock within 50 ms of power-on");
}

/// The detector reports a good supply until it has settled.
#[test]
fn a_node_starts_no_clock_with_a_low_supply() {
    // RCC_CR, and its bit HSEON.
    const CONTROL: u32 = 0x4002_3800;
    const EXTERNAL: u32 = 1 << 16;
    let mut journey = Journey::of("");
    let power_on = journey.vehicle.node(nodes::GPS).resets()[0].0;
    journey.vehicle.node_mut(nodes::GPS).set_supply(2_900);
    for step in 1..=2_000 {
        journey.run_until(power_on + span(f64::from(step) * 25e-6));
        let mcu = journey.vehicle.node_mut(nodes::GPS);
        let control = mcu.read_register(CONTROL).expect("a register");
        assert_eq!(control & EXTERNAL, 0, "{step}: {:?}", mcu.resets());
    }
    let mcu = journey.vehicle.node_mut(nodes::GPS);
    assert!(mcu.resets().len() > 1, "{:?}", mcu.resets());
    mcu.set_supply(3_300);
    journey.to(0.5);
    let report = first_after(&journey, GpsStatus::ID, at(0.0));
    let report = GpsStatus::decode(&report.data).expect("a status");
    // A supply that rises slowly after power-on is no fault.
    assert_eq!(report.fault, uagv::messages::Fault::None);
}

/// The level of the detector: its lowest threshold for a falling supply is 2.85 V.
#[test]
fn a_small_dip_of_the_supply_changes_nothing() {
    for (lowest, resets) in [("2.86 V", 1), ("2.84 V", 2)] {
        let mut journey = running(&format!(
            "brownout = [{{ node = \"gps\", at = \"3.2 s\", until = \"3.201 s\", \
             lowest = \"{lowest}\" }}]"
        ));
        journey.to(4.5);
        let found = journey.vehicle.node(nodes::GPS).resets();
        assert_eq!(found.len(), resets, "{lowest}: {found:?}");
        assert_steady(&journey, &[100, 206, 300], 4.2, 4.5);
    }
}

/// A start that waited for its PLL without a bound, and with its watchdog off, would stand still for
/// ever.
#[test]
fn a_node_whose_pll_does_not_lock_tries_again_and_tells_why() {
    for node in [nodes::DRIVE, nodes::GPS] {
        let mut journey = Journey::of(RUNNING);
        journey.vehicle.node_mut(node).set_pll_locks(false);
        journey.to(0.5);
        let tries = journey.vehicle.node(node).resets();
        assert!(tries.len() > 5, "{} starts", tries.len());
        let again = tries.iter().skip(1).map(|(_, cause)| *cause);
        assert!(again.eq(std::iter::repeat_n(ResetCause::Software, tries.len() - 1)));
        journey.vehicle.node_mut(node).set_pll_locks(true);
        journey.to(3.0);
        let report = first_after(&journey, 511 + node.0 as u16, at(0.5));
        let report = GpsStatus::decode(&report.data).expect("one layout for all nodes");
        assert_eq!(report.fault, uagv::messages::Fault::ClockFailure);
        assert_steady(&journey, &[100, 206, 300], 2.0, 3.0);
    }
}
