//! The bus guardian: its image on an emulated board alone, its TX lines driven bit by bit, and as a part of the
//! vehicle, with gates between the nodes and the bus.

use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

use can_bus::{Frame, Level, RecordKind, Retry, SimDuration, SimTime, Tester};
use furrow_tests::nodes::DRIVE;
use parts::Tap;
use ttcan::{NodeId, WindowKind};
use twin::image::Image;
use twin::mcu::{Board, FlashTiming};
use twin::network::Network;
use twin::part::Part;
use twin::{Images, Twin};
use uagv::matrix::{self, MATRIX, STEERING};
use vehicle_model::{NodeIndex, Overrides, Vehicle};
use world::Scenario;
use xtask::Workspace;

/// Picoseconds in a microsecond, and in a bit at 250 kbit/s.
const US: u64 = 1_000_000;
const BIT: u64 = 4 * US;
const MS: u64 = 1000 * US;
const CYCLE: u64 = 100 * MS;

/// Who guards.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Guards {
    /// One guardian guards all nodes.
    All,
    /// A small one guards the drive node.
    Drive,
}

/// The vehicle with a guardian, and its five images.
fn guarded(by: Guards) -> &'static (Vehicle, Images) {
    static ALL: OnceLock<(Vehicle, Images)> = OnceLock::new();
    static ONE: OnceLock<(Vehicle, Images)> = OnceLock::new();
    let (place, name, values) = match by {
        Guards::All => (&ALL, "uagv", "guardian.enabled=true"),
        Guards::Drive => (&ONE, "sentry", ""),
    };
    place.get_or_init(|| {
        let build = || {
            let workspace = Workspace::find()?;
            let values = Overrides::parse(values).expect("a value of the manifest");
            let vehicle = xtask::vehicle::with(&workspace, name, &values)?;
            let nodes: Vec<_> = vehicle.nodes().collect();
            let images = xtask::build::images(&workspace, &vehicle, &nodes)?;
            Ok((vehicle, xtask::build::read(&images)?))
        };
        build().unwrap_or_else(|failure: xtask::Failure| panic!("{failure}"))
    })
}

/// The image of a guardian.
fn image(by: Guards) -> Arc<Image> {
    let (vehicle, images) = guarded(by);
    let guardian = vehicle.guardian().expect("it is on");
    let part = match by {
        Guards::All => Part::F446,
        Guards::Drive => Part::F303,
    };
    let image = Image::from_elf(part, images.of(guardian));
    Arc::new(image.expect("it is for this part"))
}

struct Rig {
    network: Network,
    taps: &'static [Tap],
    tester: can_bus::NodeId,
    now: u64,
}

impl Rig {
    /// A guardian that has started, and a master that nobody guards.
    fn new(by: Guards) -> Self {
        let mut network = Network::new();
        let image = &image(by);
        let (vehicle, _) = guarded(by);
        let guardian = vehicle.guardian().expect("it is on");
        let board = Board {
            flash: FlashTiming::WaitStates,
            ..Board::default()
        };
        network.add(Arc::clone(image), &board);
        let tester = network.bus().add_tester(Tester::new());
        let mut rig = Self {
            network,
            taps: vehicle.board(guardian).taps,
            tester,
            now: 0,
        };
        for node in 0..rig.taps.len() {
            rig.drive(node, true);
        }
        rig.pass(100 * MS);
        assert_eq!(rig.closed(), 0, "all gates are open");
        rig
    }

    fn pass(&mut self, time: u64) {
        self.now += time;
        let until = SimTime::from_ticks(0) + SimDuration::from_ticks(self.now);
        self.network.run_until(until);
    }

    fn drive(&mut self, node: usize, recessive: bool) {
        let pin = self.taps[node].line;
        self.network.node_mut(0).drive_pin(pin, Some(recessive));
    }

    /// The gates that are closed, bit by bit.
    fn closed(&self) -> u32 {
        let taps = self.taps.iter().enumerate();
        taps.fold(0, |closed, (node, tap)| {
            closed | u32::from(self.network.node(0).pin(tap.gate)) << node
        })
    }

    /// Drives every other bit of a line. Returns behind which bit its gate was closed.
    fn toggle(&mut self, node: usize, bits: u64) -> Option<u64> {
        let mut closed = None;
        for bit in 0..bits {
            self.drive(node, bit % 2 == 1);
            self.pass(BIT);
            if self.closed() != 0 && closed.is_none() {
                assert_eq!(self.closed(), 1 << node, "only its own gate");
                closed = Some(bit + 1);
            }
        }
        self.drive(node, true);
        closed
    }

    /// Lets the master begin a basic cycle.
    fn reference(&mut self) {
        let frame = Frame::standard(100, &[0; 8]).expect("short");
        let now = SimTime::from_ticks(0) + SimDuration::from_ticks(self.now);
        let tester = self.tester;
        self.network.bus().send_at(tester, now, frame, Retry::Once);
    }
}

/// How the image of a guardian treats the line of `sender`, which has this index among its guarded nodes.
fn stops_what_is_outside_the_windows(by: Guards, node: usize, sender: NodeId) {
    let mut rig = Rig::new(by);
    // Acknowledge bits and flags pass, and no frame does.
    for dominant in [1, 6] {
        rig.drive(node, false);
        rig.pass(dominant * BIT);
        rig.drive(node, true);
        rig.pass(20 * BIT);
        assert_eq!(rig.closed(), 0);
    }
    let stopped = rig.toggle(node, 34).expect("it is stopped");
    println!("a frame without a schedule is stopped behind {stopped} bits");
    // A short spell, and two looks.
    let short = match by {
        Guards::All => 28,
        Guards::Drive => 20,
    };
    assert!((short..=33).contains(&stopped), "{stopped}");
    rig.pass(11 * BIT);
    assert_eq!(rig.closed(), 0, "the spell is over");

    // In schedule.
    for _ in 0..3 {
        rig.reference();
        rig.pass(CYCLE);
    }
    rig.reference();
    let windows = MATRIX.config().windows;
    let window = windows.iter().find(
        |window| matches!(window.kind, WindowKind::Exclusive { sender: of, .. } if of == sender),
    );
    let start = u64::from(window.expect("it has one").start.ticks());
    rig.pass(start * US);
    assert_eq!(rig.toggle(node, 60), None, "its own window");
    rig.pass(20 * BIT);
    let stopped = rig.toggle(node, 60).expect("it is stopped");
    println!("in schedule, behind {stopped} bits");
    assert!((short..=33).contains(&stopped), "{stopped}");
    // It is cut now, and no other one is.
    for _ in 0..5 {
        rig.pass(CYCLE);
        assert_eq!(rig.closed(), 1 << node);
    }
    let node = rig.network.node(0);
    assert!(node.violations().is_empty(), "{:?}", node.violations());
    assert_eq!(node.resets().len(), 1, "{:?}", node.resets());
}

#[test]
fn the_guardians_image_stops_what_is_outside_the_windows() {
    stops_what_is_outside_the_windows(Guards::All, usize::from(STEERING.0), STEERING);
}

#[test]
fn the_small_guardians_image_stops_what_is_outside_the_windows() {
    stops_what_is_outside_the_windows(Guards::Drive, 0, matrix::DRIVE);
}

/// Its watchdog bites, and the gate opens.
#[test]
fn a_small_guardian_that_does_not_look_any_more_starts_again() {
    let mut rig = Rig::new(Guards::Drive);
    let (tim7_cr1, tim2_dier) = (0x4000_1400, 0x4000_000C);
    for (begun, register) in [(2, tim7_cr1), (3, tim2_dier)] {
        let node = rig.network.node_mut(0);
        assert!(node.write_register(register, 0));
        rig.pass(1000 * MS);
        assert_eq!(rig.network.node(0).resets().len(), begun);
        assert_eq!(rig.closed(), 0);
    }
}

/// The usual run, with a guardian or without.
struct Run {
    twin: Twin,
    vehicle: &'static Vehicle,
}

/// A frame on the bus: its start in picoseconds, its identifier, and the node that sent it.
type OnBus = (u64, u16, Option<NodeIndex>);

impl Run {
    /// Nothing happens, so the nodes send the same with a node that is cut and without one.
    fn still(by: Option<Guards>) -> Self {
        Self::new(by, |vehicle| Scenario::uneventful(vehicle, "still"))
    }

    fn straight(by: Option<Guards>) -> Self {
        Self::new(by, |vehicle| {
            Scenario::find(vehicle, "straight-line").expect("it comes along")
        })
    }

    fn new(by: Option<Guards>, scenario: fn(&Vehicle) -> Scenario) -> Self {
        let (vehicle, images) = match by.map(guarded) {
            Some((vehicle, images)) => (vehicle, images),
            None => (furrow_tests::vehicle(), furrow_tests::images()),
        };
        let scenario = scenario(vehicle);
        let twin = Twin::new(vehicle, &scenario, 1, images).expect("the images fit");
        Self { twin, vehicle }
    }

    fn guardian(&self) -> NodeIndex {
        self.vehicle.guardian().expect("it is on")
    }

    /// Runs until `ms` after power-on.
    fn to(&mut self, ms: u64) -> &mut Self {
        let until = SimTime::from_ticks(ms * MS);
        self.twin.run_until(until).expect("no violation");
        self
    }

    /// The complete frames that began from one time to another, in ms.
    fn frames(&self, from: u64, to: u64) -> Vec<OnBus> {
        let records = self.twin.records().iter();
        let frames = records.filter_map(|record| match record.kind {
            RecordKind::FrameEnd { frame, start, .. } => {
                let embedded_can::Id::Standard(id) = frame.id() else {
                    panic!("no node sends those");
                };
                let sender = self.twin.node_at(record.node);
                Some((start.as_ticks(), id.as_raw(), sender))
            }
            _ => None,
        });
        let mut frames: Vec<OnBus> = frames.collect();
        frames.retain(|(start, ..)| (from * MS..to * MS).contains(start));
        frames
    }

    /// How often each message of an exclusive window came, and the references, but for those of one node.
    fn windows(&self, from: u64, to: u64, without: NodeIndex) -> BTreeMap<u16, usize> {
        let messages = &self.vehicle.network().messages;
        let mut counts = BTreeMap::new();
        for (_, id, sender) in self.frames(from, to) {
            let message = messages.iter().find(|message| message.id == id);
            let Some(message) = message else { continue };
            let arbitrating = network_model::WindowKind::Arbitrating;
            if message.window.kind != arbitrating && sender.is_some_and(|node| node != without) {
                *counts.entry(id).or_default() += 1;
            }
        }
        counts
    }

    /// Adds a sender to the TX line of the drive node that does this from one time to another, in ms.
    fn babble(&mut self, what: Babble, from: u64, to: u64) -> can_bus::NodeId {
        let babbler = self.twin.add_babbler(DRIVE).expect("it is on the bus");
        let at = |ms: u64| SimTime::from_ticks(ms * MS);
        let mut bus = self.twin.network().bus();
        match what {
            Babble::Frame(id) => {
                let frame = Frame::standard(id, &[0; 8]).expect("short");
                bus.babble(babbler, frame, at(from), at(to));
            }
            Babble::Stuck => {
                let bits = (to - from) * MS / BIT;
                let levels = vec![Level::Dominant; usize::try_from(bits).expect("few")];
                bus.play_raw(babbler, at(from), levels);
            }
        }
        babbler
    }

    /// Whether the gate of a node is closed.
    fn is_closed(&self, node: NodeIndex) -> bool {
        let mut changes = self.twin.gates().iter();
        let last = changes.rfind(|change| change.node == node);
        last.is_some_and(|change| change.closed)
    }
}

/// What a broken node does.
#[derive(Clone, Copy, Debug)]
enum Babble {
    /// It sends a frame with this identifier again and again.
    Frame(u16),
    /// Its TX line is dominant.
    Stuck,
}

/// How long the start of a frame may differ with the guardian, in picoseconds: a transmit enable window, 16 bits.
/// The time master follows the receiver's bytes, and with gates the emulated bus is brought up to date more
/// often, so interrupts come up to a microsecond earlier.
const SAME: u64 = 16 * BIT;

/// Length of the run with good nodes only, ms.
const SPAN: u64 = 10_000;

#[test]
fn a_guardian_changes_nothing_for_good_nodes() {
    let mut plain = Run::straight(None);
    plain.to(SPAN);
    changes_nothing(&plain, Guards::All, "gps 0 controller 0 steering 0 drive 0");
    changes_nothing(&plain, Guards::Drive, "drive 0");
}

fn changes_nothing(plain: &Run, by: Guards, counts: &str) {
    let mut guarded = Run::straight(Some(by));
    guarded.to(SPAN);
    assert_eq!(guarded.twin.gates(), [], "no gate was ever closed");
    let (one, other) = (plain.frames(0, SPAN), guarded.frames(0, SPAN));
    // Event messages of two nodes that wait for the same window may come in the other order.
    let ids = |frames: &[OnBus]| {
        let cycles = frames.split(|(_, id, _)| *id == 100);
        let sorted = cycles.map(|cycle| {
            let mut ids: Vec<_> = cycle.iter().map(|(_, id, node)| (*id, *node)).collect();
            ids.sort_unstable();
            ids
        });
        sorted.collect::<Vec<_>>()
    };
    assert_eq!(ids(&one), ids(&other));
    let apart = one
        .iter()
        .zip(&other)
        .map(|(one, other)| one.0.abs_diff(other.0));
    let largest = apart.max().expect("there are frames");
    println!("{} frames, at most {} ns apart", one.len(), largest / 1000);
    assert!(largest <= SAME, "{largest}");
    // It never sent, and knows the time.
    let guardian = guarded.guardian();
    assert!(other.iter().all(|(.., node)| *node != Some(guardian)));
    let console = String::from_utf8_lossy(guarded.twin.console(guardian)).into_owned();
    let last = console.lines().last().expect("it tells of itself");
    assert_eq!(last, format!("guardian run cuts {counts}"));
}

/// All four acknowledge three foreign frames in each millisecond, which nobody sends who is guarded.
#[test]
fn a_flood_of_foreign_frames_closes_no_gate() {
    flood(Guards::All);
    flood(Guards::Drive);
}

fn flood(by: Guards) {
    let mut flooded = Run::new(Some(by), |vehicle| {
        let flood = "summary = \"flood\"\nduration = \"2 s\"\n\n[[bus]]\nwhat = \"frame\"\nid = 2047\n\
            data = []\nat = \"0.5 s\"\nevery = \"320 us\"\nuntil = \"1.4 s\"\n";
        Scenario::parse(vehicle, "flood", "the test's scenario", flood).expect("it is sound")
    });
    flooded.to(1500);
    let foreign = flooded.frames(500, 1400);
    let foreign = foreign.iter().filter(|(_, id, _)| *id == 2047).count();
    assert!(foreign > 2000, "{foreign}");
    assert_eq!(flooded.twin.gates(), []);
}

#[test]
fn a_node_that_babbles_is_cut_and_returns() {
    babbles(Guards::All);
}

#[test]
fn a_node_that_babbles_is_cut_by_its_small_guardian_and_returns() {
    babbles(Guards::Drive);
}

fn babbles(by: Guards) {
    // Good traffic, for comparison.
    let mut good = Run::still(None);
    good.to(END);
    let expected = good.windows(CUT, END, DRIVE);
    assert!(expected.len() > 3, "{expected:?}");
    let messages = &good.vehicle.network().messages;
    let own = messages.iter().find(|message| message.name == "DriveState");
    let own = own.expect("the drive node's cyclic message").id;
    for what in [Babble::Frame(0), Babble::Frame(own), Babble::Stuck] {
        let mut bare = Run::still(None);
        bare.babble(what, FROM, TO);
        bare.to(END);
        let lost = lost(&expected, &bare.windows(CUT, END, DRIVE));
        let mut guarded = Run::still(Some(by));
        guarded.babble(what, FROM, TO);
        guarded.to(END);
        let still = self::lost(&expected, &guarded.windows(CUT, END, DRIVE));
        let gates = guarded.twin.gates();
        assert!(gates.iter().all(|change| change.node == DRIVE), "{gates:?}");
        let closed = gates
            .iter()
            .find(|change| change.closed)
            .expect("it is cut");
        let after = closed.at.as_ticks().saturating_sub(FROM * MS);
        let open = gates.last().expect("there are some");
        println!(
            "{what:?}: cut after {} us, {still:?} windows lost then, {lost:?} without a guardian, open at {} ms",
            after / US,
            open.at.as_ticks() / MS
        );
        assert!(after <= CYCLE, "{what:?}: {after}");
        assert!(
            lost.values().sum::<usize>() > 10,
            "{what:?}: without a guardian windows are lost, {lost:?}"
        );
        assert!(still.is_empty(), "{what:?}: {still:?}");
        // The gate stays closed until the node has behaved for ten basic cycles.
        assert!(!guarded.is_closed(DRIVE), "{what:?}");
        // It need not misbehave to the end: behind the gate its controller goes to bus-off by itself.
        let opened = open.at.as_ticks();
        let latest = TO * MS + 11 * CYCLE;
        assert!(
            (FROM * MS + 10 * CYCLE..=latest).contains(&opened),
            "{what:?}: {opened}"
        );
        let back = guarded.frames(END - 500, END);
        let back = back
            .iter()
            .filter(|(_, id, node)| *id == own && *node == Some(DRIVE));
        assert!(back.count() >= 4, "{what:?}: it sends again");
        let console = guarded.twin.console(guarded.guardian());
        let console = String::from_utf8_lossy(console).into_owned();
        assert!(console.contains("cut drive "), "{console}");
    }
}

/// From when to when a node babbles, and until when runs go, in ms; and when it must have been cut: a basic
/// cycle later, at the begin of the next one.
const FROM: u64 = 1_030;
const TO: u64 = 1_330;
const CUT: u64 = 1_200;
const END: u64 = 3_300;

/// The messages of which fewer frames came than expected, with how many.
fn lost(expected: &BTreeMap<u16, usize>, seen: &BTreeMap<u16, usize>) -> BTreeMap<u16, usize> {
    let lost = expected.iter().map(|(id, expected)| {
        let seen = seen.get(id).copied().unwrap_or_default();
        (*id, expected.saturating_sub(seen))
    });
    lost.filter(|(_, lost)| *lost > 0).collect()
}

#[test]
fn without_supply_or_in_reset_a_guardian_leaves_the_bus_alone() {
    leaves_the_bus_alone(Guards::All);
    leaves_the_bus_alone(Guards::Drive);
}

fn leaves_the_bus_alone(by: Guards) {
    // From the beginning.
    let (mut plain, mut held) = (Run::still(None), Run::still(Some(by)));
    let guardian = held.guardian();
    held.twin.node_mut(guardian).hold_reset();
    plain.to(2_000);
    held.to(2_000);
    assert_eq!(held.twin.gates(), []);
    let ids = |run: &Run| {
        run.frames(0, 2_000)
            .iter()
            .map(|(_, id, node)| (*id, *node))
            .collect::<Vec<_>>()
    };
    assert_eq!(ids(&plain), ids(&held));
    // A reset opens the gate that it has closed: the babbler is on the bus again.
    let mut run = Run::still(Some(by));
    let babbler = run.babble(Babble::Frame(0), FROM, 1_400);
    run.to(1_250);
    assert!(run.is_closed(DRIVE));
    let sent = |run: &Run| {
        let records = run.twin.records().iter();
        let ends = records.filter(|record| {
            record.node == babbler && matches!(record.kind, RecordKind::FrameEnd { .. })
        });
        ends.count()
    };
    let before = sent(&run);
    run.twin.node_mut(guardian).hold_reset();
    run.to(1_350);
    assert!(sent(&run) > before + 10, "{before}, {}", sent(&run));
}
