//! A surface without detail is left out if others have detail: the config is accepted, the others
//! are tracked, and their places in the records stay the same.

use serde_json::Value;

use super::scene::{Scene, records};

const CAMERA: &str = "[camera]\ncalibration = \"camera.toml\"\n";
const PLAIN: &str = "[[stage.surface]]\nimage = \"flat.png\"\nsize_m = [2.0, 1.5]\nposition_m = [0.3, 1.0, 0.2]\n";
const PLAIN_PHOTO: &str = "[[stage.surface]]\nphoto = \"flat.png\"\ncorners_px = [[100, 100], [500, 110], [490, 400], [110, 390]]\n\
    size_m = [2.0, 1.5]\nposition_m = [0.3, 1.0, 0.2]\n";
const ART: &str = "[[stage.surface]]\nimage = \"art.png\"\nsize_m = [4.0, 3.0]\n";

/// Replays the scene with a stage of these sections and returns its records. The first one may
/// still await confirmation.
fn replayed(scene: &Scene, sections: &[&str]) -> Vec<Value> {
    scene.write("stage.toml", &[&[CAMERA], sections].concat().concat());
    let run = scene.replay(&["--poses", "poses.jsonl"]);
    run.assert_success();
    let is_warned = run.stderr.contains("flat.png: it has too little texture to be found and is left out");
    assert_eq!(is_warned, sections.len() > 1, "{}", run.stderr);
    records(scene)
}

fn position(record: &Value) -> [f64; 3] {
    std::array::from_fn(|k| record["pose"]["position_m"][k].as_f64().unwrap())
}

#[test]
fn a_plain_first_surface_keeps_its_place() {
    let scene = Scene::new();
    let alone = replayed(&scene, &[ART]);
    for plain in [PLAIN, PLAIN_PHOTO] {
        let beside = replayed(&scene, &[plain, ART]);
        assert!(beside.iter().filter(|r| r["state"] == "tracking").count() >= 4, "{beside:?}");
        for (a, b) in alone.iter().zip(&beside).filter(|(_, b)| b["state"] == "tracking") {
            let apart = position(a).iter().zip(position(b)).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
            assert!(apart < 0.02, "{apart} m apart: {b}");
            // The homography belongs to the first surface, which is not seen. The essential matrix
            // refers to that surface's reference camera, whose pose is known.
            assert!(b["homography"].is_null() && b["essential"]["rotation_xyzw"].is_array(), "{b}");
        }
    }
}

#[test]
fn a_later_plain_surface_does_not_affect_the_first() {
    let scene = Scene::new();
    let records = replayed(&scene, &[ART, PLAIN]);
    assert!(records.iter().filter(|r| r["homography"].is_array()).count() >= 4, "{records:?}");
}

#[test]
fn a_stage_of_plain_surfaces_only_is_refused() {
    let scene = Scene::new();
    scene.write("stage.toml", &[CAMERA, PLAIN, PLAIN_PHOTO].concat());
    scene.replay(&[]).assert_refused(2, &["flat.png", "too little texture", "line 4"]);
}
