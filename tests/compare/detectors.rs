//! `stagepose detectors` as a user runs it.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;
use stagepose::diagnostics::simulate::{grey, paint};

fn detectors(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stagepose"));
    command.current_dir(folder).arg("detectors").args(arguments).output().expect("the program runs")
}

fn rows(folder: &Path, arguments: &[&str]) -> Vec<Value> {
    let output = detectors(folder, arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let bytes = std::fs::read(folder.join("table.json")).expect("the table is there");
    serde_json::from_slice(&bytes).expect("the table is JSON")
}

#[test]
fn detectors_are_measured_on_known_views() {
    let folder = tempfile::tempdir().expect("a folder");
    grey(&paint(400, 300, 1)).save(folder.path().join("one.png")).expect("it can be written");
    let rows = rows(folder.path(), &["one.png", "--only", "sift,harris", "--json", "table.json"]);
    assert_eq!(rows.len(), 14);
    let of = |detector: &str, pair: &str| {
        let is_it = |row: &&Value| row["detector"] == detector && row["pair"].as_str().is_some_and(|p| p.ends_with(pair));
        rows.iter().find(is_it).unwrap_or_else(|| panic!("no row of {detector}, {pair}"))
    };
    // SIFT tolerates a roll, corners with upright patches do not, and both tolerate less light.
    let [sift, harris] = ["sift", "harris"].map(|detector| of(detector, "roll 30"));
    assert!(sift["repeatability"].as_f64() > Some(0.5) && sift["right"].as_f64() > Some(0.9), "{sift}");
    assert!(sift["corner_error_px"].as_f64().is_some_and(|e| e < 0.5), "{sift}");
    assert!(harris["repeatability"].as_f64() > Some(0.4) && harris["right"].as_f64() < Some(0.5), "{harris}");
    for detector in ["sift", "harris"] {
        let dim = of(detector, "dim 0.4");
        assert!(dim["right"].as_f64() > Some(0.9) && dim["localisation_error_px"].as_f64() < Some(1.0), "{dim}");
    }
}

#[test]
fn measuring_photographs_needs_their_homographies() {
    let folder = tempfile::tempdir().expect("a folder");
    grey(&paint(400, 300, 1)).save(folder.path().join("one.png")).expect("it can be written");
    std::fs::write(folder.path().join("same"), "1 0 0\n0 1 0\n0 0 1\n").expect("it can be written");
    std::fs::write(folder.path().join("line"), "1 0 0 0 1 0 0 1 0").expect("it can be written");
    std::fs::write(folder.path().join("words"), "one nought nought").expect("it can be written");
    let pair: &[&str] = &["one.png", "one.png", "--only", "live", "--json", "table.json"];
    let rows = rows(folder.path(), &[pair, &["--homography", "same"]].concat());
    assert_eq!((rows.len(), rows[0]["right"].as_f64()), (1, Some(1.0)));
    for (more, words) in [
        (&["--homography", "line"][..], "line: maps the picture to a line"),
        (&["--homography", "words"], "words: has more than numbers"),
        (&["--homography", "gone"], "gone: cannot be read"),
        (&["--homography", "same", "--homography", "same"], "one --homography for each picture after the first"),
        (&["--only", "orb"], "there is no such detector"),
    ] {
        let output = detectors(folder.path(), &[pair, more].concat());
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && stderr.contains(words) && !stderr.contains("panicked"), "{more:?}: {stderr}");
    }
}
