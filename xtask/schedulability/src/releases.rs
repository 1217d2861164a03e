//! When the bus releases tasks: time tables from the network file.
//!
//! The cycle begins with the start of the reference message. A frame of another
//! node begins within the transmit enable window of its own window, by a clock
//! that may differ from this node's by the network's uncertainty; it has ended
//! after its shortest length at the earliest and its longest, fully stuffed, at
//! the latest. The window timer follows the node's own clock.

use network_model::{Message, Network, SendType, Window, WindowKind, worst_case_bits};

use crate::arrivals::{Job, Kind, Timetable};
use crate::units::{MICROSECOND, Picoseconds};

/// Bits of a data frame with an 11-bit identifier before its data are counted,
/// without stuffing, up to the last bit but one, where a receiver takes it.
const SHORTEST_BITS: u64 = 43;
/// Bits before arbitration can be lost: the start of frame.
const ARBITRATION_BITS: u64 = 1;
/// The rest of the frame and the interframe space.
const REST_BITS: u64 = 4;
/// Bits between two frames.
const INTERFRAME_BITS: u64 = 3;

/// What one node has to do with the bus.
#[derive(Debug, Clone, Copy)]
pub struct Bus<'a> {
    network: &'a Network,
    node: &'a str,
    lead: Picoseconds,
}

impl<'a> Bus<'a> {
    /// Of a node that begins its transmissions `lead` before their mark.
    #[must_use]
    pub fn new(network: &'a Network, node: &'a str, lead: Picoseconds) -> Self {
        Self {
            network,
            node,
            lead,
        }
    }

    fn is_own(&self, message: &Message) -> bool {
        message.sender.eq_ignore_ascii_case(self.node)
    }

    fn bit(&self) -> Picoseconds {
        u64::from(self.network.bit_time_ns()) * 1000
    }

    fn uncertainty(&self) -> Picoseconds {
        u64::from(self.network.sync_uncertainty_us) * MICROSECOND
    }

    /// How late a frame may begin in its window.
    #[must_use]
    pub fn transmit_enable(&self) -> Picoseconds {
        u64::from(self.network.transmit_enable_bits) * self.bit()
    }

    /// How long after the node's timer has called for it a frame must be asked
    /// for: the controller begins it with the next bit, and a frame begins
    /// within the transmit enable window.
    fn request(&self) -> Picoseconds {
        (self.transmit_enable() + self.lead).saturating_sub(self.bit())
    }

    /// Least time between the ends of two frames of other nodes, or of its own.
    #[must_use]
    pub fn spacing(&self, own: bool) -> Picoseconds {
        let messages = self.network.messages.iter();
        let bits = messages
            .filter(|message| self.is_own(message) == own)
            .map(|message| SHORTEST_BITS + REST_BITS + 8 * u64::from(message.shortest))
            .min();
        bits.unwrap_or(SHORTEST_BITS + REST_BITS) * self.bit()
    }

    /// Least time between the latest end of a frame in an exclusive window and
    /// the moment when the window timer closes it.
    #[must_use]
    pub fn after_frame(&self) -> Picoseconds {
        let exclusive = self.network.messages.iter();
        exclusive
            .filter(|message| message.window.kind == WindowKind::Exclusive)
            .map(|message| {
                let last = u64::from(worst_case_bits(message.length)) * self.bit();
                let used = self.transmit_enable() + last + self.uncertainty() + self.lead;
                (u64::from(message.window.length_us) * MICROSECOND).saturating_sub(used)
            })
            .min()
            .unwrap_or(Picoseconds::MAX)
    }

    /// The basic cycles of the system matrix, or one if all are alike.
    fn cycles(&self) -> u64 {
        let mut windows = self.network.messages.iter().map(|message| message.window);
        if windows.all(|window| window.repeat <= 1) {
            1
        } else {
            u64::from(self.network.basic_cycles.max(1))
        }
    }

    fn basic_cycle(&self) -> Picoseconds {
        u64::from(self.network.basic_cycle_us) * MICROSECOND
    }

    /// Where the basic cycles begin that have this window.
    fn begins(&self, window: Window) -> impl Iterator<Item = Picoseconds> + use<> {
        let (repeat, offset) = (u64::from(window.repeat.max(1)), u64::from(window.offset));
        let length = self.basic_cycle();
        (0..self.cycles())
            .filter(move |cycle| cycle % repeat == offset % repeat)
            .map(move |cycle| cycle * length)
    }

    fn table(&self, spacing: Picoseconds, jobs: Vec<Job>) -> Timetable {
        Timetable {
            cycle: self.cycles() * self.basic_cycle(),
            spacing,
            burst: 0,
            kind: Kind::Any,
            cost: None,
            begun_at: Vec::new(),
            jobs,
        }
    }

    /// The releases that an arbitrating window brings, by its first edge.
    fn in_window(&self, spacing: Picoseconds, burst: u64, jobs: Vec<Job>) -> Timetable {
        let arbitrating = self.network.messages.iter();
        let mut begun_at: Vec<Picoseconds> = arbitrating
            .filter(|message| message.window.kind == WindowKind::Arbitrating)
            .flat_map(|message| {
                let start = u64::from(message.window.start_us) * MICROSECOND;
                self.begins(message.window)
                    .map(move |begin| (begin + start).saturating_sub(self.lead))
            })
            .collect();
        begun_at.sort_unstable();
        begun_at.dedup();
        Timetable {
            burst,
            kind: Kind::Arbitrating,
            begun_at,
            ..self.table(spacing, jobs)
        }
    }

    /// The ends of frames: of all others, or of its own outside the arbitrating
    /// windows ([`Bus::attempts`]).
    #[must_use]
    pub fn frames(&self, own: bool) -> Vec<Timetable> {
        let kinds = [
            (WindowKind::Reference, Kind::Reference),
            (WindowKind::Exclusive, Kind::Exclusive),
            (WindowKind::Arbitrating, Kind::Arbitrating),
        ];
        kinds
            .into_iter()
            .filter(|(window, _)| !(own && *window == WindowKind::Arbitrating))
            .map(|(window, kind)| Timetable {
                kind,
                ..self.frames_of(own, |message| {
                    self.is_own(message) == own && message.window.kind == window
                })
            })
            .filter(|table| !table.jobs.is_empty())
            .collect()
    }

    /// Time that nothing of the schedule waits for what an arbitrating window
    /// brings: until the receive FIFO of three frames overruns.
    #[must_use]
    pub fn fifo_margin(&self) -> Picoseconds {
        3 * self.spacing(false)
    }

    /// The ends of its own attempts in each arbitrating window: a message of its
    /// own was sent, or lost against another's.
    ///
    /// A frame on the bus ends one attempt at most, somewhere between its begin
    /// and its end, and not before it has sent its first bits. So of any three
    /// ends, the first and the last are a frame apart; and so many more may end
    /// by being withdrawn, after which none follows in the window.
    #[must_use]
    pub fn attempts(&self) -> Option<Timetable> {
        let arbitrated = |m: &&Message| m.window.kind == WindowKind::Arbitrating;
        let messages = || self.network.messages.iter().filter(arbitrated);
        if !messages().any(|message| self.is_own(message)) {
            return None;
        }
        let mut jobs = Vec::new();
        for message in messages() {
            let window = message.window;
            let what = if self.is_own(message) {
                "sent"
            } else {
                "lost against"
            };
            for begin in self.begins(window) {
                let job = Job {
                    label: format!("{what} {}", message.name),
                    earliest: (begin
                        + u64::from(window.start_us) * MICROSECOND
                        + ARBITRATION_BITS * self.bit())
                    .saturating_sub(self.uncertainty()),
                    latest: begin + u64::from(window.end_us()) * MICROSECOND + self.uncertainty(),
                    deadline: Some(self.fifo_margin()),
                    transmits: false,
                };
                jobs.extend(std::iter::repeat_n(job, self.events_in_cycle(message)));
            }
        }
        let shortest = messages()
            .map(|message| SHORTEST_BITS + REST_BITS + 8 * u64::from(message.shortest))
            .min()?;
        Some(self.in_window(shortest * self.bit(), 1, jobs))
    }

    /// The ends of another node's message; `None` if there is none.
    #[must_use]
    pub fn message(&self, name: &str) -> Option<Timetable> {
        let table = self.frames_of(false, |message| {
            !self.is_own(message) && message.name == name
        });
        (!table.jobs.is_empty()).then_some(table)
    }

    fn frames_of(&self, own: bool, wanted: impl Fn(&Message) -> bool) -> Timetable {
        let mut jobs: Vec<Job> = Vec::new();
        let mut references: Vec<(Window, usize)> = Vec::new();
        for message in self.network.messages.iter().filter(|m| wanted(m)) {
            let window = message.window;
            let first = (SHORTEST_BITS + 8 * u64::from(message.shortest)) * self.bit();
            let last = u64::from(worst_case_bits(message.length)) * self.bit();
            for begin in self.begins(window) {
                let start = begin + u64::from(window.start_us) * MICROSECOND;
                let end = begin + u64::from(window.end_us()) * MICROSECOND;
                let job = Job {
                    label: message.name.clone(),
                    earliest: (start + first).saturating_sub(self.uncertainty()),
                    latest: match window.kind {
                        WindowKind::Arbitrating => end + self.uncertainty(),
                        _ => start + self.transmit_enable() + last + self.uncertainty(),
                    },
                    deadline: (window.kind == WindowKind::Arbitrating).then(|| self.fifo_margin()),
                    transmits: false,
                };
                match window.kind {
                    // Several masters, but one reference in each cycle.
                    WindowKind::Reference => {
                        let known = references.iter().find(|(of, at)| {
                            *of == window
                                && jobs[*at].earliest / self.basic_cycle()
                                    == begin / self.basic_cycle()
                        });
                        if let Some((_, at)) = known {
                            let other = &mut jobs[*at];
                            other.earliest = other.earliest.min(job.earliest);
                            other.latest = other.latest.max(job.latest);
                        } else {
                            references.push((window, jobs.len()));
                            jobs.push(job);
                        }
                    }
                    WindowKind::Arbitrating => {
                        jobs.extend(std::iter::repeat_n(job, self.events_in_cycle(message)));
                    }
                    WindowKind::Exclusive => jobs.push(job),
                }
            }
        }
        self.table(self.spacing(own), jobs)
    }

    /// How often an event message may be sent in one basic cycle.
    fn events_in_cycle(&self, message: &Message) -> usize {
        let interval = match message.send_type {
            SendType::Event { interval_ms } => interval_ms,
            SendType::Cyclic { period_ms } => period_ms,
        };
        let cycle_ms = self.network.basic_cycle_us.div_ceil(1000);
        cycle_ms.div_ceil(interval.max(1)).max(1) as usize
    }

    /// What the window timer is set to.
    #[must_use]
    pub fn window_edges(&self) -> Vec<Timetable> {
        let mut jobs: Vec<Job> = Vec::new();
        let mut references: Vec<Job> = Vec::new();
        let mut arbitrating: Vec<Job> = Vec::new();
        let mut withdrawals: Vec<Job> = Vec::new();
        let at = |instant: Picoseconds| instant.saturating_sub(self.lead);
        let job = |label: String, instant: Picoseconds, deadline: Option<Picoseconds>| Job {
            label,
            earliest: at(instant),
            latest: at(instant),
            transmits: deadline.is_some(),
            deadline: deadline.or_else(|| self.until_next_frame(instant)),
        };
        for message in &self.network.messages {
            let window = message.window;
            let own = self.is_own(message);
            for begin in self.begins(window) {
                let start = begin + u64::from(window.start_us) * MICROSECOND;
                let end = begin + u64::from(window.end_us()) * MICROSECOND;
                match window.kind {
                    WindowKind::Reference if own => {
                        // Asked for at the end of the cycle before.
                        let instant = begin + self.basic_cycle();
                        let mut reference =
                            job(message.name.clone(), instant, Some(self.request()));
                        reference.latest += 2 * self.uncertainty();
                        references.push(reference);
                        continue;
                    }
                    WindowKind::Reference => continue,
                    WindowKind::Exclusive if own => {
                        jobs.push(job(message.name.clone(), start, Some(self.request())));
                        jobs.push(job(
                            format!("transmit enable of {}", message.name),
                            start + self.transmit_enable(),
                            None,
                        ));
                    }
                    WindowKind::Exclusive => {
                        jobs.push(job(format!("window of {}", message.name), start, None));
                    }
                    WindowKind::Arbitrating => {
                        arbitrating.push(job("arbitrating window".to_owned(), start, None));
                        if own {
                            withdrawals.push(self.last_moment(window, begin, message.length, 0));
                        }
                    }
                }
                jobs.push(job(
                    format!("end of the window at {} us", window.start_us),
                    end,
                    None,
                ));
            }
        }
        let withdrawals = one_in_each_window(withdrawals, self.basic_cycle());
        // Edges that coincide are one compare; the strictest of them counts.
        let compares = |mut jobs: Vec<Job>| {
            jobs.sort_by_key(|job| (job.earliest, job.latest, job.deadline.unwrap_or(u64::MAX)));
            jobs.dedup_by_key(|job| job.earliest);
            jobs
        };
        let arbitrating = compares(arbitrating);
        // The first edge of an arbitrating window passes the end of another with it.
        jobs.retain(|job| {
            job.transmits
                || arbitrating
                    .iter()
                    .all(|other| other.earliest != job.earliest)
        });
        let of_kind = |kind, jobs| Timetable {
            kind,
            ..self.table(0, jobs)
        };
        let mut tables = vec![
            of_kind(Kind::Exclusive, compares(jobs)),
            of_kind(Kind::Reference, references),
            of_kind(Kind::Arbitrating, arbitrating),
            self.in_window(0, 0, withdrawals),
        ];
        tables.retain(|table| !table.jobs.is_empty());
        tables
    }

    /// The instant at which the node's event message of this length can begin no
    /// more, up to `late` late.
    fn last_moment(
        &self,
        window: Window,
        begin: Picoseconds,
        length: u8,
        late: Picoseconds,
    ) -> Job {
        let end = begin + u64::from(window.end_us()) * MICROSECOND;
        let longest = (u64::from(worst_case_bits(length)) + INTERFRAME_BITS) * self.bit();
        let shortest = (SHORTEST_BITS + REST_BITS) * self.bit();
        Job {
            label: "last moment for event messages".to_owned(),
            earliest: end.saturating_sub(longest + self.uncertainty() + self.lead),
            latest: end.saturating_sub(shortest + self.uncertainty() + self.lead) + late,
            deadline: Some(self.fifo_margin()),
            transmits: false,
        }
    }

    /// The ends of the node's attempts that are withdrawn.
    #[must_use]
    pub fn withdrawn(&self) -> Option<Timetable> {
        let own = self.network.messages.iter();
        let own = own.filter(|m| self.is_own(m) && m.window.kind == WindowKind::Arbitrating);
        let jobs: Vec<Job> = own
            .flat_map(|message| {
                self.begins(message.window).map(|begin| {
                    self.last_moment(message.window, begin, message.length, self.fifo_margin())
                })
            })
            .collect();
        (!jobs.is_empty())
            .then(|| self.in_window(0, 0, one_in_each_window(jobs, self.basic_cycle())))
    }

    /// Time from an edge to the earliest end of a frame of another node that
    /// begins after it.
    fn until_next_frame(&self, edge: Picoseconds) -> Option<Picoseconds> {
        let length = self.cycles() * self.basic_cycle();
        let others = self.network.messages.iter().filter(|m| !self.is_own(m));
        others
            .flat_map(|message| {
                let window = message.window;
                let first = (SHORTEST_BITS + 8 * u64::from(message.shortest)) * self.bit();
                self.begins(window).map(move |begin| {
                    let start = begin + u64::from(window.start_us) * MICROSECOND;
                    let end = begin + u64::from(window.end_us()) * MICROSECOND;
                    // In an arbitrating window a frame may begin at any time.
                    let last = if window.kind == WindowKind::Arbitrating {
                        end.saturating_sub(first)
                    } else {
                        start
                    };
                    let edge = edge % length;
                    let wait = if edge <= start {
                        start - edge
                    } else if edge <= last {
                        0
                    } else {
                        start + length - edge
                    };
                    wait + first
                })
            })
            .min()
            .map(|time| time.saturating_sub(self.uncertainty()))
    }

    /// A release at this time of every basic cycle.
    #[must_use]
    pub fn marks(&self, at_us: &[u64]) -> Timetable {
        let jobs = (0..self.cycles()).flat_map(|cycle| {
            at_us.iter().map(move |at| {
                let instant = cycle * self.basic_cycle() + at * MICROSECOND;
                Job {
                    label: format!("{at} us of the cycle"),
                    earliest: instant,
                    latest: instant,
                    deadline: None,
                    transmits: false,
                }
            })
        });
        self.table(0, jobs.collect())
    }

    /// The node's own event messages being put in line during their window; else
    /// they wait for its begin.
    #[must_use]
    pub fn events_queued(&self) -> Option<Timetable> {
        let mut jobs = Vec::new();
        for message in self.network.messages.iter().filter(|m| self.is_own(m)) {
            let window = message.window;
            if window.kind != WindowKind::Arbitrating {
                continue;
            }
            for begin in self.begins(window) {
                let job = Job {
                    label: format!("{} is put in line", message.name),
                    earliest: (begin + u64::from(window.start_us) * MICROSECOND)
                        .saturating_sub(self.lead),
                    latest: begin + u64::from(window.end_us()) * MICROSECOND,
                    deadline: Some(self.fifo_margin()),
                    transmits: false,
                };
                jobs.extend(std::iter::repeat_n(job, self.events_in_cycle(message)));
            }
        }
        (!jobs.is_empty()).then(|| self.in_window(0, 0, jobs))
    }

    /// When the window of the node's own `message` begins at the latest for it
    /// to be in line; `None` if it has none.
    #[must_use]
    pub fn due(&self, message: &str) -> Option<Picoseconds> {
        let found = self.network.messages.iter();
        let message = found
            .filter(|m| self.is_own(m))
            .find(|m| m.name == message)?;
        Some((u64::from(message.window.start_us) * MICROSECOND).saturating_sub(self.lead))
    }
}

/// Of the windows of several messages that coincide, one.
fn one_in_each_window(mut jobs: Vec<Job>, cycle: Picoseconds) -> Vec<Job> {
    jobs.sort_by_key(|job| job.earliest);
    let mut merged: Vec<Job> = Vec::new();
    for job in jobs {
        match merged.last_mut() {
            Some(last) if last.earliest / cycle == job.earliest / cycle => {
                last.latest = last.latest.max(job.latest);
            }
            _ => merged.push(job),
        }
    }
    merged
}
