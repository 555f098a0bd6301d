//! The bars of accuracy: short scenes of the virtual stage, each hard in a way of its own, rendered in memory, tracked, scored against
//! exact truth and compared with a committed baseline. Nothing but the clone is needed.
//!
//! `cargo bench --bench bars` ends with 1 where a figure is worse than its baseline; `-- --write` renews the baseline; `-- actors still`
//! runs these scenes only.

mod baseline;
mod film;
mod scenes;
mod score;

use std::process::ExitCode;

use baseline::Baseline;
use film::Film;
use score::Row;

/// What the command line asks for.
struct Choice {
    is_written: bool,
    scenes: Vec<String>,
}

impl Choice {
    fn read() -> Result<Self, String> {
        let mut choice = Self { is_written: false, scenes: Vec::new() };
        for word in std::env::args().skip(1) {
            match word.as_str() {
                // Cargo says so to every bench.
                "--bench" => {}
                "--write" => choice.is_written = true,
                word if scenes::SCENES.iter().any(|(name, _)| *name == word) => choice.scenes.push(word.to_owned()),
                word => return Err(format!("bars: `{word}` is neither an option (--write) nor a scene ({})", scenes::names())),
            }
        }
        Ok(choice)
    }

    fn wants(&self, scene: &str) -> bool {
        self.scenes.is_empty() || self.scenes.iter().any(|name| name == scene)
    }
}

fn main() -> ExitCode {
    match run() {
        Ok(code) => code,
        Err(problem) => {
            eprintln!("{problem}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<ExitCode, String> {
    let choice = Choice::read()?;
    let mut rows = Vec::new();
    println!("{}", Row::HEAD);
    for (name, scene) in scenes::SCENES.iter().filter(|(name, _)| choice.wants(name)) {
        for row in film_rows(name, &scene())? {
            println!("{row}");
            rows.push(row);
        }
    }
    if choice.is_written {
        Baseline::read_or_empty()?.with(&rows).write()?;
        println!("the baseline is renewed: {}", baseline::FILE);
        return Ok(ExitCode::SUCCESS);
    }
    let verdict = Baseline::read()?.judge(&rows);
    print!("{verdict}");
    Ok(if verdict.is_kept() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// A row for the camera, and one for each object.
fn film_rows(name: &str, film: &Film) -> Result<Vec<Row>, String> {
    let frames = film.render()?;
    let (samples, ms) = film.track(&frames)?;
    let mut rows = vec![Row { name: name.to_owned(), figures: film.score_camera(&samples), ms: Some(ms) }];
    for (k, object) in film.stage.objects.iter().enumerate() {
        let name = format!("{name}/{}", object.body.name);
        rows.push(Row { name, figures: film.score_object(k, &samples), ms: None });
    }
    Ok(rows)
}
