//! `stagepose export`: files for other programs from a tracked clip, and a message for every
//! mistake.

use std::sync::OnceLock;

use serde_json::Value;
use stagepose::{Facet, FacetTexture, Pose, StageMap};

use super::scene::{CAMERA, CONFIG, Scene, records};

/// Returns the clip's poses, tracked once for all tests here.
fn poses() -> &'static str {
    static POSES: OnceLock<String> = OnceLock::new();
    POSES.get_or_init(|| {
        let scene = Scene::new();
        scene.replay(&["--poses", "poses.jsonl"]).assert_success();
        scene.read("poses.jsonl")
    })
}

fn tracked() -> Scene {
    let scene = Scene::new();
    scene.write("poses.jsonl", poses());
    scene
}

/// Returns the poses with the record of one row replaced by one without a pose.
fn without(row: usize) -> String {
    let mut lines: Vec<String> = poses().lines().map(str::to_owned).collect();
    let mut record: Value = serde_json::from_str(&lines[row]).unwrap();
    (record["state"], record["pose"]) = ("lost".into(), Value::Null);
    lines[row] = record.to_string();
    lines.join("\n") + "\n"
}

#[test]
fn a_tracked_clip_is_written_in_every_format() {
    let scene = tracked();
    let tracking = records(&scene).iter().filter(|record| record["state"] == "tracking").count();
    assert_eq!(tracking, 6);
    for (to, file, contains) in [
        ("usd", "take.usda", "double3 xformOp:translate.timeSamples"),
        ("chan", "take.chan", "6\t"),
        ("blender", "take.py", "import bpy"),
        ("ae", "take.jsx", "ADBE Camera Zoom"),
        ("gltf", "take.gltf", "\"perspective\""),
        ("mcap", "take.mcap", "foxglove.FrameTransform"),
    ] {
        let run = scene.run(&["export", "poses.jsonl", "--to", to, "--config", "stage.toml", "-o", file]);
        run.assert_success();
        assert!(run.stdout.starts_with(&format!("{file}: 6 of 6 frames, 0 without a pose")), "{}", run.stdout);
        assert_eq!(run.stdout.contains("; 30.000 frames per second"), to != "mcap", "{}", run.stdout);
        let bytes = std::fs::read(scene.path(file)).unwrap();
        assert!(String::from_utf8_lossy(&bytes).contains(contains), "{to}");
        // A second time gives the same bytes.
        scene.run(&["export", "poses.jsonl", "--to", to, "--config", "stage.toml", "-o", file]).assert_success();
        assert_eq!(std::fs::read(scene.path(file)).unwrap(), bytes, "{to}");
    }
    let artwork = image::open(scene.path("art.png")).unwrap().into_rgb8();
    assert_eq!(image::open(scene.path("take-art.png")).unwrap().into_rgb8(), artwork);
}

#[test]
fn a_channel_file_has_the_records_positions() {
    let scene = tracked();
    scene.write("gap.jsonl", &without(3));
    let run = scene.run(&["export", "gap.jsonl", "--to", "chan", "--output", "take.chan"]);
    run.assert_success();
    assert!(run.stdout.starts_with("take.chan: 5 of 6 frames, 1 without a pose"), "{}", run.stdout);
    assert!(run.stdout.contains("without the field of view; --config FILE adds it"), "{}", run.stdout);
    let rows = [0, 1, 2, 4, 5];
    let text = scene.read("take.chan");
    for (line, row) in text.lines().zip(rows) {
        let numbers: Vec<f64> = line.split('\t').map(|v| v.parse().unwrap()).collect();
        let wanted: Vec<f64> = serde_json::from_value(records(&scene)[row]["pose"]["position_m"].clone()).unwrap();
        assert_eq!((numbers[0], numbers.len()), (row as f64 + 1.0, 7));
        let off = [numbers[1] - wanted[0], numbers[2] - wanted[2], numbers[3] + wanted[1]];
        assert!(off.iter().all(|v| v.abs() < 1e-8), "{line} {wanted:?}");
    }
    assert_eq!(text.lines().count(), rows.len());
}

#[test]
fn the_stage_is_written_with_its_artwork() {
    let scene = Scene::new();
    for (to, file) in [("obj", "stage.obj"), ("gltf", "stage.gltf"), ("usd", "stage.usda")] {
        let run = scene.run(&["export", "--config", "stage.toml", "--to", to, "--output", file]);
        run.assert_success();
        assert!(run.stdout.starts_with(&format!("{file}: the stage, 1 surface\n")), "{}", run.stdout);
        assert_eq!(run.stdout.contains("beside it: stage-art.png"), to != "gltf", "{}", run.stdout);
    }
    assert!(scene.read("stage.obj").contains("mtllib stage.mtl"));
    assert!(scene.read("stage.mtl").contains("map_Kd stage-art.png"));
    let usd = scene.read("stage.usda");
    let points = usd.split_once("point3f[] points = [(").unwrap().1.split_once(")]").unwrap().0;
    let points: Vec<f64> = points.split(['(', ')', ',', ' ']).filter(|v| !v.is_empty()).map(|v| v.parse().unwrap()).collect();
    let wanted = [-2.0, 0.0, -1.5, 2.0, 0.0, -1.5, -2.0, 0.0, 1.5, 2.0, 0.0, 1.5];
    assert!(points.len() == 12 && points.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-9), "{points:?}");
    assert!(scene.path("stage-art.png").is_file());
}

#[test]
fn a_recording_brings_its_own_config() {
    let scene = tracked();
    std::fs::create_dir_all(scene.path("clip/config")).unwrap();
    for (from, to) in [("poses.jsonl", "clip/poses.jsonl"), ("stage.toml", "clip/config/stage.toml"), ("art.png", "clip/config/art.png")] {
        std::fs::copy(scene.path(from), scene.path(to)).unwrap();
    }
    scene.write("clip/config/camera.toml", &CAMERA.replace("cx = 159.5", "cx = 161.5").replace("[0.0,", "[-0.1,"));
    let run = scene.run(&["export", "clip", "--to", "gltf", "--fps", "29.97", "--output", "take.gltf"]);
    run.assert_success();
    for said in ["29.970 frames per second", "not in it: the distortion", "the principal point, 2.00 px right of and 0.00 px below"] {
        assert!(run.stdout.contains(said), "`{said}` is not in {}", run.stdout);
    }
}

#[test]
fn facets_of_a_map_are_sheets_of_the_stage() {
    let scene = Scene::new();
    let light = (0..80_u32 * 64).map(|n| (n.wrapping_mul(2_654_435_761) >> 16) as u16).collect();
    let facet = |k: usize| Facet {
        name: format!("facet {k}"),
        size_m: [0.8, 0.64],
        pose: Pose::new(nalgebra::UnitQuaternion::identity(), nalgebra::Vector3::new(k as f64, 0.0, 0.0)),
        shape: Default::default(),
        texture: FacetTexture { width: 80, height: 64, light: Vec::clone(&light) },
    };
    let map = StageMap { bend: [0.0; 7], keyframes: vec![Pose::identity()], facets: vec![facet(1), facet(2)] };
    std::fs::write(scene.path("stage.map"), map.to_bytes()).unwrap();
    scene.write("stage.toml", "[camera]\ncalibration = \"camera.toml\"\n[stage.map]\nfile = \"stage.map\"\n");
    for (to, file) in [("obj", "set.obj"), ("usd", "set.usda"), ("gltf", "set.gltf")] {
        scene.run(&["export", "--config", "stage.toml", "--to", to, "--output", file]).assert_success();
    }
    let text = scene.read("set.obj");
    assert_eq!((text.lines().filter(|line| line.starts_with("o ")).count(), text.contains("\nv 2.4 0 -0.32\n")), (2, true), "{text}");
    // Each has its texture beside it, and texture coordinates on all of it.
    let pictures = std::fs::read_dir(scene.path("")).unwrap().filter(|entry| {
        let name = entry.as_ref().unwrap().file_name();
        name.to_string_lossy().starts_with("set-") && name.to_string_lossy().ends_with(".png")
    });
    assert_eq!(pictures.count(), 2);
    assert_eq!(text.lines().filter(|line| line.starts_with("vt ")).count(), 8);
}

#[test]
fn mcap_of_a_recording_has_its_pictures_and_events() {
    let scene = tracked();
    std::fs::create_dir_all(scene.path("clip/config")).unwrap();
    for (from, to) in [("poses.jsonl", "clip/poses.jsonl"), ("stage.toml", "clip/config/stage.toml"), ("art.png", "clip/config/art.png")] {
        std::fs::copy(scene.path(from), scene.path(to)).unwrap();
    }
    scene.write("clip/config/camera.toml", CAMERA);
    // Two rows are JPEGs; one more lies outside the clip, and is not read.
    let index = scene.read("clip/timestamps.csv");
    scene.write(
        "clip/timestamps.csv",
        &index.replace("000000.png", "000000.jpg").replace("000001.png", "000001.jpg").replace("000002.png", "../../secret.jpg"),
    );
    for (name, jpeg) in [("clip/frames/000000.jpg", "first"), ("clip/frames/000001.jpg", "second"), ("secret.jpg", "secret")] {
        scene.write(name, jpeg);
    }
    scene.write("clip/events.jsonl", "{\"timestamp_ns\":5,\"event\":\"tracked\",\"after_ms\":0}\nno event\n");
    let run = scene.run(&["export", "clip", "--to", "mcap", "--output", "take.mcap"]);
    run.assert_success();
    let bytes = std::fs::read(scene.path("take.mcap")).unwrap();
    let text = String::from_utf8_lossy(&bytes);
    // "first" and "second" in base64.
    for part in ["\"data\":\"Zmlyc3Q=\"", "\"data\":\"c2Vjb25k\"", "{\"timestamp_ns\":5,\"event\":\"tracked\",\"after_ms\":0}"] {
        assert!(text.contains(part), "{part}");
    }
    assert!(!text.contains("c2VjcmV0") && !text.contains("no event") && !scene.path("take.mcap.part").exists());
}

#[test]
fn dropped_pictures_are_mentioned_where_rows_count() {
    let scene = tracked();
    let shifted = |(k, line): (usize, &str)| match k {
        0..4 => format!("{line}\n"),
        _ => {
            let mut record: Value = serde_json::from_str(line).unwrap();
            record["timestamp_ns"] = (record["timestamp_ns"].as_i64().unwrap() + 66_666_666).into();
            format!("{record}\n")
        }
    };
    scene.write("late.jsonl", &poses().lines().enumerate().map(shifted).collect::<String>());
    let export = |to: &str, file: &str| scene.run(&["export", "late.jsonl", "--to", to, "--config", "stage.toml", "-o", file]).stdout;
    let said = export("blender", "take.py");
    assert!(said.contains("row 4 is +2.0 frames away") || said.contains("row 5 is +2.0 frames away"), "{said}");
    assert!(!export("usd", "take.usda").contains("frames away"));
}

#[test]
fn wrong_poses_are_refused_with_line_and_fix() {
    let scene = tracked();
    let lines: Vec<&str> = poses().lines().collect();
    let cut = poses().len() - 40;
    for (text, parts) in [
        (String::new(), vec!["bad.jsonl: it holds no record", "`--poses`"]),
        (poses()[..cut].to_owned(), vec!["bad.jsonl: line 6 is cut off", "write it again"]),
        ("0.000000000 1 2 3 0 0 0 1\n".to_owned(), vec!["line 1 is not a pose record", "expected a JSON object"]),
        (CONFIG.to_owned(), vec!["line 1 is not JSON"]),
        ("{\"frames\":90}\n".to_owned(), vec!["line 1 is not a pose record", "missing field `timestamp_ns`"]),
        (format!("{0}\n{0}\n", lines[0]), vec!["line 2", "`timestamp_ns`", "give one recording"]),
        (lines[0].replace("orientation_xyzw", "orientation"), vec!["line 1 is not a pose record", "missing field `orientation_xyzw`"]),
        (lines[0].replace("tracking", "lost") + "\n", vec!["none of its 1 records has a pose", "check --clip"]),
    ] {
        scene.write("bad.jsonl", &text);
        let run = scene.run(&["export", "bad.jsonl", "--to", "usd", "--config", "stage.toml", "--output", "take.usda"]);
        run.assert_refused(1, &parts);
    }
    // A single record has no rate.
    scene.write("bad.jsonl", lines[0]);
    let one = ["export", "bad.jsonl", "--to", "usd", "--config", "stage.toml", "--output", "take.usda"];
    scene.run(&one).assert_refused(1, &["bad.jsonl: its stamps give no frame rate", "--fps N"]);
    assert!(!scene.path("take.usda").exists());
    scene.run(&[&one[..], &["--fps", "25"]].concat()).assert_success();
}

#[test]
fn arguments_that_do_not_fit_are_refused() {
    let scene = tracked();
    let cases: [(&[&str], &[&str]); 10] = [
        (&["poses.jsonl", "--to", "usd", "-o", "a.usda"], &["--to usd needs the lens", "--config FILE"]),
        (&["poses.jsonl", "--to", "usd", "--config", "stage.toml", "-o", "a.usdc"], &["--output is a.usdc", ".usda or .usd"]),
        (&["poses.jsonl", "--to", "obj", "--config", "stage.toml", "-o", "a.obj"], &["--to obj is for the stage", "omit POSES"]),
        (&["--to", "chan", "--config", "stage.toml", "-o", "a.chan"], &["--to chan is for poses"]),
        (&["--to", "gltf", "-o", "a.gltf"], &["nothing to export", "--config FILE"]),
        (&["--to", "gltf", "--config", "stage.toml", "--fps", "25", "-o", "a.gltf"], &["--fps and --size are for poses"]),
        (&["poses.jsonl", "--to", "chan", "--fps", "0", "-o", "a.chan"], &["--fps is 0", "0.1 to 10000"]),
        (&["poses.jsonl", "--to", "usd", "--config", "stage.toml", "--size", "big", "-o", "a.usda"], &["--size is \"big\"", "1920x1080"]),
        (&["poses.jsonl", "--to", "usd", "--config", "stage.toml", "--size", "320x100", "-o", "a.usda"], &["another aspect ratio"]),
        (&["poses.jsonl", "--to", "usd", "--config", "none.toml", "-o", "a.usda"], &["none.toml"]),
    ];
    for (arguments, parts) in cases {
        scene.run(&[&["export"], arguments].concat()).assert_refused(2, parts);
    }
    // A guessed lens has no picture size of its own.
    scene.config_with("calibration = \"camera.toml\"", "fov_deg = 60");
    let guess = ["export", "poses.jsonl", "--to", "usd", "--config", "stage.toml", "-o", "a.usda"];
    scene.run(&guess).assert_refused(2, &["stage.toml: its lens is a guess", "--size WxH"]);
    scene.run(&[&guess[..], &["--size", "320x240"]].concat()).assert_success();
}

#[test]
fn nothing_that_is_read_is_overwritten() {
    let scene = tracked();
    std::os::unix::fs::symlink("poses.jsonl", scene.path("take.chan")).unwrap();
    let run = scene.run(&["export", "poses.jsonl", "--to", "chan", "--output", "take.chan"]);
    run.assert_refused(2, &["--output take.chan: it is the poses, which would be overwritten"]);
    // The artwork's copy would replace the artwork itself.
    std::fs::rename(scene.path("art.png"), scene.path("take-art.png")).unwrap();
    std::fs::hard_link(scene.path("take-art.png"), scene.path("art.png")).unwrap();
    let run = scene.run(&["export", "poses.jsonl", "--to", "usd", "--config", "stage.toml", "--output", "take.usda"]);
    run.assert_refused(2, &["take-art.png", "a file of the config, which would be overwritten"]);
    scene
        .run(&["export", "poses.jsonl", "--to", "chan", "--output", "no/take.chan"])
        .assert_refused(1, &["no/take.chan", "cannot be written"]);
    scene.run(&["export", "none.jsonl", "--to", "chan", "--output", "a.chan"]).assert_refused(1, &["none.jsonl: cannot be read"]);
    scene.run(&["export", "clip", "--to", "chan", "--output", "a.chan"]).assert_refused(1, &["clip: is no recording", "poses.jsonl"]);
    assert_eq!(scene.read("poses.jsonl"), poses());
}
