//! Missions: what the controller's task of low priority does for them, and its message.

use control::mission::{Outputs, Piece, Purpose, Section, Stretch, Switching};
use control::path::Progress;
use control::route::Route as _;
use firmware::convert;
use firmware::machine::Machine;
use firmware::mission::{self as missions, At, State, Stored, Told, Work};
use network::Message;

use crate::design::CONTROL_RELEASE;
use crate::messages::{self as named, Milliseconds, MissionState, SectionSwitching};
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
    let work = Work::new(Stored::read(words), &line, Uagv::SETTINGS.cruise, settings);
    pilot
        .law_mut()
        .follow(Stretch::new(work.origin(), settings.pace));
    Ok(Plan {
        work,
        outputs: all_off(),
    })
}

/// Sections that need no time, at the rear axle; all of them off. They are told of a cycle ahead.
fn all_off() -> Outputs<f32> {
    let release = CONTROL_RELEASE.to_micros() as f32 * 1e-6;
    let section = missions::lead(&Section::default(), Uagv::PERIOD, release);
    Outputs::new([section; 8])
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
    /// Whether the progress is that of the vehicle: before it has moved, nobody knows where it is.
    located: bool,
}

/// Looks at what the pilot does.
pub fn see(pilot: &Pilot) -> Seen {
    let law = pilot.law();
    Seen {
        route: *law.route(),
        progress: *law.progress(),
        speed: pilot.decision().tracking.speed,
        running: pilot.mode() == control::mode::Mode::AutonomousRun,
        located: law.is_located(),
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

    /// The messages about the mission and about the sections, from what the pilot does. Call it once in each basic cycle.
    // Not inlined: in the task, its loops would count as often as those of the planning.
    #[inline(never)]
    pub fn tell(&mut self, seen: &Seen) -> ([u8; 8], [u8; 8]) {
        let Seen {
            route,
            progress,
            speed,
            running,
            located,
        } = seen;
        let switching = if *running && *located {
            self.outputs.step(route, progress, *speed, Uagv::PERIOD)
        } else {
            self.outputs = all_off();
            Switching::default()
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
        let state = MissionState {
            state,
            purpose: match place.purpose {
                Purpose::Leg => named::MissionPurpose::Leg,
                Purpose::Turn => named::MissionPurpose::Turn,
                Purpose::Approach => named::MissionPurpose::Approach,
            },
            leg: number(place.leg),
            legs: number(self.work.count()),
            along: convert::rounded(place.along * 10.0).clamp(0, 65_535) as u16,
            sections: switching.now,
        };
        (
            state.encode(),
            sections(&missions::told(&switching)).encode(),
        )
    }
}

/// The message about the sections.
fn sections(told: &[Told; 8]) -> SectionSwitching {
    let [one, two, three, four, five, six, seven, eight] = *told;
    SectionSwitching {
        state1: one.on,
        after1: Milliseconds(one.after.into()),
        state2: two.on,
        after2: Milliseconds(two.after.into()),
        state3: three.on,
        after3: Milliseconds(three.after.into()),
        state4: four.on,
        after4: Milliseconds(four.after.into()),
        state5: five.on,
        after5: Milliseconds(five.after.into()),
        state6: six.on,
        after6: Milliseconds(six.after.into()),
        state7: seven.on,
        after7: Milliseconds(seven.after.into()),
        state8: eight.on,
        after8: Milliseconds(eight.after.into()),
    }
}
