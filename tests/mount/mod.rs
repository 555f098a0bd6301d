//! `stagepose mount` on rendered pairs of views with exact ground truth.

pub mod rig;

use std::path::Path;
use std::process::{Command, Output};

use nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde_json::Value;
use stagepose::protocols::to_body_axes;
use stagepose::{Body, Camera, Pose, Stage};

use rig::{Board, filming, filming_camera, mount, rig, tracking_camera, write};

/// Positions of the rig in metres, and its pan, tilt and roll there in degrees.
const PLACES: [([f64; 3], [f64; 3]); 6] = [
    ([0.0, -4.2, 0.0], [0.0, 0.0, 0.0]),
    ([-1.6, -3.6, 0.2], [-24.0, -2.0, 3.0]),
    ([1.7, -3.5, -0.1], [25.0, 2.0, -4.0]),
    ([0.3, -3.0, 1.0], [3.0, -17.0, 2.0]),
    ([-0.4, -2.7, -0.6], [-6.0, 11.0, -8.0]),
    ([0.9, -5.0, 0.5], [9.0, -5.0, 12.0]),
];

fn poses(places: &[([f64; 3], [f64; 3])]) -> Vec<Pose<Stage, Camera>> {
    places.iter().map(|(at, angles)| rig(*at, *angles)).collect()
}

fn run(folder: &Path, more: &[&str]) -> Output {
    let arguments = ["mount", "--config", "a.toml", "--clip", "a", "--with", "b.toml", "--clip", "b"];
    Command::new(env!("CARGO_BIN_EXE_stagepose")).args(arguments).args(more).current_dir(folder).env_remove("RUST_LOG").output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

/// Returns the true mount between the cameras' bodies, as the config has it.
fn true_mount() -> Pose<Body, Body> {
    let axes = to_body_axes(&Pose::identity()).rotation.inverse();
    Pose::new(axes * mount().rotation * axes.inverse(), axes * mount().translation)
}

/// Returns the errors of a result in millimetres and degrees, and its squared error normalised by
/// the stated covariance and six degrees of freedom.
fn off(told: &Value) -> (f64, f64, f64) {
    let (offset, q) = (Vector3::from_vec(numbers(&told["offset_m"])), numbers(&told["orientation_xyzw"]));
    let rotation = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q[3], q[0], q[1], q[2]));
    let (shift, rotation) = (true_mount().translation - offset, (true_mount().rotation * rotation.inverse()).scaled_axis());
    let e = Vector6::new(shift.x, shift.y, shift.z, rotation.x, rotation.y, rotation.z);
    let covariance = Matrix6::from_row_slice(&numbers(&told["covariance"]));
    (shift.norm() * 1e3, rotation.norm().to_degrees(), e.dot(&(covariance.try_inverse().unwrap() * e)) / 6.0)
}

fn json(folder: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(folder.join("mount.json")).unwrap()).unwrap()
}

#[test]
fn six_view_pairs_solve_the_mount_and_check_the_typed_one() {
    let folder = tempfile::tempdir().unwrap();
    let (folder, board, tracking) = (folder.path(), Board::new(3), poses(&PLACES));
    write(folder, "a", tracking_camera(), &board, &tracking);
    write(folder, "b", filming_camera(), &board, &tracking.iter().map(filming).collect::<Vec<_>>());
    let config = std::fs::read_to_string(folder.join("a.toml")).unwrap();
    // Values as from a tape measure, then values that are two centimetres off.
    let o = true_mount().translation;
    let angles = stagepose::protocols::PanTiltRoll::of_rotation(&true_mount().rotation, 0.0);
    let typed = |up: f64| {
        let rotation = format!("[{:.2}, {:.2}, {:.2}]", angles.pan_deg, angles.tilt_deg, angles.roll_deg);
        format!("{config}[mount]\nname = \"A-cam\"\noffset_m = [{:.3}, {:.3}, {:.3}]\nrotation_deg = {rotation}\n", o.x, o.y, o.z + up)
    };
    std::fs::write(folder.join("a.toml"), typed(0.0)).unwrap();
    let told = run(folder, &["--json", "mount.json"]);
    assert_eq!(told.status.code(), Some(0), "{}{}", text(&told.stdout), text(&told.stderr));
    let said = text(&told.stdout);
    let (mm, degrees, nees) = off(&json(folder));
    println!("{said}\noff by {mm:.3} mm, {degrees:.4} degrees, NEES/6 {nees:.2}");
    assert!(mm <= 1.0 && degrees <= 0.05, "{mm} mm, {degrees} degrees: {said}");
    // In one trial with six degrees of freedom, NEES/6 exceeds 3.7 once in a thousand.
    assert!(nees < 3.7, "{nees}: {said}");
    assert!(said.contains("6 pairs of views, 6 measured by both cameras, 6 used") && said.contains("verdict   good"), "{said}");
    assert!(said.contains("its [mount] agrees with the measurement"), "{said}");
    // The printed section works where it is printed for, and is the same mount.
    let section = &said[said.find("[mount]\nname").unwrap()..];
    std::fs::write(folder.join("c.toml"), format!("{config}{section}")).unwrap();
    let check = Command::new(env!("CARGO_BIN_EXE_stagepose")).args(["check", "--config", "c.toml"]).current_dir(folder).output().unwrap();
    assert!(
        check.status.success() && text(&check.stdout).contains("A-cam on the camera: "),
        "{}{}",
        text(&check.stdout),
        text(&check.stderr)
    );
    assert!(text(&check.stdout).contains("its lens: 960 x 540 pixels"), "{}", text(&check.stdout));
    std::fs::write(folder.join("a.toml"), typed(0.02)).unwrap();
    // One pair fewer is still enough to find the error.
    for clip in ["a", "b"] {
        std::fs::remove_file(folder.join(clip).join("005.png")).unwrap();
    }
    let said = text(&run(folder, &[]).stdout);
    assert!(said.contains("differs from the measurement by ") && said.contains(" (right ") && said.contains("up +2"), "{said}");
}

#[test]
fn one_pair_reports_its_uncertainty_and_the_missing_view() {
    let folder = tempfile::tempdir().unwrap();
    let (folder, board) = (folder.path(), Board::new(4));
    let tracking = poses(&PLACES[..2]);
    let mut seen: Vec<_> = tracking.iter().map(filming).collect();
    // In the second view, the filming camera looks away.
    seen[1].rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 2.0) * seen[1].rotation;
    write(folder, "a", tracking_camera(), &board, &tracking);
    write(folder, "b", filming_camera(), &board, &seen);
    let told = run(folder, &["--json", "mount.json"]);
    let said = text(&told.stdout);
    assert_eq!(told.status.code(), Some(0), "{said}{}", text(&told.stderr));
    assert!(said.contains("picture 2: the filming camera does not find its stage"), "{said}");
    assert!(said.contains("one pair of views only: nothing verifies it"), "{said}");
    assert!(said.contains("next      take a pair of views from") && said.contains(": then about "), "{said}");
    let (mm, degrees, nees) = off(&json(folder));
    assert!(nees < 3.7 && mm < 20.0 && degrees < 0.5, "{mm} mm, {degrees} degrees, NEES/6 {nees}: {said}");
}

/// Frames of a film while the rig stands still, and while it is carried on.
const STANDING_FRAMES: usize = 12;
const CARRIED_FRAMES: usize = 5;

/// Returns what a camera films of a rig that is carried from place to place. Each film has its own
/// number of frames at the start and at the end.
fn filmed(places: &[Pose<Stage, Camera>], first: usize, last: usize) -> Vec<Pose<Stage, Camera>> {
    let mut film = vec![places[0]; first];
    for (k, place) in places.iter().enumerate() {
        film.extend([*place; STANDING_FRAMES]);
        let Some(next) = places.get(k + 1) else { continue };
        film.extend((1..=CARRIED_FRAMES).map(|i| {
            let share = i as f64 / (CARRIED_FRAMES + 1) as f64;
            Pose::new(place.rotation.slerp(&next.rotation, share), place.translation.lerp(&next.translation, share))
        }));
    }
    film.extend(vec![places[places.len() - 1]; last]);
    film
}

#[test]
fn films_are_paired_by_counting_their_standstills() {
    let folder = tempfile::tempdir().unwrap();
    let (folder, board, tracking) = (folder.path(), Board::new(6), poses(&PLACES[..3]));
    let seen: Vec<_> = tracking.iter().map(filming).collect();
    write(folder, "a", tracking_camera(), &board, &filmed(&tracking, 0, 4));
    write(folder, "b", filming_camera(), &board, &filmed(&seen, 7, 0));
    let told = run(folder, &["--json", "mount.json"]);
    let said = text(&told.stdout);
    assert_eq!(told.status.code(), Some(0), "{said}{}", text(&told.stderr));
    assert!(said.contains("3 pairs of views, 3 measured by both cameras, 3 used"), "{said}");
    let (mm, degrees, nees) = off(&json(folder));
    assert!(mm <= 1.5 && degrees <= 0.05 && nees < 3.7, "{mm} mm, {degrees} degrees, NEES/6 {nees}: {said}");
}

#[test]
fn a_guessed_lens_adds_its_uncertainty_to_the_mount() {
    let folder = tempfile::tempdir().unwrap();
    let (folder, board, tracking) = (folder.path(), Board::new(7), poses(&PLACES));
    let sigma = |told: &Value| numbers(&told["covariance"]).iter().step_by(7).take(3).sum::<f64>().sqrt();
    write(folder, "a", tracking_camera(), &board, &tracking);
    write(folder, "b", filming_camera(), &board, &tracking.iter().map(filming).collect::<Vec<_>>());
    let told = run(folder, &["--json", "mount.json"]);
    assert_eq!(told.status.code(), Some(0), "{}{}", text(&told.stdout), text(&told.stderr));
    let calibrated = sigma(&json(folder));
    // The true angle is 61.3 degrees; a data sheet rounds it.
    let config = std::fs::read_to_string(folder.join("a.toml")).unwrap();
    let guessed = config.replace("calibration = \"a-camera.toml\"", "width = 640\nheight = 480\nfov_deg = 60");
    assert_ne!(config, guessed);
    std::fs::write(folder.join("a.toml"), guessed).unwrap();
    std::fs::remove_file(folder.join("mount.json")).unwrap();
    let told = run(folder, &["--json", "mount.json"]);
    let said = text(&told.stdout);
    let (told_m, (mm, degrees, nees)) = (sigma(&json(folder)), off(&json(folder)));
    println!("{said}\noff by {mm:.3} mm, {degrees:.4} degrees, NEES/6 {nees:.2}, sigma {told_m} m instead of {calibrated}");
    assert!(
        said.contains("most of the uncertainty is the calibrations', which more views do not reduce: calibrate both cameras"),
        "{said}"
    );
    // Decimetres: nothing to show a renderer, and no view is asked for that would not help.
    assert!(said.contains("verdict   do not use") && !said.contains("next      "), "{said}");
    assert!(text(&told.stderr).contains("calibrate both cameras with `stagepose calibrate`"), "{}", text(&told.stderr));
    assert_eq!(told.status.code(), Some(1), "{said}");
    assert!(told_m > 5.0 * calibrated && nees < 3.7, "{told_m} {calibrated} NEES/6 {nees}: {said}");
}

/// Returns where the filming camera's own stage is in the tracking camera's. The rig stands about
/// 3.5 m from the two boards.
fn boards_apart() -> Pose<Stage, Stage> {
    Pose::new(UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -0.3), Vector3::new(1.2, 0.4, 0.2))
}

fn on_own_boards(rotations: &[[f64; 3]]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = [0.0, -3.6, 0.1];
    let tracking: Vec<_> = rotations.iter().map(|angles| rig(at, *angles)).collect();
    let seen: Vec<_> = tracking.iter().map(|pose| boards_apart().inverse() * filming(pose)).collect();
    write(folder.path(), "a", tracking_camera(), &Board::new(5), &tracking);
    write(folder.path(), "b", filming_camera(), &Board::new(6), &seen);
    folder
}

#[test]
fn own_boards_need_rotations_about_two_axes() {
    let panned = on_own_boards(&[-15.0, -8.0, 0.0, 8.0, 15.0].map(|pan| [pan, 0.0, 0.0]));
    let refused = run(panned.path(), &["--own-boards"]);
    let said = text(&refused.stderr);
    assert_eq!(refused.status.code(), Some(1), "{said}");
    for part in ["the rig turned about one axis only (it was panned)", "tilted or rolled", "omit --own-boards"] {
        assert!(said.contains(part), "{said}");
    }
    let rotations = [[0.0, 0.0, 0.0], [-14.0, 3.0, 0.0], [13.0, -4.0, 15.0], [0.0, 12.0, -15.0], [-3.0, -12.0, 20.0], [8.0, 8.0, -25.0]];
    let told = on_own_boards(&rotations);
    let output = run(told.path(), &["--own-boards", "--json", "mount.json"]);
    assert_eq!(output.status.code(), Some(0), "{}{}", text(&output.stdout), text(&output.stderr));
    let (mm, degrees, nees) = off(&json(told.path()));
    println!("own boards: off by {mm:.3} mm, {degrees:.4} degrees, NEES/6 {nees:.2}");
    assert!(mm < 20.0 && degrees < 0.5 && nees < 3.7, "{mm} mm, {degrees} degrees, NEES/6 {nees}: {}", text(&output.stdout));
}

#[test]
fn mismatched_mount_inputs_are_refused_with_a_hint() {
    let folder = tempfile::tempdir().unwrap();
    let (folder, board) = (folder.path(), Board::new(7));
    let tracking = poses(&PLACES[..3]);
    write(folder, "a", tracking_camera(), &board, &tracking);
    write(folder, "b", filming_camera(), &board, &tracking[..2].iter().map(filming).collect::<Vec<_>>());
    let refused = |more: &[&str], parts: &[&str]| {
        let output = run(folder, more);
        let said = text(&output.stderr);
        assert!(parts.iter().all(|part| said.contains(part)) && !said.contains("panicked"), "{said}");
        output.status.code()
    };
    assert_eq!(refused(&[], &["a has 3 pictures", "b has 2", "one picture for each view in the same order"]), Some(1));
    assert_eq!(refused(&["--clip", "b"], &["--clip is there 3 times"]), Some(2));
    assert_eq!(refused(&["--json", "a.toml"], &["--json"]), Some(2));
    // Neither clip shows its stage.
    std::fs::remove_file(folder.join("a/002.png")).unwrap();
    for name in ["a", "b"] {
        Board::new(99).art.save(folder.join(format!("{name}-board.png"))).unwrap();
    }
    let parts = ["both cameras see their stage in 0 of 2 pairs of views, 1 are needed", "picture 1: neither camera finds its stage"];
    assert_eq!(refused(&[], &parts), Some(1));
}

/// Random rigs, each with three random views: the reported mount is as accurate as its covariance
/// says. `STAGEPOSE_RIGS=20` tries more rigs than the two of a normal run.
#[test]
fn the_stated_mount_sigma_matches_the_error() {
    let trials: u64 = std::env::var("STAGEPOSE_RIGS").ok().and_then(|n| n.parse().ok()).unwrap_or(2);
    let (mut sum, mut worst) = (0.0, [0.0_f64; 2]);
    for trial in 0..trials {
        let mut random = Pcg64Mcg::seed_from_u64(trial);
        let mut near = |size: f64| random.random_range(-size..=size);
        // From anywhere, looking roughly at the middle.
        let place = |_| {
            let at = [near(1.6), -4.0 + near(0.9), near(0.8)];
            // y points upstage and the rig is downstage, so from the right it pans to the left, and
            // from above it tilts down.
            let [pan, tilt] = [-at[0] / at[1], at[2] / at[1]].map(|slope: f64| slope.atan().to_degrees());
            (at, [pan + near(5.0), tilt + near(4.0), near(15.0)])
        };
        let tracking = poses(&(0..3).map(place).collect::<Vec<_>>());
        let (folder, board) = (tempfile::tempdir().unwrap(), Board::new(100 + trial));
        write(folder.path(), "a", tracking_camera(), &board, &tracking);
        write(folder.path(), "b", filming_camera(), &board, &tracking.iter().map(filming).collect::<Vec<_>>());
        let output = run(folder.path(), &["--json", "mount.json"]);
        assert_eq!(output.status.code(), Some(0), "{}{}", text(&output.stdout), text(&output.stderr));
        let (mm, degrees, nees) = off(&json(folder.path()));
        println!("rig {trial}: off by {mm:.3} mm, {degrees:.4} degrees, NEES/6 {nees:.2}");
        worst = [worst[0].max(mm), worst[1].max(degrees)];
        sum += nees / trials as f64;
    }
    println!("of {trials} rigs: NEES/6 {sum:.2}, worst {:.3} mm, {:.4} degrees", worst[0], worst[1]);
    // The mean of 6 n squared normal numbers has a standard deviation of sqrt(2 / 6 n). The limit
    // allows five of those, plus a quarter for errors that are not noise.
    assert!(sum < 1.25 + 5.0 * (2.0 / (6.0 * trials as f64)).sqrt(), "NEES/6 {sum}");
    assert!(worst[0] <= 1.0 && worst[1] <= 0.05, "{worst:?}");
}
