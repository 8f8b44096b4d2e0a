#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("rtde"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("rtde").run)(bytes);
});
