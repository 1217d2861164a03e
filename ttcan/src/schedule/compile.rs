//! Compiles a checked matrix to the tables of a schedule.

use super::{Entry, Known, Network, Role};
use crate::features::MASKS;
use crate::id::Id;
use crate::matrix::{NodeId, REFERENCE_OFFSET_LIMIT, SystemMatrix, WindowKind};

pub(super) const NO_ENTRY: Entry = Entry {
    start: 0,
    end: 0,
    window: 0,
    role: Role::Arbitrating,
};

pub(super) const NO_MESSAGE: Known = Known {
    id: Id::constant::<0>(),
    #[cfg(feature = "masks")]
    mask: Id::MAX_STANDARD as u32,
    sender: NodeId(0),
    len: 0,
    is_event: false,
    retry_late: false,
    window: 0,
    cycles: (1, 0),
};

/// The parameters of the schedule.
pub(super) const fn network(matrix: &SystemMatrix) -> Network {
    let config = matrix.config();
    let uncertainty = config.sync_uncertainty.ticks();
    let reference_length = matrix.reference_micros();
    let early = REFERENCE_OFFSET_LIMIT + uncertainty + reference_length;
    let mut masters = [None; 8];
    let mut rank = 0;
    while rank < config.masters.len() && rank < 8 {
        masters[rank] = Some(config.masters[rank]);
        rank += 1;
    }
    Network {
        bit: bit_length(config.bit_rate),
        basic_cycle: config.basic_cycle.ticks(),
        cycles: config.cycles,
        reference: config.reference,
        reference_bits: config.reference.all_but_rank(),
        reference_format: config.reference_format,
        masters,
        master_count: rank as u8,
        transmit_enable: matrix.bits_to_micros(config.transmit_enable_bits as u32),
        uncertainty,
        longest_gap: config.longest_gap.ticks(),
        reference_length,
        reference_early: config.basic_cycle.ticks().saturating_sub(early),
        reference_late: early + reference_length,
        tells_time: config.reference_format.tells_time(),
        window_count: config.windows.len(),
        exclusive_count: 0,
        #[cfg(feature = "masks")]
        one_id: 0,
        first: [0; 65],
        distinct_mask: matrix.distinct_cycles() - 1,
    }
}

/// Length of a bit in 2^-16 us. The bit rate of a checked matrix is not 0.
const fn bit_length(bit_rate: u32) -> u32 {
    let micros = 1_000_000u64 << 16;
    let rate = if bit_rate == 0 { 1 } else { bit_rate as u64 };
    let length = (micros + rate / 2) / rate;
    if length > u32::MAX as u64 {
        u32::MAX
    } else {
        length as u32
    }
}

/// Fills `entries`, whose length is the matrix's
/// [`entry_count`](SystemMatrix::entry_count), and [`Network::first`].
pub(super) const fn entries(matrix: &SystemMatrix, network: &mut Network, entries: &mut [Entry]) {
    let windows = matrix.config().windows;
    let distinct = matrix.distinct_cycles();
    let mut next = 0;
    let mut cycle = 0;
    while cycle < distinct {
        network.first[cycle as usize] = next as u16;
        let mut merging = false;
        let mut at = 0;
        while at < windows.len() {
            let window = &windows[at];
            if window.is_in(cycle) {
                let role = match window.kind {
                    WindowKind::Exclusive {
                        id,
                        len,
                        sender,
                        retry_late,
                    } => Some(Role::Exclusive {
                        id,
                        len,
                        sender,
                        retry_late,
                    }),
                    WindowKind::Arbitrating { merged_with_next } => {
                        let continued = merging;
                        merging = merged_with_next;
                        if continued {
                            entries[next - 1].end = window.end();
                            None
                        } else {
                            Some(Role::Arbitrating)
                        }
                    }
                    WindowKind::Free => None,
                };
                if let Some(role) = role {
                    entries[next] = Entry {
                        start: window.start.ticks(),
                        end: window.end(),
                        window: at as u16,
                        role,
                    };
                    next += 1;
                }
            }
            at += 1;
        }
        cycle += 1;
    }
    network.first[distinct as usize] = next as u16;
}

/// Fills `known`, whose length is the matrix's [`id_count`](SystemMatrix::id_count),
/// sorted by identifier, and `windows_of`, which has one element for each node.
pub(super) const fn known(
    matrix: &SystemMatrix,
    network: &mut Network,
    known: &mut [Known],
    windows_of: &mut [u16],
) {
    let config = matrix.config();
    let mut count = 0;
    let mut at = 0;
    while at < config.windows.len() {
        let window = &config.windows[at];
        if let WindowKind::Exclusive {
            id,
            len,
            sender,
            retry_late,
        } = window.kind
        {
            let times = (config.cycles / window.repeat) as u16;
            let total = &mut windows_of[sender.0 as usize];
            *total = total.saturating_add(times);
            let message = Known {
                id,
                #[cfg(feature = "masks")]
                mask: id.all_bits(),
                sender,
                len,
                is_event: false,
                retry_late,
                window: at as u16,
                cycles: (1, 0),
            };
            insert(known, count, message);
            count += 1;
        }
        at += 1;
    }
    network.exclusive_count = count as u16;
    // Those with several identifiers stand behind the others.
    let mut masked = 0;
    at = 0;
    while at < config.events.len() {
        let event = &config.events[at];
        let message = Known {
            id: event.id,
            #[cfg(feature = "masks")]
            mask: event.mask,
            sender: event.sender,
            len: event.len,
            is_event: true,
            cycles: (event.repeat, event.offset),
            ..NO_MESSAGE
        };
        if !MASKS || event.has_one_id() {
            insert(known, count, message);
            count += 1;
        } else {
            masked += 1;
            known[known.len() - masked] = message;
        }
        at += 1;
    }
    #[cfg(feature = "masks")]
    {
        network.one_id = count;
    }
}

/// Inserts a message into the first `count` ones, which are sorted by identifier.
const fn insert(known: &mut [Known], count: usize, message: Known) {
    let mut at = count;
    while at > 0 && known[at - 1].id.priority() > message.id.priority() {
        known[at] = known[at - 1];
        at -= 1;
    }
    known[at] = message;
}
