//! What the page asks of the program's own commands (`daemon::run_own`): sheets to print, and
//! recordings checked, surveyed or mapped as jobs. The page so gets what the command line gives.
//!
//! - `PUT`, `GET /api/v1/prints/NAME`: a poster or a calibration board, kept in `prints`;
//! - `POST`, `GET /api/v1/recordings/ID/{check,survey,map}`: a job, and its result as JSON;
//! - `POST /api/v1/recordings/ID/{survey,map}/use`: its result becomes the config.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use axum::http::Method;
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::config::take_over;
use super::findings::MAX_CONFIG;
use super::line_index::LineIndex;
use super::recordings::Folder;
use super::{answer, failed};
use crate::config::named_below;
use crate::daemon::stand_back;
use crate::daemon::{Progress, Supervisor, run_own};
use crate::safe_file;
use crate::web::call::Call;
use crate::web::reply::Reply;
use crate::web::routes::{Access, Route};

/// Maximum size of a request here, bytes.
const LARGEST: u64 = 4096;
/// Maximum size of a sheet to print, bytes. A round figure above the largest poster's.
const MAX_SHEET: u64 = 64 << 20;
/// Maximum size of a result, bytes. A round figure above any survey's.
const MAX_RESULT: u64 = 16 << 20;
/// Maximum number of sheets that are kept. Raised, they may take more of the disk.
const MAX_SHEETS: usize = 32;
/// The folder of sheets.
const PRINTS: &str = "prints";
/// The folder of results, and of the stages that were surveyed or mapped.
const WALKS: &str = "walks";

/// A command that reads a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Reading {
    Check,
    Survey,
    Map,
}

impl Reading {
    fn word(self) -> &'static str {
        match self {
            Self::Check => "check",
            Self::Survey => "survey",
            Self::Map => "map",
        }
    }
}

/// How a recording is read.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Wanted {
    /// Whether a survey also measures the lens.
    refines_lens: bool,
}

/// A sheet that was made.
#[derive(Debug, Serialize)]
struct Sheet {
    /// The picture on it for the config, if it is a poster: its file, width and height.
    file: Option<PathBuf>,
    width: Option<u32>,
    height: Option<u32>,
    /// Width and height of the printed picture, metres.
    size_m: Option<[f64; 2]>,
}

pub(super) fn routes(supervisor: &Arc<Supervisor>, lines: &Arc<LineIndex>) -> Vec<Route> {
    let (for_put, for_get) = (supervisor.clone(), supervisor.clone());
    let reading = |method, path, access, handler: fn(&Arc<Supervisor>, &Folder, &mut Call, Reading) -> Result<Reply, Reply>, of| {
        let (supervisor, folder) = (supervisor.clone(), Folder::new(supervisor, lines));
        Route::slow(method, path, access, move |call| handler(&supervisor, &folder, call, of))
    };
    let start = |path, of| reading(Method::POST, path, Access::Change, start, of).takes(LARGEST).seldom();
    let result = |path, of| reading(Method::GET, path, Access::Paired, result, of);
    let accept = |path, of| reading(Method::POST, path, Access::Change, accept, of).seldom();
    vec![
        Route::slow(Method::PUT, "/api/v1/prints/{name}", Access::Change, move |call| print(&for_put, call)).seldom(),
        Route::slow(Method::GET, "/api/v1/prints/{name}", Access::Paired, move |call| sheet(&for_get, call)),
        start("/api/v1/recordings/{id}/check", Reading::Check),
        start("/api/v1/recordings/{id}/survey", Reading::Survey),
        start("/api/v1/recordings/{id}/map", Reading::Map),
        result("/api/v1/recordings/{id}/check", Reading::Check),
        result("/api/v1/recordings/{id}/survey", Reading::Survey),
        result("/api/v1/recordings/{id}/map", Reading::Map),
        accept("/api/v1/recordings/{id}/survey/use", Reading::Survey),
        accept("/api/v1/recordings/{id}/map/use", Reading::Map),
    ]
}

/// Returns the program, or the reply that this build has no commands.
pub(super) fn program(supervisor: &Supervisor) -> Result<PathBuf, Reply> {
    supervisor.program().ok_or_else(|| Reply::text(409, "this daemon has no commands to run; start it with the stagepose program\n"))
}

/// Returns the arguments that make a sheet by its name: `poster-PAPER-SEED`, or
/// `board-COLUMNSxROWS-MM-PAPER`.
fn sheet_arguments(name: &str) -> Option<Vec<String>> {
    let plain = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_alphanumeric());
    let words = |words: &[&str]| Some(words.iter().map(|word| (*word).to_owned()).collect());
    match *name.split('-').collect::<Vec<_>>() {
        ["poster", paper, seed] if plain(paper) && seed.parse::<u32>().is_ok() => words(&["poster", "--paper", paper, "--seed", seed]),
        ["board", corners, mm, paper] if plain(corners) && plain(paper) && mm.parse::<u32>().is_ok() => {
            words(&["board", "--board", corners, "--square-mm", mm, "--paper", paper])
        }
        _ => None,
    }
}

fn print(supervisor: &Supervisor, call: &mut Call) -> Result<Reply, Reply> {
    let name = call.name("name")?.to_owned();
    let unknown = || Reply::text(400, "a sheet is called poster-PAPER-SEED or board-9x6-MM-PAPER\n");
    let arguments = sheet_arguments(&name).ok_or_else(unknown)?;
    let program = program(supervisor)?;
    let keeping = supervisor.keeping();
    let folder = keeping.folder().join(PRINTS);
    let unwritten =
        |e: std::io::Error| failed(&format!("{}: it cannot be written; let the daemon's user write there", folder.display()), &e);
    std::fs::create_dir_all(&folder).map_err(unwritten)?;
    let sheet = folder.join(format!("{name}.pdf"));
    let count = std::fs::read_dir(&folder).map_err(unwritten)?.count();
    if count >= 2 * MAX_SHEETS && !sheet.exists() {
        return Err(Reply::text(
            409,
            format!("there are {count} files in {} already; delete those that no config names\n", folder.display()),
        ));
    }
    call.still_may()?;
    let arguments: Vec<OsString> = arguments.into_iter().map(OsString::from).chain(["-o".into(), sheet.into()]).collect();
    let ended = run_own(&program, &arguments, None).map_err(|e| failed("the sheet cannot be made", &e))?;
    if ended.code != Some(0) {
        return Err(Reply::text(422, format!("{}\n", ended.said)));
    }
    let picture = format!("{name}-picture.png");
    let size = image::image_dimensions(folder.join(&picture)).ok();
    let file = size.map(|_| if keeping.is_elsewhere() { folder.join(&picture) } else { Path::new(PRINTS).join(&picture) });
    answer(&Sheet { file, width: size.map(|s| s.0), height: size.map(|s| s.1), size_m: size_m(&ended.output) })
}

/// Returns the size of the surface in the config's lines that a poster's command prints.
fn size_m(printed: &str) -> Option<[f64; 2]> {
    let lines: toml::Table = printed.parse().ok()?;
    let size = lines.get("stage")?.get("surface")?.get(0)?.get("size_m")?.as_array()?;
    Some([size.first()?.as_float()?, size.get(1)?.as_float()?])
}

fn sheet(supervisor: &Supervisor, call: &mut Call) -> Result<Reply, Reply> {
    let none = || Reply::text(404, "there is no such sheet; PUT its name without .pdf to make it\n");
    let name = call.name("name")?;
    let kind = match Path::new(name).extension().and_then(|ending| ending.to_str()) {
        Some("pdf") => "application/pdf",
        Some("png") => "image/png",
        _ => return Err(none()),
    };
    let bytes = safe_file::read_below(&supervisor.keeping().folder(), &Path::new(PRINTS).join(name), MAX_SHEET);
    Ok(Reply::new(200, kind, bytes.map_err(|_| none())?))
}

/// The files of a command's result.
struct Files {
    /// The config that it read.
    config: PathBuf,
    /// Its result as JSON.
    result: PathBuf,
    /// The folder of the made stage.
    made: PathBuf,
}

impl Files {
    fn of(supervisor: &Supervisor, id: &str, reading: Reading) -> Self {
        let folder = supervisor.keeping().folder().join(WALKS);
        let name = format!("{id}-{}", reading.word());
        Self { config: folder.join(format!("{name}.toml")), result: folder.join(format!("{name}.json")), made: folder.join(name) }
    }
}

/// Returns the current config with whole paths, which can be read from any folder.
fn config_anywhere(supervisor: &Supervisor) -> Result<String, Reply> {
    let read = safe_file::read(&supervisor.keeping().current(), MAX_CONFIG).map_err(|e| failed("the config cannot be read", &e))?;
    let parent = supervisor.file().parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let folder = std::path::absolute(parent).map_err(|e| failed("the config's folder is unknown", &e))?;
    let text = String::from_utf8(read).ok().and_then(|text| named_below(&text, &folder));
    text.ok_or_else(|| Reply::text(409, "the config in the file is not good; mend it first\n"))
}

/// Returns a config without what it sends and serves: a check tries these, and this daemon has them
/// open.
fn without_receivers(text: &str) -> String {
    let Ok(mut table) = text.parse::<toml::Table>() else { return text.to_owned() };
    ["http", "output", "timecode"].iter().for_each(|key| _ = table.remove(*key));
    table.to_string()
}

fn start(supervisor: &Arc<Supervisor>, folder: &Folder, call: &mut Call, reading: Reading) -> Result<Reply, Reply> {
    let wanted: Wanted = call.json(LARGEST)?;
    let clip = folder.clip(call)?;
    let program = program(supervisor)?;
    if supervisor.recording().as_deref() == Some(clip.path.as_path()) {
        return Err(Reply::text(409, "this is being recorded; end the recording first\n"));
    }
    let files = Files::of(supervisor, &clip.id, reading);
    let text = config_anywhere(supervisor)?;
    let text = if reading == Reading::Check { without_receivers(&text) } else { text };
    call.still_may()?;
    let unwritten =
        |e: std::io::Error| failed(&format!("{}: it cannot be written; let the daemon's user write there", files.config.display()), &e);
    std::fs::create_dir_all(files.config.parent().unwrap_or(Path::new("."))).map_err(unwritten)?;
    safe_file::write_lasting(&files.config, text.as_bytes()).map_err(unwritten)?;
    let mut arguments: Vec<OsString> = vec![reading.word().into()];
    match reading {
        Reading::Check => arguments.extend(["--clip".into(), clip.path.into()]),
        Reading::Survey | Reading::Map => arguments.extend([clip.path.into(), "--output".into(), files.made.clone().into()]),
    }
    arguments.extend(["--config".into(), files.config.into(), "--json".into(), files.result.clone().into()]);
    if wanted.refines_lens && reading == Reading::Survey {
        arguments.extend(["--lens".into(), "refine".into()]);
    }
    let work = move |progress: &mut Progress| {
        stand_back();
        read_recording(&program, &arguments, &files.result, progress)
    };
    match supervisor.jobs.start(reading.word(), clip.id, &supervisor.link.events, work) {
        Ok(number) => Ok(Reply::json(202, json!({"job": number}).to_string())),
        Err(job) => Err(Reply::text(
            409,
            format!("job {} ({}) is under way; wait for it, or end it by DELETE /api/v1/jobs/{}\n", job.job, job.kind, job.job),
        )),
    }
}

/// Runs a command that writes `result`. If it wrote that it did its work, whatever its verdict.
pub(super) fn read_recording(program: &Path, arguments: &[OsString], result: &Path, progress: &mut Progress) -> Result<String, String> {
    // A former result must not be taken for this one's.
    std::fs::remove_file(result)
        .or_else(|e| if e.kind() == std::io::ErrorKind::NotFound { Ok(()) } else { Err(e) })
        .map_err(|e| e.to_string())?;
    let ended = run_own(program, arguments, Some(progress)).map_err(|e| format!("the command cannot be run ({e})"))?;
    match (result.is_file(), ended.said.as_str()) {
        (true, _) => Ok("done".to_owned()),
        (false, "") => Err("it ended without a result; see the log".to_owned()),
        (false, said) => Err(said.to_owned()),
    }
}

fn result(supervisor: &Arc<Supervisor>, folder: &Folder, call: &mut Call, reading: Reading) -> Result<Reply, Reply> {
    let clip = folder.clip(call)?;
    let Files { result, .. } = Files::of(supervisor, &clip.id, reading);
    let bytes = safe_file::read(&result, MAX_RESULT);
    let none = |_| Reply::text(404, format!("there is no {} of this recording yet; POST here to begin one\n", reading.word()));
    Ok(Reply::new(200, "application/json", bytes.map_err(none)?))
}

/// Makes the surveyed or mapped stage the config; the former one is kept.
fn accept(supervisor: &Arc<Supervisor>, folder: &Folder, call: &mut Call, reading: Reading) -> Result<Reply, Reply> {
    let clip = folder.clip(call)?;
    let Files { made, .. } = Files::of(supervisor, &clip.id, reading);
    let none = || Reply::text(409, format!("no stage was made by the {}; see its verdict\n", reading.word()));
    let text = safe_file::read(&made.join("stage.toml"), MAX_CONFIG).map_err(|_| none())?;
    // Paths of the config are relative to its own folder, which may be another one.
    let below = match supervisor.keeping().is_elsewhere() {
        true => made,
        false => Path::new(WALKS).join(made.file_name().unwrap_or_default()),
    };
    let text = String::from_utf8(text).ok().and_then(|text| named_below(&text, &below)).ok_or_else(none)?;
    take_over(supervisor, call, &text, None)
}

#[cfg(test)]
#[path = "commands_tests.rs"]
mod tests;
