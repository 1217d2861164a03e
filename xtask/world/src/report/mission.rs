//! How a mission was driven: against its own path, section by section, and what of the ground was worked.

use serde::{Deserialize, Serialize};

use super::cover::{Areas, Ground, Spot};
use super::figures::rounded;
use super::guidance::autonomous_spans;
use super::{Cell, Column, Run};
use crate::record::StateSample;
use crate::time::seconds;

/// A vehicle that is slower than this stands, m/s.
const STANDS: f64 = 0.01;

/// A vehicle that stands for so long has stopped, s.
const STOPPED: f64 = 0.5;

/// How near to a change of its direction of travel a vehicle may stand, m.
const REVERSES: f64 = 0.3;

/// How near to the end of its path a vehicle has arrived, m.
const ARRIVED: f64 = 0.05;

/// How far from the end of a swath a change of a section still belongs to it, m.
const NEAR: f64 = 5.0;

/// Length of the pieces in which the ground is worked, m.
const STEP: f64 = 0.05;

/// What a piece of a path is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// A leg of the mission.
    Leg,
    /// The turn behind a leg.
    Turn,
    /// The way to a leg.
    Approach,
}

impl Purpose {
    fn word(self) -> &'static str {
        match self {
            Self::Leg => "leg",
            Self::Turn => "turn",
            Self::Approach => "approach",
        }
    }
}

/// A piece of a mission's path.
#[derive(Clone, Debug, PartialEq)]
pub struct Stage {
    /// The leg that it is of, behind which it is a turn, or to which it leads; counted from zero.
    pub leg: usize,
    /// What it is for.
    pub purpose: Purpose,
    /// Way along the path to its beginning, m.
    pub begin: f64,
    /// Length, m.
    pub length: f64,
    /// Sections of the implement that work on it, one in each bit.
    pub outputs: u8,
    /// Whether it is driven backwards.
    pub reverse: bool,
    /// Places along it, no more than a quarter of a metre apart where it bends: north and east, m, and the vehicle's
    /// heading, rad.
    pub poses: Vec<(f64, f64, f64)>,
}

/// Where the rear axle was against the path, at one state of the vehicle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Located {
    /// The number of the piece; `None` while the vehicle does not follow the path, as before its beginning.
    pub stage: Option<usize>,
    /// Way along the path, m.
    pub along: f64,
    /// Distance to the right of it as seen in the direction of travel, m.
    pub right: f64,
    /// Direction of travel against that of the path, rad.
    pub heading_error: f64,
}

/// A section of the implement is switched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SectionSwitch {
    /// When, s.
    pub at: f64,
    /// Which, 1 to 8.
    pub section: u8,
    /// Whether on or off.
    pub on: bool,
}

/// How an autonomous run ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunEnd {
    /// When.
    pub at_seconds: f64,
    /// The mode that followed.
    pub mode: String,
    /// Why, as the vehicle tells it; `null` if it does not.
    pub reason: Option<String>,
    /// Whether it ended because the vehicle had come to the end of its path, as far as it tells why.
    pub arrived: bool,
}

/// What is known of a mission in a run.
#[derive(Clone, Copy, Debug)]
pub struct MissionRun<'a> {
    /// Its path.
    pub path: &'a [Stage],
    /// Whether its path ends with the last piece, and does not begin again.
    pub ends: bool,
    /// For each state of the run, where the rear axle was.
    pub located: &'a [Located],
    /// What the implement did, in order of time.
    pub switches: &'a [SectionSwitch],
    /// How the autonomous runs ended that did, in order of time.
    pub ended: &'a [RunEnd],
    /// Width of the implement, m, if it is known. The sections that the mission uses share it from left to right.
    pub width: Option<f64>,
    /// From the rear axle to the point of the states, m.
    pub rear: f64,
}

impl MissionRun<'_> {
    /// Length of its path, m.
    pub(super) fn length(&self) -> f64 {
        self.path
            .last()
            .map_or(0.0, |last| last.begin + last.length)
    }
}

/// How a mission was driven. Errors are those of the rear axle against the path, while the vehicle moves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MissionFigures {
    /// Whether the vehicle came to its end.
    pub finished: bool,
    /// Whether the vehicle still drove it when the time of the run was over.
    #[serde(default)]
    pub cut: bool,
    /// How often it was driven from its first leg to its last one and back, if it repeats; `null` if it does not.
    #[serde(default)]
    pub rounds: Option<usize>,
    /// Length of its path, once through.
    #[serde(default)]
    pub path_m: f64,
    /// What ended the last run before that; `null` if nothing did.
    pub ended: Option<RunEnd>,
    /// From the first motion on the path to its end or the run's.
    pub time_seconds: f64,
    /// Way along the path.
    pub way_m: f64,
    /// How often the vehicle stood on the way, other than where it changes its direction, and how many runs something else
    /// ended than the end of the mission.
    pub stops: usize,
    /// Mean size of the cross-track error on legs.
    pub mean_cm: Option<f64>,
    /// Standard deviation of it, of all legs together.
    pub deviation_cm: Option<f64>,
    /// Largest on legs.
    pub largest_cm: Option<f64>,
    /// Largest in turns.
    pub turns_largest_cm: Option<f64>,
    /// Largest distance of a section's switch from the end of its swath.
    pub switched_within_cm: Option<f64>,
    /// Ends of swaths at which a section was not switched, and switches anywhere else.
    pub wrong_switches: usize,
    /// What was worked; `null` if the width of the implement is unknown.
    pub coverage: Option<CoverageFigures>,
    /// One entry for each leg driven.
    pub legs: Vec<LegFigures>,
    /// One entry for each turn driven.
    pub turns: Vec<TurnFigures>,
}

/// What an implement worked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CoverageFigures {
    /// Area of the swaths: all that should be worked.
    pub swaths_m2: f64,
    /// Share of it that was worked.
    pub worked_percent: f64,
    /// Area that was worked by two passes, as a share of the swaths'.
    pub twice_percent: f64,
    /// Area that was worked beside the swaths.
    pub outside_m2: f64,
}

/// How a leg was driven.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LegFigures {
    /// The leg, counted from 1.
    pub leg: usize,
    /// When it began.
    pub from_seconds: f64,
    /// Mean speed.
    pub mean_speed_m_s: f64,
    /// Mean size of the cross-track error.
    pub mean_cm: f64,
    /// Standard deviation of it.
    pub deviation_cm: f64,
    /// Largest.
    pub largest_cm: f64,
    /// The sections that work on it.
    pub sections: Vec<SectionFigures>,
}

/// Where a section was switched at a leg's ends, positive behind the end in the direction of travel. `null` if it was
/// not, or if it works on the neighbouring leg, too.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SectionFigures {
    /// The section, 1 to 8.
    pub section: u8,
    /// Behind the leg's beginning.
    pub on_cm: Option<f64>,
    /// Behind its end.
    pub off_cm: Option<f64>,
}

/// How a turn was driven.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TurnFigures {
    /// The leg before it, counted from 1.
    pub after_leg: usize,
    /// Largest cross-track error.
    pub largest_cm: f64,
}

fn cm(metres: f64) -> f64 {
    rounded(metres * 100.0, 3)
}

/// Sums of cross-track errors.
#[derive(Clone, Copy, Default)]
struct Errors {
    count: f64,
    sum: f64,
    sizes: f64,
    squares: f64,
    largest: f64,
}

impl Errors {
    fn of(errors: impl Iterator<Item = f64>) -> Self {
        errors.fold(Self::default(), |mut all, error| {
            all.count += 1.0;
            all.sum += error;
            all.sizes += error.abs();
            all.squares += error * error;
            all.largest = all.largest.max(error.abs());
            all
        })
    }

    fn mean_cm(&self) -> f64 {
        cm(self.sizes / self.count)
    }

    fn deviation_cm(&self) -> f64 {
        let mean = self.sum / self.count;
        cm(libm::sqrt(
            (self.squares / self.count - mean * mean).max(0.0),
        ))
    }

    fn figure(&self, value: fn(&Self) -> f64) -> Option<f64> {
        (self.count > 0.0).then(|| value(self))
    }
}

/// An end of a swath at which a section should be switched.
struct Border {
    along: f64,
    section: u8,
    on: bool,
    /// The piece that begins there; for the end of the path the number of pieces.
    stage: usize,
    /// How far behind the border it was switched, m.
    behind: Option<f64>,
}

/// A run of a mission, ready to be judged.
struct Drive<'a> {
    run: &'a Run<'a>,
    mission: &'a MissionRun<'a>,
}

impl MissionFigures {
    /// The figures in a line.
    #[must_use]
    pub fn line(&self) -> String {
        let cm =
            |name: &str, value: Option<f64>| value.map(|value| format!("{name} {value:.2} cm"));
        let coverage = self.coverage.as_ref();
        let worked = coverage.map(|all| format!("{:.2} % worked", all.worked_percent));
        let parts = [
            cm("legs: mean", self.mean_cm),
            cm("deviation", self.deviation_cm),
            cm("largest", self.largest_cm),
            cm("turns: largest", self.turns_largest_cm),
            cm("sections within", self.switched_within_cm),
            worked,
        ];
        let parts: Vec<String> = parts.into_iter().flatten().collect();
        match parts.as_slice() {
            [] => "nothing driven".into(),
            parts => parts.join(", "),
        }
    }

    /// The figures of a run.
    #[must_use]
    pub fn of(run: &Run, mission: &MissionRun) -> Self {
        Drive { run, mission }.figures()
    }
}

impl<'a> Drive<'a> {
    /// The states on the path with their places, while the vehicle drives by itself.
    fn followed(
        &self,
    ) -> impl Iterator<Item = (&'a StateSample, &'a Located, &'a Stage)> + use<'a> {
        let path = self.mission.path;
        let both = self.run.states.iter().zip(self.mission.located);
        both.filter_map(move |(state, located)| Some((state, located, path.get(located.stage?)?)))
    }

    /// The same while it moves.
    fn moving(&self) -> impl Iterator<Item = (&'a StateSample, &'a Located, &'a Stage)> + use<'a> {
        self.followed()
            .filter(|(state, ..)| state.speed.abs() >= STANDS)
    }

    fn figures(&self) -> MissionFigures {
        let on = |purpose: Purpose| {
            let of = self
                .moving()
                .filter(move |(_, _, stage)| stage.purpose == purpose);
            Errors::of(of.map(|(_, located, _)| located.right))
        };
        let (legs, turns) = (on(Purpose::Leg), on(Purpose::Turn));
        let end = self.mission.length();
        let reached = self.followed().map(|(_, located, _)| located.along);
        let reached = reached.fold(0.0, f64::max);
        let ended = self.mission.ended;
        let goes_on = autonomous_spans(self.run).len() > ended.len();
        let finished = self.mission.ends
            && reached >= end - ARRIVED
            // A vehicle that is stopped beside its path, or beyond it, has not come to its end.
            && (ended.is_empty() || goes_on || ended.iter().any(|run| run.arrived));
        let first = self.moving().next().map(|(state, ..)| seconds(state.at));
        let arrived = self.moving().last().map(|(state, ..)| seconds(state.at));
        let (borders, extra) = self.borders(reached);
        let passed = |border: &&Border| finished || border.along < reached - NEAR;
        let missed = borders
            .iter()
            .filter(passed)
            .filter(|border| border.behind.is_none());
        let switched = borders.iter().filter_map(|border| border.behind);
        MissionFigures {
            finished,
            cut: goes_on && !finished,
            rounds: self.rounds(),
            path_m: rounded(end, 3),
            ended: ended.last().filter(|_| !finished && !goes_on).cloned(),
            time_seconds: rounded(arrived.zip(first).map_or(0.0, |(to, from)| to - from), 3),
            way_m: rounded(self.way(reached), 3),
            stops: self.stops(self.mission.ends.then_some(end)),
            mean_cm: legs.figure(Errors::mean_cm),
            deviation_cm: legs.figure(Errors::deviation_cm),
            largest_cm: legs.figure(|all| cm(all.largest)),
            turns_largest_cm: turns.figure(|all| cm(all.largest)),
            switched_within_cm: switched.map(f64::abs).reduce(f64::max).map(cm),
            wrong_switches: missed.count() + extra,
            coverage: self.mission.width.map(|width| self.coverage(width)),
            legs: self.legs(&borders),
            turns: self.turns(),
        }
    }

    /// Way along the path, m, with all of its rounds.
    fn way(&self, reached: f64) -> f64 {
        match self.rounds() {
            Some(rounds @ 1..) => {
                let last = self.followed().last();
                let along = last.map_or(0.0, |(_, located, _)| located.along);
                rounds as f64 * self.mission.length() + along
            }
            _ => reached,
        }
    }

    /// How often the path was driven to its end, of one that begins again.
    fn rounds(&self) -> Option<usize> {
        if self.mission.ends {
            return None;
        }
        // Where the path begins again, the way along it falls back by more than half of it.
        let half = self.mission.length() * 0.5;
        let mut before = None;
        let mut rounds = 0;
        for (_, located, _) in self.followed() {
            rounds += usize::from(before.is_some_and(|before| located.along < before - half));
            before = Some(located.along);
        }
        Some(rounds)
    }

    /// How often the vehicle stood on its way.
    fn stops(&self, end: Option<f64>) -> usize {
        let mut stood: Option<f64> = None;
        let (mut stops, mut counted, mut moved) = (0, false, false);
        for (state, located, stage) in self.followed() {
            if state.speed.abs() >= STANDS {
                (stood, counted, moved) = (None, false, true);
                continue;
            }
            let since = *stood.get_or_insert(seconds(state.at));
            let long = seconds(state.at) - since >= STOPPED;
            let at_end = end.is_some_and(|end| located.along >= end - ARRIVED);
            if long && moved && !counted && !at_end && !self.reverses(located, stage) {
                stops += 1;
                counted = true;
            }
        }
        // Runs that end before their mission.
        let ended = self.mission.ended.iter();
        stops + ended.filter(|run| !run.arrived).count()
    }

    /// Whether the direction of travel changes near a place.
    fn reverses(&self, located: &Located, stage: &Stage) -> bool {
        let path = self.mission.path.iter();
        let near = path.filter(|other| {
            let (from, to) = (
                other.begin - REVERSES,
                other.begin + other.length + REVERSES,
            );
            (from..=to).contains(&located.along)
        });
        near.into_iter().any(|other| other.reverse != stage.reverse)
    }

    /// The ends of swaths, each with its switch, and how many switches are at none of them.
    fn borders(&self, reached: f64) -> (Vec<Border>, usize) {
        let path = self.mission.path;
        let mut borders = Vec::new();
        let mut before = 0;
        let begins = path.iter().map(|stage| (stage.begin, stage.outputs));
        let end = self.mission.ends.then(|| (self.mission.length(), 0));
        for (stage, (along, outputs)) in begins.chain(end).enumerate() {
            for section in (1..=8).filter(|section| (before ^ outputs) >> (section - 1) & 1 != 0) {
                borders.push(Border {
                    along,
                    section,
                    on: outputs >> (section - 1) & 1 != 0,
                    stage,
                    behind: None,
                });
            }
            before = outputs;
        }
        borders.retain(|border| border.along <= reached + NEAR);
        let mut extra = 0;
        for switch in self.mission.switches {
            let Some(along) = self.along(switch.at) else {
                continue;
            };
            let fits = |border: &&mut Border| {
                border.section == switch.section
                    && border.on == switch.on
                    // Each round has it once more.
                    && (border.behind.is_none() || !self.mission.ends)
                    && (border.along - along).abs() <= NEAR
            };
            let nearest = borders.iter_mut().filter(fits).min_by(|one, other| {
                let far = |border: &Border| (border.along - along).abs();
                far(one).total_cmp(&far(other))
            });
            match nearest {
                Some(border) => {
                    let behind = along - border.along;
                    let worse = border
                        .behind
                        .is_none_or(|before| behind.abs() > before.abs());
                    if worse {
                        border.behind = Some(behind);
                    }
                }
                None => extra += 1,
            }
        }
        (borders, extra)
    }

    /// Way along the path at a time (s); `None` before the first state and behind the last one.
    fn along(&self, at: f64) -> Option<f64> {
        let next = self
            .run
            .states
            .partition_point(|state| seconds(state.at) <= at);
        let before = next.checked_sub(1)?;
        let of = |index: usize| {
            let state = self.run.states.get(index)?;
            Some((seconds(state.at), self.mission.located.get(index)?.along))
        };
        let ((from, first), (to, second)) = (of(before)?, of(next)?);
        Some(first + (second - first) * (at - from) / (to - from))
    }

    /// Consecutive states on the same leg, or in the same turn.
    fn groups(&self, purpose: Purpose) -> Vec<Vec<(&'a StateSample, &'a Located, usize)>> {
        let mut groups: Vec<Vec<_>> = Vec::new();
        let mut last = None;
        for (state, located, stage) in self.moving() {
            let number = located.stage.unwrap_or_default();
            let key = (stage.purpose, stage.leg);
            if stage.purpose == purpose {
                if last != Some(key) {
                    groups.push(Vec::new());
                }
                if let Some(group) = groups.last_mut() {
                    group.push((state, located, number));
                }
            }
            last = Some(key);
        }
        groups
    }

    fn legs(&self, borders: &[Border]) -> Vec<LegFigures> {
        let path = self.mission.path;
        let figures = |group: Vec<(&StateSample, &Located, usize)>| {
            let (state, _, first) = *group.first()?;
            let (.., last) = *group.last()?;
            let errors = Errors::of(group.iter().map(|(_, located, _)| located.right));
            let speeds = group.iter().map(|(state, ..)| state.speed.abs());
            let outputs = path
                .get(first..=last)?
                .iter()
                .fold(0, |all, one| all | one.outputs);
            let of = |section: u8, on: bool| {
                let places = if on {
                    first..=last
                } else {
                    first + 1..=last + 1
                };
                let fits = |border: &&Border| {
                    border.section == section && border.on == on && places.contains(&border.stage)
                };
                borders.iter().find(fits)?.behind.map(cm)
            };
            let sections = (1..=8).filter(|section| outputs >> (section - 1) & 1 != 0);
            Some(LegFigures {
                leg: path.get(first)?.leg + 1,
                from_seconds: rounded(seconds(state.at), 3),
                mean_speed_m_s: rounded(speeds.sum::<f64>() / errors.count, 4),
                mean_cm: errors.mean_cm(),
                deviation_cm: errors.deviation_cm(),
                largest_cm: cm(errors.largest),
                sections: sections
                    .map(|section| SectionFigures {
                        section,
                        on_cm: of(section, true),
                        off_cm: of(section, false),
                    })
                    .collect(),
            })
        };
        let groups = self.groups(Purpose::Leg);
        groups.into_iter().filter_map(figures).collect()
    }

    fn turns(&self) -> Vec<TurnFigures> {
        let figures = |group: Vec<(&StateSample, &Located, usize)>| {
            let (.., first) = *group.first()?;
            let errors = Errors::of(group.iter().map(|(_, located, _)| located.right));
            Some(TurnFigures {
                after_leg: self.mission.path.get(first)?.leg + 1,
                largest_cm: cm(errors.largest),
            })
        };
        let groups = self.groups(Purpose::Turn);
        groups.into_iter().filter_map(figures).collect()
    }

    /// The edges of each section of an implement, metres to the right of its middle.
    fn edges(&self, width: f64) -> Vec<(u8, f64, f64)> {
        let used = self
            .mission
            .path
            .iter()
            .fold(0, |all, stage| all | stage.outputs);
        let sections: Vec<u8> = (1..=8)
            .filter(|section| used >> (section - 1) & 1 != 0)
            .collect();
        let each = width / sections.len().max(1) as f64;
        let edges = sections.iter().enumerate().map(|(place, section)| {
            let left = place as f64 * each - 0.5 * width;
            (*section, left, left + each)
        });
        edges.collect()
    }

    fn coverage(&self, width: f64) -> CoverageFigures {
        let edges = self.edges(width);
        let poses = self.mission.path.iter().filter(|stage| stage.outputs != 0);
        let spots = poses.flat_map(|stage| stage.poses.iter().map(|pose| (pose.0, pose.1)));
        let mut ground = Ground::about(spots, width);
        for stage in self.mission.path {
            for &(_, left, right) in edges.iter().filter(|(section, ..)| stage.works(*section)) {
                for pair in stage.poses.windows(2) {
                    ground.want(&strip(pair[0], pair[1], left, right));
                }
            }
        }
        self.work(&mut ground, &edges);
        let Areas {
            wanted,
            worked,
            twice,
            outside,
        } = ground.areas();
        let percent = |area: f64| rounded(area / wanted.max(1e-9) * 100.0, 3);
        CoverageFigures {
            swaths_m2: rounded(wanted, 2),
            worked_percent: percent(worked),
            twice_percent: percent(twice),
            outside_m2: rounded(outside, 2),
        }
    }

    /// What the implement works, as it was switched.
    fn work(&self, ground: &mut Ground, edges: &[(u8, f64, f64)]) {
        let mut on = 0_u8;
        let mut pass = 0;
        let mut switches = self.mission.switches.iter().peekable();
        let mut last: Option<(f64, (f64, f64, f64))> = None;
        for state in self.run.states {
            let now = seconds(state.at);
            let here = self.rear(state);
            let (before, from) = *last.get_or_insert((now, here));
            let mut begin = from;
            while let Some(switch) = switches.next_if(|switch| switch.at <= now) {
                let share = if now > before {
                    ((switch.at - before) / (now - before)).clamp(0.0, 1.0)
                } else {
                    1.0
                };
                let between = |from: f64, to: f64| from + share * (to - from);
                let place = (
                    between(from.0, here.0),
                    between(from.1, here.1),
                    between(from.2, here.2),
                );
                pass_over(ground, edges, on, (begin, place), pass);
                begin = place;
                if switch.on && on == 0 {
                    pass += 1;
                }
                let bit = 1 << (switch.section - 1);
                on = if switch.on { on | bit } else { on & !bit };
            }
            let far = libm::hypot(here.0 - begin.0, here.1 - begin.1) >= STEP;
            if far || begin != from {
                pass_over(ground, edges, on, (begin, here), pass);
                last = Some((now, here));
            }
        }
    }

    /// Place of the rear axle, and heading.
    fn rear(&self, state: &StateSample) -> (f64, f64, f64) {
        let rear = self.mission.rear;
        (
            state.north - rear * libm::cos(state.heading),
            state.east - rear * libm::sin(state.heading),
            state.heading,
        )
    }
}

/// The sections that are on work the ground between two poses.
fn pass_over(
    ground: &mut Ground,
    edges: &[(u8, f64, f64)],
    on: u8,
    (from, to): ((f64, f64, f64), (f64, f64, f64)),
    pass: u16,
) {
    for &(section, left, right) in edges {
        if on >> (section - 1) & 1 != 0 {
            ground.work(&strip(from, to, left, right), pass);
        }
    }
}

/// What lies between two poses, from `left` to `right` metres to the right of them.
fn strip(from: (f64, f64, f64), to: (f64, f64, f64), left: f64, right: f64) -> [Spot; 4] {
    let beside = |(north, east, heading): (f64, f64, f64), right: f64| {
        (
            north - right * libm::sin(heading),
            east + right * libm::cos(heading),
        )
    };
    [
        beside(from, left),
        beside(to, left),
        beside(to, right),
        beside(from, right),
    ]
}

impl Stage {
    /// Whether a section, 1 to 8, works on it.
    fn works(&self, section: u8) -> bool {
        self.outputs >> (section - 1) & 1 != 0
    }
}

/// The columns that a mission adds to the states: the leg, and what the vehicle does there.
pub(super) fn columns(mission: &MissionRun) -> [(Column, Vec<Cell>); 2] {
    let of = |cell: &dyn Fn(&Stage) -> Cell| {
        let stage = |located: &Located| mission.path.get(located.stage?);
        let cells = mission.located.iter();
        cells
            .map(|located| stage(located).map_or(Cell::Empty, cell))
            .collect()
    };
    [
        (
            Column::new(
                "leg",
                "",
                0,
                "leg of the mission, counted from 1; in a turn the one before it",
            ),
            of(&|stage| Cell::Number((stage.leg + 1) as f64)),
        ),
        (
            Column::new(
                "on",
                "",
                0,
                "what the vehicle drives: leg, turn or approach",
            ),
            of(&|stage| Cell::Word(stage.purpose.word())),
        ),
    ]
}
