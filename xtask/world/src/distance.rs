//! Laser distance sensor O1D100 (ifm electronic) and the divider behind it.
//!
//! The sensor gives 0 to 10 V for 20 to 1000 cm (thesis 2.2.4.2), and three equal resistors divide that
//! by 3. It measures at most 33 times a second (inferred); between two measurements its output stays where
//! it is, though the node samples it more often.
//!
//! Light comes back during the sensor's exposure, from the whole spot; here it is that of a few rays over
//! the spot, at a few instants. It decreases with the square of the distance. A spot on the edge of a plant
//! gets light from two distances, and the maker does not say what the sensor makes of it. By default it
//! gives the distance from which most light comes. With the mean of both, readings between plant and
//! background are held until the next plant; the thesis's law then touches bare stalks after 12 m, with
//! mean differences of 14 cm, though it drove 16 m of field with means of 5 to 8 cm. So the mean is there for
//! comparison only.
//!
//! The exposure, the width of the spot, noise, drop-outs, and what faults do to the voltage are inferred.

use serde::Deserialize;

use crate::random::{Purpose, Stream};
use crate::rover::{Mount, State};
use crate::rows::{Rows, What};
use crate::scenario::check::{between, within};
use crate::time::{PER_SECOND, SimTime};
use crate::units::{Length, Ratio, Time};

/// The distance at 0 V, metres.
pub const NEAREST: f64 = 0.2;

/// The distance at 10 V, metres.
pub const FARTHEST: f64 = 10.0;

/// Voltage behind the divider at [`FARTHEST`].
pub const FULL_SCALE: f64 = 10.0 / 3.0;

/// Voltage at which the diodes of the sled's input hold a line that is shorted to 24 V: that of
/// the supply and of a Schottky diode.
const CLAMPED: f64 = 3.6;

/// Rays across the spot.
const RAYS: u32 = 3;

/// Instants of an exposure at which rays are cast.
const LOOKS: u32 = 3;

/// Sensors that share a stream of random numbers.
const SENSORS: u64 = 2;

/// Distance of two things that a sensor tells apart with [`Edges::Brightest`], metres.
const APART: f64 = 0.1;

/// What a sensor makes of a spot on an edge, whose light comes from two distances.
#[derive(Copy, Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Edges {
    /// The mean, weighted with the light.
    Mean,
    /// The distance from which most light comes.
    Brightest,
}

/// Constants of both sensors: table `[distance]`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Parameters {
    /// Length of a measurement, 30 ms to 1 s. Default 1/33 s.
    pub period: Time,
    /// How long the sensor gathers light at the end of a measurement, 1 ms to 30 ms. Default 5 ms.
    pub exposure: Time,
    /// What it makes of a spot on an edge. Default the brightest.
    pub edges: Edges,
    /// Diameter of the spot at the aperture, 0 to 5 cm. Default 4 mm.
    pub spot_near: Length,
    /// Diameter of the spot at 10 m, 0 to 20 cm. Default 15 mm.
    pub spot_far: Length,
    /// Standard deviation of a measurement at distance zero, 0 to 20 cm. Default 3 mm.
    pub noise: Length,
    /// Its increase with the distance, 0 to 10 %. Default 0.2 %.
    pub noise_slope: Ratio,
    /// Share of the measurements that find no target although there is one, 0 to 100 %. Default 0 %.
    pub drop_outs: Ratio,
    /// Distance at which the leaf guard in front of the aperture holds leaves away, 0 to 50 cm (thesis
    /// 2.2.1). Default 20 cm, the lower end of the range.
    pub guard: Length,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            period: Time::new(1.0 / 33.0),
            exposure: Time::new(0.005),
            edges: Edges::Brightest,
            spot_near: Length::new(0.004),
            spot_far: Length::new(0.015),
            noise: Length::new(0.003),
            noise_slope: Ratio::new(0.002),
            drop_outs: Ratio::default(),
            guard: Length::new(0.2),
        }
    }
}

impl Parameters {
    /// Checks what a file says about the sensors.
    ///
    /// # Errors
    /// The first value out of its range, as a phrase that begins with the field.
    pub fn check(&self) -> Result<(), String> {
        let lengths = |most| between(Length::default(), Length::new(most));
        let shares = |most| between(Ratio::default(), Ratio::new(most));
        let periods = between(Time::new(0.03), Time::new(1.0));
        within("distance.period", self.period, periods)?;
        let exposures = between(Time::new(0.001), Time::new(0.03));
        within("distance.exposure", self.exposure, exposures)?;
        within("distance.spot_near", self.spot_near, lengths(0.05))?;
        within("distance.spot_far", self.spot_far, lengths(0.2))?;
        within("distance.noise", self.noise, lengths(0.2))?;
        within("distance.noise_slope", self.noise_slope, shares(0.1))?;
        within("distance.drop_outs", self.drop_outs, shares(1.0))?;
        within("distance.guard", self.guard, lengths(0.5))
    }
}

/// What is wrong with a sensor or its line.
#[derive(Copy, Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Fault {
    /// The lead between sensor and divider is broken: the divider draws the line to ground.
    Open,
    /// The lead touches ground.
    ShortedToGround,
    /// The lead touches the sensor's supply of 24 V: the diodes of the sled's input clamp it.
    ShortedToSupply,
    /// The output stays at its present voltage.
    Frozen,
    /// The sensor finds no target, as behind a dirty lens.
    Blind,
}

/// A beam as it was cast, for pictures.
#[derive(Copy, Clone, Debug, PartialEq)]
pub struct Beam {
    /// The aperture: `x`, `y`, metres.
    pub from: (f64, f64),
    /// Where the light ended: `x`, `y`, metres.
    pub to: (f64, f64),
    /// What it met; `None` if nothing within 10 m.
    pub what: Option<What>,
}

/// Light that comes back from one distance.
#[derive(Copy, Clone, Debug)]
struct Echo {
    distance: f64,
    weight: f64,
}

/// One sensor with its divider.
#[derive(Clone, Debug)]
pub struct DistanceSensor {
    parameters: Parameters,
    mount: Mount,
    /// Number of the sensor, below [`SENSORS`].
    number: u64,
    stream: Stream,
    /// Looks that were taken by now.
    looks: u64,
    /// When the first measurement begins, ticks.
    phase: u64,
    /// What has come back during the current measurement.
    light: Vec<Echo>,
    measured: Option<f64>,
    volts: f64,
    beam: Option<Beam>,
    fault: Option<Fault>,
}

impl DistanceSensor {
    /// A sensor whose first measurement begins at a random time within its period. `number` is 0 for
    /// the one on the left, 1 for the one on the right; each has its own noise.
    #[must_use]
    pub fn new(parameters: Parameters, mount: Mount, seed: u64, number: u64) -> Self {
        let mut stream = Stream::new(seed, Purpose::Distances);
        stream.seek(number % SENSORS);
        let period = parameters.period.get() * PER_SECOND as f64;
        Self {
            phase: (period * stream.uniform()) as u64,
            parameters,
            mount,
            number: number % SENSORS,
            stream,
            looks: 0,
            light: Vec::new(),
            measured: None,
            volts: 0.0,
            beam: None,
            fault: None,
        }
    }

    /// When it looks next. The looks of a measurement are spread over its exposure; the last one ends
    /// it.
    #[must_use]
    pub fn next_look(&self) -> SimTime {
        let left = u64::from(LOOKS) - 1 - self.looks % u64::from(LOOKS);
        let apart = self.parameters.exposure.get() * PER_SECOND as f64 / f64::from(LOOKS - 1);
        SimTime::from_ticks(self.next_output().as_ticks() - (left as f64 * apart) as u64)
    }

    /// When its output may change next: the end of the current measurement.
    #[must_use]
    pub fn next_output(&self) -> SimTime {
        let period = self.parameters.period.get() * PER_SECOND as f64;
        let measurements = self.looks / u64::from(LOOKS) + 1;
        SimTime::from_ticks(self.phase + (measurements as f64 * period) as u64)
    }

    /// Looks as often as is due until `now`, at the rows and from the robot that is in `state` at
    /// each of these times.
    pub fn advance_to(
        &mut self,
        now: SimTime,
        rows: &Rows,
        mut state: impl FnMut(SimTime) -> State,
    ) {
        while self.next_look() <= now {
            let state = state(self.next_look());
            self.look(rows, &state);
        }
    }

    /// Looks from a robot in `state`. The last look of a measurement sets the output.
    fn look(&mut self, rows: &Rows, state: &State) {
        let p = &self.parameters;
        let (x, y, heading) = self.mount.beam(state);
        let (s, c) = (libm::sin(heading), libm::cos(heading));
        let near = p.spot_near.get();
        let spread = (p.spot_far.get() - near) / FARTHEST;
        for ray in 0..RAYS {
            let share = f64::from(ray) / f64::from(RAYS - 1) - 0.5;
            let beside = share * near;
            let from = (x - beside * s, y + beside * c);
            let Some(hit) = rows.cast(from.0, from.1, heading + share * spread, FARTHEST) else {
                continue;
            };
            let distance = match hit.what {
                What::Leaf => hit.distance.max(p.guard.get()),
                _ => hit.distance,
            };
            // Whatever is nearer than 1 cm is as bright as at 1 cm.
            let weight = 1.0 / (distance * distance).max(1e-4);
            self.light.push(Echo { distance, weight });
        }
        let middle = rows.cast(x, y, heading, FARTHEST);
        let end = middle.map_or(FARTHEST, |hit| hit.distance);
        self.beam = Some(Beam {
            from: (x, y),
            to: (x + end * c, y + end * s),
            what: middle.map(|hit| hit.what),
        });
        self.looks += 1;
        if self.looks.is_multiple_of(u64::from(LOOKS)) {
            let light = core::mem::take(&mut self.light);
            self.measure(light);
        }
    }

    /// Ends a measurement.
    fn measure(&mut self, light: Vec<Echo>) {
        // The first numbers belong to the phases.
        self.stream
            .seek((1 + self.looks / u64::from(LOOKS)) * SENSORS + self.number);
        let normal = self.stream.normal();
        let dropped = self.stream.uniform() < self.parameters.drop_outs.get();
        let found = match self.parameters.edges {
            Edges::Mean => mean(&light),
            Edges::Brightest => brightest(light),
        };
        let blind = dropped || self.fault == Some(Fault::Blind);
        self.measured = found.filter(|_| !blind).map(|distance| {
            let Parameters {
                noise, noise_slope, ..
            } = &self.parameters;
            distance + normal * (noise.get() + noise_slope.get() * distance)
        });
        if self.fault != Some(Fault::Frozen) {
            self.volts = volts(self.measured);
        }
    }

    /// Begins or ends a fault. A frozen output stays where it is from now on.
    pub fn set_fault(&mut self, fault: Option<Fault>) {
        self.fault = fault;
    }

    /// Voltage behind the divider, from the last measurement that has ended; 0 V before the
    /// first.
    #[must_use]
    pub fn volts(&self) -> f64 {
        match self.fault {
            None | Some(Fault::Frozen) => self.volts,
            Some(Fault::Open | Fault::ShortedToGround) => 0.0,
            Some(Fault::ShortedToSupply) => CLAMPED,
            Some(Fault::Blind) => volts(None),
        }
    }

    /// The last distance that it measured, metres; `None` without a target.
    #[must_use]
    pub fn measured(&self) -> Option<f64> {
        self.measured
    }

    /// The middle of the beam at the last look.
    #[must_use]
    pub fn beam(&self) -> Option<Beam> {
        self.beam
    }
}

/// The mean of all distances, weighted with their light; `None` without light.
fn mean(light: &[Echo]) -> Option<f64> {
    let sum: f64 = light.iter().map(|echo| echo.weight).sum();
    let weighted: f64 = light.iter().map(|echo| echo.weight * echo.distance).sum();
    (sum > 0.0).then(|| weighted / sum)
}

/// The mean of the thing from which most light comes. What is less than [`APART`] behind it counts as the
/// same thing.
fn brightest(mut light: Vec<Echo>) -> Option<f64> {
    light.sort_by(|a, b| a.distance.total_cmp(&b.distance));
    let things = light.chunk_by(|a, b| b.distance - a.distance < APART);
    let sum = |thing: &[Echo]| thing.iter().map(|echo| echo.weight).sum::<f64>();
    let most = things.max_by(|a, b| sum(a).total_cmp(&sum(b)))?;
    mean(most)
}

/// Voltage behind the divider for a distance in metres, without a target full scale.
#[must_use]
pub fn volts(distance: Option<f64>) -> f64 {
    distance.map_or(FULL_SCALE, |distance| {
        let share = (distance - NEAREST) / (FARTHEST - NEAREST);
        FULL_SCALE * share.clamp(0.0, 1.0)
    })
}

/// The distance in metres for which the divider gives `volts`.
#[must_use]
pub fn metres(volts: f64) -> f64 {
    NEAREST + (FARTHEST - NEAREST) * (volts / FULL_SCALE)
}
