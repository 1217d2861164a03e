//! What the satellite receiver says, turned into messages of the gps node.

use network::Message as _;
use network::matrix::window;
use network::messages::{
    Heading, Latitude, Longitude, Millidegrees, Millimetres, MillimetresPerSecond, Position,
    Velocity,
};

use crate::{convert, design};
use ttcan::Micros;

use crate::sbp::{self, Fix, Message, Parser, Progress};

/// Places that [`Station::step`] goes over: as many as the shortest position or velocity has
/// bytes, so that each of them ends a step of its own.
pub const STEP: usize = 30;

/// Data for a window of the node; `None` takes back what was in line.
pub type Put = (usize, Option<[u8; 8]>);

/// State of the receiver.
#[derive(Clone, Copy, Debug, Default)]
pub struct Navigation {
    fix: Fix,
    satellites: u8,
    heading: Option<Millidegrees>,
    heard_at: Option<u32>,
    tow: Option<u32>,
    epochs: u32,
}

impl Navigation {
    /// A receiver that has not been heard.
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

    /// Takes one message, decoded at `now` (time base), and hands what it changes in the
    /// node's windows to `put`.
    ///
    /// Position and heading are for the bus only while the solution is fixed; a message that
    /// ends the fix takes both back at once.
    pub fn message(&mut self, message: &Message, now: u32, mut put: impl FnMut(Put)) {
        match *message {
            Message::PositionNed(position) => {
                self.heard(position.tow, now);
                self.fix = position.fix;
                self.satellites = position.satellites;
                let data = position.fix.is_fixed().then(|| {
                    Position {
                        north: Millimetres(position.north),
                        east: Millimetres(position.east),
                    }
                    .encode()
                });
                put((window::POSITION, data));
                if data.is_none() {
                    put((window::HEADING, None));
                }
            }
            Message::VelocityNed(velocity) => {
                self.heard(velocity.tow, now);
                if !velocity.valid {
                    put((window::VELOCITY, None));
                    return;
                }
                put((
                    window::VELOCITY,
                    Some(
                        Velocity {
                            north: MillimetresPerSecond(velocity.north),
                            east: MillimetresPerSecond(velocity.east),
                        }
                        .encode(),
                    ),
                ));
                // At walking pace and below the last heading stands.
                if let Some(heading) = convert::heading_of(velocity.north, velocity.east) {
                    self.heading = Some(heading);
                }
                let heading = self.heading.filter(|_| self.fix.is_fixed());
                put((
                    window::HEADING,
                    heading.map(|heading| padded(Heading { heading }.encode())),
                ));
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
                let latitude = angle(position.latitude).map(|angle| {
                    Latitude {
                        fraction: angle.fraction,
                        whole: angle.whole,
                        negative: angle.negative,
                    }
                    .encode()
                });
                let longitude = angle(position.longitude).map(|angle| {
                    Longitude {
                        fraction: angle.fraction,
                        whole: angle.whole,
                        negative: angle.negative,
                    }
                    .encode()
                });
                put((window::LATITUDE, latitude.map(padded)));
                put((window::LONGITUDE, longitude.map(padded)));
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

    /// Notes that time passes: after `timeout` ticks without a message there is no fix any
    /// more. True when that just happened. To be called more often than every 2^31 ticks.
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

    /// Satellites used in it.
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

    /// Ticks since the last message; `None` when the receiver is silent. A message that was
    /// heard after `now` was read, by a task of a higher priority, is of age 0.
    pub fn age(&self, now: u32) -> Option<u32> {
        self.heard_at
            .map(|heard| now.wrapping_sub(heard).cast_signed().max(0).cast_unsigned())
    }
}

/// What [`Station::step`] came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// As far as it goes in one call, over [`STEP`] bytes at least.
    More,
    /// To where bytes are missing.
    Drained,
    /// There for the first time since the line fell idle, with all that has arrived.
    Paused(Pause),
}

/// What is known when all that came before a pause of the line has been looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pause {
    /// When the line fell idle, time base.
    pub since: u32,
    /// Whether a measurement epoch began since the last pause.
    pub is_new_epoch: bool,
    /// Time of week of the last epoch, ms.
    pub tow: Option<u32>,
    /// Whether the solution is fixed.
    pub fixed: bool,
}

/// The receiver as the node hears it: bytes in, data for windows out.
#[derive(Clone, Debug, Default)]
pub struct Station {
    parser: Parser,
    navigation: Navigation,
    /// Whether there may be bytes that have not been taken.
    behind: bool,
    idle_since: Option<u32>,
    /// Epochs at the last pause.
    epochs: u32,
}

impl Station {
    /// A receiver that has not been heard.
    pub const fn new() -> Self {
        Self {
            parser: Parser::new(),
            navigation: Navigation::new(),
            behind: false,
            idle_since: None,
            epochs: 0,
        }
    }

    /// Takes bytes that have arrived, to be looked at by [`Station::step`]; true when there
    /// may be more of them than it takes in one call, [`sbp::LOT`].
    #[inline(always)]
    pub fn take(&mut self, bytes: impl ExactSizeIterator<Item = u8>) -> bool {
        self.behind = self.parser.take(bytes);
        self.behind
    }

    /// Notes that the line fell idle at `now`, after what has arrived by then.
    pub const fn pause(&mut self, now: u32) {
        self.idle_since = Some(now);
    }

    /// Looks at bytes that were taken, [`STEP`] of them and to the next position or
    /// velocity at most, and hands what that changes to `put`. To be called again as long as
    /// there is [`Step::More`].
    #[inline(always)]
    pub fn step(&mut self, now: u32, put: impl FnMut(Put)) -> Step {
        match self.parser.next(STEP) {
            Progress::Frame(frame) => {
                if let Some(message) = sbp::decode(&frame) {
                    self.navigation.message(&message, now, put);
                }
                Step::More
            }
            Progress::More => Step::More,
            Progress::Drained if self.behind => Step::Drained,
            Progress::Drained => match self.idle_since.take() {
                Some(since) => {
                    let epochs = self.navigation.epochs;
                    Step::Paused(Pause {
                        since,
                        is_new_epoch: core::mem::replace(&mut self.epochs, epochs) != epochs,
                        tow: self.navigation.tow,
                        fixed: self.navigation.fix.is_fixed(),
                    })
                }
                None => Step::Drained,
            },
        }
    }

    /// What the receiver said.
    pub const fn navigation(&self) -> &Navigation {
        &self.navigation
    }

    /// What the receiver said, to note that time passes.
    pub const fn navigation_mut(&mut self) -> &mut Navigation {
        &mut self.navigation
    }

    /// What happened to its bytes.
    pub const fn counters(&self) -> sbp::Counters {
        self.parser.counters()
    }
}

/// By how many microseconds the basic cycle after this one should be longer so that the
/// receiver's bursts come to end [`design::BURST_LEAD`] before the references. `age` is the
/// age of the cycle under way at the end of a burst.
///
/// Proportional to the error with a time constant of 3.2 s, the nearer way round the cycle.
/// The stack cuts it at what the other nodes bear.
pub fn trim(age: Micros) -> i8 {
    const CYCLE: i32 = network::matrix::BASIC_CYCLE.ticks().cast_signed();
    const WANTED: i32 = CYCLE - design::BURST_LEAD.ticks().cast_signed();
    let early = WANTED - age.ticks().min(CYCLE.cast_unsigned()).cast_signed();
    let nearer = if early > CYCLE / 2 {
        early - CYCLE
    } else {
        early
    };
    // A burst that ends too early in its cycle: the references are late, shorten.
    (-nearer / 32).clamp(-100, 100) as i8
}

/// Data of a shorter message in the buffer of a window.
pub fn padded<const N: usize>(data: [u8; N]) -> [u8; 8] {
    let mut bytes = [0; 8];
    for (to, from) in bytes.iter_mut().zip(data) {
        *to = from;
    }
    bytes
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

    fn puts(navigation: &mut Navigation, message: &Message) -> Vec<Put> {
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
                [(window::POSITION, None), (window::HEADING, None)]
            );
            assert_eq!(
                puts(&mut navigation, &velocity(1000))[1],
                (window::HEADING, None)
            );
        }
        let put = puts(&mut navigation, &position(Fix::Fixed));
        assert_eq!(
            put,
            [(window::POSITION, Some([0xFB, 0xFF, 0xFF, 0xFF, 7, 0, 0, 0]))]
        );
        // 180 degrees = 180 000 = 0x02BF20; and it stands when the vehicle stops.
        for speed in [-1000, 0] {
            let put = puts(&mut navigation, &velocity(speed));
            assert_eq!(
                put[1],
                (window::HEADING, Some([0x20, 0xBF, 2, 0, 0, 0, 0, 0]))
            );
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
        let lead = design::BURST_LEAD.ticks();
        assert_eq!(trim(Micros::micros(100_000 - lead)), 0);
        // The burst ends too early: the references come too late after it.
        assert_eq!(trim(Micros::micros(100_000 - lead - 320)), -10);
        assert_eq!(trim(Micros::micros(100_000 - lead + 320)), 10);
        // Just after a reference: the cycle has to grow until the burst is in front of it.
        assert_eq!(trim(Micros::micros(100)), 100);
        assert_eq!(trim(Micros::micros(60_000)), -100);
        assert_eq!(trim(Micros::micros(u32::MAX)), 100);
    }

    /// From any phase the bursts settle in place, with a receiver 50 ppm off.
    #[test]
    fn any_phase_settles() {
        for start in (0..100_000).step_by(997) {
            let mut age = f64::from(start);
            for _ in 0..20_000 {
                let trim = trim(Micros::micros(age as u32)).clamp(-8, 8);
                age = (age - f64::from(trim) + 5.0).rem_euclid(100_000.0);
            }
            let lead = 100_000.0 - age;
            assert!((lead - 5_000.0).abs() < 200.0, "{start}: {lead}");
        }
    }
}
