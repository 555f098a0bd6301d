//! Inputs that are not a walk around this stage: each is refused in one sentence, and nothing is
//! overwritten.

use std::io::{BufRead, BufReader};

use image::GrayImage;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use stagepose::diagnostics::simulate::{grey, paint};

use super::{Walk, frames};

fn survey<'a>(clip: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["survey", clip, "--config", "stage.toml", "--output", "surveyed"], more].concat()
}

#[test]
fn clips_that_are_not_a_walk_are_refused_with_the_reason() {
    let walk = Walk::new();
    let other = grey(&paint(480, 270, 77));
    walk.save("elsewhere", &vec![other; 4]);
    walk.save("still", &vec![frames()[20].clone(); 6]);
    walk.save("one", &frames()[..1]);
    walk.save("dark", &vec![GrayImage::new(480, 270); 3]);
    for (clip, part) in [
        ("elsewhere", "the stage is found in none of the 4 frames"),
        ("still", "the camera came to"),
        ("one", "the camera came to"),
        ("dark", "the stage is found in none of the 3 frames"),
        ("nothing", "nothing"),
    ] {
        walk.run(&survey(clip, &[])).assert_refused(1, &[part]);
        assert!(!walk.path("surveyed").exists(), "{clip}");
    }
}

#[test]
fn an_earlier_survey_is_replaced_completely() {
    let walk = Walk::new();
    walk.shorten();
    std::fs::create_dir(walk.path("surveyed")).expect("it can be made");
    walk.write("surveyed/mine.txt", "keep");
    walk.run(&survey("short", &[])).assert_refused(2, &["surveyed", "no earlier survey wrote"]);
    assert_eq!(walk.read("surveyed/mine.txt"), "keep");
    std::fs::remove_file(walk.path("surveyed/mine.txt")).expect("it is there");
    walk.run(&survey("short", &[])).assert_success();
    let first = walk.files("surveyed");
    // A failing survey leaves the earlier one as it was.
    walk.save("one", &frames()[..1]);
    walk.run(&survey("one", &[])).assert_refused(1, &["the camera came to"]);
    assert_eq!(walk.files("surveyed"), first);
    walk.run(&survey("short", &[])).assert_success();
    assert_eq!(walk.files("surveyed"), first);
    a_shape_of_another_picture_or_size_is_refused_with_the_mend(&walk);
}

fn a_shape_of_another_picture_or_size_is_refused_with_the_mend(walk: &Walk) {
    std::fs::copy(walk.path("surveyed/shape-1.toml"), walk.path("shape.toml")).expect("it can be copied");
    let config = |surface: &str| {
        walk.write(
            "bent.toml",
            &format!("[camera]\ncalibration = \"camera.toml\"\n[[stage.surface]]\n{surface}\nshape = \"shape.toml\"\n"),
        );
        walk.run(&["check", "--config", "bent.toml", "--no-device"])
    };
    config("image = \"backdrop.png\"\nsize_m = [4.0, 3.0]").assert_success();
    config("image = \"flat.png\"\nsize_m = [4.0, 3.0]")
        .assert_refused(2, &["bent.toml", "line 6", "shape.toml", "another picture", "stagepose survey"]);
    config("image = \"backdrop.png\"\nsize_m = [4.0, 2.9]").assert_refused(2, &["shape.toml", "4 x 3 m", "4 x 2.9 m"]);
    walk.write("shape.toml", "picture = 3\n");
    config("image = \"backdrop.png\"\nsize_m = [4.0, 3.0]").assert_refused(2, &["shape.toml", "line 1"]);
}

#[test]
fn an_interrupted_survey_keeps_the_earlier_one_and_resumes() {
    let walk = Walk::new();
    walk.run(&survey("walk", &[])).assert_success();
    let first = walk.files("surveyed");
    // Leftovers of a run that was killed while writing must not enter the next survey.
    std::fs::create_dir(walk.path(".surveyed.new")).expect("it can be made");
    walk.write(".surveyed.new/shape-9.toml", "");
    let mut child = crate::program()
        .args(survey("walk", &["--log", "debug", "--json", "out.json"]))
        .current_dir(walk.path(""))
        .stderr(std::process::Stdio::piped())
        .stdout(std::process::Stdio::null())
        .spawn()
        .expect("the program runs");
    let mut lines = BufReader::new(child.stderr.take().expect("it is piped")).lines().map_while(Result::ok);
    assert!(lines.any(|line| line.contains("survey::walked::adjustment")), "it adjusts");
    kill(Pid::from_raw(child.id() as i32), Signal::SIGINT).expect("it runs");
    let rest: Vec<String> = lines.collect();
    assert_eq!(child.wait().expect("it ends").code(), Some(1));
    assert!(
        rest.iter().any(|line| line.contains("interrupted; nothing was written") && line.contains("to continue from there")),
        "{rest:?}"
    );
    assert!(!walk.path("out.json").exists());
    assert_eq!(walk.files("surveyed"), first);
    let kept = std::fs::read(walk.path(".surveyed.walk")).expect("the walk is kept");
    let words = "continuing from there";
    let again = walk.run(&survey("walk", &["--log", "info"]));
    again.assert_success();
    assert!(again.stderr.contains(words), "{}", again.stderr);
    assert_eq!(walk.files("surveyed"), first);
    assert!([".surveyed.new", ".surveyed.old", ".surveyed.walk"].iter().all(|name| !walk.path(name).exists()));
    // A kept walk that is damaged or belongs to other clips is ignored.
    for (bytes, clip) in [(&kept[..kept.len() / 2], "walk"), (&kept[..], "other")] {
        walk.save("other", frames());
        std::fs::write(walk.path(".surveyed.walk"), bytes).expect("it can be written");
        let anew = walk.run(&survey(clip, &["--log", "info"]));
        anew.assert_success();
        assert!(!anew.stderr.contains(words), "{}", anew.stderr);
        assert_eq!(walk.files("surveyed"), first);
    }
}
