//! Whether every message fits in its window.

use network_model::{Message, Network, SendType, Window, WindowKind, worst_case_bits};

use crate::can;
use crate::results::MessageReport;
use crate::table::BusTable;
use crate::units::MICROSECOND;

/// The answers for all messages, in the order of their windows.
///
/// The window of a reference message and an exclusive window must hold one frame
/// ([`Network::needed_us`]). Messages that share an arbitrating window in the same basic cycles
/// delay each other as on a bus of their own (Davis et al. 2007), with errors.
#[must_use]
pub fn messages(network: &Network, table: &BusTable) -> Vec<MessageReport> {
    let bit = u64::from(network.bit_time_ns());
    let errors = can::ErrorRate {
        burst: table.error_burst,
        interval: table.error_interval_ms * 1_000_000,
    };
    let mut events: Vec<&Message> = network
        .messages
        .iter()
        .filter(|m| m.window.kind == WindowKind::Arbitrating)
        .collect();
    events.sort_by_key(|m| m.id);
    let mut reports: Vec<MessageReport> = network
        .messages
        .iter()
        .map(|m| {
            let arbitrating = m.window.kind == WindowKind::Arbitrating;
            let need = if arbitrating {
                let together: Vec<&&Message> =
                    events.iter().filter(|e| meet(e.window, m.window)).collect();
                let streams: Vec<can::Message> = together.iter().map(|e| stream(e, bit)).collect();
                let at = together.iter().position(|e| e.id == m.id).unwrap_or(0);
                can::response(&streams, at, bit, errors)
                    .ok()
                    .map(|ns| ns * 1000)
            } else {
                Some(u64::from(network.needed_us(m)) * MICROSECOND)
            };
            MessageReport {
                name: m.name.clone(),
                id: m.id,
                need,
                room: u64::from(m.window.length_us) * MICROSECOND,
                start: Some(u64::from(m.window.start_us) * MICROSECOND),
                arbitrating,
            }
        })
        .collect();
    reports.sort_by_key(|m| (m.start, m.id));
    reports
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
