//! The servo pulses, sampled through the input register of the port.

use crate::bench::{Bench, near};
use crate::board::clock::Clocks;
use crate::board::pulse::{PulsePeriod, PulseWidth};
use crate::board::servos::Servos;
use crate::board::time::Clock;
use crate::registers::port_a;

const IDR: u32 = 0x10;

/// The pins, left and right.
const PINS: [u32; 2] = [7, 10];

/// A period that no command of these tests waits for.
const PERIOD_US: u16 = 10_000;

/// How far a measured width may be from the true one, us: two samples are less than 1 us apart.
const SLACK_US: u32 = 2;

/// The outputs with what measures them.
struct Outputs {
    servos: Servos,
    clock: Clock,
    clocks: Clocks,
}

impl Outputs {
    fn start() -> Self {
        Self::with_period(PERIOD_US)
    }

    fn with_period(us: u16) -> Self {
        let mut outputs = Self::silent(us);
        assert!(outputs.servos.begin(), "no pulse begins");
        outputs
    }

    /// No pulses have begun.
    fn silent(us: u16) -> Self {
        let mut bench = Bench::start();
        let period = PulsePeriod::new(us).expect("a period");
        let servos = bench.sled.rest.servos(period).expect("the first call");
        assert!(bench.sled.rest.servos(period).is_none(), "a second call");
        Self {
            servos,
            clock: bench.sled.clock,
            clocks: bench.sled.clocks,
        }
    }

    fn us(&self, ticks: u32) -> u32 {
        ticks / self.clocks.ticks_per_us
    }

    /// Levels of both pins, one bit each.
    fn levels() -> u32 {
        let port = port_a().read(IDR);
        (port >> PINS[0] & 1) | (port >> PINS[1] & 1) << 1
    }

    /// Waits for these levels, and returns when they came.
    #[track_caller]
    fn wait(&self, what: &str, done: impl Fn(u32) -> bool) -> u32 {
        let since = self.clock.now();
        loop {
            let levels = Self::levels();
            let now = self.clock.now();
            if done(levels) {
                return now;
            }
            let waited = self.us(now.wrapping_sub(since));
            assert!(waited < 2 * u32::from(PERIOD_US), "{what}");
        }
    }

    /// Measures the next pulses from their beginning: when that is, and their widths in
    /// microseconds. The lines are low.
    #[track_caller]
    fn pulses(&self) -> (u32, [u32; 2]) {
        assert!(Self::levels() == 0, "a line is not low");
        let began = self.wait("no pulse begins", |levels| levels != 0);
        assert!(Self::levels() == 0b11, "the pulses do not begin together");
        (began, self.ends(began))
    }

    /// The widths of the pulses that began then.
    #[track_caller]
    fn ends(&self, began: u32) -> [u32; 2] {
        let mut widths = [0; 2];
        let first = self.wait("no pulse ends", |levels| levels != 0b11);
        let left = Self::levels();
        for (side, width) in widths.iter_mut().enumerate() {
            let ended = if left >> side & 1 == 0 {
                first
            } else {
                self.wait("a pulse does not end", |levels| levels >> side & 1 == 0)
            };
            *width = self.us(ended.wrapping_sub(began));
        }
        widths
    }

    fn pause(&self, us: u32) {
        let since = self.clock.now();
        while self.us(self.clock.now().wrapping_sub(since)) < us {}
    }
}

#[track_caller]
fn widths(measured: [u32; 2], left: u32, right: u32) {
    near("left pulse, us", measured[0], left, SLACK_US);
    near("right pulse, us", measured[1], right, SLACK_US);
}

#[embedded_test::tests(default_timeout = 5)]
mod tests {
    use super::*;

    #[test]
    fn no_pulse_comes_until_they_begin() {
        let mut outputs = Outputs::silent(PERIOD_US);
        let silent = |outputs: &Outputs| {
            let since = outputs.clock.now();
            while outputs.us(outputs.clock.now().wrapping_sub(since)) < 2 * u32::from(PERIOD_US) {
                assert!(Outputs::levels() == 0, "a pulse");
            }
            assert!(!outputs.servos.is_on());
        };
        silent(&outputs);
        let width = PulseWidth::clamped(1250);
        outputs.servos.fire(width, PulseWidth::LONGEST);
        silent(&outputs);
        // The first pulses have the widths that were set, and all of them.
        let since = outputs.clock.now();
        while !outputs.servos.begin() {
            let waited = outputs.us(outputs.clock.now().wrapping_sub(since));
            assert!(waited < 2100, "it does not begin");
        }
        let began = outputs.wait("no pulse begins", |levels| levels == 0b11);
        widths(outputs.ends(began), 1250, 2000);
        assert!(outputs.servos.is_on());
        // Again changes nothing: the next pulses come in their time.
        assert!(outputs.servos.begin());
        let (next, measured) = outputs.pulses();
        let between = outputs.us(next.wrapping_sub(began));
        near("us between pulses", between, PERIOD_US.into(), SLACK_US);
        widths(measured, 1250, 2000);
    }

    #[test]
    fn a_pause_cuts_no_pulse() {
        let mut outputs = Outputs::start();
        let long = PulseWidth::LONGEST;
        outputs.servos.set(long, long);
        outputs.pulses();
        let began = outputs.wait("no pulse begins", |levels| levels != 0);
        outputs.pause(1900);
        assert!(!outputs.servos.pause(), "a pulse is cut");
        widths(outputs.ends(began), 2000, 2000);
        outputs.pause(10);
        assert!(outputs.servos.pause() && !outputs.servos.is_on());
        assert!(outputs.servos.pause(), "it is off already");
        let since = outputs.clock.now();
        while outputs.us(outputs.clock.now().wrapping_sub(since)) < 2 * u32::from(PERIOD_US) {
            assert!(Outputs::levels() == 0, "a pulse");
        }
        outputs.servos.stop();
        while !outputs.servos.begin() {}
        let began = outputs.wait("no pulse begins", |levels| levels == 0b11);
        widths(outputs.ends(began), 1500, 1500);
    }

    #[test]
    fn the_first_pulses_are_neutral_and_follow_in_their_period() {
        let outputs = Outputs::start();
        assert!(outputs.servos.is_neutral() && outputs.servos.is_on());
        let (first, measured) = outputs.pulses();
        widths(measured, 1500, 1500);
        let (second, measured) = outputs.pulses();
        widths(measured, 1500, 1500);
        let between = outputs.us(second.wrapping_sub(first));
        near("us between pulses", between, PERIOD_US.into(), SLACK_US);
    }

    #[test]
    fn a_width_counts_from_the_next_pulse() {
        let mut outputs = Outputs::start();
        outputs.pulses();
        outputs
            .servos
            .set(PulseWidth::SHORTEST, PulseWidth::LONGEST);
        let (_, measured) = outputs.pulses();
        widths(measured, 1000, 2000);
        // In the middle of a pulse.
        let began = outputs.wait("no pulse begins", |levels| levels != 0);
        outputs.pause(500);
        outputs.servos.stop();
        widths(outputs.ends(began), 1000, 2000);
        let (_, measured) = outputs.pulses();
        widths(measured, 1500, 1500);
    }

    #[test]
    fn a_command_fires_pulses_at_once() {
        let mut outputs = Outputs::start();
        let (mut last, _) = outputs.pulses();
        for us in [1200, 1800, 1499] {
            // 4 ms after the last pulses began, long before the next ones would.
            while outputs.us(outputs.clock.now().wrapping_sub(last)) < 4000 {}
            let width = PulseWidth::clamped(us);
            let since = outputs.clock.now();
            let fired = outputs.servos.fire(width, PulseWidth::NEUTRAL);
            let began = outputs.wait("no pulse begins", |levels| levels == 0b11);
            assert!(fired, "it was not fired");
            near(
                "us until it began",
                outputs.us(began.wrapping_sub(since)),
                0,
                5,
            );
            widths(outputs.ends(began), us.into(), 1500);
            last = began;
        }
        let (began, _) = outputs.pulses();
        let between = outputs.us(began.wrapping_sub(last));
        near("us between pulses", between, PERIOD_US.into(), 5);
    }

    /// Neither in the middle of a pulse nor within 3 ms of its beginning.
    #[test]
    fn a_command_waits_for_the_period_when_it_comes_too_soon() {
        let mut outputs = Outputs::start();
        let (mut last, _) = outputs.pulses();
        for (wait, us) in [(700, 1300), (2800, 1700)] {
            let began = outputs.wait("no pulse begins", |levels| levels != 0);
            let between = outputs.us(began.wrapping_sub(last));
            near("us between pulses", between, PERIOD_US.into(), SLACK_US);
            last = began;
            outputs.pause(wait);
            let before = Outputs::levels();
            let width = PulseWidth::clamped(us);
            let fired = outputs.servos.fire(width, width);
            assert!(!fired, "it was fired too soon");
            assert!(Outputs::levels() == before, "a level has changed");
            if before != 0 {
                outputs.ends(began);
            }
            let (next, measured) = outputs.pulses();
            near(
                "us between pulses",
                outputs.us(next.wrapping_sub(last)),
                PERIOD_US.into(),
                SLACK_US,
            );
            widths(measured, us.into(), us.into());
            last = next;
        }
    }

    /// Commands at all phases of a short period: in steps of 33 us, and in steps of three ticks near
    /// the two instants from which and until which a command fires.
    #[test]
    #[timeout(30)]
    fn a_command_at_any_phase_leaves_every_pulse_whole() {
        const SHORT_US: u16 = 3300;
        let mut outputs = Outputs::with_period(SHORT_US);
        let per_us = outputs.clocks.ticks_per_us;
        let near = |us: u32| ((us - 4) * per_us..(us + 1) * per_us).step_by(3);
        let all = (0..u32::from(SHORT_US) * per_us).step_by(33 * per_us as usize);
        let (mut fired, mut waited) = (0, 0);
        for (turn, phase) in (0..).zip(all.chain(near(3000)).chain(near(SHORT_US.into()))) {
            // Lengths that no other turn has had for a while, and that tell left from right.
            let left = PulseWidth::clamped(1000 + turn % 490);
            let right = PulseWidth::clamped(2000 - turn % 490);
            let began = outputs.wait("no pulse begins", |levels| levels != 0);
            while outputs.clock.now().wrapping_sub(began) < phase {}
            if outputs.servos.fire(left, right) {
                fired += 1;
            } else {
                waited += 1;
            }
            // The pulses that follow when the lines are low are the new ones at the latest.
            outputs.wait("a pulse does not end", |levels| levels == 0);
            let began = outputs.wait("no pulse begins", |levels| levels != 0);
            let measured = outputs.ends(began);
            assert!(
                measured[0].abs_diff(left.us().into()) <= SLACK_US
                    && measured[1].abs_diff(right.us().into()) <= SLACK_US,
                "{measured:?} us after a command at {phase} ticks, not {left:?} and {right:?}"
            );
        }
        // It fires for 300 of 3300 us: at 9 of the first 100 phases, and about half of the others.
        defmt::info!("fired {=u32}, waited {=u32}", fired, waited);
        assert!(fired > 15 && waited > 90, "{fired} fired, {waited} waited");
    }

    /// Once they have ended, as before a reset, the lines stay low; the pulses that run end first.
    #[test]
    fn the_end_of_the_program_does_not_cut_a_pulse() {
        use crate::board::servos::end;
        let mut outputs = Outputs::start();
        outputs.pulses();
        let long = PulseWidth::LONGEST;
        outputs.servos.set(long, long);
        let began = outputs.wait("no pulse begins", |levels| levels != 0);
        end();
        let ended = outputs.us(outputs.clock.now().wrapping_sub(began));
        near("us until the end", ended, 2000, 20);
        assert!(!outputs.servos.is_on(), "the outputs are on");
        let since = outputs.clock.now();
        while outputs.us(outputs.clock.now().wrapping_sub(since)) < 3 * u32::from(PERIOD_US) {
            assert!(Outputs::levels() == 0, "a pulse after the end");
        }
    }
}
