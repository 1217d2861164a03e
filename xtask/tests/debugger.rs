//! The debugger of `sim --gdb`: a run with stops is the run without them, and earlier places are reached again.

use std::collections::BTreeSet;
use std::sync::OnceLock;

use object::{Object, ObjectSymbol};
use twin::replay::{Halt, Replay};
use twin::stops::{Stop, Stops, Watch, Watched};
use twin::{Images, Twin};
use vehicle_model::{NodeIndex, Vehicle};
use world::{Scenario, SimDuration, SimTime};
use xtask::{Workspace, build, vehicle};

/// As `sim` cuts its runs.
const SPAN: SimDuration = campaign::agreement::SPAN;

struct Subject {
    vehicle: Vehicle,
    images: Images,
    scenario: Scenario,
}

fn subject() -> &'static Subject {
    static SUBJECT: OnceLock<Subject> = OnceLock::new();
    SUBJECT.get_or_init(|| {
        let workspace = Workspace::find().unwrap();
        let vehicle = vehicle::find(&workspace, "uagv").unwrap();
        let nodes: Vec<_> = vehicle.nodes().collect();
        let images = build::images(&workspace, &vehicle, &nodes).unwrap();
        let images = build::read(&images).unwrap();
        let scenario = Scenario::find(&vehicle, "straight-line").unwrap();
        Subject {
            vehicle,
            images,
            scenario,
        }
    })
}

impl Subject {
    fn twin(&self) -> Twin {
        Twin::new(&self.vehicle, &self.scenario, 1, &self.images).unwrap()
    }

    fn node(&self, name: &str) -> NodeIndex {
        self.vehicle.find_node(name).unwrap()
    }

    fn replay(&self, node: &str, end: f64) -> Replay<()> {
        let node = self.node(node);
        Replay::new(self.twin(), (), node, seconds(end), SPAN).unwrap()
    }

    /// Address of a function or a static of a node.
    fn symbol(&self, node: &str, name: &str) -> u32 {
        let file = object::File::parse(self.images.of(self.node(node))).unwrap();
        let symbol = file.symbols().find(|symbol| symbol.name() == Ok(name));
        let symbol = symbol.unwrap_or_else(|| panic!("{node} has no symbol {name}"));
        symbol.address() as u32 & !1
    }
}

fn seconds(seconds: f64) -> SimTime {
    SimTime::from_ticks((seconds * 1e12) as u64)
}

fn never(_: &Replay<()>) -> bool {
    false
}

fn breakpoint(at: u32) -> Stops {
    Stops {
        breakpoints: BTreeSet::from([at]),
        ..Stops::default()
    }
}

/// Where a run is: steps of the node, its time, program counter and all of its memory.
fn place(replay: &Replay<()>) -> (u64, SimTime, u32, Vec<u8>) {
    let mcu = replay.mcu();
    let memory = mcu.memory(0x2000_0000, 12 * 1024).unwrap();
    (mcu.steps(), mcu.now(), mcu.pc(), memory)
}

#[test]
fn a_run_with_stops_and_returns_is_the_run_without_them() {
    let subject = subject();
    let end = seconds(1.5);
    let mut plain = subject.twin();
    while plain.now() < end {
        let next = (plain.now() + SPAN).min(end);
        plain.run_until(next).unwrap();
    }

    let mut replay = subject.replay("steering", 1.5);
    let stops = breakpoint(subject.symbol("steering", "USB_LP_CAN_RX0"));
    let mut places = Vec::new();
    while replay.forwards(stops.clone(), &mut never) == Halt::Stop(Stop::Breakpoint) {
        places.push(place(&replay));
    }
    assert!(places.len() > 20, "{}", places.len());
    assert!(plain.records() == replay.records());

    // The same places, from the last one to the first, and once more forwards.
    for wanted in places.iter().rev() {
        let halt = replay.backwards(&stops, &mut never);
        assert_eq!(halt, Halt::Stop(Stop::Breakpoint));
        assert!(place(&replay) == *wanted, "at {} s", wanted.1.as_ticks());
    }
    assert_eq!(replay.backwards(&stops, &mut never), Halt::Beginning);
    for wanted in &places {
        let halt = replay.forwards(stops.clone(), &mut never);
        assert_eq!(halt, Halt::Stop(Stop::Breakpoint));
        assert!(place(&replay) == *wanted);
    }
    assert_eq!(replay.forwards(stops, &mut never), Halt::End);
    assert!(plain.records() == replay.records());
}

#[test]
fn accesses_are_met_forwards_before_and_backwards_behind_them() {
    let subject = subject();
    let mut replay = subject.replay("steering", 1.0);
    // The program's place in the buffer of its log.
    let word = subject.symbol("steering", "_SEGGER_RTT") + 36;
    let stops = |kind| Stops {
        watches: BTreeSet::from([Watch {
            first: word,
            last: word + 3,
            kind,
        }]),
        ..Stops::default()
    };
    let mut written = Vec::new();
    while let Halt::Stop(stop) = replay.forwards(stops(Watched::Writes), &mut never) {
        assert!(matches!(stop, Stop::Access(_)), "{stop:?}");
        let held = replay.mcu().memory(word, 4);
        assert_eq!(replay.step_back(), Halt::Stop(Stop::Step));
        assert_eq!(replay.mcu().memory(word, 4), held);
        let halt = replay.forwards(stops(Watched::Writes), &mut never);
        assert_eq!(halt, Halt::Stop(stop));
        written.push(replay.steps());
    }
    let mut changes = 0;
    for before in written.iter().rev() {
        let halt = replay.backwards(&stops(Watched::Writes), &mut never);
        assert!(matches!(halt, Halt::Stop(Stop::Access(_))), "{halt:?}");
        assert_eq!(replay.steps(), before + 1);
        let new = replay.mcu().memory(word, 4);
        replay.step_back();
        changes += usize::from(replay.mcu().memory(word, 4) != new);
    }
    // The test of the memory, and each line of the log.
    assert!(changes > 3, "{changes} of {}", written.len());
    let halt = replay.backwards(&stops(Watched::Writes), &mut never);
    assert_eq!(halt, Halt::Beginning);
    let halt = replay.forwards(stops(Watched::Reads), &mut never);
    assert!(matches!(halt, Halt::Stop(Stop::Access(_))), "{halt:?}");
}

#[test]
fn a_place_is_found_by_its_time_and_left_by_steps() {
    let mut replay = subject().replay("controller", 2.0);
    let time = seconds(1.234_567);
    assert_eq!(replay.go_to(time, &mut never), Halt::Stop(Stop::Time));
    let late = replay.mcu().now().as_ticks() - time.as_ticks();
    assert!(late <= 1_000_000_000, "{late} ps");
    let run_to = |replay: &mut Replay<()>, steps| {
        let stops = Stops {
            step: Some(steps),
            ..Stops::default()
        };
        let halt = replay.forwards(stops, &mut never);
        assert_eq!(halt, Halt::Stop(Stop::Step));
    };
    // The node may sleep; its next step is a place.
    let next = replay.steps() + 1;
    run_to(&mut replay, next);
    let at = place(&replay);
    for _ in 0..300 {
        assert_eq!(replay.step_back(), Halt::Stop(Stop::Step));
    }
    assert_eq!(replay.steps(), at.0 - 300);
    run_to(&mut replay, at.0);
    assert!(place(&replay) == at);
    replay.go_to(seconds(1.9), &mut never);
    assert!(replay.mcu().now() >= seconds(1.9));
    replay.go_to(at.1, &mut never);
    assert!(place(&replay) == at);
    let mut once = |_: &Replay<()>| true;
    assert_eq!(
        replay.forwards(Stops::default(), &mut once),
        Halt::Interrupted
    );
    let halt = replay.backwards(&breakpoint(0), &mut once);
    assert_eq!(halt, Halt::Interrupted);
    assert!(replay.mcu().now() > time, "it is where it was");
}

#[test]
fn a_change_holds_until_one_goes_back_behind_it() {
    const FREE: u32 = 0x2000_2000;
    let mut replay = subject().replay("steering", 2.0);
    replay.go_to(seconds(0.5), &mut never);
    let (at, now) = (replay.steps(), replay.mcu().now());
    let held = replay.mcu().memory(FREE, 4).unwrap();
    assert!(replay.change(|mcu| mcu.set_memory(FREE, b"mark")));
    assert!(replay.change(|mcu| mcu.set_memory(FREE, b"more")));
    let has = |replay: &Replay<()>| replay.mcu().memory(FREE, 4).unwrap();
    replay.go_to(seconds(1.5), &mut never);
    assert_eq!(has(&replay), b"more");
    replay.go_to(now, &mut never);
    assert_eq!((replay.steps(), has(&replay)), (at, b"more".to_vec()));
    assert_eq!(replay.step_back(), Halt::Stop(Stop::Step));
    assert_eq!(has(&replay), held);
    replay.go_to(seconds(1.5), &mut never);
    assert_eq!(has(&replay), held);
}
