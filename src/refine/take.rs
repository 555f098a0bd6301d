//! The rows of one body over a take: stretches in which it was seen without a long gap.

use nalgebra::Matrix6;

use super::smoother::{Sighting, smooth};
use crate::frame::Timestamp;
use crate::geometry::{Body, Camera, Pose};

/// Maximum time between two rows in which the body was seen, for the rows between them to be
/// bridged, seconds. Raised, poses are reported that nothing supports.
const MAX_GAP_S: f64 = 0.5;

/// What a frame measured of a body.
#[derive(Debug, Clone, Copy)]
pub struct Measured {
    /// The pose.
    pub pose: Pose<Body, Camera>,
    /// Covariance of [δp, δθ] by noise, new in every frame: p_true = p + δp, R_true = Exp(δθ) R.
    pub noise: Matrix6<f64>,
    /// The same by errors that all frames share.
    pub common: Matrix6<f64>,
}

/// A row of a take.
#[derive(Debug, Clone, Copy)]
pub struct Row {
    /// Its stamp.
    pub timestamp: Timestamp,
    /// What was measured in it; `None` where the body was not seen.
    pub measured: Option<Measured>,
}

/// A refined pose.
#[derive(Debug, Clone, Copy)]
pub struct Refined {
    /// The pose.
    pub pose: Pose<Body, Camera>,
    /// Its covariance, as in [`Measured::noise`], with all contributions.
    pub covariance: Matrix6<f64>,
    /// Whether the body was not seen in this row, only before and after it.
    pub is_bridged: bool,
}

/// Refines the poses of a body. `None` in rows where nothing was seen for longer than
/// [`MAX_GAP_S`], and before the first and after the last row in which it was seen. Stamps must
/// rise.
pub fn refine(rows: &[Row]) -> Vec<Option<Refined>> {
    let mut refined = vec![None; rows.len()];
    let seen: Vec<usize> = (0..rows.len()).filter(|&k| rows[k].measured.is_some()).collect();
    let is_together = |a: &usize, b: &usize| rows[*b].timestamp.seconds_since(rows[*a].timestamp) <= MAX_GAP_S;
    for stretch in seen.chunk_by(is_together) {
        let (Some(&first), Some(&last)) = (stretch.first(), stretch.last()) else { continue };
        for (k, pose) in (first..=last).zip(refine_stretch(&rows[first..=last])) {
            refined[k] = pose;
        }
    }
    refined
}

/// Refines a stretch; where it cannot be smoothed, the measured poses stay.
fn refine_stretch(rows: &[Row]) -> Vec<Option<Refined>> {
    let start = rows.first().map_or_else(Timestamp::default, |row| row.timestamp);
    let sighting = |row: &Row| Sighting {
        at_s: row.timestamp.seconds_since(start),
        seen: row.measured.map(|measured| (measured.pose, measured.noise)),
    };
    let sightings: Vec<Sighting> = rows.iter().map(sighting).collect();
    let Some(smoothed) = smooth(&sightings) else {
        let as_measured = |m: Measured| Refined { pose: m.pose, covariance: m.noise + m.common, is_bridged: false };
        return rows.iter().map(|row| row.measured.map(as_measured)).collect();
    };
    let mut common = Matrix6::zeros();
    let with_common = |(row, (pose, noise)): (&Row, (Pose<Body, Camera>, Matrix6<f64>))| {
        common = row.measured.map_or(common, |measured| measured.common);
        Some(Refined { pose, covariance: noise + common, is_bridged: row.measured.is_none() })
    };
    rows.iter().zip(smoothed).map(with_common).collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    /// Rows at 30 frames per second of a camera that moves along x; those in `hidden` show nothing.
    fn rows(count: usize, hidden: &[std::ops::Range<usize>]) -> Vec<Row> {
        let row = |k: usize| Row {
            timestamp: Timestamp::from_ns(k as i64 * 33_333_333),
            measured: (!hidden.iter().any(|range| range.contains(&k))).then(|| Measured {
                pose: Pose::new(UnitQuaternion::identity(), Vector3::x() * (0.01 * k as f64)),
                noise: Matrix6::identity() * 1e-8,
                common: Matrix6::identity() * 1e-6,
            }),
        };
        (0..count).map(row).collect()
    }

    #[test]
    fn short_gaps_are_bridged_and_long_ones_left() {
        let refined = refine(&rows(120, &[0..3, 20..30, 50..70, 110..120]));
        let what = |k: usize| refined[k].map(|row| row.is_bridged);
        for (k, expected) in
            [(0, None), (3, Some(false)), (25, Some(true)), (49, Some(false)), (50, None), (60, None), (70, Some(false)), (115, None)]
        {
            assert_eq!(what(k), expected, "row {k}");
        }
        let bridged = refined[25].expect("bridged");
        assert!((bridged.pose.translation.x - 0.25).abs() < 1e-3, "{:?}", bridged.pose);
    }

    #[test]
    fn shared_errors_do_not_average_out() {
        for row in refine(&rows(90, &[40..44, 60..62])).into_iter().flatten() {
            assert!((0..6).all(|k| row.covariance[(k, k)] > 1e-6), "{}", row.covariance);
            let most = if row.is_bridged { 1e-5 } else { 1.02e-6 };
            assert!((0..3).all(|k| row.covariance[(k, k)] < most), "{}", row.covariance);
        }
    }

    #[test]
    fn a_single_row_stays_as_measured() {
        let rows = rows(1, &[]);
        let refined = refine(&rows)[0].expect("seen");
        let measured = rows[0].measured.expect("seen");
        assert_eq!(refined.pose.translation, measured.pose.translation);
        assert!((refined.covariance - measured.noise - measured.common).norm() < 1e-12);
        assert!(refine(&[]).is_empty());
    }
}
