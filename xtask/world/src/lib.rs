//! The surroundings of a vehicle's nodes, for simulation on a PC.
//!
//! The vehicle's manifest (`vehicle-model`) says which devices are wired to which node and
//! what the machine measures; a scenario says what happens in a run.
//!
//! - [`vehicle`]: a bicycle model with limits, dead bands, slip and slope;
//! - [`receiver`]: a Piksi that speaks SBP; [`syren`]: motor drivers; [`lcd`]: the display;
//!   [`victor`]: motor drivers with servo pulses; [`distance`]: laser distance sensors;
//!   [`mod@line`]: a serial line as its receiver sees it; [`operator`]: remote control, joystick and
//!   emergency-stop loop;
//! - [`rover`]: a robot with six wheels that is steered by the speeds of both sides;
//! - [`rows`]: crop rows with plants, leaves and weeds, and what a beam of light meets in them;
//! - [`row_drive`]: a robot on its way along a row, with its sensors and motor drivers;
//! - [`crop`]: rows beside the line of a machine;
//! - [`scenario`]: what happens, as TOML files with units;
//! - [`World`]: all of it as one value, driven by a simulation of the nodes;
//! - [`report`]: figures, tables and pictures of a finished run.
//!
//! Everything is a function of scenario and seed: two runs give the same bytes.

#![forbid(unsafe_code)]

mod changes;
pub mod crop;
pub mod distance;
pub mod lcd;
pub mod line;
pub mod operator;
pub mod random;
pub mod receiver;
mod record;
pub mod report;
pub mod rover;
pub mod row_drive;
pub mod rows;
pub mod scenario;
mod signal;
pub mod syren;
pub mod time;
pub use vehicle_model::{Device, NodeIndex, units};
pub mod vehicle;
pub mod victor;
mod world;

pub use record::{
    Character, Counters, EffortChange, Garble, RelayChange, ScreenChange, StateSample,
};
pub use scenario::{DURATIONS, Scenario, ScenarioError};
pub use signal::{Analog, Input};
pub use time::{SimDuration, SimTime};
pub use world::{Disturbance, Effect, Output, RECORD_PERIOD, World, start_bit};
