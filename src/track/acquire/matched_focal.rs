//! Estimates the focal length from the matches of a frame that finds the stage.
//!
//! A frame that shows the stage in depth or from the side fits only one focal length. A lens
//! calibrated in another mode of the camera is 10 to 50 % off: too far for the linear step of
//! [`focal_clue`](crate::track::model_error::focal_clue), since tiles that are displaced this far
//! are not aligned at all. Matches reach further. So the stage is posed with a grid of other focal
//! lengths; if one has clearly smaller residuals, the covariance includes it. From straight ahead,
//! all have the same residuals. Slightly distorted pictures and slightly misplaced surfaces are
//! rival explanations and are tested too.

use crate::track::acquire::tuning::TUNING;
use crate::track::model_error::tuning::TUNING as MODEL_ERROR_TUNING;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix2, Matrix2xX, Vector2};
use tracing::debug;

use super::candidate::AgreeingMatch;
use crate::camera::{CameraModel, Intrinsics};
use crate::geometry::resection::{MovingCamera, Observation, resect, residual_and_jacobian, squared_residual};
use crate::geometry::{Body, Camera, Pose};
use crate::track::model_error::lens_watch::MatchedFocal;
use crate::track::model_error::model_unknowns::{CORNER_UNKNOWNS, fill_corners, fill_place};
use crate::track::scene::reference::PreparedBody;

/// Estimates whether another focal length fits the matches.
///
/// `pose`: `T_camera_body` found with the calibrated focal length. `is_global`: all rows are known
/// to be exposed together; otherwise the camera may have moved while they were read. `suspected`:
/// logarithm of the ratio of the focal length that earlier matches fit to the calibrated one.
pub fn matched_focal(
    pose: &Pose<Camera, Body>,
    camera: &CameraModel,
    body: &PreparedBody,
    matches: &[AgreeingMatch],
    is_global: bool,
    suspected: Option<f64>,
) -> MatchedFocal {
    if matches.len() < TUNING.min_focal_matches {
        return MatchedFocal::Unclear;
    }
    let asked: Vec<AgreeingMatch> = matches.iter().step_by(matches.len().div_ceil(TUNING.max_focal_matches)).copied().collect();
    let observations: Vec<Observation> = asked.iter().map(|m| m.observation).collect();
    let trial = Trial { camera, body, matches: &asked, observations: &observations, is_global };
    trial.ask(pose, suspected).unwrap_or(MatchedFocal::Unclear)
}

/// A focal length and the best pose with it.
#[derive(Debug, Clone, Copy)]
struct Fit {
    /// Logarithm of the ratio of the focal length to the calibrated one.
    change: f64,
    pose: Pose<Camera, Body>,
    /// Sum of truncated squares, sigmas.
    cost: f64,
}

struct Trial<'a> {
    camera: &'a CameraModel,
    body: &'a PreparedBody,
    matches: &'a [AgreeingMatch],
    observations: &'a [Observation],
    is_global: bool,
}

impl Trial<'_> {
    /// Compares the calibrated focal length with others and with rival explanations; `None` without
    /// a pose.
    fn ask(&self, pose: &Pose<Camera, Body>, suspected: Option<f64>) -> Option<MatchedFocal> {
        let calibrated = self.fit(pose, 0.0)?;
        let excess = calibrated.cost - self.matches.iter().map(|m| m.floor).sum::<f64>();
        if excess > TUNING.min_focal_misfit * self.observations.len() as f64 {
            let best = self.best(calibrated);
            let rival = |moved, askew| self.rival_cost(&calibrated, moved, askew).unwrap_or(calibrated.cost).min(calibrated.cost);
            let moved = if self.is_global { calibrated.cost } else { rival(true, false) };
            let askew = rival(!self.is_global, true);
            debug!(change = best.change, calibrated = calibrated.cost, excess, moved, askew, left = best.cost, "focal length by matches");
            let is_inside = best.change.abs() < (f64::from(TUNING.focal_steps_each_way) - 0.5) * TUNING.log_focal_step;
            let gain = calibrated.cost - best.cost;
            let is_moved = moved - best.cost < self.min_gain(&best);
            if is_inside && !is_moved && gain > self.min_gain(&best) && gain > TUNING.min_focal_cost_drop_ratio * excess {
                if askew - best.cost > self.min_gain(&best) {
                    return Some(MatchedFocal::Changed(best.change));
                }
                if best.change.abs() < MODEL_ERROR_TUNING.max_focal_change {
                    return Some(MatchedFocal::Contested(best.change));
                }
            }
        }
        let rival = self.towards(calibrated, suspected?);
        let is_clear = rival.cost - calibrated.cost > self.min_gain(&calibrated);
        Some(if is_clear { MatchedFocal::Calibrated } else { MatchedFocal::Unclear })
    }

    /// Returns the drop of the cost that exceeds noise if this fit is the best.
    fn min_gain(&self, best: &Fit) -> f64 {
        TUNING.min_focal_cost_drop * best.cost / (2 * self.observations.len() - 7) as f64
    }

    /// Fits the pose with another focal length, starting from that with a similar one.
    fn fit(&self, start: &Pose<Camera, Body>, change: f64) -> Option<Fit> {
        let i = *self.camera.intrinsics();
        let camera = CameraModel::new(Intrinsics { fx: i.fx * change.exp(), fy: i.fy * change.exp(), ..i }).ok()?;
        let still = MovingCamera::still(&camera);
        let pose = resect(start, &still, self.observations, TUNING.max_resection_steps)?.pose;
        let square = |o: &Observation| {
            squared_residual(&pose, &still, o)
                .map_or(TUNING.max_squared_focal_residual, |square| square.min(TUNING.max_squared_focal_residual))
        };
        Some(Fit { change, pose, cost: self.observations.iter().map(square).sum() })
    }

    /// Returns the best fit on a grid from the calibrated focal length outwards, refined by halving
    /// the step.
    fn best(&self, calibrated: Fit) -> Fit {
        let mut best = calibrated;
        for direction in [-TUNING.log_focal_step, TUNING.log_focal_step] {
            let mut last = calibrated;
            for _ in 0..TUNING.focal_steps_each_way {
                let Some(next) = self.fit(&last.pose, last.change + direction) else { break };
                last = next;
                best = if next.cost < best.cost { next } else { best };
            }
        }
        let mut step = 0.5 * TUNING.log_focal_step;
        for _ in 0..4 {
            for change in [best.change - step, best.change + step] {
                best = self.fit(&best.pose, change).filter(|next| next.cost < best.cost).unwrap_or(best);
            }
            step *= 0.5;
        }
        best
    }

    /// Fits another focal length, reached by steps from a known one.
    fn towards(&self, start: Fit, change: f64) -> Fit {
        let steps = (change.abs() / TUNING.log_focal_step).ceil().max(1.0);
        let mut last = start;
        for k in 1..=steps as u32 {
            let Some(next) = self.fit(&last.pose, change * f64::from(k) / steps) else {
                return Fit { cost: f64::INFINITY, ..last };
            };
            last = next;
        }
        last
    }

    /// Returns the cost under a rival explanation: the calibrated lens is right, but the camera
    /// moved while the rows were read, or pictures are distorted and surfaces misplaced. It is the
    /// linear step from a fit, including the prior cost of that step.
    fn rival_cost(&self, fit: &Fit, is_moved: bool, is_askew: bool) -> Option<f64> {
        let count = self.body.surfaces.len();
        let (motion, corners) = (6, 12);
        let places = corners + CORNER_UNKNOWNS * count;
        let n = places + 6 * (count - 1);
        let doubt = |k: usize| &self.body.surfaces[k].spec.doubt;
        let sigma = |k: usize| match k {
            0..6 => f64::INFINITY,
            k if k < corners => {
                if is_moved {
                    TUNING.readout_motion_sigma[(k - motion) / 3]
                } else {
                    MODEL_ERROR_TUNING.fixed_sigma
                }
            }
            _ if !is_askew => MODEL_ERROR_TUNING.fixed_sigma,
            k if k < places => TUNING.surface_skew_sigma.max(doubt((k - corners) / CORNER_UNKNOWNS).corners_share()),
            k if (k - places) % 6 < 3 => MODEL_ERROR_TUNING.clue_place_sigma_m.max(doubt(1 + (k - places) / 6).position_m),
            k => MODEL_ERROR_TUNING.clue_direction_sigma.max(doubt(1 + (k - places) / 6).rotation_rad),
        };
        let prior = DVector::from_fn(n, |k, _| sigma(k).powi(-2));
        let row_share = |y: f64| (y + 0.5) / f64::from(self.camera.height()) - 0.5;
        let still = MovingCamera::still(self.camera);
        let to_camera = fit.pose.rotation_matrix();
        let mut normal = DMatrix::from_diagonal(&prior);
        let mut right = DVector::zeros(n);
        let mut rows = Vec::with_capacity(self.matches.len());
        for m in self.matches {
            let (residual, by_pose) = residual_and_jacobian(&fit.pose, &still, &m.observation)?;
            let (k, mut row) = (m.surface as usize, Matrix2xX::zeros(n));
            let spec = &self.body.surfaces[k].spec;
            row.columns_mut(0, 6).copy_from(&by_pose);
            row.columns_mut(motion, 6).copy_from(&(by_pose * row_share(m.observation.pixel.y)));
            let by_point = by_pose.fixed_columns::<3>(0) * to_camera;
            let by_surface = by_point * spec.pose.rotation_matrix();
            fill_corners(&mut row, corners + CORNER_UNKNOWNS * k, &by_surface, spec.size_m, m.on_picture_m);
            if k > 0 {
                let from_centre = m.observation.point.coords - spec.pose.translation;
                fill_place(&mut row, places + 6 * (k - 1), &by_point, &from_centre);
            }
            let weighted = m.observation.information * &row;
            normal.gemm_tr(1.0, &row, &weighted, 1.0);
            right.gemv_tr(-1.0, &weighted, &residual, 1.0);
            rows.push((row, residual, m.observation.information));
        }
        let step = Cholesky::<f64, Dyn>::new(normal)?.solve(&right);
        let taken: f64 = prior.iter().zip(step.iter()).map(|(information, step)| information * step * step).sum();
        let square = |(row, residual, information): &(Matrix2xX<f64>, Vector2<f64>, Matrix2<f64>)| {
            let left = residual + row * &step;
            left.dot(&(information * left)).min(TUNING.max_squared_focal_residual)
        };
        Some(taken + rows.iter().map(square).sum::<f64>())
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::track::patches::fitted_anchor::FittedAnchor;
    use crate::track::scene::surface::SurfaceSpec;
    use crate::track::synthetic::{cloth, facing, lens, prepared, seen_anchors, with_flat, zoomed};

    const NOISE_PX: f64 = 0.5;

    /// Returns matches of a frame that `camera` took of `real`, as observations of `configured`.
    /// The residual of a free homography is their noise.
    fn matches(configured: &PreparedBody, real: &PreparedBody, camera: &CameraModel, pose: &Pose<Camera, Body>) -> Vec<AgreeingMatch> {
        let mut random = Pcg64Mcg::seed_from_u64(3);
        let mut noise = Vec::new();
        let anchors = seen_anchors(real, pose, camera, 9, |_, _| {
            let off = Vector2::from_fn(|_, _| (0..12).map(|_| random.random_range(-0.5..0.5)).sum::<f64>() * NOISE_PX);
            noise.push(off.norm_squared());
            off
        });
        let observed = |(anchor, floor): (&FittedAnchor, f64)| {
            let spec = &configured.surfaces[anchor.surface as usize].spec;
            let point = spec.body_point(anchor.artwork);
            let observation = Observation { point, information: Matrix2::identity(), ..anchor.observation };
            AgreeingMatch { surface: anchor.surface, on_picture_m: spec.to_metres(anchor.artwork), observation, floor }
        };
        anchors.iter().zip(noise).map(observed).collect()
    }

    /// Returns the estimate if `camera` took the picture and the usual lens is configured.
    fn estimate(configured: Vec<SurfaceSpec>, real: Vec<SurfaceSpec>, camera: &CameraModel, pose: &Pose<Camera, Body>) -> MatchedFocal {
        estimate_through(&lens(640, 480), configured, real, camera, pose)
    }

    /// Like [`estimate`], with another configured lens.
    fn estimate_through(
        calibrated: &CameraModel,
        configured: Vec<SurfaceSpec>,
        real: Vec<SurfaceSpec>,
        camera: &CameraModel,
        pose: &Pose<Camera, Body>,
    ) -> MatchedFocal {
        let (configured, real) = (prepared(configured), prepared(real));
        let found = matches(&configured, &real, camera, pose);
        let observations: Vec<Observation> = found.iter().map(|m| m.observation).collect();
        let start = resect(pose, &MovingCamera::still(calibrated), &observations, 30).expect("a pose").pose;
        matched_focal(&start, calibrated, &configured, &found, true, None)
    }

    #[test]
    fn another_camera_mode_is_found_at_once() {
        let oblique = facing(0.1, -0.3, Vector3::new(0.2, 0.05, 5.0));
        for by in [0.667, 0.8, 0.9, 1.1, 1.25, 1.5_f64] {
            let MatchedFocal::Changed(change) = estimate(with_flat(), with_flat(), &zoomed(by), &oblique) else { panic!("{by}") };
            assert!((change - by.ln()).abs() < 0.03, "{by}: {change} instead of {}", by.ln());
        }
    }

    #[test]
    fn a_correct_lens_is_not_doubted() {
        for tilt in [-0.4, -0.1, 0.0, 0.2, 0.5] {
            let pose = facing(0.5 * tilt, tilt, Vector3::new(0.3, -0.1, 5.0));
            assert_eq!(estimate(with_flat(), with_flat(), &lens(640, 480), &pose), MatchedFocal::Unclear, "{tilt}");
        }
    }

    #[test]
    fn a_frontal_print_gives_no_evidence_on_the_lens() {
        let ahead = facing(0.0, 0.0, Vector3::new(0.0, 0.0, 5.0));
        // Distortion would reveal the focal length even here, so this lens has none.
        let [calibrated, real] = [640.0, 800.0].map(|f| CameraModel::pinhole(640, 480, f, f, 319.5, 239.5).expect("a camera"));
        let estimate = estimate_through(&calibrated, vec![cloth(1)], vec![cloth(1)], &real, &ahead);
        assert_eq!(estimate, MatchedFocal::Unclear);
    }

    #[test]
    fn corners_off_by_a_pixel_do_not_blame_the_lens() {
        let oblique = facing(0.15, -0.25, Vector3::new(0.1, 0.0, 5.0));
        for higher in [0.985, 0.995, 1.005, 1.015] {
            let mut cropped = cloth(1);
            cropped.size_m[1] *= higher;
            let estimate = estimate(vec![cloth(1)], vec![cropped], &lens(640, 480), &oblique);
            assert!(matches!(estimate, MatchedFocal::Unclear | MatchedFocal::Contested(_)), "{higher}: {estimate:?}");
        }
    }

    #[test]
    fn a_misplaced_flat_does_not_blame_the_lens() {
        let oblique = facing(0.1, -0.3, Vector3::new(0.2, 0.05, 5.0));
        for off in [Vector3::new(0.0, 0.0, 0.03), Vector3::new(0.02, 0.0, 0.0), Vector3::new(-0.02, 0.01, -0.03)] {
            let mut moved = with_flat();
            moved[1].pose.translation += off;
            let estimate = estimate(with_flat(), moved, &lens(640, 480), &oblique);
            assert!(matches!(estimate, MatchedFocal::Unclear | MatchedFocal::Contested(_)), "{off}: {estimate:?}");
        }
    }

    #[test]
    fn rows_displaced_by_motion_do_not_blame_the_lens() {
        let (body, calibrated) = (prepared(with_flat()), lens(640, 480));
        let oblique = facing(0.1, -0.3, Vector3::new(0.2, 0.05, 5.0));
        for twist in [[0.02, 0.0, 0.0, 0.0, 0.02, 0.0], [0.0, 0.01, 0.02, 0.02, 0.0, 0.0], [-0.01, 0.0, -0.02, -0.01, 0.015, 0.01]] {
            let mut found = matches(&body, &body, &calibrated, &oblique);
            for m in &mut found {
                let share = (m.observation.pixel.y + 0.5) / 480.0 - 0.5;
                let (_, by_pose) = residual_and_jacobian(&oblique, &MovingCamera::still(&calibrated), &m.observation).expect("it is seen");
                m.observation.pixel += by_pose * nalgebra::Vector6::from(twist) * share;
            }
            assert_eq!(matched_focal(&oblique, &calibrated, &body, &found, false, None), MatchedFocal::Unclear, "{twist:?}");
        }
        // A different mode is still found.
        let found = matches(&body, &body, &zoomed(0.8), &oblique);
        let observations: Vec<Observation> = found.iter().map(|m| m.observation).collect();
        let start = resect(&oblique, &MovingCamera::still(&calibrated), &observations, 30).expect("a pose").pose;
        let estimate = matched_focal(&start, &calibrated, &body, &found, false, None);
        assert!(matches!(estimate, MatchedFocal::Changed(change) if (change - 0.8_f64.ln()).abs() < 0.03), "{estimate:?}");
    }

    #[test]
    fn a_lens_doubt_is_cleared_if_the_calibrated_lens_fits_better() {
        let body = prepared(with_flat());
        let calibrated = lens(640, 480);
        let oblique = facing(0.1, -0.3, Vector3::new(0.2, 0.05, 5.0));
        let found = matches(&body, &body, &calibrated, &oblique);
        for suspected in [-0.4, -0.1, 0.08, 0.3] {
            assert_eq!(matched_focal(&oblique, &calibrated, &body, &found, true, Some(suspected)), MatchedFocal::Calibrated, "{suspected}");
        }
        // From straight ahead no doubt is taken back.
        let (flat, ahead) = (prepared(vec![cloth(1)]), facing(0.0, 0.0, Vector3::new(0.0, 0.0, 5.0)));
        let found = matches(&flat, &flat, &calibrated, &ahead);
        assert_eq!(matched_focal(&ahead, &calibrated, &flat, &found, true, Some(0.1)), MatchedFocal::Unclear);
        assert_eq!(matched_focal(&ahead, &calibrated, &flat, &found[..20], true, Some(0.1)), MatchedFocal::Unclear);
    }
}
