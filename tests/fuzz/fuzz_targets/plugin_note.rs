#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("plugin_note"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("plugin_note").run)(bytes);
});
