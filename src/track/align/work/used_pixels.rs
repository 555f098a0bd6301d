//! The pixels that a pose rests on, for pictures that show what the tracker saw.

use super::super::normal::squared_after;
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
        for ((run, step), gauge) in self.pixels.runs.iter().zip(&self.steps).zip(&self.gauges) {
            let light = self.light_of(run);
            let view = self.view(run, &light);
            let told = run.range().filter(|k| self.residuals.information[*k] > 0.0);
            out.extend(told.map(|k| UsedPixel {
                centre_px: self.pixels.place(k).map(|v| n * v as f32 + 0.5 * (n - 1.0)),
                sigmas: squared_after(&view, k, step).sqrt() / solved.scale as f32,
                takes_part: gauge.is_open,
            }));
        }
    }
}
