//! Checks of a network that go beyond the syntax of a DBC file.

use std::collections::{BTreeMap, BTreeSet};

/// Longest transmit enable window, in bit times: that of `ttcan`, which checks it once more when the
/// images are built.
const LONGEST_TRANSMIT_ENABLE: u8 = 32;

use crate::{
    frame::worst_case_bits,
    generate,
    network::{Message, Network, SendType, Window, WindowKind},
    problem::Problem,
    reference::Reference,
    signal::Signal,
};

/// Longest basic cycle, in microseconds.
const LONGEST_CYCLE_US: u32 = 1_000_000;

/// All problems of a network, in the order of its messages. While the windows are still to be
/// found (`unscheduled`), they are not checked.
pub(crate) fn check(network: &Network, unscheduled: bool) -> Vec<Problem> {
    let mut problems = Vec::new();
    bus(network, &mut problems);
    if !unscheduled {
        time_frame(network, &mut problems);
    }
    let unique = problems.len();
    names(network, &mut problems);
    // Two equal names also become one in Rust.
    if problems.len() == unique && !unscheduled {
        generate::check(network, &mut problems);
    }
    masters(network, &mut problems);
    for message in &network.messages {
        data(network, message, &mut problems);
        precedence(network, message, unscheduled, &mut problems);
        replacement(network, message, &mut problems);
        if !unscheduled {
            for at in message.windows() {
                window(network, message, at, &mut problems);
            }
            rate(network, message, &mut problems);
            lateness(network, message, &mut problems);
        }
    }
    if !unscheduled {
        event_cycles(network, &mut problems);
        overlaps(network, &mut problems);
    }
    problems
}

fn bus(network: &Network, problems: &mut Vec<Problem>) {
    let mut refuse = |what: String| problems.push(Problem { line: None, what });
    if !(10_000..=1_000_000).contains(&network.bit_rate) {
        refuse(format!(
            "Baudrate is {} bit/s: 10000 to 1000000 are accepted",
            network.bit_rate
        ));
    }
    if !(1..=LONGEST_TRANSMIT_ENABLE).contains(&network.transmit_enable_bits) {
        refuse(format!(
            "TransmitEnable is {}: 1 to {} bit times are accepted",
            network.transmit_enable_bits, LONGEST_TRANSMIT_ENABLE
        ));
    }
}

fn time_frame(network: &Network, problems: &mut Vec<Problem>) {
    let mut refuse = |what: String| problems.push(Problem { line: None, what });
    if !(1..=LONGEST_CYCLE_US).contains(&network.basic_cycle_us) {
        refuse(format!(
            "BasicCycle is {} us: 1 to {LONGEST_CYCLE_US} us are accepted",
            network.basic_cycle_us
        ));
    }
    if !network.basic_cycles.is_power_of_two() || network.basic_cycles > 64 {
        refuse(format!(
            "BasicCycles is {}: a system matrix has 1, 2, 4, 8, 16, 32 or 64",
            network.basic_cycles
        ));
    }
}

fn names(network: &Network, problems: &mut Vec<Problem>) {
    let mut ids = BTreeMap::new();
    let mut names = BTreeSet::new();
    for message in &network.messages {
        if let Some(other) = ids.insert(message.id, &message.name) {
            problems.push(Problem {
                line: message.line,
                what: format!(
                    "messages {other} and {} have the same identifier {}",
                    message.name, message.id
                ),
            });
        }
        if !names.insert(&message.name) {
            problems.push(Problem {
                line: message.line,
                what: format!("two messages have the name {}", message.name),
            });
        }
        if !network.nodes.iter().any(|n| n.name == message.sender) {
            problems.push(Problem {
                line: message.line,
                what: format!(
                    "the sender {} of message {} is no node of the network",
                    message.sender, message.name
                ),
            });
        }
    }
}

/// The master of rank r sends the reference whose identifier is that of rank 0
/// plus r, within the three low bits (ISO 11898-4).
fn masters(network: &Network, problems: &mut Vec<Problem>) {
    let mut ranks: Vec<_> = network
        .nodes
        .iter()
        .filter_map(|node| Some((node.master_rank?, node)))
        .collect();
    ranks.sort_by_key(|(rank, _)| *rank);
    let references: Vec<&Message> = network
        .messages
        .iter()
        .filter(|message| message.window.kind == WindowKind::Reference)
        .collect();
    let mut refuse = |line, what: String| problems.push(Problem { line, what });
    let Some((_, first)) = ranks.first() else {
        refuse(
            None,
            "no node has a MasterRank: nobody would start a cycle".into(),
        );
        return;
    };
    let Some(base) = references.iter().find(|m| m.sender == first.name) else {
        refuse(
            None,
            format!("the first master {} sends no reference message", first.name),
        );
        return;
    };
    for (index, (rank, node)) in ranks.iter().enumerate() {
        if usize::from(*rank) != index {
            refuse(
                None,
                format!(
                    "node {} has the master rank {rank}: ranks count 0, 1, 2 without a gap, and the next is {index}",
                    node.name
                ),
            );
        }
        let own: Vec<_> = references
            .iter()
            .filter(|m| m.sender == node.name)
            .collect();
        match own.as_slice() {
            [own] => reference(own, base, *rank, &mut refuse),
            _ => refuse(
                None,
                format!(
                    "master {} sends {} reference messages: each master sends one",
                    node.name,
                    own.len()
                ),
            ),
        }
    }
    for message in references {
        if !ranks.iter().any(|(_, node)| node.name == message.sender) {
            refuse(
                message.line,
                format!(
                    "{} sends the reference message {} but has no MasterRank",
                    message.sender, message.name
                ),
            );
        }
    }
}

/// Checks the reference message of the master of rank `rank` against that of rank 0.
fn reference(
    own: &Message,
    base: &Message,
    rank: u8,
    refuse: &mut impl FnMut(Option<usize>, String),
) {
    let id = base.id + u16::from(rank);
    if own.id != id || id >> 3 != base.id >> 3 {
        refuse(
            own.line,
            format!(
                "reference message {} ({}) of the master of rank {rank} must have the identifier {id}, which must equal that of {} but for its three low bits",
                own.name, own.id, base.name
            ),
        );
    }
    if Reference::of(own).is_none() || Reference::of(own) != Reference::of(base) {
        refuse(
            own.line,
            format!(
                "reference message {} needs CycleCount (6 bits), Discontinuity and NextIsGap in one byte from its lowest bit; SystemTime (32 bits) and PreviousStart (16 bits), if it has them, big-endian; and the same layout as {}",
                own.name, base.name
            ),
        );
    }
    if own.length != base.length || own.shortest != base.shortest {
        refuse(
            own.line,
            format!(
                "reference messages {} and {} differ in length",
                base.name, own.name
            ),
        );
    }
}

fn data(network: &Network, message: &Message, problems: &mut Vec<Problem>) {
    let mut owners: BTreeMap<(u16, u8), &Signal> = BTreeMap::new();
    let mut clashes = BTreeSet::new();
    let mut names = BTreeSet::new();
    for signal in &message.signals {
        let of = format!("signal {} of message {}", signal.name, message.name);
        let mut refuse = |what: String| {
            problems.push(Problem {
                line: signal.line,
                what,
            });
        };
        if !names.insert(&signal.name) {
            refuse(format!(
                "message {} has two signals {}",
                message.name, signal.name
            ));
        }
        for index in 0..signal.size {
            match signal.position(index) {
                Some(place) if place.0 < u16::from(message.length) => {
                    if let Some(other) = owners.insert(place, signal)
                        && clashes.insert((other.name.as_str(), signal.name.as_str()))
                    {
                        refuse(format!(
                            "{of} overlaps signal {} in byte {}",
                            other.name, place.0
                        ));
                    }
                }
                _ => {
                    refuse(format!(
                        "{of} does not fit the {} data bytes of its message",
                        message.length
                    ));
                    break;
                }
            }
        }
        range(network, signal, &of, &mut refuse);
    }
}

/// Checks the numbers that a signal may hold, and its receivers.
fn range(network: &Network, signal: &Signal, of: &str, refuse: &mut impl FnMut(String)) {
    if !(signal.factor.is_finite() && signal.factor > 0.0) {
        refuse(format!(
            "{of} has the factor {}: it must be positive",
            signal.factor
        ));
        return;
    }
    let (Some(offset), Some((least, greatest))) = (signal.offset_counts(), signal.count_range())
    else {
        refuse(format!(
            "{of} has an offset or a limit that is no whole number of its factor {}",
            signal.factor
        ));
        return;
    };
    let (raw_least, raw_greatest) = signal.raw_range();
    if least > greatest || least < raw_least + offset || greatest > raw_greatest + offset {
        refuse(format!(
            "{of} has the range {} to {}: its {} bits hold {} to {}",
            signal.min,
            signal.max,
            signal.size,
            signal.physical(raw_least),
            signal.physical(raw_greatest)
        ));
    }
    if i64::try_from(least).is_err() || i64::try_from(greatest).is_err() {
        refuse(format!("{of} exceeds a signed number of 64 bits"));
    }
    if let Some(name) = &signal.values
        && let Some(table) = network.value_tables.iter().find(|t| t.name == *name)
    {
        for value in &table.values {
            if !(least..=greatest).contains(&i128::from(value.raw)) {
                refuse(format!(
                    "value {} ({}) of {of} is outside its range",
                    value.raw, value.name
                ));
            }
        }
    }
    for receiver in &signal.receivers {
        if receiver != crate::network::NOBODY && !network.nodes.iter().any(|n| n.name == *receiver)
        {
            refuse(format!(
                "the receiver {receiver} of {of} is no node of the network"
            ));
        }
    }
}

fn describe(message: &Message, window: Window) -> String {
    format!(
        "message {} ({}) in the window at {} us",
        message.name, message.id, window.start_us
    )
}

fn window(network: &Network, message: &Message, window: Window, problems: &mut Vec<Problem>) {
    let of = describe(message, window);
    let mut refuse = |what: String| {
        problems.push(Problem {
            line: message.line,
            what,
        });
    };
    if window.end_us() > network.basic_cycle_us {
        refuse(format!(
            "{of}: the window ends at {} us, after the basic cycle of {} us",
            window.end_us(),
            network.basic_cycle_us
        ));
    }
    if !window.repeat.is_power_of_two() || window.repeat > network.basic_cycles {
        refuse(format!(
            "{of}: WindowRepeat is {}, but must be a power of two up to the {} basic cycles",
            window.repeat, network.basic_cycles
        ));
    } else if window.offset >= window.repeat {
        refuse(format!(
            "{of}: WindowOffset is {}, but must be less than WindowRepeat {}",
            window.offset, window.repeat
        ));
    }
    let bits = worst_case_bits(message.length);
    let enable = network.latest_begin_bits(message);
    let need = network.needed_us(message);
    if need > window.length_us {
        refuse(format!(
            "{of}: {} us are too short, the longest frame ({bits} bit times), the transmit enable window ({enable}) and {} us of clock error need {need} us",
            window.length_us, network.sync_uncertainty_us
        ));
    }
    match (window.kind, message.send_type) {
        (WindowKind::Reference, _) if window.start_us != 0 || window.repeat != 1 => refuse(
            format!("{of}: a reference message starts every basic cycle, at 0 us"),
        ),
        (WindowKind::Arbitrating, SendType::Cyclic { .. }) => {
            refuse(format!("{of}: a cyclic message needs an exclusive window"))
        }
        (WindowKind::Exclusive, SendType::Event { .. }) => refuse(format!(
            "{of}: an event message needs an arbitrating window"
        )),
        _ => {}
    }
}

/// Checks that the event messages of a node may be sent in the same basic cycles: they wait in one
/// line, and the first one would hold the others.
fn event_cycles(network: &Network, problems: &mut Vec<Problem>) {
    let events = network.messages.iter().enumerate();
    let events = events.filter(|(_, message)| message.window.kind == WindowKind::Arbitrating);
    for (at, message) in events {
        let mut before = network.messages[..at].iter();
        let other = before.find(|other| {
            other.window.kind == WindowKind::Arbitrating
                && other.sender == message.sender
                && (other.window.repeat, other.window.offset)
                    != (message.window.repeat, message.window.offset)
        });
        if let Some(other) = other {
            problems.push(Problem {
                line: message.line,
                what: format!(
                    "{}: WindowRepeat and WindowOffset are {} and {}, but {} and {} for {}: all event messages of {} need the same",
                    describe(message, message.window),
                    message.window.repeat,
                    message.window.offset,
                    other.window.repeat,
                    other.window.offset,
                    other.name,
                    message.sender
                ),
            });
        }
    }
}

/// Checks that a message that may be sent late has an exclusive window, and that there is an arbitrating one to
/// send it in.
fn lateness(network: &Network, message: &Message, problems: &mut Vec<Problem>) {
    if !message.retry_late {
        return;
    }
    let of = describe(message, message.window);
    let mut refuse = |what: &str| {
        problems.push(Problem {
            line: message.line,
            what: format!("{of}: {what}"),
        });
    };
    if message.window.kind != WindowKind::Exclusive {
        refuse("only a message of an exclusive window may have RetryLate");
        return;
    }
    let windows = network.windows();
    let mut arbitrating = windows
        .iter()
        .filter(|window| window.kind == WindowKind::Arbitrating)
        .peekable();
    if arbitrating.peek().is_none() {
        refuse("RetryLate needs an arbitrating window, and there is none");
    } else if arbitrating.any(|window| window.repeat > 1) {
        refuse("RetryLate needs arbitrating windows in every basic cycle");
    }
}

/// Checks that a message's windows come as often as its period says.
fn rate(network: &Network, message: &Message, problems: &mut Vec<Problem>) {
    let of = describe(message, message.window);
    let mut refuse = |what: String| {
        problems.push(Problem {
            line: message.line,
            what,
        });
    };
    let kind = message.window.kind;
    if kind != WindowKind::Exclusive && !message.further.is_empty() {
        refuse(format!(
            "{of}: only an exclusive window may have FurtherWindows"
        ));
        return;
    }
    let period_ms = match message.send_type {
        SendType::Cyclic { period_ms } => period_ms,
        SendType::Event { interval_ms } => {
            if interval_ms == 0 {
                refuse(format!(
                    "{of}: an event message needs a least interval in GenMsgDelayTime"
                ));
            }
            return;
        }
    };
    let cycles = u64::from(network.basic_cycles);
    let matrix_us = u64::from(network.basic_cycle_us) * cycles;
    let times: u64 = message
        .windows()
        .map(|window| cycles / u64::from(window.repeat.max(1)))
        .sum();
    let right = match kind {
        // Rounded up to whole milliseconds, because a basic cycle may have a fraction of one.
        WindowKind::Reference => u64::from(period_ms) == matrix_us.div_ceil(cycles.max(1) * 1000),
        WindowKind::Exclusive | WindowKind::Arbitrating => {
            u64::from(period_ms) * 1000 * times == matrix_us
        }
    };
    if !right {
        refuse(format!(
            "{of}: GenMsgCycleTime is {period_ms} ms, but its window comes every {} ms",
            matrix_us as f64 / 1000.0 / times.max(1) as f64
        ));
    }
}

/// Checks that the windows of the messages that a message needs lie before its own.
fn replacement(network: &Network, message: &Message, problems: &mut Vec<Problem>) {
    let Some(name) = &message.instead_of else {
        return;
    };
    let of = format!("message {} ({})", message.name, message.id);
    let first = network.messages.iter().find(|other| other.name == *name);
    let fits = |first: &Message| {
        let interval = |message: &Message| match message.send_type {
            SendType::Event { interval_ms } => Some(interval_ms),
            SendType::Cyclic { .. } => None,
        };
        first.sender == message.sender
            && first.instead_of.is_none()
            && interval(first).is_some_and(|least| interval(message) >= Some(least))
            && (first.length, first.shortest) == (message.length, message.shortest)
    };
    let what = match first {
        Some(first) if fits(first) => return,
        Some(_) => format!(
            "{of} is sent instead of {name} by its attribute InsteadOf: an event message of the \
             same sender, of the same length, with an interval that is not longer, is accepted"
        ),
        None => format!(
            "{of} is sent instead of {name} by its attribute InsteadOf, but there is no such message"
        ),
    };
    problems.push(Problem {
        line: message.line,
        what,
    });
}

fn precedence(
    network: &Network,
    message: &Message,
    unscheduled: bool,
    problems: &mut Vec<Problem>,
) {
    let of = format!("message {} ({})", message.name, message.id);
    let mut refuse = |what: String| {
        problems.push(Problem {
            line: message.line,
            what,
        });
    };
    if message.preparation_us > LONGEST_CYCLE_US {
        refuse(format!(
            "{of} has the Preparation {} us: 0 to {LONGEST_CYCLE_US} us are accepted",
            message.preparation_us
        ));
        return;
    }
    for name in &message.after {
        let mut messages = network.messages.iter();
        let Some(first) = messages.find(|other| other.name == *name) else {
            refuse(format!(
                "{of} needs {name} by its attribute After, but there is no such message"
            ));
            continue;
        };
        let kinds = [first.window.kind, message.window.kind];
        if kinds.iter().any(|kind| *kind != WindowKind::Exclusive) {
            refuse(format!(
                "{of} needs {name} by its attribute After: both must have exclusive windows"
            ));
            continue;
        }
        let broken = first.windows().any(|needed| {
            let mut own = message.windows();
            own.any(|own| own.shares_cycle(&needed) && own.start_us < needed.end_us())
        });
        if broken && !unscheduled {
            refuse(format!("{of} is scheduled before {name}, which it needs"));
            return;
        }
    }
    let Some(release) = network.release_us(message).filter(|_| !unscheduled) else {
        return;
    };
    let ready = release.saturating_add(message.preparation_us);
    if let Some(early) = message.windows().find(|own| own.start_us < ready) {
        refuse(format!(
            "{of} is scheduled at {} us: what it needs has arrived at {release} us, and its Preparation takes {} us",
            early.start_us, message.preparation_us
        ));
    }
}

fn overlaps(network: &Network, problems: &mut Vec<Problem>) {
    let windows: Vec<(&Message, Window)> = network
        .messages
        .iter()
        .flat_map(|message| message.windows().map(move |window| (message, window)))
        .collect();
    for (index, (message, window)) in windows.iter().enumerate() {
        for (other, of_other) in windows.iter().take(index) {
            let shared = window == of_other && window.kind != WindowKind::Exclusive;
            if !shared && window.overlaps(of_other) {
                problems.push(Problem {
                    line: message.line,
                    what: format!(
                        "the window of message {} ({}), {} to {} us, overlaps that of {} ({}), {} to {} us",
                        message.name,
                        message.id,
                        window.start_us,
                        window.end_us(),
                        other.name,
                        other.id,
                        of_other.start_us,
                        of_other.end_us()
                    ),
                });
            }
        }
    }
}
