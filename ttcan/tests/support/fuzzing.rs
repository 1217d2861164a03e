//! The fuzz targets as functions of the fuzzer's bytes. The tests of the crate call
//! them with random bytes, because a fuzzer needs a nightly toolchain.

use ttcan::guardian::{Guardian, GuardianConfig, Lines};
use ttcan::{
    Action, ErrorLevel, Event, Frame, GlobalTime, Id, MatrixConfig, Micros, Node, NodeConfig,
    NodeId, Reception, ReferenceFormat, Stamp, StampLatency, SyncState, SystemMatrix,
    TransmitOutcome, Window, frame_bits, shortest_bits, worst_case_bits,
};

const MATRIX: SystemMatrix = SystemMatrix::constant(MatrixConfig {
    bit_rate: 500_000,
    basic_cycle: Micros::millis(8),
    cycles: 4,
    reference: Id::constant::<8>(),
    reference_format: ReferenceFormat::new(1, Some(1), 5, Some(6)),
    masters: &[NodeId(0), NodeId(1), NodeId(2)],
    transmit_enable_bits: 16,
    sync_uncertainty: Micros::micros(20),
    longest_gap: Micros::millis(30),
    windows: &[
        Window::exclusive(
            "a",
            Micros::micros(500),
            Micros::micros(400),
            ID_A,
            8,
            NodeId(0),
        ),
        Window::exclusive(
            "b",
            Micros::micros(900),
            Micros::micros(400),
            ID_B,
            4,
            NodeId(1),
        )
        .retry_late(),
        Window::exclusive(
            "b'",
            Micros::micros(1300),
            Micros::micros(400),
            ID_C,
            0,
            NodeId(1),
        )
        .every(2, 1),
        Window::exclusive(
            "c",
            Micros::micros(1300),
            Micros::micros(400),
            ID_D,
            2,
            NodeId(2),
        )
        .every(4, 2),
        Window::arbitrating("d", Micros::micros(2000), Micros::micros(600)).merged(),
        Window::arbitrating("e", Micros::micros(2600), Micros::micros(600)),
    ],
    events: &[
        Event::new("f", EVENT, 8, NodeId(1)),
        Event::new("g", ID_E, 8, NodeId(0)),
    ],
});

const ID_A: Id = Id::constant::<16>();
const ID_B: Id = Id::constant::<17>();
const ID_C: Id = Id::constant::<18>();
const ID_D: Id = Id::constant::<19>();
const ID_E: Id = Id::constant::<20>();
const EVENT: Id = Id::constant::<7>();

ttcan::schedule!(static SCHEDULE = MATRIX);

type Stack = Node<'static, { MATRIX.window_count() }, { MATRIX.node_count() }, 3>;

/// A source of bytes, which gives zeros when it is used up.
struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn next(&mut self) -> u8 {
        match self.0.split_first() {
            Some((first, rest)) => {
                self.0 = rest;
                *first
            }
            None => 0,
        }
    }

    fn word(&mut self) -> u32 {
        u32::from_le_bytes([self.next(), self.next(), self.next(), self.next()])
    }

    fn data(&mut self) -> [u8; 8] {
        let mut data = [0; 8];
        data.fill_with(|| self.next());
        data
    }
}

/// Checks that the length of an arbitrary frame is within its bounds.
pub fn frames(bytes: &[u8]) {
    let mut bytes = Bytes(bytes);
    let id = if bytes.next() & 1 == 0 {
        Id::standard((bytes.word() & 0x7FF) as u16)
    } else {
        Id::extended(bytes.word() & 0x1FFF_FFFF)
    };
    let id = id.expect("masked to the range");
    let frame = Frame::from_parts(id, bytes.next() % 16, bytes.data());
    let bits = frame_bits(&frame);
    assert!(bits >= shortest_bits(id, frame.len()));
    assert!(bits <= worst_case_bits(id, frame.len()));
    assert_eq!(
        Frame::new(id, frame.data())
            .expect("at most 8 bytes")
            .data(),
        frame.data()
    );
}

/// What a node reported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Said {
    /// An action to carry out.
    Action(Action),
    /// How a frame was taken.
    Reception(Reception),
    /// Ticks until the next deadline.
    Deadline(Option<i32>),
}

/// Calls a node with arbitrary operations at arbitrary times, and checks what must
/// always hold. The node's counter starts at `origin`.
pub fn operations(bytes: &[u8], origin: u32) -> Vec<Said> {
    let mut bytes = Bytes(bytes);
    let config = NodeConfig {
        latency: StampLatency::bxcan(36, 10),
        transmit_lead: 20,
        application_watchdog: (bytes.next() & 1 == 1).then_some(Micros::millis(50)),
        // A crystal, or an RC oscillator.
        drift_limit_ppm: if bytes.next() & 1 == 1 { 10_000 } else { 200 },
        ..NodeConfig::new(NodeId(u16::from(bytes.next() % 4)), 18)
    };
    let mut driver = Driver {
        node: Stack::new(SCHEDULE.view(), config).expect("the configuration is sound"),
        now: Stamp(origin),
        open: false,
        silent: true,
        said: Vec::new(),
    };
    driver.run(bytes);
    driver.said
}

/// The same with a node of any configuration. No arithmetic overflows. Returns whether the
/// configuration was accepted.
pub fn configurations(bytes: &[u8]) -> bool {
    let mut bytes = Bytes(bytes);
    let mut draw = |edges: &[u32]| {
        // Mostly an edge, so that most configurations are accepted.
        let at = usize::from(bytes.next());
        match edges.get(at % edges.len()) {
            Some(edge) if at < 250 => *edge,
            _ => bytes.word(),
        }
    };
    let most = u32::MAX;
    let ticks_per_us = draw(&[1, 2, 18, 180, 999, 1000, 1001]);
    let latency = StampLatency {
        receive: draw(&[0, 1, 4000, most]).cast_signed(),
        transmit: draw(&[0, 1, 4000, most]).cast_signed(),
    };
    let config = NodeConfig {
        latency,
        transmit_lead: draw(&[0, 54, 4000, 4_000_000]),
        reference_offset: Some(draw(&[0, 16, 127, 200]) as u8).filter(|offset| *offset < 200),
        watch: draw(&[1, 2, 4, 255]) as u8,
        application_watchdog: Some(Micros::micros(draw(&[
            0,
            1,
            8000,
            1_000_000,
            1_000_000_000,
        ]))),
        drift_limit_ppm: draw(&[0, 200, 9999, 10_000, 10_001]) as u16,
        ..NodeConfig::new(NodeId(draw(&[0, 1, 2, 3]) as u16), ticks_per_us)
    };
    let Ok(node) = Stack::new(SCHEDULE.view(), config) else {
        return false;
    };
    let mut driver = Driver {
        node,
        now: Stamp(draw(&[0, 1 << 31, most])),
        open: false,
        silent: true,
        said: Vec::new(),
    };
    driver.run(bytes);
    true
}

struct Driver {
    node: Stack,
    now: Stamp,
    /// A transmission was requested and is neither reported nor withdrawn.
    open: bool,
    silent: bool,
    said: Vec<Said>,
}

impl Driver {
    fn run(&mut self, mut bytes: Bytes) {
        self.start();
        // Longer inputs bring nothing new.
        for _ in 0..512 {
            if bytes.0.is_empty() {
                break;
            }
            self.operate(&mut bytes);
            self.serve();
        }
    }

    fn start(&mut self) {
        self.node.start(self.now);
        self.silent = false;
    }

    fn receive(&mut self, frame: Frame, stamp: Stamp) {
        let reception = self.node.handle_receive(&frame, stamp);
        self.said.push(Said::Reception(reception));
    }

    fn operate(&mut self, bytes: &mut Bytes) {
        match bytes.next() % 13 {
            0 => self.now = self.now.after(u32::from(bytes.next()) * 64),
            1..=3 => {
                if let Some(deadline) = self.node.next_deadline()
                    && deadline.reached(self.now)
                {
                    let late = u32::from(bytes.next() % 4) * 300;
                    self.now = deadline.after(late);
                }
            }
            4 => {
                let id = Id::standard(u16::from(bytes.next() % 32)).expect("small");
                let frame = Frame::from_parts(id, bytes.next() % 9, bytes.data());
                self.receive(frame, self.now);
            }
            5 | 6 => {
                let rank = bytes.next() % 4;
                let mut data = bytes.data();
                data[5] &= 0xC3;
                let id = Id::standard(8 + u16::from(rank)).expect("small");
                let len = if bytes.next().is_multiple_of(8) { 5 } else { 8 };
                self.receive(Frame::from_parts(id, len, data), self.now);
            }
            7 | 8 => {
                let outcome = match bytes.next() % 8 {
                    0 => TransmitOutcome::Error,
                    1 => TransmitOutcome::ArbitrationLost,
                    2 => TransmitOutcome::Aborted,
                    3 => TransmitOutcome::Empty,
                    _ => TransmitOutcome::Sent,
                };
                self.open = false;
                self.node.handle_transmit(outcome, self.now);
            }
            9 => {
                let frame = Frame::from_parts(EVENT, bytes.next() % 9, bytes.data());
                let lifetime = Micros::micros(bytes.word() % 100_000);
                let _ = if bytes.next().is_multiple_of(2) {
                    self.node.queue_event(frame, self.now, lifetime)
                } else {
                    self.node.replace_event(frame, self.now, lifetime)
                };
            }
            10 => match bytes.next() % 6 {
                0 => _ = self.node.request_gap(),
                1 => _ = self.node.end_gap(self.now),
                2 => {
                    let time = GlobalTime::from_raw(u64::from(bytes.word()) << (bytes.next() % 33));
                    _ = self.node.set_global_time(self.now, time);
                }
                3 => self.node.clear_errors(),
                4 => self.node.set_reference_payload(&bytes.data()),
                _ => self.node.feed_watchdog(self.now),
            },
            11 => match bytes.next() % 4 {
                0 => self.node.handle_bus_off(),
                1 => self.start(),
                2 => {
                    let frame = Frame::from_parts(ID_A, 8, bytes.data());
                    self.receive(frame, self.now.offset(-(i32::from(bytes.next()) << 8)));
                }
                _ => self.now = self.now.after(bytes.word() >> 2),
            },
            _ => self.node.feed_watchdog(self.now),
        }
    }

    fn serve(&mut self) {
        let mut rounds = 0;
        while let Some(action) = self.node.poll(self.now) {
            rounds += 1;
            assert!(rounds < 64, "the node does not come to rest");
            assert!(!self.silent, "{action:?} after silence");
            match action {
                Action::TransmitReference(_) => self.ask(),
                Action::Transmit(_) | Action::TransmitEvent(_) => {
                    let status = self.node.status();
                    assert!(matches!(
                        status.sync,
                        SyncState::InSchedule | SyncState::InGap
                    ));
                    assert!(status.error_level < ErrorLevel::Error);
                    self.ask();
                }
                Action::Abort => self.open = false,
                Action::Silence => {
                    self.open = false;
                    self.silent = true;
                }
            }
            self.said.push(Said::Action(action));
        }
        let deadline = self.node.next_deadline();
        assert_eq!(
            deadline.is_none(),
            self.node.status().sync == SyncState::Off
        );
        assert_eq!(self.silent, deadline.is_none());
        let ahead = deadline.map(|deadline| deadline.ticks_since(self.now));
        assert!(
            ahead.is_none_or(|ahead| ahead > 0),
            "nothing is due that poll left"
        );
        self.said.push(Said::Deadline(ahead));
        let _ = self.node.peer(NodeId(1));
        let _ = self.node.window(2);
        let _ = self.node.cycle_time(self.now);
        let _ = self.node.global_time(self.now);
    }

    fn ask(&mut self) {
        assert!(!self.open, "two transmissions are open");
        self.open = true;
    }
}

/// What a guardian said: whose gates are open, and in how many ticks time alone changes something.
pub type Watched = (u32, i32);

/// A guardian of any configuration with arbitrary lines and frames at arbitrary times. Its counter
/// starts at `origin`. `None` if the configuration was refused.
pub fn guardian(bytes: &[u8], origin: u32) -> Option<Vec<Watched>> {
    let mut bytes = Bytes(bytes);
    let mut draw = |edges: &[u32]| {
        // Mostly an edge, so that most configurations are accepted.
        let at = usize::from(bytes.next());
        match edges.get(at % edges.len()) {
            Some(edge) if at < 250 => *edge,
            _ => bytes.word(),
        }
    };
    let config = GuardianConfig {
        receive_latency: draw(&[0, 10, 4000, u32::MAX]).cast_signed(),
        jitter: Micros::micros(draw(&[0, 2, 1000])),
        drift_ppm: draw(&[0, 200, 10_000]) as u16,
        spell_bits: draw(&[8, 20, 28]) as u8,
        penalty: draw(&[1, 10]) as u16,
        lost: draw(&[1, 4, 100]) as u8,
        strikes: draw(&[0, 4, 255]) as u8,
        pulses: draw(&[0, 64, 255]) as u8,
        attempts: draw(&[0, 32, 255]) as u8,
        untimely: draw(&[0, 4, 255]) as u8,
        ..GuardianConfig::new(
            draw(&[1, 18, 18, 18, 180, 1000]),
            // 2.75 bits of 2 us.
            Micros::micros(draw(&[0, 4, 5])),
        )
    };
    let senders = [0, 1, 2, 9].map(NodeId);
    let mut watch = Watch {
        guardian: Guardian::new(SCHEDULE.view(), config, senders, Stamp(origin)).ok()?,
        now: Stamp(origin),
        said: Vec::new(),
        lines: Lines::default(),
        bit: 2 * config.ticks_per_us,
    };
    watch.look();
    // Longer inputs bring nothing new.
    for _ in 0..512 {
        if bytes.0.is_empty() {
            break;
        }
        watch.operate(&mut bytes);
        watch.look();
    }
    Some(watch.said)
}

struct Watch {
    guardian: Guardian<'static, 4>,
    now: Stamp,
    said: Vec<Watched>,
    lines: Lines,
    /// Ticks of a bit.
    bit: u32,
}

impl Watch {
    fn look(&mut self) {
        let open = self.guardian.look(self.lines, self.now);
        self.lines.fell = 0;
        let due = self.guardian.due().ticks_since(self.now);
        assert!(due > 0, "a look leaves something undone");
        let before = self.guardian.clone();
        assert_eq!(self.guardian.look(self.lines, self.now), open);
        assert!(before == self.guardian, "it does not come to rest");
        assert!(!open.is_open(4) && !open.is_open(usize::MAX));
        // A look that is left out as `due` allows changes nothing.
        let between = self.now.after(due.unsigned_abs() - 1);
        assert_eq!(self.guardian.look(self.lines, between), open);
        assert!(before == self.guardian, "a look was not due");
        self.said.push((open.bits(), due));
    }

    fn operate(&mut self, bytes: &mut Bytes) {
        match bytes.next() % 8 {
            0 | 1 => {
                // Bit 4 is that of no sender.
                self.lines.dominant = u32::from(bytes.next() & 0x1F);
                self.lines.fell = u32::from(bytes.next() & 0x1F);
            }
            2 => self.now = self.now.after(u32::from(bytes.next() % 32) * self.bit),
            3 | 4 => {
                let due = self.guardian.due();
                if due.reached(self.now) {
                    let late = u32::from(bytes.next() % 4) * 3 * self.bit;
                    self.now = due.after(late);
                }
            }
            5 => {
                let id = Id::standard(u16::from(bytes.next() % 32)).expect("small");
                let frame = Frame::from_parts(id, bytes.next() % 9, bytes.data());
                self.now = self.now.after(frame_bits(&frame) * self.bit);
                self.guardian.handle_frame(&frame, self.now);
            }
            6 => {
                let rank = bytes.next() % 4;
                let mut data = bytes.data();
                data[5] &= 0xC3;
                let id = Id::standard(8 + u16::from(rank)).expect("small");
                let frame = Frame::from_parts(id, 8, data);
                self.now = self.now.after(frame_bits(&frame) * self.bit);
                self.guardian.handle_frame(&frame, self.now);
            }
            _ => match bytes.next() % 8 {
                0 => self.guardian.pardon(usize::from(bytes.next() % 5)),
                1 => self.now = self.now.after(bytes.word() >> 4),
                // About a basic cycle.
                _ => self.now = self.now.after((3800 + u32::from(bytes.next())) * self.bit),
            },
        }
    }
}
