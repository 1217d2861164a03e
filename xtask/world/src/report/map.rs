//! A map of shares over two quantities.

use super::plot::{Anchor, Canvas, colour};

const LEFT: f64 = 92.0;
const TOP: f64 = 112.0;

/// Size of a cell.
const CELL: (f64, f64) = (72.0, 44.0);

/// Between two panels.
const BETWEEN: f64 = 40.0;

/// An axis of the map.
#[derive(Clone, Copy, Debug)]
pub struct MapAxis<'a> {
    /// What it shows, with its unit.
    pub label: &'a str,
    /// The value of each column or line.
    pub values: &'a [f64],
}

/// A cell of the map.
#[derive(Clone, Debug)]
pub struct MapCell {
    /// The share that gives it its colour, 0 to 1.
    pub share: f64,
    /// A line below the share.
    pub label: String,
}

/// One of the maps of a picture.
#[derive(Clone, Debug)]
pub struct MapPanel {
    /// What distinguishes it from the others.
    pub heading: String,
    /// Its cells, line by line.
    pub cells: Vec<MapCell>,
}

/// Maps side by side, with the same axes.
#[derive(Clone, Copy, Debug)]
pub struct MapPicture<'a> {
    /// Title.
    pub name: &'a str,
    /// A line below the title.
    pub about: &'a str,
    /// The columns.
    pub across: MapAxis<'a>,
    /// The lines, the first one at the top.
    pub down: MapAxis<'a>,
    /// The maps.
    pub panels: &'a [MapPanel],
}

/// The picture: each cell shows its share as a colour and in percent.
#[must_use]
pub fn map_svg(picture: &MapPicture) -> String {
    let (columns, lines) = (picture.across.values.len(), picture.down.values.len());
    let (width, height) = (columns as f64 * CELL.0, lines as f64 * CELL.1);
    let panels = picture.panels.len() as f64;
    let whole = LEFT + panels * (width + BETWEEN);
    let mut canvas = Canvas::new(whole.max(900.0), TOP + height + 60.0);
    canvas.title(LEFT, 32.0, picture.name);
    canvas.text(
        LEFT,
        53.0,
        13.0,
        Anchor::Start,
        colour::MUTED,
        picture.about,
    );
    let bottom = TOP + height;
    for (i, value) in picture.down.values.iter().enumerate() {
        let y = TOP + (i as f64 + 0.5) * CELL.1 + 4.0;
        canvas.text(
            LEFT - 8.0,
            y,
            12.0,
            Anchor::End,
            colour::MUTED,
            &value.to_string(),
        );
    }
    canvas.rotated(LEFT - 50.0, TOP + height / 2.0, picture.down.label);
    for (i, panel) in picture.panels.iter().enumerate() {
        let left = LEFT + i as f64 * (width + BETWEEN);
        canvas.text(
            left,
            TOP - 8.0,
            13.0,
            Anchor::Start,
            colour::INK,
            &panel.heading,
        );
        for (k, cell) in panel.cells.iter().enumerate() {
            let (x, y) = ((k % columns) as f64 * CELL.0, (k / columns) as f64 * CELL.1);
            draw(&mut canvas, cell, (left + x, TOP + y));
        }
        for (k, value) in picture.across.values.iter().enumerate() {
            let x = left + (k as f64 + 0.5) * CELL.0;
            canvas.text(
                x,
                bottom + 16.0,
                12.0,
                Anchor::Middle,
                colour::MUTED,
                &value.to_string(),
            );
        }
        canvas.text(
            left + width / 2.0,
            bottom + 36.0,
            12.0,
            Anchor::Middle,
            colour::INK,
            picture.across.label,
        );
    }
    canvas.finish(picture.name, picture.about)
}

fn draw(canvas: &mut Canvas, cell: &MapCell, (x, y): (f64, f64)) {
    let share = cell.share.clamp(0.0, 1.0);
    let (width, height) = (CELL.0 - 2.0, CELL.1 - 2.0);
    canvas.rectangle(x, y, width, height, colour::GRID, 1.0);
    canvas.rectangle(x, y, width, height, colour::ORANGE, share);
    let middle = x + width / 2.0;
    let percent = format!("{:.0} %", 100.0 * share);
    canvas.text(
        middle,
        y + 18.0,
        13.0,
        Anchor::Middle,
        colour::INK,
        &percent,
    );
    canvas.text(
        middle,
        y + 34.0,
        11.0,
        Anchor::Middle,
        colour::INK,
        &cell.label,
    );
}
