//! `compare-poses` and `freeze`: another tracker beside this one, and a camera that stands still.

use std::fmt::Write;

use nalgebra::{UnitQuaternion, Vector3};
use serde_json::Value;

use super::scene::{Run, Scene, records};

/// The rig at a time: it moves and turns about all axes, not periodically.
fn rig(t: f64) -> (Vector3<f64>, UnitQuaternion<f64>) {
    let sway = |size: f64, hz: f64, phase: f64| size * (std::f64::consts::TAU * hz * t + phase).sin();
    let angles = [sway(0.1, 0.31, 0.0) + sway(0.05, 0.83, 1.0), sway(0.08, 0.47, 2.0), sway(0.3, 0.23, 0.5) + sway(0.12, 0.71, 0.0)];
    let position = Vector3::new(sway(0.6, 0.19, 0.0), -4.0 + sway(0.3, 0.29, 1.0), 1.6 + sway(0.1, 0.41, 0.0));
    (position, UnitQuaternion::from_euler_angles(angles[0], angles[1], angles[2]))
}

fn record(t: f64) -> String {
    let (p, q) = rig(t);
    let q = q.coords;
    let pose = format!("{{\"position_m\":[{},{},{}],\"orientation_xyzw\":[{},{},{},{}]}}", p.x, p.y, p.z, q.x, q.y, q.z, q.w);
    format!("{{\"sequence\":0,\"timestamp_ns\":{},\"state\":\"tracking\",\"pose\":{pose},\"measured\":{pose}}}\n", (t * 1e9) as i64)
}

/// Another tracker in a frame and with a sensor of its own, whose stamps are 41 ms late, and whose
/// x is off by a little ripple.
fn other(t: f64, scale: f64, ripple_m: f64) -> String {
    let (p, q) = rig(t);
    let world = UnitQuaternion::from_euler_angles(0.1, -0.2, 1.0);
    let p = p + q * Vector3::new(0.1, -0.05, 0.2) + Vector3::x() * ripple_m * (40.0 * t).sin();
    let (p, q) = ((world * p) * scale + Vector3::new(5.0, 1.0, -2.0), world * q * UnitQuaternion::from_euler_angles(0.3, 1.2, -0.4));
    let q = q.coords;
    format!("{:.6} {} {} {} {} {} {} {}\n", t + 0.041, p.x, p.y, p.z, q.x, q.y, q.z, q.w)
}

fn compare(scene: &Scene, scale: f64, ripple_m: f64, more: &[&str]) -> Run {
    let (mut ours, mut others) = (String::new(), String::new());
    (0..300).for_each(|k| ours.push_str(&record(f64::from(k) / 30.0)));
    (0..490).for_each(|k| write!(others, "{}", other(f64::from(k) / 50.0, scale, ripple_m)).unwrap());
    scene.write("ours.jsonl", &ours);
    scene.write("other.txt", &others);
    scene.run(&[&["compare-poses", "ours.jsonl", "other.txt", "--json", "found.json"], more].concat())
}

fn found(scene: &Scene) -> Value {
    serde_json::from_str(&scene.read("found.json")).unwrap()
}

#[test]
fn another_trackers_log_is_aligned_and_judged() {
    let scene = Scene::new();
    let run = compare(&scene, 1.0, 0.002, &[]);
    run.assert_success();
    assert!(run.stdout.contains("verdict   good\n"), "{}", run.stdout);
    let json = found(&scene);
    assert!((json["delay_s"].as_f64().unwrap() - 0.041).abs() < 0.001, "{json}");
    let rms: Vec<f64> = (0..3).map(|k| json["position_m"][k]["rms"].as_f64().unwrap()).collect();
    // A sine of 2 mm; a little of it looks like a delay.
    assert!((rms[0] - 0.002 * 0.5_f64.sqrt()).abs() < 2e-4 && rms[1] < 5e-4 && rms[2] < 5e-4, "{rms:?}");
    assert!(json["angle_deg"]["max"].as_f64().unwrap() < 0.05, "{json}");
    let worse = compare(&scene, 1.0, 0.02, &[]);
    worse.assert_success();
    assert!(worse.stdout.contains("verdict   usable\n          they differ by 13.5 mm"), "{}", worse.stdout);
    compare(&scene, 1.02, 0.0, &[]).assert_refused(1, &["the trackers do not agree"]);
    assert!(found(&scene)["reasons"][0].as_str().unwrap().contains("metre is +1.9 % of ours"));
    // A wrong delay is a difference while the rig moves.
    compare(&scene, 1.0, 0.0, &["--delay-s", "0.2"]).assert_refused(1, &["the trackers do not agree"]);
}

#[test]
fn logs_that_cannot_be_compared_are_refused_in_a_sentence() {
    let scene = Scene::new();
    scene.write("ours.jsonl", &record(0.0));
    scene.write("other.txt", "1 0 0 0 0 0 0 1\n");
    let run = |arguments: &[&str]| scene.run(&[&["compare-poses"], arguments].concat());
    run(&["ours.jsonl", "other.txt"]).assert_refused(1, &["the logs have 0 instants in common, 30 are needed"]);
    run(&["ours.jsonl", "missing.txt"]).assert_refused(2, &["missing.txt", "name a readable file"]);
    scene.write("bad.txt", "1 0 0 0 0 0 1\n");
    run(&["ours.jsonl", "bad.txt"]).assert_refused(1, &["bad.txt: line 1: 7 numbers"]);
    run(&["ours.jsonl", "other.txt", "--json", "ours.jsonl"]).assert_refused(2, &["ours.jsonl"]);
    let still: String =
        (0..100_i64).map(|k| record(0.0).replace("\"timestamp_ns\":0", &format!("\"timestamp_ns\":{}", k * 33_000_000))).collect();
    scene.write("still.jsonl", &still);
    run(&["still.jsonl", "still.jsonl"]).assert_refused(1, &["the camera moves by 0.000 m"]);
}

#[test]
fn what_freeze_prints_is_a_config() {
    let scene = Scene::new();
    // Forty rows of one picture, each a little brighter: repeated pictures are not measured anew.
    let first = image::open(scene.path("clip/frames/000000.png")).unwrap().into_luma8();
    let mut stamps = "#timestamp [ns],filename\n".to_owned();
    for k in 0..40_u32 {
        let mut frame = first.clone();
        frame.put_pixel(0, 0, image::Luma([(k + 1) as u8]));
        frame.save(scene.path(&format!("clip/frames/{k:06}.png"))).unwrap();
        writeln!(stamps, "{},{k:06}.png", u64::from(k) * 33_333_333).unwrap();
    }
    scene.write("clip/timestamps.csv", &stamps);
    let run = scene.run(&["freeze", "clip", "--config", "stage.toml"]);
    run.assert_success();
    assert!(run.stdout.starts_with("# Measured by `stagepose freeze`: known to "), "{}", run.stdout);
    let config = scene.read("stage.toml").replace("[[stage.surface]]", &format!("{}[[stage.surface]]", run.stdout));
    scene.write("stage.toml", &config);
    scene.replay(&["--poses", "poses.jsonl"]).assert_success();
    for record in records(&scene) {
        assert_eq!((&record["state"], &record["pose"]), (&"tracking".into(), &record["measured"]), "{record}");
        assert!(record["inliers"].is_null() && record["covariance"][35].as_f64().unwrap() > 0.0, "{record}");
    }
    // The same picture as an object, with no stage at all: it is where the stage was.
    let pose = run.stdout.as_str();
    let object = "[[object]]\nname = \"prop\"\n[[object.surface]]\nimage = \"art.png\"\nsize_m = [4.0, 3.0]\n";
    scene.write("object.toml", &format!("[camera]\ncalibration = \"camera.toml\"\n{pose}{object}"));
    scene.run(&["check", "--config", "object.toml", "--no-device"]).assert_success();
    scene.run(&["replay", "clip", "--config", "object.toml", "--poses", "object.jsonl"]).assert_success();
    let last: Value = serde_json::from_str(scene.read("object.jsonl").lines().last().unwrap()).unwrap();
    let prop = &last["objects"][0];
    assert_eq!((&last["state"], &prop["state"]), (&"tracking".into(), &"tracking".into()), "{last}");
    let place: Vec<f64> = (0..3).map(|k| prop["pose"]["position_m"][k].as_f64().unwrap()).collect();
    assert!(place.iter().all(|v| v.abs() < 0.02), "{place:?}");
    // Refined, the camera stays as configured.
    scene.run(&["refine", "clip", "--config", "object.toml", "--poses", "refined.jsonl"]).assert_success();
    let refined: Value = serde_json::from_str(scene.read("refined.jsonl").lines().last().unwrap()).unwrap();
    assert_eq!((&refined["pose"], &refined["covariance"]), (&last["pose"], &last["covariance"]));
    // The camera moved: the scene's own clip has six frames from six places.
    let other = Scene::new();
    other.run(&["freeze", "clip", "--config", "stage.toml"]).assert_refused(1, &["clip: the stage is tracked in ", "30 are needed"]);
}
