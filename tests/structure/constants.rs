//! Checks that each constant of the source has a comment, or belongs to a group that has one.
//!
//! The source is read as lines, because comments are not in the syntax tree. The check relies on
//! the formatting: an item ends where its indentation returns.

use std::path::Path;

/// A constant without a comment: its line number, from 1, and its name.
type Silent<'a> = (usize, &'a str);

fn indentation(line: &str) -> usize {
    line.len() - line.trim_start().len()
}

/// Returns the name of the constant or static that a line declares.
fn declared(line: &str) -> Option<&str> {
    let line = line.trim_start();
    let line = match line.strip_prefix("pub") {
        Some(rest) if rest.starts_with('(') => rest.split_once(") ")?.1,
        Some(rest) => rest.strip_prefix(' ')?,
        None => line,
    };
    let rest = line.strip_prefix("const ").or(line.strip_prefix("static "))?;
    let (name, kind) = rest.strip_prefix("mut ").unwrap_or(rest).split_once(':')?;
    let is_name = name.chars().all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_');
    // A trailing comma means a const parameter of a generic item.
    (is_name && !kind.ends_with(',')).then_some(name)
}

/// Returns the last line of an item: the first one that ends it, at its own indentation or with the
/// semicolon of a single value.
fn end(lines: &[&str], begin: usize) -> usize {
    let own = indentation(lines[begin]);
    let is_end = |k: usize| match lines[k].trim_end() {
        line if k == begin => line.ends_with(';') || line.ends_with('}'),
        // The value begins on a line of its own.
        line if lines[begin].ends_with('=') => line.ends_with(';') && indentation(line) <= own + 4,
        line => indentation(line) == own && (line.ends_with(';') || line.ends_with('}')),
    };
    (begin..lines.len()).find(|k| is_end(*k)).unwrap_or(lines.len() - 1)
}

fn is_attribute(line: &str) -> bool {
    line.trim_start().starts_with("#[")
}

/// Returns the number of constants outside tests, and those among them without a comment.
fn read(text: &str) -> (usize, Vec<Silent<'_>>) {
    let lines: Vec<&str> = text.lines().collect();
    let (mut count, mut silent) = (0, Vec::new());
    // The line after the last constant that has a comment, or belongs to a group that has one.
    let mut group_goes_on_at = None;
    let mut at = 0;
    while at < lines.len() {
        let begin = at;
        let item = (begin..lines.len()).find(|k| !is_attribute(lines[*k])).unwrap_or(lines.len() - 1);
        at = item + 1;
        if lines[begin..item].iter().any(|line| line.trim() == "#[cfg(test)]") {
            at = end(&lines, item) + 1;
        } else if let Some(name) = declared(lines[item]) {
            count += 1;
            at = end(&lines, item) + 1;
            let above = begin.checked_sub(1).map_or("", |k| lines[k].trim_start());
            let has_comment = above.starts_with("//") && !above.starts_with("//!");
            if has_comment || group_goes_on_at == Some(begin) {
                group_goes_on_at = Some(at);
            } else {
                silent.push((item + 1, name));
            }
        }
    }
    (count, silent)
}

#[test]
fn every_constant_says_what_it_is() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let modules = super::read();
    let main = root.join("src/main.rs");
    let (mut count, mut silent) = (0, Vec::new());
    for file in modules.files().chain([main.as_path()]) {
        let text = std::fs::read_to_string(file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        let (in_file, without) = read(&text);
        count += in_file;
        let place = file.strip_prefix(root).unwrap_or(file).display();
        silent.extend(without.into_iter().map(|(line, name)| format!("{place}:{line}: {name}")));
    }
    assert!(count > 300, "the reader sees only {count} constants");
    assert!(silent.is_empty(), "{} constants without a comment:\n{}", silent.len(), silent.join("\n"));
}

#[test]
fn a_constant_without_a_comment_is_found_out() {
    let text = "\
//! A module.
const FIRST: u8 = 0;

/// Two of a kind,
#[rustfmt::skip]
pub(super) const ONE: [u8; 2] = [
    1, 1,
];
const OTHER: &str =
    \"other\";
static LATER: u8 = 3;
fn between() {}
const ALONE: u8 = 4;

const fn length<
    const N: usize,
>() {
    // Here, too.
    const INSIDE: usize = 5;

    static APART: usize = 6;
}

#[cfg(test)]
mod tests {
    const UNSEEN: u8 = 7;
}
pub const LAST: u8 = 8;
";
    assert_eq!(read(text), (8, vec![(2, "FIRST"), (13, "ALONE"), (21, "APART"), (28, "LAST")]));
}
