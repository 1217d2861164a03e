//! From sources, images and tables to answers.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use network_model::Network;

use crate::execution::Execution;
use crate::model::NodeModel;
use crate::node::{Observed, schedule};
use crate::results::{MICROSECOND, Report};
use crate::table::{NodeTable, Table};
use crate::tasks::App;
use crate::{bus, chains};
use wcet::annotation::Annotations;
use wcet::image::Image;
use wcet::watch::Watch;

/// What to analyse.
#[derive(Debug, Clone)]
pub struct Inputs {
    /// Folder that relative source paths of the images start from.
    pub root: PathBuf,
    /// The task table.
    pub table: PathBuf,
    /// The network file.
    pub network: PathBuf,
    /// Source and image of each node, by its name in the table.
    pub nodes: BTreeMap<String, (PathBuf, PathBuf)>,
}

/// The inputs are wrong: one sentence.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct InputError(pub String);

/// Table, network and tasks of the nodes: what needs no image.
#[derive(Debug, Clone, PartialEq)]
pub struct Models {
    /// The task table.
    pub table: Table,
    /// The network.
    pub network: Network,
    /// Tasks by node, with the node's part of the table.
    pub nodes: Vec<(NodeModel, NodeTable)>,
}

impl Models {
    /// Reads the sources of these nodes, each by its name in the table; `root`
    /// is left off the paths in errors.
    ///
    /// # Errors
    /// Something cannot be read, or does not fit the others.
    pub fn read<'a>(
        root: &Path,
        table: &Path,
        network: &Path,
        sources: impl IntoIterator<Item = (&'a str, &'a Path)>,
    ) -> Result<Self, InputError> {
        let name = |path: &Path| {
            let short = path.strip_prefix(root).unwrap_or(path);
            short.display().to_string()
        };
        let file = name(table);
        let parsed = Table::parse(&file, &read(table, &file)?).map_err(InputError)?;
        let network_name = name(network);
        let network = Network::parse(&read(network, &network_name)?).map_err(|problems| {
            InputError(format!("{network_name}: {problems}").replace('\n', "; "))
        })?;
        let mut nodes = Vec::new();
        for (node, source) in sources {
            let of_node = parsed
                .node
                .get(node)
                .ok_or_else(|| InputError(format!("{file} has no node {node}")))?;
            let source_name = name(source);
            let app = App::parse(&source_name, &read(source, &source_name)?)
                .map_err(|error| InputError(error.to_string()))?;
            let mut model = NodeModel::new(node, &app, of_node, &network, &file)?;
            model.source = source_name;
            nodes.push((model, of_node.clone()));
        }
        Ok(Self {
            table: parsed,
            network,
            nodes,
        })
    }
}

fn read(path: &Path, name: &str) -> Result<String, InputError> {
    std::fs::read_to_string(path)
        .map_err(|error| InputError(format!("cannot read {name}: {error}")))
}

/// What sources, tables and images say; what is missing for the answers is what
/// was seen in runs.
#[derive(Debug)]
pub struct Programs {
    models: Models,
    executions: Vec<Execution>,
}

impl Programs {
    /// Reads everything and bounds the execution times; `progress` is told what
    /// is under way, from any thread.
    ///
    /// # Errors
    /// An input is missing or wrong.
    pub fn read(inputs: &Inputs, progress: &(dyn Fn(&str) + Sync)) -> Result<Self, InputError> {
        let sources = inputs
            .nodes
            .iter()
            .map(|(node, (source, _))| (node.as_str(), source.as_path()));
        let models = Models::read(&inputs.root, &inputs.table, &inputs.network, sources)?;
        let executions = side_by_side(&models.nodes, |(model, table)| {
            execution(inputs, model, table, progress)
        });
        let executions = executions.into_iter().collect::<Result<_, _>>()?;
        Ok(Self { models, executions })
    }

    /// What a run of a node's handlers must keep to.
    pub fn watches(&self, node: &str) -> impl Iterator<Item = (&str, &Arc<Watch>)> {
        let all = self.models.nodes.iter().zip(&self.executions);
        all.filter(move |((model, _), _)| model.name == node)
            .flat_map(|(_, execution)| &execution.handlers)
            .filter_map(|(name, handler)| Some((name.as_str(), handler.watch.as_ref()?)))
    }

    /// Words that a node's memory must hold from its start-up on: address and word.
    pub fn lasting(&self, node: &str) -> impl Iterator<Item = (u32, u32)> {
        let all = self.models.nodes.iter().zip(&self.executions);
        all.filter(move |((model, _), _)| model.name == node)
            .flat_map(|(_, execution)| &execution.lasting)
            .map(|(address, word)| (*address, *word))
    }

    /// The answers, with what was seen of each node.
    ///
    /// # Errors
    /// A chain of the table names something that is nowhere; that something is
    /// not schedulable is an answer, not an error.
    pub fn report(
        &self,
        observed: &BTreeMap<String, Observed>,
        progress: &(dyn Fn(&str) + Sync),
    ) -> Result<Report, InputError> {
        let Self { models, executions } = self;
        let all: Vec<_> = models.nodes.iter().zip(executions).collect();
        let nodes = side_by_side(&all, |((model, table), execution)| {
            progress(&format!("{}: response times", model.name));
            schedule(model, table, execution, observed.get(&model.name))
        });
        let messages = bus::messages(&models.network, &models.table.bus);
        let basic_cycle = u64::from(models.network.basic_cycle_us) * MICROSECOND;
        let mut chains = Vec::new();
        for chain in &models.table.chain {
            chains.extend(chains::follow(chain, &nodes, &messages, basic_cycle)?);
        }
        Ok(Report {
            assumptions: crate::assumptions::of(models, &nodes),
            nodes,
            messages,
            chains,
            kernels: Vec::new(),
            basic_cycle,
        })
    }
}

/// What `work` makes of each, as many at once as there are processors.
fn side_by_side<T: Sync, R: Send>(all: &[T], work: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let next = Mutex::new(0..all.len());
    let done = Mutex::new(BTreeMap::new());
    let workers = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    std::thread::scope(|scope| {
        for _ in 0..workers.min(all.len()) {
            scope.spawn(|| {
                while let Some(at) = next.lock().ok().and_then(|mut next| next.next()) {
                    let result = work(&all[at]);
                    if let Ok(mut done) = done.lock() {
                        done.insert(at, result);
                    }
                }
            });
        }
    });
    let done = done.into_inner().unwrap_or_default();
    done.into_values().collect()
}

fn execution(
    inputs: &Inputs,
    model: &NodeModel,
    table: &NodeTable,
    progress: &(dyn Fn(&str) + Sync),
) -> Result<Execution, InputError> {
    let Some((_, elf)) = inputs.nodes.get(&model.name) else {
        return Err(InputError(format!("there is no image of {}", model.name)));
    };
    let image = Image::read(elf).map_err(|error| InputError(error.to_string()))?;
    let annotations = Annotations::new(&inputs.root);
    let told = |task: &str| progress(&format!("{}.{task}", model.name));
    let execution = Execution::of(model, table, &image, &annotations, &told)?;
    match annotations.misplaced().first() {
        Some(misplaced) => Err(InputError(misplaced.to_string())),
        None => Ok(execution),
    }
}
