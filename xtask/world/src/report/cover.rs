//! Which part of an area an implement has worked, and which part twice.

/// A place: metres north and east.
pub(super) type Spot = (f64, f64);

/// Length of a side of a cell, m. An edge of a strip is exact on average, because a cell counts by its middle.
const CELL: f64 = 0.05;

/// Most cells. In larger areas they become larger.
const MOST: f64 = 3e7;

/// What is known of a cell.
#[derive(Clone, Copy, Default)]
struct Cell {
    /// Whether it should be worked.
    wanted: bool,
    /// Whether it was worked by two passes.
    twice: bool,
    /// The last pass that worked it; 0 for none.
    pass: u16,
}

/// An area as cells.
pub(super) struct Ground {
    south: f64,
    west: f64,
    cell: f64,
    columns: usize,
    cells: Vec<Cell>,
}

/// Areas, m2.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Areas {
    /// What should be worked.
    pub wanted: f64,
    /// What of it was.
    pub worked: f64,
    /// What of all that was worked was worked by two passes or more.
    pub twice: f64,
    /// What was worked and should not be.
    pub outside: f64,
}

impl Ground {
    /// The ground about these places, with a margin (m).
    pub(super) fn about(places: impl Iterator<Item = Spot>, margin: f64) -> Self {
        let (mut least, mut most) = ((f64::MAX, f64::MAX), (f64::MIN, f64::MIN));
        for (north, east) in places {
            least = (least.0.min(north), least.1.min(east));
            most = (most.0.max(north), most.1.max(east));
        }
        let size = |from: f64, to: f64| (to - from).max(0.0) + 2.0 * margin;
        let (tall, wide) = (size(least.0, most.0), size(least.1, most.1));
        let cell = CELL.max(libm::sqrt(tall * wide / MOST));
        let count = |size: f64| (size / cell).ceil() as usize + 1;
        let (rows, columns) = (count(tall), count(wide));
        Self {
            south: least.0 - margin,
            west: least.1 - margin,
            cell,
            columns,
            cells: vec![Cell::default(); rows * columns],
        }
    }

    /// Calls `mark` for each cell whose middle lies within a convex shape.
    fn within(&mut self, corners: &[Spot], mark: &mut dyn FnMut(&mut Cell)) {
        let rows = self.cells.len() / self.columns.max(1);
        let middle = |from: f64, value: f64| (value - from) / self.cell - 0.5;
        let clamp = |index: f64, count: usize| index.clamp(0.0, count as f64) as usize;
        let norths = || corners.iter().map(|corner| middle(self.south, corner.0));
        let first = clamp(norths().fold(f64::MAX, f64::min).ceil(), rows);
        let last = clamp(norths().fold(f64::MIN, f64::max).floor() + 1.0, rows);
        for row in first..last {
            let at = row as f64;
            let (mut west, mut east) = (f64::MAX, f64::MIN);
            for (one, next) in corners.iter().zip(corners.iter().cycle().skip(1)) {
                let (from, to) = (middle(self.south, one.0), middle(self.south, next.0));
                if (from <= at) != (to <= at) {
                    let share = (at - from) / (to - from);
                    let crossing = middle(self.west, one.1 + share * (next.1 - one.1));
                    (west, east) = (west.min(crossing), east.max(crossing));
                }
            }
            let (begin, end) = (
                clamp(west.ceil(), self.columns),
                clamp(east.ceil(), self.columns),
            );
            let begin = row * self.columns + begin.min(end);
            let end = row * self.columns + end;
            for cell in self.cells.get_mut(begin..end).unwrap_or_default() {
                mark(cell);
            }
        }
    }

    /// This convex shape should be worked.
    pub(super) fn want(&mut self, corners: &[Spot]) {
        self.within(corners, &mut |cell| cell.wanted = true);
    }

    /// A pass, counted from 1, worked this convex shape.
    pub(super) fn work(&mut self, corners: &[Spot], pass: u16) {
        self.within(corners, &mut |cell| {
            cell.twice |= cell.pass != 0 && cell.pass != pass;
            cell.pass = pass;
        });
    }

    /// The areas.
    pub(super) fn areas(&self) -> Areas {
        let size = self.cell * self.cell;
        let count =
            |of: fn(&Cell) -> bool| self.cells.iter().filter(|cell| of(cell)).count() as f64 * size;
        Areas {
            wanted: count(|cell| cell.wanted),
            worked: count(|cell| cell.wanted && cell.pass != 0),
            twice: count(|cell| cell.twice),
            outside: count(|cell| !cell.wanted && cell.pass != 0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn strip(west: f64, east: f64) -> [Spot; 4] {
        [(0.0, west), (10.0, west), (10.0, east), (0.0, east)]
    }

    #[test]
    fn strips_side_by_side_cover_all_and_nothing_twice() {
        let mut ground = Ground::about([(0.0, 0.0), (10.0, 6.0)].into_iter(), 1.0);
        ground.want(&strip(0.0, 6.0));
        ground.work(&strip(0.0, 3.0), 1);
        let half = ground.areas();
        assert!((half.wanted - 60.0).abs() < 0.5 && (half.worked - 30.0).abs() < 0.5);
        ground.work(&strip(3.0, 6.0), 2);
        let all = ground.areas();
        assert_eq!((all.worked, all.twice), (all.wanted, 0.0));
        ground.work(&strip(5.0, 6.5), 3);
        let beyond = ground.areas();
        assert!((beyond.twice - 10.0).abs() < 0.5 && (beyond.outside - 5.0).abs() < 0.5);
        // The same pass again is no second one.
        ground.work(&strip(5.0, 6.5), 3);
        assert_eq!(ground.areas(), beyond);
    }

    #[test]
    fn a_slanted_shape_has_its_area() {
        let mut ground = Ground::about([(-6.0, -6.0), (6.0, 6.0)].into_iter(), 0.0);
        ground.want(&[(0.0, -5.0), (5.0, 0.0), (0.0, 5.0), (-5.0, 0.0)]);
        assert!((ground.areas().wanted - 50.0).abs() < 0.5);
        // What lies beyond the ground is left out.
        ground.work(&[(-20.0, 5.0), (20.0, 5.0), (20.0, 50.0), (-20.0, 50.0)], 1);
        assert!((ground.areas().outside - 12.0).abs() < 0.7);
    }
}
