//! Second copies of the stage's picture: prints beside it, smaller prints, and frames, wings and
//! masks that resemble copies but are none.

use nalgebra::{Point3, Vector3};
use stagepose::{CameraPath, PoseSample, Reason, Shake, Spline, State, SurfaceSpec, VirtualStage};

use super::scene::{FPS, backdrop, backdrop_art, camera, errors, other_art, past, quiet, rows, setup, surface, track, track_rows};

/// A camera 3.4 m in front of the stage that looks at these x over time (seconds, metres).
fn looking(at: &[(f64, f64)]) -> CameraPath {
    let targets: Vec<_> = at.iter().map(|(t, x)| (*t, Vector3::new(*x, 0.0, 0.0))).collect();
    let position = Spline::fixed(Vector3::new(0.7, -3.4, 0.1));
    CameraPath { position, target: Spline::straight(&targets).unwrap(), roll_rad: 0.01, shake: Some(Shake::new(0.002, 0.001, 2.0, 4)) }
}

/// A print of the backdrop, `share` times its size, centred at `middle`.
fn print(share: f64, middle: Vector3<f64>) -> SurfaceSpec {
    surface("print", backdrop_art(), [4.0 * share, 3.0 * share], middle, 0.0)
}

fn with_scenery(path: CameraPath, scenery: Vec<SurfaceSpec>) -> VirtualStage {
    let mut scene = quiet(camera(640, 360), path, backdrop());
    scene.scenery = scenery;
    scene
}

/// Asserts that no reported pose is wrong.
fn assert_none_wrong(scene: &VirtualStage, samples: &[PoseSample]) {
    for sample in samples.iter().filter(|s| s.state == State::Tracking) {
        let (shift, degrees) = errors(scene, sample);
        assert!(shift < 0.01 && degrees < 0.3, "frame {}: {shift} of the distance, {degrees} degrees", sample.sequence);
    }
}

fn count(samples: &[PoseSample], reason: Reason) -> usize {
    samples.iter().filter(|s| s.reason == Some(reason)).count()
}

#[test]
fn a_pan_to_a_smaller_print_is_not_tracked_as_motion() {
    let path = looking(&[(0.0, 0.2), (0.2, 0.2), (0.7, 4.2), (1.0, 4.2), (1.5, 0.4), (2.0, 0.4)]);
    let scene = with_scenery(path, vec![print(0.5, Vector3::new(3.3, 0.0, 0.1))]);
    let samples = track(&scene, (1.9 * FPS) as u64);
    assert_none_wrong(&scene, &samples);
    let jumped = count(&samples, Reason::Jumped);
    println!("{jumped} jumped");
    assert!(jumped >= 5 && samples[..6].iter().all(|s| s.state == State::Tracking));
    assert!(samples[50..].iter().all(|s| s.state == State::Tracking), "{:?}", samples[45..].iter().map(|s| s.reason).collect::<Vec<_>>());
}

#[test]
fn no_pose_is_reported_while_two_look_alikes_are_visible() {
    for share in [1.0, 0.6] {
        let path = looking(&[(0.0, 1.8), (0.4, 1.8), (0.9, -1.2), (3.0, -1.2)]);
        let mut path = path;
        path.position = Spline::fixed(Vector3::new(0.9, -4.6, 0.1));
        let scene = with_scenery(path, vec![print(share, Vector3::new(2.1 + 2.0 * share, 0.0, 0.0))]);
        let samples = track(&scene, (1.9 * FPS) as u64);
        assert_none_wrong(&scene, &samples);
        assert!(
            samples[..12].iter().all(|s| s.reason == Some(Reason::Ambiguous) && s.state == State::Searching),
            "{:?}",
            samples[..12].iter().map(|s| s.reason).collect::<Vec<_>>()
        );
        assert!(
            samples[54..].iter().all(|s| s.state == State::Tracking),
            "{:?}",
            samples[50..].iter().map(|s| s.reason).collect::<Vec<_>>()
        );
    }
}

#[test]
fn a_second_print_coming_into_view_ends_no_track() {
    let path = looking(&[(0.0, -0.5), (0.3, -0.5), (0.8, 1.2), (3.0, 1.2)]);
    let scene = with_scenery(path, vec![print(0.5, Vector3::new(3.2, 0.0, 0.0))]);
    let samples = track(&scene, 36);
    assert_none_wrong(&scene, &samples);
    assert!(samples.iter().all(|s| s.state == State::Tracking));
}

/// Frames hide borders, masks hide halves, and the scenery beside the stage has another picture;
/// none of them is a copy.
#[test]
fn scenery_hiding_the_borders_does_not_prevent_tracking() {
    let board = |x: f64, z: f64, size: [f64; 2]| surface("board", other_art(), size, Vector3::new(x, -0.05, z), 0.0);
    let frame =
        vec![board(-1.95, 0.0, [0.6, 3.4]), board(1.95, 0.0, [0.6, 3.4]), board(0.0, 1.5, [4.4, 0.5]), board(0.0, -1.5, [4.4, 0.5])];
    let half = vec![board(1.2, 0.0, [2.4, 3.4])];
    let wing = vec![board(2.9, 0.0, [1.6, 3.0]), board(-2.9, 0.0, [1.6, 3.0])];
    for scenery in [frame, half, wing] {
        let scene = with_scenery(past(), scenery);
        let samples = track(&scene, 6);
        assert_none_wrong(&scene, &samples);
        assert!(samples[1..].iter().all(|s| s.state == State::Tracking), "{:?}", samples.iter().map(|s| s.reason).collect::<Vec<_>>());
    }
}

#[test]
fn a_camera_carried_while_dark_is_found_elsewhere() {
    let keys = [(0.0, -0.9), (0.2, -0.9), (1.2, 1.0), (2.0, 1.0)].map(|(t, x)| (t, Vector3::new(x, -3.3, 0.2)));
    let path = CameraPath { position: Spline::straight(&keys).unwrap(), ..CameraPath::fixed(Point3::origin(), Point3::origin()) };
    let mut scene = with_scenery(path, Vec::new());
    scene.blackouts.push(5.5 / FPS..35.5 / FPS);
    let samples = track(&scene, 42);
    assert_none_wrong(&scene, &samples);
    assert!(samples[37..].iter().all(|s| s.state == State::Tracking), "{:?}", samples[36..].iter().map(|s| s.reason).collect::<Vec<_>>());
}

/// A quick pan at 5, 30 and 240 frames a second: 0.6 m and 40 degrees within 0.4 s.
#[test]
fn a_quick_pan_is_tracked_at_any_frame_rate() {
    for fps in [5.0, 30.0, 240.0] {
        let targets = [
            (0.0, Vector3::new(-1.4, 0.0, 0.0)),
            (0.2, Vector3::new(-1.2, 0.0, 0.0)),
            (0.6, Vector3::new(1.2, 0.0, 0.0)),
            (1.0, Vector3::new(1.4, 0.0, 0.0)),
        ];
        let keys = [
            (0.0, Vector3::new(-0.3, -3.3, 0.0)),
            (0.2, Vector3::new(-0.3, -3.3, 0.0)),
            (0.6, Vector3::new(0.3, -3.2, 0.1)),
            (1.0, Vector3::new(0.3, -3.2, 0.1)),
        ];
        let path = CameraPath { position: Spline::new(&keys).unwrap(), target: Spline::new(&targets).unwrap(), roll_rad: 0.0, shake: None };
        let scene = with_scenery(path, Vec::new());
        let mut source = stagepose::diagnostics::capture::VirtualCamera::new(scene.clone(), fps, ((0.9 * fps) as u64).min(120));
        let rows: Vec<_> = std::iter::from_fn(|| stagepose::FrameSource::next_entry(&mut source)).collect();
        let samples = track_rows(setup(&scene), &rows);
        assert_none_wrong(&scene, &samples);
        assert_eq!(count(&samples, Reason::Jumped), 0, "{fps}");
        let given = samples.iter().filter(|s| s.state == State::Tracking).count();
        assert!(given + 1 >= samples.len(), "{fps}: {given} of {}", samples.len());
    }
}

#[test]
fn a_stage_without_look_alikes_tracks_in_its_first_frame() {
    let scene = with_scenery(past(), Vec::new());
    for row in rows(&scene, 3) {
        let samples = track_rows(setup(&scene), &[row]);
        assert_eq!(samples[0].state, State::Tracking);
    }
}
