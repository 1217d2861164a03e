//! What one node knows of itself.

use crate::matrix::NodeId;
use crate::time::Micros;

/// From the end of the last bit of a frame's end of frame to the stamp that the
/// node takes of it, in ticks; negative when the stamp comes earlier.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct StampLatency {
    /// Of a received frame.
    pub receive: i32,
    /// Of a frame that the node sent.
    pub transmit: i32,
}

impl StampLatency {
    /// End of frame and stamp coincide.
    pub const NONE: Self = Self {
        receive: 0,
        transmit: 0,
    };

    /// For bxCAN: a frame is valid for its receivers one bit before its end,
    /// for its transmitter at its end (ISO 11898-1), and each stamp is taken
    /// `interrupt` ticks after that. `bit` is the length of a bit in ticks.
    pub const fn bxcan(bit: u32, interrupt: u32) -> Self {
        Self {
            receive: interrupt.cast_signed().wrapping_sub(bit.cast_signed()),
            transmit: interrupt.cast_signed(),
        }
    }
}

/// Configuration of one node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeConfig {
    /// Which node this is.
    pub node: NodeId,
    /// Ticks of the stamps' counter in a microsecond, 1 to 1000.
    pub ticks_per_us: u32,
    /// When stamps are taken.
    pub latency: StampLatency,
    /// How much before its time mark a transmission is asked for, in ticks: the
    /// time from the timer's compare to the start of frame on an idle bus.
    pub transmit_lead: u32,
    /// Initial reference trigger offset in microseconds, 0 to 127: how much
    /// later than the end of the basic cycle this potential master sends the
    /// reference when a better-ranked master does not. Backups need values that
    /// grow with the rank by more than the time to notice a start of frame.
    /// `None` stands for 16 us for each rank.
    pub reference_offset: Option<u8>,
    /// References that may be missing in a row before the watch trigger: from
    /// this many on, S3. The thesis stops actuators at two (6.2.4.4).
    pub watch: u8,
    /// Longest gap, from the reference that announces it, after which a time
    /// master starts the next basic cycle without the event.
    pub longest_gap: Micros,
    /// Longest time between two calls of
    /// [`Node::feed_watchdog`](crate::Node::feed_watchdog), if the application
    /// is to be watched.
    pub application_watchdog: Option<Micros>,
    /// Largest rate between this node's counter and global time that is
    /// followed, in parts per million, up to 10 000.
    pub drift_limit_ppm: u16,
    /// Whether the node takes the place among the potential masters that the
    /// matrix gives it. One whose clock the others could not follow had better
    /// not.
    pub may_lead: bool,
}

impl core::hash::Hash for NodeConfig {
    /// The node stands for the rest.
    fn hash<H: core::hash::Hasher>(&self, state: &mut H) {
        self.node.hash(state);
    }
}

impl NodeConfig {
    /// The usual configuration: no latency, reference trigger offset by rank,
    /// watch at four missing references, gaps of ten seconds at most, no
    /// application watchdog, drift up to 200 ppm.
    pub const fn new(node: NodeId, ticks_per_us: u32) -> Self {
        Self {
            node,
            ticks_per_us,
            latency: StampLatency::NONE,
            transmit_lead: 0,
            reference_offset: None,
            watch: 4,
            longest_gap: Micros::secs(10),
            application_watchdog: None,
            drift_limit_ppm: 200,
            may_lead: true,
        }
    }
}

/// A node cannot be made of this schedule and configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConfigError {
    /// The node's sizes in its type are less than those of the schedule.
    Size,
    /// `ticks_per_us` is not within 1 to 1000.
    Ticks,
    /// The counter would wrap within the watch, gap or watchdog time: that time
    /// in ticks must not exceed 2^30.
    TooLong,
    /// The latencies or the lead are longer than a basic cycle.
    Latency,
    /// `reference_offset` is above 127.
    ReferenceOffset,
    /// `watch` is 0.
    Watch,
    /// The matrix makes the node a potential master, and the crate is built
    /// without its feature `master`.
    Master,
}

impl core::fmt::Display for ConfigError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Size => "the node has no room for all windows or nodes of its schedule",
            Self::Ticks => "the counter must run at 1 to 1000 ticks per microsecond",
            Self::TooLong => "the watch, gap or watchdog time is too long for the counter",
            Self::Latency => "a latency or lead is longer than a basic cycle",
            Self::ReferenceOffset => "the reference trigger offset must be 0 to 127 us",
            Self::Watch => "the watch needs at least one missing reference",
            Self::Master => "a potential master needs the feature `master` of the crate",
        })
    }
}

impl core::error::Error for ConfigError {}
