//! The choice of a bus on the command line.

use std::{fmt, str::FromStr};

/// Baud rate of a serial port when none is named. An adapter on USB has none and ignores it.
const BAUD: u32 = 115_200;

/// A bus.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Bus {
    /// That of the virtual vehicle.
    Twin,
    /// Behind a SocketCAN interface.
    SocketCan(String),
    /// Behind an adapter on a serial port that speaks slcan.
    Slcan {
        /// The port.
        port: String,
        /// Its baud rate.
        baud: u32,
    },
}

/// A text that names no bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("twin, socketcan:INTERFACE or slcan:PORT[@BAUD] is accepted")]
pub struct NoBus;

impl FromStr for Bus {
    type Err = NoBus;

    fn from_str(text: &str) -> Result<Self, NoBus> {
        match text.split_once(':') {
            None if text == "twin" => Ok(Self::Twin),
            Some(("socketcan", name)) if !name.is_empty() => Ok(Self::SocketCan(name.into())),
            Some(("slcan", port)) => {
                let (port, baud) = match port.rsplit_once('@') {
                    Some((port, baud)) => (port, baud.parse().map_err(|_| NoBus)?),
                    None => (port, BAUD),
                };
                if port.is_empty() || baud == 0 {
                    return Err(NoBus);
                }
                Ok(Self::Slcan {
                    port: port.into(),
                    baud,
                })
            }
            _ => Err(NoBus),
        }
    }
}

impl fmt::Display for Bus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Twin => f.write_str("twin"),
            Self::SocketCan(name) => write!(f, "socketcan:{name}"),
            Self::Slcan { port, baud: BAUD } => write!(f, "slcan:{port}"),
            Self::Slcan { port, baud } => write!(f, "slcan:{port}@{baud}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_kind_of_bus_is_named() {
        for text in [
            "twin",
            "socketcan:can0",
            "slcan:/dev/ttyACM0",
            "slcan:/dev/ttyUSB0@1000000",
            "slcan:COM3",
        ] {
            let bus: Bus = text.parse().unwrap();
            assert_eq!(bus.to_string(), text);
        }
        let port = |text: &str| match text.parse() {
            Ok(Bus::Slcan { port, baud }) => (port, baud),
            other => panic!("{other:?}"),
        };
        assert_eq!(port("slcan:/dev/a@b@9600"), ("/dev/a@b".into(), 9600));
        assert_eq!(port("slcan:COM3"), ("COM3".into(), 115_200));
    }

    #[test]
    fn anything_else_is_refused() {
        for text in [
            "",
            "can0",
            "Twin",
            "twin:",
            "socketcan",
            "socketcan:",
            "slcan:",
            "slcan:@9600",
            "slcan:COM3@",
            "slcan:COM3@fast",
            "slcan:COM3@0",
            "usb:1",
        ] {
            assert_eq!(text.parse::<Bus>(), Err(NoBus), "{text}");
        }
    }
}
