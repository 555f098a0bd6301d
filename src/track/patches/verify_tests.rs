use image::{GrayImage, Luma};
use nalgebra::{Vector3, Vector6};

use super::*;
use crate::features::halved;
use crate::geometry::resection::perturbed;
use crate::track::synthetic::{cloth, facing, lens, prepared, texture, view};

fn truth() -> Pose<Camera, Body> {
    facing(0.2, -0.3, Vector3::new(0.1, 0.05, 3.4))
}

fn verified(frame: &GrayImage, start: &Pose<Camera, Body>) -> Result<(Verified, Vec<FittedAnchor>), Refusal> {
    let body = prepared(vec![cloth(1)]);
    let half = halved(frame);
    let (camera, workers) = (lens(480, 360), Workers::new(1));
    let full = FullView {
        camera: &camera,
        picture: SearchPicture { image: frame, scale: 1.0, mask: None },
        row_motion: RowMotion { shutter: Default::default(), readout_sigma_s: 0.0, before: None },
        workers: &workers,
    };
    let view = View { full, half: SearchPicture { image: &half, scale: 2.0, mask: None } };
    let mut buffers = VerifyBuffers::default();
    verify(&body, start, &view, false, &mut buffers).map(|found| (found, buffers.anchors))
}

fn frame() -> GrayImage {
    view(&cloth(1), &truth(), &lens(480, 360))
}

#[test]
fn a_pose_that_is_nearly_right_becomes_right() {
    let start = perturbed(&truth(), &Vector6::new(0.02, -0.015, 0.03, 0.006, -0.005, 0.003));
    let (found, anchors) = verified(&frame(), &start).expect("the picture agrees");
    let (shift, rotation) =
        ((found.pose.translation - truth().inverse().translation).norm(), found.pose.angle_to(&truth().inverse()).to_degrees());
    println!("{shift:.5} m, {rotation:.4} degrees, {} anchors, share {:.2}, {:.3} px", anchors.len(), found.share, found.solver_rms_px);
    assert!(shift < 0.003 && rotation < 0.03, "{shift} {rotation}");
    assert!(found.share > 0.8 && anchors.len() > 100 && found.solver_rms_px < 0.2);
    assert_eq!(found.covariance, found.covariance.transpose());
    assert!(found.covariance.cholesky().is_some());
    // Without a rolling shutter every anchor is where it was seen, up to its residual.
    let residual = |a: &FittedAnchor| (a.corrected_px - a.observation.pixel).norm();
    assert!(anchors.iter().all(|a| residual(a) < 1e-9));
}

#[test]
fn a_pose_that_is_far_off_is_refused() {
    for step in [
        Vector6::new(0.5, 0.0, 0.0, 0.0, 0.0, 0.0),
        Vector6::new(0.0, 0.0, 1.0, 0.0, 0.0, 0.0),
        Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.3),
        Vector6::new(0.0, 0.0, 0.0, 0.15, 0.1, 0.0),
    ] {
        let refused = verified(&frame(), &perturbed(&truth(), &step));
        assert!(refused.is_err(), "{step}");
    }
}

#[test]
fn a_frame_without_the_stage_verifies_nothing() {
    for frame in [texture(480, 360, 5), GrayImage::from_pixel(480, 360, Luma([100]))] {
        assert!(verified(&frame, &truth()).is_err());
    }
}

#[test]
fn a_corner_of_the_picture_is_not_enough() {
    // Only a ninth of the frame shows the stage.
    let mut covered = frame();
    for (x, y, grey) in covered.enumerate_pixels_mut() {
        if x > 160 || y > 120 {
            *grey = Luma([60]);
        }
    }
    assert!(matches!(verified(&covered, &truth()), Err(Refusal::TooFew(_) | Refusal::Clustered(_) | Refusal::Share(_))));
}
