//! Solves for a velocity by the motion blur of a level's pixels.
//!
//! An alignment step takes its slopes from where the picture is; this one takes them from how it is
//! smeared. The derivatives by the velocity replace the columns of the pose in the system of an
//! alignment. So light and point spread are solved for as well, and occluders get as little weight.

use crate::track::align::tuning::TUNING;
use nalgebra::{Matrix3, Matrix6, Vector2, Vector3, Vector6};

use super::solution::VoteScatter;
use super::{LevelProblem, Reweighted};
use crate::motion::{Motion, MotionError, MotionMatrix};
use crate::track::align::kernel::columns::POSE;
use crate::track::align::pixels::appearance::Appearance;
use crate::track::align::pixels::level_spec::LevelSpec;
use crate::track::align::pixels::level_spec::TileTime;
use crate::track::align::solve::system::Prior;

/// What is known before a velocity is estimated by its blur.
pub struct KnownVelocity {
    /// Information of [v, ω] about the linearisation.
    pub information: Matrix6<f64>,
    /// The point spread's variance, and one sigma of it.
    pub psf_variance: f64,
    /// See `psf_variance`.
    pub psf_variance_sigma: f64,
}

/// A step of a velocity by its blur.
pub struct VelocityStep {
    /// Correction of [v, ω], m/s and rad/s.
    pub step: Vector6<f64>,
    /// Covariance of the corrected velocity: noise, with the prior.
    pub covariance: Matrix6<f64>,
}

impl LevelProblem {
    /// Returns a step towards the velocity that the pixels' blur shows, from that of `motion`.
    /// Components of [v, ω] that are not `estimated` stay. Invalidates the level's solution. `None`
    /// where the system is singular.
    pub fn velocity_step(
        &mut self,
        spec: &LevelSpec,
        motion: &Motion,
        estimated: &[bool; POSE],
        known: &KnownVelocity,
    ) -> Option<VelocityStep> {
        self.predict_by_velocity(spec, motion);
        let Appearance { by_pose, by_velocity, .. } = &mut self.picture.appearance;
        std::mem::swap(by_pose, by_velocity);
        by_pose.iter_mut().zip(estimated).filter(|(_, is_estimated)| !**is_estimated).for_each(|(column, _)| column.fill(0.0));
        let mut information = MotionMatrix::identity() * TUNING.regularising_information;
        information.fixed_view_mut::<6, 6>(0, 0).copy_from(&known.information);
        self.blur_step(spec, &information, known)
    }

    /// Returns the squared blur that a prediction without blur lacks: second moments (xx, yy, xy)
    /// of the angular velocity across and down the frame, in units of `angular_velocity` (rad/s)
    /// squared, and their covariance. `None` where the system is singular.
    pub fn missing_blur(
        &mut self,
        spec: &LevelSpec,
        motion: &Motion,
        angular_velocity: f64,
        known: &KnownVelocity,
    ) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let mut columns: [Vec<f32>; POSE] = Default::default();
        let diagonal = std::f64::consts::FRAC_1_SQRT_2;
        for (column, along) in columns.iter_mut().zip([Vector2::x(), Vector2::y(), Vector2::repeat(diagonal)]) {
            let rotated = Motion { angular_velocity: motion.angular_velocity + along_frame(&along) * angular_velocity, ..*motion };
            self.predict(spec, &rotated);
            column.clone_from(&self.picture.appearance.intensity);
        }
        self.predict(spec, motion);
        let intensity = &self.picture.appearance.intensity;
        let [across, down, between, unused @ ..] = &mut columns;
        for (k, sharp) in intensity.iter().enumerate() {
            (across[k], down[k]) = (across[k] - sharp, down[k] - sharp);
            between[k] = 2.0 * (between[k] - sharp) - (across[k] + down[k]);
        }
        unused.iter_mut().for_each(|column| column.resize(intensity.len(), 0.0));
        let mut information = MotionMatrix::identity() * TUNING.regularising_information;
        information.fixed_view_mut::<3, 3>(0, 0).copy_from(&(Matrix3::identity() * TUNING.squared_blur_information));
        self.picture.appearance.by_pose = columns;
        let VelocityStep { step, covariance } = self.blur_step(spec, &information, known)?;
        Some((step.fixed_rows::<3>(0).into_owned(), covariance.fixed_view::<3, 3>(0, 0).into_owned()))
    }

    /// Solves for a step with the columns that replace the pose's.
    fn blur_step(&mut self, spec: &LevelSpec, information: &MotionMatrix, known: &KnownVelocity) -> Option<VelocityStep> {
        (self.at, self.solved) = (None, None);
        let prior = Prior {
            information,
            error: MotionError::zeros(),
            psf_variance: known.psf_variance,
            psf_variance_sigma: known.psf_variance_sigma,
        };
        let together = TileTime { delay_s: 0.0, mean_square_s2: 0.0 };
        self.gate_tiles(&spec.noise, false);
        let Reweighted { weight, .. } = self.reweight(spec, &prior, Some(together), false, TUNING.blur_reweightings)?;
        let Self { picture, runs, system, .. } = self;
        let step: Vector6<f64> = system.step().motion().fixed_rows::<6>(0).into_owned();
        let (covariance, votes) = system.covariance();
        let by_noise: Matrix6<f64> = covariance.fixed_view::<6, 6>(0, 0).into_owned();
        let mut scatter = VoteScatter::default();
        for r in runs.iter().filter(|r| r.gate.is_open) {
            let nodes = picture.pixels.light().nodes_of(r.run.tile);
            scatter.add(&votes.of_tile(&r.equations.left_by(&r.step), nodes, &together, weight));
        }
        Some(VelocityStep { step, covariance: scatter.or_noise(&by_noise)? })
    }
}

/// Returns the angular velocity, in camera axes, that moves the picture along a direction of the
/// frame (x right, y down).
pub fn along_frame(direction: &Vector2<f64>) -> Vector3<f64> {
    Vector3::new(direction.y, -direction.x, 0.0)
}
