//! What the program is known to keep in its memory ([`lasting`](crate::lasting)).

use std::rc::Rc;

use crate::bound::{Bound, Entry, Problem};
use crate::extent::Extent;
use crate::lasting::{Known, Memory, Stored, UnknownStores, Words, Written, drop_reached};

use super::Analysis;

/// How often all handlers are run to find words that hold one of a few addresses. Two or three runs find them all.
const MOST_ROUNDS: usize = 4;

/// The exceptions that `PRIMASK` does not mask, by number: NMI and HardFault (DDI 0403 B1.5.2).
const UNMASKED: [u16; 2] = [2, 3];

/// What start-up leaves in memory, and what is stored there later.
struct Left {
    words: Words,
    touched: Written,
    stored: Stored,
    /// Whether stores through unresolved pointers are taken to spare words with addresses.
    sparing: bool,
}

impl Analysis<'_> {
    /// Finds the words that keep the address which start-up from `main` wrote to them, and those that the handlers
    /// set to one of a few addresses. They are taken for granted from then on. `handlers` must be all
    /// handlers of the program.
    ///
    /// If no word can be proven because of stores through unresolved pointers, such stores are
    /// treated as `unknown_stores` says.
    pub fn learn(&mut self, main: u32, handlers: &[u32], unknown_stores: UnknownStores) -> Known {
        self.starts_alone = UNMASKED.iter().all(|number| self.never_returns(*number));
        self.learn_all(main, handlers, unknown_stores);
        if Memory::trusts_lent(&self.lent, &self.trusted) {
            self.holds = false;
            self.known.clear();
            // What was taken for granted rests on bytes that DMA may write.
            self.lasting = Rc::default();
            self.choices = Rc::default();
            self.learn_all(main, handlers, unknown_stores);
        }
        Known {
            lasting: (*self.lasting).clone(),
            choices: (*self.choices).clone(),
        }
    }

    /// Whether the program has a handler of the exception of this number, and that never returns.
    fn never_returns(&mut self, exception: u16) -> bool {
        let Some(entry) = self.program.image.vectors().get(&exception).copied() else {
            return false;
        };
        let (bound, memory) = self.explore(entry, Entry::Fault, &[]);
        !bound.returns && !memory.lost && !is_not_followed(&bound)
    }

    fn learn_all(&mut self, main: u32, handlers: &[u32], unknown_stores: UnknownStores) {
        if let Some(left) = self.learn_lasting(main, handlers, unknown_stores) {
            self.learn_choices(main, handlers, left);
        }
    }

    fn learn_lasting(
        &mut self,
        main: u32,
        handlers: &[u32],
        unknown_stores: UnknownStores,
    ) -> Option<Left> {
        let (program, mut memory) = self.explore(main, Entry::Program, &[]);
        let mut lost = memory.lost || is_not_followed(&program);
        self.known.insert((main, Entry::Program), program);
        // Idle code that could not be followed, or that stores anywhere, may only not know these words. It is
        // then run again with them, as each handler is.
        let blind = lost || memory.written.contains(&Extent::EVERYWHERE);
        if blind {
            let (start, left) = self.explore_in((main, Entry::Program), &[], None, true);
            lost = left.lost || is_not_followed(&start);
            memory.left = left.left;
            memory.touched = left.touched;
            memory.stored = Stored::default();
        }
        let left = memory.left.filter(|_| !lost)?;
        let mut words = left.clone();
        if !blind {
            drop_reached(&mut words, &memory.written);
        }
        let again = blind.then_some((main, Entry::Program));
        let entries = handlers.iter().map(|handler| (*handler, Entry::Handler));
        let entries: Vec<(u32, Entry)> = entries.chain(again).collect();
        let mut spared = (unknown_stores == UnknownStores::SparePointers).then(|| words.clone());
        let mut sparing = false;
        loop {
            self.lasting = Rc::new(words.clone());
            let (mut written, stored, lost) = self.stores_of(&entries);
            if sparing {
                written.remove(&Extent::EVERYWHERE);
            }
            if lost {
                written.insert(Extent::EVERYWHERE);
            }
            let fewer = drop_reached(&mut words, &written);
            match spared.take_if(|_| fewer && words.is_empty() && !lost) {
                Some(all) => (words, sparing) = (all, true),
                None if fewer => {}
                None => {
                    memory.stored.extend(stored);
                    return (!lost).then_some(Left {
                        words: left,
                        touched: memory.touched,
                        stored: memory.stored,
                        sparing,
                    });
                }
            }
        }
    }

    fn learn_choices(&mut self, main: u32, handlers: &[u32], left: Left) {
        let Left {
            words,
            touched,
            mut stored,
            sparing,
        } = left;
        let zeroed = self.program.image.zeroed();
        let is_zero = |bytes: Extent| {
            zeroed.is_some_and(|zeroed| zeroed.meet(bytes) == Some(bytes))
                && touched.iter().all(|touched| touched.meet(bytes).is_none())
        };
        let initial = |bytes: Extent| {
            let word = words.get(&bytes.first).copied();
            word.or_else(|| is_zero(bytes).then_some(0))
        };
        let handlers = handlers.iter().map(|handler| (*handler, Entry::Handler));
        let entries: Vec<(u32, Entry)> = handlers.chain([(main, Entry::Program)]).collect();
        for _ in 0..MOST_ROUNDS {
            if sparing {
                stored.spare();
            }
            let found = stored.choices(initial);
            if found == *self.choices {
                return;
            }
            self.choices = Rc::new(found);
            let lost;
            (_, stored, lost) = self.stores_of(&entries);
            if lost {
                return;
            }
        }
    }

    /// The bytes that this code may write, what it stores there, and whether some of it could not be followed.
    fn stores_of(&mut self, entries: &[(u32, Entry)]) -> (Written, Stored, bool) {
        let mut written = Written::new();
        let mut stored = Stored::default();
        let mut lost = false;
        for &(entry, kind) in entries {
            let (bound, memory) = self.explore(entry, kind, &[]);
            lost |= is_not_followed(&bound);
            written.extend(memory.written);
            stored.extend(memory.stored);
            self.known.insert((entry, kind), bound);
        }
        (written, stored, lost)
    }
}

/// Whether a path could not be followed to its end.
fn is_not_followed(bound: &Bound) -> bool {
    bound.problems.iter().any(Problem::hides_paths)
}
