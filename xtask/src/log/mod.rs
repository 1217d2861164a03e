//! The log of a program on a virtual microcontroller: defmt's frames, taken from its memory as a
//! debug probe does (RTT), and made readable with the format strings of the image.
//!
//! `defmt-decoder` does the same for probe-rs, but it makes every number of `serde_json` in this
//! program one of arbitrary precision. So only its parser of format strings is used. A frame is
//! the index of its format string and then the arguments; see `defmt`'s design documents.

use std::collections::BTreeMap;

use defmt_parser::{DisplayHint, Fragment, Parameter, ParserMode, Type};
use object::{Object, ObjectSection, ObjectSymbol};
use serde::Deserialize;

use twin::mcu::Mcu;

/// The frames of an image.
#[derive(Debug, Clone)]
pub(crate) struct Log {
    formats: BTreeMap<u16, Format>,
    /// Address of RTT's control block.
    control: Option<u32>,
    pending: Vec<u8>,
}

/// A format string; its level if it is that of a line.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Format {
    level: Option<&'static str>,
    text: String,
}

/// The name of a symbol of defmt.
#[derive(Deserialize)]
struct Entry {
    tag: String,
    data: String,
}

const LEVELS: [(&str, &str); 6] = [
    ("defmt_trace", "TRACE"),
    ("defmt_debug", "DEBUG"),
    ("defmt_info", "INFO"),
    ("defmt_warn", "WARN"),
    ("defmt_error", "ERROR"),
    ("defmt_println", ""),
];

/// The level of a line and the text behind it; no level if the line has none.
pub(crate) fn parts(line: &str) -> (&str, &str) {
    let is_level = |word: &str| !word.is_empty() && LEVELS.iter().any(|(_, level)| *level == word);
    let parts = line.split_once(' ');
    parts
        .filter(|(word, _)| is_level(word))
        .unwrap_or(("", line))
}

/// Offsets in RTT's control block: of the first channel's buffer, its size, and where the program
/// writes and the probe reads.
const BUFFER: u32 = 28;
const SIZE: u32 = 32;
const WRITTEN: u32 = 36;
const READ: u32 = 40;

impl Log {
    /// The frames of this image. Without defmt it has none.
    pub(crate) fn of(elf: &[u8]) -> Self {
        let file = object::File::parse(elf).ok();
        let mut formats = BTreeMap::new();
        let mut control = None;
        for symbol in file.iter().flat_map(|file| file.symbols()) {
            let name = symbol.name().unwrap_or_default();
            if name == "_SEGGER_RTT" {
                control = u32::try_from(symbol.address()).ok();
            }
            let section = symbol.section_index().zip(file.as_ref());
            let section = section.and_then(|(index, file)| file.section_by_index(index).ok());
            let in_defmt = section.is_some_and(|section| section.name() == Ok(".defmt"));
            let entry = serde_json::from_str::<Entry>(name).ok();
            let index = u16::try_from(symbol.address()).ok();
            if let (true, Some(entry), Some(index)) = (in_defmt, entry, index) {
                let level = LEVELS.iter().find(|(tag, _)| *tag == entry.tag);
                let format = Format {
                    level: level.map(|(_, level)| *level),
                    text: entry.data,
                };
                formats.insert(index, format);
            }
        }
        Self {
            formats,
            control,
            pending: Vec::new(),
        }
    }

    /// The lines that the program has written since the last call.
    pub(crate) fn take(&mut self, mcu: &mut Mcu) -> Vec<String> {
        if let Some(bytes) = self.control.and_then(|control| drain(mcu, control)) {
            self.pending.extend(bytes);
        }
        self.lines()
    }

    /// The lines whose frames are complete. A zero ends a frame.
    fn lines(&mut self) -> Vec<String> {
        let mut lines = Vec::new();
        while let Some(end) = self.pending.iter().position(|&byte| byte == 0) {
            let frame: Vec<u8> = self.pending.drain(..=end).collect();
            let frame = frame.strip_suffix(&[0]).unwrap_or_default();
            if !frame.is_empty() {
                let line = unpack(frame).and_then(|frame| self.line(&frame));
                lines.push(line.unwrap_or_else(|| "a line that cannot be read".into()));
            }
        }
        lines
    }

    fn line(&self, frame: &[u8]) -> Option<String> {
        let mut input = Input(frame);
        let format = self.formats.get(&input.u16()?)?;
        let text = self.text(&format.text, &mut input)?;
        Some(match format.level? {
            "" => text,
            level => format!("{level} {text}"),
        })
    }

    /// A format string with its arguments.
    fn text(&self, format: &str, input: &mut Input<'_>) -> Option<String> {
        let fragments = defmt_parser::parse(format, ParserMode::ForwardsCompatible).ok()?;
        // Arguments come in the order of their numbers, each once.
        let mut parameters: BTreeMap<usize, &Parameter> = BTreeMap::new();
        for fragment in &fragments {
            if let Fragment::Parameter(parameter) = fragment {
                parameters.insert(parameter.index, parameter);
            }
        }
        let mut arguments = BTreeMap::new();
        for (index, Parameter { ty, hint, .. }) in parameters {
            let argument = match (ty, hint) {
                // No program of this workspace has another hint.
                (Type::U32, Some(DisplayHint::Hexadecimal { zero_pad, .. })) => {
                    format!("{:0zero_pad$X}", input.u32()?)
                }
                _ => self.argument(ty, input)?,
            };
            arguments.insert(index, argument);
        }
        let mut text = String::new();
        for fragment in &fragments {
            text.push_str(match fragment {
                Fragment::Literal(literal) => literal,
                Fragment::Parameter(parameter) => arguments.get(&parameter.index)?,
            });
        }
        Some(text)
    }

    fn argument(&self, kind: &Type, input: &mut Input<'_>) -> Option<String> {
        Some(match kind {
            Type::U8 => input.take::<1>().map(u8::from_le_bytes)?.to_string(),
            Type::U16 => input.u16()?.to_string(),
            Type::U32 | Type::Usize => input.u32()?.to_string(),
            Type::U64 => input.take().map(u64::from_le_bytes)?.to_string(),
            Type::I8 => input.take().map(i8::from_le_bytes)?.to_string(),
            Type::I16 => input.take().map(i16::from_le_bytes)?.to_string(),
            Type::I32 | Type::Isize => input.take().map(i32::from_le_bytes)?.to_string(),
            Type::I64 => input.take().map(i64::from_le_bytes)?.to_string(),
            Type::F32 => input.take().map(f32::from_le_bytes)?.to_string(),
            Type::F64 => input.take().map(f64::from_le_bytes)?.to_string(),
            Type::Bool => (input.take() != Some([0])).to_string(),
            Type::Char => char::from_u32(input.u32()?)?.to_string(),
            Type::Str => {
                let length = input.u32()? as usize;
                input.utf8(length)?
            }
            Type::IStr => self.formats.get(&input.u16()?)?.text.clone(),
            Type::Debug | Type::Display => {
                let end = input.0.iter().position(|&byte| byte == 0xFF)?;
                let text = input.utf8(end)?;
                input.take::<1>()?;
                text
            }
            Type::Format => {
                let index = input.u16()?;
                self.nested(index, input)?
            }
            Type::FormatSequence => {
                let mut text = String::new();
                loop {
                    match input.u16()? {
                        0 => break text,
                        index => text.push_str(&self.nested(index, input)?),
                    }
                }
            }
            // No program of this workspace logs anything else.
            _ => return None,
        })
    }

    /// A value that formats itself. The variants of an enum are separated by bars, and the number
    /// of its variant comes first.
    fn nested(&self, index: u16, input: &mut Input<'_>) -> Option<String> {
        let format = &self.formats.get(&index)?.text;
        if !format.contains('|') {
            return self.text(format, input);
        }
        let [variant] = input.take()?;
        self.text(format.split('|').nth(variant.into())?, input)
    }
}

/// The bytes of a frame that are still to be read.
struct Input<'a>(&'a [u8]);

impl Input<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (bytes, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*bytes)
    }

    fn u16(&mut self) -> Option<u16> {
        self.take().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn utf8(&mut self, length: usize) -> Option<String> {
        let (bytes, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        String::from_utf8(bytes.to_vec()).ok()
    }
}

/// Takes away the encoding in which no byte of a frame is zero (reverse zero-compressing COBS). It
/// is read from its end: a byte of control says which of the bytes before it were zeros.
fn unpack(frame: &[u8]) -> Option<Vec<u8>> {
    let mut bytes = frame.iter().rev().copied();
    let mut reversed = Vec::new();
    while let Some(control) = bytes.next() {
        let (zeros, count) = match control {
            0 => return None,
            0x01..=0x7F => (control, 7),
            0x80..=0xFE => {
                reversed.push(0);
                (0, usize::from(control & 0x7F) + 7)
            }
            0xFF => (0, 134),
        };
        for place in 0..count {
            let zero = place < 7 && zeros >> (6 - place) & 1 != 0;
            reversed.push(if zero { 0 } else { bytes.next()? });
        }
    }
    reversed.reverse();
    Some(reversed)
}

/// Takes what the program has written to the first channel.
fn drain(mcu: &mut Mcu, control: u32) -> Option<Vec<u8>> {
    let word = |mcu: &Mcu, offset: u32| {
        let bytes = mcu.memory(control + offset, 4)?;
        Some(u32::from_le_bytes(bytes.try_into().ok()?))
    };
    let size = word(mcu, SIZE)?;
    let (written, mut read) = (word(mcu, WRITTEN)?, word(mcu, READ)?);
    // Before the program has started its memory holds anything.
    if size == 0 || written >= size || read >= size {
        return None;
    }
    let buffer = word(mcu, BUFFER)?;
    let mut bytes = Vec::new();
    while read != written {
        bytes.extend(mcu.memory(buffer + read, 1)?);
        read = (read + 1) % size;
    }
    mcu.set_memory(control + READ, &read.to_le_bytes());
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn log(formats: &[(u16, Option<&'static str>, &str)]) -> Log {
        let formats = formats.iter().map(|&(index, level, text)| {
            let text = text.to_owned();
            (index, Format { level, text })
        });
        Log {
            formats: formats.collect(),
            control: None,
            pending: Vec::new(),
        }
    }

    #[test]
    fn zeros_come_back_where_they_were() {
        // Seven bytes of which the third was zero.
        // Seven bytes of which the fifth was zero.
        let packed = [1, 2, 4, 5, 6, 7, 0b001_0000];
        assert_eq!(unpack(&packed), Some(vec![1, 2, 4, 5, 0, 6, 7]));
        assert_eq!(unpack(&[3]), None, "the bytes before it are missing");
        assert_eq!(unpack(&[]), Some(Vec::new()));
    }

    #[test]
    fn a_line_shows_its_arguments() {
        let log = log(&[
            (7, Some("INFO"), "{=str}: {=u32} of {}, {=i8}"),
            (9, None, "External|Internal"),
            (4, Some("ERROR"), "{=__internal_Display} ({0})"),
        ]);
        let mut frame = vec![7, 0, 2, 0, 0, 0];
        frame.extend(b"us");
        frame.extend(300_u32.to_le_bytes());
        frame.extend([9, 0, 1, 0xFF]);
        assert_eq!(log.line(&frame).unwrap(), "INFO us: 300 of Internal, -1");
        assert_eq!(log.line(&frame[..5]), None, "a frame that is cut off");
        assert_eq!(log.line(&[8, 0]), None, "an unknown format");
        assert_eq!(log.line(&[9, 0]), None, "not the format of a line");
    }

    /// So the log's number of a key is that of `cargo xtask keys show`.
    #[test]
    fn a_number_in_hexadecimal_has_all_its_digits() {
        let log = log(&[(7, Some("INFO"), "{=u32:08X}")]);
        let mut frame = vec![7, 0];
        frame.extend(0x09A3_40BD_u32.to_le_bytes());
        assert_eq!(log.line(&frame).unwrap(), "INFO 09A340BD");
    }

    #[test]
    fn frames_end_with_a_zero_wherever_they_are_cut() {
        let mut log = log(&[(1, Some(""), "hello")]);
        log.pending = vec![0, 0b000_0001];
        assert_eq!(log.lines(), Vec::<String>::new());
        log.pending.extend([0]);
        // Seven bytes were expected before the byte of control.
        assert_eq!(log.lines(), ["a line that cannot be read"]);
    }
}
