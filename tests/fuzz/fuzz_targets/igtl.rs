#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("igtl"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("igtl").run)(bytes);
});
