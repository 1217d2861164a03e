//! `sim --experiment row-limits`: how long a gap and how many leaves a row follower drives through.
//!
//! The vehicle's own law drives along field rows of the thesis (2.2.7) without bus and images: distances
//! in whole centimetres, efforts as in the command, servo pulses. Each cell of the map is a length of a
//! gap in both rows at once and a density of leaves on one side. It judges nothing: it shows where the
//! law fails.

use std::fmt::Write as _;

use control::row::{RowSettings, Sides};
use firmware::rows::{FULL_EFFORT, Follower, Furrow, State};
use serde::Serialize;
use vehicle_model::{
    Vehicle,
    manifest::{CropRows, Law, Rover},
    units::{Density, Length, Ratio, Speed},
};
use world::{
    distance,
    report::{MapAxis, MapCell, MapPanel, MapPicture, map_svg},
    rover::{Mount, Parameters, Terrain},
    row_drive::{Chain, Followed, RowDrive, Setting, follow},
    scenario::{Gap, Kind, Leaves, Row, RowStart, Section, Side},
    victor,
};

use super::{
    Error,
    kept::{Kept, Place},
    needed, run_all,
};
use crate::{Failure, cli::Sim};

/// Name of the experiment.
pub const NAME: &str = "row-limits";

/// The two speeds of the thesis (2.3), m/s.
const SPEEDS: [f64; 2] = [0.4, 0.8];

/// From the sample of the distances to the servo pulse, seconds: the limit that the analysis of the
/// vehicle holds it to.
const LATENCY: f64 = 0.002;

/// 75 feet (thesis 2.2.7), metres.
const LENGTH: f64 = 22.86;

/// Where the gap in both rows begins, metres. The longest one ends before the leaves begin again.
const GAP_FROM: f64 = 9.0;

/// Where leaves hang into the row from one side alone: the side, and from where to where, metres.
const LEAFY: [(Side, f64, f64); 2] = [(Side::Right, 3.0, 6.5), (Side::Left, 15.0, 18.5)];

/// Leaves here and there on both sides, 1/m.
const FEW: f64 = 0.5;

/// What the map spans.
#[derive(Clone, Debug)]
pub struct Grid {
    /// Lengths of the gap, metres: 0, or 0.1 to 13.
    pub gaps: Vec<f64>,
    /// Densities of the leaves, 1/m.
    pub densities: Vec<f64>,
}

impl Default for Grid {
    fn default() -> Self {
        Self {
            gaps: vec![0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0],
            densities: vec![0.0, 2.0, 4.0, 6.0, 9.0, 12.0],
        }
    }
}

/// One run.
#[derive(Clone, Copy, Debug)]
struct Job {
    speed: f64,
    gap: f64,
    density: f64,
    seed: u64,
}

/// What the runs of one cell came to.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Cell {
    /// Speed in the row's middle, m/s.
    pub speed: f64,
    /// Length of the gap in both rows, metres.
    pub gap: f64,
    /// Leaves in a metre of the leafy side.
    pub leaves: f64,
    /// Number of runs.
    pub runs: usize,
    /// Runs in which the robot touched a plant.
    pub contacts: usize,
    /// Runs in which it left the row through the gap.
    pub lefts: usize,
    /// Runs in which it stopped by itself before the end of the row.
    pub stops: usize,
    /// Runs in which one of these happened.
    pub failures: usize,
    /// Mean distance from the middle of the row, up to a contact or stop, cm.
    pub offset_cm: f64,
    /// Largest distance from the middle, cm.
    pub largest_cm: f64,
    /// Way of all runs, metres.
    pub way: f64,
    /// Mean speed along the row, m/s.
    pub mean_speed: f64,
}

/// The map.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Limit {
    /// Name of the experiment.
    pub experiment: &'static str,
    /// First seed.
    pub first_seed: u64,
    /// Number of seeds.
    pub seeds: u64,
    /// Room between the robot in the middle of the row and the stalks on either side, cm.
    pub room_cm: f64,
    /// The cells: by speed, then by the density of the leaves, then by the length of the gap.
    pub cells: Vec<Cell>,
}

/// Runs the experiment and prints the map.
///
/// # Errors
/// The vehicle has no rover under Furrow's law, or the output folder is wrong (exit code 2).
pub fn run(vehicle: &Vehicle, options: &Sim) -> Result<(), Failure> {
    let place = Place::of(options)?;
    let grid = Grid::default();
    let kept = match &place {
        Some(place) => {
            let manifest = vehicle.manifest();
            place.kept(NAME, options, &(&grid, &manifest.rover), &[])?
        }
        None => None,
    };
    let (map, runs) = map(vehicle, &grid, (options.seed, options.seeds), kept)?;
    if let Some(place) = place {
        let picture = picture(vehicle, &grid, &map);
        place.finish(&[
            ("experiment.json", &json(&map)),
            ("runs.csv", &runs),
            ("row-limits.svg", &picture),
        ])?;
    }
    if options.json {
        print!("{}", json(&map));
    } else {
        print!("{}", text(&grid, &map));
    }
    Ok(())
}

/// The map of a vehicle's law over a grid, and one line of CSV for each run.
///
/// # Errors
/// The vehicle has no rover, or not under Furrow's law, or no settings can be made of its numbers.
fn map(
    vehicle: &Vehicle,
    grid: &Grid,
    (first_seed, seeds): (u64, u64),
    kept: Option<Kept<Followed>>,
) -> Result<(Limit, String), Error> {
    let rover = needed(vehicle, "[rover]", vehicle.manifest().rover.as_ref())?;
    if rover.law != Law::Furrow {
        return Err(Error::ThesisLaw {
            vehicle: vehicle.name().into(),
        });
    }
    let period = f64::from(vehicle.network().basic_cycle_us) * 1e-6;
    let mut jobs = Vec::new();
    for speed in SPEEDS {
        for &density in &grid.densities {
            for &gap in &grid.gaps {
                jobs.extend((0..seeds).map(|number| Job {
                    speed,
                    gap,
                    density,
                    seed: first_seed.wrapping_add(number),
                }));
            }
        }
    }
    let runs = run_all(&jobs, &Job::name, kept, &|job| job.drive(rover, period))?;
    let cells = jobs
        .chunks(seeds as usize)
        .zip(runs.chunks(seeds as usize))
        .map(|(jobs, runs)| Cell::of(&jobs[0], runs))
        .collect();
    let rows = &rover.rows;
    let free = rows.width.get() - rows.stalk.get() - rover.width.get();
    let map = Limit {
        experiment: NAME,
        first_seed,
        seeds,
        room_cm: (free * 50.0 * 100.0).round() / 100.0,
        cells,
    };
    Ok((map, csv(&jobs, &runs)))
}

impl Limit {
    /// Whether runs failed where there is neither a gap nor leaves on one side.
    fn fails_when_bare(&self) -> bool {
        let bare = |cell: &&Cell| cell.gap == 0.0 && cell.leaves == 0.0;
        self.cells.iter().filter(bare).any(|cell| cell.failures > 0)
    }
}

impl Job {
    fn name(&self) -> String {
        format!("{} m/s with a gap of {} m", self.speed, self.gap)
    }

    /// The row of this run, with the width and the stalks of the vehicle's rows.
    fn row(&self, rows: &CropRows) -> Row {
        let leaves = |side, from, to, density| Leaves {
            side,
            from: Length::new(from),
            to: Length::new(to),
            density: Density::new(density),
            reach: Length::new(0.25),
            length: Length::new(0.12),
        };
        let mut all = vec![leaves(Side::Both, 0.0, LENGTH, FEW)];
        all.extend(LEAFY.map(|(side, from, to)| leaves(side, from, to, self.density)));
        let gap = Gap {
            side: Side::Both,
            from: Length::new(GAP_FROM),
            to: Length::new(GAP_FROM + self.gap),
        };
        Row {
            section: vec![Section {
                kind: Kind::Stalks,
                length: Length::new(LENGTH),
                width: Some(rows.width),
                spacing: None,
                diameter: Some(rows.stalk),
                diameter_scatter: None,
                along: None,
                across: None,
                missing: Ratio::new(0.05),
                behind: None,
            }],
            gap: Vec::from_iter((self.gap > 0.0).then_some(gap)),
            leaves: all,
            start: RowStart {
                station: Length::new(0.3),
                ..RowStart::default()
            },
            ..Row::default()
        }
    }

    /// The run. The law is told the speed, and the length of the gap if it is longer than the longest one
    /// of the manifest: it takes what is longer for the end of the row.
    fn drive(&self, rover: &Rover, period: f64) -> Result<Followed, Error> {
        let mut told = *rover;
        told.cruise = Speed::new(self.speed);
        told.rows.gap = Length::new(rover.rows.gap.get().max(self.gap));
        let settings = RowSettings::<f32>::for_robot(&vehicle_model::robot(&told))?;
        let mut follower = Follower::<Furrow>::new(&settings);
        let row = self.row(&rover.rows);
        let setting = Setting {
            row: &row,
            rover: Parameters::of(rover),
            mount: Mount::of(rover),
            terrain: Terrain::field(),
            distance: distance::Parameters::default(),
            driver_clocks: victor::clocks(self.seed),
        };
        let chain = Chain {
            period,
            latency: LATENCY,
            // Four times as long as at full speed.
            longest: 4.0 * LENGTH / self.speed,
        };
        let mut drive = RowDrive::new(&setting, self.seed);
        Ok(follow(&mut drive, &chain, |[left, right]| {
            let distances = Sides {
                left: Some(left),
                right: Some(right),
            };
            let step = follower.command(&distances, true, period as f32);
            follower.correct();
            let effort = |effort| f64::from(effort) / f64::from(FULL_EFFORT);
            (step.state == State::Following)
                .then(|| [effort(step.efforts.left), effort(step.efforts.right)])
        }))
    }
}

impl Cell {
    fn of(job: &Job, runs: &[Followed]) -> Self {
        let sum = |value: fn(&Followed) -> f64| runs.iter().map(value).sum::<f64>();
        let count = |is: fn(&Followed) -> bool| runs.iter().filter(|run| is(run)).count();
        let way = sum(|run| run.way);
        Self {
            speed: job.speed,
            gap: job.gap,
            leaves: job.density,
            runs: runs.len(),
            contacts: count(|run| run.touched),
            lefts: count(|run| run.left),
            stops: count(|run| run.stopped),
            failures: count(Followed::failed),
            offset_cm: 100.0 * sum(|run| run.offset) / runs.len().max(1) as f64,
            largest_cm: 100.0
                * runs
                    .iter()
                    .fold(0.0, |most, run| f64::max(most, run.largest)),
            way,
            mean_speed: way / sum(|run| run.time).max(f64::MIN_POSITIVE),
        }
    }

    /// Share of the runs in which the robot did not come to the end of the row.
    fn failed(&self) -> f64 {
        self.failures as f64 / self.runs.max(1) as f64
    }
}

/// The map for programs.
fn json(map: &Limit) -> String {
    let mut text = serde_json::to_string_pretty(map).unwrap_or_default();
    text.push('\n');
    text
}

/// The cells of one speed, a line for each density.
fn lines<'a>(
    grid: &'a Grid,
    map: &'a Limit,
    speed: f64,
) -> impl Iterator<Item = (f64, &'a [Cell])> {
    let of_speed = map.cells.chunks(grid.gaps.len() * grid.densities.len());
    let cells = of_speed.filter(move |cells| cells[0].speed == speed);
    let lines = cells.flat_map(|cells| cells.chunks(grid.gaps.len()));
    grid.densities.iter().copied().zip(lines)
}

/// The map for people: in each cell the runs that failed, and the mean offset.
fn text(grid: &Grid, map: &Limit) -> String {
    let last = map.first_seed.wrapping_add(map.seeds - 1);
    let mut text = format!(
        "{NAME}: seeds {} to {last}; in each cell the runs that touched a plant, left the row or\n\
         stopped before its end, and the mean distance from the row's middle in cm\n\
         between robot and stalks are {:.1} cm on either side\n",
        map.first_seed, map.room_cm
    );
    // Writing to a string cannot fail.
    for speed in SPEEDS {
        let _ = write!(
            text,
            "\n{speed} m/s\n{:>14} | gap in both rows (m)\n{:>14} |",
            "leaves (1/m)", ""
        );
        for gap in &grid.gaps {
            let _ = write!(text, "{gap:>12}");
        }
        text.push('\n');
        let (mut way, mut time) = (0.0, 0.0);
        for (density, cells) in lines(grid, map, speed) {
            let _ = write!(text, "{density:>14} |");
            for cell in cells {
                let _ = write!(text, "{:>6}{:>6.1}", cell.failures, cell.offset_cm);
                way += cell.way;
                time += cell.way / cell.mean_speed;
            }
            text.push('\n');
        }
        let _ = writeln!(
            text,
            "{:>14} | {:.1} km at {:.2} m/s on average",
            "",
            way / 1000.0,
            way / time
        );
    }
    if map.fails_when_bare() {
        text.push_str(NOT_FITTED);
    }
    text
}

/// What failures in rows without gap and leaves mean.
const NOT_FITTED: &str = "\n\
    Even rows without gap and leaves make runs fail: rows or sensors differ too much from those that the\n\
    law was fitted to, 76.2 cm apart and with beams at 45 deg. Wider rows or a slower cruise speed help.\n";

/// The map as a picture.
fn picture(vehicle: &Vehicle, grid: &Grid, map: &Limit) -> String {
    let panel = |speed: &f64| {
        let cells = lines(grid, map, *speed).flat_map(|(_, cells)| cells);
        let cell = |cell: &Cell| MapCell {
            share: cell.failed(),
            label: format!("{:.1} cm", cell.offset_cm),
        };
        MapPanel {
            heading: format!("{speed} m/s"),
            cells: cells.map(cell).collect(),
        }
    };
    map_svg(&MapPicture {
        name: "Limits of the row follower",
        about: &format!(
            "vehicle {}, {} runs a cell from seed {}: share of the runs that touch a plant, leave the row or \
             stop, and the mean distance from the middle",
            vehicle.name(),
            map.seeds,
            map.first_seed
        ),
        across: MapAxis {
            label: "gap in both rows (m)",
            values: &grid.gaps,
        },
        down: MapAxis {
            label: "leaves on one side over 3.5 m (1/m)",
            values: &grid.densities,
        },
        panels: &SPEEDS.iter().map(panel).collect::<Vec<_>>(),
    })
}

/// One line for each run.
fn csv(jobs: &[Job], runs: &[Followed]) -> String {
    let mut text = String::from(
        "speed,gap_m,leaves_per_m,seed,offset_cm,largest_cm,way_m,seconds,contact,left,stopped\n",
    );
    for (job, run) in jobs.iter().zip(runs) {
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{},{},{},{},{:.3},{:.2},{:.3},{:.3},{},{},{}",
            job.speed,
            job.gap,
            job.density,
            job.seed,
            100.0 * run.offset,
            100.0 * run.largest,
            run.way,
            run.time,
            run.touched,
            run.left,
            run.stopped
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use vehicle_model::{Overrides, units::Angle};
    use world::scenario::Limits;

    use crate::{Workspace, vehicle};

    fn tiny() -> Grid {
        Grid {
            gaps: vec![0.0, 12.0],
            densities: vec![0.0],
        }
    }

    fn follower() -> Vehicle {
        vehicle::find(&Workspace::find().unwrap(), "row-follower").unwrap()
    }

    /// A row without a gap is driven well, and one with twelve metres without a plant, of which the law
    /// was told, less well.
    #[test]
    fn a_map_tells_a_good_row_from_a_bad_one() {
        let (map, runs) = map(&follower(), &tiny(), (3, 2), None).unwrap();
        assert_eq!(map.cells.len(), 4);
        assert_eq!(runs.lines().count(), 1 + 8);
        for cells in map.cells.chunks(2) {
            let [good, bad] = cells else { panic!() };
            assert_eq!((good.runs, good.failures), (2, 0), "{good:?}");
            assert!(good.way > 40.0 && good.offset_cm < 3.0, "{good:?}");
            assert!(good.mean_speed > 0.8 * good.speed, "{good:?}");
            assert!(
                bad.failures > 0 || bad.offset_cm > good.offset_cm,
                "{bad:?}"
            );
        }
        let text = text(&tiny(), &map);
        assert!(text.contains("seeds 3 to 4"), "{text}");
        let line = text.lines().find(|line| line.trim().starts_with("0 |"));
        assert_eq!(line.unwrap().split_whitespace().count(), 6, "{text}");
        let parsed: serde_json::Value = serde_json::from_str(&json(&map)).unwrap();
        assert_eq!(parsed["cells"][1]["gap"], 12.0);
        let picture = picture(&follower(), &tiny(), &map);
        assert!(picture.contains("vehicle row-follower, 2 runs a cell from seed 3"));
    }

    #[test]
    fn a_cell_counts_each_failed_run_once() {
        let job = Job {
            speed: 0.4,
            gap: 1.0,
            density: 2.0,
            seed: 1,
        };
        let good = Followed {
            offset: 0.01,
            largest: 0.03,
            way: 20.0,
            time: 50.0,
            ..Followed::default()
        };
        let gone = Followed {
            offset: 0.03,
            largest: 0.5,
            way: 10.0,
            time: 30.0,
            touched: true,
            left: true,
            ..Followed::default()
        };
        let stopped = Followed {
            stopped: true,
            ..good
        };
        let cell = Cell::of(&job, &[good, gone, stopped, good]);
        assert_eq!((cell.runs, cell.failures), (4, 2));
        assert_eq!((cell.contacts, cell.lefts, cell.stops), (1, 1, 1));
        assert!((cell.offset_cm - 1.5).abs() < 1e-9, "{cell:?}");
        assert!((cell.largest_cm - 50.0).abs() < 1e-9, "{cell:?}");
        assert!((cell.mean_speed - 70.0 / 180.0).abs() < 1e-9, "{cell:?}");
        assert!((cell.failed() - 0.5).abs() < 1e-9, "{cell:?}");
    }

    /// The seed decides alone: neither the number of runs nor their order changes one.
    #[test]
    fn a_run_depends_on_its_job_alone() {
        let lines = |seed, seeds| map(&follower(), &tiny(), (seed, seeds), None).unwrap().1;
        let (both, one) = (lines(3, 2), lines(4, 1));
        for line in one.lines() {
            assert!(both.lines().any(|other| other == line), "{line}");
        }
    }

    #[test]
    fn every_row_of_the_map_is_possible() {
        let vehicle = follower();
        let rover = vehicle.manifest().rover.as_ref().unwrap();
        let limits = Limits::of(&Parameters::of(rover), &Mount::of(rover));
        let grid = Grid::default();
        for &gap in &grid.gaps {
            for &density in &grid.densities {
                let job = Job {
                    speed: 0.4,
                    gap,
                    density,
                    seed: 1,
                };
                assert_eq!(job.row(&rover.rows).check(&limits), Ok(()));
            }
        }
    }

    /// Rows of another width than the vehicle's would tell where a wrong manifest fails.
    #[test]
    fn the_rows_are_as_wide_as_the_vehicles() {
        let set = Overrides::parse("rover.rows.width=110 cm").unwrap();
        let wide = vehicle::with(&Workspace::find().unwrap(), "row-follower", &set).unwrap();
        let grid = Grid {
            gaps: vec![0.0],
            densities: vec![0.0],
        };
        let (map, _) = map(&wide, &grid, (1, 2), None).unwrap();
        for cell in &map.cells {
            assert!(cell.failures == 0 && cell.offset_cm < 4.0, "{cell:?}");
        }
    }

    /// Narrow rows and beams far ahead: the map says why even the bare row fails.
    #[test]
    fn rows_that_the_law_was_not_fitted_to_are_explained() {
        let grid = Grid {
            gaps: vec![0.0],
            densities: vec![0.0],
        };
        let of = |set: &str| {
            let set = Overrides::parse(set).unwrap();
            let vehicle = vehicle::with(&Workspace::find().unwrap(), "row-follower", &set).unwrap();
            let map = map(&vehicle, &grid, (1, 4), None).unwrap().0;
            text(&grid, &map)
        };
        let narrow = of("rover.rows.width=53 cm;rover.sensors.angle=30 deg");
        assert!(narrow.contains("are 10.0 cm on either side"), "{narrow}");
        assert!(narrow.ends_with(NOT_FITTED), "{narrow}");
        let own = of("");
        assert!(!own.contains(NOT_FITTED), "{own}");
        // The text names the rows and the sensors of the vehicle as it comes.
        let vehicle = follower();
        let rover = vehicle.manifest().rover.as_ref().unwrap();
        let fitted = (rover.rows.width, rover.sensors.angle);
        assert_eq!(fitted, (Length::new(0.762), Angle::degrees(45.0)));
    }

    #[test]
    fn another_law_is_refused_with_what_to_do() {
        let set = Overrides::parse("rover.law=thesis").unwrap();
        let thesis = vehicle::with(&Workspace::find().unwrap(), "row-follower", &set).unwrap();
        let error = map(&thesis, &tiny(), (1, 1), None).unwrap_err();
        assert!(error.is_usage());
        assert!(
            error.to_string().contains("use --set rover.law=furrow"),
            "{error}"
        );
    }

    #[test]
    fn a_vehicle_without_a_row_law_is_refused() {
        let uagv = vehicle::find(&Workspace::find().unwrap(), "uagv").unwrap();
        let error = map(&uagv, &tiny(), (1, 1), None).unwrap_err();
        assert!(error.is_usage());
        assert!(error.to_string().contains("has no [rover]"), "{error}");
    }
}
