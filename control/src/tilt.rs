//! Roll and pitch from an inertial sensor: where they put a high antenna, and how they swing it.
//!
//! On a slope an antenna 2 m above the ground is 3.5 cm beside its place for each degree of roll. [`TiltWatch`]
//! tells a [`Controller`] where it is. While roll and pitch change, the antenna also moves in ways that the
//! course of the vehicle does not explain: the watch takes this velocity out of that of the antenna.

use crate::angle::Direction;
use crate::controller::Controller;
use crate::model::{Antenna, Geometry};
use crate::position::Velocity;
use crate::route::Route;
use crate::scalar::Scalar;

/// Roll and pitch of a vehicle, rad: the last two angles of the order yaw, pitch, roll, about the axes forward and
/// right of its body.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tilt<T> {
    /// Positive if the right side is lower.
    pub roll: T,
    /// Positive if the front is higher.
    pub pitch: T,
}

/// Largest roll and pitch that are taken for true, rad. A vehicle on wheels tips over before.
const LARGEST: f64 = 0.5;

/// Longest time between two measurements, of which the difference tells how the antenna swings, s. A field has
/// waves that a vehicle passes in a second.
const LONGEST: f64 = 0.3;

impl<T: Scalar> Tilt<T> {
    /// True if both angles are at most half a radian. A larger one, or one that is not a number, is an error of the
    /// sensor.
    #[must_use]
    pub fn is_plausible(&self) -> bool {
        let largest = T::lit(LARGEST);
        self.roll.abs() <= largest && self.pitch.abs() <= largest
    }

    /// Place of an antenna over the ground, m ahead of the rear axle and to the right of the centre line, in the
    /// horizontal plane. On level ground it is `l1` and `right`. If the tilt is plausible, the error is below 4e-6
    /// of the antenna's distance.
    #[must_use]
    pub fn place(&self, geometry: &Geometry<T>, antenna: &Antenna<T>) -> (T, T) {
        let level = Direction::north();
        let (roll, pitch) = (level.near(self.roll), level.near(self.pitch));
        let above = antenna.height * roll.cosine - antenna.right * roll.sine;
        (
            geometry.l1 * pitch.cosine - above * pitch.sine,
            antenna.right * roll.cosine + antenna.height * roll.sine,
        )
    }
}

/// Where the antenna was when a tilt was measured, m ahead and to the right, and how long that is ago, s.
#[derive(Clone, Copy, Debug)]
struct Seen<T> {
    ahead: T,
    right: T,
    age: T,
}

/// Follows the measured tilts.
#[derive(Clone, Copy, Debug)]
pub struct TiltWatch<T> {
    longest_age: T,
    /// The last measurements, the newest first.
    past: [Option<Seen<T>>; 2],
}

impl<T: Scalar> TiltWatch<T> {
    /// A watch that has seen no tilt. Without one for longer than `longest_age` (s), the ground counts as level.
    #[must_use]
    pub fn new(longest_age: T) -> Self {
        Self {
            longest_age,
            past: [None; 2],
        }
    }

    /// Whether a tilt counts that is not too old.
    #[must_use]
    pub fn is_measured(&self) -> bool {
        self.past[0].is_some()
    }

    /// Call it before each step of `controller`, `dt` (s) after the last call, with the tilt and the antenna's velocity
    /// that arrived with the position, if they did. Returns the velocity for the step: without what roll and pitch
    /// change of it, once the heading is known. A tilt that is not plausible counts as missing.
    ///
    /// Two measurements apart, the noise of the angles (0.2 degrees at 2 m: 5 cm/s) is not above that of the velocity by
    /// much, and waves in the ground of 3 m are still followed.
    pub fn step<R: Route<T>>(
        &mut self,
        controller: &mut Controller<T, R>,
        tilt: Option<Tilt<T>>,
        velocity: Option<Velocity>,
        dt: T,
    ) -> Option<Velocity> {
        let [newest, before] = self.past.map(|seen| {
            seen.map(|seen| Seen {
                age: seen.age + dt,
                ..seen
            })
        });
        let Some(tilt) = tilt.filter(Tilt::is_plausible) else {
            // The last place counts for a while. Before the first tilt it is that on level ground.
            self.past = match newest {
                Some(seen) if seen.age > self.longest_age => {
                    controller.set_tilt(None);
                    [None; 2]
                }
                _ => [newest, before],
            };
            return velocity;
        };
        let (ahead, right) = controller.set_tilt(Some(tilt));
        let now = Seen {
            ahead,
            right,
            age: T::zero(),
        };
        self.past = [Some(now), newest];
        let usable = |seen: &Seen<T>| seen.age <= T::lit(LONGEST);
        match (velocity, before.filter(usable).or(newest.filter(usable))) {
            (Some(velocity), Some(then)) if controller.is_located() => {
                let heading = controller.estimator().estimate().heading;
                Some(steadied(velocity, &now, &then, heading))
            }
            _ => velocity,
        }
    }
}

/// A velocity of the antenna without what it owes to the change of its place in the vehicle.
fn steadied<T: Scalar>(velocity: Velocity, now: &Seen<T>, then: &Seen<T>, heading: T) -> Velocity {
    let (sine, cosine) = heading.sine_cosine();
    // In mm/s, as velocities are.
    let scale = T::lit(1000.0) / then.age;
    let ahead = (now.ahead - then.ahead) * scale;
    let right = (now.right - then.right) * scale;
    Velocity {
        north: velocity
            .north
            .saturating_sub(rounded(ahead * cosine - right * sine)),
        east: velocity
            .east
            .saturating_sub(rounded(ahead * sine + right * cosine)),
    }
}

/// The nearest integer of a magnitude below a million.
fn rounded<T: Scalar>(value: T) -> i32 {
    let size = value.abs().min(T::lit(1e6)).nearest().whole() as i32;
    if value < T::zero() { -size } else { size }
}
