//! `stagepose map` as a user runs it: a set of which only the flat's picture is configured, walked
//! past, then tracked with its map alone.

use nalgebra::Vector3;

use super::{FPS, FRAMES, LENS, Walk, path, stage};

/// A config that knows the flat alone, where it really is.
fn know_the_flat(walk: &Walk) {
    let pose = &stage().surfaces[1].pose;
    walk.write(
        "poster.toml",
        &format!(
            "[camera]\ncalibration = \"camera.toml\"\nshutter = \"global\"\n\n[[stage.surface]] # the only one known\nimage = \"flat.png\"\n\
             size_m = [1.2, 0.9]\nposition_m = {:?}\norientation_xyzw = {:?}\n\n[tracker]\nconfirm_frames = 2\n",
            pose.translation.as_slice(),
            pose.orientation_xyzw()
        ),
    );
}

#[test]
fn a_walk_is_mapped_and_the_map_alone_gives_true_poses() {
    let walk = Walk::new();
    know_the_flat(&walk);
    let arguments = |folder: &'static str| ["map", "walk", "--config", "poster.toml", "--output", folder, "--json", "out.json"];
    let run = walk.run(&arguments("mapped"));
    run.assert_success();
    let json = walk.json("out.json");
    assert!(json["facets"].as_array().is_some_and(|facets| !facets.is_empty()), "{json}");
    assert!(["good", "usable"].contains(&json["verdict"].as_str().expect("words")), "{}", json["verdict"]);
    // The folder is complete by itself, and its config has no surface any more.
    for file in ["backdrop.png", "flat.png", "camera.toml", "stage.toml", "poster.toml"] {
        std::fs::remove_file(walk.path(file)).expect("it is there");
    }
    let config = walk.read("mapped/stage.toml");
    assert!(config.contains("[tracker]\nconfirm_frames = 2") && config.contains("# [[stage.surface]] # the only one known"), "{config}");
    walk.run(&["replay", "walk", "--config", "mapped/stage.toml", "--tum", "poses.txt"]).assert_success();
    let (mut errors_mm, path) = (Vec::new(), path());
    for line in walk.read("poses.txt").lines() {
        let numbers: Vec<f64> = line.split(' ').map(|v| v.parse().expect("a number")).collect();
        let truth = path.pose(numbers[0]).translation;
        errors_mm.push(1e3 * (Vector3::new(numbers[1], numbers[2], numbers[3]) - truth).norm());
    }
    errors_mm.sort_by(f64::total_cmp);
    let median = errors_mm[errors_mm.len() / 2];
    println!("{} of {FRAMES} frames at {FPS} Hz, {median:.3} mm median\n{}", errors_mm.len(), run.stdout);
    assert!(errors_mm.len() as u64 + 3 >= FRAMES && median < 2.0, "{median}");
}

#[test]
fn what_cannot_carry_a_map_is_refused_with_the_reason() {
    let walk = Walk::new();
    know_the_flat(&walk);
    let map = |clip: &str, config: &str| walk.run(&["map", clip, "--config", config, "--output", "mapped"]);
    let frames = super::frames();
    walk.save("still", &vec![frames[20].clone(); 6]);
    map("still", "poster.toml").assert_refused(1, &["the camera came to"]);
    // A lens that is guessed, and a stage that has a map already.
    let guess = walk.read("poster.toml").replace("calibration = \"camera.toml\"", "fov_deg = 60");
    walk.write("guess.toml", &guess);
    map("walk", "guess.toml").assert_refused(2, &["guess.toml", "stagepose calibrate"]);
    std::fs::create_dir(walk.path("mapped")).expect("it can be made");
    walk.write("mapped/mine.txt", "keep");
    map("walk", "poster.toml").assert_refused(2, &["mapped", "no earlier map wrote"]);
    assert!(walk.read("camera.toml").contains(&format!("fx = {:?}", LENS.fx)));
}
