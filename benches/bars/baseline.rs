//! The committed figures, and how much worse a run may be.
//!
//! A build yields the same bytes on every run, on any number of threads. Another processor may have
//! other vector registers and sum in another order, hence the tolerances.

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;

use crate::readme;
use crate::score::{Figures, Row};

/// Where the baseline is, from the project's folder.
pub const FILE: &str = "benches/bars/baseline.json";
/// Maximum loss of reported poses against the baseline, percent of the frames. Raised, lost frames
/// pass.
const MAX_LOST_PERCENT: f64 = 2.0;
/// Maximum number of wrong poses beyond those of the baseline. Raised, wrong poses pass.
const MAX_MORE_WRONG: usize = 0;
/// Maximum ratio of an error to its baseline. Raised, a loss of accuracy passes.
const MAX_ERROR_RATIO: f64 = 1.05;
/// Maximum ratio of NEES/6 to its baseline, or of the baseline to it. It is a mean of squares, so
/// it changes twice as much as errors do.
const MAX_NEES_RATIO: f64 = 1.10;
/// Maximum ratio of the mean number of rounds to its baseline, and of the number that 95 % of the
/// frames keep. Raised, slower alignment passes. The second is a small integer, hence wider.
const MAX_ROUNDS_RATIO: f64 = 1.05;
const MAX_P95_ROUNDS_RATIO: f64 = 1.25;

/// Figures by the name of the scene.
#[derive(Default)]
pub struct Baseline(BTreeMap<String, Figures>);

/// The result of the comparison.
#[derive(Default)]
pub struct Verdict {
    regressions: Vec<String>,
    improvements: Vec<String>,
    compared: usize,
}

/// How a figure changed.
enum Change {
    Worse,
    Better,
    Same,
}

impl Baseline {
    fn path() -> PathBuf {
        PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(FILE)
    }

    pub fn read() -> Result<Self, String> {
        let text = std::fs::read_to_string(Self::path()).map_err(|e| format!("{FILE}: {e}; `-- --write` makes it"))?;
        Ok(Self(serde_json::from_str(&text).map_err(|e| format!("{FILE}: {e}; `-- --write` renews it"))?))
    }

    /// Reads the baseline; empty if there is no file yet. Scenes that do not run keep their
    /// figures.
    pub fn read_or_empty() -> Result<Self, String> {
        if Self::path().exists() { Self::read() } else { Ok(Self::default()) }
    }

    pub fn with(mut self, rows: &[Row]) -> Self {
        self.0.extend(rows.iter().map(|row| (row.name.clone(), row.figures.clone())));
        self
    }

    pub fn write(&self) -> Result<(), String> {
        let text = serde_json::to_string_pretty(&self.0).map_err(|e| e.to_string())?;
        std::fs::write(Self::path(), text + "\n").map_err(|e| format!("{FILE}: {e}"))
    }

    /// Returns the README's table of these figures.
    pub fn table(&self) -> String {
        readme::table(|name| self.0.get(name))
    }

    /// Compares a run with the baseline, and the README's table as well.
    pub fn judge(&self, rows: &[Row]) -> Result<Verdict, String> {
        let mut verdict = Verdict::default();
        for row in rows {
            match self.0.get(&row.name) {
                Some(baseline) => verdict.compare(row, baseline),
                None => verdict.regressions.push(format!("{}: not in the baseline; `-- --write` adds it", row.name)),
            }
        }
        if !readme::has(&self.table())? {
            verdict.regressions.push(format!("{}: its table is not that of {FILE}; `-- --write` renews both", readme::FILE));
        }
        Ok(verdict)
    }
}

impl Verdict {
    pub fn is_kept(&self) -> bool {
        self.regressions.is_empty()
    }

    fn compare(&mut self, row: &Row, baseline: &Figures) {
        self.compared += 1;
        let now = &row.figures;
        let lost_percent = 100.0 * (baseline.given as f64 - now.given as f64) / baseline.frames as f64;
        let given = change(lost_percent > MAX_LOST_PERCENT, lost_percent < 0.0);
        self.note(row, "given", given, baseline.given, now.given);
        let wrong = change(now.wrong > baseline.wrong + MAX_MORE_WRONG, now.wrong < baseline.wrong);
        self.note(row, "wrong", wrong, baseline.wrong, now.wrong);
        if baseline.frames != now.frames {
            self.regressions.push(format!("{}: {} frames, in the baseline {}", row.name, now.frames, baseline.frames));
        }
        let errors = [
            ("median mm", baseline.median_mm, now.median_mm),
            ("p95 mm", baseline.p95_mm, now.p95_mm),
            ("median mdeg", baseline.median_mdeg, now.median_mdeg),
            ("p95 mdeg", baseline.p95_mdeg, now.p95_mdeg),
        ];
        for (what, before, after) in errors {
            let (Some(before), Some(after)) = (before, after) else { continue };
            self.note(row, what, change(after > before * MAX_ERROR_RATIO, after * MAX_ERROR_RATIO < before), before, after);
        }
        if let (Some(before), Some(after)) = (baseline.nees6, now.nees6) {
            // A covariance that grew is as dishonest as one that shrank.
            let ratio = (after / before).max(before / after);
            self.note(row, "NEES/6", change(ratio > MAX_NEES_RATIO, false), before, after);
        }
        let rounds = [
            ("rounds", baseline.mean_rounds, now.mean_rounds, MAX_ROUNDS_RATIO),
            ("p95 rounds", baseline.p95_rounds, now.p95_rounds, MAX_P95_ROUNDS_RATIO),
        ];
        for (what, before, after, ratio) in rounds {
            let (Some(before), Some(after)) = (before, after) else { continue };
            self.note(row, what, change(after > before * ratio, after * ratio < before), before, after);
        }
    }

    fn note(&mut self, row: &Row, what: &str, change: Change, before: impl fmt::Display, after: impl fmt::Display) {
        let line = format!("{}: {what} {after}, in the baseline {before}", row.name);
        match change {
            Change::Worse => self.regressions.push(line),
            Change::Better => self.improvements.push(line),
            Change::Same => {}
        }
    }
}

fn change(is_worse: bool, is_better: bool) -> Change {
    match (is_worse, is_better) {
        (true, _) => Change::Worse,
        (_, true) => Change::Better,
        _ => Change::Same,
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for line in &self.improvements {
            writeln!(f, "better  {line}")?;
        }
        for line in &self.regressions {
            writeln!(f, "WORSE   {line}")?;
        }
        match (self.is_kept(), self.improvements.is_empty()) {
            (false, _) => writeln!(f, "MISSED: {} figures are worse than {FILE} allows", self.regressions.len()),
            (true, false) => writeln!(f, "kept, and better in places: `-- --write` renews {FILE}"),
            (true, true) => writeln!(f, "kept: {} rows are as {FILE} has them", self.compared),
        }
    }
}
