//! The question on the bus: when it is sent, and which answers count.

use std::{collections::BTreeMap, time::Duration};

use can_bus::Frame;

use super::{
    messages::{Messages, Report},
    schedule::Begin,
    transport::{Error, Transport},
};

/// How long to wait for a reference message. The last time master in rank leads sooner after its
/// start, even when none has its clock.
const REFERENCE: Duration = Duration::from_secs(6);

/// How long to listen on a bus without reference messages.
const LISTEN: Duration = Duration::from_secs(3);

/// How long nodes have to start and report. A node without its clock needs the most: it waits for
/// the references of a time master that waits for its own clock, then trims its oscillator.
const START: Duration = Duration::from_secs(10);

/// How long running nodes have to report, apart from [`CYCLES`].
const RUNNING: Duration = Duration::from_secs(1);

/// Basic cycles that running nodes have to report, in addition to [`RUNNING`].
const CYCLES: u32 = 8;

/// How many requests are sent.
const REQUESTS: u8 = 3;

/// How often the progress is told at least.
const TOLD: Duration = Duration::from_millis(100);

/// How much later than on time a reference message may come: the latency of an adapter.
const LATENCY: Duration = Duration::from_millis(1);

/// Inverse of the share of a basic cycle by which it may be longer or shorter: a time master on
/// its internal oscillator has an error of 1 %.
const SHARE: u32 = 80;

/// Inverse of the share of a period by which the half of all periods in the middle may scatter.
const SCATTER: u32 = 5;

/// What to ask.
pub struct Question<'m> {
    /// The messages.
    pub messages: &'m Messages<'m>,
    /// The names of all nodes.
    pub names: &'m [String],
    /// Indices of the nodes whose answers are waited for.
    pub wanted: &'m [usize],
    /// Whether the nodes start again.
    pub start_again: bool,
}

/// What is told while the question is on the bus.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Told {
    /// Something has happened; a sentence.
    Note(String),
    /// It waits.
    Waits {
        /// The time of the transport.
        now: Duration,
        /// For what.
        what: String,
    },
}

/// What came from the bus.
#[derive(Debug, Default, PartialEq)]
pub struct Answers {
    /// The last report of each node, with the time.
    pub reports: Vec<Option<(Duration, Report)>>,
    /// Number of frames of each message, by identifier.
    pub heard: BTreeMap<u16, u64>,
    /// When each request was handed over, and how long after the begin of its basic cycle.
    pub requests: Vec<(Duration, Duration)>,
    /// Why no request, or no further one, could be sent.
    pub unsent: Option<Unsent>,
}

/// Why a request cannot be sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unsent {
    /// No time master sends references.
    NoReference,
    /// The references come at irregular times, so that nothing can be sent at the right moment.
    Irregular,
    /// The references come in the basic cycle of another vehicle.
    OtherCycle {
        /// Time from one to the next.
        seen: Duration,
    },
}

/// Why nothing can be asked of a vehicle when references come in another cycle than its own.
pub(super) fn other_cycle(vehicle: &str, cycle: Duration, seen: Duration) -> String {
    let ms = |time: Duration| (time.as_secs_f64() * 10_000.0).round() / 10.0;
    format!(
        "the reference messages come every {} ms, but the basic cycle of {vehicle} has {} ms: if \
         another vehicle is on the bus, --vehicle names it",
        ms(seen),
        ms(cycle)
    )
}

/// Whether two times from one reference message to the next are equal.
fn are_equal(one: Duration, other: Duration) -> bool {
    one.abs_diff(other) <= LATENCY + other / SHARE
}

/// Asks the nodes and waits for the answers.
///
/// # Errors
/// The bus cannot be reached any more.
pub fn ask(
    transport: &mut dyn Transport,
    question: &Question<'_>,
    tell: &mut dyn FnMut(Told),
) -> Result<Answers, Error> {
    let mut asking = Asking {
        transport,
        question,
        tell,
        answers: Answers {
            reports: vec![None; question.names.len()],
            ..Answers::default()
        },
        restarts: Vec::new(),
        last: None,
        on_time: None,
        periods: Vec::new(),
    };
    asking.all()?;
    asking.note_running();
    Ok(asking.answers)
}

struct Asking<'a> {
    transport: &'a mut dyn Transport,
    question: &'a Question<'a>,
    tell: &'a mut dyn FnMut(Told),
    answers: Answers,
    /// Rounds of the requests to start again.
    restarts: Vec<u8>,
    /// The last reference message.
    last: Option<Begin>,
    /// The same, if it came one basic cycle after the one before.
    on_time: Option<Begin>,
    /// The times from one reference message to the next.
    periods: Vec<Duration>,
}

impl Asking<'_> {
    fn all(&mut self) -> Result<(), Error> {
        for round in 1..=REQUESTS {
            // A node that is late has heard the first request, or reports by itself after its
            // start. So a further request starts the nodes again only if no node has answered.
            let unheard = self.answers.reports.iter().all(Option::is_none);
            let start_again = self.question.start_again && unheard && round < REQUESTS;
            if let Some(why) = self.send(round, start_again)? {
                self.answers.unsent = Some(why);
                if round == 1 {
                    let end = self.transport.now() + LISTEN;
                    let why: String = match why {
                        Unsent::NoReference => {
                            "there is no reference message on the bus, so no time master leads it"
                                .into()
                        }
                        Unsent::Irregular => {
                            "the reference messages come at irregular times, so no window is known"
                                .into()
                        }
                        Unsent::OtherCycle { seen } => {
                            let messages = self.question.messages;
                            other_cycle(messages.vehicle(), messages.basic_cycle(), seen)
                        }
                    };
                    self.note(&format!(
                        "Nothing can be asked: {why}. Listening all the same."
                    ));
                    while self.receive(end, "what nodes say by themselves")? {}
                }
                return Ok(());
            }
            let limit = if start_again {
                START
            } else {
                RUNNING + self.question.messages.basic_cycle() * CYCLES
            };
            let end = self.transport.now() + limit;
            while !self.missing().is_empty() {
                let what = format!("the report of {}", self.missing().join(", "));
                if !self.receive(end, &what)? {
                    break;
                }
            }
            let missing = self.missing();
            if missing.is_empty() {
                return Ok(());
            }
            if round < REQUESTS {
                let missing = missing.join(", ");
                self.note(&format!("No report of {missing}; asking once more."));
            }
        }
        Ok(())
    }

    /// Says which nodes have answered a request to start again without a start.
    fn note_running(&mut self) {
        let wanted = self.question.wanted.iter();
        let running: Vec<&str> = wanted
            .filter(|node| {
                let report = self.answers.reports[**node].as_ref();
                report.is_some_and(|(_, report)| self.restarts.contains(&report.round))
            })
            .map(|node| self.question.names[*node].as_str())
            .collect();
        if !running.is_empty() {
            self.note(&format!(
                "Not started again: {}. A node with a key never starts again by a request, and no node does while \
                 its motor may turn. The results are those of its last start and of its running program.",
                running.join(", ")
            ));
        }
    }

    /// Names of the nodes that have not reported.
    fn missing(&self) -> Vec<&str> {
        let silent = |node: &&usize| self.answers.reports[**node].is_none();
        let nodes = self.question.wanted.iter().filter(silent);
        nodes
            .map(|node| self.question.names[*node].as_str())
            .collect()
    }

    fn note(&mut self, note: &str) {
        (self.tell)(Told::Note(note.into()));
    }

    /// Sends a request in its window, and says why if that is impossible.
    fn send(&mut self, round: u8, start_again: bool) -> Result<Option<Unsent>, Error> {
        let frame = self.question.messages.request(round, start_again);
        let place = self.question.messages.place();
        // A basic cycle that has begun before may be over.
        self.on_time = None;
        self.periods.clear();
        let mut seen = false;
        let mut end = self.transport.now() + REFERENCE;
        loop {
            let former = self.last;
            if !self.receive(end, "the reference message of a time master")? {
                return Ok(Some(match (seen, self.other_cycle()) {
                    (false, _) => Unsent::NoReference,
                    (true, None) => Unsent::Irregular,
                    (true, Some(seen)) => Unsent::OtherCycle { seen },
                }));
            }
            if self.last == former {
                continue;
            }
            if !seen {
                seen = true;
                end += REFERENCE;
            }
            let Some(begin) = self.on_time else {
                continue;
            };
            if !self.question.messages.has_window(begin.cycle) {
                continue;
            }
            let opens = begin.at + place.earliest;
            while self.receive(opens, "the window of the request")? {}
            let now = self.transport.now();
            if now <= begin.at + place.latest {
                self.transport.send(&frame)?;
                self.answers.requests.push((now, now - begin.at));
                if start_again {
                    self.restarts.push(round);
                }
                let nodes = match start_again {
                    true => "The nodes are asked to start again",
                    false => "The running nodes are asked",
                };
                self.note(&format!("{nodes} (round {round})."));
                return Ok(None);
            }
        }
    }

    /// The time from one reference message to the next, if it is that of another vehicle.
    ///
    /// A busy computer takes single frames much too late, so the half of the periods in the middle
    /// says whether there is a cycle. Their mean tells how many cycles each period has been, of which
    /// some have lost their reference.
    fn other_cycle(&self) -> Option<Duration> {
        let mut periods = self.periods.clone();
        periods.sort_unstable();
        let quarter = periods.len() / 4;
        let middle = &periods[quarter..periods.len() - quarter];
        let (least, greatest) = (*middle.first()?, *middle.last()?);
        let mean = middle.iter().sum::<Duration>() / u32::try_from(middle.len()).ok()?;
        if mean.is_zero() || greatest - least > LATENCY + mean / SCATTER {
            return None;
        }
        let cycles: f64 = periods
            .iter()
            .map(|period| period.div_duration_f64(mean).round())
            .sum();
        let period = periods.iter().sum::<Duration>().div_f64(cycles);
        (!are_equal(period, self.question.messages.basic_cycle())).then_some(period)
    }

    /// Waits for a frame and takes it; false if none has come until `end`.
    fn receive(&mut self, end: Duration, what: &str) -> Result<bool, Error> {
        loop {
            let now = self.transport.now();
            (self.tell)(Told::Waits {
                now,
                what: what.into(),
            });
            if let Some(received) = self.transport.receive(end.min(now + TOLD))? {
                self.take(&received.frame, received.at);
                return Ok(true);
            }
            if self.transport.now() >= end {
                return Ok(false);
            }
        }
    }

    fn take(&mut self, frame: &Frame, at: Duration) {
        let messages = self.question.messages;
        let Some(message) = messages.message(frame) else {
            return;
        };
        *self.answers.heard.entry(message.id).or_default() += 1;
        if let Some(begin) = messages.begin(frame, at) {
            let passed = self.last.map(|last| begin.at.saturating_sub(last.at));
            let regular = passed.is_some_and(|passed| are_equal(passed, messages.basic_cycle()));
            self.periods.extend(passed);
            self.on_time = regular.then_some(begin);
            self.last = Some(begin);
        }
        if let Some((node, report)) = messages.report(frame) {
            // Another program's rounds are no answers to this one's requests.
            let sent = self.answers.requests.len();
            let asked = sent > 0 || self.answers.unsent.is_some();
            if asked && (report.round == 0 || usize::from(report.round) <= sent) {
                self.answers.reports[node] = Some((at, report));
            }
        }
    }
}
