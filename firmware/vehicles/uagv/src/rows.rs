//! Guidance by rows: the messages of the rows node and of the controller.

use control::row::RowPose;
use control::takeover::{self, RowSighting};
use firmware::convert;
use firmware::e2e::{self, Secret};
use firmware::link::{Link, Port, WindowTimer};
use firmware::rows::Motion;
use network::Message;
use ttcan::Frame;

use crate::Pilot;
use crate::matrix::{ROWS, window};
use crate::messages::{
    Guide, LogGuidance, LogMotion, Millimetres, NodeHealth, RowGuidance, RowOffset, RowPresence,
};
use crate::peers::{Peers, health};

/// Tenths of a degree in a radian.
const TENTHS: f32 = 1800.0 / core::f32::consts::PI;

/// The message of the rows node in the basic cycle that began at system time `time` (ms); `sender`
/// protects it.
pub fn offset(sighting: &RowSighting<f32>, sender: &mut e2e::Sender, time: u32) -> [u8; 8] {
    let RowPose {
        offset,
        heading,
        half_width,
    } = sighting.pose;
    let byte = |value: f32| convert::rounded(value).clamp(0, 255) as u8;
    let mut data = RowOffset {
        offset: Millimetres(convert::rounded(offset * 1e3).clamp(-2000, 2000)),
        heading: convert::rounded(heading * TENTHS).clamp(-512, 511) as i16,
        presence: match sighting.presence {
            takeover::Presence::Searching => RowPresence::Searching,
            takeover::Presence::Following => RowPresence::Following,
            takeover::Presence::End => RowPresence::End,
            takeover::Presence::Faulty => RowPresence::Faulty,
        },
        width: byte(half_width * 100.0),
        // Rounded up: a deviation must not look better than it is.
        deviation: byte(sighting.deviation * 200.0 + 0.5),
        counter: 0,
        check: 0,
    }
    .encode();
    sender.seal::<RowOffset>(time, &mut data);
    data
}

/// What such a message says.
pub fn sighting(message: &RowOffset) -> RowSighting<f32> {
    RowSighting {
        presence: match message.presence {
            RowPresence::Searching => takeover::Presence::Searching,
            RowPresence::Following => takeover::Presence::Following,
            RowPresence::End => takeover::Presence::End,
            RowPresence::Faulty => takeover::Presence::Faulty,
        },
        pose: RowPose {
            offset: message.offset.0 as f32 * 1e-3,
            heading: f32::from(message.heading) / TENTHS,
            half_width: f32::from(message.width) * 0.01,
        },
        deviation: f32::from(message.deviation) * 0.005,
    }
}

/// What the controller has told of the vehicle's motion since the last call, for the rows node.
pub fn motion<P: Port, T: WindowTimer, const WINDOWS: usize, const NODES: usize>(
    link: &mut Link<P, T, WINDOWS, NODES>,
) -> Motion {
    let speed = link.message::<LogMotion>(window::LOG_MOTION);
    let steering = link.message::<LogGuidance>(window::LOG_GUIDANCE);
    Motion {
        speed: speed.map(|message| convert::from_centimetres_per_second(message.speed.0)),
        steering_angle: steering
            .map(|message| message.steering_angle.0 as f32 * (core::f32::consts::PI / 180e3)),
    }
}

/// The frame of the rows node that has come, for the controller.
pub fn take<P: Port, T: WindowTimer, const WINDOWS: usize, const NODES: usize>(
    link: &mut Link<P, T, WINDOWS, NODES>,
) -> Option<Frame> {
    link.take_believed(window::ROW_OFFSET)
}

/// Gives the pilot the secret of the session, by which it knows true frames.
pub fn set_secret(pilot: &mut Pilot, secret: Option<Secret>) {
    pilot.guide_mut().set_secret(secret);
}

/// Shows it to the pilot, in the basic cycle that began at system time `time` (ms).
pub fn see(pilot: &mut Pilot, frame: Option<Frame>, time: u32) {
    let data = frame.as_ref().map(Frame::data);
    pilot.guide_mut().see::<RowOffset>(data, time, |data| {
        RowOffset::decode(data)
            .ok()
            .map(|message| sighting(&message))
    });
}

/// The message that says what guides the run.
pub fn log(pilot: &Pilot) -> RowGuidance {
    let takeover = pilot.guide().takeover();
    let (place, rest) = takeover.place();
    RowGuidance {
        guide: match takeover.guide() {
            takeover::Guide::Satellites => Guide::Satellites,
            takeover::Guide::Rows => Guide::Rows,
            takeover::Guide::Returning => Guide::Returning,
            takeover::Guide::Nothing => Guide::Nothing,
        },
        ready: takeover.is_ready(),
        rows_health: NodeHealth::Unknown,
        right: Millimetres(convert::millimetres(place.right)),
        handed_over: Millimetres(convert::millimetres(rest.right)),
        way: convert::rounded(takeover.way() * 100.0).clamp(0, 65535) as u16,
    }
}

/// Puts that message into its window, with what the controller sees of the rows node.
pub fn put<P: Port, T: WindowTimer, const WINDOWS: usize, const NODES: usize>(
    link: &mut Link<P, T, WINDOWS, NODES>,
    message: RowGuidance,
    peers: &Peers,
) {
    let rows_health = health(peers, ROWS);
    let message = RowGuidance {
        rows_health,
        ..message
    };
    link.put(window::ROW_GUIDANCE, message.encode());
}
