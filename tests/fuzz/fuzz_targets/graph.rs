#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("graph"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("graph").run)(bytes);
});
