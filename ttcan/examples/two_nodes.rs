//! Two nodes on an in-memory bus: a time master, and one that sends its speed.
use ttcan::simulation::{Bus, Crystal, Quiet};
use ttcan::{Id, MatrixConfig, Micros, Node, NodeConfig, NodeId, ReferenceFormat};
use ttcan::{SystemMatrix, Window};

const MASTER: NodeId = NodeId(0);
const MOTOR: NodeId = NodeId(1);
const MS: Micros = Micros::millis(1);
const SPEED: Id = Id::constant::<0x200>();

const MATRIX: SystemMatrix = SystemMatrix::constant(MatrixConfig {
    bit_rate: 250_000,
    basic_cycle: Micros::millis(10),
    cycles: 1,
    reference: Id::constant::<0x100>(),
    reference_format: ReferenceFormat::LEVEL_2,
    masters: &[MASTER],
    transmit_enable_bits: 16,
    sync_uncertainty: Micros::micros(20),
    longest_gap: Micros::micros(0),
    windows: &[Window::exclusive("speed", MS, MS, SPEED, 2, MOTOR)],
    events: &[],
});
ttcan::schedule!(static SCHEDULE = MATRIX);
type Stack = Node<'static, { MATRIX.window_count() }, { MATRIX.node_count() }, 4>;

fn main() -> Result<(), ttcan::ConfigError> {
    let mut bus = Bus::new(250_000, Quiet, 1);
    for id in [MASTER, MOTOR] {
        let node = Stack::new(SCHEDULE.view(), NodeConfig::new(id, 18))?;
        let index = bus.add(node, Crystal::perfect(18));
        bus.start(index);
    }
    bus.run_millis(100);
    for sent in &bus.traffic {
        let (id, data) = (sent.frame.id(), sent.frame.data());
        println!("{:8} us  {id}#{data:02X?}", sent.start.ticks() / 1000);
    }
    Ok(())
}
