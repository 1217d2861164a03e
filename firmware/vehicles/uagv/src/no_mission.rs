//! No missions: the controller follows the line between the waypoints.

/// Nothing to plan.
pub type Plan = ();
