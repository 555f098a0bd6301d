//! The kernels of a frame, one by one: alignment on ten thousand pixels, corners, pyramid,
//! description, matching, and the robust solvers.
//!
//! `cargo bench --bench kernels`

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use image::GrayImage;
use nalgebra::{Matrix2, Point3, Rotation2, UnitQuaternion, Vector2, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use stagepose::diagnostics::capture::VirtualCamera;
use stagepose::diagnostics::features::{
    CornerBuffers, CornerOptions, ExtractorOptions, FeatureExtractor, MatchBuffers, Pyramid, ReferenceIndex, Workers, describe,
    detect_corners, orientation, smooth_into,
};
use stagepose::diagnostics::geometry::{LocalAffinity, MovingCamera, Observation, essential_candidates, resect, robust_affine};
use stagepose::diagnostics::simulate::{grey, paint};
use stagepose::diagnostics::track::AlignKernels;
use stagepose::two_views::geometry::{
    Homography, Order, PointPair, RayPair, RobustOptions, corrected, decompose_homography, eight_point, five_point, gold_standard,
    judged_motion, refine_fundamental, refine_motion_in_pixels, robust_essential, robust_fundamental, robust_homography, seven_point,
};
use stagepose::{Body, Camera, CameraModel, Dolly, EntryContent, FrameSource, Normalized, Pose, dolly};

fn picture() -> GrayImage {
    grey(&paint(1280, 720, 3))
}

/// The segment test (FAST-9), its scores, and the even distribution of corners over a 1280x720
/// picture.
fn corners(c: &mut Criterion) {
    let picture = picture();
    let options = CornerOptions { count: 1000, threshold: 20, least_threshold: 6, border: 18, cell_px: 40 };
    let (mut buffers, mut found) = (CornerBuffers::default(), Vec::new());
    c.bench_function("segment test and corners 1280x720", |b| {
        b.iter(|| {
            detect_corners(black_box(&picture), &options, &mut buffers, &mut found);
            found.len()
        })
    });
}

fn pyramid(c: &mut Criterion) {
    let picture = picture();
    let mut pyramid = Pyramid::default();
    c.bench_function("pyramid of 8 levels 1280x720", |b| b.iter(|| pyramid.build(black_box(&picture), 1.2, 8, 48).len()));
    let (mut smooth, mut row) = (picture.clone(), Vec::new());
    c.bench_function("smooth 1280x720", |b| b.iter(|| smooth_into(black_box(&picture), &mut smooth, &mut row)));
}

fn description(c: &mut Criterion) {
    let picture = picture();
    c.bench_function("orient and describe one corner", |b| {
        b.iter(|| {
            let angle = orientation(&picture, black_box(640), black_box(360));
            describe(&picture, 640, 360, angle)
        })
    });
}

/// The Hamming scan of 1500 features against 4000, including the ratio and mutual tests.
fn hamming(c: &mut Criterion) {
    let workers = Workers::new(1);
    let (mut extractor, mut reference, mut frame) = (FeatureExtractor::default(), Vec::new(), Vec::new());
    let options = |count| ExtractorOptions { count, ..ExtractorOptions::default() };
    extractor.extract(&grey(&paint(1600, 1200, 3)), None, &options(4000), &workers, &mut reference);
    extractor.extract(&picture(), None, &options(1500), &workers, &mut frame);
    let mut index = ReferenceIndex::default();
    index.add(0, &reference, |p| p, 1.0);
    let (mut buffers, mut matches) = (MatchBuffers::default(), Vec::new());
    c.bench_function(&format!("match {} features over {}", frame.len(), reference.len()), |b| {
        b.iter(|| {
            index.match_features(black_box(&frame), 0.85, &workers, &mut buffers, &mut matches);
            matches.len()
        })
    });
}

fn pose() -> Pose<Camera, Body> {
    Pose::new(UnitQuaternion::from_euler_angles(0.2, -0.3, 0.05), Vector3::new(0.1, -0.2, 4.0))
}

/// Returns random points in a box of 4 x 3 x `depth` metres around the origin.
fn points(count: usize, depth: f64, random: &mut Pcg64Mcg) -> Vec<Point3<f64>> {
    let mut within = |half: f64| random.random_range(-half..=half);
    (0..count).map(|_| Point3::new(within(2.0), within(1.5), within(0.5 * depth))).collect()
}

fn ray(pose: &Pose<Camera, Body>, point: &Point3<f64>) -> Vector2<f64> {
    let c = pose.transform(point);
    Vector2::new(c.x / c.z, c.y / c.z)
}

/// A robust homography from 400 pairs, a third of them wrong.
fn homography(c: &mut Criterion) {
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let pairs: Vec<PointPair> = points(400, 0.0, &mut random)
        .iter()
        .enumerate()
        .map(|(k, p)| {
            let wrong = Vector2::new(random.random_range(-600.0..600.0), random.random_range(-400.0..400.0));
            let noise = Vector2::new(random.random_range(-0.7..0.7), random.random_range(-0.7..0.7));
            let to = if k % 3 == 2 { wrong } else { ray(&pose(), p) * 1100.0 + noise };
            PointPair { from: p.coords.xy() * 300.0, to }
        })
        .collect();
    let options = RobustOptions {
        max_samples: 1500,
        order: Order::BestFirst { even_after: 1500, draws_each: 1, stops_by_best: false },
        ..RobustOptions::default()
    };
    c.bench_function("robust homography, 400 pairs", |b| b.iter(|| robust_homography(black_box(&pairs), &options)));
}

fn essential(c: &mut Criterion) {
    let mut random = Pcg64Mcg::seed_from_u64(2);
    let first = Pose::<Camera, Body>::new(UnitQuaternion::identity(), Vector3::new(0.0, 0.0, 5.0));
    let pair = |p: &Point3<f64>| RayPair { first: ray(&first, p), second: ray(&pose(), p) };
    let pairs: Vec<RayPair> = points(300, 2.0, &mut random).iter().map(pair).collect();
    let five: [RayPair; 5] = std::array::from_fn(|k| pairs[17 * k]);
    c.bench_function("five-point", |b| b.iter(|| five_point(black_box(&five))));
    c.bench_function("essential candidates, 12 samples of 300 pairs", |b| {
        b.iter(|| essential_candidates(black_box(&pairs), 1e-3, 12, 6, 1))
    });
}

/// The two-view solvers that docs/solvers.md lists: 200 pairs of a box and of a plane, with noise
/// of about half a pixel.
fn two_views(c: &mut Criterion) {
    const FOCAL: f64 = 1100.0;
    let mut random = Pcg64Mcg::seed_from_u64(4);
    let first = Pose::<Camera, Body>::new(UnitQuaternion::identity(), Vector3::new(0.0, 0.0, 5.0));
    let seen = |points: Vec<Point3<f64>>, random: &mut Pcg64Mcg| -> (Vec<RayPair>, Vec<PointPair>) {
        let mut noise = || Vector2::new(random.random_range(-0.8..0.8), random.random_range(-0.8..0.8)) / FOCAL;
        let rays: Vec<RayPair> =
            points.iter().map(|p| RayPair { first: ray(&first, p) + noise(), second: ray(&pose(), p) + noise() }).collect();
        let pixels = rays.iter().map(|r| PointPair { from: r.first * FOCAL, to: r.second * FOCAL }).collect();
        (rays, pixels)
    };
    let (box_points, plane_points) = (points(200, 2.0, &mut random), points(200, 0.0, &mut random));
    let ((rays, pixels), (flat_rays, flat)) = (seen(box_points, &mut random), seen(plane_points, &mut random));
    let h = Homography::from_pairs(&flat, None).expect("a plane");
    let f = eight_point(&pixels, None).expect("relief");
    let motion = robust_essential(&rays, [FOCAL; 2], &RobustOptions::default()).expect("a motion").model.motion;
    let normalised = Homography::from_pairs(&flat_rays.iter().map(|r| PointPair { from: r.first, to: r.second }).collect::<Vec<_>>(), None);
    let (four, seven) = (std::array::from_fn(|k| flat[31 * k]), std::array::from_fn(|k| pixels[17 * k]));
    c.bench_function("four-point", |b| b.iter(|| Homography::from_four(black_box(&four))));
    c.bench_function("direct linear, 200 pairs", |b| b.iter(|| Homography::from_pairs(black_box(&flat), None)));
    c.bench_function("transfer refinement, 200 pairs", |b| b.iter(|| h.refined(black_box(&flat), 0.5, 15)));
    c.bench_function("gold standard, 200 pairs", |b| b.iter(|| gold_standard(&h, black_box(&flat), 15)));
    c.bench_function("seven-point", |b| b.iter(|| seven_point(black_box(&seven))));
    c.bench_function("eight-point, 200 pairs", |b| b.iter(|| eight_point(black_box(&pixels), None)));
    c.bench_function("fundamental refinement, 200 pairs", |b| b.iter(|| refine_fundamental(&f, black_box(&pixels), 0.5, 15)));
    c.bench_function("motion refinement, 200 pairs", |b| {
        b.iter(|| refine_motion_in_pixels(&motion, black_box(&rays), [FOCAL; 2], 0.5, 15))
    });
    c.bench_function("essential decomposition, 200 pairs", |b| b.iter(|| judged_motion(&motion.essential(), black_box(&rays), 5e-4)));
    if let Some(normalised) = normalised {
        c.bench_function("homography decomposition, 200 pairs", |b| b.iter(|| decompose_homography(&normalised, black_box(&flat_rays))));
    }
    c.bench_function("triangulation, corrected", |b| b.iter(|| corrected(&motion, black_box(&rays[0]))));
    let with_wrong = |mut pairs: Vec<PointPair>| {
        pairs.iter_mut().step_by(2).for_each(|p| p.to = Vector2::new(p.from.y, p.from.x) * 0.7 + Vector2::new(17.0, -31.0));
        pairs
    };
    let (flat, pixels) = (with_wrong(flat), with_wrong(pixels));
    let rays: Vec<RayPair> = pixels.iter().map(|p| RayPair { first: p.from / FOCAL, second: p.to / FOCAL }).collect();
    let options = RobustOptions::default();
    c.bench_function("robust homography, 200 pairs, half wrong", |b| b.iter(|| robust_homography(black_box(&flat), &options)));
    c.bench_function("robust fundamental, 200 pairs, half wrong", |b| b.iter(|| robust_fundamental(black_box(&pixels), &options)));
    c.bench_function("robust essential, 200 pairs, half wrong", |b| b.iter(|| robust_essential(black_box(&rays), [FOCAL; 2], &options)));
}

/// Six right matches of a small picture among sixty wrong ones.
fn affinities(c: &mut Criterion) {
    let mut random = Pcg64Mcg::seed_from_u64(5);
    let map = Matrix2::new(0.4, -0.2, 0.1, 0.3);
    let mut point = |side: f64| Vector2::new(random.random_range(0.0..side), random.random_range(0.0..side));
    let matches: Vec<LocalAffinity> = (0..66)
        .map(|k| {
            let (from, anywhere, turn) = (point(400.0), point(300.0), point(6.0).x);
            let (to, turn) = if k % 11 == 0 { (map * from, 0.0) } else { (anywhere, turn) };
            LocalAffinity { pair: PointPair { from, to }, derivative: Rotation2::new(turn) * map, noise: 1.0 }
        })
        .collect();
    c.bench_function("affine map of 6 matches among 60 wrong ones", |b| b.iter(|| robust_affine(black_box(&matches), 5)));
}

fn resection(c: &mut Criterion) {
    let camera = CameraModel::pinhole(1280, 720, 1100.0, 1100.0, 639.5, 359.5).expect("a camera");
    let mut random = Pcg64Mcg::seed_from_u64(3);
    let observations: Vec<Observation> = points(300, 1.0, &mut random)
        .into_iter()
        .map(|point| {
            let noise = Vector2::new(random.random_range(-0.3..0.3), random.random_range(-0.3..0.3));
            let pixel = camera.project(Normalized(ray(&pose(), &point))).0 + noise;
            Observation { point, pixel, information: Matrix2::identity() * 25.0, delay_s: 0.0, group: 0 }
        })
        .collect();
    let start = Pose::new(pose().rotation, pose().translation + Vector3::new(0.02, -0.01, 0.05));
    c.bench_function("resection, 300 points", |b| {
        b.iter(|| resect(black_box(&start), &MovingCamera::still(&camera), black_box(&observations), 15))
    });
}

/// The alignment kernels of a tracked frame: ten thousand pixels at half the size of 1280x720.
fn alignment(c: &mut Criterion) {
    let mut camera = VirtualCamera::new(
        dolly(Dolly { width: 1280, height: 720, seed: 1, duration_s: 1.0, artwork_width: 1600 }).expect("a scene"),
        30.0,
        1,
    );
    let (scene, row) = (camera.stage().clone(), camera.next_entry());
    let Some(EntryContent::Frame(frame)) = row.map(|r| r.content) else { panic!("a virtual camera loses no frame") };
    let seen: Pose<Camera, Body> = scene.truth(0.0).inverse().renamed();
    let mut kernels = AlignKernels::new(frame.image, scene.camera, &scene.stage.surfaces[0], &seen);
    c.bench_function("halve 1280x720", |b| b.iter(|| kernels.halve()));
    c.bench_function("choose 10,000 pixels", |b| b.iter(|| kernels.choose(black_box(10_000))));
    c.bench_function("lay them out", |b| b.iter(|| kernels.lay_out()));
    for (side, places) in [(3, 1), (5, 1), (5, 3), (5, 5), (5, 9)] {
        let what = if places == 1 { format!("sharp, {side}x{side} looks") } else { format!("{places} places of a blur") };
        c.bench_function(&format!("predict them, {what}"), |b| b.iter(|| kernels.predict(side, black_box(places))));
    }
    kernels.predict(5, 1);
    c.bench_function("residuals", |b| b.iter(|| kernels.residuals()));
    c.bench_function("normal equations of all tiles", |b| b.iter(|| kernels.tile_equations(black_box(false))));
    c.bench_function("normal equations of all tiles and their rows", |b| b.iter(|| kernels.tile_equations(black_box(true))));
    c.bench_function("evidence of all tiles", |b| b.iter(|| kernels.evidence()));
    c.bench_function("noise of all tiles", |b| b.iter(|| kernels.noise_sums()));
}

criterion_group!(kernels, alignment, corners, pyramid, description, hamming, homography, essential, two_views, affinities, resection);
criterion_main!(kernels);
