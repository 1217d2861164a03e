//! The vehicle without the vehicle: emulated microcontrollers that run the release images.

mod clock;
pub mod image;
pub mod mcu;
pub mod part;
mod peripheral;
pub mod statistics;
mod window;

pub use peripheral::{PinChange, ResetCause, SharedBus, UartByte};
