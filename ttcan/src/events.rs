//! Messages that wait for an arbitrating window.

use crate::{Frame, Id, Stamp};

/// What is to be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Item {
    Event(Frame),
    /// A scheduled message that missed its window.
    Late {
        window: u16,
        id: Id,
        len: u8,
    },
}

impl Item {
    pub fn id(&self) -> Id {
        match self {
            Self::Event(frame) => frame.id(),
            Self::Late { id, .. } => *id,
        }
    }

    pub fn len(&self) -> u8 {
        match self {
            Self::Event(frame) => frame.len(),
            Self::Late { len, .. } => *len,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Waiting {
    item: Item,
    expires: Stamp,
}

/// Up to `Q` messages by identifier, messages of one identifier in the order
/// in which they came.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Queue<const Q: usize> {
    waiting: [Option<Waiting>; Q],
}

impl<const Q: usize> Queue<Q> {
    pub const fn new() -> Self {
        Self { waiting: [None; Q] }
    }

    pub fn is_empty(&self) -> bool {
        !matches!(self.waiting.first(), Some(Some(_)))
    }

    pub fn len(&self) -> usize {
        self.waiting.iter().flatten().count()
    }

    /// `false` when there is no room.
    pub fn insert(&mut self, item: Item, expires: Stamp) -> bool {
        if !matches!(self.waiting.last(), Some(None)) {
            return false;
        }
        let mut carried = Some(Waiting { item, expires });
        for place in &mut self.waiting {
            let goes_before = match (&carried, &*place) {
                (Some(new), Some(old)) => new.item.id() < old.item.id(),
                (Some(_), None) => true,
                (None, _) => break,
            };
            if goes_before {
                core::mem::swap(place, &mut carried);
            }
        }
        true
    }

    /// The most urgent message.
    pub fn first(&self) -> Option<&Item> {
        self.waiting.first()?.as_ref().map(|waiting| &waiting.item)
    }

    /// Removes the oldest message of `id`.
    pub fn remove(&mut self, id: Id) {
        let place = self.find(|waiting| waiting.item.id() == id);
        if let Some(place) = place {
            self.remove_at(place);
        }
    }

    /// Drops what has expired by `now` and returns how many that were.
    pub fn expire(&mut self, now: Stamp) -> u32 {
        let mut expired = 0;
        // loop-bound: 8 places, all of them expired
        while let Some(place) = self.find(|waiting| now.reached(waiting.expires)) {
            // at-most: 2 messages that expire together
            self.remove_at(place);
            expired += 1;
        }
        expired
    }

    fn find(&self, wanted: impl Fn(&Waiting) -> bool) -> Option<usize> {
        self.waiting
            .iter()
            .position(|waiting| waiting.as_ref().is_some_and(&wanted))
    }

    #[inline(never)]
    fn remove_at(&mut self, place: usize) {
        // From the end, each takes the place of the one before it.
        let mut carried = None;
        for place in self.waiting.iter_mut().skip(place).rev() {
            core::mem::swap(place, &mut carried);
        }
    }

    pub fn clear(&mut self) {
        self.waiting = [None; Q];
    }

    /// Moves all deadlines so that `now` becomes stamp 0.
    #[cfg(feature = "std")]
    pub fn shift(&mut self, now: Stamp) {
        for waiting in self.waiting.iter_mut().flatten() {
            waiting.expires = Stamp(waiting.expires.0.wrapping_sub(now.0));
        }
    }
}
