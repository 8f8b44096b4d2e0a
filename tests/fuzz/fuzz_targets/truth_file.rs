#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("truth_file"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("truth_file").run)(bytes);
});
