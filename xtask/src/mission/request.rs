//! Requests for a vehicle's mission, from a program on its bus (`firmware::mission::upload`).

use std::time::Duration;

use can_bus::Frame;
use embedded_can::{Id, StandardId};
use firmware::mission::{
    transport::{SINGLE, Sender, single},
    upload::{Outcome, Reason, Request},
};
use network_model::{Message, Network, WindowKind};
use vehicle_model::Vehicle;

use crate::selftest::{
    Transport, TransportError,
    schedule::{self, Begin},
};

/// How long to wait for a reference message.
const PATIENCE: Duration = Duration::from_secs(6);

/// How long the vehicle may be silent while it checks a mission: it tells of that once a second.
const SILENCE: Duration = Duration::from_secs(5);

/// How long the first answer takes from a node that is there, if the request was in its window.
const ANSWER: Duration = Duration::from_secs(1);

/// How long the flash takes at most, and the node to start again.
const WRITING: Duration = Duration::from_secs(12);

/// How often a request is tried that nobody answers, and an upload of which frames are lost.
const TRIES: u8 = 10;

/// Frames that may be sent in a basic cycle, as the network file says of the message.
const FRAMES: u32 = 6;

/// How often the progress is told at least.
const TOLD: Duration = Duration::from_millis(100);

/// Why a request has no success.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The network file has no messages for it.
    #[error(
        "vehicle {0:?} takes no missions from its bus: its network file has no message MissionRequest"
    )]
    NoMessages(String),
    /// The bus cannot be reached.
    #[error(transparent)]
    Transport(#[from] TransportError),
    /// No time master leads the bus.
    #[error(
        "there is no reference message on the bus, so no time master leads it and nothing can be sent"
    )]
    NoReference,
    /// The vehicle does not answer.
    #[error(
        "the vehicle does not answer: its images need mission.enabled=true, and its controller must be on the bus"
    )]
    NoAnswer,
    /// It has answered at first.
    #[error("the vehicle has stopped answering {0}")]
    Silent(&'static str),
    /// It refuses.
    #[error("the vehicle refuses: {}", .0.sentence())]
    Refused(Refusal),
    /// The mission in the flash is not the new one.
    #[error(
        "the vehicle has started anew and has the mission of before: its flash could not be written"
    )]
    NotKept,
}

impl Error {
    /// Whether the command line is wrong.
    pub(crate) fn is_usage(&self) -> bool {
        match self {
            Self::NoMessages(_) => true,
            Self::Transport(error) => error.is_usage(),
            _ => false,
        }
    }
}

/// Why the vehicle refuses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Refusal {
    /// The reason; `None` for one that this program does not know.
    pub reason: Option<Reason>,
    /// The leg of the record at fault, counted from 0.
    pub leg: u16,
}

impl Refusal {
    /// In words.
    #[must_use]
    pub fn sentence(&self) -> String {
        match self.reason {
            None => "for a reason that this program does not know".into(),
            Some(reason) if reason.is_of_leg() => {
                format!("piece {} of the mission: {}", self.leg + 1, reason.text())
            }
            Some(reason) => reason.text().into(),
        }
    }
}

/// An answer of the vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Answer {
    /// What has become of the request.
    pub outcome: Outcome,
    /// Why it was refused; of the state: why the mission cannot be driven.
    pub refusal: Refusal,
    /// Low byte of the number of the mission in the flash; 0 if a debug probe wrote it, or there is none.
    pub number: u8,
}

/// What is told while a request is on the bus.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Told {
    /// So many bytes of all have been sent.
    Sends(usize, usize),
    /// The vehicle checks the mission, and is at this piece.
    Checks(u16),
    /// The vehicle writes its flash.
    Writes,
    /// A frame was lost; it is sent once more.
    Again,
}

/// What the vehicle says of its mission in each basic cycle: signals of the message `MissionState` with their names or
/// numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// What is known of the mission, as the network file names it.
    pub state: String,
    /// The leg, and how many there are.
    pub legs: (u16, u16),
    /// Distance along the leg, m.
    pub along: f64,
}

/// Asks one vehicle.
pub struct Client<'a> {
    transport: &'a mut dyn Transport,
    network: &'a Network,
    request: &'a Message,
    answer: &'a Message,
    tell: &'a mut dyn FnMut(Told),
    /// The last message in front of the window, after which it is open for certain.
    before: Option<u16>,
    /// The basic cycle that runs, whether that message has come in it, and how many frames it has had.
    begin: Option<Begin>,
    open: bool,
    sent: u32,
    round: u8,
    /// Round of the first attempt at the current request.
    first: u8,
    state: Option<State>,
}

/// Whether a refusal says that frames were lost on the way.
const fn is_lost(reason: Reason) -> bool {
    matches!(
        reason,
        Reason::Sequence | Reason::Silence | Reason::Interrupted
    )
}

/// A frame that concerns a request.
enum Heard {
    Flow([u8; 8]),
    Answer(Answer),
}

impl<'a> Client<'a> {
    /// A program on the bus of a vehicle.
    ///
    /// # Errors
    /// Its network file has no messages for requests.
    pub fn new(
        vehicle: &'a Vehicle,
        transport: &'a mut dyn Transport,
        tell: &'a mut dyn FnMut(Told),
    ) -> Result<Self, Error> {
        let network = vehicle.network();
        let find = |name: &str| network.messages.iter().find(|one| one.name == name);
        let none = || Error::NoMessages(vehicle.name().into());
        let request = find("MissionRequest").ok_or_else(none)?;
        let earlier = network.messages.iter().filter(|one| {
            let window = one.window;
            let always = window.repeat <= 1 && window.start_us < request.window.start_us;
            window.kind == WindowKind::Exclusive && always
        });
        Ok(Self {
            before: earlier
                .max_by_key(|one| one.window.start_us)
                .map(|one| one.id),
            request,
            answer: find("MissionAnswer").ok_or_else(none)?,
            network,
            transport,
            tell,
            begin: None,
            open: false,
            sent: 0,
            round: 0,
            first: 0,
            state: None,
        })
    }

    /// Uploads a record, and waits until it lies in the flash. Returns its number.
    ///
    /// # Errors
    /// The vehicle refuses it, or cannot be reached.
    pub fn upload(&mut self, record: &[u8]) -> Result<u8, Error> {
        let before = self.ask(Request::State, &[])?.number;
        self.ask(Request::Upload, record)?;
        self.written(before)
    }

    /// Lets the vehicle check a record, and forget it.
    ///
    /// # Errors
    /// The vehicle refuses it, or cannot be reached.
    pub fn check(&mut self, record: &[u8]) -> Result<(), Error> {
        self.ask(Request::Check, record).map(|_| ())
    }

    /// Asks the vehicle to forget its mission, and waits until it has.
    ///
    /// # Errors
    /// It refuses, or cannot be reached.
    pub fn forget(&mut self) -> Result<(), Error> {
        let before = self.ask(Request::Drop, &[])?.number;
        self.written(before).map(|_| ())
    }

    /// Sends a request without a record.
    ///
    /// # Errors
    /// The vehicle refuses it, or cannot be reached.
    pub fn request(&mut self, request: Request) -> Result<Answer, Error> {
        self.ask(request, &[])
    }

    /// What the vehicle said last of its mission.
    #[must_use]
    pub const fn state(&self) -> Option<&State> {
        self.state.as_ref()
    }

    /// Waits until the vehicle is back with another mission than the one of this number.
    fn written(&mut self, before: u8) -> Result<u8, Error> {
        (self.tell)(Told::Writes);
        let end = self.transport.now() + WRITING;
        // It still answers for a moment, and then it is off the bus.
        let quiet = self.transport.now() + Duration::from_secs(1);
        while self.transport.now() < quiet {
            self.hear(quiet)?;
        }
        loop {
            match self.exchange(&[Request::State.code(), self.round]) {
                Ok(answer) if answer.number != before => return Ok(answer.number),
                Ok(_) if self.transport.now() >= end => return Err(Error::NotKept),
                Err(Error::NoAnswer) if self.transport.now() < end => {}
                Ok(_) => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Sends a request and waits for its last answer. One that was lost on the way is sent again.
    fn ask(&mut self, request: Request, record: &[u8]) -> Result<Answer, Error> {
        let end = self.transport.now() + PATIENCE;
        while self.begin.is_none() {
            if self.transport.now() >= end {
                return Err(Error::NoReference);
            }
            self.hear(end)?;
        }
        let mut tries = 0;
        loop {
            tries += 1;
            self.round = self.round.wrapping_add(1).max(1);
            if tries == 1 {
                self.first = self.round;
            }
            let mut message = vec![request.code(), self.round];
            if !record.is_empty() {
                message.extend([0, 0]);
                message.extend(record);
            }
            let told = match self.exchange(&message) {
                // An earlier attempt has arrived late: what the vehicle checks is this mission.
                Err(Error::Refused(refusal))
                    if refusal.reason == Some(Reason::Busy) && tries > 1 && !record.is_empty() =>
                {
                    self.wait(SILENCE, "while it checked the mission")
                }
                told => told,
            };
            let again = match &told {
                Err(Error::Refused(refusal)) => refusal.reason.is_some_and(is_lost),
                Err(Error::Silent(_)) => !record.is_empty(),
                Err(Error::NoAnswer) => true,
                _ => false,
            };
            if !again || tries >= TRIES {
                return told;
            }
            if !matches!(told, Err(Error::NoAnswer)) {
                (self.tell)(Told::Again);
            }
        }
    }

    /// Waits for the last answer to an attempt of before. The vehicle may be silent for so long.
    fn wait(&mut self, silence: Duration, doing: &'static str) -> Result<Answer, Error> {
        let mut end = self.transport.now() + silence;
        while self.transport.now() < end {
            let Some(Heard::Answer(answer)) = self.hear(end)? else {
                continue;
            };
            match answer.outcome {
                Outcome::Done => return Ok(answer),
                // The answer to the attempt that came into the check.
                Outcome::Refused if answer.refusal.reason == Some(Reason::Busy) => {}
                Outcome::Refused => return Err(Error::Refused(answer.refusal)),
                Outcome::Checking => {
                    (self.tell)(Told::Checks(answer.refusal.leg));
                    end = self.transport.now() + silence;
                }
            }
        }
        Err(Error::Silent(doing))
    }

    /// Sends a message, and waits for its last answer.
    fn exchange(&mut self, message: &[u8]) -> Result<Answer, Error> {
        let mut sender = Sender::new(message);
        let mut end = self.transport.now() + ANSWER;
        let mut waits: Result<(), &'static str> = Ok(());
        loop {
            self.send(&mut sender)?;
            let now = self.transport.now();
            if now >= end {
                return Err(match waits {
                    Err(doing) => Error::Silent(doing),
                    Ok(()) => Error::NoAnswer,
                });
            }
            let answer = match self.hear(end.min(now + TOLD))? {
                None => continue,
                Some(Heard::Flow(flow)) => {
                    // What it refuses, it tells in an answer.
                    let _ = sender.flow(&flow);
                    end = self.transport.now() + SILENCE;
                    waits = Err("in the middle of the upload");
                    continue;
                }
                Some(Heard::Answer(answer)) => answer,
            };
            match answer.outcome {
                Outcome::Done => return Ok(answer),
                Outcome::Refused => return Err(Error::Refused(answer.refusal)),
                Outcome::Checking => {
                    (self.tell)(Told::Checks(answer.refusal.leg));
                    end = self.transport.now() + SILENCE;
                    waits = Err("while it checked the mission");
                }
            }
        }
    }

    /// Sends the frames for which the running basic cycle has room, if its window is open or will be.
    fn send(&mut self, sender: &mut Sender<'_>) -> Result<(), Error> {
        let Some(begin) = self.begin else {
            return Ok(());
        };
        // A computer that hears frames late, or a simulation that is slower than time, would send into the windows of
        // others otherwise.
        if !self.open
            || sender.is_done()
            || sender.waits()
            || !schedule::has_window(self.request, begin.cycle)
        {
            return Ok(());
        }
        let (sent, length) = sender.progress();
        let left = if length <= SINGLE {
            1
        } else {
            (length - sent).div_ceil(SINGLE)
        };
        let left = u32::try_from(left).unwrap_or(FRAMES);
        let count = left.min(FRAMES.saturating_sub(self.sent));
        let place = schedule::place(self.network, self.request, count.max(1));
        let now = self.transport.now();
        if count == 0 || now > begin.at + place.latest {
            return Ok(());
        }
        if now < begin.at + place.earliest {
            return Ok(());
        }
        for _ in 0..count {
            let Some(data) = sender.frame() else { break };
            self.transport.send(&self.frame(&data))?;
            self.sent += 1;
        }
        let (sent, length) = sender.progress();
        if length > SINGLE {
            (self.tell)(Told::Sends(sent, length));
        }
        Ok(())
    }

    fn frame(&self, data: &[u8; 8]) -> Frame {
        Frame::standard(self.request.id, data).unwrap_or_else(|| unreachable!("11 bits, 8 bytes"))
    }

    /// Waits for the next frame that concerns a request, at most until `until` and until the window opens.
    fn hear(&mut self, until: Duration) -> Result<Option<Heard>, Error> {
        let place = schedule::place(self.network, self.request, 1);
        let opens = self.begin.map(|begin| begin.at + place.earliest);
        let now = self.transport.now();
        let until = opens
            .filter(|opens| *opens > now)
            .map_or(until, |opens| until.min(opens));
        let Some(received) = self.transport.receive(until)? else {
            return Ok(None);
        };
        if let Some(begin) = schedule::begin(self.network, &received.frame, received.at) {
            self.begin = Some(begin);
            self.open = self.before.is_none();
            self.sent = 0;
            return Ok(None);
        }
        let begun = schedule::cycle_of(self.network, &received.frame, received.at);
        if let (Some(begin), Some(begun)) = (&mut self.begin, begun) {
            begin.at = begin.at.max(begun);
        }
        let message = schedule::message(self.network, &received.frame);
        self.open |= message.is_some_and(|message| Some(message.id) == self.before);
        self.look(&received.frame);
        Ok(self.answer_in(&received.frame))
    }

    /// The answer or the flow control in a frame.
    fn answer_in(&self, frame: &Frame) -> Option<Heard> {
        let id = StandardId::new(self.answer.id).map(Id::Standard)?;
        if frame.id() != id || frame.is_remote() {
            return None;
        }
        let data = <[u8; 8]>::try_from(frame.data()).ok()?;
        let [control, _, round, outcome, reason, low, high, number] = data;
        if control >> 4 == 3 {
            return Some(Heard::Flow(data));
        }
        // A refusal of an upload that had no room for its number has none.
        let ours = round == self.round || round == 0;
        let outcome = Outcome::of(outcome)?;
        let reason = Reason::of(reason);
        // On a slow bus the answer to an earlier attempt comes during a later one. That the earlier one was lost is known.
        let attempts = self.round.wrapping_sub(self.first);
        let earlier = round != 0 && self.round.wrapping_sub(round) <= attempts;
        let late = earlier && !(outcome == Outcome::Refused && reason.is_some_and(is_lost));
        if data.first() != single(&[0; SINGLE]).first() || !(ours || late) {
            return None;
        }
        Some(Heard::Answer(Answer {
            outcome,
            refusal: Refusal {
                reason,
                leg: u16::from_le_bytes([low, high]),
            },
            number,
        }))
    }

    /// Notes what the vehicle says of its mission.
    fn look(&mut self, frame: &Frame) {
        let message = schedule::message(self.network, frame);
        let Some(message) = message.filter(|message| message.name == "MissionState") else {
            return;
        };
        let signal = |name: &str| message.signals.iter().find(|one| one.name == name);
        let raw = |name: &str| signal(name).map_or(0, |one| one.extract(frame.data()));
        let state = raw("State");
        let named = signal("State").and_then(|one| {
            let table = one.values.as_ref()?;
            let mut tables = self.network.value_tables.iter();
            let values = &tables.find(|it| it.name == *table)?.values;
            values.iter().find(|value| i128::from(value.raw) == state)
        });
        let number = |name: &str| u16::try_from(raw(name)).unwrap_or(u16::MAX);
        self.state = Some(State {
            state: named.map_or_else(|| state.to_string(), |value| value.name.clone()),
            legs: (number("Leg"), number("Legs")),
            along: signal("Along").map_or(0.0, |one| one.physical(raw("Along"))),
        });
    }
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use super::*;
    use crate::{
        Workspace,
        selftest::{Received, TransportError},
        vehicle,
    };

    /// A vehicle on a slow bus: it grants the first attempt late, takes it, and refuses the second one as it checks.
    struct Slow {
        now: Duration,
        answer: u16,
        reference: u16,
        coming: VecDeque<(Duration, Frame)>,
        begun: u32,
        last: [u8; 8],
    }

    impl Slow {
        fn says(&mut self, after: u64, data: [u8; 8]) {
            let at = self.now + Duration::from_millis(after);
            let place = self.coming.partition_point(|(other, _)| *other <= at);
            self.coming
                .insert(place, (at, Frame::standard(self.answer, &data).unwrap()));
        }

        fn answers(&mut self, after: u64, round: u8, outcome: Outcome, reason: Reason) {
            self.says(
                after,
                [
                    7,
                    Request::Upload.code(),
                    round,
                    outcome.code(),
                    reason.code(),
                    0,
                    0,
                    1,
                ],
            );
        }
    }

    impl Transport for Slow {
        fn now(&self) -> Duration {
            self.now
        }

        fn send(&mut self, frame: &Frame) -> Result<(), TransportError> {
            let data = <[u8; 8]>::try_from(frame.data()).unwrap();
            if data[0] >> 4 != 1 {
                return Ok(());
            }
            self.begun += 1;
            match self.begun {
                // The first frame of the first attempt: lost, as the vehicle believes; then all of it has arrived.
                1 => {
                    self.answers(200, data[3], Outcome::Refused, Reason::Silence);
                    self.last = data;
                }
                _ => {
                    let first = self.last[3];
                    self.answers(200, 0, Outcome::Refused, Reason::Busy);
                    self.answers(1200, first, Outcome::Checking, Reason::None);
                    self.answers(5200, first, Outcome::Done, Reason::None);
                }
            }
            Ok(())
        }

        fn receive(&mut self, until: Duration) -> Result<Option<Received>, TransportError> {
            let cycle = Duration::from_millis(100);
            let next = Duration::from_millis((self.now.as_millis() as u64 / 100 + 1) * 100);
            let due = self.coming.front().map(|(at, _)| *at);
            if let Some(at) = due.filter(|at| *at <= until && *at <= next) {
                self.now = self.now.max(at);
                let (_, frame) = self.coming.pop_front().unwrap();
                return Ok(Some(Received {
                    at: self.now,
                    frame,
                }));
            }
            if next <= until {
                self.now = next;
                let time = (next.as_millis() as u32).to_be_bytes();
                let [a, b, c, d] = time;
                let frame = Frame::standard(self.reference, &[1, a, b, c, d, 0, 0, 0]).unwrap();
                let _ = cycle;
                return Ok(Some(Received {
                    at: self.now,
                    frame,
                }));
            }
            self.now = self.now.max(until);
            Ok(None)
        }
    }

    #[test]
    fn an_upload_waits_for_its_first_attempt() {
        let workspace = Workspace::find().unwrap();
        let on = vehicle_model::Overrides::parse("mission.enabled=true").unwrap();
        let vehicle = vehicle::with(&workspace, "uagv", &on).unwrap();
        let network = vehicle.network();
        let id = |kind: &dyn Fn(&Message) -> bool| {
            network.messages.iter().find(|one| kind(one)).unwrap().id
        };
        let mut slow = Slow {
            now: Duration::ZERO,
            answer: id(&|one| one.name == "MissionAnswer"),
            reference: id(&|one| one.window.kind == WindowKind::Reference),
            coming: VecDeque::new(),
            begun: 0,
            last: [0; 8],
        };
        let mut checks = 0;
        let mut tell = |told| checks += u32::from(matches!(told, Told::Checks(_)));
        let mut client = Client::new(&vehicle, &mut slow, &mut tell).unwrap();
        client.before = None;
        client.check(&[0; 40]).unwrap();
        assert_eq!((checks, slow.begun), (1, 2));
    }
}
