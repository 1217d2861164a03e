//! The fuzz targets as functions of the fuzzer's bytes. The tests of the crate call them with
//! random bytes, because a fuzzer needs a nightly toolchain.

use can_bus::log::{Item, Reader, mcap};
use can_bus::slcan::{Answer, Decoder, encode};

/// All answers in the bytes of a serial port. Every frame among them must be read back as it is
/// written.
pub fn slcan(bytes: &[u8]) -> Vec<Answer> {
    let mut decoder = Decoder::new();
    let answers: Vec<Answer> = bytes
        .iter()
        .filter_map(|byte| decoder.push(*byte))
        .collect();
    for answer in &answers {
        if let Answer::Frame { frame, .. } = answer {
            let mut decoder = Decoder::new();
            let line = encode(frame);
            let again: Vec<Answer> = line.bytes().filter_map(|b| decoder.push(b)).collect();
            let same = Answer::Frame {
                frame: *frame,
                stamp: None,
            };
            assert_eq!(again, [same]);
        }
    }
    answers
}

/// All lines of a log. A frame among them must name an interface of the reader, and a log with a frame
/// has a format.
pub fn log(bytes: &[u8]) -> Vec<Item> {
    let mut reader = Reader::new();
    let mut items = Vec::new();
    let mut input = bytes;
    reader
        .read(&mut input, &mut |item| items.push(item))
        .expect("bytes can be read");
    for item in &items {
        if let Item::Frame(entry) = item {
            assert!(usize::from(entry.channel) < reader.channels().len());
            assert!(reader.format().is_some());
        }
    }
    items
}

/// All frames of an MCAP file. One of them must name a topic of the reader, and a file that is read to its
/// end has one.
pub fn mcap(bytes: &[u8]) -> Result<Vec<Item>, mcap::Error> {
    let mut reader = mcap::Reader::default();
    let mut items = Vec::new();
    let mut input = bytes;
    let end = reader.read(&mut input, &mut |item| items.push(item));
    for item in &items {
        if let Item::Frame(entry) = item {
            assert!(usize::from(entry.channel) < reader.topics().len());
        }
    }
    end?;
    assert!(!reader.topics().is_empty());
    Ok(items)
}
