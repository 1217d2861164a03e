//! The vehicle without the vehicle: emulated microcontrollers that run the release images.

mod clock;
pub mod image;
pub mod mcu;
pub mod network;
pub mod part;
mod peripheral;
pub mod statistics;
pub mod vehicle;
mod window;

pub use peripheral::{PinChange, ResetCause, SharedBus, UartByte};
pub use vehicle::{Images, Options, Outcome, Progress, Vehicle, VehicleError, run};
