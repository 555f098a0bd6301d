//! The pose while it is being tracked: one line that is rewritten on a terminal, now and then a line elsewhere.

use std::io::{self, IsTerminal, Stdout, Write};

use crate::cli::angles::camera_words;
use crate::geometry::{Camera, Pose, Stage};
use crate::record::PoseSample;

/// Frames a line where no terminal shows them: two lines a second at 30 frames a second. Raised, a log has fewer lines.
const LINE_EVERY: u64 = 15;

/// Prints poses as they come.
#[derive(Debug)]
pub(super) struct LivePrint<W> {
    out: W,
    /// At a terminal: rewrite one line.
    rewrite: bool,
}

impl LivePrint<Stdout> {
    /// To standard output.
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

    /// Shows a frame's pose and how far off it is.
    pub(super) fn show(&mut self, sample: &PoseSample, truth: &Pose<Stage, Camera>) -> io::Result<()> {
        if self.rewrite {
            // Back to the line's start, and clear what a longer line left behind.
            write!(self.out, "\r{}\x1b[K", line(sample, truth, false))?;
            return self.out.flush();
        }
        if sample.sequence.is_multiple_of(LINE_EVERY) {
            writeln!(self.out, "{}", line(sample, truth, true))?;
        }
        Ok(())
    }

    /// Leaves the rewritten line.
    pub(super) fn end(&mut self) -> io::Result<()> {
        if self.rewrite { writeln!(self.out) } else { Ok(()) }
    }
}

/// On a terminal a line must not be longer than it is wide: there the quaternion is left out.
fn line(sample: &PoseSample, truth: &Pose<Stage, Camera>, with_quaternion: bool) -> String {
    let state = sample.state.word();
    let start = format!("{:>6} {state:<9}", sample.sequence);
    let Some(pose) = &sample.pose else { return start };
    let [x, y, z, w] = pose.orientation_xyzw();
    let off_mm = 1e3 * (pose.translation - truth.translation).norm();
    let quaternion = if with_quaternion { format!("  turned {x:+.4} {y:+.4} {z:+.4} {w:+.4}") } else { String::new() };
    format!("{start} {}{quaternion}  off {off_mm:.2} mm", camera_words(pose))
}
