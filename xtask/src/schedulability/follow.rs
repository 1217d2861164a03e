//! Follows every activation of a node's handlers in a run, and says where it
//! leaves what was analysed.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use twin::mcu::{Seen, Trace};
use wcet::watch::{Activation, Refuted, Watch};

/// What was found of one handler.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Found {
    /// Activations followed to their end.
    pub activations: u64,
    /// What does not hold; of several about one place the one furthest off.
    pub refuted: Vec<Refuted>,
}

/// What was found, by the number of the exception.
pub type Findings = BTreeMap<u16, Found>;

/// A handler in hand: its exception and, where it is watched, how far it is.
type InHand = (u16, Option<Activation>);

/// Follows one node.
#[derive(Debug)]
pub struct Follower {
    watches: BTreeMap<u16, Arc<Watch>>,
    /// The handlers in hand, the one that runs last.
    stack: Vec<InHand>,
    findings: Arc<Mutex<Findings>>,
}

impl Follower {
    /// With what each exception's handler must keep to.
    #[must_use]
    pub fn new(watches: BTreeMap<u16, Arc<Watch>>) -> Self {
        Self {
            watches,
            stack: Vec::new(),
            findings: Arc::default(),
        }
    }

    /// Where the findings are gathered.
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
                let Some((exception, Some(activation))) = self.stack.last_mut() else {
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
            Seen::Entered(exception) => self.begin(exception),
            Seen::Chained(exception) => {
                self.end();
                self.begin(exception);
            }
            Seen::Returned => self.end(),
            Seen::Reset => self.stack.clear(),
        }
    }

    fn begin(&mut self, exception: u16) {
        let watch = self.watches.get(&exception);
        self.stack
            .push((exception, watch.map(|watch| watch.activation())));
    }

    fn end(&mut self) {
        if let Some((exception, Some(_))) = self.stack.pop() {
            lock(&self.findings)
                .entry(exception)
                .or_default()
                .activations += 1;
        }
    }
}

/// What is found out of a mutex that nobody can leave half-written.
pub fn lock(findings: &Mutex<Findings>) -> MutexGuard<'_, Findings> {
    findings.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Adds to what is refuted; one place is named once, with its largest count.
fn note(all: &mut Vec<Refuted>, new: Refuted) {
    let known = all.iter_mut().find(|known| match (&**known, &new) {
        (Refuted::Turns { at, .. }, Refuted::Turns { at: other, .. })
        | (Refuted::Times { at, .. }, Refuted::Times { at: other, .. }) => at == other,
        // Whatever follows the first step out of the graph is out of it too.
        (Refuted::Outside(_), Refuted::Outside(_)) => true,
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
