//! Reads the folder of a vehicle: `vehicle.toml` (the manifest) and `network.dbc` (messages
//! and system matrix), checked against each other.
//!
//! The build script of a vehicle's crate calls [`build::run`], which generates constants for
//! the images from the folder. The virtual vehicle, the analysis and the commands read the
//! folder directly.
//!
//! | file | what it holds |
//! | --- | --- |
//! | `vehicle.toml` | nodes, wiring, machine, run: [`manifest`] |
//! | `network.dbc` | messages, signals, windows: `network-model` |
//! | `tasks.toml` | what releases each task and by when it must be done: `schedulability` |
//! | `nodes/NAME.rs` | the RTIC application of each node |
//! | `scenarios/*.toml` | what happens around the nodes in a run: `world` |
//!
//! A variant of a vehicle is a folder `variants/NAME` in the vehicle's folder. It has a `vehicle.toml` with the
//! values in which it differs, and may have scenarios. All else is the vehicle's.

pub mod build;
pub mod check;
mod design;
mod error;
pub mod manifest;
mod overrides;
mod source;
pub mod text;
pub mod units;
mod vehicle;

pub use design::{description, drive, limits, potentiometer, robot, steering};
pub use error::VehicleError;
pub use manifest::{BackupMaster, Device, Machine, Manifest, Node, Protocol, Remote};
pub use overrides::{Override, Overrides};
pub use vehicle::{NetworkText, NodeIndex, Vehicle};
