//! Crop rows: plants, leaves, weeds and barriers on either side of the way that a robot drives.
//!
//! [`Rows::new`] makes them from a scenario's [`Row`] and a seed.
//! [`Rows::cast`] finds what a beam of light meets first, [`Rows::contact`] what a chassis touches.
//! Everything stands in the horizontal plane at the height of the distance sensors: `x` points along
//! the beginning of the row and `y` to its right, both in metres, and headings are in radians, positive
//! to the right.
//!
//! Each purpose draws from its own random stream, so more leaves move no plant.

mod grid;
mod line;
mod make;
mod shape;

pub use line::{CentreLine, Place};
pub use shape::{Footprint, Shape, What};

use grid::Grid;
pub(crate) use make::PIECE;

use crate::scenario::Row;

/// What a beam meets first.
#[derive(Copy, Clone, Debug, PartialEq)]
pub struct Hit {
    /// Distance from the beam's origin, metres.
    pub distance: f64,
    /// What it meets.
    pub what: What,
}

/// What a chassis touches.
#[derive(Copy, Clone, Debug, PartialEq)]
pub struct Contact {
    /// What it touches.
    pub what: What,
    /// `x` of a point of it, metres.
    pub x: f64,
    /// `y` of the same point, metres.
    pub y: f64,
}

/// Rows as they stand in one run.
#[derive(Clone, Debug)]
pub struct Rows {
    line: CentreLine,
    shapes: Vec<Shape>,
    /// Station beside which each shape stands, metres.
    stations: Vec<f64>,
    grid: Grid,
    length: f64,
    /// Station at which each width begins, and the width, metres.
    widths: Vec<(f64, f64)>,
}

impl Rows {
    /// The rows that `row` describes, as `seed` places them. `row` must have passed
    /// [`Row::check`].
    #[must_use]
    pub fn new(row: &Row, seed: u64) -> Self {
        let line = CentreLine::new(row);
        let (stations, shapes): (Vec<f64>, Vec<Shape>) =
            make::shapes(row, &line, seed).into_iter().unzip();
        let grid = Grid::new(&shapes);
        let widths = row
            .stations()
            .map(|(section, from, _)| (from, section.width().get()));
        Self {
            grid,
            shapes,
            stations,
            widths: widths.collect(),
            length: row.length(),
            line,
        }
    }

    /// What the beam from (`x`, `y`) towards `heading` meets within `range` metres. A beam that
    /// begins inside a plant meets it at distance zero.
    #[must_use]
    pub fn cast(&self, x: f64, y: f64, heading: f64, range: f64) -> Option<Hit> {
        let way = (libm::cos(heading), libm::sin(heading));
        self.grid.cast(&self.shapes, (x, y), way, range)
    }

    /// A solid thing that the chassis touches. Leaves give way, so they do not count.
    #[must_use]
    pub fn contact(&self, chassis: &Footprint) -> Option<Contact> {
        let reach = libm::hypot(chassis.half_length, chassis.half_width);
        let near = self.grid.near((chassis.x, chassis.y), reach);
        let mut touched: Vec<u32> = near
            .filter(|index| {
                let shape = &self.shapes[*index as usize];
                shape.what.is_solid() && chassis.touches(shape)
            })
            .collect();
        // The order of the grid's cells must not decide which of several is reported.
        touched.sort_unstable();
        touched.first().map(|index| {
            let shape = &self.shapes[*index as usize];
            Contact {
                what: shape.what,
                x: shape.from.0,
                y: shape.from.1,
            }
        })
    }

    /// Everything that stands there, in no particular order.
    #[must_use]
    pub fn shapes(&self) -> &[Shape] {
        &self.shapes
    }

    /// What stands beside the stations from `from` to `to`, metres.
    pub fn between(&self, from: f64, to: f64) -> impl Iterator<Item = (f64, &Shape)> {
        let all = self.stations.iter().copied().zip(&self.shapes);
        all.filter(move |(station, _)| (from..=to).contains(station))
    }

    /// The middle between the two innermost rows.
    #[must_use]
    pub fn line(&self) -> &CentreLine {
        &self.line
    }

    /// Length of the row along its middle, metres; it begins at station 0.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Distance between the two innermost rows at a station, metres. Before the row it is that of its
    /// beginning, behind it that of its end.
    #[must_use]
    pub fn width_at(&self, station: f64) -> f64 {
        let begun = self.widths.partition_point(|(from, _)| *from <= station);
        self.widths
            .get(begun.saturating_sub(1))
            .map_or(0.0, |(_, width)| *width)
    }
}
