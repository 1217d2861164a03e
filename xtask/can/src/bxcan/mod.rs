//! The register-level model of ST's bxCAN, after its chapters in RM0390 (STM32F446, two controllers
//! with shared filters) and RM0316 (STM32F303, one controller).
//!
//! The controller holds registers, mailboxes and FIFOs. The bus reports to it the events of its
//! medium access control. Where the manuals are silent, the model assumes:
//!
//! - ALST and TERR describe the latest attempt; a success clears both.
//! - FULL is cleared by software only, as the manuals say.
//! - ERRI is set when an enabled error flag rises, and by every error code while LECIE is set.
//! - Filter numbers of the second controller start at its first bank.
//! - With INRQ and SLEEP both set, the controller initialises. ST's own driver relies on it:
//!   `HAL_CAN_Init` of STM32CubeF4 sets INRQ, waits for INAK, and only then clears SLEEP.
//! - In loop back mode the frame is not driven onto the bus.
//! - The eleven recessive bits after which the controller leaves initialisation are those at its
//!   receive pin, in loop back mode too. The manuals say that the pin is disregarded in this mode
//!   (RM0390 30.5.2), and that INAK is cleared after eleven recessive bits "on the CAN RX signal"
//!   (30.9.2). Users report that without a transceiver INAK stays set even in loop back mode.
//! - The debug freeze (DBF) has no effect.

mod fifo;
mod filter;
mod mailbox;
pub(crate) mod registers;

use embedded_can::Id;

use crate::Frame;
use crate::confinement::{ErrorCounters, ErrorKind, ErrorState};
use crate::time::{BitSegments, Ps};
use fifo::{Fifo, Stored};
pub(crate) use filter::FilterBanks;
use mailbox::Mailbox;
use registers::{self as reg, btr, esr, ier, ir, mcr, msr};

/// Levels of a controller's four interrupt lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IrqLines {
    /// Transmit: a request is complete.
    pub tx: bool,
    /// Receive FIFO 0: message pending, full or overrun.
    pub rx0: bool,
    /// Receive FIFO 1: message pending, full or overrun.
    pub rx1: bool,
    /// Status change and error.
    pub sce: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    Sleep,
    Init,
    /// Entering normal mode; waits for eleven recessive bits.
    Joining {
        from_sleep: bool,
    },
    Normal,
}

/// What the bus knows of the controller's receive pin and activity; needed for MSR.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LineStatus {
    pub transmitting: bool,
    pub receiving: bool,
    pub last_sample: bool,
    pub level: bool,
}

/// What the bus knows of a mailbox at the time of a write.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WireStatus {
    /// The mailbox whose frame is being sent.
    pub sending: Option<u8>,
    /// True if a frame of this controller may have started between the time that the bus has
    /// processed and the time of the write.
    pub may_have_started: bool,
}

/// What the bus must do after a register write.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Effects {
    /// The requested mode may have changed.
    pub mode: bool,
    /// Master reset.
    pub reset: bool,
    /// Mailboxes whose abort must be decided when the bus reaches the time of the write, one bit
    /// each.
    pub aborts: u8,
}

/// One controller.
#[derive(Clone, Debug)]
pub(crate) struct BxCan {
    /// True for CAN2 of a pair, which has no filter registers of its own.
    second: bool,
    mode: Mode,
    mode_requested_at: Ps,
    mcr: u32,
    ier: u32,
    btr: u32,
    flags: u32,
    lec: u32,
    counters: ErrorCounters,
    mailboxes: [Mailbox; 3],
    fifos: [Fifo; 2],
    /// Bits of the first data word that reception inverts: the controller is broken.
    defect: u32,
    /// It does not leave the bus when the program asks for another mode: it is broken.
    jammed: bool,
    /// It takes a bit timing over outside initialisation: it is broken.
    unlocked: bool,
    requests: u64,
    /// Time at which the counter of time triggered mode was zero.
    timer_origin: Ps,
    /// Time stamp of the latest start of frame.
    start_stamp: u16,
}

impl BxCan {
    pub(crate) fn new(second: bool) -> Self {
        Self {
            second,
            mode: Mode::Sleep,
            mode_requested_at: 0,
            mcr: mcr::AFTER_RESET,
            ier: 0,
            btr: btr::AFTER_RESET,
            flags: 0,
            lec: 0,
            counters: ErrorCounters::default(),
            mailboxes: Default::default(),
            fifos: Default::default(),
            defect: 0,
            jammed: false,
            unlocked: false,
            requests: 0,
            timer_origin: 0,
            start_stamp: 0,
        }
    }

    /// A reset by the clock controller or of the whole chip.
    pub(crate) fn reset(&mut self) {
        *self = Self::new(self.second);
    }

    /// MCR's RESET bit: returns to sleep mode and resets MCR and the FIFOs' counts.
    fn master_reset(&mut self) {
        self.mcr = mcr::AFTER_RESET;
        self.mode = Mode::Sleep;
        self.flags = 0;
        self.fifos = Default::default();
        self.mailboxes = Default::default();
        self.counters = ErrorCounters::default();
        self.lec = 0;
    }

    // Settings that the bus needs.

    pub(crate) fn segments(&self) -> BitSegments {
        BitSegments {
            prescaler: (self.btr & 0x3FF) as u16 + 1,
            before_sample: (self.btr >> 16 & 0xF) as u8 + 1,
            after_sample: (self.btr >> 20 & 0x7) as u8 + 1,
            jump_width: (self.btr >> 24 & 0x3) as u8 + 1,
        }
    }

    pub(crate) const fn silent(&self) -> bool {
        self.btr & btr::SILM != 0
    }

    pub(crate) const fn loop_back(&self) -> bool {
        self.btr & btr::LBKM != 0
    }

    pub(crate) const fn automatic_recovery(&self) -> bool {
        self.mcr & mcr::ABOM != 0
    }

    const fn time_triggered(&self) -> bool {
        self.mcr & mcr::TTCM != 0
    }

    const fn single_shot(&self) -> bool {
        self.mcr & mcr::NART != 0
    }

    /// The mode that INRQ and SLEEP request.
    const fn wanted(&self) -> Mode {
        match (self.mcr & mcr::INRQ != 0, self.mcr & mcr::SLEEP != 0) {
            (true, _) => Mode::Init,
            (false, true) => Mode::Sleep,
            (false, false) => Mode::Normal,
        }
    }

    /// True if the controller must leave the bus as soon as it neither sends nor receives.
    pub(crate) fn wants_to_detach(&self, now: Ps) -> bool {
        now >= self.mode_requested_at
            && matches!(self.mode, Mode::Normal | Mode::Joining { .. })
            && self.wanted() != Mode::Normal
            && !self.jammed
    }

    /// True if the controller must join the bus.
    pub(crate) fn wants_to_attach(&self, now: Ps) -> bool {
        now >= self.mode_requested_at
            && matches!(self.mode, Mode::Init | Mode::Sleep)
            && self.wanted() == Mode::Normal
    }

    /// The controller has left the bus.
    pub(crate) fn detached(&mut self) {
        self.settle(self.wanted());
    }

    /// The controller starts to wait for eleven recessive bits at `now`.
    pub(crate) fn attached(&mut self, now: Ps) {
        self.mode = Mode::Joining {
            from_sleep: self.mode == Mode::Sleep,
        };
        self.timer_origin = now;
    }

    /// True while the controller waits for eleven recessive bits.
    pub(crate) const fn joins(&self) -> bool {
        matches!(self.mode, Mode::Joining { .. })
    }

    /// The controller has seen the eleven recessive bits.
    pub(crate) fn synchronised(&mut self) {
        if matches!(self.mode, Mode::Joining { .. }) {
            self.mode = Mode::Normal;
            self.flags &= !msr::SLAKI;
        }
    }

    /// A frame starts on the bus while the controller sleeps. True if the controller wakes up.
    pub(crate) fn start_while_asleep(&mut self, now: Ps) -> bool {
        if self.mode != Mode::Sleep {
            return false;
        }
        self.flags |= msr::WKUI;
        if self.mcr & mcr::AWUM == 0 {
            return false;
        }
        self.mcr &= !mcr::SLEEP;
        self.mode_requested_at = now;
        true
    }

    /// True if the start of a frame on the bus changes this controller's registers at once.
    pub(crate) const fn minds_start_of_frame(&self) -> bool {
        matches!(self.mode, Mode::Sleep)
            && (self.mcr & mcr::AWUM != 0 || self.ier & ier::WKUIE != 0)
    }

    fn settle(&mut self, mode: Mode) {
        self.mode = mode;
        if mode == Mode::Sleep {
            if self.ier & ier::SLKIE != 0 {
                self.flags |= msr::SLAKI;
            }
        } else {
            self.flags &= !msr::SLAKI;
        }
    }

    // Transmission.

    /// The mailbox to send, and its frame, in a bit that begins at `now`.
    pub(crate) fn pending(&self, now: Ps, bit: Ps) -> Option<(u8, Frame)> {
        if self.silent() && !self.loop_back() {
            return None;
        }
        let by_order = self.mcr & mcr::TXFP != 0;
        let (slot, mailbox) = self
            .mailboxes
            .iter()
            .enumerate()
            .filter(|(_, mailbox)| mailbox.requested_at(now).is_some_and(|at| at <= now))
            .min_by_key(|(slot, mailbox)| {
                let rank = if by_order {
                    mailbox.order()
                } else {
                    u64::from(mailbox.urgency())
                };
                (rank, *slot)
            })?;
        let stamp = self.time_triggered().then(|| self.timer(now, bit));
        Some((slot as u8, mailbox.frame(stamp)?))
    }

    /// The time of the earliest request that still waits for the bus.
    pub(crate) fn earliest_request(&self, now: Ps) -> Option<Ps> {
        if self.silent() && !self.loop_back() {
            return None;
        }
        self.mailboxes
            .iter()
            .filter_map(|mailbox| mailbox.requested_at(now))
            .min()
    }

    /// Decides on an abort once the bus has reached the time of its write: at once, unless the
    /// mailbox is being sent.
    pub(crate) fn decide_abort(&mut self, slot: u8, sending: Option<u8>) {
        if let Some(mailbox) = self.mailboxes.get_mut(usize::from(slot))
            && mailbox.is_aborting()
            && sending != Some(slot)
        {
            mailbox.finish_abort();
        }
    }

    fn timer(&self, now: Ps, bit: Ps) -> u16 {
        (now.saturating_sub(self.timer_origin) / bit.max(1)) as u16
    }

    /// A frame starts: the controller's own or another node's.
    pub(crate) fn frame_started(&mut self, now: Ps, bit: Ps, slot: Option<u8>) {
        if self.time_triggered() {
            self.start_stamp = self.timer(now, bit);
            if let Some(mailbox) = slot.and_then(|slot| self.mailboxes.get_mut(usize::from(slot))) {
                mailbox.stamp(self.start_stamp);
            }
        }
    }

    pub(crate) fn arbitration_lost(&mut self, slot: u8) {
        let single_shot = self.single_shot();
        if let Some(mailbox) = self.mailboxes.get_mut(usize::from(slot)) {
            mailbox.attempt_failed(true, single_shot);
        }
    }

    pub(crate) fn transmitted(&mut self, slot: u8) {
        self.lec = 0;
        if let Some(mailbox) = self.mailboxes.get_mut(usize::from(slot)) {
            mailbox.transmitted();
        }
    }

    // Reception.

    pub(crate) fn corrupt(&mut self, mask: u32) {
        self.defect = mask;
    }

    pub(crate) const fn jam(&mut self, unlocked: bool) {
        self.jammed = true;
        self.unlocked = unlocked;
    }

    pub(crate) fn received(&mut self, frame: &Frame, filters: &FilterBanks) {
        self.lec = 0;
        let mut rir = match frame.id() {
            Id::Standard(id) => u32::from(id.as_raw()) << 21,
            Id::Extended(id) => id.as_raw() << 3 | ir::IDE,
        };
        if frame.is_remote() {
            rir |= ir::RTR;
        }
        let Some(found) = filters.matching(rir, self.second) else {
            return;
        };
        let time = if self.time_triggered() {
            u32::from(self.start_stamp)
        } else {
            0
        };
        let mut bytes = [0; 8];
        bytes[..frame.data().len()].copy_from_slice(frame.data());
        let word = |at: usize| {
            u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
        };
        let message: Stored = [
            rir,
            time << 16 | u32::from(found.index) << 8 | u32::from(frame.dlc()),
            word(0) ^ self.defect,
            word(4),
        ];
        let locked = self.mcr & mcr::RFLM != 0;
        self.fifos[found.fifo].store(message, locked);
    }

    // Errors.

    pub(crate) fn error(&mut self, kind: ErrorKind, slot: Option<u8>) {
        self.lec = kind as u32;
        if self.ier & ier::LECIE != 0 {
            self.flags |= msr::ERRI;
        }
        let single_shot = self.single_shot();
        if let Some(mailbox) = slot.and_then(|slot| self.mailboxes.get_mut(usize::from(slot))) {
            mailbox.attempt_failed(false, single_shot);
        }
    }

    /// Stores the error counters and raises ERRI for error flags that they set.
    pub(crate) fn set_counters(&mut self, counters: ErrorCounters) {
        let before = self.error_flags();
        self.counters = counters;
        let risen = self.error_flags() & !before;
        let enabled = [
            (esr::EWGF, ier::EWGIE),
            (esr::EPVF, ier::EPVIE),
            (esr::BOFF, ier::BOFIE),
        ]
        .iter()
        .any(|(flag, enable)| risen & flag != 0 && self.ier & enable != 0);
        if enabled {
            self.flags |= msr::ERRI;
        }
    }

    fn error_flags(&self) -> u32 {
        let state = self.counters.state();
        let mut flags = 0;
        if self.counters.warning() {
            flags |= esr::EWGF;
        }
        if self.counters.transmit() > 127 || self.counters.receive() > 127 {
            flags |= esr::EPVF;
        }
        if state == ErrorState::BusOff {
            flags |= esr::BOFF;
        }
        flags
    }

    // Registers.

    /// Levels of the interrupt lines (RM0390, bxCAN, "bxCAN interrupts").
    pub(crate) fn irq(&self) -> IrqLines {
        let enabled = |bit: u32| self.ier & bit != 0;
        let fifo = |fifo: &Fifo, pending: u32, full: u32, overrun: u32| {
            let status = fifo.status();
            (status & 0b11 != 0 && enabled(pending))
                || (status & reg::rfr::FULL != 0 && enabled(full))
                || (status & reg::rfr::FOVR != 0 && enabled(overrun))
        };
        IrqLines {
            tx: enabled(ier::TMEIE) && self.mailboxes.iter().any(Mailbox::is_completed),
            rx0: fifo(&self.fifos[0], ier::FMPIE0, ier::FFIE0, ier::FOVIE0),
            rx1: fifo(&self.fifos[1], ier::FMPIE1, ier::FFIE1, ier::FOVIE1),
            sce: (self.flags & msr::ERRI != 0 && enabled(ier::ERRIE))
                || (self.flags & msr::WKUI != 0 && enabled(ier::WKUIE))
                || (self.flags & msr::SLAKI != 0 && enabled(ier::SLKIE)),
        }
    }

    fn tsr(&self) -> u32 {
        let mut value = 0;
        for (slot, mailbox) in self.mailboxes.iter().enumerate() {
            value |= mailbox.status() << (8 * slot);
            value |= u32::from(mailbox.is_empty()) << (26 + slot);
        }
        let by_order = self.mcr & mcr::TXFP != 0;
        let lowest = self
            .mailboxes
            .iter()
            .enumerate()
            .filter(|(_, mailbox)| !mailbox.is_empty())
            .max_by_key(|(slot, mailbox)| {
                let rank = if by_order {
                    mailbox.order()
                } else {
                    u64::from(mailbox.urgency())
                };
                (rank, *slot)
            })
            .map(|(slot, _)| slot);
        let pending = self.mailboxes.iter().filter(|m| !m.is_empty()).count();
        let code = self
            .mailboxes
            .iter()
            .position(Mailbox::is_empty)
            .or(lowest)
            .unwrap_or(0);
        value |= (code as u32) << 24;
        if let Some(slot) = lowest
            && pending > 1
        {
            value |= 1 << (29 + slot);
        }
        value
    }

    fn msr(&self, line: LineStatus) -> u32 {
        let mut value = self.flags;
        value |= match self.mode {
            Mode::Init | Mode::Joining { from_sleep: false } => msr::INAK,
            Mode::Sleep | Mode::Joining { from_sleep: true } => msr::SLAK,
            Mode::Normal => 0,
        };
        for (set, bit) in [
            (line.transmitting, msr::TXM),
            (line.receiving, msr::RXM),
            (line.last_sample, msr::SAMP),
            (line.level, msr::RX),
        ] {
            if set {
                value |= bit;
            }
        }
        value
    }

    fn esr(&self) -> u32 {
        self.error_flags()
            | self.lec << esr::LEC_SHIFT
            | u32::from(self.counters.transmit() & 0xFF) << esr::TEC_SHIFT
            | u32::from(self.counters.receive() & 0xFF) << esr::REC_SHIFT
    }

    pub(crate) fn read(&self, offset: u32, line: LineStatus, filters: &FilterBanks) -> u32 {
        match offset & !3 {
            reg::MCR => self.mcr,
            reg::MSR => self.msr(line),
            reg::TSR => self.tsr(),
            reg::RF0R => self.fifos[0].status(),
            reg::RF1R => self.fifos[1].status(),
            reg::IER => self.ier,
            reg::ESR => self.esr(),
            reg::BTR => self.btr,
            offset @ reg::TI0R..reg::TX_END => {
                let (mailbox, register) = place(offset - reg::TI0R);
                self.mailboxes[mailbox].read(register)
            }
            offset @ reg::RI0R..reg::RX_END => {
                let (fifo, register) = place(offset - reg::RI0R);
                self.fifos[fifo].output(register as usize)
            }
            offset if !self.second => filters.read(offset),
            _ => 0,
        }
    }

    pub(crate) fn write(
        &mut self,
        offset: u32,
        value: u32,
        at: Ps,
        wire: WireStatus,
        filters: &mut FilterBanks,
    ) -> Effects {
        let mut effects = Effects::default();
        match offset & !3 {
            reg::MCR => {
                if value & mcr::RESET != 0 {
                    self.master_reset();
                    effects.reset = true;
                    return effects;
                }
                self.mcr = value & mcr::WRITABLE;
                self.mode_requested_at = at;
                // A change between sleep and initialisation does not involve the bus.
                if matches!(self.mode, Mode::Init | Mode::Sleep) && self.wanted() != Mode::Normal {
                    let wanted = self.wanted();
                    if wanted != self.mode {
                        self.settle(wanted);
                    }
                }
                effects.mode = true;
            }
            reg::MSR => self.flags &= !(value & (msr::ERRI | msr::WKUI | msr::SLAKI)),
            reg::TSR => {
                for slot in 0..3_u8 {
                    let bits = value >> (8 * slot) & 0xFF;
                    let mailbox = &mut self.mailboxes[usize::from(slot)];
                    mailbox.acknowledge(bits);
                    if bits & 0x80 == 0 || mailbox.is_empty() {
                        continue;
                    }
                    if wire.sending == Some(slot) {
                        mailbox.abort_later(at);
                    } else if wire.may_have_started {
                        mailbox.abort_later(at);
                        effects.aborts |= 1 << slot;
                    } else {
                        mailbox.finish_abort();
                    }
                }
            }
            reg::RF0R => self.fifos[0].control(value),
            reg::RF1R => self.fifos[1].control(value),
            reg::IER => self.ier = value & ier::WRITABLE,
            reg::ESR => self.lec = value >> esr::LEC_SHIFT & esr::LEC_MASK,
            reg::BTR if self.mode == Mode::Init || self.unlocked => {
                self.btr = value & btr::WRITABLE
            }
            offset @ reg::TI0R..reg::TX_END => {
                let (mailbox, register) = place(offset - reg::TI0R);
                if self.mailboxes[mailbox].write(register, value) {
                    self.mailboxes[mailbox].request(at, self.requests);
                    self.requests += 1;
                }
            }
            offset if !self.second => filters.write(offset, value),
            _ => {}
        }
        effects
    }
}

/// Mailbox number and register number for an offset into a block of mailboxes.
const fn place(offset: u32) -> (usize, u32) {
    (
        (offset / reg::MAILBOX_STRIDE) as usize,
        offset % reg::MAILBOX_STRIDE / 4,
    )
}
