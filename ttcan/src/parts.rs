//! The optional parts of a node, as constants: what is left out is still compiled
//! and checked, and then removed as code that is never reached.

/// Counters of what happened.
pub(crate) const COUNTERS: bool = cfg!(feature = "counters");
/// Event messages and late messages.
pub(crate) const EVENTS: bool = cfg!(feature = "events");
/// Event-synchronised cycles.
pub(crate) const GAPS: bool = cfg!(feature = "gaps");
/// Global time and rate correction.
pub(crate) const GLOBAL_TIME: bool = cfg!(feature = "global-time");
/// The role of a potential time master.
pub(crate) const MASTER: bool = cfg!(feature = "master");
/// Failure classes of other nodes.
pub(crate) const PEERS: bool = cfg!(feature = "peers");
