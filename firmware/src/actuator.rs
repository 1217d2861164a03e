//! Supervision of an actuator: which command it obeys, and the effort of its motor.
//!
//! A command is obeyed only if its end-to-end protection holds, its values are within the
//! machine's limits and its flags agree with its mode. It expires after two periods. Without
//! a command the motor stands still.

use core::marker::PhantomData;

use control::calibration::Actuator;
use control::feedback::Limits;
use network::Message;
use ttcan::Micros;

use crate::e2e::Secret;
use crate::link::Arrival;
use crate::machine::{Machine, MotionCommand};
use crate::{convert, design, e2e};

/// Why a command frame is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "target", derive(defmt::Format))]
pub enum Refusal {
    /// Not eight bytes, or a signal outside its range.
    Malformed,
    /// The end-to-end protection refuses it.
    Protection(e2e::Refusal),
    /// A value is outside the limits of the vehicle (thesis 5.3).
    Limits,
    /// It enables an actuator in a mode in which all actuators stand still.
    Mode,
}

/// A message that commands actuators: eight bytes, of which the last two are for the protection of
/// [`e2e`].
pub trait Command: Message {
    /// Whether a command that makes no sense, although its end-to-end protection holds, ends the one in
    /// force at once: its sender computes wrongly, so its last command deserves no trust either. Else
    /// that one lasts until it expires.
    const NONSENSE_ENDS: bool = false;

    /// Checks that the values of the command make sense. The caller has already checked its
    /// end-to-end protection and the ranges of its signals.
    ///
    /// # Errors
    /// [`Refusal`] says why not.
    fn check(&self) -> Result<(), Refusal>;
}

/// Checks that a machine may do what a motion command asks: an implementation of
/// [`Command::check`].
///
/// # Errors
/// The command is beyond the machine's limits, or enables an actuator in a mode in which all
/// stand still.
pub fn check_motion<M: Machine, C: MotionCommand>(command: &C) -> Result<(), Refusal> {
    // Half a count beyond the limits is rounding.
    if command.steering_rate().abs() > M::LIMITS.steering_rate + 1e-4
        || command.speed().abs() > M::LIMITS.speed + 5e-3
    {
        return Err(Refusal::Limits);
    }
    if (command.steering_enabled() || command.drive_enabled())
        && (!command.is_driving_mode() || command.emergency_stop())
    {
        return Err(Refusal::Mode);
    }
    Ok(())
}

/// The command in force.
#[derive(Clone, Copy, Debug)]
pub struct CommandHold<C> {
    protection: e2e::Receiver,
    command: Option<C>,
    refused: u16,
    refusal: Option<Refusal>,
}

impl<C: Command> CommandHold<C> {
    /// No command. `secret` is that of the node.
    pub const fn new(secret: Secret) -> Self {
        Self {
            protection: e2e::Receiver::new(secret),
            command: None,
            refused: 0,
            refusal: None,
        }
    }

    /// Judges a frame from the command's window of the basic cycle that began at system time
    /// `time`. The accepted command is in force until the next one or until
    /// [`CommandHold::expire`].
    ///
    /// # Errors
    /// [`Refusal`] says why the frame is not obeyed. Then it changes nothing, unless
    /// [`Command::NONSENSE_ENDS`].
    pub fn receive(&mut self, data: &[u8], time: u32) -> Result<C, Refusal> {
        let judged = self.judge(data, time);
        match judged {
            Ok(command) => self.command = Some(command),
            Err(refusal) => {
                self.refused = self.refused.wrapping_add(1);
                self.refusal = Some(refusal);
                if C::NONSENSE_ENDS && !matches!(refusal, Refusal::Protection(_)) {
                    self.expire();
                }
            }
        }
        judged
    }

    fn judge(&mut self, data: &[u8], time: u32) -> Result<C, Refusal> {
        let bytes: &[u8; 8] = data.try_into().map_err(|_| Refusal::Malformed)?;
        self.protection
            .judge::<C>(time, bytes)
            .map_err(Refusal::Protection)?;
        let command = C::decode(data).map_err(|_| Refusal::Malformed)?;
        command.check()?;
        Ok(command)
    }

    /// Drops the command, because it is too old or the network is gone. The sender must begin a
    /// new sequence.
    pub fn expire(&mut self) {
        self.command = None;
        self.protection.forget();
    }

    /// The command in force.
    pub const fn command(&self) -> Option<&C> {
        self.command.as_ref()
    }

    /// Frames refused so far; wraps.
    pub const fn refused(&self) -> u16 {
        self.refused
    }

    /// Why the last refused frame was refused.
    pub const fn refusal(&self) -> Option<Refusal> {
        self.refusal
    }
}

/// Effort for the steering actuator, -1..=1. `angle` is the steering angle, rad. Without an
/// angle (`None`: the potentiometer's sample is stale or implausible) the effort is zero.
///
/// Towards an end stop the rate is limited so that the actuator does not reach the stop within
/// [`design::END_STOP_HORIZON`]. At or beyond the stop only the way back is open.
pub fn steering_effort<M: Machine>(
    command: Option<&impl MotionCommand>,
    angle: Option<f32>,
) -> f32 {
    let (Some(command), Some(angle)) = (command, angle) else {
        return 0.0;
    };
    if !command.steering_enabled() || command.emergency_stop() {
        return 0.0;
    }
    limited_effort(&M::LIMITS, &M::STEERING, command.steering_rate(), angle)
}

/// Effort for a steering rate, rad/s, at a steering angle, rad, within the limits and away from
/// the end stops; see [`steering_effort`].
#[inline]
pub fn limited_effort(
    limits: &Limits<f32>,
    actuator: &Actuator<f32>,
    rate: f32,
    angle: f32,
) -> f32 {
    let largest = limits.steering_rate;
    // Not `clamp`, which panics if a limit is NaN.
    let rate = rate.max(-largest).min(largest);
    let limit = limits.steering_angle;
    let right = ((limit - angle) / design::END_STOP_HORIZON).max(0.0);
    let left = ((limit + angle) / design::END_STOP_HORIZON).max(0.0);
    effort(actuator, rate.min(right).max(-left))
}

/// Speed to command `dt` seconds after `speed`, on the way to the speed `wanted`, m/s.
/// The acceleration, m/s^2, is limited; see [`Drive::effort`].
#[inline]
pub fn limited_speed(speed: f32, wanted: f32, acceleration: f32, dt: f32) -> f32 {
    let start = if wanted * speed < 0.0 {
        0.0
    } else {
        speed.abs()
    };
    let largest = start + acceleration * dt;
    // Not `clamp`, which panics if a limit is NaN.
    wanted.max(-largest).min(largest)
}

/// Slew-rate limiter of the drive motor's speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drive<M> {
    speed: f32,
    machine: PhantomData<M>,
}

impl<M: Machine> Default for Drive<M> {
    fn default() -> Self {
        Self::new()
    }
}

impl<M: Machine> Drive<M> {
    /// A limiter at standstill.
    pub const fn new() -> Self {
        Self {
            speed: 0.0,
            machine: PhantomData,
        }
    }

    /// Effort for the drive motor, -1..=1, `dt` seconds after the last call. Acceleration is
    /// limited, also away from zero after a change of direction; slowing down is not.
    pub fn effort(&mut self, command: Option<&impl MotionCommand>, dt: f32) -> f32 {
        let limit = M::LIMITS.speed;
        let wanted = match command {
            Some(command) if command.drive_enabled() && !command.emergency_stop() => {
                command.speed().clamp(-limit, limit)
            }
            _ => 0.0,
        };
        self.speed = limited_speed(self.speed, wanted, M::ACCELERATION, dt);
        effort(&M::DRIVE, self.speed)
    }

    /// Notes that the motor was stopped: the limiter starts again from standstill.
    pub fn stop(&mut self) {
        self.speed = 0.0;
    }

    /// Commanded speed behind the limiter, m/s.
    pub const fn speed(&self) -> f32 {
        self.speed
    }
}

/// Time limits of an actuator node, in ticks of its time base.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Times {
    /// Age at which a command expires.
    pub command: u32,
    /// Age above which a sample of the potentiometer is stale.
    pub sample: u32,
    /// Ticks per microsecond.
    pub per_us: u32,
}

impl Times {
    /// The limits on a time base of `ticks_per_us`. `command` is the age at which the network's
    /// command is overdue.
    pub const fn new(command: Micros, ticks_per_us: u32) -> Self {
        Self {
            command: command.ticks().saturating_mul(ticks_per_us),
            sample: design::SAMPLE_TIMEOUT.ticks().saturating_mul(ticks_per_us),
            per_us: ticks_per_us,
        }
    }
}

/// The command of an actuator node and its age.
#[derive(Clone, Copy, Debug)]
pub struct Supervised<C> {
    hold: CommandHold<C>,
    accepted_at: u32,
    times: Times,
}

impl<C: Command> Supervised<C> {
    /// A supervisor without a command. `secret` is that of the node.
    pub const fn new(times: Times, secret: Secret) -> Self {
        Self {
            hold: CommandHold::new(secret),
            accepted_at: 0,
            times,
        }
    }

    /// From now on commands are judged by this secret, that of another session, or none is obeyed.
    pub fn set_secret(&mut self, secret: Option<Secret>) {
        self.hold.protection.set_secret(secret);
    }

    /// Judges a frame from the command's window that arrived before `now`, in the basic cycle
    /// that began at system time `time` (ms).
    ///
    /// # Errors
    /// See [`CommandHold::receive`].
    pub fn receive(&mut self, data: &[u8], time: u32, now: u32) -> Result<C, Refusal> {
        let judged = self.hold.receive(data, time);
        if judged.is_ok() {
            self.accepted_at = now;
        }
        judged
    }

    /// One job of an actuator node's task, which a command or its absence releases: judges the
    /// frame of `arrival`, and drops the command if it has expired. True if a new command is in
    /// force.
    pub fn attend(&mut self, arrival: &Arrival, now: u32) -> bool {
        let Arrival { frame, time, alive } = arrival;
        let accepted = frame
            .as_ref()
            .is_some_and(|frame| self.receive(frame.data(), *time, now).is_ok());
        self.supervise(*alive, now);
        accepted && self.command().is_some()
    }

    /// Drops the command if it is too old or if `alive` is false (the network or its first time
    /// master is gone, or two commands in a row are missing). True if a command was dropped.
    pub fn supervise(&mut self, alive: bool, now: u32) -> bool {
        let held = self.hold.command().is_some();
        let expired = held && now.wrapping_sub(self.accepted_at) >= self.times.command;
        if expired || !alive {
            self.hold.expire();
        }
        held && self.hold.command().is_none()
    }

    /// The command in force.
    pub const fn command(&self) -> Option<&C> {
        self.hold.command()
    }

    /// Frames refused so far; wraps.
    pub const fn refused(&self) -> u16 {
        self.hold.refused()
    }

    /// Why the last refused frame was refused.
    pub const fn refusal(&self) -> Option<Refusal> {
        self.hold.refusal()
    }
}

/// State and control of the steering node.
#[derive(Clone, Copy, Debug)]
pub struct Steering<M, C> {
    /// The command.
    pub supervised: Supervised<C>,
    sample: Option<(u16, u32)>,
    machine: PhantomData<M>,
}

impl<M: Machine, C: MotionCommand> Steering<M, C> {
    /// A steering node that stands still. `secret` is that of the node.
    pub const fn new(times: Times, secret: Secret) -> Self {
        Self {
            supervised: Supervised::new(times, secret),
            sample: None,
            machine: PhantomData,
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
        M::POTENTIOMETER.angle(count).ok()
    }

    /// Whether the last sample is fresh. A stale sample is forgotten: after the counter has
    /// wrapped, its time stamp would look fresh again.
    pub fn has_sample(&mut self, now: u32) -> bool {
        let limit = self.supervised.times.sample;
        self.sample = self.sample.filter(|(_, at)| now.wrapping_sub(*at) <= limit);
        self.sample.is_some()
    }

    /// The last count, plausible or not.
    pub fn count(&self) -> Option<u16> {
        self.sample.map(|(count, _)| count)
    }

    /// The motor driver's byte; `None` when no command lets the motor turn. Its circuit is open
    /// then, so that not even noise on the driver's line moves it.
    pub fn byte(&self, now: u32) -> Option<u8> {
        let command = self.supervised.command()?;
        if !command.steering_enabled() || command.emergency_stop() {
            return None;
        }
        let effort = steering_effort::<M>(Some(command), self.angle(now));
        Some(convert::motor_byte(effort, M::FULL_BYTE_IS_FORWARD))
    }
}

/// State and control of the drive node.
#[derive(Clone, Copy, Debug)]
pub struct Driving<M, C> {
    /// The command.
    pub supervised: Supervised<C>,
    drive: Drive<M>,
    stepped_at: u32,
}

impl<M: Machine, C: MotionCommand> Driving<M, C> {
    /// A drive node that stands still. `secret` is that of the node.
    pub const fn new(times: Times, secret: Secret) -> Self {
        Self {
            supervised: Supervised::new(times, secret),
            drive: Drive::new(),
            stepped_at: 0,
        }
    }

    /// The motor driver's byte; `None` when no command lets the motor turn. Its circuit is open
    /// then, so that not even noise on the driver's line moves it. Advances the slew-rate limiter
    /// by the time since the last call.
    pub fn byte(&mut self, now: u32) -> Option<u8> {
        let ticks = now.wrapping_sub(self.stepped_at);
        self.stepped_at = now;
        let micros = ticks.checked_div(self.supervised.times.per_us).unwrap_or(0);
        // Bounded, so that neither the first call nor a long pause makes the speed jump.
        let dt = (micros.min(design::LONGEST_SLEW_STEP.ticks())) as f32 * 1e-6;
        let command = self.supervised.command();
        let effort = self.drive.effort(command, dt);
        let command =
            command.filter(|command| command.drive_enabled() && !command.emergency_stop());
        command.map(|_| convert::motor_byte(effort, M::FULL_BYTE_IS_FORWARD))
    }

    /// Commanded speed behind the slew-rate limiter, m/s.
    pub const fn speed(&self) -> f32 {
        self.drive.speed
    }
}

/// Effort of an actuator, -1..=1, for a rate in its unit: rad/s of the steering, m/s of the
/// drive. Rates below a thousandth of the full rate give no effort: they are not worth a jump
/// across the dead band.
pub fn effort(actuator: &Actuator<f32>, rate: f32) -> f32 {
    let least = 1e-3 * actuator.positive.full_rate;
    if rate.abs() < least {
        0.0
    } else {
        actuator.effort(rate)
    }
}
