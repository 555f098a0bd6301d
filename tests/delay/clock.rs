//! `stagepose delay --clock` on rendered clips of a screen that shows the clock, with exact times.

use std::path::Path;

use image::{GrayImage, Luma};
use serde_json::Value;

use super::text;

/// Frames per second, and the exposure, seconds.
const FPS: f64 = 25.0;
const EXPOSURE_S: f64 = 0.012;
/// Interval between two codes: three refreshes of a screen at 59.94 per second.
const HOLD_S: f64 = 3.0 / 59.94;
/// When the screen's code 0 would be shown, UTC seconds.
const BEGIN_S: f64 = 1_790_000_000.25;
/// How much longer than its code the screen takes to shine, seconds.
const LAG_S: f64 = 0.021;

/// Returns the page's code at a time: whether each of 18 x 8 cells is white.
fn is_white([column, row]: [i64; 2], ms: f64) -> bool {
    let depth = column.min(17 - column).min(row).min(7 - row);
    if depth < 2 {
        return depth < 0 || depth == 1 && [column, row] != [1, 1];
    }
    let time = ms.round() as u64 % (1 << 28);
    let bit = (column - 2) + 14 * ((row - 2) / 2);
    ((time ^ (time >> 1)) >> bit & 1 == 1) != (row % 2 == 1)
}

/// Returns what a camera sees that is exposed around this time: seconds after [`BEGIN_S`].
fn filmed(middle_s: f64) -> GrayImage {
    let [from, to] = [-0.5, 0.5].map(|half| ((middle_s + half * EXPOSURE_S - LAG_S) / HOLD_S).floor());
    let share = if from == to { 0.0 } else { (middle_s + 0.5 * EXPOSURE_S - LAG_S - to * HOLD_S) / EXPOSURE_S };
    let code = |n: f64| (BEGIN_S + n * HOLD_S) * 1e3;
    let (cell, left, top) = (16.0, 30.0, 26.0);
    GrayImage::from_fn(352, 200, |x, y| {
        let at = [(f64::from(x) - left) / cell, (f64::from(y) - top) / cell];
        let white = |n: f64| f64::from(u8::from(is_white(at.map(|v| v.floor() as i64), code(n))));
        let is_screen = (-1.0..19.0).contains(&at[0]) && (-1.0..9.0).contains(&at[1]);
        let light = if is_screen { 0.02 + 0.8 * ((1.0 - share) * white(from) + share * white(to)) } else { 0.01 };
        Luma([(255.0 * f64::powf(light, 1.0 / 2.2)).round() as u8])
    })
}

/// Writes a clip whose stamps are late by this much after the exposure, seconds by frame number.
fn clip(folder: &Path, name: &str, frames: u32, late_s: impl Fn(u32) -> f64) {
    let clip = folder.join(name);
    std::fs::create_dir_all(clip.join("frames")).unwrap();
    let mut rows = String::from("#timestamp [ns],filename\n");
    for k in 0..frames {
        let middle_s = 0.1 + f64::from(k) / FPS;
        filmed(middle_s).save(clip.join(format!("frames/{k:03}.png"))).unwrap();
        // The clip's clock begins 5 s before the screen's.
        rows += &format!("{},{k:03}.png\n", ((5.0 + middle_s + late_s(k)) * 1e9).round() as i64);
    }
    std::fs::write(clip.join("timestamps.csv"), rows).unwrap();
    let utc_ns = (BEGIN_S * 1e9) as i64;
    std::fs::write(clip.join("clip.toml"), format!("[clock]\nmonotonic_ns = 5000000000\nutc_ns = {utc_ns}\n")).unwrap();
}

fn delay(folder: &Path, clip: &str, more: &[&str]) -> (Option<i32>, String, Value) {
    let arguments = ["delay", "--config", "camera.toml", "--clip", clip, "--clock", "--json", "out.json"];
    let output = crate::program().args(arguments).args(more).current_dir(folder).output().unwrap();
    let said = std::fs::read(folder.join("out.json")).map(|bytes| serde_json::from_slice(&bytes).unwrap()).unwrap_or_default();
    (output.status.code(), text(&output.stdout) + &text(&output.stderr), said)
}

#[test]
fn a_filmed_clock_shows_how_late_stamps_are() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::write(at.join("camera.toml"), "[camera]\nfov_deg = 60\nshutter = \"global\"\n").unwrap();
    // A delay of 33 ms that grows by 3 ms a minute, and stamps that scatter by 2.1 ms (rms).
    let scatter = [-3.0, 1.0, 2.0, 0.0, -1.0, 3.0, -2.0];
    let late_s = |k: u32| 0.033 + 0.003 / 60.0 * f64::from(k) / FPS + 1e-3 * scatter[(k * 5 % 7) as usize];
    clip(at, "a", 300, late_s);
    let (code, said, json) = delay(at, "a", &["--screen-lag-ms", "21"]);
    assert_eq!(code, Some(0), "{said}");
    println!("{said}");
    let number = |key: &str| json[key].as_f64().unwrap_or_else(|| panic!("{key}: {json:#}"));
    assert!((number("delay_s") - 0.0333).abs() < 0.001, "{json:#}");
    assert!((number("spread_s") - 0.002).abs() < 0.001, "{json:#}");
    assert!((number("drift_s_per_min") - 0.003).abs() < 4.0 * number("drift_sigma_s_per_min"), "{json:#}");
    assert!(number("with_clock") > 280.0 && number("late") == 0.0, "{json:#}");
    assert!(said.contains("[camera]\nlatency_s = 0.033"), "{said}");
    // Without the screen's lag the delay is within its sigma.
    let (code, said, json) = delay(at, "a", &[]);
    let (delay_s, sigma_s) = (json["delay_s"].as_f64().unwrap(), json["sigma_s"].as_f64().unwrap());
    assert!(code == Some(0) && (delay_s - 0.0333).abs() < sigma_s && json["verdict"] == "usable", "{said}");
    assert!(said.contains("--screen-lag-ms"), "{said}");
    // Without UTC, spread and drift remain.
    std::fs::remove_file(at.join("a/clip.toml")).unwrap();
    let (code, said, json) = delay(at, "a", &[]);
    assert!(code == Some(1) && json["delay_s"].is_null() && said.contains("clip.toml"), "{said}");
    assert!((json["spread_s"].as_f64().unwrap() - 0.002).abs() < 0.001, "{json:#}");
}

#[test]
fn clips_that_do_not_show_the_clock_are_refused_with_what_to_film() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::write(at.join("camera.toml"), "[camera]\nfov_deg = 60\n").unwrap();
    clip(at, "short", 5, |_| 0.0);
    let (code, said, json) = delay(at, "short", &[]);
    assert!(code == Some(1) && said.contains("5 of 5 frames show the clock, 24 are needed"), "{said}");
    assert!(json["delay_s"].is_null() && json["verdict"] == "do not use", "{json:#}");
    for (more, word) in [(["--screen-lag-ms", "900"], "0 to 500"), (["--with-log", "a.txt"], "cannot be used with")] {
        let (code, said, _) = delay(at, "short", &more);
        assert!(code == Some(2) && said.contains(word), "{said}");
    }
}
