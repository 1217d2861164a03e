//! `cargo deadlines init`: a first task table, with questions where a value cannot be found.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use schedulability::execution::Execution;
use schedulability::model::NodeModel;
use schedulability::pends::{Found, Pender};
use schedulability::table::{IDLE, INIT};
use schedulability::tasks::Task;

use crate::app::Source;
use crate::parts::{self, PartFile};
use crate::table::QUESTION;

/// What is known of the part.
pub struct OnPart<'a> {
    /// Its name, if one was given.
    pub name: Option<&'a str>,
    /// Its file, if there is one of this name.
    pub file: Option<&'a PartFile>,
    /// The clock of the core, if one was given.
    pub core_hz: Option<u32>,
}

/// The handlers that are no task of the source but may be in the image: a monotonic's, say. Each with the
/// priority that the image gives it, if that is known.
pub type Handlers = BTreeMap<String, Option<u32>>;

/// The text of a table for an application. `model` and `execution` are of a trial run, in which each task
/// has a row; they tell who pends whom.
#[must_use]
pub fn table(
    source: &Source,
    handlers: &Handlers,
    model: &NodeModel,
    execution: Option<&Execution>,
    on: &OnPart<'_>,
) -> String {
    let mut text = head(source, on);
    let none = BTreeSet::new();
    let pends = Pends {
        model,
        found: execution.map_or(&none, |execution| &execution.pends),
        timers: handlers,
    };
    for (handler, priority) in handlers {
        add_handler(&mut text, source, handler, *priority, &pends);
    }
    for task in &source.app.tasks {
        let comments = source.comments.iter();
        let mut comments = comments.filter(|(name, _)| *name == task.name);
        match comments.next() {
            Some((name, comment)) => {
                let at = &comment.place;
                let _ = writeln!(text, "\n# {name}: its row is the comment at {at}.");
            }
            None => add_task(&mut text, source, task, &pends),
        }
    }
    for task in &source.in_idle {
        let _ = writeln!(
            text,
            "\n# {task} has priority 0: it runs in place of idle, and has no bound and no row."
        );
    }
    text
}

/// The row of a handler that is no task of the source.
fn add_handler(
    text: &mut String,
    source: &Source,
    handler: &str,
    priority: Option<u32>,
    pends: &Pends<'_>,
) {
    let _ = writeln!(
        text,
        "\n# The handler {handler}, which is no task of the source (a monotonic's?)."
    );
    let _ = writeln!(text, "[task.{handler}]");
    if let Some(priority) = priority {
        let _ = writeln!(text, "priority = {priority} # as the image sets it");
    }
    match source.systick_hz.filter(|_| handler == "SysTick") {
        Some(hz) if hz > 0 => {
            let _ = writeln!(text, "every_us = {} # ticks at {hz} Hz", 1_000_000 / hz);
        }
        _ => question(text, "every_us", "least time between two of its interrupts"),
    }
    pends.write(text, handler, handler, None);
    question(text, "deadline_us", DEADLINE);
}

/// The row of a task.
fn add_task(text: &mut String, source: &Source, task: &Task, pends: &Pends<'_>) {
    let interrupt = source.app.interrupt(task).unwrap_or(&task.name);
    let runs = match &task.binds {
        Some(interrupt) => format!("bound to {interrupt}"),
        None => format!("software task, run by {interrupt}"),
    };
    let _ = writeln!(
        text,
        "\n# Priority {}, {runs} ({}:{}).",
        task.priority, source.shown, task.line
    );
    let _ = writeln!(text, "[task.{}]", task.name);
    let delays = source.delays.iter().filter(|(name, _)| *name == task.name);
    let shortest = delays.map(|(_, us)| *us).min();
    let timer = shortest.and_then(|_| pends.timer(interrupt));
    match shortest {
        Some(us) => {
            let _ = writeln!(
                text,
                "every_us = {us} # its shortest delay; each of its `.await`s ends in a release"
            );
        }
        None => question(
            text,
            "every_us",
            "least time between two releases, or a list, one for each cause",
        ),
    }
    if let Some(timer) = &timer {
        let _ = writeln!(text, "after = \"{timer}\"");
    }
    pends.write(text, &task.name, interrupt, timer.as_deref());
    question(text, "deadline_us", DEADLINE);
}

/// What a question for a deadline says.
const DEADLINE: &str = "by when it must be done, after its release";

fn question(text: &mut String, key: &str, about: &str) {
    let _ = writeln!(text, "{key} = \"{QUESTION}\" # {about}");
}

fn head(source: &Source, on: &OnPart<'_>) -> String {
    let mut text = format!(
        "# What releases each task of {}, and by when it must be done, for `cargo deadlines`. Times are in\n\
         # microseconds. A value \"{QUESTION}\" is a question that is left: the analysis names it.\n\n",
        source.shown
    );
    match on.name {
        Some(name) => {
            let _ = writeln!(text, "part = \"{name}\"");
        }
        None => {
            let known: Vec<&str> = parts::names().collect();
            question(
                &mut text,
                "part",
                &format!("one of {}, or a file that ends in .toml", known.join(", ")),
            );
        }
    }
    match on.core_hz {
        Some(hz) => {
            let _ = writeln!(text, "core_hz = {hz}");
        }
        None => question(
            &mut text,
            "core_hz",
            "the clock that the program gives to the core",
        ),
    }
    if on
        .file
        .is_none_or(|file| file.peripherals.divider.is_some())
    {
        text.push_str(
            "# Without them, each bus of peripherals counts as slow as the part can make it:\n\
             # bus_hz = 42_000_000      # the slowest bus that the program uses\n\
             # fast_bus_hz = 84_000_000 # that of the part's `fast` peripherals (APB2 and AHB of an STM32)\n",
        );
    }
    text
}

/// What is known of the pends of a program.
struct Pends<'a> {
    model: &'a NodeModel,
    found: &'a BTreeSet<Found>,
    /// Handlers of monotonics.
    timers: &'a Handlers,
}

impl Pends<'_> {
    /// Who pends the handler of an interrupt and so may pend `task`, by name, each with a place. Software tasks of
    /// one priority share a handler: each of them may be the one that pends. Where it pends itself, the task
    /// stands for all of them.
    fn of(&self, task: &str, interrupt: &str) -> BTreeMap<String, &str> {
        let found = self.found.iter().filter(|found| found.pended == interrupt);
        let named = found.flat_map(|found| {
            let penders = match &found.pender {
                Pender::Init => vec![INIT.to_owned()],
                Pender::Idle => vec![IDLE.to_owned()],
                Pender::Handler(handler) if handler == interrupt => vec![task.to_owned()],
                Pender::Handler(handler) => self.tasks_of(handler),
            };
            penders
                .into_iter()
                .map(|pender| (pender, found.place.as_str()))
        });
        named.collect()
    }

    /// The tasks that the handler of an interrupt runs.
    fn tasks_of(&self, interrupt: &str) -> Vec<String> {
        let tasks = self.model.tasks.iter();
        let of_handler = tasks.filter(|one| one.interrupt == interrupt);
        of_handler.map(|one| one.name.clone()).collect()
    }

    /// The timer that wakes the software tasks of a handler, if one does.
    fn timer(&self, interrupt: &str) -> Option<String> {
        let mut penders = self.of(interrupt, interrupt).into_keys();
        penders.find(|pender| self.timers.contains_key(pender))
    }

    /// Writes the lines about who pends a task, which the handler of an interrupt runs, but for `after`.
    fn write(&self, text: &mut String, task: &str, interrupt: &str, after: Option<&str>) {
        let is_timer = self.timers.contains_key(interrupt);
        let bounded = "{ every_us = N, because = \"...\" }";
        for (pender, place) in self.of(task, interrupt) {
            let (how, about) = match pender.as_str() {
                pender if Some(pender) == after => continue,
                INIT => ("once", String::new()),
                IDLE => (QUESTION, format!(": {bounded}")),
                _ if is_timer => ("each", ": right if a job starts one delay".to_owned()),
                pender if pender == task => (QUESTION, format!(": {bounded}")),
                pender => (
                    QUESTION,
                    format!(
                        ": \"each\" for a release by each of its jobs, or {bounded}; or `after = \"{pender}\"` \
                         if its jobs make those of `every_us`"
                    ),
                ),
            };
            let _ = writeln!(text, "pended_by.{pender} = \"{how}\" # at {place}{about}");
        }
    }
}
