//! A netlist as a drawing (SVG): components on the left and on the right, and a line for each net
//! between them. Supplies and ground are names.

use std::collections::BTreeMap;
use std::fmt::{self, Write as _};

use crate::netlist::{Component, Net, Netlist, Node};

/// Height of a pin, px.
const ROW: i32 = 14;
/// Width of a component, px.
const BOX: i32 = 190;
/// Room for the name of a net beside its pin, px.
const NAME: i32 = 128;
/// Distance between two lines, px.
const TRACK: i32 = 9;
/// Margin and height of the title, px.
const TOP: i32 = 44;
/// Margin, px.
const EDGE: i32 = 12;

/// Tell neighbouring lines apart.
const COLOURS: [&str; 8] = [
    "#1b6ca8", "#b5402a", "#2e7d32", "#7b4fa3", "#a0660b", "#00838f", "#ad1457", "#4e5d2f",
];

/// A component with its place.
struct Placed<'n> {
    component: &'n Component,
    y: i32,
    /// Number and name of the wired pins, and their nets.
    pins: Vec<(String, &'n Net)>,
    /// Whether it has open pins.
    open: bool,
}

impl Placed<'_> {
    fn rows(&self) -> i32 {
        1 + self.pins.len() as i32 + i32::from(self.open)
    }

    /// Middle of a pin's row.
    fn pin_y(&self, pin: usize) -> i32 {
        self.y + ROW * (pin as i32 + 1) + ROW / 2
    }
}

/// A line between components: its net's place in the netlist, and what it spans.
struct Track<'n> {
    net: &'n Net,
    /// Heights of the pins, and whether they are on the right.
    pins: Vec<(i32, bool)>,
}

impl Track<'_> {
    fn top(&self) -> i32 {
        self.pins.iter().map(|(y, _)| *y).min().unwrap_or_default()
    }

    fn bottom(&self) -> i32 {
        self.pins.iter().map(|(y, _)| *y).max().unwrap_or_default()
    }
}

/// Draws a netlist. Equal netlists give equal drawings.
///
/// # Errors
/// Never: a `String` takes all that is written to it.
pub fn draw(netlist: &Netlist) -> Result<String, fmt::Error> {
    let (right, left): (Vec<&Component>, Vec<&Component>) = netlist
        .components
        .iter()
        .partition(|component| component.on_right);
    let left = place(netlist, &left, TOP);
    // Half a row lower, so that no line on the right covers one on the left.
    let right = place(netlist, &right, TOP + ROW / 2);
    let tracks = tracks(&left, &right);
    let lanes = lanes(&tracks);
    let count = lanes.iter().max().map_or(0, |lane| lane + 1);
    let channel = EDGE + BOX + NAME;
    let far = channel + TRACK * (count as i32 + 1) + NAME;
    let (width, height) = (far + BOX + EDGE, bottom(&left).max(bottom(&right)) + EDGE);

    let mut svg = String::new();
    writeln!(
        svg,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
         viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" font-size=\"10\">"
    )?;
    writeln!(
        svg,
        "<rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>"
    )?;
    text(
        &mut svg,
        (EDGE, 26),
        "start",
        "font-size=\"16\"",
        &netlist.title,
    )?;
    for (number, (track, lane)) in tracks.iter().zip(&lanes).enumerate() {
        let x = channel + TRACK * (*lane as i32 + 1);
        let colour = COLOURS[number % COLOURS.len()];
        wire(&mut svg, track, x, (EDGE + BOX, far), colour)?;
    }
    for (column, x, outward) in [(&left, EDGE, 1), (&right, far, -1)] {
        for placed in column {
            component(&mut svg, placed, x, outward)?;
        }
    }
    svg.push_str("</svg>\n");
    Ok(svg)
}

/// Stacks those of the components that have pins.
fn place<'n>(netlist: &'n Netlist, components: &[&'n Component], top: i32) -> Vec<Placed<'n>> {
    let mut y = top;
    let mut column = Vec::new();
    for component in components {
        let pins = netlist.pins_of(&component.reference);
        let wired = pins.iter().filter(|(_, net)| !net.is_open());
        let placed = Placed {
            component,
            y,
            pins: wired.map(|(node, net)| (label(node), *net)).collect(),
            open: pins.iter().any(|(_, net)| net.is_open()),
        };
        if !placed.pins.is_empty() {
            y += ROW * (placed.rows() + 1);
            column.push(placed);
        }
    }
    column
}

/// Number and name of a pin; once, if they are the same.
fn label(node: &Node) -> String {
    if node.pin == node.function {
        node.pin.clone()
    } else {
        format!("{} {}", node.pin, node.function)
    }
}

fn bottom(column: &[Placed]) -> i32 {
    column
        .last()
        .map_or(TOP, |placed| placed.y + ROW * placed.rows())
}

/// The lines, in the order of their first pins. Supplies have none.
fn tracks<'n>(left: &[Placed<'n>], right: &[Placed<'n>]) -> Vec<Track<'n>> {
    let mut tracks: BTreeMap<&str, Track<'n>> = BTreeMap::new();
    for (column, is_right) in [(left, false), (right, true)] {
        for placed in column {
            for (pin, (_, net)) in placed.pins.iter().enumerate() {
                if !net.is_supply() {
                    let pins = Vec::new();
                    let track = tracks.entry(&net.name).or_insert(Track { net, pins });
                    track.pins.push((placed.pin_y(pin), is_right));
                }
            }
        }
    }
    let mut tracks: Vec<Track> = tracks.into_values().collect();
    tracks.sort_by_key(Track::top);
    tracks
}

/// The lane of each line: the first one that no line above it reaches down to.
fn lanes(tracks: &[Track]) -> Vec<usize> {
    let mut ends: Vec<i32> = Vec::new();
    let mut lanes = Vec::new();
    for track in tracks {
        let free = ends.iter().position(|end| end + ROW <= track.top());
        let lane = free.unwrap_or(ends.len());
        match ends.get_mut(lane) {
            Some(end) => *end = track.bottom(),
            None => ends.push(track.bottom()),
        }
        lanes.push(lane);
    }
    lanes
}

/// Draws a line with the name of its net at each pin. A dot joins a pin between the ends.
fn wire(
    svg: &mut String,
    track: &Track,
    x: i32,
    (near, far): (i32, i32),
    colour: &str,
) -> fmt::Result {
    let (top, bottom) = (track.top(), track.bottom());
    writeln!(svg, "<g stroke=\"{colour}\" fill=\"none\">")?;
    writeln!(svg, "<path d=\"M{x} {top}V{bottom}\"/>")?;
    for (y, is_right) in &track.pins {
        let from = if *is_right { far } else { near };
        writeln!(svg, "<path d=\"M{from} {y}H{x}\"/>")?;
        if (top + 1..bottom).contains(y) {
            writeln!(
                svg,
                "<circle cx=\"{x}\" cy=\"{y}\" r=\"2\" fill=\"{colour}\"/>"
            )?;
        }
    }
    writeln!(svg, "</g>")?;
    for (y, is_right) in &track.pins {
        let (at, anchor) = if *is_right {
            (far - 4, "end")
        } else {
            (near + 4, "start")
        };
        let style = format!("font-size=\"9\" fill=\"{colour}\"");
        text(svg, (at, y - 2), anchor, &style, &track.net.name)?;
    }
    Ok(())
}

/// Draws a component whose pins are on the side that `outward` points to, 1 or -1.
fn component(svg: &mut String, placed: &Placed, x: i32, outward: i32) -> fmt::Result {
    let height = ROW * placed.rows();
    let Component {
        reference, value, ..
    } = placed.component;
    writeln!(
        svg,
        "<rect x=\"{x}\" y=\"{}\" width=\"{BOX}\" height=\"{height}\" fill=\"#f4f6f8\" \
         stroke=\"#333\"/>",
        placed.y
    )?;
    let label = format!("{reference}: {value}");
    text(
        svg,
        (x + 6, placed.y + 11),
        "start",
        "font-weight=\"bold\"",
        &label,
    )?;
    let (edge, inside, anchor, opposite) = if outward > 0 {
        (x + BOX, x + BOX - 6, "end", "start")
    } else {
        (x, x + 6, "start", "end")
    };
    for (pin, (name, net)) in placed.pins.iter().enumerate() {
        let y = placed.pin_y(pin);
        text(svg, (inside, y + 4), anchor, "", name.trim())?;
        if net.is_supply() {
            let end = edge + 10 * outward;
            writeln!(svg, "<path d=\"M{edge} {y}H{end}\" stroke=\"#333\"/>")?;
            let colour = if net.name == "GND" { "#333" } else { "#c00" };
            let style = format!("font-size=\"9\" fill=\"{colour}\"");
            text(svg, (end + 3 * outward, y + 3), opposite, &style, &net.name)?;
        }
    }
    if placed.open {
        let y = placed.pin_y(placed.pins.len()) + 4;
        text(svg, (inside, y), anchor, "fill=\"#777\"", "other pins open")?;
    }
    Ok(())
}

/// Writes a line of text.
fn text(
    svg: &mut String,
    (x, y): (i32, i32),
    anchor: &str,
    style: &str,
    text: &str,
) -> fmt::Result {
    let text = text.replace('&', "&amp;").replace('<', "&lt;");
    writeln!(
        svg,
        "<text x=\"{x}\" y=\"{y}\" text-anchor=\"{anchor}\" {style}>{text}</text>"
    )
}
