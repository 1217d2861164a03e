//! When the bus releases tasks: time tables from the network file.
//!
//! The cycle begins with the start of the reference message. A frame of another
//! node begins within the transmit enable window of its own window, by a clock
//! that may differ from this node's by the network's uncertainty; it has ended
//! after its shortest length at the earliest and its longest, fully stuffed, at
//! the latest. The window timer follows the node's own clock.

use network_model::{Message, Network, SendType, Window, WindowKind, worst_case_bits};

use crate::arrivals::{Job, Sporadic, Timetable};
use crate::results::{MICROSECOND, Picoseconds};

/// Bits of a data frame with an 11-bit identifier before its data are counted,
/// without stuffing, up to the last bit but one, where a receiver takes it.
const SHORTEST_BITS: u64 = 43;
/// The rest of the frame and the interframe space.
const REST_BITS: u64 = 4;

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
            jobs,
        }
    }

    /// The ends of frames, of its own or of all others.
    #[must_use]
    pub fn frames(&self, own: bool) -> Timetable {
        self.frames_of(own, |message| self.is_own(message) == own)
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
                    deadline: None,
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
    pub fn window_edges(&self) -> Timetable {
        let mut jobs: Vec<Job> = Vec::new();
        let at = |instant: Picoseconds| instant.saturating_sub(self.lead);
        let job = |label: String, instant: Picoseconds, deadline| Job {
            label,
            earliest: at(instant),
            latest: at(instant),
            deadline,
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
                            job(message.name.clone(), instant, Some(self.transmit_enable()));
                        reference.latest += 2 * self.uncertainty();
                        jobs.push(reference);
                        continue;
                    }
                    WindowKind::Reference => continue,
                    WindowKind::Exclusive if own => {
                        jobs.push(job(
                            message.name.clone(),
                            start,
                            Some(self.transmit_enable()),
                        ));
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
                        jobs.push(job("arbitrating window".to_owned(), start, None));
                        if own {
                            // Its turn comes after the window's beginning or after the
                            // message before it, whose end is dealt with by its deadline.
                            let times = self.events_in_cycle(message);
                            for what in ["turn of", "transmit enable of", "turn after"] {
                                let job = Job {
                                    label: format!("{what} {}", message.name),
                                    earliest: at(start),
                                    latest: end + self.after_frame(),
                                    deadline: None,
                                };
                                jobs.extend(std::iter::repeat_n(job, times));
                            }
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
        // Edges that coincide are one compare; the strictest of them counts.
        jobs.sort_by_key(|job| (job.earliest, job.latest, job.deadline.unwrap_or(u64::MAX)));
        jobs.dedup_by(|job, first| {
            job.earliest == job.latest
                && (job.earliest, job.latest) == (first.earliest, first.latest)
        });
        self.table(0, jobs)
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
                }
            })
        });
        self.table(0, jobs.collect())
    }

    /// The node's own event messages being put in line.
    #[must_use]
    pub fn events_queued(&self) -> Vec<Sporadic> {
        let own = self.network.messages.iter().filter(|m| self.is_own(m));
        own.filter_map(|message| match message.send_type {
            SendType::Event { interval_ms } if message.window.kind == WindowKind::Arbitrating => {
                let interval = u64::from(interval_ms.max(1)) * 1000 * MICROSECOND;
                Some(Sporadic::every(interval))
            }
            _ => None,
        })
        .collect()
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
