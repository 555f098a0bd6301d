use std::io::{Read, Write};
use std::net::{Ipv4Addr, TcpStream};
use std::time::Instant;

use super::*;
use crate::record::State;

fn server() -> Server {
    let settings = HttpSettings { listen: (Ipv4Addr::LOCALHOST, 0).into() };
    Server::start(&settings, vec![Route::new("/healthz", |r| Reply::text(503, format!("{} {:?}", r.path, r.query)))]).unwrap()
}

fn sample(sequence: u64) -> PoseSample {
    PoseSample {
        sequence,
        timestamp_ns: 40,
        state: State::Tracking,
        pose: Some(crate::publish::golden::golden_camera()),
        measurement: None,
        objects: Vec::new(),
        times: Default::default(),
    }
}

fn connect(server: &Server) -> TcpStream {
    let stream = TcpStream::connect(server.address()).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    stream.set_write_timeout(Some(Duration::from_secs(20))).unwrap();
    stream
}

/// Everything that comes until the server closes.
fn exchange(server: &Server, request: &[u8]) -> String {
    let mut stream = connect(server);
    // The server may close before it has read everything.
    let _ = stream.write_all(request);
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    String::from_utf8_lossy(&answer).into_owned()
}

fn get(server: &Server, path: &str) -> String {
    exchange(server, format!("GET {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n").as_bytes())
}

#[test]
fn pose_state_and_added_routes_are_answered() {
    let server = server();
    assert!(get(&server, "/api/v1/pose").starts_with("HTTP/1.1 503"));
    assert!(get(&server, "/api/v1/state").contains(r#""state":null"#));
    server.publish(&sample(7));
    let answer = get(&server, "/api/v1/pose");
    assert!(answer.starts_with("HTTP/1.1 200") && answer.ends_with(&sample(7).to_json_line()), "{answer}");
    let answer = get(&server, "/api/v1/state");
    assert!(answer.contains(r#""state":"tracking""#) && answer.contains(r#""sequence":7"#), "{answer}");
    let answer = get(&server, "/healthz?deep=1");
    assert!(answer.starts_with("HTTP/1.1 503") && answer.ends_with(r#"/healthz Some("deep=1")"#), "{answer}");
    assert!(get(&server, "/nothing").starts_with("HTTP/1.1 404"));
    server.close();
}

#[test]
fn malformed_and_oversized_requests_are_refused() {
    let server = server();
    let long = format!("GET /{} HTTP/1.1\r\nHost: x\r\n\r\n", "a".repeat(64 * 1024));
    let many = format!("GET / HTTP/1.1\r\n{}\r\n", "X: y\r\n".repeat(200));
    let posted = "POST /api/v1/pose HTTP/1.1\r\nHost: x\r\nConnection: close\r\nContent-Length: 3\r\n\r\nabc";
    let with_body = "GET /api/v1/pose HTTP/1.1\r\nHost: x\r\nConnection: close\r\nContent-Length: 3\r\n\r\nabc";
    let no_key = "GET /ws HTTP/1.1\r\nHost: x\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\r\n";
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

const UPGRADE: &str = "GET /ws HTTP/1.1\r\nHost: x\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
    Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n";

/// A WebSocket that the server has subscribed to the feed.
fn web_socket(server: &Server) -> TcpStream {
    let clients = server.feed.clients();
    let mut stream = connect(server);
    stream.write_all(UPGRADE.as_bytes()).unwrap();
    let mut head = Vec::new();
    let mut byte = [0];
    while !head.ends_with(b"\r\n\r\n") {
        stream.read_exact(&mut byte).unwrap();
        head.push(byte[0]);
    }
    assert!(head.starts_with(b"HTTP/1.1 101"), "{}", String::from_utf8_lossy(&head));
    wait_until(|| server.feed.clients() > clients);
    stream
}

fn wait_until(mut done: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !done() {
        assert!(begun.elapsed() < Duration::from_secs(30), "it never happens");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// The text of the next frame, which is not masked and shorter than 64 kB.
fn next_text(stream: &mut TcpStream) -> String {
    let mut head = [0; 2];
    stream.read_exact(&mut head).unwrap();
    assert_eq!(head[0], 0x81);
    let length = match head[1] {
        126 => {
            let mut long = [0; 2];
            stream.read_exact(&mut long).unwrap();
            usize::from(u16::from_be_bytes(long))
        }
        short => usize::from(short),
    };
    let mut text = vec![0; length];
    stream.read_exact(&mut text).unwrap();
    String::from_utf8(text).unwrap()
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
fn a_slow_reader_is_dropped_and_holds_nobody_up() {
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
    let refusal = Server::start(&HttpSettings { listen: first.address() }, Vec::new()).err().unwrap().to_string();
    assert!(refusal.contains(&first.address().to_string()) && refusal.contains("free port"), "{refusal}");
}
