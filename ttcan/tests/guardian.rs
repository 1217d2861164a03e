//! The bus guardian beside a network: good nodes are never cut, babbling ones soon.

#[path = "support/guarded.rs"]
mod guarded;
mod support;

use guarded::{Guarded, Level};
use proptest::prelude::*;
use support::{
    ALARM, BUTTON, CONTROLLER, DRIVE, GPS, MATRIX, SCHEDULE, STEERING, TICKS_PER_US, UagvBus, at,
    bits_of, crystal, uagv,
};
use ttcan::guardian::{Guardian, GuardianConfig, GuardianError, GuardianState, Lines, Trip};
use ttcan::simulation::{Application, Bus, Fate, SimTime};
use ttcan::{Frame, Id, Micros, NodeId, Stamp, SyncState, WindowKind};

const NODES: usize = 4;
const ALL: [NodeId; NODES] = [GPS, CONTROLLER, STEERING, DRIVE];
const CYCLE_MS: u64 = 100;
/// The nodes that are no masters, bit by bit. Only such a node is guarded by its own processor: a master may have
/// to repeat its references because of others, which its own guardian does not see.
const ACTUATORS: u32 = 0b1100;

/// The application of the guarded network: each frame goes by the guardian.
struct Watched {
    guarded: Guarded<NODES>,
    /// Which nodes have power and acknowledge.
    alive: [bool; NODES],
    /// When nobody was there to acknowledge a node's frame for the last time.
    alone: [Option<SimTime>; NODES],
    /// One of this many frames is destroyed, and one is missed by one node; 0 for none.
    noise: u64,
}

impl Application for Watched {
    fn silenced(&mut self, node: usize, _: SimTime) {
        self.alive[node] = false;
    }

    fn fate(&mut self, sender: usize, frame: &Frame, now: SimTime) -> Fate {
        let guarded = &mut self.guarded;
        guarded.run(now.ticks());
        let heard = (0..NODES).any(|node| node != sender && self.alive[node]);
        let mut fate = Fate::Delivered;
        if self.noise > 0 {
            if guarded.below(self.noise) == 0 {
                fate = Fate::Destroyed;
            } else if guarded.below(self.noise) == 0 {
                fate = Fate::MissedBy(guarded.below(NODES as u64) as usize);
            }
        }
        if !heard {
            self.alone[sender] = Some(now);
            fate = Fate::NotAcknowledged;
        }
        guarded.transmit(sender, frame, now.ticks(), fate, &self.alive)
    }

    fn contends(&mut self, sender: usize, frame: &Frame) {
        self.guarded.contenders.push((sender, *frame));
    }

    fn destroyed_at(&mut self) -> Option<u32> {
        self.guarded.destroyed_at
    }
}

fn network(seed: u64, noise: u64, ppm: i64) -> UagvBus<Watched> {
    let mut guarded = Guarded::new(SCHEDULE.view(), ALL, seed, ppm);
    let mut deviation = || {
        let span = 2 * ppm.unsigned_abs() * 1000;
        guarded.below(span + 1) as i32 - (ppm * 1000) as i32
    };
    let crystals = [deviation(), deviation(), deviation(), deviation()];
    let watched = Watched {
        guarded,
        alive: [false; NODES],
        alone: [None; NODES],
        noise,
    };
    let mut bus = Bus::new(250_000, watched, seed);
    for (node, ppb) in crystals.into_iter().enumerate() {
        let phase = (seed as u32).wrapping_mul(node as u32 + 1);
        bus.add(uagv(NodeId(node as u16)), crystal(ppb, phase));
    }
    bus
}

fn start(bus: &mut UagvBus<Watched>, node: usize) {
    bus.application.alive[node] = true;
    bus.start(node);
}

fn stop(bus: &mut UagvBus<Watched>, node: usize) {
    bus.application.alive[node] = false;
    bus.crash(node, uagv(NodeId(node as u16)));
}

/// The guardian of a single node cuts it only if nobody was there to acknowledge its references.
fn check_singly(bus: &UagvBus<Watched>, before: &mut Vec<u16>) {
    let now = bus.application.guarded.singly();
    for (node, (before, now)) in before.iter().zip(&now).enumerate() {
        let alone = bus.application.alone[node];
        let lately = alone
            .is_some_and(|alone| alone.ticks() + 2 * CYCLE_MS * 1_000_000 >= bus.now().ticks());
        assert!(
            before == now || lately,
            "the guardian of node {node} cut it at {} for {:?}, {}",
            bus.now(),
            bus.application.guarded.reason(node),
            bus.application.guarded.history()
        );
    }
    *before = now;
}

/// Lets `cycles` basic cycles pass with deaths and returns, events and gaps. Returns how many
/// frames were on the bus.
fn live(bus: &mut UagvBus<Watched>, cycles: u64) -> usize {
    let mut frames = 0;
    let mut changes = [0; 3];
    let mut singly = vec![0; NODES];
    for _ in 0..cycles {
        let now = bus.now().ticks() / 1_000_000;
        let until = now + CYCLE_MS;
        let node = bus.application.guarded.below(NODES as u64) as usize;
        // In any phase of the basic cycle.
        let phase = bus.application.guarded.below(CYCLE_MS);
        bus.run_until(at(now + phase));
        match bus.application.guarded.below(40) {
            0 if bus.is_powered(node) => {
                stop(bus, node);
                changes[0] += 1;
            }
            1 | 2 if !bus.is_powered(node) => start(bus, node),
            3..=9 if bus.application.alive[3] => {
                let id = if phase.is_multiple_of(2) {
                    ALARM
                } else {
                    BUTTON
                };
                let frame = Frame::new(id, &[phase as u8; 3]).expect("short");
                bus.with(3, |drive, now| {
                    _ = drive.queue_event(frame, now, Micros::millis(300));
                });
                changes[1] += 1;
            }
            10 => {
                for master in [0, 1] {
                    if bus.application.alive[master] {
                        changes[2] +=
                            usize::from(bus.with(master, |node, _| node.request_gap()).is_ok());
                    }
                }
            }
            11..=20 => {
                for master in [0, 1] {
                    if bus.application.alive[master] {
                        bus.with(master, |node, now| _ = node.end_gap(now));
                    }
                }
            }
            _ => {}
        }
        bus.run_until(at(until));
        for node in 0..NODES {
            if bus.is_powered(node) {
                if bus.node(node).status().sync == SyncState::Off {
                    start(bus, node);
                }
                bus.with(node, |node, _| node.clear_errors());
            }
        }
        frames += bus.traffic.len();
        bus.traffic.clear();
        if bus.application.guarded.own == 0 {
            check_singly(bus, &mut singly);
        }
        let guarded = &bus.application.guarded;
        for sender in 0..NODES {
            assert_eq!(
                guarded.cuts(sender),
                (0, None),
                "node {sender} was cut before {until} ms, {}",
                guarded.history()
            );
        }
    }
    println!("{frames} frames, {changes:?} deaths, events and gaps");
    assert!(changes.iter().all(|count| *count > 0));
    frames
}

fn good(seed: u64, cycles: u64, own: u32) {
    live_well(network(seed, 50, 100), seed, cycles, own);
}

fn live_well(mut bus: UagvBus<Watched>, seed: u64, cycles: u64, own: u32) {
    bus.application.guarded.own = own;
    // In any order, and one of them perhaps much later.
    for _ in 0..NODES {
        let node = bus.application.guarded.below(NODES as u64) as usize;
        if !bus.application.alive[node] {
            start(&mut bus, node);
        }
        let pause = bus.application.guarded.below(250);
        bus.run_millis(pause);
    }
    let frames = live(&mut bus, cycles);
    let clipped = bus.application.guarded.clipped;
    println!("seed {seed}: {clipped} of {frames} frames stopped in {cycles} basic cycles");
}

/// A hundred thousand basic cycles: almost three hours of the vehicle's time.
#[test]
fn good_nodes_are_never_cut() {
    for seed in 0..100 {
        good(seed, 1000, 0);
    }
    // A master returns, and neither the guardian nor the master before receive its reference.
    good(1000, 1300, 0);
}

/// Nor are those with guardians of their own.
#[test]
fn good_nodes_are_never_cut_by_their_own_guardians() {
    for seed in 0..20 {
        good(seed, 1000, ACTUATORS);
    }
}

/// Nor are they if these look only when an edge, a rest or a limit says so.
#[test]
fn good_nodes_are_never_cut_by_guardians_that_edges_wake() {
    for seed in 0..20 {
        let mut bus = network(seed, 50, 100);
        bus.application.guarded.by_edges = true;
        bus.application.guarded.lateness = 10_000;
        live_well(bus, seed, 1000, ACTUATORS);
    }
}

/// Nor are they if these work in steps, as on a small board.
#[test]
fn good_nodes_are_never_cut_by_guardians_that_work_in_steps() {
    for seed in 0..20 {
        let mut bus = network(seed, 50, 100);
        let guarded = &mut bus.application.guarded;
        (guarded.by_edges, guarded.lateness) = (true, 5_000);
        guarded.work_in_steps(0);
        live_well(bus, seed, 1000, ACTUATORS);
    }
}

/// All acknowledge each of 312 foreign frames in a basic cycle, and none of these bits counts as a flag without a reason.
#[test]
fn good_nodes_are_not_cut_for_acknowledging_a_flood() {
    for seed in 0..20 {
        let mut guarded = Guarded::new(SCHEDULE.view(), ALL, seed, 100);
        guarded.deaf = 0;
        // As on the F446's board: a frame may be taken before a look has found the slot of the last of four lines.
        (guarded.period, guarded.lateness, guarded.taking) = (8889, 2100, 1000);
        let frame = Frame::new(Id::standard(0x7FF).expect("an identifier"), &[]).expect("short");
        for at in 0..3000 {
            guarded.overhear(&frame, at * 320_000, &[true; NODES]);
        }
        for node in 0..NODES {
            assert_eq!(guarded.trips(node), (0, None), "node {node}, seed {seed}");
        }
    }
}

/// A million basic cycles: `cargo test -p ttcan --test guardian -- --ignored --nocapture`
#[test]
#[ignore = "takes minutes"]
fn good_nodes_are_never_cut_in_a_million_basic_cycles() {
    for seed in 1000..1100 {
        good(seed, 10_000, 0);
    }
}

/// What a babbling node sends.
fn babble(kind: u64, node: usize) -> Frame {
    let own = |event: bool| {
        let config = MATRIX.config();
        let window = config.windows.iter().find_map(|window| match window.kind {
            WindowKind::Exclusive { id, sender, .. } if usize::from(sender.0) == node => Some(id),
            _ => None,
        });
        if event && node == 3 {
            ALARM
        } else {
            window.expect("each node has one")
        }
    };
    let reference = MATRIX.config().reference;
    let id = match kind {
        0 => Id::standard(0).expect("small"),
        1 => own(false),
        2 => own(true),
        // The reference of the best-ranked master, and of the other one.
        3 => reference,
        4 => reference.offset(1).expect("small"),
        // A message of another node, of none, and the weakest ones.
        5 => Id::standard(if node == 2 { 300 } else { 206 }).expect("small"),
        6 => Id::standard(0x7FF).expect("the largest"),
        _ => Id::extended(0x1FFF_FFFF).expect("the largest"),
    };
    let len = [8, 7, 3, 8, 6, 2, 0, 8][kind as usize % 8];
    Frame::from_parts(id, len, [0; 8])
}

const KINDS: u64 = 8;

/// No other node was cut, and since the cut each of their windows was used in each basic cycle but the
/// first ones.
fn check_others(bus: &UagvBus<Watched>, node: usize, cut: u64, seed: u64) {
    // Another master takes over.
    let quiet = if node == 0 { 4 } else { 2 };
    let from = cut + quiet * CYCLE_MS * 1_000_000;
    for (sender, other) in ALL.iter().enumerate().filter(|(sender, _)| *sender != node) {
        let cuts = bus.application.guarded.cuts(sender);
        assert_eq!(
            cuts,
            (0, None),
            "good node {sender}, seed {seed} {cut} {}",
            bus.application.guarded.history()
        );
        for window in MATRIX.config().windows {
            if let WindowKind::Exclusive { id, sender, .. } = window.kind
                && sender == *other
            {
                let seen = bus.traffic.iter().filter(|sent| {
                    sent.frame.id() == id
                        && sent.fate == Fate::Delivered
                        && sent.start.ticks() >= from
                });
                let seen = seen.count() as u64;
                assert!(
                    seen >= 15 - quiet - 1,
                    "{} was lost after the cut: {seen}, node {node}, seed {seed}",
                    window.name
                );
            }
        }
    }
}

/// What wakes guardians of one node, and whether their lower half works in steps.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Works {
    ByTimer,
    ByEdges,
    InSteps,
}

/// A node begins to send one frame after the other, and goes on when it is cut: by the guardian of all nodes, or
/// by its own, as others have their `own`. Returns after how many microseconds it was cut.
fn babbler(seed: u64, own: u32, works: Works) -> u64 {
    let mut bus = network(seed, 0, 100);
    bus.application.guarded.by_edges = works != Works::ByTimer;
    if works == Works::InSteps {
        bus.application.guarded.work_in_steps(0);
    }
    bus.application.guarded.deaf = 0;
    let node = match own {
        0 => (seed / KINDS % NODES as u64) as usize,
        _ => 2 + (seed / KINDS % 2) as usize,
    };
    bus.application.guarded.babbler = Some(node);
    bus.application.guarded.own = own;
    for node in 0..NODES {
        start(&mut bus, node);
    }
    bus.run_millis(1000);
    let kind = seed % KINDS;
    let frame = babble(kind, node);
    let begin = at(1000 + seed % 200).ticks() + bus.application.guarded.below(1_000_000);
    bus.run_until(SimTime::from_ticks(begin));
    let mut time = begin;
    while bus.application.guarded.cuts(node).0 == 0 {
        if bus.application.guarded.is_open(node) {
            bus.inject(node, frame);
        }
        time += 50_000;
        bus.run_until(SimTime::from_ticks(time));
        bus.application.guarded.run(time);
        assert!(
            time < begin + CYCLE_MS * 1_000_000,
            "kind {kind} of node {node} is not cut, seed {seed}, {}",
            bus.application.guarded.history()
        );
    }
    let cut = time;
    // Nothing of it comes through its gate any more.
    stop(&mut bus, node);
    bus.traffic.clear();
    let until = cut + 15 * CYCLE_MS * 1_000_000;
    while time < until {
        let bits = bits_of(&frame).len();
        bus.application.guarded.send(node, &frame, time, bits);
        time += 3_000_000;
        bus.run_until(SimTime::from_ticks(time));
        bus.application.guarded.run(time);
        assert!(
            !bus.application.guarded.is_open(node),
            "kind {kind} of node {node} is back at {time} after {cut}, {:?}, {}, seed {seed}",
            bus.application.guarded.trips(node),
            bus.application.guarded.history()
        );
    }
    check_others(&bus, node, cut, seed);
    // After good conduct for ten basic cycles it may return.
    let mut returned = time;
    while !bus.application.guarded.is_open(node) {
        returned += 1_000_000;
        bus.run_until(SimTime::from_ticks(returned));
        bus.application.guarded.run(returned);
        assert!(
            returned < time + 11 * CYCLE_MS * 1_000_000,
            "it never returns"
        );
    }
    assert!(returned + 2 * CYCLE_MS * 1_000_000 > time + 10 * CYCLE_MS * 1_000_000);
    (cut - begin) / 1000
}

/// Each kind of frame, from each node, begun in any phase of the basic cycle.
#[test]
fn a_babbler_is_cut_within_a_basic_cycle_and_no_window_is_lost_after_that() {
    for (own, works) in [
        (0, Works::ByTimer),
        (ACTUATORS, Works::ByTimer),
        (ACTUATORS, Works::ByEdges),
        (ACTUATORS, Works::InSteps),
    ] {
        let mut times: Vec<u64> = (0..1024).map(|seed| babbler(seed, own, works)).collect();
        times.sort_unstable();
        println!(
            "own guardians {own:#b}, {works:?}: cut after {} us in half of the cases, {} us at most",
            times[512], times[1023]
        );
    }
}

/// A master sends the reference of another one, and begins the next frame before the one before is taken. That was its
/// spell before the last one, so the other master is not blamed for it when it takes over.
#[test]
fn a_babbler_that_has_begun_its_next_frame_is_found() {
    for seed in [2500, 9899, 10699] {
        babbler(seed, 0, Works::ByTimer);
    }
}

/// A node may return when a frame is handled. It rests then, and looks wait for its next edge.
#[test]
fn a_node_may_return_without_a_look() {
    babbler(1305, ACTUATORS, Works::ByTimer);
}

/// One guardian, its clock in bits.
struct Rig<const P: usize> {
    guardian: Guardian<'static, P>,
    /// Where the bus is, in bits since the start.
    now: u32,
    lines: Lines,
    /// Looks are at most this many quarter bits apart, and at least `shortest`. The next one is in
    /// `next`.
    longest: u32,
    shortest: u32,
    next: u32,
    random: u32,
    open: u32,
}

const BIT_TICKS: u32 = 4 * TICKS_PER_US;

/// The longest time from look to look that is allowed, in quarter bits.
const LONGEST: u32 = 11;

impl<const P: usize> Rig<P> {
    /// Looks come every two bits.
    fn new(senders: [NodeId; P]) -> Self {
        Self::with_looks(senders, (8, 8), 0)
    }

    /// Looks come after a random number of quarter bits within these bounds.
    fn with_looks(senders: [NodeId; P], (shortest, longest): (u32, u32), seed: u32) -> Self {
        // A bit has 4 us.
        let config = GuardianConfig::new(TICKS_PER_US, Micros::micros(longest));
        let now = Stamp(u32::MAX - 1_000_000);
        let guardian = Guardian::new(SCHEDULE.view(), config, senders, now).expect("it is sound");
        Self {
            guardian,
            now: 0,
            lines: Lines::default(),
            longest,
            shortest,
            next: seed % longest,
            random: seed,
            open: (1 << P) - 1,
        }
    }

    fn stamp(&self) -> Stamp {
        Stamp(u32::MAX - 1_000_000).after(self.now * BIT_TICKS)
    }

    fn look(&mut self, now: Stamp) {
        self.open = self.guardian.look(self.lines, now).bits();
        self.lines.fell = 0;
    }

    /// Lets bits pass. Returns after how many of them the gate of sender 0 closed.
    fn pass(&mut self, bits: u32) -> Option<u32> {
        let mut closed = None;
        for bit in 0..bits {
            while self.next < 4 {
                self.look(self.stamp().after(self.next * BIT_TICKS / 4));
                self.random = self.random.wrapping_mul(1_664_525).wrapping_add(1);
                let span = self.longest - self.shortest + 1;
                self.next += self.shortest + (self.random >> 16) % span;
                if self.open & 1 == 0 && closed.is_none() {
                    closed = Some(bit + 1);
                }
            }
            self.next -= 4;
            self.now += 1;
        }
        closed
    }

    /// An edge at the present instant.
    fn edge(&mut self, sender: usize, level: Level) {
        match level {
            Level::Dominant => {
                self.lines.dominant |= 1 << sender;
                self.lines.fell |= 1 << sender;
            }
            Level::Recessive => self.lines.dominant &= !(1 << sender),
        }
    }

    /// A dominant pulse, and then as many recessive bits. Returns whether gate 0 stayed open.
    fn pulse(&mut self, sender: usize, dominant: u32, recessive: u32) -> bool {
        self.edge(sender, Level::Dominant);
        let first = self.pass(dominant);
        self.edge(sender, Level::Recessive);
        let open = self.open & 1 == 1;
        self.pass(recessive);
        first.is_none() && open
    }

    /// A frame on a line; the guardian receives it if `good`. Returns after how many bits gate 0 closed.
    fn frame(&mut self, sender: usize, frame: &Frame, good: bool) -> Option<u32> {
        let mut closed = None;
        let mut last = true;
        let bits = bits_of(frame);
        for (at, bit) in bits.iter().copied().chain([true]).enumerate() {
            if bit != last {
                self.edge(
                    sender,
                    if bit {
                        Level::Recessive
                    } else {
                        Level::Dominant
                    },
                );
            }
            last = bit;
            if self.pass(1).is_some() && closed.is_none() {
                closed = Some(at as u32 + 1);
            }
        }
        // The recessive bit of the chain is the first of the ten behind the CRC.
        self.pass(9);
        if good {
            let stamp = self.stamp();
            self.open = self.guardian.handle_frame(frame, stamp).bits();
        }
        self.pass(3);
        closed
    }

    /// Two references of sender 0, so that the schedule runs. Time is then `micros` in the basic
    /// cycle of the second.
    fn synchronise(&mut self, micros: u32) {
        let reference = reference();
        self.pass(50);
        let begun = self.now;
        assert_eq!(self.frame(0, &reference, true), None);
        self.pass(25_000 - (self.now - begun));
        let begun = self.now;
        assert_eq!(self.frame(0, &reference, true), None);
        assert_eq!(self.guardian.state(), GuardianState::InSchedule);
        self.pass(micros / 4 - (self.now - begun));
    }
}

fn reference() -> Frame {
    Frame::from_parts(MATRIX.config().reference, 8, [0; 8])
}

fn message(id: u16, len: u8) -> Frame {
    Frame::from_parts(Id::standard(id).expect("small"), len, [0xA5; 8])
}

/// An owner that edges wake may leave its looks out for longer than the counter tells. The last reference cannot lie ahead.
#[test]
fn a_guardian_that_was_not_asked_for_long_has_lost_the_time() {
    for seconds in [1, 60, 118, 119, 120, 150, 200, 235] {
        let mut rig = Rig::new([GPS, STEERING]);
        rig.synchronise(20_000);
        let now = rig.stamp().after(seconds * 1_000_000 * TICKS_PER_US);
        rig.look(now);
        let state = rig.guardian.state();
        assert_eq!(state, GuardianState::Unsynchronised, "after {seconds} s");
    }
}

/// Bits of a short spell. The gate is closed up to two looks later, which are two bits apart.
const SHORT: u32 = 20;

#[test]
fn acknowledge_bits_and_flags_pass_at_any_time() {
    for seed in 0..200 {
        let shortest = 1 + seed % LONGEST;
        let mut rig = Rig::with_looks([STEERING, GPS], (shortest, LONGEST), seed);
        assert!(rig.pulse(0, 1, 100), "acknowledge bit");
        assert!(rig.pulse(0, 6, 100), "error flag");
        for behind in 1..=9 {
            assert!(
                rig.pulse(0, 1, behind) && rig.pulse(0, 6, 100),
                "a flag {behind} bits behind it, seed {seed}"
            );
        }
        // Two overload frames.
        assert!(rig.pulse(0, 6, 8) && rig.pulse(0, 6, 25_000));
        assert_eq!(rig.guardian.trips(0), (0, None));
    }
}

/// The shortest distance of two spells of a good node is 11 bits.
#[test]
fn a_frame_right_behind_an_acknowledge_bit_or_a_flag_begins_a_spell() {
    for seed in 0..2000 {
        let mut rig = Rig::with_looks(ALL, (1 + seed % LONGEST, LONGEST), seed);
        let dominant = if seed % 2 == 0 { 1 } else { 6 };
        let late = seed / 11 % 16;
        rig.synchronise(6000 + 4 * late - 4 * (dominant + 11));
        let flag = seed % 4 > 1;
        if flag {
            // Behind an acknowledge bit.
            rig.now -= 4;
            assert!(rig.pulse(2, 1, 3));
        }
        assert!(rig.pulse(2, dominant, 11));
        rig.frame(2, &message(206, 2), true);
        let trips = rig.guardian.trips(2);
        assert_eq!((rig.open, trips), (0b1111, (0, None)), "seed {seed}");
    }
}

/// Late and omitted looks may stop a good node, but let nothing through that others would not.
#[test]
fn no_frame_passes_beside_late_looks() {
    for seed in 0..2000 {
        let mut rig = Rig::with_looks([STEERING, GPS], (1, LONGEST), seed);
        rig.longest = 8 + seed % 50;
        rig.pass(100);
        // Five dominant and five recessive bits in turn are the most that a frame can look like several
        // spells.
        let mut passed = 0;
        for _ in 0..20 {
            rig.edge(0, Level::Dominant);
            for _ in 0..5 {
                passed += u32::from(rig.open & 1 == 1);
                rig.pass(1);
            }
            rig.edge(0, Level::Recessive);
            rig.pass(5);
        }
        assert!(passed <= 30, "{passed} dominant bits pass, seed {seed}");
    }
}

#[test]
fn a_frame_outside_its_window_is_stopped_and_cuts_its_sender() {
    let mut rig = Rig::new([GPS, STEERING]);
    rig.synchronise(20_000);
    // The message of the window at 6 ms. Gate 1 is not that of `closed`.
    rig.frame(1, &message(206, 2), false);
    assert_eq!(rig.guardian.trips(1), (1, Some(Trip::Misplaced)));
    assert_eq!(rig.guardian.trips(0), (0, None));
    assert_eq!(rig.open, 0b01);

    let mut rig = Rig::new([STEERING, GPS]);
    rig.pass(100);
    let closed = rig
        .frame(0, &message(206, 2), false)
        .expect("it is stopped");
    assert!((SHORT..=SHORT + 4).contains(&closed), "after {closed} bits");
    assert_eq!(rig.guardian.trips(0), (0, None), "the time is not known");
    assert_eq!(rig.open, 0b11, "the spell is over");
}

#[test]
fn a_message_in_its_window_passes_once() {
    for (early, late) in [(0, 0), (20, 0), (0, 80)] {
        let mut rig = Rig::new([GPS, STEERING]);
        rig.synchronise(6000 + late - early);
        rig.frame(1, &message(206, 2), true);
        assert_eq!(
            (rig.open, rig.guardian.trips(1).0),
            (0b11, 0),
            "-{early} +{late} us"
        );
        rig.frame(1, &message(206, 2), false);
        assert_eq!(rig.guardian.trips(1), (1, Some(Trip::Misplaced)));
    }
}

#[test]
fn another_message_in_the_window_cuts_its_sender() {
    let mut rig = Rig::new([GPS, STEERING]);
    rig.synchronise(6000);
    rig.frame(1, &message(205, 2), true);
    assert_eq!(rig.guardian.trips(1), (1, Some(Trip::Identifier)));
}

#[test]
fn a_line_that_is_stuck_is_closed_until_it_is_released() {
    let mut rig = Rig::new([STEERING]);
    rig.edge(0, Level::Dominant);
    let closed = rig.pass(3_000_000).expect("within two minutes");
    assert!((SHORT..=SHORT + 4).contains(&closed), "after {closed} bits");
    rig.edge(0, Level::Recessive);
    rig.pass(10);
    assert_eq!(rig.open, 1);
    // In schedule it is cut, too, and must behave for ten basic cycles.
    let mut rig = Rig::new([GPS, STEERING]);
    rig.synchronise(20_000);
    rig.edge(1, Level::Dominant);
    rig.pass(10_000_000);
    assert_eq!(rig.open, 0b01);
    rig.edge(1, Level::Recessive);
    rig.pass(249_000);
    assert_eq!(rig.open, 0b01);
    rig.pass(2000);
    assert_eq!(rig.open, 0b11);
}

#[test]
fn flags_without_a_reason_cut_their_sender() {
    let mut rig = Rig::new([STEERING, DRIVE]);
    let limit = u32::from(GuardianConfig::new(TICKS_PER_US, Micros::micros(8)).pulses);
    for _ in 0..=limit {
        rig.pulse(0, 6, 80);
        // What both send at once answers what both have heard.
        rig.edge(0, Level::Dominant);
        rig.edge(1, Level::Dominant);
        rig.pass(6);
        rig.edge(0, Level::Recessive);
        rig.edge(1, Level::Recessive);
        rig.pass(20);
        if rig.guardian.trips(0).0 > 0 {
            break;
        }
    }
    assert_eq!(rig.guardian.trips(0), (1, Some(Trip::Pulses)));
    assert_eq!(rig.guardian.trips(1), (0, None));
    assert!(rig.now < 25_000, "within a basic cycle");
    // Ten basic cycles of good conduct.
    rig.pass(249_000);
    assert_eq!(rig.open, 0b10);
    rig.pass(2000);
    assert_eq!(rig.open, 0b11);
}

/// It repeats its reference for as long as nobody acknowledges it.
#[test]
fn a_master_that_is_alone_is_not_cut() {
    for behind in [1, 6, 7] {
        let mut rig = Rig::new([GPS, STEERING]);
        for _ in 0..1000 {
            assert_eq!(rig.frame(0, &reference(), false), None);
            // The flag, 13 bits and more behind the last dominant bit is none of a frame's.
            rig.now -= 11;
            rig.pass(behind);
            assert!(rig.pulse(0, 6, 11));
        }
        assert_eq!(rig.guardian.trips(0), (0, None));
        assert_eq!(rig.guardian.state(), GuardianState::Unsynchronised);
    }
}

/// References that others disturb, or that are none.
#[test]
fn a_master_without_success_is_cut() {
    let mut rig = Rig::new([GPS, STEERING]);
    let begun = rig.now;
    while rig.guardian.trips(0).0 == 0 {
        rig.frame(0, &reference(), false);
        rig.pulse(1, 6, 11);
        assert!(rig.now - begun < 25_000, "within a basic cycle");
    }
    let mut rig = Rig::new([GPS, STEERING]);
    rig.frame(0, &message(206, 2), true);
    assert_eq!(rig.guardian.trips(0), (1, Some(Trip::Identifier)));
}

#[test]
fn a_guardian_of_one_node_stops_it_outside_its_windows() {
    let mut rig = Rig::new([STEERING]);
    let begun = rig.now;
    let stamp = |rig: &Rig<1>| rig.stamp();
    for cycle in 0..2 {
        rig.pass(25_000 * cycle + 200 - (rig.now - begun).min(200));
        let now = stamp(&rig);
        rig.open = rig.guardian.handle_frame(&reference(), now).bits();
    }
    assert_eq!(rig.guardian.state(), GuardianState::InSchedule);
    let bits = bits_of(&reference()).len() as u32 + 10;
    rig.pass(1500 - bits);
    assert_eq!(rig.frame(0, &message(206, 2), true), None);
    assert!(rig.frame(0, &message(206, 2), false).is_some());
    assert_eq!(rig.guardian.trips(0), (1, Some(Trip::Misplaced)));
    rig.guardian.pardon(0);
    rig.pass(3);
    assert_eq!(rig.open, 1);
}

/// It sees no other line, so each attempt without success counts while the time is known.
#[test]
fn a_guardian_of_one_master_stops_endless_attempts() {
    let mut rig = Rig::new([GPS]);
    rig.synchronise(99_900);
    let begun = rig.now;
    while rig.guardian.trips(0).0 == 0 {
        rig.frame(0, &reference(), false);
        assert!(rig.now - begun < 25_000, "within a basic cycle");
    }
    assert_eq!(rig.guardian.trips(0), (1, Some(Trip::Misplaced)));
}

#[test]
fn configurations_are_checked() {
    let sound = GuardianConfig::new(TICKS_PER_US, Micros::micros(8));
    let refused =
        |config: GuardianConfig| Guardian::new(SCHEDULE.view(), config, ALL, Stamp(0)).err();
    assert_eq!(refused(sound), None);
    let slow = GuardianConfig {
        handling: Micros::micros(515),
        ..sound
    };
    assert_eq!(refused(slow), None);
    assert_eq!(
        Guardian::new(SCHEDULE.view(), sound, [GPS, GPS], Stamp(0)).err(),
        Some(GuardianError::Senders)
    );
    for (config, error) in [
        (
            GuardianConfig {
                ticks_per_us: 0,
                ..sound
            },
            GuardianError::Ticks,
        ),
        (
            GuardianConfig {
                ticks_per_us: 1000,
                ..sound
            },
            GuardianError::TooLong,
        ),
        (
            GuardianConfig {
                penalty: 0,
                ..sound
            },
            GuardianError::Cycles,
        ),
        (GuardianConfig { lost: 101, ..sound }, GuardianError::Cycles),
        (
            GuardianConfig {
                drift_ppm: 10_001,
                ..sound
            },
            GuardianError::Drift,
        ),
        (
            GuardianConfig {
                spell_bits: 29,
                ..sound
            },
            GuardianError::SpellBits,
        ),
        (
            GuardianConfig {
                receive_latency: i32::MIN,
                ..sound
            },
            GuardianError::Latency,
        ),
        (
            GuardianConfig {
                interval: Micros::micros(12),
                ..sound
            },
            GuardianError::Interval,
        ),
        // A reference has up to 135 bits. The first window begins 1000 us behind its mark, and opens up to 25 us before.
        (
            GuardianConfig {
                handling: Micros::micros(516),
                ..sound
            },
            GuardianError::Handling,
        ),
    ] {
        assert_eq!(refused(config), Some(error));
    }
}

/// 64 spells, one of which is counted in each call, have to fit into half of a basic cycle.
#[test]
fn spells_are_judged_often_enough_to_be_counted() {
    let refused = |ruling: u32| {
        let config = GuardianConfig {
            ruling: Micros::micros(ruling),
            ..GuardianConfig::new(TICKS_PER_US, Micros::micros(8))
        };
        Guardian::new(SCHEDULE.view(), config, ALL, Stamp(0)).err()
    };
    assert_eq!(refused(781), None);
    assert_eq!(refused(782), Some(GuardianError::Ruling));
}

/// A look of the halves finds the slot of one spell. With more senders than looks in a short spell, the last of those that
/// begin a frame at once would be stopped in its own slot.
#[test]
fn halves_have_no_more_senders_than_looks_in_a_short_spell() {
    // 112 us have 10 looks.
    let halves = GuardianConfig {
        handling: Micros::micros(100),
        spell_bits: 28,
        ..GuardianConfig::new(TICKS_PER_US, Micros::micros(11))
    };
    let ten = core::array::from_fn::<_, 10, _>(|at| NodeId(at as u16));
    assert!(Guardian::new(SCHEDULE.view(), halves, ten, Stamp(0)).is_ok());
    let eleven = core::array::from_fn::<_, 11, _>(|at| NodeId(at as u16));
    let refused = Guardian::new(SCHEDULE.view(), halves, eleven, Stamp(0)).err();
    assert_eq!(refused, Some(GuardianError::Looks));
    // A whole guardian finds all slots in the look in which the spells begin.
    let whole = GuardianConfig {
        handling: Micros::micros(0),
        ..halves
    };
    assert!(Guardian::new(SCHEDULE.view(), whole, eleven, Stamp(0)).is_ok());
}

#[test]
fn a_guardian_is_as_large_as_its_documentation_says() {
    let one = size_of::<Guardian<'static, 1>>();
    let four = size_of::<Guardian<'static, 4>>();
    println!(
        "{one} bytes for one sender, {} for each more",
        (four - one) / 3
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// Any message with any data, begun anywhere in its transmit enable window.
    #[test]
    fn messages_in_their_windows_pass(data: [u8; 8], late in 0u32..16, which in 0usize..6) {
        let mut rig = Rig::new(ALL);
        let window = MATRIX.config().windows[which];
        let WindowKind::Exclusive { id, len, sender, .. } = window.kind else {
            panic!("the first six are exclusive")
        };
        rig.synchronise(window.start.ticks() + 4 * late);
        rig.frame(usize::from(sender.0), &Frame::from_parts(id, len, data), true);
        prop_assert_eq!(rig.open, 0b1111);
        prop_assert_eq!(rig.guardian.trips(usize::from(sender.0)), (0, None));
    }

    /// Whatever a sender does outside its windows, no spell of it is longer than the limit and two
    /// looks, however often the looks come.
    #[test]
    fn no_spell_is_longer_than_the_limit(
        pulses in prop::collection::vec((1u32..12, 1u32..12), 1..60),
        shortest in 1..=LONGEST,
        seed: u32,
    ) {
        let mut rig = Rig::with_looks([STEERING, GPS], (shortest, LONGEST), seed);
        let limit = SHORT + (2 * LONGEST).div_ceil(4);
        let (mut spell, mut quiet) = (0, 100);
        for (dominant, recessive) in pulses {
            for (level, bits) in [(Level::Dominant, dominant), (Level::Recessive, recessive)] {
                rig.edge(0, level);
                for _ in 0..bits {
                    if level == Level::Dominant {
                        spell = if quiet > 5 { 0 } else { spell };
                        quiet = 0;
                    } else {
                        quiet += 1;
                    }
                    spell += 1;
                    prop_assert!(
                        spell <= limit || quiet > 0 || rig.open & 1 == 0,
                        "bit {} of a spell passes", spell
                    );
                    rig.pass(1);
                }
            }
        }
    }

    /// Whatever a sender drives for up to the limit, and then not for 11 bits, passes.
    #[test]
    fn short_spells_pass(
        spells in prop::collection::vec((1u32..7, 1u32..9, 1u32..7, 11u32..30), 1..40),
        shortest in 1..=LONGEST,
        seed: u32,
    ) {
        let mut rig = Rig::with_looks([STEERING, GPS], (shortest, LONGEST), seed);
        for (dominant, recessive, again, rest) in spells {
            prop_assert!(rig.pulse(0, dominant, recessive));
            prop_assert!(rig.pulse(0, again, rest));
            prop_assert_eq!(rig.guardian.trips(0), (0, None));
        }
    }
}
