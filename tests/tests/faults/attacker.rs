//! A foreign node on the vehicle's bus.

use can_bus::{Disturbance, Frame, NodeId, Retry, Tester};
use embedded_can::{Id, StandardId};
use furrow_tests::Journey;
use world::SimTime;

/// A foreign node that listens, sends frames and destroys those of others.
pub(crate) struct Attacker {
    tester: NodeId,
}

impl Attacker {
    pub(crate) fn on(journey: &mut Journey) -> Self {
        let tester = journey.vehicle.network().bus().add_tester(Tester::new());
        Self { tester }
    }

    pub(crate) fn send(&self, journey: &mut Journey, when: SimTime, id: u16, data: &[u8]) {
        let frame = Frame::standard(id, data).expect("a frame");
        let mut bus = journey.vehicle.network().bus();
        bus.send_at(self.tester, when, frame, Retry::Once);
    }

    /// Destroys each frame with this identifier, or each frame, except its own.
    pub(crate) fn suppress(
        &self,
        journey: &mut Journey,
        id: Option<u16>,
        from: SimTime,
        until: SimTime,
    ) {
        journey
            .vehicle
            .network()
            .bus()
            .disturb(Disturbance::Suppress {
                id: id.and_then(StandardId::new).map(Id::Standard),
                bit: 20,
                spared: Some(self.tester),
                from,
                until,
            });
    }
}
