//! timestamps.csv on arbitrary bytes.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = stagepose::capture::read_timestamps(bytes);
});
