#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("pedal"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("pedal").run)(bytes);
});
