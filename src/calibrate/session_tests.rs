//! Complete calibrations: of rendered pictures with exact truth, and of published pictures with
//! known results.

use std::path::Path;

use nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};

use super::*;
use crate::calibrate::judge::Verdict;
use crate::calibrate::picture::inspect;
use crate::calibrate::rendered::{BoardPhotographer, Photograph};
use crate::calibrate::solve::adjust::BoardFrame;
use crate::camera::{CameraModel, Intrinsics};
use crate::capture::decode_grey;
use crate::geometry::{Camera, Pose};

fn camera() -> BoardPhotographer {
    let distortion = [-0.3, 0.11, 0.0008, -0.0006, 0.0];
    let intrinsics = Intrinsics { width: 640, height: 480, fx: 520.0, fy: 522.0, cx: 326.0, cy: 236.0, skew: 0.0, distortion };
    BoardPhotographer::new(CameraModel::new(intrinsics).unwrap())
}

/// Rendered views, tilted by `tilt` rad to all sides, in all parts of the picture.
fn rendered(camera: &BoardPhotographer, board: &Board, count: usize, tilt: f64) -> Vec<Inspected> {
    (0..count)
        .map(|k| {
            let azimuth = 1.57 * k as f64 + 0.4;
            let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(azimuth.cos(), azimuth.sin(), 0.0) * tilt);
            let middle = board.corner(board.corner_count() - 1).push(0.0) * 0.5;
            let offset = Vector3::new(0.09 * ((k % 3) as f64 - 1.0), 0.06 * ((k / 3 % 3) as f64 - 1.0), 0.38 + 0.03 * (k % 2) as f64);
            let pose: Pose<Camera, BoardFrame> = Pose::new(rotation, offset - rotation * middle);
            let how = Photograph { blur_px: 0.7, noise: 2.0, seed: k as u64, ..Photograph::default() };
            inspect(PathBuf::from(format!("view{k}.png")), &camera.photograph(board, &pose, &how), board)
        })
        .collect()
}

#[test]
fn rendered_pictures_give_the_camera_they_were_taken_with() {
    let (camera, board) = (camera(), Board::new(9, 6, 0.024).unwrap());
    let pictures = rendered(&camera, &board, 12, 0.55);
    let made = calibrate(&pictures, &board, &CalibrationOptions::default()).unwrap();
    assert_eq!(made.views.iter().filter(|v| v.used).count(), 12);
    let truth = super::super::solve::lens::Lens::of_model(&camera.model);
    let (found, three_sigma) = (made.estimate.bundle.lens.0, made.estimate.lens_uncertainty());
    for k in (0..9).filter(|&k| k != 4) {
        // Four sigma: eight parameters at once, with one fixed noise realisation.
        assert!((found[k] - truth.0[k]).abs() < 1.34 * three_sigma[k], "number {k}: {} is not {}", found[k], truth.0[k]);
    }
    assert!(made.estimate.rms_px < 0.04, "{}", made.estimate.rms_px);
    assert_eq!(made.judgement.verdict, Verdict::Good, "{}", made.judgement.sentence());
    assert!(made.rounds.1 < STILL_PX);
}

#[test]
fn corners_refined_with_the_lens_are_more_accurate() {
    let distortion = [-0.42, 0.2, 0.0, 0.0, 0.0];
    let intrinsics = Intrinsics { width: 640, height: 480, fx: 380.0, fy: 380.0, cx: 319.5, cy: 239.5, skew: 0.0, distortion };
    let (camera, board) = (BoardPhotographer::new(CameraModel::new(intrinsics).unwrap()), Board::new(7, 5, 0.04).unwrap());
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, 0.5, 0.0));
    let pose: Pose<Camera, BoardFrame> = Pose::new(rotation, Vector3::new(0.02, 0.01, 0.24) - rotation * Vector3::new(0.12, 0.08, 0.0));
    let picture = camera.photograph(&board, &pose, &Photograph { blur_px: 2.0, noise: 0.5, falloff: 0.0, ..Photograph::default() });
    let seen = inspect("wide.png".into(), &picture, &board);
    let (found, truth) = (seen.board.unwrap(), camera.corners(&board, &pose));
    let geometry = BoardView::new(&camera.model, &pose, &board, &found).unwrap();
    let (mut before, mut after) = (0.0, 0.0);
    let mut window = Window::default();
    for (k, (corner, truth)) in found.corners.iter().flatten().zip(&truth).enumerate() {
        let again = geometry.corner(seen.patch.as_ref().unwrap(), k, *corner, &mut window).unwrap();
        before += (corner - truth).norm_squared();
        after += (again - truth).norm_squared();
    }
    assert!(after < 0.8 * before, "{before} {after}");
}

#[test]
fn a_view_that_does_not_fit_is_rejected_with_the_reason() {
    let (camera, board) = (camera(), Board::new(9, 6, 0.024).unwrap());
    let mut pictures = rendered(&camera, &board, 9, 0.5);
    if let Ok(found) = &mut pictures[4].board {
        // As if the board had been bent.
        found.corners.iter_mut().enumerate().for_each(|(k, c)| {
            if let Some(c) = c {
                c.y += 3.0 * ((k % 9) as f64 / 4.0 - 1.0).powi(2);
            }
        });
    }
    pictures[4].patch = None;
    let twin = pictures[2].clone();
    pictures.push(Inspected { file: "twin.png".into(), ..twin });
    let made = calibrate(&pictures, &board, &CalibrationOptions::default()).unwrap();
    assert!(!made.views[4].used && made.views[4].reason.as_deref().unwrap().contains("fit"), "{:?}", made.views[4].reason);
    assert_eq!(made.views[9].reason.as_deref(), Some("the same view as view2.png"));
    assert_eq!(made.views.iter().filter(|v| v.used).count(), 8);
}

#[test]
fn front_on_views_get_the_do_not_use_verdict() {
    let (camera, board) = (camera(), Board::new(9, 6, 0.024).unwrap());
    let pictures = rendered(&camera, &board, 9, 0.04);
    let made = calibrate(&pictures, &board, &CalibrationOptions::default()).unwrap();
    assert_eq!(made.judgement.verdict, Verdict::DoNotUse);
    assert!(made.judgement.sentence().contains("one direction"), "{}", made.judgement.sentence());
    assert!(made.judgement.next_picture.contains("side"), "{}", made.judgement.next_picture);
}

/// Views of a board close to a very wide lens, `nearer` of them closer than the others; `bent`
/// returns how far from the middle a ray appears, pixels, by its angle from the axis.
fn seen_wide(board: &Board, nearer: usize, bent: impl Fn(f64) -> f64) -> Vec<Inspected> {
    let view = |k: usize| {
        let azimuth = 2.4 * k as f64;
        let tilt = Vector3::new(azimuth.cos(), azimuth.sin(), 0.0) * (0.2 + 0.03 * (k % 8) as f64);
        let rotation = UnitQuaternion::from_scaled_axis(tilt);
        let away = if k < nearer { 0.07 } else { 0.13 } + 0.02 * (k % 4) as f64;
        let offset = Vector3::new(0.10 * ((k % 3) as f64 - 1.0), 0.06 * ((k / 3 % 3) as f64 - 1.0), away);
        let middle = board.corner(board.corner_count() - 1).push(0.0) * 0.5;
        let corner = |index: usize| {
            let at = rotation * (board.corner(index).push(0.0) - middle) + offset;
            let (across, noise) = (at.xy().norm(), 0.05 * (1.7 * index as f64 + 0.9 * k as f64).sin());
            let away = at.xy() * (bent(across.atan2(at.z)) / across.max(1e-9));
            Some(away + Vector2::new(319.5 + noise, 199.5 - noise)).filter(|p| (0.0..639.0).contains(&p.x) && (0.0..399.0).contains(&p.y))
        };
        let corners = (0..board.corner_count()).map(corner).collect();
        let light = Vec::new();
        let found = FoundBoard { corners, blur_px: 0.7, contrast: 140.0, light, margin: 1.0, dark_origin: true, square_px: 30.0 };
        Inspected {
            size: Some((640, 400)),
            board: Ok(found),
            ..Inspected::unreadable(PathBuf::from(format!("view{k}.png")), String::new())
        }
    };
    (0..16).map(view).collect()
}

#[test]
fn a_fisheye_is_named_and_gets_the_do_not_use_verdict() {
    let board = Board::new(9, 6, 0.024).unwrap();
    let with_k3 = || {
        let mut options = CalibrationOptions::default();
        options.solve.free.free[9] = true;
        options
    };
    for options in [CalibrationOptions::default(), with_k3()] {
        for nearer in [0, 4, 6] {
            let made = calibrate(&seen_wide(&board, nearer, |angle| 152.0 * angle), &board, &options).unwrap();
            assert_eq!(made.judgement.verdict, Verdict::DoNotUse);
            let sentence = made.judgement.sentence();
            assert!(sentence.contains("this is a fisheye or a very wide lens"), "{nearer}: {sentence}");
            assert!(made.judgement.next_picture.contains("do not help"), "{}", made.judgement.next_picture);
        }
        // As wide, but within the model.
        let straight = |angle: f64| 200.0 * angle.tan() * (1.0 - 0.02 * angle.tan().powi(2));
        let made = calibrate(&seen_wide(&board, 0, straight), &board, &options).unwrap();
        assert!(!made.judgement.reasons().join(";").contains("fisheye"), "{:?}", made.judgement.reasons());
    }
}

#[test]
fn pictures_of_two_sizes_are_refused_by_name() {
    let (camera, board) = (camera(), Board::new(9, 6, 0.024).unwrap());
    let mut pictures = rendered(&camera, &board, 3, 0.4);
    pictures[2].size = Some((1280, 960));
    let error = calibrate(&pictures, &board, &CalibrationOptions::default()).unwrap_err().to_string();
    assert!(error.contains("view0.png is 640 x 480 pixels and view2.png is 1280 x 960"), "{error}");
}

/// The calibration of a set in ../shared/data; `None` if it is absent.
fn shared(folder: &str, prefix: &str, board: &Board) -> Option<CameraCalibration> {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data")).join(folder);
    let Ok(entries) = std::fs::read_dir(&folder) else {
        println!("skipped: {} is absent", folder.display());
        return None;
    };
    let mut files: Vec<PathBuf> = entries.map(|e| e.unwrap().path()).collect();
    files.retain(|f| {
        let name = f.file_name().unwrap().to_string_lossy().into_owned();
        name.starts_with(prefix) && name.ends_with(".jpg")
    });
    files.sort();
    let look = |file: PathBuf| {
        let picture = decode_grey(&std::fs::read(&file).unwrap()).unwrap();
        inspect(file, &picture, board)
    };
    let pictures: Vec<Inspected> = files.into_iter().map(look).collect();
    Some(calibrate(&pictures, board, &CalibrationOptions::default()).unwrap())
}

fn used(made: &CameraCalibration) -> usize {
    made.views.iter().filter(|v| v.used).count()
}

#[test]
fn opencv_sample_pictures_calibrate_correctly() {
    let board = Board::new(9, 6, 0.025).unwrap();
    let Some(left) = shared("calib-opencv-leftright", "left", &board) else { return };
    assert_eq!(used(&left), 13);
    assert!(left.estimate.rms_px <= 0.186, "{}", left.estimate.rms_px);
    assert!((left.estimate.bundle.lens.0[0] - 533.4).abs() < 0.6, "{}", left.estimate.bundle.lens.0[0]);
    assert!(left.judgement.halves.as_ref().unwrap().agree(), "{:?}", left.judgement.halves);
    assert_ne!(left.judgement.verdict, Verdict::DoNotUse);
    let Some(right) = shared("calib-opencv-leftright", "right", &board) else { return };
    assert_eq!(used(&right), 13);
    assert!(right.judgement.halves.as_ref().unwrap().agree(), "{:?}", right.judgement.halves);
}

#[test]
fn sony_pictures_calibrate_correctly() {
    let Some(made) = shared("calib-boofcv-sony", "frame", &Board::new(6, 4, 0.03).unwrap()) else { return };
    assert_eq!(used(&made), 13);
    assert!(made.estimate.rms_px <= 0.152, "{}", made.estimate.rms_px);
}

type RightFromLeft = Pose<Camera, Camera>;

/// T_right_left = T_right_board T_board_left of one view, with the covariance of its [δθ, δt].
fn between(left: &CameraCalibration, l: usize, right: &CameraCalibration, r: usize) -> (RightFromLeft, Matrix6<f64>) {
    let (from_left, from_right) = (&left.estimate.bundle.poses[l], &right.estimate.bundle.poses[r]);
    let pose = *from_right * from_left.inverse();
    let rotation = pose.rotation_matrix();
    let lever = (rotation * from_left.translation).cross_matrix();
    let mut by_right = Matrix6::identity();
    by_right.fixed_view_mut::<3, 3>(3, 0).copy_from(&lever);
    let mut by_left = Matrix6::zeros();
    by_left.fixed_view_mut::<3, 3>(0, 0).copy_from(&-rotation);
    by_left.fixed_view_mut::<3, 3>(3, 0).copy_from(&(-lever * rotation));
    by_left.fixed_view_mut::<3, 3>(3, 3).copy_from(&-rotation);
    let covariance = by_right * right.estimate.pose_covariances[r] * by_right.transpose()
        + by_left * left.estimate.pose_covariances[l] * by_left.transpose();
    (pose, covariance)
}

/// Fuses the poses, weighted by their covariances.
fn fused(each: &[(RightFromLeft, Matrix6<f64>)]) -> RightFromLeft {
    let mut mean = each[0].0;
    for _ in 0..5 {
        let (mut information, mut sum) = (Matrix6::zeros(), Vector6::zeros());
        for (pose, covariance) in each {
            let mut off = Vector6::zeros();
            off.fixed_rows_mut::<3>(0).copy_from(&(pose.rotation * mean.rotation.inverse()).scaled_axis());
            off.fixed_rows_mut::<3>(3).copy_from(&(pose.translation - mean.translation));
            let weight = covariance.try_inverse().unwrap();
            information += weight;
            sum += weight * off;
        }
        let step = information.try_inverse().unwrap() * sum;
        let rotation = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
        mean = Pose::new(rotation * mean.rotation, mean.translation + step.fixed_rows::<3>(3));
    }
    mean
}

/// Both cameras of a stereo head see the same boards; the pose between them is the baseline.
#[test]
fn the_baseline_of_a_stereo_head() {
    let board = Board::new(6, 4, 0.03).unwrap();
    let (Some(left), Some(right)) = (shared("calib-boofcv-bumblebee2", "left", &board), shared("calib-boofcv-bumblebee2", "right", &board))
    else {
        return;
    };
    assert_eq!((used(&left), used(&right)), (11, 11));
    let each: Vec<_> =
        left.views.iter().zip(&right.views).map(|(l, r)| between(&left, l.index.unwrap(), &right, r.index.unwrap())).collect();
    let each_mm: Vec<f64> = each.iter().map(|(pose, _)| pose.translation.norm() * 1e3).collect();
    let baseline = fused(&each).translation.norm() * 1e3;
    println!("baseline {baseline:.3} mm, views {each_mm:.2?}");
    assert!((baseline - 120.0).abs() <= 0.6, "{baseline:.3} mm of {each_mm:.2?}");
}

#[test]
fn degenerate_pictures_get_the_do_not_use_verdict() {
    let Some(made) = shared("calib-photonvision-picam640-degenerate", "img", &Board::new(7, 7, 0.02).unwrap()) else { return };
    assert_eq!(made.judgement.verdict, Verdict::DoNotUse);
    assert!(made.judgement.sentence().contains("front-on"), "{}", made.judgement.sentence());
}
