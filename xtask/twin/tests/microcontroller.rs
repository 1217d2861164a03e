//! Small programs, assembled by hand, on complete microcontrollers.

mod program;

use can_bus::{SimDuration, SimTime};
use program::{Program, VECTORS};
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex};
use twin::ResetCause;
use twin::debugger::Ended;
use twin::mcu::{Board, Executed, FlashTiming, Mcu, Seen, Storer};
use twin::part::{Part, Pin};

const MS: u64 = 1_000_000_000;
const US: u64 = 1_000_000;

fn at(ps: u64) -> SimTime {
    SimTime::from_ticks(ps)
}

fn run(mcu: &mut Mcu, until: u64) {
    while mcu.now() < at(until) {
        mcu.run_until(at(until));
    }
}

fn to_180_mhz(program: &mut Program) {
    program
        .open(0x4002_3840, 1 << 28)
        .poke(0x4002_3800, 0x0005_0083)
        .wait(0x4002_3800, 1 << 17)
        .poke(0x4002_3804, 4 | 180 << 6 | 1 << 22 | 2 << 24 | 2 << 28)
        .poke(0x4002_3800, 0x0105_0083)
        .poke(0x4000_7000, 0xC000 | 1 << 16)
        .wait(0x4000_7004, 1 << 16)
        .poke(0x4000_7000, 0xC000 | 3 << 16)
        .wait(0x4000_7004, 1 << 17)
        .poke(0x4002_3C00, 0x705)
        .wait(0x4002_3800, 1 << 25)
        .poke(0x4002_3808, 0b101 << 10 | 0b100 << 13)
        .wait_cycles(16)
        .poke(0x4002_3808, 0b101 << 10 | 0b100 << 13 | 2)
        .wait(0x4002_3808, 0b1000);
}

fn to_72_mhz(program: &mut Program) {
    program
        .poke(0x4002_1000, 0x0005_0083)
        .wait(0x4002_1000, 1 << 17)
        .poke(0x4002_2000, 0x12)
        .poke(0x4002_1004, 7 << 18 | 1 << 16 | 0b100 << 8)
        .poke(0x4002_1000, 0x0105_0083)
        .wait(0x4002_1000, 1 << 25)
        .poke(0x4002_1004, 7 << 18 | 1 << 16 | 0b100 << 8 | 2)
        .wait(0x4002_1004, 0b1000);
}

#[test]
fn both_parts_reach_their_clock_and_sleep() {
    let mut program = Program::new();
    to_180_mhz(&mut program);
    program.sleep_for_ever();
    let mut mcu = program.start(Part::F446, &Board::default());
    run(&mut mcu, 10 * MS);
    assert_eq!((mcu.core_hz(), mcu.is_asleep()), (180_000_000, true));
    assert!(mcu.unmodelled().is_empty());
    assert_eq!(mcu.violations(), []);

    let mut program = Program::new();
    to_72_mhz(&mut program);
    program.sleep_for_ever();
    let mut mcu = program.start(Part::F303, &Board::default());
    run(&mut mcu, 10 * MS);
    assert_eq!((mcu.core_hz(), mcu.is_asleep()), (72_000_000, true));
    assert_eq!(mcu.violations(), []);
    // OSC_IN is not connected: the program keeps running on the internal oscillator and waits for
    // ever.
    let board = Board {
        external_clock: None,
        ..Board::default()
    };
    let mut mcu = program.start(Part::F303, &board);
    run(&mut mcu, 10 * MS);
    assert_eq!((mcu.core_hz(), mcu.is_asleep()), (8_000_000, false));
}

/// A store, and the register and flags to wait for afterwards.
type Step = (u32, u32, Option<(u32, u32)>);

/// The violations of a program that brings a part to its highest clock with some of the writes
/// left out or changed.
fn violations(part: &'static Part, change: impl Fn(u32, u32) -> Option<u32>) -> Vec<String> {
    let mut program = Program::new();
    if part == Part::F446 {
        program.open(0x4002_3840, 1 << 28);
    }
    let steps: &[Step] = if part == Part::F446 {
        &[
            (0x4002_3800, 0x0005_0083, Some((0x4002_3800, 1 << 17))),
            (
                0x4002_3804,
                4 | 180 << 6 | 1 << 22 | 2 << 24 | 2 << 28,
                None,
            ),
            (0x4002_3800, 0x0105_0083, Some((0x4002_3800, 1 << 25))),
            (0x4000_7000, 0xC000 | 1 << 16, Some((0x4000_7004, 1 << 16))),
            (0x4000_7000, 0xC000 | 3 << 16, Some((0x4000_7004, 1 << 17))),
            (0x4002_3C00, 0x705, None),
            (0x4002_3808, 0b101 << 10 | 0b100 << 13, None),
            (0x4002_3808, 0b101 << 10 | 0b100 << 13 | 2, None),
            (0x4002_3C00, 0x705, None),
        ]
    } else {
        &[
            (0x4002_1000, 0x0005_0083, Some((0x4002_1000, 1 << 17))),
            (0x4002_2000, 0x12, None),
            (0x4002_1004, 7 << 18 | 1 << 16 | 0b100 << 8, None),
            (0x4002_1000, 0x0105_0083, Some((0x4002_1000, 1 << 25))),
            (0x4002_1004, 7 << 18 | 1 << 16 | 0b100 << 8 | 2, None),
            (0x4002_2000, 0x12, None),
        ]
    };
    for &(address, value, flag) in steps {
        if let Some(value) = change(address, value) {
            program.poke(address, value);
            if let Some((register, mask)) = flag {
                program.wait(register, mask);
            }
            program.wait_cycles(16);
        }
    }
    program.sleep_for_ever();
    let mut mcu = program.start(part, &Board::default());
    run(&mut mcu, 10 * MS);
    mcu.violations().iter().map(ToString::to_string).collect()
}

fn only(violations: &[String], part: &str) {
    assert!(
        violations.len() == 1 && violations[0].contains(part),
        "{violations:#?}"
    );
}

#[test]
fn a_clock_beyond_a_limit_is_a_violation() {
    const ACR: u32 = 0x4002_3C00;
    const PLLCFGR: u32 = 0x4002_3804;
    const CFGR: u32 = 0x4002_3808;
    assert!(violations(Part::F446, |_, value| Some(value)).is_empty());
    assert!(violations(Part::F303, |_, value| Some(value)).is_empty());
    // No wait states at all.
    let found = violations(Part::F446, |at, value| (at != ACR).then_some(value));
    only(
        &found,
        "0 wait states of the flash at a core clock of 180 MHz",
    );
    let found = violations(Part::F303, |at, value| (at != 0x4002_2000).then_some(value));
    only(
        &found,
        "0 wait states of the flash at a core clock of 72 MHz",
    );
    // Prescalers only together with the switch: they may take 16 cycles to take effect.
    let found = violations(Part::F446, |at, value| {
        (at != CFGR || value & 3 != 0).then_some(value)
    });
    assert!(found[0].contains("APB1 can run at 180 MHz"), "{found:#?}");
    assert!(found[1].contains("APB2 can run at 180 MHz"), "{found:#?}");
    // No over-drive.
    let found = violations(Part::F446, |at, value| (at != 0x4000_7000).then_some(value));
    only(&found, "without over-drive");
    // 8 MHz into the PLL.
    let undivided = |at, value| {
        Some(if at == PLLCFGR {
            value & !0x3F | 2
        } else {
            value
        })
    };
    let found = violations(Part::F446, undivided);
    assert!(found[0].contains("PLL input 4 MHz"), "{found:#?}");
}

#[test]
fn the_violations_of_the_clocks_name_their_order() {
    // The prescalers are lowered before the clock: fewer than 16 cycles are not enough.
    for (gap, breaches) in [(0, 2), (11, 2), (12, 0)] {
        let mut program = Program::new();
        to_180_mhz(&mut program);
        program
            .poke(0x4002_3808, 0b101 << 10 | 0b100 << 13)
            .wait_clear(0x4002_3808, 0b1100)
            .poke(0x4002_3808, 0)
            .wait_cycles(16)
            .poke(0x4002_3808, 0b101 << 10 | 0b100 << 13)
            .wait_cycles(gap)
            // The program's constants take four cycles, the store before them two.
            .constant(0, 0x4002_3808)
            .constant(1, 0b101 << 10 | 0b100 << 13 | 2);
        program.half(0x6001).sleep_for_ever();
        let mut mcu = program.start(Part::F446, &Board::default());
        run(&mut mcu, 10 * MS);
        let found: Vec<_> = mcu.violations();
        assert_eq!(found.len(), breaches, "{gap}: {found:#?}");
    }
}

const GPIOA: u32 = 0x4002_0000;
const LED: Pin = Pin::new('A', 5);

/// TIM2 counts at 18 MHz and interrupts at 18000 and 36000. The handler toggles the LED and
/// advances the compare value.
fn blinker() -> Program {
    let mut program = Program::new();
    to_180_mhz(&mut program);
    program
        .open(0x4002_3830, 1 << 20 | 1)
        .poke(GPIOA, 0xA800_0000 | 1 << 10)
        .open(0x4002_3840, 1 << 28 | 1)
        .poke(0x4000_0028, 4)
        .poke(0x4000_0014, 1)
        .poke(0x4000_0010, 0)
        .poke(0x4000_0034, 18_000)
        .poke(0x4000_000C, 1 << 1)
        .enable(28)
        .poke(GPIOA + 0x18, 1 << 5)
        .poke(0x4000_0000, 1)
        .sleep_for_ever();
    program.handler(16 + 28);
    program
        .poke(0x4000_0010, 0)
        .peek(GPIOA + 0x14)
        // MOVS r3, #32; EORS r2, r3; STR r2, [r0]
        .half(0x2320)
        .half(0x405A)
        .half(0x6002)
        .peek(0x4000_0034)
        // ADD r2, r2, r3 with r3 = 18000; STR r2, [r0]
        .constant(3, 18_000)
        .half(0x441A)
        .half(0x6002)
        .return_from_handler();
    program
}

#[test]
fn a_sleeping_core_wakes_in_the_cycle_of_the_compare_match() {
    let mut mcu = blinker().start(Part::F446, &Board::default());
    run(&mut mcu, 50 * MS);
    let edges = mcu.drain_pins();
    assert!(edges.len() > 40);
    assert!(edges.iter().all(|edge| edge.pin == LED));
    // 18000 ticks of 18 MHz are exactly a millisecond, because the same instructions run between
    // the match and the pin each time.
    for pair in edges.windows(2).skip(1) {
        assert_eq!(pair[1].at.as_ticks() - pair[0].at.as_ticks(), MS);
        assert_ne!(pair[0].high, pair[1].high);
    }
    let load = mcu.load();
    let [task] = &load.tasks[..] else {
        panic!("one task: {load:?}");
    };
    assert_eq!(task.exception, 44);
    assert_eq!(task.activations as usize, edges.len() - 1);
    // Two loads and three stores of two cycles, fourteen other instructions of one.
    assert_eq!(task.longest, 5 * 2 + 14);
    assert_eq!(task.longest_response, 12 + task.longest + 10);
}

#[test]
fn wait_states_cost_the_cycles_that_prefetch_and_caches_leave() {
    let blinking = |acr: u32| {
        // SysTick every 1000 cycles; its handler is 40 instructions of one cycle in five
        // lines.
        let mut program = Program::new();
        program
            .poke(0x4002_3C00, acr)
            .poke(0xE000_E014, 999)
            .poke(0xE000_E018, 0)
            .poke(0xE000_E010, 7)
            .sleep_for_ever();
        // Skip the flash line after the sleeping program's, because it is already prefetched.
        let end = program.here();
        while program.here() < end + 16 || !program.here().is_multiple_of(16) {
            program.half(0xBF00);
        }
        program.handler(15);
        for _ in 0..39 {
            program.half(0xBF00);
        }
        program.return_from_handler();
        let board = Board {
            flash: FlashTiming::WaitStates,
            ..Board::default()
        };
        let mut mcu = program.start(Part::F446, &board);
        run(&mut mcu, 10 * MS);
        mcu.load().tasks[0].clone()
    };
    let lines = 5;
    // No prefetch and no cache: each line waits in full, the first one again in each activation.
    let plain = blinking(5);
    assert_eq!(plain.longest, 40 + 5 * lines);
    assert_eq!(plain.total, plain.activations * (40 + 5 * lines));
    // Prefetch: executing a line lasts eight cycles and reading the next one takes six.
    let ahead = blinking(5 | 1 << 8);
    assert_eq!(ahead.longest, 40 + 5);
    // Cached: only the first activation waits.
    let cached = blinking(5 | 1 << 9);
    assert_eq!(cached.total, cached.activations * 40 + 5 * lines);
}

#[test]
fn a_fast_crystal_makes_everything_early() {
    let board = Board {
        crystal_ppb: 50_000,
        ..Board::default()
    };
    let mut mcu = blinker().start(Part::F446, &board);
    run(&mut mcu, 50 * MS);
    let edges = mcu.drain_pins();
    let [.., a, b] = &edges[..] else {
        panic!("edges");
    };
    let period = b.at.as_ticks() - a.at.as_ticks();
    assert!(period.abs_diff(MS - 50_000) < 100, "{period}");
}

#[test]
fn the_same_program_does_the_same_in_slices_of_any_length() {
    let mut whole = blinker().start(Part::F446, &Board::default());
    run(&mut whole, 30 * MS);
    let mut sliced = blinker().start(Part::F446, &Board::default());
    let mut t = 0;
    for k in 0.. {
        t += 1 + k * 7_919 % (90 * US);
        run(&mut sliced, t.min(30 * MS));
        if t >= 30 * MS {
            break;
        }
    }
    assert_eq!(whole.drain_pins(), sliced.drain_pins());
    assert_eq!(whole.load().tasks, sliced.load().tasks);
}

#[test]
fn the_watchdog_resets_and_ram_survives() {
    let mut program = Program::new();
    program
        .poke(0x4000_3000, 0xCCCC)
        .poke(0x4000_3000, 0x5555)
        .poke(0x4000_3004, 1)
        .poke(0x4000_3008, 99)
        // Counts its starts at 0x2000_1000. The shorter timeout applies once the update is done.
        .peek(0x2000_1000)
        .half(0x3201)
        .half(0x6002)
        .wait(0x4000_300C, 0)
        .peek(0x4000_300C)
        .half(0x2A00)
        .half(0xD1FA)
        .poke(0x4000_3000, 0xAAAA)
        .sleep_for_ever();
    let mut mcu = program.start(Part::F446, &Board::default());
    // 100 counts of 8 / 32 kHz, which is 25 ms, and some time for the start.
    run(&mut mcu, 110 * MS);
    let causes: Vec<_> = mcu.resets().iter().map(|(_, cause)| *cause).collect();
    assert_eq!(causes[0], ResetCause::PowerOn);
    assert_eq!(causes[1..], [ResetCause::Watchdog; 4]);
    let period = mcu.resets()[3].0.as_ticks() - mcu.resets()[2].0.as_ticks();
    assert!((25 * MS..26 * MS).contains(&period), "{period}");
    assert_eq!(mcu.memory(0x2000_1000, 4), Some(vec![5, 0, 0, 0]));
}

#[test]
fn the_program_can_reset_itself_and_reads_why() {
    let mut program = Program::new();
    program
        .peek(0x4002_3874)
        .constant(0, 0x2000_1000)
        // LDR r3, [r0]: the first start leaves its flags and resets, the second sleeps.
        .half(0x6803)
        .half(0x6002)
        // CMP r3, #0; BNE over the reset
        .half(0x2B00)
        .half(0xD109)
        .poke(0xE000_ED0C, 0x05FA_0004)
        .half(0xE7FE)
        .sleep_for_ever();
    let mut mcu = program.start(Part::F446, &Board::default());
    run(&mut mcu, MS);
    run(&mut mcu, 2 * MS);
    let causes: Vec<_> = mcu.resets().iter().map(|(_, cause)| *cause).collect();
    assert_eq!(causes, [ResetCause::PowerOn, ResetCause::Software]);
    assert!(mcu.is_asleep());
    let flags = mcu.memory(0x2000_1000, 4).expect("RAM");
    assert_eq!(flags[3] & 0x1C, 0x1C, "pin, power and software");
}

#[test]
fn a_part_held_in_reset_stands_still_and_starts_anew() {
    let mut mcu = blinker().start(Part::F446, &Board::default());
    run(&mut mcu, 10 * MS);
    mcu.hold_reset();
    mcu.drain_pins();
    run(&mut mcu, 30 * MS);
    assert_eq!(mcu.drain_pins(), []);
    assert_eq!(mcu.core_hz(), 16_000_000);
    mcu.release_reset();
    run(&mut mcu, 40 * MS);
    assert!(mcu.drain_pins().len() > 5);
    // In the first cycle of 16 MHz after the release.
    let &(released, cause) = mcu.resets().last().expect("a reset");
    assert_eq!(cause, ResetCause::Pin);
    assert!(released.as_ticks() - 30 * MS < 62_500, "{released:?}");
}

#[test]
fn a_scan_of_two_channels_arrives_in_memory_by_dma() {
    let mut program = Program::new();
    program
        .open(0x4002_3830, 1 << 20 | 1 << 22)
        .open(0x4002_3840, 1 << 1)
        .open(0x4002_3844, 1 << 8)
        // DMA2 stream 0: half-words, circular, memory increment.
        .poke(0x4002_6414, 4)
        .poke(0x4002_6418, 0x4001_204C)
        .poke(0x4002_641C, 0x2000_1000)
        .poke(0x4002_6410, 1 << 13 | 1 << 11 | 1 << 10 | 1 << 8 | 1)
        // ADC1: scan of channels 0 and 1 on TIM3's TRGO.
        .poke(0x4001_2004, 1 << 8)
        .poke(0x4001_202C, 1 << 20)
        .poke(0x4001_2034, 1 << 5)
        .poke(0x4001_2008, 1 | 1 << 8 | 1 << 9 | 8 << 24 | 1 << 28)
        // TIM3: 16 MHz / 16 / 5000, update as TRGO.
        .poke(0x4000_0428, 15)
        .poke(0x4000_042C, 4999)
        .poke(0x4000_0414, 1)
        .poke(0x4000_0404, 2 << 4)
        .poke(0x4000_0400, 1)
        .sleep_for_ever();
    let mut mcu = program.start(Part::F446, &Board::default());
    mcu.set_analog(0, 0x123);
    mcu.set_analog(1, 0x456);
    // Until MMS is set, TRGO follows the UG bit: a first scan starts at once, the next one 5 ms
    // later.
    run(&mut mcu, 6 * MS);
    mcu.set_analog(0, 0x789);
    run(&mut mcu, 11 * MS);
    let memory = mcu.memory(0x2000_1000, 8).expect("RAM");
    let counts: Vec<_> = memory
        .chunks(2)
        .map(|pair| u16::from_le_bytes([pair[0], pair[1]]))
        .collect();
    assert_eq!(counts, [0x789, 0x456, 0x123, 0x456]);
}

/// USART1 at 1 Mbaud from 16 MHz, received by DMA2 stream 2 into a ring at 0x2000_1000. The
/// program then waits for a byte, which comes `cycle` cycles after a fixed instant; `acknowledge`
/// is what it does about it, with SR in r2 and the address of SR in r0.
fn receives(acknowledge: &[u16], cycle: u64) -> (Mcu, u8) {
    let mut program = Program::new();
    program
        .open(0x4002_3830, 1 << 20 | 1 << 22 | 1)
        .open(0x4002_3844, 1 << 4)
        .poke(0x4002_0024, 7 << 8)
        .poke(0x4002_0000, 0xA800_0000 | 2 << 20)
        .poke(0x4002_6440 + 4, 16)
        .poke(0x4002_6440 + 8, 0x4001_1004)
        .poke(0x4002_6440 + 12, 0x2000_1000)
        .poke(0x4002_6440, 4 << 25 | 1 << 10 | 1 << 8 | 1)
        .poke(0x4001_1008, 16)
        .poke(0x4001_1014, 1 << 6)
        .poke(0x4001_100C, 1 << 13 | 1 << 2)
        .constant(0, 0x4001_1000)
        .constant(3, 1 << 5);
    // loop: LDR r2, [r0]; TST r2, r3; BEQ loop
    program.half(0x6802).half(0x421A).half(0xD0FC);
    for &instruction in acknowledge {
        program.half(instruction);
    }
    program.sleep_for_ever();
    let mut mcu = program.start(Part::F446, &Board::default());
    run(&mut mcu, MS / 2);
    mcu.feed_uart(1, b"x", at(MS + cycle * 62_500), 1_000_000);
    run(&mut mcu, 2 * MS);
    let stored = mcu.memory(0x2000_1000, 1).expect("RAM")[0];
    (mcu, stored)
}

#[test]
fn a_byte_that_the_program_reads_before_the_dma_is_lost_to_the_ring() {
    // LDR r4, [r0, #4]: the program reads DR as soon as it sees the byte, four cycles after the
    // status. The DMA needs six. So it depends on the cycle who comes first.
    let mut lost = 0;
    for cycle in 0..12 {
        let (mut mcu, stored) = receives(&[0x6844], cycle);
        assert_eq!(mcu.register(4), u32::from(b'x'));
        let left = mcu.read_register(0x4002_6444);
        match stored {
            0 => lost += u32::from(left == Some(16)),
            byte => assert_eq!((byte, left), (b'x', Some(15))),
        }
        // A program that leaves the byte to the DMA.
        let (mut mcu, stored) = receives(&[], cycle);
        assert_eq!(stored, b'x');
        assert_eq!(mcu.read_register(0x4002_6444), Some(15));
    }
    assert!((2..=6).contains(&lost), "{lost}");
}

#[test]
fn bytes_leave_by_dma_only_on_the_pin_that_is_theirs() {
    let program = |function: u32| {
        let mut program = Program::new();
        program
            .open(0x4002_1014, 1 | 1 << 17)
            .open(0x4002_101C, 1 << 17)
            .poke(0x4800_0020, function << 8)
            .poke(0x4800_0000, 0xA800_0000 | 2 << 4)
            .poke(0x2000_1000, u32::from_le_bytes(*b"plow"))
            // DMA1 channel 7: 8 bits, memory to peripheral.
            .poke(0x4002_0084, 4)
            .poke(0x4002_0088, 0x4000_4428)
            .poke(0x4002_008C, 0x2000_1000)
            // USART2 at 115200 from 8 MHz.
            .poke(0x4000_440C, 69)
            .poke(0x4000_4408, 1 << 7)
            .poke(0x4000_4400, 1 | 1 << 3)
            .poke(0x4002_0080, 1 << 7 | 1 << 4 | 1)
            .sleep_for_ever();
        program
    };
    let mut mcu = program(7).start(Part::F303, &Board::default());
    run(&mut mcu, 2 * MS);
    let sent = mcu.drain_uart();
    let bytes: Vec<_> = sent.iter().map(|sent| sent.byte).collect();
    assert_eq!(bytes, b"plow");
    assert!(
        sent.iter()
            .all(|sent| sent.usart == 2 && sent.baud == 115_942)
    );
    for pair in sent.windows(2) {
        assert_eq!(pair[1].start, pair[0].end);
        let length = pair[1].end.as_ticks() - pair[1].start.as_ticks();
        assert_eq!(length, 690 * 125_000);
    }
    let mut mcu = program(4).start(Part::F303, &Board::default());
    run(&mut mcu, 2 * MS);
    assert_eq!(mcu.drain_uart(), []);
}

#[test]
fn a_block_without_its_clock_reads_zero_and_takes_nothing() {
    let mut program = Program::new();
    program
        .poke(0x4000_0028, 7)
        .open(0x4002_3840, 1)
        .peek(0x4000_0028)
        .constant(0, 0x2000_1000)
        .half(0x6002)
        .sleep_for_ever();
    let mut mcu = program.start(Part::F446, &Board::default());
    mcu.set_memory(0x2000_1000, &[0xFF; 4]);
    run(&mut mcu, MS);
    assert_eq!(mcu.memory(0x2000_1000, 4), Some(vec![0; 4]));
}

/// What is in a register after a store to it `gap` NOPs behind the store that enabled its clock;
/// and the violations. `prescalers` is the value of RCC_CFGR.
fn stored_after(
    part: &'static Part,
    prescalers: (u32, u32),
    enable: (u32, u32),
    register: u32,
    gap: usize,
) -> (u32, Vec<twin::Violation>) {
    let mut program = Program::new();
    program
        .poke(prescalers.0, prescalers.1)
        // STR r1, [r0]; NOPs; STR r3, [r2]; NOPs; LDR r4, [r2]
        .constant(0, enable.0)
        .constant(1, enable.1)
        .constant(2, register)
        .constant(3, 7)
        .half(0x6001)
        .wait_cycles(gap)
        .half(0x6013)
        .wait_cycles(16)
        .half(0x6814)
        .sleep_for_ever();
    let mut mcu = program.start(part, &Board::default());
    run(&mut mcu, MS);
    (mcu.register(4), mcu.violations())
}

#[test]
fn a_peripheral_used_too_soon_after_its_clock_was_enabled_loses_the_write() {
    const F446_CFGR: u32 = 0x4002_3808;
    const F303_CFGR: u32 = 0x4002_1004;
    // APB1 not divided: 1 + 1 cycles; divided by 4: 1 + 4; on AHB: 2.
    let cases = [
        (Part::F446, (F446_CFGR, 0), (0x4002_3840, 1), 0x4000_0028, 2),
        (
            Part::F446,
            (F446_CFGR, 0b101 << 10),
            (0x4002_3840, 1),
            0x4000_0028,
            5,
        ),
        (
            Part::F446,
            (F446_CFGR, 0),
            (0x4002_3830, 1 << 20 | 4),
            0x4002_0814,
            2,
        ),
        (
            Part::F303,
            (F303_CFGR, 0b100 << 8),
            (0x4002_101C, 1),
            0x4000_0028,
            3,
        ),
        (
            Part::F303,
            (F303_CFGR, 0),
            (0x4002_1014, 1 << 19),
            0x4800_0814,
            2,
        ),
    ];
    for (part, prescalers, enable, register, needed) in cases {
        for gap in 0..8 {
            let (value, violations) = stored_after(part, prescalers, enable, register, gap);
            let text: Vec<_> = violations.iter().map(ToString::to_string).collect();
            if gap < needed {
                assert_eq!(value, 0, "{register:#x} after {gap}: {text:?}");
                assert_eq!(violations.len(), 1, "{text:?}");
                assert_eq!(violations[0].address, register);
                let early = format!("{} cycles too early", needed - gap);
                assert!(text[0].contains(&early), "{text:?}");
            } else {
                assert_eq!(
                    (value, text.len()),
                    (7, 0),
                    "{register:#x} after {gap}: {text:?}"
                );
            }
        }
    }
}

#[test]
fn an_access_to_nothing_is_a_fault_that_shows() {
    let mut program = Program::new();
    program.peek(0x4000_2800).sleep_for_ever();
    let mut mcu = program.start(Part::F303, &Board::default());
    run(&mut mcu, MS);
    assert_eq!(mcu.exception(), 3);
    assert_eq!(mcu.bus_faults(), (1, 0x4000_2800));
    let [violation] = &mcu.violations()[..] else {
        panic!("{:?}", mcu.violations());
    };
    assert!(
        violation
            .to_string()
            .contains("no peripheral that is modelled")
    );
}

#[test]
fn an_access_that_a_register_does_not_allow_is_a_violation() {
    let mut program = Program::new();
    program
        .open(0x4002_3840, 1 | 1 << 25)
        // A reserved bit of TIM2_SR; CAN_MSR by a byte: LDRB r2, [r0]; GPIO behind its registers.
        .poke(0x4000_0010, 1 << 31)
        .constant(0, 0x4000_6404)
        .half(0x7802)
        .open(0x4002_3830, 1 << 20 | 1)
        .peek(0x4002_003C)
        .sleep_for_ever();
    let mut mcu = program.start(Part::F446, &Board::default());
    run(&mut mcu, MS);
    let found: Vec<_> = mcu.violations().iter().map(ToString::to_string).collect();
    assert_eq!(found.len(), 4, "{found:#?}");
    for (text, wanted) in found.iter().zip([
        "TIM2_SR (0x40000010): written 0x80000000, which changes the reserved bits 0x80000000",
        "CAN1_MSR (0x40006404): read by 1 bytes, at least 4 are needed",
        "Gpio(0) + 0x3c (0x4002003c): there is no register",
        "Gpio(0) + 0x3c (0x4002003c): read, and it is not modelled",
    ]) {
        assert!(text.contains(wanted), "{text}");
    }
}

#[test]
fn systick_wakes_a_sleeping_core_at_its_rate() {
    let mut program = Program::new();
    program
        .open(0x4002_1014, 0x14 | 1 << 18)
        .poke(0x4800_0400, 0x280 & !(3 << 6) | 1 << 6)
        .poke(0xE000_E014, 7_999)
        .poke(0xE000_E018, 0)
        .poke(0xE000_E010, 7)
        .sleep_for_ever();
    program.handler(15);
    program
        .peek(0x4800_0414)
        .half(0x2308)
        .half(0x405A)
        .half(0x6002)
        .return_from_handler();
    let mut mcu = program.start(Part::F303, &Board::default());
    run(&mut mcu, 100 * MS);
    let edges = mcu.drain_pins();
    assert_eq!(edges.len(), 99);
    let first = edges[0].at.as_ticks();
    let last = edges[98].at.as_ticks();
    // 8000 cycles of 8 MHz. A pin may change up to one cycle later, when the core samples it.
    assert!(
        (last - first).abs_diff(98 * MS) <= 98 * 125_000,
        "{}",
        last - first
    );
}

#[test]
fn every_executed_instruction_can_be_observed() {
    let mut program = Program::new();
    program.sleep_for_ever();
    let start = 0x0800_0000 + (VECTORS as u32) * 4 + 2;
    let mut mcu = program.start(Part::F446, &Board::default());
    let seen = Arc::new(Mutex::new(Vec::new()));
    let sink = Arc::clone(&seen);
    mcu.set_trace(Some(Box::new(move |what| {
        sink.lock().expect("one thread").push(what);
    })));
    mcu.run_for(SimDuration::from_ticks(MS));
    let seen = seen.lock().expect("one thread");
    assert!(seen.contains(&Seen::Executed(start)));
    assert!(seen.len() < 10, "asleep, nothing is executed: {seen:x?}");
}

#[test]
fn exceptions_are_observed_around_their_instructions() {
    let mut program = Program::new();
    program
        .constant(7, 0)
        .poke(0xE000_E014, 96)
        .poke(0xE000_E018, 0)
        .poke(0xE000_E010, 7)
        .sleep_for_ever();
    program.handler(15);
    // ADDS r7, #1
    program.half(0x3701).return_from_handler();
    let mut mcu = program.start(Part::F303, &Board::default());
    let seen = Arc::new(Mutex::new(Vec::new()));
    let sink = Arc::clone(&seen);
    mcu.set_trace(Some(Box::new(move |what| {
        sink.lock().expect("one thread").push(what);
    })));
    run(&mut mcu, MS);
    let seen = seen.lock().expect("one thread");
    let handler = mcu.image().handler(15).expect("a handler").0;
    let activations: Vec<&[Seen]> = seen
        .split(|what| matches!(what, Seen::Entered(15, _, 0)))
        .skip(1)
        .collect();
    assert_eq!(activations.len() as u32, mcu.register(7));
    assert!(activations.len() > 50);
    for activation in activations {
        assert_eq!(activation[0], Seen::Executed(handler));
        assert!(matches!(activation[1], Seen::Executed(_)));
        assert_eq!(activation[2], Seen::Returned(0));
    }
}

/// What a slower core executes ends later; an instruction that is skipped does not, nor do entry and return of an
/// exception, of which it is told.
#[test]
fn a_core_can_be_slower_than_the_emulated_one() {
    let mut program = Program::new();
    let start = 0x0800_0000 + program.here() as u32;
    // movs r0, #0; ite eq; moveq r1, r0; movne r1, r0; nop
    for half in [0x2000, 0xbf0c, 0x4601, 0x4601, 0xbf00] {
        program.half(half);
    }
    program.sleep_for_ever();
    let slept = |later: u64| {
        let mut mcu = program.start(Part::F446, &Board::default());
        let seen = Arc::new(Mutex::new(Vec::new()));
        let sink = Arc::clone(&seen);
        mcu.set_slower(Some(Box::new(move |executed| {
            sink.lock().expect("one thread").push(executed);
            executed.map_or(0, |_| later)
        })));
        run(&mut mcu, MS);
        let seen = seen.lock().expect("one thread").clone();
        (mcu.load().thread, seen)
    };
    let ((fast, seen), (slow, again)) = (slept(0), slept(100));
    let at = |offset: u32| {
        Some(Executed {
            at: start + offset,
            next: start + offset + 2,
        })
    };
    // The first step is the reset.
    assert_eq!(seen[1..6], [at(0), at(2), at(4), None, at(8)]);
    assert_eq!(seen, again);
    let executed = seen.iter().flatten().count() as u64;
    assert_eq!(slow, fast + 100 * executed);
}

/// What is seen of stores to the word at 0x2000_1000, and to the registers, within a millisecond.
fn stores(program: &Program, part: &'static Part) -> Vec<Seen> {
    let mut mcu = program.start(part, &Board::default());
    let seen = Arc::new(Mutex::new(Vec::new()));
    let sink = Arc::clone(&seen);
    mcu.set_trace(Some(Box::new(move |what| {
        if matches!(what, Seen::Stored(..) | Seen::Rearranged(..)) {
            sink.lock().expect("one thread").push(what);
        }
    })));
    mcu.watch_stores(&BTreeSet::from([0x2000_1000]));
    run(&mut mcu, MS);
    let seen = seen.lock().expect("one thread");
    seen.clone()
}

#[test]
fn a_word_that_is_changed_and_put_back_is_seen_at_each_store() {
    let mut program = Program::new();
    let start = 0x0800_0000 + program.here() as u32;
    program
        .poke(0x2000_1000, 7)
        .poke(0x2000_1004, 5)
        .poke(0x2000_1000, 9)
        // STRB r1, [r0, #1]
        .half(0x7041)
        .poke(0x2000_1000, 7)
        .sleep_for_ever();
    // Two constants of eight bytes each before each store.
    let by = |behind: u32| Storer::Instruction(start + behind);
    assert_eq!(
        stores(&program, Part::F446),
        [
            Seen::Stored(by(16), 0x2000_1000, 7),
            Seen::Stored(by(52), 0x2000_1000, 9),
            Seen::Stored(by(54), 0x2000_1000, 0x0909),
            Seen::Stored(by(72), 0x2000_1000, 7),
        ]
    );
}

#[test]
fn a_transfer_to_a_watched_word_is_seen() {
    // Memory to memory, one word.
    let mut program = Program::new();
    program
        .open(0x4002_3830, 1 << 22)
        .poke(0x4002_6414 + 0x18, 1)
        .poke(0x4002_6418 + 0x18, 0x0800_0000)
        .poke(0x4002_641C + 0x18, 0x2000_1000)
        .poke(0x4002_6410 + 0x18, 2 << 13 | 2 << 11 | 2 << 6 | 1)
        .sleep_for_ever();
    let by = Storer::Dma {
        controller: 2,
        unit: 1,
    };
    assert_eq!(
        stores(&program, Part::F446),
        [Seen::Stored(by, 0x2000_1000, 0x2000_2000)]
    );
    let mut program = Program::new();
    program
        .open(0x4002_1014, 1)
        .poke(0x4002_000C, 1)
        .poke(0x4002_0010, 0x0800_0000)
        .poke(0x4002_0014, 0x2000_1000)
        .poke(0x4002_0008, 1 << 14 | 2 << 10 | 2 << 8 | 1)
        .sleep_for_ever();
    let by = Storer::Dma {
        controller: 1,
        unit: 1,
    };
    assert_eq!(
        stores(&program, Part::F303),
        [Seen::Stored(by, 0x2000_1000, 0x2000_2000)]
    );
}

#[test]
fn a_store_that_changes_who_interrupts_whom_is_seen() {
    let mut program = Program::new();
    let start = 0x0800_0000 + program.here() as u32;
    program
        .poke(0xE000_E404, 0x4000_0000)
        // The same again, and a request that is no change.
        .poke(0xE000_E404, 0x4000_0000)
        .poke(0xE000_ED04, 1 << 25)
        .poke(0xE000_E100, 1 << 5)
        .poke(0xE000_E180, 1 << 5)
        .poke(0xE000_ED20, 0x5000_0000)
        .poke(0xE000_ED0C, 0x05FA_0400)
        .poke(0xE000_ED08, 0x2000_0000)
        .sleep_for_ever();
    let seen = |number: u32, register| Seen::Rearranged(start + 18 * number + 16, register);
    assert_eq!(
        stores(&program, Part::F446),
        [
            seen(0, 0xE000_E404),
            seen(3, 0xE000_E100),
            seen(4, 0xE000_E180),
            seen(5, 0xE000_ED20),
            seen(6, 0xE000_ED0C),
            seen(7, 0xE000_ED08),
        ]
    );
}

/// The core saves registers as an exception begins: with its stack too deep, on a variable.
#[test]
fn registers_that_are_saved_on_a_watched_word_are_seen() {
    let mut program = Program::new();
    program
        .constant(0, 0x2000_1010)
        // MOV sp, r0
        .half(0x4685)
        .poke(0xE000_ED04, 1 << 28)
        .sleep_for_ever();
    program.handler(14);
    program.return_from_handler();
    let seen = stores(&program, Part::F446);
    assert!(
        matches!(seen[..], [Seen::Stored(Storer::Entry(14), 0x2000_1000, _)]),
        "{seen:x?}"
    );
}

#[test]
fn interrupts_leave_systick_at_its_rate() {
    let mut program = Program::new();
    // PendSV in a loop, against SysTick every 997 cycles: some entries begin just before it is due.
    program
        .poke(0xE000_E014, 996)
        .poke(0xE000_E018, 0)
        .constant(0, 0xE000_ED04)
        .constant(1, 1 << 28)
        .constant(7, 0)
        .poke(0xE000_E010, 7)
        .constant(0, 0xE000_ED04)
        .constant(1, 1 << 28);
    // STR r1, [r0]; B to it.
    program.half(0x6001).half(0xE7FD);
    program.handler(14);
    program.return_from_handler();
    program.handler(15);
    // ADDS r7, #1
    program.half(0x3701).return_from_handler();
    let mut mcu = program.start(Part::F303, &Board::default());
    run(&mut mcu, 1000 * MS);
    let wanted = 8_000_000 / 997;
    let ticks = mcu.register(7);
    assert!(ticks.abs_diff(wanted) <= 2, "{ticks} of {wanted}");
}

#[test]
fn an_interrupt_in_an_it_block_leaves_its_conditions_standing() {
    let mut program = Program::new();
    // SysTick every 97 cycles, against a loop of 8: it interrupts each instruction in turn.
    program
        .poke(0xE000_E014, 96)
        .poke(0xE000_E018, 0)
        .constant(4, 0)
        .constant(5, 0)
        .constant(6, 0)
        .constant(7, 0)
        .poke(0xE000_E010, 7)
        // loop: CMP r5, #1; ITTTT EQ; ADDEQ r4, #1, four times; ADDS r6, #1; B loop
        .half(0x2D01)
        .half(0xBF01);
    for _ in 0..4 {
        program.half(0x3401);
    }
    program.half(0x3601).half(0xE7F7);
    program.handler(15);
    // ADDS r7, #1
    program.half(0x3701).return_from_handler();
    let mut mcu = program.start(Part::F303, &Board::default());
    run(&mut mcu, 10 * MS);
    assert!(mcu.register(6) > 1000 && mcu.register(7) > 500);
    assert_eq!(mcu.register(4), 0, "instructions whose condition fails ran");
}

#[test]
fn an_interrupt_after_a_float_comparison_leaves_its_outcome_standing() {
    // The handler that uses no float (ADDS r7, #1), and one that compares too, the other way
    // round: VCMP s1, s0.
    let handlers: [&[u16]; 2] = [&[0x3701], &[0x3701, 0xEEF4, 0x0A40]];
    for instructions in handlers {
        let mut program = Program::new();
        // The FPU, and SysTick every 97 cycles.
        program
            .poke(0xE000_ED88, 0x00F0_0000)
            .poke(0xE000_E014, 96)
            .poke(0xE000_E018, 0)
            .constant(4, 0)
            .constant(6, 0)
            .constant(7, 0)
            // VMOV s0, #1.0; VMOV s1, #2.0
            .half(0xEEB7)
            .half(0x0A00)
            .half(0xEEF0)
            .half(0x0A00)
            .poke(0xE000_E010, 7)
            // loop: VCMP s0, s1; VMRS APSR_nzcv, FPSCR; IT PL; ADDPL r4, #1; ADDS r6, #1; B loop
            .half(0xEEB4)
            .half(0x0A60)
            .half(0xEEF1)
            .half(0xFA10)
            .half(0xBF58)
            .half(0x3401)
            .half(0x3601)
            .half(0xE7F7);
        program.handler(15);
        for &instruction in instructions {
            program.half(instruction);
        }
        program.return_from_handler();
        let mut mcu = program.start(Part::F303, &Board::default());
        run(&mut mcu, 10 * MS);
        assert!(mcu.register(6) > 1000 && mcu.register(7) > 500);
        assert_eq!(mcu.register(4), 0, "1 was not below 2");
    }
}

/// Writes `words` from `address` on, then makes the semihosting call `operation`; uses r0 to r2.
fn call(program: &mut Program, operation: u32, address: u32, words: &[u32]) {
    for (word, &value) in (0..).zip(words) {
        program.poke(address + 4 * word, value);
    }
    program.constant(1, address).constant(0, operation);
    program.half(0xBEAB);
}

#[test]
fn a_debugger_passes_the_command_line_and_notes_the_end() {
    const BUFFER: u32 = 0x2000_0100;
    const BLOCK: u32 = 0x2000_0200;
    let mut program = Program::new();
    call(&mut program, 0x15, BLOCK, &[BUFFER, 16]);
    call(&mut program, 0x20, BLOCK + 8, &[0x2_0026, 7]);
    program.sleep_for_ever();
    let mut mcu = program.start(Part::F303, &Board::default());
    mcu.attach_debugger("run_addr 1");
    run(&mut mcu, MS);
    assert_eq!(mcu.ended(), Some(&Ended::Exit(7)));
    assert_eq!(mcu.memory(BUFFER, 11).unwrap(), b"run_addr 1\0");
    assert_eq!(mcu.memory(BLOCK + 4, 4).unwrap(), 10_u32.to_le_bytes());
    // Nothing follows the end.
    let at = mcu.pc();
    run(&mut mcu, 2 * MS);
    assert_eq!((mcu.pc(), mcu.is_locked_up()), (at, false));
}

#[test]
fn a_debugger_notices_a_program_that_starts_again() {
    let mut program = Program::new();
    call(&mut program, 0x15, 0x2000_0200, &[0x2000_0100, 16]);
    // A reset by the program (SCB_AIRCR).
    program.poke(0xE000_ED0C, 0x05FA_0004).sleep_for_ever();
    let mut mcu = program.start(Part::F446, &Board::default());
    mcu.attach_debugger("x");
    for ms in 1..3 {
        run(&mut mcu, ms * MS);
    }
    assert_eq!(mcu.ended(), Some(&Ended::Restarted));
    assert_eq!(mcu.resets().len(), 2);
}

#[test]
fn without_a_debugger_its_call_is_a_fault() {
    let mut program = Program::new();
    program.half(0xBEAB).sleep_for_ever();
    let mut mcu = program.start(Part::F303, &Board::default());
    run(&mut mcu, MS);
    assert_eq!((mcu.exception(), mcu.ended()), (3, None));
}

#[test]
fn the_input_register_shows_what_a_transmitter_sends() {
    // PA9 in alternate function 7, USART1 on APB2, 8 MHz HSI, 100 cycles a bit.
    let mut program = Program::new();
    program
        .open(0x4002_1014, 1 << 17)
        .open(0x4002_1018, 1 << 14)
        .poke(0x4001_380C, 100)
        .poke(0x4001_3800, 1 | 1 << 3)
        .poke(0x4800_0024, 7 << 4)
        .poke(0x4800_0000, 0xA800_0000 | 2 << 18)
        .poke(0x4001_3828, 0)
        .sleep_for_ever();
    let mut mcu = program.start(Part::F303, &Board::default());
    run(&mut mcu, MS);
    let sent = mcu.drain_uart();
    assert_eq!(sent.len(), 1);
    let mut mcu = program.start(Part::F303, &Board::default());
    let pa9 = |mcu: &mut Mcu| mcu.read_register(0x4800_0010).unwrap() >> 9 & 1;
    for (when, level) in [
        (sent[0].start.as_ticks() - US, 1),
        (sent[0].start.as_ticks() + US, 0),
        (sent[0].edges[9].as_ticks() - US, 0),
        (sent[0].end.as_ticks(), 1),
    ] {
        run(&mut mcu, when);
        assert_eq!(pa9(&mut mcu), level, "{when}");
    }
    mcu.drive_pin(Pin::new('A', 9), Some(false));
    assert_eq!(pa9(&mut mcu), 0, "a short circuit wins");
}

#[test]
fn an_edge_of_a_pin_stays_pending_until_the_program_clears_it() {
    const PR: u32 = 0x4001_3C14;
    let mut program = Program::new();
    program
        .open(0x4002_3830, 1 << 20 | 1 | 1 << 2)
        .open(0x4002_3844, 1 << 14)
        // Line 1 is wired to port C, and line 0 still to port A. Falling edges, no interrupts.
        .poke(0x4001_3808, 2 << 4)
        .poke(0x4001_3C0C, 0b11)
        .sleep_for_ever();
    let mut mcu = program.start(Part::F446, &Board::default());
    let mut until = MS;
    run(&mut mcu, until);
    let mut pulse = |mcu: &mut Mcu, port, pin| {
        for level in [true, false, true] {
            mcu.drive_pin(Pin::new(port, pin), Some(level));
            until += MS / 1000;
            run(mcu, until);
        }
        mcu.read_register(PR)
    };
    assert_eq!(pulse(&mut mcu, 'A', 1), Some(0));
    assert_eq!(pulse(&mut mcu, 'C', 0), Some(0));
    assert_eq!(pulse(&mut mcu, 'C', 1), Some(0b10));
    assert_eq!(pulse(&mut mcu, 'A', 0), Some(0b11));
    assert!(mcu.write_register(PR, 0b10));
    assert_eq!(mcu.read_register(PR), Some(0b01));
    assert!(mcu.violations().is_empty(), "{:?}", mcu.violations());
}

const TIM7: u32 = 0x4000_1400;
/// How long PB3 is high, which the program raises before it starts TIM7 for one pulse of `counts`
/// microseconds, and lowers in its interrupt.
fn alarm(counts: u32) -> u64 {
    let mut program = Program::new();
    program
        .open(0x4002_1014, 0x14 | 1 << 18)
        .poke(0x4800_0400, 0x200 | 1 << 6)
        // Without its clock the timer takes nothing.
        .poke(TIM7 + 0x0C, 1)
        .open(0x4002_101C, 1 << 5)
        .poke(TIM7, 1 << 2)
        .poke(TIM7 + 0x28, 7)
        .poke(TIM7 + 0x2C, counts - 1)
        .poke(TIM7 + 0x14, 1)
        .poke(TIM7 + 0x0C, 1)
        .enable(55)
        .poke(0x4800_0418, 1 << 3)
        .poke(TIM7, 1 << 3 | 1 << 2 | 1)
        .sleep_for_ever();
    program.handler(16 + 55);
    program
        .poke(0x4800_0428, 1 << 3)
        .poke(TIM7 + 0x10, 0)
        .return_from_handler();
    let mut mcu = program.start(Part::F303, &Board::default());
    run(&mut mcu, 10 * MS);
    assert_eq!(mcu.violations(), []);
    assert_eq!(mcu.read_register(TIM7), Some(1 << 3 | 1 << 2));
    assert_eq!(mcu.load().tasks[0].activations, 1);
    let pins = mcu.drain_pins();
    let [up, down] = &pins[..] else {
        panic!("{pins:?}");
    };
    down.at.as_ticks() - up.at.as_ticks()
}

#[test]
fn one_pulse_of_tim7_wakes_a_sleeping_core_in_its_own_cycle() {
    let short = alarm(100);
    // Beyond the counts, 5 cycles to the store that starts it and 12 + 5 + 2 at most from the overflow to
    // the pin, of 125 ns each.
    assert!(
        (100 * US..100 * US + 24 * 125_000).contains(&short),
        "{short}"
    );
    assert_eq!(alarm(1100) - short, MS);
    assert_eq!(alarm(101) - short, US);
}
