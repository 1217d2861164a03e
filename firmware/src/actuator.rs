//! What an actuator node may do: the command it holds, and what its motor is told.
//!
//! A node that drives an actuator trusts nothing: a command counts only when its end-to-end
//! protection holds, its values are within the vehicle's limits and its flags agree with its
//! mode; it expires after two periods; without one the motor stands still.

use control::calibration::Actuator;
use network::Message;
use network::messages::{Command, Mode};

use crate::link::Arrival;
use crate::{convert, design, e2e};

/// Why a command frame is not acted on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// Not eight bytes, or a signal outside its range.
    Malformed,
    /// The end-to-end protection.
    Protection(e2e::Refusal),
    /// Outside the limits of the vehicle (thesis 5.3).
    Limits,
    /// An actuator is enabled in a mode in which all stand still.
    Mode,
}

/// The command in force.
#[derive(Clone, Copy, Debug, Default)]
pub struct CommandHold {
    protection: e2e::Receiver,
    command: Option<Command>,
    refused: u16,
}

impl CommandHold {
    /// No command.
    pub const fn new() -> Self {
        Self {
            protection: e2e::Receiver::new(),
            command: None,
            refused: 0,
        }
    }

    /// Judges a frame from the command's window of the basic cycle that began at system time
    /// `time`. The accepted command is in force until the next one or until
    /// [`CommandHold::expire`].
    ///
    /// # Errors
    /// [`Refusal`] says why the frame changes nothing.
    pub fn receive(&mut self, data: &[u8], time: u32) -> Result<Command, Refusal> {
        let judged = self.judge(data, time);
        match judged {
            Ok(command) => self.command = Some(command),
            Err(_) => self.refused = self.refused.wrapping_add(1),
        }
        judged
    }

    fn judge(&mut self, data: &[u8], time: u32) -> Result<Command, Refusal> {
        let bytes: &[u8; 8] = data.try_into().map_err(|_| Refusal::Malformed)?;
        self.protection
            .judge(Command::ID, time, bytes)
            .map_err(Refusal::Protection)?;
        let command = Command::decode(data).map_err(|_| Refusal::Malformed)?;
        let rate = convert::steering_rate_of(command.steering_rate);
        let speed = convert::speed_of(command.speed);
        // Half a count beyond the limits is rounding.
        if rate.abs() > design::STEERING_RATE_LIMIT + 1e-4
            || speed.abs() > design::SPEED_LIMIT + 5e-3
        {
            return Err(Refusal::Limits);
        }
        let moving = matches!(command.mode, Mode::Manual | Mode::AutonomousRun);
        if (command.steering_enabled || command.drive_enabled)
            && (!moving || command.emergency_stop)
        {
            return Err(Refusal::Mode);
        }
        Ok(command)
    }

    /// The command is too old, or the network is gone: nothing is in force, and the sender
    /// must begin a sequence anew.
    pub fn expire(&mut self) {
        self.command = None;
        self.protection.forget();
    }

    /// The command in force.
    pub const fn command(&self) -> Option<&Command> {
        self.command.as_ref()
    }

    /// Frames refused so far; wraps.
    pub const fn refused(&self) -> u16 {
        self.refused
    }
}

/// Effort for the steering actuator, -1..=1. `angle` is the steering angle, rad, `None` when
/// the potentiometer cannot be believed: then nothing moves.
///
/// Towards an end stop the rate is limited so that the stop is not reached within
/// [`design::END_STOP_HORIZON`]; at or beyond it only the way back is open.
pub fn steering_effort(command: Option<&Command>, angle: Option<f32>) -> f32 {
    let (Some(command), Some(angle)) = (command, angle) else {
        return 0.0;
    };
    if !command.steering_enabled || command.emergency_stop {
        return 0.0;
    }
    let rate = convert::steering_rate_of(command.steering_rate)
        .clamp(-design::STEERING_RATE_LIMIT, design::STEERING_RATE_LIMIT);
    let limit = design::STEERING_ANGLE_LIMIT;
    let right = ((limit - angle) / design::END_STOP_HORIZON).max(0.0);
    let left = ((limit + angle) / design::END_STOP_HORIZON).max(0.0);
    effort(&design::STEERING_ACTUATOR, rate.min(right).max(-left))
}

/// The drive motor's speed with its slew.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Drive {
    speed: f32,
}

impl Drive {
    /// At standstill.
    pub const fn new() -> Self {
        Self { speed: 0.0 }
    }

    /// Effort for the drive motor, -1..=1, `dt` seconds after the last call. Growing speed is
    /// slewed, also through zero when the direction changes; slowing down is not.
    pub fn effort(&mut self, command: Option<&Command>, dt: f32) -> f32 {
        let wanted = match command {
            Some(command) if command.drive_enabled && !command.emergency_stop => {
                convert::speed_of(command.speed).clamp(-design::SPEED_LIMIT, design::SPEED_LIMIT)
            }
            _ => 0.0,
        };
        let start = if wanted * self.speed < 0.0 {
            0.0
        } else {
            self.speed.abs()
        };
        let largest = start + design::DRIVE_SLEW * dt;
        // Not `clamp`, which panics when its limits are no numbers.
        self.speed = wanted.max(-largest).min(largest);
        effort(&design::DRIVE_MOTOR, self.speed)
    }

    /// The motor was stopped.
    pub fn stop(&mut self) {
        self.speed = 0.0;
    }
}

/// Times of an actuator node, in ticks of its time base.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Times {
    /// Age at which a command expires.
    pub command: u32,
    /// Age at which the potentiometer's sample cannot be believed any more.
    pub sample: u32,
    /// Ticks per microsecond.
    pub per_us: u32,
}

impl Times {
    /// The design's times on a time base of `ticks_per_us`.
    pub const fn new(ticks_per_us: u32) -> Self {
        Self {
            command: design::COMMAND_TIMEOUT.ticks().saturating_mul(ticks_per_us),
            sample: design::SAMPLE_TIMEOUT.ticks().saturating_mul(ticks_per_us),
            per_us: ticks_per_us,
        }
    }
}

/// The command of an actuator node and its age.
#[derive(Clone, Copy, Debug)]
pub struct Supervised {
    hold: CommandHold,
    accepted_at: u32,
    times: Times,
}

impl Supervised {
    /// No command.
    pub const fn new(times: Times) -> Self {
        Self {
            hold: CommandHold::new(),
            accepted_at: 0,
            times,
        }
    }

    /// Judges a frame from the command's window that arrived before `now`, in the basic cycle
    /// that began at system time `time` (ms).
    ///
    /// # Errors
    /// See [`CommandHold::receive`].
    pub fn receive(&mut self, data: &[u8], time: u32, now: u32) -> Result<Command, Refusal> {
        let judged = self.hold.receive(data, time);
        if judged.is_ok() {
            self.accepted_at = now;
        }
        judged
    }

    /// The task of an actuator node that is released by commands and by their absence: takes
    /// what a link brought. True when a new command is in force.
    pub fn attend(&mut self, arrival: &Arrival, now: u32) -> bool {
        let Arrival { frame, time, alive } = arrival;
        let accepted = frame
            .as_ref()
            .is_some_and(|frame| self.receive(frame.data(), *time, now).is_ok());
        self.supervise(*alive, now);
        accepted && self.command().is_some()
    }

    /// Drops the command when it is too old or when `alive` is false: the network is gone, or
    /// the command was missed twice. True when a command was dropped.
    pub fn supervise(&mut self, alive: bool, now: u32) -> bool {
        let held = self.hold.command().is_some();
        let expired = held && now.wrapping_sub(self.accepted_at) >= self.times.command;
        if expired || !alive {
            self.hold.expire();
        }
        held && self.hold.command().is_none()
    }

    /// The command in force.
    pub const fn command(&self) -> Option<&Command> {
        self.hold.command()
    }

    /// Frames refused so far; wraps.
    pub const fn refused(&self) -> u16 {
        self.hold.refused()
    }
}

/// What the steering node does.
#[derive(Clone, Copy, Debug)]
pub struct Steering {
    /// The command.
    pub supervised: Supervised,
    sample: Option<(u16, u32)>,
}

impl Steering {
    /// Standing still.
    pub const fn new(times: Times) -> Self {
        Self {
            supervised: Supervised::new(times),
            sample: None,
        }
    }

    /// Takes a sample of the potentiometer.
    pub fn sample(&mut self, count: u16, now: u32) {
        self.sample = Some((count, now));
    }

    /// The steering angle, rad, from a sample that is fresh and plausible.
    pub fn angle(&self, now: u32) -> Option<f32> {
        let (count, at) = self.sample?;
        if now.wrapping_sub(at) > self.supervised.times.sample {
            return None;
        }
        design::POTENTIOMETER.angle(count).ok()
    }

    /// Whether the last sample is fresh. One that is not is forgotten, before the counter
    /// comes round to its stamp again.
    pub fn has_sample(&mut self, now: u32) -> bool {
        let limit = self.supervised.times.sample;
        self.sample = self.sample.filter(|(_, at)| now.wrapping_sub(*at) <= limit);
        self.sample.is_some()
    }

    /// The last count, plausible or not.
    pub fn count(&self) -> Option<u16> {
        self.sample.map(|(count, _)| count)
    }

    /// The motor driver's byte, `None` when no command is in force.
    pub fn byte(&self, now: u32) -> Option<u8> {
        let command = self.supervised.command()?;
        let effort = steering_effort(Some(command), self.angle(now));
        Some(convert::motor_byte(effort))
    }
}

/// What the drive node does.
#[derive(Clone, Copy, Debug)]
pub struct Driving {
    /// The command.
    pub supervised: Supervised,
    drive: Drive,
    stepped_at: u32,
}

impl Driving {
    /// Standing still.
    pub const fn new(times: Times) -> Self {
        Self {
            supervised: Supervised::new(times),
            drive: Drive::new(),
            stepped_at: 0,
        }
    }

    /// The motor driver's byte, `None` when no command is in force; advances the slew by the
    /// time since the last call.
    pub fn byte(&mut self, now: u32) -> Option<u8> {
        let ticks = now.wrapping_sub(self.stepped_at);
        self.stepped_at = now;
        let micros = ticks.checked_div(self.supervised.times.per_us).unwrap_or(0);
        // The first call has no past, and a long pause earns no jump.
        let dt = (micros.min(design::LONGEST_SLEW_STEP.ticks())) as f32 * 1e-6;
        let command = self.supervised.command();
        let effort = self.drive.effort(command, dt);
        command.map(|_| convert::motor_byte(effort))
    }

    /// Commanded speed after the slew, m/s.
    pub const fn speed(&self) -> f32 {
        self.drive.speed
    }
}

/// Rates below a thousandth of the full one are none: the dead band is not jumped over for
/// them.
fn effort(actuator: &Actuator<f32>, rate: f32) -> f32 {
    let least = 1e-3 * actuator.positive.full_rate;
    if rate.abs() < least {
        0.0
    } else {
        actuator.effort(rate)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use network::messages::{CentidegreesPerSecond, CentimetresPerSecond};
    use proptest::prelude::*;

    fn command(rate: i16, speed: i16) -> Command {
        Command {
            steering_rate: CentidegreesPerSecond(rate),
            speed: CentimetresPerSecond(speed),
            mode: Mode::Manual,
            steering_enabled: true,
            drive_enabled: true,
            emergency_stop: false,
            counter: 0,
            check: 0,
        }
    }

    fn sealed(sender: &mut e2e::Sender, command: &Command) -> [u8; 8] {
        let mut data = command.encode();
        sender.seal(Command::ID, 7, &mut data);
        data
    }

    #[test]
    fn an_old_sample_stays_old_when_the_counter_comes_round() {
        let times = Times::new(18);
        let mut steering = Steering::new(times);
        steering.sample(2048, 0);
        assert!(steering.has_sample(times.sample));
        assert!(!steering.has_sample(times.sample + 1));
        assert!(!steering.has_sample(0));
    }

    #[test]
    fn nothing_moves_before_the_second_good_frame() {
        let mut sender = e2e::Sender::default();
        let mut hold = CommandHold::new();
        assert!(hold.command().is_none());
        assert!(
            hold.receive(&sealed(&mut sender, &command(100, 50)), 7)
                .is_err()
        );
        assert!(hold.command().is_none());
        assert!(
            hold.receive(&sealed(&mut sender, &command(100, 50)), 7)
                .is_ok()
        );
        assert_eq!(hold.command().unwrap().speed, CentimetresPerSecond(50));
        hold.expire();
        assert!(hold.command().is_none());
        assert_eq!(
            hold.receive(&sealed(&mut sender, &command(100, 50)), 7),
            Err(Refusal::Protection(e2e::Refusal::First))
        );
    }

    #[test]
    fn impossible_commands_are_refused() {
        let mut sender = e2e::Sender::default();
        let mut hold = CommandHold::new();
        let _ = hold.receive(&sealed(&mut sender, &command(0, 0)), 7);
        let mut refuse =
            |command: &Command| hold.receive(&sealed(&mut sender, command), 7).unwrap_err();
        assert_eq!(refuse(&command(2501, 0)), Refusal::Limits);
        assert_eq!(refuse(&command(0, -201)), Refusal::Limits);
        let idle = Command {
            mode: Mode::Idle,
            ..command(0, 0)
        };
        assert_eq!(refuse(&idle), Refusal::Mode);
        let stopped = Command {
            emergency_stop: true,
            ..command(0, 0)
        };
        assert_eq!(refuse(&stopped), Refusal::Mode);
        assert_eq!(hold.receive(&[0; 7], 7), Err(Refusal::Malformed));
        assert!(hold.command().is_none());
    }

    proptest! {
        /// Any bytes at all: a command in force always keeps the limits.
        #[test]
        fn whatever_arrives_a_command_in_force_keeps_the_limits(
            frames in proptest::collection::vec(any::<[u8; 8]>(), 1..20), seal: bool,
        ) {
            let mut sender = e2e::Sender::default();
            let mut hold = CommandHold::new();
            for mut frame in frames {
                if seal {
                    sender.seal(Command::ID, 7, &mut frame);
                }
                let _ = hold.receive(&frame, 7);
                if let Some(command) = hold.command() {
                    prop_assert!(command.steering_rate.0.abs() <= 2500);
                    prop_assert!(command.speed.0.abs() <= 200);
                }
            }
        }

        /// No command ever drives the wheels further out at or beyond an end stop.
        #[test]
        fn the_end_stops_hold(rate in -2500i16..=2500, beyond in 0.0f32..0.2, left: bool) {
            let angle = design::STEERING_ANGLE_LIMIT + beyond;
            let angle = if left { -angle } else { angle };
            let effort = steering_effort(Some(&command(rate, 0)), Some(angle));
            prop_assert!(effort * angle <= 0.0);
        }

        /// Integrated at 200 Hz with the actuator's own line, the angle never passes a stop.
        #[test]
        fn the_wheels_stay_within_their_limits(rate in -2500i16..=2500, start in -0.43f32..0.43) {
            let mut angle = start;
            for _ in 0..400 {
                let effort = steering_effort(Some(&command(rate, 0)), Some(angle));
                angle += design::STEERING_ACTUATOR.rate(effort) * 0.005;
                prop_assert!(angle.abs() <= design::STEERING_ANGLE_LIMIT + 1e-4);
            }
        }

        #[test]
        fn the_drive_slews_up_and_never_down(speeds in proptest::collection::vec(-200i16..=200, 1..40)) {
            let mut drive = Drive::new();
            let mut last = 0.0f32;
            for speed in speeds {
                drive.effort(Some(&command(0, speed)), 0.1);
                let now = drive.speed;
                prop_assert!(now.abs() <= last.abs() + design::DRIVE_SLEW * 0.1 + 1e-5);
                let wanted = f32::from(speed) / 100.0;
                prop_assert!(now.abs() <= wanted.abs() + 1e-5 && now * wanted >= 0.0);
                last = now;
            }
            prop_assert_eq!(drive.effort(None, 0.1), 0.0);
        }
    }

    #[test]
    fn without_command_or_angle_the_steering_stands_still() {
        assert_eq!(steering_effort(None, Some(0.0)), 0.0);
        assert_eq!(steering_effort(Some(&command(1000, 0)), None), 0.0);
        let disabled = Command {
            steering_enabled: false,
            ..command(1000, 0)
        };
        assert_eq!(steering_effort(Some(&disabled), Some(0.0)), 0.0);
    }
}
