#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("guard_message"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("guard_message").run)(bytes);
});
