//! Nodes with the devices of a rover: pulses reach its motors, voltages and levels reach the nodes.

mod program;

use can_bus::{SimDuration, SimTime};
use program::{Program, elf, vehicle};
use twin::part::Part;
use twin::{Images, Twin};
use vehicle_model::NodeIndex;
use world::rover::Side;
use world::time::{at, from_seconds, since, span_seconds};
use world::{Analog, Scenario};

/// Nodes of the vehicle, as in the world's tests.
const REMOTE: NodeIndex = NodeIndex(1);
const SENSORS: NodeIndex = NodeIndex(2);

const RCC: u32 = 0x4002_1000;
const PORT_A: u32 = 0x4800_0000;
const PORT_B: u32 = 0x4800_0400;
const TIM1: u32 = 0x4001_2C00;
const ADC1: u32 = 0x5000_0000;
const ADC_COMMON: u32 = 0x5000_0300;

/// Where the programs put what they read.
const RESULT: u32 = 0x2000_0000;

/// Runs on the internal oscillator of 8 MHz.
fn idle() -> Program {
    let mut program = Program::new();
    program.sleep_for_ever();
    program
}

/// Pulses every 5 ms: 1.6 ms on the left, 1.8 ms on the right.
fn motors() -> Program {
    let mut program = Program::new();
    program
        .open(RCC + 0x14, 1 << 17)
        .open(RCC + 0x18, 1 << 11)
        // PA7 and PA10 are outputs of TIM1; PA13 and PA14 stay with the debugger.
        .poke(PORT_A, 0x2800_0000 | 2 << 14 | 2 << 20)
        .poke(PORT_A + 0x20, 6 << 28)
        .poke(PORT_A + 0x24, 6 << 8)
        .poke(TIM1 + 0x28, 7)
        .poke(TIM1 + 0x2C, 4999)
        .poke(TIM1 + 0x34, 1600)
        .poke(TIM1 + 0x3C, 1800)
        .poke(TIM1 + 0x18, 0b110 << 4)
        .poke(TIM1 + 0x1C, 0b110 << 4)
        .poke(TIM1 + 0x14, 1)
        .poke(TIM1 + 0x20, 1 << 2 | 1 << 8)
        .poke(TIM1 + 0x44, 1 << 15)
        .poke(TIM1, 1)
        .sleep_for_ever();
    program
}

/// Appends a jump back to `to`.
fn again(program: &mut Program, to: usize) {
    let words = (to as isize - program.here() as isize - 4) / 2;
    assert!(words >= -1024, "the loop is too long");
    program.half(0xE000 | words as u16 & 0x7FF);
}

/// Converts channel 2 (left), then channel 4 (right), again and again.
fn sensors() -> Program {
    let mut program = Program::new();
    program
        .open(RCC + 0x14, 1 << 28 | 1 << 17)
        // PA1 and PA3 are analogue.
        .poke(PORT_A, 0x2800_0000 | 3 << 2 | 3 << 6)
        .poke(ADC_COMMON + 0x08, 1 << 16)
        .poke(ADC1 + 0x08, 0)
        .poke(ADC1 + 0x08, 1 << 28)
        .wait_cycles(100)
        .poke(ADC1 + 0x08, 1 << 28 | 1)
        .wait(ADC1, 1);
    let begin = program.here();
    for (rank, channel) in [2, 4].into_iter().enumerate() {
        program
            .poke(ADC1 + 0x30, channel << 6)
            .poke(ADC1 + 0x08, 1 << 28 | 1 | 1 << 2)
            .wait(ADC1, 1 << 2)
            .peek(ADC1 + 0x40)
            // STR r2, [r0]
            .constant(0, RESULT + 4 * rank as u32)
            .half(0x6002);
    }
    again(&mut program, begin);
    program
}

/// Reads the levels of port B, again and again.
fn remote() -> Program {
    let mut program = Program::new();
    program
        .open(RCC + 0x14, 1 << 18)
        // PB4 and PB5 are inputs, also for the part's own debugging.
        .poke(PORT_B, 0);
    let begin = program.here();
    program.peek(PORT_B + 0x10).constant(0, RESULT).half(0x6002);
    again(&mut program, begin);
    program
}

fn twin(scenario: &str) -> Twin {
    let vehicle = vehicle();
    let text = format!(
        "[[row.section]]\nkind = \"barriers\"\nlength = \"20 m\"\nwidth = \"2 m\"\n{scenario}"
    );
    let scenario = Scenario::parse(&vehicle, "t", "t", &text).unwrap();
    let images = Images::new(vec![
        elf(&idle(), Part::F446),
        elf(&remote(), Part::F303),
        elf(&sensors(), Part::F303),
        elf(&motors(), Part::F303),
    ]);
    Twin::new(&vehicle, &scenario, 1, &images).unwrap()
}

fn word(twin: &Twin, node: NodeIndex, index: u32) -> u32 {
    let bytes = twin.node(node).memory(RESULT + 4 * index, 4).unwrap();
    u32::from_le_bytes(bytes.try_into().unwrap())
}

fn time(seconds: f64) -> SimTime {
    at(from_seconds(seconds))
}

#[test]
fn pulses_of_a_node_drive_the_robot() {
    let mut twin = twin("");
    twin.run_until(time(1.0)).unwrap();
    let drive = twin.world().drive().unwrap();
    // 100 us and 300 us beyond neutral are 0.2 and 0.6 of 500 us. The node's oscillator and the
    // drivers' clocks are each off by up to 1 %, of the whole pulse.
    for (side, effort) in [(Side::Left, 0.2), (Side::Right, 0.6)] {
        let found = drive.efforts()[side as usize];
        assert!((found - effort).abs() < 0.08, "{side:?}: {found}");
        // One each 5 ms; the period of the first is not known.
        let counts = drive.driver(side).counts();
        assert!((195..=202).contains(&counts.valid), "{counts:?}");
        assert_eq!(counts.odd, 0);
    }
    let last = drive.samples().last().unwrap();
    assert!(last.state.speed > 0.3 && last.state.turn < -0.1, "{last:?}");
}

#[test]
fn the_begin_of_bursts_and_pulses_is_recorded() {
    let mut twin = twin("");
    twin.run_until(time(0.5)).unwrap();
    let chain = twin.chain();
    // The oscillator is off by up to 1 %.
    let expected = 0.5 / 0.005;
    for side in [Side::Left, Side::Right] {
        let begins = chain.pulses.iter().filter(|(_, of)| *of == side);
        let begins: Vec<SimTime> = begins.map(|(at, _)| *at).collect();
        assert!(
            (begins.len() as f64 - expected).abs() < 3.0,
            "{}",
            begins.len()
        );
        for pair in begins.windows(2) {
            let period = span_seconds(since(pair[1], pair[0]));
            assert!((period - 0.005).abs() < 60e-6, "{period}");
        }
    }
    // One conversion after the other, of 2 and of 4: the program's loop takes 60 us at 8 MHz.
    assert!(chain.samples.is_sorted() && chain.samples.len() > 5_000);
    let latencies: Vec<_> = chain.latencies().collect();
    // The first pulse of each side begins before the first sample.
    assert_eq!(latencies.len() + 2, chain.pulses.len());
    for latency in latencies {
        assert!(span_seconds(latency.since_sample) < 60e-6, "{latency:?}");
    }
}

#[test]
fn the_motors_rest_after_a_reset_of_their_node() {
    let mut twin = twin("[[reset]]\nnode = \"drive\"\nat = \"500 ms\"\n");
    twin.run_until(time(1.0)).unwrap();
    let rests = twin.world().drive().unwrap().rests();
    assert_eq!(rests.len(), 3, "{rests:?}");
    // The drivers take 100 ms without a pulse for a silence.
    let silent = span_seconds(since(rests[2].0, time(0.5)));
    assert!(rests[2].1 && (0.09..0.11).contains(&silent), "{rests:?}");
}

#[test]
fn voltages_of_the_sensors_reach_their_channels() {
    let fault = "[[distance_fault]]\nside = \"left\"\nfault = \"shorted-to-supply\"\nat = \"400 ms\"\n\
                 [[distance_fault]]\nside = \"right\"\nfault = \"open\"\nat = \"500 ms\"\n";
    let mut twin = twin(fault);
    let sees = |twin: &Twin| [word(twin, SENSORS, 0), word(twin, SENSORS, 1)];
    // Long enough for both sensors to have measured.
    twin.run_until(time(0.3)).unwrap();
    let before = sees(&twin);
    for (side, count) in [Side::Left, Side::Right].into_iter().zip(before) {
        let volts = twin.world().drive().unwrap().volts(side, twin.now());
        let expected = volts / 3.3 * 4095.0;
        assert!(
            (f64::from(count) - expected).abs() < 6.0 && count > 100,
            "{side:?}: {count} {expected}"
        );
    }
    assert!(
        twin.world()
            .analogs()
            .contains(&(SENSORS, Analog::Distance(Side::Left)))
    );
    twin.run_until(time(0.4) + SimDuration::from_ticks(2_000_000_000))
        .unwrap();
    let [left, right] = sees(&twin);
    assert!(left == 4095 && right > 100, "{left} {right}");
    twin.run_until(time(0.502)).unwrap();
    let [left, right] = sees(&twin);
    assert!(left == 4095 && right < 6, "{left} {right}");
}

#[test]
fn presses_of_the_remote_reach_its_pins() {
    let press = |button: &str, at: &str| format!("[[press]]\nat = {at:?}\nbutton = {button:?}\n");
    let presses = press("run", "100 ms") + &press("stop", "200 ms") + &press("run", "300 ms");
    let mut twin = twin(&presses);
    let mut levels = |seconds| {
        twin.run_until(time(seconds)).unwrap();
        let word = word(&twin, REMOTE, 0);
        (word >> 5 & 1, word >> 4 & 1)
    };
    assert_eq!(levels(0.05), (0, 0));
    assert_eq!(levels(0.15), (1, 0));
    assert_eq!(levels(0.25), (1, 1));
    assert_eq!(levels(0.35), (0, 1));
}
