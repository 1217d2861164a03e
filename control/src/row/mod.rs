//! Following a crop row with two distance sensors (thesis chapter 2).
//!
//! [`thesis`] is the signal chain of the thesis. [`RowEstimator`] knows leaves
//! from stalks and bridges gaps.

mod beams;
mod end;
mod estimator;
mod health;
mod mixture;
mod runs;
mod settings;
pub mod thesis;

pub use beams::{Beams, Mounting, MountingError, Prediction, RowPose, Side};
pub use end::OpenWay;
pub use estimator::{RowDistances, RowEstimate, RowEstimator, WheelSpeeds};
pub use health::SideHealth;
pub use settings::{Motion, Readings, RowEstimatorError, RowEstimatorSettings, Rows};
pub use thesis::{
    ConditionalHold, EmptyRange, IntegralState, ProportionalIntegral, RowFollower, ScalarKalman,
    Sides, VarianceError, differential,
};
