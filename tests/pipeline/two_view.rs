//! `homography`, `essential` and `model` of the record, compared with the ground truth.

use image::imageops;
use nalgebra::{Matrix3, Point3, Vector2, Vector3};
use stagepose::diagnostics::simulate::look_at;
use stagepose::two_views::geometry::Homography;
use stagepose::{Camera, CameraPath, EssentialMotion, Normalized, Pose, PoseSample, Stage, TwoViewModel, VirtualStage};

use super::scene::{backdrop, backdrop_art, body, camera, other_art, past, quiet, surface, track, truth_of};

/// Returns where an artwork pixel of the first surface is truly seen, in undistorted pixels; `None`
/// outside the frame.
pub fn seen_at(scene: &VirtualStage, truth: &Pose<Stage, Camera>, artwork: Vector2<f64>) -> Option<Vector2<f64>> {
    let point = scene.stage.surfaces[0].body_point(artwork);
    let c = truth.inverse().transform(&point);
    let ray = Normalized(Vector2::new(c.x / c.z, c.y / c.z));
    let raw = scene.camera.project(ray).0;
    let inside = raw.x > 0.0 && raw.y > 0.0 && raw.x < f64::from(scene.camera.width()) && raw.y < f64::from(scene.camera.height());
    (c.z > 0.0 && inside).then(|| scene.camera.undistorted_pixel(ray))
}

/// Returns the largest distance between a homography and the ground truth over the artwork pixels
/// in view. `from` maps an artwork pixel to the pixel that the homography starts from.
pub fn worst_transfer(scene: &VirtualStage, sample: &PoseSample, h: &Matrix3<f64>, from: impl Fn(Vector2<f64>) -> Vector2<f64>) -> f64 {
    assert_eq!(h[(2, 2)], 1.0);
    let art = &scene.stage.surfaces[0].artwork;
    let (w, h_px) = (f64::from(art.width()), f64::from(art.height()));
    let truth = truth_of(scene, sample);
    let mut worst = 0.0_f64;
    let mut compared = 0;
    // The corners and a grid between them, because a corner may be out of view.
    for i in 0..=8 {
        for k in 0..=8 {
            let p = Vector2::new(f64::from(i) / 8.0 * w - 0.5, f64::from(k) / 8.0 * h_px - 0.5);
            let Some(expected) = seen_at(scene, &truth, p) else { continue };
            let found = Homography(*h).map(from(p)).expect("a finite pixel");
            worst = worst.max((found - expected).norm());
            compared += 1;
        }
    }
    assert!(compared > 20, "{compared} places in view");
    worst
}

/// Returns the errors of the record's motion from a reference camera, degrees: rotation, direction.
pub fn motion_errors(scene: &VirtualStage, sample: &PoseSample, reference: &Pose<Stage, Camera>, found: &EssentialMotion) -> (f64, f64) {
    let truth: Pose<Camera, Camera> = truth_of(scene, sample).inverse() * *reference;
    let rotation = found.rotation.angle_to(&truth.rotation).to_degrees();
    (rotation, found.translation_direction.angle(&truth.translation).to_degrees())
}

/// Returns the reference camera of C3: as far in front of the first surface as that is wide.
fn reference() -> Pose<Stage, Camera> {
    look_at(Point3::new(0.0, -4.0, 0.0), Point3::origin(), 0.0)
}

fn assert_two_views(scene: &VirtualStage, model: TwoViewModel) {
    let mut worst = (0.0_f64, 0.0_f64, 0.0_f64);
    for sample in track(scene, 8).iter().skip(1) {
        let m = sample.measurement.expect("it tracks");
        assert_eq!(m.model, Some(model), "frame {}", sample.sequence);
        let h = m.homography.expect("correspondences enough");
        let essential = m.essential.expect("a baseline");
        let (rotation, direction) = motion_errors(scene, sample, &reference(), &essential);
        worst = (worst.0.max(worst_transfer(scene, sample, &h, |p| p)), worst.1.max(rotation), worst.2.max(direction));
        assert!(Some(essential.inliers) <= m.inliers && essential.inliers > 30);
    }
    println!("worst: homography {:.3} px, essential {:.3} and {:.3} degrees", worst.0, worst.1, worst.2);
    assert!(worst.0 < 0.5 && worst.1 < 0.5 && worst.2 < 0.5, "{worst:?}");
}

#[test]
fn a_flat_stage_is_a_homography() {
    assert_two_views(&quiet(camera(640, 480), past(), backdrop()), TwoViewModel::Homography);
}

#[test]
fn a_stage_with_depth_is_an_essential_matrix() {
    let flats = vec![
        surface("backdrop", backdrop_art(), [4.0, 3.0], Vector3::zeros(), 0.0),
        surface("left", other_art(), [1.2, 0.9], Vector3::new(-0.9, -0.7, -0.3), 0.3),
        surface("right", &imageops::flip_vertical(other_art()), [1.2, 0.9], Vector3::new(0.8, -1.0, 0.1), -0.4),
    ];
    assert_two_views(&quiet(camera(640, 480), past(), body(flats)), TwoViewModel::Essential);
}

#[test]
fn at_the_reference_position_there_is_no_direction() {
    // 2 cm of 4 m are half a percent.
    for (x, is_null) in [(0.02, true), (0.25, false)] {
        let path = CameraPath::fixed(Point3::new(x, -4.0, 0.0), Point3::new(0.3, 0.0, 0.1));
        let scene = quiet(camera(640, 360), path, backdrop());
        for sample in track(&scene, 3).iter().skip(1) {
            let m = sample.measurement.expect("it tracks");
            assert_eq!(m.essential.is_none(), is_null, "at {x} m");
        }
    }
}
