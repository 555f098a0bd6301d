//! SPECIFICATION.md names a test for every promise, and each must exist. So must the files that
//! other documents refer to.

use std::collections::BTreeSet;
use std::path::Path;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// Returns what a row names in backquotes in its last column: `path` or `path::name`.
fn named(row: &str) -> Vec<&str> {
    let last = row.trim_end_matches(" |").rsplit(" | ").next().unwrap_or_default();
    last.split('`').skip(1).step_by(2).collect()
}

/// Whether a Rust file has a test of that name; other attributes may stand between `#[test]` and
/// the function.
fn has_test(text: &str, name: &str) -> bool {
    let head = format!("fn {name}(");
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    lines.iter().enumerate().filter(|(_, line)| line.starts_with(&head)).any(|(at, _)| {
        let attributes = lines[..at].iter().rev().take_while(|line| line.starts_with("#["));
        attributes.into_iter().any(|line| *line == "#[test]")
    })
}

/// Returns why a named item proves nothing, or `None` if it exists.
fn fault(named: &str) -> Option<String> {
    let (path, name) = named.split_once("::").map_or((named, None), |(path, name)| (path, Some(name)));
    let Ok(text) = std::fs::read_to_string(Path::new(ROOT).join(path)) else { return Some(format!("{named}: no file {path}")) };
    let is_there = match name {
        None => true,
        Some(name) if path.ends_with(".rs") => has_test(&text, name),
        Some(name) => text.contains(name),
    };
    (!is_there).then(|| format!("{named}: nothing of that name in {path}"))
}

#[test]
fn every_promise_names_tests_that_exist() {
    let text = std::fs::read_to_string(Path::new(ROOT).join("SPECIFICATION.md")).expect("SPECIFICATION.md is there");
    let rows: Vec<&str> = text.lines().filter(|line| line.starts_with("| ") && !line.starts_with("| promise |")).collect();
    let silent: Vec<_> = rows.iter().filter(|row| named(row).is_empty()).collect();
    assert!(silent.is_empty(), "promises that name nothing: {silent:#?}");
    let all: BTreeSet<&str> = rows.iter().flat_map(|row| named(row)).collect();
    assert!(all.len() > 100, "the reader sees only {} names", all.len());
    let faults: Vec<String> = all.into_iter().filter_map(fault).collect();
    assert!(faults.is_empty(), "{faults:#?}");
}

/// Returns the paths of source, tests and benches in backquotes; in a list, only the first one is
/// complete.
fn paths(text: &str) -> BTreeSet<&str> {
    let quoted = text.split('`').skip(1).step_by(2);
    let is_path = |word: &&str| ["src/", "tests/", "benches/", "docs/", "config/", "examples/"].iter().any(|room| word.starts_with(room));
    quoted.filter(is_path).filter(|word| !word.contains([' ', '*', '…']) && !word.contains("NAME")).collect()
}

#[test]
fn files_named_in_documents_exist() {
    for document in ["CONTRIBUTING.md", "docs/glossary.md"] {
        let text = std::fs::read_to_string(Path::new(ROOT).join(document)).expect("the document is there");
        let all = paths(&text);
        assert!(all.len() > 20, "{document}: the reader sees only {} paths", all.len());
        let missing: Vec<_> = all.into_iter().filter(|path| !Path::new(ROOT).join(path).exists()).collect();
        assert!(missing.is_empty(), "{document} names {missing:?}");
    }
}

#[test]
fn a_name_that_is_not_a_test_is_detected() {
    let here = "tests/structure/specification.rs";
    assert_eq!(fault(&format!("{here}::a_name_that_is_not_a_test_is_detected")), None);
    assert!(fault(&format!("{here}::has_test")).is_some(), "a function that is no test");
    assert!(fault(&format!("{here}::never")).is_some() && fault("tests/never.rs").is_some());
}
