//! Random matrices, crystals and faults: nodes send only in their windows while
//! there are faults, and are in schedule again after them.

use proptest::prelude::*;
use ttcan::simulation::{Application, Bus, Crystal, Fate, SimTime};
use ttcan::synthesis::{Message, Wishes, power_of_two};
use ttcan::{
    Frame, HeapSchedule, Id, MasterState, MatrixConfig, Micros, Node, NodeConfig, NodeId,
    ReferenceFormat, StampLatency, SyncState, SystemMatrix, WindowKind,
};

const NODES: u16 = 4;
const TICKS_PER_US: u32 = 16;

type Stack<'s> = Node<'s, 64, 8, 4>;

const NETWORK: MatrixConfig = MatrixConfig {
    bit_rate: 250_000,
    basic_cycle: Micros::millis(1),
    cycles: 1,
    reference: Id::constant::<0>(),
    reference_format: ReferenceFormat::LEVEL_2,
    masters: &[NodeId(2), NodeId(0), NodeId(1)],
    transmit_enable_bits: 16,
    sync_uncertainty: Micros::micros(20),
    longest_gap: Micros::micros(0),
    windows: &[],
    events: &[],
};

#[derive(Clone, Debug)]
struct Drawn {
    messages: Vec<(u8, u32, u16)>,
    ppm: Vec<i32>,
    seed: u64,
    /// One of this many frames is destroyed while there are faults.
    destroyed: u64,
    /// Crashes: node, time in ms, and ms until it starts again.
    crashes: Vec<(usize, u64, u64)>,
}

fn drawn() -> impl Strategy<Value = Drawn> {
    let message = (
        0u8..=8,
        prop::sample::select(vec![20u32, 40, 80, 160]),
        0..NODES,
    );
    (
        prop::collection::vec(message, 1..10),
        prop::collection::vec(-100i32..=100, usize::from(NODES)),
        any::<u64>(),
        2u64..40,
        prop::collection::vec((0..usize::from(NODES), 300u64..1500, 1u64..600), 0..3),
    )
        .prop_map(|(messages, ppm, seed, destroyed, crashes)| Drawn {
            messages,
            ppm,
            seed,
            destroyed,
            crashes,
        })
}

struct Faults {
    until: SimTime,
    destroyed: u64,
    count: u64,
}

impl Application for Faults {
    fn fate(&mut self, _: usize, _: &Frame, now: SimTime) -> Fate {
        self.count = self.count.wrapping_mul(6_364_136_223_846_793_005) + 1_442_695;
        if now < self.until && (self.count >> 33).is_multiple_of(self.destroyed) {
            Fate::Destroyed
        } else {
            Fate::Delivered
        }
    }
}

fn at(millis: u64) -> SimTime {
    SimTime::from_ticks(millis * 1_000_000)
}

/// Whether a frame is in one of its windows, counted from the last delivered
/// reference.
fn in_place(matrix: &SystemMatrix, cycle: u8, from: u64, until: u64, id: Id, node: u16) -> bool {
    let uncertainty = u64::from(NETWORK.sync_uncertainty.ticks()) * 1000;
    matrix.config().windows.iter().any(|window| {
        let start = u64::from(window.start.ticks()) * 1000;
        let end = start + u64::from(window.length.ticks()) * 1000;
        let own = matches!(window.kind, WindowKind::Exclusive { id: own, sender, .. }
            if own == id && sender.0 == node);
        own && window.is_in(cycle) && from + uncertainty >= start && until <= end + uncertainty
    })
}

fn messages(drawn: &Drawn) -> Vec<Message> {
    drawn
        .messages
        .iter()
        .enumerate()
        .map(|(number, (len, period, sender))| Message {
            name: number.to_string(),
            id: Id::standard(16 + number as u16).expect("small"),
            len: *len,
            sender: NodeId(*sender),
            period: Micros::millis(*period),
            deadline: Micros::millis(*period),
            after: Vec::new(),
            gap: Micros::micros(0),
        })
        .collect()
}

fn node(schedule: &HeapSchedule, number: u16) -> Stack<'_> {
    let config = NodeConfig {
        latency: StampLatency::bxcan(4 * TICKS_PER_US, 8),
        transmit_lead: 2 * TICKS_PER_US,
        ..NodeConfig::new(NodeId(number), TICKS_PER_US)
    };
    Stack::new(schedule.view(), config).expect("the configuration is sound")
}

/// Runs the network: 2.2 s with faults, 1.2 s without.
fn simulate<'s>(schedule: &'s HeapSchedule, drawn: &Drawn) -> Bus<'s, Faults, 64, 8, 4> {
    let faults = Faults {
        until: at(2200),
        destroyed: drawn.destroyed,
        count: drawn.seed,
    };
    let mut bus = Bus::new(250_000, faults, drawn.seed);
    for number in 0..NODES {
        let crystal = Crystal {
            ticks_per_us: TICKS_PER_US,
            ppb: drawn.ppm[usize::from(number)] * 1000,
            phase: (drawn.seed as u32).wrapping_mul(u32::from(number) + 1),
            interrupt: (100, 900),
        };
        bus.add(node(schedule, number), crystal);
        bus.start(usize::from(number));
    }
    let mut changes: Vec<(u64, usize, bool)> = Vec::new();
    for (index, millis, pause) in &drawn.crashes {
        changes.push((*millis, *index, false));
        changes.push((millis + pause, *index, true));
    }
    changes.sort_unstable();
    for (millis, index, start) in changes {
        bus.run_until(at(millis));
        if start {
            bus.start(index);
        } else {
            bus.crash(index, node(schedule, index as u16));
        }
    }
    bus.run_until(at(2200));
    // The application restarts its node after a severe error, and clears others.
    for index in 0..usize::from(NODES) {
        let status = bus.node(index).status();
        if status.sync == SyncState::Off {
            bus.start(index);
        }
        bus.with(index, |node, _| node.clear_errors());
    }
    bus.run_until(at(3400));
    bus
}

/// All nodes are in schedule, follow the best master and have the same time.
fn check_nodes(bus: &Bus<'_, Faults, 64, 8, 4>, drawn: &Drawn) {
    for index in 0..usize::from(NODES) {
        let status = bus.node(index).status();
        assert_eq!(
            status.sync,
            SyncState::InSchedule,
            "node {index} of {drawn:?}"
        );
        assert_eq!(status.master_rank, Some(0), "node {index} of {drawn:?}");
        assert_eq!(
            bus.node(index).counters().misplaced,
            0,
            "node {index} of {drawn:?}"
        );
    }
    assert_eq!(bus.node(2).status().master, MasterState::Current);
    let times: Vec<i64> = (0..usize::from(NODES))
        .map(|index| {
            let time = bus.node(index).global_time(bus.stamp(index));
            time.expect("all have a time").raw() as i64
        })
        .collect();
    let spread = times.iter().max().unwrap() - times.iter().min().unwrap();
    assert!(spread <= 3 << 16, "{} us", spread as f64 / 65536.0);
}

fn run(drawn: &Drawn) {
    let messages = messages(drawn);
    let plan = power_of_two(&NETWORK, &messages, &Wishes::NONE).expect("there is room");
    let windows = plan.windows(&messages);
    let matrix = SystemMatrix::new(MatrixConfig {
        basic_cycle: plan.basic_cycle,
        cycles: plan.cycles,
        windows: &windows,
        ..NETWORK
    })
    .expect("a plan is a valid matrix");
    let schedule = HeapSchedule::new(&matrix).expect("it is small");
    let bus = simulate(&schedule, drawn);
    check_nodes(&bus, drawn);

    let mut mark = None;
    let mut served = 0;
    for sent in &bus.traffic {
        if sent.frame.id().raw() < 8 {
            if sent.fate == Fate::Delivered {
                mark = Some((sent.start.ticks(), sent.frame.data()[4] & 0x3F));
            }
            continue;
        }
        let (mark, cycle) = mark.expect("nothing comes before a reference");
        let (from, until) = (sent.start.ticks() - mark, sent.end.ticks() - mark);
        let node = sent.sender as u16;
        assert!(
            in_place(&matrix, cycle, from, until, sent.frame.id(), node),
            "{} of node {node} from {from} to {until} ns in cycle {cycle} of {drawn:?}",
            sent.frame.id(),
        );
        served += usize::from(sent.start > at(3000));
    }
    // Every message came in the last 400 ms as often as its period says, less
    // one for the two ends.
    let expected: usize = plan
        .periods
        .iter()
        .map(|period| (400_000 / period.ticks()) as usize - 1)
        .sum();
    assert!(served >= expected, "{served} of {expected} in {drawn:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn keep_and_find_their_schedule(drawn in drawn()) {
        run(&drawn);
    }
}
