use nalgebra::{UnitQuaternion, Vector2, Vector3, Vector6};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::super::focal_clue::RowDisplacement;
use super::super::row_motion::RowMotion;
use super::super::surface::SurfaceSpec;
use super::super::synthetic::{cloth, facing, lens, prepared, seen_anchors};
use super::super::tile_residuals::TileResiduals;
use super::*;
use crate::camera::{Intrinsics, Normalized, Shutter};
use crate::geometry::resection::{MovingCamera, Observation, perturbed, resect};
use crate::geometry::{Body, Camera, Pose};
use crate::track::fitted_anchor::FittedAnchor;

const NOISE_PX: f64 = 0.005;

/// A cloth and a flat before it, at an angle.
fn with_flat() -> Vec<SurfaceSpec> {
    let mut flat = cloth(2);
    flat.pose = Pose::new(UnitQuaternion::from_euler_angles(0.0, 0.4, 0.0), Vector3::new(0.7, 0.1, 0.9));
    flat.size_m = [1.2, 0.9];
    vec![cloth(1), flat]
}

fn zoomed(by: f64) -> CameraModel {
    let i = *lens(640, 480).intrinsics();
    CameraModel::new(Intrinsics { fx: by * i.fx, fy: by * i.fy, ..i }).unwrap()
}

/// Frames of a stage that is configured as it is, but for how its corners really are, and of a lens that is configured as [`lens`].
struct Show {
    configured: PreparedBody,
    real: PreparedBody,
    /// Ratio, shear and keystones of every picture as it really is.
    askew: [f64; 4],
    memory: FocalMemory,
    random: Pcg64Mcg,
}

impl Show {
    fn new(configured: Vec<SurfaceSpec>, real: Vec<SurfaceSpec>) -> Self {
        let configured = prepared(configured);
        let memory = FocalMemory::new(&configured);
        Self { configured, real: prepared(real), askew: [0.0; 4], memory, random: Pcg64Mcg::seed_from_u64(1) }
    }

    fn as_configured(surfaces: Vec<SurfaceSpec>) -> Self {
        Self::new(surfaces.clone(), surfaces)
    }

    /// What a frame says that `camera` took.
    fn clue(&mut self, camera: &CameraModel, start: &Pose<Camera, Body>) -> LensClue {
        let Self { configured, real, random, askew, .. } = self;
        let mut noise = |_, _| Vector2::from_fn(|_, _| (0..12).map(|_| random.random_range(-0.5..0.5)).sum::<f64>() * NOISE_PX);
        let mut anchors = seen_anchors(real, start, camera, 10, &mut noise);
        for a in &mut anchors {
            let spec = &configured.surfaces[a.surface as usize].spec;
            let at = spec.to_metres(a.artwork);
            let moved: Vector2<f64> =
                super::super::model_unknowns::moved_by_corners(spec.size_m, at).iter().zip(*askew).map(|(by, n)| by * n).sum();
            // The configured picture has this detail elsewhere.
            a.artwork = spec.to_artwork(at - moved);
            a.observation.point = spec.body_point(a.artwork);
            a.observation.information /= NOISE_PX.powi(2);
        }
        let rows = RowMotion { shutter: Shutter::default(), readout_sigma_s: 0.02, before: None };
        self.asked(&anchors, start, &rows)
    }

    fn asked(&mut self, anchors: &[FittedAnchor], start: &Pose<Camera, Body>, rows: &RowMotion) -> LensClue {
        let (observations, told): (Vec<Observation>, _) = (anchors.iter().map(|a| a.observation).collect(), lens(640, 480));
        let pose = resect(start, &MovingCamera::still(&told), &observations, 30).expect("a pose").pose;
        let mut residuals = TileResiduals::default();
        residuals.take(&pose, &told, anchors).expect("tiles enough");
        let rows = match rows.before {
            None => RowMotion { before: Some((pose, 0.03, None)), ..*rows },
            Some(_) => *rows,
        };
        let rows = RowDisplacement::new(&told, &rows, &pose);
        let frame = StudiedFrame { residuals: &residuals, pose: &pose, anchors, rows: &rows };
        let clue = self.memory.ask(&frame, &self.configured, &told).expect("a clue");
        self.memory.remember(1.0);
        clue
    }

    /// What the last of some frames says of a path past the stage.
    fn walk(&mut self, camera: &CameraModel, frames: u32) -> Vec<LensClue> {
        (0..frames)
            .map(|k| self.clue(camera, &facing(0.12 - 0.01 * f64::from(k), 0.4 - 0.03 * f64::from(k), Vector3::new(0.2, 0.05, 5.0))))
            .collect()
    }
}

fn oblique() -> Pose<Camera, Body> {
    facing(0.1, -0.35, Vector3::new(0.2, 0.05, 5.0))
}

#[test]
fn a_zoom_is_seen_from_the_side_and_in_depth() {
    let ahead = facing(0.02, 0.03, Vector3::new(0.2, 0.05, 5.0));
    for (surfaces, pose) in [(vec![cloth(1)], oblique()), (with_flat(), ahead)] {
        for by in [1.15, 0.87, 1.03] {
            let mut show = Show::as_configured(surfaces.clone());
            (0..6).for_each(|_| assert!(show.clue(&lens(640, 480), &pose).off(0.0).is_none()));
            let clue = show.clue(&zoomed(by), &pose);
            assert!(clue.changed.is_off(0.0) && !clue.changed.is_right(0.0), "{by}: {clue:?}");
            assert!((clue.changed.change - f64::ln(by)).abs() < 0.2 * f64::abs(by - 1.0) + 4.0 * clue.changed.sigma, "{by}: {clue:?}");
        }
    }
}

#[test]
fn a_lens_that_is_wrong_from_the_first_is_found_on_a_walk() {
    for by in [1.1, 0.9] {
        let mut show = Show::as_configured(with_flat());
        let said = show.walk(&zoomed(by), 12);
        assert!(said.iter().any(|clue| clue.whole.is_off(0.003)), "{by}: {:?}", said.last());
    }
}

#[test]
fn pictures_that_are_sheared_or_cropped_askew_convict_no_lens() {
    // Shear of 0.3 %, keystones of 0.2 % each way, and a crop that is askew.
    for askew in [[0.0, 0.003, 0.0, 0.0], [0.0, 0.0, 0.002, 0.0], [0.0, 0.0, 0.0, -0.002], [0.002, -0.002, 0.0015, 0.002]] {
        let mut show = Show { askew, ..Show::as_configured(vec![cloth(1)]) };
        for clue in show.walk(&lens(640, 480), 30) {
            assert_eq!(clue.off(0.003), None, "{askew:?}: {clue:?}");
        }
    }
}

#[test]
fn a_pan_under_a_rolling_shutter_that_is_not_configured_is_no_zoom() {
    let (body, camera, height) = (prepared(vec![cloth(1)]), lens(640, 480), 480.0);
    for motion in [[0.0, 0.0, 0.4, 0.6, 0.0, 0.0], [0.0, 0.4, 0.0, 0.8, -0.4, 0.3]] {
        let mut anchors = seen_anchors(&body, &oblique(), &camera, 10, &mut |_, _| Vector2::zeros());
        for a in &mut anchors {
            let late = perturbed(&oblique(), &(Vector6::from(motion) * (0.025 * (a.observation.pixel.y / height - 0.5))));
            let c = late.transform(&a.observation.point).coords;
            a.observation.pixel = camera.project(Normalized(c.xy() / c.z)).0;
            a.corrected_px = a.observation.pixel;
            a.observation.information /= NOISE_PX.powi(2);
        }
        let before = perturbed(&oblique(), &(Vector6::from(motion) * -0.03));
        let rows = RowMotion { shutter: Shutter::default(), readout_sigma_s: 0.02, before: Some((before, 0.03, None)) };
        let clue = Show::as_configured(vec![cloth(1)]).asked(&anchors, &oblique(), &rows);
        assert_eq!(clue.off(0.0), None, "{motion:?}: {clue:?}");
    }
}

#[test]
fn the_calibrated_lens_is_right() {
    let mut show = Show::as_configured(with_flat());
    let said = show.walk(&lens(640, 480), 12);
    let last = said.last().expect("frames");
    assert!(said.iter().all(|clue| clue.off(0.0).is_none() && clue.doubt().is_none()), "{said:?}");
    assert!(last.changed.is_right(0.0) && last.whole.sigma < 0.003, "{last:?}");
}

#[test]
fn a_flat_stage_straight_ahead_says_nothing_of_it() {
    let pose = facing(0.0, 0.0, Vector3::new(0.2, 0.05, 5.0));
    let clue = Show::as_configured(vec![cloth(1)]).clue(&zoomed(1.1), &pose);
    assert!(clue.off(0.0).is_none() && !clue.changed.is_right(0.003), "{clue:?}");
}

#[test]
fn careless_measures_are_no_zoom() {
    let mut stretched = cloth(1);
    stretched.size_m[0] *= 1.005;
    let mut elsewhere = with_flat();
    elsewhere[1].pose.translation += Vector3::new(0.004, -0.003, 0.006);
    let i = *lens(640, 480).intrinsics();
    let bent = CameraModel::new(Intrinsics { distortion: [-0.13, 0.05, 0.0005, -0.0003, 0.0], ..i }).unwrap();
    let shows = [
        (Show::new(vec![stretched], vec![cloth(1)]), lens(640, 480)),
        (Show::new(elsewhere, with_flat()), lens(640, 480)),
        (Show::as_configured(vec![cloth(1)]), bent),
    ];
    for (k, (mut show, camera)) in shows.into_iter().enumerate() {
        let said = show.walk(&camera, 20);
        assert!(said.iter().all(|clue| clue.off(0.003).is_none()), "{k}: {said:?}");
    }
}
