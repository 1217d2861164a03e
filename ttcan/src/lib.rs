//! Time-triggered CAN (ISO 11898-4) in software, for CAN controllers without
//! time-trigger hardware.
//!
//! The protocol is a pure state machine. A [`Node`] is told of frames and of the
//! passing of time, and says what to send. It touches no hardware, reads no clock,
//! allocates nothing and cannot panic. The same code runs in firmware, in a
//! simulation of a thousand nodes and under a model checker.
//!
//! * [`SystemMatrix`]: the windows of the network, checked at compile time.
//! * [`Schedule`]: the matrix compiled to a table, by [`schedule!`].
//! * [`Node`]: one node that follows the schedule.
//! * [`guardian`]: what keeps a node that babbles off the bus.
//! * [`frame_bits`], [`worst_case_bits`], [`BitTiming`]: lengths of frames and bit
//!   timing of the controller.
//!
//! Features make a node smaller where they are off; all are on by default:
//! `master` (the role of a potential time master), `global-time` (level 2),
//! `events` (sending event and late messages), `gaps` (event-synchronised cycles),
//! `peers` (failure classes of other nodes), `counters` (of everything that
//! happens).
//!
//! `masks` is off by default: event messages with several identifiers, so that other protocols can
//! share arbitrating windows (`Event::masked`).
//!
//! `embedded-can` is off by default: frames and identifiers of the crate of that name, and
//! `Driver`, a node behind a controller whose driver has such frames.
//!
//! The feature `std` is for hosts only: `simulation`, an in-memory bus, and
//! `synthesis`, which makes a matrix from messages.
//!
//! ```
#![doc = include_str!("../examples/two_nodes.rs")]
//! ```

#![no_std]
#![forbid(unsafe_code)]
// Code of a feature that is off is still compiled, see `features`.
#![cfg_attr(
    not(all(
        feature = "counters",
        feature = "events",
        feature = "gaps",
        feature = "global-time",
        feature = "master",
        feature = "peers"
    )),
    allow(dead_code, unused_imports)
)]

#[cfg(feature = "std")]
extern crate std;

mod bit_timing;
mod clock;
#[cfg(feature = "embedded-can")]
mod driver;
mod features;
mod frame;
pub mod guardian;
mod id;
mod length;
mod matrix;
mod node;
mod queue;
mod reference;
mod schedule;
#[cfg(feature = "std")]
pub mod simulation;
mod supervision;
#[cfg(feature = "std")]
pub mod synthesis;
mod time;

pub use bit_timing::{BitTiming, NoBitTiming};
pub use clock::ClockState;
#[cfg(feature = "embedded-can")]
pub use driver::{Controller, Driver};
pub use frame::{Frame, TooLong};
pub use id::Id;
pub use length::{INTERFRAME_BITS, frame_bits, shortest_bits, worst_case_bits};
pub use matrix::{
    Event, LONGEST_TRANSMIT_ENABLE, MatrixConfig, MatrixError, Message, NodeId, Problem,
    SystemMatrix, Window, WindowKind,
};
pub use node::{
    Action, ConfigError, Counters, Fault, Grant, MasterState, Node, NodeConfig, NotInCharge,
    QueueError, Reception, StampLatency, Status, SyncState, TransmitOutcome,
};
pub use reference::ReferenceFormat;
#[cfg(feature = "std")]
pub use schedule::HeapSchedule;
pub use schedule::{Schedule, ScheduleView, WrongSize};
pub use supervision::{ErrorLevel, Health, Severe, WindowStatus};
pub use time::{GlobalTime, Micros, Stamp};
