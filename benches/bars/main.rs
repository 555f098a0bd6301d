//! Accuracy bars: short scenes of the virtual stage, each with its own difficulty, are rendered in
//! memory, tracked, scored against exact truth and compared with a committed baseline. This needs
//! nothing but the clone.
//!
//! `cargo bench --bench bars` ends with 1 where a figure is worse than its baseline; `-- --write`
//! renews the baseline; `-- actors still` runs these scenes only; `-- --grey` adds up grey levels
//! in place of light, as older figures were made, and compares with nothing;
//! `-- --renderers PYTHON` holds the renderer against that of `../shared/bench` (`renderers.rs`).

mod baseline;
mod film;
mod renderers;
mod scenes;
mod score;

use std::process::ExitCode;

use baseline::Baseline;
use film::Film;
use score::Row;

/// What the command line asks for.
struct Choice {
    is_written: bool,
    is_grey: bool,
    /// The Python that runs the other renderer.
    renderers: Option<String>,
    scenes: Vec<String>,
}

impl Choice {
    fn read() -> Result<Self, String> {
        let mut choice = Self { is_written: false, is_grey: false, renderers: None, scenes: Vec::new() };
        let mut words = std::env::args().skip(1);
        while let Some(word) = words.next() {
            match word.as_str() {
                // Cargo says so to every bench.
                "--bench" => {}
                "--write" => choice.is_written = true,
                "--grey" => choice.is_grey = true,
                "--renderers" => {
                    choice.renderers = Some(words.next().ok_or("bars: --renderers needs a Python that has what render.py needs")?)
                }
                word if scenes::SCENES.iter().any(|(name, _)| *name == word) => choice.scenes.push(word.to_owned()),
                word => {
                    return Err(format!(
                        "bars: `{word}` is neither an option (--write, --grey, --renderers PYTHON) nor a scene ({})",
                        scenes::names()
                    ));
                }
            }
        }
        if choice.is_written && choice.is_grey {
            return Err("bars: the baseline is of scenes in linear light; leave out --grey or --write".to_owned());
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
    if let Some(python) = &choice.renderers {
        return Ok(if renderers::agree(python)? { ExitCode::SUCCESS } else { ExitCode::FAILURE });
    }
    let mut rows = Vec::new();
    println!("{}", Row::HEAD);
    for (name, scene) in scenes::SCENES.iter().filter(|(name, _)| choice.wants(name)) {
        let film = if choice.is_grey { scene().in_grey_averages() } else { scene() };
        for row in film_rows(name, &film)? {
            println!("{row}");
            rows.push(row);
        }
    }
    if choice.is_grey {
        return Ok(ExitCode::SUCCESS);
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
    let tracked = film.track(&frames)?;
    let mut rows = vec![Row { name: name.to_owned(), figures: film.score_camera(&tracked), ms: Some(tracked.ms) }];
    for (k, object) in film.stage.objects.iter().enumerate() {
        let name = format!("{name}/{}", object.body.name);
        rows.push(Row { name, figures: film.score_object(k, &tracked), ms: None });
    }
    Ok(rows)
}
