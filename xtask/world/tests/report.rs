//! Reports on artificial runs whose figures can be computed by hand.

mod uagv;

use std::time::Duration;

use world::receiver::Fix;
use world::report::{
    CropRun, Due, FrameRecord, Judgement, ModeChange, OutputFolder, Run, Summary, TaskTime, Window,
    WindowContent, WindowKind, approached, expectations, last_cycle, states, terminal, track_svg,
};
use world::time::{at, from_seconds};
use world::{EffortChange, NodeIndex, Scenario, SimDuration, SimTime, StateSample, World};

const BIT: SimDuration = SimDuration::from_ticks(4_000_000);

fn micros(us: f64) -> SimTime {
    at(from_seconds(us * 1e-6))
}

fn span(us: f64) -> SimDuration {
    from_seconds(us * 1e-6)
}

fn state(time: f64, north: f64, east: f64) -> StateSample {
    StateSample {
        at: at(from_seconds(time)),
        north,
        east,
        heading: 0.1,
        steering: -0.2,
        speed: 1.0,
        steering_effort: 0.0,
        drive_effort: 0.5,
        fix: Fix::Fixed,
    }
}

fn frame(id: u16, first: u8, start: f64, bits: u32) -> FrameRecord {
    FrameRecord {
        id,
        dlc: 1,
        data: [first, 0, 0, 0, 0, 0, 0, 0],
        start: micros(start),
        end: micros(start + 4.0 * f64::from(bits)),
        complete: true,
        remote: false,
    }
}

fn window(id: u16, start: f64, kind: WindowKind, due: Due) -> Window {
    Window {
        id,
        message: format!("Message{id}"),
        sender: "gps".to_owned(),
        start: span(start),
        length: span(1000.0),
        repeat: 1,
        offset: 0,
        kind,
        due,
    }
}

/// The data that a run refers to.
struct Made {
    scenario: Scenario,
    nodes: Vec<String>,
    duration: f64,
    states: Vec<StateSample>,
    efforts: Vec<EffortChange>,
    frames: Vec<FrameRecord>,
    windows: Vec<Window>,
    modes: Vec<ModeChange>,
    tasks: Vec<TaskTime>,
}

impl Made {
    fn new(scenario: &str, duration: f64) -> Self {
        Self {
            scenario: Scenario::parse(&uagv::vehicle(), "made", "made", scenario).unwrap(),
            nodes: uagv::ALL.map(uagv::name).to_vec(),
            duration,
            states: Vec::new(),
            efforts: Vec::new(),
            frames: Vec::new(),
            windows: Vec::new(),
            modes: Vec::new(),
            tasks: Vec::new(),
        }
    }

    fn run(&self) -> Run<'_> {
        Run {
            scenario: &self.scenario,
            nodes: &self.nodes,
            seed: 42,
            duration: from_seconds(self.duration),
            states: &self.states,
            efforts: &self.efforts,
            frames: &self.frames,
            windows: &self.windows,
            cycle_count_byte: 1,
            basic_cycle: span(100_000.0),
            bit_time: BIT,
            modes: &self.modes,
            tasks: &self.tasks,
            rover: None,
            crop: None,
            mission: None,
        }
    }

    fn mode(&mut self, time: f64, mode: &str, autonomous: bool) {
        self.modes.push(ModeChange {
            at: at(from_seconds(time)),
            mode: mode.to_owned(),
            autonomous,
        });
    }

    fn effort(&mut self, time: f64, node: NodeIndex, effort: f64) {
        self.efforts.push(EffortChange {
            at: at(from_seconds(time)),
            node,
            byte: 127,
            effort,
        });
    }
}

/// 1 m right of the line until 2 s, then alternately 2 cm right and left every 10 ms. At 3 s the
/// error leaves the band for a moment, so the first second in the band is too short to count as
/// settled.
fn driven() -> Made {
    let mut made = Made::new("", 10.0);
    for i in 0..=1000 {
        let time = f64::from(i) / 100.0;
        let east = match i {
            0..200 => 1.0,
            300 => -0.08,
            _ if i % 2 == 0 => 0.02,
            _ => -0.02,
        };
        made.states.push(state(time, time, east));
    }
    made.mode(0.0, "Idle", false);
    made.mode(1.0, "AutonomousRun", true);
    made
}

#[test]
fn the_approach_is_over_when_the_mean_is_passed() {
    let errors = |values: &[f64]| -> Vec<(f64, f64)> {
        let timed = values.iter().enumerate();
        timed.map(|(i, error)| (i as f64, *error)).collect()
    };
    // The mean is 0.01.
    assert_eq!(
        approached(&errors(&[0.05, 0.03, 0.02, -0.02, 0.0, -0.02])),
        3
    );
    assert_eq!(approached(&errors(&[-0.05, -0.03, 0.02])), 2);
    assert_eq!(approached(&errors(&[0.01, 0.01])), 0);
    assert_eq!(approached(&[]), 0);
}

#[test]
fn guidance_figures() {
    let made = driven();
    let summary = Summary::of(&made.run());
    assert_eq!(summary.autonomous_runs.len(), 1);
    let run = &summary.autonomous_runs[0];
    assert_eq!((run.from_seconds, run.until_seconds), (1.0, 10.0));
    assert_eq!(run.initial_cross_track_error_cm, 100.0);
    // In the band from 2 s, left at 3 s after 1 s, in it again from 3.01 s: 2.01 s after 1 s.
    assert_eq!(run.settling_seconds, Some(2.01));
    assert_eq!(run.largest_cross_track_error_cm, Some(2.0));
    assert_eq!(run.overshoot_cm, 8.0);
    // From -2 cm at 3.01 s to 2 cm at 10 s: as many of each.
    assert_eq!(run.mean_cross_track_error_cm, Some(0.0));
    assert_eq!(run.standard_deviation_cm, Some(2.0));
    assert_eq!(run.steering_reversals_per_second, Some(0.0));
    assert_eq!(summary.largest_speed_m_s, Some(1.0));
    assert_eq!(summary.largest_steering_angle_deg, Some(11.459));
}

#[test]
fn a_run_that_never_settles_has_no_such_figures() {
    let mut made = driven();
    made.states.truncate(450);
    made.duration = 4.49;
    let summary = Summary::of(&made.run());
    assert_eq!(summary.autonomous_runs[0].settling_seconds, None);
    assert_eq!(summary.autonomous_runs[0].mean_cross_track_error_cm, None);
    assert!(summary.json().contains("\"settling_seconds\": null"));
}

#[test]
fn the_error_is_measured_from_the_line() {
    let mut made = driven();
    // A line to the east, 3 m north of the origin: south of it is right of it.
    let text = r#"
        [line]
        from = { north = "3 m", east = "0 m" }
        to = { north = "3 m", east = "100 m" }
    "#;
    made.scenario = Scenario::parse(&uagv::vehicle(), "made", "made", text).unwrap();
    let (along, error) = made.scenario.line.unwrap().locate(1.0, 7.0);
    assert!(
        (along - 7.0).abs() < 1e-12 && (error - 2.0).abs() < 1e-12,
        "{along} {error}"
    );
}

#[test]
fn reversals_are_counted_once_settled() {
    let mut made = driven();
    // Alternating every 100 ms from 5 s on, with pauses that do not count: 50 changes of sign in
    // 5 s, one of them already at 5 s against the effort before.
    for (i, state) in made.states.iter_mut().enumerate() {
        let tenth = i / 10;
        state.steering_effort = match (i >= 500, i % 10 == 0, tenth % 2 == 0) {
            (false, ..) => -0.3,
            (true, true, _) => 0.0,
            (true, false, true) => 0.3,
            (true, false, false) => -0.3,
        };
    }
    let summary = Summary::of(&made.run());
    let rate = summary.autonomous_runs[0]
        .steering_reversals_per_second
        .unwrap();
    assert_eq!(rate, (50.0_f64 / 6.99 * 1000.0).round() / 1000.0);
}

#[test]
fn stops_are_timed_from_the_event() {
    let mut made = Made::new(
        "[[reset]]\nnode = \"gps\"\nat = \"2 s\"\n[[fix]]\nat = \"4 s\"\nstate = \"float\"\n\
         [[reset]]\nnode = \"drive\"\nat = \"6 s\"\n[[fix]]\nat = \"50 s\"\nstate = \"none\"\n",
        8.0,
    );
    made.effort(1.0, uagv::STEERING, 0.3);
    made.effort(1.0, uagv::DRIVE, 0.5);
    made.effort(2.150, uagv::DRIVE, 0.0);
    made.effort(2.190, uagv::STEERING, 0.0);
    made.effort(6.5, uagv::DRIVE, 0.5);
    let summary = Summary::of(&made.run());
    let stops: Vec<(&str, Option<f64>)> = summary
        .stops
        .iter()
        .map(|stop| (stop.event.as_str(), stop.motors_stopped_after_ms))
        .collect();
    assert_eq!(
        stops,
        [
            ("gps held in reset", Some(190.0)),
            ("fix lost (float)", Some(0.0)),
            ("drive held in reset", Some(0.0)),
        ]
    );
    made.efforts.truncate(3);
    assert_eq!(
        Summary::of(&made.run()).stops[0].motors_stopped_after_ms,
        None
    );
}

/// An expectation of a run, judged: the judgement and what was seen.
fn judged(made: &Made, expect: &str) -> (Judgement, String) {
    let text = format!("duration = \"20 s\"\n[[expect]]\n{expect}");
    let scenario = Scenario::parse(&uagv::vehicle(), "made", "made", &text).unwrap();
    let run = Run {
        scenario: &scenario,
        ..made.run()
    };
    let decode = |frame: &FrameRecord, signal: &str| {
        (signal == "Fault").then(|| ["None", "SelfTest"][usize::from(frame.data[0])].to_owned())
    };
    let mut all = expectations(&run, &Summary::of(&run), &decode);
    let one = all.remove(0);
    (one.judgement, one.seen)
}

/// Expectations of the run below, and what they are judged by.
const CASES: [(&str, Judgement, &str); 18] = [
    (
        "what = \"mode\"\nat = \"1 s\"\nmode = \"AutonomousRun\"",
        Judgement::Met,
        "AutonomousRun since 1 s",
    ),
    (
        "what = \"mode\"\nat = \"999 ms\"\nmode = \"AutonomousRun\"",
        Judgement::Failed,
        "Idle since 0 s",
    ),
    (
        "what = \"mode\"\nat = \"11 s\"\nmode = \"AutonomousRun\"",
        Judgement::Open,
        "the run ended at 10 s",
    ),
    (
        "what = \"error\"\nfrom = \"4 s\"\nbelow = \"2.1 cm\"",
        Judgement::Met,
        "2.00 cm at 10.00 s",
    ),
    (
        "what = \"error\"\nfrom = \"2 s\"\nuntil = \"4 s\"\nbelow = \"8 cm\"",
        Judgement::Failed,
        "-8.00 cm at 3.00 s",
    ),
    (
        "what = \"error\"\nfrom = \"11 s\"\nbelow = \"8 cm\"",
        Judgement::Open,
        "the run ended at 10 s",
    ),
    (
        "what = \"stop\"\nafter = \"4 s\"\nwithin = \"250 ms\"",
        Judgement::Met,
        "at rest after 250.000 ms",
    ),
    (
        "what = \"stop\"\nafter = \"4 s\"\nwithin = \"249 ms\"",
        Judgement::Failed,
        "at rest after 250.000 ms",
    ),
    (
        "what = \"stop\"\nafter = \"5 s\"\nwithin = \"0 s\"",
        Judgement::Met,
        "they were at rest already",
    ),
    (
        "what = \"stop\"\nafter = \"9 s\"\nwithin = \"1 s\"",
        Judgement::Failed,
        "the motors were not at rest until the end of the run",
    ),
    (
        "what = \"frames\"\nmessage = \"Command\"\nuntil = \"10 s\"\nleast = 2\nmost = 2",
        Judgement::Met,
        "2 of them",
    ),
    (
        "what = \"frames\"\nmessage = \"Command\"\nfrom = \"2 s\"\nuntil = \"10 s\"\nleast = 2",
        Judgement::Failed,
        "1 of them",
    ),
    (
        "what = \"frames\"\nmessage = \"Latitude\"\nuntil = \"10 s\"\nmost = 0\nleast = 0",
        Judgement::Met,
        "0 of them",
    ),
    // The run was cut: the rest of it may have more frames, but not fewer.
    (
        "what = \"frames\"\nmessage = \"Command\"\nleast = 2\nmost = 2",
        Judgement::Open,
        "the run ended at 10 s",
    ),
    (
        "what = \"frames\"\nmessage = \"Command\"\nleast = 0\nmost = 1",
        Judgement::Failed,
        "2 of them",
    ),
    (
        "what = \"clean-bus\"",
        Judgement::Failed,
        "2 frames outside their windows, 1 foreign frames",
    ),
    (
        "what = \"count\"\nof = \"foreign-frames\"\nmost = 1",
        Judgement::Met,
        "1 of them",
    ),
    (
        "what = \"count\"\nof = \"foreign-frames\"",
        Judgement::Failed,
        "1 of them",
    ),
];

#[test]
fn each_expectation_is_judged_by_what_the_run_shows() {
    let mut made = driven();
    made.windows = vec![
        window(300, 7000.0, WindowKind::Exclusive, Due::Always),
        window(514, 12_000.0, WindowKind::Arbitrating, Due::Sometimes),
    ];
    made.windows[0].message = "Command".into();
    made.windows[1].message = "DriveStatus".into();
    made.frames = vec![
        frame(300, 0, 1e6, 100),
        frame(514, 0, 2e6, 100),
        frame(300, 0, 3e6, 100),
        frame(514, 1, 4e6, 100),
        frame(99, 0, 5e6, 100),
    ];
    made.effort(1.0, uagv::DRIVE, 0.5);
    made.effort(4.25, uagv::DRIVE, 0.0);
    made.effort(9.0, uagv::DRIVE, 0.5);
    let status =
        "what = \"signal\"\nmessage = \"DriveStatus\"\nsignal = \"Fault\"\nvalue = \"None\"\n";
    for (expect, judgement, seen) in CASES {
        assert_eq!(
            judged(&made, expect),
            (judgement, seen.to_owned()),
            "{expect}"
        );
    }
    assert_eq!(
        judged(&made, status),
        (Judgement::Failed, "SelfTest at 4 s".into())
    );
    let early = format!("{status}until = \"3 s\"");
    assert_eq!(
        judged(&made, &early),
        (Judgement::Met, "1 frames of it".into())
    );
    let never = format!("{status}from = \"10 s\"");
    assert_eq!(
        judged(&made, &never),
        (Judgement::Open, "the run ended at 10 s".into())
    );
    let text = format!("duration = \"10 s\"\n[[expect]]\n{never}");
    let error = Scenario::parse(&uagv::vehicle(), "made", "made", &text).unwrap_err();
    assert!(
        error
            .to_string()
            .ends_with("its period begins at 10 s, when the run ends"),
        "{error}"
    );
    let late = format!("{status}from = \"5 s\"");
    assert_eq!(
        judged(&made, &late),
        (Judgement::Failed, "0 frames of it".into())
    );
    made.efforts.clear();
    made.modes.clear();
    let idle = "what = \"mode\"\nat = \"1 s\"\nmode = \"Idle\"";
    assert_eq!(
        judged(&made, idle),
        (Judgement::Failed, "no mode was told until then".into())
    );
}

/// Where the fix is lost, rows may guide the machine on: its motors need not stop.
#[test]
fn what_an_event_made_of_the_motors_is_said_in_words() {
    let text = "[[row.section]]\nkind = \"poles\"\nlength = \"20 m\"\n\
                [[fix]]\nat = \"2 s\"\nstate = \"float\"\n";
    let mut made = Made::new(text, 4.0);
    made.effort(1.0, uagv::DRIVE, 0.5);
    let world = World::new(&uagv::vehicle(), &made.scenario, 1);
    let told = |made: &Made, guides: &[(f64, &str)]| {
        let guides: Vec<ModeChange> = guides
            .iter()
            .map(|&(seconds, guide)| ModeChange {
                at: at(from_seconds(seconds)),
                mode: guide.into(),
                autonomous: false,
            })
            .collect();
        let run = Run {
            crop: Some(CropRun {
                crop: world.crop().unwrap(),
                guides: &guides,
            }),
            ..made.run()
        };
        terminal(&Summary::of(&run), None)
    };
    let on = told(&made, &[(0.5, "Satellites"), (2.1, "Rows")]);
    let sentence = "2.000 s  fix lost (float): the vehicle drove on, guided by Rows\n";
    assert!(on.contains(sentence), "{on}");
    let off = told(&made, &[]);
    let sentence = "fix lost (float): the motors did not stop before the next event or the end of \
                    the run\n";
    assert!(off.contains(sentence), "{off}");
    made.effort(2.25, uagv::DRIVE, 0.0);
    let stopped = told(&made, &[(0.5, "Satellites"), (2.1, "Rows")]);
    assert!(
        stopped.contains("motors stopped after 250.0 ms"),
        "{stopped}"
    );
    made.efforts.remove(0);
    let stood = told(&made, &[]);
    assert!(
        stood.contains("fix lost (float): the motors stood already"),
        "{stood}"
    );
}

/// Four basic cycles. Message 300 has a window in each second one; message 301 has one at each of
/// two places.
#[test]
fn a_window_is_missed_only_in_the_basic_cycles_that_have_it() {
    let mut made = Made::new("", 0.4);
    let reference = window(100, 0.0, WindowKind::Reference, Due::Always);
    let every_second = |id, start, offset| Window {
        repeat: 2,
        offset,
        ..window(id, start, WindowKind::Exclusive, Due::Always)
    };
    made.windows = vec![
        reference,
        every_second(300, 3000.0, 1),
        every_second(301, 5000.0, 0),
        every_second(301, 7000.0, 1),
    ];
    for count in 0..4 {
        let start = 100_000.0 * f64::from(count);
        let mut reference = frame(100, 1, start, 50);
        // The upper two bits are not part of the count.
        reference.data[1] = count | 0xC0;
        made.frames.push(reference);
        if count == 1 {
            made.frames.push(frame(300, 0, start + 3004.0, 50));
        }
        let place = if count % 2 == 0 { 5000.0 } else { 7000.0 };
        made.frames.push(frame(301, 0, start + place, 50));
    }
    let figures = |made: &Made| {
        let bus = Summary::of(&made.run()).bus;
        let windows = bus.windows.iter().map(|w| (w.id, w.frames, w.missed));
        (bus.frames_outside_their_window, windows.collect::<Vec<_>>())
    };
    let tallies = [(300, 1, 1), (301, 2, 0), (301, 2, 0)];
    assert_eq!(figures(&made), (0, tallies.to_vec()));
    // In a basic cycle that has no such window, it is outside.
    made.frames.push(frame(300, 0, 303_004.0 - 100_000.0, 50));
    made.frames.sort_by_key(|frame| frame.start);
    assert_eq!(figures(&made), (1, tallies.to_vec()));
}

/// A receiver that measures in each third basic cycle, once not, and the fix is lost in two others.
#[test]
fn windows_between_two_measurements_are_not_missed() {
    let mut made = Made::new("", 2.0);
    made.windows = vec![
        window(100, 0.0, WindowKind::Reference, Due::Always),
        window(200, 3000.0, WindowKind::Exclusive, Due::WhileFixed(3)),
    ];
    let (lost, unfixed) = (9, [4, 5]);
    for cycle in 0..19 {
        let start = 10_000.0 + 100_000.0 * f64::from(cycle);
        made.frames
            .push(frame(100, u8::from(!unfixed.contains(&cycle)), start, 50));
        if cycle % 3 == 0 && cycle != lost {
            made.frames.push(frame(200, 0, start + 3000.0, 50));
        }
    }
    let missed = |made: &Made| Summary::of(&made.run()).bus.missed_windows;
    assert_eq!(missed(&made), 1);
    // Each of them, if each was due.
    made.windows[1].due = Due::WhileFixed(1);
    assert_eq!(missed(&made), 11);
}

/// Two basic cycles and the beginning of a third, with one frame late, one missed and one foreign.
fn traffic() -> Made {
    let mut made = Made::new("", 0.25);
    made.windows = vec![
        window(100, 0.0, WindowKind::Reference, Due::Always),
        window(200, 3000.0, WindowKind::Exclusive, Due::WhileFixed(1)),
        window(206, 6000.0, WindowKind::Exclusive, Due::Always),
        window(501, 12_000.0, WindowKind::Arbitrating, Due::Sometimes),
    ];
    made.frames = vec![
        frame(100, 1, 10_000.0, 50),
        frame(200, 0, 13_008.0, 50),
        frame(206, 0, 16_002.0, 50),
        frame(501, 0, 22_500.0, 50),
        frame(100, 0, 110_000.0, 50),
        frame(206, 0, 115_998.0, 50),
        frame(7, 0, 150_000.0, 50),
        frame(100, 1, 210_000.0, 50),
        frame(200, 0, 213_020.0, 50),
        frame(200, 0, 240_000.0, 50),
    ];
    made
}

/// Whoever asks for a message is not its sender.
#[test]
fn remote_frames_are_no_messages() {
    let mut made = traffic();
    let asks = |id, at| FrameRecord {
        remote: true,
        ..frame(id, 0, at, 44)
    };
    // In the window of another message, where message 206 is missing, and for the reference.
    made.frames.insert(3, asks(200, 20_000.0));
    made.frames.push(asks(206, 216_000.0));
    made.frames.push(asks(100, 245_000.0));
    made.frames.sort_by_key(|frame| frame.start);
    let (asked, clean) = (
        Summary::of(&made.run()).bus,
        Summary::of(&traffic().run()).bus,
    );
    assert_eq!(asked.frames, clean.frames + 3);
    assert!(asked.load_percent > clean.load_percent);
    assert_eq!(asked.windows, clean.windows);
    assert_eq!(asked.frames_per_id, clean.frames_per_id);
    assert_eq!(
        (
            asked.basic_cycles,
            asked.missed_windows,
            asked.frames_outside_their_window
        ),
        (
            clean.basic_cycles,
            clean.missed_windows,
            clean.frames_outside_their_window
        )
    );
}

#[test]
fn bus_figures() {
    let made = traffic();
    let bus = Summary::of(&made.run()).bus;
    assert_eq!((bus.frames, bus.error_frames, bus.basic_cycles), (10, 0, 3));
    // 10 frames of 53 bits of 4 us in 250 ms.
    assert_eq!(bus.load_percent, 0.848);
    assert_eq!(
        (bus.latest_start_us, bus.latest_start_id),
        (Some(20.0), Some(200))
    );
    assert_eq!(bus.earliest_start_us, Some(-2.0));
    // Message 206 in the third cycle. Message 200 in the second is not due without a fix.
    assert_eq!(bus.missed_windows, 1);
    assert_eq!(bus.frames_outside_their_window, 1);
    assert_eq!(bus.foreign_frames, 1);
    let counts: Vec<(u16, u64)> = bus
        .frames_per_id
        .iter()
        .map(|entry| (entry.id, entry.frames))
        .collect();
    assert_eq!(counts, [(7, 1), (100, 3), (200, 3), (206, 2), (501, 1)]);
    let windows: Vec<_> = bus
        .windows
        .iter()
        .map(|w| {
            (
                w.id,
                w.frames,
                w.missed,
                w.earliest_start_us,
                w.mean_start_us,
                w.latest_start_us,
            )
        })
        .collect();
    assert_eq!(
        windows,
        [
            (200, 2, 0, Some(8.0), Some(14.0), Some(20.0)),
            (206, 2, 1, Some(-2.0), Some(0.0), Some(2.0)),
        ]
    );
}

#[test]
fn the_last_whole_cycle_tells_what_came_in_each_window() {
    let of = |made: &Made, came: bool| -> Vec<WindowContent> {
        let cycle = last_cycle(&made.run(), &|_| came).unwrap();
        assert_eq!(cycle.begin, micros(110_000.0));
        let windows = cycle.windows.into_iter().enumerate();
        windows
            .map(|(number, (place, content))| {
                assert_eq!(place, number);
                content
            })
            .collect()
    };
    let contents = |made: &Made| of(made, true);
    let mut made = traffic();
    let [reference, position, pot, event] = contents(&made)[..] else {
        panic!("four windows");
    };
    assert_eq!(reference, WindowContent::Frame(0.0));
    // Without a fix it is not due.
    assert_eq!(position, WindowContent::Empty);
    assert!(matches!(pot, WindowContent::Frame(behind) if (behind + 2.0).abs() < 1e-6));
    assert_eq!(event, WindowContent::Empty);
    made.frames[5].complete = false;
    assert_eq!(contents(&made)[2], WindowContent::Destroyed);
    made.frames.remove(5);
    assert_eq!(contents(&made)[2], WindowContent::Missed);
    made.frames[4].data[0] = 1;
    assert_eq!(contents(&made)[1], WindowContent::Missed);
    // As in the report, a message that has never come is not missed.
    assert_eq!(of(&made, false)[1], WindowContent::Empty);
    // The first cycle is not over.
    made.duration = 0.1;
    made.frames.truncate(4);
    assert_eq!(last_cycle(&made.run(), &|_| true), None);
}

/// The master sends at 10 and 110 ms and dies at 150 ms; the backup follows.
#[test]
fn a_takeover_is_timed_from_the_dead_masters_last_reference() {
    let of = |sender: &str, window: Window| Window {
        sender: sender.into(),
        ..window
    };
    let mut made = Made::new("[[reset]]\nnode = \"gps\"\nat = \"150 ms\"\n", 0.45);
    made.windows = vec![
        of("gps", window(100, 0.0, WindowKind::Reference, Due::Always)),
        of(
            "controller",
            window(101, 0.0, WindowKind::Reference, Due::Always),
        ),
        of(
            "gps",
            window(401, 1000.0, WindowKind::Exclusive, Due::Always),
        ),
        of(
            "steering",
            window(206, 6000.0, WindowKind::Exclusive, Due::Always),
        ),
    ];
    made.frames = vec![
        frame(100, 0, 10_000.0, 50),
        frame(401, 0, 11_000.0, 50),
        frame(206, 0, 16_000.0, 50),
        frame(100, 0, 110_000.0, 50),
        frame(401, 0, 111_000.0, 50),
        frame(206, 0, 116_000.0, 50),
        frame(101, 0, 210_018.0, 50),
        frame(206, 0, 216_018.0, 50),
        frame(101, 0, 310_018.0, 50),
        frame(206, 0, 316_018.0, 50),
    ];
    let takeovers = |made: &Made| Summary::of(&made.run()).bus.takeovers;
    let [takeover] = takeovers(&made).try_into().expect("one takeover");
    assert_eq!(takeover.master, "gps");
    assert_eq!(takeover.at_seconds, 0.15);
    assert_eq!(takeover.next_reference_after_us, Some(100_018.0));
    // A basic cycle of 100 ms, the backup's offset of 16 us, and 20 us of clock uncertainty.
    assert_eq!(takeover.bound_us, 100_036.0);
    // The window of the master that is in reset does not count.
    assert_eq!(takeover.windows_lost, 0);
    made.frames.remove(7);
    assert_eq!(takeovers(&made)[0].windows_lost, 1);
    made.frames.truncate(6);
    assert_eq!(takeovers(&made)[0].next_reference_after_us, None);
    // There is no takeover if the node in reset was not the current master.
    made.frames.truncate(3);
    made.frames[0].id = 101;
    assert_eq!(takeovers(&made), []);
}

#[test]
fn a_missed_window_needs_the_fix_of_its_cycle() {
    let mut made = traffic();
    made.frames[4].data[0] = 1;
    assert_eq!(Summary::of(&made.run()).bus.missed_windows, 2);
}

#[test]
fn frames_without_a_reference_are_outside() {
    let mut made = traffic();
    made.duration = 1.0;
    // 150 ms after the last reference its cycle is over.
    made.frames.push(frame(206, 0, 359_000.0, 50));
    made.frames.push(frame(206, 0, 361_000.0, 50));
    let bus = Summary::of(&made.run()).bus;
    assert_eq!(bus.frames_outside_their_window, 3);
}

/// A foreign node may flood the bus with a message of the network that belongs into an arbitrating window.
#[test]
fn event_messages_outside_the_arbitrating_windows_are_counted() {
    let mut made = traffic();
    made.windows.push(window(
        531,
        30_000.0,
        WindowKind::Arbitrating,
        Due::Sometimes,
    ));
    let outside = |made: &Made| Summary::of(&made.run()).bus.frames_outside_their_window;
    let clean = outside(&made);
    // In its own window, early by less than two clocks differ, and tried again in another one.
    for start in [40_500.0, 39_985.0, 122_900.0] {
        made.frames.push(frame(531, 0, start, 50));
    }
    made.frames.sort_by_key(|frame| frame.start);
    assert_eq!(outside(&made), clean);
    for start in [39_900.0, 41_000.0, 43_000.0, 121_900.0, 245_000.0] {
        made.frames.push(frame(531, 0, start, 50));
    }
    made.frames.sort_by_key(|frame| frame.start);
    assert_eq!(outside(&made), clean + 5);
    // After the end of the last basic cycle, too.
    made.duration = 1.0;
    made.frames.push(frame(531, 0, 400_000.0, 50));
    assert_eq!(outside(&made), clean + 6);
    // A bus without references has no windows to keep to.
    for window in &mut made.windows {
        window.kind = WindowKind::Arbitrating;
    }
    assert_eq!(outside(&made), 0);
}

#[test]
fn error_frames_load_the_bus_but_are_no_frames() {
    let mut made = traffic();
    made.frames[9].complete = false;
    let bus = Summary::of(&made.run()).bus;
    assert_eq!(
        (bus.frames, bus.error_frames, bus.load_percent),
        (9, 1, 0.848)
    );
    assert_eq!(bus.frames_outside_their_window, 0);
}

#[test]
fn an_empty_run_has_a_report() {
    let made = Made::new("", 1.0);
    let summary = Summary::of(&made.run());
    assert!(terminal(&summary, None).contains("no autonomous run"));
    let text = track_svg(&made.run(), &summary).unwrap();
    roxmltree::Document::parse(&text).unwrap();
}

fn complete() -> Made {
    let mut made = driven();
    let traffic = traffic();
    (made.frames, made.windows) = (traffic.frames, traffic.windows);
    made.tasks.push(TaskTime {
        node: "steering".to_owned(),
        task: "can_receive".to_owned(),
        runs: 321,
        longest_cycles: 720,
        core_hz: 72_000_000,
    });
    made
}

#[test]
fn the_summary_file_and_the_terminal_say_the_same() {
    let made = complete();
    let summary = Summary::of(&made.run());
    insta::assert_snapshot!("summary", summary.json());
    let wall = Some(Duration::from_millis(4_000));
    insta::assert_snapshot!("terminal", terminal(&summary, wall));
}

#[test]
fn the_table_of_states() {
    let mut made = driven();
    made.states.truncate(2);
    assert_eq!(
        states(&made.run()).unwrap().csv(),
        "time_s,north_m,east_m,heading_deg,steering_angle_deg,speed_m_s,along_m,\
         cross_track_error_m,heading_error_deg,steering_effort,drive_effort,fix\n\
         0.00,0.0000,1.0000,5.730,-11.459,1.0000,0.0000,1.0000,5.730,0.0000,0.5000,fixed\n\
         0.01,0.0100,1.0000,5.730,-11.459,1.0000,0.0100,1.0000,5.730,0.0000,0.5000,fixed\n"
    );
}

#[test]
fn the_picture_is_svg_with_everything_inside() {
    let mut made = complete();
    made.scenario.name = "a < b & \"c\"".to_owned();
    made.states[5].fix = Fix::Single;
    let summary = Summary::of(&made.run());
    let text = track_svg(&made.run(), &summary).unwrap();
    let document = roxmltree::Document::parse(&text).unwrap();
    let root = document.root_element();
    let size = |name: &str| root.attribute(name).unwrap().parse::<f64>().unwrap();
    let (width, height) = (size("width"), size("height"));
    let words: Vec<&str> = root.descendants().filter_map(|node| node.text()).collect();
    for expected in [
        "a < b & \"c\"",
        "start",
        "end",
        "path",
        "way along the line (m)",
        "right of line (m)",
        "time (s)",
        "speed (m/s)",
        "settled, 2.0 s",
    ] {
        assert!(
            words.contains(&expected),
            "{expected:?} is missing in {words:?}"
        );
    }
    assert!(!text.contains("NaN") && !text.contains("inf"));
    for node in root.descendants() {
        for (name, most) in [("x", width), ("cx", width), ("y", height), ("cy", height)] {
            if let Some(place) = node.attribute(name) {
                let place: f64 = place.parse().unwrap();
                assert!((0.0..=most).contains(&place), "{name}={place} in {node:?}");
            }
        }
    }
    let curves = root
        .descendants()
        .filter(|node| node.has_tag_name("path"))
        .count();
    assert_eq!(curves, 5, "path, error twice, steering, speed");
}

#[test]
fn a_folder_appears_whole() {
    let parent = tempfile::tempdir().unwrap();
    let target = parent.path().join("deep/er/out");
    let mut folder = OutputFolder::create(&target).unwrap();
    folder.write("a.txt", b"A").unwrap();
    assert!(!target.exists(), "nothing half written");
    assert_eq!(folder.finish().unwrap(), target);
    assert_eq!(std::fs::read(target.join("a.txt")).unwrap(), b"A");

    // A second run into the same folder replaces its files and keeps the others.
    std::fs::write(target.join("mine.txt"), b"M").unwrap();
    let mut folder = OutputFolder::create(&target).unwrap();
    folder.write("a.txt", b"B").unwrap();
    assert_eq!(std::fs::read(target.join("a.txt")).unwrap(), b"A");
    folder.finish().unwrap();
    let mut names: Vec<_> = std::fs::read_dir(&target)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert_eq!(names, ["a.txt", "mine.txt"]);
    assert_eq!(std::fs::read(target.join("a.txt")).unwrap(), b"B");
}

#[test]
fn an_unfinished_folder_leaves_nothing() {
    let parent = tempfile::tempdir().unwrap();
    let target = parent.path().join("out");
    let mut folder = OutputFolder::create(&target).unwrap();
    folder.write("a.txt", b"A").unwrap();
    drop(folder);
    assert_eq!(std::fs::read_dir(parent.path()).unwrap().count(), 0);
}

#[test]
fn of_two_runs_into_one_folder_the_second_is_refused() {
    let parent = tempfile::tempdir().unwrap();
    let target = parent.path().join("out");
    for exists in [false, true] {
        let mut first = OutputFolder::create(&target).unwrap();
        first.write("a.txt", b"A").unwrap();
        let error = OutputFolder::create(&target).unwrap_err().to_string();
        assert!(error.contains("another run writes to it"), "{error}");
        first.finish().unwrap();
        assert_eq!(std::fs::read_dir(&target).unwrap().count(), 1, "{exists}");
    }
    // What a killed run has left is in nobody's way.
    let left = target.join(".unfinished");
    std::fs::create_dir(&left).unwrap();
    std::fs::write(left.join(".lock"), b"").unwrap();
    std::fs::write(left.join("b.txt"), b"B").unwrap();
    let folder = OutputFolder::create(&target).unwrap();
    folder.finish().unwrap();
    assert_eq!(std::fs::read_dir(&target).unwrap().count(), 1);
}

#[test]
fn what_an_older_run_has_left_goes_away_with_it() {
    let parent = tempfile::tempdir().unwrap();
    for name in ["a.txt", "log-one.txt", "mine.txt"] {
        std::fs::write(parent.path().join(name), b"old").unwrap();
    }
    let mut folder = OutputFolder::create(parent.path()).unwrap();
    folder.replace_older(|name| name == "a.txt" || name.starts_with("log-"));
    folder.write("a.txt", b"new").unwrap();
    folder.finish().unwrap();
    assert_eq!(std::fs::read(parent.path().join("a.txt")).unwrap(), b"new");
    assert!(!parent.path().join("log-one.txt").exists());
    assert!(parent.path().join("mine.txt").exists());
}

#[cfg(unix)]
#[test]
fn what_is_no_file_is_not_replaced() {
    let parent = tempfile::tempdir().unwrap();
    let (kept, target) = (parent.path().join("kept.txt"), parent.path().join("out"));
    std::fs::write(&kept, b"K").unwrap();
    std::fs::create_dir(&target).unwrap();
    let link = target.join("b.txt");
    std::os::unix::fs::symlink(&kept, &link).unwrap();
    let mut folder = OutputFolder::create(&target).unwrap();
    folder.write("a.txt", b"A").unwrap();
    folder.write("b.txt", b"B").unwrap();
    let error = folder.finish().unwrap_err().to_string();
    assert!(error.contains("its b.txt is no regular file"), "{error}");
    assert!(link.is_symlink() && std::fs::read(&kept).unwrap() == b"K");
    assert!(!target.join("a.txt").exists(), "all or nothing");
    assert_eq!(std::fs::read_dir(&target).unwrap().count(), 1);
}

#[test]
fn a_folder_that_cannot_be_is_refused_in_a_sentence() {
    let parent = tempfile::tempdir().unwrap();
    let file = parent.path().join("file");
    std::fs::write(&file, b"").unwrap();
    for target in [file.clone(), file.join("below")] {
        let error = OutputFolder::create(&target).unwrap_err().to_string();
        let expected = format!(
            "output folder {} cannot be written: a file is in the way; name a folder that can be \
             created or written to",
            target.display()
        );
        assert_eq!(error, expected);
    }
}

/// A bus that falls silent is no clean one, though its last frames were all as planned.
#[test]
fn a_bus_without_references_is_not_clean() {
    let judged_with = |until: u32| {
        let mut made = driven();
        made.windows = vec![window(100, 0.0, WindowKind::Reference, Due::Always)];
        let cycles = (0..until).map(|cycle| frame(100, 0, f64::from(cycle) * 1e5, 100));
        made.frames = cycles.collect();
        judged(&made, "what = \"clean-bus\"")
    };
    assert_eq!(
        judged_with(100),
        (Judgement::Met, "100 frames, all as planned".into())
    );
    let (judgement, seen) = judged_with(30);
    assert_eq!(judgement, Judgement::Failed);
    assert!(
        seen.contains("no reference for 7.1 s from 2.9 s on"),
        "{seen}"
    );
    // Of a run that was cut, nobody knows whether frames would have come.
    assert_eq!(judged_with(0).0, Judgement::Open);
}
