//! Fences and obstacles with few corners.
//!
//! A boundary that was walked or driven has hundreds of corners, and a vehicle compares itself with a few dozen. A ring
//! with fewer corners is looked for in three steps: the edge is moved by a margin to the safe side, thinned out so that it
//! stays within that margin of itself (Douglas and Peucker 1973), and compared with the given one. So a fence never leaves
//! the boundary, and an obstacle is covered as a whole. The smallest of [`MARGINS`] that gives few enough corners is taken.

use geo::buffer::{BufferStyle, LineJoin};
use geo::{Area as _, BooleanOps as _, Buffer as _, Polygon, Simplify as _};

use crate::place::Local;
use crate::plan::LEAST_OBSTACLE;
use crate::polygon;

/// Margins that are tried, m. An edge is moved by up to twice the margin.
pub const MARGINS: [f64; 10] = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 3.0, 5.0];

/// Largest share of a fence's area that may be lost: narrow arms of a field would vanish.
pub const LARGEST_LOSS: f64 = 0.05;

/// Area by which a ring may miss the safe side because of rounding, m2.
const ROUNDING: f64 = 1e-6;

/// To which side a ring may be moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// It encloses no place that the given one does not: a fence.
    Inside,
    /// It encloses all places that the given one does: an obstacle.
    Outside,
}

/// A ring with fewer corners.
#[derive(Clone, Debug, PartialEq)]
pub struct Thinned {
    /// Its corners, without the first one again at the end.
    pub corners: Vec<Local>,
    /// Largest distance by which an edge was moved, m; 0 if the ring was left as it is.
    pub moved: f64,
    /// Area between both rings, m2.
    pub area: f64,
}

/// The ring with at most `most` corners, moved to the safe side only. `None` if the largest margin is not enough, or a fence would
/// lose more than [`LARGEST_LOSS`].
#[must_use]
pub fn thinned(ring: &[Local], most: usize, side: Side) -> Option<Thinned> {
    if ring.len() <= most {
        return Some(Thinned {
            corners: ring.to_vec(),
            moved: 0.0,
            area: 0.0,
        });
    }
    let size = polygon::area(ring).abs();
    MARGINS.into_iter().find_map(|margin| {
        let thin = thinned_by(ring, margin, side)?;
        let loss = side == Side::Outside || thin.area <= LARGEST_LOSS * size;
        (thin.corners.len() <= most && loss).then_some(thin)
    })
}

/// The ring with fewer corners, moved to the safe side by up to twice the margin. `None` if that is no simple ring.
fn thinned_by(ring: &[Local], margin: f64, side: Side) -> Option<Thinned> {
    let given = Polygon::new(polygon::ring(ring), Vec::new());
    let by = match side {
        Side::Inside => -margin,
        Side::Outside => margin,
    };
    let style = BufferStyle::new(by).line_join(LineJoin::Miter(2.0));
    let parts = given.buffer_with_style(style);
    let size = |part: &Polygon| part.unsigned_area();
    let largest = parts
        .into_iter()
        .max_by(|one, other| size(one).total_cmp(&size(other)))?;
    let edge = largest.exterior().simplify(margin);
    let corners = polygon::corners(&edge);
    let thin = Polygon::new(edge, Vec::new());
    let missed = match side {
        Side::Inside => thin.difference(&given),
        Side::Outside => given.difference(&thin),
    };
    let good = corners.len() >= 3
        && polygon::crossing(&corners).is_none()
        && missed.unsigned_area() <= ROUNDING;
    good.then(|| Thinned {
        moved: 2.0 * margin,
        area: (size(&thin) - size(&given)).abs(),
        corners,
    })
}

/// How far about a hole that is too small for an obstacle its obstacle reaches, m.
pub const ABOUT: f64 = 0.05;

/// Up to this size an obstacle about such a hole is a rectangle, and a larger one follows its edge, m.
const POLE: f64 = 1.0;

/// Step of a round corner, rad.
const ARC: f64 = 0.5;

/// The obstacle about a ring that encloses less than [`LEAST_OBSTACLE`], [`ABOUT`] farther out on all sides; `None` for a
/// larger one. The ring may be a pole, so it is not left out.
#[must_use]
pub fn grown(ring: &[Local]) -> Option<Vec<Local>> {
    if polygon::area(ring).abs() >= LEAST_OBSTACLE {
        return None;
    }
    let range = |of: fn(&Local) -> f64| {
        let values = ring.iter().map(of);
        let (least, most) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |range, value| {
            (range.0.min(value), range.1.max(value))
        });
        (least - ABOUT, most + ABOUT)
    };
    let (south, north) = range(|corner| corner.north);
    let (west, east) = range(|corner| corner.east);
    if (north - south).max(east - west) <= POLE {
        return Some(vec![
            Local::new(south, west),
            Local::new(south, east),
            Local::new(north, east),
            Local::new(north, west),
        ]);
    }
    // The band along the edge: a ring so thin may have no inside that could grow.
    let style = BufferStyle::new(ABOUT).line_join(LineJoin::Round(ARC));
    let band = polygon::ring(ring).buffer_with_style(style);
    let size = |part: &Polygon| part.unsigned_area();
    let largest = band
        .into_iter()
        .max_by(|one, other| size(one).total_cmp(&size(other)))?;
    Some(polygon::corners(largest.exterior()))
}

/// The obstacles with at most `most` corners together, where each one counts one more than it has: all are moved by the same margin, so
/// that large ones keep more corners than small ones. `None` if the largest margin is not enough.
#[must_use]
pub fn obstacles(rings: &[Vec<Local>], most: usize) -> Option<Vec<Thinned>> {
    let unchanged = |ring: &Vec<Local>| Thinned {
        corners: ring.clone(),
        moved: 0.0,
        area: 0.0,
    };
    let fits =
        |thin: &Vec<Thinned>| thin.iter().map(|one| one.corners.len() + 1).sum::<usize>() <= most;
    let all: Vec<Thinned> = rings.iter().map(unchanged).collect();
    if fits(&all) {
        return Some(all);
    }
    MARGINS.into_iter().find_map(|margin| {
        let thin = rings.iter().map(|ring| {
            thinned_by(ring, margin, Side::Outside)
                .filter(|thin| thin.corners.len() < ring.len())
                .unwrap_or_else(|| unchanged(ring))
        });
        Some(thin.collect()).filter(fits)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::TAU;

    /// A ring about a place that was walked: every step aside by up to a decimetre.
    fn walked(radius: f64, asides: &[f64]) -> Vec<Local> {
        let step = TAU / asides.len() as f64;
        let corner = |(index, aside): (usize, &f64)| {
            Local::new(5.0, -3.0).towards(index as f64 * step, radius + aside)
        };
        asides.iter().enumerate().map(corner).collect()
    }

    fn polygon_of(corners: &[Local]) -> Polygon {
        Polygon::new(polygon::ring(corners), Vec::new())
    }

    #[test]
    fn few_corners_stay_as_they_are() {
        let ring = walked(20.0, &[0.0; 64]);
        let thin = thinned(&ring, 64, Side::Inside).unwrap();
        assert_eq!((thin.corners, thin.moved, thin.area), (ring, 0.0, 0.0));
    }

    #[test]
    fn a_ring_that_is_all_corners_is_refused() {
        let teeth: Vec<f64> = (0..400).map(|index| f64::from(index % 2) * 40.0).collect();
        assert_eq!(thinned(&walked(60.0, &teeth), 64, Side::Inside), None);
    }

    #[test]
    fn obstacles_share_their_corners() {
        let rings = vec![
            walked(3.0, &[0.0; 90]),
            walked(2.0, &[0.0; 4]),
            walked(1.0, &[0.0; 50]),
        ];
        let thin = obstacles(&rings, 40).unwrap();
        let corners: usize = thin.iter().map(|one| one.corners.len() + 1).sum();
        assert!(corners <= 40, "{corners}");
        for (ring, thin) in rings.iter().zip(&thin) {
            let missed = polygon_of(ring).difference(&polygon_of(&thin.corners));
            assert!(missed.unsigned_area() < 1e-5);
        }
        assert_eq!(obstacles(&rings, 9), None);
        assert_eq!(obstacles(&[], 40), Some(Vec::new()));
    }

    /// Two round ponds, a barn and a pole: corners that the small ones need not are left to the large ones.
    #[test]
    fn large_obstacles_keep_more_corners() {
        let rings = vec![
            walked(80.0, &[0.0; 36]),
            walked(130.0, &[0.0; 36]),
            walked(15.0, &[0.0; 18]),
            walked(0.7, &[0.0; 4]),
        ];
        let thin = obstacles(&rings, 64).unwrap();
        let moved: Vec<f64> = thin.iter().map(|one| one.moved).collect();
        assert!(moved.iter().all(|moved| *moved <= 6.0), "{moved:?}");
        assert!(thin[1].corners.len() > thin[2].corners.len());
        assert_eq!((&thin[3].corners, moved[3]), (&rings[3], 0.0));
    }

    /// A pole, a sliver, a line that leads back, and a point.
    #[test]
    fn a_hole_too_small_for_an_obstacle_is_kept() {
        let places = |pairs: &[(f64, f64)]| -> Vec<Local> {
            pairs.iter().map(|(n, e)| Local::new(*n, *e)).collect()
        };
        let pole = |half: f64| {
            places(&[
                (7.0, 3.0),
                (7.0, 3.0 + half),
                (7.0 + half, 3.0 + half),
                (7.0 + half, 3.0),
            ])
        };
        let round: Vec<Local> = (0..20)
            .map(|corner| Local::new(7.0, 3.0).towards(TAU * f64::from(corner) / 20.0, 0.005))
            .collect();
        let sliver = places(&[(30.0, 20.0), (34.0, 24.0), (30.000_001, 20.0)]);
        let line = places(&[(30.0, 20.0), (34.0, 24.0), (32.0, 22.0)]);
        for ring in [
            pole(0.009),
            pole(1e-6),
            round,
            sliver,
            line,
            vec![Local::new(7.0, 3.0); 4],
        ] {
            let obstacle = grown(&ring).unwrap();
            assert!(
                polygon::area(&obstacle).abs() >= LEAST_OBSTACLE,
                "{obstacle:?}"
            );
            assert_eq!(polygon::crossing(&obstacle), None, "{obstacle:?}");
            for corner in &ring {
                for towards in 0..24 {
                    let about = corner.towards(TAU * f64::from(towards) / 24.0, 0.9 * ABOUT);
                    assert!(
                        polygon::holds(&obstacle, about, 0.0),
                        "{about} {obstacle:?}"
                    );
                }
            }
            let farthest = |corner: &Local| {
                let distances = ring.iter().map(|at| at.distance(*corner));
                distances.fold(f64::INFINITY, f64::min)
            };
            assert!(
                obstacle.iter().all(|corner| farthest(corner) < 2.5 * ABOUT),
                "{obstacle:?}"
            );
        }
        assert_eq!(grown(&pole(0.011)), None);
    }

    proptest! {
        #[test]
        fn a_fence_stays_inside_its_boundary(
            asides in prop::collection::vec(-0.1_f64..0.1, 65..300), radius in 15.0_f64..200.0
        ) {
            let ring = walked(radius, &asides);
            let given = polygon_of(&ring);
            let inner = thinned(&ring, 64, Side::Inside).unwrap();
            prop_assert!(inner.corners.len() <= 64);
            let thin = polygon_of(&inner.corners);
            prop_assert!(thin.difference(&given).unsigned_area() < 1e-5);
            let length = TAU * radius * 1.2;
            prop_assert!(inner.area > 0.0 && inner.area < inner.moved * length, "{:?}", inner.area);
            let outer = thinned(&ring, 64, Side::Outside).unwrap();
            let thin = polygon_of(&outer.corners);
            prop_assert!(given.difference(&thin).unsigned_area() < 1e-5);
        }
    }
}
