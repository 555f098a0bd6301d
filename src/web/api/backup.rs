//! `GET /api/v1/backup`, `POST /api/v1/restore`: the config with all files it names, and the
//! virtual set, as one zip.

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
use super::findings::judged_to_run;
use super::gltf;
use super::sets::{MAX_MODEL, is_model, models};
use crate::daemon::Supervisor;
use crate::safe_file;
use crate::web::call::{Call, is_name};
use crate::web::download::Download;
use crate::web::reply::Reply;
use crate::web::routes::{Access, Route};

/// Maximum size of a backup's zip, bytes. Chosen: room for the pictures of many surfaces. Raised,
/// restoring takes more memory and disk.
const MAX_PACKED: u64 = 64 << 20;
/// Maximum size of its unpacked files, bytes. Raised, restoring takes more disk.
const MAX_UNPACKED: u64 = 256 << 20;
/// Maximum number of files in a backup: more than a stage has surfaces and models. Raised, an
/// invalid zip takes longer to refuse.
const MAX_FILES: usize = 500;
/// The config's name in a backup.
const CONFIG: &str = "stage.toml";
/// The virtual set's name in a backup.
const SET: &str = "set.json";

pub(super) fn routes(supervisor: &Arc<Supervisor>) -> Vec<Route> {
    let (for_backup, for_restore) = (supervisor.clone(), supervisor.clone());
    vec![
        Route::slow(Method::GET, "/api/v1/backup", Access::Paired, move |_| backup(&for_backup)),
        Route::slow(Method::POST, "/api/v1/restore", Access::Change, move |call| restore(&for_restore, call))
            .takes_a_file()
            .seldom_unless("try=1"),
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
        let set = safe_file::read_below(&folder, Path::new(SET), MAX_MODEL).ok().map(|bytes| (SET.to_owned(), bytes));
        let of_sets = models(&folder).into_iter().filter_map(|(name, _)| {
            let bytes = safe_file::read_below(&folder, &Path::new("sets").join(&name), MAX_MODEL).ok()?;
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

/// A folder that is removed when this is dropped.
struct Staging(PathBuf);

impl Drop for Staging {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn restore(supervisor: &Supervisor, call: &mut Call) -> Result<Reply, Reply> {
    let only_tries = call.queried("try", 0, 0..=1)? == 1;
    let packed = call.content(MAX_PACKED)?;
    let _alone = supervisor.alone();
    let file = supervisor.file();
    let folder = file.parent().unwrap_or(Path::new("")).to_owned();
    // A hidden folder in the same file system as the target.
    let staging = Staging(folder.join(format!(".restore-{}", std::process::id())));
    let _ = std::fs::remove_dir_all(&staging.0);
    std::fs::create_dir_all(staging.0.join("sets")).map_err(|e| unwritable(file, &e))?;
    let names = unpack(&packed, &staging.0)?;
    let text = safe_file::read(&staging.0.join(CONFIG), MAX_PACKED).ok().and_then(|bytes| String::from_utf8(bytes).ok());
    let text =
        text.ok_or_else(|| Reply::text(422, "the zip has no stage.toml, so it is not a backup; give one of GET /api/v1/backup\n"))?;
    let (settings, findings) = judged_to_run(&text, &staging.0.join(CONFIG), supervisor);
    let Some(settings) = settings else { return Ok(reply(422, &findings, false)) };
    let is_named =
        |name: &str| name == CONFIG || name == SET || name.starts_with("sets/") || settings.files.contains(&staging.0.join(name));
    if let Some(name) = names.iter().find(|name| !is_named(name)) {
        let sentence = format!("{name}: the config in the zip does not name this file; give a zip of GET /api/v1/backup\n");
        return Err(Reply::text(422, sentence));
    }
    let target = |name: &str| if name == CONFIG { file.to_owned() } else { folder.join(name) };
    if only_tries {
        let (replaces, adds): (Vec<&String>, Vec<&String>) = names.iter().partition(|name| target(name).exists());
        return Ok(Reply::json(200, json!({"findings": findings, "saved": false, "replaces": replaces, "adds": adds}).to_string()));
    }
    let places: Vec<PathBuf> = std::iter::once(file.to_owned()).chain(names.iter().filter(|n| *n != CONFIG).map(|n| target(n))).collect();
    keep_former(&places).map_err(|e| unwritable(file, &e))?;
    std::fs::create_dir_all(folder.join("sets")).map_err(|e| unwritable(file, &e))?;
    call.still_may()?;
    // The config comes last, because it names the others.
    let in_order = names.iter().map(String::as_str).filter(|name| *name != CONFIG).chain([CONFIG]);
    let moves: Vec<(PathBuf, PathBuf)> = in_order.map(|name| (staging.0.join(name), target(name))).collect();
    move_all(&moves, &staging.0.join("before")).map_err(|(to, e)| unwritable(&to, &e))?;
    supervisor.reload();
    Ok(reply(200, &findings, true))
}

/// Moves all files to their places, or none. What was in a place is kept in `before` until all are
/// moved.
fn move_all(moves: &[(PathBuf, PathBuf)], before: &Path) -> Result<(), (PathBuf, io::Error)> {
    std::fs::create_dir(before).map_err(|e| (before.to_owned(), e))?;
    let mut done: Vec<(&Path, Option<PathBuf>)> = Vec::new();
    for (k, (from, to)) in moves.iter().enumerate() {
        let kept = before.join(k.to_string());
        // A hard link keeps the old file without leaving its place empty.
        let is_kept = match std::fs::hard_link(to, &kept) {
            Ok(()) => Ok(Some(kept)),
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
            // The file system has no hard links.
            Err(_) => std::fs::copy(to, &kept).map(|_| Some(kept)),
        };
        match is_kept.and_then(|kept| std::fs::rename(from, to).map(|()| kept)) {
            Ok(kept) => done.push((to, kept)),
            Err(error) => {
                undo(done);
                return Err((to.clone(), error));
            }
        }
    }
    Ok(())
}

/// Restores what was in these places.
fn undo(done: Vec<(&Path, Option<PathBuf>)>) {
    for (to, kept) in done.into_iter().rev() {
        let undone = kept.map_or_else(|| std::fs::remove_file(to), |kept| std::fs::rename(kept, to));
        if let Err(error) = undone {
            tracing::error!(
                "{}: the files from before a restore cannot be put back ({error}); they are in the folder former",
                to.display()
            );
        }
    }
}

/// Unpacks a zip into a folder. It writes nothing outside the folder and limits the total size.
fn unpack(packed: &[u8], folder: &Path) -> Result<BTreeSet<String>, Reply> {
    let bad = |why: &str| Reply::text(422, format!("{why}; give a zip of GET /api/v1/backup\n"));
    let mut zip = ZipArchive::new(Cursor::new(packed)).map_err(|_| bad("this is not a complete zip"))?;
    if zip.len() > MAX_FILES {
        return Err(bad("the zip has too many files"));
    }
    let (mut left, mut names) = (MAX_UNPACKED, BTreeSet::new());
    for k in 0..zip.len() {
        let mut entry = zip.by_index(k).map_err(|_| bad("a file in the zip cannot be read"))?;
        let name = entry.name().to_owned();
        if entry.is_dir() && name == "sets/" {
            continue;
        }
        let of_set = name.strip_prefix("sets/").is_some_and(is_model);
        if !entry.is_file() || !(is_name(&name) || of_set) {
            return Err(bad("the zip holds a name that no backup has"));
        }
        let mut bytes = Vec::new();
        // Limit the bytes that are unpacked: the sizes stated in a zip may be wrong.
        (&mut entry).take(left + 1).read_to_end(&mut bytes).map_err(|_| bad("a file in the zip is damaged"))?;
        left = left.checked_sub(bytes.len() as u64).ok_or_else(|| bad("the zip unpacks to more than 256 MB"))?;
        let path = folder.join(&name);
        std::fs::write(&path, &bytes).map_err(|e| failed("the zip cannot be unpacked beside the config", &e))?;
        if of_set {
            gltf::judge(&path).map_err(|reason| Reply::text(422, format!("{name}: {reason}\n")))?;
        }
        if !names.insert(name) {
            return Err(bad("a name occurs twice in the zip"));
        }
    }
    Ok(names)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::web::api::gltf::tests::glb;
    use crate::web::api::tests::{respond, supervised};

    fn zipped(files: &[(&str, &[u8])]) -> Vec<u8> {
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        for (name, bytes) in files {
            zip.start_file(*name, SimpleFileOptions::default()).unwrap();
            zip.write_all(bytes).unwrap();
        }
        zip.finish().unwrap().into_inner()
    }

    #[test]
    fn a_restore_brings_back_the_backup_and_keeps_the_former() {
        let (one, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let from = supervised(one.path());
        std::fs::write(one.path().join("set.json"), "{\"objects\":[1]}").unwrap();
        std::fs::create_dir(one.path().join("sets")).unwrap();
        let model = glb(r#"{"asset":{"version":"2.0"}}"#);
        std::fs::write(one.path().join("sets/door.glb"), &model).unwrap();
        let (status, zip) = respond(&routes(&from), "GET", "/api/v1/backup", b"");
        assert_eq!(status, 200);
        let to = supervised(other.path());
        std::fs::write(to.file(), "# it was another one\n").unwrap();
        let (status, said) = respond(&routes(&to), "POST", "/api/v1/restore?try=1", &zip);
        assert_eq!((status, to.take_reload()), (200, false), "{}", String::from_utf8_lossy(&said));
        let findings: serde_json::Value = serde_json::from_slice(&said).unwrap();
        assert_eq!((&findings["replaces"], &findings["saved"]), (&json!(["stage.toml"]), &json!(false)), "{findings}");
        assert!(findings["adds"].as_array().unwrap().contains(&json!("sets/door.glb")), "{findings}");
        assert_eq!(std::fs::read_to_string(to.file()).unwrap(), "# it was another one\n", "it was only tried");
        let (status, said) = respond(&routes(&to), "POST", "/api/v1/restore", &zip);
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
    fn an_unsafe_or_unusable_zip_changes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let supervisor = supervised(folder.path());
        let before = std::fs::read(supervisor.file()).unwrap();
        let picture = std::fs::read(folder.path().join("backdrop.png")).unwrap();
        std::fs::write(folder.path().join("show.toml"), "kept").unwrap();
        let bombs = vec![0; 1 << 20];
        let many: Vec<(String, &[u8])> = (0..MAX_FILES + 1).map(|k| (format!("a{k}"), &b""[..])).collect();
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
            ("not named", zipped(&[("backdrop.png", &picture), ("notes.txt", b"x"), ("stage.toml", &before)])),
            ("another's", zipped(&[("backdrop.png", &picture), ("show.toml", b"x"), ("stage.toml", &before)])),
            ("bad model", zipped(&[("sets/a.glb", b"x")])),
            ("many", zipped(&many)),
        ] {
            let (status, said) = respond(&routes(&supervisor), "POST", "/api/v1/restore", &zip);
            assert_eq!(status, 422, "{what}: {}", String::from_utf8_lossy(&said));
        }
        assert_eq!((std::fs::read(supervisor.file()).unwrap(), supervisor.take_reload()), (before, false));
        assert!(!folder.path().join("../evil").exists());
        assert_eq!(std::fs::read_to_string(folder.path().join("show.toml")).unwrap(), "kept");
    }

    #[test]
    fn a_restore_that_fails_half_way_leaves_everything_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let supervisor = supervised(folder.path());
        let (at, model) = (|name: &str| folder.path().join(name), glb(r#"{"asset":{"version":"2.0"}}"#));
        let (config, picture) = (std::fs::read(supervisor.file()).unwrap(), std::fs::read(at("backdrop.png")).unwrap());
        let other = image::GrayImage::from_fn(160, 120, |x, y| image::Luma([((x * 91 + y * 37) % 251) as u8]));
        other.save(at("other.png")).unwrap();
        let other = std::fs::read(at("other.png")).unwrap();
        std::fs::remove_file(at("other.png")).unwrap();
        // The last file but one cannot be replaced, because a folder is in its place.
        std::fs::create_dir_all(at("sets/door.glb")).unwrap();
        let new = [&config[..], b"# new\n"].concat();
        let zip = zipped(&[
            ("backdrop.png", &other),
            ("set.json", b"{}"),
            ("sets/a.glb", &model),
            ("sets/door.glb", &model),
            ("stage.toml", &new),
        ]);
        let (status, said) = respond(&routes(&supervisor), "POST", "/api/v1/restore", &zip);
        let said = String::from_utf8_lossy(&said).into_owned();
        assert!(status == 500 && said.contains("door.glb"), "{status}: {said}");
        assert_eq!((std::fs::read(supervisor.file()).unwrap(), std::fs::read(at("backdrop.png")).unwrap()), (config, picture));
        assert!(!at("set.json").exists() && !at("sets/a.glb").exists() && !supervisor.take_reload());
        // Without that obstacle all files are moved.
        std::fs::remove_dir(at("sets/door.glb")).unwrap();
        assert_eq!(respond(&routes(&supervisor), "POST", "/api/v1/restore", &zip).0, 200);
        assert_eq!((std::fs::read(supervisor.file()).unwrap(), std::fs::read(at("backdrop.png")).unwrap()), (new, other));
        assert!(at("set.json").exists() && at("sets/a.glb").exists() && supervisor.take_reload());
    }
}
