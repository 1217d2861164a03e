//! Following a crop row with two distance sensors (thesis chapter 2).
//!
//! [`thesis`] is the signal chain of the thesis.

mod beams;
pub mod thesis;

pub use beams::{Beams, Mounting, MountingError, Prediction, RowPose, Side};
pub use thesis::{
    ConditionalHold, EmptyRange, IntegralState, ProportionalIntegral, RowFollower, ScalarKalman,
    Sides, VarianceError, differential,
};
