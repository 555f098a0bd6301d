//! Logs to stderr without breaking the progress bar.

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

/// The progress bar, once there is one; it is suspended while a message is written.
static BAR: OnceLock<ProgressBar> = OnceLock::new();

/// The `--log` option, which overrides `[log] level`.
#[derive(Debug, clap::Args)]
pub(super) struct LogArguments {
    /// What to log to stderr; `debug` includes the time of every stage of every frame [default: the
    /// config's, else warn]
    #[arg(long, value_name = "LEVEL", ignore_case = true, value_parser = levels())]
    log: Option<LevelFilter>,
}

fn levels() -> impl TypedValueParser<Value = LevelFilter> {
    PossibleValuesParser::new(LOG_LEVELS.map(|(word, _)| word)).try_map(|word| word.parse::<LevelFilter>())
}

/// Starts logging; a second call has no effect.
pub(super) fn start(arguments: &LogArguments, settings: LogSettings) {
    start_as(arguments, settings, false);
}

/// As [`start`], for commands that track only to find something out. They report what a tracker
/// would tell an operator, or only tried a setup that does not hold, so the tracker's messages are
/// dropped unless `--log` is given.
pub(super) fn start_for_trials(arguments: &LogArguments, settings: LogSettings) {
    start_as(arguments, settings, arguments.log.is_none());
}

fn start_as(arguments: &LogArguments, settings: LogSettings, trackers_are_quiet: bool) {
    let level = arguments.log.unwrap_or(settings.level);
    // systemd sets JOURNAL_STREAM if stderr goes to its journal, which adds its own time and reads
    // "<4>" as a priority.
    let to_journal = std::env::var_os("JOURNAL_STREAM").is_some() && !io::stderr().is_terminal();
    let lines = Lines { with_priority: to_journal && settings.format == LogFormat::Text, trackers_are_quiet };
    // The module name matters only for debugging and for programs.
    let with_target = level >= LevelFilter::DEBUG || settings.format == LogFormat::Json;
    let builder =
        tracing_subscriber::fmt().with_max_level(level).with_writer(lines).with_span_events(FmtSpan::CLOSE).with_target(with_target);
    // This fails only if a subscriber is already installed, which then does the work.
    let _ = match settings.format {
        LogFormat::Text if to_journal => builder.with_ansi(false).without_time().try_init(),
        LogFormat::Text => builder.with_ansi(false).try_init(),
        LogFormat::Json => builder.json().try_init(),
    };
}

/// Suspends this bar around messages from now on.
pub(super) fn beside(bar: &ProgressBar) {
    let _ = BAR.set(bar.clone());
}

/// Makes a writer per message.
struct Lines {
    with_priority: bool,
    /// Whether the tracker's messages are dropped.
    trackers_are_quiet: bool,
}

/// The module prefix of the tracker's messages.
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

/// Returns the prefix that the journal reads as a line's priority (sd-daemon(3)).
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
        // A message arrives in one piece with one line end. Any other control character came from
        // an outside name: escape it, so that it cannot move the terminal's cursor or forge a log
        // line. The escapes are JSON's, so a JSON line stays valid.
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
