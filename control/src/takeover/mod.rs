//! Guidance by the rows of a crop while there is no satellite fix, as the thesis
//! wants it as a supplement to satellite navigation (thesis 2.1 and 2.4).
//!
//! [`RowWatch`] finds the vehicle's place between the rows by two distance sensors.
//! [`Takeover`] decides what guides an autonomous run, and steers while that is not
//! the satellites alone.
//!
//! The middle of the row is not exactly the line that the satellites guide along.
//! Neither change of the guide moves the steering at once: the difference of both
//! is handed over, and taken back at a bounded rate.

mod limits;
mod watch;

pub use limits::{TakeoverError, TakeoverSettings};
pub use watch::{Presence, RowSighting, RowWatch};

use crate::controller::{Settings, Tracking};
use crate::guidance::{Deviation, Guidance, GuidanceError};
use crate::hold::Hold;
use crate::safety::{Command, SafetyFilter, Verdict};
use crate::scalar::{Scalar, clamp_symmetric, wrap_angle};

/// Sound sightings, one after the other, before the rows can take over.
const READY: u8 = 5;
/// Largest change of the offset (m) and of the heading (rad) from one sighting to
/// the next beyond what the vehicle's motion explains.
const LARGEST_JUMP: (f64, f64) = (0.12, 0.12);
/// Largest offset as a share of half the width between the rows.
const LARGEST_OFFSET: f64 = 0.8;
/// Largest heading against the rows, and largest angle between the rows and the
/// line, rad.
const LARGEST_HEADING: f64 = 0.35;
const LARGEST_ANGLE: f64 = 0.15;
/// Largest standard deviation of a sound sighting, m.
const LARGEST_DEVIATION: f64 = 0.15;
/// How far half the width may differ from the expected one, in its standard
/// deviations.
const WIDTH_DEVIATIONS: f64 = 4.0;
/// Rate at which a difference of the headings is taken back, rad/s.
const TURN_BACK: f64 = 0.02;
/// Shortest time from the return of the satellites' guidance to the end of the
/// handover, s: the speed is that of the run again by then.
const SHORTEST_RETURN: f64 = 2.0;

/// What guides an autonomous run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Guide {
    /// The satellites alone. The run ends without a fix.
    #[default]
    Satellites,
    /// The rows, at reduced speed.
    Rows,
    /// The satellites again, while what they differ from the rows by is taken back.
    Returning,
    /// Nothing: the run must end.
    Nothing,
}

/// Place of the vehicle relative to what it follows: rear axle and heading.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Place<T> {
    /// The rear axle's distance to the right, m.
    pub right: T,
    /// Heading to the right, rad.
    pub heading: T,
}

impl<T: Scalar> Place<T> {
    fn zero() -> Self {
        Self {
            right: T::zero(),
            heading: T::zero(),
        }
    }

    fn plus(self, other: Self) -> Self {
        Self {
            right: self.right + other.right,
            heading: self.heading + other.heading,
        }
    }

    fn minus(self, other: Self) -> Self {
        Self {
            right: self.right - other.right,
            heading: wrap_angle(self.heading - other.heading),
        }
    }
}

/// What a step of the takeover depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Situation<T> {
    /// Whether the vehicle is in an autonomous run.
    pub running: bool,
    /// Whether the receiver has an RTK-fixed solution and its position is recent.
    pub fixed: bool,
    /// Where the controller sees the vehicle; by dead reckoning without a fix.
    pub tracking: Tracking<T>,
    /// The rows, if a message has come whose protection holds. One that is repeated,
    /// altered or out of order is none.
    pub sighting: Option<RowSighting<T>>,
    /// Time since the last step, s.
    pub dt: T,
}

/// The takeover and its state.
#[derive(Clone, Copy, Debug)]
pub struct Takeover<T> {
    settings: TakeoverSettings<T>,
    controller: Settings<T>,
    guide: Guide,
    /// Place between the rows by the last sound sighting, moved on since then.
    row: Place<T>,
    /// Its age, s.
    age: T,
    /// Sound sightings one after the other, up to [`READY`].
    sound: u8,
    /// Way without a fix, m.
    way: T,
    /// How long there has been a fix again, s.
    fixed: T,
    /// What is added to the place by the present guide, so that the steering does not
    /// jump.
    handover: Place<T>,
    /// The place that the law steers by.
    place: Place<T>,
    guidance: Guidance<T>,
    hold: Hold,
    safety: SafetyFilter<T>,
}

impl<T: Scalar> Takeover<T> {
    /// A takeover that the satellites guide before, for a vehicle with these settings
    /// of its controller.
    ///
    /// # Errors
    /// [`TakeoverError`] names the setting that is unusable.
    pub fn new(
        settings: TakeoverSettings<T>,
        controller: Settings<T>,
    ) -> Result<Self, TakeoverError> {
        settings.check()?;
        let guidance = Guidance::new(controller.guidance);
        let safety = SafetyFilter::new(controller.limits, controller.slew, settings.longest_age);
        Ok(Self {
            settings,
            guide: Guide::Satellites,
            row: Place::zero(),
            age: settings.longest_age + T::one(),
            sound: 0,
            way: T::zero(),
            fixed: T::zero(),
            handover: Place::zero(),
            place: Place::zero(),
            guidance: guidance.map_err(|_: GuidanceError| TakeoverError::Controller)?,
            hold: Hold::new(),
            safety,
            controller,
        })
    }

    /// What guides the run.
    #[must_use]
    pub fn guide(&self) -> Guide {
        self.guide
    }

    /// Way without a fix, m; 0 while the satellites guide.
    #[must_use]
    pub fn way(&self) -> T {
        self.way
    }

    /// The place that the law steers by, and the part of it that is still to be taken
    /// back.
    #[must_use]
    pub fn place(&self) -> (Place<T>, Place<T>) {
        (self.place, self.handover)
    }

    /// Whether the rows could guide now.
    #[must_use]
    pub fn is_ready(&self) -> bool {
        self.sound >= READY && self.age <= self.settings.longest_age
    }

    /// Decides what guides the run from now on. Call it once in each step and in every
    /// mode.
    pub fn step(&mut self, now: &Situation<T>) -> Guide {
        let satellites = self.by_satellites(&now.tracking);
        self.age += now.dt;
        self.row = self.moved(self.row, now);
        self.see(now);
        self.fixed = if now.fixed {
            self.fixed + now.dt
        } else {
            T::zero()
        };
        let next = self.next(now, &satellites);
        if next != self.guide {
            self.change(next, &satellites, now);
        } else if matches!(next, Guide::Rows | Guide::Returning) {
            self.take_back(now.dt);
        }
        let by = match self.guide {
            Guide::Rows => self.row,
            Guide::Satellites | Guide::Returning | Guide::Nothing => satellites,
        };
        self.place = by.plus(self.handover);
        self.way = match self.guide {
            Guide::Rows if now.fixed => self.way,
            Guide::Rows => self.way + now.tracking.speed.abs() * now.dt,
            Guide::Satellites | Guide::Returning | Guide::Nothing => T::zero(),
        };
        self.guide
    }

    /// The command of the guide [`Guide::Rows`] or [`Guide::Returning`]. `applied` has
    /// been applied to the actuators since the last step, `measured` is the steering
    /// angle by the potentiometer (rad), and `effectiveness` the real steering rate as a
    /// share of the commanded one. Standstill under another guide.
    pub fn drive(
        &mut self,
        tracking: &Tracking<T>,
        applied: Command<T>,
        measured: Option<T>,
        effectiveness: T,
        dt: T,
    ) -> (Command<T>, Verdict) {
        self.safety.resume(applied);
        let (speed, age) = match self.guide {
            Guide::Rows => (self.settings.speed, self.age),
            Guide::Returning => (self.controller.cruise, T::zero()),
            Guide::Satellites | Guide::Nothing => {
                return self.safety.step(None, T::zero(), measured, dt);
            }
        };
        let forward = if tracking.speed > T::zero() {
            tracking.speed
        } else {
            T::zero()
        };
        let deviation = Deviation {
            cross_track: self.place.right,
            heading: self.place.heading,
            steering_angle: tracking.steering_angle,
            speed: forward,
            curvature: T::zero(),
            curvature_ahead: T::zero(),
            effectiveness,
        };
        let firm = self.controller.firm.at(forward);
        let gentle = self.controller.gentle.at(forward);
        let target = self.guidance.target(&deviation, &firm, &gentle, dt);
        let error = target.angle - tracking.steering_angle;
        let rate = self
            .hold
            .rate(&self.controller.hold, error, target.follow, dt);
        let proposed = Command {
            steering_rate: rate / effectiveness,
            speed,
        };
        self.safety.step(Some(proposed), age, measured, dt)
    }

    /// Place by the satellites' line.
    fn by_satellites(&self, tracking: &Tracking<T>) -> Place<T> {
        let (sine, _) = tracking.heading_error.sine_cosine();
        Place {
            right: tracking.cross_track - self.controller.controlled_point * sine,
            heading: tracking.heading_error,
        }
    }

    /// A place after the motion of a step.
    fn moved(&self, place: Place<T>, now: &Situation<T>) -> Place<T> {
        let way = now.tracking.speed * now.dt;
        let turn = way * now.tracking.steering_angle.tangent() / self.controller.guidance.wheelbase;
        let (sine, _) = (place.heading + turn * T::lit(0.5)).sine_cosine();
        Place {
            right: place.right + way * sine,
            heading: wrap_angle(place.heading + turn),
        }
    }

    /// Takes a sighting if it is sound. While the rows guide, one that is not is as none;
    /// else it begins anew what the rows must show before they take over. The row's end
    /// counts at once.
    fn see(&mut self, now: &Situation<T>) {
        if !(self.age <= self.settings.longest_age) {
            self.sound = 0;
        }
        let Some(sighting) = now.sighting else {
            return;
        };
        if !self.is_plausible(&sighting) {
            if self.guide != Guide::Rows || sighting.presence != Presence::Following {
                self.sound = 0;
            }
            return;
        }
        let seen = Place {
            right: sighting.pose.offset,
            heading: sighting.pose.heading,
        };
        let jump = seen.minus(self.row);
        let (offset, heading) = LARGEST_JUMP;
        let continues = jump.right.abs() <= T::lit(offset) && jump.heading.abs() <= T::lit(heading);
        if self.sound == 0 || continues {
            self.sound = self.sound.saturating_add(1).min(READY);
        } else if self.guide == Guide::Rows {
            return;
        } else {
            self.sound = 1;
        }
        self.row = seen;
        self.age = T::zero();
    }

    fn is_plausible(&self, sighting: &RowSighting<T>) -> bool {
        let settings = &self.settings;
        let pose = &sighting.pose;
        let width = (pose.half_width - settings.half_width).abs();
        sighting.presence == Presence::Following
            && pose.offset.abs() <= settings.half_width * T::lit(LARGEST_OFFSET)
            && pose.heading.abs() <= T::lit(LARGEST_HEADING)
            && width <= settings.tolerance * T::lit(WIDTH_DEVIATIONS)
            && sighting.deviation >= T::zero()
            && sighting.deviation <= T::lit(LARGEST_DEVIATION)
    }

    fn next(&self, now: &Situation<T>, satellites: &Place<T>) -> Guide {
        if !now.running {
            return Guide::Satellites;
        }
        let rows = self.is_ready() && {
            let angle = satellites.minus(self.row).heading;
            self.guide == Guide::Rows || angle.abs() <= T::lit(LARGEST_ANGLE)
        };
        let rows = if rows { Guide::Rows } else { Guide::Nothing };
        match self.guide {
            Guide::Nothing => Guide::Nothing,
            Guide::Satellites | Guide::Returning if !now.fixed => rows,
            Guide::Satellites => Guide::Satellites,
            Guide::Returning => {
                let rest = self.handover;
                let back = rest.right == T::zero() && rest.heading == T::zero();
                if back && self.fixed >= self.settings.settle + T::lit(SHORTEST_RETURN) {
                    Guide::Satellites
                } else {
                    Guide::Returning
                }
            }
            Guide::Rows if now.fixed && self.fixed >= self.settings.settle => Guide::Returning,
            // The row's end is where the fix may well have come back just now.
            Guide::Rows if now.fixed && rows == Guide::Nothing => Guide::Returning,
            Guide::Rows if !now.fixed && !(self.way <= self.settings.longest_way) => Guide::Nothing,
            Guide::Rows => rows,
        }
    }

    fn change(&mut self, next: Guide, satellites: &Place<T>, now: &Situation<T>) {
        let before = self.guide;
        self.guide = next;
        let last = match before {
            // The controller steers by the satellites' place itself.
            Guide::Satellites | Guide::Nothing => *satellites,
            // The last place was that of the last step.
            Guide::Rows | Guide::Returning => self.moved(self.place, now),
        };
        self.handover = match next {
            Guide::Rows => last.minus(self.row),
            Guide::Returning => last.minus(*satellites),
            Guide::Satellites | Guide::Nothing => Place::zero(),
        };
        if matches!(before, Guide::Satellites | Guide::Nothing) {
            self.guidance.reset();
            self.hold = Hold::new();
        }
    }

    /// Takes back a part of the handover.
    fn take_back(&mut self, dt: T) {
        let less = |rest: T, most: T| rest - clamp_symmetric(rest, most);
        let Place { right, heading } = self.handover;
        self.handover = Place {
            right: less(right, self.settings.take_back * dt),
            heading: less(heading, T::lit(TURN_BACK) * dt),
        };
    }
}
