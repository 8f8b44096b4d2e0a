#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("ros_message"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("ros_message").run)(bytes);
});
