//! Checks the tuning constants of `src/track`: each name has one meaning, each constant a comment
//! of at most three lines, and a row in docs/tuning.md that says where it was measured.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A tuning constant as a `tuning.rs` declares it.
struct Constant {
    name: String,
    comment_lines: usize,
}

/// Reads the constants in the body of a `tuning!`: fields with a value.
fn constants(text: &str) -> Vec<Constant> {
    let (mut found, mut comment_lines) = (Vec::new(), 0);
    for line in text.lines().map(str::trim_start) {
        if line.starts_with("///") {
            comment_lines += 1;
            continue;
        }
        let field = line
            .split_once(": ")
            .filter(|(name, kind)| kind.contains(" = ") && name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_'));
        found.extend(field.map(|(name, _)| Constant { name: name.to_owned(), comment_lines }));
        comment_lines = 0;
    }
    found
}

#[test]
fn every_tuning_constant_has_one_meaning_a_comment_and_a_row_in_the_table() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let table = std::fs::read_to_string(root.join("docs/tuning.md")).expect("docs/tuning.md is there");
    let mut places: BTreeMap<String, PathBuf> = BTreeMap::new();
    let mut faults = Vec::new();
    let declares = |file: &PathBuf| file.ends_with("tuning.rs") || file.ends_with("tuning/frame_order.rs");
    for file in super::files_below("src/track").into_iter().filter(declares) {
        let text = std::fs::read_to_string(&file).expect("a file of constants");
        for constant in constants(&text) {
            let Constant { name, comment_lines } = constant;
            if !(1..=3).contains(&comment_lines) {
                faults.push(format!("{name}: a comment of {comment_lines} lines"));
            }
            if !table.contains(&format!("`{name}`")) {
                faults.push(format!("{name}: no row in docs/tuning.md"));
            }
            if let Some(other) = places.insert(name.clone(), file.clone()) {
                faults.push(format!("{name}: in {} and {}", other.display(), file.display()));
            }
        }
    }
    assert!(places.len() > 400, "the reader sees only {} constants", places.len());
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn the_reader_sees_fields_with_values_and_their_comments() {
    let text = "tuning! {\n    /// About.\n    pub struct T {\n        // file.rs\n        /// One.\n        /// Two.\n        max_a: f64 = 1.0,\n        b: usize = 2,\n    }\n}\n";
    let seen: Vec<(String, usize)> = constants(text).into_iter().map(|c| (c.name, c.comment_lines)).collect();
    assert_eq!(seen, [("max_a".to_owned(), 2), ("b".to_owned(), 0)]);
}
