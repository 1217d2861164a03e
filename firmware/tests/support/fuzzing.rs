//! The fuzz targets as functions of the fuzzer's bytes. Tests call them with random bytes,
//! because a fuzzer needs a nightly toolchain.

#[path = "requests.rs"]
mod requests;

pub use requests::requests;

use firmware::e2e::{Key, Proof, Receiver, Refusal, Secret, Sender, TimeProof};
use network::{DecodeError, Message, Signal};
use ttcan::{Frame, Id, Micros};

/// A command with 26 bits for its tag, as the UAGV's.
#[derive(Clone, Copy, Debug)]
struct Command;

impl Message for Command {
    const ID: u16 = 300;
    const NAME: &'static str = "Command";
    const LENGTH: u8 = 8;
    const SHORTEST: u8 = 8;
    const FREE: u64 = 0x0000_F8F8_0000_0000;
    type Node = ();
    const SENDER: () = ();
    const SIGNALS: &'static [Signal] = &[];
    type Bytes = [u8; 8];

    fn encode(&self) -> [u8; 8] {
        [0; 8]
    }

    fn frame(&self) -> Frame {
        Frame::from_parts(Id::constant::<300>(), 8, [0; 8])
    }

    fn decode(_: &[u8]) -> Result<Self, DecodeError> {
        Ok(Self)
    }

    fn visit(&self, _: &mut dyn FnMut(&'static Signal, i64)) {}
}

const SECRET: Secret = Secret::Key(Key::new([0x5A; 16]));
/// Free bits of a reference's first byte.
const MASK: u8 = 0xFC;

/// What a node with a key sees of a bus on which the fuzzer sends, too.
struct Bus {
    sender: Sender,
    receiver: Receiver,
    master: TimeProof,
    node: TimeProof,
    time: u32,
    /// True commands, and whether the receiver has accepted each.
    sent: Vec<(u32, [u8; 8])>,
    /// Time of the last command that was accepted.
    accepted: Option<u32>,
    /// Wrong tags of references in a row.
    wrong: u32,
    /// Forged references whose tag was guessed. A fuzzer that is told what each guess changes finds many.
    guessed: u32,
    /// Those in a row. As many as prove the time are a forged proof, which blind guesses find once in 2^30.
    in_a_row: u8,
}

/// How far a reference may be ahead of the one before without a new proof, ms: two may be missing.
const STEP: u32 = 300;

/// A reference of this time.
fn at(time: u32) -> Frame {
    let [a, b, c, d] = time.to_be_bytes();
    Frame::from_parts(Id::constant::<100>(), 8, [0, a, b, c, d, 0, 0, 0])
}

impl Bus {
    fn reference(&mut self, forged: Option<[u8; 8]>) {
        let [a, b, c, d] = self.time.to_be_bytes();
        let data = [1 | self.master.bits(), a, b, c, d, 0, 0, 0];
        let sent = Frame::from_parts(Id::constant::<100>(), 8, data);
        let heard = forged.map_or(sent, |data| {
            Frame::from_parts(Id::constant::<100>(), 8, data)
        });
        if self.node.is_past(&heard) {
            // Then the link does not follow it. With each guess the attacker leads the time on by a step at most.
            let lead = self.time.wrapping_add(self.guessed * STEP);
            assert!(
                forged.is_some() || !self.node.is_past(&at(lead)),
                "a true reference is ignored"
            );
            return;
        }
        let [first, ..] = heard.buffer();
        let guesses = forged.is_some() && first & MASK == self.node.bits();
        self.guessed += u32::from(guesses);
        self.in_a_row = if guesses { self.in_a_row + 1 } else { 0 };
        let before = self.node.wrong();
        self.node.begin(&heard, STEP);
        self.wrong = match self.node.wrong() == before {
            true => 0,
            false => self.wrong + 1,
        };
        assert!(self.wrong < 2 || self.node.proof() == Proof::Unproven);
        if forged.is_none() {
            self.master.begin(&sent, STEP);
        }
        for proof in [&mut self.master, &mut self.node] {
            if let Some(open) = proof.open() {
                proof.close(open.answer());
            }
        }
    }

    fn judge(&mut self, time: u32, data: &[u8; 8], is_true: bool) {
        let judged = self.receiver.judge::<Command>(time, data);
        if judged.is_ok() {
            assert!(is_true, "{data:x?} at {time} passes");
            let is_later = |last: u32| time.wrapping_sub(last).cast_signed() > 0;
            assert!(self.accepted.is_none_or(is_later), "{time} comes again");
            self.accepted = Some(time);
        } else if is_true {
            assert_ne!(judged, Err(Refusal::Forged));
        }
    }

    fn step(&mut self, code: u8, bytes: [u8; 8]) {
        match code % 8 {
            0 | 1 => {
                self.time = self.time.wrapping_add(100);
                self.reference(None);
                let mut data = bytes;
                self.sender.seal::<Command>(self.time, &mut data);
                self.judge(self.time, &data, true);
                self.sent.push((self.time, data));
            }
            2 => self.reference(Some(bytes)),
            3 => {
                // A reference of a time near the true one, with made-up bits.
                let [tag, step, ..] = bytes;
                let time = self.time.wrapping_add_signed(i32::from(step as i8) * 100);
                let [a, b, c, d] = time.to_be_bytes();
                self.reference(Some([tag, a, b, c, d, 0, 0, 0]));
            }
            4 => self.judge(self.time, &bytes, false),
            5 => {
                let [which, flip, ..] = bytes;
                let count = self.sent.len().max(1);
                if let Some(&(time, data)) = self.sent.get(usize::from(which) % count) {
                    self.judge(time, &data, true);
                    let flipped = u64::from_le_bytes(data) ^ 1 << (flip % 64);
                    self.judge(time, &flipped.to_le_bytes(), false);
                    if time != self.time {
                        self.judge(self.time, &data, false);
                    }
                }
            }
            6 => self.receiver.forget(),
            _ => self.receiver = Receiver::new(SECRET),
        }
        if code % 8 == 7 {
            self.accepted = None;
        }
    }
}

/// A receiver of commands and of references, between true ones, forged ones and ones that were sent
/// before.
pub fn protection(data: &[u8]) {
    let new = || TimeProof::new(SECRET, MASK, Micros::millis(100));
    let mut bus = Bus {
        sender: Sender::new(SECRET),
        receiver: Receiver::new(SECRET),
        master: new(),
        node: new(),
        time: u32::MAX - 3000,
        sent: Vec::new(),
        accepted: None,
        wrong: 0,
        guessed: 0,
        in_a_row: 0,
    };
    for step in data.chunks_exact(9) {
        if let [code, bytes @ ..] = step
            && let Ok(bytes) = bytes.try_into()
        {
            bus.step(*code, bytes);
        }
        if bus.in_a_row >= bus.node.needed() {
            return;
        }
    }
    // True references prove the time again, whatever came before.
    for _ in 0..3 * u32::from(bus.node.needed()) + bus.guessed * STEP / 100 {
        bus.time = bus.time.wrapping_add(100);
        bus.reference(None);
    }
    assert_eq!(bus.node.proof(), Proof::Proven);
}
