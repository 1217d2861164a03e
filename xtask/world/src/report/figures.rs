//! The figures that a summary holds, with units in the names of their fields.

use serde::Serialize;

use crate::time::since;

/// A time span in an autonomous mode.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AutonomousRun {
    /// When it began.
    pub from_seconds: f64,
    /// When it ended.
    pub until_seconds: f64,
    /// Cross-track error at the start, positive right of the line.
    pub initial_cross_track_error_cm: f64,
    /// Time from the start to the first instant from which the cross-track error stays within
    /// 5 cm for at least 3 s.
    pub settling_seconds: Option<f64>,
    /// Mean of the cross-track error from then on.
    pub mean_cross_track_error_cm: Option<f64>,
    /// Standard deviation of the cross-track error from then on.
    pub standard_deviation_cm: Option<f64>,
    /// Largest cross-track error once the approach is over, either side: from where it first passes its mean.
    pub largest_cross_track_error_cm: Option<f64>,
    /// Largest cross-track error on the side of the line away from the start: the overshoot.
    pub overshoot_cm: f64,
    /// Changes of sign of the steering effort per second after settling, without times of zero
    /// effort.
    pub steering_reversals_per_second: Option<f64>,
}

/// How the motors came to rest after an event.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StopFigures {
    /// What happened.
    pub event: String,
    /// When.
    pub at_seconds: f64,
    /// Time until both motor drivers were commanded to stop. It is 0 if they had stopped before,
    /// and `null` if they did not stop before the next event.
    pub motors_stopped_after_ms: Option<f64>,
    /// What guided the vehicle next if the motors did not stop, by its name in the network file; left
    /// out if they stopped, or if no message tells it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub guided_on_by: Option<String>,
}

/// A mode of the vehicle.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ModeFigures {
    /// When it began.
    pub at_seconds: f64,
    /// Its name.
    pub mode: String,
}

/// Figures of the bus.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BusFigures {
    /// Share of the time in which the bus is busy: frames, error frames, intermissions.
    pub load_percent: f64,
    /// Complete frames.
    pub frames: u64,
    /// Error frames; where only frames are known, those that ended in one.
    pub error_frames: u64,
    /// Basic cycles: reference messages.
    pub basic_cycles: u64,
    /// Frames for each identifier that was seen, in order of the identifier.
    pub frames_per_id: Vec<IdFigures>,
    /// Latest start of frame after its window's begin, over the exclusive windows.
    pub latest_start_us: Option<f64>,
    /// Identifier of that frame.
    pub latest_start_id: Option<u16>,
    /// Earliest start of frame against its window's begin, negative when early.
    pub earliest_start_us: Option<f64>,
    /// Number of times that an exclusive window stayed empty although its message was due and had
    /// been sent before.
    pub missed_windows: u64,
    /// Complete frames that started outside their identifier's window.
    pub frames_outside_their_window: u64,
    /// Complete frames whose identifier has no window.
    pub foreign_frames: u64,
    /// How well the nodes agreed on the global time; `null` when they were not compared.
    pub global_time: Option<GlobalTimeFigures>,
    /// One entry for each node whose gate the bus guardian closed.
    pub gates: Vec<GateFigures>,
    /// One entry for each time that the time master was held in reset.
    pub takeovers: Vec<TakeoverFigures>,
    /// Figures for each exclusive window, in order of the basic cycle.
    pub windows: Vec<WindowFigures>,
}

/// What the bus guardian did with the gate of a node.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GateFigures {
    /// The node.
    pub node: String,
    /// How often the gate was closed: for good, or until a spell was over.
    pub closings: usize,
    /// When it was closed first.
    pub first_closed_seconds: f64,
    /// When it was opened last; `null` if it is closed at the end.
    pub open_again_seconds: Option<f64>,
}

/// Differences between the nodes' global times, from one second after they know it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GlobalTimeFigures {
    /// Number of instants at which they were compared.
    pub instants: usize,
    /// Largest difference between any two nodes.
    pub largest_difference_us: f64,
    /// Difference that 99 % of the instants stay within.
    pub p99_difference_us: f64,
}

impl GlobalTimeFigures {
    /// Figures in microseconds, rounded.
    #[must_use]
    pub fn new(instants: usize, largest_us: f64, p99_us: f64) -> Self {
        Self {
            instants,
            largest_difference_us: rounded(largest_us, 3),
            p99_difference_us: rounded(p99_us, 3),
        }
    }
}

/// A takeover after the time master was held in reset.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TakeoverFigures {
    /// The time master.
    pub master: String,
    /// When it was held in reset.
    pub at_seconds: f64,
    /// From its last reference message to the next one of another master; `null` when none came.
    pub next_reference_after_us: Option<f64>,
    /// The longest that this may take: a basic cycle and the offset of the backup.
    pub bound_us: f64,
    /// Exclusive windows of other nodes that stayed empty in the basic cycle in which the master
    /// died and in the next one.
    pub windows_lost: u64,
}

/// Frames of one identifier.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct IdFigures {
    /// Identifier.
    pub id: u16,
    /// Name of the message; empty when the matrix does not know it.
    pub message: String,
    /// Complete frames.
    pub frames: u64,
}

/// Figures of one exclusive window.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WindowFigures {
    /// Identifier of its message.
    pub id: u16,
    /// Name of its message.
    pub message: String,
    /// Sender of its message.
    pub sender: String,
    /// Begin of the window, counted from the reference message's start of frame.
    pub window_start_us: f64,
    /// Cycles in which its message was on the bus in the window.
    pub frames: u64,
    /// Cycles in which the window stayed empty although the message was due and had been sent
    /// before.
    pub missed: u64,
    /// Earliest start of frame after the window's begin, negative when early.
    pub earliest_start_us: Option<f64>,
    /// Mean start of frame after the window's begin.
    pub mean_start_us: Option<f64>,
    /// Latest start of frame after the window's begin.
    pub latest_start_us: Option<f64>,
}

/// Figures of one task of one node.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TaskFigures {
    /// Node.
    pub node: String,
    /// Task.
    pub task: String,
    /// How often it ran.
    pub runs: u64,
    /// Core cycles of its longest run.
    pub longest_cycles: u64,
    /// That time in microseconds at the node's nominal clock.
    pub longest_us: f64,
}

/// `value` rounded to `digits` decimals, so that files are legible and differences in the last bit
/// do not appear.
#[must_use]
pub fn rounded(value: f64, digits: i32) -> f64 {
    let scale = 10_f64.powi(digits);
    let rounded = (value * scale).round() / scale;
    // Turns a negative zero into zero.
    rounded + 0.0
}

/// Microseconds from `earlier` to `later`; negative if `later` is the earlier one.
pub(super) fn micros_between(earlier: crate::SimTime, later: crate::SimTime) -> f64 {
    let ahead = since(later, earlier).as_ticks() as f64;
    let behind = since(earlier, later).as_ticks() as f64;
    (ahead - behind) / 1e6
}
