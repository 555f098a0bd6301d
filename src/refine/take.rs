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
/// [`MAX_GAP_S`], before the first and after the last row in which it was seen, and in rows whose
/// stamps do not follow those before them.
pub fn refine(rows: &[Row]) -> Vec<Option<Refined>> {
    let mut refined = vec![None; rows.len()];
    let in_order = in_order(rows);
    let seen: Vec<usize> = (0..in_order.len()).filter(|&k| rows[in_order[k]].measured.is_some()).collect();
    let timestamp = |k: usize| rows[in_order[k]].timestamp;
    for stretch in seen.chunk_by(|a, b| timestamp(*b).seconds_since(timestamp(*a)) <= MAX_GAP_S) {
        let (Some(&first), Some(&last)) = (stretch.first(), stretch.last()) else { continue };
        let indices = &in_order[first..=last];
        let stretch: Vec<Row> = indices.iter().map(|&k| rows[k]).collect();
        for (k, pose) in indices.iter().zip(refine_stretch(&stretch)) {
            refined[*k] = pose;
        }
    }
    refined
}

/// Returns the rows whose stamps are later than all before them.
fn in_order(rows: &[Row]) -> Vec<usize> {
    let mut latest = None;
    let is_later = |k: &usize| {
        let timestamp = rows[*k].timestamp;
        let is_later = latest.is_none_or(|latest| timestamp > latest);
        latest = latest.max(Some(timestamp));
        is_later
    };
    (0..rows.len()).filter(is_later).collect()
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
    fn rows_out_of_order_are_left_out() {
        let mut rows = rows(30, &[]);
        rows[12].timestamp = rows[9].timestamp;
        let refined = refine(&rows);
        for (k, row) in refined.iter().enumerate() {
            assert_eq!(row.is_some(), k != 12, "row {k}");
        }
        let x = refined[13].expect("seen").pose.translation.x;
        assert!((x - 0.13).abs() < 1e-4, "{x}");
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
