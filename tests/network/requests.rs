//! Damaged requests for a real daemon: each gets an HTTP answer or none, strangers get nothing, and
//! the daemon stays healthy.

use super::inputs;
use super::mutator::Mutator;
use super::service::Service;

/// Statuses of requests that were admitted, and of those that were refused.
const LET_IN: [u16; 9] = [101, 200, 202, 304, 404, 405, 413, 429, 503];
const REFUSED: [u16; 6] = [400, 403, 414, 421, 426, 431];

fn good() -> Vec<Vec<u8>> {
    let get = |path: &str, more: &str| format!("GET {path} HTTP/1.1\r\nHost: localhost:8090\r\n{more}\r\n").into_bytes();
    let upgrade =
        "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
    let frames = b"\x89\x80\x01\x02\x03\x04\x81\x83\x01\x02\x03\x04abc\x88\x80\x01\x02\x03\x04".to_vec();
    vec![
        get("/", "Accept-Encoding: gzip\r\nIf-None-Match: \"0123456789abcdef\"\r\n"),
        get("/vendor/preact.js", "If-None-Match: W/\"1\", *\r\n"),
        get("/api/v1/state", ""),
        get("/api/v1/scene", ""),
        get("/api/v1/pose?x=%00%ff", "Origin: http://localhost:8090\r\nAccept: */*\r\n"),
        get("/healthz", "Sec-Fetch-Site: same-origin\r\nConnection: close\r\n"),
        get("/metrics", "User-Agent: Prometheus/3\r\nAccept-Encoding: gzip\r\n"),
        [get("/ws", upgrade), frames.clone()].concat(),
        [get("/ws/events", upgrade), frames.clone()].concat(),
        // `n` asks for a frame; the rest is not understood.
        [get("/ws/view?width=-1", upgrade), b"\x81\x81\x00\x00\x00\x00n\x82\x81\x00\x00\x00\x00n".to_vec(), frames].concat(),
        b"POST /api/v1/ring/save HTTP/1.1\r\nHost: [::1]\r\nContent-Length: 0\r\n\r\n".to_vec(),
        b"POST /api/v1/ring/save HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n3\r\nabc\r\n0\r\n\r\n".to_vec(),
        b"GET http://127.0.0.1/healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".to_vec(),
        b"GET /healthz HTTP/1.1\r\nHost: evil.example\r\n\r\n".to_vec(),
        b"GET /ws HTTP/1.1\r\nHost: evil.example\r\nOrigin: http://evil.example\r\n\r\n".to_vec(),
        b"HEAD /healthz HTTP/1.0\r\n\r\n".to_vec(),
        get("/healthz", "").repeat(20),
        b"OPTIONS * HTTP/1.1\r\nHost: localhost\r\n\r\n".to_vec(),
    ]
}

/// Whether any text in the request could be a host of this machine, or a request that needs no
/// host.
fn may_be_let_in(request: &[u8]) -> bool {
    let text = String::from_utf8_lossy(request).to_ascii_lowercase();
    ["localhost", "127.", "::", "http/1.0"].iter().any(|part| text.contains(part))
}

#[test]
fn damaged_requests_do_no_harm() {
    let (good, mut mutator, mut service) = (good(), Mutator::new(7), Service::start());
    let (mut let_in, mut refused, mut unanswered) = (0, 0, 0);
    for count in 0..inputs() {
        let request = mutator.input(&good);
        let answer = service.ask(&request);
        if answer.is_empty() {
            unanswered += 1;
        } else {
            let text = String::from_utf8_lossy(&answer);
            let status = text.strip_prefix("HTTP/1.").and_then(|rest| rest.get(2..5)?.parse().ok()).unwrap_or(0);
            let is_let_in = LET_IN.contains(&status);
            assert!(is_let_in || REFUSED.contains(&status), "{text} for {}", String::from_utf8_lossy(&request));
            assert!(!is_let_in || may_be_let_in(&request), "{text} for {}", String::from_utf8_lossy(&request));
            let_in += u64::from(is_let_in);
            refused += u64::from(!is_let_in);
        }
        if count % 20 == 0 {
            service.check();
        }
    }
    assert!(let_in > inputs() / 20 && refused > inputs() / 20, "{let_in} let in, {refused} refused");
    service.end(&format!("{} damaged requests, {let_in} let in, {refused} refused, {unanswered} without an answer", inputs()));
}
