//! The system matrix, in the types of the crate `ttcan`.

use std::fmt::Write;

use super::names::{doc, screaming, snake};
use crate::{
    network::{Message, Network, Node, Window, WindowKind},
    reference::Reference,
};

/// Writes the nodes that send, the windows and the system matrix of a network.
pub fn matrix(network: &Network) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_all(&mut out, network);
    out
}

fn write_all(out: &mut String, network: &Network) -> std::fmt::Result {
    for (number, node) in senders(network).into_iter().enumerate() {
        writeln!(out, "/// Node `{}`: {}", node.name, doc(&node.comment))?;
        writeln!(
            out,
            "pub const {}: NodeId = NodeId({number});\n",
            screaming(&node.name)
        )?;
    }
    write_names(out, network)?;
    write_constants(out, network)?;
    write_received(out, network)?;
    write_windows(out, network)?;
    write_matrix(out, network)
}

/// Nodes that send at least one message, in file order.
fn senders(network: &Network) -> Vec<&Node> {
    let sends = |node: &&Node| network.messages.iter().any(|m| m.sender == node.name);
    network.nodes.iter().filter(sends).collect()
}

fn write_names(out: &mut String, network: &Network) -> std::fmt::Result {
    let nodes = senders(network);
    let names: Vec<String> = nodes
        .iter()
        .map(|node| format!("{:?}", node.name))
        .collect();
    writeln!(out, "/// Names of the nodes that send, by their numbers.")?;
    writeln!(
        out,
        "pub const NAMES: [&str; {}] = [{}];\n",
        names.len(),
        names.join(", ")
    )
}

fn write_constants(out: &mut String, network: &Network) -> std::fmt::Result {
    writeln!(out, "/// Bit rate of the bus in bit/s.")?;
    writeln!(out, "pub const BIT_RATE: u32 = {};\n", network.bit_rate)?;
    writeln!(out, "/// Length of the basic cycle.")?;
    writeln!(
        out,
        "pub const BASIC_CYCLE: Micros = Micros::micros({});\n",
        network.basic_cycle_us
    )?;
    writeln!(
        out,
        "/// The bits of the first byte of every reference that belong to no signal."
    )?;
    writeln!(
        out,
        "pub const REFERENCE_FREE: u8 = {:#X};\n",
        network.reference_free()
    )
}

/// A window of the matrix with its name in Rust.
struct Named<'n> {
    name: String,
    window: Window,
    /// The one message of an exclusive window.
    message: Option<&'n Message>,
}

fn named(network: &Network) -> Vec<Named<'_>> {
    let windows = network.windows();
    let arbitrating = |window: &&Window| window.kind == WindowKind::Arbitrating;
    let several = windows.iter().filter(arbitrating).count() > 1;
    let mut events = 0;
    let mut named = Vec::new();
    for window in windows {
        let name = match window.kind {
            WindowKind::Reference => continue,
            WindowKind::Exclusive => None,
            WindowKind::Arbitrating if several => {
                events += 1;
                Some(format!("events_{events}"))
            }
            WindowKind::Arbitrating => Some("events".into()),
        };
        let message = network
            .messages
            .iter()
            .find(|message| name.is_none() && message.windows().any(|its| its == window));
        let name = name.or_else(|| {
            let message = message?;
            let base = snake(&message.name);
            let number = message.windows().position(|its| its == window)? + 1;
            Some(match number {
                1 => base,
                _ => format!("{base}_{number}"),
            })
        });
        named.push(Named {
            name: name.unwrap_or_default(),
            window,
            message,
        });
    }
    named
}

/// The windows of the matrix: line and description of what each is for, and its name in Rust.
pub(super) fn window_names(network: &Network) -> Vec<(Option<usize>, String, String)> {
    let windows = named(network).into_iter();
    let told = windows.map(|named| {
        let line = named.message.and_then(|message| message.line);
        let what = match named.message {
            Some(message) => format!("a window of message {} ({})", message.name, message.id),
            None => format!("the arbitrating window at {} us", named.window.start_us),
        };
        (line, what, named.name.to_uppercase())
    });
    told.collect()
}

fn write_windows(out: &mut String, network: &Network) -> std::fmt::Result {
    writeln!(
        out,
        "/// Positions of the windows in the matrix, as the protocol reports them."
    )?;
    writeln!(out, "pub mod window {{")?;
    for (index, named) in named(network).into_iter().enumerate() {
        let contents = match named.message {
            Some(message) => format!(
                "Message `{}` ({}) of `{}`",
                message.name, message.id, message.sender
            ),
            None => "Event messages".into(),
        };
        writeln!(
            out,
            "    /// {contents}, from {} to {} us.",
            named.window.start_us,
            named.window.end_us()
        )?;
        writeln!(
            out,
            "    pub const {}: usize = {index};",
            named.name.to_uppercase()
        )?;
    }
    writeln!(out, "}}\n")?;
    write_releases(out, network)?;
    write_overdue(out, network)
}

/// The messages of each node that sends.
fn write_received(out: &mut String, network: &Network) -> std::fmt::Result {
    let nodes = senders(network);
    writeln!(
        out,
        "/// Identifiers of the messages that each node receives, by its number."
    )?;
    writeln!(out, "pub const RECEIVED: [&[u16]; {}] = [", nodes.len())?;
    for node in nodes {
        let messages = network.messages.iter();
        let ids: Vec<String> = messages
            .filter(|message| message.is_for(&node.name))
            .map(|message| message.id.to_string())
            .collect();
        writeln!(out, "    &[{}],", ids.join(", "))?;
    }
    writeln!(out, "];\n")
}

/// When messages of exclusive windows are overdue.
fn write_overdue(out: &mut String, network: &Network) -> std::fmt::Result {
    let messages = network.messages.iter();
    let exclusive = messages.filter(|message| message.window.kind == WindowKind::Exclusive);
    writeln!(
        out,
        "/// How long after the end of a message's frame the second one after it is overdue."
    )?;
    writeln!(out, "pub mod overdue {{\n    use ttcan::Micros;\n")?;
    for message in exclusive {
        writeln!(out, "    /// Message `{}` ({}).", message.name, message.id)?;
        writeln!(
            out,
            "    pub const {}: Micros = Micros::micros({});",
            screaming(&message.name),
            network.overdue_us(message)
        )?;
    }
    writeln!(out, "}}\n")
}

/// The instants at which the steps of the senders are released.
fn write_releases(out: &mut String, network: &Network) -> std::fmt::Result {
    let releases: Vec<(&Message, u32)> = network
        .messages
        .iter()
        .filter_map(|message| Some((message, network.release_us(message)?)))
        .collect();
    if releases.is_empty() {
        return Ok(());
    }
    writeln!(
        out,
        "/// Cycle times at which all has arrived that the sender of a message needs for it."
    )?;
    writeln!(out, "pub mod release {{\n    use ttcan::Micros;\n")?;
    for (message, release_us) in releases {
        writeln!(
            out,
            "    /// For message `{}` ({}): {} have arrived.",
            message.name,
            message.id,
            message.after.join(", ")
        )?;
        writeln!(
            out,
            "    pub const {}: Micros = Micros::micros({release_us});",
            screaming(&message.name)
        )?;
    }
    writeln!(out, "}}\n")
}

fn write_matrix(out: &mut String, network: &Network) -> std::fmt::Result {
    let mut masters: Vec<(u8, String)> = network
        .nodes
        .iter()
        .filter_map(|node| Some((node.master_rank?, screaming(&node.name))))
        .collect();
    masters.sort();
    let masters: Vec<String> = masters.into_iter().map(|(_, name)| name).collect();
    let mut references = network
        .messages
        .iter()
        .filter(|message| message.window.kind == WindowKind::Reference);
    // The references are in the order of their identifiers, rank 0 first.
    let base = references.next();
    let reference = base.and_then(Reference::of).unwrap_or_default();

    writeln!(out, "/// The system matrix, checked at compile time.")?;
    writeln!(
        out,
        "pub const MATRIX: SystemMatrix<'static> = SystemMatrix::constant(MatrixConfig {{"
    )?;
    writeln!(out, "    bit_rate: BIT_RATE,")?;
    writeln!(out, "    basic_cycle: BASIC_CYCLE,")?;
    writeln!(out, "    cycles: {},", network.basic_cycles)?;
    let id = base.map_or(0, |message| message.id);
    writeln!(out, "    reference: Id::constant::<{id}>(),")?;
    writeln!(
        out,
        "    reference_format: ReferenceFormat::new({}, {:?}, {}, {:?}),",
        reference.application, reference.coarse, reference.control, reference.mark
    )?;
    writeln!(out, "    masters: &[{}],", masters.join(", "))?;
    writeln!(
        out,
        "    transmit_enable_bits: {},",
        network.transmit_enable_bits
    )?;
    writeln!(
        out,
        "    sync_uncertainty: Micros::micros({}),",
        network.sync_uncertainty_us
    )?;
    writeln!(out, "    longest_gap: Micros::micros(0),")?;
    write_matrix_windows(out, network)?;
    write_matrix_events(out, network)?;
    writeln!(out, "}});\n")?;
    writeln!(out, "ttcan::schedule!(")?;
    writeln!(
        out,
        "    /// The schedule compiled from [`MATRIX`], the same on every node."
    )?;
    writeln!(out, "    pub static SCHEDULE = MATRIX")?;
    writeln!(out, ");")
}

fn write_matrix_windows(out: &mut String, network: &Network) -> std::fmt::Result {
    writeln!(out, "    windows: &[")?;
    for named in named(network) {
        let Window {
            start_us,
            length_us,
            repeat,
            offset,
            ..
        } = named.window;
        let name = &named.name;
        let span = format!("Micros::micros({start_us}), Micros::micros({length_us})");
        let mut window = match named.message {
            Some(message) => format!(
                "Window::exclusive({name:?}, {span}, Id::constant::<{}>(), {}, {})",
                message.id,
                message.length,
                screaming(&message.sender)
            ),
            None => format!("Window::arbitrating({name:?}, {span})"),
        };
        if repeat > 1 {
            let _ = write!(window, ".every({repeat}, {offset})");
        }
        if named.message.is_some_and(|message| message.retry_late) {
            window.push_str(".retry_late()");
        }
        writeln!(out, "        {window},")?;
    }
    writeln!(out, "    ],")
}

fn write_matrix_events(out: &mut String, network: &Network) -> std::fmt::Result {
    writeln!(out, "    events: &[")?;
    for message in &network.messages {
        if message.window.kind == WindowKind::Arbitrating {
            let mut event = format!(
                "Event::new({:?}, Id::constant::<{}>(), {}, {})",
                snake(&message.name),
                message.id,
                message.length,
                screaming(&message.sender)
            );
            let Window { repeat, offset, .. } = message.window;
            if repeat > 1 {
                let _ = write!(event, ".every({repeat}, {offset})");
            }
            writeln!(out, "        {event},")?;
        }
    }
    writeln!(out, "    ],")
}
