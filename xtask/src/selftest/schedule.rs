//! The schedule of a bus, for a program that sends in it.

use std::time::Duration;

use can_bus::{Frame, wire::WireFrame};
use embedded_can::Id;
use network_model::{Message, Network, Reference, WindowKind, worst_case_bits};

/// A reference message on the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Begin {
    /// When the basic cycle has begun: the start of the frame.
    pub(crate) at: Duration,
    /// Its number in the system matrix.
    pub(crate) cycle: u8,
}

/// When frames may begin, after the begin of a basic cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Place {
    pub(crate) earliest: Duration,
    pub(crate) latest: Duration,
}

/// The message of a frame.
pub(crate) fn message<'v>(network: &'v Network, frame: &Frame) -> Option<&'v Message> {
    match frame.id() {
        Id::Standard(id) if !frame.is_remote() => network.message(id.as_raw()),
        _ => None,
    }
}

/// The begin of a basic cycle, if the frame that ended at `end` is a reference message.
pub(crate) fn begin(network: &Network, frame: &Frame, end: Duration) -> Option<Begin> {
    let message = message(network, frame)?;
    if message.window.kind != WindowKind::Reference {
        return None;
    }
    let control = Reference::of(message).and_then(|layout| {
        let data = frame.data();
        data.get(usize::from(layout.control)).copied()
    });
    Some(Begin {
        at: end.saturating_sub(duration(network, frame)),
        cycle: control.unwrap_or(0) & 0x3F,
    })
}

/// When the basic cycle has begun in whose exclusive window this frame ended at `end`. A program that hears frames late
/// knows by the last one how far the bus is.
pub(crate) fn cycle_of(network: &Network, frame: &Frame, end: Duration) -> Option<Duration> {
    let window = message(network, frame)?.window;
    let before = micros(window.start_us) + duration(network, frame);
    (window.kind == WindowKind::Exclusive).then(|| end.saturating_sub(before))
}

/// How long a frame takes on the bus.
fn duration(network: &Network, frame: &Frame) -> Duration {
    let bits = WireFrame::encode(frame).bits() as u64;
    Duration::from_nanos(bits * 1_000_000_000 / u64::from(network.bit_rate.max(1)))
}

/// When the first of so many frames of a message may begin. Its window must still hold them when each one wins
/// arbitration at once, with room for the clock error of the nodes on both sides.
pub(crate) fn place(network: &Network, message: &Message, frames: u32) -> Place {
    let window = message.window;
    let uncertain = network.sync_uncertainty_us;
    let frame = network.bits_to_us(worst_case_bits(message.length)) * frames;
    let latest = window.end_us().saturating_sub(frame + uncertain);
    Place {
        earliest: micros(window.start_us + uncertain),
        latest: micros(latest),
    }
}

/// Whether the basic cycle of that number has the message's window.
pub(crate) fn has_window(message: &Message, cycle: u8) -> bool {
    let window = message.window;
    cycle % window.repeat.max(1) == window.offset
}

fn micros(us: u32) -> Duration {
    Duration::from_micros(u64::from(us))
}
