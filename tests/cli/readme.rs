//! Runs the README's commands, and the first commands of the shipped examples, as written.
//!
//! The test reads the README when it runs, so a broken command there fails here without a build.
//! Only [`here`] replaces what cannot run in a test.

use std::path::Path;
use std::process::Command;

use nalgebra::{UnitQuaternion, Vector3};
use stagepose::diagnostics::calibrate::Board;
use stagepose::{Pose, read_calibration};

use crate::calibrate::rendered::{BoardPhotographer, Photograph};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// Returns the code blocks of a language, without the indentation of lists.
fn blocks(language: &str) -> Vec<String> {
    let readme = std::fs::read_to_string(format!("{ROOT}/README.md")).unwrap();
    let mut blocks = Vec::new();
    let mut lines = readme.lines();
    while let Some(line) = lines.next() {
        let indentation = line.len() - line.trim_start().len();
        if line.trim() == format!("```{language}") {
            let inside = lines.by_ref().take_while(|line| line.trim() != "```");
            blocks.push(inside.map(|line| line.get(indentation..).unwrap_or_default().to_owned() + "\n").collect());
        }
    }
    blocks
}

/// Adapts a block so that it can run in a test: it drops the setup and the build, which are done by
/// then, and plays the clip in place of a camera. Returns `None` for the blocks that test and
/// install; .ci/run covers those separately.
fn here(block: &str) -> Option<String> {
    if block.starts_with("cargo test") || block.starts_with("packaging/deb") {
        return None;
    }
    let with_clip = |line: &str| match line.contains("stagepose run ") || line.contains("stagepose record ") {
        true => format!("{} --play clip.mp4\n", line.split(" #").next().unwrap_or(line).trim_end()),
        false => format!("{line}\n"),
    };
    Some(block.replace(".ci/setup && cargo build --release && ", "").lines().map(with_clip).collect())
}

/// Renders views of the printed board by the fixture's camera, tilted in all directions.
fn take_pictures(folder: &Path) {
    let camera = read_calibration(Path::new(&format!("{ROOT}/fixtures/dolly/camera.toml"))).unwrap().model;
    let photographer = BoardPhotographer::new(camera);
    let board = Board::new(9, 6, 0.024).unwrap();
    std::fs::create_dir(folder).unwrap();
    for k in 0..14_usize {
        let azimuth = 1.57 * k as f64 + 0.4;
        let tilt = 0.5 + 0.02 * (k % 4) as f64;
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(azimuth.cos(), azimuth.sin(), 0.0) * tilt);
        let place = Vector3::new(0.09 * ((k % 3) as f64 - 1.0), 0.05 * ((k / 3 % 3) as f64 - 1.0), 0.38 + 0.05 * (k % 2) as f64);
        let pose = Pose::new(rotation, place - rotation * Vector3::new(0.096, 0.06, 0.0));
        let lens = Photograph { blur_px: 0.6, noise: 1.0, seed: k as u64, ..Photograph::default() };
        photographer.photograph(&board, &pose, &lens).save(folder.join(format!("{k:02}.png"))).unwrap();
    }
}

/// Runs a block in a shell in the folder, and returns what it printed.
fn shell(folder: &Path, block: &str) -> String {
    let output = Command::new("bash").args(["-euc", block]).current_dir(folder).output().unwrap();
    let (out, said) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{block}\n{out}\n{said}");
    format!("{out}{said}")
}

/// Sets up what a new user has: a built clone of the project, artwork, pictures of the board, and a
/// clip.
fn clone_of_a_new_user() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let link = |from: &str, to: &str| {
        let to = folder.path().join(to);
        std::fs::create_dir_all(to.parent().unwrap()).unwrap();
        std::os::unix::fs::symlink(from, to).unwrap();
    };
    link(env!("CARGO_BIN_EXE_stagepose"), "target/release/stagepose");
    link(&format!("{ROOT}/fixtures"), "fixtures");
    link(&format!("{ROOT}/fixtures/dolly/backdrop.png"), "backdrop.png");
    // A folder is a clip whatever its name is.
    link(&format!("{ROOT}/fixtures/dolly"), "clip.mp4");
    take_pictures(&folder.path().join("pictures"));
    folder
}

/// Returns the camera's position errors in the tracked frames of step 5, metres, sorted.
fn errors(poses: &str) -> Vec<f64> {
    let truth = std::fs::read_to_string(format!("{ROOT}/fixtures/dolly/groundtruth.txt")).unwrap();
    let numbers = |line: &str| line.split_whitespace().filter_map(|word| word.parse().ok()).collect::<Vec<f64>>();
    let truth: Vec<_> = truth.lines().filter(|line| !line.starts_with('#')).map(numbers).collect();
    let records = poses.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
    let tracking = records.filter(|record| record["state"] == "tracking");
    let error = |record: serde_json::Value| {
        let row = &truth[record["sequence"].as_u64().unwrap() as usize];
        let off = |k: usize| record["measured"]["position_m"][k].as_f64().unwrap() - row[k + 1];
        Vector3::new(off(0), off(1), off(2)).norm()
    };
    let mut errors: Vec<_> = tracking.map(error).collect();
    errors.sort_by(f64::total_cmp);
    errors
}

#[test]
fn the_steps_run_as_they_are_written() {
    let clone = clone_of_a_new_user();
    let folder = clone.path();
    let configs = blocks("toml");
    let config = configs.iter().find(|block| block.contains("[camera]")).expect("step 4 shows a config");
    std::fs::write(folder.join("stage.toml"), config).unwrap();
    let mut ran = String::new();
    for block in blocks("sh").iter().filter_map(|block| here(block)) {
        shell(folder, &block);
        ran += &block;
    }
    for command in ["board", "calibrate", "check", "replay", "devices", "run", "record", "export"] {
        assert!(
            ran.contains(&format!("stagepose {command} ")) || ran.contains(&format!("stagepose {command}\n")),
            "no {command} in:\n{ran}"
        );
    }
    for file in [
        "board.pdf",
        "camera.toml",
        "report.html",
        "overlay/000000.jpg",
        "take1/poses.jsonl",
        "take.usda",
        "take-backdrop.png",
        "stage.gltf",
    ] {
        assert!(folder.join(file).is_file(), "{file}");
    }
    // Step 5 used the lens that step 3 measured and the config of step 4.
    let errors = errors(&std::fs::read_to_string(folder.join("poses.jsonl")).unwrap());
    assert!(errors.len() >= 36, "{} of 40 frames", errors.len());
    assert!(errors[errors.len() / 2] < 0.02, "median error {} m", errors[errors.len() / 2]);
    // Checks the outputs that "Feed the scenery" adds to the config.
    let outputs = configs.iter().find(|block| block.contains("[[output]]")).expect("the README shows an output");
    std::fs::write(folder.join("stage.toml"), format!("{config}\n{outputs}")).unwrap();
    let said = shell(folder, "target/release/stagepose check --config stage.toml --no-device");
    assert!(said.contains("192.168.1.20:40000"), "{said}");
}

#[test]
fn every_example_config_works_with_send_test() {
    let folder = tempfile::tempdir().unwrap();
    let mut examples = 0;
    for example in std::fs::read_dir(format!("{ROOT}/config")).unwrap().flatten() {
        let text = std::fs::read_to_string(example.path()).unwrap();
        if !text.lines().any(|line| line == "[[output]]") {
            continue;
        }
        // Nothing leaves this machine, but a receiver that runs on it may hear the packets.
        let here: String = text.lines().map(|line| to_this_machine(line) + "\n").collect();
        let name = example.file_name().into_string().unwrap();
        std::fs::write(folder.path().join(&name), here).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_stagepose"));
        let run = command.args(["send-test", "--config", &name, "--seconds", "0.2"]).current_dir(folder.path()).output().unwrap();
        let said = String::from_utf8_lossy(&run.stderr);
        assert_eq!(run.status.code(), Some(0), "{name}: {said}");
        assert!(said.contains("camera.toml is not there yet") && said.contains("sending a test pose to "), "{name}: {said}");
        examples += 1;
    }
    assert!(examples >= 6, "{examples}");
}

/// Replaces the address of another machine in a config line with this machine's.
fn to_this_machine(line: &str) -> String {
    match line.split_once("192.168.").filter(|_| !line.starts_with('#')) {
        Some((before, after)) => {
            let rest = after.trim_start_matches(|c: char| c.is_ascii_digit() || c == '.');
            format!("{before}127.0.0.1{rest}")
        }
        None => line.to_owned(),
    }
}
