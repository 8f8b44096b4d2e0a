#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("gate"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("gate").run)(bytes);
});
