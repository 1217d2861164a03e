#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let _ = ttcan_fuzz::configurations(data);
});
