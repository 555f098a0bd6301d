use std::io::{Read, Write};
use std::net::{Ipv4Addr, TcpStream};
use std::time::Instant;

use super::*;
use crate::frame::Timestamp;
use crate::record::State;
use crate::web::reply::Reply;

fn server() -> Server {
    let settings = HttpSettings { listen: (Ipv4Addr::LOCALHOST, 0).into(), hosts: Vec::new() };
    let health = Route::get("/healthz", || Reply::text(503, "not yet"));
    Server::start(&settings, vec![health, Route::post("/save", || Reply::text(202, "saved\n"))]).unwrap()
}

fn sample(sequence: u64) -> PoseSample {
    PoseSample {
        sequence,
        timestamp: Timestamp::from_ns(40),
        state: State::Tracking,
        pose: Some(crate::protocols::golden::golden_camera()),
        measurement: None,
        objects: Vec::new(),
        reason: None,
        learnt: Default::default(),
        times: Default::default(),
    }
}

fn connect(server: &Server) -> TcpStream {
    let stream = TcpStream::connect(server.address()).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    stream.set_write_timeout(Some(Duration::from_secs(20))).unwrap();
    stream
}

/// Returns everything that comes until the server closes.
fn exchange(server: &Server, request: &[u8]) -> String {
    let mut stream = connect(server);
    // The server may close before it has read everything.
    let _ = stream.write_all(request);
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    String::from_utf8_lossy(&answer).into_owned()
}

fn get(server: &Server, path: &str) -> String {
    exchange(server, format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").as_bytes())
}

#[test]
fn pose_state_and_added_routes_respond() {
    let server = server();
    assert!(get(&server, "/api/v1/pose").starts_with("HTTP/1.1 503"));
    assert!(get(&server, "/api/v1/state").contains(r#""state":null"#));
    server.publish(&sample(7));
    let answer = get(&server, "/api/v1/pose");
    assert!(answer.starts_with("HTTP/1.1 200") && answer.ends_with(&sample(7).to_json_line()), "{answer}");
    let answer = get(&server, "/api/v1/state");
    assert!(answer.contains(r#""state":"tracking""#) && answer.contains(r#""sequence":7"#), "{answer}");
    let answer = get(&server, "/healthz?deep=1");
    assert!(answer.starts_with("HTTP/1.1 503") && answer.ends_with("not yet"), "{answer}");
    assert!(get(&server, "/api/v1/scene").starts_with("HTTP/1.1 503"), "there is no session");
    assert!(get(&server, "/nothing").starts_with("HTTP/1.1 404"));
    server.close();
}

#[test]
fn the_page_is_served_with_a_policy_and_cached() {
    let server = server();
    for (path, content_type) in [("/", "text/html"), ("/style.css", "text/css"), ("/app.js", "text/javascript"), ("/icon.svg", "image/svg")]
    {
        let answer = get(&server, path);
        let (head, body) = answer.split_once("\r\n\r\n").unwrap();
        let head = head.to_lowercase();
        assert!(head.starts_with("http/1.1 200") && head.contains(&format!("\r\ncontent-type: {content_type}")), "{head}");
        let has = |line: &str| assert!(head.contains(&format!("\r\n{line}")), "{path} has no {line}: {head}");
        has("content-security-policy: default-src 'none'; script-src 'self'; style-src 'self'; ");
        has("x-content-type-options: nosniff");
        has("cross-origin-resource-policy: same-origin");
        has("cache-control: no-cache");
        has(&format!("content-length: {}", body.len()));
        assert!(!head.contains("unsafe-inline") && !head.contains("access-control-allow"), "{head}");
        let tag = head.lines().find_map(|line| line.strip_prefix("etag: ")).unwrap();
        let again = format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nIf-None-Match: {tag}\r\nConnection: close\r\n\r\n");
        let again = exchange(&server, again.as_bytes());
        assert!(again.starts_with("HTTP/1.1 304") && again.ends_with("\r\n\r\n"), "{again}");
        let head_only = exchange(&server, format!("HEAD {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").as_bytes());
        assert!(head_only.starts_with("HTTP/1.1 200") && head_only.ends_with("\r\n\r\n"), "{head_only}");
        assert_eq!(status(&server, &format!("POST {path} HTTP/1.1"), "Host: localhost\r\n"), 405, "{path}");
    }
    for path in ["/index.html", "/page/app.js", "/vendor/", "/vendor/../app.js", "/%2e%2e/Cargo.toml", "/vendor/remake", "//app.js"] {
        assert_eq!(status(&server, &format!("GET {path} HTTP/1.1"), "Host: localhost\r\n"), 404, "{path}");
    }
}

#[test]
fn malformed_and_oversized_requests_are_refused() {
    let server = server();
    let long = format!("GET /{} HTTP/1.1\r\nHost: localhost\r\n\r\n", "a".repeat(64 * 1024));
    let many = format!("GET / HTTP/1.1\r\n{}\r\n", "X: y\r\n".repeat(200));
    let posted = "POST /api/v1/pose HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Length: 3\r\n\r\nabc";
    let with_body = "GET /api/v1/pose HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Length: 3\r\n\r\nabc";
    let no_key = "GET /ws HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\r\n";
    let cases: [(&[u8], &str); 7] = [
        (b"\x16\x03\x01\x02\x00\x01\x00", "HTTP/1.1 400"),
        (b"GET / HTTP/9.9\r\n\r\n", "HTTP/1.1 400"),
        (long.as_bytes(), "HTTP/1.1 4"),
        (many.as_bytes(), "HTTP/1.1 431"),
        (posted.as_bytes(), "HTTP/1.1 405"),
        (with_body.as_bytes(), "HTTP/1.1 413"),
        (no_key.as_bytes(), "HTTP/1.1 4"),
    ];
    for (request, wanted) in cases {
        let mut stream = connect(&server);
        let _ = stream.write_all(request);
        let mut start = [0; 12];
        let read = stream.read_exact(&mut start);
        let found = String::from_utf8_lossy(&start).into_owned();
        assert!(
            read.is_ok() && found.starts_with(wanted),
            "{found:?} {wanted}: {}",
            String::from_utf8_lossy(&request[..20.min(request.len())])
        );
    }
    assert!(get(&server, "/api/v1/state").starts_with("HTTP/1.1 200"), "it still serves");
}

/// Returns the status for a request with these header lines.
fn status(server: &Server, line: &str, headers: &str) -> u16 {
    let answer = exchange(server, format!("{line}\r\n{headers}Connection: close\r\n\r\n").as_bytes());
    answer.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0)
}

#[test]
fn every_path_is_guarded_and_the_web_socket_too() {
    let server = server();
    for path in
        ["/", "/app.js", "/ws", "/ws/events", "/ws/view", "/healthz", "/save", "/api/v1/pose", "/api/v1/state", "/api/v1/scene", "/nothing"]
    {
        for method in ["GET", "POST", "OPTIONS", "PUT"] {
            let asked = |headers: &str| status(&server, &format!("{method} {path} HTTP/1.1"), headers);
            assert_eq!(asked("Host: evil.example\r\n"), 421, "{method} {path}");
            assert_eq!(asked("Host: localhost\r\nOrigin: http://evil.example\r\n"), 403, "{method} {path}");
            assert_eq!(asked("Host: localhost\r\nOrigin: null\r\n"), 403, "{method} {path}");
            assert_eq!(asked("Host: localhost\r\nHost: localhost\r\n"), 400, "{method} {path}");
        }
    }
    let upgrade = |origin: &str| exchange(&server, UPGRADE.replace("Host: localhost", origin).as_bytes());
    assert!(upgrade("Host: localhost:1\r\nOrigin: http://evil.example").starts_with("HTTP/1.1 403"));
    assert!(upgrade("Host: evil.example:1\r\nOrigin: http://evil.example:1").starts_with("HTTP/1.1 421"));
    // The server's own page may; the exchange ends with the server.
    let mut stream = connect(&server);
    stream.write_all(UPGRADE.replace("Host: localhost", "Host: localhost:1\r\nOrigin: http://localhost:1").as_bytes()).unwrap();
    let mut start = [0; 12];
    stream.read_exact(&mut start).unwrap();
    assert_eq!(&start, b"HTTP/1.1 101");
}

#[test]
fn a_client_may_half_close_after_its_request() {
    let server = server();
    for version in ["1.0", "1.1"] {
        let mut stream = connect(&server);
        write!(stream, "GET /healthz HTTP/{version}\r\nHost: localhost\r\n\r\n").unwrap();
        stream.shutdown(std::net::Shutdown::Write).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        assert!(answer.contains(" 503 ") && answer.ends_with("not yet"), "{answer}");
    }
}

#[test]
fn changes_require_post_and_are_rate_limited() {
    let server = server();
    let get = get(&server, "/save");
    assert!(get.starts_with("HTTP/1.1 405") && get.to_lowercase().contains("\r\nallow: post\r\n"), "{get}");
    let post = || exchange(&server, b"POST /save HTTP/1.1\r\nHost: localhost\r\nContent-Length: 0\r\nConnection: close\r\n\r\n");
    let answers: Vec<String> = (0..20).map(|_| post()).collect();
    let done = answers.iter().filter(|answer| answer.starts_with("HTTP/1.1 202")).count();
    let refused: Vec<&String> = answers.iter().filter(|answer| answer.starts_with("HTTP/1.1 429")).collect();
    assert!((1..20).contains(&done) && done + refused.len() == 20, "{answers:?}");
    assert!(refused.iter().all(|answer| answer.to_lowercase().contains("\r\nretry-after: ")), "{refused:?}");
    // A foreign page's attempts do not count.
    assert_eq!(status(&server, "POST /save HTTP/1.1", "Host: localhost\r\nOrigin: http://evil.example\r\n"), 403);
}

#[test]
fn a_client_that_pipelines_and_never_reads_is_dropped() {
    let server = server();
    let mut stuck = connect(&server);
    let request = b"GET /api/v1/state HTTP/1.1\r\nHost: localhost\r\n\r\n".repeat(2000);
    // Write until nothing more is taken, and then until the server has had enough.
    stuck.set_write_timeout(Some(Duration::from_millis(500))).unwrap();
    let begun = Instant::now();
    while !matches!(stuck.write(&request), Err(e) if e.kind() != std::io::ErrorKind::WouldBlock) {
        assert!(begun.elapsed() < Duration::from_secs(40), "it is never let go");
    }
}

#[test]
fn a_full_server_answers_requests_but_refuses_web_sockets() {
    let server = server();
    // Silent connections from one peer, which may have half of the places. They end after some
    // seconds, which the test does not wait for.
    let silent: Vec<TcpStream> = (0..200).map(|_| connect(&server)).collect();
    assert!(get(&server, "/healthz").starts_with("HTTP/1.1 503 "));
    let refused = exchange(&server, UPGRADE.as_bytes());
    assert!(refused.starts_with("HTTP/1.1 503") && refused.contains("too many clients"), "{refused}");
    drop(silent);
    wait_until(|| exchange_start(&server, UPGRADE.as_bytes()).starts_with("HTTP/1.1 101"));
}

/// Returns the first bytes of the answer.
fn exchange_start(server: &Server, request: &[u8]) -> String {
    let mut stream = connect(server);
    let mut start = [0; 12];
    let _ = stream.write_all(request).and_then(|()| stream.read_exact(&mut start));
    String::from_utf8_lossy(&start).into_owned()
}

/// A request for a WebSocket.
const UPGRADE: &str = "GET /ws HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
    Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n";

/// Returns a WebSocket that the server has subscribed to the feed.
fn web_socket(server: &Server) -> TcpStream {
    let clients = server.feed.clients();
    let stream = upgraded(server, UPGRADE);
    wait_until(|| server.feed.clients() > clients);
    stream
}

/// Returns a viewer that has received the state and has asked for nothing.
fn viewer(server: &Server) -> TcpStream {
    let mut stream = upgraded(server, &UPGRADE.replace("/ws", "/ws/view"));
    assert!(next_text(&mut stream).contains("\"state\":"));
    stream
}

fn upgraded(server: &Server, request: &str) -> TcpStream {
    let mut stream = connect(server);
    stream.write_all(request.as_bytes()).unwrap();
    let mut head = Vec::new();
    let mut byte = [0];
    while !head.ends_with(b"\r\n\r\n") {
        stream.read_exact(&mut byte).unwrap();
        head.push(byte[0]);
    }
    assert!(head.starts_with(b"HTTP/1.1 101"), "{}", String::from_utf8_lossy(&head));
    stream
}

fn wait_until(mut done: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !done() {
        assert!(begun.elapsed() < Duration::from_secs(30), "it never happens");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Returns the text of the next frame.
fn next_text(stream: &mut TcpStream) -> String {
    let (kind, content) = next_message(stream);
    assert_eq!(kind, 0x81);
    String::from_utf8(content).unwrap()
}

/// Returns the first byte and the content of the next frame, which is not masked.
fn next_message(stream: &mut TcpStream) -> (u8, Vec<u8>) {
    let mut head = [0; 2];
    stream.read_exact(&mut head).unwrap();
    let mut long = |bytes: usize| {
        let mut length = [0; 8];
        stream.read_exact(&mut length[8 - bytes..]).unwrap();
        u64::from_be_bytes(length)
    };
    let length = match head[1] {
        126 => long(2),
        127 => long(8),
        short => short.into(),
    };
    let mut content = vec![0; length as usize];
    stream.read_exact(&mut content).unwrap();
    (head[0], content)
}

/// Asks for a frame: `n`, masked with zeros.
const NEXT: [u8; 7] = [0x81, 0x81, 0, 0, 0, 0, b'n'];

/// Returns the number of the next frame and the length of its picture, skipping messages between
/// frames.
fn next_frame(stream: &mut TcpStream) -> (u64, usize) {
    loop {
        let (kind, content) = next_message(stream);
        if kind == 0x82 {
            let (length, rest) = content.split_first_chunk().unwrap();
            let (head, jpeg) = rest.split_at(u32::from_le_bytes(*length) as usize);
            let head: serde_json::Value = serde_json::from_slice(head).unwrap();
            return (head["record"]["sequence"].as_u64().unwrap(), jpeg.len());
        }
        assert_eq!(kind, 0x81);
    }
}

/// Returns a row with a JPEG of this length, as far as the server knows.
fn row(sequence: u64, bytes: usize) -> ClipEntry {
    let frame = crate::frame::Frame::new(image::GrayImage::new(4, 3), Timestamp::from_ns(40), sequence);
    let received = Some(crate::capture::Received::Jpeg(vec![7; bytes].into()));
    ClipEntry { received, ..ClipEntry::new(sequence, frame.timestamp, crate::capture::EntryContent::Frame(frame)) }
}

#[test]
fn a_web_socket_gets_every_record() {
    let server = server();
    let mut stream = web_socket(&server);
    for k in 0..20 {
        server.publish(&sample(k));
    }
    for k in 0..20 {
        assert_eq!(next_text(&mut stream), sample(k).to_json_line());
    }
    server.close();
    let mut rest = Vec::new();
    stream.read_to_end(&mut rest).unwrap();
    assert_eq!(rest, [0x88, 0], "it is closed in form");
}

#[test]
fn an_oversized_frame_ends_the_web_socket() {
    let server = server();
    let mut stream = web_socket(&server);
    // A masked text frame that announces a megabyte.
    stream.write_all(&[0x81, 0xFF, 0, 0, 0, 0, 0, 0x10, 0, 0, 1, 2, 3, 4]).unwrap();
    wait_until(|| server.feed.clients() == 0);
}

#[test]
fn a_slow_reader_is_dropped_and_delays_no_other() {
    let server = server();
    let _sleeper = web_socket(&server);
    let mut reader = web_socket(&server);
    let mut k = 0;
    wait_until(|| {
        for _ in 0..100 {
            server.publish(&sample(k));
            assert_eq!(next_text(&mut reader), sample(k).to_json_line());
            k += 1;
        }
        server.feed.clients() == 1
    });
    server.publish(&sample(k));
    assert_eq!(next_text(&mut reader), sample(k).to_json_line());
}

#[test]
fn a_port_in_use_is_refused() {
    let first = server();
    let settings = HttpSettings { listen: first.address(), hosts: Vec::new() };
    let refusal = Server::start(&settings, Vec::new()).err().unwrap().to_string();
    assert!(refusal.contains(&first.address().to_string()) && refusal.contains("free port"), "{refusal}");
}

#[test]
fn frames_are_copied_only_for_viewers_that_ask() {
    let server = server();
    let mut observer = server.observer(None);
    let mut seen = |k| observer(&row(k, 1000), &sample(k));
    let mut viewer = viewer(&server);
    (0..50).for_each(&mut seen);
    assert_eq!(server.hub.copied(), 0, "it is connected, and asks for nothing");
    for k in 50..60 {
        viewer.write_all(&NEXT).unwrap();
        wait_until(|| server.hub.waiting() == 1);
        seen(k);
        assert_eq!(next_frame(&mut viewer), (k, 1000));
        // It has the frame it asked for.
        seen(1000 + k);
    }
    assert_eq!(server.hub.copied(), 10);
    // However often it asks, a client has at most two frames on their way.
    (0..20).for_each(|_| viewer.write_all(&NEXT).unwrap());
    for k in 60..62 {
        wait_until(|| server.hub.waiting() == 1);
        seen(k);
        assert_eq!(next_frame(&mut viewer), (k, 1000));
    }
    drop(viewer);
    wait_until(|| server.hub.waiting() == 0 && server.hub.viewers() == 0);
    server.close();
}

#[test]
fn one_stalled_viewer_of_eight_harms_no_other() {
    let server = server();
    let mut observer = server.observer(None);
    let mut stalled = viewer(&server);
    let mut others: Vec<(TcpStream, Option<u64>)> = (0..7).map(|_| (viewer(&server), None)).collect();
    // Frames go on: a client that asks a little late gets the next one.
    let (end, has_ended) = crossbeam_channel::bounded::<()>(0);
    let camera = std::thread::spawn(move || {
        for k in 0.. {
            observer(&row(k, 500_000), &sample(k));
            if has_ended.recv_timeout(Duration::from_millis(5)) == Err(crossbeam_channel::RecvTimeoutError::Disconnected) {
                return;
            }
        }
    });
    let mut rounds = 0;
    // Until it is dropped: by then the system's buffers are full, and a message has timed out.
    wait_until(|| {
        let _ = stalled.write_all(&NEXT);
        others.iter_mut().for_each(|(viewer, _)| viewer.write_all(&NEXT).unwrap());
        for (viewer, last) in &mut others {
            let (k, size) = next_frame(viewer);
            assert!(size == 500_000 && last.is_none_or(|last| last < k), "{k} after {last:?}");
            *last = Some(k);
        }
        rounds += 1;
        server.hub.viewers() == 7
    });
    assert!(rounds > 2, "{rounds}");
    drop(end);
    camera.join().unwrap();
}

#[test]
fn unknown_viewer_messages_close_with_the_reason() {
    let server = server();
    for said in [&[0x81, 0x81, 0, 0, 0, 0, b'x'][..], &[0x82, 0x81, 0, 0, 0, 0, b'n'], &[0x81, 0x80, 0, 0, 0, 0]] {
        let mut viewer = viewer(&server);
        viewer.write_all(said).unwrap();
        let close = std::iter::repeat_with(|| next_message(&mut viewer)).find(|(kind, _)| *kind != 0x81).unwrap();
        assert_eq!((close.0, &close.1[..2]), (0x88, &1008_u16.to_be_bytes()[..]));
        assert!(close.1.ends_with(b"other messages are not supported"));
    }
    wait_until(|| server.hub.viewers() == 0);
}

#[test]
fn a_viewer_gets_the_state_while_no_frame_arrives() {
    let server = server();
    let mut viewer = viewer(&server);
    server.publish(&sample(7));
    let said: serde_json::Value = std::iter::repeat_with(|| serde_json::from_str(&next_text(&mut viewer)).unwrap())
        .find(|s: &serde_json::Value| s["state"]["state"].is_string())
        .unwrap();
    assert_eq!((&said["state"]["state"], &said["state"]["sequence"]), (&"tracking".into(), &7.into()));
    assert_eq!(said["page"].as_str().map(str::len), Some(16));
}

#[test]
fn events_are_sent_as_sentences() {
    let server = server();
    let log = crate::daemon::live::EventLog::default();
    server.follow_events(log.listen());
    log.publish(crate::daemon::live::Event::CameraWaiting { reason: "it is not plugged in".to_owned() });
    let mut stream = upgraded(&server, &UPGRADE.replace("/ws", "/ws/events"));
    let event: serde_json::Value = serde_json::from_str(&next_text(&mut stream)).unwrap();
    assert_eq!((&event["event"], &event["says"]), (&"camera_waiting".into(), &"waiting for the camera: it is not plugged in".into()));
    log.publish(crate::daemon::live::Event::Ended { reason: "it was asked to".to_owned() });
    assert!(next_text(&mut stream).contains("ended: it was asked to"));
    server.close();
    let mut rest = Vec::new();
    stream.read_to_end(&mut rest).unwrap();
    assert_eq!(rest, [0x88, 0], "it is closed in form");
}
