//! Words that keep the address which start-up wrote to them.

use crate::common::{image_path, kernel};
use wcet::analysis::Analysis;
use wcet::annotation::Annotations;
use wcet::bound::{Bound, Entry};
use wcet::cycles::Cycles;
use wcet::image::Image;
use wcet::lasting::UnknownStores::{self, ClobberAll, SparePointers};
use wcet::timing::Timing;

/// The number of words that last with these handlers, and the bound of the first handler.
fn learn(handlers: &[&str], unknown_stores: UnknownStores) -> (usize, Bound) {
    let image = Image::read(image_path()).unwrap();
    let annotations = Annotations::new(std::path::Path::new(env!("CARGO_MANIFEST_DIR")));
    let mut analysis = Analysis::new(&image, &annotations, Timing::flashed(parts::Sled::F446));
    let at = |name: &&str| kernel(&image, &format!("start::{name}"));
    let handlers: Vec<u32> = handlers.iter().map(at).collect();
    let words = analysis
        .learn(at(&"set_up"), &handlers, unknown_stores)
        .len();
    let bound = analysis.run(handlers[0], Entry::Handler);
    assert!(bound.problems.is_empty(), "{:?}", bound.problems);
    (words, bound)
}

/// A pointer in RAM leads to eight words of RAM. If the analysis knows that, each word costs two
/// cycles, and not as much as a peripheral.
#[test]
fn a_pointer_set_at_the_start_leads_to_known_memory() {
    let (words, bound) = learn(&["use_pointer", "use_index"], ClobberAll);
    assert_eq!(words, 1);
    let (_, unknown) = learn(&["use_pointer", "write_anywhere"], ClobberAll);
    let Cycles { zero_wait, flashed } = bound.cycles;
    assert_eq!(zero_wait, unknown.cycles.zero_wait);
    assert!(flashed < 3 * zero_wait, "{:?}", bound.cycles);
    assert!(
        flashed + 16 * 10 < unknown.cycles.flashed,
        "{flashed} {unknown:?}"
    );
}

#[test]
fn a_word_that_a_handler_may_change_does_not_last() {
    assert_eq!(learn(&["use_pointer", "move_pointer"], ClobberAll).0, 0);
    assert_eq!(learn(&["use_pointer", "write_anywhere"], ClobberAll).0, 0);
}

/// Stores through unresolved pointers spare the word if that is allowed. A store that is known to
/// reach the word does not.
#[test]
fn unresolved_pointers_may_be_taken_to_spare_a_word() {
    let (words, bound) = learn(&["use_pointer", "write_anywhere"], SparePointers);
    assert_eq!(words, 1);
    assert!(
        bound.cycles.flashed < 3 * bound.cycles.zero_wait,
        "{:?}",
        bound.cycles
    );
    let all = ["use_pointer", "write_anywhere", "move_pointer"];
    assert_eq!(learn(&all, SparePointers).0, 0);
}
