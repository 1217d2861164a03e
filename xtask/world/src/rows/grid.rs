//! Finds the shapes near a place, or along a beam, without a look at all of them.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use super::Hit;
use super::shape::{Point, Shape};

/// Edge of a cell, metres: about the distance between two plants.
const CELL: f64 = 0.25;

/// A cell's column and row.
type Cell = (i32, i32);

fn cell(point: Point) -> Cell {
    // Casts saturate, so that a place far away has a cell too.
    (
        (point.0 / CELL).floor() as i32,
        (point.1 / CELL).floor() as i32,
    )
}

/// Mixes a cell's two numbers by multiplication (D. E. Knuth, The Art of Computer Programming 3,
/// 6.4). It has no secret, so a run never depends on the process, and costs little for each cell
/// that a beam crosses.
#[derive(Copy, Clone, Debug, Default)]
struct Mixer(u64);

impl Hasher for Mixer {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.write_u64(u64::from(*byte));
        }
    }

    fn write_i32(&mut self, number: i32) {
        self.write_u64(u64::from(number.cast_unsigned()));
    }

    fn write_u64(&mut self, number: u64) {
        let mixed = (self.0 ^ number).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = mixed ^ (mixed >> 29);
    }
}

/// The cells that hold something.
#[derive(Clone, Debug)]
pub(super) struct Grid {
    /// For each cell the part of `members` that belongs to it.
    cells: HashMap<Cell, (u32, u32), BuildHasherDefault<Mixer>>,
    /// Indices of shapes, cell by cell.
    members: Vec<u32>,
    /// The cells between which everything lies, both included.
    least: Cell,
    most: Cell,
}

impl Grid {
    /// A grid of all `shapes`.
    pub(super) fn new(shapes: &[Shape]) -> Self {
        let mut entries: Vec<(Cell, u32)> = Vec::with_capacity(2 * shapes.len());
        for (index, shape) in shapes.iter().enumerate() {
            let (least, most) = cells_of(shape);
            for column in least.0..=most.0 {
                for row in least.1..=most.1 {
                    entries.push(((column, row), index as u32));
                }
            }
        }
        entries.sort_unstable();
        let mut cells = HashMap::default();
        let (mut least, mut most) = ((i32::MAX, i32::MAX), (i32::MIN, i32::MIN));
        for (place, (cell, _)) in entries.iter().enumerate() {
            cells.entry(*cell).or_insert((place as u32, 0)).1 = place as u32 + 1;
            least = (least.0.min(cell.0), least.1.min(cell.1));
            most = (most.0.max(cell.0), most.1.max(cell.1));
        }
        Self {
            cells,
            members: entries.into_iter().map(|(_, index)| index).collect(),
            least,
            most,
        }
    }

    fn members(&self, cell: Cell) -> &[u32] {
        self.cells.get(&cell).map_or(&[], |(from, to)| {
            &self.members[*from as usize..*to as usize]
        })
    }

    /// Indices of the shapes that may lie within `reach` of a place; some twice.
    pub(super) fn near(&self, place: Point, reach: f64) -> impl Iterator<Item = u32> {
        let least = cell((place.0 - reach, place.1 - reach));
        let most = cell((place.0 + reach, place.1 + reach));
        let columns = least.0.max(self.least.0)..=most.0.min(self.most.0);
        columns.flat_map(move |column| {
            (least.1..=most.1).flat_map(move |row| self.members((column, row)).iter().copied())
        })
    }

    /// The first shape along a beam. `way` is a unit vector. The cells are visited in the order in
    /// which the beam crosses them (Amanatides and Woo, Eurographics 1987).
    pub(super) fn cast(
        &self,
        shapes: &[Shape],
        origin: Point,
        way: Point,
        range: f64,
    ) -> Option<Hit> {
        let mut cell = cell(origin);
        let step = |part: f64| if part > 0.0 { 1 } else { -1 };
        let steps = (step(way.0), step(way.1));
        // Distances to the next borders of cells, and between two of them.
        let next = |origin: f64, way: f64, cell: i32| {
            let border = f64::from(cell) + f64::from(u8::from(way > 0.0));
            if way == 0.0 {
                f64::INFINITY
            } else {
                (border * CELL - origin) / way
            }
        };
        let mut borders = (next(origin.0, way.0, cell.0), next(origin.1, way.1, cell.1));
        let between = ((CELL / way.0).abs(), (CELL / way.1).abs());
        let mut best: Option<Hit> = None;
        loop {
            for index in self.members(cell) {
                let shape = &shapes[*index as usize];
                let nearest = best.map_or(range, |hit| hit.distance);
                if let Some(distance) = shape.hit(origin, way)
                    && distance <= nearest
                {
                    best = Some(Hit {
                        distance,
                        what: shape.what,
                    });
                }
            }
            let crossed = borders.0.min(borders.1);
            let gone = |cell: i32, step: i32, least: i32, most: i32| {
                if step > 0 { cell > most } else { cell < least }
            };
            if best.map_or(range, |hit| hit.distance) <= crossed
                || gone(cell.0, steps.0, self.least.0, self.most.0)
                || gone(cell.1, steps.1, self.least.1, self.most.1)
            {
                return best;
            }
            if borders.0 < borders.1 {
                cell.0 += steps.0;
                borders.0 += between.0;
            } else {
                cell.1 += steps.1;
                borders.1 += between.1;
            }
        }
    }
}

/// The first and the last cell of the box around a shape.
fn cells_of(shape: &Shape) -> (Cell, Cell) {
    let Shape {
        from, to, radius, ..
    } = shape;
    let low = (from.0.min(to.0) - radius, from.1.min(to.1) - radius);
    let high = (from.0.max(to.0) + radius, from.1.max(to.1) + radius);
    (cell(low), cell(high))
}
