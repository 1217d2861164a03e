//! The queue of messages that wait for an arbitrating window.

use crate::frame::Frame;
use crate::id::Id;
use crate::time::Stamp;

/// A message in the queue.
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
    pub(crate) fn id(&self) -> Id {
        match self {
            Self::Event(frame) => frame.id(),
            Self::Late { id, .. } => *id,
        }
    }

    pub(crate) fn len(&self) -> u8 {
        match self {
            Self::Event(frame) => frame.len(),
            Self::Late { len, .. } => *len,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Waiting {
    /// Identifier of the item, copied for quick comparison.
    id: Id,
    /// Running number, for the order among equal identifiers.
    turn: u32,
    expires: Stamp,
    item: Item,
}

impl Waiting {
    fn goes_before(&self, other: &Self) -> bool {
        if self.id == other.id {
            self.turn.wrapping_sub(other.turn).cast_signed() < 0
        } else {
            self.id < other.id
        }
    }
}

/// A priority queue of up to `Q` messages: the lowest identifier first, equal
/// identifiers in the order in which they were inserted. Messages stay in their
/// places. The first one is searched when one is removed, because there is time
/// then; an insertion only compares with it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Queue<const Q: usize> {
    places: [Option<Waiting>; Q],
    count: usize,
    turn: u32,
    first: Option<u8>,
}

impl<const Q: usize> Queue<Q> {
    pub(crate) const fn new() -> Self {
        Self {
            places: [None; Q],
            count: 0,
            turn: 0,
            first: None,
        }
    }

    pub(crate) const fn is_empty(&self) -> bool {
        self.count == 0
    }

    pub(crate) const fn len(&self) -> usize {
        self.count
    }

    /// Inserts a message, in the place of one that expired by `now` if need be.
    /// Returns how many messages expired, or `None` if there is no room. The first
    /// message keeps its place until its turn, and the one at `kept` until its
    /// transmission is reported.
    // Not inlined, so that the analysis finds the bounds of its loops.
    #[inline(never)]
    pub(crate) fn insert(
        &mut self,
        item: Item,
        expires: Stamp,
        now: Stamp,
        kept: Option<u8>,
    ) -> Option<u32> {
        let turn = self.turn;
        let new = Waiting {
            id: item.id(),
            turn,
            expires,
            item,
        };
        let before = match self.first.map(|first| self.places.get(usize::from(first))) {
            Some(Some(Some(first))) => new.goes_before(first),
            _ => true,
        };
        for (at, place) in self.places.iter_mut().enumerate() {
            let at = at as u8;
            let expired = place
                .as_ref()
                .is_some_and(|waiting| now.reached(waiting.expires))
                && self.first != Some(at)
                && kept != Some(at);
            if place.is_none() || expired {
                *place = Some(new);
                if before {
                    self.first = Some(at);
                }
                self.turn = turn.wrapping_add(1);
                self.count += usize::from(!expired);
                return Some(u32::from(expired));
            }
        }
        None
    }

    /// Whether a message with this identifier waits.
    #[cfg(feature = "events")]
    // Not inlined, so that the analysis finds the bounds of its loops.
    #[inline(never)]
    pub(crate) fn has(&self, id: Id) -> bool {
        let mut waiting = self.places.iter().flatten();
        waiting.any(|waiting| waiting.id == id)
    }

    /// Puts a message in the place of one of its identifier, except the one at `kept`. It keeps that
    /// one's turn. False if there is none.
    #[cfg(feature = "events")]
    #[inline(never)]
    pub(crate) fn replace(&mut self, item: Item, expires: Stamp, kept: Option<u8>) -> bool {
        let id = item.id();
        let mut older: Option<&mut Waiting> = None;
        for (at, place) in self.places.iter_mut().enumerate() {
            if let Some(waiting) = place
                && waiting.id == id
                && kept != Some(at as u8)
            {
                older = Some(waiting);
            }
        }
        let Some(older) = older else {
            return false;
        };
        (older.item, older.expires) = (item, expires);
        true
    }

    /// The place of the first message, and whether it has expired by `now`.
    pub(crate) fn first(&self, now: Stamp) -> Option<(u8, bool)> {
        let at = self.first?;
        let waiting = self.places.get(usize::from(at))?.as_ref()?;
        Some((at, now.reached(waiting.expires)))
    }

    fn find_first(&self) -> Option<u8> {
        let mut first: Option<(u8, &Waiting)> = None;
        for (at, place) in self.places.iter().enumerate() {
            if let Some(waiting) = place
                && first.is_none_or(|(_, first)| waiting.goes_before(first))
            {
                first = Some((at as u8, waiting));
            }
        }
        first.map(|(at, _)| at)
    }

    /// The message at a place.
    pub(crate) fn get(&self, place: u8) -> Option<&Item> {
        self.places
            .get(usize::from(place))?
            .as_ref()
            .map(|waiting| &waiting.item)
    }

    /// Removes the message at a place.
    #[inline(never)]
    pub(crate) fn remove(&mut self, place: u8) {
        if let Some(place) = self.places.get_mut(usize::from(place))
            && place.is_some()
        {
            *place = None;
            self.count = self.count.saturating_sub(1);
            self.first = self.find_first();
        }
    }

    pub(crate) fn clear(&mut self) {
        *self = Self::new();
    }

    /// Moves all deadlines so that `now` becomes stamp 0, and sorts the messages so
    /// that queues with the same messages are equal. Returns the new place of the
    /// message at `place`.
    #[cfg(feature = "std")]
    pub(crate) fn shift(&mut self, now: Stamp, place: u8) -> u8 {
        let turn = |waiting: &Option<Waiting>| waiting.as_ref().map(|waiting| waiting.turn);
        let followed = self.places.get(usize::from(place)).and_then(turn);
        self.places.sort_by(|one, other| match (one, other) {
            (Some(one), Some(other)) if one.goes_before(other) => core::cmp::Ordering::Less,
            (Some(_), Some(_)) => core::cmp::Ordering::Greater,
            _ => other.is_some().cmp(&one.is_some()),
        });
        let moved = self
            .places
            .iter()
            .position(|waiting| followed.is_some() && turn(waiting) == followed);
        self.turn = 0;
        for waiting in self.places.iter_mut().flatten() {
            waiting.expires = Stamp(waiting.expires.0.wrapping_sub(now.0));
            waiting.turn = self.turn;
            self.turn += 1;
        }
        self.first = self.find_first();
        moved.map_or(place, |moved| moved as u8)
    }
}
