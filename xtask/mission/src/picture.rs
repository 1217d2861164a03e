//! A plan from above, as SVG: fence, headland, legs with their order and direction, start, scale and north.
//!
//! The file stands alone. Its colours follow the reader's light or dark scheme.

use std::fmt::Write as _;

use crate::curve::{Chain, Segment};
use crate::field::Field;
use crate::place::Local;
use crate::plan::{End, Join, Outputs, Plan};

/// Additions to the picture of a plan.
#[derive(Clone, Copy, Debug, Default)]
pub struct Options<'a> {
    /// The drivable curve of each leg ([`crate::curve::legs`]); without one, a leg is drawn through its points and not coloured.
    pub chains: &'a [Chain],
    /// The largest curvature that the vehicle can drive, 1/m. Legs are coloured by their share of it.
    pub limit: Option<f64>,
    /// Working width, m: the strips of legs with a section on.
    pub width: Option<f64>,
    /// The field of the plan: its obstacles and its inner area.
    pub field: Option<&'a Field>,
    /// The turns as the vehicle plans them, in place of straight lines between the legs.
    pub turns: &'a [Vec<Local>],
    /// What was driven, if the plan was.
    pub driven: Option<Driven<'a>>,
}

/// How a plan was driven.
#[derive(Clone, Copy, Debug)]
pub struct Driven<'a> {
    /// The way of the vehicle, no more than a few decimetres from place to place.
    pub way: &'a [Local],
    /// The parts of it on which the implement worked.
    pub worked: &'a [Vec<Local>],
    /// A line about it, below the title.
    pub figures: &'a str,
}

/// Width of the picture, in its own units, and of the column of its legend.
const WIDTH: f64 = 960.0;
const LEGEND: f64 = 230.0;
const MARGIN: f64 = 28.0;
/// Below the title.
const TOP: f64 = 76.0;
/// Largest height of the map, and least height of the picture below its title.
const TALLEST: f64 = 760.0;
const LOWEST: f64 = 330.0;
/// Most legs that all have a number.
const NUMBERED: usize = 40;

const STYLE: &str = "svg{color-scheme:light dark;--ink:#1d2830;--soft:#55646e;--page:#fff;--line:#8b979f;--shade:#e3eef5;\
    --blue:#0072b2;--green:#007e5c;--orange:#c35500;--over:#b0247a;font-family:system-ui,Helvetica,Arial,sans-serif}\
    @media(prefers-color-scheme:dark){svg{--ink:#e4e9ec;--soft:#a3b0b8;--page:#14191d;--line:#5b6870;--shade:#1d2c36;\
    --blue:#56b4e9;--green:#35c79b;--orange:#f0a35e;--over:#ff7ac0}}\
    .page{fill:var(--page)}.fence{fill:var(--shade);stroke:var(--ink);stroke-width:1.6}\
    .inner{fill:var(--page);stroke:var(--line);stroke-dasharray:5 4;fill-rule:evenodd}\
    .hole{fill:none;stroke:var(--ink);stroke-width:1.2;stroke-dasharray:1 3}\
    .strip{fill:none;stroke:var(--green);stroke-opacity:.16}.sample{stroke-width:12}.turn{fill:none;stroke:var(--line);stroke-dasharray:2 4}\
    .leg{fill:none;stroke-width:2;stroke-linejoin:round;stroke-linecap:round}.plain{stroke:var(--ink)}\
    .low{stroke:var(--blue)}.middle{stroke:var(--green)}.high{stroke:var(--orange);stroke-width:2.6}\
    .over{stroke:var(--over);stroke-width:4}.back{stroke-dasharray:7 4}.arrow{fill:var(--ink)}\
    .start{fill:var(--page);stroke:var(--ink);stroke-width:2}.end{fill:var(--ink)}.driven{fill:none;stroke:var(--over);stroke-width:1}.scale{fill:none;stroke:var(--ink);stroke-width:1.5}\
    text{fill:var(--soft);font-size:12px}.title{fill:var(--ink);font-size:19px;font-weight:bold}\
    .number{fill:var(--ink);font-size:11px;paint-order:stroke;stroke:var(--page);stroke-width:3px}";

/// Classes of curvature: up to which share of the limit, the class of the style, and its words.
const CLASSES: [(f64, &str, &str); 4] = [
    (0.5, "low", "up to 50 %"),
    (0.8, "middle", "50 to 80 %"),
    (1.0 + 1e-9, "high", "80 to 100 %"),
    (f64::INFINITY, "over", "above the limit"),
];

/// Text with the special characters of XML escaped, and without characters that XML has not.
fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\u{fffe}' | '\u{ffff}' => {}
            c if c.is_control() => {}
            c => out.push(c),
        }
    }
    out
}

/// How places become coordinates of the picture.
struct Map {
    scale: f64,
    north: f64,
    west: f64,
    height: f64,
}

impl Map {
    fn of(places: impl Iterator<Item = Local>) -> Self {
        let (mut south_west, mut north_east) = (
            Local::new(f64::INFINITY, f64::INFINITY),
            Local::new(f64::NEG_INFINITY, f64::NEG_INFINITY),
        );
        for place in places {
            south_west = Local::new(
                south_west.north.min(place.north),
                south_west.east.min(place.east),
            );
            north_east = Local::new(
                north_east.north.max(place.north),
                north_east.east.max(place.east),
            );
        }
        let size = |from: f64, to: f64| (to - from).max(1.0);
        let (tall, wide) = (
            size(south_west.north, north_east.north),
            size(south_west.east, north_east.east),
        );
        let room = WIDTH - LEGEND - 3.0 * MARGIN;
        let scale = (room / wide).min(TALLEST / tall);
        let height = (tall * scale).max(LOWEST);
        let middle = |from: f64, to: f64| 0.5 * (from + to);
        Self {
            scale,
            north: middle(south_west.north, north_east.north) + 0.5 * height / scale,
            west: middle(south_west.east, north_east.east) - 0.5 * room / scale,
            height,
        }
    }

    fn x(&self, place: Local) -> f64 {
        MARGIN + (place.east - self.west) * self.scale
    }

    fn y(&self, place: Local) -> f64 {
        TOP + (self.north - place.north) * self.scale
    }

    /// `x y` of places, for paths.
    fn path(&self, places: &[Local]) -> String {
        let mut path = String::new();
        for (index, place) in places.iter().enumerate() {
            let verb = if index == 0 { 'M' } else { 'L' };
            // Writing to a string cannot fail.
            let _ = write!(path, "{verb}{:.1} {:.1}", self.x(*place), self.y(*place));
        }
        path
    }
}

struct Canvas {
    body: String,
}

impl Canvas {
    fn path(&mut self, class: &str, path: &str) {
        let _ = writeln!(self.body, "<path class=\"{class}\" d=\"{path}\"/>");
    }

    fn text(&mut self, x: f64, y: f64, class: &str, anchor: &str, text: &str) {
        let text = escape(text);
        let _ = writeln!(
            self.body,
            "<text class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{text}</text>"
        );
    }
}

/// The picture of a plan.
#[must_use]
pub fn svg(plan: &Plan, options: &Options) -> String {
    let curves: Vec<Vec<Local>> = plan
        .legs
        .iter()
        .enumerate()
        .map(|(index, leg)| match options.chains.get(index) {
            Some(chain) => places(chain),
            None => leg.shape.points(),
        })
        .collect();
    let edge = options.field.iter().flat_map(|field| &field.area.outer);
    let edge = edge.chain(plan.obstacles.iter().flatten());
    let planned = options.turns.iter().flatten();
    let places = plan
        .fence
        .iter()
        .chain(edge)
        .chain(curves.iter().flatten())
        .chain(planned);
    let map = Map::of(places.copied());
    let mut canvas = Canvas {
        body: String::new(),
    };
    ground(&mut canvas, &map, plan, options);
    if let Some(width) = options.width {
        let working = plan.legs.iter().zip(&curves);
        let working = working.filter(|(leg, _)| leg.outputs != Outputs(0));
        let planned: Vec<&Vec<Local>> = working.map(|(_, curve)| curve).collect();
        let strips = match &options.driven {
            Some(driven) => driven.worked.iter().collect(),
            None => planned,
        };
        for strip in strips {
            let _ = writeln!(
                canvas.body,
                "<path class=\"strip\" stroke-width=\"{:.1}\" d=\"{}\"/>",
                width * map.scale,
                map.path(strip)
            );
        }
    }
    match options.turns {
        [] => turns(&mut canvas, &map, plan, &curves),
        planned => {
            for turn in planned {
                canvas.path("turn", &map.path(turn));
            }
        }
    }
    for (index, leg) in plan.legs.iter().enumerate() {
        let back = if leg.reverse { " back" } else { "" };
        for (class, piece) in coloured(options.chains.get(index), options.limit, &curves[index]) {
            canvas.path(&format!("leg {class}{back}"), &map.path(&piece));
        }
    }
    if let Some(driven) = &options.driven {
        canvas.path("driven", &map.path(driven.way));
    }
    for curve in &curves {
        arrow(&mut canvas, &map, curve);
    }
    numbers(&mut canvas, &map, plan, &curves);
    legend(&mut canvas, &map, plan, options);
    finish(canvas, plan, &map, options)
}

fn ground(canvas: &mut Canvas, map: &Map, plan: &Plan, options: &Options) {
    if !plan.fence.is_empty() {
        canvas.path("fence", &format!("{}Z", map.path(&plan.fence)));
    }
    let inner = options.field.iter().flat_map(|field| &field.inner);
    for area in inner {
        let rings: String = area
            .rings()
            .map(|ring| format!("{}Z", map.path(ring)))
            .collect();
        canvas.path("inner", &rings);
    }
    for obstacle in &plan.obstacles {
        canvas.path("hole", &format!("{}Z", map.path(obstacle)));
    }
}

/// Dotted lines where the vehicle turns: from the end of a leg to the beginning of the next one.
fn turns(canvas: &mut Canvas, map: &Map, plan: &Plan, curves: &[Vec<Local>]) {
    let count = plan.legs.len();
    for (index, leg) in plan.legs.iter().enumerate() {
        let before = match (index, plan.end) {
            (0, End::Stop) => continue,
            (0, End::Repeat) => count - 1,
            _ => index - 1,
        };
        if leg.join == Join::Turn
            && let (Some(from), Some(to)) = (curves[before].last(), curves[index].first())
        {
            canvas.path("turn", &map.path(&[*from, *to]));
        }
    }
}

/// Distances along a piece of a curve between which it is drawn straight, m: its ends are enough for a line.
fn samples(chain: &Chain, segment: &Segment) -> Vec<f64> {
    let step = (chain.length() / 400.0).max(0.25);
    let count = match segment.curvature == 0.0 && segment.sharpness == 0.0 {
        true => 1,
        false => (segment.length / step).ceil().max(1.0) as usize,
    };
    (0..=count)
        .map(|index| index as f64 / count as f64 * segment.length)
        .collect()
}

/// Places along a curve.
fn places(chain: &Chain) -> Vec<Local> {
    let mut places: Vec<Local> = Vec::new();
    for segment in &chain.segments {
        let samples = samples(chain, segment);
        // The end of a piece is the beginning of the next one.
        places.pop();
        places.extend(samples.into_iter().map(|along| segment.at(along).place));
    }
    places
}

/// A leg in pieces of one colour.
fn coloured(
    chain: Option<&Chain>,
    limit: Option<f64>,
    curve: &[Local],
) -> Vec<(&'static str, Vec<Local>)> {
    let (Some(chain), Some(limit)) = (chain, limit) else {
        return vec![("plain", curve.to_vec())];
    };
    let mut pieces: Vec<(&'static str, Vec<Local>)> = Vec::new();
    for segment in &chain.segments {
        for pair in samples(chain, segment).windows(2) {
            let curvature = segment.curvature_at(0.5 * (pair[0] + pair[1]));
            let share = curvature.abs() / limit;
            let class = CLASSES.iter().find(|(most, ..)| share <= *most);
            let class = class.map_or("over", |(_, class, _)| class);
            let (from, to) = (segment.at(pair[0]).place, segment.at(pair[1]).place);
            match pieces.last_mut() {
                Some((last, places)) if *last == class => places.push(to),
                _ => pieces.push((class, vec![from, to])),
            }
        }
    }
    pieces
}

/// A triangle in the middle of a leg, in its direction.
fn arrow(canvas: &mut Canvas, map: &Map, curve: &[Local]) {
    let length: f64 = curve.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
    let mut rest = 0.5 * length;
    let middle = curve.windows(2).find(|pair| {
        let piece = pair[0].distance(pair[1]);
        let here = rest <= piece;
        rest -= if here { 0.0 } else { piece };
        here
    });
    let Some([from, to]) = middle else { return };
    if length * map.scale < 14.0 {
        return;
    }
    let bearing = from.bearing(*to);
    let size = 5.0 / map.scale;
    let tip = from.towards(bearing, rest + size);
    let back = from.towards(bearing, rest - size);
    let beside = |side: f64| back.towards(bearing + std::f64::consts::FRAC_PI_2, side * 0.8 * size);
    canvas.path(
        "arrow",
        &format!("{}Z", map.path(&[tip, beside(1.0), beside(-1.0)])),
    );
}

/// Numbers of the legs at a quarter of them, and the marks of start and end.
fn numbers(canvas: &mut Canvas, map: &Map, plan: &Plan, curves: &[Vec<Local>]) {
    let each = plan.legs.len().div_ceil(NUMBERED);
    for (index, curve) in curves
        .iter()
        .enumerate()
        .filter(|(index, _)| index % each == 0)
    {
        let Some([from, to]) = curve.get(curve.len() / 4..).and_then(<[_]>::first_chunk) else {
            continue;
        };
        // A line has two points only.
        let at = if curve.len() == 2 {
            from.between(*to, 0.25)
        } else {
            *from
        };
        canvas.text(
            map.x(at),
            map.y(at) + 4.0,
            "number",
            "middle",
            &(index + 1).to_string(),
        );
    }
    let ends = curves.first().and_then(|curve| curve.first());
    let ends = ends.zip(curves.last().and_then(|curve| curve.last()));
    let Some((start, end)) = ends else { return };
    if plan.end == End::Stop {
        let (x, y) = (map.x(*end) - 5.0, map.y(*end) - 5.0);
        let _ = writeln!(
            canvas.body,
            "<rect class=\"end\" x=\"{x:.1}\" y=\"{y:.1}\" width=\"10\" height=\"10\"/>"
        );
    }
    let (x, y) = (map.x(*start), map.y(*start));
    let _ = writeln!(
        canvas.body,
        "<circle class=\"start\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"6\"/>"
    );
}

/// The longest round length of at most some units of the picture, m.
fn round_length(scale: f64, most: f64) -> f64 {
    let power = 10_f64.powf((most / scale).log10().floor());
    let factors = [5.0, 2.0, 1.0];
    let fits = factors
        .iter()
        .find(|factor| *factor * power * scale <= most);
    fits.unwrap_or(&1.0) * power
}

fn legend(canvas: &mut Canvas, map: &Map, plan: &Plan, options: &Options) {
    let left = WIDTH - LEGEND - MARGIN;
    let sample = |y: f64| format!("M{left:.1} {y:.1}h34");
    let mut y = TOP + 14.0;
    let mut row = |canvas: &mut Canvas, class: &str, text: &str| {
        if !class.is_empty() {
            canvas.path(class, &sample(y - 4.0));
        }
        let indent = if class.is_empty() { 0.0 } else { 46.0 };
        canvas.text(left + indent, y, "", "start", text);
        y += 22.0;
    };
    match options.limit.filter(|_| !options.chains.is_empty()) {
        Some(limit) => {
            row(canvas, "", "Curvature, share of the limit");
            row(canvas, "", &format!("(radius {:.2} m):", 1.0 / limit));
            for (_, class, words) in CLASSES {
                row(canvas, &format!("leg {class}"), words);
            }
        }
        None => row(canvas, "leg plain", "leg"),
    }
    if plan.legs.iter().any(|leg| leg.reverse) {
        row(canvas, "leg plain back", "driven backwards");
    }
    if plan.legs.iter().any(|leg| leg.join == Join::Turn) && plan.legs.len() > 1 {
        row(canvas, "turn", "turn, planned by the vehicle");
    }
    if options.driven.is_some() {
        row(canvas, "driven", "driven");
    }
    if !plan.fence.is_empty() {
        row(canvas, "scale", "fence");
    }
    if let Some(field) = options.field {
        row(canvas, "inner", "inner edge of the headland");
        if !field.area.holes.is_empty() {
            row(canvas, "hole", "obstacle");
        }
    }
    if options.width.is_some() && plan.legs.iter().any(|leg| leg.outputs != Outputs(0)) {
        row(canvas, "strip sample", "worked");
    }
    let symbol = y - 4.0;
    let _ = writeln!(
        canvas.body,
        "<circle class=\"start\" cx=\"{:.1}\" cy=\"{symbol:.1}\" r=\"6\"/>",
        left + 17.0
    );
    let tail = match plan.end {
        End::Stop => "start (the square is the end)",
        End::Repeat => "start (the mission repeats)",
    };
    canvas.text(left + 46.0, y, "", "start", tail);
    let bottom = TOP + map.height;
    let length = round_length(map.scale, LEGEND - 60.0);
    let bar = length * map.scale;
    canvas.path(
        "scale",
        &format!("M{left:.1} {:.1}v6h{bar:.1}v-6", bottom - 8.0),
    );
    canvas.text(
        left + bar + 8.0,
        bottom,
        "",
        "start",
        &format!("{length} m"),
    );
    let (x, tip) = (left + LEGEND - 16.0, bottom - 62.0);
    canvas.path("arrow", &format!("M{x:.1} {tip:.1}l7 20l-7 -5l-7 5Z"));
    canvas.text(x, tip + 34.0, "", "middle", "N");
}

fn finish(canvas: Canvas, plan: &Plan, map: &Map, options: &Options) -> String {
    let height = TOP + map.height + MARGIN;
    let legs = match plan.legs.len() {
        1 => "1 leg".to_owned(),
        count => format!("{count} legs"),
    };
    let speeds = plan.legs.iter().map(|leg| leg.speed);
    let (slow, fast) = speeds.fold((f64::INFINITY, 0.0_f64), |(slow, fast), speed| {
        (slow.min(speed), fast.max(speed))
    });
    let speed = match fast - slow < 1e-9 {
        true => format!("{fast} m/s"),
        false => format!("{slow} to {fast} m/s"),
    };
    let about = format!("{legs}, {:.0} m without turns, {speed}", plan.length());
    let about = match &options.driven {
        Some(driven) => format!("{about}; {}", escape(driven.figures)),
        None => about,
    };
    let name = escape(&plan.name);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height:.0}\" role=\"img\" \
         aria-labelledby=\"plan-title plan-text\">\n<title id=\"plan-title\">{name}</title>\n<desc id=\"plan-text\">The mission from above, \
         north up: {about}</desc>\n<style>{STYLE}</style>\n<rect class=\"page\" width=\"{WIDTH}\" height=\"{height:.0}\"/>\n\
         <text class=\"title\" x=\"{MARGIN}\" y=\"34\">{name}</text>\n<text x=\"{MARGIN}\" y=\"56\">{about}</text>\n{}</svg>\n",
        canvas.body
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_of_the_scale_are_round() {
        assert_eq!(round_length(1.0, 170.0), 100.0);
        assert_eq!(round_length(0.8, 170.0), 200.0);
        assert_eq!(round_length(30.0, 170.0), 5.0);
        assert_eq!(round_length(200.0, 170.0), 0.5);
    }

    #[test]
    fn text_is_escaped() {
        assert_eq!(escape("a<b & \"c\"\u{1}"), "a&lt;b &amp; &quot;c&quot;");
    }
}
