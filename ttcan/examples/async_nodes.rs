//! Two nodes as asynchronous tasks: a time master, and one that sends its speed. Each task waits for
//! the controller and for the window timer at once, as a task of embassy does.
//!
//! [`run`] is the task, for any executor, controller and timer. The rest is a bus in memory: one bit
//! rate, one time, and frames that nobody disturbs.

use core::cell::RefCell;
use core::future::{pending, poll_fn};
use core::task::Poll;
use std::collections::VecDeque;

use embassy_futures::select::{Either, select, select3};
use embassy_futures::{block_on, yield_now};
use ttcan::{
    Controller, Driver, Frame, Grant, Id, MatrixConfig, Micros, Node, NodeConfig, NodeId,
    Reception, ReferenceFormat, Stamp, StampLatency, SystemMatrix, TransmitOutcome, Window,
    frame_bits,
};

/// What an interrupt of the controller reports. It takes the stamp before anything else.
enum Interrupt<F> {
    /// A frame was received.
    Received(F, Stamp),
    /// The transmission that was requested last has ended.
    Ended(TransmitOutcome, Stamp),
}

/// The controller's interrupts, from a queue that they fill.
trait Interrupts<F> {
    /// Waits for the next one.
    async fn next(&mut self) -> Interrupt<F>;
}

/// The free-running counter and its compare channel.
trait Timer {
    /// The counter.
    fn now(&self) -> Stamp;
    /// Waits until the counter has reached `stamp`; not at all if it has.
    async fn reach(&self, stamp: Stamp);
}

/// The task of a node. `message` has the data of a granted window; `received` takes the frames.
async fn run<C: Controller, const W: usize, const P: usize, const Q: usize>(
    driver: &mut Driver<'_, C, W, P, Q>,
    interrupts: &mut impl Interrupts<C::Frame>,
    timer: &impl Timer,
    mut message: impl FnMut(Grant) -> Option<[u8; 8]>,
    mut received: impl FnMut(Reception, &C::Frame),
) {
    driver.node.start(timer.now());
    loop {
        let deadline = driver.next_deadline(timer.now());
        let due = async {
            match deadline {
                Some(deadline) => timer.reach(deadline).await,
                None => pending().await,
            }
        };
        match select(interrupts.next(), due).await {
            Either::First(Interrupt::Received(frame, stamp)) => {
                if let Some(reception) = driver.handle_receive(&frame, stamp) {
                    received(reception, &frame);
                }
            }
            Either::First(Interrupt::Ended(outcome, stamp)) => {
                driver.handle_transmit(outcome, stamp);
            }
            Either::Second(()) => driver.handle_timer(timer.now(), &mut message),
        }
    }
}

const MASTER: NodeId = NodeId(0);
const MOTOR: NodeId = NodeId(1);
const MS: Micros = Micros::millis(1);
/// A message with the number of basic cycles that the master has begun.
pub const COUNT: Id = Id::constant::<0x180>();
/// The same number, as the other node has received it.
pub const ECHO: Id = Id::constant::<0x200>();

const MATRIX: SystemMatrix = SystemMatrix::constant(MatrixConfig {
    bit_rate: 250_000,
    basic_cycle: Micros::millis(10),
    cycles: 1,
    reference: Id::constant::<0x100>(),
    reference_format: ReferenceFormat::LEVEL_2,
    masters: &[MASTER],
    transmit_enable_bits: 16,
    sync_uncertainty: Micros::micros(20),
    longest_gap: Micros::micros(0),
    windows: &[
        Window::exclusive("count", MS, MS, COUNT, 2, MASTER),
        Window::exclusive("echo", Micros::millis(3), MS, ECHO, 2, MOTOR),
    ],
    events: &[],
});
ttcan::schedule!(static SCHEDULE = MATRIX);
type Stack = Node<'static, { MATRIX.window_count() }, { MATRIX.node_count() }, 1>;

/// Counts 1 MHz.
const BIT: u32 = 4;

/// The bus and its controllers.
#[derive(Default)]
struct Bus {
    now: u32,
    /// The frame that each controller is to send.
    mailboxes: [Option<Frame>; 2],
    /// The frame on the bus, its sender and its end.
    busy: Option<(usize, Frame, u32)>,
    /// Interrupts that no task has taken yet.
    pending: [VecDeque<Interrupt<Frame>>; 2],
    /// Starts and frames so far.
    traffic: Vec<(u32, Frame)>,
}

impl Bus {
    /// One microsecond passes.
    fn step(&mut self) {
        self.now += 1;
        if let Some((sender, frame, end)) = self.busy {
            // A frame is valid for its receiver one bit before its end, for its sender at its end.
            if self.now == end - BIT {
                let stamp = Stamp(self.now);
                self.pending[1 - sender].push_back(Interrupt::Received(frame, stamp));
            } else if self.now == end {
                let ended = Interrupt::Ended(TransmitOutcome::Sent, Stamp(end));
                self.pending[sender].push_back(ended);
            } else if self.now == end + 3 * BIT {
                self.busy = None;
            }
        }
        if self.busy.is_none() {
            let ready = |sender: &usize| self.mailboxes[*sender].map(|frame| frame.id());
            let winner = (0..2).filter(|it| ready(it).is_some()).min_by_key(ready);
            if let Some((sender, frame)) =
                winner.and_then(|it| Some((it, self.mailboxes[it].take()?)))
            {
                self.traffic.push((self.now, frame));
                self.busy = Some((sender, frame, self.now + BIT * frame_bits(&frame)));
            }
        }
    }
}

/// A node's connection to the bus.
#[derive(Clone, Copy)]
struct Port<'b>(&'b RefCell<Bus>, usize);

impl Controller for Port<'_> {
    type Frame = Frame;

    fn transmit_once(&mut self, frame: &Frame) -> bool {
        let mailbox = &mut self.0.borrow_mut().mailboxes[self.1];
        let free = mailbox.is_none();
        if free {
            *mailbox = Some(*frame);
        }
        free
    }

    fn abort(&mut self) {
        let mut bus = self.0.borrow_mut();
        let now = Stamp(bus.now);
        if bus.mailboxes[self.1].take().is_some() {
            bus.pending[self.1].push_back(Interrupt::Ended(TransmitOutcome::Aborted, now));
        }
    }

    fn silence(&mut self) {
        self.0.borrow_mut().mailboxes[self.1] = None;
    }
}

impl Interrupts<Frame> for Port<'_> {
    async fn next(&mut self) -> Interrupt<Frame> {
        let take = || self.0.borrow_mut().pending[self.1].pop_front();
        poll_fn(|_| take().map_or(Poll::Pending, Poll::Ready)).await
    }
}

impl Timer for Port<'_> {
    fn now(&self) -> Stamp {
        Stamp(self.0.borrow().now)
    }

    async fn reach(&self, stamp: Stamp) {
        poll_fn(|_| match self.now().reached(stamp) {
            true => Poll::Ready(()),
            false => Poll::Pending,
        })
        .await;
    }
}

/// Runs the network for this many milliseconds. Returns the starts of frame in microseconds, and the
/// frames.
pub fn network(millis: u32) -> Vec<(u32, Frame)> {
    let bus = RefCell::new(Bus::default());
    let [mut master, mut motor] = [MASTER, MOTOR].map(|id| {
        let config = NodeConfig {
            latency: StampLatency::bxcan(BIT, 0),
            ..NodeConfig::new(id, 1)
        };
        let node = Stack::new(SCHEDULE.view(), config).expect("the configuration is sound");
        Driver::new(node, Port(&bus, usize::from(id.0)))
    });
    let [mut of_master, mut of_motor] = [Port(&bus, 0), Port(&bus, 1)];
    let [first, second] = [of_master, of_motor];
    let mut count = 0_u16;
    let counted = |_: Grant| {
        count += 1;
        let [high, low] = count.to_be_bytes();
        Some([high, low, 0, 0, 0, 0, 0, 0])
    };
    // Messages go from one callback to the other.
    let heard = RefCell::new(None);
    let hear = |_: Reception, frame: &Frame| {
        if frame.id() == COUNT {
            heard.replace(Some(frame.buffer()));
        }
    };
    let time = async {
        for _ in 0..millis * 1000 {
            bus.borrow_mut().step();
            yield_now().await;
        }
    };
    block_on(select3(
        time,
        run(&mut master, &mut of_master, &first, counted, |_, _| {}),
        run(&mut motor, &mut of_motor, &second, |_| heard.take(), hear),
    ));
    bus.take().traffic
}

/// Prints what is on the bus in 100 ms.
pub fn main() {
    for (start, frame) in network(100) {
        println!("{start:8} us  {}#{:02X?}", frame.id(), frame.data());
    }
}
