//! The vehicle's nodes and the boards they run on.

use clap::ValueEnum;

/// A node of the vehicle: one image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, ValueEnum)]
pub enum Node {
    /// RTK receiver and time master, on the F446 sled.
    Gps,
    /// States, control law, modes and user interface, on the F446 sled.
    Controller,
    /// Steering actuator and potentiometer, on the F303 sled.
    Steering,
    /// Drive motor, on the F303 sled.
    Drive,
}

impl Node {
    /// All nodes, in the order in which they are listed.
    pub const ALL: [Node; 4] = [Node::Gps, Node::Controller, Node::Steering, Node::Drive];

    /// Name of the node and of its image.
    pub const fn name(self) -> &'static str {
        match self {
            Node::Gps => "gps",
            Node::Controller => "controller",
            Node::Steering => "steering",
            Node::Drive => "drive",
        }
    }

    /// The board that the node runs on (thesis 5.2.3).
    pub const fn board(self) -> Board {
        match self {
            Node::Gps | Node::Controller => Board::F446,
            Node::Steering | Node::Drive => Board::F303,
        }
    }
}

/// A board: a CAN sled with a microcontroller on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Board {
    /// Nucleo-F446RE: STM32F446RE.
    F446,
    /// Nucleo-F303K8: STM32F303K8.
    F303,
}

/// A memory of a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Region {
    /// Name in tables.
    pub name: &'static str,
    /// First address.
    pub origin: u64,
    /// Size in bytes.
    pub size: u64,
}

impl Region {
    /// Whether an address lies in the memory.
    pub const fn contains(&self, address: u64) -> bool {
        self.origin <= address && address - self.origin < self.size
    }
}

/// How much of a part an image may use, in bytes. Less than there is, so that a
/// jump in size is seen when it happens and not when the memory is full.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Budget {
    /// Code and constants.
    pub flash: u64,
    /// Static variables.
    pub statics: u64,
    /// Least room for the stack.
    pub stack: u64,
}

const KIB: u64 = 1024;

impl Board {
    /// All boards.
    pub const ALL: [Board; 2] = [Board::F446, Board::F303];

    /// Name in tables; the firmware's feature of the same name selects the board.
    pub const fn name(self) -> &'static str {
        match self {
            Board::F446 => "f446",
            Board::F303 => "f303",
        }
    }

    /// Name of the part for probe-rs.
    pub const fn chip(self) -> &'static str {
        match self {
            Board::F446 => "STM32F446RETx",
            Board::F303 => "STM32F303K8Tx",
        }
    }

    /// Flash (RM0390 3.3, RM0316 4.2).
    pub const fn flash(self) -> Region {
        Region {
            name: "flash",
            origin: 0x0800_0000,
            size: match self {
                Board::F446 => 512 * KIB,
                Board::F303 => 64 * KIB,
            },
        }
    }

    /// Memories for variables and the stack (RM0390 2.2, RM0316 3.2).
    pub const fn ram(self) -> &'static [Region] {
        match self {
            Board::F446 => &[Region {
                name: "RAM",
                origin: 0x2000_0000,
                size: 128 * KIB,
            }],
            Board::F303 => &[
                Region {
                    name: "RAM",
                    origin: 0x2000_0000,
                    size: 12 * KIB,
                },
                Region {
                    name: "CCM",
                    origin: 0x1000_0000,
                    size: 4 * KIB,
                },
            ],
        }
    }

    /// What an image for the board may use.
    pub const fn budget(self) -> Budget {
        match self {
            Board::F446 => Budget {
                flash: 128 * KIB,
                statics: 32 * KIB,
                stack: 8 * KIB,
            },
            Board::F303 => Budget {
                flash: 48 * KIB,
                statics: 8 * KIB,
                stack: 2 * KIB,
            },
        }
    }
}
