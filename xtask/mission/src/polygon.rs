//! Questions about one ring of corners. The first corner does not stand again at the end.

use geo::{Area as _, Coord, LineString, Polygon};

use crate::place::Local;

/// The place with east as x and north as y.
pub(crate) fn coord(place: Local) -> Coord {
    Coord {
        x: place.east,
        y: place.north,
    }
}

/// The ring as a closed line.
pub(crate) fn ring(corners: &[Local]) -> LineString {
    let mut line: LineString = corners.iter().copied().map(coord).collect();
    line.close();
    line
}

/// The corners of a closed line.
pub(crate) fn corners(ring: &LineString) -> Vec<Local> {
    let place = |coord: &Coord| Local::new(coord.y, coord.x);
    let mut corners: Vec<Local> = ring.coords().map(place).collect();
    if corners.len() > 1 && corners.first() == corners.last() {
        corners.pop();
    }
    corners
}

/// Area, m2, positive if the corners go round clockwise as seen from above.
#[must_use]
pub fn area(corners: &[Local]) -> f64 {
    -Polygon::new(ring(corners), Vec::new()).signed_area()
}

/// Distance of a place to the straight piece between two others, m.
#[must_use]
pub fn distance_to_piece(place: Local, from: Local, to: Local) -> f64 {
    let (north, east) = (to.north - from.north, to.east - from.east);
    let square = north * north + east * east;
    if square == 0.0 {
        return place.distance(from);
    }
    let along = (place.north - from.north) * north + (place.east - from.east) * east;
    place.distance(from.between(to, (along / square).clamp(0.0, 1.0)))
}

fn sides(corners: &[Local]) -> impl Iterator<Item = (Local, Local)> {
    let next = corners.iter().cycle().skip(1);
    corners.iter().copied().zip(next.copied())
}

/// True if a place is inside, or outside by at most `margin` metres.
#[must_use]
pub fn holds(corners: &[Local], place: Local, margin: f64) -> bool {
    // The sides that cross the way from the place to the east, each counted at its lower end only.
    let crossed = sides(corners).filter(|(from, to)| {
        (from.north > place.north) != (to.north > place.north) && {
            let share = (place.north - from.north) / (to.north - from.north);
            from.east + share * (to.east - from.east) > place.east
        }
    });
    crossed.count() % 2 == 1
        || sides(corners).any(|(from, to)| distance_to_piece(place, from, to) <= margin)
}

/// Two sides that meet although they are no neighbours, or neighbours that lie on each other, by the numbers of their first
/// corners. `None` for a simple polygon.
#[must_use]
pub fn crossing(corners: &[Local]) -> Option<(usize, usize)> {
    use geo::line_intersection::{LineIntersection, line_intersection};
    let count = corners.len();
    let sides: Vec<geo::Line> = sides(corners)
        .map(|(from, to)| geo::Line::new(coord(from), coord(to)))
        .collect();
    // By their least north, so that each side is compared only with those beside it.
    let low = |index: &usize| sides[*index].start.y.min(sides[*index].end.y);
    let high = |index: usize| sides[index].start.y.max(sides[index].end.y);
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|one, other| low(one).total_cmp(&low(other)));
    for (place, &one) in order.iter().enumerate() {
        for &other in order[place + 1..]
            .iter()
            .take_while(|other| low(other) <= high(one))
        {
            let (first, second) = (one.min(other), one.max(other));
            let neighbours = second == first + 1 || (first == 0 && second + 1 == count);
            match line_intersection(sides[one], sides[other]) {
                None => {}
                Some(LineIntersection::SinglePoint { .. }) if neighbours => {}
                Some(_) => return Some((first, second)),
            }
        }
    }
    None
}

/// Where two sides meet that [`crossing`] found.
#[must_use]
pub fn meeting(corners: &[Local], (one, other): (usize, usize)) -> Option<Local> {
    use geo::line_intersection::{LineIntersection, line_intersection};
    let side = |index: usize| {
        let (from, to) = sides(corners).nth(index)?;
        Some(geo::Line::new(coord(from), coord(to)))
    };
    let at = match line_intersection(side(one)?, side(other)?)? {
        LineIntersection::SinglePoint { intersection, .. } => intersection,
        LineIntersection::Collinear { intersection } => intersection.start,
    };
    Some(Local::new(at.y, at.x))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn places(pairs: &[(f64, f64)]) -> Vec<Local> {
        pairs.iter().map(|(n, e)| Local::new(*n, *e)).collect()
    }

    #[test]
    fn a_notch_is_outside() {
        let shape = places(&[
            (0.0, 0.0),
            (0.0, 4.0),
            (4.0, 4.0),
            (4.0, 3.0),
            (1.0, 2.0),
            (4.0, 1.0),
            (4.0, 0.0),
        ]);
        assert!(holds(&shape, Local::new(0.5, 2.0), 0.0));
        assert!(holds(&shape, Local::new(3.9, 0.5), 0.0));
        assert!(!holds(&shape, Local::new(3.0, 2.0), 0.0));
        assert!(!holds(&shape, Local::new(-0.1, 2.0), 0.05));
        assert!(holds(&shape, Local::new(-0.1, 2.0), 0.11));
        assert_eq!(crossing(&shape), None);
        // 16 less a triangle of 2 by 3.
        assert!((area(&shape).abs() - 13.0).abs() < 1e-12);
    }

    #[test]
    fn crossings_are_named() {
        let bow = places(&[(0.0, 0.0), (4.0, 4.0), (4.0, 0.0), (0.0, 4.0)]);
        assert_eq!(crossing(&bow), Some((0, 2)));
        assert_eq!(meeting(&bow, (0, 2)), Some(Local::new(2.0, 2.0)));
        let back = places(&[(0.0, 0.0), (4.0, 0.0), (2.0, 0.0), (0.0, 4.0)]);
        assert!(crossing(&back).is_some());
    }

    #[test]
    fn clockwise_is_positive() {
        let square = places(&[(0.0, 0.0), (2.0, 0.0), (2.0, 3.0), (0.0, 3.0)]);
        assert_eq!(area(&square), 6.0);
    }

    proptest! {
        #[test]
        fn a_star_is_simple_and_holds_its_centre(radii in prop::collection::vec(1.0_f64..9.0, 5..60)) {
            let step = std::f64::consts::TAU / radii.len() as f64;
            let corners: Vec<Local> = radii.iter().enumerate()
                .map(|(i, radius)| Local::default().towards(i as f64 * step, *radius))
                .collect();
            prop_assert_eq!(crossing(&corners), None);
            prop_assert!(holds(&corners, Local::default(), 0.0));
            prop_assert!(!holds(&corners, Local::new(0.0, 9.5), 0.4));
            prop_assert!(area(&corners) > 0.0);
        }
    }
}
