//! MCAP files: written by the library, then damaged.

use std::collections::BTreeMap;
use std::io::Cursor;

use can_bus::log::{Item, Skip, mcap::Error};
use mcap::records::MessageHeader;
use proptest::prelude::*;

use crate::fuzz;

/// A file with one frame on each of so many topics.
fn written(topics: u16, chunk_size: Option<u64>) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let options = mcap::WriteOptions::new()
        .compression(None)
        .chunk_size(chunk_size);
    let mut writer = options.create(&mut file).unwrap();
    let schema = writer
        .add_schema("furrow.Frame", "jsonschema", b"{}")
        .unwrap();
    for topic in 0..topics {
        let name = format!("/can/{topic}");
        let channel_id = writer
            .add_channel(schema, &name, "json", &BTreeMap::new())
            .unwrap();
        let header = MessageHeader {
            channel_id,
            sequence: u32::from(topic),
            log_time: 1_000 * u64::from(topic),
            publish_time: 0,
        };
        let frame = br#"{"id":100,"data":"0001"}"#;
        writer.write_to_known_channel(&header, frame).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    file.into_inner()
}

fn frames(items: &[Item]) -> usize {
    let frames = items.iter().filter(|item| matches!(item, Item::Frame(_)));
    frames.count()
}

#[test]
fn a_written_file_is_read() {
    for chunk_size in [None, Some(1), Some(1 << 20)] {
        let items = fuzz::mcap(&written(3, chunk_size)).unwrap();
        assert_eq!((items.len(), frames(&items)), (3, 3), "{chunk_size:?}");
    }
}

#[test]
fn frames_of_too_many_topics_are_counted() {
    let items = fuzz::mcap(&written(66, None)).unwrap();
    assert_eq!(frames(&items), 64);
    let beyond = Item::Skipped(Skip::Interface);
    assert_eq!(items.iter().filter(|item| **item == beyond).count(), 2);
}

#[test]
fn what_follows_the_end_is_refused() {
    let one = written(1, None);
    for rest in [&b"x"[..], &one] {
        let both = [&one, rest].concat();
        assert!(matches!(fuzz::mcap(&both), Err(Error::GoesOn)), "{rest:?}");
    }
}

proptest! {
    #[test]
    fn any_bytes_are_read(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        prop_assert!(fuzz::mcap(&bytes).is_err());
    }

    #[test]
    fn any_damage_is_read(
        chunk_size in prop::option::of(1..200_u64),
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..8),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let mut bytes = written(4, chunk_size);
        let whole = bytes.clone();
        for (at, byte) in &damage {
            let at = at.index(bytes.len());
            bytes[at] = *byte;
        }
        let end = cut.map_or(bytes.len(), |cut| cut.index(bytes.len()));
        let read = fuzz::mcap(&bytes[..end]);
        if end < whole.len() {
            prop_assert!(read.is_err());
        } else if bytes == whole {
            prop_assert!(read.is_ok());
        }
    }
}
