//! The image of the bus guardian on the emulated board: its TX lines driven bit by bit, and references on
//! its bus.

use std::sync::Arc;

use can_bus::{Frame, Retry, SimDuration, SimTime, Tester};
use serde_json::Value;
use ttcan::WindowKind;
use twin::image::Image;
use twin::mcu::{Board, FlashTiming};
use twin::network::Network;
use twin::part::{Part, Pin};
use uagv::matrix::{MATRIX, STEERING};
use xtask::{Workspace, target};

/// Picoseconds in a microsecond, and in a bit at 250 kbit/s.
const US: u64 = 1_000_000;
const BIT: u64 = 4 * US;
const MS: u64 = 1000 * US;
const CYCLE: u64 = 100 * MS;

/// Builds the image.
fn image() -> Arc<Image> {
    let workspace = Workspace::find().unwrap_or_else(|failure| panic!("{failure}"));
    let mut cargo = target::cargo(&workspace, "build");
    cargo.args(["--release", "--package", "uagv", "--bin", "guardian"]);
    cargo.args(["--features", "f446", "--features", "guardian"]);
    cargo.args(["--message-format", "json-render-diagnostics"]);
    let output = cargo.output().expect("cargo starts");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let messages = String::from_utf8(output.stdout).expect("cargo writes UTF-8");
    let executable = messages
        .lines()
        .filter_map(|line| serde_json::from_str::<Value>(line).ok())
        .find_map(|message| message["executable"].as_str().map(str::to_owned));
    let elf = std::fs::read(executable.expect("there is one")).expect("it can be read");
    Arc::new(Image::from_elf(Part::F446, &elf).expect("it is for the F446"))
}

struct Rig {
    network: Network,
    tester: can_bus::NodeId,
    now: u64,
}

impl Rig {
    /// A guardian that has started, and a master that nobody guards.
    fn new(image: &Arc<Image>) -> Self {
        let mut network = Network::new();
        let board = Board {
            flash: FlashTiming::WaitStates,
            ..Board::default()
        };
        network.add(Arc::clone(image), &board);
        let tester = network.bus().add_tester(Tester::new());
        let mut rig = Self {
            network,
            tester,
            now: 0,
        };
        for node in 0..4 {
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

    fn drive(&mut self, node: u8, recessive: bool) {
        let pin = Pin::new('C', node);
        self.network.node_mut(0).drive_pin(pin, Some(recessive));
    }

    /// The gates that are closed, bit by bit.
    fn closed(&self) -> u32 {
        (0..4).fold(0, |closed, node| {
            let gate = self.network.node(0).pin(Pin::new('C', node + 6));
            closed | u32::from(gate) << node
        })
    }

    /// Drives every other bit of a line. Returns behind which bit its gate was closed.
    fn toggle(&mut self, node: u8, bits: u64) -> Option<u64> {
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

/// The steering node's index among the guarded nodes.
const NODE: u8 = STEERING.0 as u8;

#[test]
fn the_guardians_image_stops_what_is_outside_the_windows() {
    let image = image();
    let mut rig = Rig::new(&image);
    // Acknowledge bits and flags pass, and no frame does.
    for dominant in [1, 6] {
        rig.drive(NODE, false);
        rig.pass(dominant * BIT);
        rig.drive(NODE, true);
        rig.pass(20 * BIT);
        assert_eq!(rig.closed(), 0);
    }
    let stopped = rig.toggle(NODE, 34).expect("it is stopped");
    println!("a frame without a schedule is stopped behind {stopped} bits");
    assert!((20..=26).contains(&stopped), "{stopped}");
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
        |window| matches!(window.kind, WindowKind::Exclusive { sender, .. } if sender == STEERING),
    );
    let start = u64::from(window.expect("it has one").start.ticks());
    rig.pass(start * US);
    assert_eq!(rig.toggle(NODE, 60), None, "its own window");
    rig.pass(20 * BIT);
    let stopped = rig.toggle(NODE, 60).expect("it is stopped");
    println!("in schedule, behind {stopped} bits");
    assert!((20..=26).contains(&stopped), "{stopped}");
    // It is cut now, and no other one is.
    for _ in 0..5 {
        rig.pass(CYCLE);
        assert_eq!(rig.closed(), 1 << NODE);
    }
    let node = rig.network.node(0);
    assert!(node.violations().is_empty(), "{:?}", node.violations());
    assert_eq!(node.resets().len(), 1, "{:?}", node.resets());
}
