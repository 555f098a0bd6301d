//! `stagepose delay` on rendered clips of a rig that is panned, with exact stamps.

mod clock;

use std::path::Path;
use std::process::Output;
use std::sync::OnceLock;

use nalgebra::UnitQuaternion;
use serde_json::Value;
use stagepose::protocols::freed::FreedPacket;
use stagepose::{Camera, CameraModel, Pose, Stage};

use crate::mount::rig::{Board, filming, rig, write};

/// Frames per second, and seconds from the first frame to the last.
const FPS: f64 = 30.0;
const OTHER_FPS: f64 = 25.0;
const SPAN_S: f64 = 2.4;
/// How late the second camera's stamps are, seconds.
const DELAY_S: f64 = 0.041;

fn tracking_camera() -> CameraModel {
    CameraModel::pinhole(480, 360, 400.0, 400.0, 239.5, 179.5).unwrap()
}

/// Sees 61.9 degrees across; the other camera is turned by 25 degrees.
fn filming_camera() -> CameraModel {
    CameraModel::pinhole(480, 270, 400.0, 400.0, 239.5, 134.5).unwrap()
}

/// Returns the rig's pose while somebody pans it to and fro, not periodically.
fn panned(time_s: f64) -> Pose<Stage, Camera> {
    let sway = |degrees: f64, hz: f64, phase: f64| degrees * (std::f64::consts::TAU * hz * time_s + phase).sin();
    rig([0.1, -4.4, 0.0], [sway(9.0, 0.8, 0.0) + sway(4.0, 1.9, 1.0), sway(2.0, 0.6, 2.0), 0.0])
}

/// Gives a folder of pictures the form of a clip with stamps.
fn stamp(folder: &Path, name: &str, stamps_s: &[f64]) {
    let clip = folder.join(name);
    std::fs::rename(&clip, folder.join("frames")).unwrap();
    std::fs::create_dir(&clip).unwrap();
    std::fs::rename(folder.join("frames"), clip.join("frames")).unwrap();
    restamp(&clip, stamps_s);
}

fn restamp(clip: &Path, stamps_s: &[f64]) {
    let row = |(k, stamp_s): (usize, &f64)| format!("{},{k:03}.png\n", (stamp_s * 1e9).round() as i64);
    let rows: String = stamps_s.iter().enumerate().map(row).collect();
    std::fs::write(clip.join("timestamps.csv"), format!("#timestamp [ns],filename\n{rows}")).unwrap();
}

/// Returns when a camera's frames are taken.
fn times(fps: f64) -> Vec<f64> {
    (0..=(SPAN_S * fps) as u32).map(|k| f64::from(k) / fps).collect()
}

/// Returns the stamps of the second clip, `delay_s` late on a clock that begins at 100 s.
fn late(delay_s: f64) -> Vec<f64> {
    times(OTHER_FPS).iter().map(|t| t + 100.0 + delay_s).collect()
}

/// Returns a folder with both clips and configs, rendered once: a.toml and b.toml know the stage,
/// fov.toml is b's without it.
fn pair() -> &'static Path {
    static PAIR: OnceLock<tempfile::TempDir> = OnceLock::new();
    let make = || {
        let folder = tempfile::tempdir().unwrap();
        let (at, board) = (folder.path(), Board::new(8));
        write(at, "a", tracking_camera(), &board, &times(FPS).iter().map(|t| panned(*t)).collect::<Vec<_>>());
        stamp(at, "a", &times(FPS).iter().map(|t| t + 100.0).collect::<Vec<_>>());
        write(at, "b", filming_camera(), &board, &times(OTHER_FPS).iter().map(|t| filming(&panned(*t))).collect::<Vec<_>>());
        stamp(at, "b", &late(DELAY_S));
        std::fs::write(at.join("fov.toml"), "[camera]\nfov_deg = 60\n").unwrap();
        folder
    };
    PAIR.get_or_init(make).path()
}

/// Runs `delay` for the first camera and what `more` says of the second.
fn run(more: &[&str]) -> Output {
    let first = ["delay", "--config", "a.toml", "--clip", "a"];
    crate::program().args(first).args(more).current_dir(pair()).env_remove("RUST_LOG").output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

fn json(name: &str) -> Value {
    serde_json::from_slice(&std::fs::read(pair().join(name)).unwrap()).unwrap()
}

/// Asserts that a measured delay is right to a millisecond and within its sigma.
fn assert_right(output: &Output, name: &str, delay_s: f64) -> String {
    let said = text(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{said}{}", text(&output.stderr));
    let told = json(name);
    let number = |key: &str| told[key].as_f64().unwrap();
    let (error_s, sigma_s) = (number("delay_s") - delay_s, number("sigma_s"));
    println!("{name}: {:+.3} ms off, sigma {:.3} ms\n{said}", error_s * 1e3, sigma_s * 1e3);
    assert!(error_s.abs() < 1e-3 && error_s.abs() < 4.0 * sigma_s, "{told:#}");
    said
}

#[test]
fn the_delay_of_a_filming_camera_is_measured_and_its_lines_work() {
    let said = assert_right(&run(&["--with", "b.toml", "--with-clip", "b", "--json", "tracked.json"]), "tracked.json", DELAY_S);
    for part in ["the second camera's stamps are later", "[mount]\ndelay_s = 0.04", "# for b.toml", "[camera]\nlatency_s = 0.04"] {
        assert!(said.contains(part), "{part}: {said}");
    }
    // The configs accept the lines.
    let config = std::fs::read_to_string(pair().join("a.toml")).unwrap();
    let with = config.replace("[camera]", "[camera]\nlatency_s = 0.0410") + "[mount]\noffset_m = [0, 0, 0]\ndelay_s = 0.0410\n";
    std::fs::write(pair().join("with.toml"), with).unwrap();
    let check = crate::program().args(["check", "--config", "with.toml", "--no-device"]).current_dir(pair()).output().unwrap();
    assert!(!text(&check.stderr).contains("latency_s") && !text(&check.stderr).contains("delay_s"), "{}", text(&check.stderr));
}

#[test]
fn a_camera_that_knows_no_stage_is_compared_by_its_pictures() {
    let said = assert_right(&run(&["--with", "fov.toml", "--with-clip", "b", "--json", "fov.json"]), "fov.json", DELAY_S);
    assert!(said.contains("rotations between"), "{said}");
    // A guessed lens is not tracked, even with a stage.
    let config = std::fs::read_to_string(pair().join("b.toml")).unwrap();
    std::fs::write(pair().join("guess.toml"), config.replace("calibration = \"b-camera.toml\"", "fov_deg = 60")).unwrap();
    let said = assert_right(&run(&["--with", "guess.toml", "--with-clip", "b", "--json", "guess.json"]), "guess.json", DELAY_S);
    assert!(said.contains("rotations between"), "{said}");
    // Other commands still need a stage.
    let refused = crate::program().args(["replay", "b", "--config", "fov.toml"]).current_dir(pair()).output().unwrap();
    assert!(refused.status.code() == Some(2) && text(&refused.stderr).contains("stage.surface"), "{}", text(&refused.stderr));
}

/// Returns the second camera's true orientations, 100 a second, with their stamps.
fn log() -> impl Iterator<Item = (f64, UnitQuaternion<f64>)> {
    let times = (0..(SPAN_S * 100.0) as u32).map(|k| f64::from(k) * 0.01);
    times.map(|t| (t + 100.0 - 0.0237, filming(&panned(t)).rotation))
}

#[test]
fn logs_of_other_trackers_are_compared() {
    let line = |(t, q): (f64, UnitQuaternion<f64>)| format!("{t:.6} 0 0 0 {} {} {} {}\n", q.coords.x, q.coords.y, q.coords.z, q.coords.w);
    std::fs::write(pair().join("log.txt"), log().map(line).collect::<String>()).unwrap();
    let said = assert_right(&run(&["--with-log", "log.txt", "--json", "log.json"]), "log.json", -0.0237);
    assert!(
        said.contains("the first camera's stamps are later") && said.contains("# for a.toml") && said.contains("latency_s = 0.02"),
        "{said}"
    );
    let replay = ["replay", "b", "--config", "b.toml", "--poses", "b.jsonl"];
    assert!(crate::program().args(replay).current_dir(pair()).output().unwrap().status.success());
    assert_right(&run(&["--with-log", "b.jsonl", "--json", "record.json"]), "record.json", DELAY_S);
}

#[test]
fn freed_captures_are_compared_on_the_clock_that_the_recording_states() {
    // A capture file of libpcap, nanoseconds, with UTC stamps 1000 s ahead of the clip's clock.
    let number = |n: u32| n.to_le_bytes();
    let mut capture = [number(0xA1B2_3C4D).as_slice(), &[0; 20]].concat();
    for (t, q) in log() {
        let ns = ((t + 1000.0) * 1e9).round() as u64;
        let body = stagepose::protocols::to_body_axes(&Pose::new(q, nalgebra::Vector3::zeros()));
        let packet = FreedPacket::of_pose(1, &body, 0.0).encode().0;
        [(ns / 1_000_000_000) as u32, (ns % 1_000_000_000) as u32, 71, 71].iter().for_each(|n| capture.extend(number(*n)));
        capture.extend([0; 42]);
        capture.extend(packet);
    }
    std::fs::write(pair().join("freed.pcap"), capture).unwrap();
    let refused = run(&["--with-log", "freed.pcap"]);
    assert!(text(&refused.stderr).contains("its stamps are UTC, and a has no clip.toml"), "{}", text(&refused.stderr));
    // A clip with such a clip.toml: links to the same frames.
    let recorded = pair().join("recorded");
    std::fs::create_dir(&recorded).unwrap();
    std::os::unix::fs::symlink(pair().join("a/frames"), recorded.join("frames")).unwrap();
    std::fs::copy(pair().join("a/timestamps.csv"), recorded.join("timestamps.csv")).unwrap();
    std::fs::write(recorded.join("clip.toml"), "[clock]\nmonotonic_ns = 5000000000\nutc_ns = 1005000000000\n").unwrap();
    let arguments = ["delay", "--config", "a.toml", "--clip", "recorded", "--with-log", "freed.pcap", "--json", "freed.json"];
    let output = crate::program().args(arguments).current_dir(pair()).output().unwrap();
    assert_right(&output, "freed.json", -0.0237);
}

#[test]
fn bad_pairs_are_refused_with_a_sentence_and_json() {
    let refused = |more: &[&str], code: i32, parts: &[&str]| {
        let output = run(more);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{said}{}", text(&output.stdout));
        assert!(parts.iter().all(|part| said.contains(part)) && !said.contains("panicked"), "{said}");
    };
    refused(&[], 2, &["--with"]);
    refused(&["--with", "b.toml"], 2, &["--with-clip"]);
    refused(&["--with", "b.toml", "--with-clip", "b", "--with-log", "x"], 2, &["--with-log"]);
    refused(&["--with", "b.toml", "--with-clip", "-"], 2, &["must be files or folders"]);
    refused(&["--with", "b.toml", "--with-clip", "b", "--range-s", "0"], 2, &["0.05 to 60"]);
    refused(&["--with", "b.toml", "--with-clip", "b", "--json", "a.toml"], 2, &["--json"]);
    refused(&["--with-log", "none.txt"], 2, &["none.txt", "name a readable file"]);
    std::fs::write(pair().join("bad.txt"), "1 0 0 0 0 0 0 1\n2 0 0\n").unwrap();
    refused(&["--with-log", "bad.txt"], 1, &["bad.txt: line 2: 3 numbers, not the 8"]);
    std::fs::write(pair().join("freed.bin"), FreedPacket::default().encode().0.repeat(4)).unwrap();
    refused(&["--with-log", "freed.bin"], 1, &["freed.bin: FreeD packets without time stamps", "tcpdump"]);
    // A camera that stands still.
    let still = pair().join("still");
    std::fs::create_dir_all(still.join("frames")).unwrap();
    let rows: Vec<f64> = times(OTHER_FPS).iter().map(|t| t + 100.0).collect();
    restamp(&still, &rows);
    for k in 0..rows.len() {
        std::fs::copy(pair().join("b/frames/000.png"), still.join(format!("frames/{k:03}.png"))).unwrap();
    }
    refused(&["--with", "fov.toml", "--with-clip", "still", "--json", "still.json"], 1, &["the second camera has no rotation"]);
    assert!(json("still.json")["delay_s"].is_null() && json("still.json")["verdict"] == "do not use", "{}", json("still.json"));
    std::fs::write(pair().join("apart.txt"), "1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n").unwrap();
    refused(&["--with-log", "apart.txt"], 1, &["the clips do not overlap", "stamps of one clock"]);
}
