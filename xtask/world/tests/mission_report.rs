//! Reports on artificial runs of a mission whose figures can be computed by hand.

mod uagv;

use world::receiver::Fix;
use world::report::{
    Located, MissionFigures, MissionRun, ModeChange, Purpose, Run, RunEnd, SectionSwitch, Stage,
    Summary, states, terminal,
};
use world::time::{at, from_seconds};
use world::{Scenario, StateSample};

const REAR: f64 = 0.255;

/// Two legs of 20 m side by side, 3 m apart, with a turn of 10 m between them that is drawn straight. Section 1 works on
/// both.
fn path() -> Vec<Stage> {
    let line = |east: f64, from: f64, to: f64, heading: f64| {
        vec![(from, east, heading), (to, east, heading)]
    };
    let stage = |leg, purpose, begin, length, outputs, poses| Stage {
        leg,
        purpose,
        begin,
        length,
        outputs,
        reverse: false,
        poses,
    };
    let back = std::f64::consts::PI;
    vec![
        stage(0, Purpose::Leg, 0.0, 20.0, 1, line(0.0, 0.0, 20.0, 0.0)),
        stage(0, Purpose::Turn, 20.0, 10.0, 0, Vec::new()),
        stage(1, Purpose::Leg, 30.0, 20.0, 1, line(3.0, 20.0, 0.0, back)),
    ]
}

/// A run along the path at 1 m/s, from second 10 on. `right` is the cross-track error along the path.
struct Driven {
    scenario: Scenario,
    path: Vec<Stage>,
    states: Vec<StateSample>,
    located: Vec<Located>,
    switches: Vec<SectionSwitch>,
    ended: Vec<RunEnd>,
    modes: Vec<ModeChange>,
    repeats: bool,
}

impl Driven {
    fn new(right: fn(f64) -> f64) -> Self {
        let path = path();
        let (mut states, mut located) = (Vec::new(), Vec::new());
        for step in 0..=5100 {
            let time = f64::from(step) * 0.01;
            let along = (time - 0.5).clamp(0.0, 50.0);
            let stage = path
                .iter()
                .rposition(|stage| stage.begin <= along)
                .filter(|_| time >= 0.5);
            let error = right(along);
            // In the turn, the vehicle goes on straight for a metre at both ends.
            let (north, east, heading) = if along >= 29.0 {
                (50.0 - along, 3.0 - error, std::f64::consts::PI)
            } else if along > 21.0 {
                (21.0, 1.5, 1.5)
            } else {
                (time - 0.5, error, 0.0)
            };
            states.push(StateSample {
                at: at(from_seconds(10.0 + time)),
                north: north + REAR * heading.cos(),
                east: east + REAR * heading.sin(),
                heading,
                steering: 0.0,
                speed: if along < 50.0 { 1.0 } else { 0.0 },
                steering_effort: 0.0,
                drive_effort: 0.5,
                fix: Fix::Fixed,
            });
            located.push(Located {
                stage,
                along: if time < 0.5 { time - 0.5 } else { along },
                right: error,
                heading_error: 0.01,
            });
        }
        Self {
            scenario: Scenario::parse(&uagv::vehicle(), "made", "made", "").unwrap(),
            path,
            states,
            located,
            switches: Vec::new(),
            ended: Vec::new(),
            modes: vec![ModeChange {
                at: at(from_seconds(10.4)),
                mode: "Autonomous".into(),
                autonomous: true,
            }],
            repeats: false,
        }
    }

    /// Section 1 is switched when the rear axle is at this place of the path, m.
    fn switch(&mut self, along: f64, on: bool) {
        self.switches.push(SectionSwitch {
            at: 10.5 + along,
            section: 1,
            on,
        });
    }

    /// Calls `look` with the run.
    fn look<T>(&self, look: impl Fn(&Run, &MissionRun) -> T) -> T {
        let nodes = uagv::ALL.map(uagv::name).to_vec();
        let mission = MissionRun {
            path: &self.path,
            ends: !self.repeats,
            located: &self.located,
            switches: &self.switches,
            ended: &self.ended,
            width: Some(3.0),
            rear: REAR,
        };
        let run = Run {
            scenario: &self.scenario,
            nodes: &nodes,
            seed: 1,
            duration: from_seconds(62.0),
            states: &self.states,
            efforts: &[],
            frames: &[],
            windows: &[],
            cycle_count_byte: 1,
            basic_cycle: from_seconds(0.1),
            bit_time: from_seconds(4e-6),
            modes: &self.modes,
            tasks: &[],
            rover: None,
            crop: None,
            mission: Some(mission),
        };
        look(&run, &mission)
    }

    fn figures(&self) -> MissionFigures {
        self.look(MissionFigures::of)
    }
}

/// 1 cm to one side on the first leg, 2 cm to the other on the second one, 4 cm in the turn.
fn beside(along: f64) -> f64 {
    match along {
        along if along < 20.0 => 0.01,
        along if along < 30.0 => 0.04,
        _ => -0.02,
    }
}

#[test]
fn errors_are_those_of_legs_and_turns() {
    let figures = Driven::new(beside).figures();
    assert!(figures.finished && figures.stops == 0);
    assert!((figures.way_m - 50.0).abs() < 1e-9);
    assert!((figures.time_seconds - 50.0).abs() < 0.02, "{figures:?}");
    assert!((figures.mean_cm.unwrap() - 1.5).abs() < 0.01);
    // About the mean of -0.5 cm.
    assert!((figures.deviation_cm.unwrap() - 1.5).abs() < 0.01);
    assert_eq!(figures.largest_cm, Some(2.0));
    assert_eq!(figures.turns_largest_cm, Some(4.0));
    let legs: Vec<_> = figures
        .legs
        .iter()
        .map(|leg| (leg.leg, leg.mean_cm))
        .collect();
    assert_eq!(legs, [(1, 1.0), (2, 2.0)]);
    let turns: Vec<_> = figures
        .turns
        .iter()
        .map(|turn| (turn.after_leg, turn.largest_cm))
        .collect();
    assert_eq!(turns, [(1, 4.0)]);
    // Nothing was switched, and nothing worked.
    assert_eq!(
        (figures.switched_within_cm, figures.wrong_switches),
        (None, 4)
    );
    let coverage = figures.coverage.unwrap();
    assert!((coverage.swaths_m2 - 120.0).abs() < 1.0);
    assert_eq!(coverage.worked_percent, 0.0);
}

#[test]
fn switches_are_told_by_the_ends_of_the_legs() {
    let mut driven = Driven::new(|_| 0.0);
    for (along, on) in [(-0.02, true), (20.03, false), (30.01, true), (49.95, false)] {
        driven.switch(along, on);
    }
    let figures = driven.figures();
    assert!(
        (figures.switched_within_cm.unwrap() - 5.0).abs() < 0.01,
        "{figures:?}"
    );
    assert_eq!(figures.wrong_switches, 0);
    let close = |found: Option<f64>, cm: f64| (found.unwrap() - cm).abs() < 0.01;
    let [first, second] = &figures.legs[..] else {
        panic!("{figures:?}");
    };
    assert!(close(first.sections[0].on_cm, -2.0) && close(first.sections[0].off_cm, 3.0));
    assert!(close(second.sections[0].on_cm, 1.0) && close(second.sections[0].off_cm, -5.0));
    let coverage = figures.coverage.unwrap();
    assert!(
        (coverage.worked_percent - (100.0 - 0.06 / 40.0 * 100.0)).abs() < 0.3,
        "{coverage:?}"
    );
    assert!(coverage.twice_percent < 0.01 && coverage.outside_m2 < 0.5);

    // A switch on the way is one too many, and its way is not worked.
    driven.switches.clear();
    for (along, on) in [
        (0.0, true),
        (8.0, false),
        (12.0, true),
        (20.0, false),
        (30.0, true),
        (50.0, false),
    ] {
        driven.switch(along, on);
    }
    let figures = driven.figures();
    assert_eq!(figures.wrong_switches, 2);
    let worked = figures.coverage.unwrap().worked_percent;
    assert!((worked - 90.0).abs() < 0.5, "{worked}");
}

#[test]
fn a_lane_beside_the_path_is_worked_twice_and_outside() {
    // Half a metre to the right of both legs, which is towards each other.
    let mut driven = Driven::new(|_| 0.5);
    for (along, on) in [(0.0, true), (20.0, false), (30.0, true), (50.0, false)] {
        driven.switch(along, on);
    }
    let coverage = driven.figures().coverage.unwrap();
    // A metre of ground is worked twice, and half a metre on both sides is left.
    assert!(
        (coverage.twice_percent - 20.0 / 120.0 * 100.0).abs() < 0.5,
        "{coverage:?}"
    );
    assert!(
        (coverage.worked_percent - 100.0 / 120.0 * 100.0).abs() < 0.5,
        "{coverage:?}"
    );
    assert!(coverage.outside_m2 < 0.5);
}

#[test]
fn a_stop_on_the_way_is_counted() {
    let mut driven = Driven::new(|_| 0.0);
    for state in &mut driven.states[1000..1100] {
        state.speed = 0.0;
    }
    assert_eq!(driven.figures().stops, 1);
    // Where the direction changes, a vehicle stands.
    driven.path[0].length = 9.6;
    driven.path.insert(
        1,
        Stage {
            begin: 9.6,
            length: 10.4,
            reverse: true,
            ..driven.path[0].clone()
        },
    );
    assert_eq!(driven.figures().stops, 0);
}

/// Where the vehicle is does not tell whether it has come there by its path.
#[test]
fn a_run_that_something_else_ended_is_not_driven_to_its_end() {
    let mut driven = Driven::new(beside);
    let end = |mode: &str, reason: Option<&str>, arrived| RunEnd {
        at_seconds: 60.6,
        mode: mode.into(),
        reason: reason.map(str::to_owned),
        arrived,
    };
    let look = |driven: &Driven| {
        driven.look(|run, mission| {
            let text = terminal(&Summary::of(run), None);
            (MissionFigures::of(run, mission), text)
        })
    };
    let fence = end("Fault", Some("Fence"), false);
    driven.ended = vec![fence.clone()];
    let (figures, text) = look(&driven);
    assert!(!figures.finished && figures.stops == 1);
    assert_eq!(figures.ended.as_ref(), Some(&fence));
    assert!(
        text.contains("driven not to its end: 50.0 m in 50.0 s with 1 stop\n"),
        "{text}"
    );
    assert!(
        text.contains("its run ended at 60.6 s: mode Fault, reason Fence\n"),
        "{text}"
    );
    // A second run takes it to its end.
    driven
        .ended
        .push(end("AutonomousReady", Some("PathEnd"), true));
    let (figures, text) = look(&driven);
    assert!(figures.finished && figures.stops == 1 && figures.ended.is_none());
    assert!(!text.contains("its run ended"), "{text}");
    driven.ended = vec![end("Idle", None, true)];
    assert!(look(&driven).0.finished);
}

/// A run whose time is over is no fault of the vehicle.
#[test]
fn a_run_that_its_time_ends_is_told_so() {
    let mut driven = Driven::new(beside);
    driven.states.truncate(3000);
    driven.located.truncate(3000);
    let look = |driven: &Driven| {
        driven.look(|run, mission| {
            let text = terminal(&Summary::of(run), None);
            (MissionFigures::of(run, mission), text)
        })
    };
    let (figures, text) = look(&driven);
    assert!(figures.cut && !figures.finished && figures.rounds.is_none());
    assert!(
        text.contains(
            "driven for a part of its 50.0 m, then the time of the run was over: 29.5 m in "
        ),
        "{text}"
    );
    // One that the vehicle ends is none of these.
    driven.ended = vec![RunEnd {
        at_seconds: 39.9,
        mode: "Fault".into(),
        reason: Some("Fence".into()),
        arrived: false,
    }];
    let (figures, text) = look(&driven);
    assert!(!figures.cut, "{figures:?}");
    assert!(text.contains("driven not to its end"), "{text}");
}

#[test]
fn a_mission_that_repeats_is_told_in_rounds() {
    let mut driven = Driven::new(beside);
    driven.repeats = true;
    // The path once more.
    let (states, located) = (driven.states.clone(), driven.located.clone());
    let last = driven.states.last().unwrap().at;
    for (state, at) in states.iter().zip(&located) {
        let mut state = *state;
        state.at = last + (state.at - states[0].at);
        driven.states.push(state);
        driven.located.push(*at);
    }
    let (figures, text) = driven.look(|run, mission| {
        let text = terminal(&Summary::of(run), None);
        (MissionFigures::of(run, mission), text)
    });
    assert_eq!(figures.rounds, Some(1));
    assert!(text.contains("driven in 1 whole round of 50.0 m"), "{text}");
}

/// The display shows the reason, and so does the report.
#[test]
fn a_run_that_does_not_begin_has_its_reason() {
    let mut driven = Driven::new(beside);
    driven.modes.clear();
    driven
        .located
        .iter_mut()
        .for_each(|located| located.stage = None);
    driven.ended = vec![RunEnd {
        at_seconds: 12.3,
        mode: "Fault".into(),
        reason: Some("FarOff".into()),
        arrived: false,
    }];
    let text = driven.look(|run, _| terminal(&Summary::of(run), None));
    assert!(
        text.contains("no run began, refused at 12.3 s: mode Fault, reason FarOff\n"),
        "{text}"
    );
}

#[test]
fn the_report_and_the_states_are_those_of_the_path() {
    let driven = Driven::new(beside);
    let (summary, table) = driven.look(|run, _| (Summary::of(run), states(run).unwrap()));
    let text = terminal(&summary, None);
    assert!(
        text.contains("mission driven to its end: 50.0 m in 50.0 s with 0 stops"),
        "{text}"
    );
    assert!(text.contains("turns, largest"), "{text}");
    assert!(!text.contains("settled to 5 cm"), "{text}");
    assert!(summary.json().contains("\"turns_largest_cm\": 4.0"));
    let csv = table.csv();
    assert!(
        csv.lines().next().unwrap().ends_with(",fix,leg,on"),
        "{csv}"
    );
    let row = csv.lines().find(|line| line.starts_with("35.50,")).unwrap();
    assert!(
        row.contains(",25.0000,0.0400,0.573,") && row.ends_with(",1,turn"),
        "{row}"
    );
}
