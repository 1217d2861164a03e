//! Under which time master the actuators may move (thesis 6.2.4.4).
//!
//! The first time master of a vehicle is the node that its operator relies on: holding it in
//! reset stops the motors. A backup master then keeps the schedule, so that the nodes go on to
//! report, but it does not drive the vehicle unless the manifest says so.
//!
//! The node of each actuator applies the rule itself, to the references that it receives. So a
//! controller that goes on to send commands changes nothing.

use ttcan::Micros;

use crate::design;

/// What the motors do while a backup master leads the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BackupMaster {
    /// They stop.
    Stop,
    /// They obey commands as under the first time master.
    Drive,
}

/// The rule of a vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rule {
    backup: BackupMaster,
    basic_cycle: Micros,
}

impl Rule {
    /// The rule for a network with this basic cycle: one reference of the first master may be
    /// missing, but not two in a row.
    pub const fn new(backup: BackupMaster, basic_cycle: Micros) -> Self {
        Self {
            backup,
            basic_cycle,
        }
    }

    /// Time from a reference of the first master until the one `cycles` later is overdue, ticks.
    const fn overdue(&self, cycles: u32, ticks_per_us: u32) -> u32 {
        let cycles = self.basic_cycle.ticks().saturating_mul(cycles);
        let late = design::REFERENCE_ARRIVAL.ticks();
        cycles.saturating_add(late).saturating_mul(ticks_per_us)
    }
}

/// What a node knows about the time master that leads the bus.
#[derive(Clone, Copy, Debug)]
pub struct Leader {
    backup: BackupMaster,
    /// Longest age of a reference of the first master when a backup begins a cycle in its place,
    /// ticks. A backup that is later than that would move the next reference beyond `patience`.
    backup_by: u32,
    /// Time from a reference of the first master until the second after it is overdue, ticks.
    patience: u32,
    /// Start of the last reference of the first master; `None` if there is no recent one.
    first: Option<u32>,
}

impl Leader {
    /// No reference was seen yet.
    pub const fn new(rule: Rule, ticks_per_us: u32) -> Self {
        Self {
            backup: rule.backup,
            backup_by: rule.overdue(1, ticks_per_us),
            patience: rule.overdue(network::MISSED_PERIODS, ticks_per_us),
            first: None,
        }
    }

    /// A basic cycle began at `mark` with a reference of the master of this rank.
    pub const fn begin(&mut self, rank: u8, mark: u32) {
        match self.first {
            _ if rank == 0 => self.first = Some(mark),
            Some(first) if mark.wrapping_sub(first) > self.backup_by => self.first = None,
            _ => {}
        }
    }

    /// The node left the bus: what it saw before says nothing about now.
    pub const fn forget(&mut self) {
        self.first = None;
    }

    /// Whether actuators may move at `now`. A node that receives no reference at all also stops
    /// by [`ttcan::Node::is_alive`].
    pub const fn permits(&self, now: u32) -> bool {
        match (self.backup, self.first) {
            (BackupMaster::Drive, _) => true,
            (BackupMaster::Stop, Some(first)) => now.wrapping_sub(first) < self.patience,
            (BackupMaster::Stop, None) => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PER_US: u32 = 18;
    const CYCLE: u32 = 100_000 * PER_US;
    /// The counter wraps during the tests.
    const BEGIN: u32 = u32::MAX - CYCLE;

    fn leader(backup: BackupMaster) -> Leader {
        Leader::new(Rule::new(backup, Micros::millis(100)), PER_US)
    }

    /// What the rule says 7 ms after the last of these references, one in each cycle.
    fn after(leader: &mut Leader, ranks: &[Option<u8>]) -> bool {
        let mut now = BEGIN;
        for (cycle, rank) in (0u32..).zip(ranks) {
            now = BEGIN.wrapping_add(cycle * CYCLE);
            if let Some(rank) = rank {
                leader.begin(*rank, now);
            }
        }
        leader.permits(now.wrapping_add(7000 * PER_US))
    }

    #[test]
    fn one_missing_reference_of_the_first_master_is_tolerated_the_second_stops() {
        let (first, backup) = (Some(0), Some(1));
        for (ranks, permitted) in [
            (&[] as &[_], false),
            (&[backup], false),
            (&[backup, backup, backup], false),
            (&[first], true),
            (&[first, backup], true),
            (&[first, backup, first, backup], true),
            (&[first, None], true),
            (&[first, None, None], false),
            (&[first, backup, backup], false),
            (&[first, None, backup], false),
            (&[first, backup, backup, first], true),
            (&[backup, first], true),
        ] {
            let mut leader = leader(BackupMaster::Stop);
            assert_eq!(after(&mut leader, ranks), permitted, "{ranks:?}");
        }
    }

    #[test]
    fn the_permission_ends_two_cycles_after_the_last_reference_whatever_a_backup_sends() {
        let mut leader = leader(BackupMaster::Stop);
        leader.begin(0, BEGIN);
        leader.begin(1, BEGIN.wrapping_add(CYCLE));
        let end = BEGIN.wrapping_add(2 * CYCLE + 700 * PER_US);
        assert!(leader.permits(end.wrapping_sub(1)));
        assert!(!leader.permits(end));
        // A backup that begins late shifts the cycles: it is not tolerated at all.
        leader.begin(0, BEGIN);
        let late = BEGIN.wrapping_add(CYCLE / 2 * 3);
        leader.begin(1, late);
        assert!(!leader.permits(late));
    }

    #[test]
    fn a_node_that_left_the_bus_waits_for_the_first_master() {
        let mut leader = leader(BackupMaster::Stop);
        assert!(after(&mut leader, &[Some(0)]));
        leader.forget();
        assert!(!leader.permits(BEGIN));
        assert!(!after(&mut leader, &[Some(1)]));
        assert!(after(&mut leader, &[Some(0)]));
    }

    #[test]
    fn a_vehicle_that_drives_under_a_backup_does_so_under_any_master() {
        for ranks in [&[Some(1), Some(1), Some(1)], &[Some(0), Some(3), Some(3)]] {
            let mut leader = leader(BackupMaster::Drive);
            assert!(after(&mut leader, ranks));
        }
    }
}
