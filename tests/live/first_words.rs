//! What a new user sees first: the page's address, a clip that plays repeatedly, and where a
//! service keeps its files.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, ChildStdout, Command};
use std::time::{Duration, Instant};

use super::program::{config, stagepose};

const FIXTURE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/dolly");

/// A running program that is killed at the end of its test.
struct Running(Child, BufReader<ChildStdout>);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Running {
    fn start(command: &mut Command) -> Self {
        let mut child = command.stderr(std::process::Stdio::null()).spawn().unwrap();
        let out = BufReader::new(child.stdout.take().unwrap());
        Self(child, out)
    }

    fn line(&mut self) -> String {
        let mut line = String::new();
        self.1.read_line(&mut line).unwrap();
        line
    }

    /// Returns the port of the page whose address is the next line.
    fn page(&mut self) -> u16 {
        let line = self.line();
        let address = line.strip_prefix("page: http://127.0.0.1:").unwrap_or_else(|| panic!("no address in `{line}`"));
        address.split('/').next().unwrap().parse().unwrap()
    }
}

/// Returns status and content.
fn ask(port: u16, method: &str, path: &str, content: &str) -> (u16, String) {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    let head = format!("{method} {path} HTTP/1.0\r\nHost: localhost\r\nIf-Match: *\r\nContent-Length: {}\r\n\r\n", content.len());
    stream.write_all((head + content).as_bytes()).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    let answer = String::from_utf8_lossy(&answer);
    let (head, content) = answer.split_once("\r\n\r\n").unwrap();
    (head.split(' ').nth(1).unwrap().parse().unwrap(), content.to_owned())
}

/// Returns an `[http]` section with a port that is free now.
fn http() -> String {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    format!("[http]\nlisten = \"127.0.0.1:{port}\"\n")
}

fn wait(what: &str, mut is_so: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !is_so() {
        assert!(begun.elapsed() < Duration::from_secs(60), "{what}: it never happens");
        std::thread::sleep(Duration::from_millis(30));
    }
}

#[test]
fn the_demo_serves_the_page_and_prints_its_address_first() {
    let folder = tempfile::tempdir().unwrap();
    let mut demo = Running::start(stagepose(folder.path()).args(["demo", "--width", "160", "--height", "120", "--frames", "100000"]));
    let port = demo.page();
    let (status, page) = ask(port, "GET", "/", "");
    assert!(status == 200 && page.contains("<html"), "{status} {page}");
    wait("tracking", || ask(port, "GET", "/api/v1/state", "").1.contains("tracking"));
    assert!(ask(port, "GET", "/api/v1/scene", "").1.contains("backdrop"));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "it writes nothing");
}

#[test]
fn a_demo_without_the_page_prints_none() {
    let folder = tempfile::tempdir().unwrap();
    let demo = stagepose(folder.path()).args(["demo", "--no-page", "--width", "80", "--height", "64", "--frames", "3"]).output().unwrap();
    let said = String::from_utf8(demo.stdout).unwrap();
    assert!(demo.status.success() && !said.contains("http") && said.contains("wrong poses"), "{said}");
}

#[test]
fn setup_in_an_empty_folder_prints_the_pages_address() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = stagepose(folder.path());
    let mut setup = Running::start(command.env("XDG_STATE_HOME", folder.path()).args(["setup", "--listen", "127.0.0.1:0"]));
    assert!(setup.line().contains("stage.toml: there is no config yet"));
    let port = setup.page();
    assert_eq!(ask(port, "GET", "/", "").0, 200);
}

#[test]
fn run_prints_the_pages_address_and_loops_a_clip() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path());
    let text = std::fs::read_to_string(&config).unwrap() + &http();
    std::fs::write(&config, text).unwrap();
    let mut command = stagepose(folder.path());
    command.env("XDG_STATE_HOME", folder.path()).args([
        "run",
        "--config",
        "stage.toml",
        "--poses",
        "poses.jsonl",
        "--loop",
        "--play",
        FIXTURE,
    ]);
    let mut run = Running::start(&mut command);
    let port = run.page();
    assert_eq!(ask(port, "GET", "/", "").0, 200);
    let records = || -> Vec<serde_json::Value> {
        let text = std::fs::read_to_string(folder.path().join("poses.jsonl")).unwrap_or_default();
        text.split_inclusive('\n').filter(|line| line.ends_with('\n')).map(|line| serde_json::from_str(line).unwrap()).collect()
    };
    let begins = || records().iter().filter(|record| record["sequence"] == 0).count();
    wait("a third time", || begins() >= 3);
    let stamps: Vec<i64> = records().iter().map(|record| record["timestamp_ns"].as_i64().unwrap()).collect();
    assert!(stamps.windows(2).all(|w| w[1] > w[0]), "stamps do not rise");
    // No state is carried over: the stage must be found anew each time.
    let first_of_each = records().into_iter().filter(|record| record["sequence"] == 0);
    assert!(first_of_each.into_iter().all(|record| record["state"] == "searching" || record["state"] == "tracking"));
}

#[test]
fn a_clip_from_standard_input_cannot_be_played_again() {
    let folder = tempfile::tempdir().unwrap();
    config(folder.path());
    let run = stagepose(folder.path()).args(["run", "--config", "stage.toml", "--play", "-", "--loop"]).output().unwrap();
    let said = String::from_utf8(run.stderr).unwrap();
    assert!(run.status.code() == Some(2) && said.contains("cannot be played twice"), "{said}");
}

fn is_root() -> bool {
    std::fs::metadata("/proc/self").unwrap().uid() == 0
}

/// Runs the command as a service whose config belongs to root.
fn as_nobody(command: &mut Command, state: &Path) {
    const NOBODY: u32 = 65534;
    chown(state, Some(NOBODY), Some(NOBODY)).unwrap();
    command.uid(NOBODY).gid(NOBODY).env("STATE_DIRECTORY", state).env("CACHE_DIRECTORY", state);
}

#[test]
fn a_read_only_config_folder_redirects_to_the_state_folder() {
    let [etc, state] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let config = config(etc.path());
    let text = std::fs::read_to_string(&config).unwrap() + &http();
    std::fs::write(&config, &text).unwrap();
    let mut command = stagepose(etc.path());
    command.args(["run", "--config", "stage.toml", "--loop", "--play", FIXTURE]);
    if is_root() {
        std::fs::set_permissions(etc.path(), std::fs::Permissions::from_mode(0o755)).unwrap();
        as_nobody(&mut command, state.path());
    } else {
        std::fs::set_permissions(etc.path(), std::fs::Permissions::from_mode(0o555)).unwrap();
        command.env("STATE_DIRECTORY", state.path());
    }
    let mut run = Running::start(&mut command);
    let port = run.page();
    wait("tracking", || ask(port, "GET", "/api/v1/state", "").1.contains("tracking"));
    let set = r#"{"objects":[{"kind":"cone"}]}"#;
    assert_eq!(ask(port, "PUT", "/api/v1/set", set).0, 204);
    assert_eq!(ask(port, "GET", "/api/v1/set", "").1, set);
    let changed = format!("{text}[log]\nlevel = \"error\"\n");
    let (status, said) = ask(port, "PUT", "/api/v1/config", &changed);
    assert!(status == 200 && said.contains("\"saved\":true"), "{status} {said}");
    assert_eq!(ask(port, "GET", "/api/v1/config", "").1, changed);
    assert_eq!(std::fs::read_to_string(&config).unwrap(), text, "what was given stays");
    wait("a recording", || ask(port, "POST", "/api/v1/recordings/start", "").0 == 202);
    let recorded = || {
        let of = std::fs::read_dir(state.path()).unwrap().flatten().find(|entry| entry.file_name().to_string_lossy().starts_with("of-"));
        of.is_some_and(|of| std::fs::read_dir(of.path().join("recordings")).is_ok_and(|clips| clips.count() > 0))
    };
    wait("a clip", recorded);
    std::fs::set_permissions(etc.path(), std::fs::Permissions::from_mode(0o755)).unwrap();
}

#[test]
fn an_unwritable_recording_is_refused_with_its_cause() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path());
    let text = std::fs::read_to_string(&config).unwrap() + &http() + "[recorder]\nfolder = \"/etc/recordings\"\n";
    std::fs::write(&config, text).unwrap();
    let state = tempfile::tempdir().unwrap();
    let mut command = stagepose(folder.path());
    command.args(["run", "--config", "stage.toml", "--loop", "--play", FIXTURE]);
    if is_root() {
        std::fs::set_permissions(folder.path(), std::fs::Permissions::from_mode(0o755)).unwrap();
        as_nobody(&mut command, state.path());
    }
    let mut run = Running::start(command.env("STATE_DIRECTORY", state.path()));
    let port = run.page();
    wait("tracking", || ask(port, "GET", "/api/v1/state", "").1.contains("tracking"));
    let (status, said) = ask(port, "POST", "/api/v1/recordings/start", "");
    assert!(status == 409 && said.contains("/etc") && said.contains("user write there") && !said.contains("make room"), "{status} {said}");
    assert!(ask(port, "GET", "/api/v1/recordings", "").1.contains("\"recording\":null"));
}
