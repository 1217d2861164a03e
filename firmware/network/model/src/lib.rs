//! The network file of a time-triggered CAN network: reading, checking, writing Rust from it.
//!
//! A network file is a DBC file whose messages carry, as custom attributes, the
//! window of the system matrix in which each is sent. One file then serves the
//! firmware, the analyses on the host, and every outside tool that reads DBC.
//!
//! [`Network::parse`] reads a file and checks it; [`Assignment::write`] puts other
//! windows into it; [`generate::messages`] and
//! [`generate::matrix`] write the Rust of a network crate from its build script.
//!
//! # Attributes
//!
//! | attribute | of | meaning | unit, range |
//! | --- | --- | --- | --- |
//! | `Baudrate` | network | bit rate of the bus | bit/s |
//! | `BasicCycle` | network | length of the basic cycle | us |
//! | `BasicCycles` | network | basic cycles of the system matrix | 1, 2, 4 .. 64 |
//! | `SyncUncertainty` | network | allowance in each window for clock error | us |
//! | `TransmitEnable` | network | how late after its window's start a frame may still begin | bit times, 1..16 |
//! | `MasterRank` | node | rank as time master, 0 first; -1: never a master | -1..7 |
//! | `GenMsgSendType` | message | `Cyclic` or `Event` | |
//! | `GenMsgCycleTime` | message | period of a cyclic message | ms |
//! | `GenMsgDelayTime` | message | least time between two event messages | ms |
//! | `ShortestLength` | message | fewest data bytes that still decode; -1: all of them | bytes |
//! | `SendCondition` | message | `Always`, or `WhileFixed`: its window stays empty while the reference message says that no fix is there | |
//! | `Deadline` | message | longest time from when a cyclic message is due until its window is over, for finding windows; none or 0: its period | us |
//! | `After` | message | messages that its sender needs first, blanks between their names: their windows lie before its own | |
//! | `RetryLate` | message of an exclusive window | `Yes`: if it could not be sent in its window, because the frame was disturbed, it is sent in the next arbitrating window | `No`, `Yes` |
//! | `InsteadOf` | event message | event message of the same sender in whose place it is sent: the two together come no more often than that one may | |
//! | `Preparation` | message with `After` | time that its sender takes from when those messages have arrived until its own can be sent | us |
//! | `WindowKind` | message | `Reference`, `Exclusive` or `Arbitrating` | |
//! | `WindowStart`, `WindowLength` | message | the window in the basic cycle | us |
//! | `WindowRepeat`, `WindowOffset` | message | in which basic cycles: repeat factor and first cycle | 1..64, 0..63 |
//! | `FurtherWindows` | message | more windows of an exclusive message: `start repeat offset` of each, commas between them | us, 1..64, 0..63 |
//!
//! What is only sometimes on the bus may stand in a file of its own, a supplement, which
//! [`supplemented`] adds to the network file.
//!
//! Messages that share an arbitrating window state the same window. The
//! reference message of a master of rank r has the identifier of rank 0 plus r;
//! which of its bytes the protocol writes, [`Reference`] tells.

mod check;
mod edit;
mod frame;
pub mod generate;
mod network;
mod parse;
mod problem;
mod reference;
mod signal;
mod supplement;

pub use ::network::MISSED_PERIODS;
pub use edit::{Assigned, Assignment};
pub use frame::worst_case_bits;
pub use network::{
    Condition, Message, Network, Node, SendType, Value, ValueTable, Window, WindowKind,
};
pub use problem::{Problem, Problems};
pub use reference::Reference;
pub use signal::{ByteOrder, Piece, Signal};
pub use supplement::supplemented;
