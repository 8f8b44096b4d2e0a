#![no_main]

libfuzzer_sys::fuzz_target!(init: panoscope_fuzz_targets::begin("webrtc_offer"), |bytes: &[u8]| {
    (panoscope_fuzz_targets::target("webrtc_offer").run)(bytes);
});
