//! The queue of a node that sends at once, and its link: nothing is lost but what newer data replace
//! or what is too old, the lowest identifier goes first, and everything is bounded.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

use firmware::event::{ATTEMPTS, Identity, Link, Mailboxes, Need, Outbox, Route, Waiting};
use firmware::link::{Port, WindowTimer};
use proptest::prelude::*;
use sled_common::can::{ErrorState, MAILBOXES, Occupied, Outcome, Received};
use sled_common::clock::Oscillator;
use ttcan::{Frame, Id, Micros, NodeId};

const PLACES: usize = 5;

fn frame(id: u16, value: u8) -> Frame {
    let id = Id::standard(id).expect("a standard identifier");
    Frame::new(id, &[value]).expect("one byte")
}

#[derive(Clone, Copy, Debug)]
enum Step {
    Insert { id: u16, lifetime: u32 },
    Begin(usize),
    End(usize),
    Back(usize),
    Leave(usize),
    Expire,
    Pass(u32),
}

fn step() -> impl Strategy<Value = Step> {
    let mailbox = 0..MAILBOXES;
    prop_oneof![
        4 => (0..8u16, 0..1000u32).prop_map(|(id, lifetime)| Step::Insert { id, lifetime }),
        3 => mailbox.clone().prop_map(Step::Begin),
        1 => mailbox.clone().prop_map(Step::End),
        2 => mailbox.clone().prop_map(Step::Back),
        1 => mailbox.prop_map(Step::Leave),
        1 => Just(Step::Expire),
        1 => (0..300u32).prop_map(Step::Pass),
    ]
}

/// What the queue should hold: value and last use of each identifier.
#[derive(Default)]
struct Model {
    known: BTreeSet<u16>,
    waiting: BTreeMap<u16, (u8, u64)>,
    sending: [Option<(u16, u8, u64)>; MAILBOXES],
    leaving: [bool; MAILBOXES],
    /// A newer frame of the same message has come.
    outdated: [bool; MAILBOXES],
}

impl Model {
    fn is_sending(&self, id: u16) -> bool {
        let mut sending = self.sending.iter().flatten();
        sending.any(|(other, ..)| *other == id)
    }

    /// The most urgent frame that may go into a mailbox.
    fn first(&self) -> Option<u16> {
        let mut waiting = self.waiting.keys().copied();
        waiting.find(|id| !self.is_sending(*id))
    }

    /// A frame in a mailbox is as old as the newest one of its message.
    fn outdate(&mut self, id: u16, expires: u64) {
        for (sending, outdated) in self.sending.iter_mut().zip(&mut self.outdated) {
            if let Some((other, _, at)) = sending
                && *other == id
            {
                (*at, *outdated) = (expires, true);
            }
        }
    }

    /// What a frame of this identifier needs that has come to wait.
    fn need(&self, id: u16) -> Need {
        let sending = |one: &Option<(u16, u8, u64)>| one.is_some_and(|(other, ..)| other == id);
        if let Some(mailbox) = self.sending.iter().position(sending) {
            return Need::Withdraw(mailbox);
        }
        match self.sending.iter().position(Option::is_none) {
            Some(free) => Need::Load(free),
            None => self.less_urgent(id).map_or(Need::Patience, Need::Withdraw),
        }
    }

    /// The mailbox with the least urgent frame that stays, if this identifier goes before it.
    fn less_urgent(&self, id: u16) -> Option<usize> {
        let sending = self.sending.iter().enumerate();
        let sending = sending.filter(|(mailbox, _)| !self.leaving[*mailbox]);
        let sending = sending.filter_map(|(mailbox, frame)| Some((frame.as_ref()?.0, mailbox)));
        let least = sending.max()?;
        (least.0 > id).then_some(least.1)
    }
}

proptest! {
    #[test]
    fn a_frame_leaves_the_queue_only_when_it_is_sent_replaced_or_too_old(
        steps in proptest::collection::vec(step(), 0..200),
        begin in any::<u32>(),
    ) {
        let mut outbox: Outbox<PLACES> = Outbox::new();
        let mut model = Model::default();
        // Time of the model, which does not wrap.
        let mut now: u64 = 0;
        let stamp = |time: u64| begin.wrapping_add(time as u32);
        for (value, step) in steps.into_iter().enumerate() {
            let value = value as u8;
            match step {
                Step::Insert { id, lifetime } => {
                    let expires = now + u64::from(lifetime);
                    let new = Waiting { frame: frame(id, value), expires: stamp(expires) };
                    let replaces = model.waiting.contains_key(&id);
                    let fits = model.known.contains(&id) || model.known.len() < PLACES;
                    let place = outbox.claim(new.frame.id());
                    prop_assert_eq!(place.is_ok(), fits);
                    if let Ok(place) = place {
                        let (replaced, need) = outbox.insert(place, new);
                        prop_assert_eq!(replaced, replaces);
                        prop_assert_eq!(need, model.need(id));
                        model.known.insert(id);
                        model.waiting.insert(id, (value, expires));
                        model.outdate(id, expires);
                    }
                }
                Step::Begin(mailbox) if model.sending[mailbox].is_none() => {
                    let first = model.first();
                    let taken = first.and_then(|id| Some((id, model.waiting.remove(&id)?)));
                    (model.leaving[mailbox], model.outdated[mailbox]) = (false, false);
                    model.sending[mailbox] = taken.map(|(id, (value, at))| (id, value, at));
                    let expected = taken.map(|(id, (value, _))| frame(id, value));
                    let place = outbox.first();
                    let begun = place.and_then(|place| outbox.begin(mailbox, place).copied());
                    prop_assert_eq!(begun, expected);
                }
                Step::Begin(_) => {}
                Step::End(mailbox) => {
                    outbox.end(mailbox);
                    model.sending[mailbox] = None;
                }
                Step::Back(mailbox) => {
                    let waits = match model.sending[mailbox].take() {
                        None => true,
                        Some(_) if model.outdated[mailbox] => false,
                        Some((_, _, expires)) if expires < now => false,
                        Some((id, value, expires)) => {
                            model.waiting.insert(id, (value, expires));
                            true
                        }
                    };
                    prop_assert_eq!(outbox.back(mailbox, stamp(now)), waits);
                }
                Step::Leave(mailbox) => {
                    outbox.leave(mailbox);
                    model.leaving[mailbox] = true;
                }
                Step::Expire => {
                    let before = model.waiting.len();
                    model.waiting.retain(|_, (_, expires)| *expires >= now);
                    let dropped = before - model.waiting.len();
                    prop_assert_eq!(usize::from(outbox.expire(stamp(now))), dropped);
                }
                Step::Pass(time) => now += u64::from(time),
            }
            for (mailbox, sending) in model.sending.iter().enumerate() {
                let of = sending.map(|(id, ..)| u32::from(id));
                prop_assert_eq!(outbox.sending(mailbox).map(|id| id.raw()), of);
                let stays = sending.filter(|_| !model.leaving[mailbox]);
                let old = stays.map(|(_, _, at)| at < now);
                prop_assert_eq!(outbox.is_old(mailbox, stamp(now)), old == Some(true));
            }
            let free = model.sending.iter().position(Option::is_none);
            prop_assert_eq!(outbox.free_mailbox(), free);
        }
        for mailbox in 0..MAILBOXES {
            outbox.end(mailbox);
        }
        let rest = std::iter::from_fn(|| {
            let place = outbox.first()?;
            let frame = outbox.begin(0, place).copied();
            outbox.end(0);
            frame
        });
        let rest: Vec<Frame> = rest.collect();
        let expected = model.waiting.iter().map(|(id, (value, _))| frame(*id, *value));
        prop_assert_eq!(rest, expected.collect::<Vec<_>>());
    }
}

/// A controller whose attempts end as the test wants.
#[derive(Default)]
struct Cell {
    mailbox: [Option<Frame>; MAILBOXES],
    aborted: [bool; MAILBOXES],
    outcome: [Option<Outcome>; MAILBOXES],
    loaded: Vec<Frame>,
}

impl Cell {
    /// The mailbox whose frame competes first.
    fn first(&self) -> Option<usize> {
        let mailboxes = self.mailbox.iter().enumerate();
        let ids = mailboxes.filter_map(|(at, frame)| Some((frame.as_ref()?.id(), at)));
        ids.min().map(|(_, at)| at)
    }
}

#[derive(Clone, Default)]
struct TestPort(Rc<RefCell<Cell>>);

impl Port for TestPort {
    fn receive(&mut self) -> Option<Received> {
        None
    }
    fn take_overrun(&mut self) -> bool {
        false
    }
    fn load(&mut self, frame: &Frame) -> Result<(), Occupied> {
        self.load_into(0, frame)
    }
    fn abort(&mut self) {
        self.abort_in(0);
    }
    fn outcome(&mut self) -> Option<Outcome> {
        self.outcome_in(0)
    }
    fn acknowledge_error(&mut self) {}
    fn error_state(&self) -> ErrorState {
        ErrorState::default()
    }
    fn leave_bus(&mut self) {}
    fn join_bus(&mut self, _: bool) -> bool {
        true
    }
    fn take_error(&mut self) -> bool {
        false
    }
}

impl Mailboxes for TestPort {
    fn load_into(&mut self, mailbox: usize, frame: &Frame) -> Result<(), Occupied> {
        let mut cell = self.0.borrow_mut();
        if cell.mailbox[mailbox].is_some() || cell.outcome[mailbox].is_some() {
            return Err(Occupied);
        }
        cell.mailbox[mailbox] = Some(*frame);
        cell.aborted[mailbox] = false;
        cell.loaded.push(*frame);
        Ok(())
    }
    fn abort_in(&mut self, mailbox: usize) {
        self.0.borrow_mut().aborted[mailbox] = true;
    }
    fn outcome_in(&mut self, mailbox: usize) -> Option<Outcome> {
        self.0.borrow_mut().outcome[mailbox].take()
    }
    fn order_by_identifier(&mut self) {}
    fn accept_only(&mut self, _: &[u16]) {}
}

struct Still;

impl WindowTimer for Still {
    fn now(&self) -> u32 {
        0
    }
    fn set_window(&mut self, _: u32) {}
    fn clear_window(&mut self) {}
}

const WINDOWS: usize = 6;
const EVENTS: u16 = 2;

/// Messages of this node, more than there are mailboxes, the most urgent of them last.
static ROUTES: [Option<Route>; WINDOWS] = [
    route::<205>(0),
    route::<204>(1),
    None,
    route::<203>(2),
    route::<202>(3),
    route::<201>(4),
];

const fn route<const ID: u16>(place: u8) -> Option<Route> {
    Some(Route {
        id: Id::constant::<ID>(),
        len: 1,
        sender: NodeId(0),
        period: Micros::millis(5),
        place,
    })
}

#[derive(Clone, Copy, Debug)]
enum Act {
    Put(usize),
    Event(u16),
    /// The attempt of the most urgent frame ends so.
    Ends(Outcome),
    /// A frame whose withdrawal was asked for is withdrawn.
    Withdrawn(usize),
    Supervise,
}

fn act() -> impl Strategy<Value = Act> {
    let outcome = prop_oneof![
        2 => Just(Outcome::Complete),
        3 => Just(Outcome::ArbitrationLost),
        1 => Just(Outcome::Error),
    ];
    prop_oneof![
        3 => (0..WINDOWS).prop_map(Act::Put),
        1 => (0..EVENTS).prop_map(Act::Event),
        4 => outcome.prop_map(Act::Ends),
        2 => (0..MAILBOXES).prop_map(Act::Withdrawn),
        1 => Just(Act::Supervise),
    ]
}

/// The data of each message that are not out yet.
type Unsent = BTreeMap<Id, u8>;

/// Whether what is in the mailboxes goes before all that waits, or is about to be withdrawn.
fn is_in_order(cell: &Cell, unsent: &Unsent) -> bool {
    let mailboxes = || cell.mailbox.iter().zip(cell.aborted);
    let current = |id: &Id, value: &u8| {
        mailboxes().any(|(frame, _)| {
            frame.is_some_and(|frame| (frame.id(), frame.data()[0]) == (*id, *value))
        })
    };
    let waiting = unsent.iter().find(|(id, value)| !current(id, value));
    waiting.is_none_or(|(id, _)| {
        // Either a withdrawal is on its way, or all in the mailboxes are more urgent.
        let later = |frame: &Frame| frame.id() >= *id;
        mailboxes().any(|(frame, aborted)| frame.as_ref().is_some_and(later) && aborted)
            || mailboxes().all(|(frame, _)| frame.is_some_and(|frame| frame.id() < *id))
    })
}

proptest! {
    #[test]
    fn the_last_data_of_each_message_are_sent_in_the_order_of_the_identifiers(
        acts in proptest::collection::vec(act(), 0..200),
    ) {
        let port = TestPort::default();
        let cell = Rc::clone(&port.0);
        let identity = Identity {
            routes: &ROUTES,
            basic_cycle: Micros::millis(5),
            node: NodeId(0),
            awaited: Id::constant::<530>(),
            received: &[],
        };
        let place = Box::leak(Box::new(None));
        let mut link: Link<_, _, WINDOWS, { WINDOWS - 1 + EVENTS as usize }> =
            Link::new(place, identity, Oscillator::External, 18, port, Still);
        link.start();
        let mut unsent = Unsent::new();
        let (mut failures, mut troubled) = (0, false);
        let drain = [Act::Supervise, Act::Ends(Outcome::Complete)];
        let drain = std::iter::repeat_n(drain, 4 * (WINDOWS + usize::from(EVENTS))).flatten();
        for (at, act) in acts.into_iter().chain(drain).enumerate() {
            let value = at as u8;
            let loads = cell.borrow().loaded.len();
            match act {
                Act::Put(window) => {
                    link.put(window, [value; 8]);
                    if let Some(route) = ROUTES[window] {
                        unsent.insert(route.id, value);
                    }
                }
                Act::Event(event) => {
                    let id = 500 + event;
                    prop_assert_eq!(link.queue_event(id, &[value], Micros::secs(1)), Ok(()));
                    unsent.extend(Id::standard(id).map(|id| (id, value)));
                }
                Act::Ends(outcome) => {
                    let first = cell.borrow().first();
                    if let Some(mailbox) = first {
                        let frame = cell.borrow_mut().mailbox[mailbox].take();
                        cell.borrow_mut().outcome[mailbox] = Some(outcome);
                        let sent = frame.filter(|_| outcome == Outcome::Complete);
                        if let Some(frame) = sent
                            && unsent.get(&frame.id()) == Some(&frame.data()[0])
                        {
                            unsent.remove(&frame.id());
                        }
                        failures = match outcome {
                            Outcome::Complete => 0,
                            Outcome::Error => failures + 1,
                            _ => failures,
                        };
                        prop_assert!(!link.on_transmit(0));
                    }
                }
                Act::Withdrawn(mailbox) => {
                    let frame = cell.borrow_mut().mailbox[mailbox].take();
                    let aborted = cell.borrow().aborted[mailbox];
                    if frame.is_some() && aborted {
                        cell.borrow_mut().outcome[mailbox] = Some(Outcome::Aborted);
                        prop_assert!(!link.on_transmit(0));
                    } else {
                        cell.borrow_mut().mailbox[mailbox] = frame;
                    }
                }
                Act::Supervise => {
                    link.service();
            link.tidy();
                    failures = 0;
                }
            }
            let cell = cell.borrow();
            // After errors the node rests, except for what was in its other mailboxes.
            prop_assert!(usize::from(failures) < usize::from(ATTEMPTS) + MAILBOXES);
            prop_assert!(failures < ATTEMPTS || cell.loaded.len() == loads);
            // Its order holds again when it has caught up after errors.
            troubled = !unsent.is_empty() && (troubled || failures > 0);
            prop_assert!(troubled || is_in_order(&cell, &unsent));
            for (at, frame) in cell.mailbox.iter().enumerate() {
                let same = |other: &Option<Frame>| {
                    other.zip(*frame).is_some_and(|(a, b)| a.id() == b.id())
                };
                prop_assert!(!cell.mailbox[..at].iter().any(same), "twice in the mailboxes");
            }
        }
        prop_assert_eq!(unsent, Unsent::new());
    }
}
