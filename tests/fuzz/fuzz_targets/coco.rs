#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("coco"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("coco").run)(bytes);
});
