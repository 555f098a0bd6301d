//! What half and double of each tuning constant do to the scenes of `bars`: errors, reported poses,
//! wrong ones, and rounds of alignment.
//!
//! `cargo bench --bench bars --no-default-features --features capture,tuning -- tuning` measures
//! all constants, two runs of all scenes each. Results go to target/tuning.jsonl as they are made,
//! and the next run continues there, so it may be interrupted at any time. `-- tuning --for 10`
//! ends after ten minutes, `-- tuning align max_coarse_rounds` measures a room or a constant, and
//! `-- tuning --write` writes what has been measured into docs/tuning.md.

mod runs;
mod table;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

use stagepose::Frame;
use stagepose::diagnostics::tuning::{Constant, constants, restore, scale};

use self::runs::{Outcome, Results, Run};
use crate::film::Film;
use crate::scenes;

/// Half and double: far enough to show an effect, near enough to stay in the range that somebody
/// would try.
const FACTORS: [f64; 2] = [0.5, 2.0];

/// What the command line asks for.
struct Choice {
    is_written: bool,
    limit: Option<Duration>,
    /// Rooms and constants; empty for all.
    words: Vec<String>,
}

impl Choice {
    fn read(mut words: impl Iterator<Item = String>) -> Result<Self, String> {
        let mut choice = Self { is_written: false, limit: None, words: Vec::new() };
        let all = constants();
        while let Some(word) = words.next() {
            match word.as_str() {
                // Cargo says so to every bench.
                "--bench" => {}
                "--write" => choice.is_written = true,
                "--for" => {
                    let minutes: u64 = words.next().and_then(|n| n.parse().ok()).ok_or("tuning: --for needs a number of minutes")?;
                    choice.limit = Some(Duration::from_secs(60 * minutes));
                }
                word if all.iter().any(|constant| constant.room == word || constant.name == word) => choice.words.push(word.to_owned()),
                word => return Err(format!("tuning: `{word}` is neither an option (--for MINUTES, --write) nor a room or a constant")),
            }
        }
        Ok(choice)
    }

    fn wants(&self, constant: &Constant) -> bool {
        self.words.is_empty() || self.words.iter().any(|word| word == constant.room || word == constant.name)
    }
}

/// Does what the words after `tuning` ask for.
pub fn run(words: impl Iterator<Item = String>) -> Result<(), String> {
    let choice = Choice::read(words)?;
    if choice.is_written {
        let results = Results::read()?;
        return table::write(&results, &constants());
    }
    let start = Instant::now();
    let films = rendered()?;
    let declared = tracked(&films)?;
    let mut results = Results::continued(declared)?;
    for constant in constants().iter().filter(|constant| choice.wants(constant)) {
        for factor in FACTORS {
            if choice.limit.is_some_and(|limit| start.elapsed() > limit) {
                println!("the time is up; the next run continues here");
                return Ok(());
            }
            if results.has(constant, factor) {
                continue;
            }
            let outcome = outcome_of(constant, factor, &films);
            println!("{} {} = {}, x {factor}: {}", constant.room, constant.name, constant.value, results.effect_of(&outcome));
            results.add(Run::of(constant, factor, outcome))?;
        }
    }
    Ok(())
}

/// A scene with its frames.
type Rendered = (&'static str, Film, Vec<Frame>);

/// Renders all scenes once: no tuning constant acts on the renderer.
fn rendered() -> Result<Vec<Rendered>, String> {
    let of_scene = |scene: &scenes::Scene| {
        let film = (scene.film)();
        film.render().map(|frames| (scene.name, film, frames))
    };
    scenes::SCENES.iter().map(of_scene).collect()
}

/// Tracks all scenes with the constants as they are now.
fn tracked(films: &[Rendered]) -> Result<Outcome, String> {
    let mut rows = Outcome::default();
    for (name, film, frames) in films {
        rows.extend(film.rows(name, frames)?.into_iter().map(|row| (row.name, row.figures)));
    }
    Ok(rows)
}

/// Tracks all scenes with one constant scaled. A value that nobody can use may fail, or panic: then
/// no scene has figures.
fn outcome_of(constant: &Constant, factor: f64, films: &[Rendered]) -> Outcome {
    scale(constant.room, constant.name, factor);
    let outcome = catch_unwind(AssertUnwindSafe(|| tracked(films)));
    restore();
    outcome.ok().and_then(Result::ok).unwrap_or_default()
}
