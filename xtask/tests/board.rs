//! The tests of the boards can fail: each subject has a fault here that one of its tests finds, on
//! the virtual microcontroller. That they pass on a sound board is a step of `cargo xtask test`.

use std::sync::{Arc, OnceLock};

use can_bus::Tester;
use parts::{Pin, Sled};
use twin::mcu::{Board, Mcu};
use twin::network::Network;
use xtask::{
    Workspace,
    board::{Outcome, Surroundings, TestImage, run_on_twin, sound},
};

/// The tests of a board, built once.
fn image(sled: &'static Sled) -> Arc<TestImage> {
    static IMAGES: [OnceLock<Arc<TestImage>>; 2] = [const { OnceLock::new() }; 2];
    let place = Sled::ALL.iter().position(|other| *other == sled).unwrap();
    let build = || {
        let workspace = Workspace::find().unwrap();
        Arc::new(TestImage::build(&workspace, sled).unwrap())
    };
    Arc::clone(IMAGES[place].get_or_init(build))
}

/// How a test ends on this board and in these surroundings.
fn outcome(
    sled: &'static Sled,
    name: &str,
    board: &Board,
    around: &mut Surroundings<'_>,
) -> Outcome {
    let image = image(sled);
    let test = image.tests.iter().find(|test| test.name == name).unwrap();
    let verdict = run_on_twin(&image, test, board, around).unwrap();
    // A test that ends by itself has logged something.
    let ended = verdict.outcome == Outcome::Passed;
    assert!(!ended || !verdict.log.is_empty(), "{verdict:?}");
    verdict.outcome
}

/// Fails unless the test passes on a sound board, and fails with a sentence that begins so in these
/// surroundings.
#[track_caller]
fn found(sled: &'static Sled, name: &str, sentence: &str, fault: &mut dyn FnMut(&mut Network)) {
    let sound = sound(sled);
    let without = outcome(sled, name, &sound, &mut |_| {});
    assert_eq!(without, Outcome::Passed);
    judge(outcome(sled, name, &sound, fault), sentence);
}

#[track_caller]
fn judge(outcome: Outcome, sentence: &str) {
    let Outcome::Failed(why) = outcome else {
        panic!("the fault is not found");
    };
    assert!(why.starts_with(sentence), "{why}");
}

/// Acts once, as soon as the program has set this bit of a register.
fn once(register: u32, bit: u32, act: impl Fn(&mut Mcu)) -> impl FnMut(&mut Network) {
    let mut done = false;
    move |network| {
        let mcu = network.node_mut(0);
        let set = mcu.read_register(register).unwrap_or(0) & bit != 0;
        if set && !done {
            act(mcu);
            done = true;
        }
    }
}

const TIM2: u32 = 0x4000_0000;
const TIM3: u32 = 0x4000_0400;
const DMA1_CCR1: u32 = 0x4002_0008;
const CR1: u32 = 0x00;
const DIER: u32 = 0x0C;
const EGR: u32 = 0x14;
const CNT: u32 = 0x24;
const PSC: u32 = 0x28;
const ARR: u32 = 0x2C;
/// CR1: the timer counts.
const CEN: u32 = 1;

/// A time base that counts faster by a quarter or more.
fn wrong_prescaler() -> impl FnMut(&mut Network) {
    once(TIM2 + CR1, CEN, |mcu| {
        let prescaler = mcu.read_register(TIM2 + PSC).unwrap();
        mcu.write_register(TIM2 + PSC, prescaler - 1);
        // The update that loads the prescaler also clears the counter.
        let count = mcu.read_register(TIM2 + CNT).unwrap();
        mcu.write_register(TIM2 + EGR, 1);
        mcu.write_register(TIM2 + CNT, count);
    })
}

/// The other tests take the internal oscillator as it is: a Nucleo-F303K8 as delivered has no
/// other.
#[test]
fn a_missing_crystal_is_found_by_one_test() {
    for sled in Sled::ALL {
        let board = Board {
            external_clock: None,
            ..sound(sled)
        };
        for test in &image(sled).tests {
            let outcome = outcome(sled, &test.name, &board, &mut |_| {});
            if test.name == "the_external_clock_drives_the_core" {
                judge(outcome, "no external clock");
            } else {
                assert_eq!(outcome, Outcome::Passed, "{}", test.name);
            }
        }
    }
}

/// Start-up refuses a clock that is off by more than a tenth; the board runs on its internal
/// oscillator then.
#[test]
fn a_crystal_of_another_frequency_is_found() {
    for sled in Sled::ALL {
        for (hertz, name, why) in [
            (
                7_350_000,
                "the_core_is_as_fast_as_the_internal_oscillator_says",
                "core clock, kHz",
            ),
            (
                7_000_000,
                "the_external_clock_drives_the_core",
                "no external clock",
            ),
        ] {
            let board = Board {
                external_clock: Some(hertz),
                ..sound(sled)
            };
            judge(outcome(sled, name, &board, &mut |_| {}), why);
        }
    }
}

#[test]
fn a_wrong_prescaler_of_the_time_base_is_found() {
    let name = "the_time_base_divides_the_clock_of_the_core";
    found(Sled::F303, name, "core cycles", &mut wrong_prescaler());
    let name = "frames_follow_each_other_in_bit_times";
    found(
        Sled::F446,
        name,
        "ticks from end to end",
        &mut wrong_prescaler(),
    );
}

#[test]
fn an_alarm_that_does_not_come_is_found() {
    let name = "an_alarm_fires_at_its_instant";
    let mut mask = |network: &mut Network| {
        network.node_mut(0).write_register(TIM2 + DIER, 0);
    };
    found(Sled::F303, name, "no alarm", &mut mask);
}

#[test]
fn a_node_that_acknowledges_is_found() {
    let name = "a_failed_attempt_is_not_repeated";
    let mut first = true;
    let mut join = |network: &mut Network| {
        if std::mem::take(&mut first) {
            network.bus().add_tester(Tester::new());
        }
    };
    found(Sled::F303, name, "another node acknowledges", &mut join);
}

#[test]
fn a_converter_at_another_rate_is_found() {
    let name = "the_converter_fills_its_ring_at_the_rate_of_its_timer";
    let mut faster = once(TIM3 + CR1, CEN, |mcu| {
        let period = mcu.read_register(TIM3 + ARR).unwrap();
        mcu.write_register(TIM3 + ARR, period / 2);
    });
    found(Sled::F303, name, "ticks of a ring", &mut faster);
}

/// ADC1_2_CCR, and the bits that divide the converter's clock by four.
const CONVERTERS_CCR: u32 = 0x5000_0308;
const BY_FOUR: u32 = 0b11 << 16;

#[test]
fn a_converter_that_is_too_slow_is_found() {
    let name = "a_burst_by_software_takes_its_time_and_gives_both_means";
    let mut slower = |network: &mut Network| {
        let mcu = network.node_mut(0);
        if mcu.read_register(CONVERTERS_CCR) == Some(2 << 16) {
            mcu.write_register(CONVERTERS_CCR, BY_FOUR);
        }
    };
    found(Sled::F303, name, "the burst does not end", &mut slower);
    let name = "the_timer_begins_bursts_at_its_rate";
    let mut faster = once(TIM3 + CR1, CEN, |mcu| {
        let period = mcu.read_register(TIM3 + ARR).unwrap();
        mcu.write_register(TIM3 + ARR, period / 2);
    });
    found(Sled::F303, name, "ticks between bursts", &mut faster);
    // The DMA channel is off: nobody fetches the results.
    let name = "a_burst_that_is_begun_again_tells_and_ends";
    let mut stopped = |network: &mut Network| {
        network.node_mut(0).write_register(DMA1_CCR1, 0);
    };
    found(Sled::F303, name, "Err(Overrun)", &mut stopped);
}

/// The means that the tests log are those of the voltages at the inputs.
#[test]
fn the_means_are_those_of_the_inputs() {
    let image = image(Sled::F303);
    for name in [
        "a_burst_by_software_takes_its_time_and_gives_both_means",
        "the_timer_begins_bursts_at_its_rate",
    ] {
        let test = image.tests.iter().find(|test| test.name == name).unwrap();
        let mut voltages = |network: &mut Network| {
            let mcu = network.node_mut(0);
            mcu.set_analog(2, 1000);
            mcu.set_analog(4, 3001);
        };
        let verdict = run_on_twin(&image, test, &sound(Sled::F303), &mut voltages).unwrap();
        assert_eq!(verdict.outcome, Outcome::Passed);
        let means = verdict.log.iter().filter(|line| line.contains("left"));
        let lines: Vec<_> = means.collect();
        assert!(lines.len() >= 3, "{:?}", verdict.log);
        assert!(
            lines
                .iter()
                .all(|line| line.contains("left 16000, right 48016")),
            "{lines:?}"
        );
    }
}

#[test]
fn a_wrong_divider_of_a_serial_port_is_found() {
    const USART2_BRR: u32 = 0x4000_4408;
    const USART2_CR1: u32 = 0x4000_440C;
    const UE: u32 = 1 << 13;
    for (name, sentence) in [
        ("the_console_sends_at_its_rate", "edge, cycles"),
        (
            "lines_of_the_console_take_the_time_of_their_bytes",
            "ticks of three lines",
        ),
    ] {
        let mut slower = once(USART2_CR1, UE, |mcu| {
            let divider = mcu.read_register(USART2_BRR).unwrap();
            mcu.write_register(USART2_BRR, divider + divider / 20);
        });
        found(Sled::F446, name, sentence, &mut slower);
    }
}

#[test]
fn a_stuck_motor_line_is_found() {
    let stuck = |level| {
        move |network: &mut Network| {
            let line = Pin::new('A', 9);
            network.node_mut(0).drive_pin(line, Some(level));
        }
    };
    let name = "a_stop_reaches_the_motor_driver_as_one_byte";
    found(Sled::F303, name, "the line is not idle", &mut stuck(false));
    let name = "the_motor_driver_sees_a_stop_and_nothing_else_while_the_board_starts";
    found(Sled::F303, name, "levels: 1 instead of 5", &mut stuck(true));
}

#[test]
fn a_program_that_starts_again_has_not_passed() {
    let name = "an_alarm_in_the_past_fires_at_once";
    let mut press = once(TIM2 + CR1, CEN, |mcu| {
        mcu.hold_reset();
        mcu.release_reset();
    });
    found(
        Sled::F303,
        name,
        "the program has started again",
        &mut press,
    );
}
