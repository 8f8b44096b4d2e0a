#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("arm_line"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("arm_line").run)(bytes);
});
