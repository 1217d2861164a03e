//! What the view shows: gathered step by step, and read from the vehicle when it is drawn.

use std::time::Duration;

use can_bus::RecordKind;
use twin::Twin;
use vehicle_model::Vehicle;
use world::report::{LastCycle, Run, last_cycle};
use world::time::seconds;
use world::{Scenario, SimDuration, SimTime};

use super::super::bus::Log;
use super::super::recording::{
    NodeRecording,
    happened::{Event, Happened, NodeHistory},
};
use crate::monitor::{Picture, Watch};

/// What is simulated.
pub(crate) struct Subject {
    pub(super) vehicle: String,
    pub(super) scenario: Scenario,
    pub(super) seed: u64,
    pub(super) end: SimTime,
    watch: Watch,
    names: Vec<String>,
}

impl Subject {
    /// A run of a scenario up to `end`.
    pub(crate) fn new(vehicle: &Vehicle, scenario: &Scenario, seed: u64, end: SimTime) -> Self {
        Self {
            vehicle: vehicle.name().to_owned(),
            scenario: scenario.clone(),
            seed,
            end,
            watch: Watch::new(vehicle),
            names: crate::vehicle::node_names(vehicle),
        }
    }
}

/// The run so far.
pub(super) struct Scene {
    pub(super) subject: Subject,
    /// Records of the bus that have been taken.
    taken: usize,
    /// Simulated seconds in a second: wanted (`None` as fast as it can), and measured.
    pub(super) wanted: Option<f64>,
    pub(super) speed: Option<f64>,
    pub(super) paused: bool,
    pub(super) help: bool,
}

/// A point of the way of a vehicle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    /// s.
    pub(super) at: f64,
    /// Along the line or the row, m.
    pub(super) along: f64,
    /// Right of it, m.
    pub(super) right: f64,
    /// Direction against it, rad, positive to the right.
    pub(super) heading: f64,
    /// m/s.
    pub(super) speed: f64,
}

/// The way of a vehicle along a line or a row.
pub(super) struct Course {
    /// What it follows, and what its distance from that is called.
    pub(super) what: &'static str,
    pub(super) error: &'static str,
    /// Where the line begins and ends, m along; a row has no end.
    pub(super) line: Option<(f64, f64)>,
    pub(super) points: Vec<Point>,
    /// What distance sensors measured last on the left and right, m.
    pub(super) distances: Option<[Option<f64>; 2]>,
}

/// Most points of a way that are drawn; a terminal has fewer.
const MOST_POINTS: usize = 1500;

/// Every n-th of the samples, and the last one, so that there are [`MOST_POINTS`] at most.
fn thinned<S>(samples: &[S], point: impl Fn(&S) -> Point) -> Vec<Point> {
    let every = samples.len().div_ceil(MOST_POINTS).max(1);
    let mut points: Vec<Point> = samples.iter().step_by(every).map(&point).collect();
    points.extend(samples.last().map(point));
    points
}

impl Scene {
    pub(super) fn new(subject: Subject) -> Self {
        Self {
            subject,
            taken: 0,
            wanted: Some(1.0),
            speed: None,
            paused: false,
            help: false,
        }
    }

    pub(super) fn show_pace(&mut self, wanted: Option<f64>, paused: bool) {
        self.wanted = wanted;
        self.paused = paused;
    }

    /// Takes the frames since the last call.
    pub(super) fn take(&mut self, twin: &Twin) {
        let records = twin.records();
        for record in records.get(self.taken..).unwrap_or_default() {
            if let RecordKind::FrameEnd { frame, .. } = record.kind {
                self.subject.watch.take(wall(record.at), &frame);
            }
        }
        self.taken = records.len();
    }

    /// Nodes, messages, mode and load at present.
    pub(super) fn picture(&self, twin: &Twin) -> Picture {
        self.subject.watch.picture(wall(twin.now()))
    }

    /// The last basic cycle that is over, and how many error frames there were in the last three.
    pub(super) fn cycle(&self, twin: &Twin) -> (Option<LastCycle>, usize) {
        let matrix = self.subject.watch.matrix();
        let now = twin.now();
        let span = matrix.basic_cycle() * 3;
        let from = SimTime::from_ticks(now.as_ticks().saturating_sub(span.as_ticks()));
        let records = twin.records();
        let first = records.partition_point(|record| record.at < from);
        let log = Log::new(records.get(first..).unwrap_or_default(), matrix.bit_time());
        let run = Run {
            scenario: &self.subject.scenario,
            nodes: &self.subject.names,
            seed: self.subject.seed,
            duration: SimDuration::from_ticks(now.as_ticks()),
            states: &[],
            efforts: &[],
            frames: &log.frames,
            windows: &matrix.windows,
            cycle_count_byte: matrix.cycle_count_byte(),
            basic_cycle: matrix.basic_cycle(),
            bit_time: matrix.bit_time(),
            modes: &[],
            tasks: &[],
            rover: None,
            crop: None,
            mission: None,
        };
        let came = |window: &world::report::Window| self.subject.watch.has_come(window.id);
        (last_cycle(&run, &came), log.errors.len())
    }

    /// The windows that [`Scene::cycle`] counts.
    pub(super) fn windows(&self) -> &[world::report::Window] {
        &self.subject.watch.matrix().windows
    }

    /// What has happened so far.
    pub(super) fn events(&self, twin: &Twin, nodes: &[NodeRecording]) -> Vec<Event> {
        let histories = self.subject.names.iter().zip(twin.nodes()).zip(nodes);
        let happened = Happened {
            scenario: &self.subject.scenario,
            until: twin.now(),
            modes: self.subject.watch.modes(),
            gates: twin.gates(),
            nodes: histories
                .map(|((name, node), recording)| NodeHistory {
                    name,
                    resets: twin.node(node).resets(),
                    log: &recording.log,
                })
                .collect(),
        };
        happened.events()
    }

    /// The way of the vehicle, if it has one.
    pub(super) fn course(&self, twin: &Twin) -> Option<Course> {
        if let Some(drive) = twin.world().drive() {
            let samples = drive.samples();
            return Some(Course {
                what: "row",
                error: "offset",
                line: None,
                points: thinned(samples, |sample| Point {
                    at: seconds(sample.at),
                    along: sample.station,
                    right: sample.right,
                    heading: sample.heading,
                    speed: sample.state.speed,
                }),
                distances: samples.last().map(|last| last.distances),
            });
        }
        let line = self.subject.scenario.line.as_ref()?;
        twin.world().machine()?;
        let direction = line.direction();
        Some(Course {
            what: "line",
            error: "cross-track error",
            line: Some((0.0, line.length())),
            points: thinned(twin.world().states(), |state| {
                let (along, right) = line.locate(state.north, state.east);
                Point {
                    at: seconds(state.at),
                    along,
                    right,
                    heading: world::vehicle::wrap(state.heading - direction),
                    speed: state.speed,
                }
            }),
            distances: None,
        })
    }
}

/// The same time in the unit of the monitor.
fn wall(at: SimTime) -> Duration {
    Duration::from_nanos(at.as_ticks() / 1000)
}
