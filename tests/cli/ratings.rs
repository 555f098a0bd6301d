//! How `check` rates pictures, as a user sees it.

use super::scene::{CONFIG, Scene};

/// Writes the config with one object per picture, each 1.2 m wide.
fn with_objects(scene: &Scene, pictures: &[(&str, &str)]) {
    let object = |(name, image): &(&str, &str)| {
        format!("[[object]]\nname = \"{name}\"\n[[object.surface]]\nimage = \"{image}\"\nsize_m = [1.2, 0.9]\n")
    };
    scene.write("stage.toml", &(CONFIG.to_owned() + &pictures.iter().map(object).collect::<String>()));
}

/// Writes a different picture of the same kind: the scene's own, upside down and inverted.
fn write_other(scene: &Scene, name: &str) {
    let mut other = image::imageops::rotate180(&image::open(scene.path("art.png")).unwrap().into_luma8());
    image::imageops::invert(&mut other);
    other.save(scene.path(name)).unwrap();
}

#[test]
fn ratings_are_printed_and_drawn() {
    let scene = Scene::new();
    write_other(&scene, "other.png");
    with_objects(&scene, &[("a/b", "other.png")]);
    let plain = scene.run(&["check", "--config", "stage.toml"]);
    plain.assert_success();
    assert_eq!(plain.stdout.matches("of 5 for tracking").count(), 2, "{}", plain.stdout);
    assert!(!plain.stdout.contains("# plenty"), "{}", plain.stdout);

    let drawn = scene.run(&["check", "--config", "stage.toml", "--ratings", "maps"]);
    drawn.assert_success();
    assert_eq!(drawn.stdout.matches("# plenty").count(), 2, "{}", drawn.stdout);
    for name in ["rating-stage-1.png", "rating-a_b-1.png"] {
        let map = image::open(scene.path("maps").join(name)).unwrap().into_rgb8();
        assert!(map.pixels().any(|p| p[0] != p[1]), "{name} has no colour");
    }
}

#[test]
fn two_objects_with_one_picture_are_refused() {
    let scene = Scene::new();
    write_other(&scene, "other.png");
    with_objects(&scene, &[("left", "other.png"), ("right", "other.png")]);
    let parts = ["other.png of left and other.png of right show the same picture", "give each its own"];
    scene.run(&["check", "--config", "stage.toml"]).assert_refused(1, &parts);
}

#[test]
fn a_sign_with_one_picture_on_both_sides_is_refused() {
    let scene = Scene::new();
    write_other(&scene, "other.png");
    with_objects(&scene, &[("sign", "other.png")]);
    let back =
        "[[object.surface]]\nimage = \"other.png\"\nsize_m = [1.2, 0.9]\nposition_m = [0, 0, -0.02]\norientation_xyzw = [0, 1, 0, 0]\n";
    scene.write("stage.toml", &(std::fs::read_to_string(scene.path("stage.toml")).unwrap() + back));
    let parts = ["every surface of sign shows the picture of another one", "other.png", "give each its own"];
    scene.run(&["check", "--config", "stage.toml"]).assert_refused(1, &parts);
    // With a second surface that is unambiguous, the object can be found.
    image::imageops::flip_horizontal(&image::open(scene.path("other.png")).unwrap()).save(scene.path("edge.png")).unwrap();
    let edge = "[[object.surface]]\nimage = \"edge.png\"\nsize_m = [1.2, 0.9]\nposition_m = [2, 0, 0]\norientation_xyzw = [0, 0, 0, 1]\n";
    scene.write("stage.toml", &(std::fs::read_to_string(scene.path("stage.toml")).unwrap() + edge));
    scene.run(&["check", "--config", "stage.toml"]).assert_success();
}

#[test]
fn rating_maps_never_overwrite_inputs() {
    let scene = Scene::new();
    std::fs::rename(scene.path("art.png"), scene.path("rating-stage-1.png")).unwrap();
    scene.config_with("art.png", "rating-stage-1.png");
    let before = std::fs::read(scene.path("rating-stage-1.png")).unwrap();
    scene
        .run(&["check", "--config", "stage.toml", "--ratings", "."])
        .assert_refused(2, &["--ratings", "rating-stage-1.png", "a file of the config"]);
    assert_eq!(std::fs::read(scene.path("rating-stage-1.png")).unwrap(), before);
    scene.write("taken", "");
    scene.run(&["check", "--config", "stage.toml", "--ratings", "taken"]).assert_refused(1, &["taken"]);
}

#[test]
fn maps_are_never_written_into_a_clip() {
    let scene = Scene::new();
    std::fs::create_dir_all(scene.path("pictures/more")).unwrap();
    std::fs::copy(scene.path("art.png"), scene.path("pictures/0.png")).unwrap();
    let check = |folder: &str, more: &[&str]| scene.run(&[&["check", "--config", "stage.toml", "--ratings", folder][..], more].concat());
    for folder in ["clip", "clip/frames", "./clip/maps", "clip/frames/0000"] {
        check(folder, &[]).assert_refused(2, &["--ratings", folder, "inside the clip", "give another folder"]);
    }
    // A folder of pictures counts as a clip once it is named as one.
    for folder in ["pictures", "pictures/more", "pictures/maps"] {
        check(folder, &["--clip", "pictures", "--fps", "30"]).assert_refused(2, &["inside the clip", "give another folder"]);
    }
    assert!(!scene.path("clip/maps").exists() && !scene.path("pictures/maps").exists());
    // A folder next to a clip is not inside it.
    check(".", &[]).assert_success();
    assert!(scene.path("rating-stage-1.png").exists());
}
