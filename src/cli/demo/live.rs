//! Prints the pose while tracking: one line that is rewritten on a terminal, otherwise a line now
//! and then.

use std::io::{self, IsTerminal, Stdout, Write};

use crate::cli::angles::camera_words;
use crate::geometry::{Camera, Pose, Stage};
use crate::record::PoseSample;

/// Frames per line if the output is not a terminal: two lines a second at 30 frames per second.
/// Raised, a log has fewer lines.
const LINE_EVERY: u64 = 15;

/// Prints poses as they come.
#[derive(Debug)]
pub(super) struct LivePrint<W> {
    out: W,
    /// On a terminal: rewrite one line.
    rewrite: bool,
}

impl LivePrint<Stdout> {
    /// Prints to standard output.
    pub(super) fn stdout() -> Self {
        let out = io::stdout();
        Self { rewrite: out.is_terminal(), out }
    }
}

impl<W: Write> LivePrint<W> {
    #[cfg(test)]
    pub(super) fn to(out: W, rewrite: bool) -> Self {
        Self { out, rewrite }
    }

    /// Shows a frame's pose and its error.
    pub(super) fn show(&mut self, sample: &PoseSample, truth: &Pose<Stage, Camera>) -> io::Result<()> {
        if self.rewrite {
            // Return to the line's start, and clear the rest of a longer line.
            write!(self.out, "\r{}\x1b[K", line(sample, truth, false))?;
            return self.out.flush();
        }
        if sample.sequence.is_multiple_of(LINE_EVERY) {
            writeln!(self.out, "{}", line(sample, truth, true))?;
        }
        Ok(())
    }

    /// Ends the rewritten line.
    pub(super) fn end(&mut self) -> io::Result<()> {
        if self.rewrite { writeln!(self.out) } else { Ok(()) }
    }
}

/// Returns the line. On a terminal it must fit the width, so the quaternion is left out.
fn line(sample: &PoseSample, truth: &Pose<Stage, Camera>, with_quaternion: bool) -> String {
    let state = sample.state.word();
    let start = format!("{:>6} {state:<9}", sample.sequence);
    let Some(pose) = &sample.pose else { return start };
    let [x, y, z, w] = pose.orientation_xyzw();
    let off_mm = 1e3 * (pose.translation - truth.translation).norm();
    let quaternion = if with_quaternion { format!("  turned {x:+.4} {y:+.4} {z:+.4} {w:+.4}") } else { String::new() };
    format!("{start} {}{quaternion}  off {off_mm:.2} mm", camera_words(pose))
}
