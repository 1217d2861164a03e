//! The bus of the virtual vehicle.

use std::time::Duration;

use can_bus::{Frame, NodeId, RecordKind, Retry, SimDuration, SimTime, Tester};
use twin::{Images, Twin};
use vehicle_model::Vehicle;
use world::Scenario;

use super::transport::{Error, Received, Transport};

/// Seed of the clock errors and of the noise.
const SEED: u64 = 1;

/// Time from power-on to the first question. Nodes with their clocks are in the schedule then.
const STARTED: SimDuration = SimDuration::from_ticks(1_000_000_000_000);

/// Frames arrive at most this much later than they end.
const STEP: SimDuration = SimDuration::from_ticks(250_000_000);

/// Picoseconds of simulated time in a nanosecond.
const PER_NANOSECOND: u64 = 1000;

/// The nodes of a vehicle with their images, and a program on their bus. Simulated time passes
/// only in [`Transport::receive`], so that the outcome is the same each time.
pub struct OnTwin {
    twin: Twin,
    /// The program's place on the bus.
    program: NodeId,
    /// Records of the bus that have been looked at.
    seen: usize,
}

impl OnTwin {
    /// A standing vehicle, one second after power-on.
    ///
    /// # Errors
    /// An image is no program for its node, or did what its microcontroller does not allow.
    pub fn new(vehicle: &Vehicle, images: &Images) -> Result<Self, Error> {
        let scenario = Scenario::uneventful(vehicle, "self-test");
        Self::within(vehicle, &scenario, images)
    }

    /// The vehicle in a scenario, one second after power-on.
    ///
    /// # Errors
    /// As [`OnTwin::new`].
    pub fn within(vehicle: &Vehicle, scenario: &Scenario, images: &Images) -> Result<Self, Error> {
        let mut twin = Twin::new(vehicle, scenario, SEED, images)?;
        let tester = Tester::new().at_bit_rate(vehicle.network().bit_rate);
        let program = twin.network().bus().add_tester(tester);
        twin.run_until(SimTime::from_ticks(0) + STARTED)?;
        Ok(Self {
            seen: twin.records().len(),
            twin,
            program,
        })
    }

    /// The virtual vehicle.
    #[must_use]
    pub fn twin(&self) -> &Twin {
        &self.twin
    }

    /// The next frame of the records that another node has sent.
    fn next(&mut self) -> Option<Received> {
        while let Some(record) = self.twin.records().get(self.seen) {
            self.seen += 1;
            if let RecordKind::FrameEnd { frame, .. } = record.kind
                && record.node != self.program
            {
                return Some(Received {
                    at: duration(record.at),
                    frame,
                });
            }
        }
        None
    }
}

/// A simulated instant as a time of a transport.
fn duration(at: SimTime) -> Duration {
    Duration::from_nanos(at.as_ticks() / PER_NANOSECOND)
}

/// The simulated instant of a time of a transport.
fn instant(at: Duration) -> SimTime {
    let nanoseconds = u64::try_from(at.as_nanos()).unwrap_or(u64::MAX / PER_NANOSECOND);
    SimTime::from_ticks(nanoseconds.saturating_mul(PER_NANOSECOND))
}

impl Transport for OnTwin {
    fn now(&self) -> Duration {
        duration(self.twin.now())
    }

    fn send(&mut self, frame: &Frame) -> Result<(), Error> {
        let now = self.twin.now();
        let mut bus = self.twin.network().bus();
        bus.send_at(self.program, now, *frame, Retry::UntilSent);
        Ok(())
    }

    fn receive(&mut self, until: Duration) -> Result<Option<Received>, Error> {
        let until = instant(until);
        loop {
            if let Some(received) = self.next() {
                return Ok(Some(received));
            }
            let now = self.twin.now();
            if now >= until {
                return Ok(None);
            }
            self.twin.run_until(until.min(now + STEP))?;
        }
    }
}
