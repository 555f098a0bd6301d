//! Checks that no source silences the warnings about what nothing uses.

use std::path::PathBuf;

/// Folders of sources.
const FOLDERS: [&str; 4] = ["src", "tests", "benches", "examples"];

#[test]
fn nothing_silences_warnings_about_unused_code() {
    // Put together here, so that the search does not find itself.
    let lints = [["dead", "code"], ["unused", "imports"]].map(|words| words.join("_"));
    let is_source = |file: &PathBuf| file.extension().is_some_and(|e| e == "rs");
    let files: Vec<PathBuf> = FOLDERS.into_iter().flat_map(super::files_below).filter(is_source).collect();
    assert!(files.len() > 500, "the reader sees only {} files", files.len());
    let names_one = |file: &&PathBuf| std::fs::read_to_string(file).is_ok_and(|text| lints.iter().any(|lint| text.contains(lint.as_str())));
    let silent: Vec<_> = files.iter().filter(names_one).collect();
    assert!(silent.is_empty(), "compile what only a feature uses with that feature instead: {silent:#?}");
}
