//! A mission as the firmware drives it: one list of pieces, each with its speed and sections.
//!
//! A [`Chain`] is in the direction of travel. A piece here is in terms of the vehicle: its heading is where the vehicle points, also
//! backwards, and its curvature is positive with the wheels to the right. Driven backwards, a vehicle with its wheels to the right
//! turns to the left of its travel, so curvature and sharpness change their signs and the heading turns round.
//!
//! Places are those of the point that follows the path. For a vehicle with front wheels that steer, this is the middle of the rear axle.

use std::f64::consts::PI;

use crate::curve::{Chain, Pose, Segment, wrapped};
use crate::plan::{End, Join, Plan};

/// A line, an arc or a clothoid that is driven with one speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Piece {
    /// The leg of the plan that it is a part of, counted from zero.
    pub leg: usize,
    /// The vehicle's pose at its beginning; the heading in [-pi, pi].
    pub start: Pose,
    /// Curvature at its beginning, 1/m, positive with the wheels to the right.
    pub curvature: f64,
    /// Change of the curvature with each metre driven, 1/m2.
    pub sharpness: f64,
    /// Length, m.
    pub length: f64,
    /// Speed, m/s, positive in reverse too.
    pub speed: f64,
    /// True if it is driven backwards.
    pub reverse: bool,
    /// Sections of the implement that are on, one in each bit.
    pub outputs: u8,
    /// How the piece after it is reached. For the last one of a mission that stops it means nothing and is [`Join::Continue`].
    pub next: Join,
}

/// Longest straight piece, m: longer ones are divided. A vehicle takes pieces of up to 2000 m.
pub const LONGEST: f64 = 1500.0;

/// The pieces of a plan, whose legs have these curves ([`crate::curve::legs`]).
#[must_use]
pub fn pieces(plan: &Plan, chains: &[Chain]) -> Vec<Piece> {
    let mut pieces = Vec::new();
    for (index, (leg, chain)) in plan.legs.iter().zip(chains).enumerate() {
        let (turn, sign) = if leg.reverse { (PI, -1.0) } else { (0.0, 1.0) };
        let segments = chain.segments.iter().flat_map(divided);
        pieces.extend(segments.map(|segment| Piece {
            leg: index,
            start: Pose {
                heading: wrapped(segment.start.heading + turn),
                ..segment.start
            },
            curvature: sign * segment.curvature,
            sharpness: sign * segment.sharpness,
            length: segment.length,
            speed: leg.speed,
            reverse: leg.reverse,
            outputs: leg.outputs.0,
            next: Join::Continue,
        }));
        let after = match (plan.legs.get(index + 1), plan.end) {
            (None, End::Stop) => None,
            (None, End::Repeat) => plan.legs.first(),
            (after, _) => after,
        };
        if let (Some(last), Some(after)) = (pieces.last_mut(), after) {
            last.next = after.join;
        }
    }
    pieces
}

/// A straight segment in equal parts of at most [`LONGEST`], others whole.
fn divided(segment: &Segment) -> Vec<Segment> {
    let straight = segment.curvature == 0.0 && segment.sharpness == 0.0;
    let count = match straight {
        true => (segment.length / LONGEST).ceil().max(1.0),
        false => 1.0,
    };
    let length = segment.length / count;
    let part = |index: u32| {
        let along = f64::from(index) * length;
        let place = segment.start.place.towards(segment.start.heading, along);
        let start = Pose {
            place,
            ..segment.start
        };
        Segment {
            start,
            length,
            ..*segment
        }
    };
    (0..count as u32).map(part).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::curve::{Options, legs};
    use crate::place::{Local, Origin};
    use crate::plan::{Leg, Outputs, Shape};

    fn bend(reverse: bool, join: Join) -> Leg {
        let points = [(0.0, 0.0), (10.0, 0.5), (19.0, 3.0), (27.0, 8.0)];
        Leg {
            shape: Shape::Curve {
                points: points.map(|(north, east)| Local::new(north, east)).to_vec(),
            },
            speed: 0.7,
            reverse,
            outputs: Outputs(5),
            join,
        }
    }

    fn plan(legs: Vec<Leg>, end: End) -> Plan {
        Plan {
            name: "bends".to_owned(),
            origin: Origin::default(),
            width: None,
            fence: Vec::new(),
            obstacles: Vec::new(),
            legs,
            end,
        }
    }

    /// Where a car comes to that drives a piece: small steps in the direction it points, or backwards, and its wheels turn it.
    fn driven(piece: &Piece) -> Pose {
        let steps = 20_000;
        let step = piece.length / f64::from(steps);
        let way = if piece.reverse { -step } else { step };
        let mut pose = piece.start;
        for index in 0..steps {
            let curvature = piece.curvature + piece.sharpness * (f64::from(index) + 0.5) * step;
            let middle = pose.heading + 0.5 * curvature * way;
            pose.place = pose.place.towards(middle, way);
            pose.heading += curvature * way;
        }
        pose
    }

    /// Fields are longer than a vehicle's longest line.
    #[test]
    fn a_long_line_is_driven_in_parts() {
        let line = |length: f64| Leg {
            shape: Shape::Line {
                from: Local::new(-0.6 * length, 3.0),
                to: Local::new(0.4 * length, 3.0),
            },
            ..bend(false, Join::Turn)
        };
        let plan = plan(vec![line(4000.0), line(1500.0)], End::Stop);
        let chains = legs(&plan, &Options::default()).unwrap();
        let pieces = pieces(&plan, &chains);
        let parts: Vec<_> = pieces.iter().map(|piece| (piece.leg, piece.next)).collect();
        let (on, turn) = (Join::Continue, Join::Turn);
        assert_eq!(parts, [(0, on), (0, on), (0, turn), (1, on)]);
        for pair in pieces[..3].windows(2) {
            let end = driven(&pair[0]).place;
            assert!(end.distance(pair[1].start.place) < 1e-6);
        }
        assert!((driven(&pieces[2]).place.north - 1600.0).abs() < 1e-6);
    }

    #[test]
    fn a_car_that_drives_the_pieces_follows_the_points() {
        for reverse in [false, true] {
            let plan = plan(vec![bend(reverse, Join::Turn)], End::Stop);
            let chains = legs(&plan, &Options::default()).unwrap();
            let pieces = pieces(&plan, &chains);
            let points = plan.legs[0].shape.points();
            assert!(pieces[0].start.place.distance(points[0]) < 1e-9);
            for pair in pieces.windows(2) {
                let end = driven(&pair[0]);
                assert!(end.place.distance(pair[1].start.place) < 1e-5);
                assert!(wrapped(end.heading - pair[1].start.heading).abs() < 1e-9);
            }
            let last = &pieces[pieces.len() - 1];
            assert!(driven(last).place.distance(points[3]) < 1e-5);
            assert!(
                pieces
                    .iter()
                    .all(|piece| (piece.speed, piece.outputs) == (0.7, 5))
            );
            // The bend is to the right; backwards, the wheels are to the left for that.
            let most =
                pieces
                    .iter()
                    .map(|piece| piece.curvature)
                    .fold(0.0, |most: f64, curvature| {
                        if curvature.abs() > most.abs() {
                            curvature
                        } else {
                            most
                        }
                    });
            assert_eq!(most < 0.0, reverse, "{most}");
            // Backwards, the vehicle looks away from where it goes.
            assert_eq!(pieces[0].start.heading.abs() > PI / 2.0, reverse);
        }
    }

    #[test]
    fn a_piece_knows_how_the_next_one_is_reached() {
        let joins = |end| {
            let plan = plan(vec![bend(false, Join::Turn), bend(false, Join::Turn)], end);
            let chains = legs(&plan, &Options::default()).unwrap();
            let pieces = pieces(&plan, &chains);
            let turns = pieces
                .iter()
                .filter(|piece| piece.next == Join::Turn)
                .map(|piece| piece.leg);
            turns.collect::<Vec<_>>()
        };
        assert_eq!(joins(End::Stop), [0]);
        assert_eq!(joins(End::Repeat), [0, 1]);
    }
}
