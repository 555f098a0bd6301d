//! The least-squares mount: weights every view by its covariance, and rejects views that contradict
//! the others.

use nalgebra::{Matrix3, Matrix6, SMatrix, SVector, Vector3};
use thiserror::Error;

use super::residual::Unknowns;
use super::start;
use super::views::{Stages, ViewPair};
use crate::geometry::{Camera, FilmingCamera, Pose, Stage};

/// The result for a pair of views.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Used {
    /// Squared error of the pair relative to its covariance; 6 on average if the covariances are
    /// correct.
    pub squared_distance: f64,
    /// False if it contradicts the others and was rejected.
    pub is_used: bool,
}

/// The mount.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// `T_tracking_filming`.
    pub mount: Pose<Camera, FilmingCamera>,
    /// Covariance of [δt, δφ] in the tracking camera's axes: t_true = t + δt, R_true = Exp(δφ) R.
    pub covariance: Matrix6<f64>,
    /// The pose of the filming camera's stage in the tracking camera's; the identity if they share
    /// one.
    pub between: Pose<Stage, Stage>,
    /// How much more the views scatter than their covariances predict, as a factor on sigma; at
    /// least 1, and already applied to `covariance`.
    pub excess: f64,
    /// The result for each pair, in the order given.
    pub views: Vec<Used>,
}

/// Why views do not determine the mount.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum Unsolvable {
    /// Too few pairs.
    #[error("{found} pairs of views were measured, {wanted} are needed")]
    TooFew {
        /// Number of pairs.
        found: usize,
        /// Number of pairs needed.
        wanted: usize,
    },
    /// The rig did not rotate between the views.
    #[error("the rig turned by {rotation_deg:.1} degrees at most between the views")]
    NotRotated {
        /// The largest rotation between two of them, degrees.
        rotation_deg: f64,
    },
    /// All rotations had the same axis.
    #[error("the rig turned about one axis only")]
    OneAxis {
        /// That axis in the tracking camera's frame: x right, y down, z forward.
        axis: Vector3<f64>,
        /// Rotation about any other axis, degrees (RMS).
        across_deg: f64,
    },
    /// The equations have no solution.
    #[error("the views contradict one another")]
    NoSolution,
}

/// Minimum rotation about a second axis, degrees (RMS over all pairs of views), for separate boards
/// to determine the shift along the first one. Lowered, the noise of the poses passes for rotation;
/// raised, careful sets of small rotations are refused.
const MIN_ACROSS_DEG: f64 = 3.0;
/// Squared distance of six degrees of freedom that a good pair exceeds once in 10^5 (chi-squared);
/// above it a pair is rejected. Raised, wrong pairs pull the mount; lowered, good ones are lost.
const OUTLIER: f64 = 33.1;
/// Median of chi-squared with six degrees of freedom, to which the median of the squared distances
/// is compared, so that half of the pairs may be wrong.
const MEDIAN: f64 = 5.35;
/// Maximum number of solver steps; it converges in three to six. Raised, sets that do not converge
/// take longer.
const STEPS: usize = 30;

type Normal = SMatrix<f64, 12, 12>;

/// Solves for the mount from pairs of views: at least one if the stage is shared, three if not.
///
/// # Errors
/// When the views do not determine it, with what is missing.
pub fn solve(pairs: &[ViewPair], stages: Stages) -> Result<Solution, Unsolvable> {
    let wanted = if stages == Stages::Shared { 1 } else { 3 };
    if pairs.len() < wanted {
        return Err(Unsolvable::TooFew { found: pairs.len(), wanted });
    }
    if stages == Stages::Apart {
        rotations_suffice(pairs)?;
    }
    let mut state = start::start(pairs, stages).ok_or(Unsolvable::NoSolution)?;
    // First robustly: contradicting pairs lose weight.
    state.refine(pairs, stages, |squared, spread| 1.0 / (1.0 + squared / (spread * OUTLIER)))?;
    let distances = state.distances(pairs).ok_or(Unsolvable::NoSolution)?;
    let spread = robust_spread(&distances);
    let mut kept: Vec<bool> = distances.iter().map(|d| *d <= OUTLIER * spread).collect();
    // A rejected majority is not an outlier: then all count, and the scatter shows in `excess`.
    if 2 * kept.iter().filter(|k| **k).count() <= pairs.len() || pairs.len() < wanted + 2 {
        kept.fill(true);
    }
    let chosen: Vec<ViewPair> = pairs.iter().zip(&kept).filter(|(_, k)| **k).map(|(pair, _)| *pair).collect();
    let normal = state.refine(&chosen, stages, |_, _| 1.0)?;
    let distances = state.distances(pairs).ok_or(Unsolvable::NoSolution)?;
    let unknowns = if stages == Stages::Shared { 6 } else { 12 };
    let freedom = 6 * chosen.len() - unknowns;
    let sum: f64 = distances.iter().zip(&kept).filter(|(_, k)| **k).map(|(d, _)| d).sum();
    let excess = if freedom == 0 { 1.0 } else { (sum / freedom as f64).max(1.0) };
    let inverse = normal.cholesky().ok_or(Unsolvable::NoSolution)?.inverse();
    let covariance: Matrix6<f64> = inverse.fixed_view::<6, 6>(0, 0) * excess;
    let covariance = (covariance + covariance.transpose()) * 0.5;
    if !covariance.iter().all(|v| v.is_finite()) || !state.mount.is_finite() {
        return Err(Unsolvable::NoSolution);
    }
    let used = |(squared_distance, is_used): (f64, bool)| Used { squared_distance, is_used };
    let views = distances.into_iter().zip(kept).map(used).collect();
    Ok(Solution { mount: state.mount, covariance, between: state.between, excess: excess.sqrt(), views })
}

/// Checks that the rotations between the views have more than one axis.
fn rotations_suffice(pairs: &[ViewPair]) -> Result<(), Unsolvable> {
    let rotation = |a: &ViewPair, b: &ViewPair| (a.tracking.pose.rotation.inverse() * b.tracking.pose.rotation).scaled_axis();
    let rotations: Vec<Vector3<f64>> =
        pairs.iter().enumerate().flat_map(|(k, a)| pairs[k + 1..].iter().map(move |b| rotation(a, b))).collect();
    let largest = rotations.iter().map(Vector3::norm).fold(0.0, f64::max).to_degrees();
    if largest < MIN_ACROSS_DEG {
        return Err(Unsolvable::NotRotated { rotation_deg: largest });
    }
    let scatter: Matrix3<f64> = rotations.iter().map(|v| v * v.transpose()).sum::<Matrix3<f64>>() / rotations.len() as f64;
    let eigen = scatter.symmetric_eigen();
    let main = eigen.eigenvalues.imax();
    let across = (eigen.eigenvalues.sum() - eigen.eigenvalues[main]).max(0.0).sqrt().to_degrees();
    if across < MIN_ACROSS_DEG {
        return Err(Unsolvable::OneAxis { axis: eigen.eigenvectors.column(main).into_owned(), across_deg: across });
    }
    Ok(())
}

/// Returns how many times larger the squared distances are than their covariances predict; at
/// least 1. Half of the pairs may be wrong.
fn robust_spread(distances: &[f64]) -> f64 {
    let mut sorted = distances.to_vec();
    sorted.sort_by(f64::total_cmp);
    (sorted.get((sorted.len() - 1) / 2).copied().unwrap_or(MEDIAN) / MEDIAN).max(1.0)
}

impl Unknowns {
    /// Runs Gauss-Newton; `weight` takes a squared distance and the robust spread. Returns the
    /// final normal matrix.
    fn refine(&mut self, pairs: &[ViewPair], stages: Stages, weight: impl Fn(f64, f64) -> f64) -> Result<Normal, Unsolvable> {
        let mut normal = Normal::identity();
        for _ in 0..STEPS {
            let spread = robust_spread(&self.distances(pairs).ok_or(Unsolvable::NoSolution)?);
            normal = Normal::zeros();
            let mut right = SVector::<f64, 12>::zeros();
            for pair in pairs {
                let (residual, jacobian) = self.residual(pair);
                let information = self.covariance(pair).cholesky().ok_or(Unsolvable::NoSolution)?.inverse();
                let weight = weight(residual.dot(&(information * residual)), spread);
                let weighted = jacobian.transpose() * information * weight;
                normal += weighted * jacobian;
                right += weighted * residual;
            }
            if stages == Stages::Shared {
                // Shared stage: the relation is known and held fixed.
                normal.fixed_view_mut::<6, 12>(6, 0).fill(0.0);
                normal.fixed_view_mut::<12, 6>(0, 6).fill(0.0);
                normal.fixed_view_mut::<6, 6>(6, 6).fill_with_identity();
                right.fixed_rows_mut::<6>(6).fill(0.0);
            }
            let step = normal.cholesky().ok_or(Unsolvable::NoSolution)?.solve(&right);
            self.step(&step);
            if step.norm() < 1e-11 {
                break;
            }
        }
        Ok(normal)
    }
}
