//! Why a matrix is refused, as a sentence that can be made in a `const`.

/// What is wrong with a matrix. Times are in microseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Problem {
    /// The number of basic cycles is not 1, 2, 4, 8, 16, 32 or 64.
    CycleCount {
        /// The number given.
        cycles: u32,
    },
    /// The bit rate is 0 or above 1 Mbit/s.
    BitRate {
        /// The bit rate given, in bit/s.
        bit_rate: u32,
    },
    /// The basic cycle is shorter than two reference messages or longer than
    /// 10 s.
    BasicCycle {
        /// Its length.
        micros: u32,
    },
    /// The longest gap is neither 0 nor at least a basic cycle.
    Gap {
        /// Its length.
        micros: u32,
    },
    /// The transmit enable window is not 1 to [`LONGEST_TRANSMIT_ENABLE`](super::LONGEST_TRANSMIT_ENABLE)
    /// bit times.
    TransmitEnable {
        /// The number of bit times given.
        bits: u32,
    },
    /// There is no potential master, or more of them than the lowest three bits of
    /// the reference identifier leave room for.
    MasterCount {
        /// Number of masters given.
        masters: u32,
        /// Number that the reference identifier leaves room for.
        room: u32,
    },
    /// A node has two ranks among the masters.
    MasterTwice {
        /// The node.
        node: u32,
    },
    /// The reference format's fields overlap or pass the end of the frame.
    ReferenceFormat,
    /// There are more than 65 534 nodes, windows or event messages.
    TooLarge,
    /// The repeat factor is not a power of two, or exceeds the number of basic
    /// cycles.
    RepeatFactor {
        /// The factor given.
        repeat: u32,
    },
    /// The offset is not below the repeat factor.
    CycleOffset {
        /// The offset given.
        offset: u32,
    },
    /// The window begins before the previous one in the list.
    OutOfOrder,
    /// The window begins before the previous one of the same basic cycle ends.
    Overlap {
        /// The first basic cycle in which it does.
        cycle: u32,
    },
    /// The window begins while the reference message may be on the bus.
    InReference {
        /// The earliest possible start, as a cycle time.
        earliest: u32,
    },
    /// The window ends when the next reference message may already begin.
    PastEnd {
        /// The latest possible end, as a cycle time.
        latest: u32,
    },
    /// The window is shorter than the longest frame, the transmit enable window and
    /// the uncertainty together.
    DoesNotFit {
        /// The time needed.
        needed: u32,
        /// The window's length.
        length: u32,
    },
    /// The message is longer than 8 bytes.
    Length {
        /// Number of bytes given.
        len: u32,
    },
    /// A merged window is not directly followed by another arbitrating window in
    /// each of its basic cycles.
    NotClosed,
    /// The identifier is one of the reference message.
    ReferenceId,
    /// The identifier has two senders or two lengths, or belongs to a scheduled
    /// message and an event message.
    TwoRoles,
    /// Two event messages of a node have different basic cycles.
    EventCycles,
}

/// A matrix was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MatrixError<'a> {
    /// The window or event message with the problem, if it is in one.
    pub name: Option<&'a str>,
    /// The window or event message that it conflicts with, if there is one.
    pub other: Option<&'a str>,
    /// What is wrong.
    pub problem: Problem,
}

/// The text of a [`MatrixError`], at most 255 bytes.
#[derive(Clone, Copy)]
pub struct Message {
    bytes: [u8; 255],
    len: usize,
}

impl Message {
    /// The text.
    pub const fn as_str(&self) -> &str {
        let (text, _) = self.bytes.split_at(self.len);
        match core::str::from_utf8(text) {
            Ok(text) => text,
            // A name was cut off inside a character.
            Err(_) => "the system matrix is not valid",
        }
    }

    const fn text(&mut self, text: &str) -> &mut Self {
        let bytes = text.as_bytes();
        let mut at = 0;
        while at < bytes.len() && self.len < self.bytes.len() {
            self.bytes[self.len] = bytes[at];
            self.len += 1;
            at += 1;
        }
        self
    }

    /// A number between two texts.
    const fn phrase(&mut self, before: &str, number: u32, after: &str) -> &mut Self {
        self.text(before).number(number).text(after)
    }

    const fn number(&mut self, number: u32) -> &mut Self {
        let mut unit = 1;
        while number / unit >= 10 {
            unit *= 10;
        }
        while unit > 0 {
            if self.len < self.bytes.len() {
                self.bytes[self.len] = b'0' + (number / unit % 10) as u8;
                self.len += 1;
            }
            unit /= 10;
        }
        self
    }
}

impl MatrixError<'_> {
    /// The error as one sentence.
    pub const fn message(&self) -> Message {
        let mut message = Message {
            bytes: [0; 255],
            len: 0,
        };
        match self.name {
            Some(name) => message.text("window `").text(name).text("`: "),
            None => message.text("system matrix: "),
        };
        let other = match self.other {
            Some(other) => other,
            None => "another",
        };
        self.problem.describe(&mut message, other);
        message
    }
}

impl Problem {
    /// Writes what is wrong; `other` is the window that it conflicts with.
    const fn describe(self, message: &mut Message, other: &str) {
        match self {
            Problem::CycleCount { cycles } => message
                .number(cycles)
                .text(" basic cycles, but the count must be 1, 2, 4, 8, 16, 32 or 64"),
            Problem::BitRate { bit_rate } => {
                message.phrase("bit rate ", bit_rate, " bit/s, but it must be 1 to 1000000")
            }
            Problem::BasicCycle { micros } => message
                .text("a basic cycle of ")
                .number(micros)
                .text(" us, but it must hold two reference messages and last at most 10 s"),
            Problem::Gap { micros } => message
                .text("a longest gap of ")
                .number(micros)
                .text(" us, but it must be 0 or at least a basic cycle"),
            Problem::TransmitEnable { bits } => message
                .text("a transmit enable window of ")
                .number(bits)
                .text(" bit times, but it must be 1 to 32"),
            Problem::MasterCount { masters, room } => message
                .number(masters)
                .text(" potential masters, but the reference identifier leaves room for 1 to ")
                .number(room),
            Problem::MasterTwice { node } => message
                .text("node ")
                .number(node)
                .text(" has two ranks among the potential masters"),
            Problem::ReferenceFormat => {
                message.text("the fields of the reference message overlap or exceed 8 bytes")
            }
            Problem::TooLarge => message.text("more than 65534 nodes, windows or event messages"),
            Problem::RepeatFactor { repeat } => message
                .text("repeat factor ")
                .number(repeat)
                .text(" is no power of two of at most the number of basic cycles"),
            Problem::CycleOffset { offset } => message
                .text("cycle offset ")
                .number(offset)
                .text(" is not below the repeat factor"),
            Problem::OutOfOrder => message
                .text("begins before `")
                .text(other)
                .text("`, which stands before it in the list"),
            Problem::Overlap { cycle } => message
                .text("overlaps `")
                .text(other)
                .text("` in basic cycle ")
                .number(cycle),
            Problem::InReference { earliest } => message
                .text("begins while the reference message may be on the bus; the earliest start is ")
                .number(earliest)
                .text(" us"),
            Problem::PastEnd { latest } => message
                .text("ends when the next reference message may begin; the latest end is ")
                .number(latest)
                .text(" us"),
            Problem::DoesNotFit { needed, length } => message
                .text("is ")
                .number(length)
                .text(" us long, but its longest frame with the transmit enable window and the synchronisation uncertainty needs ")
                .number(needed)
                .text(" us"),
            Problem::Length { len } => message
                .text("a message of ")
                .number(len)
                .text(" bytes, but a CAN frame carries at most 8"),
            Problem::NotClosed => message
                .text("is merged with a next window, but no arbitrating window follows at its end in the same basic cycles"),
            Problem::ReferenceId => {
                message.text("uses an identifier of the reference message")
            }
            Problem::EventCycles => message
                .text("and `")
                .text(other)
                .text("` are event messages of one node with different basic cycles"),
            Problem::TwoRoles => message
                .text("and `")
                .text(other)
                .text("` give one identifier two senders, lengths or kinds"),
        };
    }
}

impl core::fmt::Display for MatrixError<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.message().as_str())
    }
}

impl core::error::Error for MatrixError<'_> {}
