//! A node of a network with seven windows, and the functions that the interrupts and
//! tasks of a program call. Features of `ttcan` add functions.

#![no_std]
#![no_main]
#![forbid(unsafe_code)]

use core::panic::PanicInfo;

use ttcan::{
    Action, Frame, Id, MatrixConfig, Micros, NodeConfig, NodeId, Reception, ReferenceFormat, Stamp,
    Status, SystemMatrix, TransmitOutcome, Window,
};

const FORMAT: ReferenceFormat = if cfg!(feature = "global-time") {
    ReferenceFormat::LEVEL_2
} else {
    ReferenceFormat::LEVEL_1
};

const fn window(index: u32, id: Id, sender: u16) -> Window<'static> {
    let start = Micros::micros(1000 + 1000 * index);
    Window::exclusive("window", start, Micros::micros(1000), id, 8, NodeId(sender))
}

const MATRIX: SystemMatrix<'static> = SystemMatrix::constant(MatrixConfig {
    bit_rate: 250_000,
    basic_cycle: Micros::millis(100),
    cycles: 1,
    reference: Id::constant::<0>(),
    reference_format: FORMAT,
    masters: &[NodeId(0), NodeId(1)],
    transmit_enable_bits: 16,
    sync_uncertainty: Micros::micros(20),
    longest_gap: Micros::secs(10),
    windows: &[
        window(0, Id::constant::<16>(), 0),
        window(1, Id::constant::<17>(), 1),
        window(2, Id::constant::<18>(), 2),
        window(3, Id::constant::<19>(), 3),
        window(4, Id::constant::<20>(), 0),
        window(5, Id::constant::<21>(), 1),
        window(6, Id::constant::<22>(), 2),
        #[cfg(feature = "events")]
        Window::arbitrating("events", Micros::millis(8), Micros::millis(4)),
    ],
    events: &[
        #[cfg(feature = "events")]
        ttcan::Event::new("event", Id::constant::<24>(), 8, NodeId(1)),
    ],
});

ttcan::schedule!(
    /// The schedule of the node.
    pub static SCHEDULE = MATRIX
);

const EVENTS: usize = if cfg!(feature = "events") { 8 } else { 0 };
const PEERS: usize = if cfg!(feature = "peers") { MATRIX.node_count() } else { 0 };

/// The node.
pub type Node = ttcan::Node<'static, { MATRIX.window_count() }, PEERS, EVENTS>;

#[inline(never)]
fn start(node: &mut Option<Node>, stamp: Stamp) {
    // A backup master, or a node that is never master.
    let me = NodeId(if cfg!(feature = "master") { 1 } else { 2 });
    *node = Node::new(SCHEDULE.view(), NodeConfig::new(me, 18)).ok();
    if let Some(node) = node {
        node.start(stamp);
    }
}

#[inline(never)]
fn receive(node: &mut Node, frame: &Frame, stamp: Stamp) -> Reception {
    node.handle_receive(frame, stamp)
}

#[inline(never)]
fn transmitted(node: &mut Node, outcome: TransmitOutcome, stamp: Stamp) {
    node.handle_transmit(outcome, stamp);
}

#[inline(never)]
fn advance(node: &mut Node, now: Stamp) -> Option<Action> {
    node.advance(now)
}

#[inline(never)]
fn deadline(node: &Node) -> Option<Stamp> {
    node.next_deadline()
}

/// The calls of a task: watchdog and state.
#[inline(never)]
fn look(node: &mut Node, now: Stamp) -> (Status, u8, bool) {
    node.feed_watchdog(now);
    let missed = node.window(1).map_or(0, |window| window.missed);
    (node.status(), missed, node.is_alive())
}

#[used]
static START: fn(&mut Option<Node>, Stamp) = start;
#[used]
static RECEIVE: fn(&mut Node, &Frame, Stamp) -> Reception = receive;
#[used]
static TRANSMITTED: fn(&mut Node, TransmitOutcome, Stamp) = transmitted;
#[used]
static ADVANCE: fn(&mut Node, Stamp) -> Option<Action> = advance;
#[used]
static DEADLINE: fn(&Node) -> Option<Stamp> = deadline;
#[used]
static LOOK: fn(&mut Node, Stamp) -> (Status, u8, bool) = look;

/// RAM of a node in bytes, read by `cargo xtask bench`.
#[used]
static RAM_OF_A_NODE: usize = core::mem::size_of::<Node>();

#[cfg(feature = "events")]
mod events {
    use super::{Frame, Micros, Node, Stamp};

    #[inline(never)]
    fn queue(node: &mut Node, frame: Frame, now: Stamp) -> bool {
        node.queue_event(frame, now, Micros::millis(200)).is_ok()
    }

    #[used]
    static QUEUE: fn(&mut Node, Frame, Stamp) -> bool = queue;
}

#[cfg(all(feature = "gaps", feature = "master"))]
mod gaps {
    use super::{Node, Stamp};

    #[inline(never)]
    fn gap(node: &mut Node, now: Stamp) -> bool {
        node.request_gap().is_ok() && node.end_gap(now).is_ok()
    }

    #[used]
    static GAP: fn(&mut Node, Stamp) -> bool = gap;
}

#[cfg(feature = "global-time")]
mod time {
    use super::{Node, Stamp};

    #[inline(never)]
    fn time(node: &Node, now: Stamp) -> Option<ttcan::GlobalTime> {
        node.global_time(now)
    }

    #[used]
    static TIME: fn(&Node, Stamp) -> Option<ttcan::GlobalTime> = time;
}

#[cfg(feature = "counters")]
mod counters {
    use super::Node;

    #[inline(never)]
    fn counters(node: &Node) -> &ttcan::Counters {
        node.counters()
    }

    #[used]
    static COUNTERS: fn(&Node) -> &ttcan::Counters = counters;
}

#[cfg(feature = "peers")]
mod peers {
    use super::Node;

    #[inline(never)]
    fn peer(node: &Node) -> ttcan::Health {
        node.peer(ttcan::NodeId(3))
    }

    #[used]
    static PEER: fn(&Node) -> ttcan::Health = peer;
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {}
}
