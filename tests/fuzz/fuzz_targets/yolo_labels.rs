#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("yolo_labels"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("yolo_labels").run)(bytes);
});
