#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    can_bus_fuzz::mcap(data);
});
