//! Names that contain terminal escape sequences: every command escapes them, on stdout, on stderr
//! and in the log.

use stagepose::diagnostics::printable::stands_for_itself;

use super::scene::{CONFIG, Run, Scene};

/// Sets the terminal's title, clears the screen (with a C1 control), and reverses the writing
/// direction.
const NAME: &str = "clip\x1b]0;x\x07\u{9b}2J\u{202e}";
const ESCAPED: &str = "clip\\u001b]0;x\\u0007\\u009b2J\\u202e";

/// Asserts that no control character came out raw, and that the output has the escaped name.
fn assert_escaped(run: &Run, what: &str) {
    for text in [&run.stdout, &run.stderr] {
        assert!(text.chars().all(|c| c == '\n' || stands_for_itself(c)), "{what}: {text:?}");
    }
    assert!(run.stdout.contains(ESCAPED) || run.stderr.contains(ESCAPED), "{what}: {} {}", run.stdout, run.stderr);
}

#[test]
fn every_command_escapes_names() {
    let scene = Scene::new();
    std::fs::rename(scene.path("clip"), scene.path(NAME)).unwrap();
    let checked = scene.run(&["check", "--config", "stage.toml", "--clip", NAME]);
    checked.assert_success();
    assert!(checked.stdout.contains(ESCAPED), "{}", checked.stdout);
    assert_escaped(&checked, "check");
    let missing = format!("{NAME}/no");
    for (arguments, what) in [
        (vec!["check", "--config", NAME], "a config"),
        (vec!["replay", missing.as_str(), "--config", "stage.toml"], "a clip"),
        (vec!["replay", NAME, "--config", "stage.toml", "--poses", "no/such/\x1b]0;x\x07"], "an output"),
        (vec!["replay", NAME, "--config", "stage.toml", NAME], "an argument"),
        (vec![NAME], "a command"),
        (vec!["calibrate", NAME, "--board", "9x6", "--square-mm", "25"], "pictures"),
    ] {
        let run = scene.run(&arguments);
        assert_ne!(run.code, 0, "{what}");
        for text in [&run.stdout, &run.stderr] {
            assert!(text.chars().all(|c| c == '\n' || stands_for_itself(c)), "{what}: {text:?}");
        }
        let said = run.stdout + &run.stderr;
        // The argument parser writes usage errors and removes such sequences itself.
        let is_usage = ["an argument", "a command"].contains(&what);
        assert!(!said.is_empty() && (is_usage || said.contains("\\u001b]0;x\\u0007")), "{what}: {said}");
    }
}

#[test]
fn the_log_and_the_events_escape_names() {
    let scene = Scene::new();
    std::fs::rename(scene.path("clip"), scene.path(NAME)).unwrap();
    for format in ["text", "json"] {
        scene.write("stage.toml", &format!("{CONFIG}[log]\nformat = \"{format}\"\n"));
        let run = scene.run(&["run", "--config", "stage.toml", "--play", NAME, "--events", "-", "--log", "info"]);
        run.assert_success();
        assert!(run.stdout.contains("camera_opened") && run.stdout.contains(ESCAPED), "{}", run.stdout);
        // The logging library has already escaped some of them in its own way.
        assert!(run.stderr.contains("clip\\"), "{}", run.stderr);
        assert_escaped(&run, format);
        let json = if format == "json" { run.stdout + &run.stderr } else { run.stdout };
        json.lines().for_each(|line| drop(serde_json::from_str::<serde_json::Value>(line).unwrap()));
    }
}

#[test]
fn a_config_with_control_characters_is_refused() {
    let scene = Scene::new();
    scene.write("stage.toml", &format!("{CONFIG}[[object]]\nname = \"a\\u001b]0;x\\u0007\"\n"));
    scene
        .run(&["check", "--config", "stage.toml"])
        .assert_refused(2, &["`name` in [[object]], line 7: \"a\\u001b]0;x\\u0007\" has control"]);
}
