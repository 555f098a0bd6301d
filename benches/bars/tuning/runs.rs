//! What was measured so far: a file with a line per run.

use std::collections::BTreeMap;
use std::fmt;
use std::fs::OpenOptions;
use std::io::Write;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use stagepose::diagnostics::tuning::Constant;

use crate::score::Figures;

/// The file, from the project's folder.
const FILE: &str = "target/tuning.jsonl";

/// The figures of all scenes; empty if the run failed.
pub type Outcome = BTreeMap<String, Figures>;

/// A run of all scenes.
#[derive(Serialize, Deserialize)]
pub struct Run {
    /// Room and name of the constant that was scaled; empty for the run with all as declared.
    room: String,
    name: String,
    /// Its declared value.
    value: String,
    factor: f64,
    outcome: Outcome,
}

impl Run {
    pub fn of(constant: &Constant, factor: f64, outcome: Outcome) -> Self {
        let Constant { room, name, value } = constant;
        Self { room: (*room).to_owned(), name: (*name).to_owned(), value: value.clone(), factor, outcome }
    }

    fn declared(outcome: Outcome) -> Self {
        Self { room: String::new(), name: String::new(), value: String::new(), factor: 1.0, outcome }
    }

    fn is_of(&self, constant: &Constant, factor: f64) -> bool {
        self.room == constant.room && self.name == constant.name && self.value == constant.value && self.factor == factor
    }
}

/// What scaling a constant did.
#[derive(Debug, Clone, PartialEq)]
pub enum Effect {
    /// All figures are the same.
    None,
    /// No scene has figures: the tracker failed.
    Failure,
    Change {
        /// Geometric mean over the scenes of the ratio of the median errors.
        error: f64,
        /// The largest ratio of a scene's median or 95 % error, and the scene.
        worst: f64,
        scene: String,
        /// Poses reported more, and wrong ones more.
        given: i64,
        wrong: i64,
        /// Geometric mean of the ratio of the mean rounds.
        rounds: f64,
        /// Geometric mean of the ratio of NEES/6.
        nees: f64,
    },
}

impl Effect {
    fn between(declared: &Outcome, scaled: &Outcome) -> Self {
        if scaled.is_empty() {
            return Self::Failure;
        }
        if scaled == declared {
            return Self::None;
        }
        let pairs = || declared.iter().filter_map(|(name, before)| Some((name, before, scaled.get(name)?)));
        let mean_ratio = |of: fn(&Figures) -> Option<f64>| {
            let logs: Vec<f64> =
                pairs().filter_map(|(_, before, now)| Some((of(now)? / of(before)?).ln())).filter(|v| v.is_finite()).collect();
            (logs.iter().sum::<f64>() / logs.len().max(1) as f64).exp()
        };
        let ratios = pairs().flat_map(|(name, before, now)| {
            let of = |a: Option<f64>, b: Option<f64>| Some((a? / b?, name.clone()));
            [of(now.median_mm, before.median_mm), of(now.p95_mm, before.p95_mm)].into_iter().flatten()
        });
        let (worst, scene) = ratios.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or_default();
        let more = |of: fn(&Figures) -> usize| pairs().map(|(_, before, now)| of(now) as i64 - of(before) as i64).sum();
        Self::Change {
            error: mean_ratio(|f| f.median_mm),
            worst,
            scene,
            given: more(|f| f.given),
            wrong: more(|f| f.wrong),
            rounds: mean_ratio(|f| f.mean_rounds),
            nees: mean_ratio(|f| f.nees6),
        }
    }
}

impl fmt::Display for Effect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self::Change { error, worst, scene, given, wrong, rounds, nees } = self else {
            return f.write_str(if *self == Self::None { "same" } else { "fails" });
        };
        write!(f, "error {error:.2}")?;
        if *worst > 1.05 {
            write!(f, " ({scene} {worst:.2})")?;
        }
        if *given != 0 {
            write!(f, ", poses {given:+}")?;
        }
        if *wrong != 0 {
            write!(f, ", wrong {wrong:+}")?;
        }
        for (name, ratio) in [("NEES", nees), ("rounds", rounds)] {
            if (ratio - 1.0).abs() > 0.02 {
                write!(f, ", {name} {ratio:.2}")?;
            }
        }
        Ok(())
    }
}

/// All runs so far.
pub struct Results {
    declared: Outcome,
    runs: Vec<Run>,
}

impl Results {
    fn path() -> PathBuf {
        PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(FILE)
    }

    /// Reads what was measured.
    pub fn read() -> Result<Self, String> {
        let text = std::fs::read_to_string(Self::path()).map_err(|e| format!("{FILE}: {e}; a run without --write makes it"))?;
        // A run that was interrupted may have left half a line.
        let mut runs: Vec<Run> = text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
        let first = runs.iter().position(|run| run.name.is_empty()).ok_or(format!("{FILE}: no run with the declared constants"))?;
        Ok(Self { declared: runs.remove(first).outcome, runs })
    }

    /// Continues the file if its figures are those of this build; otherwise starts it anew.
    pub fn continued(declared: Outcome) -> Result<Self, String> {
        if let Ok(results) = Self::read() {
            if results.declared == declared {
                return Ok(results);
            }
            println!("{FILE} is of another build, and begins anew");
        }
        let folder = Self::path().parent().map_or(Ok(()), std::fs::create_dir_all);
        folder.and_then(|()| std::fs::write(Self::path(), "")).map_err(|e| format!("{FILE}: {e}"))?;
        let mut results = Self { declared: declared.clone(), runs: Vec::new() };
        results.append(&Run::declared(declared))?;
        Ok(results)
    }

    pub fn has(&self, constant: &Constant, factor: f64) -> bool {
        self.runs.iter().any(|run| run.is_of(constant, factor))
    }

    pub fn add(&mut self, run: Run) -> Result<(), String> {
        self.append(&run)?;
        self.runs.push(run);
        Ok(())
    }

    fn append(&mut self, run: &Run) -> Result<(), String> {
        let line = serde_json::to_string(run).map_err(|e| e.to_string())? + "\n";
        let file = OpenOptions::new().append(true).open(Self::path());
        file.and_then(|mut file| file.write_all(line.as_bytes())).map_err(|e| format!("{FILE}: {e}"))
    }

    pub fn effect_of(&self, outcome: &Outcome) -> Effect {
        Effect::between(&self.declared, outcome)
    }

    /// Returns what a factor does to a constant; `None` if that was not measured.
    pub fn effect(&self, constant: &Constant, factor: f64) -> Option<Effect> {
        let run = self.runs.iter().find(|run| run.is_of(constant, factor))?;
        Some(self.effect_of(&run.outcome))
    }
}
