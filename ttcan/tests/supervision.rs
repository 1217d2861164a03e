//! What nodes say about each other when frames are outside their windows.

mod support;

use support::{ALARM, DRIVE, GPS, UagvBus, at, crystal, is_reference, uagv, vehicle};
use ttcan::simulation::{Application, Quiet, SimTime};
use ttcan::{Fault, Frame, Health, Id, NodeId, Reception};

const SPEED: Id = Id::constant::<210>();

/// What the nodes received.
#[derive(Default)]
struct Faults(Vec<(usize, Fault)>);

impl Application for Faults {
    fn received(&mut self, node: usize, _: &Frame, reception: Reception, _: SimTime) {
        if let Reception::Fault(fault) = reception {
            self.0.push((node, fault));
        }
    }
}

fn speed() -> Frame {
    Frame::new(SPEED, &[0; 4]).expect("it is short")
}

fn power_on<A: Application>(bus: &mut UagvBus<A>) {
    for node in 0..4 {
        bus.start(node);
    }
}

/// It sends ten messages in each basic cycle, and none in its window.
#[test]
fn a_babbling_node_is_called_so_all_the_time() {
    let mut bus = vehicle(Quiet, 13);
    power_on(&mut bus);
    // No frame is injected in the window of the node.
    bus.run_until(at(1055));
    bus.crash(3, uagv(DRIVE));
    let (mut babbling, mut looks) = (0, 0);
    for slot in 0..100 {
        for _ in 0..10 {
            bus.run_millis(1);
            if slot >= 20 {
                babbling += u32::from(bus.node(2).peer(DRIVE) == Health::Babbling);
                looks += 1;
            }
        }
        bus.inject(0, speed());
    }
    assert_eq!(babbling, looks, "babbling {babbling} of {looks} times");
    // It is over after two basic cycles.
    bus.run_millis(250);
    assert_ne!(bus.node(2).peer(DRIVE), Health::Babbling);
}

/// Another node sends under the name of one that keeps its windows.
#[test]
fn a_node_that_keeps_its_windows_is_not_accused() {
    for in_a_cycle in [1, 2, 10] {
        let mut bus = vehicle(Faults::default(), 14);
        power_on(&mut bus);
        // No frame is injected in the window of the node.
        bus.run_until(at(1055));
        let mut said = Vec::new();
        for _ in 0..10 * in_a_cycle {
            bus.run_millis(100 / in_a_cycle);
            bus.inject(0, speed());
            let health = bus.node(2).peer(DRIVE);
            if !said.contains(&health) {
                said.push(health);
            }
        }
        assert_eq!(said, [Health::Healthy, Health::Masquerade], "{in_a_cycle}");
        // The node itself knows.
        let heard = bus.application.0.iter().filter(|(node, _)| *node == 3);
        let impostors = heard
            .clone()
            .filter(|(_, fault)| *fault == Fault::Impostor)
            .count();
        assert_eq!(impostors, heard.count());
        assert!(impostors as u64 + 1 >= 10 * in_a_cycle, "{impostors}");
        assert_eq!(bus.node(3).counters().impostors as usize, impostors);
        // All is well again when it is over.
        bus.run_millis(2500);
        assert_eq!(bus.node(2).peer(DRIVE), Health::Healthy);
    }
}

/// Whatever the state of the node, the window and the kind of message.
#[test]
fn a_node_that_hears_its_own_identifier_says_so() {
    let reference = Frame::new(Id::constant::<100>(), &[0; 8]).expect("it is short");
    let alarm = Frame::new(ALARM, &[1; 8]).expect("it is short");
    for (node, frame) in [(3, speed()), (3, alarm), (0, reference)] {
        for millis in (1050..1150).chain([1250, 1330]) {
            let mut bus = vehicle(Faults::default(), 15);
            power_on(&mut bus);
            bus.run_until(at(1050));
            if millis > 1200 {
                // No reference comes any more.
                bus.crash(0, uagv(GPS));
                bus.crash(1, uagv(NodeId(1)));
                if node == 0 {
                    bus.start(0);
                }
            }
            bus.run_until(at(millis));
            bus.application.0.clear();
            bus.inject(2, frame);
            bus.run_millis(3);
            // If the node sends in the same instant, both frames are destroyed.
            let clean = bus
                .traffic
                .iter()
                .rev()
                .take(3)
                .any(|sent| sent.sender == 2 && sent.frame == frame && sent.start > at(millis));
            let said = bus.application.0.contains(&(node, Fault::Impostor));
            assert!(
                said || !clean,
                "node {node} at {millis} ms: {:?}",
                bus.application.0
            );
        }
    }
}

/// A node that may not lead is listed as a master, too.
#[test]
fn a_reference_of_its_own_rank_is_an_impostors() {
    let mut bus = UagvBus::new(250_000, Faults::default(), 16);
    for node in 0..4 {
        let config = ttcan::NodeConfig {
            may_lead: node != 1,
            ..support::config(NodeId(node))
        };
        let node = support::Uagv::new(support::SCHEDULE.view(), config).expect("it is sound");
        bus.add(node, crystal(0, 0));
    }
    power_on(&mut bus);
    bus.run_until(at(1050));
    let of_backup = Frame::new(Id::constant::<101>(), &[0; 8]).expect("it is short");
    bus.inject(2, of_backup);
    bus.run_millis(3);
    assert!(bus.application.0.contains(&(1, Fault::Impostor)));
    assert!(bus.traffic.iter().any(is_reference));
}
