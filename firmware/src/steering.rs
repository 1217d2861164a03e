//! The laws that can steer a machine along its line. The manifest chooses one.

use core::fmt::Debug;

use control::controller::{Controller, Outcome, Sample, Settings, SettingsError};
use control::line::Line;
use control::mission::Stretch;
use control::plain::PlainController;
use control::route::Route as _;
use control::safety::Command;

use crate::mission::Design;

/// Furrow's law: an estimator, and the law on its estimates.
pub type Furrow = Controller<f32, Line<f32>>;

/// Furrow's law along a mission of any length, whose path is made while the vehicle drives.
pub type Mission = Controller<f32, Stretch<f32>>;

/// The thesis's law (7.3): state feedback from the sensors themselves.
pub type Thesis = PlainController<f32>;

/// A law that steers, with its state.
pub trait Law: Sized + Clone + Debug {
    /// What it needs beside the settings of all laws.
    type Settings;

    /// A law that follows `line` and stops the vehicle at its end.
    ///
    /// # Errors
    /// [`SettingsError`] names the setting that is unusable.
    fn new(
        own: &Self::Settings,
        settings: Settings<f32>,
        line: Line<f32>,
    ) -> Result<Self, SettingsError>;

    /// The part of a step that the command waits for.
    fn update(&mut self, sample: &Sample<f32>) -> Outcome<f32>;

    /// The rest of a step: predicts the motion of the next `dt` seconds under the command that the
    /// actuators got.
    fn predict(&mut self, applied: Command<f32>, dt: f32);

    /// Slews commands from `last` on, which something else has sent to the actuators.
    fn resume(&mut self, last: Command<f32>);

    /// The real steering rate as a share of the commanded one, as far as the law estimates it.
    fn effectiveness(&self) -> f32;

    /// The real speed as a share of the commanded one, as far as the law estimates it.
    fn drive(&self) -> f32 {
        1.0
    }

    /// Whether the law knows the place well enough to go on for a moment without positions.
    fn is_placed(&self) -> bool {
        false
    }

    /// Whether there is a path to be on. While there is none, the vehicle stands.
    fn has_path(&self) -> bool {
        true
    }
}

impl Law for Furrow {
    type Settings = ();

    fn new(
        (): &Self::Settings,
        settings: Settings<f32>,
        line: Line<f32>,
    ) -> Result<Self, SettingsError> {
        Self::following(settings, line)
    }

    fn update(&mut self, sample: &Sample<f32>) -> Outcome<f32> {
        Self::update(self, sample)
    }

    fn predict(&mut self, applied: Command<f32>, dt: f32) {
        Self::predict(self, applied, dt);
    }

    fn resume(&mut self, last: Command<f32>) {
        Self::resume(self, last);
    }

    fn effectiveness(&self) -> f32 {
        Self::effectiveness(self)
    }

    fn drive(&self) -> f32 {
        Self::drive(self)
    }

    fn is_placed(&self) -> bool {
        Self::is_placed(self)
    }
}

impl Law for Mission {
    type Settings = Design;

    fn has_path(&self) -> bool {
        self.route().is_ready(self.progress())
    }

    /// Until its path is made, the vehicle stands.
    fn new(
        own: &Self::Settings,
        settings: Settings<f32>,
        line: Line<f32>,
    ) -> Result<Self, SettingsError> {
        let stretch = Stretch::new(line.origin(), own.settings(&settings).pace);
        Self::following(settings, stretch)
    }

    fn update(&mut self, sample: &Sample<f32>) -> Outcome<f32> {
        Self::update(self, sample)
    }

    fn predict(&mut self, applied: Command<f32>, dt: f32) {
        Self::predict(self, applied, dt);
    }

    fn resume(&mut self, last: Command<f32>) {
        Self::resume(self, last);
    }

    fn effectiveness(&self) -> f32 {
        Self::effectiveness(self)
    }

    fn drive(&self) -> f32 {
        Self::drive(self)
    }

    fn is_placed(&self) -> bool {
        Self::is_placed(self)
    }
}

impl Law for Thesis {
    /// Its gains on cross-track error, heading error and steering angle: 1/(m s), 1/s, 1/s.
    type Settings = [f32; 3];

    fn new(
        gains: &Self::Settings,
        settings: Settings<f32>,
        line: Line<f32>,
    ) -> Result<Self, SettingsError> {
        Self::new(*gains, settings, line)
    }

    fn update(&mut self, sample: &Sample<f32>) -> Outcome<f32> {
        self.step(sample)
    }

    /// It predicts no motion.
    fn predict(&mut self, _: Command<f32>, _: f32) {}

    fn resume(&mut self, last: Command<f32>) {
        Self::resume(self, last);
    }

    /// It estimates none, and takes the actuator for as fast as its calibration says.
    fn effectiveness(&self) -> f32 {
        1.0
    }
}
