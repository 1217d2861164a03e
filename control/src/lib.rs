//! Vehicle models, control design, estimation, guidance, modes and safety
//! limits, without the standard library.
//!
//! The crate knows no particular vehicle: [`vehicle::Description`] describes
//! one, and all settings are derived from it. The code is generic over
//! [`scalar::Scalar`]: `f32` on the target, `f64` on the host. It uses no
//! allocation, no I/O and no unsafe code, and a step of the controller cannot
//! panic.
//!
//! Frames and signs, as in thesis 7.2.4: positions are north and east;
//! headings and steering angles are clockwise (to the right) positive, in
//! radians; the cross-track error is positive to the right of the line.

#![no_std]
#![forbid(unsafe_code)]
#![warn(missing_docs)]
// Conditions are written so that NaN takes the safe branch: for NaN,
// `!(x > 0)` is true and `x <= 0` is false.
#![allow(clippy::neg_cmp_op_on_partial_ord)]

/// The linear algebra whose matrices and vectors stand in public items: a program
/// that uses this version needs no dependency of its own.
pub use nalgebra;

pub mod analysis;
mod angle;
pub mod calibration;
pub mod clothoid;
pub mod controller;
mod covariance;
pub mod demand;
pub mod design;
pub mod discretise;
pub mod dubins;
pub mod estimator;
pub mod feedback;
pub mod fence;
pub mod guidance;
pub mod habits;
pub mod hold;
pub mod kalman;
pub mod line;
pub mod linear;
pub mod lqr;
pub mod mission;
pub mod mode;
pub mod model;
pub mod mpc;
pub mod path;
pub mod plain;
pub mod position;
pub mod reeds_shepp;
pub mod response;
pub mod route;
pub mod row;
pub mod safety;
pub mod scalar;
pub mod schedule;
pub mod takeover;
pub mod tilt;
pub mod turn;
pub mod vehicle;

/// The examples of the README, as tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
