#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    mission_fuzz::csv(data);
});
