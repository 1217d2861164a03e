//! The configuration of one node.

use crate::matrix::NodeId;
use crate::time::Micros;

/// Time from the end of a frame (the last bit of its end of frame) to the node's
/// stamp of it, in ticks. Negative if the stamp is earlier.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct StampLatency {
    /// For a received frame.
    pub receive: i32,
    /// For a frame that the node sent.
    pub transmit: i32,
}

impl StampLatency {
    /// The stamp is taken exactly at the end of the frame.
    pub const NONE: Self = Self {
        receive: 0,
        transmit: 0,
    };

    /// For bxCAN. A frame becomes valid for its receivers one bit before its end,
    /// and for its transmitter at its end (ISO 11898-1). Each stamp is taken
    /// `interrupt` ticks later. `bit` is the length of a bit in ticks.
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
    /// Ticks of the node's counter per microsecond, 1 to 1000.
    pub ticks_per_us: u32,
    /// Latency of the stamps.
    pub latency: StampLatency,
    /// How long before its time mark a transmission is requested, in ticks: the time
    /// from the timer's compare to the start of frame on an idle bus.
    pub transmit_lead: u32,
    /// Initial reference trigger offset (Initial_Ref_Offset) in microseconds, 0 to
    /// 127: how long after the end of the basic cycle this potential master sends
    /// the reference if no better-ranked master does. The offset must grow with the
    /// rank, so that the better-ranked reference is on the bus first. This one is
    /// withdrawn if it has not begun a transmit enable window after its request.
    /// `None` means 16 us times the rank.
    pub reference_offset: Option<u8>,
    /// Missing references in a row that lead to the watch trigger (Watch_Trigger)
    /// and S3, at least 1. Actuators stop at two (thesis 6.2.4.4).
    pub watch: u8,
    /// Longest time between two calls of
    /// [`Node::feed_watchdog`](crate::Node::feed_watchdog); `None` without an
    /// application watchdog.
    pub application_watchdog: Option<Micros>,
    /// Largest drift between this node's counter and global time that is corrected,
    /// in parts per million, up to 10 000.
    pub drift_limit_ppm: u16,
    /// Whether the node acts as a potential master if the matrix lists it as one.
    /// Not advisable with a clock that drifts more than the limit of other nodes.
    pub may_lead: bool,
}

impl core::hash::Hash for NodeConfig {
    /// Hashes the node only: it tells the configurations of a network apart.
    fn hash<H: core::hash::Hasher>(&self, state: &mut H) {
        self.node.hash(state);
    }
}

impl NodeConfig {
    /// The default configuration: no latency, reference trigger offset by rank,
    /// watch trigger at four missing references, no application watchdog, drift up to 200 ppm.
    pub const fn new(node: NodeId, ticks_per_us: u32) -> Self {
        Self {
            node,
            ticks_per_us,
            latency: StampLatency::NONE,
            transmit_lead: 0,
            reference_offset: None,
            watch: 4,
            application_watchdog: None,
            drift_limit_ppm: 200,
            may_lead: true,
        }
    }
}

/// Why a node cannot be made from a schedule and a configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConfigError {
    /// The node's type has less room than the schedule needs.
    Size,
    /// `ticks_per_us` is not within 1 to 1000, or so large that a bit takes 2^16 ticks or more.
    Ticks,
    /// The watch, gap or watchdog time is longer than 2^30 ticks, so that the
    /// counter could wrap within it.
    TooLong,
    /// The latencies or the lead are longer than a basic cycle.
    Latency,
    /// `reference_offset` is above 127.
    ReferenceOffset,
    /// `watch` is 0.
    Watch,
    /// `drift_limit_ppm` is above 10 000.
    Drift,
    /// The matrix makes the node a potential master, and the crate is built
    /// without its feature `master`.
    Master,
}

impl core::fmt::Display for ConfigError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Size => "the node has no room for all windows or nodes of its schedule",
            Self::Ticks => {
                "the counter must run at 1 to 1000 ticks per microsecond, and a bit take less than 2^16 ticks"
            }
            Self::TooLong => "the watch, gap or watchdog time is too long for the counter",
            Self::Latency => "a latency or lead is longer than a basic cycle",
            Self::ReferenceOffset => "the reference trigger offset must be 0 to 127 us",
            Self::Watch => "the watch needs at least one missing reference",
            Self::Drift => "the drift limit must be 0 to 10 000 ppm",
            Self::Master => "a potential master needs the feature `master` of the crate",
        })
    }
}

impl core::error::Error for ConfigError {}
