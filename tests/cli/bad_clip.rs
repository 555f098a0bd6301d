//! Clips that are missing, empty or damaged, and outputs that cannot be written.

use super::scene::{Scene, records};

#[test]
fn missing_clip() {
    let scene = Scene::new();
    scene.run(&["replay", "none", "--config", "stage.toml", "--poses", "poses.jsonl"]).assert_refused(1, &["none"]);
    assert!(!scene.path("poses.jsonl").exists(), "an output was created for a clip that is not there");
}

#[test]
fn empty_clip() {
    let scene = Scene::new();
    std::fs::create_dir(scene.path("empty")).unwrap();
    scene.run(&["replay", "empty", "--config", "stage.toml"]).assert_refused(1, &["empty"]);
    std::fs::write(scene.path("empty.y4m"), b"").unwrap();
    scene.run(&["replay", "empty.y4m", "--config", "stage.toml"]).assert_refused(1, &["empty.y4m"]);
}

#[test]
fn a_file_that_is_no_clip() {
    let scene = Scene::new();
    scene.write("noise.y4m", "this is no clip");
    scene.run(&["replay", "noise.y4m", "--config", "stage.toml"]).assert_refused(1, &["noise.y4m"]);
}

#[test]
fn no_readable_frame() {
    let scene = Scene::new();
    for k in 0..6 {
        scene.truncate(&format!("clip/frames/{k:06}.png"), 40);
    }
    scene.replay(&[]).assert_refused(1, &["clip"]);
}

fn replay_with_summary(scene: &Scene) -> (Vec<serde_json::Value>, serde_json::Value, String) {
    let run = scene.replay(&["--poses", "poses.jsonl", "--summary", "summary.json"]);
    run.assert_success();
    (records(scene), serde_json::from_str(&scene.read("summary.json")).unwrap(), run.stderr)
}

#[test]
fn a_truncated_frame_becomes_a_record_and_is_counted() {
    let scene = Scene::new();
    scene.truncate("clip/frames/000003.png", 400);
    let (records, summary, stderr) = replay_with_summary(&scene);
    assert_eq!(records.len(), 6);
    assert!(records.iter().enumerate().all(|(k, record)| record["sequence"] == k));
    assert_ne!(records[3]["state"], "tracking");
    assert!(records[3]["measured"].is_null());
    assert_eq!((&summary["frames"], &summary["undecodable"], &summary["skipped"]), (&6.into(), &1.into(), &0.into()));
    assert!(stderr.contains("row 3 cannot be read"), "{stderr}");
}

#[test]
fn a_truncated_jpeg_becomes_a_record_and_is_counted() {
    let scene = Scene::new();
    let frame = image::open(scene.path("clip/frames/000002.png")).unwrap();
    frame.save(scene.path("clip/frames/000002.jpg")).unwrap();
    scene.truncate("clip/frames/000002.jpg", 700);
    scene.write("clip/timestamps.csv", &scene.read("clip/timestamps.csv").replace("000002.png", "000002.jpg"));
    let (records, summary, _) = replay_with_summary(&scene);
    assert_eq!((records.len(), &summary["undecodable"]), (6, &1.into()));
}

#[test]
fn bad_stamps_become_records_and_are_counted() {
    let scene = Scene::new();
    let stamps = "#timestamp [ns],filename\n0,000000.png\n40,000001.png\n40,000002.png\n20,000003.png\n80,000004.png\n120,000005.png\n";
    scene.write("clip/timestamps.csv", stamps);
    let (records, summary, stderr) = replay_with_summary(&scene);
    assert_eq!((records.len(), &summary["skipped"], &summary["undecodable"]), (6, &2.into(), &0.into()));
    assert!(stderr.contains("row 2 is skipped") && stderr.contains("row 3 is skipped"), "{stderr}");
}

#[test]
fn a_frame_of_another_size_becomes_a_record_and_is_counted() {
    let scene = Scene::new();
    image::GrayImage::new(100, 80).save(scene.path("clip/frames/000002.png")).unwrap();
    let (records, summary, _) = replay_with_summary(&scene);
    assert_eq!((records.len(), &summary["skipped"]), (6, &1.into()));
}

#[test]
fn many_bad_rows_are_reported_first_and_then_counted() {
    let scene = Scene::new();
    let mut stamps = "#timestamp [ns],filename\n0,000000.png\n".to_owned();
    (0..20).for_each(|_| stamps += "0,000001.png\n");
    scene.write("clip/timestamps.csv", &stamps);
    let (_, summary, stderr) = replay_with_summary(&scene);
    assert_eq!(summary["skipped"], 20);
    assert_eq!(stderr.matches("is skipped").count(), 6, "{stderr}");
    assert!(stderr.contains("more such rows are only counted"), "{stderr}");
}

#[test]
fn outputs_that_cannot_be_created() {
    let scene = Scene::new();
    for output in ["--poses", "--tum", "--summary"] {
        scene.replay(&[output, "no/such/folder/out"]).assert_refused(1, &["no/such/folder/out: cannot be written (No such file"]);
    }
    scene.replay(&["--overlay", "art.png/overlay"]).assert_refused(1, &["art.png/overlay: cannot be written"]);
}

#[test]
fn a_full_disk() {
    if !std::path::Path::new("/dev/full").exists() {
        eprintln!("skipped: this system has no /dev/full");
        return;
    }
    let scene = Scene::new();
    for output in ["--poses", "--summary"] {
        let run = scene.replay(&[output, "/dev/full"]);
        run.assert_refused(1, &["/dev/full: cannot be written (No space left on device"]);
    }
}
