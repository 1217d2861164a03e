//! Who makes whose interrupt pending, by the image, held against the task table.
//!
//! The execution-time analysis looks at every store of every handler, of start-up and of the idle
//! code ([`wcet::pend`]). What makes a task pending must be in the task table, as `after` or under
//! `pended_by`, because it is a release that the response times count. A task that makes itself
//! pending, or several that do so in a circle, may keep the processor for good; so the table must say
//! what bounds them, and why.

use std::collections::{BTreeMap, BTreeSet};

use crate::model::{NodeModel, TaskModel};
use crate::table::{IDLE, INIT, NodeTable};
use wcet::image::Image;
use wcet::pend::Pend;

/// Who makes an interrupt pending.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Pender {
    /// The start-up code, before any task runs.
    Init,
    /// The idle code.
    Idle,
    /// The handler of this interrupt.
    Handler(String),
}

/// A place of the image that makes the interrupt of a task pending.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Found {
    /// Who runs it.
    pub pender: Pender,
    /// The interrupt.
    pub pended: String,
    /// The source line of the store, and its function.
    pub place: String,
    /// True if the store is known to name this interrupt; false if it is one of several that the
    /// store may name.
    pub exact: bool,
}

/// The pends of a handler, of start-up or of the idle code that concern tasks of the model.
pub(crate) fn found<'a>(
    node: &'a NodeModel,
    image: &'a Image,
    pender: &'a Pender,
    pends: impl IntoIterator<Item = &'a Pend>,
) -> impl Iterator<Item = Found> {
    let interrupts: BTreeMap<u32, &str> = node
        .tasks
        .iter()
        .filter_map(|task| Some((image.symbol(&task.interrupt)?, task.interrupt.as_str())))
        .collect();
    let vectors = image.vectors();
    pends.into_iter().filter_map(move |pend| {
        let pended = interrupts.get(vectors.get(&pend.exception)?)?;
        Some(Found {
            pender: match pender {
                Pender::Idle if pend.early => Pender::Init,
                other => other.clone(),
            },
            pended: (*pended).to_owned(),
            place: image.describe(pend.at),
            exact: pend.exact,
        })
    })
}

/// A pend of the image that the task table omits.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file}: {}", self.sentence())]
pub struct PendError {
    /// The task table.
    pub file: String,
    /// The node.
    pub node: String,
    /// The key of the table that has its tasks' rows.
    pub rows: String,
    /// Who pends: a task, [`INIT`] or [`IDLE`].
    pub pender: String,
    /// The task that is pended.
    pub pended: String,
    /// Where.
    pub place: String,
    /// Whether the store names this interrupt for certain.
    pub exact: bool,
    /// The way back from the pended task to the pender, if there is one: the tasks between the two.
    pub back: Option<Vec<String>>,
    /// Why another task may pend or be pended in place of this one, as a clause: software tasks of one priority
    /// share a handler.
    pub shared: Option<String>,
    /// Whether the table says `after` of other tasks of the pended handler.
    pub after: bool,
}

impl PendError {
    fn sentence(&self) -> String {
        let Self {
            node,
            rows,
            pender,
            pended,
            place,
            ..
        } = self;
        let whom = if pender == pended { "itself" } else { pended };
        let (how, each) = self.bound();
        let or_each = |quote: &str| {
            let or = format!(
                ", or {quote}\"each\"{quote} in place of the braces if every job of {pender} may"
            );
            if each { or } else { String::new() }
        };
        if let Some(shared) = &self.shared {
            let line = match how {
                _ if self.after => format!("after = \"{pender}\""),
                how => format!("pended_by.{pender} = {how}"),
            };
            return format!(
                "{pender} of {node} may pend {whom} at {place}, because {shared}: write `{line}` under [{rows}.{pended}]\
                 {}, or `pended_by.{pender} = {NEVER}` if it never does",
                or_each("")
            );
        }
        let fact = if self.exact {
            format!(
                "{pender} of {node} pends {whom} at {place}{}:",
                self.consequence()
            )
        } else {
            format!(
                "{pender} of {node} may pend {whom} at {place}, because the interrupt is not known \
                 there{}: name the interrupt there, or",
                self.consequence()
            )
        };
        let or = or_each("`");
        format!("{fact} write `pended_by.{pender} = {how}` under [{rows}.{pended}]{or}")
    }

    /// How the table bounds such a pend, and whether `"each"` may stand in place of it.
    fn bound(&self) -> (&'static str, bool) {
        let own = self.shared.is_some() && (self.pender == self.pended || self.after);
        match (&self.back, self.pender.as_str()) {
            (None, INIT) => ("\"once\"", false),
            (back, pender) => (BOUNDED, back.is_none() && pender != IDLE && !own),
        }
    }

    /// What follows from the pend, after its place.
    fn consequence(&self) -> String {
        let Some(between) = &self.back else {
            return ", which the task table omits".to_owned();
        };
        if self.pender == self.pended {
            return ", and nothing in the task table bounds how often".to_owned();
        }
        let ends = [&self.pended, &self.pender];
        let way: Vec<&String> = [ends[0]]
            .into_iter()
            .chain(between)
            .chain([ends[1]])
            .collect();
        let pends = way
            .windows(2)
            .map(|pair| format!("{} pends {}", pair[0], pair[1]));
        format!(
            ", and {}, and nothing in the task table bounds how often",
            pends.collect::<Vec<_>>().join(", and ")
        )
    }
}

/// How the task table bounds pends.
const BOUNDED: &str = "{ every_us = N, because = \"...\" }";

/// How it says that there are none.
const NEVER: &str = "{ because = \"...\" }";

/// Checks that the task table says of every pend who makes it. `file` names the table in messages.
///
/// # Errors
/// The first pend that the table omits: one that a task can repeat without an end comes first.
pub fn check(
    model: &NodeModel,
    table: &NodeTable,
    found: &BTreeSet<Found>,
    file: &str,
) -> Result<(), Box<PendError>> {
    let errors = found.iter().flat_map(|one| {
        let omitted = omitted(model, table, one).into_iter();
        omitted.map(|(pender, pended)| PendError {
            file: file.to_owned(),
            node: model.name.clone(),
            rows: model.rows.clone(),
            shared: shared(model, one, &pender, &pended),
            after: after(model, table, one, &pender),
            pender,
            pended,
            place: one.place.clone(),
            exact: one.exact,
            back: back(model, found, one),
        })
    });
    let worst = errors.min_by_key(|error| (error.back.is_none(), !error.exact));
    worst.map_or(Ok(()), |worst| Err(Box::new(worst)))
}

/// The tasks that the handler of an interrupt runs.
fn tasks_of<'a>(model: &'a NodeModel, interrupt: &'a str) -> impl Iterator<Item = &'a TaskModel> {
    let tasks = model.tasks.iter();
    tasks.filter(move |task| task.interrupt == interrupt)
}

/// Name of the first task that the handler of an interrupt runs.
fn task_of(model: &NodeModel, interrupt: &str) -> String {
    let first = tasks_of(model, interrupt).next();
    first.map_or(interrupt, |task| &task.name).to_owned()
}

/// Names of those who may be the pender: software tasks of one priority share a handler, and its code does not
/// tell which of them pends.
fn penders(model: &NodeModel, pender: &Pender) -> Vec<String> {
    match pender {
        Pender::Init => vec![INIT.to_owned()],
        Pender::Idle => vec![IDLE.to_owned()],
        Pender::Handler(interrupt) => {
            let tasks = tasks_of(model, interrupt);
            tasks.map(|task| task.name.clone()).collect()
        }
    }
}

/// The pairs of a pender and a pended task that the table omits. Each task that shares the pender's handler may
/// be the one that pends, so some row must name it; each task that shares the pended handler may be the one that
/// is released, so its row must name a pender.
fn omitted(model: &NodeModel, table: &NodeTable, found: &Found) -> Vec<(String, String)> {
    let penders = penders(model, &found.pender);
    let pended: Vec<&str> = tasks_of(model, &found.pended)
        .map(|task| task.name.as_str())
        .collect();
    let names = |task: &str, pender: &str| {
        let entry = table.task.get(task);
        entry.is_some_and(|entry| {
            entry.after.as_deref() == Some(pender) || entry.pended_by.contains_key(pender)
        })
    };
    // A task that shares its handler with the other end is asked for its own pends.
    let is_own = found.pender == Pender::Handler(found.pended.clone());
    let mut omitted = Vec::new();
    for pender in &penders {
        if !pended.iter().any(|task| names(task, pender)) {
            let first = if is_own {
                Some(pender.as_str())
            } else {
                pended.first().copied()
            };
            omitted.extend(first.map(|task| (pender.clone(), task.to_owned())));
        }
    }
    for task in pended {
        if !penders.iter().any(|pender| names(task, pender)) {
            let own = penders.iter().find(|pender| is_own && *pender == task);
            let first = own.or(penders.first());
            omitted.extend(first.map(|pender| (pender.clone(), task.to_owned())));
        }
    }
    omitted
}

/// Why another task may pend or be pended in place of this one.
fn shared(model: &NodeModel, found: &Found, pender: &str, pended: &str) -> Option<String> {
    let others = |interrupt: &str, of: &str| {
        let others = tasks_of(model, interrupt).map(|task| task.name.as_str());
        let others: Vec<&str> = others.filter(|name| *name != of).collect();
        (!others.is_empty()).then(|| others.join(", "))
    };
    let of_pender = match &found.pender {
        Pender::Handler(interrupt) => others(interrupt, pender),
        Pender::Init | Pender::Idle => None,
    };
    let of_pender = of_pender.map(|others| {
        format!(
            "{pender} shares its handler with {others}, and the image does not tell which of them pends"
        )
    });
    of_pender.or_else(|| {
        let others = others(&found.pended, pended)?;
        Some(format!(
            "{pended} shares its handler with {others}, and the image does not tell which of them is pended"
        ))
    })
}

/// Whether a task of the pended handler is released `after` this pender.
fn after(model: &NodeModel, table: &NodeTable, found: &Found, pender: &str) -> bool {
    tasks_of(model, &found.pended).any(|task| {
        let entry = table.task.get(&task.name);
        entry.is_some_and(|entry| entry.after.as_deref() == Some(pender))
    })
}

/// The tasks on the shortest way of pends from the pended task back to the pender, without the two;
/// `None` if there is no such way.
fn back(model: &NodeModel, all: &BTreeSet<Found>, of: &Found) -> Option<Vec<String>> {
    let Pender::Handler(goal) = &of.pender else {
        return None;
    };
    let mut ways: Vec<Vec<&str>> = vec![vec![of.pended.as_str()]];
    let mut seen = BTreeSet::from([of.pended.as_str()]);
    while !ways.is_empty() {
        let mut longer = Vec::new();
        for way in ways {
            let last = *way.last()?;
            if last == goal {
                let between = way.iter().skip(1).take(way.len().saturating_sub(2));
                return Some(between.map(|interrupt| task_of(model, interrupt)).collect());
            }
            for next in all {
                if next.pender == Pender::Handler(last.to_owned()) && seen.insert(&next.pended) {
                    longer.push([way.as_slice(), &[next.pended.as_str()]].concat());
                }
            }
        }
        ways = longer;
    }
    None
}
