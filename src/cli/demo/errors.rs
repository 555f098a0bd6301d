//! Errors of the poses against the truth: the table at the end of the demo.

use std::fmt;

use crate::geometry::{Camera, Pose, Stage};
use crate::record::{PoseSample, State};

/// A pose is wrong if its position is off by more than this share of the camera's distance, or its
/// direction by more than this many degrees. Chosen: errors that would be visible on a stage.
/// Raised, fewer count as wrong.
const WRONG_SHARE: f64 = 0.01;
const WRONG_DEG: f64 = 0.3;

/// The error of one tracked frame.
#[derive(Debug, Clone, Copy, PartialEq)]
struct PoseError {
    position_mm: f64,
    /// Thousandths of the camera's distance from the stage's origin.
    permille: f64,
    rotation_deg: f64,
}

/// The errors of a whole run.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct PoseErrors {
    frames: usize,
    tracked: Vec<PoseError>,
}

impl PoseErrors {
    /// Counts a frame and compares its measured pose with the truth.
    pub(super) fn add(&mut self, sample: &PoseSample, truth: &Pose<Stage, Camera>) {
        self.frames += 1;
        let Some(measured) = sample.measurement.as_ref().filter(|_| sample.state == State::Tracking) else { return };
        self.tracked.push(PoseError::between(&measured.pose, truth));
    }

    /// Returns the number of poses reported as tracking that are wrong.
    fn wrong(&self) -> usize {
        self.tracked.iter().filter(|e| e.permille > 1e3 * WRONG_SHARE || e.rotation_deg > WRONG_DEG).count()
    }

    /// Returns the median, 95th percentile and maximum of one quantity.
    fn spread(&self, figure: fn(&PoseError) -> f64) -> [f64; 3] {
        let mut values: Vec<f64> = self.tracked.iter().map(figure).collect();
        values.sort_by(f64::total_cmp);
        [0.5, 0.95, 1.0].map(|share| percentile(&values, share))
    }
}

impl PoseError {
    fn between(pose: &Pose<Stage, Camera>, truth: &Pose<Stage, Camera>) -> Self {
        let off_m = (pose.translation - truth.translation).norm();
        Self {
            position_mm: 1e3 * off_m,
            permille: 1e3 * off_m / truth.translation.norm().max(f64::MIN_POSITIVE),
            rotation_deg: pose.angle_to(truth).to_degrees(),
        }
    }
}

/// Returns a percentile of sorted values, linearly interpolated; NaN if there are none.
fn percentile(sorted: &[f64], share: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let place = share * last as f64;
    let (below, rest) = (place as usize, place.fract());
    sorted[below] + (sorted[(below + 1).min(last)] - sorted[below]) * rest
}

impl fmt::Display for PoseErrors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (frames, tracking) = (self.frames, self.tracked.len());
        writeln!(f, "frames         {frames:>9}")?;
        writeln!(f, "tracking       {tracking:>9}   {:.1} %", 100.0 * tracking as f64 / frames.max(1) as f64)?;
        if tracking > 0 {
            writeln!(f, "error against the truth")?;
            writeln!(f, "                  median       p95       max")?;
            let figures: [fn(&PoseError) -> f64; 3] = [|e| e.position_mm, |e| e.permille, |e| e.rotation_deg];
            for (name, figure) in ["position [mm]", "  of dist. [‰]", "rotation [deg]"].into_iter().zip(figures) {
                let [median, p95, max] = self.spread(figure);
                writeln!(f, "{name:<14} {median:>9.4} {p95:>9.4} {max:>9.4}")?;
            }
        }
        let percent = 100.0 * WRONG_SHARE;
        writeln!(f, "wrong poses    {:>9}   (off by more than {percent} % of the distance or {WRONG_DEG} degrees)", self.wrong())
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    fn pose(x_m: f64, turn_deg: f64) -> Pose<Stage, Camera> {
        Pose::new(UnitQuaternion::from_scaled_axis(Vector3::z() * turn_deg.to_radians()), Vector3::new(x_m, -4.0, 0.0))
    }

    #[test]
    fn an_error_is_measured_in_the_stage() {
        let error = PoseError::between(&pose(0.002, 0.1), &pose(0.0, 0.0));
        assert!((error.position_mm - 2.0).abs() < 1e-9);
        assert!((error.permille - 0.5).abs() < 1e-9);
        assert!((error.rotation_deg - 0.1).abs() < 1e-9);
    }

    #[test]
    fn percentiles_lie_between_neighbours() {
        assert_eq!(percentile(&[1.0, 2.0, 3.0, 4.0, 5.0], 0.5), 3.0);
        assert_eq!(percentile(&[1.0, 2.0], 0.5), 1.5);
        assert_eq!(percentile(&[1.0, 2.0], 1.0), 2.0);
        assert!(percentile(&[], 0.5).is_nan());
    }

    #[test]
    fn wrong_poses_are_counted_by_place_and_by_direction() {
        let errors = |pairs: &[(f64, f64)]| PoseErrors {
            frames: 9,
            tracked: pairs.iter().map(|&(x, turn)| PoseError::between(&pose(x, turn), &pose(0.0, 0.0))).collect(),
        };
        assert_eq!(errors(&[(0.039, 0.29)]).wrong(), 0);
        assert_eq!(errors(&[(0.041, 0.0), (0.0, 0.31), (0.0, 0.0)]).wrong(), 2);
    }

    #[test]
    fn a_run_without_any_pose_still_has_a_table() {
        let table = PoseErrors { frames: 3, tracked: vec![] }.to_string();
        assert!(table.contains("tracking               0   0.0 %"), "{table}");
        assert!(!table.contains("NaN"), "{table}");
    }
}
