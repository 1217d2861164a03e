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

/// How much nearer than the row a reading is that a leaf must have made, m.
const LEAF: f64 = 0.06;
/// Share of the way hidden by leaves up to which a side counts as clear, and
/// from which it counts as leafy.
const LEAFY: (f64, f64) = (0.25, 0.55);
/// A run of readings that agree.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Run<T> {
    /// Sum of what the readings exceeded their predictions by, m.
    sum: T,
    readings: u8,
    way: T,
}

impl<T: Scalar> Run<T> {
    fn empty() -> Self {
        Self {
            sum: T::zero(),
            readings: 0,
            way: T::zero(),
        }
    }

    /// Adds a reading. While the robot hardly moves, a run has more readings than
    /// it needs; the later ones are left out.
    fn add(&mut self, excess: T, way: T) {
        if self.readings < u8::MAX {
            self.readings += 1;
            self.sum += excess;
        }
        self.way += way;
    }

    fn mean(&self) -> T {
        if self.readings == 0 {
            T::zero()
        } else {
            self.sum / T::integer(i32::from(self.readings))
        }
    }

    /// Whether the mean and a reading differ by no more than `agreement`.
    fn agrees(&self, excess: T, agreement: T) -> bool {
        let readings = T::integer(i32::from(self.readings));
        (excess * readings - self.sum).abs() <= agreement * readings
    }
}

/// What is remembered of one side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RowMemory<T> {
    run: Run<T>,
    /// Mean of a run that has ended and waits to be judged, m.
    ended: Option<T>,
    /// What the last reading exceeded its prediction by, m.
    last: Option<T>,
    /// Way along which the surface in the beam does not count again, m.
    counted: T,
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
            run: Run::empty(),
            ended: None,
            last: None,
            counted: T::zero(),
            cover: T::zero(),
            watch: Watch::new(),
            open: OpenWay::new(),
            blind_way: T::zero(),
        }
    }

    /// Adds what a reading exceeds its prediction by (m), `None` if nothing
    /// is within range, after the `way` (m). A run that this ends waits for
    /// [`RowMemory::take_ended`], if it counts.
    pub(super) fn extend(&mut self, excess: Option<T>, way: T, readings: &Readings<T>) {
        let is_leaf = excess.is_some_and(|excess| excess < -T::lit(LEAF));
        let hidden = if is_leaf { T::one() } else { T::zero() };
        let share = way / readings.leaf_way;
        let share = if share < T::one() { share } else { T::one() };
        self.cover += (hidden - self.cover) * share;

        let agree = |a: T, b: T| (a - b).abs() <= readings.agreement;
        let is_same_surface = match (excess, self.last) {
            (Some(excess), Some(last)) => agree(excess, last),
            _ => false,
        };
        let agrees = is_same_surface
            && excess.is_some_and(|excess| self.run.agrees(excess, readings.agreement));
        if !agrees || self.run.way >= readings.run {
            let run = core::mem::replace(&mut self.run, Run::empty());
            if run.readings >= RUN_READINGS
                && run.way >= readings.run * T::lit(LEAST_RUN)
                && !(self.counted > T::zero())
            {
                self.counted = readings.surface;
                self.ended = Some(run.mean());
            }
        }
        self.counted = if is_same_surface {
            self.counted - way
        } else {
            T::zero()
        };
        self.last = excess;
        if let Some(excess) = excess {
            self.run.add(excess, way);
        }
    }

    /// The mean of a run that has ended, once.
    pub(super) fn take_ended(&mut self) -> Option<T> {
        self.ended.take()
    }

    /// Lets the readings of the unfinished run follow their prediction, which a
    /// correction has moved by `moved` (m).
    pub(super) fn shift(&mut self, moved: T) {
        self.run.sum -= moved * T::integer(i32::from(self.run.readings));
        self.last = self.last.map(|last| last - moved);
        self.ended = self.ended.map(|ended| ended - moved);
    }

    /// The odds of a run at this side.
    pub(super) fn odds(&self, readings: &Readings<T>) -> Odds<T> {
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
            near: mix(clear.near, leafy.near),
            far: mix(clear.far, leafy.far),
        }
    }
}
