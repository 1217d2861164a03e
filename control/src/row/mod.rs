//! Following a crop row with two distance sensors (thesis chapter 2).
//!
//! [`thesis`] is the signal chain of the thesis. [`RowController`] is the one
//! that drives: the estimator knows leaves from stalks and bridges gaps, and the
//! law steers by what it finds.

mod beams;
mod controller;
mod end;
mod estimator;
mod health;
mod law;
mod mixture;
mod motion;
mod robot;
mod runs;
mod settings;
pub mod thesis;

pub use beams::{Beams, Mounting, MountingError, Prediction, RowPose, Side};
pub use controller::{RowController, RowOutcome, RowSettings, RowSettingsError, RowState, source};
pub use estimator::{RowDistances, RowEstimate, RowEstimator, WheelSpeeds};
pub use health::SideHealth;
pub use law::{RowLawError, RowLawSettings};
pub use robot::RowRobot;
pub use settings::{Motion, Odds, Readings, RowEstimatorError, RowEstimatorSettings, Rows};
pub use thesis::{
    ConditionalHold, EmptyRange, IntegralState, ProportionalIntegral, RowFollower, ScalarKalman,
    Sides, VarianceError, differential,
};
