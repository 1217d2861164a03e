//! Tests of the boards, run by `cargo xtask test --board NODE`: on the board of the node through
//! probe-rs where a debug probe is connected, otherwise on the virtual microcontroller. The image
//! is the same.
//!
//! Each test starts from a reset and begins with [`bench::Bench::start`]. A test that fails panics
//! with one sentence; the lines of the log before it show what was measured.
//!
//! | module | what it tests | needs |
//! | --- | --- | --- |
//! | [`clocks`] | oscillator, core clock, prescalers, wait states | 8 MHz at OSC_IN |
//! | [`time_base`] | rate of TIM2, its alarms | |
//! | [`stamps`] | time stamps of frames in silent loop-back | |
//! | [`dma_ring`] | lines of the console, rings of receiver and converter | |
//! | [`can_errors`] | error states of a node that nobody acknowledges | transceiver, or a wire from CAN transmit to CAN receive; no other node on the bus |
//! | `distances`, F303 only | bursts of the distance sensors' converter | |
//! | `servos`, F303 only | widths and instants of the servo pulses | nothing that drives these pins |
//! | `remote`, F303 only | the lines of the remote control | open lines without the sled's resistors, or only a Nucleo |
//! | [`wave_forms`] | what the serial transmitters put on their pins | nothing that drives these pins |

#![no_std]
#![no_main]

#[cfg(feature = "f303")]
use sled_f303 as board;
#[cfg(feature = "f446")]
use sled_f446 as board;

use cortex_m_rt as _;
use defmt::Display2Format;
use defmt_rtt as _;

mod bench;
mod can_errors;
mod clocks;
#[cfg(feature = "f303")]
mod distances;
mod dma_ring;
mod registers;
#[cfg(feature = "f303")]
mod remote;
#[cfg(feature = "f303")]
mod servos;
mod stamps;
mod time_base;
mod wave_forms;

/// Ends a test that fails. The sentence goes to the log, because that is shown on a board and on
/// the virtual microcontroller alike.
#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    let (file, line) = info
        .location()
        .map_or(("?", 0), |place| (place.file(), place.line()));
    let message = Display2Format(&info.message());
    defmt::error!("{} ({=str}:{=u32})", message, file, line);
    semihosting::process::abort()
}
