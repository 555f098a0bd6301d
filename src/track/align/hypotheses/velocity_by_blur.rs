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

use nalgebra::{Matrix2, Matrix2x3, Matrix2x6, Matrix3, Matrix6, SMatrix, SVector, Vector2, Vector3, Vector6};

use crate::camera::Shutter;
use crate::geometry::skew;
use crate::motion::{Motion, MotionEstimate};
use crate::track::align::kernel::columns::POSE;
use crate::track::align::pixels::level_spec::LevelSpec;
use crate::track::align::solve::level_problem::LevelProblem;
use crate::track::align::solve::level_problem::blur::{KnownVelocity, along_frame};

/// Maximum steps. Raised, what does not converge costs more; lowered, long blur is not reached.
const ROUNDS: usize = 5;
/// Change of blur below which a step is the last, and above which the result is rejected, pixels of
/// the level. Raised, velocities are less exact; lowered, they cost more steps, or are missed.
const SMALL_PX: f64 = 0.03;
const MAX_LAST_PX: f64 = 0.3;
/// Length of the trial blur that measures the missing blur, pixels of the level. Raised, fine
/// detail is lost where blur is short; lowered, long blur is found too short.
const FIRST_BLUR_PX: f64 = 1.5;
/// Sigmas by which the squared blur must exceed zero. Raised, slow bodies are taken to be at rest;
/// lowered, noise passes for blur.
const MIN_SIGMAS: f64 = 5.0;
/// Minimum variance of the missing blur, in multiples of `BLUR_ERROR_PX2`. Raised and lowered as
/// `MIN_SIGMAS`.
const MIN_BLUR_ERRORS: f64 = 1.5;
/// Squared sigmas by which rows must prefer a direction to its opposite. Raised, more frames wait
/// for a second one; lowered, a velocity is taken for its opposite.
const SURE_DIRECTION: f64 = 20.0;
/// Prior information of the length of an image velocity's blur, per squared pixel of the level:
/// almost none. Raised, slow bodies are taken to be at rest.
const UNKNOWN_BLUR: f64 = 1.6e-3;
/// Fraction of the other information that remains when blur is solved alone, which keeps the system
/// regular. Raised, blur repeats what was known anyway.
const NEARLY_NOTHING: f64 = 1e-4;
/// Sigma of a blur's variance from other causes than motion, pixels² of the level. Raised, blur
/// says less of slow motions; lowered, poses of sharpened pictures are trusted too much.
const BLUR_ERROR_PX2: f64 = 0.08;
/// Number of parts of a frame whose blur is wider or narrower independently. Raised, blur is
/// trusted more.
const BLUR_PATCHES: f64 = 6.0;
/// Maximum squared Mahalanobis distance of a velocity from that of rows and prior. Raised,
/// defocused or sharpened pictures pass for moving ones; lowered, thrown bodies have no velocity.
const MAX_SQUARED: f64 = 100.0;
/// Maximum relative sigma of the exposure for using blur under a rolling shutter. Raised, the first
/// pose may be further off than its covariance says; lowered, first frames wait for a second one.
const MAX_EXPOSURE_SIGMA: f64 = 0.3;
/// Minimum depth of a point over its distance, for computing its motion in the picture. Lowered,
/// the middle of a stage that begins behind the camera moves without bounds.
const MIN_DEPTH: f64 = 0.2;

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
    asked: [bool; POSE],
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
        let asked = [false, false, false, true, true, false];
        let px_per_turn_rate = focal_px(self.spec) * self.spec.shutter.exposure_s;
        let of_asked = UNKNOWN_BLUR * px_per_turn_rate.powi(2);
        let information = Matrix6::from_diagonal(&Vector6::from(asked.map(|is_asked| if is_asked { of_asked } else { 1.0 })));
        let with_velocity = |velocity: &Vector6<f64>| motion.with_twist(velocity);
        let turn_by_velocity = turn_by_velocity(&motion.pose.rotation_matrix(), &self.middle)?;
        let first = known + self.first_change(problem, &(turn_by_velocity * known))?;
        let fit = self.fit(problem, &BlurStart { first, known, information, asked, with_velocity: &with_velocity })?;
        let by_turn = turn_by_velocity.transpose() * fit.information.fixed_view::<2, 2>(3, 3);
        Some(VelocityByBlur {
            motion: with_velocity(&fit.velocity),
            information: by_turn * turn_by_velocity,
            score: by_turn * (turn_by_velocity * fit.shown),
            has_opposite: true,
        })
    }

    /// Under a rolling shutter: rows determine most of the velocity, and its direction; blur
    /// determines the rest. Both together determine the exposure.
    fn velocity(&self, problem: &mut LevelProblem) -> Option<VelocityByBlur> {
        if self.known.exposure_sigma > MAX_EXPOSURE_SIGMA {
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
        let start = BlurStart { first: known, known, information, asked: [true; POSE], with_velocity: &with_velocity };
        let fit = self.fit(problem, &start)?;
        let by_rows = |velocity: &Vector6<f64>| (velocity - known).dot(&(information * (velocity - known)));
        let is_sure = by_rows(&-fit.velocity) - by_rows(&fit.velocity) > SURE_DIRECTION;
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
        let nothing = start.information * NEARLY_NOTHING;
        // The exposure's correction is the logarithm of its ratio to the known one.
        let (mut velocity, mut exposure) = (start.first, 0.0);
        let mut fit = None;
        for _ in 0..ROUNDS {
            let motion = (start.with_velocity)(&velocity);
            let shutter = Shutter { exposure_s: self.spec.shutter.exposure_s * f64::exp(exposure), ..*self.spec.shutter };
            let spec = blurred(&LevelSpec { shutter: &shutter, ..*self.spec }, &motion);
            let step = problem.velocity_step(&spec, &motion, &start.asked, &self.known_velocity(nothing))?;
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
            fit = Some(BlurFit { velocity, shown, information }).filter(|_| moved_px < MAX_LAST_PX);
            if moved_px < SMALL_PX {
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
        covariance.cholesky().is_some_and(|c| off.dot(&c.solve(&off)) < MAX_SQUARED)
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
        let sigma = 0.5 * BLUR_ERROR_PX2 / (blur_px * blur_px / 12.0).max(f64::MIN_POSITIVE);
        1.0 / (1.0 + velocity.dot(&(by_blur * velocity)) * sigma * sigma / BLUR_PATCHES)
    }

    /// Returns blur's information with the exposure free within its relative sigma: a longer
    /// exposure blurs as a faster motion does.
    fn without_exposure(&self, by_blur: &Matrix6<f64>, velocity: &Vector6<f64>) -> Matrix6<f64> {
        let (along, variance) = (by_blur * velocity, self.known.exposure_sigma.powi(2));
        by_blur - along * along.transpose() * (variance / (1.0 + variance * velocity.dot(&along)))
    }

    /// Returns the change of the known velocity that explains the missing squared blur. It leads to
    /// one of two opposite velocities. `known_turn`: the angular velocities across and down that
    /// move the middle of the picture as the known velocity does. `None` where no blur is
    /// significantly missing.
    fn first_change(&self, problem: &mut LevelProblem, known_turn: &Vector2<f64>) -> Option<Vector6<f64>> {
        let turn_rate = FIRST_BLUR_PX / (focal_px(self.spec) * self.spec.shutter.exposure_s);
        let spec = LevelSpec { blur_px: FIRST_BLUR_PX, ..*self.spec }.with_places();
        let known = self.known_velocity(Matrix6::identity());
        let (squared, covariance) = problem.missing_blur(&spec, &self.found.motion, turn_rate, &known)?;
        let missing = Matrix2::new(squared.x, squared.z, squared.z, squared.y);
        // In units of the trial blur's variance.
        let systematic = MIN_BLUR_ERRORS * BLUR_ERROR_PX2 / (FIRST_BLUR_PX * FIRST_BLUR_PX / 12.0);
        // Whether squared blur along its longest axis is significant.
        let telling = |moments: &Matrix2<f64>| {
            let (length, along) = longest_axis(moments);
            let by = Vector3::new(along.x * along.x, along.y * along.y, 2.0 * along.x * along.y);
            let sigma = by.dot(&(covariance * by)).max(0.0).sqrt();
            tracing::trace!(blur_px = FIRST_BLUR_PX * length.max(0.0).sqrt(), sigmas = length / sigma, along = ?along.as_slice(), "missing blur");
            length > systematic.max(MIN_SIGMAS * sigma)
        };
        // The prediction already contains the known velocity's blur: the second moments of the
        // whole blur are those of the known one and of the missing one. A body that moves along
        // with the camera has less.
        let known_way = Vector2::new(-known_turn.y, known_turn.x) / turn_rate;
        let may_be_shorter = known_way.norm_squared() > systematic;
        if !(telling(&missing) || may_be_shorter && telling(&-missing)) {
            return None;
        }
        let (squared_way, along) = longest_axis(&(missing + known_way * known_way.transpose()));
        let way = along * squared_way.max(0.0).sqrt();
        let nearer = if way.dot(&known_way) < 0.0 { -way } else { way };
        let turn = along_frame(&(nearer - known_way)) * turn_rate;
        Some(Vector6::new(0.0, 0.0, 0.0, turn.x, turn.y, turn.z))
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
fn turn_by_velocity(rotation: &Matrix3<f64>, point: &Vector3<f64>) -> Option<Matrix2x6<f64>> {
    let distance_m = point.norm();
    let point = if point.z > MIN_DEPTH * distance_m { *point } else { Vector3::z() * distance_m };
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
    let blur_px = spec.blur_of(motion).max(FIRST_BLUR_PX);
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
