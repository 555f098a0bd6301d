//! `report`: what it includes, what it leaves out, and what it never overwrites.

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::process::Stdio;

use super::scene::{Run, Scene};

/// Returns the texts of a report by name; content that is not text counts as empty.
fn contents(scene: &Scene, report: &str) -> BTreeMap<String, String> {
    let mut zip = zip::ZipArchive::new(std::fs::File::open(scene.path(report)).unwrap()).unwrap();
    let mut contents = BTreeMap::new();
    for index in 0..zip.len() {
        let (mut entry, mut bytes) = (zip.by_index(index).unwrap(), Vec::new());
        entry.read_to_end(&mut bytes).unwrap();
        contents.insert(entry.name().to_owned(), String::from_utf8(bytes).unwrap_or_default());
    }
    contents
}

/// Returns the scene with its clip as a recording: records and events beside the frames.
fn recorded() -> Scene {
    let scene = Scene::new();
    let record = |state: &str| format!("{{\"state\":\"{state}\"}}\n");
    scene.write("clip/poses.jsonl", &[record("searching"), record("tracking").repeat(5)].concat());
    scene.write("clip/events.jsonl", "{\"event\":\"camera_opened\"}\n");
    scene
}

const REPORT: [&str; 7] = ["report", "--config", "stage.toml", "--output", "report.zip", "--clip", "clip"];

#[test]
fn by_default_a_report_has_texts_but_no_pictures() {
    let scene = recorded();
    let run = scene.run(&REPORT);
    run.assert_success();
    assert!(run.stdout.starts_with("report.zip:\n") && run.stdout.contains("No pictures of the stage are in it"), "{}", run.stdout);
    let contents = contents(&scene, "report.zip");
    assert!(contents["about.txt"].starts_with(concat!("stagepose ", env!("CARGO_PKG_VERSION"))), "{}", contents["about.txt"]);
    assert_eq!(contents["config/stage.toml"], scene.read("stage.toml"));
    assert_eq!(contents["config/0-camera.toml"], scene.read("camera.toml"));
    assert!(contents["config/verdict.txt"].starts_with("good\n"));
    assert_eq!(contents["recording/events.jsonl"], scene.read("clip/events.jsonl"));
    let summary: serde_json::Value = serde_json::from_str(&contents["recording/summary.json"]).unwrap();
    assert_eq!((&summary["frames"], &summary["states"]["tracking"]), (&6.into(), &5.into()));
    for name in contents.keys() {
        assert!(!name.ends_with(".png"), "{name} shows the stage");
        assert!(run.stdout.contains(name.as_str()), "{name} is not in the list: {}", run.stdout);
    }
}

#[test]
fn a_report_has_the_last_pictures_of_its_clip_only() {
    let scene = recorded();
    let stamps = scene.read("clip/timestamps.csv");
    scene.write("clip/timestamps.csv", &format!("{stamps}166666667,../camera.toml\n166666668,/etc/passwd\n"));
    scene.run(&[&REPORT[..], &["--pictures", "--seconds", "0.07"]].concat()).assert_success();
    let contents = contents(&scene, "report.zip");
    let pictures: Vec<&String> = contents.keys().filter(|name| name.starts_with("recording/frames/")).collect();
    assert_eq!(pictures, ["recording/frames/000003.png", "recording/frames/000004.png", "recording/frames/000005.png"]);
    assert!(contents.contains_key("config/1-art.png"));
    assert!(contents.keys().all(|name| !name.contains("..") && !name.contains("passwd")), "{:?}", contents.keys());
}

#[test]
fn a_terminal_is_asked_and_the_default_answer_is_no() {
    for (answer, takes) in [("y\n", true), ("n\n", false), ("\n", false), ("\u{4}", false)] {
        let scene = recorded();
        let command = format!("{} {}", env!("CARGO_BIN_EXE_stagepose"), REPORT.join(" "));
        // `script` gives the program a terminal.
        let mut asked = std::process::Command::new("script");
        asked.args(["-qec", &command, "/dev/null"]).current_dir(scene.path(""));
        let mut child = asked.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        child.stdin.take().unwrap().write_all(answer.as_bytes()).unwrap();
        let run = Run::from(child.wait_with_output().unwrap());
        assert!(
            run.code == 0 && run.stdout.contains("the last 6 pictures of the camera too? They may show people. [y/N]"),
            "{}",
            run.stdout
        );
        assert_eq!(contents(&scene, "report.zip").contains_key("recording/frames/000005.png"), takes, "{answer:?}");
    }
}

#[test]
fn a_report_is_written_despite_broken_inputs() {
    let scene = recorded();
    scene.write("stage.toml", "[camera]\ncalibration = \"gone.toml\"\n[[stage.surface]]\nimage = \"art.png\"\nsize_m = [0, 3]\n");
    std::fs::remove_file(scene.path("clip/poses.jsonl")).unwrap();
    // Opening a named pipe would wait for a writer forever.
    nix::unistd::mkfifo(&scene.path("clip/poses.jsonl"), nix::sys::stat::Mode::S_IRWXU).unwrap();
    scene.run(&REPORT).assert_success();
    let contents = contents(&scene, "report.zip");
    assert!(contents["config/verdict.txt"].contains("gone.toml"), "{}", contents["config/verdict.txt"]);
    assert!(contents["config/0-gone.toml.missing.txt"].contains("cannot be read"));
    assert!(contents["recording/poses.jsonl.missing.txt"].contains("it is a named pipe, not a plain file"));
}

#[test]
fn a_report_overwrites_nothing() {
    let scene = recorded();
    for name in ["camera.toml", "clip/poses.jsonl", "clip"] {
        let before = std::fs::read(scene.path(name)).ok();
        let run = scene.run(&["report", "--config", "stage.toml", "--output", name]);
        run.assert_refused(2, &[&format!("--output {name}: exists already; give a new file")]);
        assert_eq!(std::fs::read(scene.path(name)).ok(), before);
    }
    scene.run(&["report", "--config", "stage.toml", "--output", "no/report.zip"]).assert_refused(1, &["no/report.zip: cannot be written"]);
    scene.run(&["report", "--config", "none.toml", "--output", "r.zip"]).assert_refused(2, &["none.toml: cannot be read"]);
    scene.run(&["report", "--config", "stage.toml", "--output", "r.zip", "--clip", "."]).assert_refused(2, &["is not a recording"]);
    assert!(!scene.path("r.zip").exists());
}

#[test]
fn completions_and_manual_pages_describe_this_program() {
    let scene = Scene::new();
    for shell in ["bash", "zsh", "fish"] {
        let run = scene.run(&["completions", shell]);
        run.assert_success();
        assert!(run.stdout.contains("stagepose") && run.stdout.contains("send-test"), "{shell}");
    }
    assert_eq!(scene.run(&["completions", "dos"]).code, 2);
    // New pages replace existing ones.
    std::fs::create_dir(scene.path("man1")).unwrap();
    scene.write("man1/stagepose.1", "old");
    let run = scene.run(&["man", "man1"]);
    run.assert_success();
    assert!(scene.read("man1/stagepose.1").contains("SYNOPSIS") && scene.read("man1/stagepose-run.1").contains("seconds"));
    std::fs::remove_file(scene.path("man1/stagepose.1")).unwrap();
    nix::unistd::mkfifo(&scene.path("man1/stagepose.1"), nix::sys::stat::Mode::S_IRWXU).unwrap();
    scene.run(&["man", "man1"]).assert_refused(1, &["man1/stagepose.1: cannot be written (it is a named pipe"]);
}
