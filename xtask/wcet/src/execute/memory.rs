//! Memory of the abstract machine: the stack, constants and everything else.

use std::rc::Rc;

use crate::extent::Extent;
use crate::lasting::{FAR, FEW, is_anywhere_in_arrays, is_priorities, places, reach};
use crate::layout::{PERIPHERALS, RAM, STACK, leads_to_memory};
use crate::pend::{Pend, of_store, words};
use crate::range::Range;
use crate::value::Value;

use super::narrow::{adjust, low_bytes, unknown};
use super::step::Step;

/// Constants that are joined for a load with several possible addresses, at most.
pub(super) const MAX_LOADS: u64 = 4096;

/// Address of the register by which a program requests a reset (DDI 0403 B3.2.6).
const AIRCR: u32 = 0xe000_ed0c;
/// What the upper half of every word must be that is written there.
const KEY: u32 = 0x05fa;
/// The bit that requests the reset.
const SYSRESETREQ: u32 = 1 << 2;

/// Whether a word that is written to [`AIRCR`] requests a reset. The other bits may keep what was
/// read there; they are zero in the least of the words.
fn requests_reset(value: &Value) -> bool {
    let (low, high) = value.range.unsigned();
    low >> 16 == KEY && high >> 16 == KEY && low & SYSRESETREQ != 0
}

impl Step<'_, '_> {
    /// The word that a load of `size` bytes gives.
    pub(super) fn load(&mut self, address: &Value, size: u32, signed: bool) -> Value {
        if let Some(at) = address.as_constant()
            && STACK.contains(at)
        {
            return match self.state.stack.load(at, size) {
                Some(value) => low_bytes(&value, size, signed),
                // Never written on this path. Whatever the word is, the program cannot use it
                // as an address.
                None => unknown(size, signed),
            };
        }
        if let Some(enabled) = self.enabled_interrupts(address, size) {
            return enabled;
        }
        if let Some(word) = self.reading(address, size) {
            return word;
        }
        if let Some(at) = address.as_constant()
            && let Some(word) = self.held(at, size)
        {
            return Value::constant(adjust(word, size, signed));
        }
        if let Some(one) = self.choice(address, size) {
            return one;
        }
        let constants = |addresses: &mut dyn Iterator<Item = u32>| -> Option<Vec<u32>> {
            addresses
                .map(|at| Some(adjust(self.constant(at, size)?, size, signed)))
                .collect()
        };
        let words = match self.machine.symbols.targets(address) {
            Some(addresses) => constants(&mut addresses.into_iter()),
            None if address.range.count() <= MAX_LOADS => constants(&mut address.range.iter()),
            None => None,
        };
        if let Some(value) = words.and_then(|words| self.symbols().one_of(words)) {
            return value;
        }
        let on_stack = self.may_be_stack(address);
        Value {
            stack: size == 4 && (on_stack || self.state.escaped),
            ..unknown(size, signed)
        }
    }

    /// What the register of a device gives of which the word is known.
    fn reading(&mut self, address: &Value, size: u32) -> Option<Value> {
        let reading = self.machine.reading.as_ref()?;
        if self.state.moved_up || size != 4 || address.as_constant() != Some(reading.register) {
            return None;
        }
        Some(Value::constant(reading.word))
    }

    /// Takes note of a store that may change what this register gives.
    fn move_up(&mut self, address: &Value, size: u32, value: &Value) {
        let Some(reading) = &self.machine.reading else {
            return;
        };
        let (register, bits) = reading.until;
        let exact = size == 4 && address.as_constant() == Some(register);
        if exact && value.as_constant().is_some_and(|word| word & bits == 0) {
            return;
        }
        let reached = reach(&self.machine.symbols, address, size);
        let until = Extent::new(register, register + 3);
        self.state.moved_up |= reached.is_some_and(|reached| reached.meet(until).is_some());
    }

    /// Whether an access to `address` may reach the stack.
    fn may_be_stack(&self, address: &Value) -> bool {
        address.range.meet(STACK).is_some() && (address.stack || self.state.escaped)
    }

    /// The content of `address`, if it is constant or known at this point of start-up.
    fn constant(&self, address: u32, size: u32) -> Option<u32> {
        let zero = || {
            let bytes = Extent::new(address, address.saturating_add(size - 1));
            self.is_still_zero(bytes).then_some(0)
        };
        self.machine
            .image
            .constant(address, size)
            .or_else(zero)
            .or_else(|| {
                let within = address & 3;
                let words = if self.state.started {
                    &self.machine.memory.lasting
                } else {
                    &self.state.memory
                };
                let word = words
                    .get(&(address - within))
                    .filter(|_| within + size <= 4)?
                    >> (8 * within);
                Some(if size == 4 {
                    word
                } else {
                    word & ((1 << (8 * size)) - 1)
                })
            })
    }

    /// The word at an address that handlers set to one of a few.
    fn choice(&mut self, address: &Value, size: u32) -> Option<Value> {
        if size != 4 || !self.state.started || self.machine.memory.choices.is_empty() {
            return None;
        }
        let [at] = self.machine.symbols.targets(address)?[..] else {
            return None;
        };
        let words = self.machine.memory.choices.get(&at)?;
        let words = words.iter().copied().collect();
        self.symbols().one_of(words)
    }

    /// What `value` may be, if these are a few addresses or zero.
    fn addresses(&self, value: &Value) -> Option<Vec<u32>> {
        let words = self
            .machine
            .symbols
            .elements(value)
            .filter(|_| !value.stack)?;
        let part = &self.machine.part;
        let lead = |word: &u32| *word == 0 || leads_to_memory(part, *word);
        (words.len() as u64 <= FEW && words.iter().all(lead)).then_some(words)
    }

    /// Start-up may have changed these bytes.
    fn touch(&mut self, bytes: Extent) {
        let zeroed = self.machine.image.zeroed();
        if let Some(both) = zeroed.and_then(|zeroed| zeroed.meet(bytes)) {
            Rc::make_mut(&mut self.state.touched).insert(both);
        }
    }

    /// Whether these are bytes of variables that begin as zeros, which start-up has not changed yet.
    fn is_still_zero(&self, bytes: Extent) -> bool {
        let zeroed = self.machine.image.zeroed().filter(|_| !self.state.started);
        zeroed.is_some_and(|zeroed| zeroed.meet(bytes) == Some(bytes))
            && (self.state.touched.iter()).all(|touched| touched.meet(bytes).is_none())
    }

    /// Stores the low `size` bytes of `value`.
    pub(super) fn store(&mut self, address: &Value, size: u32, value: &Value) {
        self.note_write(address, size, value);
        self.move_up(address, size, value);
        self.state.resetting |= address.as_constant() == Some(AIRCR) && requests_reset(value);
        self.lend(address, value);
        self.note_pends(address, size, value);
        if let Some(at) = address.as_constant()
            && STACK.contains(at)
        {
            let kept = self.named(low_bytes(value, size, false));
            self.state.stack.store(at, size, kept);
            return;
        }
        let pointer = value.stack && value.range.meet(STACK).is_some() && size == 4;
        if self.is_in_variable(address) {
            self.state.escaped |= pointer;
        } else if self.may_be_stack(address) {
            self.weaken_stack(address, size, pointer);
        } else if pointer {
            // An address on the stack is now in a word that is not tracked.
            self.state.escaped = true;
        }
    }

    /// Notes a store to an unknown address that may be on the stack.
    fn weaken_stack(&mut self, address: &Value, size: u32, pointer: bool) {
        let stack = &mut self.state.stack;
        let mut escaped = false;
        if let Some(places) = places(&self.machine.symbols, address) {
            for at in places.into_iter().filter(|at| STACK.contains(*at)) {
                escaped |= stack.weaken(Range::constant(at), size, pointer, &[]);
            }
        } else {
            // Nothing is known about such a pointer. It may lead to any variable of the program, but to
            // the word that was found in `BASEPRI` or `PRIMASK` leads no pointer.
            let [clear, set] = self.machine.found_primask;
            let found = [self.machine.found_basepri, clear, set];
            let (within, kept) = if address.range.span() > STACK.span() {
                (STACK, &found[..])
            } else {
                (address.range, &[][..])
            };
            escaped = stack.weaken(within, size, pointer, kept);
        }
        self.state.escaped |= escaped;
    }

    /// Whether a store to `address` certainly stays within a static variable, and so does not
    /// reach the stack.
    fn is_in_variable(&self, address: &Value) -> bool {
        let target = self.machine.memory.target;
        let directed = matches!(target, Some(Some(to)) if to != Extent::EVERYWHERE);
        let far = address.range.span() >= FAR;
        far && directed || self.machine.symbols.origin(address).is_some()
    }

    /// Notes a store outside the stack. Before a task can run it changes the known
    /// words of memory; afterwards its bytes count as written.
    fn note_write(&mut self, address: &Value, size: u32, value: &Value) {
        let reached = match reach(&self.machine.symbols, address, size) {
            Some(Extent::EVERYWHERE) => {
                let target = self.machine.memory.target;
                target.unwrap_or(Some(Extent::EVERYWHERE))
            }
            other => other,
        };
        let Some(reached) = reached else { return };
        if is_anywhere_in_arrays(&self.machine.symbols, address) {
            self.note_arrays();
        }
        if reached != Extent::EVERYWHERE {
            let before = self.state.memory.get(&reached.first).copied();
            let before = before.filter(|_| !self.state.started && size == 4);
            let system = &mut self.machine.memory.system;
            system.note(reached, size, value, before);
            if reached.contains(AIRCR) && !requests_reset(value) {
                system.note_group(value);
            }
            self.note_enables(reached, size, value);
        }
        self.hold(reached, address, size, value);
        if self.state.started {
            self.machine.memory.written.insert(reached);
            let exact = address.as_constant() == Some(reached.first);
            let addresses = self
                .addresses(value)
                .filter(|_| exact && size == 4 && reached.first & 3 == 0);
            self.machine.memory.stored.note(reached, addresses);
            return;
        }
        if value.as_constant() != Some(0) {
            self.touch(reached);
        }
        let Extent { first, last } = reached;
        let word = if address.as_constant() == Some(first) {
            self.completed(first, size, value)
        } else {
            None
        };
        let known = RAM.contains(first) || is_priorities(first);
        if !known && reached.span() < FAR {
            return;
        }
        let near = first.saturating_sub(3)..=last;
        let touched = self.state.memory.range(near.clone()).next().is_some();
        if touched || word.is_some() {
            let memory = Rc::make_mut(&mut self.state.memory);
            // It is assumed that no store through an unknown pointer writes to the interrupt controller.
            let anywhere = reached == Extent::EVERYWHERE;
            memory.retain(|at, _| !near.contains(at) || anywhere && is_priorities(*at));
            memory.extend(word.map(|word| (first & !3, word)));
        }
    }

    /// Takes note of a store to any array.
    fn note_arrays(&mut self) {
        let image = self.machine.image;
        for array in image.variables().indexable() {
            self.forget_held(array);
            if self.state.started {
                self.machine.memory.written.insert(array);
                self.machine.memory.stored.note(array, None);
            } else {
                self.touch(array);
                let near = array.first.saturating_sub(3)..=array.last;
                if self.state.memory.range(near.clone()).next().is_some() {
                    Rc::make_mut(&mut self.state.memory).retain(|at, _| !near.contains(at));
                }
            }
        }
    }

    /// The word of memory that a store to exactly this address has left known, if it is one to keep.
    /// Compilers store an address in parts where the bytes in front of it are stored as well, so the store may
    /// be the last one of several.
    fn completed(&self, first: u32, size: u32, value: &Value) -> Option<u32> {
        let word = if size == 4 && first & 3 == 0 {
            value.as_constant().filter(|_| !value.stack)
        } else if size < 4 && (first ^ (first + size - 1)) < 4 {
            let at = first & !3;
            let mut bytes = (at..at + 4).rev().map(|at| self.state.held.get(&at));
            bytes.try_fold(0, |word, byte| Some(word << 8 | byte?))
        } else {
            None
        };
        word.filter(|word| leads_to_memory(&self.machine.part, *word) || is_priorities(first))
    }

    /// Notes the exceptions that a store makes pending.
    fn note_pends(&mut self, address: &Value, size: u32, value: &Value) {
        let Some((exceptions, exact)) = of_store(&self.machine.symbols, address, size, value)
        else {
            return;
        };
        for exception in exceptions {
            self.note_pend(exception, exact);
        }
    }

    /// Notes that the instruction makes an exception pending.
    pub(super) fn note_pend(&mut self, exception: u16, exact: bool) {
        self.machine.memory.pends.insert(Pend {
            at: self.instruction.address,
            exception,
            exact,
            early: !self.state.started,
        });
    }

    /// Notes that a peripheral is given the address of a variable: by DMA it may write to that
    /// variable at any time.
    fn lend(&mut self, address: &Value, value: &Value) {
        let inert = self.machine.part.inert;
        let is_inert = |at: u32| inert.is_some_and(|(first, last)| (first..=last).contains(&at));
        let symbols = &self.machine.symbols;
        let to_peripheral = words(symbols, address).is_some_and(|all| {
            let mut all = all.into_iter();
            all.any(|at| PERIPHERALS.contains(at) && !is_inert(at))
        });
        let lent = words(symbols, value).filter(|_| to_peripheral);
        for word in lent.into_iter().flatten() {
            self.lend_word(word);
        }
    }

    /// Notes that a peripheral may be given this word, which may be the address of a variable.
    fn lend_word(&mut self, word: u32) {
        let lent = match self.machine.image.variables().around(word) {
            Some(variable) => variable,
            None if self.machine.part.ram.contains(word) => Extent::EVERYWHERE,
            None => return,
        };
        let memory = &mut self.machine.memory;
        memory.written.insert(lent);
        memory.lent.insert(lent);
        memory.stored.note(lent, None);
        self.touch(lent);
    }
}
