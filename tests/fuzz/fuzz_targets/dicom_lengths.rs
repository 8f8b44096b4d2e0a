#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("dicom_lengths"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("dicom_lengths").run)(bytes);
});
