//! Eight potential masters: all ranks that a reference message has.

mod support;

use proptest::prelude::*;
use support::{TICKS_PER_US, at, crystal};
use ttcan::simulation::{Bus, Quiet};
use ttcan::{
    Id, MasterState, MatrixConfig, Micros, Node, NodeConfig, NodeId, ReferenceFormat, StampLatency,
    SyncState, SystemMatrix, Window,
};

const MASTERS: [NodeId; 8] = [
    NodeId(0),
    NodeId(1),
    NodeId(2),
    NodeId(3),
    NodeId(4),
    NodeId(5),
    NodeId(6),
    NodeId(7),
];
const CYCLE: u64 = 20;

const fn window(number: u16, id: Id) -> Window<'static> {
    let start = Micros::millis(1 + number as u32);
    Window::exclusive("own", start, Micros::millis(1), id, 8, NodeId(number))
}

const MATRIX: SystemMatrix = SystemMatrix::constant(MatrixConfig {
    bit_rate: 250_000,
    basic_cycle: Micros::millis(CYCLE as u32),
    cycles: 1,
    reference: Id::constant::<64>(),
    reference_format: ReferenceFormat::LEVEL_2,
    masters: &MASTERS,
    transmit_enable_bits: 16,
    sync_uncertainty: Micros::micros(20),
    longest_gap: Micros::micros(0),
    windows: &[
        window(0, Id::constant::<100>()),
        window(1, Id::constant::<101>()),
        window(2, Id::constant::<102>()),
        window(3, Id::constant::<103>()),
        window(4, Id::constant::<104>()),
        window(5, Id::constant::<105>()),
        window(6, Id::constant::<106>()),
        window(7, Id::constant::<107>()),
    ],
    events: &[],
});

ttcan::schedule!(static SCHEDULE = MATRIX);

type Master = Node<'static, 8, 8, 1>;
type Masters = Bus<'static, Quiet, 8, 8, 1>;

/// A potential master, or for number 8 a node that only listens.
fn master(number: usize) -> Master {
    let config = NodeConfig {
        latency: StampLatency::bxcan(4 * TICKS_PER_US, 6),
        transmit_lead: 3 * TICKS_PER_US,
        ..NodeConfig::new(NodeId(number as u16), TICKS_PER_US)
    };
    Master::new(SCHEDULE.view(), config).expect("the configuration is sound")
}

/// Rank and start of every delivered reference, in nanoseconds.
fn references(bus: &Masters) -> Vec<(usize, u64)> {
    let sent = bus.traffic.iter().filter(|sent| !sent.fate.is_error());
    sent.filter(|sent| sent.frame.id().raw() < 72)
        .map(|sent| (sent.sender, sent.start.ticks()))
        .collect()
}

fn in_charge(bus: &Masters) -> Vec<usize> {
    (0..8)
        .filter(|node| bus.is_powered(*node))
        .filter(|node| bus.node(*node).status().master == MasterState::Current)
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn eight_masters_take_over_by_rank_and_return(
        order in Just((0..8usize).collect::<Vec<_>>()).prop_shuffle(),
        pauses in prop::collection::vec(0u64..45, 8),
        crystals in prop::collection::vec(-50_000i32..=50_000, 8),
        seed: u64,
    ) {
        let mut bus = Masters::new(250_000, Quiet, seed);
        for (node, ppb) in crystals.iter().enumerate() {
            bus.add(master(node), crystal(*ppb, (node as u32).wrapping_mul(1_234_567_890)));
        }
        // The listening node acknowledges the references of the last master.
        bus.add(master(8), crystal(0, 0));
        bus.start(8);
        // The nodes start in a random order.
        for (node, pause) in order.into_iter().zip(pauses) {
            bus.start(node);
            bus.run_millis(pause);
        }
        let mut now = 1200;
        bus.run_until(at(now));
        prop_assert_eq!(in_charge(&bus), [0]);
        for node in 0..8 {
            prop_assert_eq!(bus.node(node).status().sync, SyncState::InSchedule);
        }
        // The masters die one after the other; the next rank takes over.
        for dead in 0..7 {
            bus.crash(dead, master(dead));
            now += 5 * CYCLE + 7;
            bus.run_until(at(now));
            prop_assert_eq!(in_charge(&bus), [dead + 1]);
            let all = references(&bus);
            let last = all.iter().rfind(|(rank, _)| *rank == dead).unwrap().1;
            let next = all.iter().find(|(_, start)| *start > last).unwrap();
            prop_assert_eq!(next.0, dead + 1);
            // The new master's offset, and 20 us between the clocks.
            let bound = CYCLE * 1_000_000 + (16 * (dead as u64 + 1) + 20) * 1000;
            prop_assert!(next.1 - last <= bound, "{} ns", next.1 - last);
            for node in dead + 1..8 {
                prop_assert_eq!(bus.node(node).counters().missed_references, 0);
            }
        }
        // All start again. The best-ranked one becomes master, and no reference is
        // missing.
        let from = references(&bus).len();
        for node in (0..7).rev() {
            bus.start(node);
            now += 5 * CYCLE;
            bus.run_until(at(now));
        }
        now += 20 * CYCLE;
        bus.run_until(at(now));
        prop_assert_eq!(in_charge(&bus), [0]);
        for pair in references(&bus)[from - 1..].windows(2) {
            let gap = pair[1].1 - pair[0].1;
            let nominal = CYCLE * 1_000_000;
            prop_assert!(gap.abs_diff(nominal) < 150_000, "{gap} ns between references");
        }
    }
}
