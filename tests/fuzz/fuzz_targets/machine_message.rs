#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("machine_message"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("machine_message").run)(bytes);
});
