//! The solver's start: closed forms from few views, choosing the one that most views agree with.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use super::residual::Unknowns;
use super::views::{Stages, ViewPair, mean};
use crate::geometry::pose::quaternion;
use crate::geometry::{Camera, FilmingCamera, Pose, Stage};

/// Maximum number of triples of views tried for separate stages: all triples of twelve views. With
/// more views as many, evenly spread, so that no view is in most of them. Raised, the start takes
/// longer; lowered, fewer triples are free of wrong views.
const MAX_TRIPLES: usize = 220;

/// Returns the candidate with the smallest sum of distances (not squared, so that one wrong view
/// cannot spoil it).
pub(super) fn start(pairs: &[ViewPair], stages: Stages) -> Option<Unknowns> {
    let candidates: Vec<Unknowns> = match stages {
        Stages::Shared => pairs.iter().map(|pair| Unknowns { mount: direct(pair), between: Pose::identity() }).collect(),
        Stages::Apart => triples(pairs).into_iter().filter_map(|triple| hand_eye(&triple)).chain(hand_eye(pairs)).collect(),
    };
    let disagreement = |unknowns: &Unknowns| Some(unknowns.distances(pairs)?.iter().map(|d| d.sqrt()).sum::<f64>());
    let rated = candidates.into_iter().filter_map(|unknowns| Some((disagreement(&unknowns).filter(|d| d.is_finite())?, unknowns)));
    rated.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, unknowns)| unknowns)
}

/// Returns T_tracking_filming = T_stage_tracking⁻¹ T_stage_filming.
fn direct(pair: &ViewPair) -> Pose<Camera, FilmingCamera> {
    pair.tracking.pose.inverse() * pair.filming.pose.renamed()
}

fn triples(pairs: &[ViewPair]) -> Vec<[ViewPair; 3]> {
    let n = pairs.len();
    let count = n * n.saturating_sub(1) * n.saturating_sub(2) / 6;
    let all = (0..n).flat_map(|i| (i + 1..n).flat_map(move |j| (j + 1..n).map(move |k| [pairs[i], pairs[j], pairs[k]])));
    all.step_by(count.div_ceil(MAX_TRIPLES).max(1)).collect()
}

/// Solves the hand-eye problem: the tracking camera's motions are the filming camera's, seen
/// through the mount: A_ij X = X B_ij. First the rotation that aligns the rotation axes, then the
/// shift by linear least squares (Tsai and Lenz 1989; Park and Martin 1994).
fn hand_eye(pairs: &[ViewPair]) -> Option<Unknowns> {
    let n = pairs.len();
    let indices = (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j)));
    let motions: Vec<_> = indices
        .map(|(i, j)| {
            let a = pairs[i].tracking.pose.inverse() * pairs[j].tracking.pose;
            let b = pairs[i].filming.pose.inverse() * pairs[j].filming.pose;
            (a, b)
        })
        .collect();
    let cross: Matrix3<f64> = motions.iter().map(|(a, b)| a.rotation.scaled_axis() * b.rotation.scaled_axis().transpose()).sum();
    let svd = cross.svd(true, true);
    // Without a second axis the rotation is undetermined.
    if svd.singular_values[1] <= 1e-6 * svd.singular_values[0] || svd.singular_values[0] <= 0.0 {
        return None;
    }
    let (u, v_t) = (svd.u?, svd.v_t?);
    let sign = (u * v_t).determinant().signum();
    let rotation = quaternion(&(u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t));
    let mut left = DMatrix::zeros(3 * motions.len(), 3);
    let mut right = DVector::zeros(3 * motions.len());
    for (k, (a, b)) in motions.iter().enumerate() {
        left.fixed_view_mut::<3, 3>(3 * k, 0).copy_from(&(a.rotation_matrix() - Matrix3::identity()));
        right.fixed_rows_mut::<3>(3 * k).copy_from(&(rotation * b.translation - a.translation));
    }
    let shift = left.svd(true, true).solve(&right, 1e-9).ok()?;
    let mount = Pose::new(rotation, Vector3::new(shift[0], shift[1], shift[2]));
    // The relation of the boards, from each pair.
    let between = |pair: &ViewPair| pair.tracking.pose * mount * pair.filming.pose.renamed::<Stage, FilmingCamera>().inverse();
    Some(Unknowns { mount, between: mean(&pairs.iter().map(between).collect::<Vec<_>>())? })
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix6;

    use super::*;
    use crate::mount::views::View;

    #[test]
    fn no_view_is_in_more_than_half_of_the_triples() {
        // Each view stands at its own number, metres to the right.
        let at =
            |n: usize| View { pose: Pose::new(Default::default(), nalgebra::Vector3::x() * n as f64), covariance: Matrix6::identity() };
        for n in [3, 12, 13, 25, 40] {
            let pairs: Vec<ViewPair> = (0..n).map(|k| ViewPair { tracking: at(k), filming: at(k) }).collect();
            let triples = triples(&pairs);
            let with = |k: usize| triples.iter().filter(|t| t.iter().any(|p| p.tracking.pose.translation.x == k as f64)).count();
            let most = (0..n).map(with).max().unwrap();
            assert!(!triples.is_empty() && triples.len() <= MAX_TRIPLES);
            assert!(n == 3 || 2 * most <= triples.len(), "{n}: one view is in {most} of {}", triples.len());
        }
    }
}
