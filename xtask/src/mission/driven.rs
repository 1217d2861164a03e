//! A mission as it was driven: the path that the vehicle plans, its place on it, and what its sections did.

use std::sync::Arc;

use control::{
    dubins::Pose,
    mission::{Mission as _, MissionSettings, Piece, Planner, Purpose, Step},
    path::{Progress, Segment},
};
use mission::{curve::Chain, picture, place::Local, plan::Plan};
use serde_json::{Value, json};
use vehicle_model::Vehicle;
use world::{
    StateSample,
    report::{
        self, FrameRecord, Located, MissionRun, ModeChange, RunEnd, SectionSwitch, Stage, rounded,
    },
    time::seconds,
};

use super::Drivable;
use crate::network::{SAME_CHANGE, decode::Decoder, matrix::Matrix};

/// A vehicle so near to the end of its path is there, m.
const AT_END: f64 = 0.1;

/// Distance between two places of a way that is drawn, m.
const NEXT: f64 = 0.1;

/// Distance between the places of a bent piece, m.
const APART: f64 = 0.25;

/// Most steps of the planning for a piece.
const STEPS: usize = 100_000;

/// The time of a section that does not change within a cycle, as the images tell it, ms.
const NEVER: f64 = firmware::mission::NEVER as f64;

/// The mode of a vehicle that refuses to drive.
const FAULT: &str = "Fault";

/// The reason with which a run ends at the end of its path.
const PATH_END: &str = "PathEnd";

/// The whole path of a mission, as the vehicle plans it.
#[derive(Clone, Debug)]
pub(crate) struct Course {
    plan: Plan,
    chains: Vec<Chain>,
    /// The largest curvature that the vehicle drives, 1/m.
    limit: f64,
    segments: Vec<Segment<f64>>,
    stages: Vec<Stage>,
    /// Whether the mission ends with the last piece.
    ends: bool,
    /// From the rear axle to the point of the states, m.
    rear: f64,
}

/// What of a course a run shows.
#[derive(Clone, Debug)]
pub(crate) struct Driven {
    course: Arc<Course>,
    located: Vec<Located>,
    switches: Vec<SectionSwitch>,
    ended: Vec<RunEnd>,
}

fn wide(segment: &Segment<f32>) -> Segment<f64> {
    Segment {
        start: Pose {
            north: f64::from(segment.start.north),
            east: f64::from(segment.start.east),
            heading: f64::from(segment.start.heading),
        },
        curvature: f64::from(segment.curvature),
        sharpness: f64::from(segment.sharpness),
        length: f64::from(segment.length),
    }
}

impl Course {
    /// The path of a mission: once from the first leg to the last one, and if the mission is repeated, the way back to the
    /// first leg.
    ///
    /// # Errors
    /// A clause that says where there is no turn.
    pub(crate) fn of(
        plan: Plan,
        drivable: &Drivable,
        settings: &MissionSettings<f32>,
        vehicle: &Vehicle,
    ) -> Result<Self, String> {
        let mission = drivable.mission();
        let machine = vehicle.manifest().machine.as_ref();
        let mut course = Self {
            plan,
            chains: drivable.chains.clone(),
            limit: settings.curvature.into(),
            segments: Vec::new(),
            stages: Vec::new(),
            ends: false,
            rear: machine.map_or(0.0, |machine| machine.rear_to_antenna.get()),
        };
        let mut planner = Planner::new(*settings);
        let mut idle = 0;
        loop {
            idle += 1;
            match planner.step(&mission) {
                Step::Piece(piece) => {
                    let again = !course.stages.is_empty()
                        && piece.purpose == Purpose::Leg
                        && piece.leg == 0;
                    if again {
                        break;
                    }
                    course.add(&piece, drivable.leg_of(piece.leg));
                    idle = 0;
                }
                Step::Working if idle < STEPS => {}
                Step::Working | Step::Done => break,
                Step::NoTurn { leg, error } => {
                    return Err(format!("leg {}: {error}", drivable.leg_of(leg) + 1));
                }
            }
        }
        course.ends = mission.end() == control::mission::End::Stop;
        Ok(course)
    }

    fn add(&mut self, piece: &Piece<f32>, leg: usize) {
        let segment = wide(&piece.segment);
        let begin = self
            .stages
            .last()
            .map_or(0.0, |last| last.begin + last.length);
        let straight = segment.curvature == 0.0 && segment.sharpness == 0.0;
        let count = match straight {
            true => 1,
            false => (segment.length / APART).ceil().max(1.0) as usize,
        };
        let turned = if piece.reverse {
            std::f64::consts::PI
        } else {
            0.0
        };
        let poses = (0..=count).map(|step| {
            let pose = segment.pose(segment.length * step as f64 / count as f64);
            (pose.north, pose.east, pose.heading + turned)
        });
        self.stages.push(Stage {
            leg,
            purpose: match piece.purpose {
                Purpose::Leg => report::Purpose::Leg,
                Purpose::Turn => report::Purpose::Turn,
                Purpose::Approach => report::Purpose::Approach,
            },
            begin,
            length: segment.length,
            outputs: piece.outputs,
            reverse: piece.reverse,
            poses: poses.collect(),
        });
        self.segments.push(segment);
    }

    /// The places of its turns, each as one line.
    fn turns(&self) -> Vec<Vec<Local>> {
        let mut turns: Vec<Vec<Local>> = Vec::new();
        let mut last = None;
        for stage in &self.stages {
            let places = stage.poses.iter();
            let places = places.map(|&(north, east, _)| Local::new(north, east));
            if stage.purpose != report::Purpose::Leg {
                if last != Some(stage.leg) {
                    turns.push(Vec::new());
                }
                if let Some(turn) = turns.last_mut() {
                    turn.extend(places);
                }
                last = Some(stage.leg);
            } else {
                last = None;
            }
        }
        turns
    }

    /// What of it a run shows: where the rear axle was at each of the `states`, and what the sections did.
    pub(crate) fn driven(
        self: &Arc<Self>,
        vehicle: &Vehicle,
        states: &[StateSample],
        modes: &[ModeChange],
        frames: &[FrameRecord],
    ) -> Driven {
        Driven {
            ended: ended(vehicle, modes, frames),
            ..self.driven_with(states, modes, switches(vehicle, frames))
        }
    }

    /// The same with what the sections did, of runs whose ends nobody tells.
    pub(crate) fn driven_with(
        self: &Arc<Self>,
        states: &[StateSample],
        modes: &[ModeChange],
        switches: Vec<SectionSwitch>,
    ) -> Driven {
        Driven {
            course: Arc::clone(self),
            located: self.locate(states, modes),
            switches,
            ended: Vec::new(),
        }
    }

    /// Whether the rear axle is at the end of the path, to a decimetre.
    pub(crate) fn is_at_end(&self, state: &StateSample) -> bool {
        let (sine, cosine) = state.heading.sin_cos();
        let place = Local::new(
            state.north - self.rear * cosine,
            state.east - self.rear * sine,
        );
        let end = self.segments.last().map(Segment::end);
        end.is_some_and(|end| place.distance(Local::new(end.north, end.east)) < AT_END)
    }

    /// Where the rear axle is at each state. A run that begins again after the end of the mission begins at its beginning.
    fn locate(&self, states: &[StateSample], modes: &[ModeChange]) -> Vec<Located> {
        let mut modes = modes.iter().peekable();
        let mut driving = false;
        let mut at = Progress::start();
        let locate = |state: &StateSample| {
            while let Some(change) = modes.next_if(|change| change.at <= state.at) {
                if change.autonomous && !driving && at.finished {
                    at = Progress::start();
                }
                driving = change.autonomous;
            }
            self.located(&mut at, state, driving)
        };
        states.iter().map(locate).collect()
    }

    fn located(&self, at: &mut Progress<f64>, state: &StateSample, driving: bool) -> Located {
        let (sine, cosine) = state.heading.sin_cos();
        let (north, east) = (
            state.north - self.rear * cosine,
            state.east - self.rear * sine,
        );
        let Some(mut segment) = self.segments.get(at.segment) else {
            return Located::default();
        };
        let mut place = segment.locate(north, east, at.along);
        for _ in 0..self.segments.len() {
            // One that repeats goes on with its first piece.
            let number = match at.segment + 1 {
                number if number < self.segments.len() => number,
                _ if self.ends => break,
                _ => 0,
            };
            let Some(next) = self.segments.get(number) else {
                break;
            };
            if !driving || place.along <= self.end_of(at.segment) {
                break;
            }
            at.segment = number;
            segment = next;
            place = segment.locate(north, east, 0.0);
        }
        at.along = place.along;
        let stage = self.stages.get(at.segment);
        let last = at.segment + 1 == self.segments.len();
        at.finished |= self.ends && last && place.along > segment.length - ARRIVED;
        let turned = match stage {
            Some(stage) if stage.reverse => std::f64::consts::PI,
            _ => 0.0,
        };
        let error = state.heading + turned - place.bearing;
        let follows = driving && (at.segment > 0 || place.along >= 0.0);
        Located {
            stage: follows.then_some(at.segment),
            along: stage.map_or(0.0, |stage| stage.begin) + place.along,
            right: place.cross_track,
            heading_error: error.sin().atan2(error.cos()),
        }
    }

    /// How far along a piece the vehicle leaves it, m: a little before its end where the direction changes, because the
    /// vehicle stops there and need not pass it.
    fn end_of(&self, number: usize) -> f64 {
        let reverse = |number: usize| self.stages.get(number).map(|stage| stage.reverse);
        let length = self
            .segments
            .get(number)
            .map_or(0.0, |segment| segment.length);
        match reverse(number) == reverse(number + 1) {
            true => length,
            false => length - ARRIVED,
        }
    }
}

/// The vehicle counts as arrived at a stop this far before it, m.
const ARRIVED: f64 = 0.02;

impl Driven {
    /// What the report needs.
    pub(crate) fn run(&self) -> MissionRun<'_> {
        MissionRun {
            path: &self.course.stages,
            ends: self.course.ends,
            located: &self.located,
            switches: &self.switches,
            ended: &self.ended,
            width: self.course.plan.width,
            rear: self.course.rear,
        }
    }

    /// The way of the rear axle: time (s) and place, a place each decimetre.
    fn way(&self, states: &[StateSample]) -> Vec<(f64, Local)> {
        let mut way: Vec<(f64, Local)> = Vec::new();
        for state in states {
            let place = Local::new(
                state.north - self.course.rear * state.heading.cos(),
                state.east - self.course.rear * state.heading.sin(),
            );
            if way
                .last()
                .is_none_or(|(_, last)| last.distance(place) >= NEXT)
            {
                way.push((seconds(state.at), place));
            }
        }
        way
    }

    /// The parts of a way on which a section was on.
    fn worked(&self, way: &[(f64, Local)]) -> Vec<Vec<(f64, Local)>> {
        let mut parts = Vec::new();
        let (mut on, mut from) = (0_u32, 0.0);
        let end = way.last().map_or(0.0, |(at, _)| *at);
        let between = |from: f64, to: f64| -> Vec<(f64, Local)> {
            let inside = way.iter().filter(|(at, _)| *at > from && *at < to);
            let ends = [from, to].map(|at| place_at(way, at).map(|place| (at, place)));
            let [first, last] = ends;
            first
                .into_iter()
                .chain(inside.copied())
                .chain(last)
                .collect()
        };
        for switch in &self.switches {
            let before = on;
            let bit = 1 << switch.section;
            on = if switch.on { on | bit } else { on & !bit };
            if before == 0 && on != 0 {
                from = switch.at;
            }
            if before != 0 && on == 0 {
                parts.push(between(from, switch.at));
            }
        }
        if on != 0 {
            parts.push(between(from, end));
        }
        parts
    }

    /// The picture of the drive from above; `figures` is a line about it.
    pub(crate) fn svg(&self, states: &[StateSample], figures: &str) -> String {
        let Course {
            plan,
            chains,
            limit,
            ..
        } = &*self.course;
        let way = self.way(states);
        let places = |part: &[(f64, Local)]| part.iter().map(|(_, place)| *place).collect();
        let worked: Vec<Vec<Local>> = self.worked(&way).iter().map(|part| places(part)).collect();
        let turns = self.course.turns();
        let way: Vec<Local> = places(&way);
        let options = picture::Options {
            chains,
            limit: Some(*limit),
            width: plan.width,
            field: None,
            turns: &turns,
            driven: Some(picture::Driven {
                way: &way,
                worked: &worked,
                figures,
            }),
        };
        picture::svg(plan, &options)
    }

    /// What the page of a run draws of it: fence, path, and what was worked with the time of each place.
    pub(crate) fn json(&self, states: &[StateSample]) -> Value {
        let pair = |place: &Local| json!([rounded(place.north, 2), rounded(place.east, 2)]);
        let stages = self.course.stages.iter();
        let path = stages.map(|stage| {
            let places = stage.poses.iter();
            let places = places.map(|&(north, east, _)| pair(&Local::new(north, east)));
            places.collect::<Vec<_>>()
        });
        let worked = self.worked(&self.way(states)).into_iter().map(|part| {
            let places = part.iter().map(|(at, place)| {
                json!([
                    rounded(place.north, 2),
                    rounded(place.east, 2),
                    rounded(*at, 2)
                ])
            });
            places.collect::<Vec<_>>()
        });
        json!({
            "fence": self.course.plan.fence.iter().map(pair).collect::<Vec<_>>(),
            "path": path.collect::<Vec<_>>(),
            "width": self.course.plan.width,
            "worked": worked.collect::<Vec<_>>(),
        })
    }
}

/// The place at a time (s) on a way.
fn place_at(way: &[(f64, Local)], at: f64) -> Option<Local> {
    let next = way.partition_point(|(time, _)| *time <= at);
    let &(from, first) = way.get(next.saturating_sub(1))?;
    let Some(&(to, second)) = way.get(next) else {
        return Some(first);
    };
    let share = ((at - from) / (to - from).max(1e-9)).clamp(0.0, 1.0);
    Some(first.between(second, share))
}

/// What is told of the sections of a cycle: for each whether it is on at its beginning, and after how many seconds of it
/// it changes.
pub(crate) type Switches = [(bool, Option<f64>); 8];

/// What a node at the sections makes of what it is told. `cycles` are the beginnings of basic cycles (s), each with what was
/// told of it. After a cycle without the message the sections keep their state; after a second one in a row they are off.
pub(crate) fn played(cycles: impl Iterator<Item = (f64, Option<Switches>)>) -> Vec<SectionSwitch> {
    let mut all = Vec::new();
    let mut state = [false; 8];
    let mut silent = 0;
    for (begin, told) in cycles {
        silent = if told.is_some() { 0 } else { silent + 1 };
        let kept = state.map(|on| (on && silent < 2, None));
        let mut changes: Vec<SectionSwitch> = Vec::new();
        let now = told.unwrap_or(kept).into_iter().zip(&mut state);
        for (section, ((on, after), state)) in (1..).zip(now) {
            let mut change = |at, on| changes.push(SectionSwitch { at, section, on });
            if *state != on {
                change(begin, on);
            }
            *state = on ^ after.is_some();
            if let Some(after) = after {
                change(begin + after, !on);
            }
        }
        changes.sort_by(|one, other| one.at.total_cmp(&other.at));
        all.append(&mut changes);
    }
    all
}

/// What the sections do by the messages on the bus.
fn switches(vehicle: &Vehicle, frames: &[FrameRecord]) -> Vec<SectionSwitch> {
    let decoder = Decoder::new(vehicle.network());
    let missions = vehicle.manifest().missions();
    let Some(known) = missions.and_then(|mission| decoder.named(&mission.sections)) else {
        return Vec::new();
    };
    let value = |name: String, data: &[u8; 8]| known.field(&name).map(|field| field.value(data));
    let told = |data: &[u8; 8]| -> Switches {
        core::array::from_fn(|index| {
            let section = index + 1;
            let after = value(format!("After{section}"), data);
            (
                value(format!("State{section}"), data).is_some_and(|on| on != 0.0),
                after
                    .filter(|after| *after < NEVER)
                    .map(|after| after * 1e-3),
            )
        })
    };
    let matrix = Matrix::new(vehicle);
    let is_reference = |frame: &FrameRecord| {
        let mut windows = matrix.windows.iter();
        windows.any(|one| one.kind == report::WindowKind::Reference && one.id == frame.id)
    };
    let mut last = None;
    let frames = frames.iter().filter(|frame| frame.is_message());
    let cycles = frames.filter_map(|frame| {
        if frame.id == known.id {
            last = Some(told(&frame.data));
        }
        is_reference(frame).then(|| (seconds(frame.start), last.take()))
    });
    played(cycles)
}

/// How the autonomous runs ended, with the reasons that the vehicle's events of the modes tell.
fn ended(vehicle: &Vehicle, modes: &[ModeChange], frames: &[FrameRecord]) -> Vec<RunEnd> {
    let matrix = Matrix::new(vehicle);
    let events: Vec<(f64, String, String)> = frames
        .iter()
        .filter(|frame| frame.is_message())
        .filter_map(|frame| {
            matrix.named(frame, "Previous")?;
            let told = |signal| matrix.named(frame, signal);
            Some((seconds(frame.end), told("Mode")?, told("Reason")?))
        })
        .collect();
    ends(modes, &events)
}

/// The same from the events: time (s), mode and reason.
fn ends(modes: &[ModeChange], events: &[(f64, String, String)]) -> Vec<RunEnd> {
    // The run that the operator wanted may not have begun at all.
    if !modes.iter().any(|change| change.autonomous) {
        let refused = events.iter().rev().find(|(_, mode, _)| mode == FAULT);
        let end = refused.map(|(at, mode, reason)| RunEnd {
            at_seconds: rounded(*at, 3),
            mode: mode.clone(),
            reason: Some(reason.clone()),
            arrived: false,
        });
        return end.into_iter().collect();
    }
    let pairs = modes.iter().zip(modes.iter().skip(1));
    let ends = pairs.filter(|(before, after)| before.autonomous && !after.autonomous);
    let end = ends.map(|(_, after)| {
        let at = seconds(after.at);
        let apart = |told: &f64| (told - at).abs();
        let reason = events
            .iter()
            .filter(|(told, mode, _)| *mode == after.mode && apart(told) <= SAME_CHANGE)
            .min_by(|one, other| apart(&one.0).total_cmp(&apart(&other.0)))
            .map(|(.., reason)| reason.clone());
        RunEnd {
            at_seconds: rounded(at, 3),
            mode: after.mode.clone(),
            arrived: reason.as_ref().is_none_or(|reason| reason == PATH_END),
            reason,
        }
    });
    end.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_that_does_not_begin_ends_with_its_fault() {
        let event = |at, mode: &str, reason: &str| (at, mode.to_owned(), reason.to_owned());
        let events = [
            event(1.0, "Idle", "None"),
            event(30.0, "Fault", "FarOff"),
            event(31.0, "Idle", "None"),
        ];
        let ended = ends(&[], &events);
        let [end] = &ended[..] else {
            panic!("{ended:?}");
        };
        assert_eq!(
            (end.mode.as_str(), end.reason.as_deref()),
            ("Fault", Some("FarOff"))
        );
        assert!(ends(&[], &events[..1]).is_empty());
    }

    #[test]
    fn a_section_changes_within_its_cycle_and_is_off_when_nobody_tells_of_it() {
        let mut first: Switches = [(false, None); 8];
        first[0] = (false, Some(0.04));
        first[7] = (true, None);
        let mut second = first;
        second[0] = (true, None);
        let cycles = [
            (0.0, None),
            (0.1, Some(first)),
            (0.2, Some(second)),
            (0.3, None),
            (0.4, None),
            (0.5, None),
        ];
        let all = played(cycles.into_iter());
        let seen: Vec<_> = all
            .iter()
            .map(|one| (one.at, one.section, one.on))
            .collect();
        assert_eq!(
            seen,
            [
                (0.1, 8, true),
                (0.14, 1, true),
                (0.4, 1, false),
                (0.4, 8, false)
            ]
        );
    }
}
