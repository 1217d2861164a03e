//! Shared by the register-level tests: a small driver that configures controllers through their
//! registers, as firmware does.

#![allow(dead_code, reason = "each test binary uses its own part")]

use can_bus::{Bus, ClockRate, Frame, NodeId, Part, SimDuration, SimTime};
use embedded_can::Id;

pub(crate) const MCR: u32 = 0x000;
pub(crate) const MSR: u32 = 0x004;
pub(crate) const TSR: u32 = 0x008;
pub(crate) const RF0R: u32 = 0x00C;
pub(crate) const RF1R: u32 = 0x010;
pub(crate) const IER: u32 = 0x014;
pub(crate) const ESR: u32 = 0x018;
pub(crate) const BTR: u32 = 0x01C;
pub(crate) const TI0R: u32 = 0x180;
pub(crate) const RI0R: u32 = 0x1B0;
pub(crate) const FMR: u32 = 0x200;
pub(crate) const FM1R: u32 = 0x204;
pub(crate) const FS1R: u32 = 0x20C;
pub(crate) const FFA1R: u32 = 0x214;
pub(crate) const FA1R: u32 = 0x21C;
pub(crate) const F0R1: u32 = 0x240;

pub(crate) const INRQ: u32 = 1;
pub(crate) const SLEEP: u32 = 1 << 1;
pub(crate) const TXFP: u32 = 1 << 2;
pub(crate) const RFLM: u32 = 1 << 3;
pub(crate) const NART: u32 = 1 << 4;
pub(crate) const AWUM: u32 = 1 << 5;
pub(crate) const ABOM: u32 = 1 << 6;
pub(crate) const TTCM: u32 = 1 << 7;

/// One bit at 250 kbit/s, in picoseconds.
pub(crate) const BIT: u64 = 4_000_000;

/// 45 MHz / 12 / 15 quanta, sample point after the 11th.
pub(crate) const BTR_250K_F446: u32 = 3 << 20 | 9 << 16 | 11;
/// 36 MHz / 9 / 16 quanta, sample point after the 12th.
pub(crate) const BTR_250K_F303: u32 = 3 << 20 | 10 << 16 | 8;

pub(crate) const fn at_us(us: u64) -> SimTime {
    SimTime::from_ticks(us * 1_000_000)
}

pub(crate) const fn ps(ps: u64) -> SimTime {
    SimTime::from_ticks(ps)
}

pub(crate) fn bits(n: u64) -> SimDuration {
    SimDuration::from_ticks(n * BIT)
}

pub(crate) fn frame(id: u16, data: &[u8]) -> Frame {
    Frame::standard(id, data).expect("the test's frames are valid")
}

pub(crate) fn f446() -> ClockRate {
    ClockRate::new(45_000_000)
}

pub(crate) fn f303() -> ClockRate {
    ClockRate::new(36_000_000)
}

/// Adds an F446 controller and brings it to normal mode with one filter that accepts everything
/// into FIFO 0. `options` are further bits of MCR. The bus is at 100 us afterwards.
pub(crate) fn normal_node(bus: &mut Bus, options: u32) -> NodeId {
    let node = bus.add_bxcan(Part::F446, f446());
    configure(bus, node, options, BTR_250K_F446);
    node
}

pub(crate) fn configure(bus: &mut Bus, node: NodeId, options: u32, btr: u32) {
    let now = bus.now();
    bus.write(node, MCR, INRQ | options, now);
    bus.advance_to(now);
    assert_eq!(bus.read(node, MSR) & 3, 1, "initialisation acknowledged");
    bus.write(node, BTR, btr, now);
    bus.write(node, FMR, 1 | 28 << 8, now);
    bus.write(node, FS1R, 1, now);
    bus.write(node, FA1R, 1, now);
    bus.write(node, FMR, 28 << 8, now);
    bus.write(node, MCR, options, now);
    bus.advance_to(now + bits(25));
    assert_eq!(bus.read(node, MSR) & 3, 0, "normal mode");
}

/// Loads a mailbox and requests its transmission.
pub(crate) fn request(bus: &mut Bus, node: NodeId, mailbox: u32, frame: &Frame, at: SimTime) {
    let base = TI0R + 0x10 * mailbox;
    let word = |from: usize| {
        frame
            .data()
            .iter()
            .skip(from)
            .take(4)
            .rev()
            .fold(0, |word, byte| word << 8 | u32::from(*byte))
    };
    bus.write(node, base + 4, u32::from(frame.dlc()), at);
    bus.write(node, base + 8, word(0), at);
    bus.write(node, base + 12, word(4), at);
    let remote = u32::from(frame.is_remote()) << 1;
    let tir = match frame.id() {
        Id::Standard(id) => u32::from(id.as_raw()) << 21,
        Id::Extended(id) => id.as_raw() << 3 | 1 << 2,
    };
    bus.write(node, base, tir | remote | 1, at);
}

/// Reads and releases the oldest message of FIFO 0: RIxR, RDTxR and the data.
pub(crate) fn take(bus: &mut Bus, node: NodeId) -> Option<(u32, u32, [u32; 2])> {
    if bus.read(node, RF0R) & 3 == 0 {
        return None;
    }
    let message = (
        bus.read(node, RI0R),
        bus.read(node, RI0R + 4),
        [bus.read(node, RI0R + 8), bus.read(node, RI0R + 12)],
    );
    bus.write(node, RF0R, 1 << 5, bus.now());
    Some(message)
}

pub(crate) fn tec(bus: &Bus, node: NodeId) -> u32 {
    bus.read(node, ESR) >> 16 & 0xFF
}

pub(crate) fn rec(bus: &Bus, node: NodeId) -> u32 {
    bus.read(node, ESR) >> 24
}

pub(crate) fn lec(bus: &Bus, node: NodeId) -> u32 {
    bus.read(node, ESR) >> 4 & 7
}

/// A frame with this identifier and other data, for collisions of equal identifiers.
pub(crate) fn same_id(id: u16, byte: u8) -> Frame {
    frame(id, &[byte])
}
