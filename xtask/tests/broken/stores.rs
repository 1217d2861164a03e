//! Stores that only a run shows: through a pointer of which the analysis knows nothing, to what it takes
//! for constant.

use std::sync::Arc;

use schedulability::system::Programs;
use twin::mcu::{Board, Mcu};
use twin::part::Part;
use wcet::image::Image;

use super::{Change, answer, from_package, image, inputs};

/// A resource that is the address of a table, which start-up leaves in memory; a task reads the table.
macro_rules! with_table {
    ($body:literal) => {
        &[
            ("level: u32,", "level: u32,\n        table: &'static [u32; 16],"),
            (
                "level: 0xFFFF,",
                "level: 0xFFFF,\n            table: part::table(),",
            ),
            ("local = [level]", "local = [level, table]"),
            (
                "let mut level = *cx.local.level;",
                concat!(
                    "let mut level = *cx.local.level ^ cx.local.table[samples[0] as usize % 16];\n        ",
                    $body
                ),
            ),
        ]
    };
}

/// The programs, as [`super::PROGRAMS`].
pub(super) const PROGRAMS: [(&str, &[Change]); 3] = [
    ("table", with_table!("")),
    (
        "restored",
        with_table!(
            "// Through memory, so that the pointer is unknown to the analysis.
        output(core::ptr::from_mut(cx.local.table) as u32);
        part::flicker(part::last());"
        ),
    ),
    (
        "regrouped",
        with_table!(
            "// The priority of EXTI2, and back again.
        output(0xE000_E408);
        part::flicker(part::last());"
        ),
    ),
];

/// What a run shows of stores, and the place of the function that makes them.
fn strays(program: &str) -> Vec<String> {
    let programs = Programs::read(&inputs(program), &|_| {}).unwrap();
    let known = programs.known("node");
    assert!(!known.lasting.is_empty(), "{program}");
    let elf = std::fs::read(image(program)).unwrap();
    let on_part = twin::image::Image::from_elf(Part::F446, &elf).unwrap();
    let mut mcu = Mcu::new(Arc::new(on_part), &Board::default(), None);
    let watches = programs.watches("node").map(|(_, watch)| watch);
    let findings = observer::follow(&mut mcu, watches, known, 0);
    mcu.run_for(can_bus::SimDuration::from_ticks(100_000_000_000));
    let image = Image::read(&image(program)).unwrap();
    let findings = observer::follower::lock(&findings);
    let all = findings.stray.iter();
    all.map(|stray| from_package(&stray.sentence(&image)))
        .collect()
}

/// A word is changed and put back before the handler ends, and so is a priority: the state at the end of
/// the run is that of the analysis.
#[test]
fn what_is_changed_and_put_back_is_seen_at_the_store() {
    assert_eq!(strays("table"), [""; 0]);
    let seen = ["restored", "regrouped"].map(strays);
    for sentences in &seen {
        assert_eq!(sentences.len(), 2, "{sentences:?}");
    }
    for (sentence, begin, end) in [
        (&seen[0][0], "src/lib.rs:", " for good"),
        (
            &seen[1][0],
            "src/lib.rs:",
            ", by a store to 0xe000e408 after start-up",
        ),
    ] {
        assert!(
            sentence.starts_with(begin) && sentence.ends_with(end),
            "{sentence}"
        );
    }
    let by_name = "stores to restored::app::__rtic_internal_local_resource_table";
    assert!(seen[0][0].contains(by_name), "{seen:?}");
    // Without the run there is nothing to see.
    for program in ["restored", "regrouped"] {
        assert_eq!(answer(program).unwrap().first_miss(), None, "{program}");
    }
}
