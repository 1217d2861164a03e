//! The upper half of a guardian of one node on a small microcontroller, which has no time for a look every two bits. It looks
//! every 4.5 bits instead, and a timer follows the line meanwhile: it tells when the line's rest ended, and when the line
//! was released last. So the stamps are as good as with more looks, and only what follows from them comes later: a
//! limit is noticed up to one look late, and a spell that has begun is too.
//!
//! From look to look it may take 5.5 bits with all delays. Then the first look behind a spell tells when the line was
//! released, the next one finds that it has been recessive for 5.5 bits, and both come within the 11 bits that it rests.

use sled_common::tap::Seen;
use ttcan::Stamp;
use ttcan::guardian::{Evidence, Lines, News, Orders, Outlook, Watch};

/// The TX line of the guarded node, and its gate.
pub trait Line {
    /// Looks at the line. `None` while it is at rest.
    fn look(&mut self) -> Option<Seen>;
    /// The line is at rest: what it does next ends that.
    fn rest(&mut self);
    /// Opens the gate, or closes it.
    fn open(&mut self, open: bool);
}

/// The upper half of the guardian of one node, with its line.
pub struct Sentry<L> {
    watch: Watch<1>,
    line: L,
    /// Whether the gate is never closed.
    passes: bool,
    /// How long a line is recessive that has ended its spell, in ticks.
    quiet: u32,
    /// Half a bit.
    skew: u32,
    /// The line has become dominant since `watch` was told of it.
    fell: bool,
    /// When it was released last, and whether `watch` does not know of that yet.
    edge: Stamp,
    released: bool,
    /// There was a look since that was asked.
    looks: bool,
}

/// Half bits of the rest that ends a spell: the five recessive bits in a row that a frame may have, and a half.
const QUIET_HALF_BITS: u32 = 11;

impl<L: Line> Sentry<L> {
    /// The upper half at rest, with an open gate, which stays so unless it `guards`. A bit has `bit` ticks.
    pub const fn new(watch: Watch<1>, line: L, bit: u32, guards: bool) -> Self {
        Self {
            watch,
            line,
            passes: !guards,
            quiet: bit.saturating_mul(QUIET_HALF_BITS).div_ceil(2),
            skew: bit / 2,
            fell: false,
            edge: Stamp(0),
            released: false,
            looks: false,
        }
    }

    /// A look, every 5.5 bits at least. At most one look of `watch` follows from it, at the stamp of what is to be told: that the
    /// rest of the line ended, that it was released, or that time has passed.
    pub fn look(&mut self, now: Stamp) {
        self.looks = true;
        let Some(seen) = self.line.look() else {
            return;
        };
        if let Some(age) = seen.released {
            self.edge = now.before(age);
            self.released = true;
        }
        let dominant = u32::from(seen.dominant);
        if self.watch.is_between_spells() {
            // If it is recessive again, its release is told with its begin, which is up to one look too early. `now` was taken
            // a little ahead of the age, and a limit must not come too early.
            self.released = false;
            let began = now.before(seen.age).after(self.skew);
            self.tell(Lines { dominant, fell: 1 }, began);
            return;
        }
        self.fell |= seen.fell;
        let fell = u32::from(self.fell);
        let quiet = !seen.dominant && now.reached(self.edge.after(self.quiet));
        if seen.dominant {
            let limit = self.watch.limit();
            if limit.is_some_and(|limit| now.reached(limit)) {
                self.tell(Lines { dominant, fell }, now);
            }
        } else if self.released {
            self.released = false;
            // It was dominant up to there, be it beyond its limit.
            self.tell(Lines { dominant, fell: 1 }, self.edge);
        } else if quiet {
            self.tell(Lines { dominant, fell }, now);
        }
    }

    fn tell(&mut self, lines: Lines, at: Stamp) {
        let open = self.watch.look(lines, at).is_open(0);
        self.line.open(open | self.passes);
        self.fell = false;
        if self.watch.is_between_spells() {
            self.released = false;
            self.line.rest();
        }
    }

    /// Whether there was a look since the last call.
    pub const fn take_looks(&mut self) -> bool {
        core::mem::replace(&mut self.looks, false)
    }

    /// The line as it is now.
    #[inline]
    pub const fn evidence(&self) -> Evidence<1> {
        self.watch.evidence()
    }

    /// See [`Watch::news`].
    #[inline]
    pub fn news(&mut self) -> News<1> {
        self.watch.news()
    }

    /// See [`Watch::driving`].
    pub const fn driving(&self) -> u32 {
        self.watch.driving()
    }

    /// See [`Watch::publish`].
    pub fn publish(&mut self, outlook: &Outlook<1>) {
        self.watch.publish(outlook, 0);
    }

    /// See [`Watch::obey`].
    pub fn obey(&mut self, orders: Orders) {
        self.watch.obey(orders);
        let open = self.watch.gates().is_open(0);
        self.line.open(open | self.passes);
    }
}

#[cfg(feature = "f303")]
impl Line for crate::board::tap::Tap {
    #[inline]
    fn look(&mut self) -> Option<Seen> {
        self.look()
    }
    #[inline]
    fn rest(&mut self) {
        self.rest();
    }
    #[inline]
    fn open(&mut self, open: bool) {
        self.open(open);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;
    use proptest::prelude::*;
    use ttcan::guardian::{Guardian, GuardianConfig};
    use ttcan::{
        Id, MatrixConfig, Micros, NodeId, ReferenceFormat, SystemMatrix, Window, schedule,
    };

    const BIT: u32 = 72;
    const TICKS_PER_US: u32 = 18;
    const NODE: NodeId = NodeId(1);

    const MATRIX: SystemMatrix = SystemMatrix::constant(MatrixConfig {
        bit_rate: 250_000,
        basic_cycle: Micros::micros(100_000),
        cycles: 1,
        reference: Id::constant::<100>(),
        reference_format: ReferenceFormat::LEVEL_1,
        masters: &[NodeId(0)],
        transmit_enable_bits: 16,
        sync_uncertainty: Micros::micros(20),
        longest_gap: Micros::micros(0),
        windows: &[Window::exclusive(
            "status",
            Micros::micros(3000),
            Micros::micros(1000),
            Id::constant::<200>(),
            8,
            NODE,
        )],
        events: &[],
    });
    schedule!(static SCHEDULE = MATRIX);

    /// A line with its timer.
    #[derive(Default)]
    struct Wire {
        now: u32,
        dominant: bool,
        begun: Option<u32>,
        fell: bool,
        released: Option<u32>,
        /// When the gate is closed, and whether it is.
        closes: Option<u32>,
        closed: bool,
    }

    impl Line for Wire {
        fn look(&mut self) -> Option<Seen> {
            let seen = Seen {
                age: self.now - self.begun?,
                dominant: self.dominant,
                fell: self.fell,
                released: self.released.map(|at| self.now - at),
            };
            (self.fell, self.released) = (false, None);
            Some(seen)
        }
        fn rest(&mut self) {
            (self.fell, self.released) = (false, None);
            self.begun = self.dominant.then_some(self.now);
        }
        fn open(&mut self, open: bool) {
            self.closed &= !open;
            self.closes = (!open).then_some(self.now + TAKES);
        }
    }

    /// Ticks from one look to the next, and of the longest delay of one.
    const LOOK: u32 = 324;
    const LATE: u32 = 72;
    /// From its begin until the gate is set.
    const TAKES: u32 = 198;

    struct Rig {
        sentry: Sentry<Wire>,
        /// When the next look comes, and the delays of looks, which take turns.
        next: u32,
        late: [u32; 4],
        looks: usize,
    }

    impl Rig {
        fn new(phase: u32, late: [u32; 4]) -> Self {
            let config = GuardianConfig {
                spell_bits: 20,
                ..GuardianConfig::new(TICKS_PER_US, Micros::micros(11))
            };
            let guardian = Guardian::new(SCHEDULE.view(), config, [NODE], Stamp(0));
            let (watch, _) = guardian.unwrap().halves();
            Self {
                sentry: Sentry::new(watch, Wire::default(), BIT, true),
                next: phase,
                late,
                looks: 0,
            }
        }

        fn drive(&mut self, dominant: bool) {
            let wire = &mut self.sentry.line;
            if dominant == wire.dominant {
                return;
            }
            wire.dominant = dominant;
            if dominant {
                wire.begun = wire.begun.or(Some(wire.now));
                wire.fell = true;
            } else {
                wire.released = Some(wire.now);
            }
        }

        fn pass(&mut self, bits: u32) {
            for _ in 0..bits * BIT {
                let wire = &mut self.sentry.line;
                wire.now += 1;
                let now = wire.now;
                wire.closed |= wire.closes.is_some_and(|at| now >= at);
                if now == self.next + self.late[self.looks % 4] {
                    self.sentry.look(Stamp(now));
                    self.next += LOOK;
                    self.looks += 1;
                }
            }
        }

        /// Drives runs of equal bits, a dominant one first. Returns behind which bit the gate was closed.
        fn drive_runs(&mut self, runs: &[u32]) -> Option<u32> {
            let mut closed = None;
            let mut behind = 0;
            for (place, bits) in runs.iter().enumerate() {
                self.drive(place % 2 == 0);
                for _ in 0..*bits {
                    self.pass(1);
                    behind += 1;
                    if self.sentry.line.closed && closed.is_none() {
                        closed = Some(behind);
                    }
                }
            }
            self.drive(false);
            closed
        }
    }

    #[test]
    fn a_line_that_is_dominant_at_rest_is_found() {
        let mut rig = Rig::new(10, [0; 4]);
        rig.sentry.line.dominant = true;
        rig.sentry.line.rest();
        rig.pass(40);
        assert!(rig.sentry.line.closed);
        rig.drive(false);
        rig.pass(22);
        assert!(!rig.sentry.line.closed, "the spell is over");
    }

    proptest! {
        /// Whenever the looks come: flags pass, with as little rest between them as there is, and no frame does.
        #[test]
        fn flags_pass_and_no_frame_does(
            phase in 1..LOOK,
            late in [0..=LATE, 0..=LATE, 0..=LATE, 0..=LATE],
            spells in proptest::collection::vec((1..=20u32, 11..=40u32), 1..20),
            frame in proptest::collection::vec(1..=5u32, 34),
        ) {
            let mut rig = Rig::new(phase, late);
            for (dominant, rest) in spells {
                rig.drive(true);
                rig.pass(dominant);
                prop_assert!(!rig.sentry.line.closed);
                rig.drive(false);
                rig.pass(rest);
                prop_assert!(!rig.sentry.line.closed);
            }
            // With stuff bits, as a frame without data up to the end of its CRC, or longer.
            let stopped = rig.drive_runs(&frame).expect("no frame passes");
            prop_assert!((20..34).contains(&stopped), "{}", stopped);
            rig.pass(22);
            prop_assert!(!rig.sentry.line.closed, "the spell is over");
        }
    }
}
