//! The unmanned ground vehicle of T. Troyer's thesis: its messages, its numbers, and what
//! its four nodes in `nodes/` add to the crate `firmware`.
//!
//! Messages, system matrix and the machine's numbers are generated from `network.dbc` and
//! `vehicle.toml`. A folder that makes no sense (overlapping windows, a cruise speed above
//! the limit) fails the build with the reason.
//!
//! ```
//! use network::Message;
//! use uagv::messages::{MillimetresPerSecond, Velocity};
//!
//! let data = [0xEA, 0xFF, 0xFF, 0xFF, 0x36, 0, 0, 0];
//! let velocity = Velocity::decode(&data)?;
//! assert_eq!(velocity.north, MillimetresPerSecond(-22));
//! assert_eq!(velocity.east, MillimetresPerSecond(54));
//! assert_eq!(velocity.encode(), data);
//! # Ok::<(), network::DecodeError>(())
//! ```

#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

firmware::vehicle!();

#[allow(clippy::approx_constant, reason = "written by a program")]
pub mod design;
mod geodetic;
/// What `vehicle.toml` says about the bus guardian.
pub mod guarded {
    include!(concat!(env!("OUT_DIR"), "/guarded.rs"));
}
#[cfg(not(any(row_guidance, planner)))]
#[path = "no_guide.rs"]
pub mod guide;
#[cfg(mission)]
pub mod mission;
#[cfg(not(mission))]
#[path = "no_mission.rs"]
pub mod mission;
pub mod peers;
#[cfg(planner)]
pub mod planner;
#[cfg(row_guidance)]
pub mod rows;
#[cfg(sessions)]
pub mod session;
#[cfg(not(sessions))]
#[path = "no_session.rs"]
pub mod session;
#[cfg(tilt)]
pub mod tilt;
#[cfg(not(tilt))]
#[path = "no_tilt.rs"]
pub mod tilt;
pub mod wire;

#[cfg(planner)]
pub use planner as guide;
#[cfg(row_guidance)]
pub use rows as guide;

/// The machine.
pub use design::Machine as Uagv;

/// What the controller decides.
pub type Pilot = firmware::pilot::Pilot<Uagv>;
/// What the steering node does.
pub type Steering = firmware::actuator::Steering<Uagv, messages::Command>;
/// What the drive node does.
pub type Driving = firmware::actuator::Driving<Uagv, messages::Command>;
