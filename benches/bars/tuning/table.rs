//! The section of docs/tuning.md that says what half and double do.

use std::fmt::Write;
use std::path::PathBuf;

use stagepose::diagnostics::tuning::Constant;

use super::FACTORS;
use super::runs::{Effect, Results};

/// The document, from the project's folder.
const FILE: &str = "docs/tuning.md";
/// Where the section begins; it ends the document.
const HEADING: &str = "## Half and double\n";
const INTRODUCTION: &str = "
`cargo bench --bench bars --no-default-features --features capture,tuning -- tuning` scales one
constant at a time and tracks the ten scenes of `bars`; `-- tuning --write` writes this section.
Error: geometric mean over the scenes of the ratio of median errors; in brackets the scene whose
median or 95 % error grew most, if by more than 5 %. Poses, wrong: how many more were reported, and
reported wrong, of all frames of all scenes. NEES, rounds: geometric mean of the ratio, if it
changed by more than 2 %.

";

/// Writes the section anew.
pub fn write(results: &Results, constants: &[Constant]) -> Result<(), String> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(FILE);
    let text = std::fs::read_to_string(&path).map_err(|e| format!("{FILE}: {e}"))?;
    let before = text.find(HEADING).map_or(text.as_str(), |at| &text[..at]).trim_end();
    let section = section(results, constants);
    std::fs::write(&path, format!("{before}\n\n{HEADING}{section}")).map_err(|e| format!("{FILE}: {e}"))
}

fn section(results: &Results, constants: &[Constant]) -> String {
    let effects = |constant: &Constant| Some(FACTORS.map(|factor| results.effect(constant, factor))).and_then(both);
    let measured: Vec<(&Constant, [Effect; 2])> = constants.iter().filter_map(|c| Some((c, effects(c)?))).collect();
    let (same, changed): (Vec<_>, Vec<_>) = measured.iter().partition(|(_, effects)| effects.iter().all(|effect| *effect == Effect::None));
    let mut text = INTRODUCTION.to_owned();
    text += "| room | constant | value | half | double |\n|---|---|---|---|---|\n";
    for (Constant { room, name, value }, [half, double]) in changed {
        // Writing to a string does not fail.
        let _ = writeln!(text, "| {room} | `{name}` | {value} | {half} | {double} |");
    }
    let names: Vec<String> = same.iter().map(|(constant, _)| format!("`{}`", constant.name)).collect();
    let missing = constants.len() - measured.len();
    let _ = write!(text, "\nNeither half nor double changes any figure of these scenes for: {}.\n", names.join(", "));
    if missing > 0 {
        let _ = write!(text, "\nNot measured yet: {missing} constants.\n");
    }
    wrapped(&text)
}

fn both([half, double]: [Option<Effect>; 2]) -> Option<[Effect; 2]> {
    Some([half?, double?])
}

/// Wraps paragraphs at 100 columns; tables keep their lines.
fn wrapped(text: &str) -> String {
    let mut out = String::new();
    for line in text.lines() {
        if line.len() <= 100 || line.starts_with('|') {
            out += line;
            out.push('\n');
            continue;
        }
        let mut width = 0;
        for word in line.split(' ') {
            if width > 0 && width + 1 + word.len() > 100 {
                out.push('\n');
                width = 0;
            } else if width > 0 {
                out.push(' ');
                width += 1;
            }
            out += word;
            width += word.len();
        }
        out.push('\n');
    }
    out
}
