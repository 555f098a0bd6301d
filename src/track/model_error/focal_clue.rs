//! Decides whether another focal length explains a frame better than the calibrated one: the lens
//! was zoomed or focused, or it is another lens.
//!
//! Seen head-on, a flat stage that fills more of the picture is either nearer or seen through a
//! longer lens, and nothing tells the two apart. From the side or in depth they differ in
//! perspective, and a wrong focal length leaves the tiles displaced. But so does a stretched print,
//! a surface that stands elsewhere than configured, or a lens with more distortion than calibrated.
//! All of these may explain the displacements first; only what the focal length alone then still
//! explains counts. This takes time, so it runs only if the focal length explains much by itself
//! ([`is_suspect`]).

use crate::track::model_error::tuning::TUNING;
use nalgebra::{DMatrix, DVector, Dyn, Matrix2xX, Matrix6, Vector6};

use super::model_unknowns::{CORNER_UNKNOWNS, fill_corners, fill_place};
use super::tile_residuals::{TileResidual, TileResiduals};
use crate::camera::{CameraModel, Shutter};
use crate::geometry::{Body, Camera, Pose};
use crate::track::patches::fitted_anchor::FittedAnchor;
use crate::track::patches::row_motion::RowMotion;
use crate::track::scene::reference::PreparedBody;

/// What one frame says about the focal length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FocalClue {
    /// Logarithm of the ratio of the fitted focal length to the calibrated one.
    pub change: f64,
    /// Its sigma, with all other model errors free.
    pub sigma: f64,
    /// Fraction of the squared displacements, after all other unknowns, that it explains.
    pub share: f64,
    /// Whether a slightly skewed picture explains the frame as well.
    pub is_contested: bool,
}

impl FocalClue {
    /// Whether another focal length explains the frame clearly better. `doubt`: sigma of the
    /// logarithm of the calibrated one.
    pub fn is_off(&self, doubt: f64) -> bool {
        self.change.abs() < TUNING.max_focal_change && !self.is_contested && self.explains(doubt)
    }

    /// Returns the possible error of the log focal length if it explains the frame but is no
    /// evidence: a skewed picture explains it as well, or the change is larger than a linear step
    /// can report. `doubt`: as for [`is_off`](Self::is_off).
    pub fn possible_change(&self, doubt: f64) -> Option<f64> {
        (!self.is_off(doubt) && self.explains(doubt)).then_some(self.change.abs().min(TUNING.max_focal_change))
    }

    fn explains(&self, doubt: f64) -> bool {
        let size = self.change.abs();
        size > TUNING.min_focal_change
            && size > TUNING.min_focal_change_sigmas * self.sigma
            && size > TUNING.min_focal_change_calibration_sigmas * doubt
            && self.share > TUNING.min_focal_explained_ratio
    }

    /// Returns the deviation of the log focal length from earlier frames if it is clear. `mean`,
    /// `mean_sigma`: the earlier estimate. Any other misfit, such as folded cloth or a slightly
    /// wrong lens, says much the same in all frames.
    pub fn deviation(&self, mean: f64, mean_sigma: f64) -> Option<f64> {
        let by = self.change - mean;
        // A share of 0 means that motion during readout explains the frame as well.
        let is_clear =
            by.abs() > TUNING.min_focal_change && by.abs() > TUNING.deviation_sigmas * self.sigma.hypot(mean_sigma) && self.share > 0.0;
        is_clear.then_some(by)
    }

    /// Whether the deviation is one that only a changed lens explains. `doubt`: as for
    /// [`is_off`](Self::is_off). `is_uncalibrated`: whether frames contradicted the calibration
    /// from the first.
    pub fn has_changed(&self, mean: f64, mean_sigma: f64, doubt: f64, is_uncalibrated: bool) -> bool {
        let least = if is_uncalibrated { TUNING.min_focal_change_sigmas } else { TUNING.clear_deviation_sigmas };
        let sigma = self.sigma.hypot(mean_sigma);
        let is_far = |by: f64| {
            sigma < TUNING.max_changed_focal_sigma
                && by.abs() < TUNING.max_focal_change
                && by.abs() > least * sigma
                && by.abs() > TUNING.min_focal_change_calibration_sigmas * doubt
        };
        self.deviation(mean, mean_sigma).is_some_and(is_far)
    }

    /// Whether the frame agrees with those from before the lens was changed.
    pub fn agrees_with_mean(&self, mean: f64, mean_sigma: f64) -> bool {
        let sigma = self.sigma.hypot(mean_sigma);
        (self.change - mean).abs() < TUNING.min_focal_change.max(TUNING.restored_focal_sigmas * sigma)
            && sigma < TUNING.max_restored_focal_sigma
    }

    /// Whether the frame was clearly taken with the calibrated focal length.
    pub fn is_right(&self, doubt: f64) -> bool {
        self.change.abs() + TUNING.restored_focal_sigmas * self.sigma
            < TUNING.min_focal_change + TUNING.min_focal_change_calibration_sigmas * doubt
    }
}

/// Whether the focal length explains much when only the pose is free. Only then is the full test
/// worth its time.
pub fn is_suspect(residuals: &TileResiduals) -> bool {
    let mut right = Vector6::<f64>::zeros();
    let mut shared = Vector6::<f64>::zeros();
    let (mut own, mut score, mut squared) = (0.0, 0.0, 0.0);
    for t in residuals.tiles() {
        let weighted = t.by_pose.transpose() * t.information;
        right += weighted * t.shift_px;
        shared += weighted * t.by_focal;
        own += t.by_focal.dot(&(t.information * t.by_focal));
        score += t.by_focal.dot(&(t.information * t.shift_px));
        squared += t.squared();
    }
    let Some(factor) = residuals.normal().cholesky() else { return false };
    let by_pose = factor.solve(&shared);
    let (information, score, left) = (own - shared.dot(&by_pose), score - right.dot(&by_pose), squared - right.dot(&factor.solve(&right)));
    let freedom = 2.0 * residuals.weight() - 7.0;
    if information <= 0.0 || freedom <= 0.0 {
        return false;
    }
    let explained = score.powi(2) / information;
    let sigma = ((left - explained).max(0.0) / freedom / information).sqrt();
    let clue = FocalClue { change: score / information, sigma, share: explained / left.max(f64::MIN_POSITIVE), is_contested: false };
    clue.explains(0.0)
}

/// How the rows of a frame may be displaced by a motion that its pose does not include.
#[derive(Debug, Clone, Copy)]
pub struct RowDisplacement {
    shutter: Shutter,
    height: u32,
    /// Inverse covariance of the motion during readout ([m/s, rad/s], camera axes).
    motion_information: Matrix6<f64>,
    is_described: bool,
}

impl RowDisplacement {
    /// Creates the displacement of a frame at `pose` (`T_camera_body`).
    ///
    /// A described shutter leaves only the error of the estimated motion. An undescribed one may
    /// read rows in sequence all the same: then the rows may contain any fraction of the body's
    /// motion, and of each component its change.
    pub fn new(camera: &CameraModel, rows: &RowMotion, pose: &Pose<Camera, Body>) -> Self {
        let is_described =
            rows.shutter.readout_s != 0.0 && rows.readout_sigma_s <= TUNING.max_described_readout_sigma * rows.shutter.readout_s.abs();
        let [moving, rotating] = TUNING.clue_motion_sigma.map(|sigma| sigma.powi(2));
        let usual = Matrix6::from_diagonal(&Vector6::new(moving, moving, moving, rotating, rotating, rotating));
        let moved = rows.twist_and_change(pose).filter(|_| !is_described);
        let covariance = moved.map_or(usual, |(twist, change)| {
            twist * twist.transpose()
                + Matrix6::from_diagonal(&change.component_mul(&change).add_scalar(TUNING.min_clue_motion_sigma.powi(2)))
        });
        let motion_information = covariance.cholesky().map_or(still(), |factor| factor.inverse());
        let readout_s = if is_described { rows.shutter.readout_s } else { TUNING.assumed_readout_s };
        Self { shutter: Shutter { readout_s, ..rows.shutter }, height: camera.height(), motion_information, is_described }
    }

    /// Returns the same for a frame in which nothing moved.
    fn without_motion(&self) -> Self {
        Self { motion_information: still(), ..*self }
    }

    /// Whether the readout time is configured or learnt well enough.
    pub fn is_described(&self) -> bool {
        self.is_described
    }

    /// Returns the inverse covariance of the motion that displaces the rows ([m/s, rad/s]).
    pub fn motion_information(&self) -> &Matrix6<f64> {
        &self.motion_information
    }

    /// Returns the exposure time of a tile's row, seconds after the middle row.
    pub fn delay_s(&self, t: &TileResidual) -> f64 {
        self.shutter.delay_s(t.place_px.y + 0.5, self.height)
    }
}

/// Returns the inverse covariance of a motion held at zero.
fn still() -> Matrix6<f64> {
    Matrix6::identity() * TUNING.min_clue_motion_sigma.powi(-2)
}

/// Estimates the focal length from one frame, with all other model errors free within their priors.
/// `pose`: `T_camera_body`. `None` if the equations are singular.
///
/// With an undescribed shutter, motion during readout and a zoom can look alike, and together they
/// explain almost anything. They are then rivals: the focal length counts only if the motion does
/// not explain the frame better.
pub fn focal_clue(
    residuals: &TileResiduals,
    pose: &Pose<Camera, Body>,
    body: &PreparedBody,
    anchors: &[FittedAnchor],
    rows: &RowDisplacement,
) -> Option<FocalClue> {
    let frame = FocalFrame { residuals, pose, body, anchors };
    let known = if rows.is_described { *rows } else { rows.without_motion() };
    let fit = Fit::new(&frame, &known, 0.0)?;
    let clue = fit.clue()?;
    let by_focal = fit.left - fit.explained();
    let moving = if rows.is_described { f64::INFINITY } else { Fit::new(&frame, rows, 0.0)?.left };
    let clue = FocalClue { share: if moving < TUNING.max_motion_rival_ratio * by_focal { 0.0 } else { clue.share }, ..clue };
    // A focal length that explains nothing has no rival.
    let is_contested =
        clue.explains(0.0) && Fit::new(&frame, &known, TUNING.clue_skew_sigma)?.left < by_focal + TUNING.min_focal_over_skew_gain;
    Some(FocalClue { is_contested, ..clue })
}

/// A frame whose focal length is estimated.
struct FocalFrame<'a> {
    residuals: &'a TileResiduals,
    pose: &'a Pose<Camera, Body>,
    body: &'a PreparedBody,
    anchors: &'a [FittedAnchor],
}

/// The residual after all other unknowns, and what the focal length explains of it.
struct Fit {
    /// Squared displacements after all other unknowns, in variances of noise.
    left: f64,
    /// Information of the log focal length.
    information: f64,
    /// Right side of its normal equation.
    score: f64,
    /// Number of measurements beyond the unknowns.
    freedom: f64,
}

impl Fit {
    /// Fits all unknowns. `askew`: prior sigma of shear and keystone of pictures whose corners are
    /// not in doubt.
    fn new(&FocalFrame { residuals, pose, body, anchors }: &FocalFrame<'_>, rows: &RowDisplacement, askew: f64) -> Option<Self> {
        let unknowns = Unknowns::new(body, anchors, *rows);
        let n = unknowns.count();
        let mut normal = unknowns.prior(body, askew);
        let (mut right, mut shared) = (DVector::zeros(n), DVector::zeros(n));
        let (mut own, mut score, mut squared) = (0.0, 0.0, 0.0);
        let mut row = Matrix2xX::zeros(n);
        for t in residuals.tiles() {
            unknowns.fill(&mut row, t, &anchors[t.anchor], pose, body);
            let weighted = t.information * &row;
            normal.gemm_tr(1.0, &row, &weighted, 1.0);
            right.gemv_tr(1.0, &weighted, &t.shift_px, 1.0);
            shared.gemv_tr(1.0, &weighted, &t.by_focal, 1.0);
            own += t.by_focal.dot(&(t.information * t.by_focal));
            score += t.by_focal.dot(&(t.information * t.shift_px));
            squared += t.squared();
        }
        let factor = nalgebra::Cholesky::<f64, Dyn>::new(normal)?;
        let by_others = factor.solve(&shared);
        Some(Self {
            left: squared - right.dot(&factor.solve(&right)),
            information: own - shared.dot(&by_others),
            score: score - right.dot(&by_others),
            freedom: 2.0 * residuals.weight() - (n + 1) as f64,
        })
    }

    /// Returns the squared displacements that the focal length explains.
    fn explained(&self) -> f64 {
        self.score.powi(2) / self.information
    }

    fn clue(&self) -> Option<FocalClue> {
        let Self { left, information, score, freedom } = *self;
        if !(information > 0.0 && left > 0.0 && freedom > 0.0) {
            return None;
        }
        let explained = self.explained();
        let sigma = ((left - explained).max(0.0) / freedom / information).sqrt();
        Some(FocalClue { change: score / information, sigma, share: explained / left, is_contested: false })
    }
}

/// The unknowns beside the focal length, in the order of their columns: the pose, the radial
/// coefficient, the motion during readout, the corners of the surfaces (ratio, shear and
/// keystones), and the places of all surfaces but the first.
struct Unknowns {
    rows: RowDisplacement,
    /// Surfaces that have tiles.
    surfaces: Vec<u32>,
}

impl Unknowns {
    fn new(body: &PreparedBody, anchors: &[FittedAnchor], rows: RowDisplacement) -> Self {
        let has_tiles = |k: &u32| anchors.iter().any(|a| a.surface == *k);
        Self { rows, surfaces: (0..body.surfaces.len() as u32).filter(has_tiles).collect() }
    }

    /// Returns the first columns of the motion, the corners and the places.
    fn begins(&self) -> [usize; 3] {
        let motion = 7;
        let corners = motion + 6;
        [motion, corners, corners + CORNER_UNKNOWNS * self.surfaces.len()]
    }

    fn count(&self) -> usize {
        self.begins()[2] + 6 * self.surfaces.len().saturating_sub(1)
    }

    /// Returns the prior information matrix of the unknowns.
    fn prior(&self, body: &PreparedBody, askew: f64) -> DMatrix<f64> {
        let [motion, corners, places] = self.begins();
        let in_doubt = |k: usize| body.surfaces[self.surfaces[(k - corners) / CORNER_UNKNOWNS] as usize].spec.doubt.corners_share();
        let sigmas = DVector::from_fn(self.count(), |k, _| match k {
            0..6 => f64::INFINITY,
            6 => TUNING.clue_radial_sigma,
            k if k < corners => 1.0,
            k if k < places && (k - corners) % CORNER_UNKNOWNS == 0 => TUNING.clue_ratio_sigma.max(in_doubt(k)),
            k if k < places => askew.max(in_doubt(k)).max(TUNING.fixed_sigma),
            k if (k - places) % 6 < 3 => TUNING.clue_place_sigma_m,
            _ => TUNING.clue_direction_sigma,
        });
        let mut prior = DMatrix::from_diagonal(&sigmas.map(|sigma: f64| sigma.powi(-2)));
        prior.fixed_view_mut::<6, 6>(motion, motion).copy_from(&self.rows.motion_information);
        prior
    }

    /// Writes the derivatives of a tile's shift.
    fn fill(&self, row: &mut Matrix2xX<f64>, t: &TileResidual, anchor: &FittedAnchor, pose: &Pose<Camera, Body>, body: &PreparedBody) {
        row.fill(0.0);
        row.columns_mut(0, 6).copy_from(&t.by_pose);
        row.set_column(6, &t.by_radial);
        let [motion, corners, places] = self.begins();
        row.columns_mut(motion, 6).copy_from(&(t.by_pose * self.rows.delay_s(t)));
        let Some(k) = self.surfaces.iter().position(|s| *s == anchor.surface) else { return };
        let spec = &body.surfaces[anchor.surface as usize].spec;
        let to_camera = pose.rotation_matrix();
        let by_point = t.by_pose.fixed_columns::<3>(0).into_owned();
        let by_surface = by_point * (to_camera * spec.pose.rotation_matrix());
        fill_corners(row, corners + CORNER_UNKNOWNS * k, &by_surface, spec.size_m, spec.to_metres(anchor.artwork));
        if k > 0 {
            let from_centre = to_camera * (anchor.observation.point.coords - spec.pose.translation);
            fill_place(row, places + 6 * (k - 1), &by_point, &from_centre);
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Vector2, Vector3};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::super::model_unknowns::moved_by_corners;
    use super::*;
    use crate::camera::{Intrinsics, Normalized};
    use crate::geometry::resection::{MovingCamera, Observation, perturbed, resect};
    use crate::track::scene::surface::SurfaceSpec;
    use crate::track::synthetic::{cloth, facing, lens, prepared, seen_anchors, with_flat, zoomed};

    const NOISE_PX: f64 = 0.005;

    /// Estimates the focal length with the configured body and the usual lens from pictures that
    /// `camera` took of the `real` body.
    fn clue(configured: Vec<SurfaceSpec>, real: Vec<SurfaceSpec>, camera: &CameraModel, start: &Pose<Camera, Body>) -> (bool, FocalClue) {
        let mut random = Pcg64Mcg::seed_from_u64(1);
        let mut noise = |_, _| Vector2::from_fn(|_, _| (0..12).map(|_| random.random_range(-0.5..0.5)).sum::<f64>() * NOISE_PX);
        let (configured, real) = (prepared(configured), prepared(real));
        let mut anchors = seen_anchors(&real, start, camera, 10, &mut noise);
        for a in &mut anchors {
            a.observation.point = configured.surfaces[a.surface as usize].spec.body_point(a.artwork);
            a.observation.information /= NOISE_PX.powi(2);
        }
        clue_from(&configured, &anchors, start)
    }

    /// The same from these observations and a start near the pose.
    fn clue_from(configured: &PreparedBody, anchors: &[FittedAnchor], start: &Pose<Camera, Body>) -> (bool, FocalClue) {
        let observations: Vec<Observation> = anchors.iter().map(|a| a.observation).collect();
        let usual_lens = lens(640, 480);
        let pose = resect(start, &MovingCamera::still(&usual_lens), &observations, 30).expect("a pose").pose;
        let mut residuals = TileResiduals::default();
        residuals.take(&pose, &usual_lens, anchors).expect("tiles enough");
        let rows = RowMotion { shutter: Shutter::default(), readout_sigma_s: 0.02, before: Some((pose, 0.03, None)) };
        let rows = RowDisplacement::new(&usual_lens, &rows, &pose);
        (is_suspect(&residuals), focal_clue(&residuals, &pose, configured, anchors, &rows).expect("a clue"))
    }

    fn oblique() -> Pose<Camera, Body> {
        facing(0.1, -0.35, Vector3::new(0.2, 0.05, 5.0))
    }

    #[test]
    fn a_zoom_is_detected_in_oblique_and_deep_views() {
        let ahead = facing(0.02, 0.03, Vector3::new(0.2, 0.05, 5.0));
        for (surfaces, pose) in [(vec![cloth(1)], oblique()), (with_flat(), ahead)] {
            // From 20 degrees aside, 0.85 is what a print shows that is 1.8 % too wide: no evidence
            // against the lens.
            for by in [1.2, 0.82] {
                let (is_suspect, clue) = clue(surfaces.clone(), surfaces.clone(), &zoomed(by), &pose);
                assert!(is_suspect && clue.is_off(0.0) && !clue.is_right(0.0), "{by}: {clue:?}");
                assert!((clue.change - f64::ln(by)).abs() < 0.15 * f64::abs(by - 1.0) + 4.0 * clue.sigma, "{by}: {clue:?}");
            }
        }
    }

    #[test]
    fn implausible_focal_clues_do_not_blame_the_lens() {
        // +507 %, -100 % and -73 % were reported for a calibrated lens when a corner of a
        // photograph was a pixel off.
        for change in [1.8, -7.0, -1.3, 0.3] {
            let clue = FocalClue { change, sigma: 0.001, share: 0.9, is_contested: false };
            assert!(!clue.is_off(0.0) && !clue.has_changed(0.0, 0.001, 0.0, false), "{change}");
            assert_eq!(clue.possible_change(0.0), Some(TUNING.max_focal_change), "{change}");
        }
        let zoom = FocalClue { change: 0.15, sigma: 0.005, share: 0.9, is_contested: false };
        assert!(zoom.is_off(0.0) && zoom.possible_change(0.0).is_none());
        let contested = FocalClue { is_contested: true, ..zoom };
        assert!(!contested.is_off(0.0) && contested.possible_change(0.0) == Some(0.15));
    }

    /// Estimates the focal length from a picture with this shear and these keystones, seen through
    /// the configured lens.
    fn askew(by: [f64; CORNER_UNKNOWNS], start: &Pose<Camera, Body>) -> FocalClue {
        let configured = prepared(vec![cloth(1)]);
        let mut anchors = seen_anchors(&configured, start, &lens(640, 480), 10, &mut |_, _| Vector2::zeros());
        for a in &mut anchors {
            let spec = &configured.surfaces[0].spec;
            let at = spec.to_metres(a.artwork);
            let moved: Vector2<f64> = moved_by_corners(spec.size_m, at).iter().zip(by).map(|(way, number)| way * number).sum();
            // The configured picture has this detail elsewhere.
            a.artwork = spec.to_artwork(at - moved);
            a.observation.point = spec.body_point(a.artwork);
            a.observation.information /= NOISE_PX.powi(2);
        }
        clue_from(&configured, &anchors, start).1
    }

    #[test]
    fn sheared_or_skewed_pictures_do_not_blame_the_lens() {
        let mut doubted = 0;
        for by in [[0.0, 0.003, 0.0, 0.0], [0.0, 0.0, 0.002, 0.0], [0.0, 0.0, 0.0, -0.002], [0.002, -0.002, 0.0015, 0.002]] {
            for k in 0..30 {
                let pose = facing(0.12 - 0.01 * f64::from(k), 0.4 - 0.03 * f64::from(k), Vector3::new(0.2, 0.05, 5.0));
                let clue = askew(by, &pose);
                assert!(!clue.is_off(0.0), "{by:?}, frame {k}: {clue:?}");
                doubted += usize::from(clue.possible_change(0.0).is_some());
            }
        }
        assert!(doubted > 20, "{doubted} of 120 frames are in doubt");
    }

    #[test]
    fn a_pan_under_an_unconfigured_rolling_shutter_is_no_zoom() {
        let (body, camera, height) = (prepared(vec![cloth(1)]), lens(640, 480), 480.0);
        for motion in [[0.0, 0.0, 0.4, 0.6, 0.0, 0.0], [0.0, 0.4, 0.0, 0.8, -0.4, 0.3]] {
            let still = seen_anchors(&body, &oblique(), &camera, 10, &mut |_, _| Vector2::zeros());
            let mut anchors = still.clone();
            for a in &mut anchors {
                let late = perturbed(&oblique(), &(Vector6::from(motion) * (0.025 * (a.observation.pixel.y / height - 0.5))));
                let c = late.transform(&a.observation.point).coords;
                a.observation.pixel = camera.project(Normalized(c.xy() / c.z)).0;
                a.corrected_px = a.observation.pixel;
                a.observation.information /= NOISE_PX.powi(2);
            }
            let observations: Vec<Observation> = anchors.iter().map(|a| a.observation).collect();
            let pose = resect(&oblique(), &MovingCamera::still(&camera), &observations, 30).expect("a pose").pose;
            let mut residuals = TileResiduals::default();
            residuals.take(&pose, &camera, &anchors).expect("tiles enough");
            let before = perturbed(&pose, &(Vector6::from(motion) * -0.03));
            let rows = RowMotion { shutter: Shutter::default(), readout_sigma_s: 0.02, before: Some((before, 0.03, None)) };
            let clue = focal_clue(&residuals, &pose, &body, &anchors, &RowDisplacement::new(&camera, &rows, &pose));
            assert!(!clue.expect("a clue").is_off(0.0), "{motion:?}: {clue:?}");
        }
    }

    #[test]
    fn a_correct_calibrated_lens_is_judged_right() {
        let (is_suspect, clue) = clue(with_flat(), with_flat(), &lens(640, 480), &oblique());
        assert!(!is_suspect && clue.is_right(0.0) && clue.change.abs() < 4.0 * clue.sigma, "{clue:?}");
    }

    #[test]
    fn a_frontal_flat_stage_gives_no_focal_evidence() {
        let pose = facing(0.0, 0.0, Vector3::new(0.2, 0.05, 5.0));
        let (_, clue) = clue(vec![cloth(1)], vec![cloth(1)], &zoomed(1.1), &pose);
        assert!(!clue.is_off(0.0) && !clue.is_right(0.0), "{clue:?}");
    }

    #[test]
    fn small_measuring_errors_are_not_mistaken_for_a_zoom() {
        let mut stretched = cloth(1);
        stretched.size_m[0] *= 1.005;
        let (_, print) = clue(vec![stretched], vec![cloth(1)], &lens(640, 480), &oblique());
        assert!(!print.is_off(0.0), "{print:?}");
        let mut elsewhere = with_flat();
        elsewhere[1].pose.translation += Vector3::new(0.004, -0.003, 0.006);
        let (_, layout) = clue(elsewhere, with_flat(), &lens(640, 480), &oblique());
        assert!(!layout.is_off(0.0), "{layout:?}");
        let i = *lens(640, 480).intrinsics();
        let bent = CameraModel::new(Intrinsics { distortion: [-0.13, 0.05, 0.0005, -0.0003, 0.0], ..i }).unwrap();
        let (_, bent) = clue(vec![cloth(1)], vec![cloth(1)], &bent, &oblique());
        assert!(!bent.is_off(0.0), "{bent:?}");
    }
}
