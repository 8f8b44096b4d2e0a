#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("attach_message"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("attach_message").run)(bytes);
});
