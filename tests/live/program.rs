//! The live commands from outside, with a clip played as the camera.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::net::UnixDatagram;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

const FIXTURE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/dolly");

pub fn stagepose(folder: &std::path::Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stagepose"));
    command.current_dir(folder).env_remove("NOTIFY_SOCKET").env_remove("RUST_LOG").stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// Copies the fixture's config and the files it names into the folder, for a test to change.
pub fn config(folder: &std::path::Path) -> std::path::PathBuf {
    for name in ["backdrop.png", "flat.png", "camera.toml", "stage.toml"] {
        std::fs::copy(format!("{FIXTURE}/{name}"), folder.join(name)).unwrap();
    }
    folder.join("stage.toml")
}

/// Writes a long clip: the fixture's pictures over and over.
pub fn long_clip(folder: &std::path::Path, times: usize) -> std::path::PathBuf {
    let one: Vec<u8> = (0..40).chain((1..39).rev()).flat_map(|n| std::fs::read(format!("{FIXTURE}/frames/{n:06}.jpg")).unwrap()).collect();
    let clip = folder.join("long.mjpeg");
    std::fs::write(&clip, one.repeat(times)).unwrap();
    clip
}

fn ends(child: &mut Child) -> i32 {
    let begun = Instant::now();
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            return status.code().unwrap_or(-1);
        }
        assert!(begun.elapsed() < Duration::from_secs(60), "it does not end");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn signal(child: &Child, signal: Signal) {
    kill(Pid::from_raw(child.id() as i32), signal).unwrap();
}

fn get(port: u16, path: &str) -> String {
    ask(port, "GET", path)
}

fn ask(port: u16, method: &str, path: &str) -> String {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    write!(stream, "{method} {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").unwrap();
    let mut reply = String::new();
    stream.read_to_string(&mut reply).unwrap();
    reply
}

/// Waits for a log line that contains a text.
fn wait_for(log: &mut impl BufRead, text: &str) {
    let mut line = String::new();
    while !line.contains(text) {
        line.clear();
        assert!(log.read_line(&mut line).unwrap() > 0, "the log ended before `{text}`");
    }
}

#[test]
fn a_full_disk_fails_the_recording_but_tracking_continues() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path());
    // The pictures are smaller than the fixture's, so that the copy of the config fits the file
    // size limit while a frame of 230 kB does not.
    for name in ["backdrop.png", "flat.png"] {
        let picture = image::open(folder.path().join(name)).unwrap().to_luma8();
        let small = image::imageops::thumbnail(&picture, picture.width() / 3, picture.height() / 3);
        small.save(folder.path().join(name)).unwrap();
        assert!(std::fs::metadata(folder.path().join(name)).unwrap().len() < MOST);
    }
    const MOST: u64 = 200_000;
    let mut command = stagepose(folder.path());
    // The clip is long and ends once enough arrived after the failure, so the machine's speed does
    // not matter.
    let clip = recording(folder.path(), 0.0081);
    command.args(["record", "take", "--config", config.to_str().unwrap(), "--poses", "live.jsonl", "--play"]).arg(&clip);
    // SAFETY: setrlimit is async-signal-safe, and nothing allocates on the way to it.
    unsafe {
        use std::os::unix::process::CommandExt;
        let limit = || nix::sys::resource::setrlimit(nix::sys::resource::Resource::RLIMIT_FSIZE, MOST, MOST);
        command.pre_exec(move || limit().map_err(std::io::Error::from));
    }
    let mut child = command.spawn().unwrap();
    let (live, begun) = (folder.path().join("live.jsonl"), Instant::now());
    while std::fs::read_to_string(&live).map_or(0, |text| text.lines().count()) <= 10 {
        assert!(begun.elapsed() < Duration::from_secs(120), "tracking does not go on");
        std::thread::sleep(Duration::from_millis(20));
    }
    signal(&child, Signal::SIGTERM);
    let code = ends(&mut child);
    let mut told = String::new();
    child.stderr.take().unwrap().read_to_string(&mut told).unwrap();
    assert_eq!(code, 1, "{told}");
    assert!(told.contains("stagepose: the recording ended early: take/frames/") && told.contains("make room on the disk"), "{told}");
}

#[test]
fn an_output_that_fails_midway_exits_with_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path());
    let run = ["run", "--config", config.to_str().unwrap(), "--play", FIXTURE, "--poses", "/dev/full"];
    let ran = stagepose(folder.path()).args(run).output().unwrap();
    let told = String::from_utf8_lossy(&ran.stderr).into_owned();
    assert_eq!(ran.status.code(), Some(1), "{told}");
    assert!(told.contains("stagepose: /dev/full: cannot be written"), "{told}");
    let over = ["run", "--config", config.to_str().unwrap(), "--play", FIXTURE, "--events", "camera.toml"];
    let ran = stagepose(folder.path()).args(over).output().unwrap();
    assert_eq!(ran.status.code(), Some(2), "{}", String::from_utf8_lossy(&ran.stderr));
}

#[test]
fn a_played_clip_is_recorded_and_replays_byte_for_byte() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path());
    let record = ["record", "take", "--config", config.to_str().unwrap(), "--play", FIXTURE, "--poses", "live.jsonl", "--log", "info"];
    let recorded = stagepose(folder.path()).args(record).output().unwrap();
    assert_eq!(recorded.status.code(), Some(0), "{}", String::from_utf8_lossy(&recorded.stderr));
    let replayed =
        stagepose(folder.path()).args(["replay", "take", "--config", "take/config/stage.toml", "--poses", "again.jsonl"]).output().unwrap();
    assert_eq!(replayed.status.code(), Some(0), "{}", String::from_utf8_lossy(&replayed.stderr));
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    assert!(!read("live.jsonl").is_empty());
    assert_eq!(read("live.jsonl"), read("take/poses.jsonl"));
    assert_eq!(read("again.jsonl"), read("take/poses.jsonl"));
    // An existing take is not overwritten.
    let again = stagepose(folder.path()).args(record).output().unwrap();
    let said = String::from_utf8_lossy(&again.stderr).into_owned();
    assert!(again.status.code() == Some(1) && said.contains("take/frames: exists already and would be overwritten"), "{said}");
}

#[test]
fn remains_of_a_recording_are_not_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path());
    let record = |more: &[&str]| {
        let arguments = ["record", "take", "--config", config.to_str().unwrap(), "--play", FIXTURE, "--seconds", "1"];
        stagepose(folder.path()).args(arguments).args(more).output().unwrap()
    };
    for name in ["poses.jsonl", "events.jsonl", "dropped.csv", "clip.toml", "config", "frames"] {
        std::fs::create_dir_all(folder.path().join("take")).unwrap();
        let part = folder.path().join("take").join(name);
        std::fs::write(&part, "kept").unwrap();
        let ran = record(&[]);
        let said = String::from_utf8_lossy(&ran.stderr).into_owned();
        assert!(ran.status.code() == Some(1) && said.contains(&format!("take/{name}: exists already")), "{said}");
        assert_eq!(std::fs::read_to_string(&part).unwrap(), "kept");
        std::fs::remove_dir_all(folder.path().join("take")).unwrap();
    }
    // No other output may use the recording's own files.
    std::fs::create_dir(folder.path().join("take")).unwrap();
    let ran = record(&["--poses", "take/poses.jsonl"]);
    let said = String::from_utf8_lossy(&ran.stderr).into_owned();
    assert!(ran.status.code() == Some(2) && said.contains("the recording writes to the same file"), "{said}");
}

/// Writes a long clip of the fixture's frames that states, as a recording does, that the camera's
/// exposure was locked.
fn recording(folder: &std::path::Path, exposure_s: f64) -> std::path::PathBuf {
    let clip = folder.join("recording");
    std::fs::create_dir_all(clip.join("frames")).unwrap();
    for frame in std::fs::read_dir(format!("{FIXTURE}/frames")).unwrap().flatten() {
        std::fs::copy(frame.path(), clip.join("frames").join(frame.file_name())).unwrap();
    }
    let to_and_fro = (0..40).chain((1..39).rev()).collect::<Vec<i64>>().repeat(20);
    let rows: String = to_and_fro.iter().zip(0_i64..).map(|(frame, n)| format!("{},{frame:06}.jpg\n", n * 33_333_333)).collect();
    std::fs::write(clip.join("timestamps.csv"), format!("#timestamp [ns],filename\n{rows}")).unwrap();
    std::fs::write(clip.join("clip.toml"), format!("[camera]\nname = \"Cam\"\nexposure_s = {exposure_s:?}\n")).unwrap();
    clip
}

/// Records a take until some of its frames are tracked, and returns what was printed.
fn record_some(folder: &std::path::Path, clip: &std::path::Path, take: &str) -> String {
    let arguments = ["record", take, "--config", "stage.toml", "--log", "info", "--play"];
    let mut child = stagepose(folder).args(arguments).arg(clip).spawn().unwrap();
    let poses = folder.join(take).join("poses.jsonl");
    let begun = Instant::now();
    while std::fs::read_to_string(&poses).map_or(0, |text| text.matches("\"tracking\"").count()) < 4 {
        assert!(begun.elapsed() < Duration::from_secs(120), "nothing is tracked");
        std::thread::sleep(Duration::from_millis(20));
    }
    signal(&child, Signal::SIGTERM);
    let code = ends(&mut child);
    let mut said = String::new();
    child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    assert_eq!(code, 0, "{said}");
    said
}

#[test]
fn a_locked_exposure_is_used_and_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path());
    let set = std::fs::read_to_string(&config).unwrap();
    let open = set.lines().filter(|line| !line.starts_with("exposure_s")).fold(String::new(), |text, line| text + line + "\n");
    std::fs::write(&config, &open).unwrap();
    let clip = recording(folder.path(), 0.0081);
    let replay = |take: &str, config: &str| {
        let replayed = stagepose(folder.path()).args(["replay", take, "--config", config, "--poses", "again.jsonl"]).output().unwrap();
        assert_eq!(replayed.status.code(), Some(0), "{}", String::from_utf8_lossy(&replayed.stderr));
        std::fs::read_to_string(folder.path().join("again.jsonl")).unwrap()
    };
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    record_some(folder.path(), &clip, "take");
    assert!(read("take/config/stage.toml").contains("exposure_s = 0.0081\n"), "{}", read("take/config/stage.toml"));
    assert_eq!(replay("take", "take/config/stage.toml"), read("take/poses.jsonl"));
    assert_ne!(replay("take", "stage.toml"), read("take/poses.jsonl"), "without the exposure the tracker has to learn it");
    // If both state an exposure, the config wins and the contradiction is reported.
    std::fs::write(&config, open.replace("[camera]", "[camera]\nexposure_s = 0.02")).unwrap();
    let said = record_some(folder.path(), &clip, "contradicted");
    assert!(said.contains("its exposure is 8.1 ms, exposure_s in [camera] says 20.0 ms"), "{said}");
    assert!(read("contradicted/config/stage.toml").contains("exposure_s = 0.02"));
    assert_eq!(replay("contradicted", "contradicted/config/stage.toml"), read("contradicted/poses.jsonl"));
}

#[test]
fn run_behaves_as_a_systemd_service() {
    let folder = tempfile::tempdir().unwrap();
    let (config, clip) = (config(folder.path()), long_clip(folder.path(), 40));
    let text = std::fs::read_to_string(&config).unwrap();
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    std::fs::write(&config, format!("{text}\n[recorder]\nring_s = 2\n[http]\nlisten = \"127.0.0.1:{port}\"\n")).unwrap();
    let manager = UnixDatagram::bind(folder.path().join("notify")).unwrap();
    manager.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    let mut command = stagepose(folder.path());
    command.env("NOTIFY_SOCKET", folder.path().join("notify")).env("WATCHDOG_USEC", "400000");
    let mut child = command
        .args(["run", "--config", "stage.toml", "--play"])
        .arg(&clip)
        .args(["--poses", "live.jsonl", "--events", "events.jsonl", "--log", "info"])
        .spawn()
        .unwrap();
    let mut log = BufReader::new(child.stderr.take().unwrap());
    let mut heard = String::new();
    let mut buffer = [0; 512];
    for wanted in ["READY=1", "WATCHDOG=1", "frames/s"] {
        while !heard.contains(wanted) {
            let n = manager.recv(&mut buffer).unwrap_or_else(|e| panic!("{wanted} did not come: {e}"));
            heard += &format!("{}\n", String::from_utf8_lossy(&buffer[..n]));
        }
    }
    let lines = || std::fs::read_to_string(folder.path().join("live.jsonl")).map_or(0, |text| text.lines().count());
    let wait_for_frames = |more: usize| {
        let (before, begun) = (lines(), Instant::now());
        while lines() < before + more {
            assert!(begun.elapsed() < Duration::from_secs(60), "no frame is tracked");
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    // Wait until the ring has something to save.
    wait_for_frames(3);
    if cfg!(feature = "http") {
        let begun = Instant::now();
        let mut health = String::new();
        while !(health.starts_with("HTTP/1.1 200") && health.contains("\"camera\":\"streaming\"")) {
            assert!(begun.elapsed() < Duration::from_secs(30), "{health}");
            health = get(port, "/healthz");
        }
        let metrics = get(port, "/metrics");
        assert!(metrics.contains("stagepose_frame_age_seconds_bucket") && metrics.contains("stagepose_camera_up "), "{metrics}");
        assert!(get(port, "/api/v1/ring/save").starts_with("HTTP/1.1 405"));
        assert!(ask(port, "POST", "/api/v1/ring/save").starts_with("HTTP/1.1 202"));
        wait_for(&mut log, "the last seconds are saved");
    }
    wait_for_frames(3);
    // SIGUSR1 saves what just happened.
    signal(&child, Signal::SIGUSR1);
    wait_for(&mut log, "the last seconds are saved");
    // A bad config is refused and the old one stays; a good one replaces it.
    std::fs::write(&config, "[camera]\nx = 1\n").unwrap();
    signal(&child, Signal::SIGHUP);
    wait_for(&mut log, "the old config stays");
    if cfg!(feature = "http") {
        let session = get(port, "/api/v1/session");
        let said: serde_json::Value = serde_json::from_str(session.split_once("\r\n\r\n").unwrap().1).unwrap();
        assert_eq!((&said["has_config"], &said["mode"]), (&true.into(), &"track".into()), "{said}");
        let finding = &said["findings"][0];
        assert_eq!((&finding["level"], &finding["line"]), (&"error".into(), &2.into()), "{said}");
        assert!(finding["sentence"].as_str().unwrap().contains("stage.toml"), "{said}");
        wait_for_frames(3);
    }
    std::fs::write(&config, text).unwrap();
    // Rename the file as a log rotation does.
    std::fs::rename(folder.path().join("events.jsonl"), folder.path().join("events.old")).unwrap();
    signal(&child, Signal::SIGHUP);
    wait_for(&mut log, "was reloaded");
    wait_for(&mut log, " is open: ");
    signal(&child, Signal::SIGTERM);
    let mut rest = String::new();
    log.read_to_string(&mut rest).unwrap();
    assert_eq!(ends(&mut child), 0, "{rest}");
    let saved = std::fs::read_dir(folder.path().join("recordings")).unwrap().flatten().map(|e| e.path());
    let saved = saved.into_iter().find(|p| p.join("timestamps.csv").exists()).expect("a saved ring");
    let replayed =
        stagepose(folder.path()).arg("replay").arg(&saved).arg("--config").arg(saved.join("config/stage.toml")).output().unwrap();
    assert_eq!(replayed.status.code(), Some(0), "{}", String::from_utf8_lossy(&replayed.stderr));
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    let (old, new) = (read("events.old"), read("events.jsonl"));
    assert!(old.contains("config_refused") && old.lines().last().unwrap().contains("\"event\":\"config_reloaded\""), "{old}");
    assert!(new.contains("camera_opened") && new.lines().last().unwrap().contains("\"event\":\"ended\""), "{new}");
    assert!(new.ends_with("a signal asked for it\"}\n"), "{new}");
    let poses = read("live.jsonl");
    assert!(poses.ends_with("}\n") && poses.lines().all(|l| serde_json::from_str::<serde_json::Value>(l).is_ok()));
}

#[test]
fn a_killed_recorder_leaves_a_clip_that_replays() {
    let folder = tempfile::tempdir().unwrap();
    let (config, clip) = (config(folder.path()), long_clip(folder.path(), 40));
    let mut child = stagepose(folder.path()).args(["record", "take", "--config"]).arg(config).arg("--play").arg(clip).spawn().unwrap();
    let poses = folder.path().join("take/poses.jsonl");
    let begun = Instant::now();
    while std::fs::read_to_string(&poses).map_or(0, |text| text.lines().count()) < 3 {
        assert!(begun.elapsed() < Duration::from_secs(60), "nothing is recorded");
        std::thread::sleep(Duration::from_millis(20));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let replayed =
        stagepose(folder.path()).args(["replay", "take", "--config", "take/config/stage.toml", "--poses", "again.jsonl"]).output().unwrap();
    assert_eq!(replayed.status.code(), Some(0), "{}", String::from_utf8_lossy(&replayed.stderr));
    let (recorded, again) = (std::fs::read_to_string(poses).unwrap(), std::fs::read_to_string(folder.path().join("again.jsonl")).unwrap());
    let whole = &recorded[..=recorded.rfind('\n').unwrap()];
    assert!(again.starts_with(whole), "{} lines recorded, {} replayed", whole.lines().count(), again.lines().count());
}

#[test]
fn a_camera_that_is_not_there_is_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path());
    let text = std::fs::read_to_string(&config).unwrap().replace("[camera]", "[camera]\ndevice = \"/dev/v4l/by-id/no-such-camera\"");
    std::fs::write(&config, text).unwrap();
    let run = stagepose(folder.path()).args(["run", "--config", "stage.toml", "--seconds", "1"]).output().unwrap();
    let said = String::from_utf8_lossy(&run.stderr).into_owned();
    if cfg!(feature = "live") {
        assert!(run.status.code() == Some(0) && said.contains("waiting for the camera"), "{said}");
    } else {
        assert!(run.status.code() == Some(2) && said.contains("without the feature `live`"), "{said}");
    }
}
