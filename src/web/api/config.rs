//! `GET`, `PUT /api/v1/config`: the config's text. A new config is checked before anything is
//! written, the former one is kept, and the running session switches to the new one.
//! `POST /api/v1/config/check` only checks one.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use axum::http::Method;
use serde_json::json;
use sha2::{Digest, Sha256};

use super::findings::{Finding, MAX_CONFIG, judged_to_run};
use crate::daemon::Supervisor;
use crate::safe_file;
use crate::utc;
use crate::web::call::Call;
use crate::web::reply::Reply;
use crate::web::routes::{Access, Route};

/// Maximum number of former configs kept; the oldest are deleted. Chosen: an evening of changes.
/// Raised, only more disk space.
const MAX_FORMER: usize = 100;
/// Number of configs that may be put in quick succession; each restarts tracking. Chosen: faster
/// than people edit. Raised, a runaway program keeps the stage from being tracked for longer.
const AT_ONCE: u32 = 20;
/// Minimum interval of further configs. Lowered, a runaway program interrupts tracking more often.
const ONE_EACH: Duration = Duration::from_secs(3);
/// Number of configs that may be checked in quick succession; each reads the pictures that it
/// names. Raised, a runaway program keeps a thread busy for longer.
const CHECKS_AT_ONCE: u32 = 60;
/// Minimum interval of further checks. Lowered, a runaway program reads more.
const ONE_CHECK_EACH: Duration = Duration::from_secs(1);

pub(super) fn routes(supervisor: &Arc<Supervisor>) -> Vec<Route> {
    let (for_get, for_put, for_check) = (supervisor.clone(), supervisor.clone(), supervisor.clone());
    vec![
        Route::slow(Method::GET, "/api/v1/config", Access::Paired, move |_| {
            let read = safe_file::read(&for_get.keeping().current(), MAX_CONFIG);
            if read.as_ref().is_err_and(|e| e.kind() == io::ErrorKind::NotFound) {
                let sentence = format!("{}: there is no config yet; put one here, with this ETag\n", for_get.file().display());
                return Err(Reply::text(404, sentence).with("etag", &tag(b"")));
            }
            let bytes = read.map_err(|e| unreadable(for_get.file(), &e))?;
            let tag = tag(&bytes);
            Ok(Reply::new(200, "text/plain; charset=utf-8", bytes).with("etag", &tag))
        }),
        Route::slow(Method::PUT, "/api/v1/config", Access::Change, move |call| {
            let text = text(call)?;
            let wanted = call.header("if-match").map(str::to_owned).ok_or_else(|| {
                Reply::text(428, "say which config this one replaces: If-Match with the ETag of GET /api/v1/config, or * for any\n")
            })?;
            take_over(&for_put, call, &text, Some(&wanted).filter(|wanted| *wanted != "*"))
        })
        .takes(MAX_CONFIG)
        .paced(AT_ONCE, ONE_EACH),
        Route::slow(Method::POST, "/api/v1/config/check", Access::Change, move |call| {
            let (_, findings) = judged_to_run(&text(call)?, for_check.file(), &for_check);
            Ok(reply(200, &findings, false))
        })
        .takes(MAX_CONFIG)
        .paced(CHECKS_AT_ONCE, ONE_CHECK_EACH),
    ]
}

/// Makes this text the config, if it can be run: the former one is kept, and the session switches
/// to it. `wanted` is the ETag of the config that it replaces; `None` replaces any.
pub(super) fn take_over(supervisor: &Supervisor, call: &Call, text: &str, wanted: Option<&String>) -> Result<Reply, Reply> {
    let _alone = supervisor.alone();
    // A config that does not exist yet has the tag of empty content.
    let before = match safe_file::read(&supervisor.keeping().current(), MAX_CONFIG) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(unreadable(supervisor.file(), &e)),
        read => read.unwrap_or_default(),
    };
    if wanted.is_some_and(|wanted| *wanted != tag(&before)) {
        return Err(Reply::text(412, "the config was changed meanwhile; read it again, and put the change into that one\n"));
    }
    let (settings, findings) = judged_to_run(text, supervisor.file(), supervisor);
    if settings.is_none() {
        return Ok(reply(422, &findings, false));
    }
    call.still_may()?;
    let changed = supervisor.keeping().changed();
    replace(&changed, text).map_err(|e| unwritable(&changed, &e))?;
    supervisor.reload();
    Ok(reply(200, &findings, true).with("etag", &tag(text.as_bytes())))
}

/// Returns the config in a request.
fn text(call: &mut Call) -> Result<String, Reply> {
    String::from_utf8(call.content(MAX_CONFIG)?).map_err(|_| Reply::text(400, "a config is text in UTF-8\n"))
}

/// Returns the reply to a new config.
pub(super) fn reply(status: u16, findings: &[Finding], saved: bool) -> Reply {
    Reply::json(status, json!({"findings": findings, "saved": saved}).to_string())
}

fn unreadable(file: &Path, error: &io::Error) -> Reply {
    Reply::text(500, format!("{}: the config cannot be read ({error})\n", file.display()))
}

/// Returns the reply for a config that cannot be written.
pub(super) fn unwritable(file: &Path, error: &io::Error) -> Reply {
    let hint = "start the daemon with a config in a folder that it may write, such as /var/lib/stagepose for the service";
    Reply::text(500, format!("{}: the config cannot be written ({error}); {hint}\n", file.display()))
}

/// Returns a content's ETag.
pub(super) fn tag(bytes: &[u8]) -> String {
    let digest = Sha256::digest(bytes);
    format!("\"{}\"", digest.iter().take(8).map(|byte| format!("{byte:02x}")).collect::<String>())
}

/// Replaces a file atomically and keeps the former one.
fn replace(file: &Path, text: &str) -> io::Result<()> {
    std::fs::create_dir_all(file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new(".")))?;
    keep_former(&[file.to_owned()])?;
    safe_file::write_lasting(file, text.as_bytes())
}

/// Copies those of these files that exist into a new folder in `former/`, next to the first file.
pub(super) fn keep_former(files: &[PathBuf]) -> io::Result<Option<PathBuf>> {
    let Some(folder) = files.first().map(|file| file.parent().unwrap_or(Path::new("")).join("former")) else { return Ok(None) };
    let stamp: String = utc::date_and_time(utc::now_s()).chars().filter(|c| *c != '-' && *c != ':').collect();
    let free = (1..).map(|n: u32| folder.join(if n == 1 { stamp.clone() } else { format!("{stamp}-{n}") })).find(|path| !path.exists());
    let Some(to) = free else { return Ok(None) };
    let there: Vec<&PathBuf> = files.iter().filter(|file| file.is_file()).collect();
    if there.is_empty() {
        return Ok(None);
    }
    std::fs::create_dir_all(&to)?;
    for file in there {
        std::fs::copy(file, to.join(file.file_name().unwrap_or_default()))?;
    }
    let mut kept: Vec<PathBuf> = std::fs::read_dir(&folder)?.filter_map(|entry| Some(entry.ok()?.path())).collect();
    kept.sort();
    for oldest in kept.iter().take(kept.len().saturating_sub(MAX_FORMER)) {
        std::fs::remove_dir_all(oldest)?;
    }
    Ok(Some(to))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::web::api::tests::{respond, respond_with, supervised};

    #[test]
    fn a_good_config_is_taken_over_and_the_former_kept() {
        let folder = tempfile::tempdir().unwrap();
        let supervisor = supervised(folder.path());
        let routes = routes(&supervisor);
        let (status, text) = respond(&routes, "GET", "/api/v1/config", b"");
        assert_eq!(status, 200);
        let put = |if_match: &str, text: &[u8]| respond_with(&routes, "PUT", "/api/v1/config", if_match, text);
        let new = [&text[..], b"[log]\nlevel = \"info\"\n"].concat();
        assert_eq!(put("", &new).0, 428);
        assert_eq!(put("If-Match: \"0\"\r\n", &new).0, 412);
        assert!(!supervisor.take_reload());
        let if_match = format!("If-Match: {}\r\n", tag(&text));
        let (status, said) = put(&if_match, &new);
        assert_eq!(status, 200, "{}", String::from_utf8_lossy(&said));
        assert!(supervisor.take_reload());
        assert_eq!(std::fs::read(supervisor.file()).unwrap(), new);
        let former = std::fs::read_dir(folder.path().join("former")).unwrap().next().unwrap().unwrap().path();
        assert_eq!(std::fs::read(former.join("stage.toml")).unwrap(), text);
        assert_eq!(put(&if_match, &new).0, 412, "it is another one now");
    }

    #[test]
    fn a_bad_config_changes_nothing_and_says_where_it_is_bad() {
        let folder = tempfile::tempdir().unwrap();
        let supervisor = supervised(folder.path());
        let before = std::fs::read(supervisor.file()).unwrap();
        for (text, line, word) in [
            ("[camera]\nfov_deg = 60\nfovdeg = 1\n", Some(3), "fov"),
            ("[camera\n", Some(1), "TOML"),
            ("[camera]\nfov_deg = 600\n[[stage.surface]]\nimage = \"backdrop.png\"\nsize_m = [4.0, 3.0]\n", Some(2), "fov_deg"),
            ("", None, "stage"),
        ] {
            let (status, said) = respond_with(&routes(&supervisor), "PUT", "/api/v1/config", "If-Match: *\r\n", text.as_bytes());
            let said: serde_json::Value = serde_json::from_slice(&said).unwrap();
            let finding = &said["findings"][0];
            assert_eq!((status, &said["saved"], &finding["level"]), (422, &false.into(), &"error".into()), "{said}");
            assert_eq!(finding["line"].as_u64(), line, "{said}");
            assert!(finding.to_string().contains(word), "{said}");
        }
        assert_eq!(respond_with(&routes(&supervisor), "PUT", "/api/v1/config", "If-Match: *\r\n", b"\xff").0, 400);
        assert_eq!((std::fs::read(supervisor.file()).unwrap(), supervisor.take_reload()), (before, false));
    }

    #[test]
    fn a_check_writes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let supervisor = supervised(folder.path());
        let before = std::fs::read(supervisor.file()).unwrap();
        let good = [&before[..], b"[log]\nlevel = \"info\"\n"].concat();
        for (text, level) in [(&good[..], None), (b"[camera]\nfov_deg = 600\n", Some("error"))] {
            let (status, said) = respond(&routes(&supervisor), "POST", "/api/v1/config/check", text);
            let said: serde_json::Value = serde_json::from_slice(&said).unwrap();
            let error = said["findings"].as_array().unwrap().iter().find(|finding| finding["level"] == "error");
            assert_eq!((status, &said["saved"], error.map(|_| "error")), (200, &false.into(), level), "{said}");
        }
        assert_eq!((std::fs::read(supervisor.file()).unwrap(), supervisor.take_reload()), (before, false));
    }

    #[test]
    fn ports_in_use_refuse_a_config_unless_they_are_our_own() {
        let folder = tempfile::tempdir().unwrap();
        let supervisor = supervised(folder.path());
        let routes = routes(&supervisor);
        let plain = std::fs::read_to_string(supervisor.file()).unwrap();
        let put = |more: &str| {
            let text = format!("{plain}{more}");
            let (status, said) = respond_with(&routes, "PUT", "/api/v1/config", "If-Match: *\r\n", text.as_bytes());
            (status, String::from_utf8(said).unwrap())
        };
        let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let at = taken.local_addr().unwrap();
        let lines = |key: &str, value: &str| format!("[[output]]\nkind = \"json\"\n{key} = \"{value}\"\n");
        let multicast = "[[output]]\nkind = \"freed\"\nto = \"239.1.2.3:4000\"\ninterface = \"no-such-network\"\n";
        for (what, more, word) in [
            ("a taken port", lines("tcp_listen", &at.to_string()), "tcp_listen"),
            ("a foreign address", lines("tcp_listen", "203.0.113.7:4000"), "tcp_listen"),
            ("a taken port of the page", format!("[http]\nlisten = \"{at}\"\n"), "listen"),
            ("a missing network", multicast.to_owned(), "interface"),
            ("a file in no folder", lines("file", "none/a.jsonl"), "file"),
            ("two in one file", lines("file", "a.jsonl") + &lines("file", "./a.jsonl"), "file"),
        ] {
            let (status, said) = put(&more);
            let answer: serde_json::Value = serde_json::from_str(&said).unwrap();
            let finding = &answer["findings"][0];
            assert_eq!((status, &answer["saved"], &finding["level"]), (422, &false.into(), &"error".into()), "{what}: {said}");
            assert!(finding["key"].as_str().unwrap().contains(word) && finding["line"].as_u64() > Some(7), "{what}: {said}");
            assert!(finding["mend"].is_string(), "{what}: {said}");
            assert_eq!((std::fs::read_to_string(supervisor.file()).unwrap(), supervisor.take_reload()), (plain.clone(), false), "{what}");
        }
        // The address that the running session listens on will be free.
        let listens = lines("tcp_listen", &at.to_string());
        std::fs::write(supervisor.file(), format!("{plain}{listens}")).unwrap();
        supervisor.use_settings(Some(crate::config::Settings::load(supervisor.file()).unwrap()));
        let (status, said) = put(&format!("{listens}[log]\nlevel = \"info\"\n"));
        assert!(status == 200 && supervisor.take_reload(), "{said}");
        // So will the page's own port, even if no config is in force yet.
        supervisor.use_settings(None);
        supervisor.set_page(Some(at));
        let (status, said) = put(&format!("[http]\nlisten = \"{at}\"\n"));
        assert!(status == 200 && supervisor.take_reload(), "{said}");
    }
}
