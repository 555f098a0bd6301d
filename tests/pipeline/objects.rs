//! Tracked objects in front of the stage.

use nalgebra::Vector3;
use stagepose::diagnostics::simulate::paint;
use stagepose::{BodySpec, LightModel, MovingObject, Normalized, ObjectPath, PoseSample, Spline, State, VirtualStage};

use super::scene::{FPS, aside, backdrop, camera, quiet, rows, setup, surface, track, track_rows};

fn with_prop() -> VirtualStage {
    let mut scene = quiet(camera(640, 480), aside(), backdrop());
    let art = stagepose::diagnostics::simulate::grey(&paint(400, 400, 77));
    let prop = surface("prop", &art, [0.9, 0.9], Vector3::new(0.0, -0.1, 0.45), 0.0);
    let keys = [(0.0, Vector3::new(-0.5, -1.0, -0.5)), (1.0, Vector3::new(0.1, -1.1, -0.4))];
    let path = ObjectPath { position: Spline::new(&keys).unwrap(), rotation_rad: -0.3, angular_velocity_rad_s: 0.2 };
    scene.objects.push(MovingObject { body: BodySpec::new("prop", vec![prop]), path });
    scene
}

#[test]
fn an_object_is_posed_in_the_stage() {
    let scene = with_prop();
    let mut worst = (0.0_f64, 0.0_f64);
    for sample in track(&scene, 8).iter().skip(1) {
        assert_eq!((sample.state, sample.objects[0].state), (State::Tracking, State::Tracking), "frame {}", sample.sequence);
        assert_eq!(sample.objects[0].name, "prop");
        let truth = scene.object_truth(0, sample.timestamp.seconds()).unwrap();
        let found = sample.objects[0].pose.unwrap();
        worst.0 = worst.0.max((found.translation - truth.translation).norm());
        worst.1 = worst.1.max(found.angle_to(&truth).to_degrees());
    }
    println!("worst: {:.4} m, {:.3} degrees", worst.0, worst.1);
    assert!(worst.0 < 0.003 && worst.1 < 0.1, "{worst:?}");
}

#[test]
fn an_object_does_not_track_in_a_blackout() {
    let mut scene = with_prop();
    scene.blackouts.push(3.5 / FPS..11.5 / FPS);
    for sample in track(&scene, 15) {
        let dark = (4..12).contains(&sample.sequence);
        let found = (1..4).contains(&sample.sequence) || sample.sequence >= 13;
        if dark {
            assert_ne!(sample.objects[0].state, State::Tracking, "frame {}", sample.sequence);
        }
        if found {
            assert_eq!(sample.objects[0].state, State::Tracking, "frame {}", sample.sequence);
        }
    }
}

/// A square prop with its name, seed and side, standing or moving along `path`.
fn prop(name: &str, seed: u64, side_m: f64, path: ObjectPath) -> MovingObject {
    let art = stagepose::diagnostics::simulate::grey(&paint(320, 320, seed));
    MovingObject { body: BodySpec::new(name, vec![surface(name, &art, [side_m, side_m], Vector3::zeros(), 0.0)]), path }
}

fn along(keys: &[(f64, [f64; 3])], rotation_rad: f64, angular_velocity_rad_s: f64) -> ObjectPath {
    let keys: Vec<_> = keys.iter().map(|(t, p)| (*t, Vector3::from(*p))).collect();
    ObjectPath { position: Spline::straight(&keys).unwrap(), rotation_rad, angular_velocity_rad_s }
}

/// Returns the frames that report an object, and its worst errors: fraction of its distance from
/// the camera, and degrees.
fn given(scene: &VirtualStage, samples: &[PoseSample], object: usize) -> (Vec<u64>, [f64; 2]) {
    let (mut frames, mut worst) = (Vec::new(), [0.0_f64; 2]);
    for sample in samples.iter().filter(|s| s.objects[object].state == State::Tracking) {
        let at_s = sample.timestamp.seconds();
        let (truth, camera) = (scene.object_truth(object, at_s).unwrap(), scene.truth(at_s));
        let found = sample.objects[object].pose.unwrap();
        let distance = (truth.translation - camera.translation).norm();
        worst[0] = worst[0].max((found.translation - truth.translation).norm() / distance);
        worst[1] = worst[1].max(found.angle_to(&truth).to_degrees());
        frames.push(sample.sequence);
    }
    (frames, worst)
}

/// Asserts that no reported object pose is off by more than a hundredth of the distance or 0.3
/// degrees; returns the frames that report it.
fn assert_right(scene: &VirtualStage, samples: &[PoseSample], object: usize) -> Vec<u64> {
    let (frames, worst) = given(scene, samples, object);
    println!("object {object}: {} frames, worst {:.5} of the distance, {:.3} degrees", frames.len(), worst[0], worst[1]);
    assert!(worst[0] < 0.01 && worst[1] < 0.3, "object {object}: {worst:?}");
    frames
}

#[test]
fn four_objects_are_followed_each_by_itself() {
    let mut scene = quiet(camera(960, 720), aside(), backdrop());
    for k in 0..4 {
        let (column, row) = (f64::from(k % 2), f64::from(k / 2));
        let from = [-1.25 + 0.8 * column, -0.3 - 0.05 * row, -0.38 + 0.62 * row];
        let drift = 0.15 * f64::from(k) - 0.3;
        let path = along(&[(0.0, from), (1.0, [from[0] + drift, from[1], from[2] + 0.1])], 0.1 * f64::from(k % 3), 0.3 * drift);
        scene.objects.push(prop(&format!("prop {k}"), 100 + u64::try_from(k).unwrap(), 0.45, path));
    }
    let started = std::time::Instant::now();
    let samples = track(&scene, 12);
    println!("{:.0} ms a frame, rendering included", started.elapsed().as_secs_f64() * 1e3 / 12.0);
    let frames: Vec<Vec<u64>> = (0..4).map(|object| assert_right(&scene, &samples, object)).collect();
    for (object, frames) in frames.iter().enumerate() {
        assert!((4..12).all(|frame| frames.contains(&frame)), "object {object}: {frames:?}");
    }
    assert!(samples.iter().skip(1).all(|sample| sample.state == State::Tracking));
}

#[test]
fn two_objects_with_one_picture_are_never_swapped() {
    let mut scene = quiet(camera(640, 480), aside(), backdrop());
    // Two copies of one print and a different one; they cross.
    for (name, seed, from, to) in [("left", 77, -1.2, 0.4), ("right", 77, 0.4, -1.2), ("other", 78, -0.4, -0.3)] {
        let height = if name == "other" { 0.7 } else { -0.4 };
        let path = along(&[(0.0, [from, -0.6, height]), (0.5, [to, -0.6, height])], 0.1, 0.0);
        scene.objects.push(prop(name, seed, 0.6, path));
    }
    let samples = track(&scene, 15);
    for object in 0..2 {
        assert_right(&scene, &samples, object);
    }
    let other = assert_right(&scene, &samples, 2);
    assert!(other.len() >= 12, "the twins hide what is not theirs: {other:?}");
}

#[test]
fn a_box_is_one_object_whichever_side_is_seen() {
    let mut scene = quiet(camera(640, 480), aside(), backdrop());
    let art = |seed| stagepose::diagnostics::simulate::grey(&paint(320, 320, seed));
    let face = |name: &str, seed, x: f64, y: f64, rotation: f64| surface(name, &art(seed), [0.8, 0.8], Vector3::new(x, y, 0.0), rotation);
    let quarter = std::f64::consts::FRAC_PI_2;
    let faces = vec![face("front", 21, 0.0, -0.4, 0.0), face("right", 22, 0.4, 0.0, quarter), face("left", 23, -0.4, 0.0, -quarter)];
    // It turns from its left side to its right side within a second.
    scene.objects.push(MovingObject {
        body: BodySpec::new("box", faces),
        path: along(&[(0.0, [-0.4, -0.9, -0.3]), (1.0, [0.0, -0.9, -0.3])], 1.1, -2.2),
    });
    let samples = track(&scene, 30);
    let frames = assert_right(&scene, &samples, 0);
    assert!((3..30).all(|frame| frames.contains(&frame)), "{frames:?}");
}

/// Whether the frame shows all of an object with a side of 0.7 m.
fn is_whole(scene: &VirtualStage, sample: &PoseSample) -> bool {
    let at_s = sample.timestamp.seconds();
    let (object, seen_from) = (scene.object_truth(0, at_s).unwrap(), scene.truth(at_s).inverse());
    [[-0.35, -0.35], [0.35, -0.35], [-0.35, 0.35], [0.35, 0.35]].iter().all(|[x, z]| {
        let place = seen_from.transform(&object.transform(&nalgebra::Point3::new(*x, 0.0, *z)));
        let ray = Normalized(nalgebra::Vector2::new(place.x / place.z, place.y / place.z));
        let pixel = scene.camera.project(ray).0;
        place.z > 0.0 && (0.0..639.0).contains(&pixel.x) && (0.0..479.0).contains(&pixel.y)
    })
}

/// The object was not seen before, and it is smeared by several pixels. Its blur reveals its speed,
/// or else the next frame does.
#[test]
fn a_fast_object_is_reported_as_soon_as_it_is_fully_visible() {
    for (seed, exposure_s) in [(31, 0.004), (32, 0.005), (33, 0.006), (34, 0.007)] {
        let mut scene = quiet(camera(640, 480), aside(), backdrop());
        let keys = [(0.0, [-3.6, -0.8, 0.0]), (0.1, [-3.6, -0.8, 0.0]), (1.2, [0.4, -0.8, 0.1])];
        scene.objects.push(prop("cart", seed, 0.7, along(&keys, 0.1, 0.3)));
        (scene.shutter.exposure_s, scene.samples) = (exposure_s, 8);
        let samples = track(&scene, 30);
        let frames = assert_right(&scene, &samples, 0);
        let first = samples.iter().find(|sample| is_whole(&scene, sample)).expect("it comes in").sequence;
        println!("whole from frame {first} on, given in {frames:?}");
        assert!((first + 1..30).all(|frame| frames.contains(&frame)), "whole from frame {first} on: {frames:?}");
    }
}

#[test]
fn an_object_that_leaves_comes_back() {
    let mut scene = quiet(camera(640, 480), aside(), backdrop());
    // Out of the frame on the left, and back in.
    let keys =
        [(0.0, [-0.6, -0.8, 0.0]), (0.4, [-3.6, -0.8, 0.0]), (0.6, [-3.6, -0.8, 0.0]), (1.0, [-0.6, -0.8, 0.0]), (1.4, [-0.6, -0.8, 0.0])];
    scene.objects.push(prop("cart", 31, 0.7, along(&keys, 0.1, 0.0)));
    let samples = track(&scene, 40);
    let frames = assert_right(&scene, &samples, 0);
    let whole: Vec<u64> = samples.iter().filter(|sample| is_whole(&scene, sample)).map(|s| s.sequence).collect();
    let back = whole.windows(2).find(|w| w[1] > w[0] + 1).map(|w| w[1]).expect("it is away for some frames");
    assert!((back + 2..40).all(|frame| frames.contains(&frame)), "whole again in {back}: {frames:?}");
    assert!(samples.iter().filter(|s| (14..18).contains(&s.sequence)).all(|s| s.objects[0].state != State::Tracking));
}

/// The poster on the stage has another shape than configured, so it is recognised in every frame
/// and never fits.
#[test]
fn an_object_that_never_fits_does_not_starve_another() {
    let mut scene = quiet(camera(960, 720), aside(), backdrop());
    scene.objects.push(prop("poster", 52, 1.1, along(&[(0.0, [-0.7, -0.5, 0.0]), (1.0, [-0.7, -0.5, 0.0])], 0.1, 0.0)));
    scene.objects.push(prop("prop", 53, 0.4, along(&[(0.0, [0.7, -0.6, 0.1]), (1.0, [0.9, -0.6, 0.1])], 0.2, 0.0)));
    let mut known = setup(&scene);
    known.objects[0].surfaces[0].size_m[1] *= 0.6;
    let samples = track_rows(known, &rows(&scene, 6));
    assert!(samples.iter().all(|sample| sample.objects[0].state != State::Tracking));
    let frames = assert_right(&scene, &samples, 1);
    assert!((2..6).all(|frame| frames.contains(&frame)), "{frames:?}");
}

#[test]
fn an_object_that_is_thrown_is_lost_honestly() {
    // In linear light it is found again four frames later.
    for (light_model, found_again) in [(LightModel::GreyAverages, 18), (LightModel::default(), 22)] {
        let mut scene = quiet(camera(640, 480), aside(), backdrop());
        scene.light_model = light_model;
        scene.shutter.exposure_s = 0.008;
        scene.samples = 16;
        // Held, thrown at almost 10 m/s, caught.
        let keys = [(0.0, [-1.0, -0.7, -0.3]), (0.3, [-1.0, -0.7, -0.3]), (0.5, [0.8, -0.9, 0.5]), (1.0, [0.8, -0.9, 0.5])];
        scene.objects.push(prop("ball", 41, 0.6, along(&keys, -0.2, 0.0)));
        // This one spins at two turns a second.
        scene.objects.push(prop("sign", 42, 0.6, along(&[(0.0, [-0.2, -0.8, -0.8]), (1.0, [-0.2, -0.8, -0.8])], 0.0, 12.5)));
        let samples = track(&scene, 30);
        let thrown = assert_right(&scene, &samples, 0);
        assert!((3..9).chain(found_again..30).all(|frame| thrown.contains(&frame)), "{thrown:?}");
        assert_right(&scene, &samples, 1);
        assert!(samples.iter().skip(1).all(|sample| sample.state == State::Tracking));
    }
}

#[test]
fn objects_in_front_do_not_change_the_stage_pose() {
    let bare = quiet(camera(640, 480), aside(), backdrop());
    let mut crowded = bare.clone();
    for k in 0..4 {
        let from = [-1.3 + 0.7 * f64::from(k), -0.5, -0.5 + 0.4 * f64::from(k % 2)];
        crowded.objects.push(prop(
            &format!("prop {k}"),
            60 + u64::try_from(k).unwrap(),
            0.6,
            along(&[(0.0, from), (1.0, [from[0] + 0.3, -0.7, from[2]])], 0.1, 0.2),
        ));
    }
    let rms_mm = |scene: &VirtualStage| {
        let samples = track(scene, 16);
        let late = samples
            .iter()
            .skip(4)
            .map(|s| (s.measurement.unwrap().pose.translation - scene.truth(s.timestamp.seconds()).translation).norm_squared());
        (late.sum::<f64>() / 12.0).sqrt() * 1e3
    };
    let (alone, among) = (rms_mm(&bare), rms_mm(&crowded));
    println!("the stage alone {alone:.4} mm, behind four objects {among:.4} mm");
    // The objects hide a fifth of the stage.
    assert!(among < 2.0 * alone + 0.05, "{among} {alone}");
}
