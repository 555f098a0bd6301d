//! The pixels that a pose rests on, for pictures that show what the tracker saw.

use super::super::normal::squares_after;
use super::{LevelProblem, LevelSpec};

/// A pixel that alignment asked, as the solution left it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UsedPixel {
    /// Its centre, pixels of the frame (it covers two by two of them).
    pub centre_px: [f32; 2],
    /// Size of its residual in robust standard deviations; beyond 4.7 it counts nothing.
    pub sigmas: f32,
    /// Whether its tile takes part: tiles that show something else do not.
    pub takes_part: bool,
}

impl LevelProblem {
    /// Adds the pixels of the level that tell something; none where nothing was solved.
    pub fn used_pixels(&self, spec: &LevelSpec, out: &mut Vec<UsedPixel>) {
        let Some(solved) = self.solved else { return };
        let n = (1u32 << spec.level) as f32;
        let mut squares = Vec::new();
        for r in &self.runs {
            squares.clear();
            squares_after(&self.picture.view(r), &r.step.columns, 1, &mut squares);
            // Those that tell something, as the squares are.
            let told = r.run.range().filter(|k| self.picture.residuals.information[*k] > 0.0);
            out.extend(told.zip(&squares).map(|(k, square)| UsedPixel {
                centre_px: [0, 1].map(|axis| n * self.pixels().place[axis][k] + 0.5 * (n - 1.0)),
                sigmas: square.sqrt() / solved.scale as f32,
                takes_part: r.gauge.is_open,
            }));
        }
    }
}
