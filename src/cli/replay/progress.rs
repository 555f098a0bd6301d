//! The progress bar: frames per second and time left on a terminal; elsewhere a line now and then.

use std::io::{IsTerminal, Write};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use crate::cli::logging;
use crate::daemon::PROGRESS_EVERY;

/// Interval of lines off a terminal. Chosen: a log stays short, and nobody thinks it hangs. Raised,
/// one waits longer for the first sign; lowered, logs fill.
const LINES_EVERY: Duration = Duration::from_secs(10);

#[derive(Clone)]
pub(in crate::cli) struct Progress {
    bar: ProgressBar,
    /// Off a terminal: when the next line is due.
    due: Option<Arc<Mutex<Instant>>>,
}

/// Returns the interval of lines off a terminal.
fn interval() -> Duration {
    let wanted = std::env::var(PROGRESS_EVERY).ok().and_then(|text| text.parse().ok());
    wanted.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok()).unwrap_or(LINES_EVERY)
}

/// Returns a line of progress: the percentage if the total is known, frames, what is being done.
fn line(done: u64, total: Option<u64>, words: &str) -> String {
    let frames = match total {
        Some(total) => format!("{} %, {done} of {total} frames", 100 * done.min(total) / total.max(1)),
        None => format!("{done} frames"),
    };
    if words.is_empty() { frames } else { format!("{frames}, {words}") }
}

impl Progress {
    /// Starts a bar for a known number of rows, or a counter.
    pub fn start(rows: Option<u64>) -> Self {
        Self::with(rows, ["{bar:32} {pos}/{len} frames, {per_sec}, {eta} left", "{spinner} {pos} frames, {per_sec}"])
    }

    /// As [`start`](Self::start), with other templates for the bar and the counter.
    pub fn with(total: Option<u64>, [words, counter_words]: [&str; 2]) -> Self {
        if !std::io::stderr().is_terminal() {
            let bar = ProgressBar::hidden();
            total.into_iter().for_each(|total| bar.set_length(total));
            return Self { bar, due: Some(Arc::new(Mutex::new(Instant::now() + interval()))) };
        }
        let (bar, template) = match total {
            Some(total) => (ProgressBar::new(total), words),
            None => (ProgressBar::new_spinner(), counter_words),
        };
        bar.set_style(ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()));
        logging::beside(&bar);
        Self { bar, due: None }
    }

    /// Prints a line if it is due.
    fn say_if_due(&self, words: &str) {
        let Some(due) = &self.due else { return };
        let mut due = due.lock().unwrap_or_else(PoisonError::into_inner);
        if Instant::now() < *due {
            return;
        }
        *due = Instant::now() + interval();
        // A closed terminal is no reason to stop.
        let _ = writeln!(std::io::stderr(), "stagepose: {}", line(self.bar.position(), self.bar.length(), words));
    }

    /// Sets the progress and what is being done.
    pub fn at(&self, done: u64, words: String) {
        self.bar.set_message(words.clone());
        self.bar.set_position(done);
        self.say_if_due(&words);
    }

    pub fn advance(&self) {
        self.bar.inc(1);
        self.say_if_due("");
    }

    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_the_percentage_where_the_total_is_known() {
        assert_eq!(line(12, Some(40), ""), "30 %, 12 of 40 frames");
        assert_eq!(line(40, Some(40), "adjusting, round 3"), "100 %, 40 of 40 frames, adjusting, round 3");
        assert_eq!(line(7, None, ""), "7 frames");
        assert_eq!(line(0, Some(0), ""), "0 %, 0 of 0 frames");
    }
}
