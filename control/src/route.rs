//! What a controller follows: one line, or a path of several segments.
//!
//! A controller is built for one kind of route, so that a vehicle that follows a line has neither
//! the code of arcs nor room for their segments.

use crate::line::Line;
use crate::path::{Path, Place, Progress};
use crate::position::Position;
use crate::scalar::Scalar;

/// Curvature and direction of a route near a place on it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bend<T> {
    /// Mean direction minus the direction at the place, rad.
    pub turn: T,
    /// Mean curvature beside the vehicle, 1/m, positive to the right.
    pub curvature: T,
    /// Mean curvature ahead, 1/m.
    pub curvature_ahead: T,
}

/// A route in the frame whose origin it names.
pub trait Route<T: Scalar> {
    /// The origin of the route's frame: its first waypoint.
    fn origin(&self) -> Position;

    /// Advances `progress` to the point `north`, `east` (m) and returns the point's place relative
    /// to the segment that was reached. Progress never goes back to an earlier segment.
    fn advance(&self, progress: &mut Progress<T>, north: T, east: T) -> Place<T>;

    /// The bend beside the vehicle and `ahead` metres (not negative) ahead of it. The averages
    /// extend over the distance that the steering needs, where `way` (m, positive) is the distance
    /// that the vehicle drives while it travels to a swing's angle.
    fn bend(&self, progress: &Progress<T>, ahead: T, way: T) -> Bend<T>;

    /// Curvature (1/m) `way` metres ahead of `progress`, if a steering of limited rate can follow the
    /// route's curvature exactly. The law then moves the steering with it, and
    /// [`Bend::curvature_ahead`] is the curvature beside the vehicle.
    fn next_curvature(&self, _progress: &Progress<T>, _way: T) -> Option<T> {
        None
    }

    /// The speed (m/s) for which the law's gains at `progress` are, where the vehicle is slower for a
    /// while because it stops or begins to drive; `None` for those of its speed.
    fn usual_speed(&self, _progress: &Progress<T>) -> Option<T> {
        None
    }

    /// False while the route is not known at `progress`. The vehicle then stands.
    fn is_ready(&self, _progress: &Progress<T>) -> bool {
        true
    }

    /// True if the vehicle drives backwards at `progress`. Bearings and curvatures are those of
    /// the travel then, too.
    fn reverse(&self, _progress: &Progress<T>) -> bool {
        false
    }

    /// The tightest curvature (1/m, not negative) from `progress` to `ahead` metres ahead of it, for a route that does not
    /// plan its speed itself.
    fn tightest(&self, _progress: &Progress<T>, _ahead: T) -> T {
        T::zero()
    }

    /// The speed (m/s, not negative) that the next command may have while the vehicle is stopped on its way, if the last one,
    /// `dt` (s) ago, was `applied` (m/s in the direction of travel). `None` if it is not stopped.
    fn stopping(&self, _applied: T, _dt: T) -> Option<T> {
        None
    }

    /// The largest speed (m/s, not negative) at `progress` when the vehicle travels at `speed` (m/s);
    /// `None` for the cruise speed of the settings.
    fn speed(&self, _progress: &Progress<T>, _speed: T) -> Option<T> {
        None
    }
}

impl<T: Scalar> Route<T> for Line<T> {
    fn origin(&self) -> Position {
        self.origin()
    }

    fn advance(&self, progress: &mut Progress<T>, north: T, east: T) -> Place<T> {
        let (along, cross_track) = self.locate_metres(north, east);
        progress.along = along;
        progress.finished = along > self.length();
        Place {
            along,
            cross_track,
            bearing: self.bearing(),
        }
    }

    fn bend(&self, _: &Progress<T>, _: T, _: T) -> Bend<T> {
        Bend {
            turn: T::zero(),
            curvature: T::zero(),
            curvature_ahead: T::zero(),
        }
    }
}

impl<T: Scalar> Route<T> for Path<T> {
    fn origin(&self) -> Position {
        self.origin()
    }

    fn advance(&self, progress: &mut Progress<T>, north: T, east: T) -> Place<T> {
        progress.advance(self, north, east)
    }

    fn tightest(&self, progress: &Progress<T>, ahead: T) -> T {
        let &Progress { segment, along, .. } = progress;
        // An arc that is shorter than a third of the way does not turn the vehicle much.
        let at = |share: f64| self.curvature(segment, along + ahead * T::lit(share)).abs();
        at(0.0).max(at(0.33)).max(at(0.67)).max(at(1.0))
    }

    fn bend(&self, progress: &Progress<T>, ahead: T, way: T) -> Bend<T> {
        let &Progress { segment, along, .. } = progress;
        let ahead = along + ahead;
        // Half the way that the steering needs, with a reserve of a quarter.
        // From one side to the other it needs twice that way.
        let curvature = |at: T| self.curvature(segment, at);
        let reverses = curvature(ahead - way) * curvature(ahead + way) < T::zero();
        let half = way * T::lit(if reverses { 1.25 } else { 0.625 });
        let here = self.smoothed(segment, along, half);
        Bend {
            turn: here.turn,
            curvature: here.curvature,
            curvature_ahead: self.smoothed(segment, ahead, half).curvature,
        }
    }
}
