//! Following a crop row with two distance sensors (thesis chapter 2).
//!
//! [`thesis`] is the signal chain of the thesis.

pub mod thesis;

pub use thesis::{
    ConditionalHold, EmptyRange, IntegralState, ProportionalIntegral, RowFollower, ScalarKalman,
    Sides, VarianceError, differential,
};
