//! Log messages to stderr, around the progress bar.

use std::io::{self, IsTerminal};
use std::sync::OnceLock;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use indicatif::ProgressBar;
use tracing::level_filters::LevelFilter;
use tracing::{Level, Metadata};
use tracing_subscriber::fmt::MakeWriter;
use tracing_subscriber::fmt::format::FmtSpan;

use crate::config::{LOG_LEVELS, LogFormat, LogSettings};
use crate::printable::printable;
use crate::telemetry::keep_log_line;

/// The progress bar that log messages step aside for, once there is one.
static BAR: OnceLock<ProgressBar> = OnceLock::new();

/// `--log`, which overrides `[log] level`.
#[derive(Debug, clap::Args)]
pub(super) struct LogArguments {
    /// What to log to stderr; `debug` has the time of every stage of every frame [default: the config's, else warn]
    #[arg(long, value_name = "LEVEL", ignore_case = true, value_parser = levels())]
    log: Option<LevelFilter>,
}

fn levels() -> impl TypedValueParser<Value = LevelFilter> {
    PossibleValuesParser::new(LOG_LEVELS.map(|(word, _)| word)).try_map(|word| word.parse::<LevelFilter>())
}

/// Starts logging; a second call changes nothing.
pub(super) fn start(arguments: &LogArguments, settings: LogSettings) {
    start_as(arguments, settings, false);
}

/// The same for a command that tracks only to find something out: what a tracker would say to an operator is part of its report, or
/// was tried and is not so. With `--log` it is heard all the same.
pub(super) fn start_for_trials(arguments: &LogArguments, settings: LogSettings) {
    start_as(arguments, settings, arguments.log.is_none());
}

fn start_as(arguments: &LogArguments, settings: LogSettings, trackers_are_quiet: bool) {
    let level = arguments.log.unwrap_or(settings.level);
    // systemd says so where stderr goes to its journal, which has its own clock and reads "<4>" as a priority.
    let to_journal = std::env::var_os("JOURNAL_STREAM").is_some() && !io::stderr().is_terminal();
    let lines = Lines { with_priority: to_journal && settings.format == LogFormat::Text, trackers_are_quiet };
    // Which part of the program speaks matters to those who look into it.
    let with_target = level >= LevelFilter::DEBUG || settings.format == LogFormat::Json;
    let builder =
        tracing_subscriber::fmt().with_max_level(level).with_writer(lines).with_span_events(FmtSpan::CLOSE).with_target(with_target);
    // It fails only where a subscriber is there already, which then does the work.
    let _ = match settings.format {
        LogFormat::Text if to_journal => builder.with_ansi(false).without_time().try_init(),
        LogFormat::Text => builder.with_ansi(false).try_init(),
        LogFormat::Json => builder.json().try_init(),
    };
}

/// From now on, messages step aside for this bar.
pub(super) fn beside(bar: &ProgressBar) {
    let _ = BAR.set(bar.clone());
}

/// Makes a writer for each message.
struct Lines {
    with_priority: bool,
    /// Whether what the tracker says goes nowhere.
    trackers_are_quiet: bool,
}

/// The module whose messages are those of a tracker.
const TRACKER: &str = "stagepose::track";

impl<'a> MakeWriter<'a> for Lines {
    type Writer = BesideBar;

    fn make_writer(&'a self) -> BesideBar {
        BesideBar { priority: "", goes_nowhere: false }
    }

    fn make_writer_for(&'a self, meta: &Metadata<'_>) -> BesideBar {
        let goes_nowhere = self.trackers_are_quiet && meta.target().starts_with(TRACKER);
        BesideBar { priority: if self.with_priority { priority(*meta.level()) } else { "" }, goes_nowhere }
    }
}

/// What the journal reads as the priority of a line (sd-daemon(3)).
fn priority(level: Level) -> &'static str {
    match level {
        Level::ERROR => "<3>",
        Level::WARN => "<4>",
        Level::INFO => "<6>",
        _ => "<7>",
    }
}

struct BesideBar {
    priority: &'static str,
    goes_nowhere: bool,
}

impl io::Write for BesideBar {
    fn write(&mut self, text: &[u8]) -> io::Result<usize> {
        if self.goes_nowhere {
            return Ok(text.len());
        }
        // A message comes in one piece, with one line end of its own. What else would move a terminal, or begin a line that
        // nobody logged, came with a name from outside. Escaped as JSON escapes it, a line of JSON stays one.
        let whole = String::from_utf8_lossy(text);
        let (message, end) = whole.strip_suffix('\n').map_or((&*whole, ""), |message| (message, "\n"));
        let message = printable(message);
        keep_log_line(&message);
        let line = [self.priority, &*message, end].concat().into_bytes();
        match BAR.get() {
            Some(bar) => bar.suspend(|| io::stderr().write_all(&line))?,
            None => io::stderr().write_all(&line)?,
        }
        Ok(text.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}
