//! The fuzz target with random bytes. `cargo +nightly fuzz run protection` in `firmware` runs more.

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
