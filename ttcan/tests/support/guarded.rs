//! A guardian on a simulated bus: TX lines bit by bit, its own crystal, latencies and losses.

use super::support::{Numbers, bits_of};
use ttcan::guardian::{
    Evidence, Gates, Guardian, GuardianConfig, GuardianState, Judge, Lines, Trip, Watch,
};
use ttcan::simulation::{Crystal, Fate, SimTime};
use ttcan::{Frame, Micros, NodeId, ScheduleView, Stamp, StampLatency};

/// A bit in nanoseconds.
pub(crate) const BIT: u64 = 4000;
const TICKS_PER_US: u32 = 18;
/// The nodes ahead of this one are potential masters.
const MASTERS: usize = 2;
/// Bits of an error frame of the simulated bus.
const ERROR_BITS: u32 = 17;
/// A short spell, in bits.
const SHORT: u8 = 28;
/// The timer of the guardian's board asks for a look each 8 us. It comes up to 3 us late, which is
/// what other interrupts take, so looks are up to 11 us apart.
const LOOK: u64 = 8000;
const LATE: u64 = 3000;
/// The lower half says when a frame may begin every so long, and up to so late. That is also how long it takes
/// behind a reference.
const AHEAD: u64 = 498_000;
const LATE_AHEAD: u64 = 340_000;
const HANDLING: u32 = ((FRAME + TOLD + LATE_AHEAD) / 1000) as u32;
/// A frame is taken up to 40 us after its reception: the next one may have begun by then. Up to so much later the
/// lower half is told of it: always before the next one is received.
const FRAME: u64 = 40_000;
const TOLD: u64 = 140_000;
/// It is told of the lines every so long, and late.
const RULE: u64 = 400_000;
/// One step of what can wait is made behind every second time, and late.
const STEP: u64 = 900_000;

/// Level of a TX line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Level {
    Dominant,
    Recessive,
}

#[derive(Clone, Copy, Debug)]
enum Event {
    Edge(usize, Level),
    Frame(Frame, Option<usize>),
    /// A frame with this stamp is taken.
    Take(Frame, Stamp),
    /// The lower half is told of the frame that was taken.
    Tell,
}

/// Rest of a line behind which a timer that its edges reset asks for a look, in nanoseconds: 6 bits.
const QUIET: u64 = 6 * BIT;

/// When a guardian that is woken by edges looks.
#[derive(Clone, Copy, Debug, Default)]
struct Edges {
    /// The next look, and the last one.
    next: Option<u64>,
    looked: u64,
    /// The last edge of the line.
    edge: u64,
    /// Whether it has become dominant since the last look.
    fell: bool,
}

/// What the lower half of the guardian does next, and when.
#[derive(Clone, Copy, Default)]
struct Rounds {
    ahead: u64,
    rule: Option<u64>,
    account: Option<u64>,
}

/// A guardian of one node. Its lower half works at once, or in steps as on a board.
enum Single {
    Whole(Box<Guardian<'static, 1>>),
    InSteps(Box<Steps>),
}

struct Steps {
    watch: Watch<1>,
    judge: Judge<'static, 1>,
    /// When the next step is due, and how many there were.
    due: Stamp,
    count: u32,
}

/// From one step to the next in ticks, and how late one ends: 300 us each.
const STEPS: u32 = 300 * TICKS_PER_US;

impl Steps {
    /// Makes the steps that end ahead of `now`. All that they find has happened before they began.
    fn settle(&mut self, now: Stamp) {
        let now = now.before(STEPS);
        while now.reached(self.due) {
            if !self.watch.has_news() && !self.judge.is_behind(self.due) {
                // But for what time changes, nothing does until a look or a frame.
                let steps = now.ticks_since(self.due).unsigned_abs() / STEPS;
                let skipped = steps.saturating_sub(100) & !1;
                self.due = self.due.after(skipped * STEPS);
            }
            let now = self.due;
            self.judge.rule(&self.watch.news(), now);
            self.count += 1;
            if self.count.is_multiple_of(2) {
                let outlook = self.judge.look_ahead(now);
                self.watch.publish(&outlook, 0);
            } else {
                let orders = self.judge.account(self.watch.driving(), now);
                self.watch.obey(orders);
            }
            self.due = now.after(STEPS);
        }
    }

    fn handle_frame(&mut self, frame: &Frame, stamp: Stamp) {
        self.settle(stamp);
        if self.judge.receive(frame, stamp, &self.watch.evidence()) {
            let outlook = self.judge.look_ahead(stamp);
            self.watch.publish(&outlook, 0);
        }
    }
}

impl Single {
    /// From now on its lower half works in steps.
    fn work_in_steps(self, now: Stamp) -> Self {
        let Self::Whole(guardian) = self else {
            return self;
        };
        let (watch, judge) = guardian.halves();
        let due = now.after(STEPS);
        Self::InSteps(Box::new(Steps {
            watch,
            judge,
            due,
            count: 0,
        }))
    }

    fn look(&mut self, lines: Lines, now: Stamp) -> Gates {
        match self {
            Self::Whole(guardian) => guardian.look(lines, now),
            Self::InSteps(steps) => {
                steps.settle(now);
                steps.watch.look(lines, now)
            }
        }
    }

    fn handle_frame(&mut self, frame: &Frame, stamp: Stamp) -> Gates {
        match self {
            Self::Whole(guardian) => guardian.handle_frame(frame, stamp),
            Self::InSteps(steps) => {
                steps.handle_frame(frame, stamp);
                steps.watch.gates()
            }
        }
    }

    fn is_between_spells(&self) -> bool {
        match self {
            Self::Whole(guardian) => guardian.is_between_spells(),
            Self::InSteps(steps) => steps.watch.is_between_spells(),
        }
    }

    fn is_at_rest(&self) -> bool {
        match self {
            Self::Whole(guardian) => guardian.is_at_rest(),
            Self::InSteps(steps) => steps.watch.is_at_rest(),
        }
    }

    fn due(&self) -> Stamp {
        match self {
            Self::Whole(guardian) => guardian.due(),
            Self::InSteps(steps) => {
                let wake = steps.due.after(STEPS);
                let due = steps.watch.due().filter(|due| wake.reached(*due));
                due.unwrap_or(wake)
            }
        }
    }

    fn trips(&self) -> (u16, Option<Trip>) {
        match self {
            Self::Whole(guardian) => guardian.trips(0),
            Self::InSteps(steps) => steps.judge.trips(0),
        }
    }
}

/// A guardian of `P` senders, and what happens around it.
pub(crate) struct Guarded<const P: usize> {
    pub(crate) watch: Watch<P>,
    pub(crate) judge: Judge<'static, P>,
    rounds: Rounds,
    /// A guardian of each node alone, and the gates that they open.
    singles: Vec<Single>,
    singly_open: u32,
    /// Nodes with a guardian of their own, bit by bit. With any, the guardian of all nodes only watches, the other
    /// nodes have no gate, and guardians sleep while their lines are at rest.
    pub(crate) own: u32,
    /// Whether these guardians look when an edge ends the rest of their line, when the line was quiet, and when a limit
    /// is reached, instead of all the time.
    pub(crate) by_edges: bool,
    edges: [Edges; P],
    crystal: Crystal,
    open: Gates,
    /// A frame that was taken, with its stamp and the lines at that moment.
    taken: Option<(Frame, Stamp, Evidence<P>)>,
    /// The lines as they are, and what became dominant since the last look.
    lines: Lines,
    /// When the timer asks for the next look, and how late that is.
    timer: u64,
    late: u64,
    /// Events that are still to come, by their time.
    pending: Vec<(u64, Event)>,
    random: Numbers,
    /// From look to look by the timer, how late a look is, and how late a frame is taken, at most.
    pub(crate) period: u64,
    pub(crate) lateness: u64,
    pub(crate) taking: u64,
    /// One of this many frames is not received by the guardian; 0 for none.
    pub(crate) deaf: u64,
    /// Frames that begin together with the next one, and have its identifier.
    pub(crate) contenders: Vec<(usize, Frame)>,
    /// The bit behind which the error frame of a frame begins that was destroyed.
    pub(crate) destroyed_at: Option<u32>,
    /// Frames that the gates stopped.
    pub(crate) clipped: usize,
    history: Vec<String>,
    /// The sender that goes on when its gate is closed.
    pub(crate) babbler: Option<usize>,
    /// Looks that could change something. All others are left out.
    pub(crate) looks: u64,
}

impl<const P: usize> Guarded<P> {
    pub(crate) fn new(
        schedule: ScheduleView<'static>,
        senders: [NodeId; P],
        seed: u64,
        ppm: i64,
    ) -> Self {
        let crystal = Crystal {
            ticks_per_us: TICKS_PER_US,
            ppb: 0,
            phase: seed as u32,
            interrupt: (0, 0),
        };
        let config = GuardianConfig {
            // The middle of 0.2 to 0.8 us.
            receive_latency: StampLatency::bxcan(4 * TICKS_PER_US, 9).receive,
            ..GuardianConfig::new(TICKS_PER_US, Micros::micros(11))
        };
        let now = crystal.stamp(SimTime::from_ticks(0));
        let central = GuardianConfig {
            spell_bits: SHORT,
            handling: Micros::micros(HANDLING),
            ruling: Micros::micros(600),
            ..config
        };
        let guardian = Guardian::new(schedule, central, senders, now).expect("it is sound");
        let (watch, judge) = guardian.halves();
        let singles = senders
            .map(|node| {
                let guardian = Guardian::new(schedule, config, [node], now);
                Single::Whole(Box::new(guardian.expect("it is sound")))
            })
            .into();
        let open = watch.gates();
        let mut guarded = Self {
            watch,
            judge,
            rounds: Rounds::default(),
            singles,
            singly_open: u32::MAX,
            own: 0,
            by_edges: false,
            edges: [Edges::default(); P],
            crystal,
            open,
            taken: None,
            lines: Lines::default(),
            timer: seed % LOOK,
            late: 0,
            pending: Vec::new(),
            random: Numbers(seed.wrapping_mul(77) + 1),
            period: LOOK,
            lateness: LATE,
            taking: FRAME,
            deaf: 200,
            contenders: Vec::new(),
            destroyed_at: None,
            clipped: 0,
            history: Vec::new(),
            babbler: None,
            looks: 0,
        };
        let span = 2 * ppm.unsigned_abs() * 1000;
        guarded.crystal.ppb = guarded.below(span + 1) as i32 - (ppm * 1000) as i32;
        guarded
    }

    /// A number below `end`.
    pub(crate) fn below(&mut self, end: u64) -> u64 {
        self.random.below(end)
    }

    /// From now on guardians of one node work in steps.
    pub(crate) fn work_in_steps(&mut self, now: u64) {
        let now = self.stamp(now);
        let singles = core::mem::take(&mut self.singles);
        let singles = singles.into_iter();
        self.singles = singles.map(|single| single.work_in_steps(now)).collect();
    }

    /// How often each node was cut by the guardian that sees only this one.
    pub(crate) fn singly(&self) -> Vec<u16> {
        self.singles.iter().map(|single| single.trips().0).collect()
    }

    /// Why the guardian of a node alone has cut it the last time.
    pub(crate) fn reason(&self, node: usize) -> Option<Trip> {
        self.singles.get(node).and_then(|single| single.trips().1)
    }

    pub(crate) fn is_open(&self, sender: usize) -> bool {
        if self.own == 0 {
            self.open.is_open(sender)
        } else {
            (self.singly_open | !self.own) >> sender & 1 == 1
        }
    }

    fn stamp(&self, nanos: u64) -> Stamp {
        self.crystal.stamp(SimTime::from_ticks(nanos))
    }

    /// Lets time pass up to `nanos`.
    pub(crate) fn run(&mut self, nanos: u64) {
        while let Some(&(time, event)) = self.pending.first()
            && time <= nanos
        {
            self.look_until(time);
            self.pending.remove(0);
            match event {
                Event::Edge(sender, Level::Dominant) => {
                    self.lines.dominant |= 1 << sender;
                    self.lines.fell |= 1 << sender;
                    self.edge(sender, time, true);
                }
                Event::Edge(sender, Level::Recessive) => {
                    self.lines.dominant &= !(1 << sender);
                    self.edge(sender, time, false);
                }
                Event::Frame(frame, sender) => {
                    let stamp = self.stamp(time);
                    // A CAN controller does not receive what it sends. Guardians of masters need their references.
                    let own = sender.filter(|own| *own >= MASTERS);
                    let singles = self.singles.iter_mut().enumerate();
                    for (at, single) in singles.filter(|(at, _)| own != Some(*at)) {
                        let open = single.handle_frame(&frame, stamp).bits();
                        self.singly_open = self.singly_open & !(1 << at) | open << at;
                    }
                    let at = time + self.below(self.taking);
                    self.insert(at, Event::Take(frame, stamp));
                }
                Event::Take(frame, stamp) => {
                    assert!(self.taken.is_none(), "the frame before was told of");
                    self.taken = Some((frame, stamp, self.watch.evidence()));
                    let at = time + self.below(TOLD);
                    self.insert(at, Event::Tell);
                }
                Event::Tell => {
                    let (frame, stamp, evidence) = self.taken.take().expect("it was taken");
                    if self.judge.receive(&frame, stamp, &evidence) {
                        self.rounds.ahead = time + self.below(LATE_AHEAD);
                    }
                    for waits in [&mut self.rounds.rule, &mut self.rounds.account] {
                        *waits = waits.map(|at| at.max(time));
                    }
                    self.ask(time);
                }
            }
        }
        self.look_until(nanos);
    }

    /// A line changes: what rests is woken, and the timer begins anew.
    fn edge(&mut self, sender: usize, time: u64, falls: bool) {
        if !self.by_edges {
            return;
        }
        let late = self.below(self.lateness + 1);
        let edges = &mut self.edges[sender];
        edges.edge = time;
        edges.fell |= falls;
        if self.singles[sender].is_between_spells() {
            let next = edges.next.filter(|next| !falls || *next < time + late);
            edges.next = next.or(falls.then_some(time + late));
        } else {
            self.set_alarm(sender, time);
        }
    }

    /// When the guardian of a node looks next, unless it rests.
    fn set_alarm(&mut self, sender: usize, time: u64) {
        let single = &self.singles[sender];
        if single.is_at_rest() {
            return;
        }
        let rests = single.is_between_spells();
        let edges = self.edges[sender];
        let now = self.stamp(time);
        let ahead = u64::from(single.due().ticks_since(now).max(0).unsigned_abs());
        let limit = time + ahead * 1000 / u64::from(TICKS_PER_US);
        let quiet = (edges.edge + QUIET).max(time + 1);
        let is_dominant = self.lines.dominant >> sender & 1 == 1;
        let next = match rests || is_dominant || edges.looked >= quiet {
            true => limit.max(time + 1),
            false => limit.max(time + 1).min(quiet),
        };
        self.edges[sender].next = Some(next + self.below(self.lateness + 1));
    }

    /// The looks of the guardians that edges wake, up to `nanos`.
    fn looks_by_edges(&mut self, nanos: u64) {
        for sender in 0..P {
            while let Some(next) = self.edges[sender].next.filter(|next| *next < nanos) {
                let edges = self.edges[sender];
                self.edges[sender] = Edges {
                    next: None,
                    looked: next,
                    fell: false,
                    ..edges
                };
                let lines = Lines {
                    dominant: self.lines.dominant >> sender & 1,
                    fell: u32::from(edges.fell),
                };
                let mut looks = vec![(next, lines)];
                if lines.dominant == 0 && next >= edges.edge + QUIET {
                    // The timer says since when the line is quiet.
                    let before = edges.edge.max(edges.looked);
                    looks = vec![(before, lines), (next, Lines::default())];
                }
                for (time, lines) in looks {
                    let now = self.stamp(time);
                    let open = self.singles[sender].look(lines, now).bits();
                    self.singly_open = self.singly_open & !(1 << sender) | open << sender;
                    self.looks += 1;
                }
                self.set_alarm(sender, next);
            }
        }
    }

    /// Looks at the lines whenever the timer asks before `nanos`, and lets the lower half work.
    fn look_until(&mut self, nanos: u64) {
        if self.by_edges {
            self.looks_by_edges(nanos);
        }
        loop {
            let rounds = self.rounds;
            let mut asked = [Some(rounds.ahead), rounds.rule, rounds.account];
            if self.taken.is_some() {
                // What has lower priorities waits.
                asked = [Some(rounds.ahead), None, None];
            }
            match asked.into_iter().flatten().min() {
                Some(at) if at < nanos && at <= self.next_look() => self.round(at),
                _ if self.next_look() < nanos => self.look_and_skip(nanos),
                _ => break,
            }
        }
    }

    /// What the lower half has to do at `time`.
    fn round(&mut self, time: u64) {
        let now = self.stamp(time);
        if self.rounds.ahead == time {
            let mut next = time + AHEAD + self.below(LATE_AHEAD);
            if self.judge.is_ahead(now) {
                // What would not change anything is left out.
                next += 3 * AHEAD;
            }
            let outlook = self.judge.look_ahead(now);
            for sender in 0..P {
                self.watch.publish(&outlook, sender);
            }
            self.rounds.ahead = next;
        } else if self.rounds.rule == Some(time) {
            self.rounds.rule = None;
            self.judge.rule(&self.watch.news(), now);
            if self.rounds.account.is_none() && self.judge.is_behind(now) {
                self.rounds.account = Some(time + self.below(STEP));
            }
        } else {
            self.rounds.account = None;
            let orders = self.judge.account(self.watch.driving(), now);
            self.watch.obey(orders);
        }
        self.open = self.watch.gates();
        self.ask(time);
    }

    /// Asks the lower half if there is something to do.
    fn ask(&mut self, time: u64) {
        let now = self.stamp(time);
        let waits = self.rounds.account.is_none() && self.judge.is_behind(now);
        if self.rounds.rule.is_none() && (self.watch.has_news() || waits) {
            self.rounds.rule = Some(time + self.below(RULE));
        }
    }

    fn look_and_skip(&mut self, nanos: u64) {
        self.look();
        self.timer += self.period;
        // What does not change anything is left out.
        if self.lines.fell == 0 {
            let now = self.next_look();
            let wake = [Some(self.judge.wake()), self.watch.due()];
            let all = self.own == 0;
            let awake = self.singles.iter().filter(|_| !self.by_edges);
            let awake = awake.filter(|single| all || !single.is_at_rest());
            let asked = awake.map(Single::due);
            let dues = wake.into_iter().flatten().chain(asked);
            let at = self.stamp(now);
            let ahead = dues.map(|due| due.ticks_since(at)).min().unwrap_or(0);
            let idle = u64::from(ahead.max(0).unsigned_abs() / TICKS_PER_US) * 1000;
            let idle = idle.min(nanos.saturating_sub(now));
            self.timer += idle.saturating_sub(2 * self.period) / self.period * self.period;
        }
        self.late = self.below(self.lateness);
    }

    fn next_look(&self) -> u64 {
        self.timer + self.late
    }

    fn look(&mut self) {
        let time = self.next_look();
        let now = self.stamp(time);
        self.open = self.watch.look(self.lines, now);
        self.ask(time);
        let by_timer = !self.by_edges;
        for (at, single) in self.singles.iter_mut().enumerate().filter(|_| by_timer) {
            let line = Lines {
                dominant: self.lines.dominant >> at & 1,
                fell: self.lines.fell >> at & 1,
            };
            if self.own == 0 || line != Lines::default() || !single.is_at_rest() {
                let open = single.look(line, now).bits();
                self.singly_open = self.singly_open & !(1 << at) | open << at;
            }
        }
        self.lines.fell = 0;
        self.looks += 1;
    }

    /// How often a sender was cut, and why the last time.
    pub(crate) fn trips(&self, sender: usize) -> (u16, Option<Trip>) {
        self.judge.trips(sender)
    }

    /// How often a sender was cut by the guardian that has its gate, and why the last time.
    pub(crate) fn cuts(&self, sender: usize) -> (u16, Option<Trip>) {
        match self.own {
            0 => self.trips(sender),
            own if own >> sender & 1 == 1 => self.singles[sender].trips(),
            _ => (0, None),
        }
    }

    pub(crate) fn state(&self) -> GuardianState {
        self.judge.state()
    }

    fn push(&mut self, time: u64, event: Event) {
        // What a reception's stamp and its interrupt need.
        let time = time + 200 + self.below(600);
        self.insert(time, event);
    }

    fn insert(&mut self, time: u64, event: Event) {
        let at = self.pending.partition_point(|(other, _)| *other <= time);
        self.pending.insert(at, (time, event));
    }

    /// A stretch of dominant bits on a line.
    pub(crate) fn drive(&mut self, sender: usize, from: u64, bits: u64) {
        self.push(from, Event::Edge(sender, Level::Dominant));
        self.push(from + bits * BIT, Event::Edge(sender, Level::Recessive));
    }

    /// The edges of the first `bits` bits of a frame.
    pub(crate) fn send(&mut self, sender: usize, frame: &Frame, from: u64, bits: usize) {
        let mut last = true;
        let stuffed = bits_of(frame);
        let bits = bits.min(stuffed.len());
        for (at, bit) in stuffed.into_iter().take(bits).chain([true]).enumerate() {
            if bit != last {
                let level = if bit {
                    Level::Recessive
                } else {
                    Level::Dominant
                };
                self.push(from + at as u64 * BIT, Event::Edge(sender, level));
            }
            last = bit;
        }
    }

    /// Two frames begin together on the bus. Returns whether they destroy each other.
    fn collide(
        &mut self,
        (one, ours): (usize, &Frame),
        (other, theirs): (usize, &Frame),
        from: u64,
        alive: &[bool; P],
    ) -> bool {
        let (bits, other_bits) = (bits_of(ours), bits_of(theirs));
        let pairs = bits.iter().zip(&other_bits);
        let same = pairs.take_while(|(a, b)| a == b).count();
        if same == bits.len().min(other_bits.len()) {
            self.send(other, theirs, from, same);
            return false;
        }
        // Who sends the recessive bit sees it dominant, and sends a flag behind it. It destroys the frame of the other
        // one.
        let (first, second) = if bits[same] {
            (one, other)
        } else {
            (other, one)
        };
        let bit = same as u64;
        for (node, frame) in [(one, ours), (other, theirs)] {
            self.send(node, frame, from, same + usize::from(node == second));
        }
        self.drive(first, from + (bit + 1) * BIT, 6);
        self.drive(second, from + (bit + 2) * BIT, 6);
        for (node, alive) in alive.iter().enumerate() {
            if *alive && node != one && node != other {
                self.drive(node, from + (bit + 7) * BIT, 6);
            }
        }
        // The last flag, and the delimiter.
        self.destroyed_at = Some(same as u32 + 13 + 8 - ERROR_BITS);
        true
    }

    /// A frame begins on the bus, or would without its gate. What becomes of it?
    pub(crate) fn transmit(
        &mut self,
        sender: usize,
        frame: &Frame,
        from: u64,
        fate: Fate,
        alive: &[bool; P],
    ) -> Fate {
        let (id, state) = (frame.id(), self.state());
        self.note(format!("{id} of {sender} at {from}, {fate:?}, {state:?}"));
        let bits = bits_of(frame).len();
        self.destroyed_at = None;
        for (other, contender) in core::mem::take(&mut self.contenders) {
            if self.is_open(other)
                && self.collide((sender, frame), (other, &contender), from, alive)
            {
                return Fate::Destroyed;
            }
        }
        if fate == Fate::Destroyed {
            // All see the error in bit 14.
            self.destroyed_at = Some(14);
            self.send(sender, frame, from, 14);
            for (node, alive) in alive.iter().enumerate() {
                if *alive && node != sender {
                    self.drive(node, from + 14 * BIT, 6);
                }
            }
            // Its own flag, in the same spell.
            self.drive(sender, from + 15 * BIT, 6);
            return fate;
        }
        self.send(sender, frame, from, bits);
        if fate == Fate::NotAcknowledged {
            // Its flag begins behind the acknowledge slot.
            self.drive(sender, from + (bits as u64 + 2) * BIT, 6);
            return fate;
        }
        let mut time = from;
        while time < from + bits as u64 * BIT {
            time += 4 * BIT;
            self.run(time);
            if !self.is_open(sender) {
                let trips: Vec<_> = (0..P).map(|at| self.trips(at)).collect();
                self.note(format!("closed after {} ns, {trips:?}", time - from));
                self.clipped += 1;
                // The receivers see it 6 bits later. Their flags take 6, and the delimiter 8.
                self.destroyed_at = Some(((time - from) / BIT) as u32 + 20 - ERROR_BITS);
                if self.babbler != Some(sender) {
                    // It sees that the bus is not what it sends, and sends a flag.
                    self.pending.retain(|(at, event)| {
                        *at <= time || !matches!(event, Event::Edge(of, _) if *of == sender)
                    });
                    self.push(time, Event::Edge(sender, Level::Recessive));
                    self.drive(sender, time + BIT, 6);
                }
                for (node, alive) in alive.iter().enumerate() {
                    if *alive && node != sender {
                        self.drive(node, time + 6 * BIT, 6);
                    }
                }
                return Fate::Destroyed;
            }
        }
        let end = from + (bits as u64 + 10) * BIT;
        for (node, alive) in alive.iter().enumerate() {
            if *alive && node != sender && fate != Fate::MissedBy(node) {
                self.drive(node, end - 9 * BIT, 1);
            }
        }
        if self.deaf == 0 || self.below(self.deaf) > 0 {
            self.push(end - BIT, Event::Frame(*frame, Some(sender)));
        } else {
            self.note("not received".to_owned());
        }
        fate
    }

    /// A frame of a sender that nobody guards begins on the bus. Those that are alive acknowledge it.
    pub(crate) fn overhear(&mut self, frame: &Frame, from: u64, alive: &[bool; P]) {
        self.run(from);
        let end = from + (bits_of(frame).len() as u64 + 10) * BIT;
        for (node, _) in alive.iter().enumerate().filter(|(_, alive)| **alive) {
            self.drive(node, end - 9 * BIT, 1);
        }
        self.push(end - BIT, Event::Frame(*frame, None));
    }

    fn note(&mut self, line: String) {
        if self.history.len() > 150 {
            self.history.remove(0);
        }
        self.history.push(line);
    }

    /// What happened lately.
    pub(crate) fn history(&self) -> String {
        format!("{:?}\n{}", self.state(), self.history.join("\n"))
    }
}
