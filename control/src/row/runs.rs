//! Runs of readings: what one sensor sees of one surface.

use super::end::OpenWay;
use super::health::Watch;
use super::settings::{Odds, Readings};
use crate::scalar::Scalar;

/// Least readings of a run that counts.
const RUN_READINGS: u8 = 3;
/// Least way of a run that counts, as a share of the longest. What is seen for
/// a shorter way is the rim of a leaf more often than a stalk.
const LEAST_RUN: f64 = 1.0 / 6.0;

/// How much farther than the row something is that is seen through it, m.
const BEHIND: f64 = 0.5;

/// Way along a surface of which the mean is taken, m. On a wall the robot turns meanwhile.
const PART: f64 = 0.1;

/// Way along surfaces at both sides, as far apart as the rows, after which they are walls, m.
const BOTH: f64 = 0.06;

/// Way along a surface without a space after which nothing else than a wall can be meant, m.
const SURE: f64 = 0.3;

/// Share of the least way along a wall that is known already after it has counted once.
const WALL_KNOWN: f64 = 0.5;

/// How much nearer than the row a reading is that a leaf must have made, m.
const LEAF: f64 = 0.06;
/// Share of the way hidden by leaves up to which a side counts as clear, and
/// from which it counts as leafy.
const LEAFY: (f64, f64) = (0.25, 0.55);
/// Successive readings of one surface.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Surface<T> {
    /// Sum of what the latest readings exceeded their predictions by, m.
    sum: T,
    readings: u8,
    /// Way along it, m.
    way: T,
    /// Way along the part of it that the sum is of, m.
    part: T,
    /// How far the beam has swept across it, m.
    swept: T,
    /// Whether the reading before it was of something near by.
    touches: bool,
}

impl<T: Scalar> Surface<T> {
    fn new(touches: bool) -> Self {
        Self {
            sum: T::zero(),
            readings: 0,
            way: T::zero(),
            part: T::zero(),
            swept: T::zero(),
            touches,
        }
    }

    /// Adds a reading. While the robot hardly moves, a surface has more readings than
    /// it needs; the later ones are left out. Of a long surface the last part counts.
    fn add(&mut self, excess: T, step: &Step<T>) {
        self.part += step.way;
        if self.part > T::lit(PART) {
            self.part = T::zero();
            self.sum = self.mean();
            self.readings = 1;
        }
        if self.readings < u8::MAX {
            self.readings += 1;
            self.sum += excess;
        }
        self.way += step.way;
        self.swept += step.swept;
    }

    fn mean(&self) -> T {
        if self.readings == 0 {
            T::zero()
        } else {
            self.sum / T::integer(i32::from(self.readings))
        }
    }

    /// Factor by which it is more likely a leaf than its place alone says; `touches`
    /// says whether the reading behind it is of something near by.
    fn doubt(&self, touches: bool, readings: &Readings<T>) -> T {
        let mut doubt = T::one();
        for touches in [self.touches, touches] {
            if touches {
                doubt *= readings.touching;
            }
        }
        let wide = self.swept / readings.wide;
        let wide = wide * wide;
        let wide = if wide < T::lit(4.0) {
            wide
        } else {
            T::lit(4.0)
        };
        doubt * (T::one() + wide * wide * wide)
    }
}

/// Whether a reading that exceeds its prediction by this (m) shows something that is not
/// seen through the row.
pub(super) fn is_near<T: Scalar>(excess: T) -> bool {
    excess < T::lit(BEHIND)
}

/// A surface that the beam has left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Run<T> {
    /// Mean of what its readings exceeded their predictions by, m.
    pub(super) excess: T,
    /// Factor by which it is more likely a leaf than its place alone says.
    pub(super) doubt: T,
}

/// What a robot did between two readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Step<T> {
    /// Way, m.
    pub(super) way: T,
    /// How far the beam swept across what it meets, m.
    pub(super) swept: T,
}

/// A long surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Wall<T> {
    /// What the last reading exceeds its prediction by, m.
    pub(super) excess: T,
    /// Way along it, m.
    pub(super) way: T,
}

/// What is remembered of one side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RowMemory<T> {
    surface: Surface<T>,
    /// A run that waits to be judged.
    ended: Option<Run<T>>,
    /// What the last reading exceeded its prediction by, m.
    last: Option<T>,
    /// Way along one surface, whether parts of it have counted or not, m.
    wall: T,
    /// Share of the way along which leaves hide the row, in [0, 1].
    cover: T,
    pub(super) watch: Watch<T>,
    pub(super) open: OpenWay<T>,
    /// Way since the last stalk, m.
    pub(super) blind_way: T,
}

impl<T: Scalar> RowMemory<T> {
    pub(super) fn new() -> Self {
        Self {
            surface: Surface::new(false),
            ended: None,
            last: None,
            wall: T::zero(),
            cover: T::zero(),
            watch: Watch::new(),
            open: OpenWay::new(),
            blind_way: T::zero(),
        }
    }

    /// Adds what a reading exceeds its prediction by (m), `None` if nothing
    /// is within range, after the `step`. A surface that this ends waits as a run for
    /// [`RowMemory::take_ended`], if it counts.
    pub(super) fn extend(
        &mut self,
        excess: Option<T>,
        step: &Step<T>,
        between: bool,
        readings: &Readings<T>,
    ) {
        let is_leaf = excess.is_some_and(|excess| excess < -T::lit(LEAF));
        let hidden = if is_leaf { T::one() } else { T::zero() };
        let share = step.way / readings.leaf_way;
        let share = if share < T::one() { share } else { T::one() };
        self.cover += (hidden - self.cover) * share;

        let wall = if between {
            T::lit(BOTH)
        } else {
            readings.surface
        };
        let is_same_surface = match (excess, self.last) {
            (Some(excess), Some(last)) => (excess - last).abs() <= readings.agreement,
            _ => false,
        };
        self.wall += step.way;
        if !is_same_surface {
            self.wall = T::zero();
            let surface = core::mem::replace(
                &mut self.surface,
                Surface::new(self.last.is_some_and(is_near)),
            );
            if surface.readings >= RUN_READINGS && surface.way >= readings.run * T::lit(LEAST_RUN) {
                self.ended = Some(Run {
                    excess: surface.mean(),
                    doubt: surface.doubt(excess.is_some_and(is_near), readings),
                });
            }
        } else if self.surface.way >= wall {
            // Longer than a leaf: a wall.
            self.ended = Some(Run {
                excess: self.surface.mean(),
                doubt: T::one(),
            });
            self.surface = Surface {
                way: wall * T::lit(WALL_KNOWN),
                ..Surface::new(true)
            };
        }
        self.last = excess;
        if let Some(excess) = excess {
            self.surface.add(excess, step);
        }
    }

    /// What the present surface exceeds its prediction by, m, if it is long enough to be a
    /// wall between walls.
    pub(super) fn long_surface(&self) -> Option<T> {
        (self.surface.way >= T::lit(BOTH)).then(|| self.surface.mean())
    }

    /// The present surface, if it is a wall for certain.
    pub(super) fn sure_wall(&self) -> Option<Wall<T>> {
        let excess = self.last.filter(|_| self.wall >= T::lit(SURE))?;
        Some(Wall {
            excess,
            way: self.wall,
        })
    }

    /// A run that has ended, once.
    pub(super) fn take_ended(&mut self) -> Option<Run<T>> {
        self.ended.take()
    }

    /// Lets the readings of the unfinished run follow their prediction, which a
    /// correction has moved by `moved` (m).
    pub(super) fn shift(&mut self, moved: T) {
        self.surface.sum -= moved * T::integer(i32::from(self.surface.readings));
        self.last = self.last.map(|last| last - moved);
        if let Some(ended) = &mut self.ended {
            ended.excess -= moved;
        }
    }

    /// The odds of a run at this side.
    pub(super) fn odds(&self, doubt: T, readings: &Readings<T>) -> Odds<T> {
        let (low, high) = LEAFY;
        let share = (self.cover - T::lit(low)) / T::lit(high - low);
        let share = if share > T::one() {
            T::one()
        } else if share > T::zero() {
            share
        } else {
            T::zero()
        };
        let Readings { clear, leafy, .. } = readings;
        let mix = |clear: T, leafy: T| clear + (leafy - clear) * share;
        Odds {
            stalk: mix(clear.stalk, leafy.stalk),
            near: mix(clear.near, leafy.near) * doubt,
            far: mix(clear.far, leafy.far) * doubt,
        }
    }
}
