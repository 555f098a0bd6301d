//! `report`: one file with all that is needed to find out what went wrong.
//!
//! Versions, the config with the calibrations that it names, what `check` thinks of it, what a running daemon says of itself, and of the
//! newest recording and of the ring events, records and their counts. Each part is taken as far as it can be read: a report is
//! made where something is wrong, so nothing that is missing or broken stops it. Pictures show people: they go in only on request.

mod bundle;
mod daemon;
mod machine;
mod recordings;

use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};

use super::failure::Failure;
use super::output_file::print;
use crate::config::{FileKind, Settings, files_named_in};
use crate::printable::printable_lines;
use crate::safe_file;
use crate::utc;
use bundle::Bundle;
use recordings::Recording;

/// More than any config has, bytes: a round figure, so that a wrong file is refused instead of read into memory.
const MOST_CONFIG_BYTES: u64 = 16 << 20;

/// Put versions, config, events and the last recording into one file, to send to who can help.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  stagepose report --config stage.toml --output report.zip\n\n\
    Run it beside a running daemon or after it. It says what it took, and asks before it takes pictures of the stage.")]
pub(super) struct ReportArguments {
    /// The config of the camera and the stage; it may be a bad one
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// The file to make; it must not be there yet
    #[arg(long, short, value_name = "FILE.zip")]
    output: PathBuf,
    /// Take this recording instead of the newest one in the recorder's folder
    #[arg(long, value_name = "CLIP")]
    clip: Option<PathBuf>,
    /// Take the last pictures of the recording and of the ring too, and the stage's artwork, without asking
    #[arg(long, conflicts_with = "no_pictures")]
    pictures: bool,
    /// Take no pictures, without asking
    #[arg(long)]
    no_pictures: bool,
    /// How many seconds of pictures
    #[arg(long, value_name = "S", default_value_t = 5.0, value_parser = seconds)]
    seconds: f64,
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|_| "give seconds such as 5".to_owned())?;
    if (0.0..=600.0).contains(&seconds) { Ok(seconds) } else { Err("give 0 to 600 seconds".to_owned()) }
}

pub(super) fn run(arguments: &ReportArguments) -> Result<(), Failure> {
    let config = safe_file::read(&arguments.config, MOST_CONFIG_BYTES).map_err(|e| {
        Failure::Usage(format!("{}: cannot be read ({e}); give the config that the trouble was with", arguments.config.display()))
    })?;
    if let Some(clip) = arguments.clip.as_ref().filter(|clip| !clip.join("timestamps.csv").is_file()) {
        return Err(Failure::Usage(format!("--clip {}: is no recording, it has no timestamps.csv; give its folder", clip.display())));
    }
    let settings = Settings::load(&arguments.config);
    let recordings = recordings::find(arguments, settings.as_ref().ok());
    let pictures = wants_pictures(arguments, &recordings)?;

    let mut bundle = Bundle::create(&arguments.output)?;
    bundle.add("about.txt", about())?;
    #[cfg(feature = "live")]
    bundle.add("devices.json", devices())?;
    bundle.add("config/stage.toml", &config)?;
    let verdict = match &settings {
        Ok(settings) => settings.notes.iter().fold("good\n".to_owned(), |text, note| text + note + "\n"),
        Err(problem) => format!("{problem}\n"),
    };
    bundle.add("config/verdict.txt", &verdict)?;
    let named = files_named_in(&String::from_utf8_lossy(&config), &arguments.config);
    for (number, (file, kind)) in named.iter().enumerate() {
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        if pictures || *kind != FileKind::Picture {
            bundle.add_file(&format!("config/{number}-{name}"), file)?;
        }
    }
    if let Some(listen) = settings.as_ref().ok().and_then(|s| s.http.as_ref()).map(|http| http.listen) {
        for (name, path) in [("daemon/state.json", "/api/v1/state"), ("daemon/health.txt", "/healthz"), ("daemon/metrics.txt", "/metrics")]
        {
            bundle.add(name, daemon::ask(listen, path))?;
        }
    }
    for recording in &recordings {
        recording.add(&mut bundle, pictures.then_some(arguments.seconds))?;
    }
    let contents = bundle.finish()?;
    let mut text = format!("{}:\n", arguments.output.display());
    contents.iter().for_each(|line| text += &format!("  {line}\n"));
    if !pictures {
        text += "No pictures of the stage are in it (--pictures takes them).\n";
    }
    print(printable_lines(&text).as_bytes())
}

/// Program, time and machine.
fn about() -> String {
    let features = [("live", cfg!(feature = "live")), ("http", cfg!(feature = "http"))];
    let features: Vec<&str> = features.into_iter().filter_map(|(name, is_on)| is_on.then_some(name)).collect();
    format!(
        "stagepose {} ({})\nmade {}\n{}",
        env!("CARGO_PKG_VERSION"),
        if features.is_empty() { "no features".to_owned() } else { features.join(", ") },
        utc::date_and_time(utc::now_s()),
        machine::describe()
    )
}

#[cfg(feature = "live")]
fn devices() -> String {
    // Serialising to a string fails only for non-string map keys, of which there are none.
    serde_json::to_string_pretty(&crate::capture::v4l2::devices()).expect("a listing has only string keys")
}

/// What was said by an option, else by whoever sits at the terminal; nobody's silence is a yes.
fn wants_pictures(arguments: &ReportArguments, recordings: &[Recording]) -> Result<bool, Failure> {
    if arguments.pictures || arguments.no_pictures || !io::stdin().is_terminal() || !io::stderr().is_terminal() {
        return Ok(arguments.pictures);
    }
    let count: usize = recordings.iter().map(|r| r.last_pictures(arguments.seconds).len()).sum();
    let question = format!("Take the stage's artwork and the last {count} pictures of the camera too? They may show people. [y/N] ");
    io::stderr().write_all(question.as_bytes()).map_err(Failure::output(Path::new("stderr")))?;
    let mut answer = String::new();
    // A terminal that cannot be read has said nothing.
    let _ = io::stdin().read_line(&mut answer);
    Ok(matches!(answer.trim().to_lowercase().as_str(), "y" | "yes"))
}
