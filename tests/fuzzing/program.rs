//! Runs the program itself on some of the inputs: it ends, its exit code is 0, 1 or 2, it prints no
//! panic, and its memory stays within a bound.

use std::io::Write;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use nix::libc;
use nix::sys::resource::{Resource, setrlimit};

use super::mutator::{Form, Mutator};
use super::{inputs, keep, seed, seeds};

/// One in this many inputs goes through the program: starting it takes as long as a hundred inputs
/// in this process.
const SHARE: u64 = 40;
/// Maximum time of a run; one that takes longer hangs.
const HANG: Duration = Duration::from_secs(60);
/// Maximum address space of a run, bytes.
const MAX_MEMORY: u64 = 2 << 30;
/// Maximum resident memory of a run or of one of its children, bytes.
const MAX_RESIDENT: u64 = 1 << 30;

/// Where a changed file goes.
enum To {
    /// In place of this file.
    File(&'static str),
    Stdin,
}

fn fuzz(name: &str, mut mutator: Mutator, to: &To, arguments: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let (mut codes, mut peak) = ([0_u64; 3], 0);
    for number in 0..inputs().div_ceil(SHARE) {
        let input = mutator.next_input();
        let mut command = Command::new(env!("CARGO_BIN_EXE_stagepose"));
        command.args(arguments).current_dir(folder.path()).env_remove("RUST_LOG");
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        match to {
            To::File(file) => std::fs::write(folder.path().join(file), &input).unwrap(),
            To::Stdin => drop(command.stdin(Stdio::piped())),
        }
        let fault = run(&mut command, matches!(to, To::Stdin).then_some(&input)).and_then(|(code, resident)| {
            peak = peak.max(resident);
            codes.get_mut(code as usize).map(|count| *count += 1).ok_or_else(|| format!("ends with {code}"))
        });
        if let Err(fault) = fault {
            panic!("{name} {fault} on input {number}; see {}", keep(name, number, &input));
        }
    }
    println!("{name}: exit codes 0, 1, 2 came {codes:?} times; largest peak {} MB resident", peak >> 20);
}

/// Returns how a child ended and its peak resident memory in bytes; `None` while it runs. The
/// kernel's figure includes the child's own children, and what this process held when it forked.
fn ended(child: &Child) -> Option<(ExitStatus, u64)> {
    let (pid, mut status) = (child.id() as libc::pid_t, 0);
    // SAFETY: all zeros is a valid value of this plain struct.
    let mut usage: libc::rusage = unsafe { std::mem::zeroed() };
    // SAFETY: both pointers are to variables that outlive the call; nothing else waits for the
    // child.
    let reaped = unsafe { libc::wait4(pid, &raw mut status, libc::WNOHANG, &raw mut usage) };
    assert!(reaped >= 0, "the child can be waited for");
    (reaped == pid).then(|| (ExitStatus::from_raw(status), usage.ru_maxrss as u64 * 1024))
}

/// Returns the exit code and the peak resident memory in bytes, or what is wrong with the run.
#[allow(clippy::zombie_processes)] // `ended` waits for it, by wait4
fn run(command: &mut Command, stdin: Option<&Vec<u8>>) -> Result<(i32, u64), String> {
    // SAFETY: setrlimit is async-signal-safe, and nothing allocates on the way to it.
    unsafe { command.pre_exec(|| setrlimit(Resource::RLIMIT_AS, MAX_MEMORY, MAX_MEMORY).map_err(std::io::Error::from)) };
    let mut child = command.spawn().expect("the program starts");
    let writer = stdin.cloned().zip(child.stdin.take()).map(|(bytes, mut to)| std::thread::spawn(move || to.write_all(&bytes)));
    let mut stderr = child.stderr.take().expect("it is piped");
    let told = std::thread::spawn(move || {
        let mut text = Vec::new();
        std::io::Read::read_to_end(&mut stderr, &mut text).map(|_| String::from_utf8_lossy(&text).into_owned())
    });
    let begun = Instant::now();
    let (status, resident) = loop {
        if let Some(end) = ended(&child) {
            break end;
        }
        if begun.elapsed() > HANG {
            child.kill().expect("it can be ended");
            return Err("hangs".to_owned());
        }
        std::thread::sleep(Duration::from_millis(1));
    };
    // A run that refuses its input stops reading it, so the write may fail.
    let _ = writer.map(std::thread::JoinHandle::join);
    let told = told.join().expect("the reader does not panic").map_err(|e| e.to_string())?;
    if told.contains("panicked") {
        return Err(format!("prints a panic ({})", told.lines().next().unwrap_or_default()));
    }
    if resident > MAX_RESIDENT {
        return Err(format!("holds {} MB", resident >> 20));
    }
    status.code().map(|code| (code, resident)).ok_or_else(|| format!("is killed ({status}; {told})"))
}

/// Writes a stage with a small clip.
fn scene(folder: &Path) {
    let at = |name: &str| folder.join(name);
    std::fs::create_dir_all(at("clip/frames")).unwrap();
    std::fs::write(at("camera.toml"), seeds::CAMERA).unwrap();
    std::fs::write(at("stage.toml"), STAGE).unwrap();
    std::fs::write(at("clip/timestamps.csv"), seeds::STAMPS).unwrap();
    std::fs::write(at("clip/clip.toml"), seeds::ABOUT).unwrap();
    seeds::picture(120, 90).save(at("art.png")).unwrap();
    for n in 0..4 {
        image::imageops::resize(&seeds::picture(120, 90), 120, 90, image::imageops::FilterType::Triangle)
            .save(at(&format!("clip/frames/{n:06}.png")))
            .unwrap();
    }
}

/// A config that binds no socket and sends nothing.
const STAGE: &str =
    "[camera]\ncalibration = \"camera.toml\"\n[[stage.surface]]\nimage = \"art.png\"\nsize_m = [4.0, 3.0]\n[tracker]\nfeatures = 300\n";

fn text(seed_text: &str) -> Mutator {
    Mutator::new(seed(), Form::Text, vec![seed_text.as_bytes().to_vec()])
}

const REPLAY: [&str; 6] = ["replay", "clip", "--config", "stage.toml", "--poses", "poses.jsonl"];

#[test]
fn replay_of_damaged_clips() {
    fuzz("replay-csv", text(seeds::STAMPS), &To::File("clip/timestamps.csv"), &REPLAY);
    fuzz("replay-csv-ms", text(seeds::STAMPS_MS), &To::File("clip/timestamps.csv"), &REPLAY);
    fuzz("replay-about", text(seeds::ABOUT), &To::File("clip/clip.toml"), &REPLAY);
    fuzz("replay-learnt", text(seeds::LEARNT), &To::File("camera.learnt"), &[&REPLAY[..], &["--learnt", "camera.learnt"]].concat());
    let png = seeds::encoded(&seeds::picture(120, 90).into(), image::ImageFormat::Png);
    fuzz("replay-png", Mutator::new(seed(), Form::Png, vec![png]), &To::File("clip/frames/000001.png"), &REPLAY);
    let stdin = ["replay", "-", "--config", "stage.toml"];
    let frame = [&b"FRAME\n"[..], seeds::picture(120, 90).as_raw()].concat();
    let y4m = [&b"YUV4MPEG2 W120 H90 F30:1 Cmono\n"[..], &frame.repeat(3)].concat();
    fuzz("replay-y4m", Mutator::new(seed(), Form::Text, vec![y4m]), &To::Stdin, &stdin);
    let jpeg = seeds::encoded(&seeds::picture(120, 90).into(), image::ImageFormat::Jpeg);
    let mjpeg = Mutator::new(seed(), Form::Binary, vec![jpeg.repeat(3)]);
    fuzz("replay-mjpeg", mjpeg, &To::File("clip.mjpeg"), &["replay", "clip.mjpeg", "--config", "stage.toml"]);
    fuzz(
        "replay-avi",
        Mutator::new(seed(), Form::Binary, seeds::avis()),
        &To::File("clip.avi"),
        &["replay", "clip.avi", "--config", "stage.toml"],
    );
}

#[test]
fn replay_survives_damaged_rotated_videos() {
    let Some(mp4) = turned_mp4() else {
        eprintln!("skipped: ffmpeg cannot make a video here");
        return;
    };
    let video = Mutator::new(seed(), Form::Binary, vec![mp4]);
    fuzz("replay-mp4", video, &To::File("clip.mp4"), &["replay", "clip.mp4", "--config", "stage.toml"]);
}

/// Encodes four pictures as an MP4 with a rotating display matrix; `None` if ffmpeg is not
/// installed.
fn turned_mp4() -> Option<Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let mut command = Command::new("ffmpeg");
    command.current_dir(folder.path()).args(["-loglevel", "error", "-i", "clip/frames/%06d.png", "-c:v", "mpeg4", "clip.mp4"]);
    command.status().ok().filter(std::process::ExitStatus::success)?;
    let mut mp4 = std::fs::read(folder.path().join("clip.mp4")).unwrap();
    // In the track header, the kind, version and flags, and 36 bytes precede the matrix (ISO/IEC
    // 14496-12, 8.3.2).
    let matrix = mp4.windows(4).position(|kind| kind == b"tkhd")? + 4 + 4 + 36;
    let turned = [0, 0x1_0000, 0, -0x1_0000, 0, 0, 0, 0, 0x4000_0000_i32];
    mp4[matrix..matrix + 36].copy_from_slice(&turned.map(i32::to_be_bytes).concat());
    Some(mp4)
}

#[test]
fn check_of_damaged_configs() {
    let check = ["check", "--config", "stage.toml", "--no-device"];
    fuzz("check-config", text(STAGE), &To::File("stage.toml"), &check);
    fuzz("check-camera", text(seeds::CAMERA), &To::File("camera.toml"), &check);
    let art = seeds::encoded(&seeds::picture(120, 90).into(), image::ImageFormat::Png);
    fuzz("check-art", Mutator::new(seed(), Form::Png, vec![art]), &To::File("art.png"), &check);
}

#[test]
fn export_of_damaged_poses() {
    for (to, file) in [("usd", "a.usda"), ("gltf", "a.gltf"), ("mcap", "a.mcap"), ("chan", "a.chan"), ("blender", "a.py"), ("ae", "a.jsx")]
    {
        let arguments = ["export", "poses.jsonl", "--config", "stage.toml", "--to", to, "--output", file];
        fuzz(&format!("export-{to}"), text(seeds::POSES), &To::File("poses.jsonl"), &arguments);
    }
}

#[test]
fn calibrate_with_damaged_pictures() {
    let board = seeds::encoded(&chessboard().into(), image::ImageFormat::Png);
    let arguments = ["calibrate", "board.png", "art.png", "--board", "7x5", "--square-mm", "25", "--json", "out.json"];
    fuzz("calibrate", Mutator::new(seed(), Form::Png, vec![board]), &To::File("board.png"), &arguments);
    fuzz("compare", text(seeds::CAMERA), &To::File("other.toml"), &["calibrate", "camera.toml", "--compare", "other.toml"]);
}

/// Draws a board of 7 x 5 inner corners, seen from the front.
fn chessboard() -> image::GrayImage {
    image::GrayImage::from_fn(120, 90, |x, y| {
        let inside = (12..108).contains(&x) && (9..81).contains(&y);
        image::Luma([if inside && ((x - 12) / 12 + (y - 9) / 12) % 2 == 0 { 20 } else { 230 }])
    })
}
