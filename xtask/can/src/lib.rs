//! A CAN bus simulated bit by bit, with register-level models of ST's bxCAN.
//!
//! - [`Bus`] owns the nodes and the time between them: arbitration, stuffing, acknowledge, error
//!   frames, error counters, bus-off and recovery follow from what each node drives and reads in
//!   each bit (ISO 11898-1), not from rules about whole frames.
//! - bxCAN controllers ([`Bus::add_bxcan`]) are reached through their registers and interrupt
//!   lines, so that unmodified firmware can run against them.
//! - [`Tester`]s are foreign nodes: loggers, spoofers, babbling idiots.
//! - [`Disturbance`]s flip bits, raise the bit error rate, or hold the bus at one level.
//! - [`candump`] reads and writes the log format of can-utils.
//! - [`log`] reads the logs of other tools, whatever their format, and counts what it cannot use.
//! - [`slcan`] reads and writes the lines of CAN adapters on a serial port.
//!
//! # Time
//! Each node divides its own clock ([`ClockRate`]) into quanta. On an idle bus it keeps its own
//! grid of bits, and starts to send at its next bit boundary. In a frame the transmitter's clock
//! sets the pace; every other node samples by its own quanta, synchronised hard at start of frame
//! and resynchronised on edges. Propagation along the cable and through transceivers is not
//! modelled.
//!
//! # Use with emulated microcontrollers
//! Register writes carry time stamps and may be ahead of the bus. [`Bus::horizon_of`] says how far
//! a node may run ahead without missing an event.

//! # Example
//! A foreign node sends a frame. A controller in its reset state is configured through its
//! registers and receives the frame in FIFO 0.
//! ```
//! use can_bus::{Bus, ClockRate, Frame, Part, Retry, SimTime, Tester};
//!
//! let us = |us: u64| SimTime::from_ticks(us * 1_000_000);
//! let mut bus = Bus::new();
//! let node = bus.add_bxcan(Part::F446, ClockRate::new(45_000_000));
//! let tester = bus.add_tester(Tester::new());
//! for (register, value) in [
//!     (0x000, 1),                           // MCR: enter initialisation
//!     (0x01C, 3 << 20 | 9 << 16 | 11),      // BTR: 250 kbit/s
//!     (0x20C, 1), (0x21C, 1), (0x200, 0x1C00), // one filter that takes everything
//!     (0x000, 0),                           // MCR: leave it
//! ] {
//!     bus.write(node, register, value, us(0));
//! }
//! let frame = Frame::standard(0x064, &[0, 0, 0x4A, 0xBB, 0x82]).unwrap();
//! bus.send_at(tester, us(100), frame, Retry::UntilSent);
//! bus.advance_to(us(600));
//! assert_eq!(bus.read(node, 0x00C), 1);               // RF0R: one message
//! assert_eq!(bus.read(node, 0x1B0) >> 21, 0x064);     // RI0R: its identifier
//! ```

#![forbid(unsafe_code)]

mod bus;
mod bxcan;
pub mod candump;
mod confinement;
mod disturbance;
mod frame;
pub mod log;
mod mac;
mod node_id;
mod record;
pub mod slcan;
mod tester;
mod time;
pub mod wire;

pub use bus::Bus;
pub use bxcan::IrqLines;
pub use confinement::{ErrorCounters, ErrorKind, ErrorState};
pub use disturbance::{Disturbance, FrameSelect, SeenBy};
pub use frame::Frame;
pub use node_id::NodeId;
pub use parts::Part;
pub use record::{Record, RecordKind};
pub use tester::{Reception, Retry, Tester};
pub use time::{BitSegments, ClockRate, SimDuration, SimTime};
pub use wire::Level;
