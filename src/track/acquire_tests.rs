use nalgebra::{UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::super::synthetic::{cloth, facing, lens, prepared};
use super::*;

fn truth() -> Pose<Camera, Body> {
    facing(0.3, -0.5, Vector3::new(0.1, 0.05, 3.6))
}

/// `right` matches with a noise of half a pixel and `wrong` ones anywhere, mixed; at least half of the first are right.
fn matches(body: &PreparedBody, camera: &CameraModel, right: usize, wrong: usize) -> Vec<SurfaceMatch> {
    let mut random = Pcg64Mcg::seed_from_u64(4);
    let mut all = Vec::new();
    while all.len() < right + wrong {
        let surface = random.random_range(0..body.surfaces.len()) as u32;
        let artwork = Vector2::new(random.random_range(0.0..640.0), random.random_range(0.0..480.0));
        let c = truth().transform(&body.surfaces[surface as usize].spec.body_point(artwork));
        let seen = camera.project(crate::camera::Normalized(Vector2::new(c.x / c.z, c.y / c.z))).0;
        let anywhere = Vector2::new(random.random_range(0.0..640.0), random.random_range(0.0..480.0));
        let noise = Vector2::new(random.random_range(-0.8..0.8), random.random_range(-0.8..0.8));
        let is_wrong = random.random_range(0..right + wrong) < wrong;
        let pixel = if is_wrong { anywhere } else { seen + noise };
        let Some(ray) = camera.unproject(Pixel(pixel)) else { continue };
        all.push(SurfaceMatch { surface, artwork, pixel, undistorted: camera.undistorted_pixel(ray), scale: 1.0 });
    }
    all
}

fn assert_found(body: &PreparedBody, right: usize, wrong: usize) {
    let camera = lens(640, 480);
    let (found, seen) = candidates(body, &matches(body, &camera, right, wrong), &camera, 1);
    let best = found.first().expect("a candidate");
    let (shift, turn) = ((best.pose.translation - truth().translation).norm(), best.pose.angle_to(&truth()).to_degrees());
    println!("{right} right, {wrong} wrong: {shift:.4} m, {turn:.3} degrees, {} inliers", best.inliers);
    assert!(shift < 0.03 && turn < 0.5 && best.inliers > right / 2, "{shift} {turn} {}", best.inliers);
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
fn surfaces_of_a_body_speak_for_one_pose() {
    let mut flat = cloth(2);
    flat.pose = Pose::new(UnitQuaternion::from_euler_angles(0.0, 0.5, 0.0), Vector3::new(0.8, 0.1, 0.7));
    flat.size_m = [1.2, 0.9];
    assert_found(&prepared(vec![cloth(1), flat]), 120, 60);
}

#[test]
fn too_few_or_only_wrong_matches_give_nothing() {
    let (body, camera) = (prepared(vec![cloth(1)]), lens(640, 480));
    assert!(candidates(&body, &[], &camera, 1).0.is_empty());
    assert!(candidates(&body, &matches(&body, &camera, 7, 0), &camera, 1).0.is_empty());
    // Chance alone must not look like a stage: what it yields, if anything, has hardly more than the least support.
    let (by_chance, _) = candidates(&body, &matches(&body, &camera, 0, 200), &camera, 1);
    assert!(by_chance.iter().all(|c| c.inliers < 20), "{by_chance:?}");
}

#[test]
fn matches_go_to_the_body_that_owns_their_surface() {
    let camera = lens(640, 480);
    let descriptor = crate::features::Descriptor([0; 4]);
    let feature = |x: f64| Feature { position: Vector2::new(x, 100.0), scale: 1.2, angle: 0.0, descriptor };
    let reference = |surface: u32| ReferenceFeature { surface, position: Vector2::new(5.0, 6.0), scale: 2.0 };
    let (features, references) = ([feature(50.0), feature(60.0), feature(70.0)], [reference(0), reference(2), reference(3)]);
    let all: Vec<Match> = (0..3).map(|k| Match { frame: k, reference: k, ratio: 0.5 }).collect();
    let own = surface_matches(&all, &features, &references, 2..4, &camera);
    assert_eq!(own.iter().map(|m| (m.surface, m.pixel.x, m.scale)).collect::<Vec<_>>(), [(0, 60.0, 1.2), (1, 70.0, 1.2)]);
}
