//! `setup`: the page before there is a good config, and tracking once there is one.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use super::program::{config, stagepose};

/// A running `setup` with a clip played as the camera; it is killed at the end of its test.
struct Setup {
    program: Child,
    port: u16,
}

impl Drop for Setup {
    fn drop(&mut self) {
        let _ = self.program.kill();
        let _ = self.program.wait();
    }
}

impl Setup {
    fn start(folder: &std::path::Path) -> Self {
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let mut command = stagepose(folder);
        command.env("XDG_STATE_HOME", folder).args(["setup", "--listen", &format!("127.0.0.1:{port}"), "--play"]);
        command.arg(super::program::long_clip(folder, 100)).stdout(Stdio::null()).stderr(Stdio::null());
        let setup = Self { program: command.spawn().unwrap(), port };
        setup.wait(|setup| TcpStream::connect(("127.0.0.1", setup.port)).is_ok());
        setup
    }

    fn wait(&self, mut is_so: impl FnMut(&Self) -> bool) {
        let begun = Instant::now();
        while !is_so(self) {
            assert!(begun.elapsed() < Duration::from_secs(60), "it never happens");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Returns status and content.
    fn ask(&self, method: &str, path: &str, content: &str) -> (u16, Value) {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        let head = format!("{method} {path} HTTP/1.0\r\nHost: localhost\r\nIf-Match: *\r\nContent-Length: {}\r\n\r\n", content.len());
        stream.write_all(head.as_bytes()).unwrap();
        stream.write_all(content.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        let (head, content) = answer.split_once("\r\n\r\n").unwrap();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        (status, serde_json::from_str(content).unwrap_or_else(|_| content.into()))
    }

    fn session(&self) -> Value {
        self.ask("GET", "/api/v1/session", "").1
    }

    fn waits_until_it_tracks(&self) {
        self.wait(|setup| setup.ask("GET", "/api/v1/state", "").1["state"] == "tracking");
        let session = self.session();
        assert_eq!((&session["mode"], &session["has_config"]), (&"track".into(), &true.into()), "{session}");
        assert_eq!(session["findings"], serde_json::json!([]));
    }
}

#[test]
fn setup_without_a_config_serves_the_page_then_tracks() {
    let folder = tempfile::tempdir().unwrap();
    let file = config(folder.path());
    let good = std::fs::read_to_string(&file).unwrap();
    std::fs::remove_file(&file).unwrap();
    let setup = Setup::start(folder.path());
    let session = setup.session();
    assert_eq!((&session["mode"], &session["has_config"]), (&"setup".into(), &false.into()), "{session}");
    assert!(session["findings"][0]["sentence"].as_str().unwrap().contains("there is no config yet"), "{session}");
    assert_eq!(setup.ask("POST", "/api/v1/mode", r#"{"mode":"track"}"#).0, 409);
    let (status, said) = setup.ask("PUT", "/api/v1/config", "[camera]\nfov_deg = 600\n");
    assert_eq!((status, &said["findings"][0]["line"]), (422, &2.into()), "{said}");
    assert!(!file.exists());
    let (status, said) = setup.ask("PUT", "/api/v1/config", &good);
    assert_eq!((status, &said["saved"]), (200, &true.into()), "{said}");
    setup.waits_until_it_tracks();
}

#[test]
fn setup_names_a_bad_config_and_tracks_once_fixed() {
    let folder = tempfile::tempdir().unwrap();
    let file = config(folder.path());
    let good = std::fs::read_to_string(&file).unwrap();
    let bad = good.replace("exposure_s = 0.008333333333333333", "exposure_s = 7");
    let line = 1 + bad.lines().position(|line| line == "exposure_s = 7").unwrap();
    std::fs::write(&file, bad).unwrap();
    let setup = Setup::start(folder.path());
    let session = setup.session();
    let finding = &session["findings"][0];
    let wanted = (&"error".into(), &line.into(), &"[camera] exposure_s".into());
    assert_eq!((&finding["level"], &finding["line"], &finding["key"]), wanted, "{session}");
    let says = finding["sentence"].as_str().unwrap();
    assert!(says.contains("stage.toml") && says.contains("exposure_s"), "{session}");
    let health = setup.ask("GET", "/api/v1/health", "").1;
    assert_eq!((&health["parts"][0]["part"], &health["parts"][0]["level"]), (&"config".into(), &"bad".into()), "{health}");
    assert_eq!(setup.ask("PUT", "/api/v1/config", &good).0, 200);
    setup.waits_until_it_tracks();
}
