//! Places plants, leaves, weeds and barriers from settings and a seed.

use core::f64::consts::PI;

use libm::{cos, log, sin};

use super::line::CentreLine;
use super::shape::{Shape, What};
use crate::random::{Purpose, Stream};
use crate::scenario::{Kind, Row, Section, Side};

/// Length of a piece of a barrier, metres. On an arc of 2 m radius the middle of its chord is 4 mm
/// inside.
pub(crate) const PIECE: f64 = 0.25;

/// Half of a leaf's thickness where a beam cuts it, metres.
const LEAF_RADIUS: f64 = 0.001;

/// Smallest radius of a plant, metres.
const LEAST_RADIUS: f64 = 0.002;

/// Shapes, each with the station beside which it stands.
type Shapes = Vec<(f64, Shape)>;

/// Everything in the field.
pub(super) fn shapes(row: &Row, line: &CentreLine, seed: u64) -> Shapes {
    let mut shapes = Vec::new();
    let mut plants = Stream::new(seed, Purpose::Plants);
    let mut before: Option<&Section> = None;
    for (section, from, to) in row.stations() {
        for side in [Side::Left, Side::Right] {
            if section.kind == Kind::Barriers {
                barrier(&mut shapes, row, line, section, side, from, to);
                if let Some(before) = before.filter(|before| before.kind == Kind::Barriers) {
                    step(&mut shapes, line, side, from, before, section);
                }
            } else {
                for behind in 0..=section.behind() {
                    let place = PlantLine {
                        side,
                        behind,
                        from,
                        to,
                    };
                    self::plants(&mut shapes, row, line, section, &place, &mut plants);
                }
            }
        }
        before = Some(section);
    }
    leaves(
        &mut shapes,
        row,
        line,
        &mut Stream::new(seed, Purpose::Leaves),
    );
    weeds(
        &mut shapes,
        row,
        line,
        &mut Stream::new(seed, Purpose::Weeds),
    );
    shapes
}

/// 1 for the right side, -1 for the left one.
fn sign(side: Side) -> f64 {
    if side == Side::Left { -1.0 } else { 1.0 }
}

fn barrier(
    shapes: &mut Shapes,
    row: &Row,
    line: &CentreLine,
    section: &Section,
    side: Side,
    from: f64,
    to: f64,
) {
    let right = sign(side) * section.width().get() / 2.0;
    let pieces = ((to - from) / PIECE).ceil().max(1.0);
    let at = |piece: u32| from + f64::from(piece) / pieces * (to - from);
    for piece in 0..pieces as u32 {
        let (mut from, mut to) = (at(piece), at(piece + 1));
        for gap in row.gap.iter().filter(|gap| gap.side.includes(side)) {
            // A gap is at least as long as a piece, so it cannot lie within one.
            if gap.includes(from) {
                from = gap.to.get();
            }
            if gap.includes(to) {
                to = gap.from.get();
            }
        }
        if from < to {
            let shape = Shape {
                from: line.at(from).beside(right),
                to: line.at(to).beside(right),
                radius: 0.0,
                what: What::Barrier,
            };
            shapes.push((from, shape));
        }
    }
}

/// The wall across, where the distance of two barriers changes.
fn step(
    shapes: &mut Shapes,
    line: &CentreLine,
    side: Side,
    at: f64,
    before: &Section,
    section: &Section,
) {
    let place = line.at(at);
    let end = |section: &Section| place.beside(sign(side) * section.width().get() / 2.0);
    if before.width() != section.width() {
        let shape = Shape {
            from: end(before),
            to: end(section),
            radius: 0.0,
            what: What::Barrier,
        };
        shapes.push((at, shape));
    }
}

/// One line of plants.
struct PlantLine {
    side: Side,
    /// How many lines are between it and the robot.
    behind: u32,
    from: f64,
    to: f64,
}

fn plants(
    shapes: &mut Shapes,
    row: &Row,
    line: &CentreLine,
    section: &Section,
    place: &PlantLine,
    stream: &mut Stream,
) {
    let what = if section.kind == Kind::Poles {
        What::Pole
    } else {
        What::Stalk
    };
    let middle = sign(place.side) * section.width().get() * (0.5 + f64::from(place.behind));
    let spacing = section.spacing();
    let mut next = place.from + spacing * stream.uniform();
    while next < place.to {
        // Each plant takes the same draws whether it is missing or not, so that a gap leaves the
        // others where they are.
        let present = stream.uniform() >= section.missing.get();
        // Neighbours keep their order.
        let most = 0.45 * spacing;
        let station = next + (section.along() * stream.normal()).clamp(-most, most);
        let right = middle + (section.across() * stream.normal()).clamp(-most, most);
        let radius = (section.diameter() + section.diameter_scatter() * stream.normal()) / 2.0;
        next += spacing;
        let mut gaps = row.gap.iter();
        let gap = place.behind == 0
            && gaps.any(|gap| gap.side.includes(place.side) && gap.includes(station));
        if present && !gap && (place.from..=place.to).contains(&station) {
            let centre = line.at(station).beside(right);
            shapes.push((station, Shape::disc(centre, radius.max(LEAST_RADIUS), what)));
        }
    }
}

/// The distance to the next of things that stand at random with `density` of them in a metre
/// (a Poisson process).
fn gap(stream: &mut Stream, density: f64) -> f64 {
    -log(1.0 - stream.uniform()) / density
}

fn leaves(shapes: &mut Shapes, row: &Row, line: &CentreLine, stream: &mut Stream) {
    for leaves in &row.leaves {
        for side in [Side::Left, Side::Right] {
            let density = leaves.density.get();
            if !leaves.side.includes(side) || density == 0.0 {
                continue;
            }
            let mut station = leaves.from.get() + gap(stream, density);
            while station < leaves.to.get() {
                let inward = leaves.reach.get() * stream.uniform();
                let half = leaves.length.get() * (0.25 + 0.25 * stream.uniform());
                let direction = PI * stream.uniform();
                let right = sign(side) * (row.width_at(station) / 2.0 - inward);
                let (x, y) = line.at(station).beside(right);
                let (dx, dy) = (half * cos(direction), half * sin(direction));
                let leaf = Shape {
                    from: (x - dx, y - dy),
                    to: (x + dx, y + dy),
                    radius: LEAF_RADIUS,
                    what: What::Leaf,
                };
                shapes.push((station, leaf));
                station += gap(stream, density);
            }
        }
    }
}

fn weeds(shapes: &mut Shapes, row: &Row, line: &CentreLine, stream: &mut Stream) {
    let mut add = |station: f64, right: f64, diameter: f64| {
        let centre = line.at(station).beside(right);
        shapes.push((station, Shape::disc(centre, diameter / 2.0, What::Weed)));
    };
    for weed in &row.weed {
        add(weed.at.get(), weed.right.get(), weed.diameter.get());
    }
    for weeds in &row.weeds {
        let density = weeds.density.get();
        if density == 0.0 {
            continue;
        }
        let mut station = weeds.from.get() + gap(stream, density);
        while station < weeds.to.get() {
            let right = stream.symmetric(row.width_at(station) / 2.0);
            let diameter = weeds.diameter.get() * (0.5 + stream.uniform());
            add(station, right, diameter);
            station += gap(stream, density);
        }
    }
}
