#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    firmware_fuzz::requests(data);
});
