#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("audit"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("audit").run)(bytes);
});
