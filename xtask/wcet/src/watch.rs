//! Holds what was assumed of the code against a run of it.
//!
//! Annotations are the programmer's word. A [`Watch`] is made from a bound and
//! follows the program counter through one activation of the task: it tells
//! when control is somewhere the analysis never was, when a loop takes more
//! turns than annotated, and when a block runs more often than annotated for a
//! whole activation.

use super::analysis::{Analysis, Bound};
use super::image::Image;

/// What a run shows to be wrong.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Refuted {
    /// Control is where the reconstructed flow has nothing: at this address.
    Outside(u32),
    /// A loop took more turns than one entry may take.
    Turns {
        /// Where it is.
        at: String,
        /// Turns so far.
        turns: u64,
        /// Turns allowed.
        bound: u64,
        /// Whether that is its annotation's word.
        annotated: bool,
    },
    /// A block ran more often than annotated for one activation.
    Times {
        /// Where it is.
        at: String,
        /// Times so far.
        times: u64,
        /// Times allowed.
        most: u64,
    },
}

impl Refuted {
    /// What the run did, in words that follow the name of the task.
    #[must_use]
    pub fn sentence(&self, image: &Image) -> String {
        match self {
            Self::Outside(address) => format!(
                "control reached {}, which is not on any path that the analysis found",
                image.describe(*address)
            ),
            Self::Turns {
                at,
                turns,
                bound,
                annotated,
            } => {
                let says = if *annotated {
                    "its annotation says"
                } else {
                    "the analysis found"
                };
                format!("the loop at {at} took {turns} turns, {says} at most {bound}")
            }
            Self::Times { at, times, most } => {
                format!(
                    "{at} ran {times} times in one activation, its annotation says at most {most}"
                )
            }
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Event {
    /// The first block of this loop.
    Turn(usize),
    /// A block of the loop's function that is not part of the loop.
    Outside(usize),
    /// A block with a count for the whole activation.
    Times(usize),
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Loop {
    at: String,
    bound: u64,
    annotated: bool,
}

/// No code of the task.
const NOTHING: u32 = 0;
/// Code at which nothing happens; what is above is the number of its events.
const QUIET: u32 = 1;

/// What to look for; see the module.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Watch {
    /// Address of the first instruction.
    entry: u32,
    /// What every half-word from `base` on is: asked for every instruction of
    /// a run, so that it has to be quick.
    marks: Vec<u32>,
    base: u32,
    events: Vec<Vec<Event>>,
    loops: Vec<Loop>,
    /// Places with the times that they may run.
    blocks: Vec<(String, u64)>,
}

/// One activation being followed.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Activation {
    turns: Vec<u64>,
    times: Vec<u64>,
}

impl Watch {
    /// For the task or function at `entry` that `bound` is of.
    pub fn new(analysis: &mut Analysis<'_>, entry: u32, bound: &Bound) -> Self {
        let nodes: Vec<_> = bound
            .facts
            .visits
            .keys()
            .filter_map(|node| Some((node, analysis.graph(node.function)?)))
            .collect();
        let code = || {
            let blocks = nodes.iter().map(|(node, graph)| &graph.blocks[node.block]);
            blocks.flat_map(|block| block.instructions.iter().map(|i| i.address))
        };
        let base = code().min().unwrap_or(0);
        let size = code().max().map_or(0, |last| (last - base) / 2 + 1);
        let mut watch = Self {
            entry,
            marks: vec![NOTHING; size as usize],
            base,
            events: Vec::new(),
            loops: Vec::new(),
            blocks: Vec::new(),
        };
        for address in code() {
            watch.marks[((address - base) / 2) as usize] = QUIET;
        }
        for (node, graph) in &nodes {
            if let Some(&most) = bound.facts.most.get(node) {
                let start = graph.blocks[node.block].start();
                watch.add(start, Event::Times(watch.blocks.len()));
                let at = analysis.image().describe(start);
                watch.blocks.push((at, most));
            }
        }
        for (node, &turns) in &bound.facts.turns {
            let Some(graph) = analysis.graph(node.function) else {
                continue;
            };
            let Some(number) = graph.loops.iter().position(|l| l.header == node.block) else {
                continue;
            };
            let l = &graph.loops[number];
            // Where the loop is the function's first block a call cannot be
            // told from a turn.
            if l.blocks.contains(&0) {
                continue;
            }
            let annotation = analysis.annotation(&graph, number);
            let start = graph.blocks[l.header].start();
            for (index, block) in graph.blocks.iter().enumerate() {
                let event = if index == l.header {
                    Event::Turn(watch.loops.len())
                } else if l.blocks.contains(&index) {
                    continue;
                } else {
                    Event::Outside(watch.loops.len())
                };
                watch.add(block.start(), event);
            }
            watch.loops.push(match annotation {
                Some((place, bound)) => Loop {
                    at: place.to_string(),
                    bound,
                    annotated: true,
                },
                None => Loop {
                    at: analysis.image().describe(start),
                    bound: turns,
                    annotated: false,
                },
            });
        }
        watch
    }

    /// Notes that reaching `address` means something; blocks that the analysis
    /// never reached mean nothing but that they are outside.
    fn add(&mut self, address: u32, event: Event) {
        let at = address.checked_sub(self.base).map(|offset| offset / 2);
        let mark = at.and_then(|at| self.marks.get_mut(at as usize));
        match mark {
            None | Some(&mut NOTHING) => {}
            Some(mark) => {
                if *mark == QUIET {
                    self.events.push(Vec::new());
                    *mark = QUIET + self.events.len() as u32;
                }
                self.events[(*mark - QUIET - 1) as usize].push(event);
            }
        }
    }

    /// Address of the first instruction.
    #[must_use]
    pub fn entry(&self) -> u32 {
        self.entry
    }

    /// Begins to follow an activation.
    #[must_use]
    pub fn activation(&self) -> Activation {
        Activation {
            turns: vec![0; self.loops.len()],
            times: vec![0; self.blocks.len()],
        }
    }

    /// Takes the address of the next instruction of `activation`.
    ///
    /// # Errors
    /// When the run refutes what was assumed.
    #[inline]
    pub fn see(&self, activation: &mut Activation, at: u32) -> Result<(), Refuted> {
        let place = (at.wrapping_sub(self.base) / 2) as usize;
        match self.marks.get(place) {
            Some(&QUIET) => Ok(()),
            None | Some(&NOTHING) => Err(Refuted::Outside(at)),
            Some(mark) => self.happens(activation, (mark - QUIET - 1) as usize),
        }
    }

    fn happens(&self, activation: &mut Activation, events: usize) -> Result<(), Refuted> {
        for event in &self.events[events] {
            match *event {
                Event::Outside(number) => activation.turns[number] = 0,
                Event::Turn(number) => {
                    let l = &self.loops[number];
                    activation.turns[number] += 1;
                    // Once more than it is repeated.
                    let turns = activation.turns[number] - 1;
                    if turns > l.bound {
                        return Err(Refuted::Turns {
                            at: l.at.clone(),
                            turns,
                            bound: l.bound,
                            annotated: l.annotated,
                        });
                    }
                }
                Event::Times(number) => {
                    let (at, most) = &self.blocks[number];
                    activation.times[number] += 1;
                    let times = activation.times[number];
                    if times > *most {
                        return Err(Refuted::Times {
                            at: at.clone(),
                            times,
                            most: *most,
                        });
                    }
                }
            }
        }
        Ok(())
    }
}
