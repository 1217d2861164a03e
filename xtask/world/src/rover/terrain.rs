//! What happens to the robot along its way: clods, grip, and the axles that it stands on.
//!
//! All of it is bound to the way that the robot has driven, not to time.

use super::{Axles, Terrain};
use crate::random::{Purpose, Stream};

/// Least and largest share of a side's speed that is lost to slip.
const SLIPS: core::ops::RangeInclusive<f64> = -0.2..=0.9;

/// A sudden change of the pose.
#[derive(Copy, Clone, Debug, Default, PartialEq)]
pub(super) struct Kick {
    /// Change of the heading, radians.
    pub(super) heading: f64,
    /// Way to the right, metres.
    pub(super) right: f64,
}

/// The ground under the robot as it goes on.
#[derive(Clone, Debug)]
pub(super) struct Surface {
    terrain: Terrain,
    axles: Axles,
    next_tip: f64,
    tips: Stream,
    next_clod: f64,
    clods: Stream,
    hit: u64,
    slip: [f64; 2],
    /// The stretch of constant slip that the robot is on.
    stretch: Option<u64>,
    slips: Stream,
}

/// The way to the next of things that come at random, `rate` in a metre; infinite for none.
fn way(stream: &mut Stream, rate: f64) -> f64 {
    if rate > 0.0 {
        -libm::log(1.0 - stream.uniform()) / rate
    } else {
        f64::INFINITY
    }
}

impl Surface {
    pub(super) fn new(terrain: &Terrain, seed: u64) -> Self {
        let mut tips = Stream::new(seed, Purpose::Tips);
        let mut clods = Stream::new(seed, Purpose::Clods);
        let axles = if tips.uniform() < 0.5 {
            Axles::Front
        } else {
            Axles::Rear
        };
        let mut surface = Self {
            axles,
            next_tip: way(&mut tips, terrain.tips.get()),
            tips,
            next_clod: way(&mut clods, terrain.clods.get()),
            clods,
            hit: 0,
            slip: [0.0; 2],
            stretch: None,
            slips: Stream::new(seed, Purpose::Slip),
            terrain: terrain.clone(),
        };
        surface.grip(0.0);
        surface
    }

    /// The robot has driven `way` metres; returns what the clods did that it has met since the last
    /// call.
    pub(super) fn advance_to(&mut self, way: f64) -> Kick {
        while way >= self.next_tip {
            self.axles = match self.axles {
                Axles::Front => Axles::Rear,
                Axles::Rear => Axles::Front,
            };
            self.next_tip += self::way(&mut self.tips, self.terrain.tips.get());
        }
        let mut kick = Kick::default();
        while way >= self.next_clod {
            kick.heading += self.terrain.clod_turn.get() * self.clods.normal();
            kick.right += self.terrain.clod_shift.get() * self.clods.normal();
            self.next_clod += self::way(&mut self.clods, self.terrain.clods.get());
            self.hit += 1;
        }
        self.grip(way);
        kick
    }

    fn grip(&mut self, way: f64) {
        let stretch = (way / self.terrain.slip_length.get()) as u64;
        if self.stretch.replace(stretch) != Some(stretch) {
            self.slips.seek(stretch);
            let (slip, slip_spread) = (self.terrain.slip.get(), self.terrain.slip_spread.get());
            self.slip = [(); 2].map(|()| {
                (slip + slip_spread * self.slips.normal()).clamp(*SLIPS.start(), *SLIPS.end())
            });
        }
    }

    pub(super) fn axles(&self) -> Axles {
        self.axles
    }

    /// Share of the speed lost to slip, left and right.
    pub(super) fn slip(&self) -> [f64; 2] {
        self.slip
    }

    pub(super) fn clods(&self) -> u64 {
        self.hit
    }
}
