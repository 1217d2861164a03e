//! MCAP files as logs of a bus: those of `cargo xtask sim`, and those of ROS with `can_msgs`.
//!
//! Channels are known by the name of their schema. All others are passed over, so that a recording of a whole
//! robot is a log, too.

use std::{
    collections::BTreeMap,
    io::{self, Read},
};

use crc::{CRC_32_ISO_HDLC, Crc};
use embedded_can::{ExtendedId, Id, StandardId};
use mcap::{
    McapError, parse_record,
    records::{ChunkHeader, Record},
    sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions},
};
use serde::Deserialize;

use super::{Entry, Item, LogTime, Skip};
use crate::Frame;

/// How an MCAP file begins.
pub const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// The name of the format.
pub const NAME: &str = "MCAP";

/// What is read.
pub const SCHEMAS: &str =
    "furrow.Frame (JSON) and can_msgs/msg/Frame (CDR of ROS 2, or can_msgs/Frame of ROS 1)";

/// Size of the pieces in which a file is read, bytes.
const PIECE: usize = 1 << 16;
/// Most bytes of a record, or of a chunk when it is unpacked: recorders make chunks of some megabytes.
const MOST: usize = 1 << 28;
/// Most channels with frames that are told apart.
const MOST_CHANNELS: usize = 64;

const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Why a file gives no frames. Displays as a clause.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The system cannot read it.
    #[error("it cannot be read: {0}")]
    Read(#[from] io::Error),
    /// It is no whole MCAP file.
    #[error("it is no whole MCAP file: {0}; `mcap recover` keeps what can be read of one")]
    Broken(#[from] McapError),
    /// A chunk cannot be unpacked.
    #[error("a chunk of the MCAP file cannot be unpacked: {0}")]
    Chunk(String),
    /// It goes on behind its end.
    #[error("bytes follow the end of the MCAP file: one file is accepted, not several in a row")]
    GoesOn,
    /// It has other channels only.
    #[error("no channel of the MCAP file has frames of a bus: the schemas {SCHEMAS} are accepted")]
    NoFrames,
}

impl Error {
    fn of(error: McapError) -> Self {
        match error {
            McapError::BytesAfterEndMagic => Self::GoesOn,
            error => Self::Broken(error),
        }
    }
}

/// How the messages of a channel are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Coding {
    /// [`Own`], frames of a run.
    Furrow,
    /// Error frames of a run.
    FurrowError,
    /// `can_msgs/msg/Frame` of ROS 2.
    Cdr,
    /// `can_msgs/Frame` of ROS 1.
    Ros1,
}

impl Coding {
    fn of(schema: &str, encoding: &str) -> Option<Self> {
        match (schema, encoding) {
            ("furrow.Frame", "json") => Some(Self::Furrow),
            ("furrow.ErrorFrame", "json") => Some(Self::FurrowError),
            ("can_msgs/msg/Frame", "cdr") => Some(Self::Cdr),
            ("can_msgs/Frame" | "can_msgs/msg/Frame", "ros1") => Some(Self::Ros1),
            _ => None,
        }
    }
}

/// A frame as `cargo xtask sim` records it.
#[derive(Deserialize)]
struct Own {
    id: u32,
    data: String,
    #[serde(default)]
    remote: bool,
    dlc: Option<u8>,
    #[serde(default = "yes")]
    complete: bool,
}

const fn yes() -> bool {
    true
}

/// Reads one file.
#[derive(Default)]
pub struct Reader {
    schemas: BTreeMap<u16, String>,
    /// How a channel is written, and its place in `topics`; none if there are too many.
    channels: BTreeMap<u16, (Coding, Option<u8>)>,
    topics: Vec<String>,
}

impl Reader {
    /// The topics with frames so far, in the order in which they came.
    pub fn topics(&self) -> &[String] {
        &self.topics
    }

    /// Reads a file to its end and hands over an item for each message of a bus.
    ///
    /// # Errors
    /// It cannot be read, is broken, or no channel has frames.
    pub fn read(&mut self, input: &mut dyn Read, each: &mut dyn FnMut(Item)) -> Result<(), Error> {
        let options = LinearReaderOptions::default()
            .with_emit_chunks(true)
            .with_validate_data_section_crc(true)
            .with_check_finishes_after_end_magic(true)
            .with_record_length_limit(MOST);
        let mut reader = LinearReader::new_with_options(options);
        while let Some(event) = reader.next_event() {
            match event.map_err(Error::of)? {
                LinearReadEvent::ReadRequest(wanted) => {
                    let count = input.read(reader.insert(wanted.clamp(1, PIECE)))?;
                    reader.notify_read(count);
                }
                LinearReadEvent::Record { data, opcode } => match parse_record(opcode, data)? {
                    Record::Chunk { header, data } => self.chunk(&header, &data, each)?,
                    record => self.record(record, each),
                },
            }
        }
        if self.topics.is_empty() {
            return Err(Error::NoFrames);
        }
        Ok(())
    }

    fn chunk(
        &mut self,
        header: &ChunkHeader,
        data: &[u8],
        each: &mut dyn FnMut(Item),
    ) -> Result<(), Error> {
        let unpacked = unpacked(header, data)?;
        for record in mcap::read::LinearReader::sans_magic(&unpacked) {
            self.record(record?, each);
        }
        Ok(())
    }

    fn record(&mut self, record: Record<'_>, each: &mut dyn FnMut(Item)) {
        match record {
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                let schema = self.schemas.get(&channel.schema_id);
                let coding = schema.and_then(|name| Coding::of(name, &channel.message_encoding));
                if let Some(coding) = coding {
                    let place = self.place(coding, &channel.topic);
                    self.channels.insert(channel.id, (coding, place));
                }
            }
            Record::Message { header, data } => {
                if let Some(&(coding, channel)) = self.channels.get(&header.channel_id) {
                    each(match channel {
                        Some(channel) => item(coding, channel, header.log_time, &data),
                        None => Item::Skipped(Skip::Interface),
                    });
                }
            }
            _ => {}
        }
    }

    /// The place of a topic. That of error frames is none: they belong to no interface.
    fn place(&mut self, coding: Coding, topic: &str) -> Option<u8> {
        if coding == Coding::FurrowError {
            return Some(0);
        }
        let name: String = topic.chars().filter(|one| !one.is_control()).collect();
        let known = self.topics.iter().position(|known| *known == name);
        let place = known.unwrap_or(self.topics.len());
        if known.is_none() {
            if place >= MOST_CHANNELS {
                return None;
            }
            self.topics.push(name);
        }
        u8::try_from(place).ok()
    }
}

/// The records of a chunk.
fn unpacked(header: &ChunkHeader, data: &[u8]) -> Result<Vec<u8>, Error> {
    let length = usize::try_from(header.uncompressed_size).unwrap_or(usize::MAX);
    if length > MOST {
        return Err(Error::Chunk(format!(
            "it has {length} bytes, and {MOST} are accepted"
        )));
    }
    // A byte more shows a chunk that is longer than it says.
    let room = header.uncompressed_size + 1;
    let mut all = Vec::new();
    let read = match header.compression.as_str() {
        "" => data.take(room).read_to_end(&mut all),
        "zstd" => ruzstd::decoding::StreamingDecoder::new(data)
            .map_err(io::Error::other)
            .and_then(|decoder| decoder.take(room).read_to_end(&mut all)),
        "lz4" => lz4_flex::frame::FrameDecoder::new(data)
            .take(room)
            .read_to_end(&mut all),
        other => {
            let why = format!("its compression is {other:?}: zstd, lz4 and none are accepted");
            return Err(Error::Chunk(why));
        }
    };
    read.map_err(|error| Error::Chunk(error.to_string()))?;
    if all.len() != length {
        return Err(Error::Chunk(format!(
            "it has {} bytes instead of {length}",
            all.len()
        )));
    }
    // Zero says that there is none.
    if header.uncompressed_crc != 0 && CRC.checksum(&all) != header.uncompressed_crc {
        return Err(Error::Chunk("its check value is wrong".into()));
    }
    Ok(all)
}

/// What a message says; `log_time` in nanoseconds.
fn item(coding: Coding, channel: u8, log_time: u64, data: &[u8]) -> Item {
    let entry = |at: u64, frame: Frame| {
        Item::Frame(Entry {
            at: LogTime::from_ticks(at),
            channel,
            direction: None,
            frame,
        })
    };
    match coding {
        Coding::FurrowError => Item::Skipped(Skip::ErrorFrame),
        Coding::Furrow => match serde_json::from_slice::<Own>(data) {
            // Its error frame is a message of its own.
            Ok(own) if !own.complete => Item::Nothing,
            Ok(own) => match own.frame() {
                Some(frame) => entry(log_time, frame),
                None => Item::Skipped(Skip::Unreadable),
            },
            Err(_) => Item::Skipped(Skip::Unreadable),
        },
        Coding::Cdr | Coding::Ros1 => {
            let read = match coding {
                Coding::Cdr => Ros::cdr(data),
                _ => Ros::ros1(data),
            };
            match read {
                Some(ros) if ros.is_error => Item::Skipped(Skip::ErrorFrame),
                Some(ros) => match ros.frame() {
                    Some(frame) => entry(ros.stamp.unwrap_or(log_time), frame),
                    None => Item::Skipped(Skip::Unreadable),
                },
                None => Item::Skipped(Skip::Unreadable),
            }
        }
    }
}

fn id(number: u32, extended: bool) -> Option<Id> {
    if extended {
        ExtendedId::new(number).map(Id::from)
    } else {
        let number = u16::try_from(number).ok()?;
        StandardId::new(number).map(Id::from)
    }
}

impl Own {
    fn frame(&self) -> Option<Frame> {
        let text = self.data.as_bytes();
        let (pairs, rest) = text.as_chunks::<2>();
        let digits = |pair: &[u8; 2]| {
            let digit = |byte: u8| char::from(byte).to_digit(16);
            u8::try_from(digit(pair[0])? * 16 + digit(pair[1])?).ok()
        };
        let data: Vec<u8> = pairs.iter().map(digits).collect::<Option<_>>()?;
        if !rest.is_empty() {
            return None;
        }
        let length = u8::try_from(data.len()).ok()?;
        let dlc = self.dlc.unwrap_or(length);
        Frame::from_parts(id(self.id, false)?, self.remote, dlc, &data)
    }
}

/// The fields of `can_msgs/Frame` that count.
struct Ros {
    /// Time stamp of the driver, ns; `None` if it gave none.
    stamp: Option<u64>,
    id: u32,
    is_remote: bool,
    is_extended: bool,
    is_error: bool,
    dlc: u8,
    data: [u8; 8],
}

/// Reads numbers from the bytes of a message.
struct Fields<'d> {
    data: &'d [u8],
    at: usize,
    big_endian: bool,
}

impl Fields<'_> {
    fn bytes<const N: usize>(&mut self) -> Option<[u8; N]> {
        let bytes = self.data.get(self.at..)?.first_chunk()?;
        self.at += N;
        Some(*bytes)
    }

    fn word(&mut self) -> Option<u32> {
        let bytes = self.bytes()?;
        Some(if self.big_endian {
            u32::from_be_bytes(bytes)
        } else {
            u32::from_le_bytes(bytes)
        })
    }

    /// The stamp, and behind it the name of a coordinate frame, which does not matter.
    fn header(&mut self) -> Option<Option<u64>> {
        let (seconds, nanos) = (self.word()?, self.word()?);
        let length = usize::try_from(self.word()?).ok()?;
        self.at = self.at.checked_add(length)?;
        let stamp = u64::from(seconds) * 1_000_000_000 + u64::from(nanos);
        Some((stamp != 0).then_some(stamp))
    }

    fn frame(&mut self, stamp: Option<u64>) -> Option<Ros> {
        let id = self.word()?;
        let [remote, extended, error, dlc] = self.bytes()?;
        Some(Ros {
            stamp,
            id,
            is_remote: remote != 0,
            is_extended: extended != 0,
            is_error: error != 0,
            dlc,
            data: self.bytes()?,
        })
    }
}

impl Ros {
    /// The common data representation of ROS 2 (OMG DDSI-RTPS, 10.5): a word that tells the order of the bytes,
    /// then the fields, words at multiples of four behind it.
    fn cdr(data: &[u8]) -> Option<Self> {
        let ([0, kind, _, _], fields) = data.split_first_chunk()? else {
            return None;
        };
        let big_endian = match kind {
            0 => true,
            1 => false,
            _ => return None,
        };
        let mut fields = Fields {
            data: fields,
            at: 0,
            big_endian,
        };
        let stamp = fields.header()?;
        fields.at = fields.at.checked_next_multiple_of(4)?;
        fields.frame(stamp)
    }

    /// The serialization of ROS 1: little-endian fields without gaps, behind a sequence number.
    fn ros1(data: &[u8]) -> Option<Self> {
        let mut fields = Fields {
            data,
            at: 4,
            big_endian: false,
        };
        let stamp = fields.header()?;
        fields.frame(stamp)
    }

    fn frame(&self) -> Option<Frame> {
        let id = id(self.id, self.is_extended)?;
        let bytes = if self.is_remote { 0 } else { self.dlc };
        let data = self.data.get(..usize::from(bytes))?;
        Frame::from_parts(id, self.is_remote, self.dlc, data)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame_of(item: Item) -> (u64, Frame) {
        match item {
            Item::Frame(entry) => (entry.at.as_ticks(), entry.frame),
            other => panic!("{other:?}"),
        }
    }

    /// Two seconds and 5 ns, frame "can0", 0x12C with three bytes.
    const CDR: &[u8] =
        b"\x00\x01\x00\x00\x02\x00\x00\x00\x05\x00\x00\x00\x05\x00\x00\x00can0\x00\x00\x00\x00\
        \x2C\x01\x00\x00\x00\x00\x00\x03\x01\x02\x03\x00\x00\x00\x00\x00";

    #[test]
    fn a_frame_of_ros_is_read_in_each_of_its_forms() {
        let expected = (2_000_000_005, Frame::standard(0x12C, &[1, 2, 3]).unwrap());
        assert_eq!(frame_of(item(Coding::Cdr, 0, 7, CDR)), expected);
        let mut big = CDR.to_vec();
        big[1] = 0;
        for word in [4, 8, 12, 24] {
            big[word..word + 4].reverse();
        }
        assert_eq!(frame_of(item(Coding::Cdr, 0, 7, &big)), expected);
        let mut ros1 = vec![9, 0, 0, 0];
        ros1.extend(&CDR[4..12]);
        ros1.extend(b"\x04\x00\x00\x00can0");
        ros1.extend(&CDR[24..]);
        assert_eq!(frame_of(item(Coding::Ros1, 0, 7, &ros1)), expected);
        // Without a stamp of the driver that of the recorder counts.
        let mut unstamped = CDR.to_vec();
        unstamped[4..12].fill(0);
        assert_eq!(frame_of(item(Coding::Cdr, 0, 7, &unstamped)).0, 7);
        let mut remote = CDR.to_vec();
        remote[28] = 1;
        let (_, frame) = frame_of(item(Coding::Cdr, 0, 7, &remote));
        assert!(frame.is_remote() && frame.dlc() == 3);
        let mut error = CDR.to_vec();
        error[30] = 1;
        assert_eq!(
            item(Coding::Cdr, 0, 7, &error),
            Item::Skipped(Skip::ErrorFrame)
        );
    }

    #[test]
    fn what_is_no_frame_is_unreadable() {
        for cut in 0..CDR.len() {
            for coding in [Coding::Cdr, Coding::Ros1, Coding::Furrow] {
                let found = item(coding, 0, 0, &CDR[..cut]);
                assert_eq!(found, Item::Skipped(Skip::Unreadable), "{coding:?} {cut}");
            }
        }
        let mut long = CDR.to_vec();
        long[31] = 9;
        assert_eq!(
            item(Coding::Cdr, 0, 0, &long),
            Item::Skipped(Skip::Unreadable)
        );
        for own in [
            r#"{"id":2048,"data":""}"#,
            r#"{"id":1,"data":"0"}"#,
            r#"{"id":1,"data":"xy"}"#,
            r#"{"id":1,"data":"+1"}"#,
            r#"{"id":1,"data":"000000000000000000"}"#,
            "{}",
        ] {
            let found = item(Coding::Furrow, 0, 0, own.as_bytes());
            assert_eq!(found, Item::Skipped(Skip::Unreadable), "{own}");
        }
    }

    #[test]
    fn a_frame_of_a_run_is_read() {
        let own = br#"{"id":300,"data":"0A0b","remote":false,"complete":true}"#;
        let (at, frame) = frame_of(item(Coding::Furrow, 0, 7, own));
        assert_eq!((at, frame), (7, Frame::standard(300, &[10, 11]).unwrap()));
        let remote = br#"{"id":300,"data":"","remote":true,"dlc":8}"#;
        let (_, frame) = frame_of(item(Coding::Furrow, 0, 7, remote));
        assert!(frame.is_remote() && frame.dlc() == 8);
        let destroyed = br#"{"id":300,"data":"","complete":false}"#;
        assert_eq!(item(Coding::Furrow, 0, 7, destroyed), Item::Nothing);
    }
}
