//! Missions: what the controller's task of low priority does for them, and its message.

use control::mission::{Outputs, Piece, Purpose, Section, Stretch};
use control::path::Progress;
use control::route::Route as _;
use firmware::convert;
use firmware::machine::Machine;
use firmware::mission::{At, State, Work, store};
use network::Message;

use crate::messages::{self as named, MissionState};
use crate::{Pilot, Uagv};

/// Steps of the planning in a basic cycle. A turn needs some hundred of them, and a leg gives it seconds.
pub const STEPS: usize = 4;

/// The mission, and the sections of the implement.
pub struct Plan {
    work: Work,
    outputs: Outputs<f32>,
}

/// Reads the mission from its place in the flash, and lets the pilot follow it.
///
/// # Errors
/// The waypoints of the manifest make no line.
pub fn plan(pilot: &mut Pilot, words: &'static [u32]) -> Result<Plan, control::line::LineError> {
    let [from, to] = Uagv::ROUTE;
    let line = control::line::Line::new(from, to)?;
    let settings = crate::design::LAW.settings(&Uagv::SETTINGS);
    let work = Work::new(
        store::find(words).stored,
        &line,
        Uagv::SETTINGS.cruise,
        settings,
    );
    pilot
        .law_mut()
        .follow(Stretch::new(work.origin(), settings.pace));
    Ok(Plan {
        work,
        outputs: Outputs::new([Section::default(); 8]),
    })
}

/// Where the vehicle is. Forgets what lies behind it, and when a mission has been driven to its end, all of it.
pub fn at(pilot: &mut Pilot) -> At {
    let running = pilot.mode() == control::mode::Mode::AutonomousRun;
    let law = pilot.law_mut();
    let (current, finished) = (law.progress().segment, law.progress().finished);
    let over = finished && !running;
    if over {
        let (origin, pace) = (law.route().origin(), *law.route().pace());
        law.follow(Stretch::new(origin, pace));
    }
    At {
        room: law.route_mut().retire(current) > 0,
        over,
    }
}

/// What the pilot does of its mission.
pub struct Seen {
    route: Stretch<f32>,
    progress: Progress<f32>,
    speed: f32,
    running: bool,
}

/// Looks at what the pilot does.
pub fn see(pilot: &Pilot) -> Seen {
    let law = pilot.law();
    Seen {
        route: *law.route(),
        progress: *law.progress(),
        speed: pilot.decision().tracking.speed,
        running: pilot.mode() == control::mode::Mode::AutonomousRun,
    }
}

/// Adds a piece to the path.
pub fn push(pilot: &mut Pilot, piece: Piece<f32>) {
    // There was room, and nobody else adds.
    let _ = pilot.law_mut().route_mut().push(piece);
}

impl Plan {
    /// A step of the planning. Returns a piece of the path, once.
    #[inline(never)]
    pub fn step(&mut self, at: At) -> Option<Piece<f32>> {
        self.work.step(at)
    }

    /// The message about the mission, from what the pilot does. Call it once in each basic cycle.
    // Not inlined: in the task, its loops would count as often as those of the planning.
    #[inline(never)]
    pub fn tell(&mut self, seen: &Seen) -> [u8; 8] {
        let Seen {
            route,
            progress,
            speed,
            running,
        } = seen;
        let sections = if *running {
            let switching = self.outputs.step(route, progress, *speed, Uagv::PERIOD);
            switching.now
        } else {
            self.outputs = Outputs::new([Section::default(); 8]);
            0
        };
        let place = route.whereabouts(progress).unwrap_or_default();
        let state = match self.work.state() {
            State::Checking => named::MissionProgress::Checking,
            State::Refused => named::MissionProgress::Refused,
            State::Stuck => named::MissionProgress::Stuck,
            State::Damaged => named::MissionProgress::Damaged,
            State::Ready if progress.finished => named::MissionProgress::Finished,
            State::Ready if *running => named::MissionProgress::Driving,
            State::Ready => named::MissionProgress::Ready,
        };
        let number = |number: usize| number.min(4095) as u16;
        MissionState {
            state,
            purpose: match place.purpose {
                Purpose::Leg => named::MissionPurpose::Leg,
                Purpose::Turn => named::MissionPurpose::Turn,
                Purpose::Approach => named::MissionPurpose::Approach,
            },
            leg: number(place.leg),
            legs: number(self.work.count()),
            along: convert::rounded(place.along * 10.0).clamp(0, 65_535) as u16,
            sections,
        }
        .encode()
    }
}
