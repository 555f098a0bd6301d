//! `GET`, `PUT /api/v1/set` and `sets/NAME.glb`: the virtual set, as the page composes it, and its
//! models. They are kept next to the config.

use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use axum::http::Method;
use serde_json::{Value, json};

use super::config::tag;
use super::failed;
use super::gltf;
use crate::daemon::Supervisor;
use crate::safe_file;
use crate::web::call::Call;
use crate::web::content::{not_arrived, too_large};
use crate::web::reply::Reply;
use crate::web::routes::{Access, Route};

/// Maximum size of a set's description, bytes: thousands of objects. A round figure.
const MAX_SET: u64 = 1 << 20;
/// Maximum size of a model, bytes: more than a browser can draw at a camera's frame rate.
pub(super) const MAX_MODEL: u64 = 64 << 20;
/// Maximum number of models. Raised, they may take more of the disk: each has up to [`MAX_MODEL`].
const MAX_MODELS: usize = 64;
/// A set before anything is placed in it.
const EMPTY: &str = r#"{"objects":[]}"#;

pub(super) fn routes(supervisor: &Arc<Supervisor>) -> Vec<Route> {
    let for_put = supervisor.clone();
    let route = |method, path, access, answer: fn(&Path, &mut Call) -> Result<Reply, Reply>| {
        let supervisor = supervisor.clone();
        Route::slow(method, path, access, move |call| answer(&folder(&supervisor), call))
    };
    vec![
        route(Method::GET, "/api/v1/set", Access::Anyone, |folder, _| {
            let text = read_set(folder)?;
            let tag = tag(&text);
            Ok(Reply::new(200, "application/json", text).with("etag", &tag))
        }),
        Route::slow(Method::PUT, "/api/v1/set", Access::Change, move |call| put_set(&for_put, call)).takes(MAX_SET),
        route(Method::GET, "/api/v1/sets", Access::Anyone, |folder, _| {
            let models: Vec<Value> = models(folder).into_iter().map(|(name, bytes)| json!({"name": name, "bytes": bytes})).collect();
            Ok(Reply::json(200, json!({"sets": models}).to_string()))
        }),
        route(Method::GET, "/api/v1/sets/{name}", Access::Anyone, |folder, call| {
            model(folder, call)?;
            let name = Path::new("sets").join(call.name("name")?);
            let bytes = safe_file::read_below(folder, &name, MAX_MODEL).map_err(|_| none())?;
            Ok(Reply::new(200, "model/gltf-binary", bytes))
        }),
        route(Method::PUT, "/api/v1/sets/{name}", Access::Change, put_model).takes_a_file(),
        route(Method::DELETE, "/api/v1/sets/{name}", Access::Change, |folder, call| {
            std::fs::remove_file(model(folder, call)?).map_err(|_| none()).map(|()| Reply::done())
        }),
    ]
}

fn none() -> Reply {
    Reply::text(404, "there is no such model; GET /api/v1/sets lists them\n")
}

/// Returns the folder of the set and its models: next to the config, or where the daemon may write.
fn folder(supervisor: &Supervisor) -> PathBuf {
    supervisor.keeping().folder()
}

fn read_set(folder: &Path) -> Result<Vec<u8>, Reply> {
    match safe_file::read_below(folder, Path::new("set.json"), MAX_SET) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(EMPTY.into()),
        read => read.map_err(|e| failed("set.json cannot be read", &e)),
    }
}

fn put_set(supervisor: &Supervisor, call: &mut Call) -> Result<Reply, Reply> {
    let folder = &folder(supervisor);
    let bytes = call.content(MAX_SET)?;
    let set: Value = serde_json::from_slice(&bytes).map_err(|e| Reply::text(400, format!("a set is JSON: {e}\n")))?;
    if !set["objects"].is_array() {
        return Err(Reply::text(422, "a set is an object with the list \"objects\"\n"));
    }
    let _alone = supervisor.alone();
    if let Some(wanted) = call.header("if-match")
        && wanted != "*"
        && wanted != tag(&read_set(folder)?)
    {
        return Err(Reply::text(412, "the set was changed meanwhile; load it again\n"));
    }
    let unwritten = |e: io::Error| failed(&format!("{}: set.json cannot be written", folder.display()), &e);
    call.still_may()?;
    std::fs::create_dir_all(folder).map_err(unwritten)?;
    safe_file::write_lasting(&folder.join("set.json"), &bytes).map_err(unwritten)?;
    Ok(Reply::done().with("etag", &tag(&bytes)))
}

/// Returns names and sizes in bytes of the existing models.
pub(super) fn models(folder: &Path) -> Vec<(String, u64)> {
    let entries = std::fs::read_dir(folder.join("sets")).into_iter().flatten().flatten();
    let mut models: Vec<(String, u64)> = entries
        .filter_map(|entry| {
            let name = entry.file_name().into_string().ok().filter(|name| is_model(name))?;
            Some((name, entry.metadata().ok().filter(std::fs::Metadata::is_file)?.len()))
        })
        .collect();
    models.sort();
    models
}

/// Whether it is a valid name of a model.
pub(super) fn is_model(name: &str) -> bool {
    let is_plain = |b: u8| b.is_ascii_alphanumeric() || b"_-".contains(&b);
    name.strip_suffix(".glb").is_some_and(|stem| (1..=64).contains(&stem.len()) && stem.bytes().all(is_plain))
}

fn model(folder: &Path, call: &Call) -> Result<PathBuf, Reply> {
    let name = call.name("name")?;
    if !is_model(name) {
        return Err(Reply::text(400, "a model is called NAME.glb, of letters, digits, dashes and underscores\n"));
    }
    Ok(folder.join("sets").join(name))
}

fn put_model(folder: &Path, call: &mut Call) -> Result<Reply, Reply> {
    let target = model(folder, call)?;
    if !target.exists() && models(folder).len() >= MAX_MODELS {
        return Err(Reply::text(409, format!("there are {MAX_MODELS} models already; delete one\n")));
    }
    let unwritten = |e: io::Error| failed(&format!("{}: the model cannot be written", target.display()), &e);
    std::fs::create_dir_all(folder.join("sets")).map_err(unwritten)?;
    // Written to the disk as it arrives; it gets its name only after it was checked.
    let mut beside = tempfile(&target).map_err(unwritten)?;
    let mut buffer = [0; 32 * 1024];
    let mut bytes = 0;
    loop {
        let n = call.content.read(&mut buffer).map_err(|e| not_arrived(&e))?;
        if n == 0 {
            break;
        }
        bytes += n as u64;
        if bytes > MAX_MODEL {
            return Err(too_large(MAX_MODEL));
        }
        beside.file.write_all(&buffer[..n]).map_err(unwritten)?;
    }
    beside.file.sync_all().map_err(unwritten)?;
    gltf::judge(&beside.path).map_err(|reason| Reply::text(422, format!("{reason}\n")))?;
    call.still_may()?;
    std::fs::rename(&beside.path, &target).map_err(unwritten)?;
    Ok(Reply::done())
}

/// A file that is removed when dropped, unless it got its final name.
struct Unfinished {
    path: PathBuf,
    file: std::fs::File,
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        // If it already has its final name, there is nothing to remove.
        let _ = std::fs::remove_file(&self.path);
    }
}

fn tempfile(target: &Path) -> io::Result<Unfinished> {
    let name = target.file_name().unwrap_or_default().to_string_lossy();
    let free = (0..).map(|n: u32| target.with_file_name(format!(".{name}.{n}"))).find(|path| !path.exists());
    let path = free.ok_or(io::ErrorKind::AlreadyExists)?;
    let file = std::fs::OpenOptions::new().write(true).create_new(true).open(&path)?;
    Ok(Unfinished { path, file })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::web::api::gltf::tests::glb;
    use crate::web::api::tests::{respond, respond_with, supervised};

    #[test]
    fn a_set_is_kept_beside_the_config() {
        let folder = tempfile::tempdir().unwrap();
        let routes = routes(&supervised(folder.path()));
        assert_eq!(respond(&routes, "GET", "/api/v1/set", b"").1, EMPTY.as_bytes());
        let set = br#"{"objects":[{"kind":"cone"}],"more":1}"#;
        assert_eq!(respond(&routes, "PUT", "/api/v1/set", set).0, 204);
        assert_eq!(respond(&routes, "GET", "/api/v1/set", b"").1, set);
        assert_eq!(respond_with(&routes, "PUT", "/api/v1/set", "If-Match: \"0\"\r\n", set).0, 412);
        for (bad, status) in [(&b"{"[..], 400), (b"[]", 422), (b"{}", 422), (b"\"objects\"", 422), (b"", 400)] {
            assert_eq!(respond(&routes, "PUT", "/api/v1/set", bad).0, status, "{}", String::from_utf8_lossy(bad));
        }
        assert_eq!(respond(&routes, "PUT", "/api/v1/set", &vec![b' '; 2 << 20]).0, 413);
        assert_eq!(respond(&routes, "GET", "/api/v1/set", b"").1, set);
    }

    #[test]
    fn a_model_is_judged_before_it_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let routes = routes(&supervised(folder.path()));
        let put = |path: &str, content: &[u8]| respond(&routes, "PUT", &format!("/api/v1/sets/{path}"), content).0;
        let good = glb(r#"{"asset":{"version":"2.0"}}"#);
        assert_eq!(put("door.glb", &good), 204);
        assert_eq!(respond(&routes, "GET", "/api/v1/sets/door.glb", b""), (200, good.clone()));
        for name in ["door.gltf", "a.b.glb", ".glb", "..%2fdoor.glb", "%2e%2e", "door.glb%00", &format!("{}.glb", "a".repeat(65))] {
            assert_eq!(put(name, &good), 400, "{name}");
        }
        assert_eq!(put("door.glb", b"no model"), 422);
        assert_eq!(put("linked.glb", &glb(r#"{"asset":{"version":"2.0"},"images":[{"uri":"http://evil.example/x.png"}]}"#)), 422);
        assert_eq!(respond(&routes, "GET", "/api/v1/sets/door.glb", b"").1, good, "the good one stays");
        let left: Vec<_> = std::fs::read_dir(folder.path().join("sets")).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert_eq!(left, ["door.glb"], "nothing half is left");
        assert_eq!(respond(&routes, "DELETE", "/api/v1/sets/door.glb", b"").0, 204);
        assert_eq!(respond(&routes, "DELETE", "/api/v1/sets/door.glb", b"").0, 404);
        assert_eq!(respond(&routes, "GET", "/api/v1/sets", b"").1, br#"{"sets":[]}"#);
    }
}
