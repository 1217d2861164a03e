//! The network: two nodes, two messages, one basic cycle of 10 ms.

use ttcan::{Id, MatrixConfig, Micros, NodeId, ReferenceFormat, SystemMatrix, Window};

/// Bit rate of the bus, bit/s.
pub(crate) const BIT_RATE: u32 = 250_000;
/// Sends the references, and a number that grows by one with each message.
pub(crate) const MASTER: NodeId = NodeId(0);
/// Sends the last number that it has received.
pub(crate) const ECHO: NodeId = NodeId(1);

const MS: Micros = Micros::millis(1);

const MATRIX: SystemMatrix = SystemMatrix::constant(MatrixConfig {
    bit_rate: BIT_RATE,
    basic_cycle: Micros::millis(10),
    cycles: 1,
    reference: Id::constant::<0x100>(),
    reference_format: ReferenceFormat::LEVEL_2,
    masters: &[MASTER],
    transmit_enable_bits: 16,
    sync_uncertainty: Micros::micros(20),
    longest_gap: Micros::micros(0),
    windows: &[
        Window::exclusive("number", MS, MS, Id::constant::<0x180>(), 4, MASTER),
        Window::exclusive(
            "echo",
            Micros::millis(3),
            MS,
            Id::constant::<0x200>(),
            4,
            ECHO,
        ),
    ],
    events: &[],
});
ttcan::schedule!(pub(crate) static SCHEDULE = MATRIX);

/// Both nodes: room for the windows and nodes of the matrix, and for no event messages.
pub(crate) type Driver<C> =
    ttcan::Driver<'static, C, { MATRIX.window_count() }, { MATRIX.node_count() }, 0>;
