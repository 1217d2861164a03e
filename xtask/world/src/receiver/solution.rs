//! A solution as the messages of the Swift Binary Protocol that a Piksi sends for it.

use libm::{atan2, round};
use sbp::messages::{
    Sbp,
    navigation::{
        MsgAgeCorrections, MsgBaselineEcef, MsgBaselineNed, MsgDops, MsgGpsTime, MsgPosEcef,
        MsgPosLlh, MsgUtcTime, MsgVelEcef, MsgVelNed,
    },
    orientation::{MsgBaselineHeading, MsgOrientEuler},
    system::MsgHeartbeat,
};

use super::earth::Geodetic;
use super::parameters::Fix;
use crate::units::Angle;
use crate::vehicle::{Attitude, wrap};

/// SBP sender id of the receiver; a Piksi derives it from its serial number.
const SENDER: Option<u16> = Some(0x88D3);

/// GPS week of every run: that of 6 March 2016.
const WEEK: u16 = 1887;

/// Seconds by which GPS time was ahead of UTC in 2016.
const LEAP_SECONDS: u64 = 17;

/// The receiver's solution at one epoch. Vectors are north, east, down from the base station's
/// antenna, metres and metres per second.
pub(super) struct Solution {
    /// Time of week, milliseconds.
    pub(super) tow: u32,
    pub(super) fix: Fix,
    pub(super) position: [f64; 3],
    /// Standard deviation of a horizontal component of the position.
    pub(super) position_sigma: f64,
    pub(super) velocity: [f64; 3],
    /// Standard deviation of a component of the velocity.
    pub(super) velocity_sigma: f64,
}

impl Solution {
    /// The messages of a burst, in the order in which the receiver sends them.
    pub(super) fn messages(&self, base: Geodetic) -> Vec<Sbp> {
        let mut messages = vec![self.gps_time(), self.utc_time()];
        messages.extend(self.positions(base));
        messages.extend(self.velocities(base));
        messages.push(self.dops());
        messages.extend(self.baselines(base));
        messages.push(Sbp::MsgAgeCorrections(MsgAgeCorrections {
            sender_id: SENDER,
            tow: self.tow,
            age: if self.fix.has_baseline() {
                10
            } else {
                u16::MAX
            },
        }));
        messages
    }

    /// True if there is a position.
    fn solved(&self) -> bool {
        self.fix != Fix::None
    }

    fn satellites(&self) -> u8 {
        match self.fix {
            Fix::None => 0,
            Fix::Single => 7,
            Fix::Float => 8,
            Fix::Fixed => 10,
        }
    }

    /// Estimated standard deviations of the position, millimetres: horizontal, vertical, overall.
    fn accuracy(&self) -> [u16; 3] {
        [1.0, 1.5, 1.8].map(|factor| millimetres(factor * self.position_sigma))
    }

    fn gps_time(&self) -> Sbp {
        Sbp::MsgGpsTime(MsgGpsTime {
            sender_id: SENDER,
            wn: WEEK,
            tow: self.tow,
            ns_residual: 0,
            flags: u8::from(self.solved()),
        })
    }

    fn utc_time(&self) -> Sbp {
        let second = u64::from(self.tow) / 1000 - LEAP_SECONDS;
        Sbp::MsgUtcTime(MsgUtcTime {
            sender_id: SENDER,
            flags: u8::from(self.solved()),
            tow: self.tow,
            year: 2016,
            month: 3,
            // The week begins on Sunday, 6 March.
            day: 6 + (second / 86_400) as u8,
            hours: (second / 3600 % 24) as u8,
            minutes: (second / 60 % 60) as u8,
            seconds: (second % 60) as u8,
            ns: self.tow % 1000 * 1_000_000,
        })
    }

    /// The position, in geodetic and earth-centred coordinates.
    fn positions(&self, base: Geodetic) -> [Sbp; 2] {
        let [h_accuracy, v_accuracy, accuracy] = self.accuracy();
        let (tow, n_sats, flags) = (self.tow, self.satellites(), self.fix.position_flags());
        let place = base.offset(zero_unless(self.solved(), self.position));
        let [lat, lon, height] = zero_unless(
            self.solved(),
            [
                place.latitude.to_degrees(),
                place.longitude.to_degrees(),
                place.height,
            ],
        );
        let [x, y, z] = zero_unless(self.solved(), place.ecef());
        [
            Sbp::MsgPosLlh(MsgPosLlh {
                sender_id: SENDER,
                tow,
                lat,
                lon,
                height,
                h_accuracy,
                v_accuracy,
                n_sats,
                flags,
            }),
            Sbp::MsgPosEcef(MsgPosEcef {
                sender_id: SENDER,
                tow,
                x,
                y,
                z,
                accuracy,
                n_sats,
                flags,
            }),
        ]
    }

    /// The velocity, in north-east-down and earth-centred coordinates.
    fn velocities(&self, base: Geodetic) -> [Sbp; 2] {
        let accuracy = millimetres(self.velocity_sigma);
        let (tow, n_sats, flags) = (self.tow, self.satellites(), u8::from(self.solved()));
        let velocity = zero_unless(self.solved(), self.velocity);
        let [n, e, d] = whole(velocity);
        let [x, y, z] = whole(base.rotate(velocity));
        [
            Sbp::MsgVelNed(MsgVelNed {
                sender_id: SENDER,
                tow,
                n,
                e,
                d,
                h_accuracy: accuracy,
                v_accuracy: accuracy,
                n_sats,
                flags,
            }),
            Sbp::MsgVelEcef(MsgVelEcef {
                sender_id: SENDER,
                tow,
                x,
                y,
                z,
                accuracy,
                n_sats,
                flags,
            }),
        ]
    }

    /// The dilutions of precision, in units of 0.01.
    fn dops(&self) -> Sbp {
        let [gdop, pdop, tdop, hdop, vdop] = if self.solved() {
            [180, 160, 90, 80, 130]
        } else {
            [u16::MAX; 5]
        };
        Sbp::MsgDops(MsgDops {
            sender_id: SENDER,
            tow: self.tow,
            gdop,
            pdop,
            tdop,
            hdop,
            vdop,
            flags: self.fix.position_flags(),
        })
    }

    /// The baseline, in north-east-down and earth-centred coordinates, and its heading.
    fn baselines(&self, base: Geodetic) -> [Sbp; 3] {
        let [h_accuracy, v_accuracy, accuracy] = self.accuracy();
        let (tow, n_sats, flags) = (self.tow, self.satellites(), self.fix.baseline_flags());
        let baseline = zero_unless(self.fix.has_baseline(), self.position);
        let [n, e, d] = whole(baseline);
        let [x, y, z] = whole(base.rotate(baseline));
        let heading = if self.fix.has_baseline() {
            let angle = atan2(baseline[1], baseline[0]).to_degrees();
            round((angle + 360.0) % 360.0 * 1000.0) as u32 % 360_000
        } else {
            0
        };
        [
            Sbp::MsgBaselineNed(MsgBaselineNed {
                sender_id: SENDER,
                tow,
                n,
                e,
                d,
                h_accuracy,
                v_accuracy,
                n_sats,
                flags,
            }),
            Sbp::MsgBaselineEcef(MsgBaselineEcef {
                sender_id: SENDER,
                tow,
                x,
                y,
                z,
                accuracy,
                n_sats,
                flags,
            }),
            Sbp::MsgBaselineHeading(MsgBaselineHeading {
                sender_id: SENDER,
                tow,
                heading,
                n_sats,
                flags,
            }),
        ]
    }
}

/// Flags of an attitude from inertial sensor and satellites.
const INERTIAL: u8 = 1;

/// The attitude that the inertial sensor of the receiver has measured, with the standard deviation of roll and pitch.
pub(super) fn orientation(tow: u32, attitude: Option<&Attitude>, sigma: Angle) -> Sbp {
    let flags = if attitude.is_some() { INERTIAL } else { 0 };
    let attitude = attitude.copied().unwrap_or_default();
    let micro = |angle: f64| round(wrap(angle).to_degrees() * 1e6) as i32;
    let sigma = sigma.get().to_degrees() as f32;
    Sbp::MsgOrientEuler(MsgOrientEuler {
        sender_id: SENDER,
        tow,
        roll: micro(attitude.roll),
        pitch: micro(attitude.pitch),
        yaw: micro(attitude.yaw),
        roll_accuracy: sigma,
        pitch_accuracy: sigma,
        yaw_accuracy: sigma,
        flags,
    })
}

/// The message that the receiver sends each second.
pub(super) fn heartbeat() -> Sbp {
    Sbp::MsgHeartbeat(MsgHeartbeat {
        sender_id: SENDER,
        flags: 0,
    })
}

fn zero_unless(yes: bool, components: [f64; 3]) -> [f64; 3] {
    if yes { components } else { [0.0; 3] }
}

/// Rounds metres to whole millimetres.
fn whole(metres: [f64; 3]) -> [i32; 3] {
    metres.map(|metres| round(metres * 1000.0) as i32)
}

fn millimetres(metres: f64) -> u16 {
    round(metres * 1000.0).clamp(0.0, 65_535.0) as u16
}
