//! `GET /api/v1/backup`, `POST /api/v1/restore`: the config with all that it names, and the set, as one zip.

use std::collections::BTreeSet;
use std::io::{self, Cursor, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use axum::http::Method;
use serde_json::json;
use zip::write::SimpleFileOptions;
use zip::{ZipArchive, ZipWriter};

use super::config::{keep_former, reply, unwritable};
use super::failed;
use super::findings::judged;
use super::gltf;
use super::sets::{LARGEST_MODEL, is_model, models};
use crate::daemon::Supervisor;
use crate::safe_file;
use crate::web::call::{Call, is_name};
use crate::web::content::Download;
use crate::web::reply::Reply;
use crate::web::routes::{Access, Route};

/// Larger than a backup, bytes, packed and unpacked. Chosen: pictures of many surfaces. Raised, restoring takes more memory and disk.
const LARGEST_PACKED: u64 = 64 << 20;
const LARGEST_UNPACKED: u64 = 256 << 20;
/// Files in a backup at most: more than a stage has surfaces and models. Raised, a wrong zip takes longer to refuse.
const MOST_FILES: usize = 500;
/// The config's name in a backup.
const CONFIG: &str = "stage.toml";

pub(super) fn routes(supervisor: &Arc<Supervisor>) -> Vec<Route> {
    let (for_backup, for_restore) = (supervisor.clone(), supervisor.clone());
    vec![
        Route::aside(Method::GET, "/api/v1/backup", Access::Paired, move |_| backup(&for_backup)),
        Route::aside(Method::POST, "/api/v1/restore", Access::Change, move |call| restore(&for_restore, call)).seldom_unless("try=1"),
    ]
}

fn backup(supervisor: &Supervisor) -> Result<Reply, Reply> {
    let settings = supervisor.settings().ok_or_else(|| Reply::text(409, "there is no config yet to keep\n"))?;
    let files = settings.source.copy(None).map_err(|e| failed("the config cannot be copied", &e))?;
    let folder = supervisor.keeping().folder();
    let make = move |to: &mut dyn Write| {
        let mut zip = ZipWriter::new_stream(to);
        let options = SimpleFileOptions::default();
        for (name, bytes) in &files {
            zip.start_file(name, options).map_err(io::Error::other)?;
            zip.write_all(bytes)?;
        }
        let set = safe_file::read(&folder.join("set.json"), LARGEST_MODEL).ok().map(|bytes| ("set.json".to_owned(), bytes));
        let of_sets = models(&folder).into_iter().filter_map(|(name, _)| {
            let bytes = safe_file::read(&folder.join("sets").join(&name), LARGEST_MODEL).ok()?;
            Some((format!("sets/{name}"), bytes))
        });
        for (name, bytes) in set.into_iter().chain(of_sets) {
            zip.start_file(&name, options).map_err(io::Error::other)?;
            zip.write_all(&bytes)?;
        }
        zip.finish().map_err(io::Error::other)?.flush()
    };
    let mut reply = Reply::new(200, "application/zip", Vec::new());
    reply.download = Some(Download::start(make).map_err(|e| failed("the backup cannot begin", &e))?);
    Ok(reply.with("content-disposition", "attachment; filename=\"stagepose-backup.zip\""))
}

/// A folder that goes again.
struct Aside(PathBuf);

impl Drop for Aside {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn restore(supervisor: &Supervisor, call: &mut Call) -> Result<Reply, Reply> {
    let only_tries = call.queried("try", 0, 0..=1)? == 1;
    let packed = call.content(LARGEST_PACKED)?;
    let _alone = supervisor.alone();
    let file = supervisor.file();
    let folder = file.parent().unwrap_or(Path::new("")).to_owned();
    // Where nobody sees it, and in the same file system as its place.
    let aside = Aside(folder.join(format!(".restore-{}", std::process::id())));
    let _ = std::fs::remove_dir_all(&aside.0);
    std::fs::create_dir_all(aside.0.join("sets")).map_err(|e| unwritable(file, &e))?;
    let names = unpack(&packed, &aside.0)?;
    let text = safe_file::read(&aside.0.join(CONFIG), LARGEST_PACKED).ok().and_then(|bytes| String::from_utf8(bytes).ok());
    let text = text.ok_or_else(|| Reply::text(422, "the zip has no stage.toml, so it is no backup; give one of GET /api/v1/backup\n"))?;
    let (settings, findings) = judged(&text, &aside.0.join(CONFIG));
    if settings.is_none() {
        return Ok(reply(422, &findings, false));
    }
    let target = |name: &str| if name == CONFIG { file.to_owned() } else { folder.join(name) };
    if only_tries {
        let (replaces, adds): (Vec<&String>, Vec<&String>) = names.iter().partition(|name| target(name).exists());
        return Ok(Reply::json(200, json!({"findings": findings, "saved": false, "replaces": replaces, "adds": adds}).to_string()));
    }
    let places: Vec<PathBuf> = std::iter::once(file.to_owned()).chain(names.iter().filter(|n| *n != CONFIG).map(|n| target(n))).collect();
    keep_former(&places).map_err(|e| unwritable(file, &e))?;
    std::fs::create_dir_all(folder.join("sets")).map_err(|e| unwritable(file, &e))?;
    // The config last: it names the others.
    for name in names.iter().filter(|name| *name != CONFIG).chain([&CONFIG.to_owned()]) {
        std::fs::rename(aside.0.join(name), target(name)).map_err(|e| unwritable(&target(name), &e))?;
    }
    supervisor.reload();
    Ok(reply(200, &findings, true))
}

/// Puts a zip's files into a folder; nothing outside of it, and nothing endless.
fn unpack(packed: &[u8], folder: &Path) -> Result<BTreeSet<String>, Reply> {
    let bad = |why: &str| Reply::text(422, format!("{why}; give a zip of GET /api/v1/backup\n"));
    let mut zip = ZipArchive::new(Cursor::new(packed)).map_err(|_| bad("this is no whole zip"))?;
    if zip.len() > MOST_FILES {
        return Err(bad("the zip has too many files"));
    }
    let (mut left, mut names) = (LARGEST_UNPACKED, BTreeSet::new());
    for k in 0..zip.len() {
        let mut entry = zip.by_index(k).map_err(|_| bad("a file in the zip cannot be read"))?;
        let name = entry.name().to_owned();
        if entry.is_dir() && name == "sets/" {
            continue;
        }
        let of_set = name.strip_prefix("sets/").is_some_and(is_model);
        if !entry.is_file() || !(is_name(&name) || of_set) {
            return Err(bad("a name in the zip is none that a backup has"));
        }
        let mut bytes = Vec::new();
        // By what comes out: what a zip says of its sizes need not be true.
        (&mut entry).take(left + 1).read_to_end(&mut bytes).map_err(|_| bad("a file in the zip is damaged"))?;
        left = left.checked_sub(bytes.len() as u64).ok_or_else(|| bad("the zip unpacks to more than 256 MB"))?;
        let path = folder.join(&name);
        std::fs::write(&path, &bytes).map_err(|e| failed("the zip cannot be unpacked beside the config", &e))?;
        if of_set {
            gltf::judge(&path).map_err(|reason| Reply::text(422, format!("{name}: {reason}\n")))?;
        }
        if !names.insert(name) {
            return Err(bad("a name is twice in the zip"));
        }
    }
    Ok(names)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::web::api::gltf::tests::glb;
    use crate::web::api::tests::{asked, supervised};

    fn zipped(files: &[(&str, &[u8])]) -> Vec<u8> {
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        for (name, bytes) in files {
            zip.start_file(*name, SimpleFileOptions::default()).unwrap();
            zip.write_all(bytes).unwrap();
        }
        zip.finish().unwrap().into_inner()
    }

    #[test]
    fn what_was_kept_comes_back_and_the_former_is_kept() {
        let (one, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let from = supervised(one.path());
        std::fs::write(one.path().join("set.json"), "{\"objects\":[1]}").unwrap();
        std::fs::create_dir(one.path().join("sets")).unwrap();
        let model = glb(r#"{"asset":{"version":"2.0"}}"#);
        std::fs::write(one.path().join("sets/door.glb"), &model).unwrap();
        let (status, zip) = asked(&routes(&from), "GET", "/api/v1/backup", b"");
        assert_eq!(status, 200);
        let to = supervised(other.path());
        std::fs::write(to.file(), "# it was another one\n").unwrap();
        let (status, said) = asked(&routes(&to), "POST", "/api/v1/restore?try=1", &zip);
        assert_eq!((status, to.take_reload()), (200, false), "{}", String::from_utf8_lossy(&said));
        let told: serde_json::Value = serde_json::from_slice(&said).unwrap();
        assert_eq!((&told["replaces"], &told["saved"]), (&json!(["stage.toml"]), &json!(false)), "{told}");
        assert!(told["adds"].as_array().unwrap().contains(&json!("sets/door.glb")), "{told}");
        assert_eq!(std::fs::read_to_string(to.file()).unwrap(), "# it was another one\n", "it was only tried");
        let (status, said) = asked(&routes(&to), "POST", "/api/v1/restore", &zip);
        assert_eq!(status, 200, "{}", String::from_utf8_lossy(&said));
        assert!(to.take_reload());
        assert!(crate::config::Settings::load(to.file()).is_ok());
        assert_eq!(std::fs::read(other.path().join("sets/door.glb")).unwrap(), model);
        assert_eq!(std::fs::read(other.path().join("set.json")).unwrap(), b"{\"objects\":[1]}");
        let former = std::fs::read_dir(other.path().join("former")).unwrap().next().unwrap().unwrap().path();
        assert_eq!(std::fs::read_to_string(former.join("stage.toml")).unwrap(), "# it was another one\n");
        assert!(!std::fs::read_dir(other.path()).unwrap().any(|e| e.unwrap().file_name().to_string_lossy().starts_with(".restore")));
    }

    #[test]
    fn a_zip_that_leads_out_or_cannot_be_used_changes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let supervisor = supervised(folder.path());
        let before = std::fs::read(supervisor.file()).unwrap();
        let bombs = vec![0; 1 << 20];
        let many: Vec<(String, &[u8])> = (0..MOST_FILES + 1).map(|k| (format!("a{k}"), &b""[..])).collect();
        let many: Vec<(&str, &[u8])> = many.iter().map(|(name, bytes)| (name.as_str(), *bytes)).collect();
        for (what, zip) in [
            ("not a zip", b"PK".to_vec()),
            ("up", zipped(&[("../evil", b"x"), ("stage.toml", &before)])),
            ("rooted", zipped(&[("/tmp/evil", b"x")])),
            ("below", zipped(&[("a/b.png", b"x")])),
            ("back", zipped(&[("..\\evil", b"x")])),
            ("hidden", zipped(&[(".bashrc", b"x")])),
            ("no config", zipped(&[("a.png", &bombs)])),
            ("bad config", zipped(&[("stage.toml", b"[camera")])),
            ("bad model", zipped(&[("sets/a.glb", b"x")])),
            ("many", zipped(&many)),
        ] {
            let (status, said) = asked(&routes(&supervisor), "POST", "/api/v1/restore", &zip);
            assert_eq!(status, 422, "{what}: {}", String::from_utf8_lossy(&said));
        }
        assert_eq!((std::fs::read(supervisor.file()).unwrap(), supervisor.take_reload()), (before, false));
        assert!(!folder.path().join("../evil").exists());
    }
}
