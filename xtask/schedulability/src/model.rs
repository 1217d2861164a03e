//! The task model of a node, built from its source, the task table and the network file.

use std::collections::{BTreeMap, BTreeSet};

use network_model::Network;

use crate::arrivals::{Arrivals, Kind, Timetable};
use crate::can::ErrorRate;
use crate::event::Traffic;
use crate::releases::Bus;
use crate::table::{BusEvent, By, Delay, IDLE, INIT, NodeTable, PendedBy, Run, TaskTable};
use crate::tasks::App;
use crate::units::{MICROSECOND, Picoseconds};

/// A task, without its execution time.
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
    /// When its jobs may be released.
    pub arrivals: Arrivals,
    /// Its deadline, for jobs that have none of their own.
    pub deadline: Picoseconds,
    /// Release jitter: how much later than its nominal instant a job may be released.
    pub jitter: Picoseconds,
    /// The task that releases this one.
    pub after: Option<String>,
    /// True if it is released only while the node is off the bus.
    pub off_bus: bool,
    /// True if releases merge: the interrupt has one pending bit, so a release while one is
    /// pending adds no job. Bus handlers are the exception: each job serves one event and is
    /// released again for the next.
    pub coalesces: bool,
    /// True for a software task, which a dispatcher runs.
    pub dispatched: bool,
    /// The identifiers of the frames that its jobs of a kind receive, if only frames release it.
    pub received: BTreeMap<Kind, Vec<u16>>,
}

/// A node, without its execution times.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeModel {
    /// Its name.
    pub name: String,
    /// Path of its source, for messages.
    pub source: String,
    /// The key of the task table that has its tasks' rows, for messages: `node.NAME.task`, or `task`.
    pub rows: String,
    /// Its tasks.
    pub tasks: Vec<TaskModel>,
    /// Whether it sends at once, without a schedule.
    pub event_triggered: bool,
}

/// Where a source and the task table do not fit together.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file}: {}", .fault.sentence(.node))]
pub struct ModelError {
    /// The task table.
    pub file: String,
    /// The node.
    pub node: String,
    /// What is wrong.
    pub fault: ModelFault,
}

/// How a source and the task table can fail to fit together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ModelFault {
    /// The table has a task that the source does not declare.
    Undeclared(String),
    /// The source declares a task that the table does not have.
    Unspecified(String),
    /// No task puts a cyclic message, on an event-triggered bus.
    Unsent(String),
    /// The table's entry of a task is wrong.
    Task {
        /// The task.
        task: String,
        /// What is wrong.
        fault: TaskFault,
    },
}

impl ModelFault {
    fn sentence(&self, node: &str) -> String {
        match self {
            Self::Undeclared(task) => format!(
                "{node} has no task {task} (a handler that is no task of the source needs a `priority`)"
            ),
            Self::Unspecified(task) => {
                format!("task {task} of {node} has no inter-arrival time and deadline")
            }
            Self::Unsent(message) => {
                format!("no task of {node} has {message} in its `sends`")
            }
            Self::Task { task, fault } => format!("task {task} of {node}: {fault}"),
        }
    }
}

/// What can be wrong with the table's entry of a task.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TaskFault {
    /// `after` names no task.
    #[error("`after` names {0}, which is no task")]
    After(String),
    /// Tasks name each other in `after`, so that none of them has a release of its own.
    #[error("`after` leads back to it ({0}), so nothing releases it: name the task that pends it")]
    AfterItself(String),
    /// `pended_by` names no task.
    #[error("`pended_by` names {0}, which is neither a task nor init or idle")]
    PendedBy(String),
    /// Tasks pend each other, each in every job.
    #[error(
        "`pended_by` says \"each\" in a loop ({0}), so nothing bounds how often it runs: one of them needs {{ every_us = N, because = \"...\" }}"
    )]
    PendsInLoop(String),
    /// `receives` names a message that no other node sends.
    #[error("no other node sends a message {0}")]
    NotReceived(String),
    /// `by` names a message that this node does not send.
    #[error("it sends no message {0}")]
    NotSent(String),
    /// Another task puts the same message.
    #[error("another task has {0} in its `sends` too")]
    SentTwice(String),
    /// The rate of its messages is not known.
    #[error("it `sends` messages, so one stream of releases is accepted, but it has more")]
    SeveralStreams,
    /// It is released too late for the message that it has to prepare.
    #[error("it is released after the window of {0} has begun")]
    TooLate(String),
    /// The times that follow from other files are not put in yet.
    #[error("the distance of its releases is not resolved")]
    Unresolved,
    /// It has a priority in the source and in the table.
    #[error("its `priority` stands in the source")]
    Priority,
    /// It has no deadline.
    #[error("it has no deadline")]
    NoDeadline,
}

impl NodeModel {
    /// Builds the model of node `name` on a bus with disturbed frames. `file` names the task table in error
    /// messages.
    ///
    /// # Errors
    /// A task is in the source or in the table but not in both, or the table names something
    /// that does not exist.
    pub fn new(
        name: &str,
        app: &App,
        table: &NodeTable,
        (network, errors): (&Network, ErrorRate),
        file: &str,
    ) -> Result<Self, ModelError> {
        let bus = Bus::new(network, name, table.board.transmit_lead)
            .with_errors(errors)
            .with_priorities_apart(apart(&present(app, table), table));
        let mut model = Self::with(name, app, table, file, |entry| {
            Ok((arrivals(entry, bus)?, deadline(entry, bus)?))
        })?;
        for task in &mut model.tasks {
            let row = table.task.get(&task.name);
            if row.is_some_and(|row| row.on.as_slice() == [BusEvent::FrameReceived]) {
                task.received = bus.received();
            }
        }
        Ok(model)
    }

    /// The model of an application whose releases and deadlines do not depend on a bus. The rows of its
    /// tasks are under `rows` in the table.
    ///
    /// # Errors
    /// As [`NodeModel::new`].
    pub fn without_bus(
        name: &str,
        app: &App,
        table: &NodeTable,
        file: &str,
        rows: &str,
    ) -> Result<Self, ModelError> {
        let model = Self::with(name, app, table, file, |entry| {
            let arrivals = Arrivals {
                sporadic: entry.sporadic().ok_or(TaskFault::Unresolved)?,
                apart: entry.apart(),
                ..Arrivals::default()
            };
            let deadline = entry.deadline_us.ok_or(TaskFault::NoDeadline)?;
            Ok((arrivals, deadline * MICROSECOND))
        })?;
        Ok(Self {
            rows: rows.to_owned(),
            ..model
        })
    }

    /// The same for a node that sends at once. [`NodeModel::take_arrivals`] puts in what changes with
    /// the traffic.
    ///
    /// # Errors
    /// As [`NodeModel::new`].
    pub fn event_triggered(
        name: &str,
        app: &App,
        table: &NodeTable,
        traffic: &Traffic,
        file: &str,
    ) -> Result<Self, ModelError> {
        let model = Self::with(name, app, table, file, |entry| {
            Ok((
                traffic.arrivals(name, entry)?,
                traffic.deadline(name, entry)?,
            ))
        })?;
        Ok(Self {
            event_triggered: true,
            ..model
        })
    }

    /// Takes over the releases that follow from this traffic.
    ///
    /// # Errors
    /// The table names something that does not exist.
    pub fn take_arrivals(
        &mut self,
        table: &NodeTable,
        traffic: &Traffic,
        file: &str,
    ) -> Result<(), ModelError> {
        let wrong = |task: &str, fault| ModelError {
            file: file.to_owned(),
            node: self.name.clone(),
            fault: ModelFault::Task {
                task: task.to_owned(),
                fault,
            },
        };
        for task in &mut self.tasks {
            let Some(entry) = table.task.get(&task.name) else {
                continue;
            };
            let arrivals = traffic.arrivals(&self.name, entry);
            task.arrivals = arrivals.map_err(|fault| wrong(&task.name, fault))?;
        }
        add_pends(&mut self.tasks, table).map_err(|(task, fault)| wrong(&task, fault))
    }

    fn with(
        name: &str,
        app: &App,
        table: &NodeTable,
        file: &str,
        timing: impl Fn(&TaskTable) -> Result<(Arrivals, Picoseconds), TaskFault>,
    ) -> Result<Self, ModelError> {
        let wrong = |fault: ModelFault| ModelError {
            file: file.to_owned(),
            node: name.to_owned(),
            fault,
        };
        let app = &present(app, table);
        let declared = declared(app, table).map_err(wrong)?;
        let is_declared = |task: &str| declared.iter().any(|(name, ..)| *name == task);
        if let Some(extra) = table.task.keys().find(|task| !is_declared(task)) {
            return Err(wrong(ModelFault::Undeclared(extra.clone())));
        }
        let mut tasks = Vec::new();
        for &(task, interrupt, priority) in &declared {
            let entry = table
                .task
                .get(task)
                .ok_or_else(|| wrong(ModelFault::Unspecified(task.to_owned())))?;
            let of_task = |fault: TaskFault| {
                wrong(ModelFault::Task {
                    task: task.to_owned(),
                    fault,
                })
            };
            if let Some(after) = entry.after.as_deref().filter(|after| !is_declared(after)) {
                return Err(of_task(TaskFault::After(after.to_owned())));
            }
            let mut penders = entry.pended_by.keys();
            let is_pender =
                |name: &String| is_declared(name) || [INIT, IDLE].contains(&name.as_str());
            if let Some(unknown) = penders.find(|name| !is_pender(name)) {
                return Err(of_task(TaskFault::PendedBy(unknown.clone())));
            }
            let (arrivals, deadline) = timing(entry).map_err(of_task)?;
            let of_app = app.tasks.iter().find(|of_app| of_app.name == task);
            tasks.push(TaskModel {
                name: task.to_owned(),
                interrupt: interrupt.to_owned(),
                priority,
                line: of_app.map(|of_app| of_app.line),
                locks: of_app.map_or_else(Vec::new, |of_app| of_app.locks.clone()),
                arrivals,
                deadline,
                jitter: entry.jitter_us * MICROSECOND,
                after: entry.after.clone(),
                off_bus: entry.off_bus,
                received: BTreeMap::new(),
                coalesces: entry.on.as_slice().is_empty()
                    && (task == interrupt || of_app.is_some_and(|of_app| of_app.binds.is_some())),
                dispatched: task != interrupt && of_app.is_none_or(|of_app| of_app.binds.is_none()),
            });
        }
        if let Some((task, fault)) = after_itself(&tasks) {
            return Err(wrong(ModelFault::Task { task, fault }));
        }
        add_pends(&mut tasks, table)
            .map_err(|(task, fault)| wrong(ModelFault::Task { task, fault }))?;
        tasks.sort_by_key(|task| std::cmp::Reverse(task.priority));
        Ok(Self {
            name: name.to_owned(),
            source: String::new(),
            rows: format!("node.{name}.task"),
            tasks,
            event_triggered: false,
        })
    }
}

/// Name, interrupt and priority of each task: those of the source, the timer's, and the handlers to
/// which the table gives a priority.
fn declared<'a>(
    app: &'a App,
    table: &'a NodeTable,
) -> Result<Vec<(&'a str, &'a str, u32)>, ModelFault> {
    let of_app = app.tasks.iter().map(|task| {
        let interrupt = app.interrupt(task).unwrap_or(&task.name);
        (task.name.as_str(), interrupt, task.priority)
    });
    let timer = app.timer.as_ref().map(|timer| {
        let name = timer.interrupt.as_str();
        (name, name, timer.priority)
    });
    let mut declared: Vec<_> = of_app.chain(timer).collect();
    for (handler, entry) in &table.task {
        let Some(priority) = entry.priority else {
            continue;
        };
        let mut known = declared.iter();
        if known.any(|(name, interrupt, _)| [name, interrupt].contains(&&handler.as_str())) {
            return Err(ModelFault::Task {
                task: handler.clone(),
                fault: TaskFault::Priority,
            });
        }
        declared.push((handler, handler, priority));
    }
    Ok(declared)
}

/// The application without the tasks with `#[cfg]` that the table does not have. One that the image has all the same is
/// found as a handler that is no task.
fn present(app: &App, table: &NodeTable) -> App {
    let mut app = app.clone();
    app.keep_present(|task| table.task.contains_key(&task.name));
    app
}

/// Whether the tasks that are released by the ends of own frames and by the window timer have different
/// priorities.
fn apart(app: &App, table: &NodeTable) -> bool {
    let of_link = |task: &str| {
        let entry = table.task.get(task);
        let on = entry.map_or(&[][..], |entry| entry.on.as_slice());
        on.contains(&BusEvent::FrameSent) || on.contains(&BusEvent::WindowEdge)
    };
    let tasks = declared(app, table).unwrap_or_default();
    let priorities = tasks.iter().filter(|(name, ..)| of_link(name));
    let priorities: BTreeSet<u32> = priorities.map(|(.., priority)| *priority).collect();
    priorities.len() > 1
}

/// The first task that `after` leads back to.
fn after_itself(tasks: &[TaskModel]) -> Option<(String, TaskFault)> {
    let after = |name: &str| {
        let named = tasks.iter().find(|task| task.name == name);
        named.and_then(|task| task.after.as_deref())
    };
    tasks.iter().find_map(|task| {
        let first = task.name.as_str();
        let mut way = vec![first];
        // Another loop may be on the way: it is that of its own tasks.
        while way.len() <= tasks.len() {
            let next = after(way.last()?)?;
            way.push(next);
            if next == first {
                let fault = TaskFault::AfterItself(way.join(" after "));
                return Some((task.name.clone(), fault));
            }
        }
        None
    })
}

/// Adds to the releases of each task those of the tasks that pend it in each of their jobs. A pend
/// comes after the release of the job, and before its deadline.
///
/// # Errors
/// The task at fault, if tasks pend each other so.
fn add_pends(tasks: &mut [TaskModel], table: &NodeTable) -> Result<(), (String, TaskFault)> {
    let each = |task: &TaskModel| -> Vec<String> {
        let pended_by = table.task.get(&task.name).map(|entry| &entry.pended_by);
        let penders = pended_by.into_iter().flatten();
        penders
            .filter(|(_, how)| matches!(how, PendedBy::Run(Run::Each)))
            .map(|(pender, _)| pender.clone())
            .collect()
    };
    let mut missing: BTreeMap<String, Vec<String>> = tasks
        .iter()
        .map(|task| (task.name.clone(), each(task)))
        .collect();
    while !missing.is_empty() {
        // A task whose penders all have their releases.
        let is_next = |penders: &Vec<String>| penders.iter().all(|one| !missing.contains_key(one));
        let next = missing.iter().find(|(_, penders)| is_next(penders));
        let Some(next) = next.map(|(task, _)| task.clone()) else {
            return Err(pends_in_loop(&missing));
        };
        for pender in missing.remove(&next).unwrap_or_default() {
            let mut all = tasks.iter();
            let of_pender = all.find(|task| task.name == pender).map(|task| {
                let late = task.jitter.saturating_add(task.deadline);
                task.arrivals.delayed(late)
            });
            let mut all = tasks.iter_mut();
            if let (Some(task), Some(added)) = (all.find(|task| task.name == next), of_pender) {
                // What the table says of any two releases holds for these, too.
                let apart = task.arrivals.apart;
                task.arrivals = std::mem::take(&mut task.arrivals).merged(&added);
                task.arrivals.apart = apart;
            }
        }
    }
    Ok(())
}

/// A loop among tasks of which each has a pender that is one of them.
fn pends_in_loop(missing: &BTreeMap<String, Vec<String>>) -> (String, TaskFault) {
    let mut path: Vec<&str> = Vec::new();
    let mut at = missing.keys().next().map(String::as_str);
    while let Some(task) = at {
        if let Some(begin) = path.iter().position(|known| *known == task) {
            path.drain(..begin);
            break;
        }
        path.push(task);
        let penders = missing.get(task).into_iter().flatten();
        let mut penders = penders.map(String::as_str);
        at = penders.find(|pender| missing.contains_key(*pender));
    }
    let first = path.first().copied().unwrap_or_default();
    let shown: Vec<&str> = path
        .iter()
        .rev()
        .copied()
        .chain(path.last().copied())
        .collect();
    (first.to_owned(), TaskFault::PendsInLoop(shown.join(" -> ")))
}

/// When the jobs of a task may be released.
fn arrivals(entry: &TaskTable, bus: Bus<'_>) -> Result<Arrivals, TaskFault> {
    let mut all = Arrivals {
        sporadic: entry.sporadic().ok_or(TaskFault::Unresolved)?,
        apart: entry.apart(),
        ..Arrivals::default()
    };
    let mut tables: Vec<Timetable> = Vec::new();
    for event in entry.on.as_slice() {
        match event {
            BusEvent::FrameReceived => tables.extend(bus.frames(false)),
            BusEvent::FrameSent => {
                tables.extend(bus.frames(true));
                tables.extend(bus.frames_again());
                tables.extend(bus.disturbed_references());
                tables.extend(bus.attempts());
                tables.extend(bus.disturbed_attempts());
                tables.extend(bus.withdrawn());
            }
            BusEvent::WindowEdge => {
                tables.extend(bus.window_edges());
                // When an attempt to send an event message ends, the next attempt follows.
                tables.extend(bus.attempts());
                tables.extend(bus.disturbed_attempts());
                tables.extend(bus.withdrawn());
            }
            BusEvent::EventQueued => tables.extend(bus.events_queued()),
        }
    }
    for message in entry.receives.as_slice() {
        let mut table = bus
            .message(message)
            .ok_or_else(|| TaskFault::NotReceived(message.clone()))?;
        if let Some(Delay::Us(us)) = entry.delay {
            // The delay begins when the message has been handled: between its reception and
            // the deadline for handling it.
            for job in &mut table.jobs {
                job.earliest += us * MICROSECOND;
                job.latest += us * MICROSECOND + bus.fifo_margin().max(bus.event_margin());
            }
        }
        tables.push(table);
    }
    if !entry.at_us.as_slice().is_empty() {
        tables.push(bus.marks(entry.at_us.as_slice()));
    }
    if entry.deadline_us.is_some() && entry.by.is_some() {
        let by = by(entry, bus)?;
        for job in tables.iter_mut().flat_map(|table| &mut table.jobs) {
            job.deadline.get_or_insert(by);
        }
    }
    all.timed = tables;
    Ok(all)
}

/// The deadline of a task; where it has two, that of its releases at any time.
fn deadline(entry: &TaskTable, bus: Bus<'_>) -> Result<Picoseconds, TaskFault> {
    match entry.deadline_us {
        Some(us) => Ok(us * MICROSECOND),
        None => by(entry, bus),
    }
}

/// The deadline that follows from the network file.
fn by(entry: &TaskTable, bus: Bus<'_>) -> Result<Picoseconds, TaskFault> {
    match &entry.by {
        Some(By::WindowEnd) => Ok(bus.after_frame().min(3 * bus.spacing(false))),
        Some(By::Window) => Ok(bus.fifo_margin()),
        Some(By::Message(message)) => {
            let due = bus
                .due(message)
                .ok_or_else(|| TaskFault::NotSent(message.clone()))?;
            let released = entry.at_us.as_slice().iter().max().copied().unwrap_or(0) * MICROSECOND;
            due.checked_sub(released)
                .ok_or_else(|| TaskFault::TooLate(message.clone()))
        }
        None => Err(TaskFault::NoDeadline),
    }
}
