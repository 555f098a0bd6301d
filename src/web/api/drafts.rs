//! `GET`, `PUT /api/v1/setup/draft`: what was typed into the set-up and is no config yet, for every
//! browser and after the daemon's end. `GET /api/v1/setup/config`: the config in parts, for a
//! set-up that goes on from it.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use axum::http::Method;
use serde_json::{Map, Value, json};

use super::config::tag;
use super::failed;
use super::findings::MAX_CONFIG;
use crate::daemon::Supervisor;
use crate::safe_file;
use crate::web::call::Call;
use crate::web::reply::Reply;
use crate::web::routes::{Access, Route};

/// Maximum size of a draft, bytes: a thousand times one. A round figure.
const MAX_DRAFT: u64 = 1 << 20;
/// Its file, next to the config.
const FILE: &str = "setup-draft.json";

pub(super) fn routes(supervisor: &Arc<Supervisor>) -> Vec<Route> {
    let (for_get, for_put, for_config) = (supervisor.clone(), supervisor.clone(), supervisor.clone());
    vec![
        Route::slow(Method::GET, "/api/v1/setup/draft", Access::Paired, move |_| {
            let bytes = read(&for_get)?;
            let tag = tag(&bytes);
            // A draft that does not exist yet has the tag of empty content.
            let content = if bytes.is_empty() { b"null".to_vec() } else { bytes };
            Ok(Reply::new(200, "application/json", content).with("etag", &tag))
        }),
        Route::slow(Method::PUT, "/api/v1/setup/draft", Access::Change, move |call| put(&for_put, call)).takes(MAX_DRAFT),
        Route::slow(Method::GET, "/api/v1/setup/config", Access::Paired, move |_| in_parts(&for_config)),
    ]
}

fn file(supervisor: &Supervisor) -> PathBuf {
    supervisor.keeping().folder().join(FILE)
}

/// Returns the draft; empty if there is none.
fn read(supervisor: &Supervisor) -> Result<Vec<u8>, Reply> {
    match safe_file::read_below(&supervisor.keeping().folder(), Path::new(FILE), MAX_DRAFT) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        read => read.map_err(|e| failed(&format!("{FILE} cannot be read"), &e)),
    }
}

fn put(supervisor: &Supervisor, call: &mut Call) -> Result<Reply, Reply> {
    let bytes = call.content(MAX_DRAFT)?;
    let draft: Value = serde_json::from_slice(&bytes).map_err(|e| Reply::text(400, format!("a draft is JSON: {e}\n")))?;
    if !draft.is_object() {
        return Err(Reply::text(422, "a draft is an object\n"));
    }
    let wanted = call.header("if-match").unwrap_or("*").to_owned();
    let _alone = supervisor.alone();
    if wanted != "*" && wanted != tag(&read(supervisor)?) {
        return Err(Reply::text(412, "another browser changed the set-up meanwhile; load it again\n"));
    }
    let unwritten = |e: io::Error| failed(&format!("{}: it cannot be written", file(supervisor).display()), &e);
    call.still_may()?;
    std::fs::create_dir_all(supervisor.keeping().folder()).map_err(unwritten)?;
    safe_file::write_lasting(&file(supervisor), &bytes).map_err(unwritten)?;
    Ok(Reply::done().with("etag", &tag(&bytes)))
}

/// Returns the config's values as JSON, and the same with each value as TOML's text: what the
/// set-up does not know, it writes as it was.
fn in_parts(supervisor: &Supervisor) -> Result<Reply, Reply> {
    let bytes = safe_file::read(&supervisor.keeping().current(), MAX_CONFIG)
        .map_err(|_| Reply::text(404, format!("{}: there is no config that can be read\n", supervisor.file().display())))?;
    let text = String::from_utf8_lossy(&bytes);
    let table: toml::Table = text.parse().map_err(|e: toml::de::Error| Reply::text(422, format!("{}\n", e.message())))?;
    let texts: Map<String, Value> = table.iter().map(|(key, value)| (key.clone(), texts(value))).collect();
    Ok(Reply::json(200, json!({"values": table, "texts": texts}).to_string()).with("etag", &tag(&bytes)))
}

/// Returns a value with its leaves as TOML's text; tables and lists of tables keep their form.
fn texts(value: &toml::Value) -> Value {
    match value {
        toml::Value::Table(table) => table.iter().map(|(key, value)| (key.clone(), texts(value))).collect::<Map<_, _>>().into(),
        toml::Value::Array(items) if !items.is_empty() && items.iter().all(toml::Value::is_table) => {
            items.iter().map(texts).collect::<Vec<_>>().into()
        }
        value => value.to_string().into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::web::api::tests::{respond, respond_with, supervised};

    #[test]
    fn a_draft_is_kept_for_every_browser_and_none_replaces_anothers_unseen() {
        let folder = tempfile::tempdir().unwrap();
        let routes = routes(&supervised(folder.path()));
        let path = "/api/v1/setup/draft";
        assert_eq!(respond(&routes, "GET", path, b""), (200, b"null".to_vec()));
        let (empty, first) = (tag(b""), br#"{"width":"4,0"}"#);
        let put = |tag: &str, content: &[u8]| respond_with(&routes, "PUT", path, &format!("If-Match: {tag}\r\n"), content).0;
        assert_eq!(put(&empty, first), 204);
        assert_eq!(respond(&routes, "GET", path, b""), (200, first.to_vec()));
        assert_eq!(put(&empty, b"{}"), 412, "it was changed meanwhile");
        assert_eq!(put(&tag(first), br#"{"width":"5"}"#), 204);
        for (bad, status) in [(&b"{"[..], 400), (b"[]", 422), (b"", 400)] {
            assert_eq!(put("*", bad), status, "{}", String::from_utf8_lossy(bad));
        }
        assert_eq!(respond(&routes, "PUT", path, &vec![b' '; 2 << 20]).0, 413);
        assert_eq!(respond(&routes, "GET", path, b"").1, br#"{"width":"5"}"#);
    }

    #[test]
    fn a_config_is_taken_apart_with_each_value_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let routes = routes(&supervised(folder.path()));
        let file = folder.path().join("stage.toml");
        std::fs::write(&file, "[camera]\nfov_deg = 60.0\n[[stage.surface]]\nsize_m = [4, 3.0]\nimage = 'a \"b\".png'\n[stage]\norigin = { top = [0, 0, 1.5] }\n").unwrap();
        let (status, said) = respond(&routes, "GET", "/api/v1/setup/config", b"");
        let said: Value = serde_json::from_slice(&said).unwrap();
        assert_eq!(
            (status, &said["values"]["camera"]["fov_deg"], &said["texts"]["camera"]["fov_deg"]),
            (200, &json!(60.0), &json!("60.0"))
        );
        let surface = &said["texts"]["stage"]["surface"][0];
        assert_eq!(
            (&surface["size_m"], &said["values"]["stage"]["surface"][0]["image"]),
            (&json!("[4, 3.0]"), &json!("a \"b\".png")),
            "{said}"
        );
        assert_eq!(said["texts"]["stage"]["origin"]["top"], json!("[0, 0, 1.5]"));
        std::fs::write(&file, "[camera\n").unwrap();
        assert_eq!(respond(&routes, "GET", "/api/v1/setup/config", b"").0, 422);
        std::fs::remove_file(&file).unwrap();
        assert_eq!(respond(&routes, "GET", "/api/v1/setup/config", b"").0, 404);
    }
}
