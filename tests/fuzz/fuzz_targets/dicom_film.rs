#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("dicom_film"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("dicom_film").run)(bytes);
});
