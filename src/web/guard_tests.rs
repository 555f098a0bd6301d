use std::net::Ipv4Addr;

use super::*;
use crate::config::HostName;

/// Returns the status for a request with these headers; 0 if it passes.
fn status(method: &str, target: &str, version: Version, headers: &[(&str, &str)]) -> u16 {
    let hosts = AllowedHosts::new(&[HostName::parse("stage.example.org").unwrap()]);
    let mut request = Request::builder().method(method).uri(target).version(version);
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    let refusal = judge(&hosts, &request.body(()).unwrap(), Ipv4Addr::LOCALHOST.into()).err();
    if let Some(reply) = &refusal {
        let sentence = String::from_utf8(reply.body.clone()).unwrap();
        assert!(sentence.ends_with('\n') && sentence.len() > 20, "{sentence}");
    }
    refusal.map_or(0, |reply| reply.status)
}

fn get(headers: &[(&str, &str)]) -> u16 {
    status("GET", "/ws", Version::HTTP_11, headers)
}

#[test]
fn the_host_must_be_of_this_machine() {
    for host in ["localhost", "localhost:8090", "127.0.0.1:1", "[::1]:8090", "[::1]", "STAGE.EXAMPLE.ORG:80"] {
        assert_eq!(get(&[("host", host)]), 0, "{host}");
    }
    for host in ["evil.example", "evil.example:8090", "8.8.8.8", "[2001:db8::1]:8090", "localhost.evil.example", "0.0.0.0:8090"] {
        assert_eq!(get(&[("host", host)]), 421, "{host}");
    }
    for host in ["", "a b", "localhost:x", "u@localhost", "localhost:99999", "[::1"] {
        assert_eq!(get(&[("host", host)]), 400, "{host}");
    }
    assert_eq!(get(&[("host", "localhost"), ("host", "localhost")]), 400);
    assert_eq!(get(&[("host", "localhost"), ("host", "evil.example")]), 400);
}

#[test]
fn without_a_host_only_http_1_0_passes() {
    assert_eq!(get(&[]), 400);
    assert_eq!(status("GET", "/healthz", Version::HTTP_10, &[]), 0);
    assert_eq!(status("GET", "/healthz", Version::HTTP_10, &[("host", "evil.example")]), 421);
    assert_eq!(status("GET", "/healthz", Version::HTTP_10, &[("origin", "http://localhost")]), 403);
}

#[test]
fn an_absolute_request_target_counts_as_the_host() {
    let whole = |target: &str, headers: &[(&str, &str)]| status("GET", target, Version::HTTP_11, headers);
    assert_eq!(whole("http://localhost:8090/ws", &[("host", "localhost:8090")]), 0);
    assert_eq!(whole("http://localhost/ws", &[("host", "localhost:80")]), 0);
    assert_eq!(whole("http://evil.example/ws", &[("host", "localhost")]), 400);
    assert_eq!(whole("http://localhost/ws", &[("host", "evil.example")]), 400);
    assert_eq!(whole("http://evil.example/ws", &[("host", "evil.example")]), 421);
    assert_eq!(whole("https://localhost/ws", &[("host", "localhost")]), 400);
    assert_eq!(whole("http://u@localhost/ws", &[("host", "localhost")]), 400);
    assert_eq!(status("GET", "http://evil.example/ws", Version::HTTP_10, &[]), 421);
    assert_eq!(status("CONNECT", "evil.example:443", Version::HTTP_11, &[("host", "localhost")]), 400);
}

#[test]
fn the_origin_must_be_this_server() {
    let from = |host: &str, origin: &str| get(&[("host", host), ("origin", origin)]);
    for (host, origin) in [
        ("localhost:8090", "http://localhost:8090"),
        ("[::1]:8090", "http://[::1]:8090"),
        ("localhost", "http://localhost"),
        ("localhost:80", "http://localhost"),
        ("stage.example.org", "https://stage.example.org"),
        ("stage.example.org:443", "https://stage.example.org"),
    ] {
        assert_eq!(from(host, origin), 0, "{host} {origin}");
    }
    for origin in [
        "null",
        "",
        "http://evil.example",
        "http://localhost",
        "http://localhost:8091",
        "https://localhost",
        "http://127.0.0.1:8090",
        "http://localhost:8090.evil.example",
        "http://localhost:8090/",
        "http://u@localhost:8090",
        "ws://localhost:8090",
        "chrome-extension://abc",
        "file://",
    ] {
        assert_eq!(from("localhost:8090", origin), 403, "{origin}");
    }
    let twice = [("host", "localhost:8090"), ("origin", "http://localhost:8090"), ("origin", "http://localhost:8090")];
    assert_eq!(get(&twice), 403);
}

#[test]
fn fetch_metadata_headers_are_respected() {
    let fetched = |method: &str, fetch: &[(&str, &str)]| {
        status(method, "/api/v1/state", Version::HTTP_11, &[&[("host", "localhost")], fetch].concat())
    };
    assert_eq!(fetched("GET", &[("sec-fetch-site", "same-origin")]), 0);
    assert_eq!(fetched("GET", &[("sec-fetch-site", "none"), ("sec-fetch-mode", "navigate")]), 0);
    for site in ["cross-site", "same-site", "", "else"] {
        assert_eq!(fetched("GET", &[("sec-fetch-site", site)]), 403, "{site}");
        assert_eq!(fetched("GET", &[("sec-fetch-site", site), ("sec-fetch-mode", "no-cors"), ("sec-fetch-dest", "image")]), 403);
        assert_eq!(fetched("GET", &[("sec-fetch-site", site), ("sec-fetch-mode", "navigate"), ("sec-fetch-dest", "iframe")]), 403);
        let link = [("sec-fetch-site", site), ("sec-fetch-mode", "navigate"), ("sec-fetch-dest", "document")];
        assert_eq!((fetched("GET", &link), fetched("POST", &link)), (0, 403));
    }
}
