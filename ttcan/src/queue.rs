//! The queue of messages that wait for an arbitrating window.

use core::num::NonZeroU8;

use crate::frame::Frame;
use crate::id::Id;
use crate::time::Stamp;

/// What is to be sent. The numbers leave 0 for a place without a message, so that an empty queue is all
/// zeros, which takes less code to make.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub(crate) enum Kind {
    /// An event message.
    Event = 1,
    /// A scheduled message that missed its window.
    Late = 2,
}

/// A message in the queue. Both kinds have the same fields, so that the queue does not have to tell
/// them apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Item {
    pub(crate) kind: Kind,
    /// The window that a late message missed; 0 for an event message.
    pub(crate) window: u16,
    /// A late message has no data yet.
    pub(crate) frame: Frame,
}

impl Item {
    pub(crate) const fn event(frame: Frame) -> Self {
        Self {
            kind: Kind::Event,
            window: 0,
            frame,
        }
    }

    pub(crate) const fn late(window: u16, id: Id, len: u8) -> Self {
        Self {
            kind: Kind::Late,
            window,
            frame: Frame::from_parts(id, len, [0; 8]),
        }
    }
}

/// A place in the queue, counted from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Place(NonZeroU8);

impl Place {
    /// The place of an index in the array.
    fn of(index: usize) -> Option<Self> {
        NonZeroU8::new((index as u8).wrapping_add(1)).map(Self)
    }

    fn index(self) -> usize {
        usize::from(self.0.get()) - 1
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Waiting {
    /// Running number, for the order among equal identifiers.
    turn: u32,
    expires: Stamp,
    item: Item,
}

impl Waiting {
    fn id(&self) -> Id {
        self.item.frame.id()
    }

    fn goes_before(&self, other: &Self) -> bool {
        if self.id() == other.id() {
            self.turn.wrapping_sub(other.turn).cast_signed() < 0
        } else {
            self.id() < other.id()
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
    turn: u32,
    first: Option<Place>,
}

impl<const Q: usize> Queue<Q> {
    /// A constant, because a value that is made at run time is built on the stack first.
    pub(crate) const EMPTY: Self = Self {
        places: [None; Q],
        turn: 0,
        first: None,
    };

    pub(crate) const fn is_empty(&self) -> bool {
        self.first.is_none()
    }

    #[cfg(feature = "events")]
    pub(crate) fn len(&self) -> usize {
        self.places.iter().flatten().count()
    }

    fn waiting(&self, place: Option<Place>) -> Option<&Waiting> {
        self.places.get(place?.index())?.as_ref()
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
        kept: Option<Place>,
    ) -> Option<u32> {
        let new = Waiting {
            turn: self.turn,
            expires,
            item,
        };
        let first = self.waiting(self.first);
        let before = first.is_none_or(|first| new.goes_before(first));
        for (index, place) in self.places.iter_mut().enumerate() {
            let at = Place::of(index);
            if let Some(waiting) = place
                && (!now.reached(waiting.expires) || at == self.first || at == kept)
            {
                continue;
            }
            let expired = place.replace(new).is_some();
            if before {
                self.first = at;
            }
            self.turn = self.turn.wrapping_add(1);
            return Some(u32::from(expired));
        }
        None
    }

    /// Whether a message with this identifier waits.
    #[cfg(feature = "events")]
    // Not inlined, so that the analysis finds the bounds of its loops.
    #[inline(never)]
    pub(crate) fn has(&self, id: Id) -> bool {
        let mut waiting = self.places.iter().flatten();
        waiting.any(|waiting| waiting.id() == id)
    }

    /// Puts a message in the place of one of its identifier, except the one at `kept`. It keeps that
    /// one's turn. False if there is none.
    #[cfg(feature = "events")]
    #[inline(never)]
    pub(crate) fn replace(&mut self, item: Item, expires: Stamp, kept: Option<Place>) -> bool {
        let id = item.frame.id();
        let mut older: Option<&mut Waiting> = None;
        for (index, place) in self.places.iter_mut().enumerate() {
            if let Some(waiting) = place
                && waiting.id() == id
                && kept != Place::of(index)
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
    pub(crate) fn first(&self, now: Stamp) -> Option<(Place, bool)> {
        let waiting = self.waiting(self.first)?;
        Some((self.first?, now.reached(waiting.expires)))
    }

    /// The message at a place.
    pub(crate) fn get(&self, place: Place) -> Option<&Item> {
        self.waiting(Some(place)).map(|waiting| &waiting.item)
    }

    fn find_first(&self) -> Option<Place> {
        let mut first: Option<(usize, &Waiting)> = None;
        for (index, place) in self.places.iter().enumerate() {
            if let Some(waiting) = place
                && first.is_none_or(|(_, first)| waiting.goes_before(first))
            {
                first = Some((index, waiting));
            }
        }
        first.and_then(|(index, _)| Place::of(index))
    }

    /// Removes the message at a place.
    #[inline(never)]
    pub(crate) fn remove(&mut self, place: Place) {
        if let Some(place) = self.places.get_mut(place.index()) {
            *place = None;
        }
        self.first = self.find_first();
    }

    pub(crate) fn clear(&mut self) {
        *self = Self::EMPTY;
    }

    /// Moves all deadlines so that `now` becomes stamp 0, and sorts the messages so
    /// that queues with the same messages are equal. Returns the new place of the
    /// message at `place`.
    #[cfg(feature = "std")]
    pub(crate) fn shift(&mut self, now: Stamp, place: Option<Place>) -> Option<Place> {
        let turn = |waiting: &Option<Waiting>| waiting.as_ref().map(|waiting| waiting.turn);
        let followed = place.and_then(|place| turn(self.places.get(place.index())?));
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
        moved.and_then(Place::of).or(place)
    }
}
