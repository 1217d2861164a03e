//! Proof of the time that references tell.
//!
//! A reference has few bits for a tag: those of its first byte that belong to no signal (six in the
//! UAGV). They carry the tag of the reference *before* it, so that the time master has a whole basic
//! cycle to compute it, and no interrupt of the bus waits for it. A node compares them with the tag that
//! it has computed itself of the reference that it heard.
//!
//! One right tag proves little: whoever guesses is right once in 64 times. So a node counts. A right
//! tag adds 1 to its trust, a wrong one takes [`WRONG`] away, and the time is proven from
//! [`TimeProof::needed`] on: as many as have 30 bits together. Trust has a limit, so two wrong tags in
//! a row always end it, whatever came before, and one does not.
//!
//! Tags are computed by the housekeeping. Where basic cycles are shorter than two of its periods, only the
//! first reference in each [`SHORT`] has one and is judged; the others must tell a time that goes on.
//!
//! While the time is not proven, no actuator moves. A node without a key needs no proof.
//!
//! # Time does not go back
//!
//! References that were recorded prove their time as well as they did then. So a node with a key
//! ignores every reference of a time before one that it has seen proven. A time that jumps ahead, or runs
//! faster than the node's clock, is not proven until as many right tags have followed it without another
//! jump. So who forges one reference cannot lock the true ones out, nor who plays recorded ones between
//! them. Nothing is sealed or judged meanwhile ([`Link::is_time_believed`](crate::link::Link::is_time_believed)).
//!
//! Whoever has recorded a later time can lock the true ones out: enough references in a row, of another run
//! with the same key, played while the masters are off the bus, prove their time. A node cannot tell them from
//! those of a master that has set its clock. It stays stopped until the true time has passed theirs, or until
//! it is switched off. The tags of references are made by the network's key, so sessions do not change this.
//!
//! Each node keeps the latest proven time in memory that a reset leaves alone. After a reset it still
//! ignores earlier times, so nobody can reset an actuator and play it the commands of this run. A time
//! master goes on from the kept time.
//!
//! The others may have gone on under another master meanwhile, so that they ignore the one that came back.
//! Until it has led them for some basic cycles it listens to that other one, and takes over the later time
//! that its tags prove. Whoever has recorded references of a lower-ranked master in another run can lead it to
//! their time then.
//!
//! A node that has lost its supply has lost the time, too. If that is a master and it begins with an
//! earlier time, the nodes that remember theirs ignore it: until it has taken over the time of another
//! master that they follow, or else until they are switched off. If it is an actuator, recorded references
//! of this run prove an earlier time to it, and only a [`Session`](super::Session) lets it refuse their
//! commands. The same holds for commands that an actuator did not hear because it was held in reset while
//! they were sent.

use ttcan::{Frame, Micros};

use super::{Key, Secret};
use crate::design;

/// What a wrong tag takes away from the trust.
const WRONG: u8 = 3;

/// Bits of right tags that prove the time: whoever guesses them all needs 2^30 attempts, one in each
/// basic cycle.
const PROVING_BITS: u32 = 30;

/// Basic cycles from this one on have a tag in each reference, ms.
const LONG: u32 = 2 * design::HOUSEKEEPING_PERIOD.ticks();
/// Time from one tag to the next where basic cycles are shorter, ms.
const SHORT: u32 = 2 * LONG;

/// References in a row that a node may miss without a doubt of the time.
const MISSING: u32 = 2;

/// System time in a reference message, ms: bytes D1..D4, most significant byte first.
pub const fn time_of(reference: &Frame) -> u32 {
    let [_, a, b, c, d, ..] = reference.buffer();
    u32::from_be_bytes([a, b, c, d])
}

/// A time that runs more than this many times as fast as the node's clock jumps. So recorded references cannot
/// prove theirs between two true ones.
const FASTEST: u32 = 2;

/// Takes the place of a message's identifier in the code, so that no tag of a reference is that of a
/// message: no message has this identifier.
const REFERENCE: u16 = u16::MAX - 1;

/// A reference as it was on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Told {
    id: u32,
    length: u8,
    data: u64,
    /// The time that it told, ms.
    time: u32,
}

/// A reference whose tag is not computed yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Open {
    key: Key,
    told: Told,
    latest: Option<u32>,
}

/// The tag of a reference.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Answer {
    told: Told,
    tag: u8,
}

impl Open {
    /// The latest time that was proven, ms.
    pub const fn latest(&self) -> Option<u32> {
        self.latest
    }

    /// Computes the tag. This takes as long as that of a command, so it is for a task of low priority,
    /// without a lock on anything.
    pub fn answer(&self) -> Answer {
        Answer {
            told: self.told,
            // The low byte has room for every mask.
            tag: self.key.code(
                self.told.data,
                self.told.id << 4 | u32::from(self.told.length),
                REFERENCE,
            ) as u8,
        }
    }
}

/// Whether the time of the bus is proven.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "target", derive(defmt::Format))]
pub enum Proof {
    /// The node has no key, or the references have no room for a tag: every reference is believed.
    #[default]
    Unasked,
    /// The references carry right tags.
    Proven,
    /// They do not, or not for long enough.
    Unproven,
}

/// A node's trust in the time of the bus, and the tag of its own next reference.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimeProof {
    secret: Secret,
    /// The bits of a reference's first byte that carry the tag.
    mask: u8,
    /// The last reference that has a tag, and its tag as soon as it is computed.
    last: Option<Told>,
    tag: Option<u8>,
    /// The time that the last reference told, ms.
    heard: Option<u32>,
    trust: u8,
    /// Basic cycle, ms.
    cycle: u32,
    /// Longest time from one reference to the next, ms.
    step: u32,
    /// Right tags in a row since the time last jumped.
    steady: u8,
    /// The latest time that was proven, ms.
    latest: Option<u32>,
    wrong: u16,
    /// Right tags that prove the time, and whether they do. Both are asked more often than they change.
    needed: u8,
    proof: Proof,
}

impl TimeProof {
    /// Nothing was heard yet. `mask` are the bits of a reference's first byte that belong to no
    /// signal, and `cycle` is the basic cycle, of which two references may be missing.
    pub const fn new(secret: Secret, mask: u8, cycle: Micros) -> Self {
        Self {
            secret,
            mask,
            last: None,
            tag: None,
            heard: None,
            trust: 0,
            cycle: cycle.ticks().div_ceil(1000),
            step: cycle.ticks().saturating_mul(MISSING + 1).div_ceil(1000),
            steady: 0,
            latest: None,
            wrong: 0,
            needed: match mask.count_ones() {
                0 => 0,
                bits => PROVING_BITS.div_ceil(bits) as u8,
            },
            proof: match secret {
                Secret::None => Proof::Unasked,
                _ if mask == 0 => Proof::Unasked,
                Secret::Key(_) | Secret::Damaged => Proof::Unproven,
            },
        }
    }

    /// Goes on from a time that this node saw proven before it started, ms: an earlier one is not followed.
    pub const fn resume(&mut self, latest: u32) {
        if self.mask() != 0 {
            self.latest = Some(latest);
        }
    }

    /// The same before it has heard anything.
    #[cfg(feature = "master")]
    pub const fn anew(&self) -> Self {
        Self {
            last: None,
            tag: None,
            heard: None,
            trust: 0,
            steady: 0,
            latest: None,
            wrong: 0,
            proof: Proof::Unproven,
            ..*self
        }
    }

    /// Goes on with the time of another master if its references have proven it without a doubt. True if
    /// they have.
    #[cfg(feature = "master")]
    pub fn go_on(&mut self, other: &Self) -> bool {
        let is_proven = other.latest.is_some();
        if is_proven {
            *self = Self {
                trust: other.trust.max(self.needed),
                proof: Proof::Proven,
                wrong: self.wrong.wrapping_add(other.wrong),
                ..*other
            };
        }
        is_proven
    }

    /// Right tags that prove the time.
    pub const fn needed(&self) -> u8 {
        self.needed
    }

    /// Whether a reference tells a time before one that was proven. Then it must not be followed.
    pub fn is_past(&self, reference: &Frame) -> bool {
        let ahead = |latest| time_of(reference).wrapping_sub(latest).cast_signed();
        self.latest.is_some_and(|latest| ahead(latest) < 0)
    }

    /// A basic cycle began with this reference, of another node or of this one. `since` is the time from the
    /// reference before by this node's clock, ms; before the first one it does not matter.
    pub fn begin(&mut self, reference: &Frame, since: u32) {
        if self.mask() == 0 {
            return;
        }
        let data = reference.buffer();
        let time = time_of(reference);
        // Times are rounded down, and a reference may wait for the bus.
        let longest = since
            .saturating_mul(FASTEST)
            .saturating_add(FASTEST)
            .min(self.step);
        let jumps = |heard| time.wrapping_sub(heard) > longest;
        if self.heard.replace(time).is_some_and(jumps) {
            (self.trust, self.steady) = (0, 0);
        } else if let (true, Some(last)) = (self.is_tagged(time), self.last) {
            let [first, ..] = data;
            self.judge(first, last.time);
        }
        self.proof = if self.trust >= self.needed {
            Proof::Proven
        } else {
            Proof::Unproven
        };
        if self.is_tagged(time) {
            self.tag = None;
            self.last = Some(Told {
                id: reference.id().raw(),
                length: reference.len(),
                data: u64::from_le_bytes(data),
                time,
            });
        }
    }

    /// Whether the reference of this time has a tag.
    const fn is_tagged(&self, time: u32) -> bool {
        self.cycle >= LONG || time % SHORT < self.cycle
    }

    /// Time from one tag to the next, ms.
    #[cfg(feature = "master")]
    pub const fn interval(&self) -> u32 {
        if self.cycle >= LONG {
            self.cycle
        } else {
            SHORT
        }
    }

    /// Basic cycles with as many tags as prove the time.
    #[cfg(feature = "master")]
    pub const fn cycles(&self) -> u32 {
        let tags = self.interval().saturating_mul(self.needed as u32);
        match self.cycle {
            0 => tags,
            cycle => tags.div_ceil(cycle),
        }
    }

    /// Compares the tag that a reference carries in its first byte with that of the last one that has
    /// one, which told the time `before`.
    fn judge(&mut self, first: u8, before: u32) {
        match self.tag {
            Some(tag) if tag & self.mask == first & self.mask => {
                self.trust = self
                    .trust
                    .saturating_add(1)
                    .min(self.needed.saturating_add(WRONG));
                self.steady = self.steady.saturating_add(1).min(self.needed);
                if self.steady >= self.needed {
                    self.latest = Some(before);
                }
            }
            Some(_) => {
                self.wrong = self.wrong.wrapping_add(1);
                self.trust = self.trust.saturating_sub(WRONG);
                self.steady = 0;
            }
            // It followed the last one too closely to be judged.
            None => self.trust = self.trust.saturating_sub(1),
        }
    }

    /// The reference whose tag is needed.
    pub const fn open(&self) -> Option<Open> {
        match (&self.secret, self.last, self.tag) {
            (Secret::Key(key), Some(told), None) if self.mask != 0 => Some(Open {
                key: *key,
                told,
                latest: self.latest,
            }),
            _ => None,
        }
    }

    /// Takes the tag of the last reference. That of an earlier one changes nothing.
    pub fn close(&mut self, answer: Answer) {
        if self.last == Some(answer.told) {
            self.tag = Some(answer.tag);
        }
    }

    /// The bits of a reference's first byte that carry the tag.
    pub const fn mask(&self) -> u8 {
        match self.secret {
            Secret::Key(_) => self.mask,
            Secret::None | Secret::Damaged => 0,
        }
    }

    /// The bits that the next reference of this node carries in its first byte.
    pub const fn bits(&self) -> u8 {
        match self.tag {
            Some(tag) => tag & self.mask,
            None => 0,
        }
    }

    /// Whether the time is proven.
    pub const fn proof(&self) -> Proof {
        self.proof
    }

    /// References with a wrong tag so far; wraps.
    pub const fn wrong(&self) -> u16 {
        self.wrong
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::{Proof, TimeProof, WRONG};
    use crate::e2e::{Key, Secret};
    use proptest::prelude::*;
    use ttcan::{Frame, Id, Micros};

    const SECRET: Secret = Secret::Key(Key::new(*b"a secret of 16 b"));
    /// As in the UAGV: a reference's first byte has two signals.
    const MASK: u8 = 0xFC;
    const CYCLE: Micros = Micros::millis(100);

    /// The reference of this cycle with these bits in its first byte.
    fn reference(cycle: u32, bits: u8) -> Frame {
        let [a, b, c, d] = cycle.wrapping_mul(100).to_be_bytes();
        let data = [bits | 1, a, b, c, d, 0, 0x12, 0x34];
        Frame::from_parts(Id::constant::<100>(), 8, data)
    }

    fn compute(proof: &mut TimeProof) {
        if let Some(open) = proof.open() {
            proof.close(open.answer());
        }
    }

    /// A master and a node that hears it.
    struct Bus {
        master: TimeProof,
        node: TimeProof,
        cycle: u32,
    }

    impl Bus {
        fn new(secret: Secret, mask: u8) -> Self {
            let new = || TimeProof::new(secret, mask, CYCLE);
            Self {
                master: new(),
                node: new(),
                cycle: 0,
            }
        }

        /// A basic cycle: the master's reference, or what the node hears in its place.
        fn cycle(&mut self, heard: Option<Frame>) {
            let sent = reference(self.cycle, self.master.bits());
            self.cycle += 1;
            self.master.begin(&sent, 100);
            self.node.begin(&heard.unwrap_or(sent), 100);
            compute(&mut self.master);
            compute(&mut self.node);
        }

        fn run(&mut self, cycles: usize) {
            for _ in 0..cycles {
                self.cycle(None);
            }
        }

        fn is_proven(&self) -> bool {
            self.node.proof() == Proof::Proven
        }
    }

    #[test]
    fn five_right_tags_prove_the_time() {
        let mut bus = Bus::new(SECRET, MASK);
        assert_eq!(bus.node.needed(), 5);
        // The first reference proves nothing: it tells of none before it that the node has heard.
        for _ in 0..=5 {
            assert!(!bus.is_proven());
            bus.cycle(None);
        }
        assert!(bus.is_proven());
        assert_eq!(bus.master.proof(), Proof::Proven, "its own ones count too");
        bus.run(1000);
        assert!(bus.is_proven());
        assert_eq!(bus.node.wrong(), 0);
    }

    /// The housekeeping computes a tag only in every second basic cycle, or later.
    #[test]
    fn short_basic_cycles_have_a_tag_now_and_then() {
        for (cycle, late) in [(5, 2), (5, 4), (1, 10), (19, 1)] {
            let new = || TimeProof::new(SECRET, MASK, Micros::millis(cycle));
            let (mut master, mut node) = (new(), new());
            let mut proven = None;
            for count in 0..2000_u32 {
                let time = 1_000_003 + count * cycle;
                let [a, b, c, d] = time.to_be_bytes();
                let data = [master.bits() | 1, a, b, c, d, 0, 0, 0];
                let sent = Frame::from_parts(Id::constant::<100>(), 8, data);
                assert!(!node.is_past(&sent));
                master.begin(&sent, cycle);
                node.begin(&sent, cycle);
                if count % late == 0 {
                    compute(&mut master);
                    compute(&mut node);
                }
                if node.proof() == Proof::Proven {
                    proven.get_or_insert(count * cycle);
                } else {
                    assert_eq!(proven, None, "{cycle} {count}");
                }
            }
            assert!(proven.is_some_and(|at| at < 300), "{cycle}: {proven:?}");
            assert_eq!(node.wrong(), 0);
        }
    }

    #[test]
    fn one_wrong_tag_is_tolerated_and_two_in_a_row_are_not() {
        let mut bus = Bus::new(SECRET, MASK);
        bus.run(1000);
        // The node misses a reference, so the next one's tag is of one that it does not know.
        bus.master.begin(&reference(7, bus.master.bits()), 100);
        compute(&mut bus.master);
        bus.cycle(None);
        assert!(bus.is_proven());
        assert_eq!(bus.node.wrong(), 1);
        bus.run(3);
        for _ in 0..2 {
            bus.cycle(Some(reference(bus.cycle, !bus.master.bits())));
        }
        assert!(!bus.is_proven());
        // The first true one after a false one has a tag of another reference.
        bus.run(1 + 5);
        assert!(bus.is_proven());
    }

    #[test]
    fn a_tag_that_comes_too_late_is_not_used() {
        let mut bus = Bus::new(SECRET, MASK);
        bus.run(20);
        let late = {
            bus.node
                .begin(&reference(bus.cycle, bus.master.bits()), 100);
            bus.node.open().expect("a tag is needed").answer()
        };
        bus.node.begin(&reference(bus.cycle + 1, 0), 100);
        bus.node.close(late);
        assert_eq!(bus.node.bits(), 0);
        assert!(bus.is_proven(), "it cost only one step of trust");
    }

    /// Whoever has no key guesses the tag, once in each basic cycle for 11 hours.
    #[test]
    fn guesses_do_not_prove_a_time() {
        let mut bus = Bus::new(SECRET, MASK);
        let mut guess = 1u64;
        let (mut proven, mut right) = (0, 0);
        for cycle in 0..400_000 {
            guess = guess
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            let wrong = bus.node.wrong();
            bus.cycle(Some(reference(cycle, (guess >> 56) as u8 & MASK)));
            right += u32::from(bus.node.wrong() == wrong);
            proven += u32::from(bus.is_proven());
        }
        // One in 64 is right: 6250 on average, with a deviation of 78.
        assert!((5800..6700).contains(&right), "{right}");
        assert_eq!(proven, 0);
    }

    #[test]
    fn an_attack_leaves_a_proven_time_two_cycles() {
        let mut bus = Bus::new(SECRET, MASK);
        let mut longest = 0;
        for attack in 0_u32..200 {
            bus.run(20);
            let mut cycles = 0;
            while bus.is_proven() {
                cycles += 1;
                bus.cycle(Some(reference(bus.cycle, attack as u8 & MASK)));
            }
            longest = longest.max(cycles);
        }
        // A guess that is right adds some.
        assert!((2..=7).contains(&longest), "{longest}");
    }

    #[test]
    fn a_recorded_time_is_not_followed() {
        let mut bus = Bus::new(SECRET, MASK);
        bus.run(3);
        assert!(!bus.node.is_past(&reference(0, 0)), "nothing is proven yet");
        bus.run(100);
        for past in 0..100 {
            assert!(bus.node.is_past(&reference(past, 0)), "{past}");
        }
        // The last one but one is proven by the last one, which may be sent twice.
        assert!(!bus.node.is_past(&reference(102, 0)));
    }

    /// The time wraps after 49 days.
    #[test]
    fn a_time_that_wraps_goes_on() {
        let mut bus = Bus::new(SECRET, MASK);
        bus.cycle = u32::MAX / 100 - 20;
        for _ in 0..40 {
            let sent = bus.cycle;
            bus.cycle(None);
            let next = Frame::from_parts(Id::constant::<100>(), 8, {
                let [a, b, c, d] = sent.wrapping_add(1).wrapping_mul(100).to_be_bytes();
                [1, a, b, c, d, 0, 0, 0]
            });
            assert!(!bus.node.is_past(&next));
        }
        assert!(bus.is_proven());
    }

    #[test]
    fn a_time_that_jumps_ahead_is_proven_anew() {
        let mut bus = Bus::new(SECRET, MASK);
        bus.run(100);
        bus.cycle += 4;
        bus.cycle(None);
        assert!(!bus.is_proven(), "it is 500 ms later");
        bus.run(4);
        assert!(!bus.is_proven());
        bus.run(1);
        assert!(bus.is_proven());
    }

    /// References that were recorded in another run, all of them right, between true ones. How fast they are
    /// played is the attacker's choice.
    #[test]
    fn recorded_references_between_true_ones_prove_no_time() {
        for pace in [1, 5, 10, 12, 20, 40, 49, 50, 60, 90, 99] {
            let mut bus = Bus::new(SECRET, MASK);
            let mut recorded = Bus::new(SECRET, MASK);
            recorded.cycle = 1_000_000;
            bus.run(50);
            for _ in 0..20 {
                for _ in 0..100 / pace {
                    let frame = reference(recorded.cycle, recorded.master.bits());
                    recorded.cycle(None);
                    assert!(!bus.node.is_past(&frame));
                    bus.node.begin(&frame, pace);
                    compute(&mut bus.node);
                }
                let next = reference(bus.cycle, 0);
                assert!(!bus.node.is_past(&next), "a true one is ignored, {pace} ms");
                bus.node
                    .begin(&reference(bus.cycle, bus.master.bits()), 100 % pace);
                bus.master
                    .begin(&reference(bus.cycle, bus.master.bits()), 100);
                compute(&mut bus.node);
                compute(&mut bus.master);
                bus.cycle += 1;
                assert!(!bus.is_proven(), "{pace} ms");
            }
            bus.run(7);
            assert!(bus.is_proven(), "{pace} ms");
        }
    }

    /// One forged reference, however far ahead it is, must not lock the true ones out.
    #[test]
    fn forged_references_do_not_move_the_time_ahead() {
        for ahead in [1, 2, 3, 10, 1000, 20_000_000] {
            for count in 1..30 {
                let mut bus = Bus::new(SECRET, MASK);
                bus.run(100);
                let begin = bus.cycle;
                for step in 0..count {
                    let bits = (step * 64) as u8;
                    bus.cycle(Some(reference(begin + ahead * (step + 1), bits & MASK)));
                }
                let next = reference(bus.cycle, 0);
                assert!(!bus.node.is_past(&next), "{ahead} {count}");
                bus.run(20);
                assert!(bus.is_proven(), "{ahead} {count}");
            }
        }
    }

    #[test]
    fn without_a_key_nothing_is_asked_and_with_a_damaged_one_nothing_is_proven() {
        for (secret, mask, proof) in [
            (Secret::None, MASK, Proof::Unasked),
            (SECRET, 0, Proof::Unasked),
            (Secret::Damaged, MASK, Proof::Unproven),
        ] {
            let mut bus = Bus::new(secret, mask);
            bus.run(100);
            assert_eq!(bus.node.proof(), proof);
            assert_eq!((bus.master.bits(), bus.node.wrong()), (0, 0));
        }
    }

    proptest! {
        /// Every bit of a reference changes its tag, and so does its key.
        #[test]
        fn a_tag_is_that_of_one_reference_only(data: [u8; 8], bit in 0usize..64, key: [u8; 16]) {
            let tag = |secret: Secret, data: [u8; 8], length: u8| {
                let mut proof = TimeProof::new(secret, 0xFF, CYCLE);
                proof.begin(&Frame::from_parts(Id::constant::<100>(), length, data), 100);
                compute(&mut proof);
                proof.bits()
            };
            // Of 256 keys one gives the same byte, so several bytes are compared.
            let several = |secret: Secret, change: u8, length: u8| -> std::vec::Vec<u8> {
                (0..8)
                    .map(|step: u8| {
                        let mut data = data;
                        data[0] = data[0].wrapping_add(step.wrapping_mul(16));
                        data[bit / 8] ^= change << (bit % 8);
                        tag(secret, data, length)
                    })
                    .collect()
            };
            let own = several(SECRET, 0, 8);
            prop_assert_eq!(&own, &several(SECRET, 0, 8));
            prop_assert_ne!(&own, &several(SECRET, 1, 8));
            prop_assert_ne!(&own, &several(SECRET, 0, 7));
            prop_assert_ne!(&own, &several(Secret::Key(Key::new(key)), 0, 8));
        }

        /// Whatever was heard before, true references prove the time again.
        #[test]
        fn true_references_end_any_attack(heard in proptest::collection::vec(any::<[u8; 8]>(), 0..60)) {
            let mut bus = Bus::new(SECRET, MASK);
            for data in heard {
                bus.cycle(Some(Frame::from_parts(Id::constant::<101>(), 8, data)));
            }
            bus.run(2 + usize::from(bus.node.needed() + WRONG));
            prop_assert!(bus.is_proven());
        }
    }
}
