//! The crate's optional features as constants. Code of a feature that is off is
//! still compiled and checked; the optimiser then removes it as unreachable.

/// Counters of everything that happens.
pub(crate) const COUNTERS: bool = cfg!(feature = "counters");
/// Sending of event messages and late messages.
pub(crate) const EVENTS: bool = cfg!(feature = "events");
/// Event-synchronised cycles (gaps).
pub(crate) const GAPS: bool = cfg!(feature = "gaps");
/// Level 2: global time and rate correction.
pub(crate) const GLOBAL_TIME: bool = cfg!(feature = "global-time");
/// Event messages with several identifiers.
pub(crate) const MASKS: bool = cfg!(feature = "masks");
/// The role of a potential time master.
pub(crate) const MASTER: bool = cfg!(feature = "master");
/// Health of the other nodes.
pub(crate) const PEERS: bool = cfg!(feature = "peers");
