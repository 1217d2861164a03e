//! Writes the Rust of a network: its message types and its system matrix.
//!
//! The text is meant for a build script, which puts it where the network crate
//! includes it. That crate brings into scope what the text refers to: its own
//! `Message`, `DecodeError` and `Signal`, and the types of `ttcan`.

mod matrix;
mod messages;
mod names;
mod types;

pub use matrix::matrix;
pub use messages::messages;

use std::collections::BTreeMap;

use crate::network::Network;
use crate::problem::Problem;
use names::{pascal, screaming, snake};

/// Types that the text defines or that it needs from the crate around it.
const TYPES: [&str; 10] = [
    "AnyMessage",
    "DecodeError",
    "FnMut",
    "Frame",
    "Id",
    "Message",
    "Node",
    "Option",
    "Result",
    "Signal",
];
/// Constants that the text of the matrix defines beside those of the nodes.
const CONSTANTS: [&str; 5] = [
    "BASIC_CYCLE",
    "BIT_RATE",
    "MATRIX",
    "REFERENCE_FREE",
    "SCHEDULE",
];
/// Names that a message's type has beside those of its signals: constants, and the bytes that its
/// decoder reads.
const OF_MESSAGE: [&str; 10] = ["id", "name", "d0", "d1", "d2", "d3", "d4", "d5", "d6", "d7"];

/// The names that share a scope in the text, each with what has it in the file.
struct Scope<'p> {
    taken: BTreeMap<String, String>,
    problems: &'p mut Vec<Problem>,
}

impl<'p> Scope<'p> {
    fn new<'n>(taken: impl IntoIterator<Item = &'n str>, problems: &'p mut Vec<Problem>) -> Self {
        let taken = taken.into_iter();
        Self {
            taken: taken
                .map(|name| (name.to_owned(), "the generated text itself".to_owned()))
                .collect(),
            problems,
        }
    }

    /// Adds what becomes `name` in Rust; a name that is none, or is taken, is a problem.
    fn add(&mut self, line: Option<usize>, what: String, name: String) {
        // `syn` takes `gen`, a keyword since the edition of 2024, for a name.
        let told = if syn::parse_str::<syn::Ident>(&name).is_err() || name == "gen" {
            format!(
                "{what} becomes {name:?} in Rust: letters, digits and underscores are accepted, a \
                 letter first, and no keyword"
            )
        } else if let Some(other) = self.taken.get(&name) {
            format!(
                "{what} becomes {name} in Rust, which {other} is already: another name is accepted"
            )
        } else {
            self.taken.insert(name, what);
            return;
        };
        self.problems.push(Problem { line, what: told });
    }
}

/// Names of a network from which [`messages`] and [`matrix`] cannot write Rust.
pub(crate) fn check(network: &Network, problems: &mut Vec<Problem>) {
    let of_node = |name: &str| format!("node {name}");
    let mut nodes = Scope::new([], problems);
    for node in &network.nodes {
        nodes.add(None, of_node(&node.name), pascal(&node.name));
    }
    let mut constants = Scope::new(CONSTANTS, problems);
    for node in &network.nodes {
        constants.add(None, of_node(&node.name), screaming(&node.name));
    }
    let quantities = types::Quantity::used(network);
    let quantities = quantities.iter().map(|quantity| quantity.name);
    let mut all = Scope::new(TYPES.into_iter().chain(quantities), problems);
    for table in &network.value_tables {
        let what = format!("the value table {}", table.name);
        all.add(None, what, table.name.clone());
    }
    for message in &network.messages {
        let what = format!("message {} ({})", message.name, message.id);
        all.add(message.line, what, message.name.clone());
    }
    for table in &network.value_tables {
        let mut values = Scope::new([], problems);
        for value in &table.values {
            let what = format!("value {:?} of the value table {}", value.name, table.name);
            values.add(None, what, value.name.clone());
        }
    }
    for message in &network.messages {
        let mut signals = Scope::new(OF_MESSAGE, problems);
        for signal in &message.signals {
            let what = format!("signal {} of message {}", signal.name, message.name);
            signals.add(signal.line, what, snake(&signal.name));
        }
    }
    let mut windows = Scope::new([], problems);
    for (line, what, name) in matrix::window_names(network) {
        windows.add(line, what, name);
    }
}
