//! The safety filter: the last stage before the actuators. It passes only safe
//! commands, whatever proposed them.

use crate::feedback::Limits;
use crate::scalar::{Scalar, clamp_symmetric};

/// A command to the actuators.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Command<T> {
    /// Steering rate, rad/s, positive to the right.
    pub steering_rate: T,
    /// Speed, m/s, positive forward.
    pub speed: T,
}

impl<T: Scalar> Command<T> {
    /// The safe command: the steering keeps its angle and the motors stop.
    #[must_use]
    pub fn still() -> Self {
        Self {
            steering_rate: T::zero(),
            speed: T::zero(),
        }
    }
}

/// What the safety filter did to a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The command passed unchanged.
    Passed,
    /// The command was reduced to the limits or the slew rates.
    Limited,
    /// A proposed value was NaN or infinite. The safe command was sent.
    NotFinite,
    /// There was no command, or it was too old. The safe command was sent.
    Stale,
    /// The steering angle is unknown or not finite. The safe command was sent.
    NoSteeringAngle,
    /// The time since the last step was not positive and finite. The safe command
    /// was sent.
    Period,
}

/// The safety filter: limits, slew rates and age of commands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SafetyFilter<T> {
    limits: Limits<T>,
    slew: Slew<T>,
    stale_after: T,
    last: Command<T>,
}

/// Slew rates: how fast a command may change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slew<T> {
    /// Largest change of the steering rate, rad/s per second.
    pub steering: T,
    /// Largest increase of the speed's magnitude, m/s per second. Slowing down is
    /// never delayed.
    pub speed: T,
}

impl<T: Scalar> SafetyFilter<T> {
    /// A filter that enforces `limits` and `slew` and treats commands older than
    /// `stale_after` seconds as missing.
    #[must_use]
    pub fn new(limits: Limits<T>, slew: Slew<T>, stale_after: T) -> Self {
        Self {
            limits,
            slew,
            stale_after,
            last: Command::still(),
        }
    }

    /// The last command that the filter sent.
    #[must_use]
    pub fn last(&self) -> Command<T> {
        self.last
    }

    /// Slews from `last` on, which something else has sent to the actuators.
    pub fn resume(&mut self, last: Command<T>) {
        self.last = last;
    }

    /// Returns the safe command nearest to `proposed`, which is `age` seconds old,
    /// and what was done to it. `steering_angle` is the measured angle (rad),
    /// `dt` the time since the last call (s).
    pub fn step(
        &mut self,
        proposed: Option<Command<T>>,
        age: T,
        steering_angle: Option<T>,
        dt: T,
    ) -> (Command<T>, Verdict) {
        let (command, verdict) = self.judge(proposed, age, steering_angle, dt);
        self.last = command;
        (command, verdict)
    }

    fn judge(
        &self,
        proposed: Option<Command<T>>,
        age: T,
        steering_angle: Option<T>,
        dt: T,
    ) -> (Command<T>, Verdict) {
        let still = Command::still();
        let Some(proposed) = proposed else {
            return (still, Verdict::Stale);
        };
        // Written so that an age of NaN counts as too old.
        if !(age <= self.stale_after) {
            return (still, Verdict::Stale);
        }
        if !(proposed.steering_rate.is_finite() && proposed.speed.is_finite()) {
            return (still, Verdict::NotFinite);
        }
        if !(dt.is_finite() && dt > T::zero()) {
            return (still, Verdict::Period);
        }
        let Some(angle) = steering_angle.filter(|angle| angle.is_finite()) else {
            return (still, Verdict::NoSteeringAngle);
        };
        let slewed = self.last.steering_rate
            + clamp_symmetric(
                proposed.steering_rate - self.last.steering_rate,
                self.slew.steering * dt,
            );
        let command = Command {
            steering_rate: self.limits.steering_rate(slewed, angle, dt),
            speed: self.speed(proposed.speed, dt),
        };
        let verdict = if command == proposed {
            Verdict::Passed
        } else {
            Verdict::Limited
        };
        (command, verdict)
    }

    fn speed(&self, proposed: T, dt: T) -> T {
        let wanted = clamp_symmetric(proposed, self.limits.speed);
        let last = self.last.speed;
        // A change of direction starts from standstill.
        let start = if wanted * last < T::zero() {
            T::zero()
        } else {
            last
        };
        let largest = start.abs() + self.slew.speed * dt;
        clamp_symmetric(wanted, largest)
    }
}
