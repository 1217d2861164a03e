//! The part of a mission's path that lies about the vehicle.

use super::pace::Pace;
use crate::path::{Place, Progress, Segment};
use crate::position::Position;
use crate::route::{Bend, Route};
use crate::scalar::Scalar;

/// Largest number of pieces in a stretch: three that have been driven, the current one, a turn of
/// eleven parts, and the leg behind it.
pub const PIECES: usize = 16;

/// Pieces behind the current one that are kept, because an implement may still be on them.
const BEHIND: usize = 3;

/// Largest number of pieces that the vehicle passes in one step.
const STEPS: usize = 1;

/// The vehicle counts as arrived at a stop this far before it, m.
const ARRIVED: f64 = 0.005;

/// What a piece is for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Purpose {
    /// A leg of the mission.
    #[default]
    Leg,
    /// The turn behind a leg.
    Turn,
    /// The way to a leg, from where the vehicle was.
    Approach,
}

/// A piece of a mission's path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Piece<T> {
    /// The segment. Its heading is the direction of travel.
    pub segment: Segment<T>,
    /// The leg that it is, behind which it is a turn, or to which it leads.
    pub leg: usize,
    /// What it is for.
    pub purpose: Purpose,
    /// Distance along the leg, the turn or the approach at its beginning, m.
    pub from: T,
    /// Largest speed on it, m/s.
    pub speed: T,
    /// True if the vehicle drives it backwards.
    pub reverse: bool,
    /// Sections of the implement that are on.
    pub outputs: u8,
    /// True if the mission ends with it.
    pub last: bool,
}

/// Where the vehicle is in its mission.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Whereabouts<T> {
    /// The leg, counted from zero; during a turn the one before it, on an approach the one ahead.
    pub leg: usize,
    /// Whether it is on the leg.
    pub purpose: Purpose,
    /// Distance along the leg, the turn or the approach, m.
    pub along: T,
}

/// A ring of the pieces about the vehicle. Pieces are numbered from the beginning of the mission,
/// as [`Progress::segment`] counts them.
#[derive(Clone, Copy, Debug)]
pub struct Stretch<T> {
    origin: Position,
    pace: Pace<T>,
    pieces: [Piece<T>; PIECES],
    /// Number of the oldest piece.
    first: usize,
    count: usize,
    paused: bool,
}

impl<T: Scalar> Stretch<T> {
    /// A stretch without pieces, in which the vehicle stands.
    #[must_use]
    pub fn new(origin: Position, pace: Pace<T>) -> Self {
        let zero = T::zero();
        Self {
            origin,
            pace,
            pieces: [Piece {
                segment: Segment {
                    start: crate::dubins::Pose {
                        north: zero,
                        east: zero,
                        heading: zero,
                    },
                    curvature: zero,
                    sharpness: zero,
                    length: zero,
                },
                leg: 0,
                purpose: Purpose::Leg,
                from: zero,
                speed: zero,
                reverse: false,
                outputs: 0,
                last: false,
            }; PIECES],
            first: 0,
            count: 0,
            paused: false,
        }
    }

    /// Drops the pieces that lie behind, when the vehicle is on piece `current`. Returns for how many
    /// more there is room.
    pub fn retire(&mut self, current: usize) -> usize {
        let keep = current.saturating_sub(BEHIND);
        let drop = keep.saturating_sub(self.first).min(self.count);
        self.first += drop;
        self.count -= drop;
        PIECES - self.count
    }

    /// Adds a piece behind the last one. False, and nothing added, if there is no room.
    pub fn push(&mut self, piece: Piece<T>) -> bool {
        if self.count >= PIECES {
            return false;
        }
        let number = self.first + self.count;
        if let Some(slot) = self.pieces.get_mut(number % PIECES) {
            *slot = piece;
            self.count += 1;
        }
        true
    }

    /// A piece by its number, if it is in the stretch.
    #[must_use]
    pub fn piece(&self, number: usize) -> Option<&Piece<T>> {
        let inside = number >= self.first && number - self.first < self.count;
        self.pieces.get(number % PIECES).filter(|_| inside)
    }

    /// Numbers of the pieces in the stretch.
    #[must_use]
    pub fn numbers(&self) -> core::ops::Range<usize> {
        self.first..self.first + self.count
    }

    /// Lets the vehicle stop, with all sections off, until [`Self::resume`].
    pub fn pause(&mut self) {
        self.paused = true;
    }

    /// Lets the vehicle drive on.
    pub fn resume(&mut self) {
        self.paused = false;
    }

    /// True between [`Self::pause`] and [`Self::resume`].
    #[must_use]
    pub fn is_paused(&self) -> bool {
        self.paused
    }

    /// The accelerations of the mission.
    #[must_use]
    pub fn pace(&self) -> &Pace<T> {
        &self.pace
    }

    /// Way (m) that a vehicle at `progress`, with `speed` (m/s), drives within `time` (s), at the
    /// speeds of the mission and with the lag of the drive.
    #[must_use]
    pub fn predict(&self, progress: &Progress<T>, speed: T, time: T) -> T {
        const STEPS: u8 = 8;
        let dt = time / T::lit(f64::from(STEPS));
        let share = dt / (dt + self.pace.reaction);
        let mut at = *progress;
        let mut speed = speed;
        let mut way = T::zero();
        // loop-bound: 8
        for _ in 0..STEPS {
            let wanted = self.speed(&at, speed).unwrap_or(speed);
            let before = speed;
            speed += (wanted - speed) * share;
            let driven = (before + speed) * dt * T::lit(0.5);
            way += driven;
            self.pass(&mut at, driven);
        }
        way
    }

    /// Moves `progress` on by `way` (m), up to where the direction changes.
    #[inline(never)]
    fn pass(&self, progress: &mut Progress<T>, way: T) {
        progress.along += way;
        // loop-bound: 16. A stretch has up to PIECES pieces.
        for _ in 0..PIECES {
            let (Some(piece), Some(_)) = (
                self.piece(progress.segment),
                self.piece(progress.segment + 1),
            ) else {
                break;
            };
            if !(progress.along > piece.segment.length) || self.turns_back(progress.segment) {
                break;
            }
            progress.along -= piece.segment.length;
            progress.segment += 1;
        }
    }

    /// Where in its mission the vehicle is; `None` while the stretch is empty.
    #[must_use]
    pub fn whereabouts(&self, progress: &Progress<T>) -> Option<Whereabouts<T>> {
        let piece = self.piece(progress.segment)?;
        Some(Whereabouts {
            leg: piece.leg,
            purpose: piece.purpose,
            along: piece.from + progress.along,
        })
    }

    /// True if the direction of driving changes behind piece `number`.
    fn turns_back(&self, number: usize) -> bool {
        match (self.piece(number), self.piece(number + 1)) {
            (Some(piece), Some(next)) => piece.reverse != next.reverse,
            _ => false,
        }
    }

    /// Curvature (1/m) in the direction of travel, `along` metres along piece `number`. It is that of
    /// the end from there on where the direction changes, or where the stretch ends.
    fn curvature(&self, number: usize, along: T) -> T {
        let mut along = along;
        let mut curvature = T::zero();
        // loop-bound: 16. A stretch has up to PIECES pieces.
        for number in number..self.numbers().end {
            let Some(piece) = self.piece(number) else {
                break;
            };
            curvature = piece.segment.curvature_at(along);
            if !(along > piece.segment.length) || self.turns_back(number) {
                break;
            }
            along -= piece.segment.length;
        }
        curvature
    }

    /// The largest speed (m/s) at `progress`, from the limits of this piece and of those ahead, when
    /// the vehicle drives at `speed` (m/s).
    // Not inlined: its loop is bounded by itself then, and not once for each loop about it.
    #[inline(never)]
    fn allowed(&self, progress: &Progress<T>, speed: T) -> T {
        let zero = T::zero();
        let Some(current) = self.piece(progress.segment) else {
            return zero;
        };
        let mut allowed = current.speed;
        let mut distance = current.segment.length - progress.along;
        // loop-bound: 16. A stretch has up to PIECES pieces.
        for number in progress.segment..self.numbers().end {
            let next = self.piece(number + 1);
            let stops = next.is_none() || self.turns_back(number);
            let limit = match next {
                Some(next) if !stops => next.speed,
                _ => zero,
            };
            let most = self.pace.before(limit, distance, speed);
            if most < allowed {
                allowed = most;
            }
            match next {
                Some(next) if !stops => distance += next.segment.length,
                _ => break,
            }
        }
        if allowed >= self.pace.creep {
            allowed
        } else if distance > zero {
            // The last centimetres before a stop.
            if current.speed < self.pace.creep {
                current.speed
            } else {
                self.pace.creep
            }
        } else {
            zero
        }
    }
}

impl<T: Scalar> Route<T> for Stretch<T> {
    fn origin(&self) -> Position {
        self.origin
    }

    fn advance(&self, progress: &mut Progress<T>, north: T, east: T) -> Place<T> {
        let zero = T::zero();
        let Some(mut piece) = self.piece(progress.segment) else {
            return Place {
                along: zero,
                cross_track: zero,
                bearing: zero,
            };
        };
        let mut place = piece.segment.locate(north, east, progress.along);
        // loop-bound: 1. STEPS: shorter pieces than a step's way are caught up with in the next ones.
        for _ in 0..STEPS {
            let Some(next) = self.piece(progress.segment + 1) else {
                break;
            };
            let end = if next.reverse == piece.reverse {
                piece.segment.length
            } else {
                piece.segment.length - T::lit(ARRIVED)
            };
            if !(place.along > end) {
                break;
            }
            progress.segment += 1;
            piece = next;
            place = piece.segment.enter(north, east);
        }
        progress.finished = piece.last && place.along > piece.segment.length - T::lit(ARRIVED);
        progress.along = place.along;
        place
    }

    /// The curvature of a mission's path has no jumps that a steering could not follow, so nothing
    /// is averaged.
    fn bend(&self, progress: &Progress<T>, _: T, _: T) -> Bend<T> {
        let curvature = self.curvature(progress.segment, progress.along);
        Bend {
            turn: T::zero(),
            curvature,
            curvature_ahead: curvature,
        }
    }

    fn next_curvature(&self, progress: &Progress<T>, way: T) -> Option<T> {
        Some(self.curvature(progress.segment, progress.along + way))
    }

    fn usual_speed(&self, progress: &Progress<T>) -> Option<T> {
        self.piece(progress.segment).map(|piece| piece.speed)
    }

    fn is_ready(&self, progress: &Progress<T>) -> bool {
        self.piece(progress.segment).is_some()
    }

    fn reverse(&self, progress: &Progress<T>) -> bool {
        self.piece(progress.segment)
            .is_some_and(|piece| piece.reverse)
    }

    fn stopping(&self, applied: T, dt: T) -> Option<T> {
        let slower = applied - self.pace.deceleration * dt;
        self.paused.then_some(if slower > self.pace.creep {
            slower
        } else {
            T::zero()
        })
    }

    fn speed(&self, progress: &Progress<T>, speed: T) -> Option<T> {
        let allowed = self.allowed(progress, speed);
        // What the drive does in its lag.
        let faster = speed + self.pace.acceleration * self.pace.reaction;
        let slower = speed - self.pace.deceleration * self.pace.reaction;
        Some(if !self.paused {
            let least = if faster > self.pace.creep {
                faster
            } else {
                self.pace.creep
            };
            if least < allowed { least } else { allowed }
        } else if !(slower > self.pace.creep) {
            T::zero()
        } else if slower < allowed {
            slower
        } else {
            allowed
        })
    }
}
