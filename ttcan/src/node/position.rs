//! Where a node is in the windows of the current basic cycle.

/// The position in the table of the schedule.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Position {
    /// Index of the current entry, or of the next one while there is none.
    pub(super) cursor: u16,
    /// One past the last entry of the basic cycle.
    pub(super) end: u16,
    pub(super) window: CurrentWindow,
    /// Index of the last entry for a message of another node, if that message
    /// was not seen. A frame that is reported late may still belong to it.
    pub(super) missed: Option<u16>,
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
    /// An arbitrating window in which an event message was withdrawn: no other
    /// one is sent in it.
    ArbitratingHeld,
}

impl Position {
    /// Before the windows of a basic cycle whose entries are `cursor..end`.
    pub(super) const fn new(cursor: u16, end: u16) -> Self {
        Self {
            cursor,
            end,
            window: CurrentWindow::None,
            missed: None,
        }
    }

    /// Outside the schedule.
    pub(super) const NONE: Self = Self::new(0, 0);

    pub(super) fn in_window(&self) -> bool {
        self.window != CurrentWindow::None
    }

    pub(super) const fn in_arbitrating_window(&self) -> bool {
        matches!(
            self.window,
            CurrentWindow::Arbitrating | CurrentWindow::ArbitratingHeld
        )
    }

    /// Ends the current window.
    pub(super) fn leave(&mut self) {
        self.window = CurrentWindow::None;
        self.cursor = self.cursor.wrapping_add(1);
    }
}
