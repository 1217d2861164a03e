//! Switches the sections of an implement at the borders of legs.

use super::stretch::{PIECES, Stretch};
use crate::path::Progress;
use crate::scalar::Scalar;

/// Number of sections.
const SECTIONS: usize = 8;

/// A section of an implement and its actuator.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Section<T> {
    /// Time from its command until it is on, s, not negative.
    pub on_delay: T,
    /// Time from its command until it is off, s, not negative.
    pub off_delay: T,
    /// Its distance ahead of the rear axle, m; negative behind it. It is taken along the path.
    pub ahead: T,
}

/// What to do with the sections in this period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Switching<T> {
    /// Sections that are to be on at its beginning.
    pub now: u8,
    /// For each section the time within the period at which it is to be switched over, s, if
    /// there is one.
    pub later: [Option<T>; SECTIONS],
}

/// The sections of an implement: one for each bit of a leg's outputs.
#[derive(Clone, Copy, Debug)]
pub struct Outputs<T> {
    sections: [Section<T>; SECTIONS],
    state: u8,
    /// For each section the piece for which it was last switched. A section is switched before
    /// it is there, by its delay.
    since: [usize; SECTIONS],
}

impl<T: Scalar> Outputs<T> {
    /// All sections off.
    #[must_use]
    pub fn new(sections: [Section<T>; SECTIONS]) -> Self {
        Self {
            sections,
            state: 0,
            since: [0; SECTIONS],
        }
    }

    /// The sections that are switched on.
    #[must_use]
    pub fn state(&self) -> u8 {
        self.state
    }

    /// Decides for the next `period` (s), when the vehicle is at `progress` in `stretch` and travels at
    /// `speed` (m/s, positive in the direction of travel). The way in a section's delay is predicted
    /// with the speeds of the mission. While the mission is paused, and at its end, all sections
    /// are off.
    pub fn step(
        &mut self,
        stretch: &Stretch<T>,
        progress: &Progress<T>,
        speed: T,
        period: T,
    ) -> Switching<T> {
        let mut later = [None; SECTIONS];
        if stretch.is_paused() || progress.finished || stretch.piece(progress.segment).is_none() {
            self.state = 0;
            self.since = [0; SECTIONS];
            return Switching { now: 0, later };
        }
        let before = self.state;
        let (mut now, mut end) = (before, before);
        let sections = self.sections.iter().zip(&mut self.since);
        let about = About {
            stretch,
            progress,
            speed,
            period,
        };
        // loop-bound: 8
        for (bit, ((section, since), later)) in sections.zip(&mut later).enumerate() {
            let mask = 1_u8 << bit;
            let switch = about.switch(section, mask, before, *since);
            *since = switch.since;
            *later = switch.later;
            now ^= if switch.now { mask } else { 0 };
            end ^= if switch.now || switch.later.is_some() {
                mask
            } else {
                0
            };
        }
        self.state = end;
        Switching { now, later }
    }
}

/// What decides about all sections.
struct About<'a, T> {
    stretch: &'a Stretch<T>,
    progress: &'a Progress<T>,
    speed: T,
    period: T,
}

/// What happens to a section.
struct Switch<T> {
    now: bool,
    later: Option<T>,
    since: usize,
}

impl<T: Scalar> About<'_, T> {
    /// Whether the section of this bit is switched over, when sections are on as in `state` and it was last
    /// switched for piece `since`.
    // A function of its own: its many ways would make several loops of the one over the sections.
    #[inline(never)]
    fn switch(&self, section: &Section<T>, mask: u8, state: u8, since: usize) -> Switch<T> {
        let Self {
            stretch,
            progress,
            speed,
            period,
        } = *self;
        let stays = Switch {
            now: false,
            later: None,
            since,
        };
        let on = state & mask != 0;
        let change = stretch.change(progress, section.ahead, since, |outputs| {
            (outputs & mask != 0) != on
        });
        let Some((piece, distance)) = change else {
            return stays;
        };
        let delay = if on {
            section.off_delay
        } else {
            section.on_delay
        };
        // No prediction for a border that is out of reach.
        let longest = delay + period;
        if distance > (speed.abs() + stretch.pace().acceleration * longest) * longest {
            return stays;
        }
        let reached = stretch.predict(progress, speed, delay);
        if distance <= reached {
            return Switch {
                now: true,
                since: piece,
                ..stays
            };
        }
        let after = stretch.predict(progress, speed, longest);
        if !(distance < after) {
            return stays;
        }
        Switch {
            later: Some(period * (distance - reached) / (after - reached)),
            since: piece,
            ..stays
        }
    }
}

impl<T: Scalar> Stretch<T> {
    /// The first piece from number `since` on that does not lie behind the point `ahead` metres
    /// ahead of the rear axle, and whose outputs are `wanted`; and the distance from the point to its
    /// beginning (m), zero on it. Behind the end of a mission all outputs are off.
    #[must_use]
    pub fn change(
        &self,
        progress: &Progress<T>,
        ahead: T,
        since: usize,
        wanted: impl Fn(u8) -> bool,
    ) -> Option<(usize, T)> {
        let reverse = self
            .piece(progress.segment)
            .is_some_and(|piece| piece.reverse);
        let here = progress.along + if reverse { -ahead } else { ahead };
        let way = |begin: T| {
            if begin > here {
                begin - here
            } else {
                T::zero()
            }
        };
        let mut begin = T::zero();
        // loop-bound: 16. A stretch has up to PIECES pieces.
        for (number, _) in (self.numbers().start..progress.segment).zip(0..PIECES) {
            begin -= self.piece(number)?.segment.length;
        }
        let mut last = false;
        // loop-bound: 16. A stretch has up to PIECES pieces.
        for (number, _) in self.numbers().zip(0..PIECES) {
            let piece = self.piece(number)?;
            let end = begin + piece.segment.length;
            if number >= since && end > here && wanted(piece.outputs) {
                return Some((number, way(begin)));
            }
            begin = end;
            last = piece.last;
        }
        (last && wanted(0)).then(|| (self.numbers().end, way(begin)))
    }
}
