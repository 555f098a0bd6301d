//! Checks that no source silences the warnings about what nothing uses.

use std::path::{Path, PathBuf};

/// Folders of sources.
const FOLDERS: [&str; 4] = ["src", "tests", "benches", "examples"];

fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display())) {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            collect(&path, files);
        } else if path.extension().is_some_and(|e| e == "rs") {
            files.push(path);
        }
    }
}

#[test]
fn nothing_silences_warnings_about_unused_code() {
    // Put together here, so that the search does not find itself.
    let lints = [["dead", "code"], ["unused", "imports"]].map(|words| words.join("_"));
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = Vec::new();
    FOLDERS.iter().for_each(|folder| collect(&root.join(folder), &mut files));
    assert!(files.len() > 500, "the reader sees only {} files", files.len());
    let names_one = |file: &&PathBuf| std::fs::read_to_string(file).is_ok_and(|text| lints.iter().any(|lint| text.contains(lint.as_str())));
    let silent: Vec<_> = files.iter().filter(names_one).collect();
    assert!(silent.is_empty(), "compile what only a feature uses with that feature instead: {silent:#?}");
}
