//! The y4m reader on arbitrary bytes.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Ok(mut reader) = stagepose::capture::Y4mReader::new(bytes) else { return };
    while reader.next_luma().is_some() {}
});
