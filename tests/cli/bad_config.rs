//! `check` and `replay` refuse every bad config with exit code 2 and a sentence that names the
//! file, the line and the fix.

use super::scene::{CAMERA, CONFIG, Scene};

/// Asserts that both commands refuse the scene's config in the same words.
fn assert_refused(scene: &Scene, parts: &[&str]) {
    let check = scene.run(&["check", "--config", "stage.toml"]);
    check.assert_refused(2, parts);
    assert!(check.stdout.is_empty());
    scene.replay(&["--poses", "poses.jsonl"]).assert_refused(2, parts);
    assert!(!scene.path("poses.jsonl").exists(), "an output was created for a config that is no good");
}

#[test]
fn no_config_file() {
    let scene = Scene::new();
    scene.run(&["check", "--config", "none.toml"]).assert_refused(2, &["none.toml: the config cannot be read (No such file"]);
}

#[test]
fn unknown_key() {
    let scene = Scene::new();
    scene.config_with("calibration", "calibraton");
    assert_refused(&scene, &["stage.toml: unknown key `calibraton` in [camera], line 2; did you mean `calibration`?"]);
}

#[test]
fn unknown_section() {
    let scene = Scene::new();
    scene.write("stage.toml", &format!("{CONFIG}[recoder]\n"));
    assert_refused(&scene, &["unknown section [recoder], line 6; did you mean `recorder`?"]);
}

#[test]
fn missing_picture() {
    let scene = Scene::new();
    scene.config_with("art.png", "none.png");
    assert_refused(&scene, &["`image` in [[stage.surface]], line 4: none.png: No such file", "; name a readable"]);
}

#[test]
fn flat_picture() {
    let scene = Scene::new();
    scene.config_with("art.png", "flat.png");
    assert_refused(
        &scene,
        &["`image` in [[stage.surface]], line 4: flat.png: the picture has too little texture", "; use a picture with more detail"],
    );
}

#[test]
fn truncated_picture() {
    let scene = Scene::new();
    scene.truncate("art.png", 3000);
    assert_refused(&scene, &["`image` in [[stage.surface]], line 4: art.png: "]);
}

#[test]
fn size_of_zero() {
    let scene = Scene::new();
    scene.config_with("[4.0, 3.0]", "[4.0, 0.0]");
    assert_refused(&scene, &["`size_m` in [[stage.surface]], line 5: [4.0, 0.0] cannot be used; give a width and a height above 0 metres"]);
}

#[test]
fn corners_not_convex() {
    let scene = Scene::new();
    scene.config_with("image = \"art.png\"", "photo = \"art.png\"\ncorners_px = [[10, 10], [600, 12], [100, 100], [20, 450]]");
    assert_refused(
        &scene,
        &["`corners_px` in [[stage.surface]], line 5: art.png: corners_px is not a convex quadrilateral; give top left"],
    );
}

#[test]
fn nan_and_negative_focal_length() {
    let scene = Scene::new();
    scene.write("camera.toml", &CAMERA.replace("fx = 300.0", "fx = nan"));
    assert_refused(&scene, &["`calibration` in [camera], line 2: ", "camera.toml", "fx", "NaN"]);
    scene.write("camera.toml", &CAMERA.replace("fy = 300.0", "fy = -300.0"));
    assert_refused(&scene, &["`calibration` in [camera], line 2: ", "camera.toml", "fy", "-300"]);
}

#[test]
fn missing_calibration() {
    let scene = Scene::new();
    scene.config_with("calibration = \"camera.toml\"\n", "");
    assert_refused(&scene, &["[camera], line 1, has no `calibration`; add calibration = \"camera.toml\""]);
    scene.config_with("camera.toml", "none.toml");
    assert_refused(&scene, &["`calibration` in [camera], line 2: ", "none.toml"]);
}

#[test]
fn calibration_of_another_shape() {
    let scene = Scene::new();
    scene.write("camera.toml", &CAMERA.replace("height = 240", "height = 180"));
    let parts = ["the calibration is for 320 x 180 pixels, the pictures are 320 x 240", "calibrate at this size"];
    scene.replay(&[]).assert_refused(2, &parts);
    scene.run(&["check", "--config", "stage.toml", "--clip", "clip"]).assert_refused(2, &parts);
}

#[test]
fn a_calibration_of_the_same_aspect_ratio_is_scaled() {
    let scene = Scene::new();
    let doubled =
        "width = 640\nheight = 480\nfx = 600.0\nfy = 600.0\ncx = 319.5\ncy = 239.5\nskew = 0.0\ndistortion = [0.0, 0.0, 0.0, 0.0, 0.0]\n";
    scene.write("camera.toml", doubled);
    let run = scene.replay(&[]);
    run.assert_success();
    assert!(run.stderr.contains("the calibration for 640 x 480 pixels is scaled to the pictures' 320 x 240"), "{}", run.stderr);
    let check = scene.run(&["check", "--config", "stage.toml", "--clip", "clip"]);
    check.assert_success();
    assert!(check.stdout.contains("note        the calibration for 640 x 480 pixels is scaled"), "{}", check.stdout);
}
