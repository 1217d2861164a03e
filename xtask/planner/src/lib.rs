//! Leads a Furrow vehicle from a computer on its CAN bus.
//!
//! A planner decides where to go, and the vehicle's control layer keeps limits, modes and time. The planner sends one
//! message in each basic cycle, in a window of its own, with the curvature and the speed that it asks for
//! ([`Demand`]). The vehicle obeys if the planner's messages come before the operator starts an autonomous run, and
//! stops when they end. The joystick, the emergency stop and all limits count before the planner.
//!
//! [`Planner`] has no I/O: it is shown all frames of the bus and makes the frames to send. So it fits any adapter.
//! The vehicle must be built with `planner.enabled = true` in its `vehicle.toml`.
//!
//! ```no_run
//! use can_bus::Frame;
//! use planner::{Demand, Error, Heard, Pace, Planner, vehicle};
//!
//! /// `received` are the frames of the bus as they come, `send` hands one to the adapter.
//! fn lead(received: impl Iterator<Item = Frame>, mut send: impl FnMut(Frame)) -> Result<(), Error> {
//!     let vehicle = vehicle("firmware/vehicles/uagv")?;
//!     let mut planner = Planner::of(&vehicle, None)?;
//!     let (begin, mut pace) = (std::time::Instant::now(), Pace::default());
//!     for frame in received {
//!         if let Heard::Begin(slot) = planner.heard(&frame, begin.elapsed()) {
//!             let Some(wait) = pace.wait(begin.elapsed(), &slot) else { continue };
//!             std::thread::sleep(wait);
//!             let demand = Demand { curvature: 0.1, speed: 0.5 };
//!             if let Some(command) = planner.command(demand) {
//!                 send(command);
//!             }
//!         }
//!     }
//!     Ok(())
//! }
//! ```

#![forbid(unsafe_code)]

mod layout;
mod pace;

use std::path::Path;
use std::time::Duration;

pub use control::demand::Demand;
use embedded_can::{Frame, Id, StandardId};
pub use firmware::e2e::Key;
use firmware::e2e::{CHECK, COUNTER, Proof, Secret, Session, TimeProof, check_value, tag};
use layout::Layout;
pub use pace::Pace;
use ttcan::Micros;
pub use vehicle_model::Vehicle;
use vehicle_model::{Overrides, VehicleError};

/// Why a vehicle cannot be led.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Its folder makes no sense.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// It has no planner.
    #[error(
        "vehicle {vehicle:?} has no planner that is on: planner.enabled = true in its vehicle.toml is needed"
    )]
    NoPlanner {
        /// The vehicle.
        vehicle: String,
    },
    /// Its network has no system time, by which a message is protected.
    #[error("vehicle {vehicle:?}: its reference messages have no signal SystemTime")]
    NoTime {
        /// The vehicle.
        vehicle: String,
    },
}

/// The vehicle of a folder, with its planner switched on.
///
/// # Errors
/// [`Error::Vehicle`] names what is wrong with the folder.
pub fn vehicle(folder: impl AsRef<Path>) -> Result<Vehicle, Error> {
    let on = Overrides::parse("planner.enabled=true").unwrap_or_default();
    Ok(Vehicle::read_with(folder.as_ref(), &on)?)
}

/// When a command may be handed to the adapter, after the end of the reference message, in time of the bus. [`Pace`] turns it
/// into time of the computer, which a simulation may be slower than.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    /// System time of the reference message, in whole milliseconds.
    pub time: Duration,
    /// Not before.
    pub earliest: Duration,
    /// Not after: the window must still hold the frame.
    pub latest: Duration,
}

/// Who leads a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lead {
    /// The vehicle's own path.
    Path,
    /// The planner; before a run: it would lead one that began now.
    Planner,
    /// Nobody: the planner led the run and its commands ended.
    Nobody,
}

/// What the vehicle says about its planner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// Who leads.
    pub lead: Lead,
    /// Commands that were refused, as their protection did not hold; wraps at 256.
    pub refused: u8,
    /// Age of the last command that was not.
    pub age: Duration,
    /// What the vehicle made of it, within its limits.
    pub demand: Demand<f64>,
}

/// What a frame means to a planner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Heard {
    /// A basic cycle has begun; a command may be sent in it.
    Begin(Slot),
    /// What the vehicle says.
    Report(Report),
    /// Nothing.
    Nothing,
}

/// Nodes whose starts make a session.
const STARTS: usize = 2;

/// The planner's side of the protocol.
#[derive(Clone, Debug)]
pub struct Planner {
    layout: Layout,
    /// By which commands are sealed; the session's, if the vehicle has sessions.
    key: Option<Key>,
    session: Option<Session<STARTS>>,
    /// Proof of the time that references tell, and when the last one of them was heard.
    proof: TimeProof,
    heard: Duration,
    counter: u8,
    /// System time of the basic cycle, ms, until a command is made for it.
    time: Option<u32>,
}

impl Planner {
    /// A planner for this vehicle. With a `key`, its messages carry a tag; the nodes must have the same one.
    ///
    /// # Errors
    /// The vehicle has no planner that is on, or no system time.
    pub fn of(vehicle: &Vehicle, key: Option<Key>) -> Result<Self, Error> {
        let network = vehicle.network();
        let cycle = Micros::micros(network.basic_cycle_us);
        let secret = key.map_or(Secret::None, Secret::Key);
        Ok(Self {
            layout: Layout::of(vehicle)?,
            proof: TimeProof::new(secret, network.reference_free(), cycle),
            heard: Duration::ZERO,
            session: key
                .filter(|_| vehicle.manifest().has_sessions())
                .map(|key| Session::new(Secret::Key(key))),
            key,
            counter: 0,
            time: None,
        })
    }

    /// Looks at a frame of the bus. Show it all of them, in order. `at` is when it was received, by any clock that
    /// goes on evenly.
    ///
    /// With a key, a reference message of a time before one that was proven begins no basic cycle, and a time
    /// that runs more than twice as fast as the clock of `at` is not proven, as in the nodes.
    pub fn heard(&mut self, frame: &impl Frame, at: Duration) -> Heard {
        let Id::Standard(id) = frame.id() else {
            return Heard::Nothing;
        };
        if frame.is_remote_frame() {
            return Heard::Nothing;
        }
        if let Some((place, start)) = self.layout.start(id.as_raw(), frame.data()) {
            if let Some(session) = &mut self.session {
                session.hear(place, start);
            }
            return Heard::Nothing;
        }
        if let Some((time, slot)) = self.layout.begin(id.as_raw(), frame.data()) {
            if !self.follows(id.as_raw(), frame.data(), at) {
                return Heard::Nothing;
            }
            self.time = slot.is_some().then_some(time);
            return slot.map_or(Heard::Nothing, Heard::Begin);
        }
        let report = self.layout.report(id.as_raw(), frame.data());
        report.map_or(Heard::Nothing, Heard::Report)
    }

    /// Whether this reference message, received at `at`, begins a basic cycle. It adds to the proof of the time.
    fn follows(&mut self, id: u16, data: &[u8], at: Duration) -> bool {
        let frame = ttcan::Id::standard(id).and_then(|id| ttcan::Frame::new(id, data).ok());
        let Some(reference) = frame.filter(|frame| !self.proof.is_past(frame)) else {
            return false;
        };
        let since = at.saturating_sub(self.heard).as_millis();
        self.heard = at;
        let since = u32::try_from(since).unwrap_or(u32::MAX);
        self.proof.begin(&reference, since);
        if let Some(open) = self.proof.open() {
            self.proof.close(open.answer());
        }
        true
    }

    /// The command for this basic cycle: one in each. `None` before the first reference message, for a second
    /// command in a cycle, for values that are not finite, and with a key before all nodes of the session have told
    /// their starts, and while the time of the bus is not proven. Otherwise, who forges a reference message of a
    /// later time could play the command at that time.
    pub fn command<F: Frame>(&mut self, demand: Demand<f64>) -> Option<F> {
        if !(demand.curvature.is_finite() && demand.speed.is_finite()) {
            return None;
        }
        let time = self.time.take()?;
        if self.proof.proof() == Proof::Unproven {
            return None;
        }
        let id = self.layout.command_id();
        let key = match &self.session {
            None => self.key,
            Some(session) => match session.secret()? {
                Secret::Key(key) => Some(key),
                Secret::None | Secret::Damaged => None,
            },
        };
        let mut data = self.layout.command(demand);
        match &key {
            None => {
                data[COUNTER] = self.counter;
                data[CHECK] = check_value(id, time, &data);
                self.counter = self.counter.wrapping_add(1);
            }
            Some(key) => {
                let mask = self.layout.mask();
                let word = u64::from_le_bytes(data) & !mask;
                data = (word | tag(key, id, time, word, mask)).to_le_bytes();
            }
        }
        F::new(StandardId::new(id)?, &data)
    }
}
