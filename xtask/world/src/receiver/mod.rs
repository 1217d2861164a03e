//! The positioning receiver: a Piksi that measures the antenna at a fixed period and sends each
//! solution as a burst of SBP frames at 1 Mbaud (thesis 6.2.4.3).
//!
//! A burst holds the messages of the receiver of 2016-17 with its factory settings: time, position,
//! velocity and baseline, the last three also in earth-centred coordinates; 296 bytes in eleven
//! frames. With the gaps between its frames a burst lasts 3.15 ms, as in the thesis. A receiver with an
//! inertial sensor adds a frame with roll, pitch and yaw.

pub mod earth;
mod parameters;
mod solution;
mod stream;

use libm::{cos, exp, sin, sqrt};
use sbp::messages::Sbp;

pub(crate) use parameters::Changes;
pub use parameters::{
    Base, Fix, FixChange, Inertial, InertialChange, Parameters, StreamFault, StreamFaultKind,
};

use crate::random::{Purpose, Stream};
use crate::time::Span as _;
use crate::time::{PER_SECOND, SimDuration, SimTime, after, at, from_seconds, seconds};
use crate::units::Time;
use crate::vehicle::{Attitude, Motion};
use earth::Geodetic;
use solution::{Solution, heartbeat, orientation};
use stream::Damage;

/// Frames and bytes of a burst without a heartbeat.
const BURST: (u32, u32) = (11, 296);

/// Baud rate of the serial line.
const BAUD: u32 = 1_000_000;

/// Bits of a byte on the serial line: start, eight data, stop.
const BITS: u64 = 10;

/// GPS time of week near the start of every run, milliseconds: Monday noon.
const TOW: u64 = 129_600_000;

/// Time constant of the slowly varying error of a float or single solution, seconds.
const WANDER: f64 = 60.0;

/// Height of the ground above the base station's antenna, metres.
const GROUND: f64 = 0.2;

/// A byte on the line.
#[derive(Copy, Clone, Debug, PartialEq, Eq)]
pub struct TimedByte {
    /// End of its stop bit.
    pub at: SimTime,
    /// Its value.
    pub byte: u8,
}

/// A first-order Gauss-Markov process with standard deviation 1; white when its time constant
/// is zero.
#[derive(Copy, Clone, Debug, Default)]
struct Wander {
    value: f64,
    started: bool,
}

impl Wander {
    /// The value `step` seconds after the last one.
    fn next(&mut self, step: f64, constant: f64, noise: &mut Stream) -> f64 {
        let keep = if constant > 0.0 && self.started {
            exp(-step / constant)
        } else {
            0.0
        };
        self.value = keep * self.value + sqrt(1.0 - keep * keep) * noise.normal();
        self.started = true;
        self.value
    }
}

/// The receiver.
#[derive(Clone, Debug)]
pub struct Receiver {
    parameters: Parameters,
    period: SimDuration,
    base: Geodetic,
    timing: Stream,
    noise: Stream,
    tilt_noise: Stream,
    /// What the inertial sensor tells from each time on, in the order of the times.
    inertial: Vec<(SimTime, Inertial)>,
    damage: Damage,
    bit: SimDuration,
    clock_ppm: f64,
    phase: SimDuration,
    epoch: SimTime,
    count: u64,
    line_free: SimTime,
    errors: [Wander; 6],
    slow: [Wander; 3],
}

impl Receiver {
    /// A receiver that was already running before the nodes start. Its first solution is within the
    /// first period.
    #[must_use]
    pub fn new(parameters: Parameters, faults: Vec<StreamFault>, seed: u64) -> Self {
        let mut timing = Stream::new(seed, Purpose::ReceiverTiming);
        let drawn_ppm = timing.symmetric(20.0);
        let drawn_phase = timing.uniform() * parameters.period.get();
        let clock_ppm = parameters
            .clock
            .map_or(drawn_ppm, crate::units::Quantity::get);
        let phase = from_seconds(
            parameters
                .phase
                .map_or(drawn_phase, crate::units::Quantity::get),
        );
        let bit = 1.0 / f64::from(BAUD) / (1.0 + clock_ppm * 1e-6);
        Self {
            period: parameters.period.span(),
            base: Geodetic {
                latitude: parameters.base.latitude.get(),
                longitude: parameters.base.longitude.get(),
                height: parameters.base.height.get(),
            },
            timing,
            noise: Stream::new(seed, Purpose::ReceiverNoise),
            tilt_noise: Stream::new(seed, Purpose::TiltNoise),
            inertial: Vec::new(),
            damage: Damage::new(faults, seed),
            bit: from_seconds(bit),
            clock_ppm,
            phase,
            epoch: SimTime::from_ticks(phase.as_ticks()),
            count: 0,
            line_free: SimTime::from_ticks(0),
            errors: [Wander::default(); 6],
            slow: [Wander::default(); 3],
            parameters,
        }
    }

    /// With an inertial sensor of which these changes tell. Without them it measures all the time.
    #[must_use]
    pub fn with_inertial(mut self, changes: &[InertialChange]) -> Self {
        let changes = changes.iter();
        self.inertial = changes.map(|it| (at(it.at.span()), it.state)).collect();
        self.inertial.sort_by_key(|(when, _)| *when);
        self
    }

    /// When the next solution's measurement is taken.
    #[must_use]
    pub fn next_epoch(&self) -> SimTime {
        self.epoch
    }

    /// Length of a bit on the serial line.
    #[must_use]
    pub fn bit_time(&self) -> SimDuration {
        self.bit
    }

    /// Error of the receiver's own clock, parts per million.
    #[must_use]
    pub fn clock_ppm(&self) -> f64 {
        self.clock_ppm
    }

    /// Takes the measurement that is due at [`Receiver::next_epoch`] and returns its bytes in
    /// order.
    pub fn measure(&mut self, antenna: &Motion, fix: Fix) -> Vec<TimedByte> {
        let epoch = self.epoch;
        let frames = self.frames(antenna, fix);
        let jitter = self.timing.uniform() * self.parameters.latency_jitter.get();
        let latency = from_seconds(self.parameters.latency.get() + jitter);
        let begin = after(epoch, latency).max(self.line_free);
        let gap = self.parameters.frame_gap.span();

        let mut bytes = Vec::new();
        let mut line = begin;
        for frame in self.damage.apply(epoch, frames) {
            for byte in frame {
                line = after(line, self.bit * BITS as u32);
                bytes.push(TimedByte { at: line, byte });
            }
            line = after(line, gap);
        }
        self.advance_epoch(fix);
        // A flood fills the whole pause before the next burst.
        let byte_time = (self.bit * BITS as u32).as_ticks();
        let quiet = self.epoch.as_ticks() + latency.as_ticks();
        let room = quiet.saturating_sub(line.as_ticks()) / byte_time;
        for byte in self.damage.flood(epoch, room as usize) {
            line = after(line, self.bit * BITS as u32);
            bytes.push(TimedByte { at: line, byte });
        }
        self.line_free = line;
        bytes
    }

    /// The time of the next solution. Solutions are at whole periods of GPS time. Without
    /// satellites the receiver uses its own clock; when satellites return, it returns to whole
    /// periods.
    fn advance_epoch(&mut self, fix: Fix) {
        self.count += 1;
        let step = self.period.as_ticks() as f64;
        self.epoch = if fix == Fix::None {
            let own = step * (1.0 - self.clock_ppm * 1e-6);
            SimTime::from_ticks(self.epoch.as_ticks() + own.round() as u64)
        } else {
            SimTime::from_ticks(
                self.phase.as_ticks() + (self.periods() + 1) * self.period.as_ticks(),
            )
        };
    }

    /// Number of periods of GPS time since the first solution, rounded.
    fn periods(&self) -> u64 {
        let past = self.epoch.as_ticks().saturating_sub(self.phase.as_ticks());
        (past + self.period.as_ticks() / 2) / self.period.as_ticks()
    }

    /// Time of week of the current epoch, milliseconds: a whole number of periods.
    fn tow(&self) -> u32 {
        (TOW + self.periods() * self.period.as_ticks() / (PER_SECOND / 1000)) as u32
    }

    fn solution(&mut self, antenna: &Motion, fix: Fix) -> Solution {
        let noise = self.errors_now(fix);
        let true_position = [antenna.north, antenna.east, -(antenna.height + GROUND)];
        let (s, c) = (
            sin(self.parameters.heading_bias.get()),
            cos(self.parameters.heading_bias.get()),
        );
        Solution {
            tow: self.tow(),
            fix,
            position: [0, 1, 2].map(|i| true_position[i] + noise.position[i]),
            position_sigma: noise.sigma,
            velocity: [
                c * antenna.north_speed - s * antenna.east_speed + noise.velocity[0],
                s * antenna.north_speed + c * antenna.east_speed + noise.velocity[1],
                noise.velocity[2],
            ],
            velocity_sigma: self.parameters.velocity_noise.get(),
        }
    }

    /// The frames of the current solution. Once per second they include a heartbeat.
    fn frames(&mut self, antenna: &Motion, fix: Fix) -> Vec<Vec<u8>> {
        let mut messages = self.solution(antenna, fix).messages(self.base);
        if !self.parameters.velocities {
            let is_velocity =
                |message: &Sbp| matches!(message, Sbp::MsgVelNed(_) | Sbp::MsgVelEcef(_));
            messages.retain(|message| !is_velocity(message));
        }
        if self.parameters.inertial {
            messages.extend(self.orientation(&antenna.attitude));
        }
        let per_second = (PER_SECOND / self.period.as_ticks()).max(1);
        if self.count.is_multiple_of(per_second) {
            messages.push(heartbeat());
        }
        // Writing fails only for a message of more than 255 bytes.
        let frames = messages.iter().map(sbp::to_vec);
        frames.map(Result::unwrap_or_default).collect()
    }

    /// The message of its inertial sensor. A sensor that tells nothing draws noise all the same, so that the rest of the run
    /// stays as it is.
    fn orientation(&mut self, real: &Attitude) -> Option<Sbp> {
        let measured = self.attitude(real);
        let now = self.epoch;
        let later = self.inertial.partition_point(|(from, _)| *from <= now);
        let state = later.checked_sub(1).map(|last| self.inertial[last].1);
        let attitude = match state.unwrap_or(Inertial::Valid) {
            Inertial::Valid => Some(measured),
            Inertial::Invalid => None,
            Inertial::Silent => return None,
        };
        let sigma = self.parameters.tilt_noise;
        Some(orientation(self.tow(), attitude.as_ref(), sigma))
    }

    /// Roll, pitch and yaw as its inertial sensor measures them.
    fn attitude(&mut self, real: &Attitude) -> Attitude {
        let noise = self.parameters.tilt_noise.get();
        let (roll, pitch) = (self.tilt_noise.normal(), self.tilt_noise.normal());
        Attitude {
            roll: real.roll + self.parameters.roll_error.get() + noise * roll,
            pitch: real.pitch + self.parameters.pitch_error.get() + noise * pitch,
            yaw: real.yaw,
        }
    }

    /// Draws the errors of one solution. Every fix state draws the same number of values, so that a
    /// loss of the fix does not change the noise in the rest of the run.
    fn errors_now(&mut self, fix: Fix) -> Errors {
        let step = self.parameters.period.get();
        let constant = self.parameters.correlation.get();
        let fast = self
            .errors
            .each_mut()
            .map(|e| e.next(step, constant, &mut self.noise));
        let slow = self
            .slow
            .each_mut()
            .map(|e| e.next(step, WANDER, &mut self.noise));
        let fixed = self.parameters.noise.get();
        let (own, wander) = match fix {
            Fix::Fixed => (fixed, 0.0),
            Fix::Float => (fixed, 0.3),
            Fix::Single | Fix::None => (fixed, 1.5),
        };
        let mut position = [0, 1, 2].map(|i| own * fast[i] + wander * slow[i]);
        // Heights are less accurate than horizontal positions, because no satellite is below.
        position[2] *= 1.5;
        let velocity = self.parameters.velocity_noise.get();
        Errors {
            position,
            velocity: [velocity * fast[3], velocity * fast[4], velocity * fast[5]],
            sigma: sqrt(own * own + wander * wander),
        }
    }
}

struct Errors {
    position: [f64; 3],
    velocity: [f64; 3],
    sigma: f64,
}

/// The pause between two frames that makes a burst without a heartbeat last `burst`; zero if the
/// bytes alone last longer.
fn frame_gap(burst: Time) -> Time {
    let (frames, bytes) = BURST;
    let line = f64::from(bytes) * BITS as f64 / f64::from(BAUD);
    Time::new(((burst.get() - line) / f64::from(frames - 1)).max(0.0))
}

/// Length of the longest burst without faults, seconds, for a receiver with `parameters`.
#[must_use]
pub fn burst_seconds(parameters: &Parameters) -> f64 {
    let mut receiver = Receiver::new(parameters.clone(), Vec::new(), 0);
    receiver.count = 1;
    let bytes = receiver.measure(&Motion::default(), Fix::Fixed);
    match (bytes.first(), bytes.last()) {
        (Some(first), Some(last)) => {
            seconds(last.at) - seconds(first.at)
                + seconds(SimTime::from_ticks(receiver.bit.as_ticks() * BITS))
        }
        _ => 0.0,
    }
}
