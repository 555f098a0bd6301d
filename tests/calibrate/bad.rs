//! Bad input yields one sentence and an exit code, and overwrites nothing.

use image::{GrayImage, Luma, imageops};

use super::scene::{Scene, view};
use crate::cli::scene::texture;

/// Writes output files that must survive.
fn keep(scene: &Scene) {
    for name in ["camera.toml", "out.json", "report.html"] {
        std::fs::write(scene.path(name), "kept").unwrap();
    }
}

const OUTPUTS: [&str; 6] = ["--output", "camera.toml", "--json", "out.json", "--report", "report.html"];

#[track_caller]
fn assert_kept(scene: &Scene) {
    for name in ["camera.toml", "out.json", "report.html"] {
        assert_eq!(scene.read(name), "kept", "{name}");
    }
}

#[test]
fn pictures_without_a_board() {
    let scene = Scene::new(0, 0.0);
    for k in 0..3 {
        texture(320, 240 + k).save(scene.path(&format!("pictures/{k}.png"))).unwrap();
    }
    GrayImage::from_pixel(320, 240, Luma([3])).save(scene.path("pictures/dark.png")).unwrap();
    keep(&scene);
    scene
        .calibrate(&OUTPUTS)
        .assert_refused(1, &["none of the 4 pictures shows the whole board of 7x5 inner corners", "pictures/0.png: no chessboard"]);
    let run = scene.run(&["calibrate", "pictures/dark.png", "--board", "7x5", "--square-mm", "25"]);
    run.assert_refused(1, &["the picture is dark"]);
    assert_kept(&scene);
}

#[test]
fn a_wrong_board_size_gets_the_right_one_suggested() {
    let scene = Scene::new(4, 0.4);
    keep(&scene);
    let base = ["calibrate", "pictures", "--square-mm", "25", "--board", "9x6"];
    scene.run(&[&base[..], &OUTPUTS].concat()).assert_refused(1, &["show one of 7x5 inner corners", "give --board 7x5"]);
    // Counting squares instead of inner corners is a common slip.
    scene.run(&["calibrate", "pictures", "--square-mm", "25", "--board", "8x6"]).assert_refused(1, &["give --board 7x5"]);
    assert_kept(&scene);
}

#[test]
fn pictures_of_several_sizes() {
    let scene = Scene::new(5, 0.4);
    let larger = imageops::resize(&view(2, 0.4), 640, 480, imageops::FilterType::Triangle);
    larger.save(scene.path("pictures/02.png")).unwrap();
    keep(&scene);
    scene
        .calibrate(&OUTPUTS)
        .assert_refused(1, &["pictures/00.png is 320 x 240 pixels", "pictures/02.png is 640 x 480", "one camera at one size"]);
    assert_kept(&scene);
}

#[test]
fn too_few_views() {
    let scene = Scene::new(2, 0.4);
    std::fs::write(scene.path("pictures/02.png"), b"no picture").unwrap();
    keep(&scene);
    scene.calibrate(&OUTPUTS).assert_refused(1, &["only 2 of 3 pictures can be used", "pictures/02.png", "take at least 10"]);
    // Copies of one view count as one view.
    for k in 0..6 {
        view(0, 0.4).save(scene.path(&format!("pictures/{k:02}.png"))).unwrap();
    }
    scene.calibrate(&OUTPUTS).assert_refused(1, &["only 1 of 6 pictures can be used", "the same view"]);
    assert_kept(&scene);
}

#[test]
fn views_from_one_direction_write_no_camera() {
    let scene = Scene::new(8, 0.03);
    keep(&scene);
    let run = scene.calibrate(&OUTPUTS);
    run.assert_refused(1, &["do not use, because", "one direction", "camera.toml is not written", "take next: "]);
    assert_eq!(scene.read("camera.toml"), "kept");
    // The JSON output is written all the same.
    assert_eq!(scene.json("out.json")["verdict"], "do not use");
    scene.calibrate(&["--output", "camera.toml", "--write-anyway"]).assert_success();
    assert!(scene.read("camera.toml").contains("fx = "));
}

#[test]
fn unreadable_files() {
    let scene = Scene::new(0, 0.0);
    std::fs::write(scene.path("pictures/a.png"), b"").unwrap();
    std::fs::write(scene.path("pictures/b.jpg"), b"GIF89a").unwrap();
    scene.calibrate(&[]).assert_refused(1, &["none of the 2 pictures can be read", "pictures/a.png: the picture is empty"]);
    scene.run(&["calibrate", "gone.png", "--board", "7x5", "--square-mm", "25"]).assert_refused(1, &["gone.png: cannot be read"]);
    // Among good pictures, unreadable ones are reported and skipped.
    let scene = Scene::new(8, 0.5);
    let whole = std::fs::read(scene.path("pictures/03.png")).unwrap();
    std::fs::write(scene.path("pictures/03.png"), &whole[..whole.len() / 2]).unwrap();
    let run = scene.calibrate(&["--json", "out.json"]);
    run.assert_success();
    assert!(run.stdout.contains("not used: pictures/03.png: the picture is cut off"), "{}", run.stdout);
    assert_eq!(scene.json("out.json")["views"][3]["found"], false);
}

#[test]
fn bad_usage_exits_with_code_2() {
    let scene = Scene::new(1, 0.4);
    let refused = |arguments: &[&str], parts: &[&str]| scene.run(&[&["calibrate"], arguments].concat()).assert_refused(2, parts);
    refused(&["pictures", "--board", "7x5", "--square-mm", "0"], &["--square-mm is 0"]);
    refused(&["pictures", "--board", "7x5", "--square-mm", "-3"], &["--square-mm is -3"]);
    refused(&["pictures", "--board", "7by5", "--square-mm", "25"], &["--board is \"7by5\"", "INNER corners"]);
    refused(&["pictures", "--board", "2x5", "--square-mm", "25"], &["from 3 to 100"]);
    refused(&["pictures", "--square-mm", "25"], &["--board is missing"]);
    refused(&["pictures", "--board", "7x5"], &["--square-mm is missing"]);
    refused(&["--board", "7x5", "--square-mm", "25"], &["there are no pictures"]);
    refused(&["pictures", "--board", "7x5", "--square-mm", "25", "--fix", "k9"], &["--fix k9", "fx, fy, cx"]);
    refused(&["pictures", "--board", "7x5", "--square-mm", "25", "--fix", "fx"], &["--fix fx=VALUE"]);
    refused(&["pictures", "--board", "7x5", "--square-mm", "25", "--compare", "gone.yaml"], &["gone.yaml"]);
}

#[test]
fn an_output_that_cannot_be_written() {
    let scene = Scene::new(4, 0.4);
    scene.calibrate(&["--output", "gone/camera.toml"]).assert_refused(1, &["gone/camera.toml: cannot be written"]);
    scene.calibrate(&["--json", "pictures"]).assert_refused(1, &["pictures: cannot be written"]);
}
