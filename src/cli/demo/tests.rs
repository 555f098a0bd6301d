use clap::Parser;
use nalgebra::{Matrix6, Vector3};

use super::*;
use crate::geometry::{Camera, Pose, Stage};
use crate::record::{Measurement, StageTimes, State, TwoViewModel};

#[derive(Debug, Parser)]
struct CommandLine {
    #[command(flatten)]
    demo: DemoArguments,
}

fn parse(line: &str) -> Result<DemoArguments, String> {
    let words = std::iter::once("demo").chain(line.split_whitespace());
    CommandLine::try_parse_from(words).map(|c| c.demo).map_err(|e| e.to_string())
}

fn tracked(frame: &Frame, pose: Pose<Stage, Camera>) -> PoseSample {
    let measurement = Measurement {
        pose,
        covariance: Matrix6::identity(),
        common: Matrix6::zeros(),
        model: Some(TwoViewModel::Homography),
        homography: None,
        essential: None,
        inliers: Some(100),
        rms_px: Some(0.1),
    };
    PoseSample {
        sequence: frame.sequence,
        timestamp: frame.timestamp,
        state: State::Tracking,
        pose: Some(pose),
        measurement: Some(measurement),
        objects: vec![],
        reason: None,
        learnt: Default::default(),
        times: StageTimes::default(),
    }
}

#[test]
fn arguments_have_defaults() {
    let demo = parse("").unwrap();
    assert_eq!((demo.frame_count(false), demo.width, demo.height, demo.fps, demo.seed), (150, 640, 480, 30.0, 1));
    assert_eq!((demo.save, demo.jpeg), (None, None));
}

#[test]
fn arguments_are_read() {
    let demo = parse("--frames 50 --save clip --width 320 --height 180 --seed 7 --fps 25 --jpeg 85").unwrap();
    assert_eq!((demo.frame_count(true), demo.width, demo.height, demo.fps, demo.seed), (50, 320, 180, 25.0, 7));
    assert_eq!((demo.save, demo.jpeg), (Some(PathBuf::from("clip")), Some(85)));
}

#[test]
fn bad_arguments_are_refused() {
    let bad = ["--frames 0", "--width 10", "--fps 0", "--fps nan", "--save c --jpeg 0", "--save c --jpeg 101", "--jpeg 80", "clip"];
    for line in bad {
        assert!(parse(line).is_err(), "{line} was taken");
    }
}

#[test]
fn a_session_scores_the_trackers_poses_against_the_truth() {
    let arguments = parse("--frames 31 --width 80 --height 64 --fps 20").unwrap();
    let mut camera = VirtualCamera::new(scene(&arguments, arguments.frame_count(false)).unwrap(), 20.0, 31);
    let truth: Vec<_> = (0..31).map(|k| camera.truth(k)).collect();
    let mut printed = Vec::new();
    let mut live = LivePrint::to(&mut printed, false);
    // Off by 3 mm sideways in every frame, and by half a metre in one.
    let off_m = |sequence: u64| if sequence == 20 { 0.5 } else { 0.003 };
    let track = |frame: &Frame| {
        let truth = truth[frame.sequence as usize];
        Ok(tracked(frame, Pose::new(truth.rotation, truth.translation + Vector3::x() * off_m(frame.sequence))))
    };
    let errors = session(&mut camera, track, None, None, &mut live).unwrap();
    let table = errors.to_string();
    for wanted in ["tracking              31   100.0 %", "position [mm]     3.0000    3.0000  500.0000", "wrong poses            1"] {
        assert!(table.contains(wanted), "{wanted:?} is not in\n{table}");
    }
    // Not a terminal: frames 0, 15 and 30.
    let lines: Vec<String> = String::from_utf8(printed).unwrap().lines().map(str::to_owned).collect();
    assert_eq!(lines.len(), 3);
    assert!(lines[1].starts_with("    15 tracking  at ") && lines[1].ends_with("off 3.00 mm"), "{}", lines[1]);
}

#[test]
fn a_terminal_gets_one_rewritten_line() {
    let arguments = parse("--frames 2 --width 64 --height 64").unwrap();
    let mut camera = VirtualCamera::new(scene(&arguments, arguments.frame_count(false)).unwrap(), 30.0, 2);
    let mut printed = Vec::new();
    let truth = camera.truth(0);
    session(&mut camera, |frame| Ok(tracked(frame, truth)), None, None, &mut LivePrint::to(&mut printed, true)).unwrap();
    let text = String::from_utf8(printed).unwrap();
    assert_eq!((text.matches('\r').count(), text.matches('\n').count()), (2, 1), "{text:?}");
}

#[test]
fn a_saved_clip_holds_what_was_rendered() {
    let folder = tempfile::tempdir().unwrap();
    let clip = folder.path().join("clip");
    let arguments = parse("--frames 3 --width 80 --height 64").unwrap();
    let stage = scene(&arguments, arguments.frame_count(false)).unwrap();
    let mut saved = SavedClip::create(&clip, &stage, None).unwrap();
    let mut camera = VirtualCamera::new(stage.clone(), 30.0, 3);
    let mut frames = Vec::new();
    let truth = camera.truth(0);
    let keep = |frame: &Frame| {
        frames.push(frame.clone());
        Ok(tracked(frame, truth))
    };
    session(&mut camera, keep, Some(&mut saved), None, &mut LivePrint::to(io::sink(), false)).unwrap();
    saved.finish().unwrap();

    let text = |name: &str| std::fs::read_to_string(clip.join(name)).unwrap();
    assert_eq!(text("timestamps.csv"), "#timestamp [ns],filename\n0,000000.png\n33333333,000001.png\n66666667,000002.png\n");
    let picture = |name: &str| image::open(clip.join(name)).unwrap().to_luma8();
    assert_eq!(picture("frames/000002.png"), frames[2].image);
    assert_eq!(picture("flat.png"), stage.stage.surfaces[1].artwork);
    let calibration: toml::Table = text("camera.toml").parse().unwrap();
    assert_eq!(calibration["fx"].as_float(), Some(stage.camera.intrinsics().fx));
    assert_eq!(calibration["distortion"].as_array().unwrap().len(), 5);
    let config: toml::Table = text("stage.toml").parse().unwrap();
    let surface = &config["stage"]["surface"][1];
    assert_eq!((surface["image"].as_str(), surface["position_m"][1].as_float()), (Some("flat.png"), Some(-0.8)));
    let last = text("groundtruth.txt").lines().last().unwrap().to_owned();
    let expected = tracked(&frames[2], camera.truth(2)).to_tum_line().unwrap();
    assert_eq!(last, expected);

    assert!(matches!(SavedClip::create(&clip, &stage, None), Err(DemoError::Exists(_))));
}

#[test]
fn nothing_that_is_in_the_folder_is_written_over() {
    let stage = scene(&parse("--width 80 --height 64").unwrap(), FRAMES).unwrap();
    for name in ["stage.toml", "camera.toml", "flat.png", "timestamps.csv", "groundtruth.txt", "frames"] {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join(name);
        std::fs::write(&file, "hours of work").unwrap();
        let said = SavedClip::create(folder.path(), &stage, None).map(|_| ()).unwrap_err().to_string();
        assert!(said.contains(name) && said.ends_with("would be overwritten; give --save a new folder"), "{said}");
        assert_eq!(std::fs::read_to_string(&file).unwrap(), "hours of work");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "{name}");
    }
}

#[test]
fn jpeg_frames_get_their_extension_and_stay_close() {
    let folder = tempfile::tempdir().unwrap();
    let stage = scene(&parse("--width 80 --height 64").unwrap(), FRAMES).unwrap();
    let mut saved = SavedClip::create(folder.path(), &stage, Some(95)).unwrap();
    let mut camera = VirtualCamera::new(stage, 30.0, 1);
    let truth = camera.truth(0);
    let mut rendered = None;
    let keep = |frame: &Frame| {
        rendered = Some(frame.image.clone());
        Ok(tracked(frame, truth))
    };
    session(&mut camera, keep, Some(&mut saved), None, &mut LivePrint::to(io::sink(), false)).unwrap();
    let (a, b) = (image::open(folder.path().join("frames/000000.jpg")).unwrap().to_luma8(), rendered.unwrap());
    let off: f64 = a.as_raw().iter().zip(b.as_raw()).map(|(x, y)| f64::from(x.abs_diff(*y))).sum::<f64>() / a.as_raw().len() as f64;
    assert!(off < 5.0, "{off} levels off on average");
}

#[test]
fn a_folder_that_cannot_be_made_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("taken");
    std::fs::write(&file, "").unwrap();
    let stage = scene(&parse("--width 64 --height 64").unwrap(), FRAMES).unwrap();
    let error = SavedClip::create(&file.join("clip"), &stage, None).unwrap_err();
    assert!(error.to_string().contains("taken"), "{error}");
}

#[test]
fn a_demo_with_the_page_on_a_terminal_runs_longer() {
    let frames = |line: &str, is_terminal| parse(line).unwrap().frame_count(is_terminal);
    assert_eq!(frames("--no-page", true), FRAMES);
    assert_eq!(frames("--save clip", true), FRAMES);
    assert_eq!(frames("", false), FRAMES);
    assert_eq!(frames("--fps 25", true), if cfg!(feature = "http") { 15_000 } else { FRAMES });
}
