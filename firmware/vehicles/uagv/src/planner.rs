//! A planner leads runs: its message, and that of the controller about it.

use control::demand::{self, Demand};
use firmware::convert;
use firmware::e2e::Secret;
use firmware::link::{Link, Port, WindowTimer};
use network::Message;
use ttcan::Frame;

use crate::Pilot;
use crate::matrix::window;
use crate::messages::{Lead, MillimetresPerSecond, PlannerCommand, PlannerLead};
use crate::peers::Peers;

/// The frame of the planner that has come.
pub fn take<P: Port, T: WindowTimer, const WINDOWS: usize, const NODES: usize>(
    link: &mut Link<P, T, WINDOWS, NODES>,
) -> Option<Frame> {
    link.take_believed(window::PLANNER_COMMAND)
}

/// Gives the pilot the secret of the session, by which it knows true frames.
pub fn set_secret(pilot: &mut Pilot, secret: Option<Secret>) {
    pilot.guide_mut().set_secret(secret);
}

/// Shows it to the pilot, in the basic cycle that began at system time `time` (ms).
pub fn see(pilot: &mut Pilot, frame: Option<Frame>, time: u32) {
    let data = frame.as_ref().map(Frame::data);
    pilot.guide_mut().see::<PlannerCommand>(data, time, |data| {
        PlannerCommand::decode(data)
            .ok()
            .map(|message| demand(&message))
    });
}

/// What the planner asks for.
fn demand(message: &PlannerCommand) -> Demand<f32> {
    Demand {
        curvature: f32::from(message.curvature) * 1e-4,
        speed: message.speed.0 as f32 * 1e-3,
    }
}

/// The message that says who leads.
pub fn log(pilot: &Pilot) -> PlannerLead {
    let guide = pilot.guide();
    let (demand, age) = guide.law().demand();
    PlannerLead {
        lead: match guide.law().lead() {
            demand::Lead::Path => Lead::Path,
            demand::Lead::Demands => Lead::Planner,
            demand::Lead::Nobody => Lead::Nobody,
        },
        refused: guide.refused(),
        age: convert::rounded(age * 100.0).clamp(0, 255) as u8,
        curvature: convert::rounded(demand.curvature * 1e4).clamp(-20_000, 20_000) as i16,
        speed: MillimetresPerSecond(convert::rounded(demand.speed * 1e3).clamp(0, 10_000)),
    }
}

/// Puts that message into its window.
pub fn put<P: Port, T: WindowTimer, const WINDOWS: usize, const NODES: usize>(
    link: &mut Link<P, T, WINDOWS, NODES>,
    message: PlannerLead,
    _: &Peers,
) {
    link.put(window::PLANNER_LEAD, message.encode());
}
