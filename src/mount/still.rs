//! Still views: finds the rows of two clips that were taken while the rig stood still, and pairs
//! them.
//!
//! Clips with equal numbers of rows were taken together: row k of one belongs to row k of the
//! other. Other clips are cut into standstills of the rig, which are then paired in order. The
//! poses of one standstill make one view: their common error does not shrink with their number, so
//! neither does the covariance.

use nalgebra::Matrix6;

use super::views::{View, mean};

/// Minimum number of rows in a standstill, in clips that have standstills: fewer are a slow moment
/// of a movement. Chosen, not tuned. Raised, short halts are skipped; lowered, clips are cut at
/// false standstills and do not pair.
const MIN_ROWS: usize = 5;
/// Maximum motion between rows that counts as standing still: in sigmas, plus metres and radians,
/// since covariances do not include all the drift of a still pose. Chosen, not tuned. Raised, slow
/// movements are merged into one view; lowered, a standstill falls into pieces.
const SIGMAS: f64 = 4.0;
pub(super) const SLACK_M: f64 = 5e-4;
pub(super) const SLACK_RAD: f64 = 4e-4;

/// Two matching views, one from each clip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StillPair {
    /// The first row in each clip, from 0.
    pub rows: [usize; 2],
    /// The measured views; `None` if the stage was not found.
    pub views: [Option<View>; 2],
}

/// The clips cannot be paired; holds the number of standstills in each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Unpaired(pub [usize; 2]);

/// Returns the still views of two clips, given the measurement for each of their rows.
///
/// # Errors
/// When the clips differ in their numbers of rows and also in their numbers of standstills, or have
/// no standstills.
pub fn still_pairs(a: &[Option<View>], b: &[Option<View>]) -> Result<Vec<StillPair>, Unpaired> {
    if a.len() == b.len() {
        return Ok(together(a, b));
    }
    let [runs_a, runs_b] = [standstills(a), standstills(b)];
    if runs_a.len() != runs_b.len() || runs_a.is_empty() {
        return Err(Unpaired([runs_a.len(), runs_b.len()]));
    }
    let pair = |(i, j): (&std::ops::Range<usize>, &std::ops::Range<usize>)| StillPair {
        rows: [i.start, j.start],
        views: [merged(&a[i.clone()]), merged(&b[j.clone()])],
    };
    Ok(runs_a.iter().zip(&runs_b).map(pair).collect())
}

/// Pairs clips whose rows belong together.
fn together(a: &[Option<View>], b: &[Option<View>]) -> Vec<StillPair> {
    // If neither camera found anything, it is unknown whether the rig moved: each such row stays
    // separate.
    let both_still = |k: usize| (a[k].is_some() || b[k].is_some()) && is_still(&a[k - 1], &a[k]) && is_still(&b[k - 1], &b[k]);
    let runs = cut(a.len(), both_still);
    let has_standstills = runs.iter().any(|run| run.len() >= MIN_ROWS);
    let kept = runs.into_iter().filter(|run| !has_standstills || run.len() >= MIN_ROWS);
    kept.map(|run| StillPair { rows: [run.start; 2], views: [merged(&a[run.clone()]), merged(&b[run])] }).collect()
}

/// Returns the runs of rows in which the camera stood still and was found.
fn standstills(rows: &[Option<View>]) -> Vec<std::ops::Range<usize>> {
    let runs = cut(rows.len(), |k| is_still(&rows[k - 1], &rows[k]));
    runs.into_iter().filter(|run| run.len() >= MIN_ROWS && rows[run.start].is_some()).collect()
}

/// Cuts the rows into runs, in which each row is joined to the one before.
fn cut(rows: usize, is_joined: impl Fn(usize) -> bool) -> Vec<std::ops::Range<usize>> {
    let starts: Vec<usize> = (0..rows).filter(|k| *k == 0 || !is_joined(*k)).collect();
    let ends = starts.iter().skip(1).copied().chain([rows]);
    starts.iter().zip(ends).map(|(start, end)| *start..end).collect()
}

fn is_still(before: &Option<View>, after: &Option<View>) -> bool {
    let (Some(before), Some(after)) = (before, after) else { return before.is_none() && after.is_none() };
    let variance = |at: usize| (before.covariance + after.covariance).fixed_view::<3, 3>(at, at).trace();
    let shift = (after.pose.translation - before.pose.translation).norm();
    shift <= SIGMAS * variance(0).sqrt() + SLACK_M && before.pose.angle_to(&after.pose) <= SIGMAS * variance(3).sqrt() + SLACK_RAD
}

/// Merges rows into one view; its covariance is their mean.
fn merged(rows: &[Option<View>]) -> Option<View> {
    let poses: Vec<_> = rows.iter().flatten().map(|view| view.pose).collect();
    let covariance = rows.iter().flatten().map(|view| view.covariance).sum::<Matrix6<f64>>() / poses.len() as f64;
    Some(View { pose: mean(&poses)?, covariance })
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;
    use crate::geometry::Pose;

    fn at(x: f64) -> Option<View> {
        let pose = Pose::new(UnitQuaternion::from_scaled_axis(Vector3::new(0.0, x, 0.0)), Vector3::new(x, -4.0, 1.6));
        Some(View { pose, covariance: Matrix6::identity() * 1e-8 })
    }

    fn rows(pairs: &[StillPair]) -> Vec<[usize; 2]> {
        pairs.iter().map(|pair| pair.rows).collect()
    }

    #[test]
    fn each_still_is_a_separate_view() {
        let a = [at(0.0), at(0.5), None, at(-0.5)];
        let pairs = still_pairs(&a, &a).unwrap();
        assert_eq!(rows(&pairs), [[0, 0], [1, 1], [2, 2], [3, 3]]);
        assert!(pairs[2].views == [None, None] && pairs[3].views[1] == at(-0.5));
    }

    #[test]
    fn films_are_split_where_the_rig_moves() {
        // Still for 8 rows, moving for 6, still for 9; within a standstill the poses scatter.
        let path = |lead: usize| -> Vec<Option<View>> {
            let still = |x: f64, n: usize| (0..n).map(move |k| at(x + 1e-4 * f64::from(u8::from(k % 2 == 0))));
            let moving = (1..6).map(|k| at(0.1 * f64::from(k)));
            still(0.0, 8 + lead).chain(moving).chain(still(0.6, 9)).collect()
        };
        let (a, b) = (path(0), path(7));
        assert_eq!(rows(&still_pairs(&a, &a).unwrap()), [[0, 0], [13, 13]]);
        let apart = still_pairs(&a, &b).unwrap();
        assert_eq!(rows(&apart), [[0, 0], [13, 20]]);
        let x = apart[0].views[0].unwrap().pose.translation.x;
        assert!((x - 5e-5).abs() < 1e-6, "{x}");
        let b_without_second = &b[..18];
        assert_eq!(still_pairs(&a, b_without_second), Err(Unpaired([2, 1])));
    }
}
