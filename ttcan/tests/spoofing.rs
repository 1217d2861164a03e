//! A node that sends one reference in another master's name: the network is in schedule, and has its
//! time, within a second.

mod support;

use support::{FORMAT, MATRIX, Uagv, UagvBus, at, config, crystal};
use ttcan::simulation::{Quiet, SimTime};
use ttcan::{
    ClockState, Fault, Frame, Id, MatrixConfig, Micros, NodeConfig, NodeId, Reception, SyncState,
    SystemMatrix,
};

/// The network without gaps.
const NO_GAPS: SystemMatrix = SystemMatrix::constant(MatrixConfig {
    longest_gap: Micros::micros(0),
    ..*MATRIX.config()
});
ttcan::schedule!(static STEADY = NO_GAPS);

/// The network with gaps of up to half a second.
const SHORT_GAPS: SystemMatrix = SystemMatrix::constant(MatrixConfig {
    longest_gap: Micros::millis(500),
    ..*MATRIX.config()
});
ttcan::schedule!(static GAPPED = SHORT_GAPS);

fn network(gaps: bool) -> UagvBus<Quiet> {
    let mut bus = UagvBus::new(250_000, Quiet, 3);
    let ppm = [31_000, -50_000, 50_000, -12_345];
    let schedule = if gaps { GAPPED.view() } else { STEADY.view() };
    for node in 0..4 {
        let config: NodeConfig = config(NodeId(node));
        let stack = Uagv::new(schedule, config).expect("the configuration is sound");
        bus.add(stack, crystal(ppm[usize::from(node)], 5));
        bus.start(usize::from(node));
    }
    bus.run_until(at(3000));
    bus
}

/// What a spoofed reference says.
#[derive(Clone, Copy, Debug)]
struct Spoof {
    rank: u8,
    gap: bool,
    discontinuity: bool,
    /// Error of its time, ms.
    ahead: i32,
    /// Microseconds after the reference mark of the current basic cycle.
    place: u64,
}

/// Global time of a node less true time, us.
fn error(bus: &UagvBus<Quiet>, node: usize) -> f64 {
    let time = bus.node(node).global_time(bus.stamp(node));
    let time = time.expect("it has a time").raw() as f64 / 65536.0;
    time - bus.now().ticks() as f64 / 1000.0
}

fn run_micros(bus: &mut UagvBus<Quiet>, micros: u64) {
    let end = bus.now().ticks() + micros * 1000;
    bus.run_until(SimTime::from_ticks(end));
}

/// How long some node was out of schedule or in a gap, ms, and the largest error of a node's time from
/// then on and meanwhile, us.
fn attack(gaps: bool, spoof: Spoof) -> (u64, f64, f64) {
    let mut bus = network(gaps);
    let mark = bus.node(2).reference_mark().expect("in schedule");
    let into = u64::from(bus.stamp(2).ticks_since(mark).unsigned_abs()) / 18;
    run_micros(&mut bus, 100_000 - into + spoof.place);
    let right = error(&bus, 0);
    let planned = bus
        .node(2)
        .global_time(bus.stamp(2))
        .expect("it has a time");
    let coarse = planned.as_millis().wrapping_add_signed(spoof.ahead);
    let mut data = [0; 8];
    data[1..5].copy_from_slice(&coarse.to_be_bytes());
    data[5] = if spoof.gap { 0x80 } else { 0 } | if spoof.discontinuity { 0x40 } else { 0 };
    // The mark of the reference before it.
    let mark = bus.node(2).reference_mark().expect("in schedule");
    let time = bus.node(2).global_time(mark).expect("it has a time");
    data[6..].copy_from_slice(&((time.raw() >> 11) as u16).to_be_bytes());
    let id = Id::standard(100 + u16::from(spoof.rank)).expect("small");
    assert_eq!(usize::from(FORMAT.longest()), data.len());
    bus.inject(3, Frame::new(id, &data).expect("8 bytes"));
    let (mut out, mut worst) = (0, 0.0_f64);
    for millis in 1..1000 {
        bus.run_millis(1);
        for node in 0..4 {
            let off = (error(&bus, node) - right).abs();
            worst = worst.max(off);
            let status = bus.node(node).status();
            let well = status.sync == SyncState::InSchedule
                && matches!(status.clock, ClockState::Locked | ClockState::Own)
                && status.master_rank == Some(0)
                && off < 300.0;
            if !well {
                out = millis;
            }
        }
    }
    let left = (0..4).map(|node| (error(&bus, node) - right).abs());
    (out, left.fold(0.0, f64::max), worst)
}

fn spoofs() -> impl Iterator<Item = Spoof> {
    let places = [20_000, 50_000, 98_500, 99_400, 99_800];
    (0..2).flat_map(move |rank| {
        places.into_iter().flat_map(move |place| {
            [0, 20, -20, 5000, -100_000]
                .into_iter()
                .flat_map(move |ahead| {
                    (0..4).map(move |bits| Spoof {
                        rank,
                        gap: bits & 1 != 0,
                        discontinuity: bits & 2 != 0,
                        ahead,
                        place,
                    })
                })
        })
    })
}

#[test]
fn one_spoofed_reference_is_over_within_a_second() {
    for gaps in [false, true] {
        let (mut longest, mut moved, mut bad) = (0, 0.0_f64, Vec::new());
        for spoof in spoofs() {
            let (out, left, worst) = attack(gaps, spoof);
            longest = longest.max(out);
            moved = moved.max(worst);
            // In a gap no node knows when the next reference comes, so that its mark may be taken for
            // that of another one.
            let most = if gaps { 2000.0 } else { 300.0 };
            if out > 900 || left > 100.0 || worst > most {
                bad.push((spoof, out, left, worst));
            }
        }
        println!("gaps {gaps}: {longest} ms, time off by {moved} us");
        assert!(
            bad.is_empty(),
            "{} bad, such as {:?}",
            bad.len(),
            bad.last()
        );
    }
}

/// In a network without gaps nobody waits for the end of one.
#[test]
fn a_gap_of_a_network_without_gaps_is_refused() {
    let mut bus = network(false);
    let frame = Frame::new(Id::constant::<101>(), &[0, 0, 0, 0, 0, 0x80, 0, 0]).expect("8 bytes");
    for node in 0..4 {
        let taken = bus.with(node, |node, now| node.handle_receive(&frame, now));
        let fault = if node == 1 {
            Fault::Impostor
        } else {
            Fault::MalformedReference
        };
        assert_eq!(taken, Reception::Fault(fault));
    }
    assert!(bus.with(0, |node, _| node.request_gap()).is_err());
}
