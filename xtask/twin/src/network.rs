//! Microcontrollers on one bus, simulated together.

use crate::image::Image;
use crate::mcu::{Board, Mcu};
use crate::part::Pin;
use crate::peripheral::{SharedBus, lock};
use can_bus::{Bus, Level, NodeId, SimDuration, SimTime};
use std::sync::{Arc, Mutex, MutexGuard};

/// Usual shortest time for which the nodes run between two updates of the bus: a quarter of a bit at 250
/// kbit/s. A node never runs further ahead of the bus than its horizon or this time, whichever is
/// later.
const SLICE: SimDuration = SimDuration::from_ticks(1_000_000);

/// Nodes and the bus between them.
///
/// Time advances in slices. Within a slice each node runs alone, up to the earliest time at which
/// an action of another node could reach it ([`Bus::horizon_of`]); then the bus is simulated up to
/// the same time. The outcome depends only on the programs, the boards and the inputs.
pub struct Network {
    bus: SharedBus,
    nodes: Vec<Mcu>,
    now: SimTime,
    slice: SimDuration,
    /// The slice in which a node was stopped.
    stopped: Option<Slice>,
    taps: Vec<Tap>,
}

/// A slice of time that the nodes go through one after the other.
#[derive(Clone, Copy)]
struct Slice {
    target: SimTime,
    /// What all nodes that have gone through it have reached.
    reached: SimTime,
    /// The next node.
    node: usize,
}

/// The wires between a guardian and one node that it guards.
#[derive(Clone)]
struct Tap {
    /// Index of the guardian.
    guardian: usize,
    /// The node on the bus.
    node: NodeId,
    /// The guardian's pin that reads the node's transmit pin.
    line: Pin,
    /// The guardian's pin that closes the node's gate while it is high.
    gate: Pin,
    /// Whether the line is high, which is recessive.
    recessive: bool,
    closed: bool,
}

impl Default for Network {
    fn default() -> Self {
        Self::new()
    }
}

impl Network {
    /// A bus without nodes.
    #[must_use]
    pub fn new() -> Self {
        Self::with_slice(SLICE)
    }

    /// A bus without nodes that is updated at least this often. An interrupt by the bus comes late
    /// by this time at most.
    #[must_use]
    pub fn with_slice(slice: SimDuration) -> Self {
        Self {
            bus: Arc::new(Mutex::new(Bus::new())),
            nodes: Vec::new(),
            now: SimTime::from_ticks(0),
            slice,
            stopped: None,
            taps: Vec::new(),
        }
    }

    /// The same nodes on the same bus, in the same state, as [`Mcu::copy`] makes them.
    #[must_use]
    pub fn copy(&self) -> Self {
        let bus = Arc::new(Mutex::new(self.bus().clone()));
        let nodes = self.nodes.iter().map(|node| node.copy(Some(&bus)));
        Self {
            nodes: nodes.collect(),
            bus,
            taps: self.taps.clone(),
            ..*self
        }
    }

    /// Adds a node; its index counts from 0 in the order of the calls.
    pub fn add(&mut self, image: Arc<Image>, board: &Board) -> usize {
        self.nodes.push(Mcu::new(image, board, Some(&self.bus)));
        self.nodes.len() - 1
    }

    /// Puts gates between nodes and the bus, which the pins of a guardian close: for each node its index, the
    /// guardian's pin at its transmit line, in front of the gate, and the pin that closes the gate while
    /// it is high. A pin that is not driven leaves the gate open. Lines and gates follow within the shortest
    /// time between two updates of the bus, and a gate acts from the next bit on.
    ///
    /// There may be several guardians, with a call for each: a node that guards itself is its own. Where
    /// several guard the same node, each of them can close it off.
    pub fn guard(&mut self, guardian: usize, taps: impl IntoIterator<Item = (usize, Pin, Pin)>) {
        for (node, line, gate) in taps {
            if let Some(node) = self.nodes[node].node() {
                self.nodes[guardian].drive_pin(line, Some(true));
                self.taps.push(Tap {
                    guardian,
                    node,
                    line,
                    gate,
                    recessive: true,
                    closed: false,
                });
            }
        }
    }

    /// Passes the levels of the transmit lines to the guardians, and those of their pins to the gates.
    fn follow_taps(&mut self) {
        if self.taps.is_empty() {
            return;
        }
        let mut bus = lock(&self.bus);
        let mut changed = Vec::new();
        for index in 0..self.taps.len() {
            let Tap {
                guardian,
                node,
                gate,
                ..
            } = self.taps[index];
            let closed = self.nodes[guardian].pin(gate);
            if closed != self.taps[index].closed {
                self.taps[index].closed = closed;
                // The gates of several guardians of a node are in a row.
                let mut taps = self.taps.iter();
                let closed = taps.any(|tap| tap.node == node && tap.closed);
                bus.close_gate(node, closed, self.now);
            }
        }
        for tap in &mut self.taps {
            let recessive = bus.transmit_level(tap.node) == Level::Recessive;
            if recessive != tap.recessive {
                tap.recessive = recessive;
                changed.push((tap.guardian, tap.line, recessive));
            }
        }
        drop(bus);
        for (guardian, line, recessive) in changed {
            self.nodes[guardian].drive_pin(line, Some(recessive));
        }
    }

    /// The bus, for testers, disturbances and records.
    pub fn bus(&self) -> MutexGuard<'_, Bus> {
        lock(&self.bus)
    }

    /// A node by its index.
    #[must_use]
    pub fn node(&self, index: usize) -> &Mcu {
        &self.nodes[index]
    }

    /// A node by its index.
    pub fn node_mut(&mut self, index: usize) -> &mut Mcu {
        &mut self.nodes[index]
    }

    /// The time up to which every node and the bus have been simulated.
    #[must_use]
    pub fn now(&self) -> SimTime {
        self.now
    }

    /// Runs everything up to `end`, past all stops of probes.
    pub fn run_until(&mut self, end: SimTime) {
        while !self.run_to_stop(end) {}
    }

    /// Runs everything up to `end`, or until a probe stops a node in the middle of a slice; then the result is
    /// false. The next call goes on where this one left: with the same ends, stops change nothing.
    pub fn run_to_stop(&mut self, end: SimTime) -> bool {
        while self.stopped.is_some() || self.now < end {
            let mut slice = self.stopped.take().unwrap_or_else(|| {
                let target = self.target(end);
                Slice {
                    target,
                    reached: target,
                    node: 0,
                }
            });
            while let Some(node) = self.nodes.get_mut(slice.node) {
                if node.stopped().is_some() || node.now() < slice.target {
                    node.run_until(slice.target);
                    if node.stopped().is_some() {
                        self.stopped = Some(slice);
                        return false;
                    }
                    slice.reached = slice.reached.min(node.now());
                }
                slice.node += 1;
            }
            // A node returns early when its program has written to the CAN controller.
            self.now = slice.reached.max(self.now);
            lock(&self.bus).advance_to(self.now);
            for node in &mut self.nodes {
                node.bus_moved();
            }
            self.follow_taps();
        }
        true
    }

    /// The time up to which the nodes may run without an update of the bus.
    fn target(&self, end: SimTime) -> SimTime {
        let mut wake = end;
        for node in &self.nodes {
            if let Some(at) = node.next_wake() {
                wake = wake.min(at);
            }
        }
        let bus = lock(&self.bus);
        let target = if wake > self.now {
            // All nodes sleep: nothing happens before a node's own event or an event on the bus.
            // A guardian looks at each bit of the others.
            let event = if self.taps.is_empty() {
                bus.next_event()
            } else {
                bus.next_step_at()
            };
            event.map_or(wake, |event| wake.min(event))
        } else if !self.taps.is_empty() {
            self.now
        } else {
            bus.horizon()
        };
        target.max(self.now + self.slice).min(end)
    }
}
