use std::os::unix::fs::PermissionsExt;

use super::*;

fn headers(of: &[(&'static str, &str)]) -> HeaderMap {
    of.iter().map(|(name, value)| (header::HeaderName::from_static(name), value.parse().unwrap())).collect()
}

fn elsewhere() -> IpAddr {
    "192.0.2.7".parse().unwrap()
}

#[test]
fn a_code_pairs_once_and_the_token_is_not_stored() {
    let folder = tempfile::tempdir().unwrap();
    let keys = Keys::open(Some(folder.path()), 1).unwrap();
    let file = code_file(folder.path(), 1);
    let code = std::fs::read_to_string(&file).unwrap();
    assert_eq!((code.len(), code.as_str()), (8, keys.code().as_str()));
    assert_eq!(file.metadata().unwrap().permissions().mode() & 0o777, 0o600);
    let now = Instant::now();
    let cookie = keys.pair(&format!("{} {}", &code[..4], &code[4..]), "Anna's\u{1b} tablet", elsewhere(), now).unwrap();
    assert!(cookie.ends_with("; HttpOnly; SameSite=Strict"), "{cookie}");
    let token = cookie.split(';').next().unwrap();
    let given = headers(&[("cookie", &format!("other=1; {token}"))]);
    let change =
        |keys: &Keys, headers: &HeaderMap| keys.judge(Access::Change, &Method::POST, headers, elsewhere()).err().map_or(0, |r| r.status);
    assert_eq!((change(&keys, &given), change(&keys, &HeaderMap::new())), (0, 401));
    assert_eq!(keys.pair(&code, "again", elsewhere(), now).unwrap_err().status, 401, "each code is used once");
    let kept = std::fs::read_to_string(folder.path().join("clients-1.json")).unwrap();
    assert!(!kept.contains(token.split_once('=').unwrap().1), "{kept}");
    drop(keys);
    assert!(!file.exists());
    // The pairing survives a restart, until it is revoked.
    let keys = Keys::open(Some(folder.path()), 1).unwrap();
    assert_eq!(change(&keys, &given), 0);
    let client = &keys.clients()[0];
    assert_eq!(client["name"], "Anna's tablet");
    keys.revoke(client["id"].as_str().unwrap()).unwrap();
    assert_eq!((change(&keys, &given), keys.revoke("0").unwrap_err().status), (401, 404));
}

#[test]
fn code_guesses_are_limited_per_peer() {
    let keys = Keys::open(None, 1).unwrap();
    let (begun, honest) = (Instant::now(), "192.0.2.8".parse().unwrap());
    let guess = |peer: &str, s: u64| keys.pair("x", "", peer.parse().unwrap(), begun + Duration::from_secs(s)).unwrap_err().status;
    let tried: Vec<u16> = (0..8).map(|s| guess("192.0.2.7", s)).collect();
    assert_eq!(tried, [401, 401, 401, 401, 401, 429, 429, 429]);
    // An IPv6 host may use any address of its network.
    let tried: Vec<u16> = (0..7).map(|k| guess(&format!("2001:db8::{k}"), 8)).collect();
    assert_eq!(tried, [401, 401, 401, 401, 401, 429, 429]);
    assert_eq!(keys.pair(&keys.code(), "", elsewhere(), begun + Duration::from_secs(8)).unwrap_err().status, 429, "also for who knows it");
    assert!(keys.pair(&keys.code(), "", honest, begun + Duration::from_secs(8)).is_ok());
    assert!(keys.pair(&keys.code(), "", elsewhere(), begun + Duration::from_secs(70)).is_ok());
    // All peers together have few tries.
    let let_in = (0..200).filter(|k| guess(&format!("198.51.100.{k}"), 140) == 401).count();
    assert_eq!(let_in, MAX_TRIES_OF_ALL);
}

#[test]
fn each_daemon_of_a_machine_has_its_own_cookie() {
    let pair = |port| {
        let keys = Keys::open(None, port).unwrap();
        let cookie = keys.pair(&keys.code(), "", elsewhere(), Instant::now()).unwrap();
        (keys, cookie.split(';').next().unwrap().to_owned())
    };
    let ((one, cookie), (other, another)) = (pair(8090), pair(8091));
    assert!(cookie.starts_with("stagepose-8090=") && another.starts_with("stagepose-8091="), "{cookie} {another}");
    // A browser paired with both sends both cookies.
    let both = headers(&[("cookie", &format!("{cookie}; {another}"))]);
    assert!(one.is_paired(&both) && other.is_paired(&both));
    let of_one = headers(&[("cookie", &cookie)]);
    assert!(one.is_paired(&of_one) && !other.is_paired(&of_one));
    // Browsers paired by an earlier version stay paired.
    assert!(one.is_paired(&headers(&[("cookie", &cookie.replace("stagepose-8090", "stagepose"))])));
}

#[test]
fn local_clients_may_change_unless_they_use_a_proxy() {
    let keys = Keys::open(None, 1).unwrap();
    let change = |of: &[(&'static str, &str)], peer: &str| {
        keys.judge(Access::Change, &Method::POST, &headers(of), peer.parse().unwrap()).err().map_or(0, |r| r.status)
    };
    for peer in ["127.0.0.1", "::1", "::ffff:127.0.0.1"] {
        assert_eq!(change(&[], peer), 0, "{peer}");
        assert_eq!(change(&[("x-forwarded-for", "192.0.2.7")], peer), 401);
        assert_eq!(change(&[("forwarded", "for=192.0.2.7")], peer), 401);
        assert_eq!(change(&[("origin", "http://localhost")], peer), 403, "a browser says the header");
        assert_eq!(change(&[("origin", "http://localhost"), ("x-stagepose", "1")], peer), 0);
    }
    assert_eq!(change(&[("cookie", "stagepose=; stagepose")], "192.0.2.7"), 401);
}

#[test]
fn the_lock_blocks_changes_but_can_be_released() {
    let folder = tempfile::tempdir().unwrap();
    let keys = Keys::open(Some(folder.path()), 1).unwrap();
    keys.lock(true).unwrap();
    drop(keys);
    let keys = Keys::open(Some(folder.path()), 1).unwrap();
    let asked = |access| keys.judge(access, &Method::POST, &HeaderMap::new(), [127, 0, 0, 1].into()).err().map_or(0, |r| r.status);
    assert_eq!([Access::Change, Access::Unlock, Access::Paired, Access::Anyone].map(asked), [423, 0, 0, 0]);
    keys.lock(false).unwrap();
    assert_eq!(asked(Access::Change), 0);
}
