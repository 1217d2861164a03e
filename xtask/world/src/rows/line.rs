//! The middle of a row: straight pieces and arcs.

use core::f64::consts::FRAC_PI_2;

use libm::{atan2, cos, hypot, sin};

use crate::scenario::{Row, Turn};
use crate::vehicle::wrap;

/// How far from the expected station [`CentreLine::locate`] searches, metres.
const SEARCH: f64 = 5.0;

/// A point of the middle, and the direction of the row there.
#[derive(Copy, Clone, Debug, PartialEq)]
pub struct Place {
    /// `x`, metres.
    pub x: f64,
    /// `y`, metres.
    pub y: f64,
    /// Direction, radians.
    pub heading: f64,
}

impl Place {
    /// The point `right` metres to the right of the middle.
    #[must_use]
    pub fn beside(&self, right: f64) -> (f64, f64) {
        (
            self.x - right * sin(self.heading),
            self.y + right * cos(self.heading),
        )
    }
}

/// A straight piece or an arc.
#[derive(Copy, Clone, Debug)]
struct Piece {
    from: f64,
    to: f64,
    start: Place,
    /// One over the radius, positive to the right, 1/m; zero for a straight piece.
    curvature: f64,
}

impl Piece {
    /// The place `ahead` metres behind the beginning.
    fn at(&self, ahead: f64) -> Place {
        let Place { x, y, heading } = self.start;
        let turned = self.curvature * ahead;
        // The chord of the arc; its direction is halfway between those of the two ends.
        let half = turned / 2.0;
        let chord = if half == 0.0 {
            ahead
        } else {
            ahead * sin(half) / half
        };
        Place {
            x: x + chord * cos(heading + half),
            y: y + chord * sin(heading + half),
            heading: heading + turned,
        }
    }

    /// Station, and distance to the right, of the point of this piece nearest to (`x`, `y`), and how
    /// far it is away.
    fn locate(&self, x: f64, y: f64) -> (f64, f64, f64) {
        let Place { heading, .. } = self.start;
        let (dx, dy) = (x - self.start.x, y - self.start.y);
        let ahead = if self.curvature == 0.0 {
            dx * cos(heading) + dy * sin(heading)
        } else {
            // The arc has its centre one radius to the right, or to the left if it is negative.
            let radius = 1.0 / self.curvature;
            let (cx, cy) = (dx + radius * sin(heading), dy - radius * cos(heading));
            // Outwards is to the left of the direction of travel on an arc to the right.
            let outward = atan2(cy, cx);
            wrap(outward + FRAC_PI_2.copysign(radius) - heading) * radius
        };
        let station = (self.from + ahead).clamp(self.from, self.to);
        let nearest = self.at(station - self.from);
        let (dx, dy) = (x - nearest.x, y - nearest.y);
        let right = dy * cos(nearest.heading) - dx * sin(nearest.heading);
        (station, right, hypot(dx, dy))
    }
}

/// The middle between the two innermost rows, from station 0 to the end of the row. It goes on
/// straight before and behind the row.
#[derive(Clone, Debug)]
pub struct CentreLine {
    pieces: Vec<Piece>,
}

/// A station that no robot reaches, metres.
const FAR: f64 = 1e6;

impl CentreLine {
    /// The middle of `row`.
    pub(super) fn new(row: &Row) -> Self {
        let mut place = Place {
            x: -FAR,
            y: 0.0,
            heading: 0.0,
        };
        let mut station = -FAR;
        let mut pieces = Vec::new();
        let mut add = |to: f64, curvature: f64| {
            if to > station {
                let piece = Piece {
                    from: station,
                    to,
                    start: place,
                    curvature,
                };
                place = piece.at(to - station);
                station = to;
                pieces.push(piece);
            }
        };
        add(0.0, 0.0);
        for bend in &row.bend {
            let sign = match bend.turn {
                Turn::Left => -1.0,
                Turn::Right => 1.0,
            };
            let (from, to) = (bend.from.get(), bend.to.get());
            add(from, 0.0);
            // An arc of half a turn or more has two points in line with its centre.
            let parts = ((to - from) / bend.radius.get()).ceil().max(1.0);
            for part in 1..=parts as u32 {
                let share = f64::from(part) / parts;
                add(from + share * (to - from), sign / bend.radius.get());
            }
        }
        add(FAR, 0.0);
        Self { pieces }
    }

    fn piece(&self, station: f64) -> usize {
        let begun = self.pieces.partition_point(|piece| piece.from <= station);
        begun.saturating_sub(1)
    }

    /// The place at `station`, metres along the middle.
    #[must_use]
    pub fn at(&self, station: f64) -> Place {
        let piece = &self.pieces[self.piece(station)];
        piece.at(station - piece.from)
    }

    /// Station of the point of the middle nearest to (`x`, `y`), and how far that is to the right
    /// of it, both in metres. The search is limited to 5 m around station `near`, since a
    /// curved row may come close to itself.
    #[must_use]
    pub fn locate(&self, x: f64, y: f64, near: f64) -> (f64, f64) {
        let pieces = &self.pieces[self.piece(near - SEARCH)..=self.piece(near + SEARCH)];
        let nearest = pieces
            .iter()
            .map(|piece| piece.locate(x, y))
            .min_by(|a, b| a.2.total_cmp(&b.2));
        nearest.map_or((near, 0.0), |(station, right, _)| (station, right))
    }
}
