use crate::track::acquire::tuning::TUNING;
use nalgebra::{Rotation2, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::*;
use crate::track::synthetic::{cloth, facing, lens, prepared, seen};

fn truth() -> Pose<Camera, Body> {
    facing(0.3, -0.5, Vector3::new(0.1, 0.05, 3.6))
}

/// Returns matches mixed at random: on average `right` ones with half a pixel of noise, and `wrong`
/// ones anywhere.
fn matches(body: &PreparedBody, camera: &CameraModel, right: usize, wrong: usize) -> Vec<SurfaceMatch> {
    matches_of(body, camera, &truth(), right, wrong, 4)
}

fn matches_of(
    body: &PreparedBody,
    camera: &CameraModel,
    pose: &Pose<Camera, Body>,
    right: usize,
    wrong: usize,
    seed: u64,
) -> Vec<SurfaceMatch> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut all = Vec::new();
    while all.len() < right + wrong {
        let surface = random.random_range(0..body.surfaces.len()) as u32;
        let artwork = Vector2::new(random.random_range(0.0..640.0), random.random_range(0.0..480.0));
        let (pixel, derivative) = seen(camera, pose, &body.surfaces[surface as usize].spec, artwork);
        let anywhere = Vector2::new(random.random_range(0.0..640.0), random.random_range(0.0..480.0));
        let noise = Vector2::new(random.random_range(-0.8..0.8), random.random_range(-0.8..0.8));
        let is_wrong = random.random_range(0..right + wrong) < wrong;
        let pixel = if is_wrong { anywhere } else { pixel + noise };
        let Some(ray) = camera.unproject(Pixel(pixel)) else { continue };
        // Directions are known to some degrees and sizes to a tenth; wrong matches have arbitrary
        // ones.
        let (rotation, growth) = if is_wrong { (3.1, 2.0) } else { (0.15, 1.1) };
        let rotation = Rotation2::new(random.random_range(-rotation..rotation));
        let growth = f64::powf(growth, random.random_range(-1.0..1.0));
        let derivative = rotation * derivative * growth;
        all.push(SurfaceMatch { surface, artwork, pixel, undistorted: camera.undistorted_pixel(ray), scale: 1.0, derivative });
    }
    all
}

/// Seeks homographies among all matches.
fn candidates_of(body: &PreparedBody, matches: &[SurfaceMatch], camera: &CameraModel) -> (Vec<Candidate>, Recognition) {
    candidates(body, matches, matches, camera, 1)
}

fn assert_found(body: &PreparedBody, right: usize, wrong: usize) {
    let camera = lens(640, 480);
    let (found, seen) = candidates_of(body, &matches(body, &camera, right, wrong), &camera);
    let best = found.first().expect("a candidate");
    let (shift, rotation) = ((best.pose.translation - truth().translation).norm(), best.pose.angle_to(&truth()).to_degrees());
    println!("{right} right, {wrong} wrong: {shift:.4} m, {rotation:.3} degrees, {} inliers", best.inliers);
    assert!(shift < 0.03 && rotation < 0.5 && best.inliers > right / 2, "{shift} {rotation} {}", best.inliers);
    assert!(seen.agreeing > right / 2 && seen.misfit.is_some_and(|m| m.abs() < 0.3), "{seen:?}");
    assert!(found.windows(2).all(|w| w[0].cost <= w[1].cost) && found.len() <= 4);
}

#[test]
fn outliers_do_not_move_the_pose() {
    let body = prepared(vec![cloth(1)]);
    assert_found(&body, 150, 0);
    assert_found(&body, 100, 100);
    assert_found(&body, 80, 160);
}

#[test]
fn all_surfaces_of_a_body_support_one_pose() {
    let mut flat = cloth(2);
    flat.pose = Pose::new(UnitQuaternion::from_euler_angles(0.0, 0.5, 0.0), Vector3::new(0.8, 0.1, 0.7));
    flat.size_m = [1.2, 0.9];
    assert_found(&prepared(vec![cloth(1), flat]), 120, 60);
}

#[test]
fn too_few_or_only_wrong_matches_yield_no_candidate() {
    let (body, camera) = (prepared(vec![cloth(1)]), lens(640, 480));
    assert!(candidates_of(&body, &[], &camera).0.is_empty());
    assert!(candidates_of(&body, &matches(&body, &camera, 7, 0), &camera).0.is_empty());
    // Random matches must not look like a stage: candidates from them, if any, have little more
    // than the minimum support.
    let (by_chance, _) = candidates_of(&body, &matches(&body, &camera, 0, 200), &camera);
    assert!(by_chance.iter().all(|c| c.inliers < 20), "{by_chance:?}");
}

/// With eight right matches among sixty, a sample of four right ones is unlikely.
#[test]
fn eight_right_matches_among_sixty_locate_a_body() {
    let (body, camera) = (prepared(vec![cloth(1)]), lens(640, 480));
    // The cloth appears some 200 pixels wide.
    let pose = facing(0.3, -0.5, Vector3::new(0.1, 0.05, 12.0));
    let mut by_homography = 0;
    for seed in 0..10 {
        let [right, wrong] = [(8, 0), (0, 52)].map(|(right, wrong)| matches_of(&body, &camera, &pose, right, wrong, seed));
        let few: Vec<SurfaceMatch> = wrong.chunks(6).zip(&right).flat_map(|(wrong, right)| [wrong, &[*right]].concat()).collect();
        let is_right = |candidates: &[Candidate]| {
            let is_near =
                |c: &Candidate| (c.pose.translation - pose.translation).norm() < 1.0 && c.pose.angle_to(&pose).to_degrees() < 12.0;
            candidates.iter().any(is_near)
        };
        let (mut found, _) = candidates_of(&body, &few, &camera);
        by_homography += usize::from(is_right(&found));
        add_candidates_of_few(&body, &few, &camera, &mut found);
        assert!(is_right(&found) && found.len() <= TUNING.max_candidates, "{seed}: {found:?}");
        assert!(found.windows(2).all(|w| w[0].cost <= w[1].cost));
    }
    assert!(by_homography < 8, "{by_homography}");
}

#[test]
fn a_well_matched_body_gets_no_few_match_candidates() {
    let (body, camera) = (prepared(vec![cloth(1)]), lens(640, 480));
    let many = matches(&body, &camera, 80, 40);
    let (mut found, _) = candidates_of(&body, &many, &camera);
    let before = found.clone();
    add_candidates_of_few(&body, &many, &camera, &mut found);
    assert_eq!(found, before);
}

#[test]
fn wrong_matches_alone_rarely_yield_candidates() {
    let (body, camera) = (prepared(vec![cloth(1)]), lens(640, 480));
    let made = |seed| {
        let mut found = Vec::new();
        add_candidates_of_few(&body, &matches_of(&body, &camera, &truth(), 0, 60, seed), &camera, &mut found);
        !found.is_empty()
    };
    assert_eq!((0..40).filter(|seed| made(*seed)).count(), 0);
}

#[test]
fn a_few_agreeing_matches_suggest_a_visible_body() {
    let (body, camera) = (prepared(vec![cloth(1)]), lens(640, 480));
    let pose = facing(0.3, -0.5, Vector3::new(0.1, 0.05, 12.0));
    let seen = |right: usize, wrong: usize| {
        (0..40).filter(|&seed| !agreeing_matches(&body, &matches_of(&body, &camera, &pose, right, wrong, seed)).is_empty()).count()
    };
    assert!(seen(10, 30) >= 38, "{}", seen(10, 30));
    assert!(seen(0, 60) <= 4, "{}", seen(0, 60));
    assert_eq!(seen(0, 0), 0);
}

#[test]
fn matches_go_to_the_body_that_owns_their_surface() {
    let camera = lens(640, 480);
    let (descriptor, polarity) = (crate::features::Descriptor([0; 4]), crate::features::Polarity::Dark);
    let feature = |x: f64| Feature { position: Vector2::new(x, 100.0), scale: 1.2, angle: 0.0, polarity, descriptor };
    let shape = Matrix2::new(0.0, -2.0, 2.0, 0.0);
    let reference = |surface: u32| ReferenceFeature { surface, position: Vector2::new(5.0, 6.0), scale: 2.0, shape, polarity };
    let (features, references) = ([feature(50.0), feature(60.0), feature(70.0)], [reference(0), reference(2), reference(3)]);
    let all: Vec<Match> = (0..3).map(|k| Match { frame: k, reference: k, ratio: 0.5 }).collect();
    let own = surface_matches(&all, &features, &references, 2..4, &camera);
    assert_eq!(own.iter().map(|m| (m.surface, m.pixel.x, m.scale)).collect::<Vec<_>>(), [(0, 60.0, 1.2), (1, 70.0, 1.2)]);
    // The reference's corner points along y, the frame's along x: right in one is up in the other,
    // and smaller.
    assert!((own[0].derivative - Matrix2::new(0.0, 0.6, -0.6, 0.0)).norm() < 1e-9, "{}", own[0].derivative);
}

#[test]
fn five_refinement_steps_converge_the_best_candidate() {
    let (body, camera) = (prepared(vec![cloth(1)]), lens(640, 480));
    let still = MovingCamera::still(&camera);
    let pose = facing(0.2, -0.3, Vector3::new(0.4, 0.2, 9.0));
    for seed in 0..20 {
        let matches = matches_of(&body, &camera, &pose, 14, 40, seed);
        let (mut found, _) = candidates_of(&body, &matches, &camera);
        add_candidates_of_few(&body, &matches, &camera, &mut found);
        let best = found.first().expect("a candidate");
        let observations: Vec<Observation> = matches.iter().map(|m| observation(&body, m)).collect();
        let near: Vec<Observation> = within_reach(&best.pose, &still, &observations, TUNING.refinement_gate_sigmas[1]).copied().collect();
        let rest = resect(&best.pose, &still, &near, 100).expect("enough matches").pose;
        let shift = (rest.translation - best.pose.translation).norm();
        assert!(shift < 0.01 * best.off[0] && rest.angle_to(&best.pose) < 0.01 * best.off[1], "{seed}: {shift} of {:?}", best.off);
    }
}
