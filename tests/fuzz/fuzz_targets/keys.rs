#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("keys"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("keys").run)(bytes);
});
