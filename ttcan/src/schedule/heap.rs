//! Schedules of matrices that are known only at run time.

use std::vec;
use std::vec::Vec;

use super::{Entry, Known, Network, ScheduleView, WrongSize, compile};
use crate::matrix::SystemMatrix;

/// The compiled schedule of a matrix on the heap, for hosts that read the matrix
/// from a file.
#[derive(Clone, Debug)]
pub struct HeapSchedule {
    network: Network,
    entries: Vec<Entry>,
    known: Vec<Known>,
    windows_of: Vec<u16>,
}

impl HeapSchedule {
    /// Compiles `matrix`.
    ///
    /// # Errors
    /// The matrix has 65 535 entries or more.
    pub fn new(matrix: &SystemMatrix) -> Result<Self, WrongSize> {
        let count = matrix.entry_count();
        if count >= usize::from(u16::MAX) {
            return Err(WrongSize);
        }
        let mut schedule = Self {
            network: compile::network(matrix),
            entries: vec![compile::NO_ENTRY; count],
            known: vec![compile::NO_MESSAGE; matrix.id_count()],
            windows_of: vec![0; matrix.node_count()],
        };
        compile::entries(matrix, &mut schedule.network, &mut schedule.entries);
        compile::known(
            matrix,
            &mut schedule.network,
            &mut schedule.known,
            &mut schedule.windows_of,
        );
        Ok(schedule)
    }

    /// A reference to the schedule, for nodes.
    pub fn view(&self) -> ScheduleView<'_> {
        ScheduleView {
            network: &self.network,
            entries: &self.entries,
            known: &self.known,
            windows_of: &self.windows_of,
        }
    }
}
