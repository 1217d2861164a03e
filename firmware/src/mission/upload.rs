//! Requests from the bus: a mission is uploaded, checked, started, paused, resumed or dropped.
//!
//! A request is a message of ISO 15765-2 ([`super::transport`]), and so is each answer:
//!
//! | byte | of a request | of an answer |
//! | --- | --- | --- |
//! | 0 | what is asked ([`Request`]) | the same |
//! | 1 | number of the question, which its asker chooses | the same |
//! | 2 | 0 | [`Outcome`] |
//! | 3 | 0 | [`Reason`] |
//! | 4, 5 | the record of a mission from here on | a leg, counted from 0 |
//! | 6 | | low byte of the mission's number |
//!
//! A short request has the first two bytes only. An uploaded record lies in RAM until it has passed the check that
//! [`super::Work`] does; until then nothing has changed. Then the node leaves the bus, writes it and starts anew
//! ([`super::store`]), and only while the vehicle stands outside of a run.
//!
//! Nothing here sets a vehicle in motion that its operator has not set to a run: a mission is the one of the *next*
//! run, and a pause ends only within the run in which it began.
//!
//! Anybody on the bus could forge a request. So a node with a key ([`crate::e2e`]) refuses all but the question for
//! its state: the messages have no room for a tag. There a mission comes by the debug probe.

use control::fence::{FenceError, ObstacleError};
use control::mission::{Check, Fault, MissionSettings, Violation};
use control::turn::TurnError;
use heapless::Deque;

use super::record::{Head, Verification};
use super::transport::{self, Failure, Heard, Receiver};

/// Words of RAM for an uploaded mission: 4 bytes of the request, then a record.
pub const WORDS: usize = 5120;

/// Frames that may wait for [`Session::take`]: a block, and two requests of other programs.
const FRAMES: usize = transport::BLOCK as usize + 2;

/// Answers that may wait until they are sent.
const WAITING: usize = 4;

/// Calls of [`Session::step`] between the last answer and the moment at which the node leaves the bus: the answer is
/// on the bus by then, if the bus works.
const FAREWELL: u8 = 5;

/// Calls of [`Session::tell`] between two answers that tell of the check.
const TELLS: u8 = 10;

/// What is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// What the vehicle does of its mission.
    State,
    /// Check this mission, and keep it.
    Upload,
    /// Check this mission, and forget it.
    Check,
    /// The next run begins with the first leg.
    Start,
    /// The vehicle stops on its path.
    Pause,
    /// It drives on.
    Resume,
    /// There is no mission any more.
    Drop,
}

impl Request {
    /// All of them, by their codes from 1 on.
    pub const ALL: [Self; 7] = [
        Self::State,
        Self::Upload,
        Self::Check,
        Self::Start,
        Self::Pause,
        Self::Resume,
        Self::Drop,
    ];

    /// Its code.
    pub const fn code(self) -> u8 {
        self as u8 + 1
    }

    /// The request with this code.
    pub const fn of(code: u8) -> Option<Self> {
        Some(match code {
            1 => Self::State,
            2 => Self::Upload,
            3 => Self::Check,
            4 => Self::Start,
            5 => Self::Pause,
            6 => Self::Resume,
            7 => Self::Drop,
            _ => return None,
        })
    }

    const fn has_record(self) -> bool {
        matches!(self, Self::Upload | Self::Check)
    }
}

/// What becomes of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// It is done; of an upload: it will be written now.
    Done,
    /// The mission is being checked.
    Checking,
    /// It is refused, and nothing has changed.
    Refused,
}

impl Outcome {
    /// Its code.
    pub const fn code(self) -> u8 {
        self as u8
    }

    /// The outcome with this code.
    pub const fn of(code: u8) -> Option<Self> {
        Some(match code {
            0 => Self::Done,
            1 => Self::Checking,
            2 => Self::Refused,
            _ => return None,
        })
    }
}

/// Names each code with its reason, in a word or two for the display, and in a part of a sentence.
macro_rules! reasons {
    ($($(#[$doc:meta])* $name:ident = $code:literal, $short:literal, $text:literal;)*) => {
        /// Why a request or a mission is refused.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[cfg_attr(feature = "target", derive(defmt::Format))]
        #[repr(u8)]
        pub enum Reason {
            $($(#[$doc])* $name = $code,)*
        }

        impl Reason {
            /// All of them.
            pub const ALL: &'static [Self] = &[$(Self::$name,)*];

            /// Its code.
            pub const fn code(self) -> u8 {
                self as u8
            }

            /// In up to 10 characters, for the display.
            pub const fn short(self) -> &'static str {
                match self {
                    $(Self::$name => $short,)*
                }
            }

            /// In words, as a part of a sentence.
            pub const fn text(self) -> &'static str {
                match self {
                    $(Self::$name => $text,)*
                }
            }
        }
    };
}

reasons! {
    /// It is not refused.
    None = 0, "nothing", "nothing is wrong";
    /// There is no such request.
    Unknown = 1, "request", "the vehicle does not know the request";
    /// The nodes have a key, and requests have no tag.
    Key = 2, "key", "the nodes have a key: a mission then comes by the debug probe";
    /// An uploaded mission is being checked or written.
    Busy = 3, "busy", "an uploaded mission is being checked or written";
    /// A run goes, or somebody drives the vehicle.
    Running = 4, "in a run", "the vehicle is driven: end the run first";
    /// The vehicle moves.
    Moving = 5, "moving", "the vehicle moves";
    /// No run goes.
    NoRun = 6, "no run", "no run goes";
    /// The run is not paused.
    NotPaused = 7, "not paused", "the run is not paused";
    /// There is no mission.
    NoMission = 8, "no mission", "the vehicle has no mission";
    /// The mission is being checked, was refused, or ends in the middle.
    NotReady = 9, "not ready", "the mission cannot be driven, or is still being checked";
    /// A frame was lost or came twice.
    Sequence = 16, "frame lost", "a frame was lost on the way";
    /// The sender has stopped in the middle.
    Silence = 17, "cut off", "the upload has stopped in the middle";
    /// Another request came before the end.
    Interrupted = 18, "cut short", "another request came before the end of the upload";
    /// It is longer than the RAM for it.
    TooLong = 19, "too long", "it is longer than an upload may be: the debug probe writes longer ones";
    /// It is no record of this format, or is damaged.
    Format = 20, "damaged", "it is no record of a mission, or damaged";
    /// The vehicle's own settings are not usable.
    Settings = 32, "settings", "the vehicle's settings are not usable";
    /// The number of legs.
    Count = 33, "legs", "it has no leg or too many";
    /// The corners of the fence.
    Fence = 34, "fence", "its fence is not usable";
    /// [`Fault::NotFinite`].
    NotFinite = 35, "number", "a number is not finite";
    /// [`Fault::TooFar`].
    TooFar = 36, "too far", "it is too far from the origin";
    /// [`Fault::Length`].
    Length = 37, "length", "it is too short or too long";
    /// [`Fault::Speed`].
    Speed = 38, "speed", "its speed is too low or too high for the vehicle";
    /// [`Fault::Curvature`].
    Curvature = 39, "curvature", "its curvature is more than the vehicle can steer";
    /// [`Fault::Sharpness`].
    Sharpness = 40, "sharpness", "its curvature changes faster than the steering";
    /// [`Fault::Outside`].
    Outside = 41, "off fence", "the vehicle would leave the fence";
    /// [`Fault::JoinPosition`].
    JoinPosition = 42, "gap", "the next leg does not begin where it ends";
    /// [`Fault::JoinHeading`].
    JoinHeading = 43, "kink", "the next leg does not begin with its last heading";
    /// [`Fault::JoinCurvature`].
    JoinCurvature = 44, "bend", "the next leg or turn does not begin with its last curvature";
    /// [`Fault::Turn`]: there is no room for it.
    NoRoom = 45, "turn room", "there is no room for the turn to the next leg";
    /// [`Fault::Turn`]: it is not usable otherwise.
    Turn = 46, "turn", "there is no turn to the next leg";
    /// The corners of the obstacles.
    Obstacles = 47, "obstacles", "its obstacles are not usable";
    /// [`Fault::Obstacle`].
    Obstacle = 48, "obstacle", "the vehicle would touch an obstacle";
    /// [`FenceError::Crossing`].
    FenceCrossing = 49, "fence knot", "two sides of its fence meet";
    /// [`ObstacleError::Crossing`].
    ObstacleCrossing = 50, "knot", "two sides of one of its obstacles meet";
    /// [`Violation::Origin`].
    Origin = 51, "origin", "its origin is too far from the base station";
}

impl Reason {
    /// The reason with this code.
    pub fn of(code: u8) -> Option<Self> {
        Self::ALL
            .iter()
            .copied()
            .find(|reason| reason.code() == code)
    }

    /// Whether it is of a leg, and not of the mission as a whole.
    pub const fn is_of_leg(self) -> bool {
        matches!(
            self,
            Self::NotFinite
                | Self::TooFar
                | Self::Length
                | Self::Speed
                | Self::Curvature
                | Self::Sharpness
                | Self::Outside
                | Self::Obstacle
                | Self::JoinPosition
                | Self::JoinHeading
                | Self::JoinCurvature
                | Self::NoRoom
                | Self::Turn
        )
    }

    const fn of_failure(failure: Failure) -> Self {
        match failure {
            Failure::Sequence => Self::Sequence,
            Failure::Silence => Self::Silence,
            Failure::Interrupted => Self::Interrupted,
            Failure::TooLong => Self::TooLong,
        }
    }

    /// Why a mission cannot be driven, and its leg at fault.
    pub fn of_violation(violation: &Violation) -> (Self, u16) {
        let place = |number: usize| number.min(usize::from(u16::MAX)) as u16;
        match *violation {
            Violation::Settings => (Self::Settings, 0),
            Violation::Count(_) => (Self::Count, 0),
            Violation::Origin => (Self::Origin, 0),
            Violation::Fence(FenceError::Corner(number)) => (Self::Fence, place(number)),
            Violation::Fence(FenceError::Crossing(number)) => (Self::FenceCrossing, place(number)),
            Violation::Fence(_) => (Self::Fence, 0),
            Violation::Obstacles(ObstacleError::Corner(number)) => (Self::Obstacles, place(number)),
            Violation::Obstacles(ObstacleError::Crossing(number)) => {
                (Self::ObstacleCrossing, place(number))
            }
            Violation::Obstacles(_) => (Self::Obstacles, 0),
            Violation::Leg { number, fault } => {
                let reason = match fault {
                    Fault::NotFinite => Self::NotFinite,
                    Fault::TooFar => Self::TooFar,
                    Fault::Length => Self::Length,
                    Fault::Speed => Self::Speed,
                    Fault::Curvature => Self::Curvature,
                    Fault::Sharpness => Self::Sharpness,
                    Fault::Outside => Self::Outside,
                    Fault::Obstacle => Self::Obstacle,
                    Fault::JoinPosition => Self::JoinPosition,
                    Fault::JoinHeading => Self::JoinHeading,
                    Fault::JoinCurvature => Self::JoinCurvature,
                    Fault::Turn(error) => Self::of_turn(error),
                };
                (reason, place(number))
            }
        }
    }

    /// Why there is no turn.
    pub const fn of_turn(error: TurnError) -> Self {
        match error {
            TurnError::NoRoom => Self::NoRoom,
            TurnError::Settings | TurnError::Pose => Self::Turn,
        }
    }
}

/// What the vehicle does while a request comes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Situation {
    /// The nodes have a key, or a damaged one.
    pub keyed: bool,
    /// An autonomous run goes.
    pub running: bool,
    /// Nobody commands the actuators, and no stop is latched that a start would forget.
    pub idle: bool,
    /// The vehicle moves.
    pub moving: bool,
    /// The run is paused.
    pub paused: bool,
    /// There is a mission in the flash.
    pub there: bool,
    /// The mission, or without one the line, can be driven.
    pub ready: bool,
    /// Why it cannot, and the leg at fault.
    pub refused: (Reason, u16),
    /// Low byte of the number of the mission in the flash.
    pub number: u8,
}

/// What a request changes at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect {
    /// The next run begins with the first leg.
    Start,
    /// The vehicle stops on its path.
    Pause,
    /// It drives on.
    Resume,
}

/// What is to be written into the flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Job {
    /// The record of so many words behind the first word of the uploaded ones.
    Store(usize),
    /// That there is no mission.
    Drop,
}

/// A change or a refusal, for loggers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Event {
    /// What was asked.
    pub request: Request,
    /// What became of it.
    pub outcome: Outcome,
    /// Why it was refused.
    pub reason: Reason,
    /// The leg at fault.
    pub leg: u16,
}

/// The frames of requests, between the interrupt that receives them and the task that reads them.
#[derive(Clone, Debug, Default)]
pub struct Inbox {
    frames: Deque<([u8; 8], u8), FRAMES>,
}

impl Inbox {
    /// Keeps the data of a frame. If there is no room it is lost, which the number of the next one shows.
    #[inline]
    pub fn push(&mut self, data: [u8; 8], length: u8) {
        let _ = self.frames.push_back((data, length));
    }

    /// Takes the oldest.
    pub fn pop(&mut self) -> Option<([u8; 8], u8)> {
        self.frames.pop_front()
    }
}

#[derive(Clone, Debug)]
#[allow(
    clippy::large_enum_variant,
    reason = "one value for the whole program; a target has no heap"
)]
enum Stage {
    Free,
    /// All bytes have come.
    Whole {
        /// Words of the record.
        length: usize,
        verification: Verification,
    },
    Checking {
        head: Head,
        check: Check<f32>,
        tells: u8,
    },
    Leaving {
        job: Job,
        left: u8,
    },
}

/// The requests of the bus, one after the other.
#[derive(Clone, Debug)]
pub struct Session {
    receiver: Receiver,
    settings: MissionSettings<f32>,
    stage: Stage,
    /// The request whose mission is being checked or written, and the number of the question.
    asked: (Request, u8),
    answers: Deque<[u8; 8], WAITING>,
    event: Option<Event>,
    /// Frames have come since the last call of [`Session::tell`].
    heard: bool,
    /// Why the last mission or request was refused.
    last: Reason,
}

impl Session {
    /// Nothing has been asked yet.
    pub const fn new(settings: MissionSettings<f32>) -> Self {
        Self {
            receiver: Receiver::new(),
            settings,
            stage: Stage::Free,
            asked: (Request::State, 0),
            answers: Deque::new(),
            event: None,
            heard: false,
            last: Reason::None,
        }
    }

    /// Why the last request was refused, for the operator; [`Reason::None`] if it was not.
    pub const fn last(&self) -> Reason {
        self.last
    }

    /// True while a mission is being checked or written.
    pub const fn is_busy(&self) -> bool {
        !matches!(self.stage, Stage::Free)
    }

    /// Bytes so far of a mission that is coming, and how many it will have.
    pub const fn progress(&self) -> Option<(usize, usize)> {
        self.receiver.progress()
    }

    /// The next frame to be sent.
    pub fn answer(&mut self) -> Option<[u8; 8]> {
        self.answers.pop_front()
    }

    /// The event that loggers have not been sent yet; it is handed out once.
    pub fn event(&mut self) -> Option<Event> {
        self.event.take()
    }

    /// Takes the data of a frame with requests; long ones are written into `words`.
    // Not inlined: the loop about it has its bound.
    #[inline(never)]
    pub fn take(&mut self, data: &[u8], words: &mut [u32], now: &Situation) -> Option<Effect> {
        self.heard = true;
        // What is checked or written stays as it is.
        let room = if self.is_busy() { 0 } else { words.len() * 4 };
        let before = self.receiver.progress().is_some();
        let heard = self.receiver.take(data, words, room);
        let again = matches!(
            heard,
            Heard::Single(..) | Heard::Begun { .. } | Heard::Failed(Failure::TooLong)
        );
        if before && again {
            self.fail(Failure::Interrupted, now);
        }
        match heard {
            Heard::Nothing => None,
            Heard::Single([code, round, ..], length) if length >= 2 => self.short(code, round, now),
            Heard::Single(..) => {
                self.refuse(Request::State, 0, Reason::Unknown, 0, now);
                None
            }
            Heard::Begun { .. } => {
                let bytes = words.first().map_or([0; 4], |word| word.to_le_bytes());
                let [code, round, ..] = bytes;
                self.asked = (Request::of(code).unwrap_or(Request::State), round);
                match self.bar(self.asked.0, now) {
                    Some(reason) => {
                        let (request, round) = self.asked;
                        self.receiver = Receiver::new();
                        self.send(transport::overflow());
                        self.refuse(request, round, reason, 0, now);
                    }
                    None => self.send(transport::clear_to_send()),
                }
                None
            }
            Heard::Block => {
                self.send(transport::clear_to_send());
                None
            }
            Heard::Failed(Failure::TooLong) => {
                self.send(transport::overflow());
                let reason = if self.is_busy() {
                    Reason::Busy
                } else {
                    Reason::TooLong
                };
                self.refuse(Request::Upload, 0, reason, 0, now);
                None
            }
            Heard::Failed(failure) => {
                self.fail(failure, now);
                None
            }
            Heard::Whole { length } => {
                self.whole(length, now);
                None
            }
        }
    }

    /// Why nobody may upload now.
    const fn bar(&self, request: Request, now: &Situation) -> Option<Reason> {
        Some(if now.keyed {
            Reason::Key
        } else if !request.has_record() {
            Reason::Unknown
        } else if now.running || !now.idle {
            Reason::Running
        } else {
            return None;
        })
    }

    /// A message has not come whole.
    fn fail(&mut self, failure: Failure, now: &Situation) {
        let (request, round) = self.asked;
        self.refuse(request, round, Reason::of_failure(failure), 0, now);
    }

    /// A request of one frame.
    fn short(&mut self, code: u8, round: u8, now: &Situation) -> Option<Effect> {
        let Some(request) = Request::of(code) else {
            self.refuse(Request::State, round, Reason::Unknown, 0, now);
            return None;
        };
        let none = (Reason::None, None);
        let (reason, effect) = match request {
            Request::State => {
                let (reason, leg) = now.refused;
                self.say(request, round, Outcome::Done, reason, leg, now);
                return None;
            }
            _ if now.keyed => (Reason::Key, None),
            Request::Upload | Request::Check => (Reason::Format, None),
            _ if self.is_busy() => (Reason::Busy, None),
            Request::Start if now.running => (Reason::Running, None),
            Request::Start if !now.ready => (Reason::NotReady, None),
            Request::Start => (Reason::None, Some(Effect::Start)),
            Request::Pause | Request::Resume if !now.running => (Reason::NoRun, None),
            Request::Pause => (Reason::None, Some(Effect::Pause)),
            Request::Resume if !now.paused => (Reason::NotPaused, None),
            Request::Resume => (Reason::None, Some(Effect::Resume)),
            Request::Drop if !now.there => (Reason::NoMission, None),
            Request::Drop => match may_write(now) {
                Some(reason) => (reason, None),
                None => {
                    self.asked = (request, round);
                    self.leave(Job::Drop);
                    none
                }
            },
        };
        if reason == Reason::None {
            self.done(request, round, now);
        } else {
            self.refuse(request, round, reason, 0, now);
        }
        effect
    }

    /// A mission has come whole.
    fn whole(&mut self, length: usize, now: &Situation) {
        let (request, round) = self.asked;
        // The operator may have begun a run meanwhile.
        if let Some(reason) = self.bar(request, now) {
            self.refuse(request, round, reason, 0, now);
        } else if !length.is_multiple_of(4) {
            self.refuse(request, round, Reason::Format, 0, now);
        } else {
            self.stage = Stage::Whole {
                length: length / 4 - 1,
                verification: Verification::default(),
            };
            self.say(request, round, Outcome::Checking, Reason::None, 0, now);
        }
    }

    /// A short step of the check, if one is going on.
    // Not inlined: in the task, its loops would count as often as those of the planning.
    #[inline(never)]
    pub fn step(&mut self, words: &[u32], now: &Situation) {
        let record = words.get(1..).unwrap_or_default();
        let (request, round) = self.asked;
        match &mut self.stage {
            Stage::Free | Stage::Leaving { .. } => {}
            Stage::Whole {
                length,
                verification,
            } => {
                let record = record.get(..*length).unwrap_or_default();
                let Some(whole) = verification.step(record) else {
                    return;
                };
                let head = Head::parse(record)
                    .filter(|head| whole && head.legs() > 0 && head.length() == record.len());
                self.stage = Stage::Free;
                match head {
                    None => self.refuse(request, round, Reason::Format, 0, now),
                    Some(head) => {
                        self.stage = Stage::Checking {
                            head,
                            check: Check::new(self.settings),
                            tells: 0,
                        };
                    }
                }
            }
            Stage::Checking { head, check, .. } => {
                if let Some(result) = check.step(&head.of(record)) {
                    let length = head.length();
                    self.stage = Stage::Free;
                    self.judge(result.err(), length, now);
                }
            }
        }
    }

    /// The check has ended.
    fn judge(&mut self, violation: Option<Violation>, length: usize, now: &Situation) {
        let (request, round) = self.asked;
        if let Some(violation) = violation {
            let (reason, leg) = Reason::of_violation(&violation);
            self.refuse(request, round, reason, leg, now);
        } else if request == Request::Check {
            self.done(request, round, now);
        } else if let Some(reason) = may_write(now) {
            self.refuse(request, round, reason, 0, now);
        } else {
            self.leave(Job::Store(length));
            self.done(request, round, now);
        }
    }

    fn leave(&mut self, job: Job) {
        self.stage = Stage::Leaving {
            job,
            left: FAREWELL,
        };
    }

    /// Time passes: call it once in each basic cycle, behind the frames of it. Returns what is to be written now, by a
    /// node that starts anew afterwards.
    pub fn tell(&mut self, now: &Situation) -> Option<Job> {
        if !core::mem::take(&mut self.heard)
            && let Heard::Failed(failure) = self.receiver.wait()
        {
            self.fail(failure, now);
        }
        match &mut self.stage {
            Stage::Free | Stage::Whole { .. } => None,
            Stage::Checking { check, tells, .. } => {
                *tells += 1;
                if *tells >= TELLS {
                    *tells = 0;
                    let leg = check.number().min(usize::from(u16::MAX)) as u16;
                    let (request, round) = self.asked;
                    self.say(request, round, Outcome::Checking, Reason::None, leg, now);
                }
                None
            }
            Stage::Leaving { job, left } => {
                *left = left.saturating_sub(1);
                if *left > 0 {
                    return None;
                }
                let job = *job;
                self.stage = Stage::Free;
                let (request, round) = self.asked;
                // The operator may have begun a run meanwhile.
                match may_write(now) {
                    Some(reason) => {
                        self.refuse(request, round, reason, 0, now);
                        None
                    }
                    None => Some(job),
                }
            }
        }
    }

    fn done(&mut self, request: Request, round: u8, now: &Situation) {
        self.last = Reason::None;
        self.event = Some(Event {
            request,
            outcome: Outcome::Done,
            reason: Reason::None,
            leg: 0,
        });
        self.say(request, round, Outcome::Done, Reason::None, 0, now);
    }

    fn refuse(&mut self, request: Request, round: u8, reason: Reason, leg: u16, now: &Situation) {
        self.last = reason;
        self.event = Some(Event {
            request,
            outcome: Outcome::Refused,
            reason,
            leg,
        });
        self.say(request, round, Outcome::Refused, reason, leg, now);
    }

    fn say(
        &mut self,
        request: Request,
        round: u8,
        outcome: Outcome,
        reason: Reason,
        leg: u16,
        now: &Situation,
    ) {
        let [low, high] = leg.to_le_bytes();
        let outcome = outcome.code();
        let answer = [
            request.code(),
            round,
            outcome,
            reason.code(),
            low,
            high,
            now.number,
        ];
        self.send(transport::single(&answer));
    }

    /// Sends a frame. One that finds no room is lost: whoever asks so much asks again.
    fn send(&mut self, frame: [u8; 8]) {
        let _ = self.answers.push_back(frame);
    }
}

/// Why the flash may not be written now.
const fn may_write(now: &Situation) -> Option<Reason> {
    Some(if now.running || !now.idle {
        Reason::Running
    } else if now.moving {
        Reason::Moving
    } else {
        return None;
    })
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use control::fence::Point;
    use control::mission::{End, Legs};
    use control::position::Position;

    use super::super::example;
    use super::super::record::words;
    use super::super::transport::Sender;
    use super::*;

    const STANDS: Situation = Situation {
        keyed: false,
        running: false,
        idle: true,
        moving: false,
        paused: false,
        there: true,
        ready: true,
        refused: (Reason::None, 0),
        number: 7,
    };
    const RUNS: Situation = Situation {
        running: true,
        idle: false,
        moving: true,
        ..STANDS
    };

    /// The request with a mission of so many straight legs with this curvature.
    fn request(request: Request, legs: u16, curvature: f32) -> Vec<u8> {
        let legs: Vec<_> = (0..legs)
            .map(|number| example::northwards(number, curvature))
            .collect();
        let mission = Legs {
            origin: Position::new(1, 2),
            legs: &legs,
            fence: &[(-9.0, -9.0), (900.0, -9.0), (900.0, 9.0), (-9.0, 9.0)]
                .map(|(north, east)| Point { north, east }),
            obstacles: &[],
            end: End::Stop,
        };
        let head = u32::from_le_bytes([request.code(), 42, 0, 0]);
        let words = core::iter::once(head).chain(words(&mission).unwrap());
        words.flat_map(u32::to_le_bytes).collect()
    }

    /// An answer.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    struct Said(u8, u8, Outcome, Reason, u16);

    struct Node {
        session: Session,
        words: Vec<u32>,
        said: Vec<Said>,
        flow: Vec<[u8; 8]>,
        effects: Vec<Effect>,
        jobs: Vec<Job>,
    }

    impl Node {
        fn new() -> Self {
            Self {
                session: Session::new(example::settings()),
                words: std::vec![0; WORDS],
                said: Vec::new(),
                flow: Vec::new(),
                effects: Vec::new(),
                jobs: Vec::new(),
            }
        }

        /// A basic cycle with these frames.
        fn cycle(&mut self, frames: &[[u8; 8]], now: &Situation) {
            for frame in frames {
                let effect = self.session.take(frame, &mut self.words, now);
                self.effects.extend(effect);
            }
            while let Some(frame) = self.session.answer() {
                match frame {
                    [7, code, round, outcome, reason, low, high, number] => {
                        assert_eq!(number, 7);
                        self.said.push(Said(
                            code,
                            round,
                            Outcome::of(outcome).unwrap(),
                            Reason::of(reason).unwrap(),
                            u16::from_le_bytes([low, high]),
                        ));
                    }
                    flow => self.flow.push(flow),
                }
            }
            for _ in 0..4 {
                self.session.step(&self.words, now);
            }
            self.jobs.extend(self.session.tell(now));
        }

        /// Sends a message as a program does, up to this share of it.
        fn send(&mut self, message: &[u8], share: usize, now: &Situation) {
            let mut sender = Sender::new(message);
            let mut frames = Vec::new();
            for _ in 0..10_000 {
                frames.clear();
                while frames.len() < 6 && sender.progress().0 < share {
                    let Some(frame) = sender.frame() else { break };
                    frames.push(frame);
                }
                self.cycle(&frames, now);
                let refused = self.flow.drain(..).any(|flow| sender.flow(&flow).is_err());
                if refused || (sender.progress().0 >= share && frames.is_empty()) {
                    break;
                }
            }
        }

        fn ask(&mut self, request: Request, now: &Situation) -> Said {
            self.cycle(&[transport::single(&[request.code(), 9])], now);
            self.said.pop().unwrap()
        }

        fn wait(&mut self, cycles: usize, now: &Situation) {
            for _ in 0..cycles {
                self.cycle(&[], now);
            }
        }
    }

    const UPLOAD: u8 = Request::Upload.code();

    #[test]
    fn a_mission_that_can_be_driven_is_written() {
        let mut node = Node::new();
        let message = request(Request::Upload, 20, 0.0);
        node.send(&message, message.len(), &STANDS);
        node.wait(100, &STANDS);
        let done = Said(UPLOAD, 42, Outcome::Done, Reason::None, 0);
        assert_eq!(node.said.last(), Some(&done));
        assert_eq!(
            node.said[0],
            Said(UPLOAD, 42, Outcome::Checking, Reason::None, 0)
        );
        let [Job::Store(length)] = node.jobs[..] else {
            panic!("{:?}", node.jobs);
        };
        let kept = node.words[1..=length]
            .iter()
            .flat_map(|word| word.to_le_bytes());
        assert_eq!(kept.collect::<Vec<u8>>(), message[4..]);
        assert_eq!(node.session.last(), Reason::None);
    }

    #[test]
    fn a_mission_that_is_only_checked_is_not_written() {
        let mut node = Node::new();
        let message = request(Request::Check, 3, 0.0);
        node.send(&message, message.len(), &STANDS);
        node.wait(100, &STANDS);
        let done = Said(Request::Check.code(), 42, Outcome::Done, Reason::None, 0);
        assert_eq!(node.said.last(), Some(&done));
        assert!(node.jobs.is_empty());
    }

    #[test]
    fn a_mission_that_cannot_be_driven_is_refused_with_its_leg() {
        let mut node = Node::new();
        let mut message = request(Request::Upload, 5, 0.0);
        node.send(&request(Request::Upload, 5, 0.9), message.len(), &STANDS);
        node.wait(50, &STANDS);
        let refused = |reason, leg| Said(UPLOAD, 42, Outcome::Refused, reason, leg);
        assert_eq!(node.said.pop(), Some(refused(Reason::Curvature, 0)));
        // Beyond the fence, from some leg on.
        let long = request(Request::Upload, 100, 0.0);
        node.send(&long, long.len(), &STANDS);
        node.wait(200, &STANDS);
        assert_eq!(node.said.pop(), Some(refused(Reason::Outside, 89)));
        message[100] ^= 1;
        node.send(&message, message.len(), &STANDS);
        node.wait(50, &STANDS);
        assert_eq!(node.said.pop(), Some(refused(Reason::Format, 0)));
        assert!(node.jobs.is_empty() && node.effects.is_empty());
        assert_eq!(node.session.last(), Reason::Format);
    }

    #[test]
    fn half_an_upload_changes_nothing() {
        let message = request(Request::Upload, 20, 0.0);
        for share in [1, 10, 100, message.len() - 1] {
            let mut node = Node::new();
            node.send(&message, share, &STANDS);
            node.wait(30, &STANDS);
            let refused = Said(UPLOAD, 42, Outcome::Refused, Reason::Silence, 0);
            // The last frame has up to seven bytes.
            if share < message.len() - 7 {
                assert!(node.jobs.is_empty());
                assert_eq!(node.said, [refused], "{share}");
            }
        }
        let mut node = Node::new();
        node.send(&message, 100, &STANDS);
        node.ask(Request::State, &STANDS);
        assert_eq!(
            node.said,
            [Said(UPLOAD, 42, Outcome::Refused, Reason::Interrupted, 0)]
        );
    }

    #[test]
    fn nothing_is_uploaded_while_the_vehicle_is_driven() {
        let message = request(Request::Upload, 20, 0.0);
        let manual = Situation {
            idle: false,
            ..STANDS
        };
        for now in [RUNS, manual] {
            let mut node = Node::new();
            node.send(&message, message.len(), &now);
            let refused = Said(UPLOAD, 42, Outcome::Refused, Reason::Running, 0);
            assert_eq!(node.said, [refused]);
            // A run that begins during the upload, during the check, and before the writing.
            for after in [1, 20, 70] {
                let mut node = Node::new();
                let whole = request(Request::Upload, 89, 0.0);
                node.send(&whole, whole.len() * after.min(20) / 20, &STANDS);
                node.wait(after.saturating_sub(20), &STANDS);
                node.wait(300, &now);
                assert!(node.jobs.is_empty(), "{after}");
                assert_eq!(node.said.last().map(|said| said.2), Some(Outcome::Refused));
            }
        }
        let mut node = Node::new();
        let rolls = Situation {
            moving: true,
            ..STANDS
        };
        node.send(&message, message.len(), &rolls);
        node.wait(100, &rolls);
        assert_eq!(node.said.last().map(|said| said.3), Some(Reason::Moving));
        assert!(node.jobs.is_empty());
    }

    #[test]
    fn one_upload_waits_for_another() {
        let mut node = Node::new();
        let message = request(Request::Upload, 89, 0.0);
        node.send(&message, message.len(), &STANDS);
        assert!(node.session.is_busy());
        let before = node.words.clone();
        let other = request(Request::Upload, 3, 0.0);
        node.send(&other, other.len(), &STANDS);
        assert_eq!(node.said.last().map(|said| said.3), Some(Reason::Busy));
        assert_eq!(node.words, before);
        assert_eq!(node.ask(Request::Drop, &STANDS).3, Reason::Busy);
        node.wait(300, &STANDS);
        assert!(matches!(node.jobs[..], [Job::Store(_)]));
    }

    #[test]
    fn requests_need_their_situation() {
        let paused = Situation {
            paused: true,
            moving: false,
            ..RUNS
        };
        let empty = Situation {
            there: false,
            ..STANDS
        };
        let unready = Situation {
            ready: false,
            ..STANDS
        };
        for (request, now, reason, effect) in [
            (Request::Start, STANDS, Reason::None, Some(Effect::Start)),
            (Request::Start, RUNS, Reason::Running, None),
            (Request::Start, unready, Reason::NotReady, None),
            (Request::Pause, RUNS, Reason::None, Some(Effect::Pause)),
            (Request::Pause, STANDS, Reason::NoRun, None),
            (Request::Resume, paused, Reason::None, Some(Effect::Resume)),
            (Request::Resume, RUNS, Reason::NotPaused, None),
            (Request::Resume, STANDS, Reason::NoRun, None),
            (Request::Drop, empty, Reason::NoMission, None),
            (Request::Drop, paused, Reason::Running, None),
            (Request::Upload, STANDS, Reason::Format, None),
        ] {
            let mut node = Node::new();
            let said = node.ask(request, &now);
            let outcome = if reason == Reason::None {
                Outcome::Done
            } else {
                Outcome::Refused
            };
            assert_eq!(said, Said(request.code(), 9, outcome, reason, 0), "{now:?}");
            assert_eq!(node.effects.first(), effect.as_ref(), "{now:?}");
            let event = node.session.event().unwrap();
            assert_eq!((event.request, event.reason), (request, reason));
            node.wait(10, &now);
            assert!(node.jobs.is_empty());
        }
        let mut node = Node::new();
        assert_eq!(node.ask(Request::Drop, &STANDS).2, Outcome::Done);
        node.wait(10, &STANDS);
        assert_eq!(node.jobs, [Job::Drop]);
        node.cycle(&[transport::single(&[99, 9])], &STANDS);
        assert_eq!(node.said.pop().unwrap().3, Reason::Unknown);
    }

    #[test]
    fn with_a_key_only_the_state_is_told() {
        let keyed = Situation {
            keyed: true,
            paused: true,
            ..RUNS
        };
        let mut node = Node::new();
        for request in Request::ALL {
            let said = node.ask(request, &keyed);
            let key = request != Request::State;
            assert_eq!(
                said.3,
                if key { Reason::Key } else { Reason::None },
                "{request:?}"
            );
        }
        let message = request(Request::Upload, 3, 0.0);
        let keyed = Situation {
            keyed: true,
            ..STANDS
        };
        node.send(&message, message.len(), &keyed);
        assert_eq!(node.said.pop().unwrap().3, Reason::Key);
        assert!(node.effects.is_empty() && node.jobs.is_empty());
    }

    #[test]
    fn codes_and_sentences_tell_reasons_apart() {
        for (at, reason) in Reason::ALL.iter().enumerate() {
            assert_eq!(Reason::of(reason.code()), Some(*reason));
            assert!(
                Reason::ALL[..at]
                    .iter()
                    .all(|other| other.text() != reason.text() && other.short() != reason.short())
            );
            assert!(reason.short().len() <= 10);
        }
        for request in Request::ALL {
            assert_eq!(Request::of(request.code()), Some(request));
        }
    }

    #[test]
    fn reasons_know_whether_they_are_of_a_leg() {
        let (fault, number) = (Fault::Obstacle, 7);
        let of_mission = [
            (Violation::Settings, 0),
            (Violation::Origin, 0),
            (Violation::Fence(FenceError::Crossing(7)), 7),
            (Violation::Obstacles(ObstacleError::Crossing(7)), 7),
            (Violation::Obstacles(ObstacleError::Open), 0),
        ];
        for (violation, place) in of_mission {
            let (reason, at) = Reason::of_violation(&violation);
            assert!(!reason.is_of_leg() && at == place, "{violation:?}");
        }
        let (reason, at) = Reason::of_violation(&Violation::Leg { number, fault });
        assert!(reason.is_of_leg() && at == 7);
    }
}
