#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("isolated_call"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("isolated_call").run)(bytes);
});
