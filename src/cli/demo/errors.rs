//! Errors of the poses against the truth: the table at the end of the demo.

use std::fmt;

use crate::geometry::{Camera, Pose, Stage};
use crate::record::{PoseSample, State};
use crate::simulate::pose_error::{WRONG_DEG, WRONG_SHARE};
use crate::simulate::{PoseError, percentile};

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
        self.tracked.push(PoseError::between(&measured.pose, truth, truth.translation.norm()));
    }

    /// Returns the number of poses reported as tracking that are wrong.
    fn wrong(&self) -> usize {
        self.tracked.iter().filter(|e| e.is_wrong()).count()
    }

    /// Returns the median, 95th percentile and maximum of one quantity.
    fn spread(&self, figure: fn(&PoseError) -> f64) -> [f64; 3] {
        let mut values: Vec<f64> = self.tracked.iter().map(figure).collect();
        values.sort_by(f64::total_cmp);
        [0.5, 0.95, 1.0].map(|share| percentile(&values, share).unwrap_or(f64::NAN))
    }
}

impl fmt::Display for PoseErrors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (frames, tracking) = (self.frames, self.tracked.len());
        writeln!(f, "frames         {frames:>9}")?;
        writeln!(f, "tracking       {tracking:>9}   {:.1} %", 100.0 * tracking as f64 / frames.max(1) as f64)?;
        if tracking > 0 {
            writeln!(f, "error against the truth")?;
            writeln!(f, "                  median       p95       max")?;
            let figures: [fn(&PoseError) -> f64; 3] = [|e| 1e3 * e.position_m, |e| 1e3 * e.share, |e| e.rotation_deg];
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

    fn pose(x_m: f64, rotation_deg: f64) -> Pose<Stage, Camera> {
        Pose::new(UnitQuaternion::from_scaled_axis(Vector3::z() * rotation_deg.to_radians()), Vector3::new(x_m, -4.0, 0.0))
    }

    #[test]
    fn an_error_is_measured_in_the_stage() {
        let error = PoseError::between(&pose(0.002, 0.1), &pose(0.0, 0.0), 4.0);
        assert!((1e3 * error.position_m - 2.0).abs() < 1e-9);
        assert!((1e3 * error.share - 0.5).abs() < 1e-9);
        assert!((error.rotation_deg - 0.1).abs() < 1e-9);
    }

    #[test]
    fn percentiles_lie_between_neighbours() {
        assert_eq!(percentile(&[1.0, 2.0, 3.0, 4.0, 5.0], 0.5), Some(3.0));
        assert_eq!(percentile(&[1.0, 2.0], 0.5), Some(1.5));
        assert_eq!(percentile(&[1.0, 2.0], 1.0), Some(2.0));
        assert_eq!(percentile(&[], 0.5), None);
    }

    #[test]
    fn wrong_poses_are_counted_by_place_and_by_direction() {
        let errors = |pairs: &[(f64, f64)]| PoseErrors {
            frames: 9,
            tracked: pairs.iter().map(|&(x, rotation)| PoseError::between(&pose(x, rotation), &pose(0.0, 0.0), 4.0)).collect(),
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
