//! The estimation: from the corners of many views to lens and poses with their uncertainty.
//!
//! It starts from a closed form ([`start`]) and makes a robust adjustment in which outliers have
//! little weight. Then outliers are removed and the rest is adjusted by plain least squares
//! ([`adjust`]), so that the textbook covariance applies, enlarged for errors shared by
//! neighbouring corners. Uncertainties are 3 sigma, as in Bouguet's toolbox:
//! `3 sqrt(diag((JᵀJ)⁻¹)) sigma`.

pub mod adjust;
pub mod lens;
pub mod start;

use nalgebra::{Matrix3, Matrix6, Vector2, Vector3};

use crate::geometry::robust_kernel::median;
use adjust::{Bundle, Loss, Observation};
use lens::{FreeNumbers, Held, LensMatrix, LensVector};

/// What is estimated, and how.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SolveOptions {
    /// Which parameters are free.
    pub free: FreeNumbers,
    /// Values for the others.
    pub held: Held,
    /// Work like Bouguet's toolbox: every corner has full weight, none is rejected, and sigma
    /// ignores the degrees of freedom.
    pub bouguet: bool,
}

/// The complete estimate.
#[derive(Debug, Clone)]
pub struct Estimate {
    /// The lens and the poses.
    pub bundle: Bundle,
    /// For each view, which of its corners are used.
    pub used: Vec<Vec<bool>>,
    /// Reprojection error per point over the used corners, sqrt(mean(dx² + dy²)), pixels.
    pub rms_px: f64,
    /// Bouguet's err: standard deviation along x and along y, pixels.
    pub axis_error_px: [f64; 2],
    /// Noise of one coordinate, pixels, with the degrees of freedom and errors shared by
    /// neighbouring corners taken into account.
    pub sigma_px: f64,
    /// Covariance of the ten parameters; zero for those held fixed.
    pub lens_covariance: LensMatrix,
    /// Covariance of each view's [δθ, δt], camera axes, rad and m: `R_true = Exp(δθ) R`.
    pub pose_covariances: Vec<Matrix6<f64>>,
}

/// Minimum number of views: Zhang's method has two equations per view, and three views determine
/// all five intrinsics.
pub const MIN_VIEWS: usize = 3;
/// Residual, in sigma, above which corners are rejected: one good corner in 40 000 (Rayleigh
/// distribution). Raised, wrong corners pull the lens; lowered, good ones are lost and sigma comes
/// out too small.
pub(crate) const OUTLIER_SIGMAS: f64 = 4.6;
/// The median length of a 2-vector of unit noise: sqrt(2 ln 2).
pub(crate) const MEDIAN_LENGTH: f64 = 1.1774;

/// Estimates the lens and a pose for every view; `None` with fewer than `MIN_VIEWS` views, or if
/// they do not determine the unknowns.
pub fn estimate(views: &[Vec<Observation>], size: (u32, u32), options: &SolveOptions) -> Option<Estimate> {
    if views.len() < MIN_VIEWS {
        return None;
    }
    let bundle = start::start(views, size, &options.free, &options.held)?;
    refine(bundle, views, options)
}

/// Estimates like [`estimate`], from a start that is already near.
pub fn refine(mut bundle: Bundle, views: &[Vec<Observation>], options: &SolveOptions) -> Option<Estimate> {
    let free = &options.free;
    let all: Vec<Vec<bool>> = views.iter().map(|view| vec![true; view.len()]).collect();
    if options.bouguet {
        bundle.adjust(views, free, Loss::Squares, 100);
        return summed_up(bundle, views, all, options);
    }
    for _ in 0..4 {
        let sigma = robust_sigma(&bundle, views);
        bundle.adjust(views, free, Loss::Cauchy(3.0 * sigma), 30);
    }
    let mut used = all;
    for _ in 0..8 {
        let sigma = robust_sigma(&bundle, views);
        let now = belonging(&bundle, views, OUTLIER_SIGMAS * sigma);
        let kept = selected(views, &now);
        bundle.adjust(&kept, free, Loss::Squares, 50);
        let settled = now == used;
        used = now;
        if settled {
            break;
        }
    }
    summed_up(bundle, views, used, options)
}

/// Returns sigma of one coordinate from the median residual, which tolerates up to half outliers.
fn robust_sigma(bundle: &Bundle, views: &[Vec<Observation>]) -> f64 {
    let mut lengths: Vec<f64> = bundle.residuals(views).map(|r| r.map_or(f64::INFINITY, |r| r.norm())).collect();
    // The floor keeps exact input from rejecting rounding errors.
    median(&mut lengths).map_or(1.0, |median| (median / MEDIAN_LENGTH).clamp(1e-6, 1e3))
}

fn belonging(bundle: &Bundle, views: &[Vec<Observation>], limit: f64) -> Vec<Vec<bool>> {
    let good = |v: usize, o: &Observation| bundle.residual(v, o).is_some_and(|r| r.norm() <= limit);
    views.iter().enumerate().map(|(v, all)| all.iter().map(|o| good(v, o)).collect()).collect()
}

fn selected(views: &[Vec<Observation>], used: &[Vec<bool>]) -> Vec<Vec<Observation>> {
    let pick = |(view, used): (&Vec<Observation>, &Vec<bool>)| view.iter().zip(used).filter(|(_, u)| **u).map(|(o, _)| *o).collect();
    views.iter().zip(used).map(pick).collect()
}

/// Computes errors and covariances of an adjusted bundle.
fn summed_up(bundle: Bundle, views: &[Vec<Observation>], used: Vec<Vec<bool>>, options: &SolveOptions) -> Option<Estimate> {
    let free = &options.free;
    let kept = selected(views, &used);
    let residuals: Vec<Vector2<f64>> = bundle.residuals(&kept).collect::<Option<_>>()?;
    let count = residuals.len() as f64;
    let squares: f64 = residuals.iter().map(|r| r.norm_squared()).sum();
    let unknowns = free.count() + 6 * views.len();
    let freedom = 2.0 * count - unknowns as f64;
    if freedom <= 0.0 || !squares.is_finite() || bundle.lens.model(1, 1).is_err() {
        return None;
    }
    let covariance = bundle.covariance(&kept, free)?;
    let variance = if options.bouguet { squares / (2.0 * count - 1.0) } else { squares / freedom * shared_error(&bundle, &kept) };
    let mean: Vector2<f64> = residuals.iter().sum::<Vector2<f64>>() / count;
    let spread = |k: usize| (residuals.iter().map(|r| (r[k] - mean[k]).powi(2)).sum::<f64>() / (count - 1.0)).sqrt();
    Some(Estimate {
        rms_px: (squares / count).sqrt(),
        axis_error_px: [spread(0), spread(1)],
        sigma_px: variance.sqrt(),
        lens_covariance: covariance.lens * variance,
        pose_covariances: covariance.views.iter().map(|c| c * variance).collect(),
        bundle,
        used,
    })
}

/// Returns the factor by which the unknowns' variance exceeds that for independent errors. A board
/// that is not flat, or a lens that the model does not fit, moves neighbouring corners alike: with
/// four neighbours of correlation rho each, a sum's variance is 1 + 4 rho times as large. 1 for
/// independent errors.
fn shared_error(bundle: &Bundle, views: &[Vec<Observation>]) -> f64 {
    let (mut alike, mut power) = (0.0, 0.0);
    for (v, view) in views.iter().enumerate() {
        let step = |pair: &[Observation]| (pair[1].board_m - pair[0].board_m).norm();
        let square = view.windows(2).map(step).fold(f64::INFINITY, f64::min);
        for pair in view.windows(2).filter(|pair| step(pair) < 1.01 * square) {
            if let (Some(a), Some(b)) = (bundle.residual(v, &pair[0]), bundle.residual(v, &pair[1])) {
                alike += a.dot(&b);
                power += 0.5 * (a.norm_squared() + b.norm_squared());
            }
        }
    }
    1.0 + 4.0 * if power > 0.0 { (alike / power).max(0.0) } else { 0.0 }
}

impl Estimate {
    /// Returns 3 sigma of each of the ten parameters; 0 for those held fixed.
    pub fn lens_uncertainty(&self) -> LensVector {
        self.lens_covariance.diagonal().map(|v| 3.0 * v.max(0.0).sqrt())
    }

    /// Returns Bouguet's extrinsics of a view: the rotation vector `omc` (rad) and `Tc` (m) of
    /// `T_camera_board`, and 3 sigma of both.
    pub fn extrinsics(&self, view: usize) -> Extrinsics {
        let pose = &self.bundle.poses[view];
        let omc = pose.rotation.scaled_axis();
        let covariance = &self.pose_covariances[view];
        let rotation = inverse_left_jacobian(&omc);
        let rotation = rotation * covariance.fixed_view::<3, 3>(0, 0) * rotation.transpose();
        let three_sigma = |m: Matrix3<f64>| m.diagonal().map(|v| 3.0 * v.max(0.0).sqrt());
        Extrinsics {
            rotation_vector: omc,
            translation_m: pose.translation,
            rotation_uncertainty: three_sigma(rotation),
            translation_uncertainty_m: three_sigma(covariance.fixed_view::<3, 3>(3, 3).into_owned()),
        }
    }

    /// Returns the rms per point of one view's used corners, pixels.
    pub fn view_rms_px(&self, view: usize, observations: &[Observation]) -> f64 {
        let kept = observations.iter().zip(&self.used[view]).filter(|(_, used)| **used);
        let squares: Vec<f64> = kept.filter_map(|(o, _)| Some(self.bundle.residual(view, o)?.norm_squared())).collect();
        (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
    }
}

/// One view's pose in the form of Bouguet's toolbox.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extrinsics {
    /// omc: axis times angle, rad, of `T_camera_board`.
    pub rotation_vector: Vector3<f64>,
    /// Tc: the board's origin in the camera frame, metres.
    pub translation_m: Vector3<f64>,
    /// 3 sigma of omc, rad.
    pub rotation_uncertainty: Vector3<f64>,
    /// 3 sigma of Tc, metres.
    pub translation_uncertainty_m: Vector3<f64>,
}

/// Returns the derivative of a rotation vector by a small rotation applied from the left.
fn inverse_left_jacobian(omega: &Vector3<f64>) -> Matrix3<f64> {
    let angle = omega.norm();
    let cross = omega.cross_matrix();
    let second = if angle < 1e-4 { 1.0 / 12.0 } else { (1.0 - 0.5 * angle * (0.5 * angle).cos() / (0.5 * angle).sin()) / (angle * angle) };
    Matrix3::identity() - cross * 0.5 + cross * cross * second
}

#[cfg(test)]
mod tests;
