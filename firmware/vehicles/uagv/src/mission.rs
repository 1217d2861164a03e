//! Missions: what the controller's task of low priority does for them, and their messages.

use control::dubins::Pose;
use control::fence::Point;
use control::mission::{Outputs, Piece, Purpose, Section, Stretch, Switching};
use control::path::Progress;
use control::route::Route as _;
use control::scalar::Scalar as _;
use firmware::convert;
use firmware::e2e::Secret;
use firmware::machine::Machine;
pub use firmware::mission::Shown;
use firmware::mission::store::{self, Place};
use firmware::mission::upload::{
    self, Effect, Event, Inbox, Job, Outcome, Reason, Session, Situation,
};
use firmware::mission::{
    self as missions, At, Stage, Standing, State, Stored, Stray, Told, Work, dropped,
};
use network::Message;
use ttcan::Frame;

use crate::design::CONTROL_RELEASE;
use crate::messages::{
    self as named, Milliseconds, MissionEvent, MissionRequest, MissionState, SectionSwitching,
};
use crate::{Pilot, Uagv};

/// Steps of the planning in a basic cycle. A turn needs some hundred of them, and a leg gives it seconds.
pub const STEPS: usize = 2;

/// Frames of requests that are read in a basic cycle.
pub const FRAMES: usize = 10;

/// Answers that are sent in a basic cycle, as message 532 may come twice in one.
pub const ANSWERS: usize = 2;

/// Standard deviations by which a place may be off.
const DEVIATIONS: f32 = 3.0;

/// Speed from which on the vehicle moves, m/s.
const MOVES: f32 = 0.1;

/// Room for an uploaded mission.
#[derive(Debug)]
pub struct Words([u32; upload::WORDS]);

impl Words {
    /// It, empty.
    #[allow(
        clippy::new_without_default,
        reason = "it is made where the program is compiled"
    )]
    pub const fn new() -> Self {
        Self([0; upload::WORDS])
    }
}

/// The frames of requests that nobody has read yet.
#[derive(Debug, Default)]
pub struct Requests(Inbox);

impl Requests {
    /// No requests yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Keeps a frame, if it belongs to a request.
    #[inline]
    pub fn push(&mut self, frame: &Frame) {
        if frame.id() == ttcan::Id::constant::<{ MissionRequest::ID }>() {
            self.0.push(frame.buffer(), frame.len());
        }
    }

    /// Takes the oldest.
    pub fn pop(&mut self) -> Option<([u8; 8], u8)> {
        self.0.pop()
    }
}

/// What lies in the flash.
#[derive(Clone, Copy, Debug)]
struct Kept {
    there: bool,
    number: u32,
    free: Place,
    next: u32,
}

/// The mission, the requests for it, and the sections of the implement.
pub struct Plan {
    work: Work,
    outputs: Outputs<f32>,
    session: Session,
    words: &'static mut [u32; upload::WORDS],
    kept: Kept,
    keyed: bool,
    /// What is known of the mission, and has been told as an event.
    told: State,
    events: u8,
}

/// What is to be written, by a node that starts anew afterwards.
#[derive(Debug)]
pub struct Written<'a> {
    /// Where.
    pub place: Place,
    /// The number of the mission.
    pub number: u32,
    /// Its record.
    pub record: &'a [u32],
}

/// Reads the mission from its place in the flash, and lets the pilot follow it. `words` are room for another one.
///
/// # Errors
/// The waypoints of the manifest make no line.
pub fn plan(
    pilot: &mut Pilot,
    flash: &'static [u32],
    words: &'static mut Words,
    secret: &Secret,
) -> Result<Plan, control::line::LineError> {
    let [from, to] = Uagv::ROUTE;
    let line = control::line::Line::new(from, to)?;
    let settings = crate::design::LAW.settings(&Uagv::SETTINGS);
    let found = store::find(flash);
    let kept = Kept {
        there: !matches!(found.stored, Stored::None),
        number: found.number,
        free: found.free,
        next: found.next,
    };
    let work = Work::new(found.stored, &line, Uagv::SETTINGS.cruise, settings);
    pilot
        .law_mut()
        .follow(Stretch::new(work.origin(), settings.pace));
    Ok(Plan {
        work,
        outputs: all_off(),
        session: Session::new(settings),
        words: &mut words.0,
        kept,
        keyed: *secret != Secret::None,
        told: State::Checking,
        events: 0,
    })
}

/// Sections that need no time, at the rear axle; all of them off. They are told of a cycle ahead.
fn all_off() -> Outputs<f32> {
    let release = CONTROL_RELEASE.to_micros() as f32 * 1e-6;
    let section = missions::lead(&Section::default(), Uagv::PERIOD, release);
    Outputs::new([section; 8])
}

/// What the vehicle does while requests are read.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    running: bool,
    idle: bool,
    moving: bool,
    paused: bool,
}

/// Looks at what the vehicle does.
pub fn look(pilot: &Pilot) -> Look {
    let speed = pilot.decision().tracking.speed;
    Look {
        running: pilot.mode() == control::mode::Mode::AutonomousRun,
        idle: pilot.may_restart(),
        moving: speed.abs() >= MOVES || speed.is_nan(),
        paused: pilot.law().route().is_paused(),
    }
}

/// Does what a request has changed.
pub fn apply(pilot: &mut Pilot, effect: Effect) {
    let law = pilot.law_mut();
    match effect {
        Effect::Start => {
            let (origin, pace) = (law.route().origin(), *law.route().pace());
            law.follow(Stretch::new(origin, pace));
        }
        Effect::Pause => law.route_mut().pause(),
        Effect::Resume => law.route_mut().resume(),
    }
}

/// Where the vehicle is. Forgets what lies behind it, and when a mission has been driven to its end, all of it.
pub fn at(pilot: &mut Pilot) -> At {
    let running = pilot.mode() == control::mode::Mode::AutonomousRun;
    let law = pilot.law_mut();
    // A pause ends with its run: the next one is the operator's.
    if !running {
        law.route_mut().resume();
    }
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
    /// How far it is beside its path, m.
    aside: f32,
    /// What is known of its place.
    standing: Standing,
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
        aside: pilot.decision().tracking.cross_track.abs(),
        standing: standing(pilot),
    }
}

/// Where the vehicle is.
fn standing(pilot: &Pilot) -> Standing {
    let law = pilot.law();
    let fixed = pilot.is_fixed();
    if law.is_located() {
        let estimate = law.estimator().estimate();
        let pose = Pose {
            north: estimate.north,
            east: estimate.east,
            heading: estimate.heading,
        };
        // By dead reckoning the place is less and less known.
        let off = if fixed {
            0.0
        } else {
            DEVIATIONS * law.estimator().largest_position_variance().root()
        };
        Standing::Pose(pose, off)
    } else if fixed {
        let position = pilot.decision().position;
        let (north, east) = position.metres_from(law.route().origin());
        let estimator = &Uagv::SETTINGS.estimator;
        let reach = crate::design::LAW
            .footprint()
            .reach_about(estimator.geometry.l1, estimator.antenna.right);
        Standing::Antenna(Point { north, east }, reach)
    } else {
        Standing::Unknown
    }
}

/// Adds a piece to the path.
pub fn push(pilot: &mut Pilot, piece: Piece<f32>) {
    // There was room, and nobody else adds.
    let _ = pilot.law_mut().route_mut().push(piece);
}

impl Plan {
    fn situation(&self, look: Look) -> Situation {
        let refused = match (self.work.state(), self.work.violation(), self.work.stuck()) {
            (_, Some(violation), _) => Reason::of_violation(&violation),
            (_, _, Some((leg, error))) => (
                Reason::of_turn(error),
                leg.min(usize::from(u16::MAX)) as u16,
            ),
            (State::Damaged, ..) => (Reason::Format, 0),
            _ => (Reason::None, 0),
        };
        Situation {
            keyed: self.keyed,
            running: look.running,
            idle: look.idle,
            moving: look.moving,
            paused: look.paused,
            there: self.kept.there,
            ready: self.work.state() == State::Ready,
            refused,
            number: self.kept.number as u8,
        }
    }

    /// Reads a frame of a request, if there is one. Returns what it changes at once.
    // Not inlined: the loop about it would count its loops as often as its own.
    #[inline(never)]
    pub fn read(&mut self, frame: Option<([u8; 8], u8)>, look: Look) -> Option<Effect> {
        let (data, length) = frame?;
        let data = data.get(..usize::from(length))?;
        let now = self.situation(look);
        let effect = self.session.take(data, self.words, &now);
        if effect == Some(Effect::Start) {
            self.work.restart();
        }
        effect
    }

    /// The next frame of an answer.
    pub fn answer(&mut self) -> Option<[u8; 8]> {
        self.session.answer()
    }

    /// The next event: a request was refused or done, or the mission in the flash was judged.
    #[inline(never)]
    pub fn event(&mut self, look: Look) -> Option<[u8; 8]> {
        let state = self.work.state();
        let judged = self.told != state;
        let (subject, outcome, reason, leg) = if let Some(event) = self.session.event() {
            let Event {
                request,
                outcome,
                reason,
                leg,
            } = event;
            (request.code(), outcome, reason, leg)
        } else if judged {
            self.told = state;
            let (reason, leg) = self.situation(look).refused;
            let outcome = if reason == Reason::None {
                Outcome::Done
            } else {
                Outcome::Refused
            };
            (0, outcome, reason, leg)
        } else {
            return None;
        };
        self.events = self.events.wrapping_add(1);
        let event = MissionEvent {
            subject: named::MissionSubject::from_raw(subject)?,
            outcome: named::MissionOutcome::from_raw(outcome.code())?,
            reason: named::MissionReason::from_raw(reason.code())?,
            leg,
            number: self.kept.number as u16,
            counter: self.events,
        };
        Some(event.encode())
    }

    /// Whether an uploaded mission is being checked; its steps take the place of the planning's.
    pub fn is_checking(&self) -> bool {
        self.session.is_busy()
    }

    /// A step of the check of an uploaded mission.
    #[inline(never)]
    pub fn check(&mut self, look: Look) {
        let now = self.situation(look);
        self.session.step(self.words.as_slice(), &now);
    }

    /// Time passes. Returns what is to be written now. Call it once in each basic cycle.
    #[inline(never)]
    pub fn written(&mut self, look: Look) -> Option<Written<'_>> {
        let now = self.situation(look);
        let length = match self.session.tell(&now)? {
            Job::Store(length) => length,
            Job::Drop => {
                let record = dropped();
                // loop-bound: 6. The words of a record without legs.
                for (to, from) in self.words.iter_mut().skip(1).zip(record) {
                    *to = from;
                }
                record.len()
            }
        };
        Some(Written {
            place: self.kept.free,
            number: self.kept.next,
            record: self.words.get(1..)?.get(..length)?,
        })
    }

    /// A step of the planning. Returns a piece of the path, once.
    #[inline(never)]
    pub fn step(&mut self, at: At) -> Option<Piece<f32>> {
        self.work.step(at)
    }

    /// Why the vehicle must not drive by itself where it is, if so.
    pub fn strays(&self, seen: &Seen) -> Option<firmware::pilot::Reason> {
        Some(match self.work.strays(&seen.standing)? {
            Stray::Fence => firmware::pilot::Reason::Fence,
            Stray::Far => firmware::pilot::Reason::FarOff,
        })
    }

    /// What the operator sees of the mission.
    #[inline(never)]
    pub fn shown(&self, seen: &Seen, look: Look) -> Shown {
        let place = seen.route.whereabouts(&seen.progress).unwrap_or_default();
        let (reason, at_fault) = self.situation(look).refused;
        let small = |number: usize| number.min(usize::from(u16::MAX - 1)) as u16;
        let request = self.session.last();
        Shown {
            number: self.kept.number as u16,
            stage: match self.work.state() {
                State::Checking => Stage::Checking,
                State::Refused | State::Stuck | State::Damaged => Stage::Refused(reason),
                State::Ready if seen.progress.finished => Stage::Finished,
                State::Ready if seen.running && seen.route.is_paused() => Stage::Paused,
                State::Ready if seen.running => Stage::Driving,
                State::Ready => Stage::Ready,
            },
            leg: if reason == Reason::None {
                small(place.leg)
            } else {
                at_fault
            },
            legs: small(self.work.count()),
            request: (request != Reason::None).then_some(request),
        }
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
            aside,
            ..
        } = seen;
        let works = *running && *located && *aside <= crate::design::LAW.aside;
        let switching = if works {
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
            State::Ready if *running && route.is_paused() => named::MissionProgress::Paused,
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
