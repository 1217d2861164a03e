//! The whole analysis: from sources, images and tables to the report.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use network_model::Message;
use parts::Sled;

use crate::can::ErrorRate;
use crate::execution::Execution;
use crate::foreign::{Foreign, SENDER};
use crate::model::NodeModel;
use crate::models::{Files, InputError, Models, Supplements};
use crate::node::{Observed, schedule};
use crate::releases::Bus;
use crate::results::{MessageReport, Report};
use crate::side_by_side::side_by_side;
use crate::table::{LoopBound, NodeTable, unused_bound};
use crate::transfers::Transfers;
use crate::units::MICROSECOND;
use crate::{bus, chains, event, pends};
use wcet::annotation::Annotations;
use wcet::image::Image;
use wcet::lasting::Known;
use wcet::timing::Timing;
use wcet::watch::Watch;

/// What to analyse.
#[derive(Debug, Clone)]
pub struct Inputs {
    /// Folder to which source paths in the images are relative.
    pub root: PathBuf,
    /// The task table.
    pub table: PathBuf,
    /// The network file.
    pub network: PathBuf,
    /// What a node that is only sometimes there adds to both, if it is there.
    pub supplements: Supplements,
    /// Time between two bursts of the satellite receiver, in microseconds; `None` if there is
    /// no receiver.
    pub receiver_period_us: Option<u64>,
    /// Whether the nodes send at once, without the schedule. All of them must be there then, because
    /// each may make the messages of the others late.
    pub event_triggered: bool,
    /// Messages of foreign nodes on the bus.
    pub foreign: Vec<Foreign>,
    /// Rate of disturbed frames in place of that of the task table.
    pub errors: Option<ErrorRate>,
    /// The program of each node, by its name in the table.
    pub nodes: BTreeMap<String, Program>,
}

/// The program of a node.
#[derive(Debug, Clone)]
pub struct Program {
    /// The board that it runs on.
    pub board: &'static Sled,
    /// Its source.
    pub source: PathBuf,
    /// Its image.
    pub image: PathBuf,
}

/// Everything that follows from sources, tables and images. Only the observations of runs are
/// missing for the report.
#[derive(Debug)]
pub struct Programs {
    models: Models,
    executions: Arc<Vec<Execution>>,
}

impl Programs {
    /// Reads everything and bounds the execution times. `progress` is called with the current
    /// step, from any thread.
    ///
    /// # Errors
    /// An input is missing or wrong.
    pub fn read(inputs: &Inputs, progress: &(dyn Fn(&str) + Sync)) -> Result<Self, InputError> {
        let models = models(inputs)?;
        let bounds = LoopBound::turns(&models.table.bounds);
        let executions = side_by_side(&models.nodes, |(model, table)| {
            execution(inputs, model, table, &bounds, progress)
        });
        let executions: Vec<_> = executions.into_iter().collect::<Result<_, _>>()?;
        let (executions, unused): (Vec<Execution>, Vec<Vec<String>>) =
            executions.into_iter().unzip();
        // Another node may have the loop.
        let is_whole = models.nodes.len() == models.table.node.len();
        let nowhere = |name: &&String| unused.iter().all(|unused| unused.contains(name));
        if let Some(name) = bounds.keys().find(nowhere).filter(|_| is_whole) {
            return Err(InputError::Bound(unused_bound(&models.file, name)));
        }
        for ((model, table), execution) in models.nodes.iter().zip(&executions) {
            pends::check(model, table, &execution.pends, &models.file)?;
        }
        Ok(Self {
            models,
            executions: Arc::new(executions),
        })
    }

    /// The same programs on a bus with other foreign messages. `inputs` are otherwise those that they
    /// were read from; their images are not read again.
    ///
    /// # Errors
    /// A foreign message cannot be on the bus.
    pub fn beside(&self, inputs: &Inputs) -> Result<Self, InputError> {
        Ok(Self {
            models: models(inputs)?,
            executions: Arc::clone(&self.executions),
        })
    }

    /// The rate of disturbed frames for which the analysis is made.
    #[must_use]
    pub const fn errors(&self) -> ErrorRate {
        self.models.errors
    }

    /// The analysed paths of a node's handlers, which runs are checked against: interrupt and
    /// watch.
    pub fn watches(&self, node: &str) -> impl Iterator<Item = (&str, &Arc<Watch>)> {
        let all = self.models.nodes.iter().zip(self.executions.iter());
        all.filter(move |((model, _), _)| model.name == node)
            .flat_map(|(_, execution)| &execution.handlers)
            .filter_map(|(name, handler)| Some((name.as_str(), handler.watch.as_ref()?)))
    }

    /// What a node's memory is known to keep; nothing if the node is not analysed.
    #[must_use]
    pub fn known(&self, node: &str) -> Known {
        let mut all = self.models.nodes.iter().zip(self.executions.iter());
        let of_node = all.find(|((model, _), _)| model.name == node);
        of_node.map_or_else(Known::default, |(_, execution)| execution.known.clone())
    }

    /// The timing of a node's part as flashed; `None` if the node is not analysed.
    #[must_use]
    pub fn flashed(&self, node: &str) -> Option<Timing> {
        let mut all = self.models.nodes.iter();
        let (_, table) = all.find(|(model, _)| model.name == node)?;
        Some(Timing::flashed(&table.board.part))
    }

    /// The transfers by DMA that the task table has for a node; `None` if the node is not analysed.
    #[must_use]
    pub fn transfers(&self, node: &str) -> Option<Transfers> {
        let mut all = self.models.nodes.iter();
        let (_, table) = all.find(|(model, _)| model.name == node)?;
        Some(table.dma.clone())
    }

    /// The report, with the observations of each node.
    ///
    /// # Errors
    /// A chain of the table names something that does not exist. A missed deadline is an
    /// answer, not an error.
    pub fn report(
        &self,
        observed: &BTreeMap<String, Observed>,
        progress: &(dyn Fn(&str) + Sync),
    ) -> Result<Report, InputError> {
        let Self { models, executions } = self;
        let (nodes, mut messages) = if models.event_triggered {
            progress("response times of tasks and messages");
            event::solve(
                (&models.network, models.errors),
                &models.foreign,
                &models.file,
                &models.nodes,
                executions,
                observed,
            )?
        } else {
            let all: Vec<_> = models.nodes.iter().zip(executions.iter()).collect();
            let nodes = side_by_side(&all, |((model, table), execution)| {
                progress(&format!("{}: response times", model.name));
                schedule(model, table, execution, observed.get(&model.name))
            });
            let reactions = nodes.iter().zip(&models.nodes);
            let reactions = reactions
                .map(|(report, (_, table))| (report.name.clone(), bus::reaction(report, table)))
                .collect();
            let supervised = &models.table.supervised;
            let messages = bus::messages(&models.network, models.errors, supervised, &reactions);
            (nodes, messages)
        };
        let foreign = |message: &Message| message.sender == SENDER;
        messages.retain(|report| {
            let mut all = models.network.messages.iter();
            !all.any(|message| foreign(message) && message.name == report.name)
        });
        let (messages, left_out) = self.independent(messages);
        let basic_cycle = u64::from(models.network.basic_cycle_us) * MICROSECOND;
        let mut chains = Vec::new();
        let bus = Bus::new(&models.network, "", 0).with_errors(models.errors);
        let errors = chains::Errors {
            rate: models.errors,
            late: if models.event_triggered {
                0
            } else {
                bus.reference_delay()
            },
        };
        for chain in &models.table.chain {
            chains.extend(chains::follow(
                chain,
                &nodes,
                &messages,
                basic_cycle,
                errors,
            ));
        }
        Ok(Report {
            assumptions: crate::assumptions::of(models, &nodes),
            nodes,
            messages,
            left_out,
            chains,
            kernels: Vec::new(),
            basic_cycle,
            errors: models.errors,
        })
    }
}

impl Programs {
    /// The answers that do not depend on a node whose program is not here, and the names of the other messages.
    fn independent(&self, messages: Vec<MessageReport>) -> (Vec<MessageReport>, Vec<String>) {
        let Models {
            network,
            nodes,
            table,
            ..
        } = &self.models;
        let is_here = |node: &&String| nodes.iter().any(|(model, _)| model.name == **node);
        let absent = table.node.keys().filter(|node| !is_here(node));
        let absent: Vec<&str> = absent.map(String::as_str).collect();
        let unknown = bus::waiting_for(network, &absent);
        let (left_out, known): (Vec<_>, Vec<_>) = messages
            .into_iter()
            .partition(|message| message.arbitrating && unknown.contains(&message.id));
        (
            known,
            left_out.into_iter().map(|message| message.name).collect(),
        )
    }
}

/// What can be read without an image.
fn models(inputs: &Inputs) -> Result<Models, InputError> {
    let sources = inputs
        .nodes
        .iter()
        .map(|(node, program)| (node.as_str(), program.board, program.source.as_path()));
    Models::read(
        &Files {
            root: &inputs.root,
            table: &inputs.table,
            network: &inputs.network,
            supplements: &inputs.supplements,
        },
        inputs.receiver_period_us,
        inputs.event_triggered,
        &inputs.foreign,
        inputs.errors,
        sources,
    )
}

/// Bounds the execution times of one node, with bounds of loops by their names. Returns those of the names, too,
/// that no loop of the node has.
fn execution(
    inputs: &Inputs,
    model: &NodeModel,
    table: &NodeTable,
    bounds: &BTreeMap<String, u64>,
    progress: &(dyn Fn(&str) + Sync),
) -> Result<(Execution, Vec<String>), InputError> {
    let Some(program) = inputs.nodes.get(&model.name) else {
        return Err(InputError::NoImage(model.name.clone()));
    };
    let image = Image::read(&program.image)?;
    let annotations = Annotations::new(&inputs.root).with_bounds(bounds.clone());
    let of_node = |task: &str| progress(&format!("{}.{task}", model.name));
    let execution = Execution::of(model, table, &image, &annotations, &of_node)?;
    match annotations.misplaced().into_iter().next() {
        Some(misplaced) => Err(misplaced.into()),
        None => Ok((execution, annotations.unused())),
    }
}
