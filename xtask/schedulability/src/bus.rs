//! Whether every message fits in its window.

use std::collections::BTreeSet;

use network_model::{Message, Network, SendType, Window, WindowKind, worst_case_bits};

use crate::can::{self, ERROR_FRAME_BITS, ErrorRate};
use crate::results::{MessageReport, Tolerance};
use crate::units::{MICROSECOND, Picoseconds};

/// The answers for all messages, in the order of their windows.
///
/// The window of a reference message and an exclusive window must hold one frame
/// ([`Network::needed_us`]). Messages that share an arbitrating window in the same basic cycles
/// delay each other as on a bus of their own (Davis et al. 2007), with disturbed frames. `supervised`
/// are the messages after which their receivers stop if [`network_model::MISSED_PERIODS`] in a row are lost.
#[must_use]
pub fn messages(
    network: &Network,
    errors: ErrorRate,
    supervised: &BTreeSet<String>,
) -> Vec<MessageReport> {
    let bit = u64::from(network.bit_time_ns());
    let mut events: Vec<&Message> = network
        .messages
        .iter()
        .filter(|m| m.window.kind == WindowKind::Arbitrating)
        .collect();
    events.sort_by_key(|m| m.id);
    let together = |message: &Message| -> (Vec<can::Message>, usize) {
        let others = events
            .iter()
            .filter(|other| meet(other.window, message.window));
        let streams: Vec<&&Message> = others.collect();
        let at = streams.iter().position(|other| other.id == message.id);
        let streams = streams.iter().map(|other| stream(other, bit)).collect();
        (streams, at.unwrap_or(0))
    };
    let of_event = |message: &Message| {
        let (streams, at) = together(message);
        let need = |errors| {
            let ns = can::response(&streams, at, bit, errors).ok();
            ns.map(|ns| ns * 1000)
        };
        let room = window(message);
        let meets = |burst| {
            let need = need(errors.with_burst(burst));
            vec![need.is_some_and(|need| need <= room)]
        };
        let tolerance = can::tolerances(1, meets).remove(0);
        (need(errors), tolerance)
    };
    let mut reports: Vec<MessageReport> = network
        .messages
        .iter()
        .map(|m| {
            let needed = Some(u64::from(network.needed_us(m)) * MICROSECOND);
            let (need, tolerance) = match m.window.kind {
                WindowKind::Arbitrating => of_event(m),
                WindowKind::Exclusive => (needed, lost(network, m, supervised)),
                WindowKind::Reference => (needed, Tolerance::Reference(repeated(m, bit))),
            };
            MessageReport {
                name: m.name.clone(),
                id: m.id,
                need,
                room: window(m),
                start: Some(u64::from(m.window.start_us) * MICROSECOND),
                arbitrating: m.window.kind == WindowKind::Arbitrating,
                tolerance,
            }
        })
        .collect();
    reports.sort_by_key(|m| (m.start, m.id));
    reports
}

/// The length of a message's window.
fn window(message: &Message) -> Picoseconds {
    u64::from(message.window.length_us) * MICROSECOND
}

/// What a disturbed frame in an exclusive window means: the next frame comes in the next window of the
/// message.
fn lost(network: &Network, message: &Message, supervised: &BTreeSet<String>) -> Tolerance {
    let period = match message.send_type {
        SendType::Cyclic { period_ms } => period_ms,
        SendType::Event { .. } => network.basic_cycle_us.div_ceil(1000),
    };
    Tolerance::Lost {
        next: u64::from(period) * 1000 * MICROSECOND,
        acted_on: supervised
            .contains(&message.name)
            .then_some(u64::from(network_model::MISSED_PERIODS)),
    }
}

/// By how much a disturbed frame delays the repetition, without the time to load the mailbox.
fn repeated(message: &Message, bit: u64) -> Picoseconds {
    (ERROR_FRAME_BITS + u64::from(worst_case_bits(message.length))) * bit * 1000
}

/// Whether two arbitrating windows are open in the same basic cycles. Both repeats are powers of two
/// (ISO 11898-4), so the rarer one alone decides.
fn meet(one: Window, other: Window) -> bool {
    let often = one.repeat.min(other.repeat).max(1);
    one.offset % often == other.offset % often
}

/// An event message as a stream on its bus.
fn stream(message: &Message, bit: u64) -> can::Message {
    let interval = match message.send_type {
        SendType::Event { interval_ms } => interval_ms,
        SendType::Cyclic { period_ms } => period_ms,
    };
    can::Message {
        name: message.name.clone(),
        length: u64::from(worst_case_bits(message.length)) * bit,
        period: u64::from(interval.max(1)) * 1_000_000,
        deadline: u64::from(message.window.length_us) * 1000,
        jitter: 0,
    }
}
