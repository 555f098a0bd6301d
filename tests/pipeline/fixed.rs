//! A camera that stands still at a configured pose: objects are tracked with no surface of the
//! stage in view, and a camera that was bumped is withheld.

use nalgebra::{Matrix6, Vector3, Vector6};
use serde_json::Value;
use stagepose::diagnostics::simulate::{grey, paint};
use stagepose::{
    BodySpec, CameraPath, FixedCamera, MovingObject, ObjectPath, Pose, PoseSample, Spline, State, Tracker, TrackerSetup, VirtualStage,
    track_entry,
};

use super::scene::{aside, backdrop, body, camera, other_art, quiet, rows, setup, surface};

/// One sigma of the configured pose, metres and radians.
const SIGMA: [f64; 2] = [0.002, 0.001];

/// A cart that rolls past a camera that stands still, before a backdrop.
fn with_cart(backdrop: BodySpec, path: CameraPath) -> VirtualStage {
    let mut scene = quiet(camera(640, 480), path, backdrop);
    let art = grey(&paint(400, 400, 77));
    let cart = surface("cart", &art, [0.9, 0.9], Vector3::new(0.0, -0.1, 0.45), 0.0);
    let keys = [(0.0, Vector3::new(-0.5, -1.0, -0.5)), (1.0, Vector3::new(0.1, -1.1, -0.4))];
    let path = ObjectPath { position: Spline::new(&keys).unwrap(), rotation_rad: -0.3, angular_velocity_rad_s: 0.2 };
    scene.objects.push(MovingObject { body: BodySpec::new("cart", vec![cart]), path });
    scene
}

/// The configured pose: that of the scene's start, off by a sigma in each axis.
fn fixed(scene: &VirtualStage) -> FixedCamera {
    let truth = scene.truth(0.0);
    let rotation = nalgebra::UnitQuaternion::from_scaled_axis(Vector3::new(1.0, -1.0, 1.0) * SIGMA[1]) * truth.rotation;
    let position = truth.translation + Vector3::new(1.0, 1.0, -1.0) * SIGMA[0];
    let variance = |k: usize| SIGMA[k / 3] * SIGMA[k / 3];
    FixedCamera {
        pose: Pose::new(rotation, position),
        covariance: Matrix6::from_fn(|row, column| if row == column { variance(row) } else { 0.0 }),
    }
}

fn standing(scene: &VirtualStage, fixed: FixedCamera) -> TrackerSetup {
    let mut setup = setup(scene);
    setup.fixed = Some(fixed);
    setup
}

fn tracked(setup: TrackerSetup, scene: &VirtualStage, frames: u64) -> Vec<PoseSample> {
    let mut tracker = Tracker::new(setup).expect("a setup that fits");
    rows(scene, frames).iter().map(|row| track_entry(&mut tracker, row)).collect()
}

/// Squared error of an object's pose in sigmas over its six degrees of freedom.
fn nees_of_cart(scene: &VirtualStage, sample: &PoseSample) -> f64 {
    let (truth, object) = (scene.object_truth(0, sample.timestamp.seconds()).unwrap(), &sample.objects[0]);
    let pose = object.pose.unwrap();
    let (shift, rotation) = (truth.translation - pose.translation, (truth.rotation * pose.rotation.inverse()).scaled_axis());
    let e = Vector6::new(shift.x, shift.y, shift.z, rotation.x, rotation.y, rotation.z);
    e.dot(&(object.covariance.unwrap().try_inverse().expect("positive definite") * e)) / 6.0
}

#[test]
fn an_object_is_posed_with_no_stage_in_view() {
    // What is behind the cart is unknown to the tracker.
    let scene = with_cart(body(vec![surface("curtain", other_art(), [4.0, 3.0], Vector3::zeros(), 0.0)]), aside());
    let fixed = fixed(&scene);
    let mut told = standing(&scene, fixed);
    told.stage = body(Vec::new());
    let samples = tracked(told, &scene, 12);
    let seen: Vec<&PoseSample> = samples.iter().filter(|sample| sample.objects[0].state == State::Tracking).collect();
    assert!(seen.len() >= 10, "{} of 12", seen.len());
    let worst = seen.iter().map(|sample| nees_of_cart(&scene, sample)).fold(0.0, f64::max);
    println!("{} of 12, NEES / 6 at most {worst:.2}", seen.len());
    // The error is one draw of the configured doubt, the same in every frame: each axis is off by a
    // sigma.
    assert!(worst < 2.0, "{worst}");
    for sample in &samples {
        let line: Value = serde_json::from_str(&sample.to_json_line()).unwrap();
        assert_eq!((sample.state, sample.pose, &line["measured"]), (State::Tracking, Some(fixed.pose), &line["pose"]));
        assert_eq!(line["covariance"][0].as_f64(), Some(SIGMA[0] * SIGMA[0]));
        for key in ["model", "homography", "essential", "inliers", "rms_px"] {
            assert!(line[key].is_null(), "{key}: {line}");
        }
        assert_eq!(serde_json::from_str::<Value>(&sample.to_parts_line()).unwrap()["noise"][0].as_f64(), Some(0.0));
    }
}

#[test]
fn a_stage_in_view_only_checks_that_the_camera_stands() {
    let scene = with_cart(backdrop(), aside());
    let fixed = fixed(&scene);
    let samples = tracked(standing(&scene, fixed), &scene, 12);
    assert!(samples.iter().all(|sample| sample.state == State::Tracking && sample.pose == Some(fixed.pose)), "off by a sigma is not moved");
    // Bumped by 5 cm: the stage says so, and nothing is given any more.
    let bumped = FixedCamera { pose: Pose::new(fixed.pose.rotation, fixed.pose.translation + Vector3::new(0.05, 0.0, 0.0)), ..fixed };
    let samples = tracked(standing(&scene, bumped), &scene, 12);
    let last = samples.last().unwrap();
    assert_eq!((last.state, last.pose, last.reason.map(|reason| reason.word())), (State::Lost, None, Some("camera_moved")));
    assert_ne!(last.objects[0].state, State::Tracking);
}
