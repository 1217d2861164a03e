//! Observed activations of a handler, held against the releases that the analysis counts.
//!
//! A handler is entered after the release of its job, and no later than the job's worst response
//! time. So the handlers that are entered within some span were released within that span and
//! the response time before it. If the task table allows fewer releases in so much time, it is
//! wrong.

use crate::arrivals::Arrivals;
use crate::units::{MICROSECOND, Picoseconds};

/// Numbers of activations in a row up to which each is looked at; of larger ones every eighth
/// part is.
const EACH: usize = 64;

/// How much faster than nominal the clock of a node or of the sender of its messages may be, in
/// parts of one: an RC oscillator's hundredth.
const CLOCK: u64 = 100;

/// How long after its first handler a node still takes what came while it started, in picoseconds:
/// frames in its FIFO, and the first steps of its software tasks. The analysis counts none of them.
pub const START_UP: Picoseconds = 10_000 * MICROSECOND;

/// More activations than the releases that are counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Excess {
    /// The activations.
    pub seen: u64,
    /// When the first of them was entered.
    pub begin: Picoseconds,
    /// From the first to the last of them.
    pub span: Picoseconds,
    /// The most that are counted in this time.
    pub most: u64,
}

/// The shortest run of activations that has more of them than `arrivals` allows, if there is one.
/// `entered` are the times at which the handler was entered, in order; `worst` is the worst
/// response time of its jobs.
#[must_use]
pub fn excess(arrivals: &Arrivals, worst: Picoseconds, entered: &[Picoseconds]) -> Option<Excess> {
    let mut many = 1;
    while many <= entered.len() {
        let spans = entered.windows(many);
        let (span, begin) = spans.map(|run| (run[many - 1] - run[0], run[0])).min()?;
        let window = span + span / CLOCK + worst + 1;
        let most = arrivals.count(window, 0);
        if many as u64 > most {
            return Some(Excess {
                seen: many as u64,
                begin,
                span,
                most,
            });
        }
        many += if many < EACH { 1 } else { many / 8 };
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn activations_are_held_against_the_table() {
        let arrivals = Arrivals::every(1000);
        // Each up to 300 late: the distances vary, the count does not.
        let sound: Vec<u64> = (0..500).map(|n| n * 1000 + n * 7 % 301).collect();
        assert_eq!(excess(&arrivals, 300, &sound), None);
        // One more than allowed, among the others.
        let mut extra = sound.clone();
        extra.insert(200, extra[199] + 350);
        assert_eq!(
            excess(&arrivals, 300, &extra),
            Some(Excess {
                seen: 2,
                begin: sound[199],
                span: 350,
                most: 1
            })
        );
        // Slowly too fast: found over a longer time.
        let fast: Vec<u64> = (0..500).map(|n| n * 950).collect();
        let found = excess(&arrivals, 300, &fast).unwrap();
        assert!(found.seen > found.most && found.seen > 5, "{found:?}");
        assert_eq!(excess(&arrivals, 300, &[]), None);
        assert_eq!(excess(&arrivals, 300, &[5]), None);
        // Of none even one is too many.
        let one = excess(&Arrivals::default(), 300, &[5]).unwrap();
        assert_eq!((one.seen, one.most), (1, 0));
    }
}
