//! Slow requests: changes of the lock or of the pairing meanwhile count, and no other client has to
//! wait for them.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use super::gltf::tests::glb;
use super::tests::{exchange, supervised, whole_server, whole_site};
use crate::daemon::Supervisor;
use crate::web::{Server, Site};

/// Headers of a request from this machine.
const OWN: &str = "Host: localhost\r\n";
/// Headers of a browser on another machine behind a proxy on this one.
const ELSEWHERE: &str = "Host: localhost\r\nX-Forwarded-For: 192.0.2.7\r\n";

/// Sends only the first part of a request.
fn begun(server: &Server, method: &str, path: &str, headers: &str, content: &[u8], sent: usize) -> TcpStream {
    let mut stream = TcpStream::connect(server.address()).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let head = format!("{method} {path} HTTP/1.1\r\nConnection: close\r\nContent-Length: {}\r\n{headers}\r\n", content.len());
    stream.write_all(head.as_bytes()).unwrap();
    stream.write_all(&content[..sent]).unwrap();
    stream
}

/// Sends the rest and returns the status; 0 if nothing came.
fn ended(mut stream: TcpStream, rest: &[u8]) -> u16 {
    let _ = stream.write_all(rest);
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    String::from_utf8_lossy(&answer).split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0)
}

fn status(server: &Server, method: &str, path: &str, headers: &str) -> u16 {
    exchange(server.address(), method, path, headers, b"").status
}

/// Returns requests that change something by their content: method, path, headers and content.
fn changes(supervisor: &Supervisor) -> Vec<(&'static str, &'static str, String, Vec<u8>)> {
    let config = std::fs::read(supervisor.file()).unwrap();
    vec![
        ("PUT", "/api/v1/set", String::new(), br#"{"objects":[{"kind":"cone"}]}"#.to_vec()),
        ("PUT", "/api/v1/sets/door.glb", String::new(), glb(r#"{"asset":{"version":"2.0"}}"#)),
        ("PUT", "/api/v1/config", "If-Match: *\r\n".to_owned(), [&config[..], b"# new\n"].concat()),
        ("POST", "/api/v1/mode", String::new(), br#"{"mode":"setup"}"#.to_vec()),
    ]
}

/// Returns the names and contents of a folder's files.
fn all_of(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut all: Vec<(String, Vec<u8>)> = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap().flatten() {
        let (name, path) = (entry.file_name().to_string_lossy().into_owned(), entry.path());
        match path.is_dir() {
            true => all.extend(all_of(&path).into_iter().map(|(below, bytes)| (format!("{name}/{below}"), bytes))),
            false => all.push((name, std::fs::read(&path).unwrap())),
        }
    }
    all.sort();
    all
}

#[test]
fn a_change_begun_before_the_show_lock_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let supervisor = supervised(folder.path());
    let server = whole_server(&supervisor, None);
    let (before, mode) = (all_of(folder.path()), supervisor.mode());
    for (method, path, headers, content) in changes(&supervisor) {
        let half = content.len() / 2;
        let request = begun(&server, method, path, &format!("{OWN}{headers}"), &content, half);
        std::thread::sleep(Duration::from_millis(200));
        assert_eq!(status(&server, "POST", "/api/v1/lock", OWN), 204);
        assert_eq!(ended(request, &content[half..]), 423, "{method} {path}");
        assert_eq!((all_of(folder.path()), supervisor.mode()), (before.clone(), mode), "{method} {path}");
        assert_eq!(status(&server, "POST", "/api/v1/unlock", OWN), 204);
        // Without a lock the same request is carried out.
        let request = begun(&server, method, path, &format!("{OWN}{headers}"), &content, half);
        std::thread::sleep(Duration::from_millis(200));
        assert!(matches!(ended(request, &content[half..]), 200..300), "{method} {path}");
        for left in ["set.json", "sets/door.glb"] {
            let _ = std::fs::remove_file(folder.path().join(left));
        }
        let _ = std::fs::remove_dir_all(folder.path().join("former"));
        let (_, config) = before.iter().find(|(name, _)| name == "stage.toml").unwrap();
        std::fs::write(supervisor.file(), config).unwrap();
        supervisor.set_mode(mode);
    }
}

#[test]
fn a_browser_that_is_revoked_while_it_sends_changes_nothing() {
    let (folder, state) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let supervisor = supervised(folder.path());
    let server = whole_site(&supervisor, Site { state: Some(state.path().to_owned()), ..Site::default() });
    let code = std::fs::read_to_string(crate::web::code_file(state.path(), server.address().port())).unwrap();
    let pairing = format!(r#"{{"code":"{code}","name":"tablet"}}"#);
    let paired = exchange(server.address(), "POST", "/api/v1/pair", ELSEWHERE, pairing.as_bytes());
    assert_eq!(paired.status, 204, "{}", paired.text());
    let cookie = paired.values("set-cookie")[0].split(';').next().unwrap().to_owned();
    let headers = format!("{ELSEWHERE}Cookie: {cookie}\r\n");
    let model = glb(r#"{"asset":{"version":"2.0"}}"#);
    let request = begun(&server, "PUT", "/api/v1/sets/a.glb", &headers, &model, 10);
    assert_eq!(ended(request, &model[10..]), 204, "it is paired");
    let request = begun(&server, "PUT", "/api/v1/sets/b.glb", &headers, &model, 10);
    std::thread::sleep(Duration::from_millis(200));
    let clients = exchange(server.address(), "GET", "/api/v1/clients", OWN, b"").text();
    let id = serde_json::from_str::<serde_json::Value>(&clients).unwrap()[0]["id"].as_str().unwrap().to_owned();
    assert_eq!(status(&server, "DELETE", &format!("/api/v1/clients/{id}"), OWN), 204);
    assert_eq!(ended(request, &model[10..]), 401);
    assert!(!folder.path().join("sets/b.glb").exists());
}

/// Sends contents byte by byte over several connections, until told to stop.
fn drip(server: &Server, connections: usize, method: &str, path: &str, headers: &str, is_over: &AtomicBool) {
    let content = vec![b' '; 4000];
    let mut open: Vec<TcpStream> = (0..connections).map(|_| begun(server, method, path, headers, &content, 1)).collect();
    while !is_over.load(Ordering::Relaxed) {
        std::thread::sleep(Duration::from_millis(500));
        for stream in &mut open {
            if stream.write_all(b" ").is_err() {
                *stream = begun(server, method, path, headers, &content, 1);
            }
        }
    }
}

#[test]
fn a_client_sending_single_bytes_delays_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let supervisor: Arc<Supervisor> = supervised(folder.path());
    let server = whole_server(&supervisor, None);
    let is_over = AtomicBool::new(false);
    std::thread::scope(|threads| {
        threads.spawn(|| drip(&server, 6, "POST", "/api/v1/pair", ELSEWHERE, &is_over));
        threads.spawn(|| drip(&server, 3, "PUT", "/api/v1/sets/slow.glb", OWN, &is_over));
        let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            std::thread::sleep(Duration::from_secs(1));
            for (method, path, content, wanted) in [
                ("GET", "/api/v1/session", "", 200),
                ("GET", "/api/v1/health", "", 200),
                ("GET", "/api/v1/set", "", 200),
                ("POST", "/api/v1/lock", "", 204),
                ("POST", "/api/v1/unlock", "", 204),
                ("POST", "/api/v1/recordings/mark", "{\"text\":\"cue\"}", 202),
            ] {
                let request = begun(&server, method, path, OWN, content.as_bytes(), content.len());
                // The slow clients may go on for an hour; this request must not wait for them.
                request.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
                assert_eq!(ended(request, b""), wanted, "{method} {path}");
            }
        }));
        is_over.store(true, Ordering::Relaxed);
        outcome.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
    });
}

#[test]
fn a_slow_but_steady_client_is_served() {
    let folder = tempfile::tempdir().unwrap();
    let server = whole_server(&supervised(folder.path()), None);
    // A phone at the edge of its network: a few bytes, a pause longer than any hiccup, and so on.
    let mark = br#"{"text":"the tall one at the back"}"#;
    let mut phone = begun(&server, "POST", "/api/v1/recordings/mark", OWN, mark, 5);
    for piece in mark[5..mark.len() - 1].chunks(10) {
        std::thread::sleep(Duration::from_millis(1500));
        phone.write_all(piece).unwrap();
    }
    assert_eq!(ended(phone, &mark[mark.len() - 1..]), 202);
    // A large model over a network with pauses.
    let nodes = vec![r#"{"name":"a part of the set","mesh":0}"#; 100_000].join(",");
    let model = glb(&format!(r#"{{"asset":{{"version":"2.0"}},"nodes":[{nodes}]}}"#));
    let mut upload = begun(&server, "PUT", "/api/v1/sets/large.glb", OWN, &model, 100);
    for piece in model[100..].chunks(1 << 20) {
        std::thread::sleep(Duration::from_millis(300));
        upload.write_all(piece).unwrap();
    }
    assert_eq!(ended(upload, b""), 204);
    assert_eq!(std::fs::read(folder.path().join("sets/large.glb")).unwrap(), model);
}
