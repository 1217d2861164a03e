//! A robot that drives along a row: rows, robot, sensors and motor drivers as one value.
//!
//! Pulses of the motor drivers' lines go in, voltages of the distance sensors come out. What happens
//! between depends on the settings, the seed and the instants of the pulses only.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use crate::distance::{self, Beam, DistanceSensor, Fault, metres};
use crate::rover::{self, Axles, Mount, Rover, Side, State, Terrain};
use crate::rows::{Contact, Footprint, Rows};
use crate::scenario::Row;
use crate::time::{START, SimDuration, SimTime, after, at, from_seconds};
use crate::victor::{FULL, NEUTRAL, Victor};
use crate::world::RECORD_PERIOD;

/// Both sides, in the order of every pair.
const SIDES: [Side; 2] = [Side::Left, Side::Right];

/// Samples of a burst that a mean is taken of, and the time between two of one sensor (thesis 2.2.5.1; sled
/// with the F303).
const SAMPLES: u32 = 50;
const SAMPLE: SimDuration = SimDuration::from_ticks(4_111_000);

/// Records from one pair of beams to the next.
const BEAM_RECORDS: u64 = 10;

/// What a drive is made of.
#[derive(Clone, Debug)]
pub struct Setting<'a> {
    /// The rows; must have passed [`Row::check`].
    pub row: &'a Row,
    /// The robot.
    pub rover: rover::Parameters,
    /// Where the sensor on the right is mounted; the one on the left is its mirror image.
    pub mount: Mount,
    /// The ground.
    pub terrain: Terrain,
    /// Both distance sensors.
    pub distance: distance::Parameters,
    /// Errors of both motor drivers' clocks, shares of one: left and right.
    pub driver_clocks: [f64; 2],
}

/// The robot at one instant. Pairs are left and right.
#[derive(Copy, Clone, Debug, PartialEq)]
pub struct RowSample {
    /// When.
    pub at: SimTime,
    /// Position and motion of the robot.
    pub state: State,
    /// Its station along the row, metres.
    pub station: f64,
    /// Distance of its middle from that of the row, metres, right positive.
    pub right: f64,
    /// Its heading against that of the row, radians, right positive.
    pub heading: f64,
    /// Efforts of the motor drivers, -1 to 1.
    pub efforts: [f64; 2],
    /// What the sensors on the left and on the right measured last, metres; `None` without a target.
    pub distances: [Option<f64>; 2],
    /// The axles that the robot stands on.
    pub axles: Axles,
}

/// A contact of the robot with something solid.
#[derive(Copy, Clone, Debug, PartialEq)]
pub struct Touch {
    /// When it was found; contacts are looked for at each record.
    pub at: SimTime,
    /// What the robot touches.
    pub contact: Contact,
    /// The area of the robot then.
    pub chassis: Footprint,
    /// Its station along the row then, metres.
    pub station: f64,
}

/// A fault of a distance sensor that begins, or ends with `None`.
#[derive(Copy, Clone, Debug, PartialEq)]
pub(crate) struct FaultChange {
    pub(crate) at: SimTime,
    pub(crate) side: Side,
    pub(crate) fault: Option<Fault>,
}

/// A robot on its way along a row.
#[derive(Clone, Debug)]
pub struct RowDrive {
    rows: Rows,
    rover: Rover,
    /// The sensors that are mounted on the left and on the right.
    sensors: [DistanceSensor; 2],
    drivers: [Victor; 2],
    efforts: [f64; 2],
    start: f64,
    station: f64,
    records: u64,
    samples: Vec<RowSample>,
    beams: Vec<Beam>,
    /// When the motors came to rest and when they left it: true from then on if both efforts are zero.
    rests: Vec<(SimTime, bool)>,
    touches: Vec<Touch>,
    /// Whether the robot touched something at the last record.
    touching: bool,
    /// Changes of faults that are still to come, in order of time.
    faults: VecDeque<FaultChange>,
}

impl RowDrive {
    /// A robot at rest at the start of the row, at time zero.
    #[must_use]
    pub fn new(setting: &Setting, seed: u64) -> Self {
        let rows = Rows::new(setting.row, seed);
        let start = &setting.row.start;
        let place = rows.line().at(start.station.get());
        let (x, y) = place.beside(start.right.get());
        let heading = place.heading + start.heading.get();
        let sensor =
            |mount, number| DistanceSensor::new(setting.distance.clone(), mount, seed, number);
        Self {
            rover: Rover::new(
                setting.rover.clone(),
                setting.terrain.clone(),
                (x, y, heading),
                seed,
            ),
            rows,
            sensors: [
                sensor(setting.mount.mirrored(), 0),
                sensor(setting.mount, 1),
            ],
            drivers: setting.driver_clocks.map(Victor::new),
            efforts: [0.0; 2],
            start: start.station.get(),
            station: start.station.get(),
            records: 0,
            samples: Vec::new(),
            beams: Vec::new(),
            rests: vec![(START, true)],
            touches: Vec::new(),
            touching: false,
            faults: VecDeque::new(),
        }
    }

    /// The line of a side's motor driver changes to `high` at `at`. It may be passed on late, as
    /// long as the drive has not been advanced to [`RowDrive::next_coupling`].
    pub fn pulse_edge(&mut self, side: Side, at: SimTime, high: bool) {
        self.drivers[side as usize].edge(at, high);
        self.obey(side, at);
    }

    /// Tells the robot what a motor driver makes of its line.
    fn obey(&mut self, side: Side, at: SimTime) {
        let effort = self.drivers[side as usize].effort(at);
        let before = &mut self.efforts[side as usize];
        if *before != effort {
            *before = effort;
            self.rover.set_effort(at, side, effort);
            let rest = self.efforts == [0.0; 2];
            if self.rests.last().is_none_or(|(_, last)| *last != rest) {
                self.rests.push((at, rest));
            }
        }
    }

    /// When a motor driver with an effort switches off unless another pulse comes.
    fn off_at(&self, side: Side) -> Option<SimTime> {
        let running = self.efforts[side as usize] != 0.0;
        self.drivers[side as usize].off_at().filter(|_| running)
    }

    fn next_record(&self) -> SimTime {
        SimTime::from_ticks(self.records * RECORD_PERIOD.as_ticks())
    }

    /// The next time at which something reads the robot's state.
    #[must_use]
    pub fn next_coupling(&self) -> SimTime {
        let looks = self.sensors.iter().map(DistanceSensor::next_look);
        let offs = SIDES.into_iter().filter_map(|side| self.off_at(side));
        let faults = self.faults.front().map(|change| change.at);
        let others = looks.chain(offs).chain(faults);
        others.fold(self.next_record(), SimTime::min)
    }

    /// Does everything that is due up to and including `to`.
    pub fn advance_to(&mut self, to: SimTime) {
        loop {
            let next = self.next_coupling();
            if next > to {
                return;
            }
            for side in SIDES {
                if self.off_at(side).is_some_and(|off| off <= next) {
                    self.obey(side, next);
                }
            }
            while let Some(change) = self.faults.pop_front_if(|change| change.at <= next) {
                self.set_fault(change.side, change.fault);
            }
            self.rover.advance_to(next);
            let state = self.rover.state();
            for sensor in &mut self.sensors {
                sensor.advance_to(next, &self.rows, |_| state);
            }
            if next == self.next_record() {
                self.record(next, state);
            }
        }
    }

    fn record(&mut self, now: SimTime, state: State) {
        let (station, right) = self.rows.line().locate(state.x, state.y, self.station);
        self.station = station;
        if self.records.is_multiple_of(BEAM_RECORDS) {
            self.beams
                .extend(self.sensors.iter().filter_map(DistanceSensor::beam));
        }
        self.records += 1;
        self.samples.push(RowSample {
            at: now,
            state,
            station,
            right,
            heading: state.heading - self.rows.line().at(station).heading,
            efforts: self.efforts,
            distances: self.sensors.each_ref().map(DistanceSensor::measured),
            axles: self.rover.axles(),
        });
        let chassis = self.rover.footprint(&state);
        let contact = self.rows.contact(&chassis);
        let touched = core::mem::replace(&mut self.touching, contact.is_some());
        if let Some(contact) = contact.filter(|_| !touched) {
            self.touches.push(Touch {
                at: now,
                contact,
                chassis,
                station,
            });
        }
    }

    /// Voltage behind the divider of the sensor that is mounted on `side`, at `when`. Measurements
    /// that end after the time that the drive has been advanced to are predicted.
    #[must_use]
    pub fn volts(&self, side: Side, when: SimTime) -> f64 {
        let sensor = &self.sensors[side as usize];
        let due = self.faults.front().is_some_and(|change| change.at <= when);
        if when < sensor.next_output() && !due {
            return sensor.volts();
        }
        let mut sensor = sensor.clone();
        let mut rover = self.rover.clone();
        let mut state = |look| {
            rover.advance_to(look);
            rover.state()
        };
        let own = self.faults.iter().filter(|change| change.side == side);
        for change in own.take_while(|change| change.at <= when) {
            // A measurement that ends at the same time comes after the change.
            let before = SimTime::from_ticks(change.at.as_ticks().saturating_sub(1));
            sensor.advance_to(before, &self.rows, &mut state);
            sensor.set_fault(change.fault);
        }
        sensor.advance_to(when, &self.rows, state);
        sensor.volts()
    }

    /// Mean of the voltages that a node reads in a burst of samples from `begin` on. A change of the
    /// sensor's output within the burst makes a mean of both outputs, which is a distance at which nothing
    /// stands: with bursts of 206 us each 5 ms one change in 24 does so.
    #[must_use]
    pub fn mean_volts(&self, side: Side, begin: SimTime) -> f64 {
        let first = self.volts(side, begin);
        let last = after(begin, SAMPLE * (SAMPLES - 1));
        let due = self.faults.front().is_some_and(|change| change.at <= last);
        if last < self.sensors[side as usize].next_output() && !due {
            return first;
        }
        let rest = (1..SAMPLES).map(|k| self.volts(side, after(begin, SAMPLE * k)));
        (first + rest.sum::<f64>()) / f64::from(SAMPLES)
    }

    /// Begins or ends a fault of the sensor that is mounted on `side` at a time in the future; of two
    /// changes at one time the one that was planned later counts.
    pub fn plan_fault(&mut self, at: SimTime, side: Side, fault: Option<Fault>) {
        let place = self.faults.partition_point(|change| change.at <= at);
        self.faults.insert(place, FaultChange { at, side, fault });
    }

    /// Begins or ends a fault of the sensor that is mounted on `side` now.
    pub fn set_fault(&mut self, side: Side, fault: Option<Fault>) {
        self.sensors[side as usize].set_fault(fault);
    }

    /// Predicts the state of the robot at `when` from the pulses known so far.
    #[must_use]
    pub fn state_at(&self, when: SimTime) -> State {
        self.rover.state_at(when)
    }

    /// Efforts of the motor drivers, -1 to 1: left and right.
    #[must_use]
    pub fn efforts(&self) -> [f64; 2] {
        self.efforts
    }

    /// When the motors came to rest and when they left it, in order of time from the start on: true from
    /// then on if both efforts are zero.
    #[must_use]
    pub fn rests(&self) -> &[(SimTime, bool)] {
        &self.rests
    }

    /// The rows.
    #[must_use]
    pub fn rows(&self) -> &Rows {
        &self.rows
    }

    /// The robot.
    #[must_use]
    pub fn rover(&self) -> &Rover {
        &self.rover
    }

    /// A side's motor driver.
    #[must_use]
    pub fn driver(&self, side: Side) -> &Victor {
        &self.drivers[side as usize]
    }

    /// Station of the robot at the start, metres.
    #[must_use]
    pub fn start(&self) -> f64 {
        self.start
    }

    /// States recorded so far, every [`RECORD_PERIOD`].
    #[must_use]
    pub fn samples(&self) -> &[RowSample] {
        &self.samples
    }

    /// Beams recorded so far, a pair each tenth of a second.
    #[must_use]
    pub fn beams(&self) -> &[Beam] {
        &self.beams
    }

    /// The contacts with something solid so far, in order of time. A contact lasts until the robot
    /// touches nothing. It drives on: what a plant does to it is not modelled.
    #[must_use]
    pub fn touches(&self) -> &[Touch] {
        &self.touches
    }

    /// The first of them.
    #[must_use]
    pub fn contact(&self) -> Option<&Touch> {
        self.touches.first()
    }
}

/// Distance before the end of the row at which [`follow`] ends, metres. The sensors look farther ahead.
const LAST_METRE: f64 = 1.0;

/// Largest distance on the bus, centimetres.
const LARGEST_DISTANCE: f64 = 250.0;

/// What a robot's nodes do together, for a drive without a bus.
#[derive(Copy, Clone, Debug)]
pub struct Chain {
    /// Period of the control step, seconds.
    pub period: f64,
    /// From the sample to the beginning of the servo pulse, seconds.
    pub latency: f64,
    /// After this time the drive ends, seconds.
    pub longest: f64,
}

/// What a drive came to.
#[derive(Copy, Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Followed {
    /// Mean distance from the middle of the row, metres.
    pub offset: f64,
    /// The largest one, metres.
    pub largest: f64,
    /// Way along the row, metres.
    pub way: f64,
    /// How long it took, seconds.
    pub time: f64,
    /// Whether the robot touched something.
    pub touched: bool,
    /// Whether its law stopped it before the end of the row.
    pub stopped: bool,
    /// Whether its middle left the row, through a gap.
    pub left: bool,
}

impl Followed {
    /// Whether the robot did not come to the end of the row.
    #[must_use]
    pub fn failed(&self) -> bool {
        self.touched || self.stopped || self.left
    }
}

/// Drives along the row until a metre before its end, until a contact, until the robot is not between its
/// rows any more, or until the law stops it.
///
/// `law` gets the distances to the left and to the right row as they are on the bus, in whole centimetres
/// up to 250, and returns the efforts of both sides, -1 to 1, or `None` to stop.
pub fn follow(
    drive: &mut RowDrive,
    chain: &Chain,
    mut law: impl FnMut([u8; 2]) -> Option<[f64; 2]>,
) -> Followed {
    let (mut followed, mut count) = (Followed::default(), 0.0);
    for step in 1..=(chain.longest / chain.period) as u32 {
        followed.time = f64::from(step) * chain.period;
        let now = at(from_seconds(followed.time));
        drive.advance_to(now);
        let Some(&sample) = drive.samples().last() else {
            continue;
        };
        followed.way = sample.station - drive.start();
        followed.touched = drive.contact().is_some();
        followed.left = sample.right.abs() > drive.rows().width_at(sample.station) / 2.0;
        if followed.failed() || sample.station > drive.rows().length() - LAST_METRE {
            break;
        }
        count += 1.0;
        followed.offset += sample.right.abs();
        followed.largest = followed.largest.max(sample.right.abs());
        let read = |side| {
            let counts = (drive.mean_volts(side, now) / 3.3 * 4095.0)
                .round()
                .min(4095.0);
            let distance = metres(counts / 4095.0 * 3.3) * 100.0;
            distance.round().clamp(0.0, LARGEST_DISTANCE) as u8
        };
        // The sensor on the right measures the left row.
        let Some(efforts) = law([read(Side::Right), read(Side::Left)]) else {
            followed.stopped = true;
            break;
        };
        let begin = at(from_seconds(followed.time + chain.latency));
        for (side, effort) in SIDES.into_iter().zip(efforts) {
            pulse(drive, side, begin, NEUTRAL + effort * FULL);
        }
    }
    followed.offset /= f64::max(count, 1.0);
    followed
}

/// Sends a pulse of `width` seconds that begins at `begin`.
pub fn pulse(drive: &mut RowDrive, side: Side, begin: SimTime, width: f64) {
    let width = SimDuration::from_ticks((width * crate::time::PER_SECOND as f64).round() as u64);
    drive.pulse_edge(side, begin.max(START), true);
    drive.pulse_edge(side, after(begin, width), false);
}
