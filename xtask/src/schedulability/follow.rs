//! Follows every activation of a node's interrupt handlers in a run, and reports where one
//! leaves the analysed paths.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use twin::mcu::{Seen, Trace};
use wcet::watch::{Activation, Refuted, Watch};

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

/// Findings by exception number.
pub type Findings = BTreeMap<u16, Found>;

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
    /// How long behind that a start takes, picoseconds.
    start_up: u64,
    findings: Arc<Mutex<Findings>>,
}

impl Follower {
    /// Follows the handlers of these exceptions, each with its watch. A start of the node takes `start_up`
    /// picoseconds from its first handler on.
    #[must_use]
    pub fn new(watches: BTreeMap<u16, Arc<Watch>>, start_up: u64) -> Self {
        Self {
            watches,
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
                        &mut lock(&self.findings).entry(exception).or_default().refuted,
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
            Seen::Reset => {
                self.stack.clear();
                self.starts += 1;
                self.began = None;
            }
        }
    }

    fn begin(&mut self, exception: u16, now: u64, mask: u8) {
        let watch = self.watches.get(&exception);
        let began = *self.began.get_or_insert(now);
        if watch.is_some() && now - began >= self.start_up {
            let mut findings = lock(&self.findings);
            let found = findings.entry(exception).or_default();
            found.entered.resize_with(self.starts, Vec::new);
            if let Some(entered) = found.entered.last_mut() {
                entered.push(now);
            }
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
            findings.entry(ended.exception).or_default().activations += 1;
        }
        if ended.mask != left {
            let refuted = Refuted::Mask {
                found: ended.mask,
                left,
            };
            note(
                &mut findings.entry(ended.exception).or_default().refuted,
                refuted,
            );
        }
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
    use super::{Follower, lock};
    use can_bus::SimTime;
    use std::collections::BTreeMap;
    use twin::mcu::Seen;
    use wcet::watch::Refuted;

    #[test]
    fn a_handler_that_leaves_another_mask_is_told() {
        let follower = Follower::new(BTreeMap::new(), 0);
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
}
