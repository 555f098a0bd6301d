//! `stagepose timecode`, and `[timecode]` in outputs, exports and recordings.

use serde_json::Value;
use stagepose::diagnostics::timecode::{LtcSignal, TimecodeRate, wav};

use super::scene::{CONFIG, Scene};

fn signal(rate: TimecodeRate, first: &str) -> LtcSignal {
    let first = first.parse().unwrap();
    LtcSignal { sample_rate: 48_000, rate, speed: 1.0, first, frames: 60, amplitude: 0.5, noise: 0.05, lead: 4_800.0, seed: 2 }
}

/// Writes a sound whose timecode begins at 0.1 s.
fn write_sound(scene: &Scene, name: &str, signal: &LtcSignal) {
    std::fs::write(scene.path(name), wav(signal.sample_rate, &signal.samples().0)).unwrap();
}

#[test]
fn a_sound_is_read_and_its_frames_are_written() {
    let scene = Scene::new();
    let mut signal = signal(TimecodeRate::Fps29_97Drop, "00:00:58;20");
    write_sound(&scene, "ltc.wav", &signal);
    let run = scene.run(&["timecode", "ltc.wav", "--frames", "frames.csv", "--json", "out.json"]);
    run.assert_success();
    assert!(run.stdout.contains("59 frames of timecode at 29.97df"), "{}", run.stdout);
    let frames = scene.read("frames.csv");
    let rows: Vec<Vec<&str>> = frames.lines().skip(1).map(|line| line.split(',').collect()).collect();
    assert_eq!((rows.len(), rows[0][1], rows[58][1], rows[0][2]), (59, "00:00:58;21", "00:01:00;21", "forward"));
    for (k, row) in rows.iter().enumerate() {
        let wanted_s = 0.1 + (k + 1) as f64 * 1001.0 / 30_000.0;
        assert!((row[0].parse::<f64>().unwrap() - wanted_s).abs() < 2e-5, "{row:?} {wanted_s}");
    }
    let json: Value = serde_json::from_str(&scene.read("out.json")).unwrap();
    assert_eq!((&json["rate"], &json["runs"][0]["frames"], &json["unconfirmed"]), (&"29.97df".into(), &59.into(), &0.into()));
    signal.speed = -1.3;
    write_sound(&scene, "back.wav", &signal);
    let run = scene.run(&["timecode", "back.wav", "--rate", "25"]);
    run.assert_success();
    assert!(run.stdout.contains("-1.30") && run.stdout.contains("note: it runs at 29.97df, not at 25"), "{}", run.stdout);
}

#[test]
fn sounds_without_timecode_are_refused_with_the_fix() {
    let scene = Scene::new();
    write_sound(&scene, "silence.wav", &LtcSignal { frames: 0, ..signal(TimecodeRate::Fps25, "00:00:00:00") });
    scene.write("text.wav", "no sound");
    scene.run(&["timecode", "silence.wav"]).assert_refused(1, &["silence.wav: there is no timecode in channel 1", "--channel"]);
    scene.run(&["timecode", "silence.wav", "--channel", "2"]).assert_refused(1, &["channel 2 is not there"]);
    scene.run(&["timecode", "text.wav"]).assert_refused(1, &["text.wav: it is no WAV file", "ffmpeg"]);
    scene.run(&["timecode", "missing.wav"]).assert_refused(1, &["missing.wav"]);
    scene.run(&["timecode", "clip"]).assert_refused(1, &["clip"]);
    scene.run(&["timecode", "silence.wav", "--json", "silence.wav"]).assert_refused(2, &["--json", "the sound"]);
    let usage = scene.run(&["timecode", "silence.wav", "--raw", "48000x0"]);
    assert!(usage.code == 2 && usage.stderr.contains("48000x2"), "{}", usage.stderr);
}

#[test]
fn outputs_and_exports_have_the_timecode_of_every_frame() {
    let scene = Scene::new();
    write_sound(&scene, "ltc.wav", &signal(TimecodeRate::Fps25, "10:00:00:00"));
    // Row 0 lies 1.01 s after the sound's first sample: 0.91 s of timecode.
    let timecode = "[timecode]\nfile = \"ltc.wav\"\nbegins_s = -1.01\n";
    let output = "[[output]]\nkind = \"json\"\non_loss = \"flag\"\nfile = \"sent.jsonl\"\n[safety]\nstale_after_s = 60\n";
    scene.write("stage.toml", &format!("{CONFIG}{timecode}{output}"));
    scene.replay(&["--outputs", "--poses", "poses.jsonl"]).assert_success();
    assert!(!scene.read("poses.jsonl").contains("timecode"), "C3 has its own keys");
    let sent: Vec<Value> = scene.read("sent.jsonl").lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(sent.len(), 6);
    for (k, line) in sent.iter().enumerate() {
        let frames = (0.91 + k as f64 / 30.0) * 25.0;
        let wanted = format!("10:00:0{}:{:02}", frames as u32 / 25, frames as u32 % 25);
        assert_eq!((&line["timecode"]["timecode"], &line["timecode"]["state"]), (&wanted.as_str().into(), &"locked".into()));
        assert!((line["timecode"]["fraction"].as_f64().unwrap() - frames.fract()).abs() < 0.01, "{line}");
    }
    for (to, file, parts) in [
        ("usd", "take.usda", vec!["stagepose:timecode.timeSamples", "0: \"10:00:00:22\"", "stagepose:timecodeRate = \"25\""]),
        ("blender", "take.py", vec!["\"code\":\"10:00:00:22\"", "\"rate\":\"25\""]),
        // 10 h and 27 frames of 30 a second: the clip's own rate.
        ("ae", "take.jsx", vec!["\"start\":{\"is_drop\":false,\"seconds\":36000.9}"]),
        ("gltf", "take.gltf", vec!["\"timecode\":\"10:00:00:22\""]),
        ("mcap", "take.mcap", vec!["/stagepose/timecode", "{\"timecode\":\"10:00:01:01\""]),
        ("chan", "take.chan", vec!["6\t"]),
    ] {
        let run = scene.run(&["export", "poses.jsonl", "--to", to, "--config", "stage.toml", "-o", file]);
        run.assert_success();
        assert!(run.stdout.contains("timecode 10:00:00:22 in row 0, at 25; 6 of 6 frames have one"), "{}", run.stdout);
        let text = String::from_utf8_lossy(&std::fs::read(scene.path(file)).unwrap()).into_owned();
        parts.iter().for_each(|part| assert!(text.contains(part), "{to}: no {part}"));
    }
}

#[test]
fn what_a_recording_has_beside_its_rows_comes_before_the_config() {
    let scene = Scene::new();
    scene.replay(&["--poses", "poses.jsonl"]).assert_success();
    let head = "#timestamp [ns],timecode,fraction of the frame,rate,state,seconds without\n";
    scene.write("timecode.csv", &format!("{head}33333333,00:00:59:29,0.5,29.97,free-wheeling,2.000\n"));
    // A pipe of the recording's time is not read.
    scene.write("stage.toml", &format!("{CONFIG}[timecode]\nfile = \"gone.fifo\"\n"));
    let export = ["export", "poses.jsonl", "--to", "usd", "--config", "stage.toml", "-o", "take.usda"];
    let run = scene.run(&export);
    run.assert_success();
    assert!(run.stdout.contains("timecode 00:00:59:29 in row 1, at 29.97; 5 of 6 frames have one"), "{}", run.stdout);
    scene.write("timecode.csv", &format!("{head}33333333,00:00:59:29,0.5,25,locked,0\n"));
    scene.run(&export).assert_refused(1, &["timecode.csv: line 2", "fits its rate"]);
    std::fs::remove_file(scene.path("timecode.csv")).unwrap();
    let run = scene.run(&export);
    run.assert_success();
    assert!(!run.stdout.contains("timecode") && run.stderr.contains("gone.fifo"), "{}", run.stderr);
}

#[test]
fn check_says_what_the_timecode_is() {
    let scene = Scene::new();
    write_sound(&scene, "ltc.wav", &signal(TimecodeRate::Fps25, "10:00:00:00"));
    for (keys, wanted) in [
        ("file = \"ltc.wav\"", "timecode    ltc.wav: 10:00:00:01 to 10:00:02:09 at 25\n"),
        ("file = \"ltc.wav\"\nrate = \"30\"", "at 25, but `rate` is 30: correct it\n"),
        ("file = \"ltc.wav\"\nchannel = 2", "channel 2 is not there"),
        ("file = \"ltc.fifo\"", "timecode    ltc.fifo is not there yet; `run` waits for it\n"),
        ("file = \"-\"", "timecode    standard input, read while the camera runs\n"),
    ] {
        scene.write("stage.toml", &format!("{CONFIG}[timecode]\n{keys}\n"));
        let run = scene.run(&["check", "--config", "stage.toml", "--no-device"]);
        run.assert_success();
        assert!(run.stdout.contains(wanted), "{keys}: {}", run.stdout);
    }
}
