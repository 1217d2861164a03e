//! What the images of bus guardians share: what goes from task to task, and what they tell on the console and in the
//! log of a debug probe.

use sled_common::clock::Oscillator;
use ttcan::guardian::{Evidence, GuardianState, Judge, News, Trip};
use ttcan::{Frame, Stamp};

use crate::console::Line;
#[cfg(feature = "target")]
use rtic::Mutex;

/// A frame that was received, and the lines when it was taken.
pub struct Taken<const NODES: usize> {
    /// The frame.
    pub frame: Frame,
    /// When it was received.
    pub stamp: Stamp,
    /// The lines.
    pub evidence: Evidence<NODES>,
}

/// Whether a guardian on this oscillator may close gates. A node's windows would pass by on an RC oscillator, which is up to
/// 5 % off, so without its crystal a guardian leaves them open, and tells it.
#[must_use]
pub fn guards(oscillator: Oscillator) -> bool {
    oscillator == Oscillator::External
}

/// The lower half, whether its gates are ever closed, and whether it has ruled since the last step of `report`.
pub struct Lower<const NODES: usize> {
    /// The lower half.
    pub judge: Judge<'static, NODES>,
    guards: bool,
    ruled: bool,
}

impl<const NODES: usize> Lower<NODES> {
    /// A lower half that has not ruled yet.
    pub const fn new(judge: Judge<'static, NODES>, guards: bool) -> Self {
        Self {
            judge,
            guards,
            ruled: false,
        }
    }

    /// Tells it of a frame. True if the time of the network follows from it.
    pub fn receive(&mut self, taken: &Taken<NODES>) -> bool {
        (self.judge).receive(&taken.frame, taken.stamp, &taken.evidence)
    }

    /// Rules on what the upper half has seen.
    pub fn rule(&mut self, news: &News<NODES>, now: Stamp) {
        self.ruled = true;
        self.judge.rule(news, now);
    }

    /// What it knows of the time of the network; `None` if its gates stay open.
    pub fn known(&self) -> Option<GuardianState> {
        self.guards.then(|| self.judge.state())
    }

    /// Whether it has ruled since the last call, and what it knows of the time of the network.
    pub fn report(&mut self) -> (bool, GuardianState) {
        (core::mem::take(&mut self.ruled), self.judge.state())
    }
}

/// How often a guarded node was cut, and why the last time.
pub type Trips = (u16, Option<Trip>);

/// A guarded node was cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cut {
    /// Its place among the guarded nodes.
    pub node: usize,
    /// How often it was cut since the guardian started, this time included; wraps.
    pub count: u16,
    /// Why.
    pub reason: Trip,
    /// When it is told, ms since the guardian started: up to half a second behind the cut.
    pub at_ms: u32,
}

#[cfg(feature = "target")]
impl Cut {
    /// Writes it to the log of a debug probe, with the node's place in the manifest's list of the guarded.
    pub fn log(&self) {
        defmt::warn!(
            "guarded node {=usize} was cut: {}, {=u16} times, {=u32} ms after the start",
            self.node,
            self.reason,
            self.count,
            self.at_ms
        );
    }
}

/// Which cuts of `NODES` guarded nodes were told.
#[derive(Clone, Copy, Debug)]
pub struct Told<const NODES: usize>([u16; NODES]);

impl<const NODES: usize> Told<NODES> {
    /// No node was cut so far.
    pub const fn new() -> Self {
        Self([0; NODES])
    }

    /// A cut of guarded node `node` that was not told yet, and counts as told now. `at_ms` is the time since
    /// the guardian's start.
    pub fn news(&mut self, node: usize, (count, reason): Trips, at_ms: u32) -> Option<Cut> {
        let told = self.0.get_mut(node).filter(|told| **told != count)?;
        *told = count;
        reason.map(|reason| Cut {
            node,
            count,
            reason,
            at_ms,
        })
    }

    /// How often each node was cut, as told so far.
    pub const fn counts(&self) -> &[u16; NODES] {
        &self.0
    }
}

/// What an image of a guardian tells on the console: a line for each cut, and one about the state each ninth time.
#[cfg(feature = "target")]
pub struct Teller<const NODES: usize> {
    told: Told<NODES>,
    steps: u32,
    /// Time since the first step, ms, and what is left of it, us.
    at_ms: u32,
    rest_us: u32,
}

#[cfg(feature = "target")]
impl<const NODES: usize> Teller<NODES> {
    /// Steps between two lines about the state.
    const STATE_EVERY: u32 = 9;

    /// Nothing was told.
    pub const fn new() -> Self {
        Self {
            told: Told::new(),
            steps: 0,
            at_ms: 0,
            rest_us: 0,
        }
    }

    /// What there is to tell, every `every_us` microseconds; often nothing. One node in each step, so that a step is short.
    pub fn step(
        &mut self,
        mut lower: impl Mutex<T = Lower<NODES>>,
        names: &[&str; NODES],
        every_us: u32,
    ) -> Line {
        self.steps = self.steps.wrapping_add(1);
        self.at_ms = self.at_ms.wrapping_add(every_us / 1000);
        self.rest_us = self.rest_us.wrapping_add(every_us % 1000);
        if self.rest_us >= 1000 {
            self.rest_us = self.rest_us.wrapping_sub(1000);
            self.at_ms = self.at_ms.wrapping_add(1);
        }
        let mut line = Line::new();
        if self.steps.is_multiple_of(Self::STATE_EVERY) {
            let known = lower.lock(|lower| lower.known());
            state(&mut line, known, names, self.told.counts());
        } else {
            let node = self.steps as usize % NODES;
            let trips = lower.lock(|lower| lower.judge.trips(node));
            if let Some(news) = self.told.news(node, trips, self.at_ms)
                && let Some(name) = names.get(node)
            {
                news.log();
                cut(&mut line, name, news);
            }
        }
        line
    }
}

#[cfg(feature = "target")]
impl<const NODES: usize> Default for Teller<NODES> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const NODES: usize> Default for Told<NODES> {
    fn default() -> Self {
        Self::new()
    }
}

/// The line about a cut of the node of this name.
pub fn cut(line: &mut Line, name: &str, cut: Cut) {
    line.str("cut ").str(name);
    line.str(match cut.reason {
        Trip::Misplaced => " misplaced",
        Trip::Identifier => " identifier",
        Trip::Pulses => " pulses",
    });
    line.str(" times ").unsigned(u32::from(cut.count));
    line.str(" at ")
        .fixed(i32::try_from(cut.at_ms).unwrap_or(i32::MAX), 3)
        .str(" s\r\n");
}

/// The line of each second: what the guardian knows of the time of the network, or that its gates stay open without a
/// crystal (`None`), and how often each node was cut.
pub fn state<const NODES: usize>(
    line: &mut Line,
    state: Option<GuardianState>,
    names: &[&str; NODES],
    counts: &[u16; NODES],
) {
    line.str("guardian ");
    line.str(match state {
        None => "open",
        Some(GuardianState::Unsynchronised) => "off",
        Some(GuardianState::Synchronising) => "sync",
        Some(GuardianState::InSchedule) => "run",
    });
    line.str(" cuts");
    for (name, count) in names.iter().zip(counts) {
        line.byte(b' ')
            .str(name)
            .byte(b' ')
            .unsigned(u32::from(*count));
    }
    line.str("\r\n");
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(line: &Line) -> &str {
        core::str::from_utf8(line.as_bytes()).unwrap()
    }

    #[test]
    fn a_cut_is_told_once() {
        let mut told = Told::<2>::new();
        assert_eq!(told.news(1, (0, None), 10), None);
        let trips = (1, Some(Trip::Misplaced));
        let news = told.news(1, trips, 3210).unwrap();
        assert_eq!((news.node, news.count), (1, 1));
        assert_eq!(told.news(1, trips, 3220), None);
        assert_eq!(told.news(2, trips, 3220), None, "there is no such node");
        assert_eq!(told.counts(), &[0, 1]);
        let again = told.news(1, (2, Some(Trip::Identifier)), 4000).unwrap();
        assert_eq!(again.reason, Trip::Identifier);
        let mut line = Line::new();
        cut(&mut line, "drive", news);
        assert_eq!(text(&line), "cut drive misplaced times 1 at 3.210 s\r\n");
    }

    #[test]
    fn the_longest_line_of_four_nodes_fits() {
        let names = ["gps", "controller", "steering", "drive"];
        let mut line = Line::new();
        state(
            &mut line,
            Some(GuardianState::Synchronising),
            &names,
            &[65535; 4],
        );
        assert_eq!(
            text(&line),
            "guardian sync cuts gps 65535 controller 65535 steering 65535 drive 65535\r\n"
        );
    }
}
