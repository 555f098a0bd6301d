//! The progress bar: frames per second and time left on a terminal, otherwise nothing.

use std::io::IsTerminal;

use indicatif::{ProgressBar, ProgressStyle};

use crate::cli::logging;

#[derive(Clone)]
pub(in crate::cli) struct Progress(ProgressBar);

impl Progress {
    /// Starts a bar for a known number of rows, or a counter.
    pub fn start(rows: Option<u64>) -> Self {
        Self::with(rows, ["{bar:32} {pos}/{len} frames, {per_sec}, {eta} left", "{spinner} {pos} frames, {per_sec}"])
    }

    /// As [`start`](Self::start), with other templates for the bar and the counter.
    pub fn with(total: Option<u64>, [words, counter_words]: [&str; 2]) -> Self {
        if !std::io::stderr().is_terminal() {
            return Self(ProgressBar::hidden());
        }
        let (bar, template) = match total {
            Some(total) => (ProgressBar::new(total), words),
            None => (ProgressBar::new_spinner(), counter_words),
        };
        bar.set_style(ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()));
        logging::beside(&bar);
        Self(bar)
    }

    /// Sets the progress and what is being done.
    pub fn at(&self, done: u64, words: String) {
        self.0.set_message(words);
        self.0.set_position(done);
    }

    pub fn advance(&self) {
        self.0.inc(1);
    }

    pub fn finish(&self) {
        self.0.finish_and_clear();
    }
}
