#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    ttcan_fuzz::guardian(data, 0);
});
