//! A thousand nodes on one bus of 1 Mbit/s. Each sends one message in a matrix of 64
//! basic cycles and supervises all others. Prints the host's time for a frame.

use std::time::Instant;

use ttcan::simulation::{Bus, Crystal, Quiet};
use ttcan::synthesis::{Message, Wishes, power_of_two};
use ttcan::{
    HeapSchedule, Id, MatrixConfig, Micros, Node, NodeConfig, NodeId, ReferenceFormat, SyncState,
    SystemMatrix,
};

const NODES: u16 = 1000;
const CYCLE: Micros = Micros::millis(10);

/// Runs the network.
pub fn main() {
    let message = |number: u16| Message {
        name: format!("message {number}"),
        id: Id::standard(16 + number).expect("11 bits hold them"),
        len: 8,
        sender: NodeId(number),
        // The shortest period gives the basic cycle.
        period: if number == 0 { CYCLE } else { CYCLE * 64 },
        deadline: CYCLE,
        after: Vec::new(),
        gap: Micros::micros(0),
    };
    let messages: Vec<Message> = (0..NODES).map(message).collect();
    let network = MatrixConfig {
        bit_rate: 1_000_000,
        basic_cycle: CYCLE,
        cycles: 64,
        reference: Id::constant::<0>(),
        reference_format: ReferenceFormat::LEVEL_2,
        masters: &[NodeId(0), NodeId(1)],
        transmit_enable_bits: 16,
        sync_uncertainty: Micros::micros(20),
        longest_gap: Micros::micros(0),
        windows: &[],
        events: &[],
    };
    let plan = power_of_two(&network, &messages, &Wishes::NONE).expect("there is room");
    let windows = plan.windows(&messages);
    let matrix = SystemMatrix::new(MatrixConfig {
        cycles: plan.cycles,
        windows: &windows,
        ..network
    })
    .expect("a plan is a valid matrix");
    let schedule = HeapSchedule::new(&matrix).expect("it is small enough");

    let mut bus = Bus::new(network.bit_rate, Quiet, 1);
    for number in 0..NODES {
        let config = NodeConfig::new(NodeId(number), 18);
        let node = Node::<1000, 1000, 1>::new(schedule.view(), config).expect("it is sound");
        let crystal = Crystal {
            ticks_per_us: 18,
            ppb: (i32::from(number % 101) - 50) * 1000,
            phase: u32::from(number) * 4_000_000,
            interrupt: (100, 500),
        };
        bus.add(node, crystal);
        bus.start(usize::from(number));
    }
    let begun = Instant::now();
    bus.run_millis(350);
    let taken = begun.elapsed();

    let in_schedule = (0..usize::from(NODES))
        .filter(|index| bus.node(*index).status().sync == SyncState::InSchedule)
        .count();
    let receptions = bus.traffic.len() * usize::from(NODES - 1);
    println!("{in_schedule} of {NODES} nodes in schedule");
    println!(
        "{} frames in 0.35 s of bus time, {:.2} s of the host's",
        bus.traffic.len(),
        taken.as_secs_f64()
    );
    println!(
        "{:.0} us for a frame on the bus",
        taken.as_secs_f64() * 1e6 / bus.traffic.len() as f64
    );
    println!(
        "{:.0} ns for a frame at a node, its timer interrupts included",
        taken.as_secs_f64() * 1e9 / receptions as f64
    );
    assert_eq!(in_schedule, usize::from(NODES));
}
