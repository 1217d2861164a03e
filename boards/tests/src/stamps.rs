//! The time stamps of frames, in silent loop-back: the cell hears itself and the bus does not.
//!
//! A frame is stamped when the interrupt of its reception or transmission is served. The protocol
//! stack takes the latency of the stamps from `StampLatency`; with it both stamps must lead back to
//! the same start of frame, which is the first bit after the request.

use crate::bench::{BIT_RATE, Bench, enable, near};
use crate::board::FACTS;
use crate::board::pac::Interrupt;
use crate::registers::{can, tim2};
use core::sync::atomic::{AtomicU32, Ordering::Relaxed};
use defmt::info;
use ttcan::{Frame, INTERFRAME_BITS, Id, StampLatency, frame_bits};

const MSR: u32 = 0x04;
const TSR: u32 = 0x08;
const RF0R: u32 = 0x0C;
const BTR: u32 = 0x1C;
/// Mailbox 1: identifier, length, data.
const TI1R: u32 = 0x190;
const TDT1R: u32 = 0x194;
const TDL1R: u32 = 0x198;
const TDH1R: u32 = 0x19C;
const INAK: u32 = 1;
const LBKM: u32 = 1 << 30;
const RQCP: [u32; 2] = [1 << 0, 1 << 8];
const TXOK: u32 = 1 << 1;
const RFOM: u32 = 1 << 5;
const CNT: u32 = 0x24;

/// Stamps of the last reception and of the last transmission of each mailbox.
static RECEIVED: AtomicU32 = AtomicU32::new(0);
static SENT: [AtomicU32; 2] = [AtomicU32::new(0), AtomicU32::new(0)];
/// How many of each there were.
static RECEPTIONS: AtomicU32 = AtomicU32::new(0);
static TRANSMISSIONS: AtomicU32 = AtomicU32::new(0);

// SAFETY: the name is the one that the part's vector table asks for.
#[cfg_attr(feature = "f446", unsafe(export_name = "CAN1_RX0"))]
// SAFETY: as above.
#[cfg_attr(feature = "f303", unsafe(export_name = "USB_LP_CAN_RX0"))]
extern "C" fn receive() {
    let stamp = tim2().read(CNT);
    can().write(RF0R, RFOM);
    RECEIVED.store(stamp, Relaxed);
    RECEPTIONS.store(RECEPTIONS.load(Relaxed) + 1, Relaxed);
}

// SAFETY: the name is the one that the part's vector table asks for.
#[cfg_attr(feature = "f446", unsafe(export_name = "CAN1_TX"))]
// SAFETY: as above.
#[cfg_attr(feature = "f303", unsafe(export_name = "USB_HP_CAN_TX"))]
extern "C" fn transmit() {
    let stamp = tim2().read(CNT);
    let status = can().read(TSR);
    for (mailbox, done) in RQCP.into_iter().enumerate() {
        if status & done != 0 {
            can().write(TSR, done);
            SENT[mailbox].store(stamp, Relaxed);
            let sent = status & TXOK << (8 * mailbox) != 0;
            TRANSMISSIONS.store(TRANSMISSIONS.load(Relaxed) + u32::from(sent), Relaxed);
        }
    }
}

#[cfg(feature = "f446")]
const INTERRUPTS: [Interrupt; 2] = [Interrupt::CAN1_RX0, Interrupt::CAN1_TX];
#[cfg(feature = "f303")]
const INTERRUPTS: [Interrupt; 2] = [Interrupt::USB_LP_CAN_RX0, Interrupt::USB_HP_CAN_TX];

/// A board whose CAN cell hears itself.
fn in_loop_back() -> Bench {
    let mut bench = Bench::start();
    loop_back(&mut bench);
    INTERRUPTS.into_iter().for_each(enable);
    bench
}

/// Lets the CAN cell hear itself and nothing else, and keeps it off the bus.
pub(crate) fn loop_back(bench: &mut Bench) {
    bench.sled.can.leave_bus();
    let left = bench.wait(10_000, || can().read(MSR) & INAK != 0);
    assert!(left, "the CAN cell does not leave the bus");
    can().set(BTR, LBKM);
    bench.sled.can.join_bus(true);
    let joined = bench.wait(10_000, || can().read(MSR) & INAK == 0);
    assert!(joined, "the CAN cell does not join its loop-back");
}

/// A frame of this length, with many stuff bits or few.
fn frame(len: u8, fill: u8) -> Frame {
    Frame::from_parts(Id::constant::<0x2A5>(), len, [fill; 8])
}

#[embedded_test::tests(default_timeout = 5)]
mod tests {
    use super::*;

    #[test]
    fn both_stamps_lead_back_to_the_start_of_the_frame() {
        let mut bench = in_loop_back();
        let bit = bench.bit();
        let latency = StampLatency::bxcan(bit, FACTS.stamp_ticks);
        let (mut soonest, mut latest, mut apart) = (i32::MAX, i32::MIN, 0);
        for (round, len) in (1..).zip((0..=8).cycle().take(27)) {
            // Another phase of the bit each time.
            bench.pause(300 + round % 7);
            let frame = frame(len, if round % 2 == 0 { 0 } else { 0x5A });
            let requested = bench.now();
            assert!(bench.sled.can.load(&frame).is_ok(), "the mailbox is full");
            let done = bench.wait(5_000, || {
                RECEPTIONS.load(Relaxed) == round && TRANSMISSIONS.load(Relaxed) == round
            });
            assert!(
                done,
                "frame {round}: {} received, {} sent",
                RECEPTIONS.load(Relaxed),
                TRANSMISSIONS.load(Relaxed)
            );
            let length = frame_bits(&frame) * bit;
            let start = |stamp: u32, latency: i32| {
                let end = stamp.wrapping_sub_signed(latency);
                end.wrapping_sub(length)
                    .wrapping_sub(requested)
                    .cast_signed()
            };
            let received = start(RECEIVED.load(Relaxed), latency.receive);
            let sent = start(SENT[0].load(Relaxed), latency.transmit);
            soonest = soonest.min(sent);
            latest = latest.max(sent);
            apart = apart.max(received.abs_diff(sent));
        }
        info!(
            "ticks from request to start: {=i32} to {=i32}, a bit is {=u32}",
            soonest, latest, bit
        );
        near(
            "difference of both stamps at most, ticks",
            apart,
            0,
            FACTS.stamp_ticks,
        );
        // A frame starts with the next bit. The manuals do not say in which part of the last bit
        // the flags rise; half a bit is left for that, and one bit for the cell to see the request.
        let bit = bit.cast_signed();
        assert!(soonest >= -bit / 2, "a frame starts before its request");
        assert!(
            latest <= 2 * bit,
            "a frame starts two bits after its request"
        );
        assert!(
            latest - soonest <= bit + bit / 4,
            "the start varies by more than a bit"
        );
    }

    /// A list of identifiers that fills a bank of filters and a half; the others stay outside.
    #[test]
    fn the_filter_takes_the_identifiers_that_it_was_given() {
        let mut bench = in_loop_back();
        let accepted = [0x000, 0x0C9, 0x2A5, 0x400, 0x555, 0x7FF];
        bench.sled.can.accept_only(&accepted);
        let (mut sent, mut heard) = (0, 0);
        for id in accepted
            .into_iter()
            .chain([0x001, 0x0C8, 0x2A4, 0x3FF, 0x7FE])
        {
            let listed = accepted.contains(&id);
            let id = Id::standard(id).expect("a standard identifier");
            let frame = Frame::from_parts(id, 1, [0x5A; 8]);
            assert!(bench.sled.can.load(&frame).is_ok(), "the mailbox is full");
            sent += 1;
            heard += u32::from(listed);
            let done = bench.wait(5_000, || TRANSMISSIONS.load(Relaxed) == sent);
            assert!(done, "{} frames sent", TRANSMISSIONS.load(Relaxed));
            bench.pause(20);
            assert!(
                RECEPTIONS.load(Relaxed) == heard,
                "{} frames received after {:#X}",
                RECEPTIONS.load(Relaxed),
                frame.id().raw()
            );
        }
    }

    #[test]
    fn frames_follow_each_other_in_bit_times() {
        let mut bench = in_loop_back();
        let bit = bench.bit();
        near("bit rate", bench.ticks(1_000_000) / bit, BIT_RATE, 0);
        for (round, len) in (1..).zip([0, 3, 8]) {
            let (first, second) = (frame(1, 0xFF), frame(len, 0x00));
            assert!(bench.sled.can.load(&first).is_ok(), "the mailbox is full");
            can().write(TDT1R, len.into());
            can().write(TDL1R, 0);
            can().write(TDH1R, 0);
            can().write(TI1R, second.id().raw() << 21 | 1);
            let done = bench.wait(5_000, || TRANSMISSIONS.load(Relaxed) == 2 * round);
            assert!(done, "{} frames sent", TRANSMISSIONS.load(Relaxed));
            let apart = SENT[1].load(Relaxed).wrapping_sub(SENT[0].load(Relaxed));
            let expected = (frame_bits(&second) + INTERFRAME_BITS) * bit;
            near("ticks from end to end", apart, expected, FACTS.stamp_ticks);
        }
    }
}
