//! Reads whole logs.

use std::collections::BTreeMap;

use can_bus::log::{Entry, Format, Item, Reader, Skip};

/// Every line's item.
pub(crate) fn read(log: &[u8]) -> Vec<Item> {
    let mut items = Vec::new();
    let mut input = log;
    Reader::new()
        .read(&mut input, &mut |item| items.push(item))
        .expect("a slice can be read");
    items
}

/// The frames, with the names of their interfaces.
pub(crate) fn entries(log: &[u8]) -> Vec<(String, Entry)> {
    let mut reader = Reader::new();
    let lines = log.split(|byte| *byte == b'\n');
    let mut entries = Vec::new();
    for line in lines {
        if let Item::Frame(entry) = reader.line(line) {
            let channel = reader.channels()[usize::from(entry.channel)].clone();
            entries.push((channel, entry));
        }
    }
    entries
}

/// How often each kind of line was skipped.
pub(crate) fn kinds(log: &[u8]) -> Vec<(Skip, usize)> {
    let mut kinds = BTreeMap::new();
    for item in read(log) {
        if let Item::Skipped(skip) = item {
            *kinds.entry(skip).or_default() += 1;
        }
    }
    kinds.into_iter().collect()
}

/// The format that a log is recognised as.
pub(crate) fn format(log: &[u8]) -> Option<Format> {
    let mut reader = Reader::new();
    let mut input = log;
    reader
        .read(&mut input, &mut |_| ())
        .expect("a slice can be read");
    reader.format()
}
