//! Prose is at most 100 columns wide: comments on lines of their own, and paragraphs of documents.
//! Links of documents lead to files.

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

/// Files that a document's links and pictures name, without places in them and other sites.
fn linked(text: &str) -> impl Iterator<Item = &str> {
    let targets = text.split("](").skip(1).filter_map(|rest| rest.split_once(')'));
    targets.map(|(target, _)| target.split('#').next().unwrap_or_default()).filter(|file| !file.is_empty() && !file.contains("://"))
}

#[test]
fn links_of_documents_lead_to_files() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let files = DOCUMENTS.iter().map(|name| root.join(name)).chain(super::files_below("docs"));
    let (mut followed, mut dead) = (0, Vec::new());
    for file in files.filter(|file| file.extension().is_some_and(|e| e == "md")) {
        let text = std::fs::read_to_string(&file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        let folder = file.parent().unwrap_or(root);
        let missing = linked(&text).inspect(|_| followed += 1).filter(|name| !folder.join(name).exists());
        dead.extend(missing.map(|name| format!("{}: {name}", file.display())));
    }
    assert!(followed > 100, "only {followed} links are followed");
    assert!(dead.is_empty(), "{} links lead nowhere:\n{}", dead.len(), dead.join("\n"));
}

#[test]
fn links_are_read_without_places_and_other_sites() {
    let text = "[a](docs/a.md#part), ![b](b.jpg); [here](#part), [there](https://example.org/c.md)";
    assert_eq!(linked(text).collect::<Vec<_>>(), ["docs/a.md", "b.jpg"]);
}

#[test]
fn wide_prose_is_found() {
    let long = "word ".repeat(21);
    let source = format!("let a = 1; // {long}\n// {long}\n/// ```\n/// {long}\n/// ```\n    //! {long}\n// {}\n", "w".repeat(120));
    assert_eq!(too_wide(&source, false), [2, 6]);
    let document = format!("{long}\n\n| {long} |\n```\n{long}\n```\n- {long}\n");
    assert_eq!(too_wide(&document, true), [1, 7]);
}
