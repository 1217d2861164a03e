//! The functions of the fuzz targets with random bytes, and further properties.

#[path = "support/fuzzing.rs"]
#[expect(unreachable_pub, reason = "a library of its own for `fuzz/`")]
mod fuzz;

use fuzz::Said;
use proptest::prelude::*;
use ttcan::{Action, Reception};

/// Random operations reach every kind of action, and messages in their windows.
#[test]
fn operations_reach_the_schedule() {
    let mut random = 1u32;
    let mut bytes = || {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (random >> 24) as u8
    };
    let mut kinds = [false; 6];
    for _ in 0..3000 {
        let input: Vec<u8> = (0..1500).map(|_| bytes()).collect();
        for said in fuzz::operations(&input, 0) {
            let kind = match said {
                Said::Action(Action::TransmitReference(_)) => 0,
                Said::Action(Action::Transmit(_)) => 1,
                Said::Action(Action::TransmitEvent(_)) => 2,
                Said::Action(Action::Abort) => 3,
                Said::Action(Action::Silence) => 4,
                Said::Reception(Reception::Scheduled { .. }) => 5,
                _ => continue,
            };
            kinds[kind] = true;
        }
    }
    assert_eq!(kinds, [true; 6]);
}

/// Nodes of accepted configurations at the ends of their ranges, with random operations.
#[test]
fn no_accepted_configuration_overflows() {
    let mut random = 1u32;
    let mut bytes = || {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (random >> 24) as u8
    };
    let mut accepted = 0;
    for _ in 0..ROUNDS {
        let input: Vec<u8> = (0..700).map(|_| bytes()).collect();
        accepted += usize::from(fuzz::configurations(&input));
    }
    println!("{accepted} of {ROUNDS} accepted");
    assert!(accepted > ROUNDS / 10);
}

/// Random operations bring a guardian to open and close its gates.
#[test]
fn operations_reach_the_gates() {
    let mut random = 1u32;
    let mut bytes = || {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (random >> 24) as u8
    };
    let (mut accepted, mut changes) = (0, 0);
    for _ in 0..3000 {
        let input: Vec<u8> = (0..1500).map(|_| bytes()).collect();
        let Some(said) = fuzz::guardian(&input, 0) else {
            continue;
        };
        accepted += 1;
        changes += said
            .windows(2)
            .filter(|pair| pair[0].0 != pair[1].0)
            .count();
    }
    println!("{accepted} of 3000 accepted, {changes} changes of gates");
    assert!(accepted > 300 && changes > 10_000);
}

const ROUNDS: usize = 50_000;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn frames(bytes in prop::collection::vec(any::<u8>(), 0..16)) {
        fuzz::frames(&bytes);
    }

    #[test]
    fn operations(bytes in prop::collection::vec(any::<u8>(), 0..1500)) {
        fuzz::operations(&bytes, 0);
    }

    /// Guardians of any configuration; their counters may have any value, too.
    #[test]
    fn a_guardian_does_not_see_its_counter_wrap(
        bytes in prop::collection::vec(any::<u8>(), 0..1500),
        origin: u32,
    ) {
        prop_assert_eq!(fuzz::guardian(&bytes, 0), fuzz::guardian(&bytes, origin));
    }

    /// The counter may have any value at the start, and wrap at any moment.
    #[test]
    fn a_node_does_not_see_its_counter_wrap(
        bytes in prop::collection::vec(any::<u8>(), 0..1500),
        origin: u32,
    ) {
        prop_assert_eq!(fuzz::operations(&bytes, 0), fuzz::operations(&bytes, origin));
    }
}

/// The inputs in a folder of `fuzz/corpus`. The packaged crate has none.
fn corpus(target: &str) -> Vec<Vec<u8>> {
    let fuzz = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz");
    if !fuzz.is_dir() {
        return Vec::new();
    }
    let entries = std::fs::read_dir(fuzz.join("corpus").join(target)).unwrap();
    let inputs: Vec<Vec<u8>> = entries
        .map(|entry| std::fs::read(entry.unwrap().path()).unwrap())
        .collect();
    assert!(inputs.len() > 200, "{} inputs of {target}", inputs.len());
    inputs
}

/// What half an hour of fuzzing found to reach each place of the code.
#[test]
fn the_fuzzers_inputs_stay_harmless() {
    for input in corpus("operations") {
        let _ = fuzz::operations(&input, 0);
    }
    for input in corpus("guardian") {
        let _ = fuzz::guardian(&input, 0);
    }
}
