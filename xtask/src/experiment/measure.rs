//! The figures of one run.

use network_model::{Message, Signal};
use serde::{Deserialize, Serialize};
use vehicle_model::Vehicle;
use world::{
    SimTime,
    report::{FrameRecord, Run, Summary},
    time::seconds,
};

use super::{Error, needed};

/// The commanded steering rate on the bus, as the vehicle's manifest names it.
#[derive(Clone, Copy, Debug)]
pub struct SteeringRate<'a> {
    /// The message that commands the motors.
    pub message: &'a Message,
    signal: &'a Signal,
}

impl<'a> SteeringRate<'a> {
    /// The signal of this vehicle.
    ///
    /// # Errors
    ///
    /// The manifest names none.
    pub fn of(vehicle: &'a Vehicle) -> Result<Self, Error> {
        let field = "calibration.steering_rate";
        let named = vehicle.manifest().calibration.as_ref();
        let path = &needed(vehicle, field, named)?.steering_rate;
        let mut messages = vehicle.network().messages.iter();
        let message = messages.find(|message| message.name == path.message);
        let message = needed(vehicle, field, message)?;
        let mut signals = message.signals.iter();
        let signal = signals.find(|signal| signal.name == path.signal);
        let signal = needed(vehicle, field, signal)?;
        Ok(Self { message, signal })
    }

    /// When the actuator nodes had each command, and its rate in the unit of the signal.
    pub fn of_frames(&self, frames: &[FrameRecord]) -> Vec<(SimTime, f64)> {
        let commands = frames
            .iter()
            .filter(|frame| frame.id == self.message.id && frame.is_message());
        let rate = |data: &[u8]| self.signal.physical(self.signal.extract(data));
        commands
            .map(|frame| (frame.end, rate(&frame.data)))
            .collect()
    }
}

/// Largest cross-track error that counts as on the line, m: the settling band of the report.
const BAND: f64 = 0.05;

/// The mean of the last seconds of this length is the one that a run arrives at. For a run that never
/// arrives, they count as its steady state.
const TAIL: f64 = 10.0;

/// Figures of one run from the moment when the vehicle drives by itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// Seed of the run.
    pub seed: u64,
    /// Time until the cross-track error stays within the band, s.
    pub settling: Option<f64>,
    /// Time until it stays within a band of that width about its own mean at the end, s: what a reader
    /// of the thesis's curves sees, whose errors have a mean other than zero.
    pub arrival: Option<f64>,
    /// Cross-track errors in steady state, evenly spaced, cm.
    pub steady: Vec<f64>,
    /// Length of the steady state, s.
    pub steady_seconds: f64,
    /// Changes of sign between steering commands that differ from zero, in steady state.
    pub sign_changes: usize,
    /// Largest cross-track error on the far side of the line, cm.
    pub overshoot: f64,
    /// Crossings of the whole band, from one side to the other.
    pub swings: usize,
    /// Whether the vehicle drove by itself up to the end.
    pub complete: bool,
}

impl Figures {
    /// The figures of `run`, `None` when the vehicle never drove by itself. `rates` are the
    /// steering commands of the run, each with the time when it took effect.
    pub fn of(run: &Run, rates: impl IntoIterator<Item = (SimTime, f64)>) -> Option<Self> {
        let summary = Summary::of(run);
        let drive = summary.autonomous_runs.first()?;
        let (from, until) = (drive.from_seconds, drive.until_seconds);
        let line = run.scenario.line.as_ref()?;
        let errors: Vec<(f64, f64)> = run
            .states
            .iter()
            .map(|state| {
                let (_, error) = line.locate(state.north, state.east);
                (seconds(state.at), error)
            })
            .filter(|(time, _)| (from..=until).contains(time))
            .collect();
        let tail = (until - TAIL).max(from);
        let arrival = arrival(&errors, tail).map(|at| at - from);
        // A law that is slow in its last centimetres is within the band before it is steady.
        let steady_after = match (drive.settling_seconds, arrival) {
            (Some(settling), Some(arrival)) => Some(settling.max(arrival)),
            (settling, arrival) => settling.or(arrival),
        };
        let steady_from = match steady_after {
            // The settling time is rounded to milliseconds, samples are 10 ms apart.
            Some(after) => from + after - 1e-3,
            None => tail,
        };
        let commands = rates
            .into_iter()
            .filter(|(at, _)| (steady_from..=until).contains(&seconds(*at)))
            .map(|(_, rate)| rate);
        Some(Self {
            seed: run.seed,
            settling: drive.settling_seconds,
            arrival,
            steady: errors
                .iter()
                .filter(|(time, _)| *time >= steady_from)
                .map(|(_, error)| error * 100.0)
                .collect(),
            steady_seconds: until - steady_from,
            sign_changes: sign_changes(commands),
            overshoot: drive.overshoot_cm,
            swings: swings(errors.iter().map(|(_, error)| *error)),
            complete: summary.autonomous_runs.len() == 1 && until >= summary.simulated_seconds,
        })
    }
}

/// When the errors, each with its time, come to stay within [`BAND`] of their mean from `tail` on.
fn arrival(errors: &[(f64, f64)], tail: f64) -> Option<f64> {
    let last = errors.iter().filter(|(time, _)| *time >= tail);
    let count = last.clone().count().max(1) as f64;
    let mean = last.map(|(_, error)| error).sum::<f64>() / count;
    let outside = errors
        .iter()
        .rposition(|(_, error)| (error - mean).abs() > BAND);
    let first = errors.get(outside.map_or(0, |index| index + 1));
    first.map(|(time, _)| *time).filter(|time| *time < tail)
}

/// Changes of sign; zeros in between are ignored.
fn sign_changes(values: impl Iterator<Item = f64>) -> usize {
    let mut last = None;
    let mut changes = 0;
    for value in values.filter(|value| *value != 0.0) {
        let positive = value > 0.0;
        changes += usize::from(last == Some(!positive));
        last = Some(positive);
    }
    changes
}

/// Crossings of the whole band, from one side to the other.
fn swings(errors: impl Iterator<Item = f64>) -> usize {
    sign_changes(errors.filter(|error| error.abs() > BAND))
}

#[cfg(test)]
mod tests {
    use world::{
        Scenario, SimDuration, StateSample, receiver::Fix, report::ModeChange, time::from_seconds,
    };

    use super::super::tests::renamed;
    use super::*;

    fn at(milliseconds: u64) -> SimTime {
        SimTime::from_ticks(milliseconds * 1_000_000_000)
    }

    /// From 1 s on the vehicle comes in from 1 m to the right at 0.5 m/s, is on the line at
    /// 3 s, shoots 20 cm over, is back at 4 s and then keeps 2 cm right and 1 cm left by
    /// turns for 6 s. Commands alternate each 100 ms between +, 0, -, 0.
    fn figures(last_mode: Option<u64>) -> Figures {
        let error = |ms: u64| match ms {
            0..=3_000 => 1.0 - 0.5 * (ms.max(1_000) - 1_000) as f64 / 1e3,
            3_001..=3_500 => -0.2 * (ms - 3_000) as f64 / 500.0,
            3_501..=4_000 => -0.2 * (4_000 - ms) as f64 / 500.0,
            _ if (ms / 10).is_multiple_of(2) => 0.02,
            _ => -0.01,
        };
        let states: Vec<StateSample> = (0..=1_000)
            .map(|k| StateSample {
                at: at(k * 10),
                north: k as f64 * 0.01,
                east: error(k * 10),
                heading: 0.0,
                steering: 0.0,
                speed: 1.0,
                steering_effort: 0.0,
                drive_effort: 0.5,
                fix: Fix::Fixed,
            })
            .collect();
        let rates = (0..100_u64).map(|k| (at(k * 100 + 8), [1.0, 0.0, -1.0, 0.0][k as usize % 4]));
        let mode = |ms, autonomous| ModeChange {
            at: at(ms),
            mode: if autonomous { "AutonomousRun" } else { "Idle" }.into(),
            autonomous,
        };
        let mut modes = vec![mode(1_000, true)];
        modes.extend(last_mode.map(|ms| mode(ms, false)));
        let workspace = crate::Workspace::find().unwrap();
        let vehicle = crate::vehicle::find(&workspace, "uagv").unwrap();
        let scenario = Scenario::parse(&vehicle, "t", "t", "").unwrap();
        let run = Run {
            scenario: &scenario,
            nodes: &[],
            seed: 9,
            duration: from_seconds(10.0),
            states: &states,
            efforts: &[],
            frames: &[],
            windows: &[],
            cycle_count_byte: 0,
            basic_cycle: SimDuration::from_ticks(100_000_000_000),
            bit_time: SimDuration::from_ticks(4_000_000),
            modes: &modes,
            tasks: &[],
            rover: None,
            crop: None,
            mission: None,
        };
        Figures::of(&run, rates).unwrap()
    }

    #[test]
    fn figures_of_a_run_are_what_was_put_in() {
        let figures = figures(None);
        assert_eq!(figures.seed, 9);
        // 5 cm to the left is passed for the last time at 4 s - 125 ms; the first sample
        // within is at 3.88 s.
        assert_eq!(figures.settling, Some(2.88));
        assert!((figures.steady_seconds - 6.12).abs() < 0.01);
        assert_eq!(figures.overshoot, 20.0);
        assert_eq!(figures.swings, 1);
        assert!(figures.complete);
        // Samples from 3.88 s to 10 s, both included.
        assert_eq!(figures.steady.len(), 613);
        assert!((figures.steady[612] - 2.0).abs() < 1e-9);
        // Commands 39..=99: k = 40 is positive, 42 negative, .., 98 negative: 30 of them.
        assert_eq!(figures.sign_changes, 29);
    }

    /// From 1 m down to 4 cm on the left within 4 s, where it stays: within the band of the line from
    /// 3.65 s on, within that of its mean from 3.85 s on.
    #[test]
    fn a_run_arrives_when_it_stays_about_its_own_mean() {
        let error = |step: u32| (1.04 - 0.0026 * f64::from(step)).max(0.0) - 0.04;
        let errors: Vec<(f64, f64)> = (0..2000)
            .map(|step| (f64::from(step) * 0.01, error(step)))
            .collect();
        let at = arrival(&errors, 10.0).unwrap();
        assert!((at - 3.81).abs() < 1e-9, "{at}");
        let restless: Vec<(f64, f64)> =
            errors.iter().map(|(time, _)| (*time, time.sin())).collect();
        assert_eq!(arrival(&restless, 10.0), None);
        assert_eq!(arrival(&[], 10.0), None);
    }

    #[test]
    fn a_run_that_ends_early_is_not_complete_and_its_tail_counts() {
        let figures = figures(Some(3_200));
        assert_eq!(figures.settling, None);
        assert!(!figures.complete);
        // Less than the tail's length: all from 1 s to 3.2 s.
        assert!((figures.steady_seconds - 2.2).abs() < 1e-9);
    }

    /// The message and its signal are those that the manifest names, wherever they are.
    #[test]
    fn the_steering_rate_is_found_by_its_role() {
        let frame = |id, data, complete| FrameRecord {
            remote: false,
            id,
            dlc: 8,
            data,
            start: at(7),
            end: at(8),
            complete,
        };
        let frames = [
            frame(300, [0, 0, 0, 0, 100, 0, 0, 0], true),
            frame(310, [100, 0, 3, 0, 0, 0, 0, 0], false),
            frame(310, [0xFF, 0xFF, 200, 0, 3, 0, 0, 0], true),
        ];
        let vehicle = renamed(&[
            ("RateToTurn : 0|16@1-", "RateToTurn : 16|16@1-"),
            (" SG_ Speed : 16|16@1-", " SG_ Speed : 0|16@1-"),
        ]);
        let rate = SteeringRate::of(&vehicle).unwrap();
        assert_eq!(rate.of_frames(&frames), [(at(8), 2.0)]);
    }

    #[test]
    fn signs_are_counted_over_zeros() {
        let values = [0, 3, 0, 2, -1, 0, -5, 4].map(f64::from);
        assert_eq!(sign_changes(values.into_iter()), 2);
        assert_eq!(sign_changes([0.0, 0.0].into_iter()), 0);
        // There and back beyond the band twice; what stays within it does not count.
        let errors = [1.0, 0.04, -0.06, -0.04, 0.04, 0.06, 0.02, -0.02, 0.01];
        assert_eq!(swings(errors.into_iter()), 2);
    }
}
