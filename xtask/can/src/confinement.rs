//! Fault confinement: the two error counters and the states they lead to (ISO 11898-1,
//! clause 12.1).

/// What a node may do on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ErrorState {
    /// It participates fully and signals errors with dominant flags.
    Active,
    /// It signals errors with recessive flags and pauses between its own frames.
    Passive,
    /// It neither sends nor acknowledges.
    BusOff,
}

/// Kind of an error on the bus, numbered as bxCAN's last error code reports it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ErrorKind {
    /// Six equal bits where bit stuffing applies.
    Stuff = 1,
    /// A dominant bit in a delimiter or in end of frame.
    Form = 2,
    /// No dominant bit in the acknowledge slot.
    Acknowledge = 3,
    /// The node sent recessive and read dominant.
    BitRecessive = 4,
    /// The node sent dominant and read recessive.
    BitDominant = 5,
    /// The CRC sequence is wrong.
    Crc = 6,
}

/// Transmit and receive error counter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ErrorCounters {
    transmit: u16,
    receive: u16,
}

impl ErrorCounters {
    /// Transmit error count, 0 to 263; above 255 the node is off the bus.
    #[must_use]
    pub const fn transmit(self) -> u16 {
        self.transmit
    }

    /// Receive error count, 0 to 255.
    #[must_use]
    pub const fn receive(self) -> u16 {
        self.receive
    }

    /// The state that follows from the counters.
    #[must_use]
    pub const fn state(self) -> ErrorState {
        if self.transmit > 255 {
            ErrorState::BusOff
        } else if self.transmit > 127 || self.receive > 127 {
            ErrorState::Passive
        } else {
            ErrorState::Active
        }
    }

    /// Whether either counter has reached the warning limit of 96.
    #[must_use]
    pub const fn warning(self) -> bool {
        self.transmit >= 96 || self.receive >= 96
    }

    /// Adds 8 to the transmit error count (rules c, d and f); does nothing in bus-off.
    pub(crate) fn transmit_error(&mut self) {
        if self.transmit < 256 {
            self.transmit += 8;
        }
    }

    /// Adds to the receive error count: 1 (rule a) or 8 (rules b, e and f); it stays at 255.
    pub(crate) fn receive_error(&mut self, amount: u16) {
        self.receive = (self.receive + amount).min(255);
    }

    /// Subtracts 1 from the transmit error count (rule g).
    pub(crate) fn transmitted(&mut self) {
        self.transmit = self.transmit.saturating_sub(1);
    }

    /// Subtracts 1 from the receive error count, or sets it to 120 if it is above 128. Rule h
    /// allows any value from 119 to 127; bxCAN takes 120 (RM0390, CAN_ESR).
    pub(crate) fn received(&mut self) {
        self.receive = if self.receive > 128 {
            120
        } else {
            self.receive.saturating_sub(1)
        };
    }

    /// Sets both counts to zero, after recovery from bus-off.
    pub(crate) fn clear(&mut self) {
        *self = Self::default();
    }
}
