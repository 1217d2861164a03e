//! Figures, tables and pictures of a finished run.
//!
//! [`Run`] holds the recordings, [`Summary`] the figures computed from them. [`write()`] puts the
//! summary (`summary.json`), the vehicle's states (`states.csv`) and a picture (`track.svg`, or
//! `row.svg` between rows) into an [`OutputFolder`]; [`terminal`] formats the summary as text. The files do not depend on the
//! computer that simulates: the same run gives the same bytes.

mod bus;
mod cover;
mod crop;
mod expected;
mod figures;
mod folder;
mod guidance;
mod latency;
mod map;
mod mission;
mod plot;
mod rover;
mod row;
mod states;
mod summary;
mod table;
mod terminal;
mod track;

use crate::record::{EffortChange, StateSample};
use crate::scenario::Scenario;
use crate::time::{SimDuration, SimTime};

pub use bus::{LastCycle, WindowContent, last_cycle};
pub use crop::{CropFigures, CropRun, GuideFigures, crop_svg};
pub use expected::{Decode, ExpectationFigures, Judgement, expectations};
pub use figures::{
    AutonomousRun, BusFigures, GateFigures, GlobalTimeFigures, IdFigures, ModeFigures, StopFigures,
    TakeoverFigures, TaskFigures, WindowFigures, rounded,
};
pub use folder::{FolderError, OutputFolder, remove_unfinished};
pub use guidance::{BAND, approached, settled};
pub use latency::{LatencyBar, LatencySeries, latency_svg};
pub use map::{MapAxis, MapCell, MapPanel, MapPicture, map_svg};
pub use mission::{
    CoverageFigures, LegFigures, Located, MissionFigures, MissionRun, Purpose, RunEnd,
    SectionFigures, SectionSwitch, Stage, TurnFigures,
};
pub use plot::Span;
pub use rover::{ContactFigures, DistancePair, RoverFigures, RoverRun, rover_states, rover_svg};
pub use row::{RowPicture, row_svg};
pub use states::states;
pub use summary::Summary;
pub use table::{Cell, Column, Table};
pub use terminal::terminal;
pub use track::track_svg;

/// Everything recorded in a run.
#[derive(Clone, Copy, Debug)]
pub struct Run<'a> {
    /// What was simulated.
    pub scenario: &'a Scenario,
    /// Names of the vehicle's nodes, in the order of its manifest.
    pub nodes: &'a [String],
    /// Seed of the run.
    pub seed: u64,
    /// How long was simulated.
    pub duration: SimDuration,
    /// States of the vehicle, in order of time.
    pub states: &'a [StateSample],
    /// Changes of the motor drivers' efforts, in order of time.
    pub efforts: &'a [EffortChange],
    /// Frames on the bus, in order of time.
    pub frames: &'a [FrameRecord],
    /// The windows of the system matrix.
    pub windows: &'a [Window],
    /// The byte of the reference message whose lower six bits count the basic cycles, from 0.
    pub cycle_count_byte: usize,
    /// Length of the basic cycle.
    pub basic_cycle: SimDuration,
    /// Length of a bit on the bus.
    pub bit_time: SimDuration,
    /// Changes of the vehicle's mode, in order of time.
    pub modes: &'a [ModeChange],
    /// Longest observed times of the nodes' tasks.
    pub tasks: &'a [TaskTime],
    /// The rover's recordings; `None` when the vehicle has none.
    pub rover: Option<RoverRun<'a>>,
    /// The recordings of a machine between rows; `None` without rows.
    pub crop: Option<CropRun<'a>>,
    /// What is known of the mission that was to be driven; `None` without one. The vehicle is then judged against its path
    /// in place of the line.
    pub mission: Option<MissionRun<'a>>,
}

impl Run<'_> {
    /// The reference messages, of every master, that were sent to their end.
    pub fn references(&self) -> impl Iterator<Item = &FrameRecord> {
        let of = |id| {
            let is_reference = |one: &Window| one.kind == WindowKind::Reference && one.id == id;
            self.windows.iter().any(is_reference)
        };
        let frames = self.frames.iter();
        frames.filter(move |frame| frame.is_message() && of(frame.id))
    }

    /// Where on its path the state of that index is; `None` without a mission.
    fn located(&self, index: usize) -> Option<&Located> {
        self.mission?.located.get(index)
    }
}

/// A frame on the bus.
#[derive(Copy, Clone, Debug, PartialEq, Eq)]
pub struct FrameRecord {
    /// Standard identifier.
    pub id: u16,
    /// Number of data bytes.
    pub dlc: u8,
    /// Data; only the first `dlc` bytes count.
    pub data: [u8; 8],
    /// First edge of the start-of-frame bit.
    pub start: SimTime,
    /// End of the last bit of the end of frame, or of the error frame.
    pub end: SimTime,
    /// True if every receiver accepted it; false if it ended in an error frame.
    pub complete: bool,
    /// True if it only asks for a message. Any node may do so: it is no frame of the message's sender, and
    /// carries no data.
    pub remote: bool,
}

impl FrameRecord {
    /// Whether it brought its message to every receiver.
    #[must_use]
    pub fn is_message(&self) -> bool {
        self.complete && !self.remote
    }
}

/// When the message of a window is expected in it.
#[derive(Copy, Clone, Debug, PartialEq, Eq)]
pub enum Due {
    /// In every basic cycle.
    Always,
    /// In one of so many basic cycles in a row: a receiver of 1 Hz has nothing to send in the others.
    OneOf(u16),
    /// The same, of those whose reference messages say that the fix is good (lowest bit of the first byte).
    WhileFixed(u16),
    /// When there is something to send.
    Sometimes,
}

impl Due {
    /// How many windows in a row may stay empty although the message is due in them.
    #[must_use]
    pub fn spared(self) -> u16 {
        match self {
            Self::OneOf(cycles) | Self::WhileFixed(cycles) => cycles.saturating_sub(1),
            Self::Always | Self::Sometimes => 0,
        }
    }
}

/// Kind of a window.
#[derive(Copy, Clone, Debug, PartialEq, Eq)]
pub enum WindowKind {
    /// The reference message, which begins the basic cycle.
    Reference,
    /// One message of one sender.
    Exclusive,
    /// The node that wins the arbitration sends its message.
    Arbitrating,
}

/// A window of the system matrix and the message sent in it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Window {
    /// Identifier of its message.
    pub id: u16,
    /// Name of its message.
    pub message: String,
    /// Its sender.
    pub sender: String,
    /// Its begin, counted from the reference message's start of frame.
    pub start: SimDuration,
    /// Its length.
    pub length: SimDuration,
    /// It comes in every basic cycle whose count leaves the remainder `offset` when divided by
    /// this. At least 1.
    pub repeat: u8,
    /// The first basic cycle that it comes in, below `repeat`.
    pub offset: u8,
    /// Its kind.
    pub kind: WindowKind,
    /// When its message is expected.
    pub due: Due,
}

/// The vehicle's mode changes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModeChange {
    /// When.
    pub at: SimTime,
    /// Name of the new mode.
    pub mode: String,
    /// True if the vehicle follows the line in this mode.
    pub autonomous: bool,
}

/// Longest observed time of a task.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TaskTime {
    /// Its node.
    pub node: String,
    /// Its name.
    pub task: String,
    /// How often it ran.
    pub runs: u64,
    /// Core cycles of its longest run.
    pub longest_cycles: u64,
    /// Core clock, cycles per second.
    pub core_hz: u64,
}

/// The vehicle's states over time; `None` for one without a machine and a rover.
#[must_use]
pub fn table(run: &Run) -> Option<Table> {
    states(run).or_else(|| run.rover.as_ref().map(rover_states))
}

/// Writes `summary.json` into `folder`, `states.csv` with the states of [`table`], for a vehicle with
/// a machine `track.svg`, and for one with a rover `row.svg`, which a machine between rows has too.
/// Returns the names of the files.
///
/// # Errors
/// When a file cannot be written.
pub fn write(
    run: &Run,
    summary: &Summary,
    states: Option<&Table>,
    folder: &mut OutputFolder,
) -> Result<Vec<&'static str>, FolderError> {
    let scenario = run.scenario;
    let about = format!("{}; seed {}", scenario.summary, run.seed);
    let (rover, crop) = (run.rover.as_ref(), run.crop.as_ref());
    let files = [
        ("summary.json", Some(summary.json())),
        ("states.csv", states.map(Table::csv)),
        ("track.svg", track_svg(run, summary)),
        (
            "row.svg",
            rover
                .map(|rover| rover_svg(rover, &scenario.name, &about))
                .or(crop.map(|crop| crop_svg(crop, &scenario.name, &about))),
        ),
    ];
    let mut names = Vec::new();
    for (name, contents) in files {
        if let Some(contents) = contents {
            folder.write(name, contents.as_bytes())?;
            names.push(name);
        }
    }
    Ok(names)
}
