//! The pins of the headers of the Nucleo boards.

use parts::{Pin, Sled};

use crate::{Error, read, table};

/// A pin of a header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HeaderPin {
    /// The header, such as `CN7`.
    pub header: String,
    /// Number of the pin.
    pub pin: String,
    /// What it is connected to on the board: a pin of the microcontroller, such as `PC10`, or a
    /// name, such as `GND`. `NC` is connected to nothing.
    pub signal: String,
}

impl HeaderPin {
    /// The pin of the microcontroller.
    #[must_use]
    pub fn mcu(&self) -> Option<Pin> {
        let mut letters = self.signal.strip_prefix('P')?.chars();
        let port = letters.next().filter(char::is_ascii_uppercase)?;
        letters
            .as_str()
            .parse()
            .ok()
            .map(|number| Pin { port, number })
    }
}

/// The headers of the Nucleo board of a sled (UM1724 and UM1956, extension connectors).
///
/// # Errors
/// The table of the board cannot be read.
pub fn of(sled: &Sled) -> Result<Vec<HeaderPin>, Error> {
    let file = format!("{}.csv", sled.title.to_lowercase());
    let lines = table(&file, &read(&file)?, ["header", "pin", "signal", "arduino"])?;
    let pin = |[header, pin, signal, _]: [String; 4]| HeaderPin {
        header,
        pin,
        signal,
    };
    Ok(lines.into_iter().map(pin).collect())
}
