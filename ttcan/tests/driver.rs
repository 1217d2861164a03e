//! A node behind a controller whose driver has frames of `embedded-can`.

use embedded_can::Frame as _;
use proptest::prelude::*;
use ttcan::{
    Controller, Driver, Fault, Frame, Grant, Id, MatrixConfig, Micros, Node, NodeConfig, NodeId,
    Reception, ReferenceFormat, Stamp, SystemMatrix, TransmitOutcome, Window,
};

const MASTER: NodeId = NodeId(0);
const OTHER: NodeId = NodeId(1);
const REFERENCE: Id = Id::constant::<0x100>();
const SPEED: Id = Id::constant::<0x200>();
const MS: Micros = Micros::millis(1);
/// Ticks in a millisecond, of a counter of 1 MHz.
const TICKS: u32 = 1000;
/// Ticks in a bit.
const BIT: u32 = 4;

const MATRIX: SystemMatrix = SystemMatrix::constant(MatrixConfig {
    bit_rate: 250_000,
    basic_cycle: Micros::millis(10),
    cycles: 1,
    reference: REFERENCE,
    reference_format: ReferenceFormat::LEVEL_1,
    masters: &[MASTER],
    transmit_enable_bits: 16,
    sync_uncertainty: Micros::micros(20),
    longest_gap: Micros::micros(0),
    windows: &[
        Window::exclusive("speed", MS, MS, SPEED, 2, MASTER),
        Window::exclusive(
            "torque",
            Micros::millis(3),
            MS,
            Id::constant::<0x201>(),
            2,
            OTHER,
        ),
    ],
    events: &[],
});
ttcan::schedule!(static SCHEDULE = MATRIX);

/// A driver's frame: any length code and remote frames, and a panic when the data of a length code
/// above 8 are read.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Raw {
    id: embedded_can::Id,
    remote: bool,
    dlc: usize,
    data: [u8; 8],
}

impl embedded_can::Frame for Raw {
    fn new(id: impl Into<embedded_can::Id>, data: &[u8]) -> Option<Self> {
        let mut bytes = [0; 8];
        bytes.get_mut(..data.len())?.copy_from_slice(data);
        let (id, dlc) = (id.into(), data.len());
        let remote = false;
        Some(Self {
            id,
            remote,
            dlc,
            data: bytes,
        })
    }

    fn new_remote(id: impl Into<embedded_can::Id>, dlc: usize) -> Option<Self> {
        let id = id.into();
        (dlc <= 8).then_some(Self {
            id,
            remote: true,
            dlc,
            data: [0; 8],
        })
    }

    fn is_extended(&self) -> bool {
        matches!(self.id, embedded_can::Id::Extended(_))
    }

    fn is_remote_frame(&self) -> bool {
        self.remote
    }

    fn id(&self) -> embedded_can::Id {
        self.id
    }

    fn dlc(&self) -> usize {
        self.dlc
    }

    fn data(&self) -> &[u8] {
        &self.data[..self.dlc]
    }
}

/// Notes what a node asks of it.
#[derive(Debug, Default)]
struct Fake {
    occupied: bool,
    loaded: Vec<Raw>,
    aborts: usize,
    silent: bool,
}

impl Controller for Fake {
    type Frame = Raw;

    fn transmit_once(&mut self, frame: &Raw) -> bool {
        if !self.occupied {
            self.loaded.push(frame.clone());
        }
        !self.occupied
    }

    fn abort(&mut self) {
        self.aborts += 1;
    }

    fn silence(&mut self) {
        self.silent = true;
    }
}

type Fixture = Driver<'static, Fake, { MATRIX.window_count() }, { MATRIX.node_count() }, 1>;

fn driver(node: NodeId) -> Fixture {
    let node = Node::new(SCHEDULE.view(), NodeConfig::new(node, 1)).expect("it is sound");
    let mut driver = Driver::new(node, Fake::default());
    driver.node.start(Stamp(0));
    driver
}

/// Serves timer interrupts until something is loaded. Returns the time.
fn until_loaded(driver: &mut Fixture, mut now: Stamp, data: Option<[u8; 8]>) -> Stamp {
    let before = driver.controller.loaded.len();
    for _ in 0..100 {
        let deadline = driver.next_deadline(now).expect("the node is on");
        now = if deadline.reached(now) { deadline } else { now };
        driver.handle_timer(now, |_| data);
        if driver.controller.loaded.len() > before {
            return now;
        }
    }
    panic!("nothing is loaded: {:?}", driver.node.status());
}

/// Reports that the frame was sent that was loaded last, at this time. Returns its end.
fn finish(driver: &mut Fixture, loaded: Stamp) -> Stamp {
    let frame = driver.controller.loaded.last().and_then(Frame::from_can);
    let end = loaded.after(BIT * ttcan::frame_bits(&frame.expect("a data frame")));
    driver.handle_transmit(TransmitOutcome::Sent, end);
    end
}

/// A master whose first two references were sent, and when the second one began.
fn leading(data: Option<[u8; 8]>) -> (Fixture, Stamp) {
    let mut driver = driver(MASTER);
    let mut now = until_loaded(&mut driver, Stamp(0), data);
    now = finish(&mut driver, now);
    now = until_loaded(&mut driver, now, data);
    (driver, now)
}

#[test]
fn references_and_messages_are_loaded_as_frames_of_the_driver() {
    let data = [1, 2, 3, 4, 5, 6, 7, 8];
    let (mut driver, mut now) = leading(Some(data));
    while driver.controller.loaded.len() < 6 {
        now = finish(&mut driver, now);
        now = until_loaded(&mut driver, now, Some(data));
    }
    let ids: Vec<Id> = driver
        .controller
        .loaded
        .iter()
        .map(|raw| raw.id.into())
        .collect();
    let speeds = ids.iter().filter(|id| **id == SPEED).count();
    let references = ids.iter().filter(|id| **id == REFERENCE).count();
    assert!(
        speeds >= 2 && references >= 2 && speeds + references == ids.len(),
        "{ids:?}"
    );
    let speed = driver
        .controller
        .loaded
        .iter()
        .find(|raw| Id::from(raw.id) == SPEED);
    assert_eq!(speed.expect("it was loaded").data(), [1, 2]);
}

#[test]
fn a_window_without_data_stays_empty() {
    let (mut driver, mut now) = leading(None);
    while driver.controller.loaded.len() < 4 {
        now = finish(&mut driver, now);
        now = until_loaded(&mut driver, now, None);
    }
    assert!(
        driver
            .controller
            .loaded
            .iter()
            .all(|raw| Id::from(raw.id) == REFERENCE)
    );
    assert!(driver.node.counters().left_empty >= 2);
}

#[test]
fn a_refused_frame_counts_as_withdrawn() {
    let (mut driver, now) = leading(Some([0; 8]));
    let now = finish(&mut driver, now);
    driver.controller.occupied = true;
    let now = driver.next_deadline(now).expect("a window comes");
    driver.handle_timer(now, |_| Some([0; 8]));
    // It is told at once, in a timer interrupt of its own.
    assert_eq!(driver.next_deadline(now), Some(now));
    let aborted = driver.node.counters().aborted;
    driver.handle_timer(now, |_: Grant| panic!("no window is granted"));
    assert_eq!(driver.node.counters().aborted, aborted + 1);
    assert_ne!(driver.next_deadline(now), Some(now));
}

#[test]
fn a_frame_that_does_not_begin_in_time_is_withdrawn() {
    let (mut driver, now) = leading(None);
    let now = finish(&mut driver, now);
    let window = until_loaded(&mut driver, now, Some([0; 8]));
    assert_eq!(driver.controller.aborts, 0);
    // 16 bits of 4 us.
    let deadline = driver.next_deadline(window).expect("the window closes");
    assert_eq!(deadline.ticks_since(window), 64);
    driver.handle_timer(deadline, |_| None);
    assert_eq!(driver.controller.aborts, 1);
}

#[test]
fn a_node_that_stops_silences_its_controller() {
    let (mut driver, now) = leading(None);
    driver.node.handle_bus_off();
    driver.handle_timer(now, |_| None);
    assert!(driver.controller.silent);
}

#[test]
fn frames_of_the_driver_reach_the_node() {
    let mut driver = driver(OTHER);
    let reference = |cycle| Raw::new(REFERENCE, &[cycle]).expect("a frame");
    let stamp = Stamp(20 * TICKS);
    let taken = driver.handle_receive(&reference(0), stamp);
    assert_eq!(taken, Some(Reception::Reference { cycle: 0, rank: 0 }));
    let later = stamp.after(5 * TICKS);
    let foreign = Raw::new(SPEED, &[1, 2]).expect("a frame");
    let taken = driver.handle_receive(&foreign, later);
    assert_eq!(taken, Some(Reception::Fault(Fault::NotInSchedule)));
    let remote = Raw::new_remote(REFERENCE, 1).expect("a frame");
    assert_eq!(driver.handle_receive(&remote, later), None);
    let long = Raw {
        dlc: 9,
        ..reference(1)
    };
    assert_eq!(driver.handle_receive(&long, later), None);
}

#[test]
fn there_are_no_remote_frames() {
    assert_eq!(<Frame as embedded_can::Frame>::new_remote(SPEED, 0), None);
}

fn ids() -> impl Strategy<Value = Id> {
    let standard = (0..=Id::MAX_STANDARD).prop_map(|raw| Id::standard(raw).expect("11 bits"));
    let extended = (0..=Id::MAX_EXTENDED).prop_map(|raw| Id::extended(raw).expect("29 bits"));
    prop_oneof![standard, extended]
}

proptest! {
    #[test]
    fn frames_and_identifiers_survive_the_way_there_and_back(
        id in ids(),
        data in proptest::collection::vec(any::<u8>(), 0..=8),
    ) {
        prop_assert_eq!(Id::from(embedded_can::Id::from(id)), id);
        let frame = Frame::new(id, &data).expect("at most 8 bytes");
        let raw: Raw = frame.to_can().expect("it holds every frame");
        prop_assert_eq!(raw.is_extended(), id.is_extended());
        prop_assert_eq!(raw.data(), &data[..]);
        prop_assert_eq!(Frame::from_can(&raw), Some(frame));
        // A node's own frames are frames of the traits, too.
        let own = <Frame as embedded_can::Frame>::new(raw.id, &data);
        prop_assert_eq!(own, Some(frame));
        prop_assert_eq!(frame.to_can::<Frame>(), Some(frame));
        prop_assert_eq!(embedded_can::Frame::dlc(&frame), data.len());
        prop_assert!(frame.is_data_frame());
        // Identifiers of `embedded-can` are in the order of arbitration, too.
        let other = embedded_can::Id::Standard(embedded_can::StandardId::MAX);
        prop_assert_eq!(Id::from(other).cmp(&id), other.cmp(&id.into()));
    }
}
