//! Two microcontrollers exchange a frame.

mod program;

use can_bus::{Frame, RecordKind, SimTime};
use program::Program;
use std::collections::BTreeSet;
use twin::mcu::Board;
use twin::network::Network;
use twin::part::{Part, Pin};
use twin::stops::{Stop, Stops, Watch, Watched};

const MS: u64 = 1_000_000_000;
const US: u64 = 1_000_000;
const CAN: u32 = 0x4000_6400;

/// Connects the CAN controller to the bus at 250 kbit/s: 16 quanta of 4 MHz, sample point after the
/// twelfth; every frame into FIFO 0, single shot.
fn join(program: &mut Program, prescaler: u32) {
    program
        .poke(CAN, 1)
        .wait(CAN + 0x04, 1)
        .poke(CAN + 0x1C, 3 << 20 | 10 << 16 | (prescaler - 1))
        .poke(CAN + 0x200, 0x2A1C_0E01)
        .poke(CAN + 0x20C, 1)
        .poke(CAN + 0x240, 0)
        .poke(CAN + 0x244, 0)
        .poke(CAN + 0x21C, 1)
        .poke(CAN + 0x200, 0x2A1C_0E00)
        .poke(CAN, 1 << 4 | 1 << 2)
        .wait_clear(CAN + 0x04, 1);
}

/// Sends identifier 0x123 with four bytes when TIM2 has counted 2 ms of 16 MHz.
fn sender(pins: bool) -> Program {
    let mut program = Program::new();
    program
        .open(0x4002_3830, 1 << 20 | 1 << 1)
        .open(0x4002_3840, 1 << 25 | 1)
        .poke(0x4002_0424, 9 << 4 | 9);
    if pins {
        program.poke(0x4002_0400, 0x280 | 2 << 18 | 2 << 16);
    }
    join(&mut program, 4);
    program
        .poke(CAN + 0x14, 1)
        .enable(19)
        .poke(0x4000_0000, 1)
        .poke(0x4000_0034, 32_000)
        .poke(0x4000_0010, 0)
        .wait(0x4000_0010, 1 << 1)
        .poke(CAN + 0x184, 4)
        .poke(CAN + 0x188, u32::from_le_bytes(*b"seed"))
        .poke(CAN + 0x180, 0x123 << 21 | 1)
        .sleep_for_ever();
    // Transmit interrupt: stores TSR and acknowledges.
    program.handler(16 + 19);
    program
        .peek(CAN + 0x08)
        .constant(0, 0x2000_1000)
        .half(0x6002)
        .poke(CAN + 0x08, 1)
        .return_from_handler();
    program
}

/// Stores the data of a received frame and raises PB3.
fn receiver() -> Program {
    let mut program = Program::new();
    program
        .open(0x4002_1014, 0x14 | 1 << 17 | 1 << 18)
        .open(0x4002_101C, 1 << 25)
        .poke(0x4800_0024, 9 << 16 | 9 << 12)
        .poke(0x4800_0000, 0xA800_0000 & !(0xF << 22) | 2 << 24 | 2 << 22)
        .poke(0x4800_0400, 1 << 6);
    join(&mut program, 2);
    program.poke(CAN + 0x14, 1 << 1).enable(20).sleep_for_ever();
    program.handler(16 + 20);
    program
        .poke(0x4800_0418, 1 << 3)
        .peek(CAN + 0x1B8)
        .constant(0, 0x2000_1000)
        .half(0x6002)
        .poke(CAN + 0x0C, 1 << 5)
        .return_from_handler();
    program
}

fn powered(pins: bool, crystal_ppb: i32) -> Network {
    let mut network = Network::new();
    let board = Board {
        rc_ppb: crystal_ppb,
        ..Board::default()
    };
    network.add(sender(pins).image(Part::F446), &board);
    network.add(receiver().image(Part::F303), &Board::default());
    network
}

fn exchange(pins: bool, crystal_ppb: i32) -> Network {
    let mut network = powered(pins, crystal_ppb);
    network.run_until(SimTime::from_ticks(5 * MS));
    for node in 0..2 {
        assert_eq!(network.node(node).violations(), []);
    }
    network
}

#[test]
fn a_frame_goes_from_one_program_to_the_other() {
    let mut network = exchange(true, 300_000);
    let data = network.node(1).memory(0x2000_1000, 4);
    assert_eq!(data.as_deref(), Some(&b"seed"[..]));
    let records = network.bus().drain_records();
    let [start, end] = &records[..] else {
        panic!("one frame: {records:?}");
    };
    let expected = Frame::standard(0x123, b"seed").expect("a frame");
    assert_eq!(start.kind, RecordKind::FrameStart { frame: expected });
    let RecordKind::FrameEnd { frame, .. } = end.kind else {
        panic!("{end:?}");
    };
    assert_eq!(frame, expected);
    // The receiver accepts the frame at the last but one bit of the end of frame, 4 us earlier. The
    // exception entry of 12 cycles and the first store take less than 4 us more at 8 MHz.
    let pins = network.node_mut(1).drain_pins();
    let [raised] = &pins[..] else {
        panic!("{pins:?}");
    };
    assert_eq!(raised.pin, Pin::new('B', 3));
    let late = raised.at.as_ticks() as i64 - end.at.as_ticks() as i64;
    assert!((-4 * US as i64..0).contains(&late), "{late} ps");
    // The sender: request complete, transmission ok, and the mailbox empty.
    let status = network.node(0).memory(0x2000_1000, 4).expect("RAM");
    assert_eq!(status[0] & 0b1111, 0b0011);
}

#[test]
fn without_its_pins_a_controller_reaches_nobody() {
    let mut network = exchange(false, 0);
    assert_eq!(network.node(1).memory(0x2000_1000, 4), Some(vec![0; 4]));
    assert!(network.node_mut(1).drain_pins().is_empty());
}

#[test]
fn a_clock_that_is_two_percent_off_does_not_get_through() {
    let network = exchange(true, 20_000_000);
    assert_eq!(network.node(1).memory(0x2000_1000, 4), Some(vec![0; 4]));
    let errors = network
        .bus()
        .drain_records()
        .iter()
        .filter(|record| matches!(record.kind, RecordKind::Error { .. }))
        .count();
    assert!(errors > 0);
}

#[test]
fn a_copy_goes_on_as_the_original_does() {
    for copied_at in [1, 2_150, 4_000] {
        let mut network = powered(true, 300_000);
        network.run_until(SimTime::from_ticks(copied_at * US));
        let mut copy = network.copy();
        for network in [&mut network, &mut copy] {
            network.run_until(SimTime::from_ticks(5 * MS));
        }
        let expected = network.bus().drain_records();
        assert_eq!(expected.len(), 2);
        assert_eq!(copy.bus().drain_records(), expected);
        for node in 0..2 {
            let ends = [&network, &copy].map(|network| {
                let mcu = network.node(node);
                let registers: Vec<_> = (0..16).map(|number| mcu.register(number)).collect();
                (mcu.cycles(), registers, mcu.memory(0x2000_0000, 0x2000))
            });
            assert_eq!(ends[0], ends[1], "node {node}, copied at {copied_at} us");
        }
        let pins = [&mut network, &mut copy].map(|network| network.node_mut(1).drain_pins());
        assert_eq!(pins[0], pins[1]);
        assert_eq!(pins[0].len(), 1);
    }
}

#[test]
fn a_copy_has_memory_of_its_own() {
    let mut network = powered(true, 0);
    network.run_until(SimTime::from_ticks(MS));
    let copy = network.copy();
    assert!(network.node_mut(0).set_memory(0x2000_0000, b"changed"));
    assert_eq!(copy.node(0).memory(0x2000_0000, 7), Some(vec![0; 7]));
}

/// Where the receiver handles its interrupt.
fn handler(network: &Network) -> u32 {
    let vector = network.node(1).memory(0x0800_0000 + 4 * (16 + 20), 4);
    u32::from_le_bytes(vector.unwrap().try_into().unwrap()) & !1
}

/// What a run leaves behind that a stop could disturb.
fn traces(network: &mut Network) -> impl PartialEq + std::fmt::Debug {
    let records = network.bus().drain_records();
    let nodes = [0, 1].map(|node| {
        let mcu = network.node_mut(node);
        (mcu.cycles(), mcu.drain_pins(), mcu.memory(0x2000_1000, 4))
    });
    (records, nodes)
}

#[test]
fn a_run_with_stops_is_the_run_without_them() {
    let end = SimTime::from_ticks(5 * MS);
    let mut plain = powered(true, 300_000);
    plain.run_until(end);
    let mut stopped = powered(true, 300_000);
    stopped.node_mut(1).attach_probe();
    let mut stops = 0;
    loop {
        let step = stopped.node(1).steps() + 7;
        stopped.node_mut(1).stop_at(Stops {
            step: Some(step),
            ..Stops::default()
        });
        if stopped.run_to_stop(end) {
            break;
        }
        stops += 1;
        assert_eq!(stopped.node(1).stopped(), Some(Stop::Step));
        assert_eq!(stopped.node(1).steps(), step);
        assert!(stopped.now() <= stopped.node(1).now(), "the bus waits");
    }
    assert!(stops > 3, "{stops}");
    assert_eq!(traces(&mut stopped), traces(&mut plain));
}

#[test]
fn a_node_stops_at_a_breakpoint_and_before_a_watched_access() {
    let end = SimTime::from_ticks(5 * MS);
    let mut network = powered(true, 0);
    network.node_mut(1).attach_probe();
    let written = Watch {
        first: 0x2000_1002,
        last: 0x2000_1002,
        kind: Watched::Writes,
    };
    let read = Watch {
        kind: Watched::Reads,
        ..written
    };
    let at = handler(&network);
    network.node_mut(1).stop_at(Stops {
        breakpoints: BTreeSet::from([at]),
        watches: BTreeSet::from([written, read]),
        ..Stops::default()
    });
    assert!(!network.run_to_stop(end));
    assert_eq!(network.node(1).stopped(), Some(Stop::Breakpoint));
    assert_eq!(
        (network.node(1).pc(), network.node(1).exception()),
        (at, 36)
    );
    assert!(!network.run_to_stop(end));
    assert_eq!(network.node(1).stopped(), Some(Stop::Access(written)));
    assert_eq!(network.node(1).memory(0x2000_1000, 4), Some(vec![0; 4]));
    assert!(network.run_to_stop(end));
    assert_eq!(network.node(1).stopped(), None);
    let data = network.node(1).memory(0x2000_1000, 4);
    assert_eq!(data.as_deref(), Some(&b"seed"[..]));

    let footprint = network.node_mut(1).take_footprint().unwrap();
    let of = |watch| Stops {
        watches: BTreeSet::from([watch]),
        ..Stops::default()
    };
    assert!(footprint.may_meet(&of(written)));
    assert!(!footprint.may_meet(&of(read)));
}

#[test]
fn a_node_stops_where_a_core_saves_registers_and_at_a_time() {
    let end = SimTime::from_ticks(5 * MS);
    let mut network = powered(true, 0);
    network.node_mut(1).attach_probe();
    // The top of the stack is at 0x2000_2000.
    let frame = Watch {
        first: 0x2000_1FFC,
        last: 0x2000_1FFF,
        kind: Watched::Writes,
    };
    network.node_mut(1).stop_at(Stops {
        watches: BTreeSet::from([frame]),
        ..Stops::default()
    });
    assert!(!network.run_to_stop(end));
    assert_eq!(network.node(1).stopped(), Some(Stop::Written(frame)));
    assert_eq!(network.node(1).pc(), handler(&network));

    let mut network = powered(true, 0);
    network.node_mut(0).attach_probe();
    let time = SimTime::from_ticks(1_500 * US);
    network.node_mut(0).stop_at(Stops {
        time: Some(time),
        ..Stops::default()
    });
    assert!(!network.run_to_stop(end));
    assert_eq!(network.node(0).stopped(), Some(Stop::Time));
    let late = network.node(0).now().as_ticks() - time.as_ticks();
    assert!(late < US, "{late} ps");
}

#[test]
fn a_debugger_sees_and_sets_all_registers() {
    let mut network = powered(true, 0);
    network.run_until(SimTime::from_ticks(MS));
    let mcu = network.node_mut(1);
    let mut registers = mcu.registers();
    assert_eq!(registers.r[15], mcu.pc());
    assert_eq!(registers.r[13], registers.msp);
    for (number, value) in (0..).zip(&mut registers.s) {
        *value = 100 + number;
    }
    registers.r[..13].copy_from_slice(&core::array::from_fn::<u32, 13, _>(|r| r as u32));
    registers.r[13] = 0x2000_0800;
    registers.basepri = 0x40;
    registers.fpscr = 1 << 31;
    mcu.set_registers(&registers);
    registers.msp = 0x2000_0800;
    assert_eq!(mcu.registers(), registers);
    registers.psp = 0x2000_0C00;
    mcu.set_registers(&registers);
    assert_eq!(mcu.registers(), registers);
    // CPUID of a Cortex-M4.
    assert_eq!(
        mcu.system_word(0xE000_ED00).map(|id| id >> 4 & 0xFFF),
        Some(0xC24)
    );
}

const TIM3: u32 = 0x4000_0400;

/// The sender and a receiver, each with a tap of its own; the receiver's tap is at PB4. It stores the count of
/// TIM3 at each edge in the RAM from 0x2000_1100 on.
fn guarded() -> Network {
    let mut program = receiver();
    program.handler(1);
    program
        .open(0x4002_1014, 0x14 | 1 << 17 | 1 << 18)
        .open(0x4002_101C, 1 << 25 | 1 << 1)
        .poke(0x4800_0420, 2 << 16)
        .poke(0x4800_0024, 9 << 16 | 9 << 12)
        .poke(0x4800_0000, 0xA800_0000 & !(0xF << 22) | 2 << 24 | 2 << 22)
        .poke(TIM3 + 0x18, 1)
        .poke(TIM3 + 0x20, 1 | 1 << 1 | 1 << 3)
        .poke(TIM3 + 0x0C, 1 << 1)
        .poke(TIM3, 1)
        .enable(29)
        .constant(4, 0x2000_1100);
    join(&mut program, 2);
    program.poke(CAN + 0x14, 1 << 1).enable(20).sleep_for_ever();
    program.handler(16 + 29);
    // STM r4!, {r2}
    program.peek(TIM3 + 0x34).half(0xC404).return_from_handler();
    let mut network = Network::new();
    network.add(sender(true).image(Part::F446), &Board::default());
    network.add(program.image(Part::F303), &Board::default());
    for (node, line, gate) in [
        (0, Pin::new('C', 0), Pin::new('C', 1)),
        (1, Pin::new('B', 4), Pin::new('A', 4)),
    ] {
        network.guard(node, [(node, line, gate)]);
    }
    network
}

/// Whether the receiver has the frame, and the sender an acknowledge for it; the levels of the sender's
/// line, once a microsecond; the counts at the edges of the receiver's.
fn outcome(mut network: Network) -> (bool, bool, BTreeSet<bool>, Vec<u32>) {
    let mut levels = BTreeSet::new();
    for at in 1..=5_000 {
        network.run_until(SimTime::from_ticks(at * US));
        levels.insert(network.node(0).pin(Pin::new('C', 0)));
    }
    for node in 0..2 {
        assert_eq!(network.node(node).violations(), []);
    }
    let words = network.node(1).memory(0x2000_1100, 64).unwrap();
    let counts = words
        .chunks(4)
        .map(|word| u32::from_le_bytes(word.try_into().unwrap()));
    let received = network.node(1).memory(0x2000_1000, 4).unwrap() == b"seed";
    let sent = network.node(0).memory(0x2000_1000, 4).unwrap()[0] & 0b10 != 0;
    let counts = counts.take_while(|count| *count != 0).collect();
    (received, sent, levels, counts)
}

#[test]
fn each_of_two_nodes_guards_itself() {
    let (received, sent, levels, counts) = outcome(guarded());
    assert!(received && sent);
    assert_eq!(levels.len(), 2);
    // The receiver drives the acknowledge bit: 4 us of 8 MHz, with the slices' 1 us on each side.
    let [fall, rise] = counts[..] else {
        panic!("{counts:?}");
    };
    assert!((24..=40).contains(&(rise - fall)), "{counts:?}");

    // A copy has the wires too.
    assert_eq!(outcome(guarded().copy()).3, counts);

    // The pin of the first node closes its gate: the frame gets no further, though it is on its line.
    let mut network = guarded();
    network.node_mut(0).drive_pin(Pin::new('C', 1), Some(true));
    let (received, sent, levels, counts) = outcome(network);
    assert!(!received && !sent);
    assert_eq!((levels.len(), counts.len()), (2, 0));

    // That of the second one keeps its acknowledge off the bus.
    let mut network = guarded();
    network.node_mut(1).drive_pin(Pin::new('A', 4), Some(true));
    let (received, sent, _, counts) = outcome(network);
    assert!(!received && !sent, "an error frame ends it");
    assert!(counts.len() >= 2, "{counts:?}");
}

#[test]
fn each_of_two_guardians_of_a_node_can_close_it_off() {
    let gates = [(0, Pin::new('C', 1)), (1, Pin::new('A', 4))];
    for open in [&[][..], &[0], &[1], &[0, 1]] {
        let mut network = powered(true, 0);
        for (guardian, gate) in gates {
            network.guard(guardian, [(0, Pin::new('A', 7), gate)]);
            let node = network.node_mut(guardian);
            node.drive_pin(gate, Some(true));
        }
        network.run_until(SimTime::from_ticks(MS));
        for &index in open {
            let (guardian, gate) = gates[index];
            network.node_mut(guardian).drive_pin(gate, Some(false));
        }
        network.run_until(SimTime::from_ticks(5 * MS));
        let received = network.node(1).memory(0x2000_1000, 4).unwrap() == b"seed";
        assert_eq!(received, open.len() == 2, "{open:?}");
    }
}
