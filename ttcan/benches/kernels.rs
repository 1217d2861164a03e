//! The events of a node as functions that a benchmark on the target can time. The
//! network has 8 or 512 windows, and both must cost the same. The file needs no
//! standard library and no harness; programs include it as a module.
//!
//! A kernel is a node right before the event. [`Kernel::run`] is the event that is
//! timed.

use ttcan::guardian::{Guardian, GuardianConfig, Judge, Lines, Watch as Upper};
use ttcan::{
    Action, Frame, Id, MatrixConfig, Micros, Node, NodeConfig, NodeId, ReferenceFormat, Schedule,
    ScheduleView, Stamp, SystemMatrix, TransmitOutcome, Window, frame_bits,
};

const MASTER: NodeId = NodeId(0);
const OTHER: NodeId = NodeId(1);
const TICKS_PER_US: u32 = 18;
const BIT: u32 = 4 * TICKS_PER_US;
const CYCLE: u32 = 10_000;
const CYCLES: u8 = 64;
const IN_CYCLE: usize = 8;

/// The `index`-th of eight windows in a basic cycle. The nodes send in turn.
const fn window(index: usize, cycle: u8, repeat: u8) -> Window<'static> {
    let id = match Id::standard(16 + index as u16 + cycle as u16 * 8) {
        Some(id) => id,
        None => panic!("there are less than 600"),
    };
    let start = Micros::micros(1000 + 1000 * index as u32);
    let sender = if index.is_multiple_of(2) {
        OTHER
    } else {
        MASTER
    };
    Window::exclusive("window", start, Micros::micros(1000), id, 8, sender).every(repeat, cycle)
}

static FEW: [Window<'static>; IN_CYCLE] = {
    let mut windows = [window(0, 0, 1); IN_CYCLE];
    let mut index = 0;
    while index < IN_CYCLE {
        windows[index] = window(index, 0, 1);
        index += 1;
    }
    windows
};

static MANY: [Window<'static>; IN_CYCLE * CYCLES as usize] = {
    let mut windows = [window(0, 0, 1); IN_CYCLE * CYCLES as usize];
    let mut at = 0;
    while at < windows.len() {
        // Sorted by start.
        let (index, cycle) = (at / CYCLES as usize, at % CYCLES as usize);
        windows[at] = window(index, cycle as u8, CYCLES);
        at += 1;
    }
    windows
};

const fn matrix(windows: &'static [Window<'static>]) -> SystemMatrix<'static> {
    SystemMatrix::constant(MatrixConfig {
        bit_rate: 250_000,
        basic_cycle: Micros::micros(CYCLE),
        cycles: CYCLES,
        reference: Id::constant::<0>(),
        reference_format: ReferenceFormat::LEVEL_2,
        masters: &[MASTER],
        transmit_enable_bits: 16,
        sync_uncertainty: Micros::micros(20),
        longest_gap: Micros::micros(0),
        windows,
        events: &[],
    })
}

const FEW_MATRIX: SystemMatrix = matrix(&FEW);
const MANY_MATRIX: SystemMatrix = matrix(&MANY);

static FEW_SCHEDULE: Schedule<
    { FEW_MATRIX.entry_count() },
    { FEW_MATRIX.id_count() },
    { FEW_MATRIX.node_count() },
> = Schedule::constant(&FEW_MATRIX);

static MANY_SCHEDULE: Schedule<
    { MANY_MATRIX.entry_count() },
    { MANY_MATRIX.id_count() },
    { MANY_MATRIX.node_count() },
> = Schedule::constant(&MANY_MATRIX);

/// A node of the network with 8 windows.
pub type Few = Node<'static, 8, 2, 4>;
/// A node of the network with 512 windows.
pub type Many = Node<'static, 512, 2, 4>;

/// The event that is timed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// A message of another node, received in its window.
    ReceiveMessage,
    /// A reference message, received, with the correction of global time.
    ReceiveReference,
    /// The timer interrupt at the beginning of an own window.
    TransmitWindow,
}

/// A node right before an event.
pub struct Kernel<N> {
    node: N,
    event: Event,
    frame: Frame,
    stamp: Stamp,
}

/// A kernel with 8 windows.
pub fn few(event: Event) -> Option<Kernel<Few>> {
    prepare(FEW_SCHEDULE.view(), event)
}

/// A kernel with 512 windows.
pub fn many(event: Event) -> Option<Kernel<Many>> {
    prepare(MANY_SCHEDULE.view(), event)
}

fn reference(cycle: u8, previous: u32) -> Frame {
    let coarse = u32::from(cycle) * (CYCLE / 1000);
    let [a, b, c, d] = coarse.to_be_bytes();
    let [high, low] = ((previous * 32) as u16).to_be_bytes();
    Frame::from_parts(Id::constant::<0>(), 7, [a, b, c, d, cycle, high, low, 0])
}

/// Prepares a kernel. `None` means that the benchmark itself is wrong.
fn prepare<const W: usize>(
    schedule: ScheduleView<'static>,
    event: Event,
) -> Option<Kernel<Node<'static, W, 2, 4>>> {
    let mut node: Node<'static, W, 2, 4> =
        Node::new(schedule, NodeConfig::new(OTHER, TICKS_PER_US)).ok()?;
    node.start(Stamp(0));
    let mut mark = Stamp(0);
    let mut frame = reference(0, 0);
    for cycle in 0..6 {
        mark = Stamp((u32::from(cycle) + 1) * CYCLE * TICKS_PER_US);
        frame = reference(cycle, u32::from(cycle) * CYCLE);
        let end = mark.after(frame_bits(&frame) * BIT);
        if cycle == 5 && event == Event::ReceiveReference {
            return Some(Kernel {
                node,
                event,
                frame,
                stamp: end,
            });
        }
        let _ = node.handle_receive(&frame, end);
        if cycle < 5 {
            drain(&mut node, mark.after((CYCLE - 100) * TICKS_PER_US));
        }
    }
    let at = |micros: u32| mark.after(micros * TICKS_PER_US);
    match event {
        Event::TransmitWindow => {
            drain(&mut node, at(900));
            Some(Kernel {
                node,
                event,
                frame,
                stamp: at(1000),
            })
        }
        _ => {
            // The second window is the master's.
            drain(&mut node, at(2010));
            let in_cycle_5 = if W == 8 { 0 } else { 5 * 8 };
            let id = Id::standard(17 + in_cycle_5)?;
            frame = Frame::from_parts(id, 8, [0x55; 8]);
            let stamp = at(2005).after(frame_bits(&frame) * BIT);
            Some(Kernel {
                node,
                event,
                frame,
                stamp,
            })
        }
    }
}

/// Lets the node do everything that is due until `until`. Each transmission
/// succeeds.
fn drain<const W: usize>(node: &mut Node<'static, W, 2, 4>, until: Stamp) {
    while let Some(deadline) = node.next_deadline() {
        if !until.reached(deadline) {
            break;
        }
        while let Some(action) = node.poll(deadline) {
            if matches!(action, Action::Transmit(_)) {
                node.handle_transmit(TransmitOutcome::Sent, deadline.after(100 * BIT));
            }
        }
    }
}

impl<const W: usize> Kernel<Node<'static, W, 2, 4>> {
    /// Runs the event up to the point where the owner can sleep again. Returns
    /// whether the result is as expected.
    #[inline(never)]
    pub fn run(&mut self) -> bool {
        let good = match self.event {
            Event::ReceiveMessage => matches!(
                self.node.handle_receive(&self.frame, self.stamp),
                ttcan::Reception::Scheduled { .. }
            ),
            Event::ReceiveReference => matches!(
                self.node.handle_receive(&self.frame, self.stamp),
                ttcan::Reception::Reference { .. }
            ),
            Event::TransmitWindow => {
                return matches!(self.node.poll(self.stamp), Some(Action::Transmit(_)))
                    && self.node.next_deadline().is_some();
            }
        };
        good && self.node.poll(self.stamp).is_none() && self.node.next_deadline().is_some()
    }
}

/// The event of a guardian that is timed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Guarded {
    /// A look that finds all lines at rest.
    Rest,
    /// A look that finds the first bit of a frame, in its sender's window.
    Begin,
    /// A look within that frame.
    Follow,
    /// A look that finds all lines dominant for the first time.
    BeginAll,
    /// The next look.
    FollowAll,
    /// The lower half finds when each sender may begin a frame next, behind a reference.
    Ahead,
    /// A message, received from the bus.
    Message,
    /// A reference message, received from the bus.
    Reference,
}

/// Two bits from look to look.
const LOOKS: Micros = Micros::micros(8);

/// The halves of a guardian of four senders right before an event.
pub struct Watch {
    upper: Upper<4>,
    lower: Judge<'static, 4>,
    event: Guarded,
    frame: Frame,
    lines: Lines,
    stamp: Stamp,
}

/// Prepares a guardian of the network with 8 windows. `None` means that the benchmark itself is wrong.
pub fn watch(event: Guarded) -> Option<Watch> {
    let senders = [MASTER, OTHER, NodeId(2), NodeId(3)];
    let config = GuardianConfig::new(TICKS_PER_US, LOOKS);
    let schedule = FEW_SCHEDULE.view();
    let mut guardian = Guardian::new(schedule, config, senders, Stamp(0)).ok()?;
    let mut mark = Stamp(0);
    let mut frame = reference(0, 0);
    let mut stamp = mark;
    for cycle in 0..6 {
        mark = Stamp((u32::from(cycle) + 1) * CYCLE * TICKS_PER_US);
        frame = reference(cycle, u32::from(cycle) * CYCLE);
        stamp = mark.after(frame_bits(&frame) * BIT);
        if cycle == 5 && event == Guarded::Reference {
            break;
        }
        guardian.handle_frame(&frame, stamp);
        let _ = guardian.look(Lines::default(), stamp);
    }
    let all = matches!(event, Guarded::BeginAll | Guarded::FollowAll);
    let senders = match event {
        _ if all => 0b1111,
        Guarded::Rest | Guarded::Reference | Guarded::Ahead => 0,
        _ => 0b10,
    };
    let lines = Lines {
        dominant: senders,
        fell: senders,
    };
    match event {
        Guarded::Reference | Guarded::Ahead => {}
        _ => stamp = mark.after(1000 * TICKS_PER_US),
    }
    if matches!(
        event,
        Guarded::Follow | Guarded::FollowAll | Guarded::Message
    ) {
        let _ = guardian.look(lines, stamp);
        stamp = stamp.after(LOOKS.ticks() * TICKS_PER_US);
    }
    if event == Guarded::Message {
        frame = Frame::from_parts(Id::standard(16)?, 8, [0; 8]);
        stamp = mark.after(1000 * TICKS_PER_US + frame_bits(&frame) * BIT);
    }
    let (mut upper, mut lower) = guardian.halves();
    while event != Guarded::Ahead && !lower.is_ahead(stamp) {
        let outlook = lower.look_ahead(stamp);
        (0..4).for_each(|sender| upper.publish(&outlook, sender));
    }
    Some(Watch {
        upper,
        lower,
        event,
        frame,
        lines,
        stamp,
    })
}

impl Watch {
    /// Runs the event. Returns whether the sender's gate is open, as it should.
    #[inline(never)]
    pub fn run(&mut self) -> bool {
        match self.event {
            Guarded::Message | Guarded::Reference => {
                let evidence = self.upper.evidence();
                let followed = self.lower.receive(&self.frame, self.stamp, &evidence);
                followed == (self.event == Guarded::Reference)
            }
            Guarded::Ahead => {
                let outlook = self.lower.look_ahead(self.stamp);
                (0..4).for_each(|sender| self.upper.publish(&outlook, sender));
                true
            }
            _ => self.upper.look(self.lines, self.stamp).is_open(1),
        }
    }
}
