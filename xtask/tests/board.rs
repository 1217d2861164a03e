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

const TIM1: u32 = 0x4001_2C00;
const CCMR1: u32 = 0x18;
/// CCMR1: PWM mode 1 of channel 1, without its preload.
const NO_PRELOAD: u32 = 0b110 << 4;
/// The pins of the servo pulses, left and right.
const SERVOS: [Pin; 2] = [Pin::new('A', 7), Pin::new('A', 10)];

#[test]
fn servo_pulses_that_are_wrong_are_found() {
    let neutral = "the_first_pulses_are_neutral_and_follow_in_their_period";
    let mut slower = once(TIM1 + CR1, CEN, |mcu| {
        let prescaler = mcu.read_register(TIM1 + PSC).unwrap();
        mcu.write_register(TIM1 + PSC, prescaler + 1);
    });
    found(Sled::F303, neutral, "left pulse, us: 1520", &mut slower);
    let next = "a_width_counts_from_the_next_pulse";
    let mut at_once = once(TIM1 + CR1, CEN, |mcu| {
        mcu.write_register(TIM1 + CCMR1, NO_PRELOAD);
    });
    found(Sled::F303, next, "left pulse, us", &mut at_once);
    for (pin, level, sentence) in [
        (SERVOS[0], true, "a line is not low"),
        (SERVOS[1], false, "the pulses do not begin together"),
    ] {
        let mut stuck = |network: &mut Network| network.node_mut(0).drive_pin(pin, Some(level));
        found(Sled::F303, neutral, sentence, &mut stuck);
    }
}

#[test]
fn a_stuck_line_of_the_remote_control_is_found() {
    let name = "open_lines_of_the_remote_control_are_low_and_each_is_read_by_itself";
    let mut stuck = |network: &mut Network| {
        network.node_mut(0).drive_pin(Pin::new('B', 5), Some(true));
    };
    found(Sled::F303, name, "an open line is high", &mut stuck);
    let mut open = |network: &mut Network| {
        network.node_mut(0).drive_pin(Pin::new('B', 4), Some(false));
    };
    found(
        Sled::F303,
        name,
        "run and stop are (false, false)",
        &mut open,
    );
}

/// A pulse: when it began, and its width, in picoseconds.
type Pulse = (u64, u64);

/// Runs a test with the servo outputs and gives how it ends and the pulses at both pins. `around` is
/// called every 50 us.
fn servo_pulses(name: &str, around: &mut dyn FnMut(&mut Network)) -> (Outcome, [Vec<Pulse>; 2]) {
    let image = image(Sled::F303);
    let test = image.tests.iter().find(|test| test.name == name).unwrap();
    let mut changes = Vec::new();
    let verdict = run_on_twin(&image, test, &sound(Sled::F303), &mut |network| {
        around(network);
        changes.extend(network.node_mut(0).drain_pins());
    });
    let pulses = SERVOS.map(|pin| {
        let own: Vec<_> = changes.iter().filter(|change| change.pin == pin).collect();
        let whole = own.chunks_exact(2).map(|edges| {
            assert!(edges[0].high && !edges[1].high, "{edges:?}");
            let began = edges[0].at.as_ticks();
            (began, edges[1].at.as_ticks() - began)
        });
        whole.collect()
    });
    (verdict.unwrap().outcome, pulses)
}

const US: u64 = 1_000_000;

/// The edges of a test that commands pulses at all phases: each pulse has a width that was
/// commanded, to 20 ns, both begin together, as one command says, and no two within 3 ms.
#[test]
fn no_command_cuts_or_lengthens_a_servo_pulse() {
    let name = "a_command_at_any_phase_leaves_every_pulse_whole";
    let (outcome, [left, right]) = servo_pulses(name, &mut |_| {});
    assert_eq!(outcome, Outcome::Passed);
    // The test may end while the pulses of one side have not.
    assert!(left.len() > 250 && left.len().abs_diff(right.len()) <= 1);
    for (left, right) in left.iter().zip(&right) {
        assert_eq!(left.0, right.0, "they begin together");
        let us = [left, right].map(|(_, width)| (width + US / 2) / US);
        for (us, (_, width)) in us.iter().zip([left, right]) {
            assert!((us * US).abs_diff(*width) < US / 50, "{width} ps");
        }
        let command = us[0] - 1000;
        let neutral = us == [1500, 1500];
        assert!(
            neutral || command < 490 && us[1] == 2000 - command,
            "{us:?}"
        );
    }
    let gaps: Vec<u64> = left.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    let bounds = (
        gaps.iter().min().unwrap() / US,
        gaps.iter().max().unwrap() / US,
    );
    // The crystal has no error; the longest gap is the period.
    assert!(
        bounds.0 >= 3000 && bounds.0 < 3005 && bounds.1 == 3300,
        "{bounds:?}"
    );
}

/// The external clock stops in the middle of a pulse: both lines are low from then on, until the
/// program ends for it. Without the break input the pulse would last nine times as long.
#[test]
fn a_lost_clock_ends_the_servo_pulses_in_hardware() {
    let name = "a_width_counts_from_the_next_pulse";
    let mut lost = None;
    let mut lose = |network: &mut Network| {
        let now = network.now().as_ticks();
        let mcu = network.node_mut(0);
        if lost.is_none() && mcu.pin(SERVOS[0]) && mcu.pin(SERVOS[1]) {
            assert!(mcu.lose_external_clock());
            lost = Some(now);
        }
    };
    let (outcome, pulses) = servo_pulses(name, &mut lose);
    judge(outcome, "the program has started again");
    let lost = lost.unwrap();
    for pulses in pulses {
        let [(began, width)] = pulses[..] else {
            panic!("one pulse: {pulses:?}");
        };
        assert!(began < lost && began + width < lost + US, "{pulses:?}");
        assert!(width < 1500 * US);
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
