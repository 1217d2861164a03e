//! The stack of the abstract machine.

use std::rc::Rc;

use super::range::Range;
use super::value::{Symbol, Value};

/// A write of an address on the stack to this many bytes or more is not tracked word by word.
const MAX_POINTER_REACH: u64 = 0x400;

/// A known piece of the stack.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Slot {
    /// Address of its first byte.
    pub address: u32,
    /// Number of bytes.
    pub size: u32,
    /// What it holds.
    pub value: Value,
}

impl Slot {
    /// Address behind its last byte.
    #[must_use]
    pub(crate) const fn end(&self) -> u32 {
        self.address + self.size
    }

    /// Whether it is at the same bytes as `other`.
    #[must_use]
    pub(crate) const fn same_place(&self, other: &Self) -> bool {
        self.address == other.address && self.size == other.size
    }
}

/// Known pieces of the stack, by address. They do not overlap.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct Slots(Rc<Vec<Slot>>);

impl Slots {
    /// These pieces, which are in order and do not overlap.
    #[must_use]
    pub(crate) fn from_sorted(slots: Vec<Slot>) -> Self {
        Self(Rc::new(slots))
    }

    /// Whether the two share their storage, and so are equal.
    #[must_use]
    pub(crate) fn shares(&self, other: &Self) -> bool {
        Rc::ptr_eq(&self.0, &other.0)
    }

    /// All pieces.
    #[must_use]
    pub(crate) fn as_slice(&self) -> &[Slot] {
        &self.0
    }

    /// Index of the first piece that ends behind `address`.
    fn index(&self, address: u32) -> usize {
        self.0.partition_point(|slot| slot.end() <= address)
    }

    /// Reads `size` bytes at a known address.
    #[must_use]
    pub(crate) fn load(&self, address: u32, size: u32) -> Option<Value> {
        let index = self.index(address);
        let slot = self.0.get(index)?;
        if slot.address == address && slot.size == size {
            return Some(slot.value);
        }
        if slot.address <= address && address + size <= slot.end() {
            let word = slot.value.as_constant()? >> (8 * (address - slot.address));
            return Some(Value::constant(if size == 4 {
                word
            } else {
                word & ((1 << (8 * size)) - 1)
            }));
        }
        // A word of several known pieces.
        let mut word = 0;
        let mut covered = 0;
        for slot in &self.0[index..] {
            if slot.address != address + covered || covered + slot.size > size {
                return None;
            }
            word |= slot.value.as_constant()? << (8 * covered);
            covered += slot.size;
            if covered == size {
                return Some(Value::constant(word));
            }
        }
        None
    }

    /// Writes `size` bytes at a known address.
    pub(crate) fn store(&mut self, address: u32, size: u32, value: Value) {
        // A constant that covers more bytes than this write keeps the others.
        let index = self.index(address);
        if let Some(slot) = self.0.get(index)
            && (slot.address, slot.size) != (address, size)
            && slot.address <= address
            && address + size <= slot.end()
            && let (Some(old), Some(new)) = (slot.value.as_constant(), value.as_constant())
        {
            let shift = 8 * (address - slot.address);
            let mask = (((1u64 << (8 * size)) - 1) << shift) as u32;
            let word = (old & !mask) | ((new << shift) & mask);
            Rc::make_mut(&mut self.0)[index].value = Value::constant(word);
            return;
        }
        let touched = touching(Range::constant(address), size);
        if self.0.iter().any(&touched) {
            Rc::make_mut(&mut self.0).retain(|slot| !touched(slot));
        }
        self.put(Slot {
            address,
            size,
            value,
        });
    }

    /// Sets this piece: replaces one at the same bytes or adds a new one, which must not
    /// overlap another.
    pub(crate) fn put(&mut self, new: Slot) {
        let slots = Rc::make_mut(&mut self.0);
        let index = slots.partition_point(|slot| slot.address < new.address);
        match slots.get_mut(index) {
            Some(slot) if slot.same_place(&new) => *slot = new,
            _ => slots.insert(index, new),
        }
    }

    /// Applies `change` to every value.
    pub(crate) fn update(&mut self, change: impl FnMut(&mut Value)) {
        let slots = Rc::make_mut(&mut self.0).iter_mut();
        slots.map(|slot| &mut slot.value).for_each(change);
    }

    /// Notes a write of `size` bytes to an unknown one of `addresses`: every piece that may
    /// have been overwritten becomes unknown. `pointer` is true if an address on the stack was
    /// written. A piece with one of the symbols `kept` is not overwritten.
    ///
    /// Returns true if that address may now be anywhere on the stack, untracked.
    #[must_use]
    pub(crate) fn weaken(
        &mut self,
        addresses: Range,
        size: u32,
        pointer: bool,
        kept: &[Symbol],
    ) -> bool {
        let overlaps = touching(addresses, size);
        let is_kept = |slot: &Slot| {
            let base = slot.value.base;
            base.is_some_and(|(symbol, _)| kept.contains(&symbol))
        };
        let touched = |slot: &Slot| overlaps(slot) && !is_kept(slot);
        if self.0.iter().any(&touched) {
            for slot in Rc::make_mut(&mut self.0) {
                if touched(slot) {
                    slot.value = Value {
                        stack: slot.value.stack || pointer,
                        ..Value::ANY
                    };
                }
            }
        }
        if !pointer {
            return false;
        }
        // Words that were not known before may hold the pointer now.
        let reach = u64::from(addresses.span()) + u64::from(size);
        if reach > MAX_POINTER_REACH {
            return true;
        }
        for offset in (0..reach as u32).step_by(4) {
            let at = (addresses.start() & !3).wrapping_add(offset);
            let index = self.index(at);
            let free = self.0.get(index).is_none_or(|slot| slot.address >= at + 4);
            if free {
                let slot = Slot {
                    address: at,
                    size: 4,
                    value: Value::MAYBE_STACK,
                };
                Rc::make_mut(&mut self.0).insert(index, slot);
            }
        }
        false
    }

    /// Forgets every piece below the stack pointer.
    pub(crate) fn drop_below(&mut self, pointer: u32) {
        if self.0.first().is_some_and(|slot| slot.address < pointer) {
            Rc::make_mut(&mut self.0).retain(|slot| slot.address >= pointer);
        }
    }
}

/// Whether a write of `size` bytes to one of `addresses` may overwrite a part of a piece.
fn touching(addresses: Range, size: u32) -> impl Fn(&Slot) -> bool {
    let first = addresses.start();
    let reach = u64::from(addresses.span()) + u64::from(size);
    move |slot| {
        u64::from(slot.address.wrapping_sub(first)) < reach
            || first.wrapping_sub(slot.address) < slot.size
    }
}
