//! A SocketCAN interface of Linux.

use std::{
    io,
    time::{Duration, Instant},
};

use can_bus::Frame;
use embedded_can::Frame as _;
use socketcan::{CanFrame, CanSocket, Socket};

use super::transport::{Error, Received, Transport};

/// A socket at an interface.
pub(super) struct SocketCan {
    socket: CanSocket,
    name: String,
    bit_rate: u32,
    begin: Instant,
}

impl SocketCan {
    /// Opens a socket at the interface of that name. `bit_rate` is the network's; the interface
    /// has its own from `ip link`.
    pub(super) fn open(name: &str, bit_rate: u32) -> Result<Self, Error> {
        let socket = CanSocket::open(name).map_err(|error| match error.raw_os_error() {
            Some(libc::ENODEV | libc::ENXIO) => Error::NoInterface(name.into()),
            _ => Error::Open {
                name: name.into(),
                error,
            },
        })?;
        Ok(Self {
            socket,
            name: name.into(),
            bit_rate,
            begin: Instant::now(),
        })
    }

    fn lost(&self, error: io::Error) -> Error {
        failed(&self.name, self.bit_rate, error)
    }
}

/// Why an interface does not work.
fn failed(name: &str, bit_rate: u32, error: io::Error) -> Error {
    let name = name.to_owned();
    match error.raw_os_error() {
        Some(libc::ENETDOWN) => Error::Down { name, bit_rate },
        Some(libc::ENODEV | libc::ENXIO) => Error::NoInterface(name),
        _ => Error::Lost { name, error },
    }
}

/// The same frame in the form of the bus model. `None` for a report about an error on the bus.
fn read(frame: &CanFrame) -> Option<Frame> {
    let dlc = u8::try_from(frame.dlc()).ok()?;
    match frame {
        CanFrame::Error(_) => None,
        CanFrame::Remote(remote) => Frame::new_remote(remote.id(), dlc),
        CanFrame::Data(data) => Frame::new_data(data.id(), data.data()),
    }
}

/// The same frame in the form of a socket.
fn write(frame: &Frame) -> Option<CanFrame> {
    if frame.is_remote() {
        CanFrame::new_remote(frame.id(), usize::from(frame.dlc()))
    } else {
        CanFrame::new(frame.id(), frame.data())
    }
}

impl Transport for SocketCan {
    fn now(&self) -> Duration {
        self.begin.elapsed()
    }

    fn send(&mut self, frame: &Frame) -> Result<(), Error> {
        let frame = write(frame).ok_or_else(|| self.lost(io::ErrorKind::InvalidInput.into()))?;
        let sent = self.socket.write_frame(&frame);
        sent.map_err(|error| self.lost(error))
    }

    fn receive(&mut self, until: Duration) -> Result<Option<Received>, Error> {
        loop {
            let Some(left) = until.checked_sub(self.now()) else {
                return Ok(None);
            };
            // Waits whole milliseconds, then looks again and again.
            match self.socket.read_frame_timeout(left) {
                Ok(frame) => {
                    if let Some(frame) = read(&frame) {
                        let at = self.now();
                        return Ok(Some(Received { at, frame }));
                    }
                }
                Err(error) if waits(&error) => {}
                Err(error) => return Err(self.lost(error)),
            }
        }
    }
}

/// Whether an error says that nothing has come yet.
fn waits(error: &io::Error) -> bool {
    use io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(error.kind(), Interrupted | TimedOut | WouldBlock)
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_can::{ExtendedId, StandardId};

    #[test]
    fn an_interface_that_is_down_is_wrong_input() {
        let error = failed(
            "can0",
            250_000,
            io::Error::from_raw_os_error(libc::ENETDOWN),
        );
        assert!(error.is_usage());
        assert_eq!(
            error.to_string(),
            "can0 is down: `sudo ip link set can0 up type can bitrate 250000` brings it up"
        );
        let broken = failed("can0", 250_000, io::Error::from_raw_os_error(libc::EIO));
        assert!(!broken.is_usage());
    }

    #[test]
    fn frames_are_the_same_on_both_sides() {
        for frame in [
            Frame::standard(0x212, &[1, 1]),
            Frame::standard(0x7FF, &[]),
            Frame::extended(0x1FFF_FFFF, &[0xFF; 8]),
            Frame::new_remote(StandardId::MAX, 3),
            Frame::new_remote(ExtendedId::ZERO, 8),
        ] {
            let frame = frame.unwrap();
            assert_eq!(read(&write(&frame).unwrap()), Some(frame));
        }
    }
}
