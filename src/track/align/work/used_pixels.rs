//! The pixels that a pose rests on, for pictures that show what the tracker saw.

use super::super::normal::squares_after;
use super::{Corrected, Task, Work};

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

impl Work {
    /// Adds the pixels of the level that tell something. After [`Work::solve`].
    pub fn used_pixels(&self, task: &Task, solved: &Corrected, out: &mut Vec<UsedPixel>) {
        let n = (1u32 << task.level) as f32;
        let mut squares = Vec::new();
        for ((run, step), gauge) in self.pixels.runs.iter().zip(&self.steps).zip(&self.gauges) {
            let light = self.light_of(run);
            squares.clear();
            squares_after(&self.view(run, &light), step, 1, &mut squares);
            // Those that tell something, as the squares are.
            let told = run.range().filter(|k| self.residuals.information[*k] > 0.0);
            out.extend(told.zip(&squares).map(|(k, square)| UsedPixel {
                centre_px: [0, 1].map(|axis| n * self.pixels.place[axis][k] + 0.5 * (n - 1.0)),
                sigmas: square.sqrt() / solved.scale as f32,
                takes_part: gauge.is_open,
            }));
        }
    }
}
