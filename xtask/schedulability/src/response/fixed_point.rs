//! Least fixed points, by which busy periods are found.

/// Steps of one search after which the analysis gives up.
const MAX_STEPS: usize = 1_000_000;
/// Responses beyond this count as none (in picoseconds: a quarter of an hour).
pub(super) const HORIZON: u64 = 1_000_000_000_000_000;

/// The least window from `start` on that `next` does not widen. `None` if `next` overflows
/// or the search takes too many steps.
pub(super) fn least_fixed_point(start: u64, next: impl Fn(u64) -> Option<u64>) -> Option<u64> {
    let mut window = start.max(1);
    for _ in 0..MAX_STEPS {
        let wider = next(window)?;
        if wider <= window {
            return Some(wider.max(start));
        }
        window = wider;
    }
    None
}

/// Steps of a search for an instant of one busy period.
const MAX_SETTLE: usize = 10_000;

/// The least instant from `start` on that is not before `next` of it. `None` if `next` gives none
/// or the search takes too many steps.
pub(super) fn settle(start: u64, next: impl Fn(u64) -> Option<u64>) -> Option<u64> {
    let mut at = start;
    for _ in 0..MAX_SETTLE {
        match next(at)? {
            later if later > at => at = later,
            _ => return Some(at),
        }
    }
    None
}
