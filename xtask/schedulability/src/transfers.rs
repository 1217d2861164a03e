//! Transfers by DMA: how often each unit of a controller moves an item, and what that costs the core.
//!
//! A transfer takes the memory and the peripheral's bus from the core, for one access each. The
//! bus matrix gives them to core and DMA in turn (RM0390 2.1, RM0316 3.1), so the core waits once for
//! each side at most. Transfers therefore count like jobs that come before all tasks.

use std::collections::BTreeMap;
use std::fmt::{self, Display};

use serde::Deserialize;

use crate::arrivals::Sporadic;
use crate::response::Task;
use crate::table::{LONGEST_US, MOST, ONCE, OutOfRange};
use crate::units::MICROSECOND;

/// A stream (F4) or channel (F3) of a DMA controller, counted as in the part's manual.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(try_from = "String")]
pub struct Unit {
    /// The controller, from 1.
    pub controller: u8,
    /// Its stream, from 0, or channel, from 1.
    pub number: u8,
}

/// Not the name of a unit.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`dma` has {0:?}: \"DMA1 stream 6\" or \"DMA1 channel 7\" is the form that is accepted")]
pub struct NoUnit(String);

impl TryFrom<String> for Unit {
    type Error = NoUnit;

    fn try_from(name: String) -> Result<Self, NoUnit> {
        let words: Vec<&str> = name.split(' ').collect();
        let unit = match words.as_slice() {
            [controller, "stream" | "channel", number] => controller
                .strip_prefix("DMA")
                .and_then(|controller| controller.parse().ok())
                .zip(number.parse().ok()),
            _ => None,
        };
        let unit = unit.map(|(controller, number)| Self { controller, number });
        unit.ok_or(NoUnit(name))
    }
}

impl Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { controller, number } = self;
        write!(f, "DMA{controller}, stream or channel {number}")
    }
}

/// How often a unit moves an item.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rate {
    /// A time, in microseconds.
    pub every_us: u64,
    /// The most transfers that begin in so much time.
    #[serde(default = "one")]
    pub transfers: u64,
    /// Least time between two of them, in microseconds; `every_us` if left out.
    pub apart_us: Option<u64>,
    /// How much later than its nominal instant a transfer may be, in microseconds: the first bytes
    /// into an empty transmitter follow each other at once.
    #[serde(default)]
    pub jitter_us: u64,
}

const fn one() -> u64 {
    1
}

impl Rate {
    /// Checks its numbers.
    ///
    /// # Errors
    /// One is out of range.
    pub fn check(&self) -> Result<(), Box<OutOfRange>> {
        OutOfRange::check("every_us", self.every_us, 1, LONGEST_US)?;
        OutOfRange::check("transfers", self.transfers, 1, MOST)?;
        let apart = self.apart_us.unwrap_or(self.every_us);
        OutOfRange::check("apart_us", apart, 1, self.every_us)?;
        OutOfRange::check("jitter_us", self.jitter_us, 0, LONGEST_US)
    }

    /// The transfers as releases.
    #[must_use]
    pub const fn releases(&self) -> Sporadic {
        let apart = match self.apart_us {
            Some(apart) => apart,
            None => self.every_us,
        };
        Sporadic {
            period: apart * MICROSECOND,
            jitter: self.jitter_us * MICROSECOND,
            limit: match self.transfers {
                0 | 1 => None,
                most => Some((most, self.every_us * MICROSECOND)),
            },
        }
    }
}

/// The transfers of a node.
pub type Transfers = BTreeMap<Unit, Rate>;

/// What transfers are called among the tasks.
pub const NAME: &str = "DMA";

/// Transfers that come closer than this are counted together, in microseconds: the search for the
/// longest response takes a step at each release.
const TOGETHER_US: u64 = 500;

/// The transfers of a unit as a task that comes before all others; each keeps the core waiting for
/// `cost`. A job of it stands for so many as come within half a millisecond, as if they came at once, which
/// no transfer does later.
#[must_use]
pub fn task(rate: &Rate, cost: u64) -> Task {
    let Sporadic {
        period,
        jitter,
        limit,
    } = rate.releases();
    let most = limit.map_or(u64::MAX, |(transfers, _)| transfers);
    let together = (TOGETHER_US * MICROSECOND).div_ceil(period).min(most);
    let stream = Sporadic {
        period: together * period,
        jitter,
        limit: limit.map(|(transfers, span)| (transfers.div_ceil(together), span)),
    };
    Task {
        name: NAME.to_owned(),
        priority: u32::MAX,
        cost: together * cost,
        arrivals: stream.into(),
        // They are late for nobody.
        deadline: ONCE,
        jitter: 0,
        after: Vec::new(),
        coalesces: false,
        off_bus: false,
        blocking: 0,
        preemption: 0.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arrivals::Arrivals;
    use crate::response;

    #[test]
    fn units_have_the_names_of_the_manuals() {
        let unit = |name: &str| Unit::try_from(name.to_owned());
        let stream = Unit {
            controller: 2,
            number: 0,
        };
        assert_eq!(unit("DMA2 stream 0"), Ok(stream));
        assert_eq!(unit("DMA2 channel 0"), Ok(stream));
        for wrong in [
            "",
            "DMA2",
            "dma2 stream 0",
            "DMA2 stream",
            "DMA stream 1",
            "DMA1 stream x",
        ] {
            let error = unit(wrong).unwrap_err().to_string();
            assert!(error.contains("is the form that is accepted"), "{error}");
        }
    }

    #[test]
    fn a_burst_counts_up_to_its_length() {
        let rate = Rate {
            every_us: 5000,
            transfers: 100,
            apart_us: Some(2),
            jitter_us: 0,
        };
        let count = |us: u64| rate.releases().count(us * MICROSECOND);
        assert_eq!((count(1), count(2), count(100)), (1, 1, 50));
        assert_eq!((count(200), count(4000), count(5001)), (100, 100, 200));
        assert!(rate.check().is_ok());
        for wrong in [
            Rate {
                every_us: 0,
                ..rate
            },
            Rate {
                transfers: 0,
                ..rate
            },
            Rate {
                apart_us: Some(0),
                ..rate
            },
            Rate {
                apart_us: Some(5001),
                ..rate
            },
        ] {
            assert!(wrong.check().is_err());
        }
    }

    #[test]
    fn transfers_delay_every_task() {
        let console = Rate {
            every_us: 86,
            transfers: 1,
            apart_us: None,
            jitter_us: 86,
        };
        let other = |cost: u64| Task {
            name: "other".to_owned(),
            priority: 16,
            arrivals: Arrivals::every(1000 * MICROSECOND),
            deadline: 1000 * MICROSECOND,
            cost,
            ..task(&console, 0)
        };
        let worst = |all: &[Task]| {
            let last = response::analyse(all).pop();
            last.and_then(Result::ok).map(|response| response.worst)
        };
        // Six count together, and the next six may come before the job has ended.
        for (cost, count) in [(10, 6), (400, 6), (600, 12)] {
            let job = other(cost * MICROSECOND);
            let alone = worst(std::slice::from_ref(&job)).unwrap();
            let both = worst(&[task(&console, MICROSECOND), job]).unwrap();
            assert_eq!(both - alone, count * MICROSECOND, "{cost}");
        }
    }

    #[test]
    fn transfers_counted_together_are_no_fewer() {
        for (every_us, transfers, apart_us) in [
            (5000, 100, Some(2)),
            (5000, 2, Some(4)),
            (9, 1, None),
            (86, 1, None),
            (1000, 7, Some(30)),
        ] {
            let rate = Rate {
                every_us,
                transfers,
                apart_us,
                jitter_us: 3,
            };
            let together = task(&rate, 1);
            let exact = rate.releases();
            for window in (0..12_000).map(|us| us * MICROSECOND + 1) {
                let most = together.arrivals.count(window, 0) * together.cost;
                let all = exact.count(window);
                assert!(most >= all, "{rate:?}: {most} of {all} in {window}");
            }
        }
    }
}
