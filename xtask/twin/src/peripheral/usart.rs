//! The USARTs in asynchronous mode, timed bit by bit: the registers of the F446 (RM0390 chapter 25)
//! and of the F303 (RM0316 chapter 29) over one model of the line.
//!
//! Transmission takes the configured number of bit times per byte, with a data register before the
//! shift register. Reception samples the sender's waveform in the middle of each of the receiver's
//! own bits, so a wrong baud rate causes wrong bytes and framing errors. Parity, the ninth bit,
//! LIN, smartcard, IrDA, mute mode and hardware flow control are not modelled.

use crate::clock::{Cycles, LocalClock, NEVER, Ps};
use crate::part::Family;
use std::collections::VecDeque;

/// Bits of a byte on the line: start bit, eight data bits, stop bit.
const BITS: usize = 10;

/// A byte sent on the transmit pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Sent {
    /// Beginning of the start bit and end of the last stop bit.
    pub start: Cycles,
    pub end: Cycles,
    pub byte: u8,
    /// Core cycles in 256 bit times, which is its baud rate.
    pub bit256: u64,
    /// Beginning of each bit, and the end of the last one.
    edges: [Cycles; BITS + 1],
    /// Times of the first edges, from before the core's clock changed last.
    passed: [Ps; BITS + 1],
    known: usize,
    /// When the transmitter let go of the line before the end.
    pub cut: Option<Cycles>,
}

impl Sent {
    fn new(start: Cycles, end: Cycles, byte: u8, bit256: u64) -> Self {
        let mut edges = core::array::from_fn(|bit| start + (bit as u64 * bit256).div_ceil(256));
        edges[BITS] = end;
        Self {
            start,
            end,
            byte,
            bit256,
            edges,
            passed: [0; BITS + 1],
            known: 0,
            cut: None,
        }
    }

    /// Times of its edges; `clock` is the core's since it last changed.
    pub(crate) fn times(&self, clock: &LocalClock) -> [Ps; BITS + 1] {
        core::array::from_fn(|edge| {
            if edge < self.known {
                self.passed[edge]
            } else {
                clock.time(self.edges[edge])
            }
        })
    }

    /// Level of the line at `now`, while it is being sent.
    fn level(&self, now: Cycles) -> bool {
        match self.edges.iter().rposition(|edge| *edge <= now) {
            None | Some(0) => false,
            Some(bit @ 1..=8) => self.byte >> (bit - 1) & 1 != 0,
            Some(_) => true,
        }
    }

    /// The core's clock changes at `now`; `before` is the old one. The bits that remain take the
    /// same number of cycles of the new clock.
    fn reclock(&mut self, now: Cycles, before: &LocalClock) {
        while self.known <= BITS && self.edges[self.known] <= now {
            self.passed[self.known] = before.time(self.edges[self.known]);
            self.known += 1;
        }
    }
}

/// A byte that the other device sends to the receive pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Arriving {
    /// Beginning of its start bit.
    pub start: Cycles,
    /// Core cycles in 256 bits of the sender.
    pub bit256: u64,
    pub byte: u8,
}

impl Arriving {
    /// Level of the line `after256` / 256 cycles after the beginning of the start bit: start bit,
    /// eight data bits, then high.
    fn level(self, after256: u64) -> bool {
        match after256 / self.bit256.max(1) {
            0 => false,
            bit @ 1..=8 => self.byte >> (bit - 1) & 1 != 0,
            _ => true,
        }
    }
}

// Flags, at the positions that both parts' status registers share.
const PE: u32 = 1 << 0;
const FE: u32 = 1 << 1;
const NF: u32 = 1 << 2;
const ORE: u32 = 1 << 3;
const IDLE: u32 = 1 << 4;
const RXNE: u32 = 1 << 5;
const TC: u32 = 1 << 6;
const TXE: u32 = 1 << 7;

#[derive(Clone, Debug)]
pub(crate) struct Usart {
    family: Family,
    cr1: u32,
    cr2: u32,
    cr3: u32,
    brr: u32,
    other: [u32; 2],
    flags: u32,
    /// True if the status register was read since the flags that this clears were set (F446).
    status_read: bool,
    /// Core cycles per cycle of the USART's kernel clock.
    divider: u64,
    data_in: u8,
    data_out: Option<u8>,
    /// End of the current transmission, and its byte; `None` for an idle frame.
    shifting: Option<(Cycles, Option<Sent>)>,
    arriving: VecDeque<Arriving>,
    /// The byte being received, and the cycle at which its stop bit is sampled.
    receiving: Option<(Cycles, Arriving)>,
    idle_at: Cycles,
    sent: Vec<Sent>,
}

impl Usart {
    pub(crate) fn new(family: Family) -> Self {
        Self {
            family,
            cr1: 0,
            cr2: 0,
            cr3: 0,
            brr: 0,
            other: [0; 2],
            flags: TXE | TC,
            status_read: false,
            divider: 1,
            data_in: 0,
            data_out: None,
            shifting: None,
            arriving: VecDeque::new(),
            receiving: None,
            idle_at: NEVER,
            sent: Vec::new(),
        }
    }

    /// Resets the USART. A byte on the receive line continues.
    pub(crate) fn reset(&mut self, now: Cycles) {
        self.cut(now);
        let arriving = std::mem::take(&mut self.arriving);
        let sent = std::mem::take(&mut self.sent);
        let divider = self.divider;
        *self = Self::new(self.family);
        self.arriving = arriving;
        self.sent = sent;
        self.divider = divider;
    }

    /// Core cycles per cycle of the kernel clock from `now` on. What the USART counts in its own
    /// bits takes the same number of cycles of its kernel clock as before.
    pub(crate) fn set_divider(&mut self, now: Cycles, divider: u64) {
        let before = std::mem::replace(&mut self.divider, divider);
        if before == divider {
            return;
        }
        let fix = |at: &mut Cycles| {
            if *at != NEVER && *at > now {
                *at = now + (*at - now) * divider / before;
            }
        };
        if let Some((end, byte)) = &mut self.shifting {
            fix(end);
            if let Some(byte) = byte {
                fix(&mut byte.end);
                byte.edges.iter_mut().for_each(fix);
            }
        }
        if let Some((at, _)) = &mut self.receiving {
            fix(at);
        }
        fix(&mut self.idle_at);
    }

    /// The core's clock changes at `now`; `before` is the old one. What comes from outside keeps
    /// its times. What the USART does itself keeps its number of cycles.
    pub(crate) fn reclock(
        &mut self,
        now: Cycles,
        before: &LocalClock,
        scale: impl Fn(Cycles) -> Cycles,
    ) {
        if let Some((_, Some(byte))) = &mut self.shifting {
            byte.reclock(now, before);
        }
        for byte in &mut self.arriving {
            if byte.start > now {
                byte.start = scale(byte.start);
            }
        }
    }

    /// The transmitter lets go of its pin: the byte on the line ends here.
    pub(crate) fn cut(&mut self, now: Cycles) {
        if let Some((_, Some(mut byte))) = self.shifting.take() {
            byte.cut = Some(now);
            self.sent.push(byte);
        }
    }

    fn enabled(&self) -> bool {
        match self.family {
            Family::F4 => self.cr1 & 1 << 13 != 0,
            Family::F3 => self.cr1 & 1 != 0,
        }
    }

    fn transmits(&self) -> bool {
        self.enabled() && self.cr1 & 1 << 3 != 0
    }

    fn receives(&self) -> bool {
        self.enabled() && self.cr1 & 1 << 2 != 0
    }

    /// True if transmitter and receiver share the transmit pin (RM0390 25.4.10, RM0316 29.5.14).
    fn half_duplex(&self) -> bool {
        self.cr3 & 1 << 3 != 0
    }

    /// Level that the transmitter gives to its pin at `now`; `None` while it does not drive it.
    pub(crate) fn line(&self, now: Cycles) -> Option<bool> {
        match &self.shifting {
            Some((_, Some(sent))) => Some(sent.level(now)),
            _ => (self.transmits() && !self.half_duplex()).then_some(true),
        }
    }

    /// Core cycles in 256 bit times (RM0390 25.4.4, RM0316 29.5.4).
    fn bit256(&self) -> u64 {
        let brr = u64::from(self.brr & 0xFFFF);
        let kernel256 = if self.cr1 & 1 << 15 == 0 {
            brr * 256
        } else {
            // Oversampling by 8: the fraction has three bits.
            ((brr & !0xF) + ((brr & 7) << 1)) * 128
        };
        (kernel256 * self.divider).max(256)
    }

    /// Bits in a frame, from the start bit to the last stop bit, in half bits.
    fn frame_halves(&self) -> u64 {
        let data = if self.cr1 & 1 << 12 == 0 { 8 } else { 9 };
        let stop_halves = match self.cr2 >> 12 & 3 {
            0 => 2,
            1 => 1,
            2 => 4,
            _ => 3,
        };
        2 * (1 + data) + stop_halves
    }

    fn frame_cycles(&self) -> Cycles {
        (self.frame_halves() * self.bit256()).div_ceil(512)
    }

    /// Whether bytes were sent since they were taken last.
    pub(crate) fn has_sent(&self) -> bool {
        !self.sent.is_empty()
    }

    /// Bytes sent since the last call.
    pub(crate) fn drain_sent(&mut self) -> Vec<Sent> {
        std::mem::take(&mut self.sent)
    }

    /// The other device sends a byte. Calls must be in order of time.
    pub(crate) fn receive(&mut self, byte: Arriving) {
        self.arriving.push_back(byte);
    }

    pub(crate) fn transmit_request(&self) -> bool {
        self.cr3 & 1 << 7 != 0 && self.transmits() && self.flags & TXE != 0
    }

    pub(crate) fn receive_request(&self) -> bool {
        self.cr3 & 1 << 6 != 0 && self.flags & RXNE != 0
    }

    /// Level of the interrupt line (RM0390 table 149, RM0316 table 171).
    pub(crate) fn interrupt(&self) -> bool {
        let f = self.flags;
        let enabled = |bit: u32| self.cr1 & 1 << bit != 0;
        enabled(7) && f & TXE != 0
            || enabled(6) && f & TC != 0
            || enabled(5) && f & (RXNE | ORE) != 0
            || enabled(4) && f & IDLE != 0
            || enabled(8) && f & PE != 0
            // With DMA, errors raise the interrupt if EIE is set.
            || self.cr3 & 1 != 0 && self.cr3 & 1 << 6 != 0 && f & (FE | NF | ORE) != 0
    }

    pub(crate) fn next_event(&self) -> Cycles {
        let shift = self.shifting.map_or(NEVER, |(end, _)| end);
        let sample = self.receiving.map_or(NEVER, |(at, _)| at);
        let start = if self.receiving.is_none() {
            self.arriving.front().map_or(NEVER, |byte| byte.start)
        } else {
            NEVER
        };
        shift.min(sample).min(start).min(self.idle_at)
    }

    /// Processes events up to `now`, which is at most [`Usart::next_event`].
    pub(crate) fn advance(&mut self, now: Cycles) {
        if let Some((end, byte)) = self.shifting
            && end <= now
        {
            self.shifting = None;
            self.sent.extend(byte);
            self.load(end);
            if self.shifting.is_none() && self.flags & TXE != 0 {
                self.flags |= TC;
            }
        }
        if let Some((at, byte)) = self.receiving
            && at <= now
        {
            self.receiving = None;
            self.sample(at, byte);
        }
        if self.idle_at <= now {
            self.idle_at = NEVER;
            self.flags |= IDLE;
            self.status_read = false;
        }
        if self.receiving.is_none()
            && let Some(byte) = self.arriving.front().copied()
            && byte.start <= now
        {
            self.arriving.pop_front();
            self.idle_at = NEVER;
            if self.receives() {
                // The stop bit is sampled nine and a half bit times of this receiver after the
                // edge.
                let at = byte.start + (self.bit256() * (self.frame_halves() - 1)).div_ceil(512);
                self.receiving = Some((at, byte));
            }
        }
    }

    /// The middle of the stop bit: the byte is complete.
    fn sample(&mut self, at: Cycles, line: Arriving) {
        if !self.receives() {
            return;
        }
        let own = self.bit256();
        let level = |bit: u64| line.level(own * (2 * bit + 1) / 2);
        let byte = (0..8).fold(0, |byte, k| byte | u8::from(level(1 + k)) << k);
        let stop = level(self.frame_halves() / 2 - 1);
        let overrun_detection = self.family == Family::F4 || self.cr3 & 1 << 12 == 0;
        if self.flags & RXNE != 0 && overrun_detection {
            self.flags |= ORE;
        } else {
            self.data_in = byte;
            self.flags |= RXNE;
            if !stop {
                self.flags |= FE;
            }
        }
        self.status_read = false;
        // An idle frame is a whole frame of ones after the stop bit.
        let stop_end = at + own.div_ceil(512);
        self.idle_at = stop_end + self.frame_cycles();
    }

    /// Moves the data register into the shift register if that is empty.
    fn load(&mut self, now: Cycles) {
        if self.shifting.is_some() || !self.transmits() {
            return;
        }
        if let Some(byte) = self.data_out.take() {
            let end = now + self.frame_cycles();
            self.shifting = Some((end, Some(Sent::new(now, end, byte, self.bit256()))));
            if self.half_duplex() && self.receives() {
                self.arriving.push_back(Arriving {
                    start: now,
                    bit256: self.bit256(),
                    byte,
                });
            }
            self.flags |= TXE;
            self.flags &= !TC;
        }
    }

    fn write_data(&mut self, value: u32, now: Cycles) {
        if self.status_read {
            self.flags &= !TC;
        }
        self.data_out = Some(value as u8);
        self.flags &= !TXE;
        self.flags &= !TC;
        self.load(now);
    }

    fn read_data(&mut self) -> u32 {
        self.flags &= !RXNE;
        if self.family == Family::F4 && self.status_read {
            // The sequence of reading SR and then DR (RM0390 25.6.1).
            self.flags &= !(ORE | IDLE | FE | NF | PE);
        }
        u32::from(self.data_in)
    }

    fn write_control(&mut self, value: u32, now: Cycles) {
        let transmitted = self.transmits();
        self.cr1 = value;
        if !transmitted && self.transmits() {
            // Setting TE sends an idle frame first (RM0390 25.4.2).
            if self.shifting.is_none() {
                self.shifting = Some((now + self.frame_cycles(), None));
            }
        }
        if !self.enabled() {
            self.data_out = None;
            self.cut(now);
            self.shifting = None;
            self.flags |= TXE | TC;
        }
        if !self.receives() {
            self.receiving = None;
            self.idle_at = NEVER;
        }
        if self.family == Family::F3 && !self.enabled() {
            self.flags = TXE | TC;
        }
    }

    pub(crate) fn read(&mut self, offset: u32) -> Option<u32> {
        match self.family {
            Family::F4 => Some(match offset {
                0x00 => {
                    self.status_read = true;
                    self.flags
                }
                0x04 => self.read_data(),
                0x08 => self.brr,
                0x0C => self.cr1,
                0x10 => self.cr2,
                0x14 => self.cr3,
                0x18 => self.other[0],
                _ => return None,
            }),
            Family::F3 => Some(match offset {
                0x00 => self.cr1,
                0x04 => self.cr2,
                0x08 => self.cr3,
                0x0C => self.brr,
                0x10 | 0x14 => self.other[((offset - 0x10) / 4) as usize],
                0x18 => 0,
                0x1C => {
                    let busy = u32::from(self.receiving.is_some()) << 16;
                    // TEACK and REACK follow the enable bits.
                    let acknowledged =
                        u32::from(self.transmits()) << 21 | u32::from(self.receives()) << 22;
                    self.flags | busy | acknowledged
                }
                0x20 => 0,
                0x24 => self.read_data(),
                0x28 => u32::from(self.data_out.unwrap_or(0)),
                _ => return None,
            }),
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, now: Cycles) {
        match (self.family, offset) {
            (Family::F4, 0x00) => {
                // Writing zero clears a flag; only these flags can be cleared so (RM0390 25.6.1).
                self.flags &= value | !(RXNE | TC);
            }
            (Family::F4, 0x04) | (Family::F3, 0x28) => self.write_data(value, now),
            (Family::F4, 0x08) => self.brr = value & 0xFFFF,
            // Only while the USART is off (RM0316 29.8.4).
            (Family::F3, 0x0C) if !self.enabled() => self.brr = value & 0xFFFF,
            (Family::F4, 0x0C) | (Family::F3, 0x00) => self.write_control(value, now),
            (Family::F4, 0x10) | (Family::F3, 0x04) => self.cr2 = value,
            (Family::F4, 0x14) | (Family::F3, 0x08) => self.cr3 = value,
            (Family::F4, 0x18) | (Family::F3, 0x10) => self.other[0] = value,
            (Family::F3, 0x14) => self.other[1] = value,
            (Family::F3, 0x18) => {
                if value & 1 << 3 != 0 {
                    self.flags &= !RXNE;
                }
                if value & 1 << 4 != 0 {
                    self.data_out = None;
                    self.flags |= TXE;
                }
            }
            (Family::F3, 0x20) => self.flags &= !(value & (PE | FE | NF | ORE | IDLE | TC)),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Arriving, FE, IDLE, ORE, RXNE, TC, TXE, Usart};
    use crate::clock::NEVER;
    use crate::part::Family;

    fn run(usart: &mut Usart, until: u64) {
        while usart.next_event() <= until {
            let at = usart.next_event();
            usart.advance(at);
        }
    }

    /// USART1 at 1 Mbaud from 90 MHz with the core at 180 MHz: a bit is 180 cycles.
    fn megabaud() -> Usart {
        let mut usart = Usart::new(Family::F4);
        usart.set_divider(0, 2);
        usart.write(0x08, 90, 0);
        usart.write(0x0C, 1 << 13 | 1 << 3 | 1 << 2, 0);
        run(&mut usart, 1800);
        usart
    }

    fn arriving(start: u64, byte: u8, bit: u64) -> Arriving {
        Arriving {
            start,
            bit256: bit * 256,
            byte,
        }
    }

    #[test]
    fn a_byte_takes_ten_bit_times_and_the_next_waits_in_the_data_register() {
        let mut usart = megabaud();
        usart.write(0x04, 0x41, 2000);
        assert_eq!(usart.read(0).unwrap() & (TXE | TC), TXE);
        usart.write(0x04, 0x42, 2010);
        assert_eq!(usart.read(0).unwrap() & (TXE | TC), 0);
        run(&mut usart, 3799);
        assert_eq!(usart.read(0).unwrap() & TXE, 0);
        run(&mut usart, 3800);
        assert_eq!(usart.read(0).unwrap() & (TXE | TC), TXE);
        run(&mut usart, 5600);
        assert_eq!(usart.read(0).unwrap() & (TXE | TC), TXE | TC);
        let sent: Vec<_> = usart
            .drain_sent()
            .iter()
            .map(|s| (s.start, s.end, s.byte))
            .collect();
        assert_eq!(sent, [(2000, 3800, 0x41), (3800, 5600, 0x42)]);
    }

    #[test]
    fn the_line_shows_each_bit_of_a_byte_and_is_high_between_them() {
        let mut usart = megabaud();
        usart.write(0x04, 0x41, 2000);
        let levels: Vec<_> = (0..12).map(|bit| usart.line(2000 + 180 * bit)).collect();
        let bits = [0, 1, 0, 0, 0, 0, 0, 1, 0, 1, 1, 1];
        assert_eq!(levels, bits.map(|bit| Some(bit != 0)));
        assert_eq!(usart.line(2179), Some(false));
        run(&mut usart, 3800);
        assert_eq!(usart.line(3800), Some(true));
        usart.write(0x0C, 0, 3900);
        assert_eq!(usart.line(3900), None, "a port that is off lets go");
    }

    #[test]
    fn in_half_duplex_mode_the_receiver_hears_the_transmitter() {
        let mut usart = megabaud();
        usart.write(0x14, 1 << 3, 2000);
        usart.write(0x04, 0xA7, 2000);
        assert_eq!(usart.line(2000), Some(false));
        run(&mut usart, 3709);
        assert_eq!(usart.read(0).unwrap() & RXNE, 0);
        run(&mut usart, 3710);
        assert_eq!(usart.read(4), Some(0xA7));
        run(&mut usart, 3800);
        assert_eq!(usart.line(3800), None, "the pull resistor holds the line");
    }

    #[test]
    fn received_bytes_arrive_in_the_middle_of_their_stop_bit() {
        let mut usart = megabaud();
        usart.receive(arriving(10_000, 0xA7, 180));
        run(&mut usart, 11_709);
        assert_eq!(usart.read(0).unwrap() & RXNE, 0);
        run(&mut usart, 11_710);
        assert_eq!(usart.read(0).unwrap() & (RXNE | FE), RXNE);
        assert_eq!(usart.read(4), Some(0xA7));
        assert_eq!(usart.read(0).unwrap() & RXNE, 0);
    }

    #[test]
    fn the_line_is_idle_a_whole_frame_after_the_last_stop_bit_and_once() {
        let mut usart = megabaud();
        usart.receive(arriving(10_000, 1, 180));
        usart.receive(arriving(11_800, 2, 180));
        run(&mut usart, 15_399);
        assert_eq!(usart.read(0).unwrap() & IDLE, 0);
        run(&mut usart, 15_400);
        assert_ne!(usart.read(0).unwrap() & IDLE, 0);
        usart.read(4);
        assert_eq!(usart.read(0).unwrap() & IDLE, 0);
        run(&mut usart, NEVER - 1);
        assert_eq!(usart.read(0).unwrap() & IDLE, 0);
    }

    #[test]
    fn a_byte_that_finds_the_last_one_unread_is_lost() {
        let mut usart = megabaud();
        usart.receive(arriving(10_000, 1, 180));
        usart.receive(arriving(11_800, 2, 180));
        run(&mut usart, 14_000);
        assert_eq!(usart.read(0).unwrap() & (RXNE | ORE), RXNE | ORE);
        assert_eq!(usart.read(4), Some(1));
        assert_eq!(usart.read(0).unwrap() & ORE, 0);
    }

    #[test]
    fn another_baud_rate_gives_other_bytes_and_framing_errors() {
        let mut usart = megabaud();
        usart.receive(arriving(10_000, 0x00, 250));
        run(&mut usart, 12_000);
        assert_ne!(usart.read(0).unwrap() & FE, 0);
        usart.read(4);
        usart.receive(arriving(20_000, 0x55, 183));
        run(&mut usart, 30_000);
        assert_eq!(usart.read(0).unwrap() & FE, 0, "1.7 % are tolerated");
        assert_eq!(usart.read(4), Some(0x55));
    }

    #[test]
    fn the_f303_clears_by_its_own_register() {
        let mut usart = Usart::new(Family::F3);
        usart.set_divider(0, 2);
        usart.write(0x0C, 937, 0);
        usart.write(0x00, 1 | 1 << 2 | 1 << 3 | 1 << 4, 0);
        usart.receive(arriving(100_000, 0x80, 1875));
        run(&mut usart, 1_000_000);
        assert!(usart.interrupt());
        assert_eq!(usart.read(0x1C).unwrap() & (IDLE | RXNE), IDLE | RXNE);
        usart.write(0x20, IDLE, 1_000_000);
        assert!(!usart.interrupt());
        assert_eq!(usart.read(0x24), Some(0x80));
        usart.write(0x28, 0x7F, 1_000_000);
        assert_eq!(usart.read(0x1C).unwrap() & (TXE | TC), TXE);
        run(&mut usart, 2_000_000);
        assert_eq!(usart.drain_sent()[0].end - 1_000_000, 18_740);
    }
}
