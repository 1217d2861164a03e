//! What is known of a bus from the frames that have come.

use std::{
    collections::{BTreeMap, VecDeque},
    fmt::Write,
    time::Duration,
};

use can_bus::{Frame, wire::INTERMISSION_BITS};
use embedded_can::Id;
use serde::Serialize;
use vehicle_model::Vehicle;
use world::report::{FrameRecord, ModeChange, Window, WindowKind, rounded};
use world::{SimTime, time::span_micros};

use crate::network::{
    length::frame_bits,
    matrix::{Matrix, are_in_order},
};

/// The last time span that classes are judged by.
const SPAN: Duration = Duration::from_secs(1);
/// A node without a frame for so many basic cycles is dead (thesis 4.3.7).
const DEAD_CYCLES: u32 = 3;
/// More than so many times the frames that are planned are babble.
const BABBLE: f64 = 2.0;
/// How far a frame of an adapter's time stamp may be from its window: adapters on USB report a frame
/// up to some milliseconds after its end.
const STAMPED: Duration = Duration::from_millis(4);

/// As many changes of classes are kept. A bus that has more of them is told by its last ones.
const CHANGES: usize = 200;

/// From such a difference on it is told how fast the bus runs against time.
const DRIFT: f64 = 0.05;

/// How a node behaves (thesis 4.3.7).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Class {
    /// It sends in its windows.
    Present,
    /// Nothing was heard of it so far.
    Unheard,
    /// It sends only when there is an occasion, and there was none of late.
    Quiet,
    /// It has fallen silent.
    Dead,
    /// Half of its frames, or more, are out of their windows.
    Lost,
    /// It sends more than is planned.
    Babbling,
}

impl Class {
    /// In a word.
    pub(crate) const fn word(self) -> &'static str {
        match self {
            Self::Present => "present",
            Self::Unheard => "not heard",
            Self::Quiet => "quiet",
            Self::Dead => "dead",
            Self::Lost => "lost",
            Self::Babbling => "babbling",
        }
    }
}

/// A node.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NodeState {
    /// Its name.
    pub node: String,
    /// How it behaves.
    pub class: Class,
    /// Its frames so far.
    pub frames: u64,
    /// Time since its last frame, s.
    pub silent_seconds: Option<f64>,
}

/// A message and its window.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WindowState {
    /// Its identifier.
    pub id: u16,
    /// Its name.
    pub message: String,
    /// Its sender.
    pub sender: String,
    /// Its frames so far.
    pub frames: u64,
    /// Frames in the last second.
    pub per_second: f64,
    /// Start of the last frame behind the begin of its window, us, by the adapter's time stamps; `None`
    /// in a window that is shared, or without a reference.
    pub behind_window_us: Option<f64>,
    /// Frames that were out of their window by more than the time stamps may err.
    pub outside: u64,
}

/// A node that began to behave in another way.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Change {
    /// When that was seen, s.
    pub at: f64,
    /// The node.
    pub node: String,
    /// How it behaves from here on.
    pub class: Class,
}

/// All that is known at an instant.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Picture {
    /// The vehicle.
    pub vehicle: String,
    /// How long the bus was watched, s.
    pub watched_seconds: f64,
    /// How fast the clock of the time stamps runs against the computer's, if that is known: a simulated bus
    /// may be slower than time. All times of frames are by the stamps.
    pub pace: Option<f64>,
    /// Frames.
    pub frames: u64,
    /// Lines of the adapter that say nothing in its protocol.
    pub unreadable_lines: u64,
    /// Share of the last second in which the bus was busy, %.
    pub load_percent: f64,
    /// The mode of the vehicle, if a message told it.
    pub mode: Option<String>,
    /// The nodes.
    pub nodes: Vec<NodeState>,
    /// The messages that came, by identifier.
    pub messages: Vec<WindowState>,
    /// Frames with identifiers that the network does not have: identifier and number.
    pub foreign: BTreeMap<String, u64>,
    /// Remote frames, which ask for a message: identifier and number. Who sent them is not known.
    pub remote: BTreeMap<String, u64>,
    /// Nodes that began to behave in another way, in order of time: the last 200 of them.
    pub changes: Vec<Change>,
}

/// The same time in the unit of the simulation.
fn sim_time(at: Duration) -> SimTime {
    let nanos = u64::try_from(at.as_nanos()).unwrap_or(u64::MAX);
    SimTime::from_ticks(nanos.saturating_mul(1000))
}

/// A message so far.
#[derive(Default)]
struct Seen {
    frames: u64,
    outside: u64,
    behind: Option<f64>,
    last: Duration,
}

/// A frame of the last second.
struct Recent {
    at: Duration,
    id: Option<u16>,
    outside: bool,
    bits: u32,
}

/// Follows a bus.
pub struct Watch {
    vehicle: String,
    nodes: Vec<String>,
    matrix: Matrix,
    bit_rate: f64,
    /// Start of the last reference.
    reference: Option<Duration>,
    /// Whether two references were in order, so that windows can be judged.
    in_order: bool,
    seen: BTreeMap<u16, Seen>,
    foreign: BTreeMap<String, u64>,
    remote: BTreeMap<String, u64>,
    recent: Vec<Recent>,
    frames: u64,
    modes: Vec<ModeChange>,
    changes: VecDeque<Change>,
    /// How each node behaves, in the order of `nodes`.
    classes: Vec<Class>,
}

impl Watch {
    /// A bus of which no frame has come yet.
    #[must_use]
    pub fn new(vehicle: &Vehicle) -> Self {
        // Nobody hears a bus guardian, which sends nothing.
        let senders = vehicle.participants();
        let nodes: Vec<String> = senders
            .map(|node| vehicle.node(node).name.clone())
            .collect();
        Self {
            vehicle: vehicle.name().to_owned(),
            classes: vec![Class::Unheard; nodes.len()],
            nodes,
            matrix: Matrix::new(vehicle),
            bit_rate: f64::from(vehicle.network().bit_rate.max(1)),
            reference: None,
            in_order: false,
            seen: BTreeMap::new(),
            foreign: BTreeMap::new(),
            remote: BTreeMap::new(),
            recent: Vec::new(),
            frames: 0,
            modes: Vec::new(),
            changes: VecDeque::new(),
        }
    }

    pub(super) fn cycle(&self) -> Duration {
        Duration::from_nanos(self.matrix.basic_cycle().as_ticks() / 1000)
    }

    /// Takes a frame that ended at `at`.
    pub fn take(&mut self, at: Duration, frame: &Frame) {
        let bits = frame_bits(frame);
        let start = at.saturating_sub(Duration::from_secs_f64(f64::from(bits) / self.bit_rate));
        self.frames += 1;
        let id = match frame.id() {
            Id::Standard(id) => Some(id.as_raw()),
            Id::Extended(_) => None,
        };
        // Any node may ask for a message, so a remote frame is none of its sender's.
        let id = id.filter(|&id| {
            !frame.is_remote() && self.matrix.windows.iter().any(|window| window.id == id)
        });
        let mut outside = false;
        match id {
            Some(id) => {
                let behind = self.behind(id, start);
                outside = behind.is_some_and(|(_, outside)| outside);
                let seen = self.seen.entry(id).or_default();
                seen.frames += 1;
                seen.last = at;
                seen.behind = behind.map(|(behind, _)| behind);
                seen.outside += u64::from(outside);
                self.read(at, id, frame);
            }
            None => {
                let name = match frame.id() {
                    Id::Standard(id) => format!("0x{:03X}", id.as_raw()),
                    Id::Extended(id) => format!("0x{:08X}", id.as_raw()),
                };
                let all = if frame.is_remote() {
                    &mut self.remote
                } else {
                    &mut self.foreign
                };
                *all.entry(name).or_default() += 1;
            }
        }
        self.recent.push(Recent {
            at,
            id,
            outside,
            bits: bits + INTERMISSION_BITS,
        });
        let old = self.recent.partition_point(|one| one.at + SPAN < at);
        self.recent.drain(..old);
    }

    /// How far behind its window's begin a frame starts, us, and whether that is out of it. A reference
    /// begins a basic cycle.
    fn behind(&mut self, id: u16, start: Duration) -> Option<(f64, bool)> {
        let of_id = |window: &&Window| window.id == id;
        let mut windows = self.matrix.windows.iter().filter(of_id);
        if windows
            .clone()
            .any(|window| window.kind == WindowKind::Reference)
        {
            if let Some(before) = self.reference.replace(start) {
                let nanos = |span: Duration| i64::try_from(span.as_nanos()).unwrap_or(i64::MAX);
                let apart = nanos(start.saturating_sub(before));
                self.in_order |= are_in_order(apart, nanos(self.cycle()), nanos(STAMPED));
            }
            return None;
        }
        if !self.in_order {
            return None;
        }
        let since = start.checked_sub(self.reference?)?.as_secs_f64() * 1e6;
        let behind = |window: &Window| since - span_micros(window.start);
        // With several windows the nearest counts.
        let nearest = windows
            .by_ref()
            .min_by(|one, other| behind(one).abs().total_cmp(&behind(other).abs()))?;
        let behind = behind(nearest);
        let spare = STAMPED.as_secs_f64() * 1e6;
        let outside = behind < -spare || behind > span_micros(nearest.length) + spare;
        let exclusive = nearest.kind == WindowKind::Exclusive;
        exclusive.then_some((behind, outside))
    }

    /// Reads the mode.
    fn read(&mut self, at: Duration, id: u16, frame: &Frame) {
        let mut data = [0; 8];
        for (to, from) in data.iter_mut().zip(frame.data()) {
            *to = *from;
        }
        let record = FrameRecord {
            id,
            dlc: frame.dlc().min(8),
            data,
            start: sim_time(at),
            end: sim_time(at),
            complete: true,
            remote: false,
        };
        let change = self.matrix.modes(&[record]).pop();
        let last = self.modes.last().map(|last| &last.mode);
        self.modes
            .extend(change.filter(|change| last != Some(&change.mode)));
    }

    /// Notes which nodes behave in another way at this time than when they were judged last.
    pub fn judge(&mut self, now: Duration) {
        let recent = self.recent(now);
        let classes = self
            .nodes
            .iter()
            .map(|name| self.node(name, &recent, now).class);
        let classes: Vec<Class> = classes.collect();
        for (at, class) in classes.iter().enumerate() {
            if self.classes[at] == *class {
                continue;
            }
            if self.changes.len() == CHANGES {
                self.changes.pop_front();
            }
            self.changes.push_back(Change {
                at: rounded(now.as_secs_f64(), 3),
                node: self.nodes[at].clone(),
                class: *class,
            });
        }
        self.classes = classes;
    }

    /// The frames of the last second.
    fn recent(&self, now: Duration) -> Vec<&Recent> {
        let all = self.recent.iter();
        all.filter(|one| one.at + SPAN >= now).collect()
    }

    /// The changes of the vehicle's mode so far.
    pub(crate) fn modes(&self) -> &[ModeChange] {
        &self.modes
    }

    /// Whether a frame of this message has come so far.
    pub(crate) fn has_come(&self, id: u16) -> bool {
        self.seen.contains_key(&id)
    }

    /// The windows of the vehicle's messages, and how long they are.
    pub(crate) fn matrix(&self) -> &Matrix {
        &self.matrix
    }

    /// What is known at this time.
    #[must_use]
    pub fn picture(&self, now: Duration) -> Picture {
        let recent = self.recent(now);
        let watched = now.min(SPAN).as_secs_f64().max(1e-9);
        let bits: u32 = recent.iter().map(|one| one.bits).sum();
        let nodes = self.nodes.iter().map(|node| self.node(node, &recent, now));
        let messages = self.seen.iter().filter_map(|(&id, seen)| {
            let window = self.matrix.windows.iter().find(|window| window.id == id)?;
            let count = recent.iter().filter(|one| one.id == Some(id)).count();
            Some(WindowState {
                id,
                message: window.message.clone(),
                sender: window.sender.clone(),
                frames: seen.frames,
                per_second: rounded(count as f64 / watched, 1),
                behind_window_us: seen.behind.map(|behind| rounded(behind, 0)),
                outside: seen.outside,
            })
        });
        Picture {
            vehicle: self.vehicle.clone(),
            watched_seconds: rounded(now.as_secs_f64(), 3),
            pace: None,
            frames: self.frames,
            unreadable_lines: 0,
            load_percent: rounded(f64::from(bits) / self.bit_rate / watched * 100.0, 2),
            mode: self.modes.last().map(|last| last.mode.clone()),
            nodes: nodes.collect(),
            messages: messages.collect(),
            foreign: self.foreign.clone(),
            remote: self.remote.clone(),
            changes: self.changes.iter().cloned().collect(),
        }
    }

    fn node(&self, node: &str, recent: &[&Recent], now: Duration) -> NodeState {
        let ids: Vec<u16> = self
            .matrix
            .windows
            .iter()
            .filter(|window| window.sender == node)
            .map(|window| window.id)
            .collect();
        let seen = self.seen.iter().filter(|(id, _)| ids.contains(id));
        let last = seen.clone().map(|(_, seen)| seen.last).max();
        let own = recent
            .iter()
            .filter(|one| one.id.is_some_and(|id| ids.contains(&id)));
        let (count, outside) = (own.clone().count(), own.filter(|one| one.outside).count());
        let silent = last.map(|last| now.saturating_sub(last));
        let class = match silent {
            // A node that sends nothing by plan is not missed.
            None => Class::Unheard,
            Some(silent) if silent > self.cycle() * DEAD_CYCLES => {
                if ids.iter().any(|&id| self.matrix.is_cyclic(id)) {
                    Class::Dead
                } else {
                    Class::Quiet
                }
            }
            Some(_) if count as f64 > BABBLE * self.planned(node) => Class::Babbling,
            Some(_) if 2 * outside >= count.max(1) => Class::Lost,
            Some(_) => Class::Present,
        };
        NodeState {
            node: node.to_owned(),
            class,
            frames: seen.map(|(_, seen)| seen.frames).sum(),
            silent_seconds: silent.map(|silent| rounded(silent.as_secs_f64(), 3)),
        }
    }

    /// Frames of a node in a second, if each of its windows has one.
    fn planned(&self, node: &str) -> f64 {
        let cycles = SPAN.as_secs_f64() / self.cycle().as_secs_f64().max(1e-6);
        let own = self
            .matrix
            .windows
            .iter()
            .filter(|window| window.sender == node);
        own.map(|window| cycles / f64::from(window.repeat.max(1)))
            .sum()
    }
}

impl Picture {
    /// As JSON, one object.
    #[must_use]
    pub fn json(&self) -> String {
        serde_json::to_string_pretty(self).unwrap_or_default()
    }

    /// What is to be told of the pace of the bus, if it is not that of time.
    fn pace(&self) -> String {
        match self.pace {
            Some(pace) if (pace - 1.0).abs() > DRIFT => {
                format!(", the bus runs at {pace:.1} of time")
            }
            _ => String::new(),
        }
    }

    /// In a line.
    #[must_use]
    pub fn line(&self) -> String {
        let nodes: Vec<String> = self
            .nodes
            .iter()
            .map(|node| format!("{} {}", node.node, node.class.word()))
            .collect();
        let mode = self
            .mode
            .as_ref()
            .map_or(String::new(), |mode| format!(", {mode}"));
        format!(
            "{:.0} s: {} frames, load {:.1} %{mode}{}; {}",
            self.watched_seconds,
            self.frames,
            self.load_percent,
            self.pace(),
            nodes.join(", ")
        )
    }

    /// As tables.
    #[must_use]
    pub fn text(&self) -> String {
        let mut t = String::new();
        // Writing to a string cannot fail.
        let _ = writeln!(
            t,
            "{}: {:.1} s, {} frames, load {:.1} %{}{}\n",
            self.vehicle,
            self.watched_seconds,
            self.frames,
            self.load_percent,
            self.mode
                .as_ref()
                .map_or(String::new(), |mode| format!(", mode {mode}")),
            self.pace()
        );
        let _ = writeln!(
            t,
            "{:<12}{:<11}{:>9}{:>15}",
            "node", "class", "frames", "last frame"
        );
        for node in &self.nodes {
            let silent = node.silent_seconds;
            let last = silent.map_or("-".to_owned(), |silent| format!("{silent:.1} s ago"));
            let class = node.class.word();
            let _ = writeln!(
                t,
                "{:<12}{class:<11}{:>9}{last:>15}",
                node.node, node.frames
            );
        }
        let _ = writeln!(
            t,
            "\n{:<20}{:>5}  {:<12}{:>9}{:>8}{:>15}{:>9}",
            "message", "id", "sender", "frames", "per s", "behind window", "outside"
        );
        for one in &self.messages {
            let behind = one.behind_window_us;
            let behind = behind.map_or("-".to_owned(), |behind| format!("{behind:.0} us"));
            let _ = writeln!(
                t,
                "{:<20}{:>5}  {:<12}{:>9}{:>8.1}{behind:>15}{:>9}",
                one.message, one.id, one.sender, one.frames, one.per_second, one.outside
            );
        }
        for (id, frames) in &self.foreign {
            let _ = writeln!(t, "{:<20}{id:>5}  {:<12}{frames:>9}", "unknown", "-");
        }
        for (id, frames) in &self.remote {
            let _ = writeln!(t, "{:<20}{id:>5}  {:<12}{frames:>9}", "remote frames", "-");
        }
        if self.unreadable_lines > 0 {
            let lines = self.unreadable_lines;
            let _ = writeln!(t, "lines of the adapter that could not be read: {lines}");
        }
        if !self.changes.is_empty() {
            let _ = writeln!(t, "\nnodes over time");
        }
        for change in &self.changes {
            let _ = writeln!(
                t,
                "{:>10.1} s  {:<12}{}",
                change.at,
                change.node,
                change.class.word()
            );
        }
        t
    }
}
