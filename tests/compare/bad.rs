//! Inputs that are not a pair of pictures, or have nothing in common: the result is a sentence, and
//! never a relation.

use std::process::{Command, Stdio};
use std::time::Duration;

use image::{GrayImage, Luma};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;
use stagepose::diagnostics::simulate::{grey, paint};

use super::compare;

fn assert_nothing(json: &Value) {
    for key in ["F", "H", "E", "rotation_xyzw", "translation_direction", "model"] {
        assert!(json[key].is_null(), "{key}: {}", json[key]);
    }
}

#[test]
fn unrelated_pictures_have_no_relation() {
    let folder = tempfile::tempdir().expect("a folder");
    let save = |name: &str, picture: &GrayImage| picture.save(folder.path().join(name)).expect("it can be written");
    save("one.png", &grey(&paint(480, 360, 1)));
    save("other.png", &grey(&paint(480, 360, 2)));
    save("even.png", &GrayImage::from_pixel(480, 360, Luma([128])));
    save("low.png", &GrayImage::from_fn(480, 1, |x, _| Luma([(x * 37) as u8])));
    save("dot.png", &GrayImage::from_pixel(1, 1, Luma([9])));
    let mut noise = 1_u32;
    let noisy = GrayImage::from_fn(480, 360, |_, _| {
        noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        Luma([(noise >> 24) as u8])
    });
    save("noise.png", &noisy);
    for (a, b) in
        [("one.png", "other.png"), ("one.png", "even.png"), ("even.png", "even.png"), ("low.png", "one.png"), ("dot.png", "dot.png")]
    {
        for detector in ["sift", "live", "harris"] {
            let found = compare(folder.path(), a, b, &["--detector", detector]);
            assert_eq!(found.code, Some(0), "{a} {b} {detector}: {}", found.stderr);
            assert_nothing(&found.json);
            assert!(found.stdout.to_lowercase().contains("no relation found"), "{}", found.stdout);
        }
    }
    let found = compare(folder.path(), "one.png", "noise.png", &[]);
    assert_nothing(&found.json);
}

#[test]
fn the_same_picture_twice_is_the_identity() {
    let folder = tempfile::tempdir().expect("a folder");
    grey(&paint(480, 360, 1)).save(folder.path().join("one.png")).expect("it can be written");
    let camera =
        "width = 480\nheight = 360\nfx = 400.0\nfy = 400.0\ncx = 239.5\ncy = 179.5\nskew = 0.0\ndistortion = [-0.1, 0.0, 0.0, 0.0, 0.0]\n";
    std::fs::write(folder.path().join("camera.toml"), camera).expect("it can be written");
    for more in [&[][..], &["--camera", "camera.toml"]] {
        let found = compare(folder.path(), "one.png", "one.png", more);
        assert_eq!((found.code, &found.json["model"]), (Some(0), &"homography".into()), "{} {}", found.stderr, found.stdout);
        let h = super::numbers::<9>(&found.json["H"]);
        let identity = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        assert!(h.iter().zip(identity).all(|(a, b)| (a - b).abs() < 1e-6), "{h:?}");
        assert!(found.json["translation_direction"].is_null());
    }
}

#[test]
fn wrong_arguments_are_named_with_a_hint() {
    let folder = tempfile::tempdir().expect("a folder");
    grey(&paint(320, 240, 1)).save(folder.path().join("one.png")).expect("it can be written");
    std::fs::write(folder.path().join("text.png"), "no picture").expect("it can be written");
    let camera =
        "width = 640\nheight = 480\nfx = 500.0\nfy = 500.0\ncx = 319.5\ncy = 239.5\nskew = 0.0\ndistortion = [0.0, 0.0, 0.0, 0.0, 0.0]\n";
    std::fs::write(folder.path().join("camera.toml"), camera).expect("it can be written");
    let cases: [(&str, &[&str], i32, &str); 12] = [
        ("gone.png", &[], 1, "gone.png"),
        ("text.png", &[], 1, "text.png"),
        ("one.png", &["--camera", "gone.toml"], 2, "gone.toml"),
        ("one.png", &["--camera", "camera.toml"], 2, "640 x 480"),
        ("one.png", &["--detector", "orb"], 2, "orb"),
        ("one.png", &["--threshold-px", "0"], 2, "--threshold-px"),
        ("one.png", &["--ratio", "2"], 2, "--ratio"),
        ("one.png", &["--detector", "harris", "--k", "7"], 2, "--k"),
        ("one.png", &["--k", "0.05"], 2, "--detector harris"),
        ("one.png", &["--half-width", "7"], 2, "--descriptor patch"),
        ("one.png", &["--detector", "live", "--cmin", "7"], 2, "--cmin changes nothing"),
        ("one.png", &["--report", "one.png"], 2, "one.png"),
    ];
    for (b, more, code, words) in cases {
        let found = compare(folder.path(), "one.png", b, more);
        assert_eq!(found.code, Some(code), "{b} {more:?}: {}", found.stderr);
        assert!(found.stderr.contains(words), "{b} {more:?}: {}", found.stderr);
        assert!(found.json.is_null() && !found.stderr.contains("panicked"), "{}", found.stderr);
    }
}

/// A signal may arrive at any time, even during a step that takes many times the ten seconds after
/// which the program is ended by force. Existing files stay, and no half-written file remains.
#[test]
fn an_interrupt_leaves_no_half_written_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let picture = grey(&paint(640, 480, 1));
    let large = image::imageops::resize(&picture, 2560, 1920, image::imageops::FilterType::Triangle);
    large.save(folder.path().join("one.png")).expect("it can be written");
    std::fs::write(folder.path().join("out.json"), "before").expect("it can be written");
    let files = || std::fs::read_dir(folder.path()).expect("the folder is there").count();
    let before = files();
    for (detector, signal) in [("asift", Signal::SIGINT), ("hessian-affine", Signal::SIGTERM)] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_stagepose"));
        command.current_dir(folder.path()).args(["compare", "one.png", "one.png", "--detector", detector]);
        command.args(["--json", "out.json", "--report", "out.html"]).stderr(Stdio::piped()).stdout(Stdio::null());
        let child = command.spawn().expect("the program runs");
        // The work takes about a minute, and the program handles signals after a tenth of a second.
        std::thread::sleep(Duration::from_millis(1500));
        kill(Pid::from_raw(child.id() as i32), signal).expect("it still runs");
        let output = child.wait_with_output().expect("it ends");
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{detector}: {stderr}");
        assert!(stderr.contains("interrupted; nothing is written"), "{detector}: {stderr}");
        let kept = std::fs::read_to_string(folder.path().join("out.json")).expect("it is there");
        assert_eq!((files(), kept.as_str()), (before, "before"), "{detector}");
    }
}
