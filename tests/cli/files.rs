//! Special files, names that lead elsewhere, and outputs that would overwrite inputs: each is
//! refused promptly in one sentence, and nothing is lost.

use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use image::{GrayImage, ImageEncoder};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use super::scene::{CAMERA, CONFIG, Run, Scene};

/// Longer than any run here takes on a loaded machine; a run that exceeds it hangs.
const PATIENCE: Duration = Duration::from_secs(120);

fn pipe(scene: &Scene, name: &str) {
    nix::unistd::mkfifo(&scene.path(name), nix::sys::stat::Mode::S_IRWXU).unwrap();
}

/// Runs a command that must end on its own, or after `signal` if there is one.
fn ends(mut command: Command, signal: Option<Signal>) -> Run {
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    if let Some(signal) = signal {
        std::thread::sleep(Duration::from_secs(5));
        assert!(child.try_wait().unwrap().is_none(), "it ended before the signal");
        kill(Pid::from_raw(child.id() as i32), signal).unwrap();
    }
    let begun = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if begun.elapsed() > PATIENCE {
            child.kill().unwrap();
            panic!("it hangs: {command:?}");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    Run::from(child.wait_with_output().unwrap())
}

fn replay(scene: &Scene, more: &[&str]) -> Command {
    scene.command(&[&["replay", "clip", "--config", "stage.toml"], more].concat())
}

#[test]
fn an_output_without_a_reader_is_refused_without_hanging() {
    let scene = Scene::new();
    pipe(&scene, "pipe");
    for flag in ["--poses", "--tum", "--summary"] {
        ends(replay(&scene, &[flag, "pipe"]), None).assert_refused(1, &["pipe: cannot be written", "nobody reads; start its reader first"]);
    }
    for (name, kind) in [("clip", "it is a folder"), ("/dev", "it is a folder")] {
        ends(replay(&scene, &["--poses", name]), None).assert_refused(1, &[kind]);
    }
    ends(replay(&scene, &["--poses", "/dev/null", "--tum", "/dev/null"]), None).assert_success();
    scene.write("stage.toml", &format!("{CONFIG}[[output]]\nkind = \"json\"\nfile = \"pipe\"\n"));
    ends(replay(&scene, &["--outputs"]), None).assert_refused(1, &["pipe", "nobody reads"]);
}

#[test]
fn a_pipe_with_a_reader_gets_every_line() {
    let scene = Scene::new();
    pipe(&scene, "pipe");
    let path = scene.path("pipe");
    let reader = std::thread::spawn(move || std::fs::read_to_string(path).unwrap());
    // If the program opens the pipe before its reader does, it is refused; then it is started
    // again.
    while ends(replay(&scene, &["--poses", "pipe", "--tum", "plain"]), None).code != 0 {}
    assert_eq!(reader.join().unwrap().lines().count(), 6);
}

#[test]
fn a_signal_ends_a_replay_blocked_on_a_pipe() {
    let scene = Scene::new();
    pipe(&scene, "full");
    let open = |write: bool| {
        std::fs::OpenOptions::new().read(true).write(write).custom_flags(nix::libc::O_NONBLOCK).open(scene.path("full")).unwrap()
    };
    let (_reader, mut filler) = (open(false), open(true));
    while filler.write(&[0; 4096]).is_ok() {}
    let run = ends(replay(&scene, &["--poses", "full"]), Some(Signal::SIGTERM));
    run.assert_refused(1, &["full: cannot be written (interrupted while waiting for its reader)"]);
    // The writer has sent a header and a half of a frame, and sleeps.
    let mut silent = scene.command(&["replay", "-", "--config", "stage.toml", "--poses", "poses.jsonl"]);
    let (from, to) = std::io::pipe().unwrap();
    silent.stdin(from);
    (&to).write_all(b"YUV4MPEG2 W320 H240 F30:1 Cmono\n").unwrap();
    ends(silent, Some(Signal::SIGTERM)).assert_refused(1, &["interrupted before the first frame"]);
    pipe(&scene, "clip.y4m");
    let run = ends(scene.command(&["replay", "clip.y4m", "--config", "stage.toml"]), None);
    run.assert_refused(1, &["clip.y4m", "nobody writes to this named pipe"]);
}

#[test]
fn inputs_are_never_overwritten() {
    let scene = Scene::new();
    std::fs::hard_link(scene.path("camera.toml"), scene.path("hard")).unwrap();
    std::os::unix::fs::symlink("art.png", scene.path("soft")).unwrap();
    let before = |name: &str| std::fs::read(scene.path(name)).unwrap();
    let names = ["stage.toml", "hard", "soft", "clip/timestamps.csv", "clip/frames/000003.png"];
    let contents: Vec<_> = names.iter().map(|name| before(name)).collect();
    for (flag, name) in ["--poses", "--tum", "--summary"].iter().flat_map(|flag| names.map(|name| (*flag, name))) {
        let what = if name.starts_with("clip") { "it is a file of the clip" } else { "it is a file of the config" };
        scene.replay(&[flag, name]).assert_refused(2, &[name, what, "would be overwritten; give another name"]);
    }
    for folder in ["clip", "clip/frames", "clip/../clip/frames"] {
        scene.replay(&["--overlay", folder]).assert_refused(2, &["--overlay", "would be overwritten"]);
    }
    // An earlier good file survives a refusal.
    scene.write("good.jsonl", "kept");
    scene.replay(&["--poses", "good.jsonl", "--tum", "hard"]).assert_refused(2, &["--tum hard"]);
    assert_eq!(scene.read("good.jsonl"), "kept");
    scene.replay(&["--poses", "one", "--tum", "./one"]).assert_refused(2, &["--poses writes to the same file; give each output"]);
    scene.write("stage.toml", &format!("{CONFIG}[[output]]\nkind = \"json\"\nfile = \"hard\"\n"));
    scene.replay(&["--outputs"]).assert_refused(2, &["`file` in [[output]], line 8", "hard: the config reads this file"]);
    scene.write("stage.toml", CONFIG);
    for (name, content) in names.iter().zip(&contents) {
        assert_eq!(&before(name), content, "{name}");
    }
    let folder = scene.command(&["calibrate", "clip/frames", "--board", "9x6", "--square-mm", "25", "--json", "clip/frames/000001.png"]);
    ends(folder, None).assert_refused(2, &["--json clip/frames/000001.png: it is a file of the clip"]);
    let file = scene.command(&["calibrate", "art.png", "--board", "9x6", "--square-mm", "25", "--output", "soft"]);
    ends(file, None).assert_refused(2, &["--output soft: it is one of the pictures"]);
    let twice = ["calibrate", "art.png", "--board", "9x6", "--square-mm", "25", "--report", "new", "--json", "./new"];
    scene.run(&twice).assert_refused(2, &["--json ./new: --report writes to the same file"]);
}

#[test]
fn check_refuses_names_that_are_not_plain_files() {
    let scene = Scene::new();
    pipe(&scene, "pipe");
    for (from, name, parts) in [
        ("camera.toml", ".", ["line 2", "it is a folder, not a plain file"]),
        ("art.png", ".", ["line 4", "it is a folder, not a plain file"]),
        ("art.png", "pipe", ["line 4", "it is a named pipe, not a plain file"]),
        ("camera.toml", "/dev/zero", ["line 2", "it is a device, not a plain file"]),
    ] {
        scene.config_with(from, name);
        ends(scene.command(&["check", "--config", "stage.toml"]), None).assert_refused(2, &parts);
    }
    ends(scene.command(&["check", "--config", "pipe"]), None).assert_refused(2, &["pipe: the config cannot be read (it is a named pipe"]);
    scene.write("stage.toml", &format!("{CONFIG}[[output]]\nkind = \"json\"\nfile = \".\"\n"));
    scene.run(&["check", "--config", "stage.toml"]).assert_refused(2, &["`file` in [[output]], line 8", "it is a folder"]);
    let run = scene.run(&["calibrate", "pipe", "/dev/zero", "--board", "9x6", "--square-mm", "25"]);
    run.assert_refused(1, &["it is a named pipe, not a plain file"]);
}

#[test]
fn check_refuses_nonsense_values() {
    let scene = Scene::new();
    for (from, to, parts) in [
        ("fx = 300.0", "fx = 1e300", ["camera.toml line 3: fx is 1e300", "it can be from 32 to 32000 pixels"]),
        ("cx = 159.5", "cx = 5000.0", ["camera.toml line 5: cx is 5000", "it can be from -160 to 480"]),
        ("[0.0, 0.0, 0.0, 0.0, 0.0]", "[1e6, 0.0, 0.0, 0.0, 0.0]", ["camera.toml line 8: distortion is", "% of the picture"]),
        ("[0.0, 0.0, 0.0, 0.0, 0.0]", "[-1e6, 0.0, 0.0, 0.0, 0.0]", ["camera.toml line 8: distortion is", "has no inverse"]),
        ("fx = 300.0\n", "", ["camera.toml line 1: `fx` is missing", "add it"]),
    ] {
        scene.write("camera.toml", &CAMERA.replace(from, to));
        scene.run(&["check", "--config", "stage.toml"]).assert_refused(2, &parts);
    }
    scene.write("camera.toml", &CAMERA.replace("cx = 159.5", "cx = 30.0"));
    let check = scene.run(&["check", "--config", "stage.toml"]);
    check.assert_success();
    assert!(check.stdout.contains("look at     camera.toml: its cx of 30 is far from the middle of 320 pixels"), "{}", check.stdout);
    scene.write("camera.toml", &CAMERA.replace("height = 240", "height = 180"));
    scene.replay(&[]).assert_refused(2, &["stage.toml: `calibration` in [camera], line 2: the calibration is for 320 x 180"]);
    scene.write("camera.toml", CAMERA);
    std::fs::write(scene.path("stage.toml"), [CONFIG.as_bytes(), b"# caf\xe9\n"].concat()).unwrap();
    scene.run(&["check", "--config", "stage.toml"]).assert_refused(2, &["stage.toml: line 6 is not TOML: a character is not UTF-8"]);
    scene.config_with("[4.0, 3.0]", "[1e300, 3.0]");
    scene.run(&["check", "--config", "stage.toml"]).assert_refused(2, &["line 5", "from 0.001 to 1000 metres"]);
}

/// Writes a JPEG whose EXIF says to show it turned by 90 degrees.
fn turned(path: &Path, picture: &GrayImage) {
    let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(std::fs::File::create(path).unwrap(), 95);
    encoder.set_exif_metadata(b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0".to_vec()).unwrap();
    picture.write_with_encoder(encoder).unwrap();
}

#[test]
fn rotated_pictures_are_rotated_refused_or_reported() {
    let scene = Scene::new();
    let art = image::open(scene.path("art.png")).unwrap().into_luma8();
    turned(&scene.path("turned.jpg"), &image::imageops::rotate270(&art));
    scene.config_with("art.png", "turned.jpg");
    let check = scene.run(&["check", "--config", "stage.toml"]);
    check.assert_success();
    assert!(check.stdout.contains("turned.jpg: artwork 640 x 480 pixels"), "{}", check.stdout);
    assert!(check.stdout.contains("turned.jpg: it is turned by 90 degrees before use"), "{}", check.stdout);
    let corners = "photo = \"turned.jpg\"\ncorners_px = [[9, 9], [470, 9], [470, 630], [9, 630]]";
    scene.config_with("image = \"art.png\"", corners);
    let refused = scene.run(&["check", "--config", "stage.toml"]);
    refused.assert_refused(2, &["`photo` in [[stage.surface]], line 4: turned.jpg", "turned by 90 degrees (EXIF)", "exiftool"]);
    scene.write("stage.toml", CONFIG);
    let frame = image::open(scene.path("clip/frames/000000.png")).unwrap().into_luma8();
    turned(&scene.path("clip/frames/000000.png"), &frame);
    let replayed = scene.replay(&["--poses", "poses.jsonl"]);
    replayed.assert_success();
    assert!(
        replayed.stderr.contains("show its picture turned by 90 degrees (EXIF); clips are tracked as stored in the file"),
        "{}",
        replayed.stderr
    );
    let run = scene.run(&["calibrate", "clip/frames", "--board", "9x6", "--square-mm", "25"]);
    assert!(run.stderr.contains("EXIF says to show 1 of the pictures turned"), "{}", run.stderr);
}

#[test]
fn pictures_of_too_many_pixels_are_refused_everywhere() {
    let scene = Scene::new();
    scene.write("clip/frames/000002.png", "P5 16384 16384 255\n");
    scene.write("large.pgm", "P5 16384 16384 255\n");
    let replayed = scene.replay(&["--poses", "poses.jsonl"]);
    replayed.assert_success();
    assert!(
        replayed.stderr.contains("row 2 cannot be read: the picture is 16384 x 16384 pixels, the maximum is 67 million"),
        "{}",
        replayed.stderr
    );
    scene
        .run(&["calibrate", "large.pgm", "--board", "9x6", "--square-mm", "25"])
        .assert_refused(1, &["16384 x 16384 pixels", "scale it down"]);
    scene.config_with("art.png", "large.pgm");
    scene.run(&["check", "--config", "stage.toml"]).assert_refused(2, &["line 4", "16384 x 16384 pixels", "scale it down"]);
}
