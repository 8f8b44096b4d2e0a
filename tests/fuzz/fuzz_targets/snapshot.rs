#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("snapshot"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("snapshot").run)(bytes);
});
