//! Following the rows of a crop (thesis chapter 2): from the converter's means to distances on the
//! bus, from distances to efforts, from efforts to servo pulses.

use control::row::{
    ConditionalHold, IntegralState, ProportionalIntegral, RowController, RowDistances, RowOutcome,
    RowPose, RowSettings, RowState, ScalarKalman, Sides, differential,
};
use control::scalar::Scalar as _;
use control::takeover::{Presence, RowSighting, RowWatch};
use sled_common::burst::{Mean, Means};
use sled_common::pulse::PulseWidth;

use crate::convert::rounded;

/// Largest distance on the bus, cm. The thesis cuts off at 150 cm; beyond it the stalks
/// of the next row show between those of the near one.
pub const LARGEST_DISTANCE: u8 = 250;

/// Largest distance that the thesis's law gets, cm (thesis 2.2.4.2).
const LARGEST_OF_THESIS: u8 = 150;

/// Efforts on the bus are shares of the full effort in 1/500: 1 us of the servo pulse.
pub const FULL_EFFORT: i16 = 500;

/// Distances that are missing one after the other, of either side, at which the robot stops.
const MISSED: u8 = network::MISSED_PERIODS as u8;

/// A distance in whole centimetres, at most [`LARGEST_DISTANCE`].
///
/// The sensor gives 0 to 10 V for 20 to 1000 cm, and three equal resistors divide that by three (thesis
/// 2.2.4.2). So the converter's full scale of 3.3 V is 970.2 cm above 20 cm.
pub const fn centimetres(mean: Mean) -> u8 {
    const SCALE: u32 = 10 * Mean::FULL_SCALE.sixteenths() as u32;
    let tenths = 9702 * mean.sixteenths() as u32;
    // At most 65 520 * 9702 + 327 600, which 32 bits hold.
    let distance = 20 + (tenths + SCALE / 2) / SCALE;
    if distance > LARGEST_DISTANCE as u32 {
        LARGEST_DISTANCE
    } else {
        distance as u8
    }
}

/// Distances to the rows on both sides, cm. The sensor on the right measures the left row (thesis,
/// Figure 2.3).
pub const fn distances(means: &Means) -> Sides<u8> {
    Sides {
        left: centimetres(means.right),
        right: centimetres(means.left),
    }
}

/// The servo pulse for an effort in 1/500.
pub const fn pulse(effort: i16) -> PulseWidth {
    let us = PulseWidth::NEUTRAL.us() as i32 + effort as i32;
    PulseWidth::clamped(if us < 0 { 0 } else { us as u16 })
}

/// Turns the lines of the remote control into one decision.
///
/// The robot drives while `run` is high, but only if `run` was low since the node started, and since
/// `stop` was high last. So neither a node that starts again nor the end of `stop` sets the
/// robot in motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RunSwitch {
    released: bool,
}

impl RunSwitch {
    /// A switch that has not seen `run` low.
    pub const fn new() -> Self {
        Self { released: false }
    }

    /// Whether the robot may drive, by the lines as they are now.
    pub const fn read(&mut self, run: bool, stop: bool) -> bool {
        if stop {
            self.released = false;
        } else if !run {
            self.released = true;
        }
        run && !stop && self.released
    }
}

/// A law that steers, with its state.
pub trait Law: Sized {
    /// What it is made of.
    type Settings;

    /// A law that has seen nothing. The build has checked its settings.
    fn new(settings: &Self::Settings) -> Self;

    /// The part of a step that the motors wait for, `dt` seconds after the last one, with the distances
    /// that have come since, in centimetres. The robot drives while it is `engaged`.
    fn command(&mut self, distances: &Sides<Option<u8>>, engaged: bool, dt: f32) -> Step;

    /// The rest of a step, due before the next command.
    fn correct(&mut self) {}
}

/// Finds out, on a bus without a schedule, whether a message comes after two of them that are missing.
///
/// The step of the law waits for the second distance there. So it cannot count the periods in which
/// that one is missing, and the robot would drive on as if there had been none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Spacing {
    /// Ticks from one message to the next from which on two are missing between them.
    limit: u32,
    /// Stamp of the last message, and the supervisions of the bus by then.
    last: Option<(u32, u32)>,
}

impl Spacing {
    /// Supervisions, of which there is one in each period, after which two messages are missing in any
    /// case. Stamps do not tell longer times apart, because the time base wraps.
    const SUPERVISIONS: u32 = network::MISSED_PERIODS + 2;

    /// A spacing of messages that come every `period` ticks of the time base. Each may be late by up to a
    /// quarter of it.
    pub const fn of(period: u32) -> Self {
        Self {
            limit: period.saturating_mul(2 * network::MISSED_PERIODS + 1) / 2,
            last: None,
        }
    }

    /// A message has come at `stamp`, when there had been so many supervisions of the bus. True if two
    /// or more are missing between the last one and this.
    pub fn has_gap(&mut self, stamp: u32, supervisions: u32) -> bool {
        let last = self.last.replace((stamp, supervisions));
        last.is_some_and(|(before, counted)| {
            stamp.wrapping_sub(before) >= self.limit
                || supervisions.wrapping_sub(counted) >= Self::SUPERVISIONS
        })
    }
}

/// Numbers of the thesis's law, for distances in centimetres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThesisLaw {
    /// Smallest plausible distance, cm.
    pub least: f32,
    /// Largest plausible distance, cm.
    pub most: f32,
    /// Variance that a distance gains between two samples, as a share of that of a sample.
    pub process: f32,
    /// Effort for a difference, 1/cm.
    pub proportional: f32,
    /// Effort for a difference that lasts, 1/(cm s).
    pub integral: f32,
    /// Limit of the difference, cm.
    pub difference: f32,
    /// Limit of the effort.
    pub effort: f32,
    /// Effort of both sides for the cruise speed.
    pub forward: f32,
    /// Sine of the angle between the beams and straight ahead.
    pub sine: f32,
}

/// What the robot does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// Stands: the operator has not let it drive.
    Idle,
    /// Drives between the rows.
    Following,
    /// Stands at the row's end, until it is engaged anew.
    End,
    /// Stands because it cannot tell where the rows are, or has no distances, until it is engaged
    /// anew.
    Lost,
}

/// Result of a control step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// Efforts of the motors in 1/500.
    pub efforts: Sides<i16>,
    /// What the robot does.
    pub state: State,
    /// Estimated place of the robot's middle right of that of the row, in half centimetres. The
    /// thesis's law does not tell it from the heading, and takes the robot to be parallel.
    pub offset: i8,
    /// Estimated heading to the right of the row, in half degrees; 0 under the thesis's law.
    pub heading: i8,
}

/// The steering of a row follower by a law.
#[derive(Clone, Copy, Debug)]
pub struct Follower<L> {
    law: L,
    /// Steps in a row without a distance of a side.
    missed: Sides<u8>,
    lost: bool,
}

/// Furrow's law.
#[derive(Clone, Copy, Debug)]
pub struct Furrow(RowController<f32>);

/// The thesis's law: conditional hold, scalar Kalman filter, P or PI (thesis 2.2.5.3 and 2.2.6.1).
#[derive(Clone, Copy, Debug)]
pub struct Thesis {
    fresh: Filter,
    filters: Sides<Filter>,
    law: ProportionalIntegral<f32>,
    integral: IntegralState<f32>,
    forward: f32,
    sine: f32,
}

/// Conditional hold and Kalman filter of one side, in centimetres.
#[derive(Clone, Copy, Debug)]
struct Filter {
    hold: ConditionalHold<f32>,
    kalman: ScalarKalman<f32>,
    last: u8,
}

impl<L: Law> Follower<L> {
    /// A follower that stands.
    pub fn new(settings: &L::Settings) -> Self {
        Self {
            law: L::new(settings),
            missed: Sides { left: 0, right: 0 },
            lost: false,
        }
    }

    /// The rest of a step, due before the next command.
    pub fn correct(&mut self) {
        self.law.correct();
    }

    /// The part of a step that the motors wait for, `dt` seconds after the last one, with the distances
    /// that have come since, in centimetres. The robot drives while it is `engaged`.
    ///
    /// One missing distance does no harm. At the second one in a row the robot stops (thesis
    /// 6.2.4.4), and stays so until it is engaged anew.
    pub fn command(&mut self, distances: &Sides<Option<u8>>, engaged: bool, dt: f32) -> Step {
        let count = |missed: &mut u8, distance: Option<u8>| {
            *missed = match distance {
                Some(_) => 0,
                None => missed.saturating_add(1),
            };
            *missed >= MISSED
        };
        let left = count(&mut self.missed.left, distances.left);
        let right = count(&mut self.missed.right, distances.right);
        self.lost = engaged && (self.lost || left || right);
        let drive = engaged && !self.lost;
        let step = self.law.command(distances, drive, dt);
        if self.lost {
            Step {
                state: State::Lost,
                ..step
            }
        } else {
            step
        }
    }
}

impl Law for Furrow {
    type Settings = RowSettings<f32>;

    fn new(settings: &RowSettings<f32>) -> Self {
        Self(RowController::of(*settings))
    }

    fn correct(&mut self) {
        self.0.correct();
    }

    fn command(&mut self, distances: &Sides<Option<u8>>, engaged: bool, dt: f32) -> Step {
        let metres = |distance: Option<u8>| distance.map_or(f32::NAN, |cm| f32::from(cm) * 0.01);
        let distances = RowDistances {
            left: metres(distances.left),
            right: metres(distances.right),
        };
        let RowOutcome {
            efforts,
            state,
            estimate,
            ..
        } = self.0.command(&distances, engaged, dt);
        Step {
            efforts: raw(&efforts),
            state: match state {
                RowState::Idle => State::Idle,
                RowState::Following => State::Following,
                RowState::End => State::End,
                RowState::Lost => State::Lost,
            },
            offset: byte(estimate.pose.offset * 200.0),
            heading: byte(estimate.pose.heading * HALF_DEGREES),
        }
    }
}

/// Half degrees in a radian.
const HALF_DEGREES: f32 = 360.0 / core::f32::consts::PI;

impl Filter {
    fn pass(&mut self, distance: Option<u8>) -> f32 {
        self.last = distance.map_or(self.last, |distance| distance.min(LARGEST_OF_THESIS));
        self.kalman.step(self.hold.pass(f32::from(self.last)))
    }
}

impl Law for Thesis {
    type Settings = ThesisLaw;

    fn new(settings: &ThesisLaw) -> Self {
        let fresh = Filter {
            hold: ConditionalHold::within(settings.least, settings.most),
            kalman: ScalarKalman::of(settings.process, 1.0),
            // Implausible, so that the hold gives its initial value.
            last: 0,
        };
        Self {
            fresh,
            filters: Sides {
                left: fresh,
                right: fresh,
            },
            law: ProportionalIntegral {
                proportional: settings.proportional,
                integral: settings.integral,
                input_limit: settings.difference,
                output_limit: settings.effort,
            },
            integral: IntegralState::new(),
            forward: settings.forward,
            sine: settings.sine,
        }
    }

    fn command(&mut self, distances: &Sides<Option<u8>>, engaged: bool, dt: f32) -> Step {
        if !engaged {
            // The next drive begins anew.
            self.filters = Sides {
                left: self.fresh,
                right: self.fresh,
            };
            self.integral = IntegralState::new();
            return Step {
                efforts: Sides { left: 0, right: 0 },
                state: State::Idle,
                offset: 0,
                heading: 0,
            };
        }
        let left = self.filters.left.pass(distances.left);
        let right = self.filters.right.pass(distances.right);
        // Thesis equation 2.1.
        let error = right - left;
        let turn = self.law.step(&mut self.integral, error, dt);
        Step {
            efforts: raw(&differential(self.forward, turn)),
            state: State::Following,
            // Half the difference on either side, in half centimetres.
            offset: byte(-error * self.sine),
            heading: 0,
        }
    }
}

/// Steps without news of the vehicle's motion after which it counts as standing: three basic cycles of
/// the messages that tell it.
const QUIET: u8 = 60;

/// Speed (m/s) and steering angle (rad, positive to the right) of a vehicle, as far as its messages have
/// come.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Speed.
    pub speed: Option<f32>,
    /// Steering angle.
    pub steering_angle: Option<f32>,
}

/// Finds the place between the rows for a vehicle that another node steers.
#[derive(Clone, Copy, Debug)]
pub struct Watcher {
    watch: RowWatch<f32>,
    wheelbase: f32,
    /// Last speed and steering angle.
    speed: f32,
    steering_angle: f32,
    /// Steps since the last news of the speed.
    quiet: u8,
    sighting: RowSighting<f32>,
    /// Whether there were distances since the last report.
    fresh: bool,
}

impl Watcher {
    /// A watcher that has seen nothing. The build has checked its settings; `wheelbase` is in metres.
    pub fn new(settings: RowSettings<f32>, wheelbase: f32) -> Self {
        Self {
            watch: RowWatch::of(settings),
            wheelbase,
            speed: 0.0,
            steering_angle: 0.0,
            quiet: QUIET,
            sighting: RowSighting {
                presence: Presence::Searching,
                pose: RowPose {
                    offset: 0.0,
                    heading: 0.0,
                    half_width: settings.estimator.rows.half_width,
                },
                deviation: 0.0,
            },
            fresh: false,
        }
    }

    /// Takes the distances of a burst, in centimetres, `dt` seconds after the last one, and what has come
    /// of the vehicle's motion since then.
    pub fn observe(&mut self, distances: &Sides<u8>, motion: Motion, dt: f32) {
        self.quiet = match motion.speed {
            Some(speed) => {
                self.speed = speed;
                0
            }
            None => self.quiet.saturating_add(1),
        };
        if self.quiet >= QUIET {
            self.speed = 0.0;
        }
        self.steering_angle = motion.steering_angle.unwrap_or(self.steering_angle);
        let turn = self.speed * self.steering_angle.tangent() / self.wheelbase;
        let metres = |centimetres: u8| f32::from(centimetres) * 0.01;
        let distances = RowDistances {
            left: metres(distances.left),
            right: metres(distances.right),
        };
        self.sighting = self.watch.observe(&distances, self.speed, turn, dt);
        self.fresh = true;
    }

    /// The rest of a step, due before the next one.
    pub fn correct(&mut self) {
        self.watch.correct();
    }

    /// What is known now.
    pub const fn sighting(&self) -> RowSighting<f32> {
        self.sighting
    }

    /// What is known now, for a message. Without distances since the last one the sensors are faulty.
    pub const fn report(&mut self) -> RowSighting<f32> {
        if !core::mem::replace(&mut self.fresh, false) {
            self.sighting.presence = Presence::Faulty;
        }
        self.sighting
    }
}

/// A number as a signed byte.
fn byte(value: f32) -> i8 {
    rounded(value).clamp(-127, 127) as i8
}

/// Efforts in 1/500.
fn raw(efforts: &Sides<f32>) -> Sides<i16> {
    let raw = |effort: f32| {
        let full = i32::from(FULL_EFFORT);
        rounded(effort * f32::from(FULL_EFFORT)).clamp(-full, full) as i16
    };
    Sides {
        left: raw(efforts.left),
        right: raw(efforts.right),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use control::calibration::{Actuator, Direction};
    use control::row::{Mounting, RowRobot};
    use proptest::prelude::*;
    use sled_common::burst::LENGTH;

    const DT: f32 = 0.005;

    fn robot() -> RowRobot {
        let direction = Direction {
            dead_band: 0.05,
            full_rate: 2.0,
        };
        let motor = Actuator {
            positive: direction,
            negative: direction,
        };
        RowRobot {
            mounting: Mounting {
                ahead: 0.2545,
                beside: 0.152,
                angle: core::f64::consts::FRAC_PI_4,
            },
            least: 0.22,
            open: 1.45,
            track: 0.6,
            lag: 0.1,
            motors: Sides {
                left: motor,
                right: motor,
            },
            cruise: 0.4,
            width: 0.762,
            tolerance: 0.04,
            stalk: 0.025,
            gap: 1.0,
        }
    }

    const THESIS: ThesisLaw = ThesisLaw {
        least: 50.0,
        most: 120.0,
        process: 0.005,
        proportional: 0.0012,
        integral: 0.0,
        difference: 40.0,
        effort: 0.1,
        forward: 0.24,
        sine: core::f32::consts::FRAC_1_SQRT_2,
    };

    /// A law with the settings of the tests.
    trait Tested: Law {
        fn follower() -> Follower<Self>;
    }

    impl Tested for Furrow {
        fn follower() -> Follower<Self> {
            Follower::new(&RowSettings::for_robot(&robot()).unwrap())
        }
    }

    impl Tested for Thesis {
        fn follower() -> Follower<Self> {
            Follower::new(&THESIS)
        }
    }

    const fn both(left: u8, right: u8) -> Sides<Option<u8>> {
        Sides {
            left: Some(left),
            right: Some(right),
        }
    }

    const NONE: Sides<Option<u8>> = Sides {
        left: None,
        right: None,
    };

    fn mean(sixteenths: u32) -> Mean {
        // Half of the samples have the higher count.
        let (count, rest) = (sixteenths / 16, sixteenths % 16);
        let sample = |index: usize| count as u16 + u16::from((index as u32 / 2 * 16) / 50 < rest);
        Means::of(|index| if index < LENGTH { sample(index) } else { 0 }).left
    }

    #[test]
    fn the_range_of_the_sensor_is_cut_at_the_bus_s_largest_distance() {
        assert_eq!(centimetres(mean(0)), 20);
        assert_eq!(centimetres(Mean::FULL_SCALE), 250);
        // 1 m is 80/980 of 10/3 V, of a full scale of 3.3 V: 337.7 counts.
        assert_eq!(centimetres(mean(16 * 338)), 100);
    }

    #[test]
    fn each_sensor_measures_the_row_on_the_other_side() {
        let means = Means {
            left: mean(0),
            right: mean(16 * 338),
        };
        let distances = distances(&means);
        assert_eq!((distances.left, distances.right), (100, 20));
    }

    #[test]
    fn a_switch_that_is_on_at_the_start_does_not_start_the_robot() {
        let mut switch = RunSwitch::new();
        assert!(!switch.read(true, false));
        assert!(!switch.read(false, false));
        assert!(switch.read(true, false));
        assert!(!switch.read(true, true));
        // The end of a stop is no start.
        assert!(!switch.read(true, false));
        assert!(!switch.read(false, false));
        assert!(switch.read(true, false));
    }

    /// A whole step.
    fn step<L: Law>(
        follower: &mut Follower<L>,
        distances: &Sides<Option<u8>>,
        engaged: bool,
    ) -> Step {
        let step = follower.command(distances, engaged, DT);
        follower.correct();
        step
    }

    /// The steps of a drive with the same distances, as between walls.
    fn drive<L: Tested>(left: u8, right: u8) -> [Step; 100] {
        let mut follower = L::follower();
        let first = step(&mut follower, &both(left, right), false);
        assert_eq!((first.efforts.left, first.state), (0, State::Idle));
        let steps = [(); 100].map(|()| step(&mut follower, &both(left, right), true));
        assert!(steps.iter().all(|step| step.state == State::Following));
        steps
    }

    fn turns(step: &Step) -> bool {
        step.efforts.left.abs_diff(step.efforts.right) > 10
    }

    fn steers<L: Tested>() {
        let middle = drive::<L>(75, 75);
        let last = middle[99];
        assert!(!turns(&last), "{last:?}");
        assert!(last.efforts.left > 50, "{last:?}");
        // Left of the middle: the left side drives faster. Only the first turn counts, because the
        // distances do not follow it.
        let left = drive::<L>(65, 85);
        let first = left.iter().find(|step| turns(step)).unwrap();
        assert!(first.efforts.left > first.efforts.right, "{first:?}");
        assert!(first.offset < 0, "{first:?}");
    }

    #[test]
    fn a_robot_in_the_middle_drives_straight_and_one_beside_it_turns_to_it() {
        steers::<Furrow>();
        steers::<Thesis>();
    }

    fn stops<L: Tested>(missing: &Sides<Option<u8>>) {
        let mut follower = L::follower();
        let mut step = |distances, engaged| step(&mut follower, distances, engaged);
        let there = both(75, 75);
        step(&there, false);
        step(&there, true);
        assert_eq!(step(missing, true).state, State::Following);
        let stopped = step(missing, true);
        assert_eq!(stopped.state, State::Lost);
        assert_eq!((stopped.efforts.left, stopped.efforts.right), (0, 0));
        assert_eq!(step(&there, true).state, State::Lost);
        assert_eq!(step(&there, false).state, State::Idle);
        assert_eq!(step(&there, true).state, State::Following);
    }

    #[test]
    fn the_second_missing_distance_stops_the_robot_until_it_is_engaged_anew() {
        let one_side = Sides {
            left: Some(75),
            right: None,
        };
        for missing in [NONE, one_side] {
            stops::<Furrow>(&missing);
            stops::<Thesis>(&missing);
        }
    }

    fn stands<L: Tested>(
        readings: &[(Option<u8>, Option<u8>, bool)],
    ) -> Result<(), proptest::test_runner::TestCaseError> {
        let mut follower = L::follower();
        for &(left, right, engaged) in readings {
            let step = step(&mut follower, &Sides { left, right }, engaged);
            let Sides { left, right } = step.efforts;
            if step.state != State::Following {
                prop_assert_eq!((left, right), (0, 0));
            }
            prop_assert!(engaged || step.state == State::Idle);
            prop_assert!(left.abs() <= FULL_EFFORT && right.abs() <= FULL_EFFORT);
        }
        Ok(())
    }

    proptest! {
        /// Each message is late by up to a quarter of the period of 5 ms, and the supervisions are at any
        /// phase to them. A gap of any length is found, also one after which the stamps are as before.
        #[test]
        fn two_missing_messages_are_found_and_one_is_not(
            begin: u32, counted: u32, phase in 0_u64..90_000, wraps in 0_u64..3,
            missing in proptest::collection::vec((0_u64..5, 0_u64..22_500), 1..30),
        ) {
            const PERIOD: u64 = 90_000;
            let mut spacing = Spacing::of(PERIOD as u32);
            let came = |spacing: &mut Spacing, time: u64| {
                let supervisions = (time + phase) / PERIOD;
                let stamp = begin.wrapping_add(time as u32);
                spacing.has_gap(stamp, counted.wrapping_add(supervisions as u32))
            };
            let mut time = 0;
            prop_assert!(!came(&mut spacing, time));
            for (missing, late) in missing {
                time += (missing + 1) * PERIOD;
                prop_assert_eq!(came(&mut spacing, time + late), missing >= 2);
            }
            // The stamps are less than a period apart.
            time += (1 + wraps) * (1 << 32) + phase;
            prop_assert!(came(&mut spacing, time));
        }

        #[test]
        fn distances_are_those_of_the_formula(sixteenths in 0_u32..=65_520) {
            let mean = mean(sixteenths);
            let volts = f64::from(mean.sixteenths()) / 65_520.0 * 3.3;
            let exact = (20.0 + 980.0 * volts / (10.0 / 3.0)).min(250.0);
            prop_assert!((f64::from(centimetres(mean)) - exact).abs() <= 0.501);
        }

        #[test]
        fn every_effort_makes_a_pulse_of_its_width(effort in i16::MIN..=i16::MAX) {
            let us = i32::from(pulse(effort).us());
            prop_assert_eq!(us, (1500 + i32::from(effort)).clamp(1000, 2000));
        }

        #[test]
        fn without_engagement_no_readings_turn_a_motor(
            readings in proptest::collection::vec((any::<Option<u8>>(), any::<Option<u8>>(), any::<bool>()), 1..200),
        ) {
            stands::<Furrow>(&readings)?;
            stands::<Thesis>(&readings)?;
        }
    }
}
