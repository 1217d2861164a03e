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
    /// Running number.
    turn: u32,
}

impl Waiting {
    fn goes_before(&self, other: &Self) -> bool {
        let (own, others) = (self.item.id(), other.item.id());
        own < others || (own == others && self.turn.wrapping_sub(other.turn) > u32::MAX / 2)
    }
}

/// Up to `Q` messages, taken by identifier, and those of one identifier in the
/// order in which they came. They stay where they were put: to look through the
/// places costs less than to keep them in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Queue<const Q: usize> {
    places: [Option<Waiting>; Q],
    count: usize,
    turn: u32,
}

impl<const Q: usize> Queue<Q> {
    pub const fn new() -> Self {
        Self {
            places: [None; Q],
            count: 0,
            turn: 0,
        }
    }

    pub const fn is_empty(&self) -> bool {
        self.count == 0
    }

    pub const fn is_full(&self) -> bool {
        self.count >= Q
    }

    pub const fn len(&self) -> usize {
        self.count
    }

    /// `false` when there is no room.
    // Its loops stay apart from the caller's in the image, where their bounds are looked for.
    #[inline(never)]
    pub fn insert(&mut self, item: Item, expires: Stamp) -> bool {
        let turn = self.turn;
        for place in &mut self.places {
            if place.is_none() {
                *place = Some(Waiting {
                    item,
                    expires,
                    turn,
                });
                self.turn = turn.wrapping_add(1);
                self.count += 1;
                return true;
            }
        }
        false
    }

    /// The most urgent message.
    #[inline(never)]
    pub fn first(&self) -> Option<&Item> {
        let mut first: Option<&Waiting> = None;
        // loop-bound: 8 places
        for waiting in self.places.iter().flatten() {
            if first.is_none_or(|first| waiting.goes_before(first)) {
                first = Some(waiting);
            }
        }
        first.map(|waiting| &waiting.item)
    }

    /// Removes the oldest message of `id`.
    #[inline(never)]
    pub fn remove(&mut self, id: Id) {
        let mut oldest: Option<(usize, &Waiting)> = None;
        // loop-bound: 8 places
        for (at, place) in self.places.iter().enumerate() {
            if let Some(waiting) = place
                && waiting.item.id() == id
                && oldest.is_none_or(|(_, oldest)| waiting.goes_before(oldest))
            {
                oldest = Some((at, waiting));
            }
        }
        if let Some((at, _)) = oldest
            && let Some(place) = self.places.get_mut(at)
        {
            *place = None;
            self.count = self.count.saturating_sub(1);
        }
    }

    /// Drops what has expired by `now` and returns how many that were.
    #[inline(never)]
    pub fn expire(&mut self, now: Stamp) -> u32 {
        let mut expired = 0;
        for place in &mut self.places {
            if place.is_some_and(|waiting| now.reached(waiting.expires)) {
                *place = None;
                self.count = self.count.saturating_sub(1);
                expired += 1;
            }
        }
        expired
    }

    pub fn clear(&mut self) {
        *self = Self::new();
    }

    /// Moves all deadlines so that `now` becomes stamp 0, and makes queues equal
    /// that hold the same messages.
    #[cfg(feature = "std")]
    pub fn shift(&mut self, now: Stamp) {
        self.places.sort_by(|one, other| match (one, other) {
            (Some(one), Some(other)) if one.goes_before(other) => core::cmp::Ordering::Less,
            (Some(_), Some(_)) => core::cmp::Ordering::Greater,
            _ => other.is_some().cmp(&one.is_some()),
        });
        self.turn = 0;
        for waiting in self.places.iter_mut().flatten() {
            waiting.expires = Stamp(waiting.expires.0.wrapping_sub(now.0));
            waiting.turn = self.turn;
            self.turn += 1;
        }
    }
}
