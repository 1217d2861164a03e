//! When the command of an actuator node ends: it expires, or the bus is gone.
//!
//! Each end pends the actuator's task, whose releases the task table bounds. So an end is told once, and
//! behind it no command is obeyed for [`END_PAUSE`]: a bus that is gone, or that comes and goes, releases
//! no more work than one that works.

use crate::design::END_PAUSE;

/// Follows the command that the application may have.
#[derive(Clone, Copy, Debug)]
pub struct Ends {
    /// A command was handed to the application, and nothing has ended it since.
    commanded: bool,
    /// When the last command ended, until the pause behind it is over.
    ended: Option<u32>,
    /// [`END_PAUSE`] in ticks of the time base.
    pause: u32,
}

impl Ends {
    /// Before the first command, on a time base with this rate.
    pub const fn new(ticks_per_us: u32) -> Self {
        Self {
            commanded: false,
            ended: None,
            pause: END_PAUSE.ticks().saturating_mul(ticks_per_us),
        }
    }

    /// Whether the application's command ends at `now`, because it may not stay in force (`over`). True
    /// once for a command.
    pub const fn take(&mut self, over: bool, now: u32) -> bool {
        let ends = self.commanded && over;
        if ends {
            self.commanded = false;
            self.ended = Some(now);
        }
        ends
    }

    /// Whether the application may have a command from `now` on. `allowed` says that the bus allows one,
    /// `new` that it brings one.
    pub const fn hand_over(&mut self, allowed: bool, new: bool, now: u32) -> bool {
        if let Some(ended) = self.ended
            && now.wrapping_sub(ended) >= self.pause
        {
            self.ended = None;
        }
        let may_have = allowed && self.ended.is_none();
        self.commanded = may_have && (self.commanded || new);
        may_have
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;

    const PER_US: u32 = 18;
    const PAUSE: u32 = END_PAUSE.ticks() * PER_US;
    /// The counter wraps during the tests.
    const BEGIN: u32 = u32::MAX - PAUSE / 2;

    #[test]
    fn a_command_ends_once() {
        let mut ends = Ends::new(PER_US);
        assert!(!ends.take(true, BEGIN), "there is no command yet");
        assert!(ends.hand_over(true, true, BEGIN) && !ends.take(false, BEGIN));
        assert!(ends.take(true, BEGIN) && !ends.take(true, BEGIN));
    }

    #[test]
    fn behind_an_end_there_is_no_command_for_a_pause() {
        let mut ends = Ends::new(PER_US);
        ends.hand_over(true, true, BEGIN);
        assert!(ends.take(true, BEGIN));
        assert!(!ends.hand_over(true, true, BEGIN.wrapping_add(PAUSE - 1)));
        assert!(!ends.take(true, BEGIN.wrapping_add(PAUSE - 1)));
        assert!(ends.hand_over(true, true, BEGIN.wrapping_add(PAUSE)));
        assert!(ends.take(true, BEGIN.wrapping_add(PAUSE)));
    }

    proptest! {
        /// Whatever the bus does, two ends are a pause apart; and the application never keeps a
        /// command that the bus does not allow: its end is told, or the next job is.
        #[test]
        fn ends_are_apart_and_none_is_missed(
            steps in prop::collection::vec((1..PAUSE, any::<(bool, bool, bool)>()), 1..200),
        ) {
            let mut ends = Ends::new(PER_US);
            let (mut now, mut last, mut has) = (BEGIN, None::<u32>, false);
            for (later, (allowed, new, job)) in steps {
                now = now.wrapping_add(later);
                if job {
                    let may_have = ends.hand_over(allowed, new, now);
                    prop_assert!(!may_have || allowed);
                    has = may_have && (has || new);
                } else if ends.take(!allowed, now) {
                    prop_assert!(last.is_none_or(|last| now.wrapping_sub(last) >= PAUSE));
                    prop_assert!(has, "nothing to end");
                    (last, has) = (Some(now), false);
                } else {
                    prop_assert!(!has || allowed, "a command outlives the bus");
                }
            }
        }
    }
}
