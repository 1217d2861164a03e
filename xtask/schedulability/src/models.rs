//! Task table, network file and the sources of all nodes, read and put together.

use std::path::{Path, PathBuf};

use network_model::Network;
use parts::Sled;

use crate::can::ErrorRate;
use crate::event::Traffic;
use crate::execution::ExecutionError;
use crate::foreign::{self, Foreign};
use crate::model::{ModelError, NodeModel};
use crate::pends::PendError;
use crate::table::{NodeTable, Protocol, Table, TableError};
use crate::tasks::{App, SourceError};
use wcet::annotation::Misplaced;
use wcet::image::ImageError;

/// What is wrong with the inputs. Each message is one sentence.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InputError {
    /// A file cannot be read.
    #[error("cannot read {file}: {reason}")]
    Unreadable {
        /// The file.
        file: String,
        /// The system's reason.
        reason: String,
    },
    /// The network file is wrong.
    #[error("{file}: {problems}")]
    Network {
        /// The file.
        file: String,
        /// What is wrong, separated by semicolons.
        problems: String,
    },
    /// The task table has no such node.
    #[error("{file} has no node {node}")]
    NoNode {
        /// The task table.
        file: String,
        /// The node.
        node: String,
    },
    /// A foreign message cannot be on the vehicle's bus.
    #[error("{0}")]
    Foreign(String),
    /// There is no image of a node.
    #[error("there is no image of {0}")]
    NoImage(String),
    /// The task table is wrong.
    #[error(transparent)]
    Table(#[from] TableError),
    /// A source is wrong.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// A source and the task table do not fit together.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// An image is wrong.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// An image does not fit its model.
    #[error(transparent)]
    Execution(#[from] ExecutionError),
    /// The task table omits who pends a task.
    #[error(transparent)]
    Pend(#[from] Box<PendError>),
    /// The task table bounds a loop that is not reached.
    #[error("{0}")]
    Bound(String),
    /// A source has an annotation that belongs to no loop.
    #[error(transparent)]
    Annotation(#[from] Misplaced),
}

/// Everything that can be read without an image: table, network and the nodes' tasks.
#[derive(Debug, Clone, PartialEq)]
pub struct Models {
    /// The task table.
    pub table: Table,
    /// The network.
    pub network: Network,
    /// The tasks of each node, with the node's part of the table.
    pub nodes: Vec<(NodeModel, NodeTable)>,
    /// Whether the nodes send at once, without the schedule.
    pub event_triggered: bool,
    /// Messages of foreign nodes on the bus.
    pub foreign: Vec<Foreign>,
    /// Rate of disturbed frames.
    pub errors: ErrorRate,
    /// Name of the task table in messages.
    pub file: String,
}

/// What nodes that are only sometimes there add to the files of their vehicle.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Supplements {
    /// The additions to the task table.
    pub tables: Vec<PathBuf>,
    /// The additions to the network file.
    pub networks: Vec<PathBuf>,
}

/// The files of a vehicle.
#[derive(Debug, Clone, Copy)]
pub struct Files<'a> {
    /// Error messages show paths relative to this folder.
    pub root: &'a Path,
    /// The task table.
    pub table: &'a Path,
    /// The network file.
    pub network: &'a Path,
    /// What adds to both.
    pub supplements: &'a Supplements,
}

impl Models {
    /// Reads the sources of these nodes, each with its name in the table and its board.
    /// `event_triggered` says that they send at once, without the schedule. The table needs
    /// `receiver_period_us`, as [`Table::resolve`] says. `foreign` nodes send on the same bus, by the
    /// schedule if there is one. `errors` takes the place of the table's rate of disturbed frames.
    ///
    /// # Errors
    /// A file cannot be read, or the files do not fit together.
    pub fn read<'a>(
        files: &Files<'_>,
        receiver_period_us: Option<u64>,
        event_triggered: bool,
        foreign: &[Foreign],
        errors: Option<ErrorRate>,
        programs: impl IntoIterator<Item = (&'a str, &'static Sled, &'a Path)>,
    ) -> Result<Self, InputError> {
        let Files {
            root,
            table,
            network,
            supplements,
        } = *files;
        let name = |path: &Path| {
            let short = path.strip_prefix(root).unwrap_or(path);
            short.display().to_string()
        };
        let file = name(table);
        let mut tasks = read(table, &file)?;
        let network_name = name(network);
        let mut network = read(network, &network_name)?;
        for table in &supplements.tables {
            tasks = supplemented(&tasks, &read(table, &name(table))?);
        }
        for supplement in &supplements.networks {
            let file = name(supplement);
            network = network_model::supplemented(&network, &read(supplement, &file)?)
                .map_err(|problems| InputError::Network { file, problems })?;
        }
        let parsed = Table::parse(&file, &tasks)?;
        let mut network = Network::parse(&network).map_err(|problems| InputError::Network {
            file: network_name,
            problems: problems.to_string().replace('\n', "; "),
        })?;
        let protocol = if event_triggered {
            Protocol::EventTriggered
        } else {
            Protocol::TimeTriggered
        };
        let parsed = parsed.with_protocol(&file, protocol)?;
        let parsed = parsed.resolve(&file, &network, receiver_period_us)?;
        foreign::check(&network, foreign).map_err(InputError::Foreign)?;
        if !event_triggered {
            foreign::schedule(&mut network, foreign);
            network = network.with_late_messages();
        }
        let errors = errors.unwrap_or_else(|| parsed.bus.errors());
        let traffic = Traffic::new(&network, errors, foreign);
        let mut nodes = Vec::new();
        for (node, board, source) in programs {
            let of_node = parsed.node.get(node).ok_or_else(|| InputError::NoNode {
                file: file.clone(),
                node: node.to_owned(),
            })?;
            let source_name = name(source);
            let app = App::parse(&source_name, &read(source, &source_name)?)?;
            let on_board = of_node.on(board);
            let mut model = if event_triggered {
                NodeModel::event_triggered(node, &app, &on_board, &traffic, &file)?
            } else {
                NodeModel::new(node, &app, &on_board, (&network, errors), &file)?
            };
            model.source = source_name;
            nodes.push((model, on_board));
        }
        Ok(Self {
            table: parsed,
            network,
            nodes,
            event_triggered,
            foreign: foreign.to_vec(),
            errors,
            file,
        })
    }
}

/// The text of a task table with what a supplement adds to it. A row of the supplement takes the place of the table's row
/// with the same name.
fn supplemented(tasks: &str, supplement: &str) -> String {
    // A row of an array (`[[chain]]`) replaces no other.
    let is_header = |line: &str| line.starts_with('[');
    let is_row = |line: &str| is_header(line) && !line.starts_with("[[");
    let replaced: Vec<&str> = supplement.lines().filter(|line| is_row(line)).collect();
    let mut kept = true;
    let mut text = String::new();
    for line in tasks.lines() {
        if is_header(line) {
            kept = !replaced.contains(&line);
        }
        if kept {
            text.push_str(line);
        }
        // An empty line in place of one that is dropped, so that errors name the right lines.
        text.push('\n');
    }
    text + supplement
}

fn read(path: &Path, name: &str) -> Result<String, InputError> {
    std::fs::read_to_string(path).map_err(|error| InputError::Unreadable {
        file: name.to_owned(),
        reason: error.to_string(),
    })
}

#[cfg(test)]
mod tests {
    use super::supplemented;

    #[test]
    fn a_row_of_a_supplement_takes_the_place_of_the_tables() {
        let tasks = "[node.a.task.one]\nevery_us = 1\n# Two.\n[node.a.task.two]\nevery_us = 2\n[[chain]]\nname = \"c\"\n";
        let more = "[node.a.task.one]\nevery_us = 3\n[[chain]]\nname = \"d\"\n";
        let table: toml::Table = supplemented(tasks, more)
            .parse()
            .expect("one row of each name");
        let task = |name: &str| table["node"]["a"]["task"][name]["every_us"].as_integer();
        assert_eq!((task("one"), task("two")), (Some(3), Some(2)));
        assert_eq!(table["chain"].as_array().map(Vec::len), Some(2));
        assert_eq!(supplemented(tasks, ""), tasks);
    }
}
