//! The bus guardian beside controllers that handle errors bit by bit: what noise and faulty nodes make good nodes send is
//! none of their faults.

#[path = "support/controllers.rs"]
mod controllers;
mod support;

use controllers::{Controller, State, number};
use support::Numbers;
use ttcan::guardian::{Gates, Guardian, GuardianConfig, Judge, Lines, Trip, Watch};
use ttcan::{
    Event, Frame, Id, MatrixConfig, Micros, NodeId, ReferenceFormat, Stamp, SystemMatrix, Window,
};

const NODES: usize = 4;
/// A listener without a guardian acknowledges, too.
const LISTENER: usize = NODES;
const TICKS_PER_US: u32 = 18;
/// Ticks of a bit at 250 kbit/s.
const BIT: u32 = 72;
/// Ticks from look to look.
const LOOK: u32 = 160;
/// Bits of a basic cycle and of a millisecond.
const CYCLE: u64 = 25_000;
const MILLI: u64 = 250;

const fn millis(at: u32) -> Micros {
    Micros::millis(at)
}

const MATRIX: SystemMatrix = SystemMatrix::constant(MatrixConfig {
    bit_rate: 250_000,
    basic_cycle: millis(100),
    cycles: 1,
    reference: Id::constant::<96>(),
    reference_format: ReferenceFormat::LEVEL_1,
    masters: &[NodeId(0), NodeId(1)],
    transmit_enable_bits: 16,
    sync_uncertainty: Micros::micros(20),
    longest_gap: Micros::micros(0),
    windows: &[
        Window::exclusive(
            "a",
            millis(2),
            millis(1),
            Id::constant::<400>(),
            8,
            NodeId(0),
        ),
        Window::exclusive(
            "b",
            millis(4),
            millis(1),
            Id::constant::<401>(),
            8,
            NodeId(1),
        ),
        Window::exclusive(
            "c",
            millis(6),
            millis(1),
            Id::constant::<402>(),
            8,
            NodeId(2),
        ),
        Window::exclusive(
            "d",
            millis(8),
            millis(1),
            Id::constant::<403>(),
            8,
            NodeId(3),
        ),
        Window::arbitrating("events", millis(11), millis(40)),
    ],
    events: &[
        Event::new("e1", Id::constant::<0x1FF>(), 8, NodeId(1)),
        Event::new("e2", Id::constant::<0x200>(), 8, NodeId(2)),
        Event::new("e3", Id::constant::<0x201>(), 8, NodeId(3)),
    ],
});
ttcan::schedule!(static SCHEDULE = MATRIX);

/// A guardian at once, or its halves with the lower one every 249 us.
enum Kind {
    Whole(Box<Guardian<'static, NODES>>),
    Halves(Box<(Watch<NODES>, Judge<'static, NODES>)>),
}

/// What the babbler drives in a bit, if it is not what its controller does.
type Babble = Box<dyn FnMut(u64, &[State]) -> bool>;

/// Four guarded nodes, which keep a schedule, and a listener.
struct Bench {
    kind: Kind,
    open: Gates,
    controllers: Vec<Controller>,
    lines: Lines,
    before: [bool; NODES],
    /// Bits since the start, ticks of the next look, and the bit in which the last reference began.
    now: u64,
    look: u64,
    mark: u64,
    steps: u64,
    numbers: Numbers,
    /// Bits in which noise makes the bus dominant.
    noise: Box<dyn Fn(u64) -> bool>,
    babblers: Vec<(usize, Babble)>,
}

fn frame(id: u16, data: &[u8]) -> Frame {
    let id = Id::standard(id).expect("it has 11 bits");
    Frame::new(id, data).expect("it has up to 8 bytes")
}

impl Bench {
    fn new(seed: u64, halves: bool) -> Self {
        let config = GuardianConfig {
            receive_latency: -(BIT as i32),
            ..GuardianConfig::new(TICKS_PER_US, Micros::micros(11))
        };
        let config = if halves {
            GuardianConfig {
                spell_bits: 28,
                handling: Micros::micros(300),
                ruling: Micros::micros(600),
                ..config
            }
        } else {
            config
        };
        let senders = [NodeId(0), NodeId(1), NodeId(2), NodeId(3)];
        let guardian = Guardian::new(SCHEDULE.view(), config, senders, Stamp(0));
        let guardian = guardian.expect("it is sound");
        let open = guardian.gates();
        Self {
            kind: if halves {
                Kind::Halves(Box::new(guardian.halves()))
            } else {
                Kind::Whole(Box::new(guardian))
            },
            open,
            controllers: (0..=NODES).map(|_| Controller::new()).collect(),
            lines: Lines::default(),
            before: [true; NODES],
            now: 0,
            look: 0,
            mark: 0,
            steps: 0,
            numbers: Numbers(seed),
            noise: Box::new(|_| false),
            babblers: Vec::new(),
        }
    }

    fn trips(&self, node: usize) -> (u16, Option<Trip>) {
        match &self.kind {
            Kind::Whole(guardian) => guardian.trips(node),
            Kind::Halves(halves) => halves.1.trips(node),
        }
    }

    fn cut(&self) -> Vec<usize> {
        let nodes = 0..NODES;
        nodes.filter(|node| self.trips(*node).0 > 0).collect()
    }

    fn send(&mut self, node: usize, frame: Frame, repeats: bool) {
        self.controllers[node].queue.push_back((frame, repeats));
    }

    /// Whether node 0 sends a reference now.
    fn is_next_reference(&self) -> bool {
        let next = self.controllers[0].queue.front();
        next.is_some_and(|(frame, _)| frame.id().raw() == 96)
    }

    /// Runs to this time of a basic cycle, which is not the first one.
    fn run_to(&mut self, phase: u64) {
        self.run(CYCLE * 3);
        while self.now - self.mark != phase {
            self.bit();
        }
    }

    /// What the schedule has the nodes send in this bit.
    fn schedule(&mut self) {
        let phase = self.now - self.mark;
        if self.now == 0 || phase == CYCLE {
            self.controllers[0].queue.clear();
            self.send(0, frame(96, &[0]), true);
        }
        for node in 0..NODES {
            let begin = (2 + 2 * node as u64) * MILLI;
            let controller = &self.controllers[node];
            if phase == begin && controller.queue.is_empty() {
                let data = self.numbers.next().to_le_bytes();
                self.send(node, frame(400 + node as u16, &data), false);
            } else if phase == begin + 16 && !controller.is_sending() {
                self.controllers[node].queue.clear();
            }
        }
    }

    /// A look at this tick, and every 249 us what can wait.
    fn look(&mut self, lines: Lines) {
        let now = Stamp(self.look as u32);
        self.open = match &mut self.kind {
            Kind::Whole(guardian) => guardian.look(lines, now),
            Kind::Halves(halves) => {
                let (watch, judge) = &mut **halves;
                watch.look(lines, now);
                let steps = self.look / u64::from(249 * TICKS_PER_US);
                if steps != self.steps {
                    self.steps = steps;
                    judge.rule(&watch.news(), now);
                    let outlook = judge.look_ahead(now);
                    (0..NODES).for_each(|node| watch.publish(&outlook, node));
                    watch.obey(judge.account(watch.driving(), now));
                }
                watch.gates()
            }
        };
    }

    fn receive(&mut self, frame: &Frame, stamp: Stamp) {
        self.open = match &mut self.kind {
            Kind::Whole(guardian) => guardian.handle_frame(frame, stamp),
            Kind::Halves(halves) => {
                let (watch, judge) = &mut **halves;
                if judge.receive(frame, stamp, &watch.evidence()) {
                    let outlook = judge.look_ahead(stamp);
                    (0..NODES).for_each(|node| watch.publish(&outlook, node));
                }
                watch.gates()
            }
        };
    }

    fn bit(&mut self) {
        self.schedule();
        let states: Vec<State> = self.controllers.iter().map(|one| one.state).collect();
        let mut own: Vec<bool> = self
            .controllers
            .iter_mut()
            .map(Controller::output)
            .collect();
        for (node, babble) in &mut self.babblers {
            own[*node] = babble(self.now, &states);
        }
        self.lines.dominant = 0;
        if states[0] == State::Idle && !own[0] && self.is_next_reference() {
            self.mark = self.now;
        }
        for (node, (own, before)) in own.iter().zip(&mut self.before).enumerate() {
            let line = 1 << node;
            self.lines.dominant |= if *own { 0 } else { line };
            self.lines.fell |= if *before && !own { line } else { 0 };
            *before = *own;
        }
        // Controllers sample the bus at three quarters of the bit.
        // The guardian's crystal is 100 ppm fast.
        let begin = self.now * u64::from(BIT) * 10_001 / 10_000;
        let sample = begin + u64::from(BIT) * 3 / 4;
        let mut bus = None;
        while self.look < begin + u64::from(BIT) || bus.is_none() {
            if bus.is_none() && self.look >= sample {
                let driven = (0..NODES).any(|node| !own[node] && self.open.is_open(node));
                bus = Some(!driven && own[LISTENER] && !(self.noise)(self.now));
            }
            if self.look < begin + u64::from(BIT) {
                self.look(self.lines);
                self.lines.fell = 0;
                // Each 8.889 us, and up to 2.1 us late.
                let grid = u64::from(LOOK);
                self.look = (self.look / grid + 1) * grid + self.numbers.below(38);
            }
        }
        let bus = bus.expect("it was sampled");
        for (node, (controller, own)) in self.controllers.iter_mut().zip(own).enumerate() {
            if self.babblers.iter().all(|(babbler, _)| *babbler != node) {
                controller.input(own, bus);
            }
        }
        if let Some(bits) = &self.controllers[LISTENER].received {
            let length = number(&bits[15..19]).min(8) as usize;
            let data = (0..length).map(|at| number(&bits[19 + at * 8..27 + at * 8]) as u8);
            let data: Vec<u8> = data.collect();
            let received = frame(number(&bits[1..12]) as u16, &data);
            self.receive(&received, Stamp((begin + u64::from(BIT)) as u32));
        }
        self.now += 1;
    }

    fn run(&mut self, bits: u64) {
        (0..bits).for_each(|_| self.bit());
    }
}

#[test]
fn good_nodes_keep_their_gates() {
    for halves in [false, true] {
        let mut bench = Bench::new(1, halves);
        bench.run(CYCLE * 50);
        assert_eq!(bench.cut(), [0; 0]);
        assert!(bench.now - bench.mark < CYCLE + MILLI, "the schedule runs");
    }
}

/// Each dominant bit in a delimiter is an error, for which all send one more flag: one spell beyond all limits.
#[test]
fn bursts_of_noise_cut_no_good_node() {
    for (seed, halves) in (0..400).flat_map(|seed| [(seed, false), (seed, true)]) {
        let mut bench = Bench::new(seed, halves);
        let mut numbers = Numbers(seed * 7 + 1);
        bench.run_to(numbers.below(CYCLE));
        let (begin, period) = (bench.now, 2 + numbers.below(20));
        let (end, width) = (
            begin + period * (1 + numbers.below(20)),
            1 + numbers.below(2),
        );
        let pulses = move |at: u64| (begin..end).contains(&at) && (at - begin) % period < width;
        bench.noise = Box::new(pulses);
        bench.run(CYCLE + CYCLE / 2);
        let kind = if halves { "halves" } else { "whole" };
        assert_eq!(bench.cut(), [0; 0], "seed {seed}, {kind}");
    }
}

/// Who loses the arbitration acknowledges the frame of who won, and that may be a short one.
#[test]
fn losers_of_an_arbitration_are_not_the_senders() {
    for (seed, halves) in (0..300).flat_map(|seed| [(seed, false), (seed, true)]) {
        let mut bench = Bench::new(seed, halves);
        bench.run_to(11 * MILLI + 3);
        for (node, id) in [(1, 0x1FF), (2, 0x200), (3, 0x201)] {
            let length = bench.numbers.below(9) as usize;
            let data = bench.numbers.next().to_le_bytes();
            bench.send(node, frame(id, &data[..length]), true);
        }
        bench.run(CYCLE / 2);
        let kind = if halves { "halves" } else { "whole" };
        assert_eq!(bench.cut(), [0; 0], "seed {seed}, {kind}");
    }
}

/// Pulses and flags of a babbler at any rate: it is cut within a basic cycle, and for what the others answer nobody is.
#[test]
fn who_answers_a_babbler_is_not_cut_for_it() {
    for halves in [false, true] {
        for dominant in [1u64, 2, 3, 6, 8, 12, 16] {
            for recessive in [6u64, 7, 8, 9, 10, 11, 12, 14, 16, 20, 30, 60] {
                let mut bench = Bench::new(1, halves);
                bench.run_to(60 * MILLI);
                let begin = bench.now;
                let period = dominant + recessive;
                let babble = move |at: u64, _: &[State]| (at - begin) % period >= dominant;
                bench.babblers.push((3, Box::new(babble)));
                while bench.now < begin + CYCLE && bench.trips(3).0 == 0 {
                    bench.bit();
                }
                let what = format!("{dominant} dominant, {recessive} recessive, halves: {halves}");
                assert_eq!(bench.cut(), [3], "{what}");
            }
        }
    }
}

/// Two babblers whose spells overlap explain each other's, but not for ever.
#[test]
fn two_babblers_do_not_excuse_each_other() {
    for halves in [false, true] {
        for (dominant, recessive) in [(14, 13), (15, 12), (18, 12), (19, 12)] {
            let mut bench = Bench::new(1, halves);
            bench.run_to(60 * MILLI);
            let (begin, period) = (bench.now, dominant + recessive);
            let one = move |at: u64, _: &[State]| (at - begin) % period >= dominant;
            let other = move |at: u64, _: &[State]| (at + period / 2 - begin) % period >= dominant;
            bench.babblers.push((3, Box::new(one)));
            bench.babblers.push((2, Box::new(other)));
            // The halves count one spell in each 249 us, and a period of theirs may end in between.
            bench.run(if halves { 2 * CYCLE } else { CYCLE });
            let what = format!("{dominant} dominant, {recessive} recessive, halves: {halves}");
            assert_eq!(bench.cut(), [2, 3], "{what}");
        }
    }
}

/// A controller whose check of the CRC is broken sends a flag behind each acknowledge delimiter. The acknowledge bits of the
/// frames that it destroys are nobody's fault. The halves know less of them, and count every second one or so.
#[test]
fn acknowledge_bits_of_destroyed_frames_do_not_count() {
    for (faulty, halves) in (1..NODES).flat_map(|node| [(node, false), (node, true)]) {
        let mut bench = Bench::new(1, halves);
        bench.run_to(500);
        let last = if halves { 33 } else { 48 };
        let mut left = 0;
        let babble = move |_: u64, states: &[State]| {
            left = match (left, states[LISTENER]) {
                (0, State::End(7)) => 6,
                (0, _) => 0,
                _ => left - 1,
            };
            left == 0
        };
        bench.babblers.push((faulty, Box::new(babble)));
        while bench.now < bench.mark + CYCLE {
            let phase = bench.now - bench.mark;
            for node in (1..3).filter(|node| *node != faulty) {
                let idle = bench.controllers[node].queue.is_empty();
                if (11 * MILLI..last * MILLI).contains(&phase) && idle {
                    let id = if node == 1 { 0x1FF } else { 0x200 };
                    bench.send(node, frame(id, &[1, 2, 3]), true);
                } else if phase == last * MILLI {
                    bench.controllers[node].queue.clear();
                }
            }
            bench.bit();
        }
        let good = bench.cut().into_iter().filter(|node| *node != faulty);
        assert_eq!(
            good.collect::<Vec<_>>(),
            [0; 0],
            "node {faulty}, halves: {halves}"
        );
    }
}
