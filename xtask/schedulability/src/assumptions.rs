//! Assumptions on which the answers rest, as sentences for the report.

use std::collections::{BTreeMap, BTreeSet};

use network_model::Network;

use crate::foreign::Foreign;
use crate::models::Models;
use crate::results::NodeReport;
use crate::table::{LoopBound, PendedBy};
use crate::units::time;

/// Something taken for granted, and what a run shows of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Assumption {
    /// What is taken for granted, and who makes sure of it.
    pub granted: &'static str,
    /// What an observed run shows of it; empty if that is nothing.
    pub watched: &'static str,
}

impl Assumption {
    /// Both, for a report of which runs are part.
    #[must_use]
    pub fn of_a_run(&self) -> String {
        format!("{} {}", self.granted, self.watched)
            .trim_end()
            .to_owned()
    }
}

/// Assumptions that hold for every program.
pub const OF_ANY_PROGRAM: [Assumption; 3] = [
    Assumption {
        granted: "If start-up leaves an address in a word of memory, and no store of any handler can reach that word, it keeps the address. If all stores that can reach a word store a few addresses, it holds one of them, and where it is used as an address, it is not null. Three things are taken for granted here: an unknown index stays within its array; an unresolved pointer (as a reference that a variable, a software task's future or the timer queue keeps) does not lead to such a word, nor to the one on the stack in which a function keeps what it found in BASEPRI or PRIMASK; and DMA writes only to variables whose address was given to a peripheral. A number that start-up leaves counts as an address if there is memory at it. Who writes the application makes sure of them.",
        watched: "The observed runs fail at a store to such a word, or of anything else to one with a few addresses, and at a handler that leaves another BASEPRI.",
    },
    Assumption {
        granted: "While a deadline counts, nothing erases or programs the flash, the core does not sleep deeply, and the lazy saving of floating-point registers stays as reset leaves it. Who writes the application makes sure.",
        watched: "",
    },
    Assumption {
        granted: "An interrupt that is requested again while it is pending runs once, and its handler serves both requests. A bus handler serves one event at a time and is released again while more are left. Who writes the handlers makes sure.",
        watched: "The observed runs count their activations.",
    },
];

/// What is taken for granted of a flash that is read ahead.
pub const READING_AHEAD: &str = "Flash: start-up switches on the reading ahead, and the caches of a part that has them. A read that has begun is not cancelled. A line is taken to be in a cache only if it was put there in the same job and fewer other lines were used since than the cache has, of which the one unused for longest is replaced (RM0390 3.4.2); a preemption costs the preempted job all lines that it reuses. Who chooses the part makes sure that its flash does so.";

/// What is taken for granted of transfers by DMA at the rates of the task table.
const TRANSFERS: &str = "SRAM is read and written without wait states. A transfer by DMA keeps the core from RAM once and from a peripheral once, each for one access of the other and the change of the master: who chooses the part makes sure. No transfer reads the flash, and none comes more often than the task table says: who writes the program and the table makes sure; an observed run that shows one fails. No debugger is connected: who builds the vehicle makes sure.";

/// Assumptions that hold for every vehicle.
const ALWAYS: [&str; 2] = [
    "In the 10 ms after a start of a node its deadlines need not hold: it takes the frames that came before, of which its FIFO keeps three, and sends nothing. Who writes the application makes sure that nothing moves in that time.",
    "An event message is sent at most once in each of its intervals. A task is not released more often than the task table says. Who writes the network file and the table makes sure; an observed run with more releases fails. The table omits no task that pends another one, if no unresolved pointer leads to the interrupt controller: who writes unsafe code makes sure.",
];

/// Assumption about a program with software tasks.
pub const OF_SOFTWARE_TASKS: Assumption = Assumption {
    granted: "The executor and the timer queue of the software tasks call only functions whose address stands in the image. A waker has its functions in a constant table. A software task waits for one instant at a time, and no other code waits by the timer: who writes it makes sure.",
    watched: "An observed run that calls another function fails, and so does one in which a task that is the only one that may wait finds another in the queue.",
};

/// Assumptions about a bus without a schedule.
const EVENT_TRIGGERED: [&str; 3] = [
    "The bus is event-triggered. A message is put by the task that `sends` it in the task table, at most once in a job and in that order; the jitter of both is inherited along the chain (Tindell and Clark 1994). Frames arbitrate by identifier (Davis et al. 2007).",
    "A node has three mailboxes, of which the lowest identifier competes first. If it has more messages, a less urgent frame of another node may begin until its transmit interrupt has loaded the next one; the bounds include that.",
    "Only the nodes of the network file send, and the foreign messages that are named, none of them off its rate: a babbling node is not covered. Who builds the vehicle makes sure.",
];

/// What is taken for granted of the foreign messages.
fn foreign(models: &Models) -> Option<String> {
    let one = |foreign: &Foreign| {
        let Foreign { id, length, .. } = foreign;
        match (models.event_triggered, foreign.jitter_us) {
            (false, _) => format!("{id} ({length} bytes)"),
            (true, 0) => format!("{id} ({length} bytes each {} us)", foreign.period_us),
            (true, late) => format!(
                "{id} ({length} bytes each {} us, up to {late} us late)",
                foreign.period_us
            ),
        }
    };
    let all: Vec<String> = models.foreign.iter().map(one).collect();
    let all = match all.as_slice() {
        [] => return None,
        all => all.join(", "),
    };
    Some(if models.event_triggered {
        format!(
            "Foreign messages: {all}. Each competes with its identifier when it is put; no frame is sent \
             after three of its periods. Who builds their nodes makes sure."
        )
    } else {
        format!(
            "Foreign messages: {all}. Their nodes keep the schedule: they have windows in the longest stretch \
             of the basic cycle that belongs to no message of the vehicle, and send only there. Who builds \
             these nodes makes sure."
        )
    })
}

/// All assumptions behind the answers for `nodes`, one sentence or a few for each.
#[must_use]
pub fn of(models: &Models, nodes: &[NodeReport]) -> Vec<String> {
    let network = &models.network;
    let mut all = if models.event_triggered {
        EVENT_TRIGGERED.map(str::to_owned).to_vec()
    } else {
        vec![format!(
            "Every frame is in its window: it begins at most {} after the window's mark, and two clocks differ by at most {} us. Only the nodes of the network file send: a foreign frame would release the receive interrupt of each node once more. Who builds the vehicle makes sure of both.",
            time(u64::from(network.transmit_enable_bits) * u64::from(network.bit_time_ns()) * 1000),
            network.sync_uncertainty_us
        )]
    };
    all.extend(foreign(models));
    all.extend(OF_ANY_PROGRAM.iter().map(Assumption::of_a_run));
    all.extend([READING_AHEAD, TRANSFERS].map(str::to_owned));
    all.extend(ALWAYS.map(str::to_owned));
    all.push(errors(models));
    let mut tasks = models.nodes.iter().flat_map(|(model, _)| &model.tasks);
    if tasks.any(|task| task.dispatched) {
        all.push(OF_SOFTWARE_TASKS.of_a_run());
    }
    all.extend(pended(models));
    for (model, table) in &models.nodes {
        let runs = format!(
            "{} runs at {} MHz",
            model.name,
            table.core_hz() as f64 / 1e6
        );
        all.push(if !sends(network, &model.name) {
            runs + " and sends nothing."
        } else if models.event_triggered {
            runs + "."
        } else {
            let lead = time(table.board.transmit_lead);
            format!("{runs} and starts a transmission {lead} before its time mark.")
        });
    }
    let tasks = nodes.iter().flat_map(|node| &node.tasks);
    all.extend(annotated(nodes, true, &models.table.bounds));
    all.extend(summarised(nodes, true));
    let panics: usize = tasks.map(|task| task.panics.len()).sum();
    if panics > 0 {
        let sending = nodes.iter().any(|node| sends(network, &node.name));
        // A bus guardian alone has no motor, and no say in one.
        let after = match sending {
            true => ", after which the motors are stopped: who writes the panic handler makes sure",
            false => "",
        };
        let panics = match panics {
            1 => "a panic".to_owned(),
            more => format!("{more} panics"),
        };
        all.push(format!(
            "The image does not prove {panics} impossible. A path is charged up to its panic{after}."
        ));
    }
    all
}

/// Whether a node sends a message of the network file. A bus guardian sends none.
fn sends(network: &Network, node: &str) -> bool {
    let mut messages = network.messages.iter();
    messages.any(|message| message.sender.eq_ignore_ascii_case(node))
}

/// The annotations that the bounds of these nodes rest on, one sentence each. `watched` if there are observed
/// runs. The reasons of those in a task table are in `bounds`.
#[must_use]
pub fn annotated(
    nodes: &[NodeReport],
    watched: bool,
    bounds: &BTreeMap<String, LoopBound>,
) -> Vec<String> {
    let tasks = nodes.iter().flat_map(|node| &node.tasks);
    let annotated: BTreeMap<&str, u64> = tasks
        .flat_map(|task| &task.annotated)
        .chain(nodes.iter().flat_map(|node| &node.idle_annotated))
        .map(|(place, bound)| (place.as_str(), *bound))
        .collect();
    let sentence = |(place, bound): (&str, u64)| {
        let what = match place.strip_suffix(", in all") {
            Some(place) => format!("The statement at {place} runs at most {bound} times in a job"),
            None => format!("The loop at {place} takes at most {bound} turns"),
        };
        let watched = if watched {
            "; an observed run with more fails"
        } else {
            ""
        };
        match bounds.get(place) {
            Some(bound) => {
                let because = bound.reason();
                format!("{what}: {because}. Who writes the task table makes sure{watched}.")
            }
            None => format!("{what}, as its annotation says. Who wrote it makes sure{watched}."),
        }
    };
    annotated.into_iter().map(sentence).collect()
}

/// How many disturbed frames are allowed for.
fn errors(models: &Models) -> String {
    let rate = models.errors;
    match (rate.is_none(), models.event_triggered) {
        (true, true) => "No frame is disturbed.".to_owned(),
        (true, false) => "No frame is disturbed. A frame in an exclusive window is not repeated: if it is disturbed, it is lost.".to_owned(),
        (false, true) => format!("The bus has {rate}, in one burst or apart. Each costs 31 bits at most, and is repeated, with what follows from it. What errors release on the processors is counted. Who builds the vehicle makes sure of the rate; an observed run that keeps it and has more releases fails."),
        (false, false) => format!("The bus has {rate}, in one burst or apart. Each costs 31 bits at most. It is repeated in an arbitrating window, and by the time master if it is a reference message. In an exclusive window it is lost, and the frame of the next cycle takes its place; an end-to-end time is said with it and without. What errors release on the processors is counted. Who builds the vehicle makes sure of the rate; an observed run that keeps it and has more releases fails."),
    }
}

/// How often tasks pend each other, and why, as the table says; equal sentences of several nodes are
/// one.
fn pended(models: &Models) -> BTreeSet<String> {
    let mut pended: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    for (model, table) in &models.nodes {
        for (task, entry) in &table.task {
            for (pender, how) in &entry.pended_by {
                let PendedBy::Bounded(bounded) = how else {
                    continue;
                };
                let what = format!(
                    "{pender} pends {task} {}: {}",
                    bounded.often(),
                    bounded.because.trim_end_matches('.')
                );
                pended.entry(what).or_default().push(&model.name);
            }
        }
    }
    let pended = pended.into_iter();
    pended
        .map(|(what, nodes)| {
            format!(
                "{what}. This holds on {}. Who writes the task table makes sure; an observed run with more \
                 releases fails.",
                nodes.join(", ")
            )
        })
        .collect()
}

/// The loops whose bounds the tool knows, in one sentence. `watched` if there are observed runs.
#[must_use]
pub fn summarised(nodes: &[NodeReport], watched: bool) -> Option<String> {
    let tasks = nodes.iter().flat_map(|node| &node.tasks);
    let mut all: BTreeMap<&str, u64> = BTreeMap::new();
    let known = tasks
        .flat_map(|task| &task.summarised)
        .chain(nodes.iter().flat_map(|node| &node.idle_summarised));
    for (what, bound) in known {
        let most = all.entry(what).or_default();
        *most = (*most).max(*bound);
    }
    let all: Vec<String> = all
        .into_iter()
        .map(|(what, bound)| format!("{what} ({bound})"))
        .collect();
    let watched = if watched {
        "; an observed run with more turns fails"
    } else {
        ""
    };
    (!all.is_empty()).then(|| {
        format!(
            "The most turns of these loops follow from what they are, not from an annotation: {}. The analysis \
             makes sure{watched}.",
            all.join("; ")
        )
    })
}
