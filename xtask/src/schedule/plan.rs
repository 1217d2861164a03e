//! Converts between network files and the types of the protocol crate.

use network_model::{
    Assigned, Assignment, Message, Network, Reference, SendType, Window, WindowKind,
};
use ttcan::{
    Event, Id, MatrixConfig, Micros, NodeId, ReferenceFormat, SystemMatrix,
    synthesis::{self, Plan, PlannedWindow, Wishes},
};

use crate::cli::{Method, Schedule};

/// A new schedule.
#[derive(Debug)]
pub(super) struct Planned {
    pub assignment: Assignment,
    pub notes: Vec<Note>,
}

/// How the schedule of a message differs from the request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Note {
    /// Identifier of the message.
    pub id: u16,
    /// The requested period, in milliseconds.
    pub wanted_ms: u32,
    /// Largest deviation of its times from a regular period.
    pub jitter_us: u32,
}

/// Finds a schedule for the messages of a network. `arbitrating` is the default share of time for
/// arbitrating windows, in thousandths; the options may set another one.
pub(super) fn find(
    network: &Network,
    method: Method,
    options: &Schedule,
    arbitrating: u16,
) -> Result<Planned, String> {
    let cyclic: Vec<(&Message, u32)> = network
        .messages
        .iter()
        .filter(|message| message.window.kind == WindowKind::Exclusive)
        .filter_map(|message| match message.send_type {
            SendType::Cyclic { period_ms } => Some((message, period_ms)),
            SendType::Event { .. } => None,
        })
        .collect();
    for message in &network.messages {
        let event = matches!(message.send_type, SendType::Event { .. });
        match message.window.kind {
            WindowKind::Exclusive if event => {
                return Err(format!(
                    "event message {} ({}) has the kind of window Exclusive: Arbitrating is accepted",
                    message.name, message.id
                ));
            }
            WindowKind::Arbitrating if !event => {
                return Err(format!(
                    "cyclic message {} ({}) has the kind of window Arbitrating: Exclusive is accepted",
                    message.name, message.id
                ));
            }
            _ => {}
        }
    }
    let events: Vec<&Message> = network
        .messages
        .iter()
        .filter(|message| message.window.kind == WindowKind::Arbitrating)
        .collect();
    // A share above 0 results in at least one window for the longest frame.
    let least = u16::from(!events.is_empty());
    let wishes = Wishes {
        grain: Micros::micros(options.grain),
        arbitrating_per_mille: options.arbitrating.unwrap_or(arbitrating.max(least)),
        free_per_mille: options.free,
        longest_cycle: Micros::millis(options.longest_cycle.unwrap_or(reference_ms(network))),
    };
    let messages: Vec<synthesis::Message> = cyclic
        .iter()
        .map(|&(message, period_ms)| synthesis::Message {
            name: message.name.clone(),
            id: id(message.id),
            len: message.length,
            sender: node(network, &message.sender),
            period: Micros::from_ticks(period_ms.saturating_mul(1000)),
            deadline: Micros::from_ticks(
                message
                    .deadline_us
                    .unwrap_or(period_ms.saturating_mul(1000)),
            ),
            after: message
                .after
                .iter()
                .filter_map(|name| cyclic.iter().position(|(other, _)| other.name == *name))
                .collect(),
            // The basic cycle, and with it the grain of the release, is not known yet.
            gap: Micros::from_ticks(message.preparation_us + Network::LARGEST_RELEASE_GRAIN_US),
        })
        .collect();
    let masters = masters(network);
    let frame = config(network, &masters, &[], &[]);
    let plan = match method {
        Method::PowerOfTwo => synthesis::power_of_two(&frame, &messages, &wishes),
        Method::LeastJitter => synthesis::least_jitter(&frame, &messages, &wishes),
    };
    let plan = plan.map_err(|infeasible| format!("there is no schedule: {infeasible}"))?;
    assign(network, &cyclic, &events, &plan, &wishes)
}

fn assign(
    network: &Network,
    cyclic: &[(&Message, u32)],
    events: &[&Message],
    plan: &Plan,
    wishes: &Wishes,
) -> Result<Planned, String> {
    let (mut assigned, notes) = exclusive(cyclic, plan)?;
    assigned.extend(references(network, plan, wishes));
    assigned.extend(arbitrating(events, plan, wishes)?);
    Ok(Planned {
        assignment: Assignment {
            basic_cycle_us: plan.basic_cycle.ticks(),
            basic_cycles: plan.cycles,
            messages: assigned,
        },
        notes,
    })
}

/// The exclusive windows of the cyclic messages.
fn exclusive(
    cyclic: &[(&Message, u32)],
    plan: &Plan,
) -> Result<(Vec<Assigned>, Vec<Note>), String> {
    let mut assigned = Vec::new();
    let mut notes = Vec::new();
    for (index, &(message, wanted_ms)) in cyclic.iter().enumerate() {
        let windows = plan
            .windows
            .iter()
            .filter(|planned| planned.message == Some(index))
            .map(|planned| window(planned, WindowKind::Exclusive));
        let period_us = plan.periods.get(index).map_or(0, |period| period.ticks());
        if !period_us.is_multiple_of(1000) {
            return Err(format!(
                "message {} would be sent every {period_us} us: a file holds whole milliseconds",
                message.name
            ));
        }
        assigned.push(Assigned {
            id: message.id,
            period_ms: Some(period_us / 1000),
            windows: windows.collect(),
        });
        notes.push(Note {
            id: message.id,
            wanted_ms,
            jitter_us: plan.jitter.get(index).map_or(0, |jitter| jitter.ticks()),
        });
    }

    Ok((assigned, notes))
}

/// The windows of the reference messages. Each is as long as its frame plus the clocks'
/// uncertainty ([`Network::needed_us`]).
fn references<'a>(
    network: &'a Network,
    plan: &'a Plan,
    wishes: &'a Wishes,
) -> impl Iterator<Item = Assigned> + 'a {
    let references = network
        .messages
        .iter()
        .filter(|message| message.window.kind == WindowKind::Reference);
    references.map(|message| {
        let grain = wishes.grain.ticks().max(1);
        let needed = network.needed_us(message);
        Assigned {
            id: message.id,
            period_ms: match message.send_type {
                SendType::Cyclic { .. } => Some(plan.basic_cycle.ticks().div_ceil(1000)),
                SendType::Event { .. } => None,
            },
            windows: vec![Window {
                start_us: 0,
                length_us: needed.div_ceil(grain) * grain,
                repeat: 1,
                offset: 0,
                kind: WindowKind::Reference,
            }],
        }
    })
}

/// The arbitrating windows. The file assigns each of them to an event message.
fn arbitrating(events: &[&Message], plan: &Plan, wishes: &Wishes) -> Result<Vec<Assigned>, String> {
    let mut shared: Vec<Window> = plan
        .windows
        .iter()
        .filter(|planned| planned.message.is_none())
        .map(|planned| window(planned, WindowKind::Arbitrating))
        .collect();
    let share =
        |window: &Window| u64::from(window.length_us) * u64::from(plan.cycles / window.repeat);
    shared.sort_by_key(|window| std::cmp::Reverse(share(window)));
    let all = u64::from(plan.basic_cycle.ticks()) * u64::from(plan.cycles);
    let kept: u64 = shared.iter().take(events.len()).map(share).sum();
    if kept * 1000 < all * u64::from(wishes.arbitrating_per_mille) {
        return Err(match events.len() {
            0 => "there is no event message to be sent in an arbitrating window".into(),
            count => format!(
                "the arbitrating windows would be {}, but {count} event messages can name only as many",
                shared.len()
            ),
        });
    }
    shared.truncate(events.len());
    if shared.is_empty() && !events.is_empty() {
        return Err(
            "the event messages need an arbitrating window: --arbitrating 1 or more is accepted"
                .into(),
        );
    }
    let assigned = events.iter().zip(shared.iter().cycle());
    let assigned = assigned.map(|(message, window)| Assigned {
        id: message.id,
        period_ms: None,
        windows: vec![*window],
    });
    Ok(assigned.collect())
}

fn window(planned: &PlannedWindow, kind: WindowKind) -> Window {
    Window {
        start_us: planned.start.ticks(),
        length_us: planned.length.ticks(),
        repeat: planned.repeat,
        offset: planned.offset,
        kind,
    }
}

/// Share of time in arbitrating windows, in thousandths.
pub(super) fn arbitrating_share(network: &Network) -> u16 {
    share(network, WindowKind::Arbitrating).floor() as u16
}

/// Share of time in windows of one kind, in thousandths.
pub(super) fn share(network: &Network, kind: WindowKind) -> f64 {
    let cycles = f64::from(network.basic_cycles);
    let taken: f64 = network
        .windows()
        .iter()
        .filter(|window| window.kind == kind)
        .map(|window| f64::from(window.length_us) * cycles / f64::from(window.repeat.max(1)))
        .sum();
    taken * 1000.0 / (f64::from(network.basic_cycle_us) * cycles)
}

/// Checks a network with the rules of the protocol crate.
pub(super) fn check(network: &Network) -> Result<(), String> {
    let mut windows: Vec<ttcan::Window> = Vec::new();
    for message in &network.messages {
        for window in message.windows() {
            let (start, length) = (
                Micros::from_ticks(window.start_us),
                Micros::from_ticks(window.length_us),
            );
            let planned = match window.kind {
                WindowKind::Reference => continue,
                WindowKind::Exclusive => ttcan::Window::exclusive(
                    &message.name,
                    start,
                    length,
                    id(message.id),
                    message.length,
                    node(network, &message.sender),
                ),
                WindowKind::Arbitrating => ttcan::Window::arbitrating(&message.name, start, length),
            };
            let planned = planned.every(window.repeat, window.offset);
            // Messages that share an arbitrating window make one window.
            let twice = |other: &ttcan::Window| {
                (other.start, other.repeat, other.offset)
                    == (planned.start, planned.repeat, planned.offset)
            };
            if window.kind == WindowKind::Exclusive || !windows.iter().any(twice) {
                windows.push(planned);
            }
        }
    }
    windows.sort_by_key(|window| window.start);
    let events: Vec<Event> = network
        .messages
        .iter()
        .filter(|message| message.window.kind == WindowKind::Arbitrating)
        .map(|message| {
            Event::new(
                &message.name,
                id(message.id),
                message.length,
                node(network, &message.sender),
            )
            .every(message.window.repeat, message.window.offset)
        })
        .collect();
    let masters = masters(network);
    SystemMatrix::new(config(network, &masters, &windows, &events))
        .map(|_| ())
        .map_err(|error| error.to_string())
}

fn config<'a>(
    network: &Network,
    masters: &'a [NodeId],
    windows: &'a [ttcan::Window<'a>],
    events: &'a [Event<'a>],
) -> MatrixConfig<'a> {
    let first = network
        .messages
        .iter()
        .filter(|message| message.window.kind == WindowKind::Reference)
        .min_by_key(|message| message.id);
    let format = first.and_then(Reference::of).unwrap_or_default();
    MatrixConfig {
        bit_rate: network.bit_rate,
        basic_cycle: Micros::from_ticks(network.basic_cycle_us),
        cycles: network.basic_cycles,
        reference: id(first.map_or(0, |message| message.id)),
        reference_format: ReferenceFormat::new(
            format.application,
            format.coarse,
            format.control,
            format.mark,
        ),
        masters,
        transmit_enable_bits: network.transmit_enable_bits,
        sync_uncertainty: Micros::from_ticks(network.sync_uncertainty_us),
        longest_gap: Micros::micros(0),
        windows,
        events,
    }
}

/// Period of the first master's reference in the file, at most a second.
fn reference_ms(network: &Network) -> u32 {
    let periods = network
        .messages
        .iter()
        .filter(|message| message.window.kind == WindowKind::Reference)
        .filter_map(|message| match message.send_type {
            SendType::Cyclic { period_ms } => Some(period_ms),
            SendType::Event { .. } => None,
        });
    let given = periods.filter(|period| *period > 0).min();
    given.unwrap_or(LONGEST_MS).min(LONGEST_MS)
}

/// Longest basic cycle that a network file can hold, in milliseconds.
const LONGEST_MS: u32 = 1000;

/// The masters in the order of their ranks.
fn masters(network: &Network) -> Vec<NodeId> {
    let mut ranked: Vec<(u8, &str)> = network
        .nodes
        .iter()
        .filter_map(|node| Some((node.master_rank?, node.name.as_str())))
        .collect();
    ranked.sort_unstable();
    ranked.iter().map(|(_, name)| node(network, name)).collect()
}

/// The number of a node: its position in the file.
fn node(network: &Network, name: &str) -> NodeId {
    let place = network.nodes.iter().position(|node| node.name == name);
    NodeId(place.unwrap_or_default() as u16)
}

/// An identifier. The network file was checked, so it fits into 11 bits.
fn id(raw: u16) -> Id {
    Id::standard(raw).unwrap_or(Id::constant::<0>())
}
