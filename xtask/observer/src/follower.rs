//! Follows every activation of a node's interrupt handlers in a run, and reports where one
//! leaves the analysed paths. From the first handler on it also reports each store that reaches what
//! the analysis takes for constant: words in which start-up leaves an address, and the interrupt
//! controller.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use schedulability::transfers::Unit;
use twin::mcu::{Seen, Storer, Trace};
use wcet::image::Image;
use wcet::lasting::Known;
use wcet::watch::{Activation, Refuted, Watch};

/// Where the flash of the parts can be seen.
const FLASH: std::ops::Range<u32> = 0..0x1000_0000;

/// Findings about one handler.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Found {
    /// Activations followed to their end.
    pub activations: u64,
    /// Times at which the handler was entered, in picoseconds, for each start of the node; those while
    /// it started are left out.
    pub entered: Vec<Vec<u64>>,
    /// Assumptions of the analysis that the run refuted. For each place only the worst one is
    /// kept.
    pub refuted: Vec<Refuted>,
}

/// Findings about one node.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Findings {
    /// Those about each handler, by its exception number.
    pub handlers: BTreeMap<u16, Found>,
    /// Stores and transfers that the analysis takes for impossible, each once.
    pub stray: Vec<Stray>,
    /// Times of the transfers of each DMA unit, in picoseconds, for each start of the node; those while it
    /// started are left out.
    pub transfers: BTreeMap<Unit, Vec<Vec<u64>>>,
}

/// A store or transfer that the analysis takes for impossible.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stray {
    /// It reached a word that keeps the address which start-up left there.
    Word {
        /// Who stored.
        by: Storer,
        /// The word's address.
        at: u32,
        /// What start-up leaves there.
        left: u32,
    },
    /// When the first handler began, such a word held something else.
    Left {
        /// The word's address.
        at: u32,
        /// What start-up leaves there by the analysis.
        left: u32,
        /// What it left.
        found: u32,
    },
    /// A word that holds one of a few addresses got something else.
    Other {
        /// Who stored it; `None` for start-up.
        by: Option<Storer>,
        /// The word's address.
        at: u32,
        /// What it holds.
        found: u32,
    },
    /// A transfer read the flash.
    Flash {
        /// Which unit.
        by: Unit,
        /// The address that it read.
        from: u32,
    },
    /// It changed which interrupts are enabled, their priorities, or the vector table.
    Rearranged {
        /// Address of the instruction.
        by: u32,
        /// Address of the register.
        register: u32,
    },
}

impl Stray {
    /// The store as a sentence without its full stop. `image` is the node's.
    #[must_use]
    pub fn sentence(&self, image: &Image) -> String {
        match *self {
            Self::Word { by, at, left } => {
                let (by, at) = (name(by, image), variable(image, at));
                format!("{by} stores to {at}, which start-up leaves at {left:#010x} for good")
            }
            Self::Left { at, left, found } => {
                let at = variable(image, at);
                format!(
                    "start-up leaves {found:#010x} in {at}, where the analysis found {left:#010x}"
                )
            }
            Self::Other { by, at, found } => {
                let at = variable(image, at);
                let by = by.map_or_else(|| "start-up".to_owned(), |by| name(by, image));
                format!(
                    "{by} stores {found:#010x} to {at}, where the analysis knows other addresses only"
                )
            }
            Self::Flash { by, from } => format!(
                "{by}, reads the flash at {from:#010x}, where the analysis counts no access but the core's"
            ),
            Self::Rearranged { by, register } => format!(
                "{} changes which interrupts are enabled, their priorities or the vector table, by a \
                 store to {register:#010x} after start-up",
                image.describe(by)
            ),
        }
    }
}

/// Who stored, in words.
fn name(by: Storer, image: &Image) -> String {
    match by {
        Storer::Instruction(by) => image.describe(by),
        Storer::Entry(number) => {
            format!("saving of registers at the begin of exception {number}")
        }
        Storer::Dma { controller, unit } => {
            format!("a transfer of DMA{controller}, stream or channel {unit},")
        }
    }
}

/// The word at `at` by the name of its variable, if it has one.
fn variable(image: &Image, at: u32) -> String {
    match image.variable(at) {
        Some((name, 0)) => format!("{name} ({at:#010x})"),
        Some((name, offset)) => format!("byte {offset} of {name} ({at:#010x})"),
        None => format!("the word at {at:#010x}"),
    }
}

/// An active handler.
#[derive(Debug)]
struct InHand {
    exception: u16,
    /// What it found in `BASEPRI`.
    mask: u8,
    /// Its position in the analysed graph, if it is watched.
    activation: Option<Activation>,
}

/// Follows one node.
#[derive(Debug)]
pub struct Follower {
    watches: BTreeMap<u16, Arc<Watch>>,
    /// The active handlers; the running one is last.
    stack: Vec<InHand>,
    /// Starts of the node so far.
    starts: usize,
    /// When the first handler was entered behind the last start.
    began: Option<u64>,
    /// Words of which the addresses are known, and what each holds since it was first written.
    known: Known,
    held: BTreeMap<u32, u32>,
    /// How long behind that a start takes, picoseconds.
    start_up: u64,
    findings: Arc<Mutex<Findings>>,
}

impl Follower {
    /// Follows the handlers of these exceptions, each with its watch. `known` is what memory is taken to keep. A
    /// start of the node takes `start_up` picoseconds from its first handler on.
    #[must_use]
    pub fn new(watches: BTreeMap<u16, Arc<Watch>>, known: Known, start_up: u64) -> Self {
        Self {
            watches,
            known,
            held: BTreeMap::new(),
            stack: Vec::new(),
            starts: 1,
            began: None,
            start_up,
            findings: Arc::default(),
        }
    }

    /// The collected findings.
    #[must_use]
    pub fn findings(&self) -> Arc<Mutex<Findings>> {
        Arc::clone(&self.findings)
    }

    /// Follows a core from now on.
    #[must_use]
    pub fn trace(mut self) -> Trace {
        Box::new(move |what| self.see(what))
    }

    fn see(&mut self, what: Seen) {
        match what {
            Seen::Executed(at) => {
                let Some(InHand {
                    exception,
                    activation: Some(activation),
                    ..
                }) = self.stack.last_mut()
                else {
                    return;
                };
                let Some(watch) = self.watches.get(exception) else {
                    return;
                };
                if let Err(refuted) = watch.see(activation, at) {
                    let exception = *exception;
                    note(
                        &mut lock(&self.findings)
                            .handlers
                            .entry(exception)
                            .or_default()
                            .refuted,
                        refuted,
                    );
                }
            }
            Seen::Entered(exception, now, mask) => self.begin(exception, now.as_ticks(), mask),
            Seen::Chained(exception, now, mask) => {
                self.end(mask);
                self.begin(exception, now.as_ticks(), mask);
            }
            Seen::Returned(mask) => self.end(mask),
            Seen::Stored(by, at, held) => {
                self.held.insert(at, held);
                if self.began.is_none() {
                    return;
                }
                if let Some(&left) = self.known.lasting.get(&at) {
                    self.strays(Stray::Word { by, at, left });
                }
                if self.is_other(at, held) {
                    let (by, found) = (Some(by), held);
                    self.strays(Stray::Other { by, at, found });
                }
            }
            Seen::Rearranged(by, register) => {
                if self.began.is_some() {
                    self.strays(Stray::Rearranged { by, register });
                }
            }
            Seen::Moved {
                controller,
                unit,
                at,
                from,
            } => self.moved(
                Unit {
                    controller,
                    number: unit,
                },
                at.as_ticks(),
                from,
            ),
            Seen::Reset => {
                self.stack.clear();
                self.starts += 1;
                self.began = None;
            }
        }
    }

    fn moved(&self, by: Unit, now: u64, from: u32) {
        if FLASH.contains(&from) {
            self.strays(Stray::Flash { by, from });
        }
        if self.began.is_some_and(|began| now >= began + self.start_up) {
            let mut findings = lock(&self.findings);
            note_time(findings.transfers.entry(by).or_default(), self.starts, now);
        }
    }

    /// Notes a store, unless the same one is known.
    fn strays(&self, stray: Stray) {
        let known = &mut lock(&self.findings).stray;
        if !known.contains(&stray) {
            known.push(stray);
        }
    }

    /// Compares what start-up has left in memory with what the analysis found.
    fn compare(&self) {
        let found_at = |at| self.held.get(&at).copied().unwrap_or_default();
        for (&at, &left) in &self.known.lasting {
            let found = found_at(at);
            if found != left {
                self.strays(Stray::Left { at, left, found });
            }
        }
        for &at in self.known.choices.keys() {
            let found = found_at(at);
            if self.is_other(at, found) {
                self.strays(Stray::Other {
                    by: None,
                    at,
                    found,
                });
            }
        }
    }

    /// Whether a word holds none of the addresses that the analysis found for it.
    fn is_other(&self, at: u32, held: u32) -> bool {
        let choices = self.known.choices.get(&at);
        choices.is_some_and(|words| !words.contains(&held))
    }

    fn begin(&mut self, exception: u16, now: u64, mask: u8) {
        if self.began.is_none() {
            self.compare();
        }
        let watch = self.watches.get(&exception);
        let began = *self.began.get_or_insert(now);
        if watch.is_some() && now - began >= self.start_up {
            let mut findings = lock(&self.findings);
            let found = findings.handlers.entry(exception).or_default();
            note_time(&mut found.entered, self.starts, now);
        }
        self.stack.push(InHand {
            exception,
            mask,
            activation: watch.map(|watch| watch.activation()),
        });
    }

    fn end(&mut self, left: u8) {
        let Some(ended) = self.stack.pop() else {
            return;
        };
        let mut findings = lock(&self.findings);
        if ended.activation.is_some() {
            let found = findings.handlers.entry(ended.exception).or_default();
            found.activations += 1;
        }
        if ended.mask != left {
            let refuted = Refuted::Mask {
                found: ended.mask,
                left,
            };
            let found = findings.handlers.entry(ended.exception).or_default();
            note(&mut found.refuted, refuted);
        }
    }
}

/// Adds a time to those of the start that is number `starts`.
fn note_time(runs: &mut Vec<Vec<u64>>, starts: usize, now: u64) {
    runs.resize_with(starts, Vec::new);
    if let Some(run) = runs.last_mut() {
        run.push(now);
    }
}

/// Locks the findings. Poisoning is ignored: no panic can leave them half-written.
pub fn lock(findings: &Mutex<Findings>) -> MutexGuard<'_, Findings> {
    findings.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Adds a refuted assumption. Each place is listed once, with its largest count.
fn note(all: &mut Vec<Refuted>, new: Refuted) {
    let known = all.iter_mut().find(|known| match (&**known, &new) {
        (Refuted::Turns { at, .. }, Refuted::Turns { at: other, .. })
        | (Refuted::Times { at, .. }, Refuted::Times { at: other, .. }) => at == other,
        // Every step after the first one that leaves the graph is outside of it too.
        (Refuted::Outside(_), Refuted::Outside(_))
        | (Refuted::Mask { .. }, Refuted::Mask { .. }) => true,
        _ => false,
    });
    match known {
        None => all.push(new),
        Some(known) => {
            let larger = match (&*known, &new) {
                (Refuted::Turns { turns, .. }, Refuted::Turns { turns: other, .. }) => {
                    other > turns
                }
                (Refuted::Times { times, .. }, Refuted::Times { times: other, .. }) => {
                    other > times
                }
                _ => false,
            };
            if larger {
                *known = new;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Follower, Stray, lock};
    use can_bus::SimTime;
    use std::collections::BTreeMap;
    use twin::mcu::{Seen, Storer};
    use wcet::lasting::Known;
    use wcet::watch::Refuted;

    #[test]
    fn a_handler_that_leaves_another_mask_is_told() {
        let follower = Follower::new(BTreeMap::new(), Known::default(), 0);
        let findings = follower.findings();
        let mut see = follower.trace();
        let now = SimTime::from_ticks(0);
        see(Seen::Entered(20, now, 0x50));
        see(Seen::Entered(21, now, 0x40));
        see(Seen::Chained(22, now, 0x40));
        see(Seen::Returned(0x50));
        see(Seen::Returned(0x50));
        let findings = lock(&findings);
        let refuted: Vec<_> = findings
            .handlers
            .iter()
            .filter(|(_, found)| !found.refuted.is_empty())
            .map(|(exception, found)| (*exception, found.refuted.clone()))
            .collect();
        let left = Refuted::Mask {
            found: 0x40,
            left: 0x50,
        };
        assert_eq!(refuted, [(22, vec![left])]);
    }

    #[test]
    fn what_start_up_leaves_is_compared_when_the_first_handler_begins() {
        let known = Known {
            lasting: BTreeMap::from([(0x2000_0000, 7), (0x2000_0004, 9)]),
            choices: BTreeMap::from([(0x2000_0008, [0, 5].into())]),
        };
        let follower = Follower::new(BTreeMap::new(), known, 0);
        let findings = follower.findings();
        let mut see = follower.trace();
        let now = SimTime::from_ticks(0);
        let store = |at, held| Seen::Stored(Storer::Instruction(2), at, held);
        // Until then start-up may do what it likes.
        see(store(0x2000_0000, 1));
        see(Seen::Rearranged(4, 0xe000_e400));
        see(store(0x2000_0000, 7));
        see(store(0x2000_0004, 8));
        see(Seen::Entered(20, now, 0));
        let left = Stray::Left {
            at: 0x2000_0004,
            left: 9,
            found: 8,
        };
        assert_eq!(lock(&findings).stray, [left]);
        // The same again after another start, which stores what it has to.
        see(Seen::Reset);
        see(store(0x2000_0004, 9));
        see(Seen::Entered(20, now, 0));
        assert_eq!(lock(&findings).stray, [left]);
        see(store(0x2000_0000, 7));
        see(Seen::Rearranged(6, 0xe000_e400));
        let word = Stray::Word {
            by: Storer::Instruction(2),
            at: 0x2000_0000,
            left: 7,
        };
        let rearranged = Stray::Rearranged {
            by: 6,
            register: 0xe000_e400,
        };
        assert_eq!(lock(&findings).stray, [left, word, rearranged]);
        see(store(0x2000_0008, 5));
        see(store(0x2000_0008, 6));
        let other = Stray::Other {
            by: Some(Storer::Instruction(2)),
            at: 0x2000_0008,
            found: 6,
        };
        assert_eq!(lock(&findings).stray, [left, word, rearranged, other]);
    }
}
