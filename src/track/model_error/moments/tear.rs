//! Torn frames: the rows above a line show another moment than those below it. Each cell has a
//! displacement along its motion; a step of these at a line is tested against a smooth change by
//! pose and readout.

use crate::track::model_error::tuning::TUNING;
use nalgebra::{SMatrix, SVector};

/// The displacement of a cell along its motion, from where the pose has it.
#[derive(Debug, Clone, Copy)]
pub struct Displaced {
    /// Row of the cell, as a fraction of the frame's height.
    pub row: f64,
    /// Displacement, pixels.
    pub off: f64,
    /// The picture's displacement per frame interval, pixels.
    pub way: f64,
    /// Derivative of the place along the motion by the pose.
    pub by_pose: SVector<f64, 6>,
}

/// Number of smooth terms: the pose (6), and the motion by the row and its square.
const SMOOTH_TERMS: usize = 8;

impl Displaced {
    fn smooth(&self) -> SVector<f64, SMOOTH_TERMS> {
        let y = self.row - 0.5;
        let p = &self.by_pose;
        SVector::from([p[0], p[1], p[2], p[3], p[4], p[5], self.way * y, self.way * y * y])
    }

    fn side(&self, line: f64) -> f64 {
        if self.row < line { -0.5 } else { 0.5 }
    }
}

/// Returns the step from the upper to the lower rows, in displacements per frame interval, if it
/// explains the cells clearly better than another pose and another readout do.
pub fn torn_by(cells: &[Displaced]) -> Option<f64> {
    let (mut normal, mut right, mut all) =
        (SMatrix::<f64, SMOOTH_TERMS, SMOOTH_TERMS>::zeros(), SVector::<f64, SMOOTH_TERMS>::zeros(), 0.0);
    for cell in cells {
        let columns = cell.smooth();
        normal += columns * columns.transpose();
        right += columns * cell.off;
        all += cell.off * cell.off;
    }
    // For a flat stage seen head-on, pose and rows cannot be told apart.
    let scale = normal.diagonal().map(|d| d.max(f64::MIN_POSITIVE).sqrt().recip());
    let scaled =
        SMatrix::<f64, SMOOTH_TERMS, SMOOTH_TERMS>::from_fn(|r, c| normal[(r, c)] * scale[r] * scale[c] + if r == c { 1e-6 } else { 0.0 });
    let inverse = scaled.cholesky()?.inverse();
    let inverse = SMatrix::<f64, SMOOTH_TERMS, SMOOTH_TERMS>::from_fn(|r, c| inverse[(r, c)] * scale[r] * scale[c]);
    let smooth_left = all - right.dot(&(inverse * right));
    let steps = (1..TUNING.tear_lines).filter_map(|k| {
        let line = k as f64 / TUNING.tear_lines as f64;
        let above = cells.iter().filter(|cell| cell.row < line).count();
        if above < TUNING.min_cells_beside_tear || cells.len() - above < TUNING.min_cells_beside_tear {
            return None;
        }
        let (mut with_smooth, mut own, mut with_off) = (SVector::<f64, SMOOTH_TERMS>::zeros(), 0.0, 0.0);
        for cell in cells {
            let step = cell.way * cell.side(line);
            with_smooth += cell.smooth() * step;
            own += step * step;
            with_off += step * cell.off;
        }
        let known = inverse * with_smooth;
        let (score, information) = (with_off - known.dot(&right), own - known.dot(&with_smooth));
        (information > 1e-3 * own).then(|| (score * score / information, score / information))
    });
    let (explained, step) = steps.max_by(|a, b| a.0.total_cmp(&b.0))?;
    tracing::debug!(cells = cells.len(), left = 1.0 - explained / smooth_left, step, "tear");
    (step.abs() >= TUNING.min_tear_step && smooth_left - explained < TUNING.max_tear_residual_ratio * smooth_left).then_some(step)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector6;

    use super::*;

    /// Cells of a plane 4 m away, seen obliquely by a camera that rotates and moves sideways. The
    /// pose is off by a little, and tiles by a tenth of a pixel.
    fn cells(ways: impl Fn(f64) -> f64) -> Vec<Displaced> {
        let f = 700.0;
        (0..120)
            .map(|k| {
                let (u, v) = (f64::from(k % 12) / 12.0 - 0.45, f64::from(k / 12) / 10.0 - 0.45);
                let (x, y) = (1.2 * u, 0.7 * v);
                let depth = 4.0 + 1.5 * u;
                let by_pose = SMatrix::<f64, 2, 6>::from_rows(&[
                    [f / depth, 0.0, -f * x / depth, -f * x * y, f * (1.0 + x * x), -f * y].into(),
                    [0.0, f / depth, -f * y / depth, -f * (1.0 + y * y), f * x * y, f * x].into(),
                ]);
                let way = by_pose * Vector6::new(0.03, 0.0, 0.005, 0.0, -0.01, 0.001);
                let noise = 0.14 * (f64::from(k) * 12.9898).sin();
                let error = by_pose * Vector6::new(0.003, -0.002, 0.004, 0.0003, 0.0006, -0.0002);
                let along = way.normalize();
                let off = way.norm() * ways(v + 0.5) + error.dot(&along) + noise;
                Displaced { row: v + 0.5, off, way: way.norm(), by_pose: by_pose.transpose() * along }
            })
            .collect()
    }

    #[test]
    fn a_step_at_any_row_is_a_tear() {
        for line in [0.2, 0.5, 0.75] {
            let step = torn_by(&cells(|row| if row < line { 0.4 } else { -0.6 })).unwrap();
            assert!((step + 1.0).abs() < 0.3, "{line}: {step}");
        }
    }

    #[test]
    fn a_rolling_shutter_is_not_a_tear() {
        assert_eq!(torn_by(&cells(|_| 0.0)), None);
        assert_eq!(torn_by(&cells(|row| 0.9 * (row - 0.5))), None);
        // A hand that starts in the middle of the frame, and one that shakes.
        assert_eq!(torn_by(&cells(|row| 0.9 * (row - 0.5).max(0.0))), None);
        assert_eq!(torn_by(&cells(|row| 0.3 * (4.0 * row).sin())), None);
    }
}
