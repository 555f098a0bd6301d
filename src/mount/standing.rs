//! The pose of a camera that stands still: the mean of the poses measured in a clip.

use nalgebra::Matrix6;
use thiserror::Error;

use super::still::{SLACK_M, SLACK_RAD};
use super::views::{View, mean};

/// Minimum number of measured rows. Chosen: a second at 30 per second. Raised, clips must be
/// longer; lowered, noise that lasts some frames passes for the pose.
const MIN_ROWS: usize = 30;
/// Maximum number of rows over which noise averages: the pose of a still camera drifts a little
/// with the light, so a longer clip knows no more. Chosen. Raised, long clips state too small a
/// doubt.
const INDEPENDENT_ROWS: usize = 25;
/// Maximum distance between the means of the clip's first and last third, in sigmas of one row,
/// plus the slack of a standstill. Raised, a slowly sinking tripod passes.
const SIGMAS: f64 = 3.0;

/// A measured row: the pose with its whole covariance, and the part of it that all rows share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StandingRow {
    /// The measurement.
    pub view: View,
    /// The shared part of its covariance.
    pub common: Matrix6<f64>,
}

/// Why a clip does not say where its camera stands.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum NotStanding {
    /// Too few rows.
    #[error(
        "the stage is tracked in {0} rows, {MIN_ROWS} are needed; film it for a few seconds from where the camera will stand, with the stage \
         in view"
    )]
    Few(usize),
    /// The camera moved.
    #[error("the camera moved by {0:.1} mm and {1:.3} degrees during the clip; film again without touching it, or let the tripod settle")]
    Moved(f64, f64),
}

/// Returns the mean pose, with the covariance of its error.
///
/// # Errors
/// When there are too few rows, or the camera moved.
pub fn standing(rows: &[StandingRow]) -> Result<View, NotStanding> {
    let third = rows.len() / 3;
    let mean_of = |rows: &[StandingRow]| mean(&rows.iter().map(|row| row.view.pose).collect::<Vec<_>>());
    let means = [mean_of(rows), mean_of(&rows[..third]), mean_of(&rows[rows.len() - third..])];
    let [Some(pose), Some(first), Some(last)] = means.map(|pose| pose.filter(|_| rows.len() >= MIN_ROWS)) else {
        return Err(NotStanding::Few(rows.len()));
    };
    let n = rows.len() as f64;
    let common = rows.iter().map(|row| row.common).sum::<Matrix6<f64>>() / n;
    let noise = rows.iter().map(|row| row.view.covariance - row.common).sum::<Matrix6<f64>>() / n;
    let sigma = |at: usize| noise.fixed_view::<3, 3>(at, at).trace().max(0.0).sqrt();
    let (shift, rotation) = ((last.translation - first.translation).norm(), last.angle_to(&first));
    if shift > SIGMAS * sigma(0) + SLACK_M || rotation > SIGMAS * sigma(3) + SLACK_RAD {
        return Err(NotStanding::Moved(shift * 1e3, rotation.to_degrees()));
    }
    let covariance = common + noise / rows.len().min(INDEPENDENT_ROWS) as f64;
    Ok(View { pose, covariance: (covariance + covariance.transpose()) * 0.5 })
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;
    use crate::geometry::Pose;

    fn row(x: f64) -> StandingRow {
        let pose = Pose::new(UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.1 * x, 0.0)), Vector3::new(x, -4.0, 1.6));
        let common = Matrix6::identity() * 4e-6;
        StandingRow { view: View { pose, covariance: common + Matrix6::identity() * 1e-8 }, common }
    }

    #[test]
    fn noise_averages_out_and_the_common_doubt_stays() {
        let rows: Vec<StandingRow> = (0..90).map(|k| row(1e-4 * [1.0, -1.0][k % 2])).collect();
        let found = standing(&rows).unwrap();
        assert!((found.pose.translation - Vector3::new(0.0, -4.0, 1.6)).norm() < 1e-12);
        assert!((found.covariance[(0, 0)] - (4e-6 + 1e-8 / 25.0)).abs() < 1e-15);
    }

    #[test]
    fn short_clips_and_moving_cameras_are_refused() {
        assert_eq!(standing(&[]), Err(NotStanding::Few(0)));
        assert_eq!(standing(&[row(0.0); 29]), Err(NotStanding::Few(29)));
        let sinking: Vec<StandingRow> = (0..90).map(|k| row(1e-4 * f64::from(k))).collect();
        let Err(NotStanding::Moved(mm, _)) = standing(&sinking) else { panic!("it moved") };
        assert!((mm - 6.0).abs() < 0.1, "{mm}");
    }
}
