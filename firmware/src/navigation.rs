//! Turns the satellite receiver's messages into those of its node.

use control::position::{Position, Velocity};
use ttcan::Micros;

use crate::convert;
use crate::convert::Geodetic;

use crate::sbp::{self, Fix, Message, Parser, Progress};

/// Bytes that [`Station::step`] reads: as many as the shortest frame of a position or a
/// velocity, so that each of these frames ends a step.
pub const STEP: usize = 30;

/// A new value for a message of the node. `None` removes what was enqueued.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Update {
    /// Position of the antenna, mm.
    Position(Option<Position>),
    /// Its velocity, mm/s.
    Velocity(Option<Velocity>),
    /// Heading of the velocity, thousandths of a degree in [0, 360 000).
    Heading(Option<i32>),
    /// Latitude of the antenna.
    Latitude(Option<Geodetic>),
    /// Its longitude.
    Longitude(Option<Geodetic>),
}

/// State of the receiver.
#[derive(Clone, Copy, Debug, Default)]
pub struct Navigation {
    fix: Fix,
    satellites: u8,
    heading: Option<i32>,
    heard_at: Option<u32>,
    tow: Option<u32>,
    epochs: u32,
}

impl Navigation {
    /// A receiver that has sent nothing yet.
    pub const fn new() -> Self {
        Self {
            fix: Fix::None,
            satellites: 0,
            heading: None,
            heard_at: None,
            tow: None,
            epochs: 0,
        }
    }

    /// Takes one message, decoded at `now` (time base), and hands what it changes to `put`.
    ///
    /// The position and the heading are sent only while the solution is fixed. A message that
    /// ends the fix removes both at once.
    pub fn message(&mut self, message: &Message, now: u32, mut put: impl FnMut(Update)) {
        match *message {
            Message::PositionNed(position) => {
                self.heard(position.tow, now);
                self.fix = position.fix;
                self.satellites = position.satellites;
                let fixed = position.fix.is_fixed();
                let place = Position::new(position.north, position.east);
                put(Update::Position(fixed.then_some(place)));
                if !fixed {
                    put(Update::Heading(None));
                }
            }
            Message::VelocityNed(velocity) => {
                self.heard(velocity.tow, now);
                if !velocity.valid {
                    put(Update::Velocity(None));
                    return;
                }
                let speed = Velocity::new(velocity.north, velocity.east);
                put(Update::Velocity(Some(speed)));
                // Walking pace and slower: the last heading stays.
                if let Some(heading) = convert::heading_of(velocity.north, velocity.east) {
                    self.heading = Some(heading);
                }
                let heading = self.heading.filter(|_| self.fix.is_fixed());
                put(Update::Heading(heading));
            }
            Message::PositionLlh(position) => {
                self.heard(position.tow, now);
                let known = position.fix != Fix::None;
                let angle = |degrees| {
                    if known {
                        convert::geodetic(degrees)
                    } else {
                        None
                    }
                };
                put(Update::Latitude(angle(position.latitude)));
                put(Update::Longitude(angle(position.longitude)));
            }
            Message::Time(_) | Message::Heading(_) | Message::Heartbeat(_) => {}
        }
    }

    fn heard(&mut self, tow: u32, now: u32) {
        if self.tow != Some(tow) {
            self.tow = Some(tow);
            self.epochs = self.epochs.wrapping_add(1);
        }
        self.heard_at = Some(now);
    }

    /// Updates the fix as time passes: after `timeout` ticks without a message the fix is lost.
    /// True if it was lost in this call. Call this more often than every 2^31 ticks.
    pub fn lapse(&mut self, now: u32, timeout: u32) -> bool {
        let silent = self.age(now).is_some_and(|age| age > timeout);
        if silent {
            self.heard_at = None;
            self.fix = Fix::None;
        }
        silent
    }

    /// Quality of the last baseline position.
    pub const fn fix(&self) -> Fix {
        self.fix
    }

    /// Satellites used in that position.
    pub const fn satellites(&self) -> u8 {
        self.satellites
    }

    /// Measurement epochs heard; wraps.
    pub const fn epochs(&self) -> u32 {
        self.epochs
    }

    /// Time of week of the last epoch, ms.
    pub const fn tow(&self) -> Option<u32> {
        self.tow
    }

    /// Ticks since the last message; `None` when the receiver is silent. If a task of a higher
    /// priority took a message after `now` was read, the age is 0.
    pub fn age(&self, now: u32) -> Option<u32> {
        self.heard_at
            .map(|heard| now.wrapping_sub(heard).cast_signed().max(0).cast_unsigned())
    }
}

/// Result of [`Station::step`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// There may be more to read: [`STEP`] bytes or more were read.
    More,
    /// All bytes are read.
    Drained,
    /// All bytes are read, for the first time since the line became idle.
    Paused(Pause),
}

/// Results when all bytes before an idle phase of the line have been read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pause {
    /// When the line became idle, time base.
    pub since: u32,
    /// Whether a measurement epoch began since the last pause.
    pub is_new_epoch: bool,
    /// Time of week of the last epoch, ms.
    pub tow: Option<u32>,
    /// Whether the solution is fixed.
    pub fixed: bool,
}

/// The receiver as its node sees it: bytes go in, updates of messages come out.
#[derive(Clone, Debug, Default)]
pub struct Station {
    parser: Parser,
    navigation: Navigation,
    /// Whether bytes may have arrived that were not taken yet.
    behind: bool,
    idle_since: Option<u32>,
    /// Epochs at the last pause.
    epochs: u32,
}

/// The body of a step. A macro, because a closure that does nothing leaves a trace in the image.
macro_rules! step {
    ($station:ident, $now:ident, $put:ident $(, $show:ident)?) => {
        match $station.parser.next(STEP) {
            Progress::Frame(frame) => {
                $($show(frame);)?
                if let Some(message) = sbp::decode(&frame) {
                    $station.navigation.message(&message, $now, $put);
                }
                Step::More
            }
            Progress::More => Step::More,
            Progress::Drained if $station.behind => Step::Drained,
            Progress::Drained => match $station.idle_since.take() {
                Some(since) => {
                    let epochs = $station.navigation.epochs;
                    Step::Paused(Pause {
                        since,
                        is_new_epoch: core::mem::replace(&mut $station.epochs, epochs) != epochs,
                        tow: $station.navigation.tow,
                        fixed: $station.navigation.fix.is_fixed(),
                    })
                }
                None => Step::Drained,
            },
        }
    };
}

impl Station {
    /// A receiver that has sent nothing yet.
    pub const fn new() -> Self {
        Self {
            parser: Parser::new(),
            navigation: Navigation::new(),
            behind: false,
            idle_since: None,
            epochs: 0,
        }
    }

    /// Takes bytes that have arrived; [`Station::step`] reads them. True if it took
    /// [`sbp::LOT`] of them, so that there may be more.
    #[inline(always)]
    pub fn take(&mut self, bytes: impl ExactSizeIterator<Item = u8>) -> bool {
        self.behind = self.parser.take(bytes);
        self.behind
    }

    /// Notes that the line became idle at `now`, after the bytes that have arrived by then.
    pub const fn pause(&mut self, now: u32) {
        self.idle_since = Some(now);
    }

    /// Reads bytes that were taken and hands changes to `put`. Stops after [`STEP`] bytes or at
    /// the end of a position or a velocity. Call this again as long as it returns
    /// [`Step::More`].
    #[inline(always)]
    pub fn step(&mut self, now: u32, put: impl FnMut(Update)) -> Step {
        step!(self, now, put)
    }

    /// As [`Station::step`], and shows each frame to `show`, for messages that not every vehicle uses.
    #[inline(always)]
    pub fn step_showing(
        &mut self,
        now: u32,
        put: impl FnMut(Update),
        mut show: impl FnMut(sbp::Frame<'_>),
    ) -> Step {
        step!(self, now, put, show)
    }

    /// State of the receiver.
    pub const fn navigation(&self) -> &Navigation {
        &self.navigation
    }

    /// State of the receiver, for updating it as time passes.
    pub const fn navigation_mut(&mut self) -> &mut Navigation {
        &mut self.navigation
    }

    /// Counters of its bytes and frames.
    pub const fn counters(&self) -> sbp::Counters {
        self.parser.counters()
    }
}

/// Correction of the length of the next basic cycle, in microseconds, positive to lengthen it.
/// It moves the ends of the receiver's bursts to `lead` before the references. `age` is the age
/// of the current cycle, of length `cycle`, at the end of a burst.
///
/// Proportional to the error, with a time constant of 3.2 s; the error is taken the shorter way
/// round the cycle. The protocol stack limits the correction to what the other nodes tolerate.
pub fn trim(age: Micros, cycle: Micros, lead: Micros) -> i8 {
    let wanted = cycle.ticks().cast_signed() - lead.ticks().cast_signed();
    let early = wanted - age.ticks().min(cycle.ticks()).cast_signed();
    let cycle = cycle.ticks().cast_signed();
    let nearer = if early > cycle / 2 {
        early - cycle
    } else {
        early
    };
    // A burst that ends too early in its cycle means that the references are late: shorten the
    // cycle.
    (-nearer / 32).clamp(-100, 100) as i8
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::sbp::{PositionNed, VelocityNed};
    use std::vec::Vec;

    fn position(fix: Fix) -> Message {
        Message::PositionNed(PositionNed {
            tow: 100,
            north: -5,
            east: 7,
            down: 0,
            satellites: 9,
            fix,
        })
    }

    fn velocity(north: i32) -> Message {
        Message::VelocityNed(VelocityNed {
            tow: 100,
            north,
            east: 0,
            down: 0,
            satellites: 9,
            valid: true,
        })
    }

    /// Length of the basic cycle.
    const CYCLE: Micros = Micros::millis(100);
    /// How long before a reference a burst should end.
    const LEAD: Micros = Micros::millis(5);

    fn puts(navigation: &mut Navigation, message: &Message) -> Vec<Update> {
        let mut puts = Vec::new();
        navigation.message(message, 0, |put| puts.push(put));
        puts
    }

    #[test]
    fn position_and_heading_need_a_fixed_solution() {
        let mut navigation = Navigation::new();
        for fix in [Fix::None, Fix::Single, Fix::Float, Fix::DeadReckoning] {
            assert_eq!(
                puts(&mut navigation, &position(fix)),
                [Update::Position(None), Update::Heading(None)]
            );
            assert_eq!(
                puts(&mut navigation, &velocity(1000))[1],
                Update::Heading(None)
            );
        }
        let put = puts(&mut navigation, &position(Fix::Fixed));
        assert_eq!(put, [Update::Position(Some(Position::new(-5, 7)))]);
        // The heading stays when the vehicle stops.
        for speed in [-1000, 0] {
            let put = puts(&mut navigation, &velocity(speed));
            assert_eq!(put[1], Update::Heading(Some(180_000)));
        }
    }

    #[test]
    fn a_silent_receiver_has_no_fix() {
        let mut navigation = Navigation::new();
        navigation.message(&position(Fix::Fixed), 1000, |_| {});
        assert!(!navigation.lapse(999, 500), "heard after the time was read");
        assert!(!navigation.lapse(1500, 500));
        assert!(navigation.fix().is_fixed());
        assert!(navigation.lapse(1501, 500));
        assert_eq!(navigation.fix(), Fix::None);
        assert!(!navigation.lapse(5000, 500));
    }

    #[test]
    fn the_cycle_is_pulled_towards_the_bursts() {
        let lead = LEAD.ticks();
        assert_eq!(trim(Micros::micros(100_000 - lead), CYCLE, LEAD), 0);
        // The burst ends too early, so the references come too long after it: shorten the
        // cycle.
        assert_eq!(trim(Micros::micros(100_000 - lead - 320), CYCLE, LEAD), -10);
        assert_eq!(trim(Micros::micros(100_000 - lead + 320), CYCLE, LEAD), 10);
        // The burst ends just after a reference: lengthen the cycle until the burst ends before
        // it.
        assert_eq!(trim(Micros::micros(100), CYCLE, LEAD), 100);
        assert_eq!(trim(Micros::micros(60_000), CYCLE, LEAD), -100);
        assert_eq!(trim(Micros::micros(u32::MAX), CYCLE, LEAD), 100);
    }

    /// From any phase, with a receiver clock 50 ppm off, the bursts settle at their place.
    #[test]
    fn any_phase_settles() {
        for start in (0..100_000).step_by(997) {
            let mut age = f64::from(start);
            for _ in 0..20_000 {
                let trim = trim(Micros::micros(age as u32), CYCLE, LEAD).clamp(-8, 8);
                age = (age - f64::from(trim) + 5.0).rem_euclid(100_000.0);
            }
            let lead = 100_000.0 - age;
            assert!((lead - 5_000.0).abs() < 200.0, "{start}: {lead}");
        }
    }
}
