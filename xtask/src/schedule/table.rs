//! Prints a schedule as a table or as JSON.

use std::fmt::{self, Write};

use network_model::{Message, Network, SendType, Window, WindowKind};
use serde_json::{Value, json};

use super::plan::{self, Note};

/// The matrix as a table: one row per window, one column per basic cycle.
pub(super) fn text(network: &Network, notes: &[Note]) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_text(&mut out, network, notes);
    out
}

fn write_text(t: &mut String, network: &Network, notes: &[Note]) -> fmt::Result {
    let cycles = network.basic_cycles;
    writeln!(
        t,
        "{} of {} ms at {} kbit/s; time masters by rank: {}",
        match cycles {
            1 => "1 basic cycle".into(),
            count => format!("{count} basic cycles"),
        },
        milliseconds(network.basic_cycle_us),
        f64::from(network.bit_rate) / 1000.0,
        masters(network).join(", ")
    )?;
    writeln!(t)?;
    let columns = usize::from(cycles).max(6);
    writeln!(
        t,
        "{:>9} {:>9}  {:<columns$}  {:<11} message",
        "start", "end", "cycles", "sender"
    )?;
    for row in rows(network) {
        let window = row.window;
        let mark = match window.kind {
            WindowKind::Reference => 'R',
            WindowKind::Exclusive => 'X',
            WindowKind::Arbitrating => 'A',
        };
        let cells: String = (0..cycles)
            .map(|cycle| {
                let here = cycle % window.repeat.max(1) == window.offset;
                if here { mark } else { '.' }
            })
            .collect();
        for (index, message) in row.messages.iter().enumerate() {
            let (start, end, cells) = match index {
                0 => (
                    format!("{} us", window.start_us),
                    format!("{} us", window.end_us()),
                    cells.as_str(),
                ),
                _ => (String::new(), String::new(), ""),
            };
            let note = notes.iter().find(|note| note.id == message.id);
            writeln!(
                t,
                "{start:>9} {end:>9}  {cells:<columns$}  {:<11} {} {}{}",
                message.sender,
                message.id,
                message.name,
                remark(message, note)
            )?;
        }
    }
    let shares = shares(network);
    writeln!(t)?;
    writeln!(
        t,
        "R reference {:.1} %, X exclusive {:.1} %, A arbitrating {:.1} %, free {:.1} % of all time",
        shares[0] / 10.0,
        shares[1] / 10.0,
        shares[2] / 10.0,
        shares[3] / 10.0
    )
}

fn remark(message: &Message, note: Option<&Note>) -> String {
    let SendType::Cyclic { period_ms } = message.send_type else {
        return String::new();
    };
    if message.window.kind == WindowKind::Reference {
        return String::new();
    }
    let mut remark = format!(", every {period_ms} ms");
    // Writing to a string cannot fail.
    if let Some(note) = note {
        if note.wanted_ms != period_ms {
            let _ = write!(remark, " instead of {} ms", note.wanted_ms);
        }
        if note.jitter_us > 0 {
            let _ = write!(remark, ", jitter {} us", note.jitter_us);
        }
    }
    remark
}

fn milliseconds(us: u32) -> String {
    format!("{}", f64::from(us) / 1000.0)
}

fn masters(network: &Network) -> Vec<&str> {
    let mut masters: Vec<(u8, &str)> = network
        .nodes
        .iter()
        .filter_map(|node| Some((node.master_rank?, node.name.as_str())))
        .collect();
    masters.sort_unstable();
    masters.into_iter().map(|(_, name)| name).collect()
}

/// A window and the messages that are sent in it.
struct Row<'n> {
    window: Window,
    messages: Vec<&'n Message>,
}

fn rows(network: &Network) -> Vec<Row<'_>> {
    let of = |window: Window| {
        let messages = network.messages.iter();
        Row {
            window,
            messages: messages
                .filter(|message| message.windows().any(|its| its == window))
                .collect(),
        }
    };
    network.windows().into_iter().map(of).collect()
}

/// Shares of time of reference, exclusive, arbitrating and free windows, in thousandths.
fn shares(network: &Network) -> [f64; 4] {
    let share = |kind| plan::share(network, kind);
    let taken = [
        share(WindowKind::Reference),
        share(WindowKind::Exclusive),
        share(WindowKind::Arbitrating),
    ];
    let free = 1000.0 - taken.iter().sum::<f64>();
    [taken[0], taken[1], taken[2], free]
}

/// The matrix as JSON.
pub(super) fn json(network: &Network, notes: &[Note]) -> String {
    let message = |message: &&Message| {
        let period = match message.send_type {
            SendType::Cyclic { period_ms } => Some(period_ms),
            SendType::Event { .. } => None,
        };
        let note = notes.iter().find(|note| note.id == message.id);
        json!({
            "id": message.id,
            "name": message.name,
            "sender": message.sender,
            "bytes": message.length,
            "period_ms": period,
            "wanted_period_ms": note.map(|note| note.wanted_ms),
            "jitter_us": note.map(|note| note.jitter_us),
        })
    };
    let windows: Vec<Value> = rows(network)
        .iter()
        .map(|row| {
            json!({
                "kind": match row.window.kind {
                    WindowKind::Reference => "reference",
                    WindowKind::Exclusive => "exclusive",
                    WindowKind::Arbitrating => "arbitrating",
                },
                "start_us": row.window.start_us,
                "length_us": row.window.length_us,
                "repeat": row.window.repeat,
                "offset": row.window.offset,
                "messages": row.messages.iter().map(message).collect::<Vec<_>>(),
            })
        })
        .collect();
    let shares = shares(network);
    let value = json!({
        "bit_rate": network.bit_rate,
        "basic_cycle_us": network.basic_cycle_us,
        "basic_cycles": network.basic_cycles,
        "masters": masters(network),
        "windows": windows,
        "shares_per_mille": {
            "reference": shares[0],
            "exclusive": shares[1],
            "arbitrating": shares[2],
            "free": shares[3],
        },
    });
    format!("{value:#}")
}
