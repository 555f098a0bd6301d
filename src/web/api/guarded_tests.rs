//! The guarantees for every route, checked on each route of the router.

use std::net::Ipv4Addr;
use std::path::Path;
use std::sync::Arc;

use serde_json::Value;

use super::tests::{Answer, exchange, supervised, whole_server};
use crate::config::HttpSettings;
use crate::publish::FrameClock;
use crate::web::Server;

/// Paths that may answer 503 because nothing is known yet.
pub(super) const NOT_YET: [&str; 4] = ["/healthz", "/api/v1/pose", "/api/v1/scene", "/api/v1/surfaces/{number}/picture"];

/// A route as the router lists it.
#[derive(Debug, Clone)]
pub(super) struct Listed {
    pub method: String,
    pub path: String,
    pub access: String,
}

pub(super) fn listed(server: &Server) -> Vec<Listed> {
    let answer = exchange(server.address(), "GET", "/api/v1/routes", "Host: localhost\r\n", b"");
    let list: Value = serde_json::from_slice(&answer.content).unwrap();
    let text = |entry: &Value, key: &str| entry[key].as_str().unwrap().to_owned();
    let read = |entry: &Value| Listed { method: text(entry, "method"), path: text(entry, "path"), access: text(entry, "access") };
    list["routes"].as_array().unwrap().iter().map(read).collect()
}

/// Returns the path with a value in place of each field.
pub(super) fn filled(path: &str) -> String {
    [("{id}", "clip-1"), ("{row}", "0"), ("{name}", "door.glb"), ("{number}", "0")]
        .iter()
        .fold(path.to_owned(), |path, (field, value)| path.replace(field, value))
}

/// Checks the security headers that every answer must have, once each.
fn holds_the_browser(answer: &Answer, of: &str) {
    let policies = answer.values("content-security-policy");
    assert_eq!(policies.len(), 1, "{of}: {}", answer.head);
    assert!(policies[0].starts_with("default-src 'none'") && policies[0].contains("frame-ancestors 'none'"), "{of}: {}", policies[0]);
    assert_eq!(answer.values("x-content-type-options"), ["nosniff"], "{of}");
    assert_eq!(answer.values("cross-origin-resource-policy"), ["same-origin"], "{of}");
    assert_eq!(answer.values("cache-control").len(), 1, "{of}: {}", answer.head);
    assert!(!answer.head.contains("access-control-allow"), "{of}: {}", answer.head);
}

/// Returns the status of a request that must be refused with a sentence.
fn refused(server: &Server, method: &str, path: &str, headers: &str) -> u16 {
    let answer = exchange(server.address(), method, path, headers, b"");
    let of = format!("{method} {path} {headers:?}");
    holds_the_browser(&answer, &of);
    let message = answer.text();
    assert!(
        message.ends_with('\n') && message.len() > 10 && answer.values("content-type") == ["text/plain; charset=utf-8"],
        "{of}: {message}"
    );
    answer.status
}

#[test]
fn every_route_refuses_unauthorised_clients() {
    let folder = tempfile::tempdir().unwrap();
    let server = whole_server(&supervised(folder.path()), None);
    let routes = listed(&server);
    assert!(routes.len() > 70 && routes.iter().any(|route| route.path == "/ws/view") && routes.iter().any(|route| route.path == "/"));
    for Listed { method, path, access } in &routes {
        let (filled, own) = (filled(path), "Host: localhost\r\n");
        let status = |method: &str, headers: &str| refused(&server, method, &filled, headers);
        assert_eq!(status(method, "Host: evil.example\r\n"), 421, "{method} {path}");
        assert_eq!(status(method, &format!("{own}Origin: http://evil.example\r\nX-Stagepose: 1\r\n")), 403, "{method} {path}");
        assert_eq!(status(method, &format!("{own}Sec-Fetch-Site: cross-site\r\nX-Stagepose: 1\r\n")), 403, "{method} {path}");
        assert_eq!(status("PATCH", own), 405, "{method} {path}");
        let elsewhere = format!("{own}X-Forwarded-For: 192.0.2.7\r\n");
        match access.as_str() {
            "paired" | "change" | "unlock" => assert_eq!(status(method, &elsewhere), 401, "{method} {path}"),
            // Reading needs no key; a pairing request has none yet, and this one contains no code.
            "anyone" | "pair" => assert_ne!(exchange(server.address(), method, &filled, &elsewhere, b"").status, 401, "{method} {path}"),
            other => panic!("{path}: there is no access {other}"),
        }
        if method == "GET" {
            assert!(["anyone", "paired"].contains(&access.as_str()), "{path} changes something by GET");
            let answer = exchange(server.address(), "GET", &filled, own, b"");
            holds_the_browser(&answer, path);
            assert!(answer.status < 500 || NOT_YET.contains(&path.as_str()), "{path}: {}", answer.text());
        } else {
            assert!(["change", "unlock", "pair"].contains(&access.as_str()), "{method} {path} is open to anyone");
            assert_eq!(status(method, &format!("{own}Origin: http://localhost\r\n")), 403, "{method} {path}: a page says X-Stagepose");
        }
    }
}

#[test]
fn under_the_show_lock_only_the_lock_can_change() {
    let folder = tempfile::tempdir().unwrap();
    let server = whole_server(&supervised(folder.path()), None);
    let own = "Host: localhost\r\n";
    assert_eq!(exchange(server.address(), "POST", "/api/v1/lock", own, b"").status, 204);
    let changes: Vec<Listed> = listed(&server).into_iter().filter(|route| route.access == "change").collect();
    assert!(changes.len() > 10, "{changes:?}");
    for route in &changes {
        assert_eq!(refused(&server, &route.method, &filled(&route.path), own), 423, "{route:?}");
    }
    assert_eq!(exchange(server.address(), "POST", "/api/v1/unlock", own, b"").status, 204);
    assert_eq!(exchange(server.address(), "POST", "/api/v1/lock", own, b"").status, 204, "changes are taken again");
}

#[test]
fn a_page_from_a_folder_gets_the_same_security_headers() {
    let folder = tempfile::tempdir().unwrap();
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/web/page");
    let server = whole_server(&supervised(folder.path()), Some(&page));
    for path in ["/", "/app.js", "/style.css", "/none.js", "/../Cargo.toml"] {
        holds_the_browser(&exchange(server.address(), "GET", path, "Host: localhost\r\n", b""), path);
    }
    let script = exchange(server.address(), "GET", "/app.js", "Host: localhost\r\n", b"");
    assert!(script.status == 200 && script.values("content-security-policy")[0].contains("script-src 'self'"), "{}", script.head);
}

#[test]
fn every_route_is_in_the_documents() {
    let folder = tempfile::tempdir().unwrap();
    let server = whole_server(&supervised(folder.path()), None);
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/protocols.md")).unwrap();
    let (_, text) = text.split_once("### WebSocket and HTTP").unwrap();
    let words: Vec<&str> = text.split(|c: char| !c.is_ascii_alphanumeric()).collect();
    for route in listed(&server).iter().filter(|route| route.path.starts_with("/api/") || route.path.starts_with("/ws")) {
        let last = route.path.split('/').rfind(|part| !part.starts_with('{')).unwrap();
        assert!(words.contains(&last), "docs/protocols.md does not name {} {}", route.method, route.path);
    }
}

#[test]
fn rate_limits_are_beyond_manual_use() {
    let folder = tempfile::tempdir().unwrap();
    let supervisor = supervised(folder.path());
    let clock = Arc::new(FrameClock::new(crate::publish::Stamps::Live));
    let settings = HttpSettings { listen: (Ipv4Addr::LOCALHOST, 0).into(), hosts: Vec::new() };
    let server = Server::start(&settings, super::routes(&supervisor, &clock)).unwrap();
    let own = "Host: localhost\r\nIf-Match: *\r\n";
    let config = std::fs::read(supervisor.file()).unwrap();
    let kinds: [(&str, &str, &[u8], usize); 3] = [
        ("POST", "/api/v1/recordings/mark", b"{}", 20),
        ("POST", "/api/v1/mode", br#"{"mode":"setup"}"#, 6),
        ("PUT", "/api/v1/config", &config, 10),
    ];
    for (method, path, content, by_hand) in kinds {
        let answers: Vec<Answer> =
            (0..200).map(|_| exchange(server.address(), method, path, own, content)).take_while(|answer| answer.status != 429).collect();
        assert!((by_hand..200).contains(&answers.len()), "{path}: {} at once", answers.len());
        assert!(answers.iter().all(|answer| (200..300).contains(&answer.status)), "{path}: {:?}", answers.last());
        let refused = exchange(server.address(), method, path, own, content);
        assert!(refused.status == 429 && !refused.values("retry-after").is_empty(), "{path}: {}", refused.head);
    }
}
