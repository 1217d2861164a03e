//! The fuzz targets with random bytes. `cargo +nightly fuzz run protection` in `firmware`, or `requests`, runs more.

#[path = "support/fuzzing.rs"]
#[expect(unreachable_pub, reason = "a library of its own for `fuzz/`")]
mod fuzzing;

use proptest::prelude::*;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn no_sequence_lets_a_forged_frame_pass(
        steps in proptest::collection::vec((any::<u8>(), any::<[u8; 8]>()), 0..300),
    ) {
        let bytes = steps.iter().flat_map(|(code, data)| std::iter::once(*code).chain(*data));
        fuzzing::protection(&bytes.collect::<Vec<u8>>());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn no_requests_do_what_the_situation_forbids(
        first: u8, steps in proptest::collection::vec((any::<u8>(), any::<[u8; 8]>()), 0..60),
    ) {
        let steps = steps.iter().flat_map(|(code, data)| std::iter::once(*code).chain(*data));
        let bytes: Vec<u8> = std::iter::once(first).chain(steps).collect();
        fuzzing::requests(&bytes);
    }
}

/// What half an hour of fuzzing found to reach each place of the code, and two inputs that guess tags.
#[test]
fn the_fuzzers_inputs_stay_harmless() {
    let corpus = concat!(env!("CARGO_MANIFEST_DIR"), "/fuzz/corpus/protection");
    let mut count = 0;
    for entry in std::fs::read_dir(corpus).unwrap() {
        let input = std::fs::read(entry.unwrap().path()).unwrap();
        fuzzing::protection(&input);
        count += 1;
    }
    assert!(count > 10, "{count} inputs");
}
