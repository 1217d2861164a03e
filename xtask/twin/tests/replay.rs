//! A run in which a debugger goes forwards and backwards, over so long a time that most states are forgotten.

mod program;

use can_bus::{RecordKind, SimDuration, SimTime};
use program::{Program, elf, vehicle};
use std::collections::BTreeSet;
use twin::part::Part;
use twin::replay::{Companion, Halt, Replay};
use twin::stops::{Stop, Stops};
use twin::{Images, Twin};
use vehicle_model::NodeIndex;
use world::Scenario;

const NODE: NodeIndex = NodeIndex(1);
const SECOND: u64 = 1_000_000_000_000;
/// Length of the run, s; older states are forgotten anew after 330 s.
const RUN: u64 = 340;
const COUNTER: u32 = 0x2000_0100;

/// SysTick of 8 MHz adds one to a word every 5 ms.
fn counting() -> Program {
    let mut program = Program::new();
    program
        .poke(COUNTER, 0)
        .poke(0xE000_E014, 40_000 - 1)
        .poke(0xE000_E018, 0)
        .poke(0xE000_E010, 0b111)
        .sleep_for_ever();
    program.handler(15);
    // ADDS r2, #1; STR r2, [r0]
    program.peek(COUNTER).half(0x3201).half(0x6002);
    program.return_from_handler();
    program
}

/// A row of barriers, with more lines in front of it.
fn scenario(more: &str) -> Scenario {
    let row = "[[row.section]]\nkind = \"barriers\"\nlength = \"20 m\"\nwidth = \"2 m\"\n";
    Scenario::parse(&vehicle(), "t", "t", &format!("{more}{row}")).unwrap()
}

fn twin() -> Twin {
    of(&scenario(""))
}

fn of(scenario: &Scenario) -> Twin {
    let vehicle = vehicle();
    let mut idle = Program::new();
    idle.sleep_for_ever();
    let node = |node: usize| match node {
        0 => elf(&idle, Part::F446),
        1 => elf(&counting(), Part::F303),
        _ => elf(&idle, Part::F303),
    };
    let images = Images::new((0..4).map(node).collect());
    Twin::new(&vehicle, scenario, 1, &images).unwrap()
}

/// Counts the steps of the vehicle, and those that it has seen for the first time.
#[derive(Clone, Default)]
struct Counts {
    all: u64,
    fresh: u64,
}

impl Companion for Counts {
    fn accompany(&mut self, _: &mut Twin, fresh: bool) {
        self.all += 1;
        self.fresh += u64::from(fresh);
    }
}

fn replay(seconds: u64) -> Replay<Counts> {
    let end = SimTime::from_ticks(seconds * SECOND);
    let span = SimDuration::from_ticks(SECOND);
    Replay::new(twin(), Counts::default(), NODE, end, span).unwrap()
}

fn never(_: &Replay<Counts>) -> bool {
    false
}

fn counter(replay: &Replay<Counts>) -> u32 {
    let bytes = replay.mcu().memory(COUNTER, 4).unwrap();
    u32::from_le_bytes(bytes.try_into().unwrap())
}

#[test]
fn a_long_run_keeps_a_bounded_number_of_states_and_still_goes_back() {
    let mut replay = replay(RUN);
    let end = SimTime::from_ticks(RUN * SECOND);
    assert_eq!(replay.forwards(Stops::default(), &mut never), Halt::End);
    let states = replay.states();
    assert!((150..=300).contains(&states), "{states}");
    let all = counter(&replay);
    // The internal oscillator is off by up to 1 %.
    assert!(all.abs_diff(RUN as u32 * 200) <= 2 * RUN as u32, "{all}");
    let steps = replay.companion().all;
    assert_eq!(replay.companion().fresh, steps);

    // The handler of each count, from the last one on.
    let vector = replay.mcu().memory(0x0800_0000 + 4 * 15, 4).unwrap();
    let handler = u32::from_le_bytes(vector.try_into().unwrap()) & !1;
    let stops = Stops {
        breakpoints: BTreeSet::from([handler]),
        ..Stops::default()
    };
    for before in 1..=3 {
        let halt = replay.backwards(&stops, &mut never);
        assert_eq!(halt, Halt::Stop(Stop::Breakpoint));
        assert_eq!(counter(&replay), all - before);
    }
    for second in [330, 300, 17, 250] {
        let time = SimTime::from_ticks(second * SECOND);
        assert_eq!(replay.go_to(time, &mut never), Halt::Stop(Stop::Time));
        let wanted = (u64::from(all) * second / RUN) as u32;
        assert!(counter(&replay).abs_diff(wanted) <= 1, "{second} s");
    }
    assert_eq!(replay.forwards(Stops::default(), &mut never), Halt::End);
    assert_eq!((counter(&replay), replay.mcu().now() >= end), (all, true));
    // Each way led through the same steps of the vehicle, and none of them was new.
    assert_eq!(replay.companion().all, steps);
    assert_eq!(replay.states(), states);
}

/// The images would be those of another vehicle than the scenario's.
#[test]
fn a_scenario_of_a_changed_vehicle_is_refused_by_the_unchanged_one() {
    let scenario = scenario("set = [\"rover.cruise=0.3\"]\n");
    let refused = Twin::new(&vehicle(), &scenario, 1, &Images::default())
        .err()
        .unwrap();
    assert_eq!(
        refused.to_string(),
        "scenario t is one of a vehicle with rover.cruise=0.3, which this one was not built with"
    );
}

/// No node has the number of the babbler, but one of them has its line.
#[test]
fn a_babbler_is_on_the_line_of_its_node() {
    let babble = "[[babble]]\nnode = \"drive\"\nat = \"2 ms\"\nuntil = \"4 ms\"\nid = 0\n";
    let mut twin = of(&scenario(babble));
    twin.run_until(SimTime::from_ticks(SECOND / 100)).unwrap();
    let outcome = twin.finish();
    let mut records = outcome.records.iter();
    let begun = records.find(|record| matches!(record.kind, RecordKind::FrameStart { .. }));
    let babbler = begun.unwrap().node;
    assert_eq!(outcome.node_at(babbler), None);
    assert_eq!(outcome.line_of(babbler), Some(NodeIndex(3)));
}
