//! Further ways of breaking the node: waits, calls, arrays, deadlines, pends and registers.

use std::fs;

use schedulability::report;

use super::{Change, answer, answer_to, from_package, inputs, package, said};

const IN_FILTER: &str = "let mut level = *cx.local.level;";

/// What a task does first.
macro_rules! in_filter {
    ($body:literal) => {
        &[(
            IN_FILTER,
            concat!("let mut level = *cx.local.level;\n        ", $body),
        )]
    };
}

/// The programs, as [`super::PROGRAMS`].
pub(super) const PROGRAMS: [(&str, &[Change]); 11] = [
    (
        "register",
        in_filter!(
            "// SAFETY: reading the counter of TIM3 has no effect.
        while unsafe { (0x4000_0424 as *const u32).read_volatile() } & 1 == 0 {}"
        ),
    ),
    ("tail", in_filter!("level ^= part::steps(input(), 0);")),
    (
        "variable",
        &[
            ("level: u32,", "level: u32,\n        weigh: fn(u32) -> u32,"),
            (
                "level: 0xFFFF,",
                "level: 0xFFFF,\n            weigh: |x| x / 3,",
            ),
            ("local = [level]", "local = [level, weigh]"),
            (
                IN_FILTER,
                "let mut level = (*cx.local.weigh)(*cx.local.level);\n        \
                 if input() & 1 == 0 {\n            *cx.local.weigh = |x| x / 5;\n        }",
            ),
        ],
    ),
    (
        "array",
        in_filter!(
            "let mut large = core::mem::MaybeUninit::<[u32; 20_000]>::uninit();
        core::hint::black_box(&mut large);"
        ),
    ),
    ("spin-lock", in_filter!("part::acquire();")),
    ("cleared", in_filter!("part::cleared();")),
    ("twice", in_filter!("part::twice();")),
    ("counted", in_filter!("level ^= part::count();")),
    (
        "pend-loop",
        &[(
            "rtic::pend(Interrupt::EXTI0);",
            "for _ in 0..20 {\n            rtic::pend(Interrupt::EXTI0);\n        }",
        )],
    ),
    (
        "grouped",
        &[(
            "let shared = Shared { samples: [0; 16] };",
            "// SAFETY: no interrupt is taken before the analysis refuses it.
        unsafe { cortex_m::Peripherals::steal().SCB.aircr.write(0x05FA_0500) };
        let shared = Shared { samples: [0; 16] };",
        )],
    ),
    (
        "grouped-fully",
        &[(
            "let shared = Shared { samples: [0; 16] };",
            "// SAFETY: all bits of a priority still count.
        unsafe { cortex_m::Peripherals::steal().SCB.aircr.write(0x05FA_0300) };
        let shared = Shared { samples: [0; 16] };",
        )],
    ),
];

#[test]
fn each_further_way_has_its_sentence() {
    for (program, sentence) in [
        (
            "register",
            "node.filter has no bound: the loop at src/bin/register.rs:49 (EXTI1) has no bound: write `// loop-bound: N` on the line above it, \
             where N is the most turns that it takes",
        ),
        (
            "tail",
            "node.filter has no bound: the loop at src/lib.rs:83 (EXTI1) has no bound: write `// loop-bound: N` on the line above it, \
             where N is the most turns that it takes",
        ),
        (
            "variable",
            "node.filter has no bound: the call through a pointer at src/bin/variable.rs:49 \
             (EXTI1) may go anywhere: call the function by name, or take the pointer from a \
             constant table",
        ),
        ("array", "the stack of node may take 80632 bytes of 16384"),
        (
            "spin-lock",
            "node.filter has no bound: the loop at src/lib.rs:100 (part::acquire) has no bound: write `// loop-bound: N` on the line above it, \
             where N is the most turns that it takes",
        ),
        (
            "cleared",
            "node.filter has no bound: the loop at src/lib.rs:111 (part::cleared) has no bound: write `// loop-bound: N` on the line above it, \
             where N is the most turns that it takes",
        ),
        (
            "twice",
            "node.filter has no bound: the loop at src/lib.rs:127 (part::twice) has no bound: write `// loop-bound: N` on the line above it, \
             where N is the most turns that it takes",
        ),
        // No loop but for the repetition of an interrupted store-exclusive.
        ("counted", ""),
        (
            "pend-loop",
            "node.sample does not behave as analysed, so it has no bound: it was released 5 times \
             within # us, # us after power-on in a run, and the task table allows 4",
        ),
        ("grouped-fully", ""),
    ] {
        assert_eq!(said(program), sentence, "{program}");
    }
    assert_eq!(
        from_package(&answer("grouped").unwrap_err().to_string()),
        "the image of node may group priorities (register AIRCR), so a higher one need not \
         interrupt a lower one: leave PRIGROUP at 3 or less"
    );
}

/// What has no bound is the headline, with the call and what to do.
#[test]
fn a_call_through_a_table_or_a_variable_is_the_headline() {
    for (program, line) in [("pointer", 50), ("variable", 49)] {
        let report = answer(program).unwrap();
        let text = from_package(&report::table(&report));
        let mut lines = text.lines().filter(|line| !line.is_empty());
        let head = [lines.next(), lines.next()].map(Option::unwrap_or_default);
        assert!(head[0].starts_with("without a bound"), "{head:?}");
        let head = [lines.next().unwrap_or_default(), head[1]].join(" ");
        let says = format!(
            "the call through a pointer at src/bin/{program}.rs:{line} (EXTI1) may go anywhere: call \
             the function by name, or take the pointer from a constant table"
        );
        assert!(head.contains(&says), "{head}");
    }
}

#[test]
fn a_shortened_deadline_is_missed() {
    let mut inputs = inputs("sound");
    let table = fs::read_to_string(&inputs.table).unwrap();
    let shorter = table.replace("deadline_us = 2000", "deadline_us = 20");
    assert_ne!(shorter, table);
    inputs.table = package().join("shortened.toml");
    fs::write(&inputs.table, shorter).unwrap();
    let miss = answer_to("sound", &inputs).unwrap().first_miss().unwrap();
    assert!(
        miss.starts_with("node.filter misses its deadline of 20.00 us by "),
        "{miss}"
    );
}
