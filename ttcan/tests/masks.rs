//! Event messages with several identifiers: other protocols share the arbitrating windows.

mod support;

use support::{config, crystal};
use ttcan::simulation::{Application, Bus, SimTime};
use ttcan::{
    Event, Fault, Frame, Id, MatrixConfig, Micros, Node, NodeId, QueueError, Reception,
    ReferenceFormat, SystemMatrix, Window,
};

const MASTER: NodeId = NodeId(0);
/// A node that speaks SAE J1939 with the source address 0x21, and one that speaks CANopen with the number 5.
const TRACTOR: NodeId = NodeId(1);
const DRIVE: NodeId = NodeId(2);

const fn extended(raw: u32) -> Id {
    match Id::extended(raw) {
        Some(id) => id,
        None => panic!("29 bits"),
    }
}

const J1939: Event = Event::masked("j1939", extended(0x21), 0xFF, 8, TRACTOR);
const CANOPEN: Event = Event::masked("canopen", Id::constant::<5>(), 0x7F, 8, DRIVE);

const fn matrix<'a>(events: &'a [Event<'a>]) -> MatrixConfig<'a> {
    const WINDOWS: &[Window] = &[
        Window::exclusive(
            "speed",
            Micros::millis(1),
            Micros::millis(1),
            Id::constant::<0x106>(),
            8,
            DRIVE,
        ),
        Window::arbitrating("events", Micros::millis(3), Micros::millis(4)),
    ];
    MatrixConfig {
        bit_rate: 500_000,
        basic_cycle: Micros::millis(10),
        cycles: 1,
        reference: Id::constant::<0x20>(),
        reference_format: ReferenceFormat::LEVEL_2,
        masters: &[MASTER],
        transmit_enable_bits: 16,
        sync_uncertainty: Micros::micros(20),
        longest_gap: Micros::micros(0),
        windows: WINDOWS,
        events,
    }
}

const MATRIX: SystemMatrix = SystemMatrix::constant(matrix(&[
    J1939,
    Event::new("alarm", Id::constant::<0x80>(), 1, MASTER),
    CANOPEN,
]));
ttcan::schedule!(static SCHEDULE = MATRIX);
type Three = Node<'static, { MATRIX.window_count() }, { MATRIX.node_count() }, 4>;

/// What node 0 received, but for references and messages in their windows.
#[derive(Default)]
struct Seen(Vec<(Id, Reception)>);

impl Application for Seen {
    fn received(&mut self, node: usize, frame: &Frame, reception: Reception, _: SimTime) {
        let scheduled = matches!(reception, Reception::Scheduled { .. });
        if node == 0 && !scheduled {
            self.0.push((frame.id(), reception));
        }
    }
}

fn started() -> Bus<'static, Seen, { MATRIX.window_count() }, { MATRIX.node_count() }, 4> {
    let mut bus = Bus::new(500_000, Seen::default(), 5);
    for node in 0..3 {
        let place = Three::new(SCHEDULE.view(), config(NodeId(node))).unwrap();
        bus.add(place, crystal(1000 * i32::from(node as u8), 0));
    }
    for node in 0..3 {
        bus.start(node);
    }
    bus.run_millis(100);
    bus
}

#[test]
fn frames_of_other_protocols_go_in_arbitrating_windows() {
    let mut bus = started();
    let life = Micros::millis(50);
    let mut queue = |node, id, data: &[u8]| {
        let frame = Frame::new(id, data).unwrap();
        bus.with(node, |node, now| node.queue_event(frame, now, life))
    };
    // Engine speed (PGN 61444, priority 3), a heartbeat and a process data object.
    let (speed, heartbeat, pdo) = (
        extended(0x0CF0_0421),
        Id::constant::<0x705>(),
        Id::constant::<0x185>(),
    );
    assert_eq!(queue(1, speed, &[7; 8]), Ok(()));
    assert_eq!(queue(2, heartbeat, &[5]), Ok(()));
    assert_eq!(queue(2, pdo, &[1, 2]), Ok(()));
    // Those of another source address or node are not this node's.
    let refused = Err(QueueError::NotAnEvent);
    assert_eq!(queue(1, extended(0x0CF0_0422), &[7; 8]), refused);
    assert_eq!(queue(2, Id::constant::<0x704>(), &[5]), refused);
    assert_eq!(queue(1, heartbeat, &[5]), refused);
    bus.run_millis(30);
    let seen: Vec<Id> = bus.application.0.iter().map(|(id, _)| *id).collect();
    assert_eq!(seen, [pdo, speed, heartbeat]);
    let events = bus.application.0.iter();
    let events = events.filter(|(_, reception)| *reception == Reception::Event);
    assert_eq!(events.count(), 3);
    let marks: Vec<_> = bus.traffic.iter().collect();
    for id in [pdo, speed, heartbeat] {
        let sent = marks.iter().find(|sent| sent.frame.id() == id).unwrap();
        let reference = marks.iter().rfind(|mark| {
            mark.frame.id().raw() == 0x20
                && !mark.frame.id().is_extended()
                && mark.start < sent.start
        });
        let after = sent.start.ticks() - reference.unwrap().start.ticks();
        assert!((2_980_000..7_000_000).contains(&after), "{id}: {after} ns");
    }
}

#[test]
fn a_frame_beside_the_window_or_of_nobody_is_refused() {
    let mut bus = started();
    // Behind the arbitrating window, before the next reference.
    let reference = bus
        .traffic
        .iter()
        .rfind(|sent| sent.frame.id().raw() == 0x20);
    let begin = reference.unwrap().start.ticks();
    bus.run_until(SimTime::from_ticks(begin + 18_000_000));
    let mut refusals = Vec::new();
    for id in [
        extended(0x0CF0_0421),
        extended(0x0CF0_0422),
        Id::constant::<0x106>(),
    ] {
        let frame = Frame::new(id, &[0; 8]).unwrap();
        bus.application.0.clear();
        bus.inject(1, frame);
        bus.run_millis(10);
        refusals.extend(bus.application.0.last().map(|(_, reception)| *reception));
    }
    assert_eq!(
        refusals,
        [
            Reception::Fault(Fault::Misplaced),
            Reception::Fault(Fault::Foreign),
            Reception::Fault(Fault::Misplaced),
        ]
    );
}

/// What the matrix with these events says.
fn refusal(events: &[Event]) -> String {
    let config = matrix(events);
    SystemMatrix::new(config).map_or_else(|error| error.to_string(), |_| String::from("accepted"))
}

#[test]
fn identifiers_with_two_owners_are_refused() {
    assert_eq!(refusal(&[J1939, CANOPEN]), "accepted");
    // Number 6 has the window's message, and with 0x20 the reference has a number.
    let of =
        |number: u16, mask| Event::masked("other", Id::standard(number).unwrap(), mask, 8, MASTER);
    assert!(refusal(&[of(6, 0x7F)]).contains("`speed`"));
    assert!(refusal(&[of(0x22, 0x7F)]).contains("reference"));
    assert!(refusal(&[of(0x120, 0x7F)]).contains("reference"));
    // The masks leave an identifier that both have: 0x185 has 5 below and 3 above.
    assert!(refusal(&[CANOPEN, of(0x180, 0x780)]).contains("`canopen`"));
    assert_eq!(refusal(&[CANOPEN, of(4, 0x7F)]), "accepted");
    // A base identifier is never an extended one.
    assert_eq!(refusal(&[J1939, of(0x21 + 8, 0xFF)]), "accepted");
    let one = Event::new("one", Id::constant::<0x685>(), 8, MASTER);
    assert!(refusal(&[CANOPEN, one]).contains("`canopen`"));
    assert!(refusal(&[one, CANOPEN]).contains("`one`"));
}
