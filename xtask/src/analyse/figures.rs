//! The figures of an analysis, with units in the names of their fields.

pub(super) use world::report::rounded;

use std::collections::BTreeMap;

use serde::Serialize;

/// Everything that an analysis found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// Name of the vehicle whose network the frames were read with.
    pub vehicle: String,
    /// The logs.
    pub log: LogFigures,
    /// Messages of the network that were seen, in order of their identifiers.
    pub messages: Vec<MessageFigures>,
    /// Identifiers that no message of the network has.
    pub unknown: Vec<UnknownFigures>,
    /// Remote frames by identifier; they count nowhere else but in the log's frames and load.
    pub remote: Vec<RemoteFigures>,
    /// The frames against the schedule; `null` if the nodes send at once.
    pub schedule: Option<ScheduleFigures>,
    /// Changes of the vehicle's mode.
    pub modes: Vec<ModeFigures>,
    /// How closely the vehicle followed its line; `null` if the log has no positions.
    pub guidance: Option<GuidanceFigures>,
    /// The steering's commands; `null` if the log has none.
    pub steering: Option<SteeringFigures>,
    /// Events in order of time.
    pub events: Vec<Event>,
    /// Events beyond those that are listed.
    pub events_left_out: u64,
}

/// Figures of the logs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LogFigures {
    /// The files, in the order in which they were named.
    pub files: Vec<FileFigures>,
    /// The interface of the vehicle's bus. All other figures are those of its frames.
    pub interface: String,
    /// Frames of each interface.
    pub interfaces: BTreeMap<String, u64>,
    /// Time stamp of the first frame, by the logger's clock. Times count from here.
    pub start_seconds: f64,
    /// From the first to the last frame.
    pub span_seconds: f64,
    /// Frames of the vehicle's bus.
    pub frames: u64,
    /// Share of the time in which these frames and the intermissions behind them take the bus.
    pub load_percent: f64,
    /// Frames of other interfaces, which were left out.
    pub frames_of_other_interfaces: u64,
    /// Remote frames, which carry no data.
    pub remote_frames: u64,
    /// Data frames of known messages with a length that these do not have; they were not decoded.
    pub wrong_length: u64,
    /// Frames whose time stamp is earlier than that of the frame before.
    pub time_goes_back: u64,
    /// Lines that are no frames, by kind.
    pub skipped: BTreeMap<&'static str, u64>,
}

/// A file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FileFigures {
    /// Its path.
    pub file: String,
    /// The format that its lines have.
    pub format: &'static str,
    /// Frames of classical CAN in it.
    pub frames: u64,
}

/// Frames of one message.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MessageFigures {
    /// Identifier.
    pub id: u16,
    /// Name.
    pub message: String,
    /// Sender by the network file.
    pub sender: String,
    /// Data frames with the identifier.
    pub frames: u64,
    /// Those among them with a length that the message does not have.
    pub wrong_length: u64,
    /// Mean time between two of them; `null` for fewer than two.
    pub mean_period_ms: Option<f64>,
    /// Least time between two of them.
    pub least_period_ms: Option<f64>,
    /// Greatest time between two of them.
    pub greatest_period_ms: Option<f64>,
}

/// Frames with an identifier that no message of the network has.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct UnknownFigures {
    /// Identifier.
    pub id: u32,
    /// Whether it has 29 bits.
    pub extended: bool,
    /// Frames.
    pub frames: u64,
}

/// Remote frames, which ask for a message. Any node may have sent them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RemoteFigures {
    /// The identifier that they ask for.
    pub id: u32,
    /// Whether it has 29 bits.
    pub extended: bool,
    /// The message with it; `null` if the network has none.
    pub message: Option<String>,
    /// How many.
    pub frames: u64,
}

/// The frames against the schedule. Starts of frame are the stamps less the frames' lengths.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScheduleFigures {
    /// How far beside its window a frame may begin by its stamp: a millisecond if the logger counts these.
    pub tolerance_us: f64,
    /// Reference messages.
    pub basic_cycles: u64,
    /// References that did not come when the next one was due.
    pub missing_references: u64,
    /// Mean time between two references.
    pub mean_cycle_us: Option<f64>,
    /// Least time between two references.
    pub shortest_cycle_us: Option<f64>,
    /// Greatest time between two references, without those with a missing one between them.
    pub longest_cycle_us: Option<f64>,
    /// Number of times that a window stayed empty although its message was due and had come
    /// before.
    pub missed_windows: u64,
    /// Frames that began in none of their identifier's windows.
    pub frames_outside_their_window: u64,
    /// Frames that cannot be placed: before two references that are as far apart as planned, or too long after the
    /// last one.
    pub frames_without_reference: u64,
    /// The windows in order of the basic cycle; arbitrating ones only with frames.
    pub windows: Vec<WindowFigures>,
    /// The frames outside their windows, by identifier and place.
    pub foreign: Vec<ForeignFigures>,
}

/// A window of the schedule and its message.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WindowFigures {
    /// Identifier of its message.
    pub id: u16,
    /// Name of its message.
    pub message: String,
    /// Sender of its message.
    pub sender: String,
    /// Whether other messages may be sent in it, too.
    pub arbitrating: bool,
    /// Begin of the window, counted from the reference message's start of frame.
    pub window_start_us: f64,
    /// Frames of its message in it.
    pub frames: u64,
    /// Basic cycles in which it stayed empty although its message was due and had come before.
    pub missed: u64,
    /// Earliest start of frame after the window's begin, negative when early.
    pub earliest_start_us: Option<f64>,
    /// Mean start of frame after the window's begin.
    pub mean_start_us: Option<f64>,
    /// Latest start of frame after the window's begin.
    pub latest_start_us: Option<f64>,
    /// From the earliest to the latest one.
    pub jitter_us: Option<f64>,
    /// Standard deviation of the starts.
    pub deviation_us: Option<f64>,
}

/// Frames that began in none of their identifier's windows.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ForeignFigures {
    /// Their identifier.
    pub id: u32,
    /// Whether it has 29 bits.
    pub extended: bool,
    /// The message with it; `null` if the network has none.
    pub message: Option<String>,
    /// Begin of the window that they were in; `null` for time that belongs to nobody.
    pub window_start_us: Option<f64>,
    /// The messages of that window.
    pub window_of: Vec<String>,
    /// How many.
    pub frames: u64,
}

/// A mode of the vehicle.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModeFigures {
    /// When it began, or when the log's first message with it came.
    pub from_seconds: f64,
    /// When the next one began, or the log ended.
    pub until_seconds: f64,
    /// Its name.
    pub mode: String,
    /// Whether the vehicle follows its line in it.
    pub autonomous: bool,
}

/// Positions and cross-track error.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GuidanceFigures {
    /// Positions in the log.
    pub positions: u64,
    /// The first one, m north and east of the base station.
    pub first_m: [f64; 2],
    /// The last one.
    pub last_m: [f64; 2],
    /// The autonomous runs.
    pub runs: Vec<RunFigures>,
    /// The cross-track errors of these runs from settling on; of the whole runs if none settled.
    pub histogram: Option<HistogramFigures>,
}

/// Cross-track error of the measured positions in an autonomous run, positive right of the line.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunFigures {
    /// When it began.
    pub from_seconds: f64,
    /// When it ended.
    pub until_seconds: f64,
    /// Positions in it.
    pub positions: u64,
    /// Cross-track error at its beginning.
    pub initial_cross_track_error_cm: f64,
    /// Time from its beginning to the first position from which the error stays within 5 cm for
    /// at least 3 s; `null` if there is none.
    pub settling_seconds: Option<f64>,
    /// Mean of the cross-track error from then on, or of the whole run if it did not settle.
    pub mean_cross_track_error_cm: f64,
    /// Standard deviation of the same errors.
    pub standard_deviation_cm: f64,
    /// Largest of the same errors once the approach is over, either side: from the first pass of the mean.
    pub largest_cross_track_error_cm: f64,
    /// Mean of the vehicle's own estimate of its cross-track error (a signal `CrossTrackError`) in the
    /// same time; `null` if no message has it.
    pub estimated_mean_cm: Option<f64>,
    /// Standard deviation of the same estimates.
    pub estimated_deviation_cm: Option<f64>,
}

/// How often the cross-track error was in which range.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HistogramFigures {
    /// Lower limit of the first range.
    pub from_cm: f64,
    /// Width of each range.
    pub width_cm: f64,
    /// Positions in each range.
    pub positions: Vec<u64>,
}

/// The steering's commands.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SteeringFigures {
    /// Commands in the log.
    pub commands: u64,
    /// Commands that let the steering move. The figures below are of these.
    pub enabled: u64,
    /// Commands to stand still.
    pub zero: u64,
    /// Mean commanded rate, positive to the right.
    pub mean_rate_deg_s: Option<f64>,
    /// Standard deviation of the commanded rate.
    pub deviation_deg_s: Option<f64>,
    /// Largest commanded rate, either side.
    pub largest_rate_deg_s: Option<f64>,
    /// Changes of sign of the commanded rate per second, without commands to stand still.
    pub reversals_per_second: Option<f64>,
    /// Commands to move whose effort, as the motor driver's byte, is within the actuator's dead
    /// band: the wheels stay.
    pub within_dead_band: u64,
    /// Smallest commanded rate that moves the actuator to the right, with the steering straight.
    pub moves_right_from_deg_s: Option<f64>,
    /// The same to the left, as a positive number.
    pub moves_left_from_deg_s: Option<f64>,
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Event {
    /// When, from the first frame.
    pub at_seconds: f64,
    /// Its kind.
    pub kind: EventKind,
    /// Its description.
    pub what: String,
}

/// The kind of an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum EventKind {
    /// The vehicle's mode changed.
    Mode,
    /// A button or switch changed.
    Button,
    /// A node's status names a fault.
    Fault,
    /// A node reported its status.
    Status,
    /// Another event message.
    Message,
    /// References were missing.
    MissingReference,
    /// Another master leads the bus.
    Master,
    /// Windows of a message stayed empty.
    EmptyWindow,
    /// A frame was in the window of another message, for the first time.
    Misplaced,
    /// No frame for a long time.
    Gap,
    /// The time stamps go back.
    Time,
}

impl EventKind {
    /// As `events.csv` has it.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Mode => "mode",
            Self::Button => "button",
            Self::Fault => "fault",
            Self::Status => "status",
            Self::Message => "message",
            Self::MissingReference => "missing-reference",
            Self::Master => "master",
            Self::EmptyWindow => "empty-window",
            Self::Misplaced => "misplaced",
            Self::Gap => "gap",
            Self::Time => "time",
        }
    }
}

impl ScheduleFigures {
    /// The messages of exclusive windows that never came, with their senders. A window counts as missed only
    /// once its message has come.
    pub(super) fn never_came(&self) -> Option<String> {
        let never = self.windows.iter();
        let never = never.filter(|one| !one.arbitrating && one.frames == 0);
        let names: Vec<String> = never
            .map(|one| format!("{} ({})", one.message, one.sender))
            .collect();
        (!names.is_empty()).then(|| names.join(", "))
    }
}

/// An identifier as people write it: of 11 bits decimal with its hexadecimal digits, of 29 bits
/// hexadecimal.
pub(super) fn identifier(id: u32, extended: bool) -> String {
    match extended {
        true => format!("{id:08X}"),
        false => format!("{id} (0x{id:03X})"),
    }
}
