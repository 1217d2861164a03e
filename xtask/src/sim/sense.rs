//! What makes a run questionable, although each of its figures is right.

use vehicle_model::Vehicle;
use world::{
    report::{Due, Run, Summary, WindowKind},
    time,
};

use crate::network::matrix::Matrix;

/// A motor that had an effort for so long must have moved the vehicle, s.
const DRIVEN: f64 = 3.0;
/// A vehicle that went less than this did not move, m.
const MOVED: f64 = 0.1;
/// Two lines whose ends differ by more than this are not the same, m.
const SAME: f64 = 1e-3;
/// The signal in which nodes tell their faults, and its value without one.
const FAULT: (&str, &str) = ("Fault", "None");

/// The sentences about a run.
pub(super) fn notes(
    vehicle: &Vehicle,
    matrix: &Matrix,
    run: &Run,
    summary: &Summary,
) -> Vec<String> {
    let mut notes = Vec::new();
    notes.extend(other_line(vehicle, run));
    notes.extend(never_sent(run, summary));
    notes.extend(unmoved(run, summary));
    let idle = super::idle_motor(vehicle, run, summary);
    notes.extend(idle.map(|node| super::Error::IdleMotor { node: node.into() }.to_string()));
    notes.extend(faults(matrix, run));
    notes
}

/// The errors are those from a line that the images do not follow.
fn other_line(vehicle: &Vehicle, run: &Run) -> Option<String> {
    if run.mission.is_some() {
        return None;
    }
    let line = run.scenario.line?;
    let waypoints = &vehicle.manifest().waypoints;
    let (from, to) = waypoints.first().zip(waypoints.last())?;
    let ends = [
        (line.from.north, from.north),
        (line.from.east, from.east),
        (line.to.north, to.north),
        (line.to.east, to.east),
    ];
    let differs = ends.iter().any(|(a, b)| (a.get() - b.get()).abs() > SAME);
    differs.then(|| {
        format!(
            "[line] of the scenario is not the line that the images follow, from {}, {} to {}, {} (north, east): the \
             cross-track errors are those from [line]",
            from.north, from.east, to.north, to.east
        )
    })
}

/// Messages that no frame carried although they are due in each of their cycles.
fn never_sent(run: &Run, summary: &Summary) -> Vec<String> {
    if summary.bus.basic_cycles == 0 {
        return Vec::new();
    }
    let due = run.windows.iter().filter(|window| {
        let due = matches!(window.due, Due::Always | Due::OneOf(_));
        window.kind == WindowKind::Exclusive && due
    });
    let silent = due.filter(|window| {
        !summary
            .bus
            .frames_per_id
            .iter()
            .any(|seen| seen.id == window.id)
    });
    let sentence = |window: &world::report::Window| {
        format!(
            "{} never sent {} ({}) in {} basic cycles, which counts as no missed window",
            window.sender, window.message, window.id, summary.bus.basic_cycles
        )
    };
    silent.map(sentence).collect()
}

/// The drive motor had an effort, and the vehicle stood.
fn unmoved(run: &Run, summary: &Summary) -> Option<String> {
    let mut driven = 0.0;
    for pair in run.states.windows(2) {
        if pair[0].drive_effort != 0.0 {
            driven += time::seconds(pair[1].at) - time::seconds(pair[0].at);
        }
    }
    let way = summary.distance_m?;
    (driven >= DRIVEN && way < MOVED).then(|| {
        format!("the drive motor had an effort for {driven:.1} s, and the vehicle went {way:.2} m")
    })
}

/// The first fault of each kind that a node tells.
fn faults(matrix: &Matrix, run: &Run) -> Vec<String> {
    let mut told: Vec<(u16, String)> = Vec::new();
    let mut sentences = Vec::new();
    for frame in run.frames.iter().filter(|frame| frame.is_message()) {
        let Some(fault) = matrix
            .named(frame, FAULT.0)
            .filter(|fault| fault != FAULT.1)
        else {
            continue;
        };
        if told
            .iter()
            .any(|known| known.0 == frame.id && known.1 == fault)
        {
            continue;
        }
        let sender = run.windows.iter().find(|window| window.id == frame.id);
        sentences.push(format!(
            "{} tells the fault {fault} at {:.3} s",
            sender.map_or("a node", |window| window.sender.as_str()),
            time::seconds(frame.start)
        ));
        told.push((frame.id, fault));
    }
    sentences
}
