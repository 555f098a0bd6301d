//! `refine`: poses from the frames before and after.

use std::collections::BTreeSet;

use super::scene::{Run, Scene, records};

fn refine(scene: &Scene, more: &[&str]) -> Run {
    scene.run(&[&["refine", "clip", "--config", "stage.toml", "--poses", "refined.jsonl"], more].concat())
}

fn refined(scene: &Scene) -> Vec<serde_json::Value> {
    scene.read("refined.jsonl").lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn variance_sum(record: &serde_json::Value) -> f64 {
    (0..6).map(|k| record["covariance"][7 * k].as_f64().unwrap()).sum()
}

#[test]
fn records_are_those_of_replay_with_another_pose() {
    let scene = Scene::new();
    scene.replay(&["--poses", "poses.jsonl"]).assert_success();
    let run = refine(&scene, &[]);
    run.assert_success();
    assert!(run.stdout.starts_with("frames          6\ntracked"), "{}", run.stdout);
    let keys = |record: &serde_json::Value| record.as_object().unwrap().keys().cloned().collect::<BTreeSet<_>>();
    let (live, refined) = (records(&scene), refined(&scene));
    assert_eq!(refined.len(), live.len());
    let mut tracked = 0;
    for (refined, live) in refined.iter().zip(&live) {
        assert_eq!(keys(refined), keys(live));
        if live["state"] == "tracking" {
            tracked += 1;
            for key in ["sequence", "timestamp_ns", "state", "measured", "inliers", "rms_px"] {
                assert_eq!(refined[key], live[key], "{key}");
            }
            assert!(variance_sum(refined) <= variance_sum(live) * (1.0 + 1e-9), "{refined}");
        }
    }
    assert!(tracked >= 4, "{tracked}");
    // The same bytes again.
    let first = scene.read("refined.jsonl");
    refine(&scene, &[]).assert_success();
    assert_eq!(scene.read("refined.jsonl"), first);
}

#[test]
fn a_row_that_shows_nothing_is_bridged() {
    let scene = Scene::new();
    image::GrayImage::from_pixel(320, 240, image::Luma([40])).save(scene.path("clip/frames/000003.png")).unwrap();
    let run = refine(&scene, &[]);
    run.assert_success();
    assert!(run.stdout.contains("bridged         1\n"), "{}", run.stdout);
    let refined = refined(&scene);
    let [before, bridged, after] = [2, 3, 4].map(|k: usize| &refined[k]);
    assert_eq!((&bridged["state"], bridged["measured"].is_null()), (&"coasting".into(), true), "{bridged}");
    assert!(variance_sum(bridged) > variance_sum(before).min(variance_sum(after)), "{bridged}");
    let x = |record: &serde_json::Value| record["pose"]["position_m"][0].as_f64().unwrap();
    assert!((x(bridged) - 0.5 * (x(before) + x(after))).abs() < 0.05, "{bridged}");
}

#[test]
fn what_cannot_be_refined_is_refused() {
    let scene = Scene::new();
    scene.run(&["refine", "-", "--config", "stage.toml", "--poses", "out.jsonl"]).assert_refused(2, &["reads the clip twice", "save it"]);
    scene.run(&["refine", "nowhere", "--config", "stage.toml", "--poses", "out.jsonl"]).assert_refused(1, &["nowhere"]);
    let without_output = scene.run(&["refine", "clip", "--config", "stage.toml"]);
    assert!(without_output.code == 2 && without_output.stderr.contains("--poses <OUT.jsonl>"), "{}", without_output.stderr);
    scene.run(&["refine", "clip", "--config", "stage.toml", "--poses", "stage.toml"]).assert_refused(2, &["stage.toml"]);
    assert!(!scene.path("out.jsonl").exists() || scene.read("out.jsonl").is_empty());
}
