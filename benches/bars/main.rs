//! Accuracy bars: short scenes of the virtual stage, each with its own difficulty, are rendered in
//! memory, tracked, scored against exact truth and compared with a committed baseline. This needs
//! nothing but the clone.
//!
//! `cargo bench --bench bars` ends with 1 where a figure is worse than its baseline, or where the
//! README's table does not have the baseline's figures. `-- --write` renews both; `-- --readme`
//! prints that table as this run measured it; `-- actors still` runs these scenes only; `-- --grey`
//! adds up grey levels in place of light, as older figures were made, and compares with nothing;
//! `-- --renderers PYTHON` holds the renderer against that of `../shared/bench` (`renderers.rs`).

mod baseline;
mod film;
mod readme;
mod renderers;
mod scenes;
mod score;
#[cfg(feature = "tuning")]
mod tuning;

use std::process::ExitCode;

use baseline::Baseline;
use scenes::Scene;
use score::Row;

/// What the command line asks for.
struct Choice {
    is_written: bool,
    is_grey: bool,
    /// Whether the README's table is printed.
    is_readme: bool,
    /// The Python that runs the other renderer.
    renderers: Option<String>,
    scenes: Vec<String>,
}

impl Choice {
    fn read() -> Result<Self, String> {
        let mut choice = Self { is_written: false, is_grey: false, is_readme: false, renderers: None, scenes: Vec::new() };
        let mut words = std::env::args().skip(1);
        while let Some(word) = words.next() {
            match word.as_str() {
                // Cargo says so to every bench.
                "--bench" => {}
                "--write" => choice.is_written = true,
                "--grey" => choice.is_grey = true,
                "--readme" => choice.is_readme = true,
                "--renderers" => {
                    choice.renderers = Some(words.next().ok_or("bars: --renderers needs a Python that has what render.py needs")?)
                }
                word if scenes::SCENES.iter().any(|scene| scene.name == word) => choice.scenes.push(word.to_owned()),
                word => {
                    return Err(format!(
                        "bars: `{word}` is neither an option (--write, --readme, --grey, --renderers PYTHON) nor a scene ({})",
                        scenes::names()
                    ));
                }
            }
        }
        if [choice.is_written, choice.is_grey, choice.is_readme].iter().filter(|is_given| **is_given).count() > 1 {
            return Err("bars: the baseline and the README are of scenes in linear light; give one of --write, --grey, --readme".to_owned());
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
    let mut words = std::env::args().skip(1).filter(|word| word != "--bench");
    if words.next().as_deref() == Some("tuning") {
        #[cfg(feature = "tuning")]
        return tuning::run(words).map(|()| ExitCode::SUCCESS);
        #[cfg(not(feature = "tuning"))]
        return Err("bars: `tuning` needs the feature: cargo bench --bench bars --features tuning -- tuning".to_owned());
    }
    let choice = Choice::read()?;
    if let Some(python) = &choice.renderers {
        return Ok(if renderers::agree(python)? { ExitCode::SUCCESS } else { ExitCode::FAILURE });
    }
    let mut rows = Vec::new();
    if !choice.is_readme {
        println!("{}", Row::HEAD);
    }
    for Scene { name, film, .. } in scenes::SCENES.iter().filter(|scene| choice.wants(scene.name)) {
        let film = if choice.is_grey { film().in_grey_averages() } else { film() };
        for row in film.rows(name, &film.render()?)? {
            if !choice.is_readme {
                println!("{row}");
            }
            rows.push(row);
        }
    }
    if choice.is_readme {
        print!("{}", Baseline::default().with(&rows).table());
        return Ok(ExitCode::SUCCESS);
    }
    if choice.is_grey {
        return Ok(ExitCode::SUCCESS);
    }
    if choice.is_written {
        let baseline = Baseline::read_or_empty()?.with(&rows);
        baseline.write()?;
        readme::write(&baseline.table())?;
        println!("renewed: {}, and the table of {}", baseline::FILE, readme::FILE);
        return Ok(ExitCode::SUCCESS);
    }
    let verdict = Baseline::read()?.judge(&rows)?;
    print!("{verdict}");
    Ok(if verdict.is_kept() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
