//! A network like that of the UAGV, and checks of its traffic.
#![allow(dead_code)] // Each test file uses its part.

use ttcan::simulation::{Application, Bus, Crystal, SimTime, Traffic};
use ttcan::{
    Event, Frame, Id, MatrixConfig, Micros, Node, NodeConfig, NodeId, ReferenceFormat,
    StampLatency, SystemMatrix, Window, WindowKind,
};

pub(crate) const GPS: NodeId = NodeId(0);
pub(crate) const CONTROLLER: NodeId = NodeId(1);
pub(crate) const STEERING: NodeId = NodeId(2);
pub(crate) const DRIVE: NodeId = NodeId(3);

pub(crate) const FORMAT: ReferenceFormat = ReferenceFormat::new(1, Some(1), 5, Some(6));

pub(crate) const BIT_NANOS: u64 = 4000;

pub(crate) const ALARM: Id = Id::constant::<0x20>();
pub(crate) const BUTTON: Id = Id::constant::<0x21>();

const fn millis(at: u32) -> Micros {
    Micros::millis(at)
}

pub(crate) const MATRIX: SystemMatrix = SystemMatrix::constant(MatrixConfig {
    bit_rate: 250_000,
    basic_cycle: millis(100),
    cycles: 1,
    reference: Id::constant::<100>(),
    reference_format: FORMAT,
    masters: &[GPS, CONTROLLER],
    transmit_enable_bits: 16,
    sync_uncertainty: Micros::micros(20),
    longest_gap: Micros::secs(10),
    windows: &[
        Window::exclusive(
            "latitude",
            millis(1),
            millis(1),
            Id::constant::<401>(),
            7,
            GPS,
        ),
        Window::exclusive(
            "position",
            millis(3),
            millis(1),
            Id::constant::<200>(),
            8,
            GPS,
        ),
        Window::exclusive(
            "steering",
            millis(6),
            millis(1),
            Id::constant::<206>(),
            2,
            STEERING,
        )
        .retry_late(),
        Window::exclusive(
            "command",
            millis(7),
            millis(1),
            Id::constant::<300>(),
            8,
            CONTROLLER,
        ),
        Window::exclusive(
            "state",
            millis(8),
            millis(1),
            Id::constant::<450>(),
            8,
            CONTROLLER,
        ),
        Window::exclusive(
            "speed",
            millis(9),
            millis(1),
            Id::constant::<210>(),
            4,
            DRIVE,
        ),
        Window::arbitrating("events 1", millis(11), millis(1)).merged(),
        Window::arbitrating("events 2", millis(12), millis(2)),
    ],
    events: &[
        Event::new("alarm", ALARM, 8, DRIVE),
        Event::new("button", BUTTON, 8, DRIVE),
    ],
});

ttcan::schedule!(pub static SCHEDULE = MATRIX);

pub(crate) type Uagv = Node<'static, { MATRIX.window_count() }, { MATRIX.node_count() }, 4>;
pub(crate) type UagvBus<A> = Bus<'static, A, { MATRIX.window_count() }, { MATRIX.node_count() }, 4>;

pub(crate) const TICKS_PER_US: u32 = 18;

pub(crate) fn config(node: NodeId) -> NodeConfig {
    NodeConfig {
        latency: StampLatency::bxcan(4 * TICKS_PER_US, 6),
        transmit_lead: 3 * TICKS_PER_US,
        ..NodeConfig::new(node, TICKS_PER_US)
    }
}

pub(crate) fn uagv(node: NodeId) -> Uagv {
    Uagv::new(SCHEDULE.view(), config(node)).expect("the configuration is sound")
}

/// A crystal with this deviation, and interrupts served after 0.2 to 0.8 us.
pub(crate) fn crystal(ppb: i32, phase: u32) -> Crystal {
    Crystal {
        ticks_per_us: TICKS_PER_US,
        ppb,
        phase,
        interrupt: (200, 800),
    }
}

/// The four nodes without power. Their crystals are up to 50 ppm off, and their
/// counters wrap soon.
pub(crate) fn vehicle<A: Application>(application: A, seed: u64) -> UagvBus<A> {
    let mut bus = Bus::new(250_000, application, seed);
    let ppm = [31_000, -50_000, 50_000, -12_345];
    for node in 0..4 {
        let phase = u32::MAX - 18_000_000 * (u32::from(node) + 1);
        bus.add(uagv(NodeId(node)), crystal(ppm[usize::from(node)], phase));
    }
    bus
}

pub(crate) fn seconds(nanos: u64) -> f64 {
    nanos as f64 * 1e-9
}

pub(crate) fn at(millis: u64) -> SimTime {
    SimTime::from_ticks(millis * 1_000_000)
}

/// What is wrong with the place of a frame, `None` if nothing is. `mark` is the
/// start of frame of the reference that began basic cycle `cycle`.
pub(crate) fn misplaced(
    matrix: &SystemMatrix,
    cycle: u8,
    mark: SimTime,
    sent: &Traffic,
) -> Option<String> {
    let from = (sent.start.ticks() - mark.ticks()) as i64;
    let until = (sent.end.ticks() - mark.ticks()) as i64;
    let config = matrix.config();
    let uncertainty = i64::from(config.sync_uncertainty.ticks()) * 1000;
    for window in config.windows.iter().filter(|window| window.is_in(cycle)) {
        let start = i64::from(window.start.ticks()) * 1000 - uncertainty;
        let end = start + i64::from(window.length.ticks()) * 1000 + 2 * uncertainty;
        let middle = (from + until) / 2;
        if middle < start + uncertainty || middle >= end - uncertainty {
            continue;
        }
        return match window.kind {
            WindowKind::Exclusive { id, sender, .. } => {
                let own = id == sent.frame.id() && usize::from(sender.0) == sent.sender;
                let inside = from >= start && until <= end;
                (!own || !inside).then(|| {
                    format!(
                        "{} of node {} from {from} to {until} ns in window {}",
                        sent.frame.id(),
                        sent.sender,
                        window.name
                    )
                })
            }
            WindowKind::Arbitrating { .. } => None,
            WindowKind::Free => Some(format!("{} in a free window", sent.frame.id())),
        };
    }
    Some(format!(
        "{} of node {} at {from} ns outside all windows",
        sent.frame.id(),
        sent.sender
    ))
}

pub(crate) fn is_reference(sent: &Traffic) -> bool {
    sent.frame.id().raw() >> 3 == MATRIX.config().reference.raw() >> 3
}

/// Checks that every frame of `traffic`, except references, is in a window of its
/// own. Times count from the last delivered reference.
pub(crate) fn assert_in_place(traffic: &[Traffic]) {
    let mut mark = None;
    for sent in traffic {
        if is_reference(sent) {
            if !sent.fate.is_error() {
                mark = Some(sent.start);
            }
            continue;
        }
        let mark = mark.expect("nothing is sent before a reference");
        assert_eq!(misplaced(&MATRIX, 0, mark, sent), None, "at {}", sent.start);
    }
}

/// A sequence of numbers that look random (SplitMix64, Steele et al. 2014).
pub(crate) struct Numbers(pub(crate) u64);

impl Numbers {
    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    /// A number below `end`.
    pub(crate) fn below(&mut self, end: u64) -> u64 {
        let number = self.next();
        if end == 0 { 0 } else { number % end }
    }
}

/// The CRC of bits without stuff bits (ISO 11898-1); 0 for bits with their CRC behind them.
pub(crate) fn crc(bits: &[bool]) -> u32 {
    bits.iter().fold(0, |crc, bit| {
        let feedback = (crc >> 14 & 1 == 1) != *bit;
        (crc << 1 & 0x7FFF) ^ if feedback { 0x4599 } else { 0 }
    })
}

/// The bits of a frame from its start to the end of its CRC, stuffed; `false` is dominant.
pub(crate) fn bits_of(frame: &Frame) -> Vec<bool> {
    let mut plain = vec![false];
    let id = frame.id();
    let mut put = |value: u32, count: u32| {
        plain.extend((0..count).rev().map(|bit| value >> bit & 1 == 1));
    };
    if id.is_extended() {
        put(id.raw() >> 18, 11);
        put(0b11, 2);
        put(id.raw() & 0x3_FFFF, 18);
        put(0, 3);
    } else {
        put(id.raw(), 11);
        put(0, 3);
    }
    put(u32::from(frame.len()), 4);
    for byte in frame.data() {
        put(u32::from(*byte), 8);
    }
    let crc = crc(&plain);
    plain.extend((0..15).rev().map(|bit| crc >> bit & 1 == 1));
    let mut stuffed = Vec::new();
    let (mut last, mut run) = (true, 0);
    for bit in plain {
        run = if bit == last { run + 1 } else { 1 };
        last = bit;
        stuffed.push(bit);
        if run == 5 {
            stuffed.push(!bit);
            (last, run) = (!bit, 1);
        }
    }
    stuffed
}
