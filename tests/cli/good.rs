//! What `replay` and `check` produce when all is well.

use std::io::Read;
use std::process::Stdio;
use std::time::Duration;

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use super::scene::{CAMERA, Scene, records};

#[test]
fn replay_without_outputs_prints_the_table() {
    let scene = Scene::new();
    let run = scene.replay(&[]);
    run.assert_success();
    assert!(run.stdout.starts_with("frames          6\ntracking"), "{}", run.stdout);
    assert!(run.stdout.contains("acquire") && run.stdout.contains("p95"), "{}", run.stdout);
    assert!(run.stderr.is_empty(), "not quiet: {}", run.stderr);
}

#[test]
fn records_go_to_stdout_and_the_table_to_stderr() {
    let scene = Scene::new();
    let run = scene.replay(&["--poses", "-"]);
    run.assert_success();
    assert_eq!(run.stdout.lines().filter(|line| line.starts_with("{\"sequence\":")).count(), 6, "{}", run.stdout);
    assert_eq!(run.stdout.lines().count(), 6);
    assert!(run.stderr.starts_with("frames"), "{}", run.stderr);
}

#[test]
fn the_same_bytes_on_one_and_two_threads() {
    let scene = Scene::new();
    // Without a cache, so that each run also prepares the picture with its own threads.
    for threads in ["1", "2"] {
        let [poses, tum] = ["jsonl", "txt"].map(|ending| format!("{threads}.{ending}"));
        let all = ["replay", "clip", "--config", "stage.toml", "--poses", &poses, "--tum", &tum, "--threads", threads];
        assert!(scene.command(&all).env("CACHE_DIRECTORY", "/dev/null").status().unwrap().success());
    }
    assert_eq!(scene.read("1.jsonl"), scene.read("2.jsonl"));
    assert_eq!(scene.read("1.txt"), scene.read("2.txt"));
}

#[test]
fn a_trajectory_has_the_poses_of_the_frames_that_are_tracked() {
    let scene = Scene::new();
    scene.replay(&["--poses", "poses.jsonl", "--tum", "poses.txt"]).assert_success();
    let tracked: Vec<_> = records(&scene).into_iter().filter(|record| record["state"] == "tracking").collect();
    let trajectory = scene.read("poses.txt");
    assert_eq!((trajectory.lines().count(), tracked.is_empty()), (tracked.len(), false));
    for (line, record) in trajectory.lines().zip(&tracked) {
        let (seconds, pose) = line.split_once(' ').unwrap();
        let (whole, fraction) = seconds.split_once('.').unwrap();
        assert_eq!(fraction.len(), 9, "{line}");
        assert_eq!(format!("{whole}{fraction}").parse::<i64>().unwrap(), record["timestamp_ns"].as_i64().unwrap(), "{line}");
        let places = [("position_m", 3), ("orientation_xyzw", 4)].map(|(key, count)| (0..count).map(move |k| (key, k)));
        let wanted = places.into_iter().flatten().map(|(key, k)| record["pose"][key][k].as_f64().unwrap());
        let found: Vec<f64> = pose.split(' ').map(|number| number.parse().unwrap()).collect();
        assert_eq!(found.len(), 7, "{line}");
        assert!(found.iter().zip(wanted).all(|(found, wanted)| (found - wanted).abs() < 1e-9), "{line}\n{record}");
    }
}

/// With a calibration that states its uncertainty, part of every pose's doubt is the same in all
/// frames.
#[test]
fn covariances_are_written_by_parts() {
    let scene = Scene::new();
    let numbers = |value: &serde_json::Value| value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect::<Vec<_>>();
    let common_variances = |uncertainty: &str| {
        scene.write("camera.toml", &format!("{CAMERA}{uncertainty}"));
        scene.replay(&["--poses", "poses.jsonl", "--parts", "parts.jsonl"]).assert_success();
        let parts: Vec<serde_json::Value> = scene.read("parts.jsonl").lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        let records = records(&scene);
        assert_eq!(parts.len(), records.len());
        let mut variances = Vec::new();
        for (parts, record) in parts.iter().zip(&records) {
            assert_eq!((&parts["sequence"], &parts["timestamp_ns"]), (&record["sequence"], &record["timestamp_ns"]));
            assert_eq!(parts["noise"].is_null(), record["covariance"].is_null());
            if record["covariance"].is_null() {
                continue;
            }
            let [noise, common, whole] = [&parts["noise"], &parts["common"], &record["covariance"]].map(numbers);
            assert!(noise.iter().zip(&common).zip(&whole).all(|((n, c), w)| (n + c - w).abs() <= 1e-12 * w.abs()), "{parts}");
            assert!((0..6).all(|k| noise[7 * k] > 0.0 && common[7 * k] >= 0.0), "{parts}");
            variances.push(common[14]);
        }
        assert!(!variances.is_empty());
        variances
    };
    let exact = common_variances("");
    let uncertain =
        common_variances("[uncertainty]\nfx = 3.0\nfy = 3.0\ncx = 0.3\ncy = 0.3\nskew = 0.0\ndistortion = [0.0, 0.0, 0.0, 0.0, 0.0]\n");
    // One sigma of the focal length, a third of a percent, is 13 mm in 4 m.
    assert!(uncertain.iter().zip(&exact).all(|(uncertain, exact)| uncertain - exact > 1e-6), "{uncertain:?} {exact:?}");
}

#[test]
fn the_summary_agrees_with_the_records() {
    let scene = Scene::new();
    scene.replay(&["--poses", "poses.jsonl", "--tum", "poses.txt", "--summary", "summary.json"]).assert_success();
    let summary: serde_json::Value = serde_json::from_str(&scene.read("summary.json")).unwrap();
    let records = scene.read("poses.jsonl");
    let count = |state: &str| records.lines().filter(|line| line.contains(&format!("\"state\":\"{state}\",\"pose\""))).count();
    for state in ["searching", "tracking", "coasting", "lost"] {
        assert_eq!(summary[state], count(state), "{state}");
    }
    assert_eq!(scene.read("poses.txt").lines().count(), count("tracking"));
    assert_eq!(summary["first_pose_ms"].is_null(), count("tracking") == 0);
}

#[test]
fn an_overlay_is_written_for_every_frame() {
    let scene = Scene::new();
    scene.replay(&["--overlay", "seen"]).assert_success();
    for k in 0..6 {
        let picture = image::open(scene.path(&format!("seen/{k:06}.jpg"))).unwrap();
        assert_eq!((picture.width(), picture.height()), (320, 240));
    }
}

#[test]
fn earlier_overlays_are_replaced_and_other_files_kept() {
    let scene = Scene::new();
    scene.replay(&["--overlay", "seen"]).assert_success();
    std::fs::copy(scene.path("seen/000005.jpg"), scene.path("seen/000123.jpg")).unwrap();
    scene.replay(&["--overlay", "seen"]).assert_success();
    assert!(scene.path("seen/000005.jpg").exists() && !scene.path("seen/000123.jpg").exists());
    std::fs::create_dir(scene.path("own")).unwrap();
    scene.write("own/000000.jpg", "a picture of mine");
    scene.write("poses.jsonl", "kept");
    scene
        .replay(&["--overlay", "own", "--poses", "poses.jsonl"])
        .assert_refused(1, &["own: holds pictures that no earlier --overlay wrote", "give a new folder"]);
    assert_eq!((scene.read("own/000000.jpg"), scene.read("poses.jsonl")), ("a picture of mine".to_owned(), "kept".to_owned()));
}

#[test]
fn a_reader_that_leaves_is_no_error() {
    let scene = Scene::new();
    let mut child = scene
        .command(&["replay", "clip", "--config", "stage.toml", "--poses", "-"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let mut stderr = String::new();
    child.stderr.take().unwrap().read_to_string(&mut stderr).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(0), "{stderr}");
    assert!(!stderr.contains("panicked"), "{stderr}");
}

#[test]
fn check_says_what_it_found() {
    let scene = Scene::new();
    let run = scene.run(&["check", "--config", "stage.toml", "--clip", "clip"]);
    run.assert_success();
    let parts = [
        "stage.toml: good",
        "camera.toml (320 x 240 pixels)",
        "focal length 300.0 x 300.0 px, principal point 159.5, 119.5 px",
        "field of view 56.1 x 43.6 degrees",
        "art.png: artwork 640 x 480 pixels on 4 x 3 m, 0.16 texels a mm",
        "best seen head-on from 0.94 m to 37.50 m",
        "clip: 6 frames of 320 x 240 pixels",
        "call a pose `tracking` after 2 frames that agree",
    ];
    for part in parts {
        assert!(run.stdout.contains(part), "`{part}` is not in: {}", run.stdout);
    }
}

#[test]
fn ctrl_c_keeps_what_was_written() {
    let scene = Scene::new();
    // Frames are ten seconds apart, so the program is certainly waiting when the signal arrives.
    let stamps: String = (0..6_u64).map(|k| format!("{},{k:06}.png\n", k * 10_000_000_000)).collect();
    scene.write("clip/timestamps.csv", &format!("#timestamp [ns],filename\n{stamps}"));
    let arguments = ["replay", "clip", "--config", "stage.toml", "--realtime", "--poses", "poses.jsonl", "--summary", "summary.json"];
    let child = scene.command(&arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let first_line = || std::fs::read_to_string(scene.path("poses.jsonl")).is_ok_and(|text| text.ends_with('\n'));
    while !first_line() {
        std::thread::sleep(Duration::from_millis(10));
    }
    kill(Pid::from_raw(child.id() as i32), Signal::SIGINT).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let lines = scene.read("poses.jsonl").lines().count();
    let summary: serde_json::Value = serde_json::from_str(&scene.read("summary.json")).unwrap();
    assert!(lines < 6 && summary["frames"] == lines, "{lines}: {summary}");
}
