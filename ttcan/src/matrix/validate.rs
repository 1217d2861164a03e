//! The checks of a matrix.

use super::{
    Event, LONGEST_TRANSMIT_ENABLE, MatrixConfig, MatrixError, Problem, Window, WindowKind,
    bits_to_micros,
};
use crate::id::Id;
use crate::length;
use crate::time::Micros;

/// Range of the reference trigger offset in network time units (ISO 11898-4):
/// a master may send its reference this much early.
pub(crate) const REFERENCE_OFFSET_LIMIT: u32 = 127;

const LONGEST_CYCLE: u32 = 10_000_000;

type Checked<'a> = Result<(), MatrixError<'a>>;

pub(super) const fn check<'a>(config: &MatrixConfig<'a>) -> Checked<'a> {
    if let Err(error) = check_network(config) {
        return Err(error);
    }
    let mut at = 0;
    while at < config.windows.len() {
        if let Err(error) = check_window(config, at) {
            return Err(error);
        }
        at += 1;
    }
    if let Err(error) = check_cycles(config) {
        return Err(error);
    }
    check_ids(config)
}

const fn network<'a>(problem: Problem) -> Checked<'a> {
    Err(MatrixError {
        name: None,
        other: None,
        problem,
    })
}

const fn refuse<'a>(window: &Window<'a>, problem: Problem) -> Checked<'a> {
    Err(MatrixError {
        name: Some(window.name),
        other: None,
        problem,
    })
}

const fn conflict<'a>(name: &'a str, other: &'a str, problem: Problem) -> Checked<'a> {
    Err(MatrixError {
        name: Some(name),
        other: Some(other),
        problem,
    })
}

const fn reference_micros(config: &MatrixConfig) -> u32 {
    let bits = length::worst_case_bits(config.reference, config.reference_format.longest());
    bits_to_micros(bits + length::INTERFRAME_BITS, config.bit_rate)
}

const fn check_network<'a>(config: &MatrixConfig<'a>) -> Checked<'a> {
    if config.bit_rate == 0 || config.bit_rate > 1_000_000 {
        return network(Problem::BitRate {
            bit_rate: config.bit_rate,
        });
    }
    if !config.cycles.is_power_of_two() || config.cycles > 64 {
        return network(Problem::CycleCount {
            cycles: config.cycles as u32,
        });
    }
    if config.transmit_enable_bits == 0 || config.transmit_enable_bits > LONGEST_TRANSMIT_ENABLE {
        return network(Problem::TransmitEnable {
            bits: config.transmit_enable_bits as u32,
        });
    }
    if !config.reference_format.is_valid() {
        return network(Problem::ReferenceFormat);
    }
    let micros = config.basic_cycle.ticks();
    if micros > LONGEST_CYCLE
        || micros / 2 < reference_micros(config)
        || micros / 4 < config.sync_uncertainty.ticks()
    {
        return network(Problem::BasicCycle { micros });
    }
    let gap = config.longest_gap.ticks();
    if gap != 0 && gap < micros {
        return network(Problem::Gap { micros: gap });
    }
    if config.windows.len() >= u16::MAX as usize || config.events.len() >= u16::MAX as usize {
        return network(Problem::TooLarge);
    }
    let room = 8 - (config.reference.raw() & 7);
    let masters = config.masters.len();
    if masters == 0 || masters > room as usize {
        return network(Problem::MasterCount {
            masters: masters as u32,
            room,
        });
    }
    let mut at = 0;
    while at < masters {
        let node = config.masters[at].0;
        let mut before = 0;
        while before < at {
            if config.masters[before].0 == node {
                return network(Problem::MasterTwice { node: node as u32 });
            }
            before += 1;
        }
        if node == u16::MAX {
            return network(Problem::TooLarge);
        }
        at += 1;
    }
    Ok(())
}

const fn check_window<'a>(config: &MatrixConfig<'a>, at: usize) -> Checked<'a> {
    let window = &config.windows[at];
    if !window.repeat.is_power_of_two() || window.repeat > config.cycles {
        return refuse(
            window,
            Problem::RepeatFactor {
                repeat: window.repeat as u32,
            },
        );
    }
    if window.offset >= window.repeat {
        return refuse(
            window,
            Problem::CycleOffset {
                offset: window.offset as u32,
            },
        );
    }
    if at > 0 {
        let before = &config.windows[at - 1];
        if window.start.ticks() < before.start.ticks() {
            return conflict(window.name, before.name, Problem::OutOfOrder);
        }
    }
    let uncertainty = config.sync_uncertainty.ticks();
    let earliest = reference_micros(config).saturating_add(uncertainty);
    if window.start.ticks() < earliest {
        return refuse(window, Problem::InReference { earliest });
    }
    // With several masters, a reference may be early by the reference trigger
    // offset. A node's clock may be wrong by the uncertainty.
    let early = if config.masters.len() > 1 {
        REFERENCE_OFFSET_LIMIT
    } else {
        0
    };
    let latest = config
        .basic_cycle
        .ticks()
        .saturating_sub(uncertainty + early);
    if window.end() > latest {
        return refuse(window, Problem::PastEnd { latest });
    }
    match window.kind {
        WindowKind::Exclusive {
            id, len, sender, ..
        } => {
            if sender.0 == u16::MAX {
                return network(Problem::TooLarge);
            }
            if len > 8 {
                return refuse(window, Problem::Length { len: len as u32 });
            }
            fits(config, window, id, len)
        }
        // A window in which not even the shortest frame fits is of no use.
        WindowKind::Arbitrating { .. } => fits(config, window, Id::constant::<0>(), 0),
        WindowKind::Free => Ok(()),
    }
}

/// Checks that a message fits in its window. The clocks of two nodes differ by at
/// most the uncertainty. The sender of this window may therefore begin that much
/// later, as seen by the sender of the next window, so the uncertainty is added
/// once.
const fn fits<'a>(config: &MatrixConfig, window: &Window<'a>, id: Id, len: u8) -> Checked<'a> {
    let bits = length::worst_case_bits(id, len)
        + length::INTERFRAME_BITS
        + config.transmit_enable_bits as u32;
    let needed = needed_micros(bits, config.bit_rate, config.sync_uncertainty);
    if needed > window.length.ticks() {
        return refuse(
            window,
            Problem::DoesNotFit {
                needed,
                length: window.length.ticks(),
            },
        );
    }
    Ok(())
}

pub(crate) const fn needed_micros(bits: u32, bit_rate: u32, uncertainty: Micros) -> u32 {
    bits_to_micros(bits, bit_rate).saturating_add(uncertainty.ticks())
}

/// Checks overlaps and merged windows in each basic cycle. The windows are sorted by
/// start, so each is compared only with the one before in the same basic cycle.
const fn check_cycles<'a>(config: &MatrixConfig<'a>) -> Checked<'a> {
    let mut cycle = 0;
    while cycle < config.cycles {
        let mut before: Option<&Window<'a>> = None;
        let mut at = 0;
        while at < config.windows.len() {
            let window = &config.windows[at];
            if window.is_in(cycle) {
                if let Some(before) = before {
                    if window.start.ticks() < before.end() {
                        return conflict(
                            window.name,
                            before.name,
                            Problem::Overlap {
                                cycle: cycle as u32,
                            },
                        );
                    }
                    if is_merged(before) && !continues(before, window) {
                        return refuse(before, Problem::NotClosed);
                    }
                }
                before = Some(window);
            }
            at += 1;
        }
        if let Some(last) = before
            && is_merged(last)
        {
            return refuse(last, Problem::NotClosed);
        }
        cycle += 1;
    }
    Ok(())
}

const fn is_merged(window: &Window) -> bool {
    matches!(
        window.kind,
        WindowKind::Arbitrating {
            merged_with_next: true
        }
    )
}

const fn continues(before: &Window, window: &Window) -> bool {
    matches!(window.kind, WindowKind::Arbitrating { .. }) && window.start.ticks() == before.end()
}

/// Checks that each identifier has one sender, one length and one kind.
const fn check_ids<'a>(config: &MatrixConfig<'a>) -> Checked<'a> {
    let mut at = 0;
    while at < config.windows.len() {
        if let WindowKind::Exclusive {
            id, len, sender, ..
        } = config.windows[at].kind
        {
            if is_reference(config, id) {
                return refuse(&config.windows[at], Problem::ReferenceId);
            }
            let mut before = 0;
            while before < at {
                if let WindowKind::Exclusive {
                    id: other,
                    len: other_len,
                    sender: other_sender,
                    ..
                } = config.windows[before].kind
                    && id.equals(other)
                    && (sender.0 != other_sender.0 || len != other_len)
                {
                    let other = config.windows[before].name;
                    return conflict(config.windows[at].name, other, Problem::TwoRoles);
                }
                before += 1;
            }
        }
        at += 1;
    }
    let mut at = 0;
    while at < config.events.len() {
        if let Err(error) = check_event(config, at) {
            return Err(error);
        }
        at += 1;
    }
    Ok(())
}

const fn check_event<'a>(config: &MatrixConfig<'a>, at: usize) -> Checked<'a> {
    let event: &Event<'a> = &config.events[at];
    let problem = if event.sender.0 == u16::MAX {
        Some(Problem::TooLarge)
    } else if event.len > 8 {
        Some(Problem::Length {
            len: event.len as u32,
        })
    } else if event.id.agrees(config.reference, event.mask & !0b111) {
        Some(Problem::ReferenceId)
    } else if !event.repeat.is_power_of_two() || event.repeat > config.cycles {
        Some(Problem::RepeatFactor {
            repeat: event.repeat as u32,
        })
    } else if event.offset >= event.repeat {
        Some(Problem::CycleOffset {
            offset: event.offset as u32,
        })
    } else {
        None
    };
    if let Some(problem) = problem {
        return Err(MatrixError {
            name: Some(event.name),
            other: None,
            problem,
        });
    }
    let mut window = 0;
    while window < config.windows.len() {
        if let WindowKind::Exclusive { id, .. } = config.windows[window].kind
            && event.id.agrees(id, event.mask)
        {
            return conflict(event.name, config.windows[window].name, Problem::TwoRoles);
        }
        window += 1;
    }
    let mut before = 0;
    while before < at {
        let other = &config.events[before];
        if event.id.agrees(other.id, event.mask & other.mask) {
            return conflict(event.name, other.name, Problem::TwoRoles);
        }
        if other.sender.0 == event.sender.0
            && (other.repeat != event.repeat || other.offset != event.offset)
        {
            return conflict(event.name, other.name, Problem::EventCycles);
        }
        before += 1;
    }
    Ok(())
}

/// Whether `id` is an identifier of the reference message: it differs at most in the
/// three lowest bits.
const fn is_reference(config: &MatrixConfig, id: Id) -> bool {
    id.is_extended() == config.reference.is_extended()
        && id.raw() >> 3 == config.reference.raw() >> 3
}
