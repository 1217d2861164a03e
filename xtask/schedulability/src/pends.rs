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
        let (how, also) = match (&self.back, pender.as_str()) {
            (None, INIT) => ("\"once\"", String::new()),
            (None, pender) if pender != IDLE => (
                BOUNDED,
                format!(", or `\"each\"` in place of the braces if every job of {pender} may"),
            ),
            _ => (BOUNDED, String::new()),
        };
        format!("{fact} write `pended_by.{pender} = {how}` under [{rows}.{pended}]{also}")
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
    let omitted = found.iter().filter(|one| !is_declared(model, table, one));
    let errors = omitted.map(|one| PendError {
        file: file.to_owned(),
        node: model.name.clone(),
        rows: model.rows.clone(),
        pender: name(model, &one.pender),
        pended: task_of(model, &one.pended),
        place: one.place.clone(),
        exact: one.exact,
        back: back(model, found, one),
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

fn name(model: &NodeModel, pender: &Pender) -> String {
    match pender {
        Pender::Init => INIT.to_owned(),
        Pender::Idle => IDLE.to_owned(),
        Pender::Handler(interrupt) => task_of(model, interrupt),
    }
}

/// Whether the table names the pender. Software tasks of one priority share a handler and its
/// releases, so it may name any of them.
fn is_declared(model: &NodeModel, table: &NodeTable, found: &Found) -> bool {
    let is_pender = |name: &str| match &found.pender {
        Pender::Init => name == INIT,
        Pender::Idle => name == IDLE,
        Pender::Handler(interrupt) => tasks_of(model, interrupt).any(|task| task.name == name),
    };
    tasks_of(model, &found.pended).any(|task| {
        let entry = table.task.get(&task.name);
        entry.is_some_and(|entry| {
            let after = entry.after.iter();
            let mut penders = after.chain(entry.pended_by.keys());
            penders.any(|name| is_pender(name))
        })
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
