//! Arguments: every command has help with an example, and bad usage ends with code 2.

use super::scene::Scene;

#[test]
fn every_command_has_help_with_an_example() {
    let scene = Scene::new();
    let names = [
        "replay",
        "check",
        "demo",
        "calibrate",
        "board",
        "poster",
        "export",
        "timecode",
        "mount",
        "delay",
        "devices",
        "run",
        "record",
        "send-test",
        "listen",
        "report",
        "completions",
        "man",
    ];
    let commands = names.map(|name| vec![name, "--help"]).into_iter().chain([vec!["--help"]]);
    for command in commands {
        let run = scene.run(&command);
        run.assert_success();
        assert!(run.stdout.contains("Example:\n  stagepose "), "{command:?}: {}", run.stdout);
    }
}

#[test]
fn bad_usage_exits_with_code_2() {
    let scene = Scene::new();
    let cases: [&[&str]; 10] = [
        &[],
        &["dance"],
        &["replay"],
        &["replay", "clip"],
        &["replay", "clip", "--config", "stage.toml", "--fps", "0"],
        &["replay", "clip", "--config", "stage.toml", "--threads", "0"],
        &["replay", "clip", "--config", "stage.toml", "--log", "loud"],
        &["listen", "freed", "0"],
        &["listen", "vrpn", "4000"],
        &["send-test", "--config", "stage.toml", "--fps", "0"],
    ];
    for arguments in cases {
        let run = scene.run(arguments);
        assert_eq!(run.code, 2, "{arguments:?}: {}", run.stderr);
        assert!(!run.stderr.is_empty() && run.stdout.is_empty(), "{arguments:?}");
    }
}

#[test]
fn outputs_without_an_output_section() {
    let scene = Scene::new();
    scene.replay(&["--outputs"]).assert_refused(2, &["stage.toml: there is no [[output]] section to send to; omit --outputs"]);
}

#[test]
fn stdout_is_given_to_one_output_only() {
    let scene = Scene::new();
    scene.replay(&["--poses", "-", "--tum", "-"]).assert_refused(2, &["only one of --poses, --parts, --tum and --summary may be `-`"]);
}
