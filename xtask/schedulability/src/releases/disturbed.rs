//! Releases that disturbed frames bring; see the module above.

use std::collections::BTreeSet;

use network_model::{Message, Window, WindowKind, worst_case_bits};

use super::{ARBITRATION_BITS, Bus, INTERFRAME_BITS, MISSING_US, SHORTEST_BITS};
use crate::arrivals::{Job, JobId, Kind, Timetable};
use crate::can::{ERROR_FRAME_BITS, ErrorRate};
use crate::units::{MICROSECOND, Picoseconds};

/// Longest time from an error to the end of the error frame, in bits: two flags and the delimiter (ISO
/// 11898-1).
const ERROR_TAIL_BITS: u64 = 20;

/// Shortest time from an error to the next frame, in bits: flag, delimiter and interframe space.
const SHORTEST_ERROR_BITS: u64 = 17;

/// Transmit enable windows in which a reference that arrives is handled, and, if there are several potential time
/// masters, a disturbed one is requested again. What errors release lies that close to the begin of the
/// basic cycle.
const SOON: u64 = 4;
/// Those in which the only time master, to which errors bring less, requests its reference again.
const ALONE: u64 = 3;
/// Those in which it handles the end of its own.
const OWN: u64 = 2;

/// Nanoseconds in a time, rounded up.
const fn nanoseconds(time: Picoseconds) -> u64 {
    time.div_ceil(1000)
}

/// What errors do to the reference that begins a basic cycle.
struct References {
    /// How much later than without errors the basic cycle begins at most.
    late: Picoseconds,
    /// How many references are disturbed until then.
    disturbed: u64,
    /// Until when behind its begin the reference is handled.
    handled: Picoseconds,
    /// Whether a reference may count as missing before it is handled.
    missing: bool,
}

impl Bus<'_> {
    /// The same with disturbed frames.
    #[must_use]
    pub const fn with_errors(self, errors: ErrorRate) -> Self {
        Self { errors, ..self }
    }

    /// Longest time from an error to the end of the error frame, if there are errors.
    pub(super) fn error_tail(&self) -> Picoseconds {
        if self.errors.is_none() {
            0
        } else {
            ERROR_TAIL_BITS * self.bit()
        }
    }

    /// Shortest time from an error to the next frame.
    fn shortest_error(&self) -> Picoseconds {
        SHORTEST_ERROR_BITS * self.bit()
    }

    /// The shortest event messages of others that may come in addition because an error is repeated, each with
    /// the shortest error frame between them.
    pub(super) fn repeated_lengths(&self, shortest: Picoseconds) -> Vec<Picoseconds> {
        let longest = self.network.windows().into_iter();
        let events = longest.filter(|window| window.kind == WindowKind::Arbitrating);
        let most = events.map(|window| self.disturbed_in(window)).max();
        let most = usize::try_from(most.unwrap_or(0)).unwrap_or(usize::MAX);
        vec![shortest + self.shortest_error(); most.min(3)]
    }

    /// The most disturbed frames that can fall into a window.
    fn disturbed_in(&self, window: Window) -> u64 {
        let open = u64::from(window.length_us) * MICROSECOND + 2 * self.uncertainty();
        self.errors
            .errors(nanoseconds(open + ERROR_FRAME_BITS * self.bit()))
    }

    /// The longest reference message.
    fn longest_reference(&self) -> Picoseconds {
        let references = self.network.messages.iter().filter(is_reference);
        let lengths = references.map(|message| u64::from(worst_case_bits(message.length)));
        (lengths.max().unwrap_or(0) + INTERFRAME_BITS) * self.bit()
    }

    /// So many transmit enable windows, but before the first window of the cycle, and before three more frames
    /// overrun the FIFO.
    fn within(&self, windows: u64) -> Picoseconds {
        let others = self.network.messages.iter().map(|message| message.window);
        let others = others.filter(|window| window.kind != WindowKind::Reference);
        let first = others
            .map(|window| u64::from(window.start_us) * MICROSECOND)
            .min();
        let first = first
            .unwrap_or(self.basic_cycle())
            .saturating_sub(self.lead);
        let error = ERROR_FRAME_BITS * self.bit();
        let used = self.longest_reference() + error.max(self.uncertainty()) + self.uncertainty();
        let left = first.saturating_sub(used);
        (windows * self.transmit_enable())
            .min(left)
            .min(self.fifo_margin())
    }

    /// Time from the end of the reference that arrives until this node has handled it.
    fn soon(&self) -> Picoseconds {
        self.within(if self.leads_alone() { OWN } else { SOON })
    }

    /// Time from the end of a disturbed reference to the request of the next one, on any time master.
    fn requested_within(&self) -> Picoseconds {
        self.within(if self.has_backup() { SOON } else { ALONE })
    }

    /// Deadline for each of the two interrupts by which a reference is requested again: that of the failed attempt
    /// and that of the window timer, which it makes pending. If both have one priority, the second one's
    /// response time, counted from the release of the first, bounds both ([`crate::bus::reaction`]).
    fn again(&self) -> Picoseconds {
        if self.apart {
            self.requested_within() / 2
        } else {
            self.requested_within()
        }
    }

    /// The same if the transmit interrupt and the window timer have different priorities.
    #[must_use]
    pub const fn with_priorities_apart(self, apart: bool) -> Self {
        Self { apart, ..self }
    }

    /// The deadline of a job for a reference, if it is not that of its task because of errors.
    pub(super) fn reference_deadline(&self) -> Option<Picoseconds> {
        (!self.errors.is_none()).then(|| self.soon())
    }

    /// What errors do to the reference that begins a basic cycle; `None` without errors.
    fn references(&self) -> Option<References> {
        let frame = self.longest_reference();
        let each = ERROR_FRAME_BITS * self.bit() + frame + self.requested_within();
        let (mut late, mut disturbed) = (0, 0);
        loop {
            let errors = self.errors.errors(nanoseconds(late + frame));
            if errors <= disturbed {
                break;
            }
            disturbed = errors;
            // It is never later than a basic cycle: the reference counts as missing then, and the next one
            // begins the cycle.
            late = (disturbed * each).min(self.basic_cycle());
        }
        let handled = frame + 2 * self.uncertainty() + self.soon();
        (disturbed > 0).then(|| References {
            late,
            disturbed,
            handled,
            missing: self.missing() < late + handled,
        })
    }

    /// How much later than without errors a basic cycle may begin, because its reference message is repeated.
    #[must_use]
    pub fn reference_delay(&self) -> Picoseconds {
        self.references().map_or(0, |references| references.late)
    }

    /// How long after the expected begin of a basic cycle its reference counts as missing, if the cycle
    /// before began with a reference (`missing_after` in `ttcan`).
    fn missing(&self) -> Picoseconds {
        MISSING_US * MICROSECOND
            + self.uncertainty()
            + 2 * (self.longest_reference() - INTERFRAME_BITS * self.bit())
    }

    /// Whether this node is a potential time master.
    fn may_lead(&self) -> bool {
        let mut references = self.network.messages.iter().filter(is_reference);
        references.any(|message| self.is_own(message))
    }

    /// Whether this node is the only time master.
    fn leads_alone(&self) -> bool {
        self.may_lead() && !self.has_backup()
    }

    /// Whether there is more than one potential time master.
    fn has_backup(&self) -> bool {
        self.network.messages.iter().filter(is_reference).count() > 1
    }

    /// The job that comes before all that errors bring to the reference behind a basic cycle: a potential time
    /// master has requested its own reference by then, as no other one has ended. `None` for any other node.
    fn requested(&self, cycle: u64) -> Option<JobId> {
        let begin = (cycle - 1) * self.basic_cycle();
        let mut references = self.network.messages.iter().filter(is_reference);
        let own = references.find(|message| self.is_own(message))?;
        Self::request_of_reference(own.window, begin)
    }

    /// So many jobs for each basic cycle, which errors bring before it begins or soon afterwards, by the cycle
    /// time of the reference that arrives. A disturbed one has come up to `late` earlier. The jobs come `from`
    /// behind it at the earliest, and `until` behind the one that arrives at the latest.
    ///
    /// What the table has of the cycle before is further away than it says. The request of the first reference,
    /// which the table has at the begin of the cycle, comes before all of them, so it costs them no more time
    /// than if it came together with them.
    fn around(
        &self,
        references: &References,
        (from, until): (Picoseconds, Picoseconds),
        (label, deadline): (&str, Picoseconds),
        times: u64,
    ) -> Vec<Job> {
        let length = self.basic_cycle();
        let before = references.late + self.uncertainty() + self.lead;
        let each = (1..=self.cycles()).map(|cycle| Job {
            id: None,
            cause: self.requested(cycle),
            label: label.to_owned(),
            earliest: (cycle * length + from).saturating_sub(before),
            latest: cycle * length + until,
            deadline: Some(deadline),
            transmits: false,
        });
        each.flat_map(|job| repeated(job, times)).collect()
    }

    /// References that are received although their sender found an error in their last bit, and repeats
    /// them.
    pub(super) fn repeated_references(&self) -> Vec<Job> {
        self.references().map_or_else(Vec::new, |references| {
            // The next one follows it. Three more frames overrun the FIFO.
            let label = ("a reference that is repeated", self.fifo_margin());
            self.around(&references, (0, 0), label, references.disturbed)
        })
    }

    /// The ends of this node's references that errors bring; `None` if it is no time master or there are no
    /// errors.
    ///
    /// If it lost arbitration against one that is then disturbed, it requests its own when a reference counts
    /// as missing, and withdraws it when the other one is handled.
    #[must_use]
    pub fn disturbed_references(&self) -> Option<Timetable> {
        let references = self.references().filter(|_| self.may_lead())?;
        let label = ("a disturbed reference", self.again());
        let mut jobs = self.around(&references, (0, 0), label, references.disturbed);
        if references.missing && self.has_backup() {
            let label = ("a reference that is withdrawn again", self.again());
            let first = self.first_own_window().unwrap_or(Picoseconds::MAX);
            let handled = (self.missing().min(first), references.handled);
            jobs.extend(self.around(&references, handled, label, 1));
        }
        Some(Timetable {
            kind: Kind::Reference,
            ..self.table(0, jobs)
        })
    }

    /// Arbitrating windows of the wanted messages, each with the begin of its basic cycle.
    fn open_for(&self, wanted: impl Fn(&Message) -> bool) -> Vec<(Window, Picoseconds)> {
        let mut known = BTreeSet::new();
        let events =
            self.network.messages.iter().filter(|message| {
                message.window.kind == WindowKind::Arbitrating && wanted(message)
            });
        let mut open = Vec::new();
        for message in events {
            for begin in self.begins(message.window) {
                if known.insert((begin, message.window.start_us)) {
                    open.push((message.window, begin));
                }
            }
        }
        open
    }

    /// The ends of this node's attempts in arbitrating windows that errors bring: its own frame was
    /// disturbed, or it lost arbitration against one that was disturbed and is sent again. `None` if it
    /// sends no event message or there are no errors.
    #[must_use]
    pub fn disturbed_attempts(&self) -> Option<Timetable> {
        let open = self.open_for(|message| self.is_own(message));
        let jobs: Vec<Job> = open
            .into_iter()
            .flat_map(|(window, begin)| {
                let start = begin + u64::from(window.start_us) * MICROSECOND;
                let end = begin + u64::from(window.end_us()) * MICROSECOND;
                let job = Job {
                    id: None,
                    cause: Self::opening(window, begin),
                    label: "an attempt that an error ends".to_owned(),
                    earliest: (start + ARBITRATION_BITS * self.bit())
                        .saturating_sub(self.uncertainty()),
                    latest: end + self.uncertainty() + self.error_tail(),
                    deadline: Some(self.event_margin()),
                    transmits: false,
                };
                repeated(job, self.disturbed_in(window))
            })
            .collect();
        (!jobs.is_empty()).then(|| self.in_window(0, 0, jobs))
    }

    /// Event messages that are received although their sender found an error in their last bit, and repeats
    /// them: as many as there can be errors in each window.
    pub(super) fn repeated_events(&self, wanted: impl Fn(&Message) -> bool) -> Vec<Job> {
        let open = self.open_for(wanted).into_iter();
        open.flat_map(|(window, begin)| {
            let start = begin + u64::from(window.start_us) * MICROSECOND;
            let job = Job {
                id: None,
                cause: None,
                label: "an event message that is repeated".to_owned(),
                earliest: (start + SHORTEST_BITS * self.bit()).saturating_sub(self.uncertainty()),
                latest: begin + u64::from(window.end_us()) * MICROSECOND + self.uncertainty(),
                deadline: Some(self.event_margin()),
                transmits: false,
            };
            repeated(job, self.disturbed_in(window))
        })
        .collect()
    }

    /// The window timer's jobs that disturbed references bring: a time master requests its own again, and a
    /// backup withdraws it; a missing reference is noted; and a node that has begun the cycle with a reference
    /// that is repeated meets its first `edges` before that one begins it again. What it does then is of no
    /// use, so it may be late.
    pub(super) fn edges_again(&self, edges: &[Timetable]) -> Vec<Timetable> {
        let Some(references) = self.references() else {
            return Vec::new();
        };
        let of_kind = |kind, jobs| Timetable {
            kind,
            ..self.table(0, jobs)
        };
        let mut tables = Vec::new();
        if self.may_lead() {
            let label = ("a reference is requested again", self.again());
            let mut jobs = self.around(&references, (0, 0), label, references.disturbed);
            let backup = self.has_backup();
            let late = u64::from(backup && references.missing);
            let handled = (self.missing(), references.handled);
            jobs.extend(self.around(&references, handled, label, late));
            tables.push(of_kind(Kind::Reference, jobs));
            if backup {
                let label = ("transmit enable of a reference again", self.again());
                let times = references.disturbed + late;
                let jobs = self.around(&references, (0, references.handled), label, times);
                tables.push(of_kind(Kind::Exclusive, jobs));
            }
        }
        if references.missing {
            let label = ("a reference counts as missing", self.fifo_margin());
            let handled = (self.missing(), references.handled);
            tables.push(of_kind(
                Kind::Exclusive,
                self.around(&references, handled, label, 1),
            ));
        }
        if self.leads_alone() {
            // It takes no reference.
            tables.retain(|table| !table.jobs.is_empty());
            return tables;
        }
        let known = references.late + references.handled;
        // A single error is either one of a reference that this node does not take, or one of a reference that
        // it takes. What it brings in the first case stands for the second one, too.
        let mut instead = if self.stands_for_both(&references) {
            3
        } else {
            0
        };
        for table in edges {
            let first = table
                .jobs
                .iter()
                .filter(|job| job.cause.is_none() && job.earliest < known.min(self.basic_cycle()));
            let first = first.skip(match table.kind {
                Kind::Exclusive => std::mem::take(&mut instead),
                _ => 0,
            });
            let jobs = first.flat_map(|job| {
                let label = format!("{} behind a reference that is repeated", job.label);
                let deadline = job.deadline.unwrap_or(0).max(self.soon());
                self.around(
                    &references,
                    (job.earliest, references.handled),
                    (&label, deadline),
                    references.disturbed,
                )
            });
            tables.push(of_kind(table.kind, jobs.collect()));
        }
        tables.retain(|table| !table.jobs.is_empty());
        tables
    }

    /// Whether the jobs that one error brings to a backup, which does not take the disturbed reference, are as many
    /// and as wide apart as those that it brings if the backup takes it: one that withdraws each of two
    /// references, and one that notes a missing one; and the ends of both.
    fn stands_for_both(&self, references: &References) -> bool {
        self.may_lead() && self.has_backup() && references.missing && references.disturbed == 1
    }

    /// The begin of this node's first exclusive window.
    fn first_own_window(&self) -> Option<Picoseconds> {
        let own =
            self.network.messages.iter().filter(|message| {
                self.is_own(message) && message.window.kind == WindowKind::Exclusive
            });
        let starts = own.map(|message| u64::from(message.window.start_us) * MICROSECOND);
        starts.min()
    }

    /// The ends of this node's frames in the first windows that follow a reference which is repeated.
    #[must_use]
    pub fn frames_again(&self) -> Option<Timetable> {
        let references = self.references().filter(|_| !self.leads_alone())?;
        let known = references.late + references.handled;
        let own = self.network.messages.iter().filter(|message| {
            let start = u64::from(message.window.start_us) * MICROSECOND;
            self.is_own(message) && message.window.kind == WindowKind::Exclusive && start < known
        });
        let own = own.skip(usize::from(self.stands_for_both(&references)));
        let jobs: Vec<Job> = own
            .flat_map(|message| {
                let start = u64::from(message.window.start_us) * MICROSECOND;
                let label = format!("{} behind a reference that is repeated", message.name);
                let last = u64::from(worst_case_bits(message.length)) * self.bit();
                // If the repeated reference is on the bus already, the frame waits, and is withdrawn when that
                // is handled.
                let end = if references.late > start {
                    self.transmit_enable() + last + self.error_tail()
                } else {
                    0
                };
                let until = references.handled + end;
                let label = (label.as_str(), self.soon());
                self.around(&references, (start, until), label, references.disturbed)
            })
            .collect();
        (!jobs.is_empty()).then(|| Timetable {
            kind: Kind::Exclusive,
            ..self.table(0, jobs)
        })
    }
}

fn is_reference(message: &&Message) -> bool {
    message.window.kind == WindowKind::Reference
}

fn repeated(job: Job, times: u64) -> impl Iterator<Item = Job> {
    std::iter::repeat_n(job, usize::try_from(times).unwrap_or(usize::MAX))
}
