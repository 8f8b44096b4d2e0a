#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("described_plugin"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("described_plugin").run)(bytes);
});
