//! The link on the boards' own port and timer.

use crate::board;
use crate::console::BusView;
use crate::design;
use crate::link::{Link, Stack, WindowTimer};
use board::clock::{Clocks, Oscillator};
use ttcan::{
    ConfigError, ErrorLevel, MasterState, Micros, NodeConfig, NodeId, StampLatency, SyncState,
};

/// The time base and its compare channels, as the link uses them.
pub struct Timer {
    clock: board::time::Clock,
    alarms: board::time::Alarms,
}

/// The link of a node on this board.
pub type BoardLink = Link<board::CanPort, Timer>;

impl WindowTimer for Timer {
    #[inline]
    fn now(&self) -> u32 {
        self.clock.now()
    }
    #[inline]
    fn set_window(&mut self, instant: u32) {
        self.alarms.set_window(instant);
    }
    #[inline]
    fn clear_window(&mut self) {
        self.alarms.clear_window();
    }
}

impl BoardLink {
    /// Sets the node's second alarm to go off in `time`.
    pub fn release_in(&mut self, time: Micros) {
        let ticks = self.ticks(time);
        self.timer_mut().release_in(ticks.cast_signed());
    }
}

impl BoardLink {
    /// Sets the node's second alarm to the cycle time `time` of the basic cycle under way; at
    /// once when that is past.
    pub fn release_at(&mut self, time: Micros) {
        if let Some(ticks) = self.until(time) {
            self.timer_mut().release_in(ticks);
        }
    }
}

impl Timer {
    /// Acknowledges the window timer; true when it had fired.
    #[inline]
    pub fn take_window(&mut self) -> bool {
        self.alarms.take_window()
    }

    /// Sets the second alarm of the node `ticks` from now; at once when negative.
    #[inline]
    pub fn release_in(&mut self, ticks: i32) {
        let instant = self.clock.now().wrapping_add_signed(ticks);
        self.alarms.set_release(instant);
    }

    /// Acknowledges the second alarm; true when it had fired.
    #[inline]
    pub fn take_release(&mut self) -> bool {
        self.alarms.take_release()
    }
}

/// Makes the link of a node, whose protocol stack lives in `place`; it is silent until [`Link::start`].
///
/// # Errors
/// The protocol stack refuses the configuration.
pub fn link(
    place: &'static mut Option<Stack>,
    node: NodeId,
    clocks: Clocks,
    can: board::CanPort,
    clock: board::time::Clock,
    alarms: board::time::Alarms,
) -> Result<BoardLink, ConfigError> {
    #[cfg(feature = "f446")]
    let (stamp, lead) = (design::STAMP_TICKS_F446, design::TRANSMIT_LEAD_F446);
    #[cfg(feature = "f303")]
    let (stamp, lead) = (design::STAMP_TICKS_F303, design::TRANSMIT_LEAD_F303);
    let bit = 1_000_000 * clocks.ticks_per_us / board::BIT_RATE;
    let config = NodeConfig {
        latency: StampLatency::bxcan(bit, stamp),
        transmit_lead: lead,
        drift_limit_ppm: match clocks.oscillator {
            Oscillator::External => design::DRIFT_LIMIT_PPM,
            Oscillator::Internal => design::DRIFT_LIMIT_PPM_INTERNAL,
        },
        ..NodeConfig::new(node, clocks.ticks_per_us)
    };
    Link::new(place, config, can, Timer { clock, alarms })
}

/// Tells a listening probe what changed on the bus. For the lowest priority only; with no
/// probe, or a slow one, the message is dropped and nobody waits.
#[derive(Default)]
pub struct Log {
    last: Option<(SyncState, MasterState, u8, u16)>,
}

impl Log {
    /// A log that has told nothing.
    pub const fn new() -> Self {
        Self { last: None }
    }

    /// Tells the state of the bus when it is another than the last one told.
    pub fn bus(&mut self, view: &BusView) {
        let level = match view.status.error_level {
            ErrorLevel::None => 0,
            ErrorLevel::Warning => 1,
            ErrorLevel::Error => 2,
            ErrorLevel::Severe(_) => 3,
        };
        let now = (
            view.status.sync,
            view.status.master,
            level,
            view.link.bus_off,
        );
        if self.last != Some(now) {
            self.last = Some(now);
            defmt::info!(
                "sync {=u8} master {=u8} level S{=u8} bus-off {=u16}",
                view.status.sync as u8,
                view.status.master as u8,
                level,
                view.link.bus_off
            );
        }
    }
}
