//! Where a node is in the windows of the current basic cycle.

/// The position in the table of the schedule.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Position {
    /// Index of the current entry, or of the next one while there is none.
    pub(super) cursor: u16,
    /// One past the last entry of the basic cycle.
    pub(super) end: u16,
    pub(super) window: CurrentWindow,
    /// What an arbitrating window of this basic cycle begins as.
    pub(super) arbitrating: CurrentWindow,
    /// Whether the entry before the current one was for a message of another node that
    /// was not seen. A frame that is reported late may still belong to it.
    pub(super) missed: bool,
}

/// The window that has begun and not ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum CurrentWindow {
    /// Between two windows, or outside the schedule.
    None,
    /// An exclusive window whose message was not received yet.
    Exclusive,
    /// An exclusive window whose message was received.
    ExclusiveSeen,
    /// An arbitrating window.
    Arbitrating,
    /// An arbitrating window in which this node sends no event message: it has withdrawn one in it, or
    /// the basic cycle is none of theirs.
    ArbitratingHeld,
}

impl Position {
    /// Before the windows of a basic cycle whose entries are `cursor..end`. `events` says whether this
    /// node may send its event messages in it.
    pub(super) const fn new(cursor: u16, end: u16, events: bool) -> Self {
        Self {
            cursor,
            end,
            window: CurrentWindow::None,
            arbitrating: if events {
                CurrentWindow::Arbitrating
            } else {
                CurrentWindow::ArbitratingHeld
            },
            missed: false,
        }
    }

    /// Outside the schedule.
    pub(super) const NONE: Self = Self {
        cursor: 0,
        end: 0,
        window: CurrentWindow::None,
        // There is none to begin.
        arbitrating: CurrentWindow::None,
        missed: false,
    };

    pub(super) fn in_window(&self) -> bool {
        self.window != CurrentWindow::None
    }

    pub(super) const fn in_arbitrating_window(&self) -> bool {
        matches!(
            self.window,
            CurrentWindow::Arbitrating | CurrentWindow::ArbitratingHeld
        )
    }

    /// Ends the current window. `missed` tells that it was for a message of another node that was not
    /// seen.
    pub(super) fn leave(&mut self, missed: bool) {
        self.window = CurrentWindow::None;
        self.missed = missed;
        self.cursor = self.cursor.wrapping_add(1);
    }
}
