//! `GET /api/v1/recordings` and the paths below it: the list of recordings, their states over time,
//! their pictures and records, and a whole recording as a zip.

use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Component, Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, UNIX_EPOCH};

use axum::http::Method;
use serde_json::{Value, json};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use super::failed;
use super::line_index::LineIndex;
use super::timeline::timeline;
use crate::capture::timestamps::StampRow;
use crate::capture::{DecodeError, decode_grey, with_huffman_tables};
use crate::config::Settings;
use crate::daemon::Supervisor;
use crate::daemon::report::{Report, config_text, find};
use crate::safe_file;
use crate::web::call::{Call, is_name};
use crate::web::download::Download;
use crate::web::reply::Reply;
use crate::web::routes::{Access, Route};

/// Maximum size of a picture, bytes: larger than any camera's.
const MAX_PICTURE: u64 = 64 << 20;
/// Maximum number of records in one answer: some 3 MB. Raised, an answer takes more memory.
const MAX_RECORDS: u64 = 5000;
/// Maximum number of columns of a timeline: more than a screen has pixels. Raised, larger answers.
pub(super) const MAX_POINTS: u64 = 4000;
/// Maximum number of concurrent downloads by all clients: each keeps the disk busy. Raised, less
/// disk bandwidth is left for the recorder.
const MAX_DOWNLOADS: usize = 2;
/// Maximum seconds of pictures in a report, the same as for the command. Raised, reports become too
/// large for mail.
const MAX_PICTURE_SECONDS: u64 = 600;
/// Maximum depth of folders within a recording's folder: frames/0000/picture. Deeper files are not
/// part of a recording.
const DEEPEST: usize = 4;

pub(super) fn routes(supervisor: &Arc<Supervisor>, lines: &Arc<LineIndex>) -> Vec<Route> {
    let read = |path, access, answer: fn(&Folder, &mut Call) -> Result<Reply, Reply>| {
        let folder = Folder::new(supervisor, lines);
        Route::slow(Method::GET, path, access, move |call| answer(&folder, call))
    };
    let downloads: Arc<AtomicUsize> = Arc::default();
    let for_report = supervisor.clone();
    let (folder, of_report) = (Folder::new(supervisor, lines), Folder::new(supervisor, lines));
    vec![
        read("/api/v1/recordings", Access::Anyone, Folder::list),
        read("/api/v1/recordings/{id}/timeline", Access::Anyone, Folder::timeline),
        read("/api/v1/recordings/{id}/frame/{row}", Access::Anyone, Folder::frame),
        read("/api/v1/recordings/{id}/poses", Access::Anyone, Folder::poses),
        Route::slow(Method::GET, "/api/v1/recordings/{id}/download", Access::Paired, move |call| download(&folder.clip(call)?, &downloads)),
        Route::slow(Method::GET, "/api/v1/recordings/{id}/report", Access::Paired, move |call| {
            report(&for_report, &of_report.clip(call)?, call)
        }),
    ]
}

/// The recorder's folder.
pub(super) struct Folder {
    supervisor: Arc<Supervisor>,
    lines: Arc<LineIndex>,
}

/// An existing recording.
pub(super) struct Clip {
    pub id: String,
    pub path: PathBuf,
}

impl Folder {
    pub fn new(supervisor: &Arc<Supervisor>, lines: &Arc<LineIndex>) -> Self {
        Self { supervisor: supervisor.clone(), lines: lines.clone() }
    }

    fn path(&self) -> Result<PathBuf, Reply> {
        let settings =
            self.supervisor.settings().ok_or_else(|| Reply::text(409, "there is no config yet, so there is no folder of recordings\n"))?;
        Ok(settings.recorder.folder.clone())
    }

    /// Returns the recording that the path names.
    pub fn clip(&self, call: &Call) -> Result<Clip, Reply> {
        let id = call.name("id")?.to_owned();
        let path = self.path()?.join(&id);
        // A symbolic link would lead out of the folder.
        let is_folder = path.symlink_metadata().is_ok_and(|about| about.is_dir());
        if !is_folder || !path.join("timestamps.csv").is_file() {
            return Err(Reply::text(404, "there is no such recording; GET /api/v1/recordings lists them\n"));
        }
        Ok(Clip { id, path })
    }

    fn list(&self, _: &mut Call) -> Result<Reply, Reply> {
        let folder = self.path()?;
        let current = self.supervisor.recording();
        let entries = std::fs::read_dir(&folder).into_iter().flatten().flatten();
        let names = entries.filter_map(|entry| entry.file_name().into_string().ok()).filter(|name| is_name(name));
        let mut clips: Vec<(i64, Value)> = names.filter_map(|name| self.summary(&folder, &name, current.as_deref())).collect();
        clips.sort_by_key(|(begun, _)| std::cmp::Reverse(*begun));
        let clips: Vec<Value> = clips.into_iter().map(|(_, clip)| clip).collect();
        let ring_s = self.supervisor.settings().map_or(0.0, |settings| settings.recorder.ring_s);
        let recording = current.as_deref().and_then(Path::file_name).map(|name| name.to_string_lossy());
        Ok(Reply::json(200, json!({"recordings": clips, "folder": folder, "ring_s": ring_s, "recording": recording}).to_string()))
    }

    fn timeline(&self, call: &mut Call) -> Result<Reply, Reply> {
        let clip = self.clip(call)?;
        let points = call.queried("points", 1000, 1..=MAX_POINTS)?;
        let timeline = timeline(&clip.path, "poses.jsonl", points as usize);
        let mut timeline = timeline.map_err(|e| failed("the recording cannot be read", &e))?;
        timeline["retracked"] = clip.path.join("retracked/compared.json").is_file().into();
        Ok(Reply::json(200, timeline.to_string()))
    }

    fn frame(&self, call: &mut Call) -> Result<Reply, Reply> {
        let clip = self.clip(call)?;
        let number = call.number("row")?;
        let beyond = || Reply::text(404, "the recording has no such row; its timeline says how many there are\n");
        let row = self.lines.stamp(&clip.path, number);
        let row = row.map_err(|_| Reply::text(500, "the recording's timestamps.csv cannot be read\n"))?.ok_or_else(beyond)?;
        let picture = Path::new("frames").join(&row.file);
        if row.file.is_empty() || !picture.components().all(|c| matches!(c, Component::Normal(_))) {
            return Err(Reply::text(404, "this row has no picture\n"));
        }
        let bytes = safe_file::read_below(&clip.path, &picture, MAX_PICTURE);
        let bytes = bytes.map_err(|e| failed("the picture cannot be read", &e))?;
        let record = self.record(&clip.path, number).unwrap_or_else(|| "null".to_owned());
        Ok(Reply::new(200, "image/jpeg", jpeg(bytes)?).with("x-stagepose-record", &escaped(&record)))
    }

    fn poses(&self, call: &mut Call) -> Result<Reply, Reply> {
        let clip = self.clip(call)?;
        self.records(&clip.path, "poses.jsonl", call)
    }

    /// Returns `count` lines of a clip's file from `from` on, as JSON lines.
    pub fn records(&self, clip: &Path, name: &str, call: &Call) -> Result<Reply, Reply> {
        let (from, count) = (call.queried("from", 0, 0..=u64::from(u32::MAX))?, call.queried("count", 500, 1..=MAX_RECORDS)?);
        let text = self.lines.records(clip, name, from, count).map_err(|e| failed("the records cannot be read", &e))?;
        Ok(Reply::new(200, "application/x-ndjson", text))
    }

    /// Returns a recording's entry in the list, and when it began, milliseconds since 1970.
    fn summary(&self, folder: &Path, name: &str, current: Option<&Path>) -> Option<(i64, Value)> {
        let path = folder.join(name);
        let index = path.join("timestamps.csv");
        if !path.symlink_metadata().ok()?.is_dir() {
            return None;
        }
        let rows = self.lines.rows(&path).ok()?;
        let stamp = |row: u64| self.lines.stamp(&path, row).ok().flatten().and_then(|row: StampRow| row.stamp.ok());
        let seconds = stamp(0).zip(stamp(rows.saturating_sub(1))).map_or(0.0, |(first, last)| last.ms_since(first) / 1e3);
        let ended = index.metadata().and_then(|about| about.modified()).ok()?.duration_since(UNIX_EPOCH).ok()?;
        let begun = ended.saturating_sub(Duration::try_from_secs_f64(seconds).unwrap_or_default()).as_millis() as i64;
        let is_open = current == Some(path.as_path());
        Some((begun, json!({"id": name, "begun_unix_ms": begun, "seconds": seconds, "frames": rows, "open": is_open})))
    }

    /// Returns the record of a row.
    fn record(&self, clip: &Path, row: u64) -> Option<String> {
        let line = String::from_utf8(self.lines.records(clip, "poses.jsonl", row, 1).ok()?).ok()?;
        serde_json::from_str::<Value>(&line).ok().map(|_| line.trim_end().to_owned())
    }
}

/// Percent-encodes a text for a header: all bytes except printable ASCII, and `%`.
fn escaped(text: &str) -> String {
    let escape = |byte: u8| match byte {
        b' '..=b'~' if byte != b'%' => char::from(byte).to_string(),
        _ => format!("%{byte:02X}"),
    };
    text.bytes().map(escape).collect()
}

/// Held while a picture is decoded: one at a time, because each may take a gigabyte.
static DECODING: Mutex<()> = Mutex::new(());

/// Converts a picture to a JPEG that browsers can show.
fn jpeg(bytes: Vec<u8>) -> Result<Vec<u8>, Reply> {
    if bytes.starts_with(&[0xFF, 0xD8]) {
        return Ok(with_huffman_tables(&bytes).into_owned());
    }
    let none = || Reply::text(404, "this row has no picture that can be read\n");
    let _alone = DECODING.lock().unwrap_or_else(PoisonError::into_inner);
    let grey = decode_grey(&bytes).map_err(|e| match e {
        DecodeError::TooLarge { .. } => Reply::text(413, format!("this row's picture is not shown: {e}\n")),
        _ => none(),
    })?;
    let (width, height) = (u16::try_from(grey.width()).map_err(|_| none())?, u16::try_from(grey.height()).map_err(|_| none())?);
    crate::web::hub::grey_jpeg(&grey, width, height, Vec::new()).ok_or_else(none)
}

/// Counts the running downloads.
struct Running(Arc<AtomicUsize>);

impl Drop for Running {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

fn download(clip: &Clip, running: &Arc<AtomicUsize>) -> Result<Reply, Reply> {
    if running.fetch_add(1, Ordering::Relaxed) >= MAX_DOWNLOADS {
        running.fetch_sub(1, Ordering::Relaxed);
        return Err(Reply::text(429, "two downloads are under way; wait for one of them\n").with("retry-after", "10"));
    }
    let (counted, path, id) = (Running(running.clone()), clip.path.clone(), clip.id.clone());
    let make = move |to: &mut dyn Write| {
        let _counted = counted;
        zip_folder(&path, &id, to)
    };
    let download = Download::start(make).map_err(|e| failed("the download cannot begin", &e))?;
    let mut reply = Reply::new(200, "application/zip", Vec::new());
    reply.download = Some(download);
    Ok(reply.with("content-disposition", &format!("attachment; filename=\"{}.zip\"", clip.id)))
}

/// Makes a report as `stagepose report` does, with pictures if requested.
fn report(supervisor: &Supervisor, clip: &Clip, call: &Call) -> Result<Reply, Reply> {
    let seconds = call.queried("pictures", 0, 0..=MAX_PICTURE_SECONDS)?;
    let (config, path) = (supervisor.file().to_owned(), clip.path.clone());
    let text = config_text(&config).map_err(|e| failed("the config cannot be read", &e))?;
    let said = vec![("daemon/diagnostics.txt", super::health::diagnostics(supervisor))];
    let make = move |to: &mut dyn Write| {
        let settings = Settings::load(&config);
        let folder = settings.as_ref().ok().map(|settings| settings.recorder.folder.as_path());
        let recordings = find(Some(&path), folder);
        let picture_seconds = (seconds > 0).then_some(seconds as f64);
        Report { config: &config, text, settings: &settings, said, recordings, picture_seconds }.write(to).map(drop)
    };
    let mut reply = Reply::new(200, "application/zip", Vec::new());
    reply.download = Some(Download::start(make).map_err(|e| failed("the report cannot begin", &e))?);
    Ok(reply.with("content-disposition", &format!("attachment; filename=\"report-{}.zip\"", clip.id)))
}

/// Zips all regular files of a folder, without compression: pictures are compressed already.
fn zip_folder(folder: &Path, name: &str, to: &mut dyn Write) -> io::Result<()> {
    let mut zip = ZipWriter::new_stream(to);
    let options = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored).large_file(true);
    add(&mut zip, options, folder, Path::new(""), name, DEEPEST)?;
    zip.finish().map_err(io::Error::other)?.flush()
}

fn add<W: Write + io::Seek>(
    zip: &mut ZipWriter<W>,
    options: SimpleFileOptions,
    folder: &Path,
    within: &Path,
    name: &str,
    deeper: usize,
) -> io::Result<()> {
    let mut entries: Vec<_> = std::fs::read_dir(folder.join(within))?.collect::<Result<_, _>>()?;
    entries.sort_by_key(std::fs::DirEntry::file_name);
    for entry in entries {
        let (kind, below) = (entry.file_type()?, format!("{name}/{}", entry.file_name().to_string_lossy()));
        if kind.is_dir() && deeper > 0 {
            add(zip, options, folder, &within.join(entry.file_name()), &below, deeper - 1)?;
        } else if kind.is_file() {
            zip.start_file(&below, options).map_err(io::Error::other)?;
            let file: File = safe_file::open_below(folder, &within.join(entry.file_name()))?;
            // A recording in progress grows; take its current length.
            let length = file.metadata()?.len();
            io::copy(&mut file.take(length), zip)?;
        }
    }
    Ok(())
}

#[cfg(test)]
#[path = "recordings_tests.rs"]
pub(super) mod tests;
