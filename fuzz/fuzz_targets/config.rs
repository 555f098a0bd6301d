//! Any text as a config: it is refused with a message or read, and never panics.
#![no_main]

use std::path::Path;

libfuzzer_sys::fuzz_target!(|text: &str| {
    if let Err(error) = stagepose::config::as_typed::Config::parse(text, Path::new("stage.toml")) {
        assert!(!error.to_string().is_empty());
    }
});
