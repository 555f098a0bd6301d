//! `report`: one file with everything needed to find a fault; `daemon::report` defines its content.

mod daemon;

use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, ErrorKind, IsTerminal, Write};
use std::path::{Path, PathBuf};

use super::failure::Failure;
use super::output_file::print;
use crate::config::Settings;
use crate::daemon::report::{Recording, Report, config_text, find};
use crate::printable::printable_lines;

/// Put versions, config, events and the last recording into one file, to send to whoever can help.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  stagepose report --config stage.toml --output report.zip\n\n\
    Run it beside a running daemon or after it. It says what it took, and asks before it takes pictures of the stage.")]
pub(super) struct ReportArguments {
    /// The config of the camera and the stage; it may be invalid
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// The file to create; it must not exist yet
    #[arg(long, short, value_name = "FILE.zip")]
    output: PathBuf,
    /// Take this recording instead of the newest one in the recorder's folder
    #[arg(long, value_name = "CLIP")]
    clip: Option<PathBuf>,
    /// Include the last pictures of the recording and of the ring, and the stage's artwork, without
    /// asking
    #[arg(long, conflicts_with = "no_pictures")]
    pictures: bool,
    /// Include no pictures, without asking
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
    let text = config_text(&arguments.config).map_err(|e| {
        Failure::Usage(format!(
            "{}: cannot be read ({e}); give the config that was in use when the problem occurred",
            arguments.config.display()
        ))
    })?;
    if let Some(clip) = arguments.clip.as_ref().filter(|clip| !clip.join("timestamps.csv").is_file()) {
        return Err(Failure::Usage(format!(
            "--clip {}: is not a recording: it has no timestamps.csv; give a recording's folder",
            clip.display()
        )));
    }
    let settings = Settings::load(&arguments.config);
    let folder = settings.as_ref().ok().map(|settings| settings.recorder.folder.as_path());
    let recordings = find(arguments.clip.as_deref(), folder);
    let pictures = wants_pictures(arguments, &recordings)?;
    let file = Unfinished::create(&arguments.output)?;
    let picture_seconds = pictures.then_some(arguments.seconds);
    let said = said(settings.as_ref().ok());
    let report = Report { config: &arguments.config, text, settings: &settings, said, recordings, picture_seconds };
    let contents = file.write(&report)?;
    let mut text = format!("{}:\n", arguments.output.display());
    contents.iter().for_each(|line| text += &format!("  {line}\n"));
    if !pictures {
        text += "No pictures of the stage are in it (--pictures takes them).\n";
    }
    print(printable_lines(&text).as_bytes())
}

/// Returns what this config's daemon says about itself.
fn said(settings: Option<&Settings>) -> Vec<(&'static str, String)> {
    let pages = [("daemon/state.json", "/api/v1/state"), ("daemon/health.txt", "/healthz"), ("daemon/metrics.txt", "/metrics")];
    let http = settings.and_then(|settings| settings.http.as_ref());
    http.into_iter().flat_map(|http| pages.map(|(name, path)| (name, daemon::ask(http.listen, path)))).collect()
}

/// The report's file. It is always a new one, nothing is overwritten, and an incomplete report is
/// removed.
struct Unfinished {
    path: PathBuf,
    file: File,
    is_whole: bool,
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        if !self.is_whole {
            // If it cannot be removed, nothing else can be done.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

impl Unfinished {
    /// Creates the file, which must not exist.
    fn create(target: &Path) -> Result<Self, Failure> {
        let file = OpenOptions::new().write(true).create_new(true).open(target).map_err(|e| match e.kind() {
            ErrorKind::AlreadyExists => Failure::Usage(format!("--output {}: exists already; give a new file", target.display())),
            _ => Failure::output(target)(e),
        })?;
        Ok(Self { path: target.to_owned(), file, is_whole: false })
    }

    /// Writes the report and returns its list of contents.
    fn write(mut self, report: &Report<'_>) -> Result<Vec<String>, Failure> {
        let written = report.write(BufWriter::new(&self.file)).and_then(|contents| self.file.sync_all().map(|()| contents));
        let contents = written.map_err(Failure::output(&self.path))?;
        self.is_whole = true;
        Ok(contents)
    }
}

/// Whether to include pictures: by option, otherwise by asking at the terminal. No answer means no.
fn wants_pictures(arguments: &ReportArguments, recordings: &[Recording]) -> Result<bool, Failure> {
    if arguments.pictures || arguments.no_pictures || !io::stdin().is_terminal() || !io::stderr().is_terminal() {
        return Ok(arguments.pictures);
    }
    let count: usize = recordings.iter().map(|r| r.last_pictures(arguments.seconds).len()).sum();
    let question = format!("Take the stage's artwork and the last {count} pictures of the camera too? They may show people. [y/N] ");
    io::stderr().write_all(question.as_bytes()).map_err(Failure::output(Path::new("stderr")))?;
    let mut answer = String::new();
    // A terminal that cannot be read gave no answer.
    let _ = io::stdin().read_line(&mut answer);
    Ok(matches!(answer.trim().to_lowercase().as_str(), "y" | "yes"))
}
