//! The avi reader on arbitrary bytes.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Ok(mut reader) = stagepose::capture::AviReader::new(bytes) else { return };
    while reader.next_jpeg().is_some() {}
});
