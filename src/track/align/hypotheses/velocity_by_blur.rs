//! The velocity of a body that was just found, by its motion blur.
//!
//! One frame does not show how a body moves, unless its rows are read one after another. But it
//! shows how the body is smeared during the exposure: along which line and how far in each part of
//! the picture, not in which direction. Without that, a moving body fits its blurred picture badly,
//! is accepted too late, and is searched for in the next frame where it no longer is. Under a
//! rolling shutter, rows determine the direction, and blur determines what rows do not: whether a
//! frontal plane is tilted, or approaches meanwhile.
//!
//! At zero velocity the derivative of blur vanishes. So the first velocity comes from the missing
//! squared blur, which is linear in the second moments of the velocity; Gauss-Newton steps follow
//! from there.

use crate::track::align::tuning::TUNING;
use nalgebra::{Matrix2, Matrix2x3, Matrix2x6, Matrix3, Matrix6, SMatrix, SVector, Vector2, Vector3, Vector6};

use crate::camera::Shutter;
use crate::geometry::skew;
use crate::motion::{Motion, MotionEstimate};
use crate::track::align::kernel::columns::POSE;
use crate::track::align::pixels::level_spec::LevelSpec;
use crate::track::align::solve::level_problem::LevelProblem;
use crate::track::align::solve::level_problem::blur::{KnownVelocity, along_frame};

/// A velocity estimated by blur.
pub struct VelocityByBlur {
    /// The aligned motion with this velocity.
    pub motion: Motion,
    /// What blur alone says of [v, ω] (m/s, rad/s): its information, and that times the velocity.
    pub information: Matrix6<f64>,
    /// See `information`.
    pub score: Vector6<f64>,
    /// Whether the opposite velocity is as likely.
    pub has_opposite: bool,
}

/// What is known of exposure and point spread.
#[derive(Clone, Copy)]
pub struct KnownBlur {
    /// Relative sigma of the exposure.
    pub exposure_sigma: f64,
    /// The point spread's variance, and one sigma of it.
    pub psf_variance: f64,
    /// See `psf_variance`.
    pub psf_variance_sigma: f64,
}

/// Returns the velocity that the blur of the selected pixels shows, where alignment found the body.
/// `middle`: the centre of its nearest surface, camera axes, metres. `None` where the blur shows
/// none, or where rows of a rolling shutter do not determine the direction.
pub fn velocity_by_blur(
    problem: &mut LevelProblem,
    spec: &LevelSpec,
    found: &MotionEstimate,
    middle: Vector3<f64>,
    known: KnownBlur,
) -> Option<VelocityByBlur> {
    let search = BlurSearch { spec, found, known, middle };
    if spec.shutter.is_global() { search.image_velocity(problem) } else { search.velocity(problem) }
}

struct BlurSearch<'a, 'b> {
    spec: &'a LevelSpec<'b>,
    found: &'a MotionEstimate,
    known: KnownBlur,
    middle: Vector3<f64>,
}

/// Where the steps start, and what they may change.
struct BlurStart<'a, F> {
    /// The initial [v, ω].
    first: Vector6<f64>,
    /// The prior of it: mean and information.
    known: Vector6<f64>,
    information: Matrix6<f64>,
    /// The components estimated by blur; the others stay.
    estimated: [bool; POSE],
    /// Returns the motion with a given velocity.
    with_velocity: &'a F,
}

/// The velocity estimated by blur.
struct BlurFit {
    /// [v, ω] by blur and prior.
    velocity: Vector6<f64>,
    /// By blur alone, and its information.
    shown: Vector6<f64>,
    information: Matrix6<f64>,
}

impl BlurSearch<'_, '_> {
    /// Under a global shutter: estimates how fast the middle of the picture moves, and along which
    /// line. Other motion within the picture is not well determined.
    fn image_velocity(&self, problem: &mut LevelProblem) -> Option<VelocityByBlur> {
        let motion = &self.found.motion;
        let known = motion.twist();
        let estimated = [false, false, false, true, true, false];
        let px_per_angular_velocity = focal_px(self.spec) * self.spec.shutter.exposure_s;
        let prior_information = TUNING.blur_prior_information * px_per_angular_velocity.powi(2);
        let information =
            Matrix6::from_diagonal(&Vector6::from(estimated.map(|is_estimated| if is_estimated { prior_information } else { 1.0 })));
        let with_velocity = |velocity: &Vector6<f64>| motion.with_twist(velocity);
        let angular_velocity_by_twist = angular_velocity_by_twist(&motion.pose.rotation_matrix(), &self.middle)?;
        let first = known + self.first_change(problem, &(angular_velocity_by_twist * known))?;
        let fit = self.fit(problem, &BlurStart { first, known, information, estimated, with_velocity: &with_velocity })?;
        let by_rotation = angular_velocity_by_twist.transpose() * fit.information.fixed_view::<2, 2>(3, 3);
        Some(VelocityByBlur {
            motion: with_velocity(&fit.velocity),
            information: by_rotation * angular_velocity_by_twist,
            score: by_rotation * (angular_velocity_by_twist * fit.shown),
            has_opposite: true,
        })
    }

    /// Under a rolling shutter: rows determine most of the velocity, and its direction; blur
    /// determines the rest. Both together determine the exposure.
    fn velocity(&self, problem: &mut LevelProblem) -> Option<VelocityByBlur> {
        if self.known.exposure_sigma > TUNING.max_exposure_sigma {
            return None;
        }
        let found = self.found;
        let known = found.motion.twist();
        let information = found.covariance.fixed_view::<6, 6>(6, 6).into_owned().cholesky()?.inverse();
        // Another velocity goes with another pose: rows determine both from one displacement.
        let pose_by_velocity = found.covariance.fixed_view::<6, 6>(0, 6) * information;
        let with_velocity = |velocity: &Vector6<f64>| {
            let pose = found.motion.with_pose_corrected(&(pose_by_velocity * (velocity - known)));
            Motion { pose, ..found.motion }.with_twist(velocity)
        };
        let start = BlurStart { first: known, known, information, estimated: [true; POSE], with_velocity: &with_velocity };
        let fit = self.fit(problem, &start)?;
        let by_rows = |velocity: &Vector6<f64>| (velocity - known).dot(&(information * (velocity - known)));
        let is_sure = by_rows(&-fit.velocity) - by_rows(&fit.velocity) > TUNING.min_direction_preference;
        is_sure.then(|| VelocityByBlur {
            motion: with_velocity(&fit.velocity),
            information: fit.information,
            score: fit.information * fit.shown,
            has_opposite: false,
        })
    }

    /// Steps to the velocity that blur and prior agree on; `None` where the steps do not converge.
    fn fit(&self, problem: &mut LevelProblem, start: &BlurStart<impl Fn(&Vector6<f64>) -> Motion>) -> Option<BlurFit> {
        // For blur alone, almost no prior is left.
        let nothing = start.information * TUNING.remaining_information_ratio;
        // The exposure's correction is the logarithm of its ratio to the known one.
        let (mut velocity, mut exposure) = (start.first, 0.0);
        let mut fit = None;
        for _ in 0..TUNING.max_blur_steps {
            let motion = (start.with_velocity)(&velocity);
            let shutter = Shutter { exposure_s: self.spec.shutter.exposure_s * f64::exp(exposure), ..*self.spec.shutter };
            let spec = blurred(&LevelSpec { shutter: &shutter, ..*self.spec }, &motion);
            let step = problem.velocity_step(&spec, &motion, &start.estimated, &self.known_velocity(nothing))?;
            let by_blur = positive(&(step.covariance.cholesky()?.inverse() - nothing));
            let believed = by_blur * self.believed(&by_blur, &velocity, spec.blur_of(&motion));
            let [faster, longer] = self.fused(start, &velocity, exposure, &believed, &step.step)?;
            let moved_px = blur_change_px(&spec, &motion, &(faster + longer));
            tracing::trace!(blur_px = spec.blur_px, moved_px, exposure, velocity = ?velocity.as_slice(), "velocity by blur");
            let information = self.without_exposure(&believed, &velocity);
            let shown = velocity + step.step + velocity * exposure;
            let share = spec.blur_px / moved_px.max(spec.blur_px);
            exposure += longer.dot(&velocity) / velocity.norm_squared().max(f64::MIN_POSITIVE) * share;
            velocity += faster * share;
            fit = Some(BlurFit { velocity, shown, information }).filter(|_| moved_px < TUNING.max_last_blur_change_px);
            if moved_px < TUNING.converged_blur_px {
                break;
            }
        }
        fit.filter(|fit| self.is_usual(&fit.velocity))
    }

    /// Whether a velocity is plausible, by the prior and, under a rolling shutter, by the rows.
    fn is_usual(&self, velocity: &Vector6<f64>) -> bool {
        let off = velocity - self.found.motion.twist();
        let covariance = self.found.covariance.fixed_view::<6, 6>(6, 6).into_owned();
        // False for NaN.
        covariance.cholesky().is_some_and(|c| off.dot(&c.solve(&off)) < TUNING.max_blur_squared_mahalanobis)
    }

    /// Returns the step that blur, the prior of the velocity, and the prior of the exposure agree
    /// on: for the velocity, and for the exposure, as the change of velocity with the same effect
    /// on blur. `step`: what blur alone asks for.
    fn fused<F>(
        &self,
        start: &BlurStart<F>,
        velocity: &Vector6<f64>,
        exposure: f64,
        by_blur: &Matrix6<f64>,
        step: &Vector6<f64>,
    ) -> Option<[Vector6<f64>; 2]> {
        let exposure_information = self.known.exposure_sigma.powi(-2);
        // Blur determines the product of velocity and exposure.
        let (along, score) = (by_blur * velocity, by_blur * step);
        let mut normal = SMatrix::<f64, 7, 7>::zeros();
        normal.fixed_view_mut::<6, 6>(0, 0).copy_from(&(start.information + by_blur));
        normal.fixed_view_mut::<6, 1>(0, 6).copy_from(&along);
        normal.fixed_view_mut::<1, 6>(6, 0).copy_from(&along.transpose());
        normal[(6, 6)] = exposure_information + velocity.dot(&along);
        let mut right = SVector::<f64, 7>::zeros();
        right.fixed_rows_mut::<6>(0).copy_from(&(start.information * (start.known - velocity) + score));
        right[6] = velocity.dot(&score) - exposure_information * exposure;
        let change = normal.cholesky()?.solve(&right);
        Some([change.fixed_rows::<6>(0).into_owned(), velocity * change[6]])
    }

    /// Returns the fraction of blur's information that is trusted: in each of a few parts of the
    /// frame blur is wider or narrower than motion makes it.
    fn believed(&self, by_blur: &Matrix6<f64>, velocity: &Vector6<f64>, blur_px: f64) -> f64 {
        // The variance of a blur grows with the square of the velocity.
        let sigma = 0.5 * TUNING.blur_error_px2 / (blur_px * blur_px / 12.0).max(f64::MIN_POSITIVE);
        1.0 / (1.0 + velocity.dot(&(by_blur * velocity)) * sigma * sigma / TUNING.independent_blur_parts)
    }

    /// Returns blur's information with the exposure free within its relative sigma: a longer
    /// exposure blurs as a faster motion does.
    fn without_exposure(&self, by_blur: &Matrix6<f64>, velocity: &Vector6<f64>) -> Matrix6<f64> {
        let (along, variance) = (by_blur * velocity, self.known.exposure_sigma.powi(2));
        by_blur - along * along.transpose() * (variance / (1.0 + variance * velocity.dot(&along)))
    }

    /// Returns the change of the known velocity that explains the missing squared blur. It leads to
    /// one of two opposite velocities. `known_angular_velocity`: the angular velocities across and
    /// down that move the middle of the picture as the known velocity does. `None` where no blur is
    /// significantly missing.
    fn first_change(&self, problem: &mut LevelProblem, known_angular_velocity: &Vector2<f64>) -> Option<Vector6<f64>> {
        let angular_velocity = TUNING.trial_blur_px / (focal_px(self.spec) * self.spec.shutter.exposure_s);
        let spec = LevelSpec { blur_px: TUNING.trial_blur_px, ..*self.spec }.with_places();
        let known = self.known_velocity(Matrix6::identity());
        let (squared, covariance) = problem.missing_blur(&spec, &self.found.motion, angular_velocity, &known)?;
        let missing = Matrix2::new(squared.x, squared.z, squared.z, squared.y);
        // In units of the trial blur's variance.
        let systematic = TUNING.min_blur_errors * TUNING.blur_error_px2 / (TUNING.trial_blur_px * TUNING.trial_blur_px / 12.0);
        // Whether squared blur along its longest axis is significant.
        let telling = |moments: &Matrix2<f64>| {
            let (length, along) = longest_axis(moments);
            let by = Vector3::new(along.x * along.x, along.y * along.y, 2.0 * along.x * along.y);
            let sigma = by.dot(&(covariance * by)).max(0.0).sqrt();
            tracing::trace!(blur_px = TUNING.trial_blur_px * length.max(0.0).sqrt(), sigmas = length / sigma, along = ?along.as_slice(), "missing blur");
            length > systematic.max(TUNING.min_blur_sigmas * sigma)
        };
        // The prediction already contains the known velocity's blur: the second moments of the
        // whole blur are those of the known one and of the missing one. A body that moves along
        // with the camera has less.
        let known_way = Vector2::new(-known_angular_velocity.y, known_angular_velocity.x) / angular_velocity;
        let may_be_shorter = known_way.norm_squared() > systematic;
        if !(telling(&missing) || may_be_shorter && telling(&-missing)) {
            return None;
        }
        let (squared_way, along) = longest_axis(&(missing + known_way * known_way.transpose()));
        let way = along * squared_way.max(0.0).sqrt();
        let nearer = if way.dot(&known_way) < 0.0 { -way } else { way };
        let change = along_frame(&(nearer - known_way)) * angular_velocity;
        Some(Vector6::new(0.0, 0.0, 0.0, change.x, change.y, change.z))
    }

    /// Returns what is known beside a velocity with this information.
    fn known_velocity(&self, information: Matrix6<f64>) -> KnownVelocity {
        let KnownBlur { psf_variance, psf_variance_sigma, .. } = self.known;
        KnownVelocity { information, psf_variance, psf_variance_sigma }
    }
}

/// Returns the largest eigenvalue and its eigenvector.
fn longest_axis(moments: &Matrix2<f64>) -> (f64, Vector2<f64>) {
    let eigen = moments.symmetric_eigen();
    let longest = eigen.eigenvalues.imax();
    (eigen.eigenvalues[longest], eigen.eigenvectors.column(longest).into_owned())
}

/// Returns the matrix from a velocity [v, ω] to the angular velocities across and down the frame
/// that move a point in the same way. `rotation`: from camera to body axes; `point`: in camera
/// axes, metres. A point far to the side is replaced by one straight ahead.
fn angular_velocity_by_twist(rotation: &Matrix3<f64>, point: &Vector3<f64>) -> Option<Matrix2x6<f64>> {
    let distance_m = point.norm();
    let point = if point.z > TUNING.min_depth_ratio * distance_m { *point } else { Vector3::z() * distance_m };
    let in_frame = Matrix2x3::new(1.0, 0.0, -point.x / point.z, 0.0, 1.0, -point.y / point.z) / point.z;
    let mut by_velocity = Matrix2x6::zeros();
    by_velocity.fixed_view_mut::<2, 3>(0, 0).copy_from(&(-in_frame * rotation.transpose()));
    by_velocity.fixed_view_mut::<2, 3>(0, 3).copy_from(&(in_frame * skew(&point)));
    Some(by_velocity.fixed_view::<2, 2>(0, 3).into_owned().try_inverse()? * by_velocity)
}

/// Returns the focal length, pixels of the level.
fn focal_px(spec: &LevelSpec) -> f64 {
    spec.rays.camera().intrinsics().fx / spec.frame_px()
}

/// Returns the level with samples along the blur of this motion, and with at least some, so that
/// blur can be compared with none.
fn blurred<'a>(spec: &LevelSpec<'a>, motion: &Motion) -> LevelSpec<'a> {
    let blur_px = spec.blur_of(motion).max(TUNING.trial_blur_px);
    LevelSpec { blur_px, ..*spec }.with_places()
}

/// Returns the maximum change of blur by a change of velocity, pixels of the level.
fn blur_change_px(spec: &LevelSpec, motion: &Motion, step: &Vector6<f64>) -> f64 {
    spec.blur_of(&Motion::still(motion.pose).with_twist(step))
}

/// Returns the nearest matrix without negative eigenvalues.
fn positive(matrix: &Matrix6<f64>) -> Matrix6<f64> {
    let mut eigen = ((matrix + matrix.transpose()) * 0.5).symmetric_eigen();
    eigen.eigenvalues.apply(|v| *v = v.max(0.0));
    eigen.recompose()
}

#[cfg(test)]
#[path = "velocity_by_blur_tests.rs"]
mod tests;
