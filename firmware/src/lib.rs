//! Code that the nodes of all vehicles share. The applications in `vehicles/NAME/nodes` are
//! composed of it; nothing here depends on a vehicle's numbers or messages.
//!
//! - [`design`]: constants, with unit, source and arithmetic;
//! - [`machine`]: the machine and its commands, as a vehicle's crate describes them;
//! - [`convert`]: where raw codes and physical units meet;
//! - [`link`]: protocol stack, CAN port and window timer as one value;
//! - [`event`]: the same for a vehicle whose nodes send at once, without a schedule;
//! - [`oscillator`]: trims an RC oscillator by the references;
//! - [`leader`]: under which time master the actuators may move;
//! - [`ends`]: when the command of an actuator node ends;
//! - [`e2e`]: the protection of actuator commands; [`actuator`]: their supervision;
//! - [`sbp`]: the satellite receiver's protocol; [`navigation`]: its messages, for the bus;
//! - [`buttons`]: debouncing; [`pilot`]: modes, states, control law;
//! - [`rows`]: following the rows of a crop; [`guide`]: guidance by them while there is no fix, or by a planner;
//! - [`pulses`]: servo pulses of the right width, on any oscillator;
//! - [`text`], [`display`], [`console`]: text for the operator;
//! - [`housekeeping`]: watchdog, status messages, LED;
//! - [`log`]: which lines a debug probe shows.
//!
//! Everything but the modules of the target runs, and is tested, on the host.

#![no_std]

#[cfg(all(feature = "f303", feature = "f446"))]
compile_error!("an image is for one part: choose the feature `f303` or `f446`, not both");

pub mod actuator;
pub mod buttons;
pub mod console;
pub mod convert;
pub mod design;
pub mod display;
pub mod e2e;
pub mod ends;
pub mod event;
pub mod guard;
pub mod guide;
pub mod housekeeping;
pub mod leader;
pub mod link;
pub mod log;
pub mod machine;
pub mod mission;
pub mod navigation;
pub mod oscillator;
pub mod peers;
pub mod pilot;
pub mod pulses;
pub mod rows;
pub mod sbp;
pub mod selftest;
pub mod sentry;
pub mod steering;
pub mod text;
mod vehicle;

pub use sled_common::starts;

#[cfg(feature = "f303")]
pub use sled_f303 as board;
#[cfg(feature = "f446")]
pub use sled_f446 as board;

#[cfg(feature = "target")]
pub mod fault;
#[cfg(feature = "target")]
pub mod node;

#[cfg(feature = "target")]
#[doc(hidden)]
pub use rtic_monotonics;

/// Makes the type `Mono`, the tick of an image's software tasks by `rtic-monotonics`, and its handler of SysTick. It
/// stands in the image, because one whose tasks wait for nothing has no such handler.
#[cfg(feature = "target")]
#[macro_export]
macro_rules! tick {
    () => {
        $crate::rtic_monotonics::systick_monotonic!(Mono, $crate::node::TICKS);

        impl $crate::node::Tick for Mono {
            fn start(tick: $crate::rtic_monotonics::systick::SYST, core_hz: u32) {
                Mono::start(tick, core_hz);
            }
        }
    };
}
