//! Commands of a higher layer: the curvature and the speed that a planner asks for.
//!
//! A computer above the control layer (thesis 5.2.5) sends a curvature and a speed in each cycle.
//! [`DemandLaw`] decides whether they guide a run and turns them into commands to the actuators. The rules
//! are those of the joystick: they count in one mode only, they hold for a limited time, and nothing exceeds
//! the limits of the machine.
//!
//! * They can begin to guide a run only before it begins, when [`READY`] of them have come one after the other.
//!   A run that follows its path goes on with that.
//! * If none comes for longer than [`DemandSettings::longest_age`], the run ends. It does not fall back to the path:
//!   the vehicle may be anywhere.

use crate::controller::Settings;
use crate::hold::Hold;
use crate::safety::{Command, SafetyFilter};
use crate::scalar::{Scalar, clamp_symmetric};

/// Demands, one after the other, before they can guide a run.
pub const READY: u8 = 3;

/// What a planner asks for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Demand<T> {
    /// Curvature of the way of the rear axle, 1/m, positive to the right.
    pub curvature: T,
    /// Speed of the rear axle, m/s. A negative one stands for none.
    pub speed: T,
}

/// Settings of the law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DemandSettings<T> {
    /// Longest age of the last demand, s, positive.
    pub longest_age: T,
    /// Largest lateral acceleration, m/s^2, positive: in turns the speed is lower than asked for.
    pub lateral: T,
}

/// The setting that is unusable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DemandError {
    /// The longest age is not a positive number.
    Age,
    /// The lateral acceleration is not a positive number.
    Lateral,
}

impl core::fmt::Display for DemandError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Age => "the longest age of a demand is not a positive number",
            Self::Lateral => "the lateral acceleration is not a positive number",
        })
    }
}

impl core::error::Error for DemandError {}

impl<T: Scalar> DemandSettings<T> {
    /// Checks that every setting is usable.
    ///
    /// # Errors
    /// [`DemandError`] names the setting that is not.
    pub fn check(&self) -> Result<(), DemandError> {
        let positive = |value: T| value.is_finite() && value > T::zero();
        if !positive(self.longest_age) {
            return Err(DemandError::Age);
        }
        if !positive(self.lateral) {
            return Err(DemandError::Lateral);
        }
        Ok(())
    }
}

/// Who leads a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Lead {
    /// The path.
    #[default]
    Path,
    /// The demands. Before a run: they would lead one that began now.
    Demands,
    /// Nobody: the demands led it and have ended, so the run must end.
    Nobody,
}

/// The law and its state.
#[derive(Clone, Copy, Debug)]
pub struct DemandLaw<T> {
    settings: DemandSettings<T>,
    controller: Settings<T>,
    demand: Demand<T>,
    /// Age of the demand, s.
    age: T,
    /// Demands one after the other, up to [`READY`].
    count: u8,
    lead: Lead,
    hold: Hold,
    safety: SafetyFilter<T>,
}

impl<T: Scalar> DemandLaw<T> {
    /// A law that has heard nothing, for a vehicle with these settings of its controller.
    ///
    /// # Errors
    /// [`DemandError`] names the setting that is unusable.
    pub fn new(settings: DemandSettings<T>, controller: Settings<T>) -> Result<Self, DemandError> {
        settings.check()?;
        Ok(Self {
            demand: Demand {
                curvature: T::zero(),
                speed: T::zero(),
            },
            age: settings.longest_age + T::one(),
            count: 0,
            lead: Lead::Path,
            hold: Hold::new(),
            safety: SafetyFilter::new(controller.limits, controller.slew, settings.longest_age),
            settings,
            controller,
        })
    }

    /// Who leads.
    #[must_use]
    pub fn lead(&self) -> Lead {
        self.lead
    }

    /// The last demand within the limits, and its age, s.
    #[must_use]
    pub fn demand(&self) -> (Demand<T>, T) {
        (self.demand, self.age)
    }

    /// Decides who leads from now on. `running` says whether the vehicle is in an autonomous run, `demand` is what has
    /// come since the last step, `dt` the time since then (s). Call it once in each step and in every mode.
    pub fn step(&mut self, running: bool, demand: Option<Demand<T>>, dt: T) -> Lead {
        self.age += dt;
        if let Some(demand) = demand.filter(is_number) {
            self.demand = self.limited(demand);
            self.age = T::zero();
            self.count = self.count.saturating_add(1).min(READY);
        }
        // Written so that an age of NaN is too old.
        let fresh = self.age <= self.settings.longest_age;
        if !fresh {
            self.count = 0;
        }
        self.lead = match self.lead {
            Lead::Demands if running && !fresh => Lead::Nobody,
            Lead::Demands | Lead::Nobody | Lead::Path if running => self.lead,
            _ if self.count >= READY => Lead::Demands,
            _ => Lead::Path,
        };
        if !running {
            self.hold = Hold::new();
        }
        self.lead
    }

    /// The command while the demands lead. `applied` has been applied to the actuators since the last step,
    /// `steering_angle` is the estimated angle and `measured` that of the potentiometer (rad), `speed` the estimated one
    /// (m/s), and `effectiveness` the real steering rate as a share of the commanded one.
    pub fn drive(
        &mut self,
        applied: Command<T>,
        steering_angle: T,
        measured: Option<T>,
        speed: T,
        effectiveness: T,
        dt: T,
    ) -> Command<T> {
        self.safety.resume(applied);
        let wheelbase = self.controller.guidance.wheelbase;
        let angle = (self.demand.curvature * wheelbase).angle_of(T::one());
        let target = clamp_symmetric(angle, self.controller.limits.steering_angle);
        let [_, _, _, follow] = self.controller.firm.at(speed.max(T::zero()));
        let error = target - steering_angle;
        let rate = self.hold.rate(&self.controller.hold, error, follow, dt);
        let proposed = Command {
            steering_rate: rate / effectiveness,
            speed: self.demand.speed,
        };
        let (command, _) = self.safety.step(Some(proposed), self.age, measured, dt);
        command
    }

    /// A demand that the vehicle can follow.
    fn limited(&self, demand: Demand<T>) -> Demand<T> {
        let controller = &self.controller;
        let most = controller.limits.steering_angle.tangent() / controller.guidance.wheelbase;
        let curvature = clamp_symmetric(demand.curvature, most);
        let speed = demand.speed.max(T::zero()).min(controller.limits.speed);
        let lateral = speed * speed * curvature.abs();
        let speed = if lateral > self.settings.lateral {
            (self.settings.lateral / curvature.abs()).root()
        } else {
            speed
        };
        Demand { curvature, speed }
    }
}

fn is_number<T: Scalar>(demand: &Demand<T>) -> bool {
    demand.curvature.is_finite() && demand.speed.is_finite()
}
