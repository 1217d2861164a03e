//! What surrounds the nodes of the vehicle, for simulation on a PC.
//!
//! - [`vehicle`]: a bicycle model with the thesis's limits, dead bands, slip and slope;
//! - [`receiver`]: a Piksi that speaks SBP; [`syren`]: motor drivers; [`lcd`]: the display;
//!   [`operator`]: remote control, joystick and emergency-stop loop;
//! - [`scenario`]: what happens, as TOML files with units;
//! - [`World`]: all of it as one value, driven by a simulation of the nodes;
//! - [`report`]: figures, tables and pictures of a finished run.
//!
//! Everything is a function of scenario and seed: two runs give the same bytes.

#![forbid(unsafe_code)]

pub mod lcd;
mod node;
pub mod operator;
pub mod random;
pub mod receiver;
mod record;
pub mod report;
pub mod scenario;
pub mod syren;
pub mod time;
pub use vehicle_model::units;
pub mod vehicle;
mod world;

pub use node::{Analog, Input, Node, Port};
pub use record::{Counters, EffortChange, StateSample};
pub use scenario::{Scenario, ScenarioError};
pub use time::{SimDuration, SimTime};
pub use world::{Disturbance, Effect, Output, RECORD_PERIOD, World};
