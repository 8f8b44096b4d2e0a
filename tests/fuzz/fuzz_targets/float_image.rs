#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("float_image"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("float_image").run)(bytes);
});
