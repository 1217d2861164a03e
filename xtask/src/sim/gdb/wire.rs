//! The connection to gdb.

use std::{
    io::{self, Read, Write},
    net::TcpStream,
};

use gdbstub::conn::Connection;

/// The connection to gdb, whose answers are written at once.
pub(super) struct Wire {
    stream: TcpStream,
    answer: Vec<u8>,
}

impl Wire {
    /// Of this connection.
    pub(super) fn new(stream: TcpStream) -> io::Result<Self> {
        stream.set_nodelay(true)?;
        Ok(Self {
            stream,
            answer: Vec::new(),
        })
    }

    /// Waits for the next byte; `None` when gdb is gone.
    pub(super) fn read(&mut self) -> io::Result<Option<u8>> {
        let mut byte = [0];
        match self.stream.read(&mut byte) {
            Ok(0) => Ok(None),
            Ok(_) => Ok(Some(byte[0])),
            Err(error) if error.kind() == io::ErrorKind::ConnectionReset => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Whether there is a byte to read, or the connection has ended.
    pub(super) fn is_called(&self) -> bool {
        let look = || {
            self.stream.set_nonblocking(true)?;
            let found = self.stream.peek(&mut [0]);
            self.stream.set_nonblocking(false)?;
            found
        };
        !look().is_err_and(|error: io::Error| error.kind() == io::ErrorKind::WouldBlock)
    }

    /// Shows a line on gdb's console. Only while the node runs does gdb take it.
    pub(super) fn show(&mut self, line: &str) -> io::Result<()> {
        let text = line.bytes().chain([b'\n']);
        let digits: String = text.map(|byte| format!("{byte:02x}")).collect();
        self.send(&format!("O{digits}"))
    }

    /// Sends a packet of its own.
    pub(super) fn send(&mut self, packet: &str) -> io::Result<()> {
        let sum = packet.bytes().fold(0_u8, u8::wrapping_add);
        Write::write_all(&mut self.stream, format!("${packet}#{sum:02x}").as_bytes())
    }
}

impl Connection for Wire {
    type Error = io::Error;

    fn write(&mut self, byte: u8) -> io::Result<()> {
        self.answer.push(byte);
        Ok(())
    }

    fn flush(&mut self) -> io::Result<()> {
        Write::write_all(&mut self.stream, &self.answer)?;
        self.answer.clear();
        Ok(())
    }
}
