//! When the bus releases tasks: time tables from the network file.
//!
//! The cycle begins with the start of the reference message. A frame of another node starts in
//! the transmit enable window of its own window, by a clock that may differ from this node's by
//! the network's uncertainty. It ends after its shortest length at the earliest, and after its
//! longest, fully stuffed length at the latest. The window timer runs on this node's clock.
//!
//! # Disturbed frames
//! They release more jobs ([`Bus::with_errors`]):
//!
//! - **Exclusive window**: nothing is sent again, so no job is added. The sender's transmit interrupt comes
//!   at any bit of the frame, and up to an error frame behind it. Receivers have one release fewer, or the
//!   same if only the last bit was disturbed.
//! - **Arbitrating window**: each disturbed frame ends one attempt of each node at most, and the next attempt
//!   follows it. If only its last bit was disturbed, the receivers have taken the frame, and take its
//!   repetition as well.
//! - **Reference message**: the time master repeats it at once. The basic cycle begins with the one that
//!   arrives, so what the errors bring lies before the begin of that cycle, by up to
//!   [`Bus::reference_delay`]. Nodes that took a reference of which only the last bit was disturbed begin
//!   the cycle twice, with the first edges of the windows. Others may count a reference as missing.

mod disturbed;

use std::collections::BTreeMap;

use network_model::{Message, Network, Window, WindowKind, worst_case_bits};

use crate::arrivals::{Job, JobId, Kind, Timetable};
use crate::bus;
use crate::can::{ErrorRate, INTERFRAME_BITS};
use crate::units::{MICROSECOND, Picoseconds};

/// Bits of a data frame with an 11-bit identifier, without data and stuffing, up to the last bit
/// but one, at which a receiver accepts it.
const SHORTEST_BITS: u64 = 43;
/// Bits before a node can lose arbitration: the start of frame.
const ARBITRATION_BITS: u64 = 1;
/// The last bit of the frame and the interframe space.
const REST_BITS: u64 = 4;

/// How long after the expected begin of a reference it counts as missing, but for the uncertainty and two
/// references: the largest reference trigger offset (ISO 11898-4), as in `ttcan`'s `missing_after`.
const MISSING_US: u64 = 127;

/// The bus as one node sees it.
#[derive(Debug, Clone, Copy)]
pub struct Bus<'a> {
    network: &'a Network,
    node: &'a str,
    lead: Picoseconds,
    errors: ErrorRate,
    /// Whether the transmit interrupt and the window timer have different priorities.
    apart: bool,
}

impl<'a> Bus<'a> {
    /// For a node that starts its transmissions `lead` before their time mark.
    #[must_use]
    pub fn new(network: &'a Network, node: &'a str, lead: Picoseconds) -> Self {
        Self {
            network,
            node,
            lead,
            errors: ErrorRate::NONE,
            apart: false,
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

    /// How long after the begin of its window a frame may start.
    #[must_use]
    pub fn transmit_enable(&self) -> Picoseconds {
        u64::from(self.network.transmit_enable_bits) * self.bit()
    }

    /// Deadline from the expiry of the node's timer to the request of the frame. The frame must
    /// start in the transmit enable window, and the controller starts it at the next bit.
    fn request(&self) -> Picoseconds {
        (self.transmit_enable() + self.lead).saturating_sub(self.bit())
    }

    /// Least time between the ends of two frames, of this node (`own`) or of other nodes.
    #[must_use]
    pub fn spacing(&self, own: bool) -> Picoseconds {
        let messages = self.network.messages.iter();
        let bits = messages
            .filter(|message| self.is_own(message) == own)
            .map(|message| SHORTEST_BITS + REST_BITS + 8 * u64::from(message.shortest))
            .min();
        bits.unwrap_or(SHORTEST_BITS + REST_BITS) * self.bit()
    }

    /// Least time from the latest end of a frame in an exclusive window to the instant at which
    /// the window timer closes the window.
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

    /// Number of basic cycles in the system matrix; one if all of them are alike.
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

    /// The begins of the basic cycles that have this window.
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
            jobs,
        }
    }

    /// A table of releases in arbitrating windows, each with the [`Bus::opening`] of its window as
    /// its cause.
    fn in_window(&self, spacing: Picoseconds, burst: u64, jobs: Vec<Job>) -> Timetable {
        Timetable {
            burst,
            kind: Kind::Arbitrating,
            ..self.table(spacing, jobs)
        }
    }

    /// The job at the first edge of an arbitrating window, or of an exclusive one of this node, in the
    /// basic cycle that begins at `begin`. Without it, this node does nothing in the window. Windows in one
    /// cycle do not overlap, so the begin of the window, in microseconds, is its number.
    fn opening(window: Window, begin: Picoseconds) -> Option<JobId> {
        let start = begin / MICROSECOND + u64::from(window.start_us);
        u32::try_from(start).ok().map(JobId)
    }

    /// The ends of frames: those of other nodes, or those of this node (`own`) outside the
    /// arbitrating windows, for which see [`Bus::attempts`].
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
                ..self.frames_of(|message| {
                    self.is_own(message) == own && message.window.kind == window
                })
            })
            .filter(|table| !table.jobs.is_empty())
            .collect()
    }

    /// The identifiers of the frames of other nodes, by the kind of the jobs that receive them. A message of an
    /// exclusive window may come in an arbitrating one, too, if its sender may send it late.
    #[must_use]
    pub fn received(&self) -> BTreeMap<Kind, Vec<u16>> {
        let mut received: BTreeMap<Kind, Vec<u16>> = BTreeMap::new();
        let messages = self.network.messages.iter();
        for message in messages.filter(|message| !self.is_own(message)) {
            let kinds: &[Kind] = match message.window.kind {
                WindowKind::Reference => &[Kind::Reference],
                WindowKind::Exclusive if message.retry_late => {
                    &[Kind::Exclusive, Kind::Arbitrating]
                }
                WindowKind::Exclusive => &[Kind::Exclusive],
                WindowKind::Arbitrating => &[Kind::Arbitrating],
            };
            for kind in kinds {
                received.entry(*kind).or_default().push(message.id);
            }
        }
        received
    }

    /// Deadline for handling a frame: the three-deep receive FIFO overruns after three more frames.
    #[must_use]
    pub fn fifo_margin(&self) -> Picoseconds {
        3 * self.spacing(false)
    }

    /// The same in an arbitrating window, where no message comes more often than its interval
    /// allows: three more frames are at least as long as the three shortest.
    #[must_use]
    pub fn event_margin(&self) -> Picoseconds {
        let events = self.network.messages.iter().filter(|message| {
            !self.is_own(message) && message.window.kind == WindowKind::Arbitrating
        });
        let mut lengths: Vec<Picoseconds> = events
            .flat_map(|message| {
                let bits = SHORTEST_BITS + REST_BITS + 8 * u64::from(message.shortest);
                std::iter::repeat_n(bits * self.bit(), self.events_in_window(message))
            })
            .collect();
        let shortest = lengths.iter().min().copied();
        lengths.extend(
            shortest
                .into_iter()
                .flat_map(|one| self.repeated_lengths(one)),
        );
        lengths.sort_unstable();
        let margin: Picoseconds = lengths.iter().take(3).sum();
        // The next frames may be those of another window if that follows soon.
        let follows = self.pause_after_events().is_none_or(|pause| pause < margin);
        if lengths.len() < 3 || follows {
            self.fifo_margin()
        } else {
            margin
        }
    }

    /// Least time from the end of an arbitrating window to the begin of the next window of another
    /// kind; `None` without an arbitrating window.
    fn pause_after_events(&self) -> Option<Picoseconds> {
        let cycle = u64::from(self.network.basic_cycle_us);
        let windows = self.network.windows();
        let (events, others): (Vec<&Window>, Vec<&Window>) = windows
            .iter()
            .partition(|window| window.kind == WindowKind::Arbitrating);
        let pause = |events: &&Window, other: &&Window| {
            let end = u64::from(events.end_us());
            (u64::from(other.start_us) + cycle).saturating_sub(end) % cycle
        };
        let pauses = events
            .iter()
            .flat_map(|event| others.iter().map(move |other| pause(event, other)));
        Some(pauses.min()? * MICROSECOND)
    }

    /// Least time from the end of a frame of another window to the begin of an arbitrating one; `None`
    /// without an arbitrating window.
    fn pause_before_events(&self) -> Option<Picoseconds> {
        let cycle = u64::from(self.network.basic_cycle_us) * MICROSECOND;
        let (events, others): (Vec<&Message>, Vec<&Message>) = self
            .network
            .messages
            .iter()
            .partition(|message| message.window.kind == WindowKind::Arbitrating);
        let pause = |event: &Message, other: &Message| {
            let frame = u64::from(worst_case_bits(other.length)) * self.bit();
            let start = u64::from(other.window.start_us) * MICROSECOND;
            let end = (start + self.transmit_enable() + frame) % cycle.max(1);
            let begin = u64::from(event.window.start_us) * MICROSECOND;
            (begin + cycle).saturating_sub(end) % cycle.max(1)
        };
        let pauses = events
            .iter()
            .flat_map(|event| others.iter().map(move |other| pause(event, other)));
        pauses.min()
    }

    /// The ends of this node's attempts in each arbitrating window: its message was sent, or lost
    /// arbitration against another one.
    ///
    /// Each frame on the bus ends at most one of our attempts, won or lost, and not before its
    /// first bits. So of any three ends, the first and the last are at least a frame apart. An
    /// attempt may also be withdrawn ([`Bus::withdrawn`]); none follows it in that window.
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
                    id: None,
                    cause: Self::opening(window, begin),
                    label: format!("{what} {}", message.name),
                    earliest: (begin
                        + u64::from(window.start_us) * MICROSECOND
                        + ARBITRATION_BITS * self.bit())
                    .saturating_sub(self.uncertainty()),
                    latest: begin + u64::from(window.end_us()) * MICROSECOND + self.uncertainty(),
                    deadline: Some(self.event_margin()),
                    transmits: false,
                };
                jobs.extend(std::iter::repeat_n(job, self.events_in_window(message)));
            }
        }
        let shortest = messages()
            .map(|message| SHORTEST_BITS + REST_BITS + 8 * u64::from(message.shortest))
            .min()?;
        Some(self.in_window(shortest * self.bit(), 1, jobs))
    }

    /// The ends of a message of another node; `None` if no other node sends it.
    #[must_use]
    pub fn message(&self, name: &str) -> Option<Timetable> {
        let mut table = self.frames_of(|message| !self.is_own(message) && message.is_named(name));
        let mut named = self.network.messages.iter().filter(|m| m.is_named(name));
        if named.all(|message| message.window.kind == WindowKind::Reference) {
            // Only the receive interrupt has to be soon.
            table.jobs.iter_mut().for_each(|job| job.deadline = None);
        }
        (!table.jobs.is_empty()).then_some(table)
    }

    /// The ends of the wanted messages.
    fn frames_of(&self, wanted: impl Fn(&Message) -> bool) -> Timetable {
        let wanted_bits = self
            .network
            .messages
            .iter()
            .filter(|message| wanted(message));
        let bits = |message: &Message| SHORTEST_BITS + REST_BITS + 8 * u64::from(message.shortest);
        let shortest = wanted_bits.map(bits).min();
        let spacing = shortest.unwrap_or(SHORTEST_BITS + REST_BITS) * self.bit();
        let mut all = self.network.messages.iter();
        let own = all.any(|m| wanted(m) && self.is_own(m));
        let mut jobs = if own {
            Vec::new()
        } else {
            self.repeated_events(&wanted)
        };
        let mut references: Vec<(Window, usize)> = Vec::new();
        for message in self.network.messages.iter().filter(|m| wanted(m)) {
            let window = message.window;
            // An error may end an own frame at any bit. In the other windows it adds a job.
            let single = own && window.kind == WindowKind::Exclusive;
            let first = if single && !self.errors.is_none() {
                ARBITRATION_BITS * self.bit()
            } else {
                (SHORTEST_BITS + 8 * u64::from(message.shortest)) * self.bit()
            };
            let tail = if single { self.error_tail() } else { 0 };
            let last = u64::from(worst_case_bits(message.length)) * self.bit();
            for begin in self.begins(window) {
                let start = begin + u64::from(window.start_us) * MICROSECOND;
                let end = begin + u64::from(window.end_us()) * MICROSECOND;
                if window.kind == WindowKind::Reference && self.backs_up(message) {
                    jobs.push(self.end_of_backup(message, begin));
                    continue;
                }
                let job = Job {
                    id: None,
                    cause: single.then(|| Self::opening(window, begin)).flatten(),
                    label: message.name.clone(),
                    earliest: (start + first).saturating_sub(self.uncertainty()),
                    latest: match window.kind {
                        WindowKind::Arbitrating => end + self.uncertainty(),
                        // The cycle begins with it.
                        WindowKind::Reference => start + last + self.uncertainty(),
                        WindowKind::Exclusive => {
                            start + self.transmit_enable() + last + tail + self.uncertainty()
                        }
                    },
                    deadline: match window.kind {
                        WindowKind::Arbitrating => Some(self.event_margin()),
                        WindowKind::Exclusive if own => Some(self.until_own_window(message)),
                        WindowKind::Exclusive => None,
                        WindowKind::Reference => self.reference_deadline(),
                    },
                    transmits: single,
                };
                match window.kind {
                    // There may be several time masters, but there is one reference in each cycle.
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
                        jobs.extend(std::iter::repeat_n(job, self.events_in_window(message)));
                    }
                    WindowKind::Exclusive => jobs.push(job),
                }
            }
        }
        // For those of this node see [`Bus::disturbed_references`].
        if !own && !references.is_empty() {
            jobs.extend(self.repeated_references());
        }
        self.table(spacing, jobs)
    }

    /// Least time from the end of this node's `message` in its exclusive window, or of the error frame that
    /// destroys it, to the begin of its own next window: its mailbox must be free by then.
    fn until_own_window(&self, message: &Message) -> Picoseconds {
        let cycle = self.basic_cycle();
        let start = |message: &Message| u64::from(message.window.start_us) * MICROSECOND;
        let own = self
            .network
            .messages
            .iter()
            .filter(|other| self.is_own(other));
        let next = own.map(
            |other| match (start(other) + cycle - start(message)) % cycle.max(1) {
                0 => cycle,
                pause => pause,
            },
        );
        let last = u64::from(worst_case_bits(message.length)) * self.bit();
        let used = self.transmit_enable() + last + self.error_tail() + self.lead;
        next.min().unwrap_or(cycle).saturating_sub(used)
    }

    /// How often an event message may be sent in one of its windows. One that is sent in place of
    /// another one counts with that.
    fn events_in_window(&self, message: &Message) -> usize {
        if message.instead_of.is_some() {
            return 0;
        }
        usize::try_from(bus::in_one_window(self.network, message)).unwrap_or(usize::MAX)
    }

    /// The instants to which the window timer is set.
    #[must_use]
    pub fn window_edges(&self) -> Vec<Timetable> {
        let mut edges = Edges::default();
        for message in &self.network.messages {
            for begin in self.begins(message.window) {
                self.add_edges(&mut edges, message, begin);
            }
        }
        let withdrawals = one_in_each_window(edges.withdrawals);
        // Edges at the same instant are one timer compare. The strictest of them counts.
        let compares = |mut jobs: Vec<Job>| {
            jobs.sort_by_key(|job| (job.earliest, job.latest, job.deadline.unwrap_or(u64::MAX)));
            jobs.dedup_by_key(|job| job.earliest);
            jobs
        };
        let arbitrating = compares(edges.arbitrating);
        // The first edge of an arbitrating window also handles the end of the window before it.
        edges.exclusive.retain(|job| {
            let mut others = arbitrating.iter();
            job.transmits || others.all(|other| other.earliest != job.earliest)
        });
        let of_kind = |kind, jobs| Timetable {
            kind,
            ..self.table(0, jobs)
        };
        let mut tables = vec![
            of_kind(Kind::Exclusive, compares(edges.exclusive)),
            of_kind(Kind::Reference, edges.references),
            of_kind(Kind::Arbitrating, arbitrating),
            self.in_window(0, 0, withdrawals),
        ];
        tables.extend(self.edges_again(&tables));
        tables.retain(|table| !table.jobs.is_empty());
        tables
    }

    /// Adds the edges of a message's window, in the basic cycle that begins at `begin`.
    fn add_edges(&self, edges: &mut Edges, message: &Message, begin: Picoseconds) {
        let window = message.window;
        let start = begin + u64::from(window.start_us) * MICROSECOND;
        let end = begin + u64::from(window.end_us()) * MICROSECOND;
        let own = self.is_own(message);
        let exclusive = &mut edges.exclusive;
        match window.kind {
            WindowKind::Reference => {
                if own {
                    // Requested at the end of the cycle before.
                    let mut request = self.transmission(message, begin + self.basic_cycle());
                    request.latest += 2 * self.uncertainty();
                    request.id = Self::request_of_reference(window, begin);
                    if self.backs_up(message) {
                        exclusive.push(self.withdrawal_of_backup(&request));
                    }
                    edges.references.push(request);
                }
                return;
            }
            WindowKind::Exclusive if own => {
                exclusive.push(Job {
                    id: Self::opening(window, begin),
                    ..self.transmission(message, start)
                });
                let label = format!("transmit enable of {}", message.name);
                exclusive.push(self.edge(label, start + self.transmit_enable()));
            }
            WindowKind::Exclusive => {
                exclusive.push(self.edge(format!("window of {}", message.name), start));
            }
            WindowKind::Arbitrating => {
                edges.arbitrating.push(Job {
                    id: Self::opening(window, begin),
                    ..self.edge("arbitrating window".to_owned(), start)
                });
                if own {
                    let last = self.last_instant(window, begin, message.length, 0);
                    edges.withdrawals.push(last);
                }
            }
        }
        let label = format!("end of the window at {} us", window.start_us);
        exclusive.push(self.edge(label, end));
    }

    /// The edge at `instant` at which this node transmits a message.
    fn transmission(&self, message: &Message, instant: Picoseconds) -> Job {
        Job {
            deadline: Some(self.request()),
            transmits: true,
            ..self.edge(message.name.clone(), instant)
        }
    }

    /// Whether this node's own reference may find that of another master on the bus.
    fn backs_up(&self, message: &Message) -> bool {
        let mut others = self.network.messages.iter().filter(|m| !self.is_own(m));
        self.is_own(message) && others.any(|m| m.window.kind == WindowKind::Reference)
    }

    /// The job that requests this node's reference at the end of the basic cycle that begins at
    /// `begin`. No arbitrating window begins together with a cycle, so [`Bus::opening`] names no
    /// other job like this.
    fn request_of_reference(window: Window, begin: Picoseconds) -> Option<JobId> {
        Self::opening(window, begin)
    }

    /// A backup withdraws its reference a transmit enable window after it requested that, which
    /// may be as late as the deadline of that `request`.
    fn withdrawal_of_backup(&self, request: &Job) -> Job {
        let first = request.earliest + self.transmit_enable();
        Job {
            id: None,
            cause: request.id,
            label: format!("transmit enable of {}", request.label),
            earliest: first,
            latest: request.latest + self.request() + self.transmit_enable(),
            deadline: self.until_next_frame(first + self.lead),
            transmits: false,
        }
    }

    /// The end of a backup's reference that was requested in the basic cycle that begins at
    /// `begin`: it loses arbitration or is withdrawn, or it is sent because no other came.
    fn end_of_backup(&self, message: &Message, begin: Picoseconds) -> Job {
        let start = begin + self.basic_cycle();
        let last = u64::from(worst_case_bits(message.length)) * self.bit();
        Job {
            id: None,
            cause: Self::request_of_reference(message.window, begin),
            label: message.name.clone(),
            earliest: (start + ARBITRATION_BITS * self.bit()).saturating_sub(self.lead),
            latest: start + self.transmit_enable() + last + 2 * self.uncertainty(),
            deadline: None,
            transmits: false,
        }
    }

    /// An edge at `instant` at which this node does not transmit.
    fn edge(&self, label: String, instant: Picoseconds) -> Job {
        let at = instant.saturating_sub(self.lead);
        Job {
            id: None,
            cause: None,
            label,
            earliest: at,
            latest: at,
            deadline: self.until_next_frame(instant),
            transmits: false,
        }
    }

    /// The last instant at which an event message of this node with this length can still start
    /// in the window, up to `late` late.
    fn last_instant(
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
            id: None,
            cause: Self::opening(window, begin),
            label: "last instant for event messages".to_owned(),
            earliest: end.saturating_sub(longest + self.uncertainty() + self.lead),
            latest: end.saturating_sub(shortest + self.uncertainty() + self.lead) + late,
            deadline: Some(self.event_margin()),
            transmits: false,
        }
    }

    /// The ends of this node's attempts that are withdrawn at the last instant of the window.
    #[must_use]
    pub fn withdrawn(&self) -> Option<Timetable> {
        let own = self.network.messages.iter();
        let own = own.filter(|m| self.is_own(m) && m.window.kind == WindowKind::Arbitrating);
        let jobs: Vec<Job> = own
            .flat_map(|message| {
                self.begins(message.window).map(|begin| {
                    self.last_instant(message.window, begin, message.length, self.fifo_margin())
                })
            })
            .collect();
        (!jobs.is_empty()).then(|| self.in_window(0, 0, one_in_each_window(jobs)))
    }

    /// Time from a window edge to the earliest end of a frame of another node that starts after
    /// the edge.
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
                    // In an arbitrating window a frame may start at any time.
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

    /// A release at each of these instants of every basic cycle, in microseconds.
    #[must_use]
    pub fn marks(&self, at_us: &[u64]) -> Timetable {
        let jobs = (0..self.cycles()).flat_map(|cycle| {
            at_us.iter().map(move |at| {
                let instant = cycle * self.basic_cycle() + at * MICROSECOND;
                Job {
                    id: None,
                    cause: None,
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

    /// The instants at which this node may enqueue its event messages during their window. A
    /// message that is enqueued outside of it waits for the window's first edge. As the ends of
    /// attempts ([`Bus::attempts`]), they must be handled before three more event messages end. If a
    /// frame of the window before may end after the first edge, it is one of the three.
    #[must_use]
    pub fn events_queued(&self) -> Option<Timetable> {
        let alone = self
            .pause_before_events()
            .is_none_or(|pause| pause >= self.lead + self.uncertainty());
        let deadline = if alone {
            self.event_margin()
        } else {
            self.fifo_margin()
        };
        let mut jobs = Vec::new();
        for message in self.network.messages.iter().filter(|m| self.is_own(m)) {
            let window = message.window;
            if window.kind != WindowKind::Arbitrating {
                continue;
            }
            for begin in self.begins(window) {
                let job = Job {
                    id: None,
                    cause: Self::opening(window, begin),
                    label: format!("{} is enqueued", message.name),
                    earliest: (begin + u64::from(window.start_us) * MICROSECOND)
                        .saturating_sub(self.lead),
                    latest: begin + u64::from(window.end_us()) * MICROSECOND,
                    deadline: Some(deadline),
                    transmits: false,
                };
                jobs.extend(std::iter::repeat_n(job, self.events_in_window(message)));
            }
        }
        (!jobs.is_empty()).then(|| self.in_window(0, 0, jobs))
    }

    /// The latest instant of the basic cycle at which this node may enqueue its `message`: the
    /// begin of its window, less the lead. `None` if the node does not send the message.
    #[must_use]
    pub fn due(&self, message: &str) -> Option<Picoseconds> {
        let found = self.network.messages.iter();
        let message = found
            .filter(|m| self.is_own(m))
            .find(|m| m.name == message)?;
        Some((u64::from(message.window.start_us) * MICROSECOND).saturating_sub(self.lead))
    }
}

/// Window edges by their kind.
#[derive(Default)]
struct Edges {
    /// Begins and ends of exclusive windows, and the ends of all windows.
    exclusive: Vec<Job>,
    /// Requests of reference messages.
    references: Vec<Job>,
    /// Begins of arbitrating windows.
    arbitrating: Vec<Job>,
    /// Last instants for event messages.
    withdrawals: Vec<Job>,
}

/// Merges the jobs of several messages that share a window, and so have the same cause, into one for
/// each window.
fn one_in_each_window(mut jobs: Vec<Job>) -> Vec<Job> {
    jobs.sort_by_key(|job| job.earliest);
    let mut merged: Vec<Job> = Vec::new();
    for job in jobs {
        match merged.iter_mut().find(|other| other.cause == job.cause) {
            Some(other) => other.latest = other.latest.max(job.latest),
            None => merged.push(job),
        }
    }
    merged
}
