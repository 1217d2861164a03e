//! The tasks of a node: source, task table and network file put together.

use std::collections::BTreeMap;

use network_model::Network;

use crate::arrivals::{Arrivals, Kind, Sporadic, Timetable};
use crate::releases::Bus;
use crate::results::{MICROSECOND, Picoseconds};
use crate::system::InputError;
use crate::table::{BusEvent, By, NodeTable, TaskTable};
use crate::tasks::{App, TIMER};

/// A task without its cost.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TaskModel {
    /// Its name.
    pub name: String,
    /// Interrupt that runs it.
    pub interrupt: String,
    /// Its priority.
    pub priority: u32,
    /// Line of its attribute in the source; `None` for the timer.
    pub line: Option<u32>,
    /// Shared resources that it locks.
    pub locks: Vec<String>,
    /// When it may be released.
    pub arrivals: Arrivals,
    /// Its deadline, of releases that have none of their own.
    pub deadline: Picoseconds,
    /// How much later than its nominal instant it may be released.
    pub jitter: Picoseconds,
    /// The task that releases it.
    pub after: Option<String>,
    /// Whether it is released only while the node is off the bus.
    pub off_bus: bool,
    /// Whether a release is no job of its own while another one is pending: an
    /// interrupt of its own runs it, and its handler serves all there is. Those
    /// of the bus do one thing and come again.
    pub coalesces: bool,
    /// Whether a dispatcher runs it.
    pub dispatched: bool,
    /// Functions that jobs of a kind never call.
    pub never: BTreeMap<Kind, Vec<String>>,
}

/// A node without its costs.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeModel {
    /// Its name.
    pub name: String,
    /// Its source.
    pub source: String,
    /// Its tasks.
    pub tasks: Vec<TaskModel>,
}

impl NodeModel {
    /// Puts the model of `name` together; `file` names the task table in errors.
    ///
    /// # Errors
    /// A task is in one of the two and not in the other, or the table names
    /// something that is nowhere.
    pub fn new(
        name: &str,
        app: &App,
        table: &NodeTable,
        network: &Network,
        file: &str,
    ) -> Result<Self, InputError> {
        let mut declared: Vec<(&str, &str, u32)> = app
            .tasks
            .iter()
            .map(|task| {
                let interrupt = app.interrupt(task).unwrap_or(&task.name);
                (task.name.as_str(), interrupt, task.priority)
            })
            .collect();
        if app.has_timer() {
            declared.push((TIMER, TIMER, app.timer_priority()));
        }
        let is_declared = |task: &str| declared.iter().any(|(name, ..)| *name == task);
        if let Some(extra) = table.task.keys().find(|task| !is_declared(task)) {
            return Err(InputError(format!("{file}: {name} has no task {extra}")));
        }
        let bus = Bus::new(network, name, table.transmit_lead_us * MICROSECOND);
        let mut tasks = Vec::new();
        for &(task, interrupt, priority) in &declared {
            let entry = table.task.get(task).ok_or_else(|| {
                InputError(format!(
                    "{file}: task {task} of {name} has no inter-arrival time and deadline"
                ))
            })?;
            let wrong = |what: String| InputError(format!("{file}: task {task} of {name}: {what}"));
            if let Some(after) = entry.after.as_deref().filter(|after| !is_declared(after)) {
                return Err(wrong(format!("`after` names {after}, which is no task")));
            }
            let of_app = app.tasks.iter().find(|of_app| of_app.name == task);
            tasks.push(TaskModel {
                name: task.to_owned(),
                interrupt: interrupt.to_owned(),
                priority,
                line: of_app.map(|of_app| of_app.line),
                locks: of_app.map_or_else(Vec::new, |of_app| of_app.locks.clone()),
                arrivals: arrivals(entry, bus).map_err(wrong)?,
                deadline: deadline(entry, bus).map_err(wrong)?,
                jitter: entry.jitter_us * MICROSECOND,
                after: entry.after.clone(),
                off_bus: entry.off_bus,
                never: entry.never.clone(),
                coalesces: entry.on.as_slice().is_empty()
                    && (task == interrupt || of_app.is_some_and(|of_app| of_app.binds.is_some())),
                dispatched: task != interrupt && of_app.is_none_or(|of_app| of_app.binds.is_none()),
            });
        }
        tasks.sort_by_key(|task| std::cmp::Reverse(task.priority));
        Ok(Self {
            name: name.to_owned(),
            source: String::new(),
            tasks,
        })
    }
}

fn arrivals(entry: &TaskTable, bus: Bus<'_>) -> Result<Arrivals, String> {
    let mut all = Arrivals {
        sporadic: entry
            .every_us
            .as_slice()
            .iter()
            .map(|every| Sporadic {
                period: every * MICROSECOND,
                limit: entry
                    .at_most
                    .map(|most| (most.jobs, most.in_us * MICROSECOND)),
            })
            .collect(),
        timed: Vec::new(),
    };
    let mut tables: Vec<Timetable> = Vec::new();
    for event in entry.on.as_slice() {
        match event {
            BusEvent::FrameReceived => tables.extend(bus.frames(false)),
            BusEvent::FrameSent => {
                tables.extend(bus.frames(true));
                tables.extend(bus.attempts());
                tables.extend(bus.withdrawn());
            }
            BusEvent::WindowEdge => {
                tables.extend(bus.window_edges());
                // What follows the end of an attempt to send an event message: the next.
                tables.extend(bus.attempts());
                tables.extend(bus.withdrawn());
            }
            BusEvent::EventQueued => tables.extend(bus.events_queued()),
        }
    }
    for message in entry.receives.as_slice() {
        let mut table = bus
            .message(message)
            .ok_or_else(|| format!("no other node sends a message {message}"))?;
        if entry.delay_us > 0 {
            // The message has been taken by its deadline when the delay begins.
            for job in &mut table.jobs {
                job.earliest += entry.delay_us * MICROSECOND;
                job.latest += entry.delay_us * MICROSECOND + bus.leisure();
            }
        }
        tables.push(table);
    }
    if !entry.at_us.as_slice().is_empty() {
        tables.push(bus.marks(entry.at_us.as_slice()));
    }
    all.timed = tables;
    Ok(all)
}

fn deadline(entry: &TaskTable, bus: Bus<'_>) -> Result<Picoseconds, String> {
    match (&entry.by, entry.deadline_us) {
        (Some(By::WindowEnd), _) => Ok(bus.after_frame().min(3 * bus.spacing(false))),
        (Some(By::Window), _) => Ok(bus.leisure()),
        (Some(By::Message(message)), _) => {
            let due = bus
                .due(message)
                .ok_or_else(|| format!("it sends no message {message}"))?;
            let released = entry.at_us.as_slice().iter().max().copied().unwrap_or(0) * MICROSECOND;
            due.checked_sub(released)
                .ok_or_else(|| format!("it is released after the window of {message} has begun"))
        }
        (None, Some(us)) => Ok(us * MICROSECOND),
        (None, None) => Err("it has no deadline".to_owned()),
    }
}
