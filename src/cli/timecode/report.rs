//! What `timecode` says about a sound.

use std::fmt::Write;
use std::path::Path;

use serde_json::{Value, json};

use crate::timecode::{TimecodeRate, TimecodeRun, TimecodeTrack};

/// Maximum number of runs that are printed; the JSON has all. Raised, a damaged tape fills the
/// screen.
const MAX_RUNS: usize = 20;
/// Speeds closer to 1 are not mentioned: clocks of sound cards differ by less.
const USUAL_SPEED: f64 = 2e-4;

/// What was read.
pub(super) struct Decoded<'a> {
    pub file: &'a Path,
    pub track: &'a TimecodeTrack,
    /// Length of the sound, seconds.
    pub length_s: f64,
    /// Words that nothing confirmed.
    pub unconfirmed: u64,
    /// The rate that it should have.
    pub wanted: Option<TimecodeRate>,
}

impl Decoded<'_> {
    /// Returns the text.
    pub fn text(&self) -> String {
        let runs = self.track.runs();
        let frames: usize = runs.iter().map(|run| run.frames).sum();
        let rate = self.track.rate().map_or(String::new(), |rate| format!(" at {rate}"));
        let (file, length_s) = (self.file.display(), self.length_s);
        let mut text = String::new();
        // Writing to a string does not fail.
        let _ = writeln!(text, "{file}: {length_s:.3} s, {frames} frames of timecode{rate}");
        for (k, run) in runs.iter().take(MAX_RUNS).enumerate() {
            if let Some(before) = k.checked_sub(1).and_then(|before| runs.get(before)) {
                let gap_s = run.first.at.seconds_since(before.last.at);
                let _ = writeln!(text, "  nothing continues it for {gap_s:.3} s");
            }
            let _ = writeln!(text, "  {}", self.sentence(run));
        }
        if runs.len() > MAX_RUNS {
            let _ = writeln!(text, "  and {} more runs", runs.len() - MAX_RUNS);
        }
        if self.unconfirmed > 0 {
            let _ = writeln!(text, "  left out: {} frames that no neighbour confirms", self.unconfirmed);
        }
        if let Some((wanted, heard)) = self.wrong_rate() {
            let _ = writeln!(text, "  note: it runs at {heard}, not at {wanted}; set the generator, or --rate and `rate` in [timecode]");
        }
        text
    }

    fn sentence(&self, run: &TimecodeRun) -> String {
        let ([first, last], frames) = ([run.first, run.last].map(|mark| (mark.code, mark.at.seconds())), run.frames);
        let speed = self.speed(run).filter(|speed| (speed - 1.0).abs() > USUAL_SPEED);
        let speed = speed.map_or(String::new(), |speed| format!(", {speed:.4} times its speed"));
        format!("{} at {:.4} s to {} at {:.4} s: {frames} frames{speed}", first.0, first.1, last.0, last.1)
    }

    fn speed(&self, run: &TimecodeRun) -> Option<f64> {
        Some(run.fps()? / self.track.rate()?.fps())
    }

    /// Returns the rate that it should have and the one it has, if they differ.
    fn wrong_rate(&self) -> Option<(TimecodeRate, TimecodeRate)> {
        self.wanted.zip(self.track.heard_rate()).filter(|(wanted, heard)| wanted != heard)
    }

    /// Returns the result as JSON.
    pub fn json(&self) -> String {
        let run = |run: &TimecodeRun| {
            json!({"first": run.first.code.to_string(), "first_s": run.first.at.seconds(), "last": run.last.code.to_string(),
                "last_s": run.last.at.seconds(), "frames": run.frames, "speed": self.speed(run)})
        };
        let runs: Vec<Value> = self.track.runs().iter().map(run).collect();
        let rate = self.track.rate().map(TimecodeRate::word);
        let wrong = self.wrong_rate().is_some();
        let value = json!({"length_s": self.length_s, "rate": rate, "wrong_rate": wrong, "runs": runs, "unconfirmed": self.unconfirmed});
        value.to_string() + "\n"
    }
}

/// Returns a line per frame.
pub(super) fn frames_csv(track: &TimecodeTrack) -> String {
    let mut text = "#seconds,timecode,direction\n".to_owned();
    for mark in track.marks() {
        let direction = if mark.is_reverse { "backward" } else { "forward" };
        let _ = writeln!(text, "{},{},{direction}", mark.at.decimal_seconds(), mark.code);
    }
    text
}
