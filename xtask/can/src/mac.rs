//! One node's medium access control: the state machine of ISO 11898-1 that turns levels into
//! frames, errors and counters, one bit at a time.

use crate::Frame;
use crate::confinement::{ErrorCounters, ErrorKind, ErrorState};
use crate::wire::{Decoder, Field, Level, WireFrame};

/// Recessive bits after which a node that joins the bus considers it idle.
const INTEGRATION_BITS: u8 = 11;
/// Number of sequences of [`INTEGRATION_BITS`] recessive bits that end bus-off.
const RECOVERY_SEQUENCES: u8 = 128;
/// Length of an error or overload flag.
const FLAG_BITS: u8 = 6;
/// Length of an error or overload delimiter.
const DELIMITER_BITS: u8 = 8;
/// Pause of an error-passive transmitter after intermission.
const SUSPEND_BITS: u8 = 8;

/// What a node learned from a sampled bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Event {
    /// Eleven recessive bits seen after joining.
    Synchronised,
    /// A start of frame was sampled. If `may_join`, a node with a pending frame may send its
    /// identifier from the next bit on.
    StartSeen { may_join: bool },
    /// Another node's identifier won the arbitration at this bit of the frame.
    ArbitrationLost { slot: u8, frame: Frame, bit: u16 },
    /// The node has sent its own frame completely.
    Transmitted { slot: u8, frame: Frame },
    /// A frame became valid for the receiver.
    Received { frame: Frame },
    /// The node detected an error. The slot is that of its own frame, if it was sending one.
    Error {
        kind: ErrorKind,
        slot: Option<u8>,
        bit: u16,
    },
    /// Bus-off has ended.
    Recovered,
}

#[derive(Clone, Debug)]
struct Transmission {
    slot: u8,
    frame: Frame,
    wire: WireFrame,
}

#[derive(Clone, Debug)]
struct FrameProgress {
    decoder: Decoder,
    /// Bits sampled since start of frame, stuff bits included.
    position: u16,
    sending: Option<Transmission>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FlagKind {
    ActiveError,
    PassiveError,
    Overload,
}

#[derive(Clone, Debug)]
enum Phase {
    /// Not on the bus: reset, initialisation or sleep.
    Detached,
    Integrating {
        seen: u8,
    },
    Idle,
    InFrame(Box<FrameProgress>),
    Flag {
        kind: FlagKind,
        transmitter: bool,
        /// Bits sent (active, overload) or equal bits seen in a row (passive).
        seen: u8,
        last: Option<Level>,
        /// An error-passive transmitter without an acknowledge counts this error only if it reads a
        /// dominant bit during its flag.
        excused: bool,
    },
    FlagEnd {
        kind: FlagKind,
        transmitter: bool,
        dominant: u8,
        first: bool,
    },
    Delimiter {
        transmitter: bool,
        seen: u8,
    },
    Intermission {
        transmitter: bool,
        seen: u8,
    },
    Suspend {
        seen: u8,
    },
    BusOff {
        recovering: bool,
        run: u8,
        sequences: u8,
    },
}

/// The state machine.
#[derive(Clone, Debug)]
pub(crate) struct Mac {
    phase: Phase,
    counters: ErrorCounters,
    /// Listen-only (bxCAN's silent mode): never drives the bus but reads its own dominant bits
    /// back.
    pub(crate) silent: bool,
    /// Loop back: treats its own frames as acknowledged and receives them.
    pub(crate) loop_back: bool,
    /// Starts the recovery from bus-off without a request.
    pub(crate) automatic_recovery: bool,
}

impl Mac {
    pub(crate) fn new() -> Self {
        Self {
            phase: Phase::Detached,
            counters: ErrorCounters::default(),
            silent: false,
            loop_back: false,
            automatic_recovery: false,
        }
    }

    pub(crate) const fn counters(&self) -> ErrorCounters {
        self.counters
    }

    /// Back to the state after power-on.
    pub(crate) fn reset(&mut self) {
        *self = Self::new();
    }

    /// Leaves the bus at once. The error counters stay.
    pub(crate) fn detach(&mut self) {
        self.phase = Phase::Detached;
    }

    /// Joins the bus after eleven recessive bits. A node in bus-off starts its recovery.
    pub(crate) fn attach(&mut self) {
        self.phase = if self.counters.state() == ErrorState::BusOff {
            Phase::BusOff {
                recovering: true,
                run: 0,
                sequences: 0,
            }
        } else {
            Phase::Integrating { seen: 0 }
        };
    }

    pub(crate) const fn is_detached(&self) -> bool {
        matches!(self.phase, Phase::Detached)
    }

    pub(crate) const fn is_idle(&self) -> bool {
        matches!(self.phase, Phase::Idle)
    }

    pub(crate) const fn is_in_frame(&self) -> bool {
        matches!(self.phase, Phase::InFrame(_))
    }

    /// True if the node neither sends nor receives, so that it may leave the bus.
    pub(crate) const fn is_quiescent(&self) -> bool {
        matches!(
            self.phase,
            Phase::Detached
                | Phase::Integrating { .. }
                | Phase::Idle
                | Phase::Intermission { .. }
                | Phase::Suspend { .. }
                | Phase::BusOff { .. }
        )
    }

    /// True if recessive bits change nothing in this node except its count of them.
    pub(crate) const fn can_wait(&self) -> bool {
        matches!(
            self.phase,
            Phase::Detached
                | Phase::Integrating { .. }
                | Phase::Idle
                | Phase::Suspend { .. }
                | Phase::BusOff { .. }
        )
    }

    /// Whether the node is sending a frame, and from which slot.
    pub(crate) fn sending(&self) -> Option<(u8, &Frame, &WireFrame)> {
        match &self.phase {
            Phase::InFrame(progress) => progress
                .sending
                .as_ref()
                .map(|sending| (sending.slot, &sending.frame, &sending.wire)),
            _ => None,
        }
    }

    /// Bits of the frame in progress that the node has sampled.
    pub(crate) fn position(&self) -> Option<u16> {
        match &self.phase {
            Phase::InFrame(progress) => Some(progress.position),
            _ => None,
        }
    }

    /// Whether the node is receiving a frame.
    pub(crate) fn is_receiving(&self) -> bool {
        matches!(&self.phase, Phase::InFrame(progress) if progress.sending.is_none())
    }

    /// Whether the node would acknowledge a valid frame.
    pub(crate) fn acknowledges(&self) -> bool {
        !self.silent && self.is_receiving()
    }

    /// Number of recessive bits on an idle bus after which the node's state changes visibly.
    pub(crate) const fn patience(&self) -> Option<u64> {
        match self.phase {
            Phase::Integrating { seen } => Some((INTEGRATION_BITS - seen) as u64),
            Phase::Suspend { seen } => Some((SUSPEND_BITS - seen) as u64),
            Phase::BusOff {
                recovering: true,
                run,
                sequences,
            } => {
                let done = sequences as u64 * INTEGRATION_BITS as u64 + run as u64;
                let next = if sequences == 0 {
                    1
                } else {
                    RECOVERY_SEQUENCES as u64
                };
                Some(next * INTEGRATION_BITS as u64 - done)
            }
            _ => None,
        }
    }

    /// Counts `bits` recessive bits of an idle bus, at most [`Self::patience`].
    pub(crate) fn wait(&mut self, bits: u64, events: &mut Vec<Event>) {
        if self.patience().is_some() {
            for _ in 0..bits {
                self.sample(Level::Recessive, events);
            }
        }
    }

    /// What the node waits for has not come yet: it saw a dominant bit.
    pub(crate) const fn wait_in_vain(&mut self) {
        match &mut self.phase {
            Phase::Integrating { seen } => *seen = 0,
            Phase::BusOff { run, .. } => *run = 0,
            _ => {}
        }
    }

    /// Starts to send in the bit that begins now. Allowed only while idle.
    pub(crate) fn start(&mut self, slot: u8, frame: Frame) {
        self.phase = Phase::InFrame(Box::new(FrameProgress {
            decoder: Decoder::new(),
            position: 0,
            sending: Some(Transmission {
                slot,
                frame,
                wire: WireFrame::encode(&frame),
            }),
        }));
    }

    /// Joins a frame whose start was just sampled, sending from the identifier on.
    pub(crate) fn join(&mut self, slot: u8, frame: Frame) {
        if let Phase::InFrame(progress) = &mut self.phase
            && progress.position == 1
            && progress.sending.is_none()
        {
            progress.sending = Some(Transmission {
                slot,
                frame,
                wire: WireFrame::encode(&frame),
            });
        }
    }

    /// The level that the node drives in the bit that begins now.
    pub(crate) fn drive(&self) -> Level {
        match &self.phase {
            Phase::InFrame(progress) => match &progress.sending {
                Some(sending) => sending
                    .wire
                    .levels()
                    .get(usize::from(progress.position))
                    .copied()
                    .unwrap_or(Level::Recessive),
                None => Level::from_bit(
                    !(progress.decoder.next_field() == Field::AcknowledgeSlot
                        && progress.decoder.crc_matches()),
                ),
            },
            Phase::Flag {
                kind: FlagKind::ActiveError | FlagKind::Overload,
                ..
            } => Level::Dominant,
            _ => Level::Recessive,
        }
    }

    /// Processes the level at the sample point of a bit.
    pub(crate) fn sample(&mut self, level: Level, events: &mut Vec<Event>) {
        let driven = self.drive();
        let level = if self.silent {
            level.and(driven)
        } else {
            level
        };
        let dominant = level == Level::Dominant;
        match &mut self.phase {
            Phase::Detached => {}
            Phase::Integrating { seen } => {
                *seen = if dominant { 0 } else { *seen + 1 };
                if *seen == INTEGRATION_BITS {
                    self.phase = Phase::Idle;
                    events.push(Event::Synchronised);
                }
            }
            Phase::Idle => {
                // Nodes with a pending frame have started together with the first sender.
                if dominant {
                    self.start_seen(false, events);
                }
            }
            Phase::InFrame(_) => self.sample_frame(level, driven, events),
            Phase::Flag { .. } => self.sample_flag(level, events),
            Phase::FlagEnd { .. } => self.sample_flag_end(dominant, events),
            &mut Phase::Delimiter { transmitter, seen } => {
                self.sample_delimiter(transmitter, seen, dominant, events);
            }
            &mut Phase::Intermission { transmitter, seen } => {
                self.sample_intermission(transmitter, seen, dominant, events);
            }
            Phase::Suspend { seen } => {
                if dominant {
                    self.start_seen(false, events);
                } else {
                    *seen += 1;
                    if *seen == SUSPEND_BITS {
                        self.phase = Phase::Idle;
                    }
                }
            }
            Phase::BusOff {
                recovering,
                run,
                sequences,
            } => {
                if *recovering {
                    *run = if dominant { 0 } else { *run + 1 };
                    if *run == INTEGRATION_BITS {
                        *run = 0;
                        *sequences += 1;
                        if *sequences == 1 {
                            events.push(Event::Synchronised);
                        }
                        if *sequences == RECOVERY_SEQUENCES {
                            self.counters.clear();
                            self.phase = Phase::Idle;
                            events.push(Event::Recovered);
                        }
                    }
                }
            }
        }
    }

    /// One of the recessive bits after a flag, after `seen` of them.
    fn sample_delimiter(
        &mut self,
        transmitter: bool,
        seen: u8,
        dominant: bool,
        events: &mut Vec<Event>,
    ) {
        if !dominant {
            self.phase = if seen + 1 == DELIMITER_BITS {
                Phase::Intermission {
                    transmitter,
                    seen: 0,
                }
            } else {
                Phase::Delimiter {
                    transmitter,
                    seen: seen + 1,
                }
            };
        } else if seen == DELIMITER_BITS - 1 {
            self.overload(transmitter);
        } else {
            self.error(ErrorKind::Form, transmitter, None, 0, events);
        }
    }

    /// One of the three bits between two frames, after `seen` of them.
    fn sample_intermission(
        &mut self,
        transmitter: bool,
        seen: u8,
        dominant: bool,
        events: &mut Vec<Event>,
    ) {
        let third = seen == 2;
        let must_pause = transmitter && self.counters.state() == ErrorState::Passive;
        if dominant && third {
            self.start_seen(!must_pause, events);
        } else if dominant {
            self.overload(transmitter);
        } else if third {
            self.phase = if must_pause {
                Phase::Suspend { seen: 0 }
            } else {
                Phase::Idle
            };
        } else {
            self.phase = Phase::Intermission {
                transmitter,
                seen: seen + 1,
            };
        }
    }

    /// Processes a level when the node has lost synchronisation with the bits on the bus, as with a
    /// wrong bit rate. Inside a frame this is an error: a bit error if the node sends the frame,
    /// otherwise a stuff error. Outside frames the node samples the level as usual.
    pub(crate) fn sample_out_of_step(&mut self, level: Level, events: &mut Vec<Event>) {
        if let Phase::InFrame(progress) = &self.phase {
            let slot = progress.sending.as_ref().map(|sending| sending.slot);
            let position = progress.position;
            let kind = if slot.is_some() {
                ErrorKind::BitRecessive
            } else {
                ErrorKind::Stuff
            };
            self.error(kind, slot.is_some(), slot, position, events);
        } else {
            self.sample(level, events);
        }
    }

    fn start_seen(&mut self, may_join: bool, events: &mut Vec<Event>) {
        let mut decoder = Decoder::new();
        // The first bit of a frame cannot break the stuffing rule.
        let _ = decoder.push(Level::Dominant);
        self.phase = Phase::InFrame(Box::new(FrameProgress {
            decoder,
            position: 1,
            sending: None,
        }));
        events.push(Event::StartSeen { may_join });
    }

    fn sample_frame(&mut self, level: Level, driven: Level, events: &mut Vec<Event>) {
        let Phase::InFrame(progress) = &mut self.phase else {
            return;
        };
        let field = progress.decoder.next_field();
        let bit = progress.position;
        let dominant = level == Level::Dominant;
        let slot = progress.sending.as_ref().map(|sending| sending.slot);

        if let Some(sending) = &progress.sending {
            if driven != level && field != Field::AcknowledgeSlot {
                let lost = field == Field::Arbitration && driven.is_recessive();
                if lost {
                    events.push(Event::ArbitrationLost {
                        slot: sending.slot,
                        frame: sending.frame,
                        bit,
                    });
                    progress.sending = None;
                } else {
                    let in_arbitration = field
                        == Field::Stuff {
                            in_arbitration: true,
                        };
                    let kind = match (driven, in_arbitration) {
                        (Level::Dominant, _) => ErrorKind::BitDominant,
                        (Level::Recessive, true) => ErrorKind::Stuff,
                        (Level::Recessive, false) => ErrorKind::BitRecessive,
                    };
                    self.error(kind, true, slot, bit, events);
                    return;
                }
            } else if field == Field::AcknowledgeSlot && level.is_recessive() && !self.loop_back {
                self.error(ErrorKind::Acknowledge, true, slot, bit, events);
                return;
            }
        } else if driven == Level::Dominant && !dominant {
            self.error(ErrorKind::BitDominant, false, None, bit, events);
            return;
        }

        let pushed = progress.decoder.push(level);
        progress.position += 1;
        let sending = slot.is_some() && progress.sending.is_some();
        if pushed.is_err() {
            self.error(ErrorKind::Stuff, sending, slot, bit, events);
            return;
        }
        match field {
            // Known since the CRC sequence, signalled after the acknowledge delimiter.
            Field::AcknowledgeDelimiter if !progress.decoder.crc_matches() => {
                self.error(ErrorKind::Crc, sending, None, bit, events);
            }
            Field::CrcDelimiter | Field::AcknowledgeDelimiter | Field::EndOfFrame(1..=6)
                if dominant =>
            {
                self.error(ErrorKind::Form, sending, None, bit, events);
            }
            Field::EndOfFrame(6) if !sending || self.loop_back => {
                if let Some(frame) = progress.decoder.frame() {
                    if !sending {
                        self.counters.received();
                    }
                    events.push(Event::Received { frame });
                }
            }
            Field::EndOfFrame(7) => {
                if let Some(Transmission { slot, frame, .. }) = progress.sending {
                    self.counters.transmitted();
                    events.push(Event::Transmitted { slot, frame });
                }
                if dominant {
                    self.overload(sending);
                } else {
                    self.phase = Phase::Intermission {
                        transmitter: sending,
                        seen: 0,
                    };
                }
            }
            _ => {}
        }
    }

    fn sample_flag(&mut self, level: Level, events: &mut Vec<Event>) {
        let Phase::Flag {
            kind,
            transmitter,
            seen,
            last,
            excused,
        } = &mut self.phase
        else {
            return;
        };
        let (kind, transmitter) = (*kind, *transmitter);
        let dominant = level == Level::Dominant;
        if kind == FlagKind::PassiveError {
            *seen = if *last == Some(level) { *seen + 1 } else { 1 };
            *last = Some(level);
            let (done, late) = (*seen == FLAG_BITS, dominant && *excused);
            if late {
                *excused = false;
                self.counters.transmit_error();
            }
            if self.fallen_off() {
                return;
            }
            if !done {
                return;
            }
        } else {
            *seen += 1;
            let done = *seen == FLAG_BITS;
            if !dominant {
                if transmitter {
                    self.counters.transmit_error();
                } else {
                    self.counters.receive_error(8);
                }
                events.push(Event::Error {
                    kind: ErrorKind::BitDominant,
                    slot: None,
                    bit: 0,
                });
                if self.fallen_off() {
                    return;
                }
            }
            if !done {
                return;
            }
        }
        self.phase = Phase::FlagEnd {
            kind,
            transmitter,
            dominant: 0,
            first: true,
        };
    }

    fn sample_flag_end(&mut self, is_dominant: bool, _events: &mut [Event]) {
        let Phase::FlagEnd {
            kind,
            transmitter,
            dominant,
            first,
        } = &mut self.phase
        else {
            return;
        };
        let transmitter = *transmitter;
        if !is_dominant {
            self.phase = Phase::Delimiter {
                transmitter,
                seen: 1,
            };
            return;
        }
        let first_after_error = std::mem::take(first) && *kind != FlagKind::Overload;
        *dominant += 1;
        let eighth = *dominant == 8;
        if eighth {
            *dominant = 0;
        }
        if first_after_error && !transmitter {
            self.counters.receive_error(8);
        }
        if eighth {
            if transmitter {
                self.counters.transmit_error();
            } else {
                self.counters.receive_error(8);
            }
        }
        self.fallen_off();
    }

    fn overload(&mut self, transmitter: bool) {
        self.phase = Phase::Flag {
            kind: FlagKind::Overload,
            transmitter,
            seen: 0,
            last: None,
            excused: false,
        };
    }

    /// Counts an error and starts its flag in the next bit.
    fn error(
        &mut self,
        kind: ErrorKind,
        transmitter: bool,
        slot: Option<u8>,
        bit: u16,
        events: &mut Vec<Event>,
    ) {
        // The error that makes a node passive is itself still signalled with an active flag.
        let passive = self.counters.state() == ErrorState::Passive;
        let excused = passive && transmitter && kind == ErrorKind::Acknowledge;
        // A transmitter does not count a stuff error during arbitration.
        let in_arbitration = slot.is_some() && kind == ErrorKind::Stuff;
        if !transmitter {
            self.counters.receive_error(1);
        } else if !excused && !in_arbitration {
            self.counters.transmit_error();
        }
        events.push(Event::Error { kind, slot, bit });
        if self.fallen_off() {
            return;
        }
        self.phase = Phase::Flag {
            kind: if passive {
                FlagKind::PassiveError
            } else {
                FlagKind::ActiveError
            },
            transmitter,
            seen: 0,
            last: None,
            excused,
        };
    }

    /// Enters bus-off if the counters say so.
    fn fallen_off(&mut self) -> bool {
        let off = self.counters.state() == ErrorState::BusOff;
        if off && !matches!(self.phase, Phase::BusOff { .. }) {
            self.phase = Phase::BusOff {
                recovering: self.automatic_recovery,
                run: 0,
                sequences: 0,
            };
        }
        off
    }
}
