//! The rows of a crop beside a machine's line: what its distance sensors measure, and what its body
//! touches.

use crate::distance::{Beam, DistanceSensor};
use crate::rover::{self, Mount, Side};
use crate::row_drive::{FaultChange, Touch};
use crate::rows::{Footprint, Rows};
use crate::scenario::{CropSetting, DistanceFault};
use crate::time::{SimTime, Span as _, at};
use crate::vehicle::{State, Vehicle};
use crate::world::RECORD_PERIOD;
use std::collections::VecDeque;

/// Records from one pair of beams to the next.
const BEAM_RECORDS: u64 = 10;

/// How far the body reaches beyond either axle, metres (inferred).
const OVERHANG: f64 = 0.2;

/// The machine between the rows at one instant.
#[derive(Copy, Clone, Debug, PartialEq)]
pub struct CropSample {
    /// When.
    pub at: SimTime,
    /// Station of the rear axle along the row, metres; the row begins at 0.
    pub station: f64,
    /// Distance of the rear axle from the middle of the row, metres, right positive.
    pub right: f64,
    /// Heading against that of the row, radians, right positive.
    pub heading: f64,
    /// Place, heading and rolling speed in the frame of the rows.
    pub state: rover::State,
}

/// Rows, sensors and recordings.
#[derive(Clone, Debug)]
pub struct Crop {
    rows: Rows,
    /// Where the row begins: northing, easting, and its direction there, clockwise from north.
    origin: (f64, f64, f64),
    /// The sensors that are mounted on the left and on the right.
    sensors: [DistanceSensor; 2],
    faults: VecDeque<FaultChange>,
    wheelbase: f64,
    half_width: f64,
    station: f64,
    records: u64,
    samples: Vec<CropSample>,
    beams: Vec<Beam>,
    touches: Vec<Touch>,
    touching: bool,
}

impl Crop {
    /// The crop of a scenario, as `seed` places it, around a machine.
    #[must_use]
    pub fn new(
        setting: &CropSetting,
        faults: &[DistanceFault],
        machine: &Vehicle,
        seed: u64,
    ) -> Self {
        let sensor =
            |mount, number| DistanceSensor::new(setting.distance.clone(), mount, seed, number);
        let parameters = machine.parameters();
        Self {
            rows: Rows::new(&setting.row, seed),
            origin: setting.origin,
            sensors: [
                sensor(setting.mount.mirrored(), 0),
                sensor(setting.mount, 1),
            ],
            faults: FaultChange::all(faults),
            wheelbase: parameters.rear_to_antenna.get() + parameters.antenna_to_front.get(),
            half_width: setting.width * 0.5,
            station: 0.0,
            records: 0,
            samples: Vec::new(),
            beams: Vec::new(),
            touches: Vec::new(),
            touching: false,
        }
    }

    /// The machine's state in the frame of the rows.
    fn seen(&self, state: &State) -> rover::State {
        let (north, east, direction) = self.origin;
        let (sine, cosine) = (libm::sin(direction), libm::cos(direction));
        let (ahead, right) = (state.north - north, state.east - east);
        rover::State {
            x: ahead * cosine + right * sine,
            y: right * cosine - ahead * sine,
            heading: state.heading - direction,
            speed: state.speed,
            sideways: 0.0,
            turn: 0.0,
            way: 0.0,
        }
    }

    fn next_record(&self) -> SimTime {
        SimTime::from_ticks(self.records * RECORD_PERIOD.as_ticks())
    }

    /// The next time at which something reads the machine's state.
    #[must_use]
    pub fn next_coupling(&self) -> SimTime {
        let looks = self.sensors.iter().map(DistanceSensor::next_look);
        let faults = self.faults.front().map(|change| change.at);
        looks.chain(faults).fold(self.next_record(), SimTime::min)
    }

    /// Does everything that is due up to and including `to`, around the machine.
    pub fn advance_to(&mut self, to: SimTime, machine: &mut Vehicle) {
        loop {
            let next = self.next_coupling();
            if next > to {
                return;
            }
            while let Some(change) = self.faults.pop_front_if(|change| change.at <= next) {
                self.sensors[change.side as usize].set_fault(change.fault);
            }
            machine.advance_to(next);
            let state = self.seen(&machine.state());
            for sensor in &mut self.sensors {
                sensor.advance_to(next, &self.rows, |_| state);
            }
            if next == self.next_record() {
                self.record(next, &state);
            }
        }
    }

    fn record(&mut self, now: SimTime, state: &rover::State) {
        let (station, right) = self.rows.line().locate(state.x, state.y, self.station);
        self.station = station;
        if self.records.is_multiple_of(BEAM_RECORDS) {
            self.beams
                .extend(self.sensors.iter().filter_map(DistanceSensor::beam));
        }
        self.records += 1;
        self.samples.push(CropSample {
            at: now,
            station,
            right,
            heading: state.heading - self.rows.line().at(station).heading,
            state: *state,
        });
        let half = self.wheelbase * 0.5;
        let body = Footprint {
            x: state.x + half * libm::cos(state.heading),
            y: state.y + half * libm::sin(state.heading),
            heading: state.heading,
            half_length: half + OVERHANG,
            half_width: self.half_width,
        };
        let contact = self.rows.contact(&body);
        let touched = core::mem::replace(&mut self.touching, contact.is_some());
        if let Some(contact) = contact.filter(|_| !touched) {
            self.touches.push(Touch {
                at: now,
                contact,
                chassis: body,
                station,
            });
        }
    }

    /// Voltage behind the divider of the sensor that is mounted on `side`, at `when`. Measurements
    /// that end after the time that the crop has been advanced to are predicted.
    #[must_use]
    pub fn volts(&self, side: Side, when: SimTime, machine: &Vehicle) -> f64 {
        let sensor = &self.sensors[side as usize];
        let due = self.faults.front().is_some_and(|change| change.at <= when);
        if when < sensor.next_output() && !due {
            return sensor.volts();
        }
        let mut sensor = sensor.clone();
        let state = |look| self.seen(&machine.state_at(look));
        let own = self.faults.iter().filter(|change| change.side == side);
        for change in own.take_while(|change| change.at <= when) {
            // A measurement that ends at the same time comes after the change.
            let before = SimTime::from_ticks(change.at.as_ticks().saturating_sub(1));
            sensor.advance_to(before, &self.rows, state);
            sensor.set_fault(change.fault);
        }
        sensor.advance_to(when, &self.rows, state);
        sensor.volts()
    }

    /// The rows.
    #[must_use]
    pub fn rows(&self) -> &Rows {
        &self.rows
    }

    /// States recorded so far, every [`RECORD_PERIOD`].
    #[must_use]
    pub fn samples(&self) -> &[CropSample] {
        &self.samples
    }

    /// Beams recorded so far, a pair each tenth of a second.
    #[must_use]
    pub fn beams(&self) -> &[Beam] {
        &self.beams
    }

    /// The contacts of the machine's body with something solid so far, in order of time. It drives on:
    /// what a plant does to it is not modelled.
    #[must_use]
    pub fn touches(&self) -> &[Touch] {
        &self.touches
    }
}

impl FaultChange {
    /// The changes of a scenario's faults, in order of time. Ends come before begins: one fault may
    /// begin when another one ends.
    fn all(faults: &[DistanceFault]) -> VecDeque<Self> {
        let change = |when: crate::units::Time, side, fault| Self {
            at: at(when.span()),
            side,
            fault,
        };
        let ends = faults.iter().flat_map(|fault| {
            let sides = fault.sides();
            let until = fault.until;
            sides.filter_map(move |side| until.map(|until| change(until, side, None)))
        });
        let begins = faults.iter().flat_map(|fault| {
            let (when, kind) = (fault.at, fault.fault);
            fault
                .sides()
                .map(move |side| change(when, side, Some(kind)))
        });
        let mut all: Vec<Self> = ends.chain(begins).collect();
        all.sort_by_key(|change| change.at);
        all.into()
    }
}

/// Where the sensor on the right of a machine is mounted, ahead of its rear axle.
#[must_use]
pub fn mount(sensors: &vehicle_model::manifest::DistanceSensors) -> Mount {
    Mount {
        ahead: sensors.ahead.get(),
        right: sensors.beside.get(),
        yaw: -sensors.angle.get(),
    }
}
