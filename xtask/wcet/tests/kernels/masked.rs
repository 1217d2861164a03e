//! Critical sections of start-up and idle code, and masks that a handler leaves behind.

use std::path::Path;

use crate::common::{PART, image_path, kernel};
use wcet::analysis::Analysis;
use wcet::annotation::Annotations;
use wcet::bound::{Bound, Entry};
use wcet::image::Image;
use wcet::mask::Level;

fn bound(name: &str, kind: Entry) -> Bound {
    let image = Image::read(image_path()).unwrap();
    let annotations = Annotations::new(Path::new(env!("CARGO_MANIFEST_DIR")));
    let mut analysis = Analysis::new(&image, &annotations, &PART);
    let entry = kernel(&image, &format!("masked::{name}"));
    analysis.run(entry, kind)
}

/// The only problem of a program or handler.
fn problem(name: &str, kind: Entry) -> String {
    let problems = bound(name, kind).problems;
    assert_eq!(problems.len(), 1, "{name}: {problems:?}");
    problems.first().unwrap().to_string()
}

/// A wait while tasks are masked blocks them for an unknown time, however they are masked.
#[test]
fn a_masked_wait_needs_a_bound() {
    for name in [
        "wait_by_primask",
        "wait_by_faultmask",
        "wait_by_faultmask_register",
        "wait_by_basepri",
        "wait_by_basepri_max",
        "wait_in_a_call",
        "wait_across_turns",
        "wait_for_good",
    ] {
        let problem = problem(name, Entry::Program);
        assert!(problem.starts_with("the loop at "), "{name}: {problem}");
        assert!(
            problem.contains(" has no bound, and interrupts are masked in it since xtask/wcet/kernels/src/masked.rs:"),
            "{name}: {problem}"
        );
    }
}

/// Before a task can run, and where none is masked, a wait delays nobody.
#[test]
fn other_waits_need_none() {
    for name in ["wait_at_the_start", "wait_unmasked"] {
        let bound = bound(name, Entry::Program);
        assert!(bound.problems.is_empty(), "{name}: {:?}", bound.problems);
        assert_eq!(bound.sections, [], "{name}");
    }
}

/// Each of the 3000 turns is a `NOP`, a subtraction and a branch at least.
#[test]
fn a_masked_loop_is_charged_all_its_turns() {
    for (name, level) in [
        ("count_by_primask", Level::All),
        ("count_by_faultmask", Level::Faults),
    ] {
        let bound = bound(name, Entry::Program);
        assert!(bound.problems.is_empty(), "{name}: {:?}", bound.problems);
        let [section] = bound.sections[..] else {
            panic!("{name}: {:?}", bound.sections);
        };
        assert_eq!(section.level, level, "{name}");
        assert!(section.cycles.zero_wait > 3000 * 4, "{name}: {section:?}");
    }
}

/// `WFI` wakes by an interrupt that `PRIMASK` masks, and by none that `BASEPRI` masks.
#[test]
fn sleep_that_no_masked_interrupt_ends_is_refused() {
    let bound = bound("sleep_by_primask", Entry::Program);
    assert!(bound.problems.is_empty(), "{:?}", bound.problems);
    for (name, kind) in [
        ("sleep_by_basepri", Entry::Program),
        ("wait_for_event_by_primask", Entry::Program),
        ("sleep_in_a_handler", Entry::Handler),
    ] {
        let problem = problem(name, kind);
        assert!(
            problem.starts_with("the core sleeps at xtask/wcet/kernels/src/masked.rs:"),
            "{problem}"
        );
    }
}

/// The return from a handler restores neither `PRIMASK` nor `BASEPRI`.
#[test]
fn a_handler_must_unmask_what_it_masks() {
    for name in ["return_masked", "return_raised"] {
        let problem = problem(name, Entry::Handler);
        assert!(
            problem.starts_with("the mask that is set at xtask/wcet/kernels/src/masked.rs:"),
            "{problem}"
        );
    }
    for name in ["return_faultmask", "lock"] {
        let bound = bound(name, Entry::Handler);
        assert!(bound.problems.is_empty(), "{name}: {:?}", bound.problems);
        assert_eq!(bound.sections.len(), 1, "{name}");
    }
}

/// A write that masks less than is masked changes nothing, so the word that is read after it is the one
/// that was there before.
#[test]
fn a_weaker_section_does_not_end_a_stronger_one() {
    let bound = bound("nest_lower", Entry::Handler);
    assert!(bound.problems.is_empty(), "{:?}", bound.problems);
    let [section] = bound.sections[..] else {
        panic!("{:?}", bound.sections);
    };
    assert_eq!(section.level, Level::From(0x20));
    assert!(section.cycles.zero_wait > 3000 * 4, "{section:?}");
}

/// Tasks that one mask after the other keeps waiting wait for all of them.
#[test]
fn a_section_goes_on_where_another_mask_takes_over() {
    let longest = |name: &str, level: Level| {
        let bound = bound(name, Entry::Handler);
        assert!(bound.problems.is_empty(), "{name}: {:?}", bound.problems);
        let sections = bound
            .sections
            .iter()
            .filter(|section| section.level == level);
        sections
            .map(|section| section.cycles.zero_wait)
            .max()
            .unwrap()
    };
    // Each part is a loop of 3000 turns, as in `nest_lower`.
    let part = longest("nest_lower", Level::From(0x20));
    assert!(longest("hand_down", Level::From(0x20)) < 2 * part - 3000);
    assert!(longest("hand_down", Level::From(0x50)) > 2 * part - 3000);
    assert!(longest("hand_round", Level::From(0x50)) > 3 * part - 3000);
    assert!(longest("hand_round", Level::All) < 2 * part - 3000);
}

/// Only the word that a handler found in `BASEPRI` certainly ends its sections.
#[test]
fn an_unknown_word_does_not_unmask() {
    for name in ["restore_unknown", "raise_to_unknown", "restore_overwritten"] {
        let problems = bound(name, Entry::Handler).problems;
        assert!(
            problems.iter().any(|problem| {
                problem.to_string().starts_with(
                "the interrupt mask is set to an unknown level at xtask/wcet/kernels/src/masked.rs:"
            )
            }),
            "{name}: {problems:?}"
        );
    }
}

/// The word is found again beside an array on the stack, and is taken to be out of reach of unknown
/// pointers.
#[test]
fn the_word_that_was_found_unmasks() {
    for name in ["restore_beside_checked_index", "restore_past_pointer"] {
        let bound = bound(name, Entry::Handler);
        assert!(bound.problems.is_empty(), "{name}: {:?}", bound.problems);
        assert_eq!(bound.sections.len(), 1, "{name}");
    }
}

/// What was read from `PRIMASK`, and what a function saves, is out of reach of unknown pointers, too.
#[test]
fn what_is_kept_past_an_unknown_pointer_is_known_behind_it() {
    for name in ["unmask_past_pointer", "count_past_pointer"] {
        let bound = bound(name, Entry::Program);
        assert!(bound.problems.is_empty(), "{name}: {:?}", bound.problems);
        assert_eq!(bound.sections.len(), 1, "{name}");
    }
}

/// An interrupt that is disabled delays its task like a mask.
#[test]
fn an_interrupt_must_not_be_disabled() {
    let problem = problem("disable_interrupt", Entry::Handler);
    assert!(
        problem.starts_with(
            "an interrupt is disabled in the interrupt controller at \
             xtask/wcet/kernels/src/masked.rs:"
        ),
        "{problem}"
    );
}
