//! Every calibration form on arbitrary bytes.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    for name in ["c.toml", "c.yml", "c.m", "c"] {
        let _ = stagepose::camera::parse_calibration(bytes, name.as_ref());
    }
});
