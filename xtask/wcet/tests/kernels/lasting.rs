//! Words that start-up sets for good.

use crate::common::{image_path, kernel};
use wcet::analysis::{Analysis, Bound, Entry};
use wcet::annotation::Annotations;
use wcet::image::Image;
use wcet::lasting::Strangers::{self, Change, Spare};
use wcet::timing::Timing;

/// How many words last beside these handlers, and the bound of the first.
fn learn(handlers: &[&str], strangers: Strangers) -> (usize, Bound) {
    let image = Image::read(image_path()).unwrap();
    let annotations = Annotations::new(std::path::Path::new(env!("CARGO_MANIFEST_DIR")));
    let mut analysis = Analysis::new(&image, &annotations, Timing::flashed(parts::Sled::F446));
    let at = |name: &&str| kernel(&image, &format!("start::{name}"));
    let handlers: Vec<u32> = handlers.iter().map(at).collect();
    let words = analysis.learn(at(&"set_up"), &handlers, strangers).len();
    let bound = analysis.run(handlers[0], Entry::Handler);
    assert!(bound.problems.is_empty(), "{:?}", bound.problems);
    (words, bound)
}

/// Eight words of RAM behind a pointer from RAM: known to be RAM, they cost
/// two cycles each, not what a peripheral costs.
#[test]
fn a_pointer_set_at_the_start_leads_to_known_memory() {
    let (words, bound) = learn(&["use_pointer", "use_index"], Change);
    assert_eq!(words, 1);
    let (_, unknown) = learn(&["use_pointer", "write_anywhere"], Change);
    let [zero, flashed] = bound.cycles;
    assert_eq!(zero, unknown.cycles[0]);
    assert!(flashed < 3 * zero, "{:?}", bound.cycles);
    assert!(
        flashed + 16 * 10 < unknown.cycles[1],
        "{flashed} {unknown:?}"
    );
}

#[test]
fn what_a_handler_may_change_does_not_last() {
    assert_eq!(learn(&["use_pointer", "move_pointer"], Change).0, 0);
    assert_eq!(learn(&["use_pointer", "write_anywhere"], Change).0, 0);
}

/// Only where it is allowed: what is known to be changed is changed.
#[test]
fn pointers_of_which_nothing_is_known_may_be_taken_to_spare_it() {
    let (words, bound) = learn(&["use_pointer", "write_anywhere"], Spare);
    assert_eq!(words, 1);
    assert!(bound.cycles[1] < 3 * bound.cycles[0], "{:?}", bound.cycles);
    let all = ["use_pointer", "write_anywhere", "move_pointer"];
    assert_eq!(learn(&all, Spare).0, 0);
}
