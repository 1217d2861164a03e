//! A running simulation of the vehicle, and the questions that tests ask about it.

use campaign::traffic::{Matrix, Sent, Traffic};
use twin::Twin;
use vehicle_model::NodeIndex;
use world::{Scenario, SimTime};

use crate::nodes::{DRIVE, STEERING};
use crate::time::at;
use crate::{images, vehicle};

/// Parses a scenario.
///
/// # Panics
/// When the text has an error; the message names it.
#[must_use]
pub fn scenario(text: &str) -> Scenario {
    Scenario::parse(vehicle(), "test", "the test's scenario", text)
        .unwrap_or_else(|error| panic!("{error}"))
}

/// A simulated vehicle with the release images.
pub struct Journey {
    /// The vehicle.
    pub vehicle: Twin,
    matrix: Matrix,
}

impl Journey {
    /// Sets up the vehicle of a scenario.
    ///
    /// # Panics
    /// When the images cannot be built.
    #[must_use]
    pub fn new(scenario: &Scenario, seed: u64) -> Self {
        let twin = Twin::new(vehicle(), scenario, seed, images());
        Self {
            vehicle: twin.unwrap_or_else(|error| panic!("{error}")),
            matrix: Matrix::new(vehicle()),
        }
    }

    /// [`Journey::new`] with the text of a scenario and seed 1.
    #[must_use]
    pub fn of(text: &str) -> Self {
        Self::new(&scenario(text), 1)
    }

    /// Runs until `seconds` after power-on.
    ///
    /// # Panics
    /// As [`Journey::run_until`].
    pub fn to(&mut self, seconds: f64) -> &mut Self {
        self.run_until(at(seconds))
    }

    /// Runs until an instant.
    ///
    /// # Panics
    /// When a program did what its microcontroller does not allow.
    pub fn run_until(&mut self, end: SimTime) -> &mut Self {
        let run = self.vehicle.run_until(end);
        run.unwrap_or_else(|error| panic!("{error}"));
        self
    }

    /// The bus traffic so far.
    #[must_use]
    pub fn traffic(&self) -> Traffic {
        Traffic::so_far(&self.vehicle)
    }

    /// The system matrix.
    #[must_use]
    pub fn matrix(&self) -> &Matrix {
        &self.matrix
    }

    /// Data of the last command (message 300) that the controller had sent by `before`.
    #[must_use]
    pub fn command(&self, before: SimTime) -> Option<[u8; 8]> {
        let traffic = self.traffic();
        let last = traffic.genuine(300).filter(|frame| frame.end <= before);
        last.last().map(Sent::bytes)
    }

    /// The mode's code in the last command; see the network file.
    #[must_use]
    pub fn mode(&self) -> Option<u8> {
        let data = self.command(self.vehicle.now())?;
        Some(data[4] & 7)
    }

    /// Effort of a node's motor driver at an instant, -1 to 1.
    #[must_use]
    pub fn effort(&self, node: NodeIndex, when: SimTime) -> f64 {
        let mut changes = self.vehicle.world().efforts().iter();
        changes
            .rfind(|change| change.node == node && change.at <= when)
            .map_or(0.0, |change| change.effort)
    }

    /// The last time at which the effort of a node's motor driver changed to a value other than
    /// zero; `None` if it never did.
    #[must_use]
    pub fn last_moved(&self, node: NodeIndex) -> Option<SimTime> {
        let mut changes = self.vehicle.world().efforts().iter();
        changes
            .rfind(|change| change.node == node && change.effort != 0.0)
            .map(|change| change.at)
    }

    /// The first time, `from` or later, at which the effort of both motor drivers is zero.
    #[must_use]
    pub fn stopped(&self, from: SimTime) -> Option<SimTime> {
        let still = |when| {
            [STEERING, DRIVE]
                .iter()
                .all(|&node| self.effort(node, when) == 0.0)
        };
        let later = self
            .vehicle
            .world()
            .efforts()
            .iter()
            .map(|change| change.at);
        std::iter::once(from)
            .chain(later.filter(|&when| when > from))
            .find(|&when| still(when))
    }

    /// The text that a node wrote to its console.
    #[must_use]
    pub fn console(&self, node: NodeIndex) -> String {
        String::from_utf8_lossy(self.vehicle.console(node)).into_owned()
    }

    /// Asserts that all frames of the vehicle's nodes were sent in their windows.
    ///
    /// # Panics
    /// When one was not; the message shows the first such frame.
    pub fn assert_in_place(&self) {
        let misplaced = self.matrix.misplaced(&self.traffic());
        if let Some(first) = misplaced.first() {
            panic!("{} frames out of place; {first}", misplaced.len());
        }
    }
}
