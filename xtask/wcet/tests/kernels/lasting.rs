//! Words that keep the address which start-up wrote to them.

use crate::common::{PART, image_path, kernel};
use wcet::analysis::Analysis;
use wcet::annotation::Annotations;
use wcet::bound::{Bound, Entry};
use wcet::cycles::Cycles;
use wcet::image::Image;
use wcet::lasting::Known;
use wcet::lasting::UnknownStores::{self, ClobberAll, SparePointers};

/// The number of words that last with these handlers, and the bound of the first handler.
fn learn(handlers: &[&str], unknown_stores: UnknownStores) -> (usize, Bound) {
    let (known, bound) = known(handlers, unknown_stores);
    (known.lasting.len(), bound)
}

/// What is known of memory with these handlers, and the bound of the first handler.
fn known(handlers: &[&str], unknown_stores: UnknownStores) -> (Known, Bound) {
    let image = Image::read(image_path()).unwrap();
    let annotations = Annotations::new(std::path::Path::new(env!("CARGO_MANIFEST_DIR")));
    let mut analysis = Analysis::new(&image, &annotations, &PART);
    let at = |name: &&str| kernel(&image, &format!("start::{name}"));
    let handlers: Vec<u32> = handlers.iter().map(at).collect();
    let known = analysis.learn(at(&"set_up"), &handlers, unknown_stores);
    let bound = analysis.run(handlers[0], Entry::Handler);
    assert!(bound.problems.is_empty(), "{:?}", bound.problems);
    (known, bound)
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

/// What is computed from an array's address is not charged as an access to a peripheral, whatever the index is.
#[test]
fn an_unknown_index_stays_in_its_array() {
    let (_, bound) = learn(&["use_any_index"], ClobberAll);
    let Cycles { zero_wait, flashed } = bound.cycles;
    assert!(flashed < 3 * zero_wait, "{:?}", bound.cycles);
}

#[test]
fn a_word_that_a_handler_may_change_does_not_last() {
    assert_eq!(learn(&["use_pointer", "move_pointer"], ClobberAll).0, 0);
    assert_eq!(learn(&["use_pointer", "write_anywhere"], ClobberAll).0, 0);
}

/// A handler may set a pointer to what start-up has left in another word, or to one of a few addresses.
#[test]
fn a_word_that_handlers_set_to_few_addresses_leads_to_them() {
    for (others, choices) in [
        (&["choose"][..], 2),
        (&["choose", "choose_another"], 3),
        (&["choose", "choose_anything"], 0),
        (&["choose", "write_anywhere"], 2),
    ] {
        let handlers: Vec<&str> = ["use_choice"].iter().chain(others).copied().collect();
        let (known, bound) = known(&handlers, SparePointers);
        let found: Vec<usize> = known
            .choices
            .values()
            .map(std::collections::BTreeSet::len)
            .collect();
        assert_eq!(
            found,
            Vec::from_iter((choices > 0).then_some(choices)),
            "{others:?}"
        );
        let Cycles { zero_wait, flashed } = bound.cycles;
        assert_eq!(
            flashed < 3 * zero_wait,
            choices > 0,
            "{others:?}: {:?}",
            bound.cycles
        );
    }
}

/// The compiler folds the least index into the address of the array, so that it seems to be one of another variable,
/// or of none.
#[test]
fn an_unknown_index_may_change_any_word_of_an_array() {
    let image = Image::read(image_path()).unwrap();
    let annotations = Annotations::new(std::path::Path::new(env!("CARGO_MANIFEST_DIR")));
    let at = |name: &str| kernel(&image, &format!("start::{name}"));
    for (other, words) in [
        ("use_index", 1),
        ("write_anywhere", 1),
        ("move_any_element", 0),
        ("move_folded_element", 0),
        ("move_far_folded_element", 0),
    ] {
        let mut analysis = Analysis::new(&image, &annotations, &PART);
        let handlers = [at("use_element"), at(other)];
        let known = analysis.learn(at("set_up_an_element"), &handlers, SparePointers);
        assert_eq!(known.lasting.len(), words, "{other}");
    }
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

/// The start lasts until the first task can run. Until then its words last, and what it masks blocks
/// nobody.
#[test]
fn the_start_lasts_until_a_task_can_run() {
    let image = Image::read(image_path()).unwrap();
    let annotations = Annotations::new(std::path::Path::new(env!("CARGO_MANIFEST_DIR")));
    let mut analysis = Analysis::new(&image, &annotations, &PART);
    let at = |name: &str| kernel(&image, &format!("start::{name}"));
    let handlers = [at("use_pointer")];
    for (name, words, sections) in [
        ("set_up", 1, 0),
        ("set_up_with_an_alarm", 1, 0),
        ("set_up_with_a_task", 0, 2),
        ("set_up_by_the_mask_before", 0, 1),
        ("set_up_on_two_paths", 0, 2),
        ("set_up_if_unclaimed", 1, 0),
        ("set_up_if_still_unclaimed", 0, 0),
        ("set_up_in_parts", 1, 0),
        ("set_up_in_parts_but_one", 0, 0),
    ] {
        let bound = analysis.run(at(name), Entry::Program);
        assert_eq!(
            bound.sections.len(),
            sections,
            "{name}: {:?}",
            bound.sections
        );
        let known = analysis.learn(at(name), &handlers, ClobberAll);
        let found = known.lasting.len();
        assert_eq!(found, words, "{name}");
    }
}

/// The halves of an address may stand apart, but the halves of two numbers do not make one.
#[test]
fn a_pointer_is_made_of_halves_that_meet_in_a_register() {
    let image = Image::read(image_path()).unwrap();
    let taken = wcet::software::taken(&image);
    let is_taken = |name: &str| {
        let mut functions = taken.iter().map(|at| image.name(*at));
        functions.any(|function| function == format!("kernels::start::{name}"))
    };
    assert!(is_taken("taken"));
    assert!(!is_taken("never_taken"));
}
