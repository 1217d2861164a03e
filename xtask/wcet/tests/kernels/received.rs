//! Handlers of which it is known what they read from a device.

use crate::common::{PART, image_path, kernel};
use wcet::analysis::Analysis;
use wcet::annotation::Annotations;
use wcet::bound::Entry;
use wcet::image::Image;
use wcet::reading::Reading;

const URGENT: u32 = 100 << 21;
const OTHER: u32 = 200 << 21;
/// Cycles of the path that only the urgent identifier takes: 100 turns, each of three cycles or more.
const WORK: u64 = 300;

/// The bounds of a handler, without wait states: of any job, and of those that read this word.
fn bounds(name: &str, word: u32) -> (u64, u64) {
    let image = Image::read(image_path()).unwrap();
    let annotations = Annotations::new(std::path::Path::new(env!("CARGO_MANIFEST_DIR")));
    let mut analysis = Analysis::new(&image, &annotations, &PART);
    let entry = kernel(&image, &format!("received::{name}"));
    let reading = Reading {
        register: 0x4000_65b0,
        word,
        until: (0x4000_640c, 1 << 5),
    };
    let any = analysis.run(entry, Entry::Handler);
    let one = analysis.run_reading(entry, reading);
    assert!(any.problems.is_empty(), "{:?}", any.problems);
    assert!(one.problems.is_empty(), "{:?}", one.problems);
    (any.cycles.zero_wait, one.cycles.zero_wait)
}

/// The store that clears a flag of the FIFO in front of the read releases nothing.
#[test]
fn a_job_takes_the_paths_that_its_identifier_allows() {
    let (any, urgent) = bounds("take", URGENT);
    assert_eq!(urgent, any);
    let (any, other) = bounds("take", OTHER);
    assert!(other + WORK < any, "{other} of {any}");
}

#[test]
fn behind_a_release_the_identifier_is_not_known() {
    for name in ["take_next", "take_by_mask"] {
        let (any, other) = bounds(name, OTHER);
        assert_eq!(other, any, "{name}");
    }
    // The second of two frames may be the urgent one.
    let (any, urgent) = bounds("take_two", URGENT);
    assert!(urgent <= any && urgent > 2 * WORK, "{urgent} of {any}");
    let (any, other) = bounds("take_two", OTHER);
    assert!(other + WORK < any && other > WORK, "{other} of {any}");
}

#[test]
fn one_path_that_releases_is_enough() {
    let (any, skipped) = bounds("take_or_skip", 0);
    assert!(skipped <= any && skipped > WORK, "{skipped} of {any}");
    let (any, other) = bounds("take_or_skip", OTHER);
    assert!(other + WORK < any, "{other} of {any}");
}
