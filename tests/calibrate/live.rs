//! `calibrate --device`, with a clip played as the camera.

use super::scene::{Scene, view};

/// A clip of `count` views, each held for a quarter of a second and preceded by a frame without a
/// board.
fn clip(scene: &Scene, count: usize) {
    std::fs::create_dir(scene.path("clip")).expect("it is new");
    for k in 0..count {
        for frame in 0..8 {
            let picture = if frame == 0 { image::GrayImage::new(320, 240) } else { view(k, 0.5) };
            picture.save(scene.path(&format!("clip/{:03}.png", 8 * k + frame))).expect("it can be written");
        }
    }
}

const BOARD: [&str; 4] = ["--board", "7x5", "--square-mm", "25"];

#[test]
fn live_views_are_captured_saved_and_calibrated_like_files() {
    let scene = Scene::new(0, 0.0);
    clip(&scene, 10);
    let run = scene.run(&[&["calibrate", "--play", "clip", "--save", "taken", "--json", "live.json"], &BOARD[..]].concat());
    run.assert_success();
    let live = scene.json("live.json");
    let taken = std::fs::read_dir(scene.path("taken")).expect("it was made").count();
    assert!((6..=10).contains(&taken), "{taken}");
    assert_eq!(live["views"].as_array().map(Vec::len), Some(taken));
    assert_eq!(live["views"][0]["file"], "taken/picture-01.png");
    // Each picture taken was reported, together with what is still missing.
    let told = run.stderr.lines().filter(|line| line.starts_with("picture ") && line.contains("missing")).count();
    assert_eq!(told, taken, "{}", run.stderr);
    scene.run(&[&["calibrate", "taken", "--json", "files.json"], &BOARD[..]].concat()).assert_success();
    let files = scene.json("files.json");
    assert_eq!((&live["fx"], &live["rms_px"], &live["verdict"]), (&files["fx"], &files["rms_px"], &files["verdict"]));
}

#[test]
fn live_capture_stops_at_the_requested_number() {
    let scene = Scene::new(0, 0.0);
    clip(&scene, 8);
    scene.run(&[&["calibrate", "--play", "clip", "--save", "taken", "--pictures", "3", "--write-anyway"], &BOARD[..]].concat());
    assert_eq!(std::fs::read_dir(scene.path("taken")).expect("it was made").count(), 3);
}

#[test]
fn invalid_capture_options_are_refused_in_a_sentence() {
    let scene = Scene::new(1, 0.3);
    let refused = |arguments: &[&str], code: i32, part: &str| {
        scene.run(&[&["calibrate"], arguments, &BOARD[..]].concat()).assert_refused(code, &[part]);
    };
    refused(&["--play", "gone"], 1, "gone");
    refused(&["pictures", "--save", "taken"], 2, "give --device too");
    refused(&["--play", "pictures", "--save", "pictures"], 2, "pictures: the folder is not empty");
    refused(&["--play", "pictures", "--save", "taken"], 1, "gave no picture");
}
