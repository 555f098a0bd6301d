//! The aligner on rendered frames: accuracy, occlusion, blur, wrong pictures, still cameras, and
//! what it learns.

#[cfg(feature = "cli")]
use std::sync::Arc;

use crate::track::align::tuning::TUNING;
use image::GrayImage;
use nalgebra::{Vector3, Vector6};

use super::super::CameraRays;
use super::*;
#[cfg(feature = "cli")]
use crate::geometry::bspline::BicubicSpline;
use crate::geometry::resection::perturbed;
use crate::motion::{Motion, MotionEstimate, ProcessNoise};
use crate::track::align::Start;
use crate::track::frame::frame_levels::FrameLevels;
use crate::track::scene::shape::tests::folds;
#[cfg(feature = "cli")]
use crate::track::scene::shape::{BentShape, SurfaceShape};
use crate::track::scene::surface::SurfaceSpec;
use crate::track::synthetic::{cloth, facing, grey_of, lens, light_of, prepared, texture, view, view_along};

fn truth() -> Pose<Camera, Body> {
    facing(0.2, -0.3, Vector3::new(0.1, 0.05, 3.4))
}

fn levels(seed: u32) -> FrameLevels {
    let mut levels = FrameLevels::default();
    levels.update(&view(&cloth(seed), &truth(), &lens(480, 360)));
    levels
}

fn aligned(frame: &mut FrameLevels, start: &Pose<Camera, Body>) -> Option<Alignment> {
    let mut aligner = Aligner::new(&prepared(vec![cloth(1)]), Shutter { readout_s: 0.0, exposure_s: 0.0 });
    let expected = MotionEstimate::unseen(start.inverse(), 3.4, 0.02, 0.006);
    aligner
        .align(frame, &CameraRays::new(lens(480, 360), None), &AlignRequest::new(Start::found(&expected), false))
        .map(|solution| solution.alignment)
}

/// Aligns a frame and accepts its pose.
fn accepted(aligner: &mut Aligner, frame: &mut FrameLevels, rays: &CameraRays, expected: &MotionEstimate) -> Alignment {
    let solution = aligner.align(frame, rays, &AlignRequest::new(Start::found(expected), false)).expect("the picture agrees");
    let found = solution.alignment;
    solution.accept(&mut Vec::new());
    found
}

#[test]
fn a_start_nearby_becomes_right_to_a_hundredth_of_a_pixel() {
    let start = perturbed(&truth(), &Vector6::new(0.02, -0.015, 0.03, 0.006, -0.005, 0.003));
    let found = aligned(&mut levels(1), &start).expect("the picture agrees");
    let pose = found.estimate.motion.pose.inverse();
    let (shift, rotation) = ((pose.translation - truth().translation).norm(), pose.angle_to(&truth()));
    println!(
        "{shift:.6} m, {rotation:.7} rad, share {:.2} of {} tiles, scale {:.2}",
        found.inlier_ratio(),
        found.tiles,
        found.residual_sigma
    );
    assert!(shift < 5e-4 && rotation < 1e-4, "{shift} {rotation}");
    assert!(found.inlier_ratio() > 0.9 && found.is_credible(false));
    assert!(found.covariance.cholesky().is_some() && found.estimate.covariance.cholesky().is_some());
}

#[test]
fn a_bent_cloth_is_aligned_as_well_as_a_flat_one() {
    let bent = SurfaceSpec { shape: folds(), ..cloth(1) };
    let mut frame = FrameLevels::default();
    frame.update(&view(&bent, &truth(), &lens(480, 360)));
    let rays = CameraRays::new(lens(480, 360), None);
    let start = perturbed(&truth(), &Vector6::new(0.02, -0.015, 0.03, 0.006, -0.005, 0.003));
    let expected = MotionEstimate::unseen(start.inverse(), 3.4, 0.02, 0.006);
    let shifts_m = [bent, cloth(1)].map(|surface| {
        let mut aligner = Aligner::new(&prepared(vec![surface]), Shutter { readout_s: 0.0, exposure_s: 0.0 });
        let found = aligner
            .align(&mut frame, &rays, &AlignRequest::new(Start::found(&expected), false))
            .expect("the picture agrees")
            .alignment
            .pose
            .inverse();
        (found.translation - truth().translation).norm()
    });
    println!("{shifts_m:?}");
    assert!(shifts_m[0] < 5e-4 && shifts_m[1] > 10.0 * shifts_m[0], "{shifts_m:?}");
}

/// Up to two thirds of the stage are behind something with as much detail. The visible part is
/// enough for a pose, and the rest must not pull it.
#[test]
fn an_occluder_over_most_of_the_stage_does_not_bias_the_pose() {
    let (stage, other) = (view(&cloth(1), &truth(), &lens(480, 360)), view(&cloth(2), &truth(), &lens(480, 360)));
    let start = perturbed(&truth(), &Vector6::new(0.01, -0.008, 0.015, 0.003, -0.0025, 0.0015));
    // First one half is occluded, then so much that the better half of the tiles would include some
    // of the occluder; each for a followed body, and for one that was reported before and has just
    // been found again.
    let cases = [(240, Some(1.0 / 30.0)), (165, Some(1.0 / 30.0)), (240, None), (165, None)];
    let shifts_m = cases.map(|(open_columns, since_s)| {
        let covered = GrayImage::from_fn(480, 360, |x, y| *if x < open_columns { &stage } else { &other }.get_pixel(x, y));
        let mut frame = FrameLevels::default();
        frame.update(&covered);
        let mut aligner = Aligner::new(&prepared(vec![cloth(1)]), Shutter { readout_s: 0.0, exposure_s: 1e-6 });
        let expected = MotionEstimate::unseen(start.inverse(), 3.4, 0.02, 0.006);
        let rays = CameraRays::new(lens(480, 360), None);
        let request = AlignRequest::new(Start { since_s, ..Start::found(&expected) }, true);
        let solution = aligner.align(&mut frame, &rays, &request);
        let found = solution.expect("the picture agrees in a third").alignment;
        assert!(found.inlier_ratio() < 0.6, "{}", found.inlier_ratio());
        let error = found.pose.inverse().translation - truth().translation;
        let sigma = found.covariance.fixed_view::<3, 3>(0, 0).trace().sqrt();
        println!("{open_columns} columns: {:.5} m of {sigma:.5}, {} of {} tiles", error.norm(), found.agreeing, found.tiles);
        error.norm()
    });
    assert!(shifts_m.iter().all(|shift| *shift < 2e-3), "{shifts_m:?}");
}

/// Renders a surface, visible in the first `open_columns`, as seen by a camera that moves sideways
/// by `blur_px` pixels during the exposure. Another cloth occludes the other columns. It averages
/// more instants than `moving_view` does: under the longest blur they lie a pixel apart.
fn smeared(surface: &SurfaceSpec, truth: &Pose<Camera, Body>, blur_px: f64, open_columns: u32) -> FrameLevels {
    let way_m = blur_px * 3.4 / 480.0;
    let along = |k: i32| perturbed(truth, &Vector6::new(way_m * (f64::from(k) / 20.0 - 0.475), 0.0, 0.0, 0.0, 0.0, 0.0));
    let views: Vec<GrayImage> = (0..20).map(|k| view(surface, &along(k), &lens(480, 360))).collect();
    let mean = |x: u32, y: u32| views.iter().map(|v| light_of(f64::from(v.get_pixel(x, y)[0]))).sum::<f64>() / 20.0;
    let other = view(&cloth(2), truth, &lens(480, 360));
    let seen = |x, y| if x < open_columns { image::Luma([grey_of(mean(x, y))]) } else { *other.get_pixel(x, y) };
    let mut levels = FrameLevels::default();
    levels.update(&GrayImage::from_fn(480, 360, seen));
    levels
}

/// A body that is large in the frame has its blur estimated where it does not fit. The first has
/// fine detail, which a blur of 9 pixels removes; it is seen whole, and occluded by a third. The
/// last has a blur of 12 pixels, with which more than half of its tiles do not fit. Whether it was
/// reported before makes no difference.
#[test]
fn a_body_is_found_though_it_is_blurred() {
    let stage = SurfaceSpec::from_artwork("fine".into(), texture(1440, 1080, 1), [4.0, 3.0], Pose::identity()).expect("texture enough");
    let start = perturbed(&truth(), &Vector6::new(0.01, -0.008, 0.015, 0.003, -0.0025, 0.0015));
    let expected = MotionEstimate::unseen(start.inverse(), 3.4, 0.02, 0.006);
    let rays = CameraRays::new(lens(480, 360), None);
    for (blur_px, open_columns) in [(9.0, 480), (9.0, 320), (12.0, 480)] {
        let mut frame = smeared(&stage, &truth(), blur_px, open_columns);
        for was_reported in [false, true] {
            let mut aligner = Aligner::new(&prepared(vec![stage.clone()]), Shutter { readout_s: 0.0, exposure_s: 0.006 });
            let request = AlignRequest::new(Start::found(&expected), was_reported);
            let found = aligner.align(&mut frame, &rays, &request).expect("the picture agrees").alignment;
            let off_m = (found.pose.inverse().translation - truth().translation).norm();
            let what = format!("{blur_px} px, {open_columns} columns, given before: {was_reported}");
            println!("{what}: scale {:.2}, {} of {} tiles, {off_m:.6} m", found.residual_sigma, found.agreeing, found.tiles);
            assert!(found.residual_sigma < 2.0 && 480 * found.agreeing > 90 * found.tiles * open_columns as usize / 100, "{what}");
            assert!(off_m < 2e-4, "{what}: {off_m} m");
        }
    }
}

/// A small body that is occluded by more than half has its blur (3 pixels) estimated once it is
/// known which tiles fit. `open_columns` leave 0.4 to 0.5 of its tiles.
#[test]
fn the_visible_part_of_an_occluded_body_reveals_its_blur() {
    let truth = facing(0.03, -0.05, Vector3::new(0.1, 0.05, 3.4));
    let small = SurfaceSpec::from_artwork("small".into(), texture(600, 450, 1), [1.3, 1.0], Pose::identity()).expect("texture enough");
    let start = perturbed(&truth, &Vector6::new(0.004, -0.003, 0.006, 0.001, -0.001, 0.0005));
    let expected = MotionEstimate::unseen(start.inverse(), 3.4, 0.02, 0.006);
    let rays = CameraRays::new(lens(480, 360), None);
    for open_columns in [241, 244, 247] {
        let mut frame = smeared(&small, &truth, 3.0, open_columns);
        let mut aligner = Aligner::new(&prepared(vec![small.clone()]), Shutter { readout_s: 0.0, exposure_s: 0.006 });
        let request = AlignRequest::new(Start::found(&expected), true);
        let found = aligner.align(&mut frame, &rays, &request).expect("the picture agrees").alignment;
        println!("{open_columns} columns: scale {:.2}, {} of {} tiles", found.residual_sigma, found.agreeing, found.tiles);
        assert!(
            2 * found.agreeing < found.tiles && found.has_opposite && found.residual_sigma < 1.2,
            "{open_columns} columns: {}",
            found.residual_sigma
        );
    }
}

#[test]
fn another_picture_is_not_a_credible_alignment() {
    for mut frame in [levels(2), {
        let mut dark = FrameLevels::default();
        dark.update(&image::GrayImage::from_pixel(480, 360, image::Luma([6])));
        dark
    }] {
        let found = aligned(&mut frame, &truth());
        assert!(found.is_none_or(|f| !f.is_credible(true) && !f.is_conclusive()));
    }
}

#[test]
fn a_start_far_off_is_not_credible() {
    for step in [Vector6::new(0.5, 0.0, 0.0, 0.0, 0.0, 0.0), Vector6::new(0.0, 0.0, 0.0, 0.15, 0.1, 0.0)] {
        let found = aligned(&mut levels(1), &perturbed(&truth(), &step));
        let is_right = |f: &Alignment| (f.estimate.motion.pose.inverse().translation - truth().translation).norm() < 0.005;
        assert!(found.is_none_or(|f| is_right(&f) || !f.is_credible(false)), "{step}");
    }
}

#[test]
fn patches_lie_where_the_pose_puts_them() {
    let mut aligner = Aligner::new(&prepared(vec![cloth(1)]), Shutter { readout_s: 0.0, exposure_s: 0.0 });
    let expected = MotionEstimate::unseen(truth().inverse(), 3.4, 0.01, 0.003);
    let rays = CameraRays::new(lens(480, 360), None);
    let mut patches = Vec::new();
    aligner
        .align(&mut levels(1), &rays, &AlignRequest::new(Start::found(&expected), false))
        .expect("the picture agrees")
        .accept(&mut patches);
    assert!(patches.len() > 40, "{}", patches.len());
    let mean = patches.iter().map(|p| p.shift_px.norm()).sum::<f64>() / patches.len() as f64;
    assert!(mean < 0.05, "{mean}");
    assert!(patches.iter().all(|p| p.on_surface_m.x.abs() < 2.0 && p.on_surface_m.y.abs() < 1.5));
}

#[cfg(feature = "cli")]
#[test]
fn single_pixels_show_wrinkles_narrower_than_a_tile() {
    use crate::camera::Normalized;
    // Wrinkles of six millimetres that the aligned model does not have.
    let mut height = BicubicSpline::<1>::zero([80, 60], [4.0, 3.0]);
    let middles = height.middles();
    let wave = |[x, y]: [f64; 2]| 0.006 * (18.0 * x + 9.0 * y).sin();
    height.coefficients_mut().iter_mut().enumerate().for_each(|(n, c)| c.x = wave(middles(n)));
    let shape = BentShape { height: height.clone(), stretch: BicubicSpline::zero([4, 3], [4.0, 3.0]), ways: Vec::new() };
    let wrinkled = SurfaceSpec { shape: SurfaceShape::Bent(Arc::new(shape)), ..cloth(1) };
    let mut frame = FrameLevels::default();
    frame.update(&view(&wrinkled, &truth(), &lens(480, 360)));
    let mut aligner = Aligner::new(&prepared(vec![cloth(1)]), Shutter { readout_s: 0.0, exposure_s: 0.0 });
    let expected = MotionEstimate::unseen(truth().inverse(), 3.4, 0.01, 0.003);
    let rays = CameraRays::new(lens(480, 360), None);
    let mut pixels = Vec::new();
    let mut solution = aligner.align(&mut frame, &rays, &AlignRequest::new(Start::found(&expected), false)).expect("the picture agrees");
    let pose = solution.alignment.pose.inverse();
    solution.pixel_shifts(&mut pixels);
    let seen = |on_surface: nalgebra::Vector2<f64>, height: f64| {
        let c = pose.transform(&on_surface.push(height).into()).coords;
        lens(480, 360).project(Normalized(c.xy() / c.z)).0
    };
    // How much of the displacement by the wrinkles the pixels show.
    let (mut shown, mut whole) = (0.0, 0.0);
    for pixel in &pixels {
        let shift = seen(pixel.on_surface_m, height.at(pixel.on_surface_m.into()).value.x) - seen(pixel.on_surface_m, 0.0);
        shown += shift.dot(&pixel.weighted);
        whole += shift.dot(&(pixel.information * shift));
        // A pixel says nothing across its gradient.
        assert!(pixel.information.determinant().abs() <= 1e-4 * pixel.information.trace().powi(2));
    }
    println!("{} pixels, {:.3}", pixels.len(), shown / whole);
    assert!(pixels.len() > 1000 && (0.8..1.2).contains(&(shown / whole)), "{} pixels, {}", pixels.len(), shown / whole);
}

/// After a jump within a frame, the reported motion is that of its last rows; the other rows'
/// patches lie elsewhere.
#[test]
fn patches_follow_the_solved_motion_not_the_final_one() {
    // Configured with folds that it does not have, so that patches must be followed.
    let bent = SurfaceSpec { shape: folds(), ..cloth(1) };
    let expected = MotionEstimate::unseen(truth().inverse(), 3.4, 0.01, 0.003);
    let rays = CameraRays::new(lens(480, 360), None);
    let [own, after_jump] = [Vector6::zeros(), Vector6::new(0.3, 0.0, 0.0, 0.0, 0.1, 0.0)].map(|jump| {
        let mut aligner = Aligner::new(&prepared(vec![bent.clone()]), Shutter { readout_s: 0.02, exposure_s: 1e-6 });
        let mut frame = levels(1);
        let mut solution =
            aligner.align(&mut frame, &rays, &AlignRequest::new(Start::found(&expected), false)).expect("the picture agrees");
        let motion = &mut solution.alignment.estimate.motion;
        *motion = motion.with_twist(&(motion.twist() + jump));
        let mut patches = Vec::new();
        solution.accept(&mut patches);
        patches
    });
    let mean = own.iter().map(|p| p.shift_px.norm()).sum::<f64>() / own.len() as f64;
    assert!(own.len() > 40 && mean > 0.2, "{} of {mean} px", own.len());
    assert_eq!(own, after_jump);
}

#[test]
fn a_static_camera_reuses_its_pixels_and_pose() {
    let mut aligner = Aligner::new(&prepared(vec![cloth(1)]), Shutter { readout_s: 0.0, exposure_s: 0.0 });
    let rays = CameraRays::new(lens(480, 360), None);
    let mut frame = levels(1);
    let mut estimate = MotionEstimate::unseen(truth().inverse(), 3.4, 0.01, 0.003);
    let mut poses = Vec::new();
    for _ in 0..6 {
        let found = accepted(&mut aligner, &mut frame, &rays, &estimate);
        poses.push(found.estimate.motion.pose);
        estimate = found.estimate.after(1.0 / 30.0, 3.4, &ProcessNoise::default());
    }
    assert!(aligner.buffers.has_kept);
    let drift = (poses[5].translation - poses[3].translation).norm();
    assert!(drift < 2e-5, "{drift}");
}

/// Follows a camera that glides past a display of `picture`; the aligner has only the coarse
/// picture that it was made from.
fn followed(coarse: &SurfaceSpec, picture: GrayImage) -> Aligner {
    let display = SurfaceSpec::from_artwork("display".into(), picture, [4.0, 3.0], Pose::identity()).expect("texture enough");
    let mut aligner = Aligner::new(&prepared(vec![coarse.clone()]), Shutter { readout_s: 0.0, exposure_s: 1e-6 });
    let rays = CameraRays::new(lens(480, 360), None);
    let pose = |k: u32| perturbed(&truth(), &Vector6::new(0.03 * f64::from(k), 0.0, 0.0, 0.0, 0.0, 0.0));
    let mut estimate = MotionEstimate::unseen(pose(0).inverse(), 3.4, 0.01, 0.003);
    for k in 0..TUNING.first_enlargement_trial_frames + 1 {
        let mut frame = FrameLevels::default();
        frame.update(&view(&display, &pose(k), &lens(480, 360)));
        let found = accepted(&mut aligner, &mut frame, &rays, &estimate);
        estimate = found.estimate.after(1.0 / 30.0, 3.4, &ProcessNoise::default());
    }
    aligner
}

#[test]
fn the_frame_reveals_how_the_picture_was_enlarged() {
    let coarse = SurfaceSpec::from_artwork("coarse".into(), texture(160, 120, 4), [4.0, 3.0], Pose::identity()).expect("texture enough");
    // First linear between its pixels, as `view` samples it; then smooth.
    assert!(!followed(&coarse, coarse.artwork.clone()).slow.is_enlarged);
    let smooth = image::imageops::resize(&coarse.artwork, 1280, 960, image::imageops::FilterType::Lanczos3);
    assert!(followed(&coarse, smooth).slow.is_enlarged);
}

#[test]
fn reselected_pixels_invalidate_the_last_solution() {
    let mut aligner = Aligner::new(&prepared(vec![cloth(1)]), Shutter { readout_s: 0.0, exposure_s: 0.0 });
    let rays = CameraRays::new(lens(480, 360), None);
    let mut frame = levels(1);
    aligner
        .align(&mut frame, &rays, &AlignRequest::new(Start::found(&MotionEstimate::unseen(truth().inverse(), 3.4, 0.01, 0.003)), false))
        .expect("the picture agrees");
    let Aligner { surfaces, buffers, slow } = &mut aligner;
    let Buffers { fine, selector, light, .. } = buffers;
    assert!(fine.solution().is_some());
    // From much farther away the pixels have another grid, with fewer nodes than the light that was
    // solved for.
    let away = Motion::still(facing(0.2, -0.3, Vector3::new(0.1, 0.05, 30.0)).inverse());
    let (runs, nodes) = (fine.pixels().runs().len(), fine.pixels().light().gains().len());
    let spec = LevelSpec::new(surfaces, slow, &rays, true, FINEST, &away);
    assert!(fine.lay_out(&spec, &mut frame, &away, selector, light));
    assert!(fine.pixels().runs().len() < runs && fine.pixels().light().gains().len() < nodes);
    assert!(fine.solution().is_none());
}

#[test]
fn a_rejected_frame_updates_no_estimates() {
    let mut aligner = Aligner::new(&prepared(vec![cloth(1)]), Shutter { readout_s: 0.0, exposure_s: 0.0 });
    let rays = CameraRays::new(lens(480, 360), None);
    let start = |x: f64| perturbed(&truth(), &Vector6::new(x, 0.0, 0.0, 0.0, 0.0, 0.0)).inverse();
    let expected = |x: f64| MotionEstimate::unseen(start(x), 3.4, 0.02, 0.006);
    accepted(&mut aligner, &mut levels(1), &rays, &expected(0.01));
    let learnt = |aligner: &Aligner| format!("{:?}", aligner.slow);
    let before = learnt(&aligner);
    // Another picture, and the right one from starts that the slow estimates would learn from.
    let _ = aligner.align(&mut levels(2), &rays, &AlignRequest::new(Start::found(&expected(0.0)), false));
    assert_eq!(learnt(&aligner), before);
    let first = aligner
        .align(&mut levels(1), &rays, &AlignRequest::new(Start::found(&expected(0.03)), false))
        .expect("the picture agrees")
        .alignment
        .pose;
    assert_eq!(learnt(&aligner), before);
    // The unaccepted frames leave no trace in later ones.
    let again = accepted(&mut aligner, &mut levels(1), &rays, &expected(0.03)).pose;
    assert_eq!(first, again);
    assert_ne!(learnt(&aligner), before);
}

#[test]
fn an_ineffective_enlargement_trial_keeps_the_solution() {
    let coarse = SurfaceSpec::from_artwork("coarse".into(), texture(160, 120, 4), [4.0, 3.0], Pose::identity()).expect("texture enough");
    let smooth = image::imageops::resize(&coarse.artwork, 1280, 960, image::imageops::FilterType::Lanczos3);
    let display = SurfaceSpec::from_artwork("display".into(), smooth, [4.0, 3.0], Pose::identity()).expect("texture enough");
    let mut frame = FrameLevels::default();
    frame.update(&view(&display, &truth(), &lens(480, 360)));
    let mut found = |untried: u32| {
        let mut aligner = Aligner::new(&prepared(vec![coarse.clone()]), Shutter { readout_s: 0.0, exposure_s: 1e-6 });
        aligner.slow.since_trial = untried;
        let start = perturbed(&truth(), &Vector6::new(0.03, 0.0, 0.0, 0.0, 0.0, 0.0)).inverse();
        let expected = MotionEstimate::unseen(start, 3.4, 0.02, 0.006);
        let rays = CameraRays::new(lens(480, 360), None);
        let pose = aligner
            .align(&mut frame, &rays, &AlignRequest::new(Start::found(&expected), false))
            .expect("the picture agrees")
            .alignment
            .pose;
        (pose, aligner.buffers.light)
    };
    assert_eq!(found(0), found(TUNING.enlargement_trial_interval_frames));
}

#[test]
fn a_far_start_needs_the_coarser_levels() {
    let mut aligner = Aligner::new(&prepared(vec![cloth(1)]), Shutter { readout_s: 0.0, exposure_s: 0.0 });
    let (mut frame, rays) = (levels(1), CameraRays::new(lens(480, 360), None));
    // Up to here, starts are off by a fifth of a pixel.
    for k in 0..20 {
        let start = perturbed(&truth(), &(Vector6::x() * if k % 2 == 0 { 0.0015 } else { -0.0015 }));
        accepted(&mut aligner, &mut frame, &rays, &MotionEstimate::unseen(start.inverse(), 3.4, 0.002, 0.0006));
    }
    // Off by twenty pixels.
    let start = perturbed(&truth(), &(Vector6::x() * 0.14));
    let mut is_found = |is_alone: bool| {
        let expected = MotionEstimate::unseen(start.inverse(), 3.4, 0.1, 0.03);
        let request = AlignRequest::new(Start { is_nearby_only: is_alone, ..Start::found(&expected) }, false);
        let found = aligner.align(&mut frame, &rays, &request);
        found.is_some_and(|solution| solution.alignment.pose.inverse().angle_to(&truth()) < 1e-3 && solution.alignment.is_credible(false))
    };
    assert!(is_found(false) && !is_found(true) && is_found(false));
}

/// A camera that starts while the first frame of a body is read: the upper rows show it at rest.
/// Without a jump in the model, the pose would be off by many sigmas.
#[test]
fn a_start_within_the_first_frame_is_in_its_covariance() {
    let shutter = Shutter { readout_s: 0.012, exposure_s: 0.004 };
    let rays = CameraRays::new(lens(480, 360), None);
    let still = Motion::still(truth().inverse());
    let starts = [0.3, 0.8].map(|speed| (still.with_twist(&Vector6::new(0.0, 0.0, 0.0, 0.1 * speed, speed, 0.0)), speed));
    for instant_s in [-0.003, 0.0] {
        for (moving, speed) in starts {
            let pose_at = |t: f64| if t < instant_s { still.pose } else { moving.after(t - instant_s).pose };
            let mut frame = FrameLevels::default();
            frame.update(&view_along(&cloth(1), pose_at, &shutter, &lens(480, 360)));
            let mut aligner = Aligner::new(&prepared(vec![cloth(1)]), shutter);
            let expected = MotionEstimate::unseen(pose_at(0.0), 3.4, 0.02, 0.006);
            let found = aligner.align(&mut frame, &rays, &AlignRequest::new(Start::found(&expected), true)).expect("the picture agrees");
            let error: Vector6<f64> =
                Motion::still(found.alignment.pose).error_to(&Motion::still(pose_at(0.0))).fixed_rows::<6>(0).into_owned();
            let nees = error.dot(&found.alignment.covariance.cholesky().expect("positive").solve(&error)) / 6.0;
            println!(
                "{instant_s} s, {speed} rad/s: {:.3} mm, {:.3} mrad, NEES/6 {nees:.1}",
                1e3 * error.fixed_rows::<3>(0).norm(),
                1e3 * error.fixed_rows::<3>(3).norm()
            );
            assert!(nees < 6.0, "{instant_s} s, {speed} rad/s: {nees}");
        }
    }
}
