//! Prose is at most 100 columns wide: comments on lines of their own, and paragraphs of documents.

use std::path::Path;

/// Maximum width of prose, columns. Code may be wider (`rustfmt.toml`).
const MAX_COLUMNS: usize = 100;
/// Folders that are read, and the documents beside them.
const FOLDERS: [&str; 6] = ["src", "tests", "benches", "examples", "docs", "fixtures"];
const DOCUMENTS: [&str; 4] = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SPECIFICATION.md"];

/// The comment of a line of Rust that holds nothing else, with its marker.
fn comment(line: &str) -> Option<&str> {
    Some(line.trim_start()).filter(|text| text.starts_with("//"))
}

/// Lines of prose that are too wide, numbered from 1. Code blocks, tables, pictures and single
/// words (addresses) may be wider.
fn too_wide(text: &str, is_document: bool) -> Vec<usize> {
    let mut is_code = false;
    let mut found = Vec::new();
    for (k, line) in text.lines().enumerate() {
        let Some(prose) = (if is_document { Some(line.trim_start()) } else { comment(line) }) else {
            is_code = false;
            continue;
        };
        let words = prose.trim_start_matches(['/', '!']).trim_start();
        if words.starts_with("```") {
            is_code = !is_code;
        }
        let may_be_wide = is_code || words.starts_with(['|', '<', '[']) || words.starts_with("![") || !words.contains(' ');
        if !may_be_wide && line.chars().count() > MAX_COLUMNS {
            found.push(k + 1);
        }
    }
    found
}

#[test]
fn prose_is_at_most_100_columns_wide() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let files = DOCUMENTS.iter().map(|name| root.join(name)).chain(FOLDERS.into_iter().flat_map(super::files_below));
    let (mut read, mut wide) = (0, Vec::new());
    for file in files {
        let is_document = file.extension().is_some_and(|e| e == "md");
        if !is_document && file.extension().is_none_or(|e| e != "rs") {
            continue;
        }
        let text = std::fs::read_to_string(&file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        let place = file.strip_prefix(root).unwrap_or(&file).display();
        wide.extend(too_wide(&text, is_document).into_iter().map(|line| format!("{place}:{line}")));
        read += 1;
    }
    assert!(read > 700, "only {read} files are read");
    assert!(wide.is_empty(), "{} lines of prose are wider than {MAX_COLUMNS} columns:\n{}", wide.len(), wide.join("\n"));
}

#[test]
fn wide_prose_is_found() {
    let long = "word ".repeat(21);
    let source = format!("let a = 1; // {long}\n// {long}\n/// ```\n/// {long}\n/// ```\n    //! {long}\n// {}\n", "w".repeat(120));
    assert_eq!(too_wide(&source, false), [2, 6]);
    let document = format!("{long}\n\n| {long} |\n```\n{long}\n```\n- {long}\n");
    assert_eq!(too_wide(&document, true), [1, 7]);
}
