//! The README's table of accuracy: the figures of the baseline, as Markdown.

use std::path::PathBuf;

use crate::scenes::{SCENES, Scene};
use crate::score::Figures;

/// The document that has the table, from the project's folder.
pub const FILE: &str = "README.md";
/// The table's first lines. The first one shows where the table begins.
const HEAD: [&str; 2] =
    ["| scene | what happens | poses | wrong | position, median | position, 95 % | rotation, median |", "|---|---|---|---|---|---|---|"];

/// Returns the table of the scenes that have figures; of the cameras alone.
pub fn table<'a>(figures_of: impl Fn(&str) -> Option<&'a Figures>) -> String {
    let row = |Scene { name, what, .. }: &Scene| {
        let Figures { frames, given, wrong, median_mm, p95_mm, median_mdeg, .. } = figures_of(name)?;
        let [median, p95] = [median_mm, p95_mm].map(|error| error.map_or("-".to_owned(), |mm| format!("{mm:.2} mm")));
        let turn = median_mdeg.map_or("-".to_owned(), |mdeg| format!("{:.4}°", 1e-3 * mdeg));
        Some(format!("| {name} | {what} | {given} of {frames} | {wrong} | {median} | {p95} | {turn} |"))
    };
    let lines: Vec<String> = HEAD.map(str::to_owned).into_iter().chain(SCENES.iter().filter_map(row)).collect();
    lines.join("\n") + "\n"
}

fn path() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(FILE)
}

/// The README: what stands before the table, the table, and what follows.
fn parts() -> Result<[String; 3], String> {
    let text = std::fs::read_to_string(path()).map_err(|e| format!("{FILE}: {e}"))?;
    let start = text.find(HEAD[0]).ok_or(format!("{FILE}: no line is `{}`", HEAD[0]))?;
    let (before, rest) = text.split_at(start);
    let length = rest.split_inclusive('\n').take_while(|line| line.starts_with('|')).map(str::len).sum();
    let (table, after) = rest.split_at(length);
    Ok([before, table, after].map(str::to_owned))
}

/// Whether the README has this table.
pub fn has(table: &str) -> Result<bool, String> {
    parts().map(|[_, its, _]| its == table)
}

/// Replaces the README's table.
pub fn write(table: &str) -> Result<(), String> {
    let [before, _, after] = parts()?;
    std::fs::write(path(), before + table + &after).map_err(|e| format!("{FILE}: {e}"))
}
