//! The picture of a drive along a row: plants, leaves, beams, path and contact from above.

use super::plot::{Anchor, Canvas, Panel, Span, colour};
use crate::distance::Beam;
use crate::rover::State;
use crate::rows::{Contact, Footprint, Rows, Shape, What};

const WIDTH: f64 = 1000.0;
const LEFT: f64 = 76.0;
const INNER: f64 = WIDTH - LEFT - 28.0;
const TOP: f64 = 112.0;

/// Least length of a strip, metres.
const STRIP: f64 = 6.0;

/// Most strips.
const STRIPS: f64 = 6.0;

/// Longest way that is shown, metres; of a longer drive it is the end.
const SHOWN: f64 = 60.0;

/// How far behind the innermost rows is shown, metres.
const BEHIND: f64 = 0.25;

/// Distance of the beams that are drawn, metres.
const BEAMS: f64 = 0.15;

/// A drive along a row.
#[derive(Copy, Clone, Debug)]
pub struct RowPicture<'a> {
    /// Title.
    pub name: &'a str,
    /// A line below the title.
    pub about: &'a str,
    /// The drive's figures, a line below that.
    pub figures: &'a str,
    /// The rows.
    pub rows: &'a Rows,
    /// Station of the robot's middle at the start, metres.
    pub start: f64,
    /// States of the robot, in order of time, no more than a few metres apart.
    pub path: &'a [State],
    /// Beams of its sensors, in order of time.
    pub beams: &'a [Beam],
    /// The first contact, and the area of the robot then.
    pub contact: Option<(Contact, Footprint)>,
}

/// A point along the row: station and distance to the right of the middle, metres.
type Spot = (f64, f64);

/// `row.svg`: the row from above in strips, one below the other, and the offset from its middle along
/// the way. Bends are drawn straight.
#[must_use]
pub fn row_svg(picture: &RowPicture) -> String {
    let path = along(picture);
    let (strips, offsets) = panels(picture, &path);
    let height = offsets.top + offsets.height + 52.0;
    let mut canvas = Canvas::new(WIDTH, height.ceil());
    canvas.title(LEFT, 32.0, picture.name);
    canvas.text(
        LEFT,
        53.0,
        13.0,
        Anchor::Start,
        colour::MUTED,
        picture.about,
    );
    let figures = picture.figures;
    canvas.text(LEFT, 73.0, 13.0, Anchor::Start, colour::INK, figures);
    for (i, strip) in strips.iter().enumerate() {
        let last = i + 1 == strips.len();
        let label = if last { "way along the row (m)" } else { "" };
        strip.axes(&mut canvas, label, "right (m)");
        if i == 0 {
            strip.heading(&mut canvas, "Seen from above, true to scale");
            for (right, stroke, text) in [
                (360.0, colour::MUTED, "plants"),
                (280.0, colour::LEAF, "leaves"),
                (204.0, colour::BEAM, "beams"),
                (128.0, colour::BLUE, "path"),
                (62.0, colour::ORANGE, "contact"),
            ] {
                strip.legend(&mut canvas, right, stroke, "", text);
            }
        }
        draw(&mut canvas, picture, strip, &path);
        strip.frame(&mut canvas);
    }
    offsets.axes(&mut canvas, "way along the row (m)", "right (cm)");
    offsets.heading(
        &mut canvas,
        "Offset of the robot's middle from that of the row",
    );
    offsets.level(&mut canvas, 0.0, colour::INK, "");
    let curve = path
        .iter()
        .map(|(station, right)| (*station, right * 100.0));
    offsets.curve(&mut canvas, curve, colour::BLUE, 1.6);
    offsets.frame(&mut canvas);
    canvas.finish(&format!("Drive along the row {}", picture.name), figures)
}

/// The path as stations and offsets.
fn along(picture: &RowPicture) -> Vec<Spot> {
    let mut near = picture.start;
    let locate = |state: &State| {
        let spot = picture.rows.line().locate(state.x, state.y, near);
        near = spot.0;
        spot
    };
    picture.path.iter().map(locate).collect()
}

/// The strips, and the panel of the offset below them.
fn panels(picture: &RowPicture, path: &[Spot]) -> (Vec<Panel>, Panel) {
    let stations = path.iter().map(|spot| spot.0);
    let driven = Span::of(stations).unwrap_or(Span { from: 0.0, to: 0.0 });
    let driven = driven.padded(0.0, 0.5);
    let (least, most) = (driven.from.min(0.0), driven.to.max(picture.rows.length()));
    let (from, to) = if most - least <= SHOWN {
        (least, most)
    } else {
        let from = (driven.to - SHOWN).max(least);
        (from, (from + SHOWN).min(most))
    };
    let count = ((to - from) / STRIP).ceil().clamp(1.0, STRIPS);
    let length = (to - from) / count;
    let widths = (0..=60).map(|i| {
        picture
            .rows
            .width_at(from + (to - from) * f64::from(i) / 60.0)
    });
    let half = widths.fold(0.0, f64::max) / 2.0 + BEHIND;
    let height = 2.0 * half * INNER / length;
    let strips: Vec<Panel> = (0..count as u32)
        .map(|i| Panel {
            left: LEFT,
            top: TOP + f64::from(i) * (height + 34.0),
            width: INNER,
            height,
            x: Span {
                from: from + f64::from(i) * length,
                to: from + f64::from(i + 1) * length,
            },
            y: Span {
                from: -half,
                to: half,
            },
            down: true,
        })
        .collect();
    let rights = path.iter().map(|spot| spot.1 * 100.0);
    let rights = Span::of(rights).unwrap_or(Span { from: 0.0, to: 0.0 });
    let offsets = Panel {
        left: LEFT,
        top: TOP + count * (height + 34.0) + 48.0,
        width: INNER,
        height: 130.0,
        x: Span { from, to },
        y: rights.with(0.0).padded(0.12, 1.0),
        down: true,
    };
    (strips, offsets)
}

/// What is seen in a strip.
fn draw(canvas: &mut Canvas, picture: &RowPicture, strip: &Panel, path: &[Spot]) {
    let rows = picture.rows;
    let point = |spot: Spot| (strip.x(spot.0), strip.y(spot.1));
    let inside = |spot: &Spot| {
        (strip.x.from..=strip.x.to).contains(&spot.0)
            && (strip.y.from..=strip.y.to).contains(&spot.1)
    };
    // Stations of the last beams drawn that look to the left, and to the right.
    let mut last = [f64::NEG_INFINITY; 2];
    let mut near = picture.start;
    for beam in picture.beams {
        let from = rows.line().locate(beam.from.0, beam.from.1, near);
        near = from.0;
        let (dx, dy) = (beam.to.0 - beam.from.0, beam.to.1 - beam.from.1);
        let part = |share: f64| {
            let (x, y) = (beam.from.0 + share * dx, beam.from.1 + share * dy);
            rows.line().locate(x, y, near)
        };
        let last = &mut last[usize::from(part(0.01).1 > from.1)];
        if !inside(&from) || from.0 < *last + BEAMS {
            continue;
        }
        *last = from.0;
        let shares = (1..=100).rev().map(|i| part(f64::from(i) / 100.0));
        if let Some(to) = shares.into_iter().find(|spot| inside(spot)) {
            canvas.line(point(from), point(to), colour::BEAM, 0.7, "");
        }
    }
    let scale = strip.width / strip.x.length();
    for (station, shape) in rows.between(strip.x.from, strip.x.to) {
        let at = |(x, y): (f64, f64)| rows.line().locate(x, y, station);
        let (from, to) = (at(shape.from), at(shape.to));
        if inside(&from) && inside(&to) {
            self::shape(canvas, shape, point(from), point(to), scale);
        }
    }
    let here = path.iter().map(|(station, right)| (*station, *right));
    strip.curve(canvas, here, colour::BLUE, 2.0);
    if let Some((contact, chassis)) = &picture.contact {
        let near = path.last().map_or(picture.start, |spot| spot.0);
        let at = |(x, y): (f64, f64)| rows.line().locate(x, y, near);
        if inside(&at((chassis.x, chassis.y))) {
            let corners = chassis.corners().map(|corner| point(at(corner)));
            canvas.outline(&corners, colour::ORANGE, 1.6);
        }
        let spot = at((contact.x, contact.y));
        if inside(&spot) {
            let (x, y) = point(spot);
            canvas.circle(x, y, 7.0, "none", colour::ORANGE);
        }
    }
}

/// A plant, leaf, weed or piece of a barrier.
fn shape(canvas: &mut Canvas, shape: &Shape, from: Spot, to: Spot, scale: f64) {
    let thickness = 2.0 * shape.radius * scale;
    match shape.what {
        What::Barrier => canvas.line(from, to, colour::INK, 2.0, ""),
        What::Leaf => canvas.line(
            from,
            to,
            colour::LEAF,
            (thickness * 10.0).round() / 10.0 + 1.0,
            "",
        ),
        What::Pole | What::Stalk => {
            canvas.disc(from.0, from.1, (thickness / 2.0).max(1.0), colour::MUTED);
        }
        What::Weed => canvas.disc(from.0, from.1, (thickness / 2.0).max(1.0), colour::GREEN),
    }
}
