//! The MJPEG splitter on arbitrary bytes.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let mut reader = stagepose::capture::MjpegReader::new(bytes);
    while reader.next_jpeg().is_some() {}
});
