//! A vehicle on its way, step by step, and what tests ask about it.

use campaign::traffic::{Matrix, Sent, Traffic};
use twin::Twin;
use vehicle_model::NodeIndex;
use world::{Scenario, SimTime};

use crate::nodes::{DRIVE, STEERING};
use crate::time::at;
use crate::{images, vehicle};

/// A scenario from its text.
///
/// # Panics
/// With the sentence that says what is wrong with the text.
#[must_use]
pub fn scenario(text: &str) -> Scenario {
    Scenario::parse(vehicle(), "test", "the test's scenario", text)
        .unwrap_or_else(|error| panic!("{error}"))
}

/// A vehicle with the release images.
pub struct Journey {
    /// The vehicle.
    pub vehicle: Twin,
    matrix: Matrix,
}

impl Journey {
    /// Puts the vehicle of a scenario together.
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

    /// Runs to so many seconds after power-on.
    pub fn to(&mut self, seconds: f64) -> &mut Self {
        self.vehicle.run_until(at(seconds));
        self
    }

    /// The frames so far.
    #[must_use]
    pub fn traffic(&self) -> Traffic {
        Traffic::so_far(&self.vehicle)
    }

    /// The system matrix.
    #[must_use]
    pub fn matrix(&self) -> &Matrix {
        &self.matrix
    }

    /// Data of the last command (message 300) that the controller sent before an instant.
    #[must_use]
    pub fn command(&self, before: SimTime) -> Option<[u8; 8]> {
        let traffic = self.traffic();
        let last = traffic.genuine(300).filter(|frame| frame.end <= before);
        last.last().map(Sent::bytes)
    }

    /// The mode's code in the last command; see the network file.
    #[must_use]
    pub fn mode(&self) -> Option<u8> {
        self.command(self.vehicle.now()).map(|data| data[4])
    }

    /// Effort of a node's motor driver at an instant, -1 to 1.
    #[must_use]
    pub fn effort(&self, node: NodeIndex, when: SimTime) -> f64 {
        let mut changes = self.vehicle.world().efforts().iter();
        changes
            .rfind(|change| change.node == node && change.at <= when)
            .map_or(0.0, |change| change.effort)
    }

    /// The last instant at which a node's motor driver began to make an effort or changed it
    /// to another than none, `None` when it never did.
    #[must_use]
    pub fn last_moved(&self, node: NodeIndex) -> Option<SimTime> {
        let mut changes = self.vehicle.world().efforts().iter();
        changes
            .rfind(|change| change.node == node && change.effort != 0.0)
            .map(|change| change.at)
    }

    /// The first instant from `from` on at which both motor drivers make no effort.
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

    /// What a node wrote on its console.
    #[must_use]
    pub fn console(&self, node: NodeIndex) -> String {
        String::from_utf8_lossy(self.vehicle.console(node)).into_owned()
    }

    /// Asserts that no frame of the vehicle's nodes stood outside of its window.
    ///
    /// # Panics
    /// When one did, with the first of them.
    pub fn assert_in_place(&self) {
        let misplaced = self.matrix.misplaced(&self.traffic());
        if let Some(first) = misplaced.first() {
            panic!("{} frames out of place; {first}", misplaced.len());
        }
    }
}
