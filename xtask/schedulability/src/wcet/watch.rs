//! Holds what was assumed of the code against a run of it.
//!
//! Annotations are the programmer's word. A [`Watch`] is made from a bound and
//! follows the program counter through one activation of the task: it tells
//! when control is somewhere the analysis never was, when a loop takes more
//! turns than annotated, and when a block runs more often than annotated for a
//! whole activation.

use std::collections::{HashMap, HashSet};

use super::analysis::{Analysis, Bound};

/// What a run shows to be wrong.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Refuted {
    /// Control is where the reconstructed flow has nothing.
    #[error("control reached {0}, which the analysis took for unreachable")]
    Outside(String),
    /// A loop took more turns than one entry may take.
    #[error("the loop at {at} took {turns} turns, {bound} are allowed")]
    Turns {
        /// Where it is.
        at: String,
        /// Turns so far.
        turns: u64,
        /// Turns allowed.
        bound: u64,
    },
    /// A block ran more often than one activation may run it.
    #[error("{at} ran {times} times in one activation, {most} are allowed")]
    Times {
        /// Where it is.
        at: String,
        /// Times so far.
        times: u64,
        /// Times allowed.
        most: u64,
    },
}

#[derive(Debug, Clone, Copy)]
enum Event {
    /// The first block of this loop.
    Turn(usize),
    /// A block of the loop's function that is not part of the loop.
    Outside(usize),
    /// A block with a count for the whole activation.
    Times(usize),
}

/// What to look for; see the module.
#[derive(Debug)]
pub struct Watch {
    code: HashSet<u32>,
    events: HashMap<u32, Vec<Event>>,
    /// Address and turns of each loop.
    loops: Vec<(u32, u64)>,
    /// Address and times of each block.
    blocks: Vec<(u32, u64)>,
}

/// One activation being followed.
#[derive(Debug)]
pub struct Activation<'w> {
    watch: &'w Watch,
    turns: Vec<u64>,
    times: Vec<u64>,
}

impl Watch {
    /// For the task or function that `bound` is of.
    pub fn new(analysis: &mut Analysis<'_>, bound: &Bound) -> Self {
        let mut watch = Self {
            code: HashSet::new(),
            events: HashMap::new(),
            loops: Vec::new(),
            blocks: Vec::new(),
        };
        for node in bound.facts.visits.keys() {
            let Some(graph) = analysis.graph(node.function) else {
                continue;
            };
            let block = &graph.blocks[node.block];
            let addresses = block.instructions.iter().map(|i| i.address);
            watch.code.extend(addresses);
            if let Some(&most) = bound.facts.most.get(node) {
                let event = Event::Times(watch.blocks.len());
                watch.blocks.push((block.start(), most));
                watch.events.entry(block.start()).or_default().push(event);
            }
        }
        for (node, &turns) in &bound.facts.turns {
            let Some(graph) = analysis.graph(node.function) else {
                continue;
            };
            let Some(l) = graph.loops.iter().find(|l| l.header == node.block) else {
                continue;
            };
            // Where the loop is the function's first block a call cannot be
            // told from a turn.
            if l.blocks.contains(&0) {
                continue;
            }
            let number = watch.loops.len();
            watch.loops.push((graph.blocks[l.header].start(), turns));
            for (index, block) in graph.blocks.iter().enumerate() {
                let event = if index == l.header {
                    Event::Turn(number)
                } else if l.blocks.contains(&index) {
                    continue;
                } else {
                    Event::Outside(number)
                };
                watch.events.entry(block.start()).or_default().push(event);
            }
        }
        watch
    }

    /// Begins to follow an activation.
    #[must_use]
    pub fn activation(&self) -> Activation<'_> {
        Activation {
            watch: self,
            turns: vec![0; self.loops.len()],
            times: vec![0; self.blocks.len()],
        }
    }
}

impl Activation<'_> {
    /// Takes the address of the next instruction; `describe` names one.
    ///
    /// # Errors
    /// When the run refutes what was assumed.
    pub fn see(&mut self, at: u32, describe: impl Fn(u32) -> String) -> Result<(), Refuted> {
        if !self.watch.code.contains(&at) {
            return Err(Refuted::Outside(describe(at)));
        }
        for event in self.watch.events.get(&at).into_iter().flatten() {
            match *event {
                Event::Outside(number) => self.turns[number] = 0,
                Event::Turn(number) => {
                    let (_, bound) = self.watch.loops[number];
                    self.turns[number] += 1;
                    // Once more than it is repeated.
                    let turns = self.turns[number] - 1;
                    if turns > bound {
                        let at = describe(at);
                        return Err(Refuted::Turns { at, turns, bound });
                    }
                }
                Event::Times(number) => {
                    let (_, most) = self.watch.blocks[number];
                    self.times[number] += 1;
                    let times = self.times[number];
                    if times > most {
                        let at = describe(at);
                        return Err(Refuted::Times { at, times, most });
                    }
                }
            }
        }
        Ok(())
    }
}
