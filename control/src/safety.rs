//! The last word before the actuators: whatever proposes a command, only a
//! safe one leaves.

use crate::feedback::Limits;
use crate::scalar::{Scalar, clamp_symmetric};

/// What the actuators are told.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Command<T> {
    /// Steering rate, rad/s, positive to the right.
    pub steering_rate: T,
    /// Speed, m/s, positive forward.
    pub speed: T,
}

impl<T: Scalar> Command<T> {
    /// The safe command: wheels hold their angle, motors stop.
    #[must_use]
    pub fn still() -> Self {
        Self {
            steering_rate: T::zero(),
            speed: T::zero(),
        }
    }
}

/// What the filter did to a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The command passed as it was.
    Passed,
    /// The command was brought within limits or slew.
    Limited,
    /// A proposed value was NaN or infinite: the safe command went out.
    NotFinite,
    /// No command, or one too old: the safe command went out.
    Stale,
    /// The steering angle is unknown or not finite: the safe command went out.
    NoSteeringAngle,
    /// The period since the last step was not positive and finite: the safe
    /// command went out.
    Period,
}

/// Limits, slew and freshness of commands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SafetyFilter<T> {
    limits: Limits<T>,
    slew: Slew<T>,
    stale_after: T,
    last: Command<T>,
}

/// How fast a command may change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slew<T> {
    /// Largest change of the steering rate, rad/s each second.
    pub steering: T,
    /// Largest growth of the speed's magnitude, m/s each second. Slowing down
    /// is never delayed.
    pub speed: T,
}

impl<T: Scalar> SafetyFilter<T> {
    /// A filter that lets nothing but `limits` and `slew` through and treats
    /// commands older than `stale_after` seconds as missing.
    #[must_use]
    pub fn new(limits: Limits<T>, slew: Slew<T>, stale_after: T) -> Self {
        Self {
            limits,
            slew,
            stale_after,
            last: Command::still(),
        }
    }

    /// What left the filter last.
    #[must_use]
    pub fn last(&self) -> Command<T> {
        self.last
    }

    /// Passes `proposed`, which is `age` seconds old, on to the actuators as
    /// far as it is safe. `steering_angle` is the measured angle (rad), `dt`
    /// the time since the last call (s).
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
        // Written so that a NaN age counts as too old.
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
        // Through standstill first when the direction changes.
        let start = if wanted * last < T::zero() {
            T::zero()
        } else {
            last
        };
        let largest = start.abs() + self.slew.speed * dt;
        clamp_symmetric(wanted, largest)
    }
}
