//! A helper for tests: drives the world's vehicle along its line through the same serial bytes as
//! the nodes, with the thesis's state feedback (7.2.3) but without a network.

use sbp::messages::Sbp;
use world::time::{after, at, from_seconds};
use world::{Analog, Device, Effect, NodeIndex, Scenario, SimDuration, SimTime, World};

use crate::uagv;

/// dlqr gains for 1 m/s, 10 Hz, unit weights.
const GAINS: [f64; 3] = [0.888_975, 2.040_970, 2.198_963];

/// Speed that the pilot drives at.
const SPEED: f64 = 1.0;

pub(crate) struct Pilot {
    pub world: World,
    stream: Vec<u8>,
    line_free: SimTime,
}

impl Pilot {
    pub(crate) fn new(scenario: &Scenario, seed: u64) -> Self {
        Self {
            world: World::new(&uagv::vehicle(), scenario, seed),
            stream: Vec::new(),
            line_free: SimTime::from_ticks(0),
        }
    }

    /// Runs until `end`; the vehicle is at rest until `start`.
    pub(crate) fn run(&mut self, start: SimDuration, end: SimDuration) {
        let (mut fixed, mut position, mut velocity) = (false, (0.0, 0.0), (0.0, 0.0));
        while let Some(next) = self.world.next_event().filter(|next| *next <= at(end)) {
            self.world.advance_to(next);
            while let Some(output) = self.world.poll() {
                if let Effect::Byte {
                    byte,
                    device: Device::SatelliteReceiver,
                    ..
                } = output.what
                {
                    self.stream.push(byte);
                }
            }
            let (messages, rest) = decode(&self.stream);
            self.stream = rest;
            for message in messages {
                match message {
                    Sbp::MsgBaselineNed(m) => {
                        fixed = m.flags & 7 == 4;
                        position = (f64::from(m.n) / 1e3, f64::from(m.e) / 1e3);
                    }
                    Sbp::MsgVelNed(m) => {
                        velocity = (f64::from(m.n) / 1e3, f64::from(m.e) / 1e3);
                    }
                    Sbp::MsgBaselineHeading(_) => {
                        let go = next >= at(start) && fixed;
                        self.control(next, go, position, velocity);
                    }
                    _ => {}
                }
            }
        }
        self.world.advance_to(at(end));
    }

    fn control(&mut self, now: SimTime, go: bool, position: (f64, f64), velocity: (f64, f64)) {
        let line = self.world.scenario().line.unwrap();
        let (_, y) = line.locate(position.0, position.1);
        let speed = libm::hypot(velocity.0, velocity.1);
        let psi = if speed > 0.2 {
            let heading = libm::atan2(velocity.1, velocity.0);
            world::vehicle::wrap(heading - line.direction())
        } else {
            0.0
        };
        let count = f64::from(self.world.adc(Analog::SteeringPot, now));
        let delta = ((count - 2048.0) / 40.0_f64).to_radians();
        let rate = -(GAINS[0] * y.clamp(-1.5, 1.5) + GAINS[1] * psi + GAINS[2] * delta);
        let share = (rate / 25_f64.to_radians()).clamp(-1.0, 1.0);
        let steering = match (go && share != 0.0, share > 0.0) {
            (false, _) => 0.0,
            (true, true) => 0.10 + 0.90 * share,
            (true, false) => -0.12 + 0.88 * share,
        };
        let drive = if go { 0.05 + 0.95 * SPEED / 2.0 } else { 0.0 };
        self.send(now, uagv::STEERING, Device::SteeringMotor, steering);
        self.send(now, uagv::DRIVE, Device::DriveMotor, drive);
    }

    fn send(&mut self, now: SimTime, node: NodeIndex, device: Device, effort: f64) {
        let steps = if effort >= 0.0 { 128.0 } else { 127.0 };
        let byte = (127.0 + steps * effort).round() as u8;
        let start = now.max(self.line_free);
        let end = after(start, from_seconds(10.0 / 38_400.0));
        self.line_free = end;
        self.world.relay(node, true, start);
        self.world.serial(node, device, byte, start, end);
    }
}

/// The complete messages at the beginning of `stream`, and the remaining bytes.
fn decode(stream: &[u8]) -> (Vec<Sbp>, Vec<u8>) {
    let Some(begin) = stream.iter().position(|byte| *byte == 0x55) else {
        return (Vec::new(), Vec::new());
    };
    let stream = &stream[begin..];
    let whole = stream
        .get(5)
        .is_some_and(|length| stream.len() >= usize::from(*length) + 8);
    if !whole {
        return (Vec::new(), stream.to_vec());
    }
    let messages = sbp::iter_messages(stream).filter_map(Result::ok).collect();
    (messages, Vec::new())
}
