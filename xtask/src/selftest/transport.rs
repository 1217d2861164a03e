//! How frames get to a bus and from it.

use std::{io, time::Duration};

use can_bus::Frame;
use twin::TwinError;

/// A frame from the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Received {
    /// When it ended. An adapter reports it later. The clock is that of [`Transport::now`], except that an
    /// adapter with time stamps goes by its own one from the first frame on.
    pub at: Duration,
    /// The frame.
    pub frame: Frame,
}

/// A bus, as a program on it sees it.
///
/// Times count from a beginning of the transport's own. On the virtual vehicle they are simulated
/// and pass only while somebody waits.
pub trait Transport {
    /// The present time.
    fn now(&self) -> Duration;

    /// Sends a frame at once. It may still wait for other frames to end, or lose arbitration.
    ///
    /// # Errors
    /// The frame cannot be handed over.
    fn send(&mut self, frame: &Frame) -> Result<(), Error>;

    /// Waits for the next frame of other nodes, at most until `until`. `None` says that it is
    /// that late.
    ///
    /// # Errors
    /// The bus cannot be reached any more.
    fn receive(&mut self, until: Duration) -> Result<Option<Received>, Error>;

    /// Lines of the adapter so far that say nothing in its protocol.
    fn unreadable(&self) -> u64 {
        0
    }
}

/// Where the system lists its serial ports by name, the advice to look there.
const PORTS: &str = if cfg!(target_os = "linux") {
    "; `ls /dev/serial/by-id` lists the ports on USB"
} else {
    ""
};

/// Why a bus cannot be reached.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// There is no such interface.
    #[error("there is no CAN interface {0}: `ip -brief link` lists the interfaces that there are")]
    NoInterface(String),
    /// There is no such serial port.
    #[error("there is no serial port {0}: connect the adapter{PORTS}")]
    NoPort(String),
    /// The user has no right to the serial port.
    #[error(
        "{0} may not be opened by this user: make the user a member of the port's group, on Debian \
         dialout, and log in again"
    )]
    NoRight(String),
    /// Something else than slcan comes from the serial port.
    #[error(
        "{name} does not speak slcan, it sends \"{text}\": name the port of the adapter, not that \
         of a board's console{PORTS}"
    )]
    NotSlcan {
        /// The port.
        name: String,
        /// A part of what comes.
        text: String,
    },
    /// Another program has opened the serial port.
    #[error("{0} is in use: another program has opened it, end that first")]
    Busy(String),
    /// The interface or the port cannot be opened.
    #[error("{name} cannot be opened: {error}")]
    Open {
        /// Its name.
        name: String,
        /// Why.
        #[source]
        error: io::Error,
    },
    /// The interface has not been started.
    #[error(
        "{name} is down: `sudo ip link set {name} up type can bitrate {bit_rate}` brings it up"
    )]
    Down {
        /// Its name.
        name: String,
        /// The bit rate of the network.
        bit_rate: u32,
    },
    /// The system has no SocketCAN.
    #[error("only Linux has SocketCAN: use an adapter on a serial port, slcan:PORT")]
    NoSocketCan,
    /// The protocol has no number for the network's bit rate.
    #[error("{name} cannot have {bit_rate} bit/s: an slcan adapter has a table of bit rates")]
    BitRate {
        /// The port.
        name: String,
        /// The bit rate of the network.
        bit_rate: u32,
    },
    /// The adapter refuses a command.
    #[error("the adapter at {name} refuses {what}")]
    Refused {
        /// The port.
        name: String,
        /// The command.
        what: &'static str,
    },
    /// The other end is gone.
    #[error(
        "the bus at {0} has ended: its adapter was taken away, or the run that it belongs to is over"
    )]
    Ended(String),
    /// It stopped working.
    #[error("{name} failed: {error}")]
    Lost {
        /// Its name.
        name: String,
        /// Why.
        #[source]
        error: io::Error,
    },
    /// The virtual vehicle cannot run on.
    #[error(transparent)]
    Twin(#[from] TwinError),
}

impl Error {
    /// Whether the command line is wrong.
    pub(crate) fn is_usage(&self) -> bool {
        matches!(
            self,
            Self::NoInterface(_)
                | Self::NoPort(_)
                | Self::NoRight(_)
                | Self::Busy(_)
                | Self::NotSlcan { .. }
                | Self::Open { .. }
                | Self::Down { .. }
                | Self::NoSocketCan
                | Self::BitRate { .. }
        )
    }
}
