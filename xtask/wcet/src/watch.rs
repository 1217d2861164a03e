//! Checks the assumptions of the analysis in a run of the code.
//!
//! Annotations are not proven. A [`Watch`] is made from a bound and follows the program counter
//! through one activation of the task. It reports when control reaches code that the analysis
//! did not reach, when a loop takes more turns than its bound, and when a block runs more often
//! than annotated for one activation.

use std::ops::RangeInclusive;
use std::rc::Rc;

use super::analysis::Analysis;
use super::bound::Bound;
use super::facts::BlockId;
use super::graph::Graph;
use super::image::Image;

/// A contradiction between a run and the analysis.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Refuted {
    /// Control reached this address, which is in none of the control-flow graphs.
    Outside(u32),
    /// A loop took more turns than its bound for one entry.
    Turns {
        /// Its place.
        at: String,
        /// Turns so far.
        turns: u64,
        /// The bound.
        bound: u64,
        /// Whether the bound is that of an annotation.
        annotated: bool,
    },
    /// A block ran more often than annotated for one activation.
    Times {
        /// Its place.
        at: String,
        /// Executions so far.
        times: u64,
        /// The annotated number.
        most: u64,
    },
    /// A handler left another word in `BASEPRI` than it found there.
    Mask {
        /// What it found.
        found: u8,
        /// What it left.
        left: u8,
    },
}

impl Refuted {
    /// The contradiction as a clause that follows the name of the task.
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
            Self::Mask { found, left } => {
                format!("it found {found:#04x} in BASEPRI and left {left:#04x} there")
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
    /// The header of this loop.
    Turn(usize),
    /// A block of the loop's function outside the loop.
    Outside(usize),
    /// A block with a limit for the whole activation.
    Times(usize),
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Loop {
    at: String,
    bound: u64,
    annotated: bool,
    /// If the loop's first block is the function's: the loop's instructions, from one address to
    /// another. Control that comes from elsewhere has called the function, and is in no turn.
    body: Option<Vec<RangeInclusive<u32>>>,
}

/// No code of the task.
const NOTHING: u32 = 0;
/// Code without an event. A larger mark is this plus the number of an entry in `events`, from
/// one on.
const QUIET: u32 = 1;

/// The checks for one task; see the module.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Watch {
    /// Address of the first instruction.
    entry: u32,
    /// A mark for every halfword from `base` on. It is looked up for every instruction of a run,
    /// so it has to be quick.
    marks: Vec<u32>,
    base: u32,
    events: Vec<Vec<Event>>,
    loops: Vec<Loop>,
    /// Places of blocks, with the number of executions that is allowed.
    blocks: Vec<(String, u64)>,
}

/// The counts of one activation that is being followed.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Activation {
    turns: Vec<u64>,
    times: Vec<u64>,
    /// Address of the last instruction.
    last: u32,
}

impl Watch {
    /// For the task or function at `entry`, whose bound is `bound`.
    pub fn new(analysis: &mut Analysis<'_>, entry: u32, bound: &Bound) -> Self {
        let reached: Vec<(BlockId, Rc<Graph>)> = bound
            .facts
            .visits
            .keys()
            .filter_map(|id| Some((*id, analysis.graph(id.function)?)))
            .collect();
        let code = || {
            let blocks = reached.iter().map(|(id, graph)| &graph.blocks[id.block]);
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
        for (id, graph) in &reached {
            if let Some(&most) = bound.facts.most.get(id) {
                let start = graph.blocks[id.block].start();
                watch.add(start, Event::Times(watch.blocks.len()));
                let at = analysis.image().describe(start);
                watch.blocks.push((at, most));
            }
        }
        for (header, &turns) in &bound.facts.turns {
            if let Some(graph) = analysis.graph(header.function) {
                watch.add_loop(analysis, &graph, header.block, turns);
            }
        }
        watch
    }

    /// Watches the loop with this header, which takes at most `turns` turns for each entry.
    fn add_loop(&mut self, analysis: &Analysis<'_>, graph: &Graph, header: usize, turns: u64) {
        let mut loops = graph.loops.iter();
        let Some(number) = loops.position(|l| l.header == header) else {
            return;
        };
        let l = &graph.loops[number];
        let body = l.blocks.contains(&0).then(|| {
            let blocks = l.blocks.iter().map(|block| &graph.blocks[*block]);
            blocks
                .map(|block| block.start()..=block.split_last().0.address)
                .collect()
        });
        for (index, block) in graph.blocks.iter().enumerate() {
            let event = if index == header {
                Event::Turn(self.loops.len())
            } else if l.blocks.contains(&index) {
                continue;
            } else {
                Event::Outside(self.loops.len())
            };
            self.add(block.start(), event);
        }
        let start = graph.blocks[header].start();
        self.loops.push(match analysis.annotation(graph, number) {
            Some((place, bound)) => Loop {
                at: place.to_string(),
                bound,
                annotated: true,
                body,
            },
            None => Loop {
                at: analysis.image().describe(start),
                bound: turns,
                annotated: false,
                body,
            },
        });
    }

    /// Adds an event at `address`, unless the analysis never reached that block: control there is
    /// a contradiction anyway.
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

    /// The counts at the begin of an activation.
    #[must_use]
    pub fn activation(&self) -> Activation {
        Activation {
            turns: vec![0; self.loops.len()],
            times: vec![0; self.blocks.len()],
            last: NOTHING,
        }
    }

    /// Follows `activation` to its next instruction, at this address.
    ///
    /// # Errors
    /// The run contradicts the analysis.
    #[inline]
    pub fn see(&self, activation: &mut Activation, at: u32) -> Result<(), Refuted> {
        let place = (at.wrapping_sub(self.base) / 2) as usize;
        let last = std::mem::replace(&mut activation.last, at);
        match self.marks.get(place) {
            Some(&QUIET) => Ok(()),
            None | Some(&NOTHING) => Err(Refuted::Outside(at)),
            Some(mark) => self.happens(activation, (mark - QUIET - 1) as usize, last),
        }
    }

    fn happens(
        &self,
        activation: &mut Activation,
        events: usize,
        last: u32,
    ) -> Result<(), Refuted> {
        for event in &self.events[events] {
            match *event {
                Event::Outside(number) => activation.turns[number] = 0,
                Event::Turn(number) => {
                    let l = &self.loops[number];
                    let called = |body: &Vec<RangeInclusive<u32>>| {
                        !body.iter().any(|block| block.contains(&last))
                    };
                    if l.body.as_ref().is_some_and(called) {
                        activation.turns[number] = 0;
                    }
                    activation.turns[number] += 1;
                    // The first pass of the header enters the loop and is no turn.
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
