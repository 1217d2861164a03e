//! Handlers in the vector table that belong to no task.
//!
//! The time of such a handler is charged to nobody. So none may return to the program, but for
//! those that have a row in the task table and are tasks by that. What a handler does that never
//! returns delays no task: after it the node starts again, or stands still. Its stack counts, for
//! it must get as far as that at any time.

use std::collections::{BTreeMap, BTreeSet};

use wcet::bound::End;
use wcet::image::{DEFAULT_HANDLER, HARD_FAULT, Image, LAST_FAULT};
use wcet::stack::FRAME_FPU;

use crate::model::NodeModel;

/// A handler that is no task and does not return.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outside {
    /// Its symbol.
    pub name: String,
    /// The exception numbers of its vectors.
    pub vectors: Vec<u16>,
    /// How it ends; empty if no path could be followed to its end.
    pub ends: BTreeSet<End>,
    /// Its stack in bytes, without the exception frame.
    pub stack: u32,
    /// Whether it begins with an empty stack and discards what is there.
    pub begins_anew: bool,
}

impl Outside {
    /// What it does, in one sentence without a full stop.
    #[must_use]
    pub fn sentence(&self) -> String {
        let ends: Vec<String> = self.ends.iter().map(ToString::to_string).collect();
        let vectors = match self.vectors.len() {
            1 => String::new(),
            many => format!(" ({many} vectors)"),
        };
        let ends = if ends.is_empty() {
            "does not return".to_owned()
        } else {
            ends.join(" or ")
        };
        let stack = if self.begins_anew {
            "discards the stack that it finds".to_owned()
        } else {
            format!("takes {} bytes of stack", self.stack)
        };
        format!("{}{vectors} {ends} and {stack}", self.name)
    }

    /// The depth of the stack in bytes when it interrupts a program whose stack has this depth.
    #[must_use]
    pub fn depth_above(&self, depth: u32) -> u32 {
        let entered = depth + FRAME_FPU;
        if self.begins_anew {
            entered.max(self.stack)
        } else {
            entered + self.stack
        }
    }
}

/// A handler of the vector table that is not, or not only, that of a task.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Candidate {
    /// Its address.
    pub entry: u32,
    /// Its symbol.
    pub name: String,
    /// The exception numbers of its vectors.
    pub vectors: Vec<u16>,
}

impl Candidate {
    /// Whether it is that of every vector to which the program gives none.
    pub(crate) fn is_default(&self) -> bool {
        self.name == DEFAULT_HANDLER
    }

    /// Its first vector that is no fault.
    pub(crate) fn interrupt(&self) -> Option<u16> {
        let mut vectors = self.vectors.iter();
        vectors.find(|number| **number > LAST_FAULT).copied()
    }
}

/// The handlers of `image` that are no task of `node`.
///
/// The compiler may give one body to several handlers. Then a handler counts as a task's only if
/// it has no more vectors than tasks.
pub(crate) fn candidates(node: &NodeModel, image: &Image) -> Vec<Candidate> {
    let interrupts: BTreeSet<&str> = node.tasks.iter().map(|t| t.interrupt.as_str()).collect();
    let mut modelled: BTreeMap<u32, usize> = BTreeMap::new();
    for entry in interrupts.iter().filter_map(|name| image.symbol(name)) {
        *modelled.entry(entry).or_default() += 1;
    }
    let mut handlers: BTreeMap<u32, Vec<u16>> = BTreeMap::new();
    for (number, entry) in image.vectors() {
        handlers.entry(entry).or_default().push(number);
    }
    handlers.retain(|entry, vectors| vectors.len() > modelled.get(entry).copied().unwrap_or(0));
    let handlers = handlers.into_iter();
    handlers
        .map(|(entry, vectors)| Candidate {
            entry,
            name: name(image, entry, &vectors, &interrupts),
            vectors,
        })
        .collect()
}

/// The name of the handler at `entry`: the default one's, the symbol of a vector that is no
/// task's, or whatever the image calls it.
fn name(image: &Image, entry: u32, vectors: &[u16], tasks: &BTreeSet<&str>) -> String {
    if image.symbol(DEFAULT_HANDLER) == Some(entry) {
        return DEFAULT_HANDLER.to_owned();
    }
    let known = vectors.iter().find_map(|number| exception(*number));
    let own = image.name(entry);
    let mut symbols = image.symbols_at(entry);
    match known {
        Some(known) => known.to_owned(),
        None if !tasks.contains(own.as_str()) => own,
        None => symbols
            .find(|symbol| !tasks.contains(symbol))
            .map_or(own, str::to_owned),
    }
}

/// The name of an exception of the core, as `cortex-m-rt` has it.
fn exception(number: u16) -> Option<&'static str> {
    Some(match number {
        2 => "NonMaskableInt",
        HARD_FAULT => "HardFault",
        4 => "MemoryManagement",
        5 => "BusFault",
        6 => "UsageFault",
        7 => "SecureFault",
        11 => "SVCall",
        12 => "DebugMonitor",
        14 => "PendSV",
        15 => "SysTick",
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use wcet::bound::End;
    use wcet::stack::FRAME_FPU;

    use super::Outside;

    #[test]
    fn a_handler_says_what_it_does() {
        let fault = Outside {
            name: "BusFault".to_owned(),
            vectors: vec![5],
            ends: BTreeSet::from([End::Reset, End::Stop("fault.rs:7".to_owned())]),
            stack: 24,
            begins_anew: false,
        };
        assert_eq!(
            fault.sentence(),
            "BusFault ends in a reset or ends at the breakpoint or undefined instruction at \
             fault.rs:7 and takes 24 bytes of stack"
        );
        assert_eq!(fault.depth_above(1000), 1000 + FRAME_FPU + 24);
        let anew = Outside {
            name: "HardFault".to_owned(),
            vectors: vec![3, 4],
            ends: BTreeSet::new(),
            stack: 2000,
            begins_anew: true,
        };
        assert_eq!(
            anew.sentence(),
            "HardFault (2 vectors) does not return and discards the stack that it finds"
        );
        assert_eq!(anew.depth_above(1000), 2000);
        assert_eq!(anew.depth_above(5000), 5000 + FRAME_FPU);
    }
}
