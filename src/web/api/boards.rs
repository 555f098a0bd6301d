//! The set-up's calibration with a board: the page sends the camera's pictures, the daemon takes
//! those that are useful, says which views are missing, and computes the lens from all of them.
//!
//! - `POST /api/v1/boards/look?columns=&rows=`: a picture, which is taken if it is useful;
//! - `GET /api/v1/boards?columns=&rows=`: the pictures so far, and what is missing;
//! - `GET`, `DELETE /api/v1/boards/NAME`: one of them;
//! - `POST`, `GET /api/v1/lens`: a job that computes the lens, and its result as JSON.
//!
//! The pictures are files next to the config, in `boards`: they outlive the daemon.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use axum::http::Method;
use image::GrayImage;
use serde::Deserialize;
use serde_json::{Value, json};

use super::commands::{program, read_recording};
use super::failed;
use crate::calibrate::board::Board;
use crate::calibrate::pick::{Look, ViewPicker};
use crate::capture::decode_grey;
use crate::daemon::stand_back;
use crate::daemon::{Progress, Supervisor};
use crate::safe_file;
use crate::web::call::Call;
use crate::web::reply::Reply;
use crate::web::routes::{Access, Route};

/// Maximum size of a camera's picture, bytes. A round figure above any camera's JPEG.
const MAX_PICTURE: u64 = 16 << 20;
/// Maximum size of a request for a lens, bytes.
const LARGEST: u64 = 4096;
/// Maximum size of a result, bytes. A round figure above any.
const MAX_RESULT: u64 = 16 << 20;
/// Maximum number of pictures. More add little, and the solver's time grows with them.
const MAX_PICTURES: usize = 40;
/// The folder of the pictures.
const BOARDS: &str = "boards";
/// The lens that was computed, from the config's folder.
const LENS: &str = "calibrations/from-board.toml";
/// Its result as JSON, among the pictures.
const RESULT: &str = "result.json";
/// The side of a square where only shapes count, metres.
const ANY_SQUARE_M: f64 = 0.024;

/// The picker of the pictures, for one size of the board; it is made anew from the files when they
/// change otherwise.
type Picking = Arc<Mutex<Option<([u64; 2], ViewPicker)>>>;

/// Which board was photographed.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Wanted {
    columns: u32,
    rows: u32,
    square_mm: f64,
}

pub(super) fn routes(supervisor: &Arc<Supervisor>) -> Vec<Route> {
    let picking = Picking::default();
    let route = |method, path, access, handler: fn(&Arc<Supervisor>, &Picking, &mut Call) -> Result<Reply, Reply>| {
        let (supervisor, picking) = (supervisor.clone(), picking.clone());
        Route::slow(method, path, access, move |call| handler(&supervisor, &picking, call))
    };
    vec![
        route(Method::GET, "/api/v1/boards", Access::Paired, |supervisor, picking, call| {
            let board = board_of(call)?;
            with_picker(supervisor, picking, board, |picker| Ok(Reply::json(200, state(supervisor, picker).to_string())))
        }),
        route(Method::POST, "/api/v1/boards/look", Access::Change, look).takes(MAX_PICTURE),
        route(Method::GET, "/api/v1/boards/{name}", Access::Paired, |supervisor, _, call| {
            let bytes = safe_file::read_below(&supervisor.keeping().folder(), &Path::new(BOARDS).join(picture_name(call)?), MAX_PICTURE);
            Ok(Reply::new(200, "image/jpeg", bytes.map_err(|_| none())?))
        }),
        route(Method::DELETE, "/api/v1/boards/{name}", Access::Change, |supervisor, picking, call| {
            std::fs::remove_file(folder(supervisor).join(picture_name(call)?)).map_err(|_| none())?;
            *picking.lock().unwrap_or_else(PoisonError::into_inner) = None;
            Ok(Reply::done())
        }),
        route(Method::POST, "/api/v1/lens", Access::Change, |supervisor, _, call| start(supervisor, call)).takes(LARGEST).seldom(),
        route(Method::GET, "/api/v1/lens", Access::Paired, |supervisor, _, _| {
            let none = |_| Reply::text(404, "no lens was computed yet; POST here to begin\n");
            Ok(Reply::new(200, "application/json", safe_file::read(&folder(supervisor).join(RESULT), MAX_RESULT).map_err(none)?))
        }),
    ]
}

fn none() -> Reply {
    Reply::text(404, "there is no such picture; GET /api/v1/boards lists them\n")
}

fn folder(supervisor: &Supervisor) -> PathBuf {
    supervisor.keeping().folder().join(BOARDS)
}

fn picture_name(call: &Call) -> Result<String, Reply> {
    let name = call.name("name")?;
    if name.ends_with(".jpg") { Ok(name.to_owned()) } else { Err(none()) }
}

/// Returns the number of inner corners along the board's sides.
fn board_of(call: &Call) -> Result<[u64; 2], Reply> {
    Ok([call.queried("columns", 9, 3..=100)?, call.queried("rows", 6, 3..=100)?])
}

/// Returns the names of the pictures, in the order in which they were taken.
fn pictures(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<String> =
        entries.filter_map(|entry| entry.file_name().into_string().ok()).filter(|name| name.ends_with(".jpg")).collect();
    names.sort();
    names
}

/// Calls `then` with the picker of this board, which knows the pictures in the folder.
fn with_picker<T>(
    supervisor: &Supervisor,
    picking: &Picking,
    size: [u64; 2],
    then: impl FnOnce(&mut ViewPicker) -> Result<T, Reply>,
) -> Result<T, Reply> {
    let mut held = picking.lock().unwrap_or_else(PoisonError::into_inner);
    if held.as_ref().is_none_or(|(of, _)| *of != size) {
        let board = Board::new(size[0] as u32, size[1] as u32, ANY_SQUARE_M).map_err(|e| Reply::text(400, format!("{e}\n")))?;
        let mut picker = ViewPicker::new(board);
        for name in pictures(&folder(supervisor)) {
            let read = safe_file::read(&folder(supervisor).join(&name), MAX_PICTURE).ok();
            if let Some(picture) = read.and_then(|bytes| decode_grey(&bytes).ok()) {
                picker.recall(name.into(), &picture);
            }
        }
        *held = Some((size, picker));
    }
    // It was made just above.
    held.as_mut().map_or_else(|| Err(none()), |(_, picker)| then(picker))
}

/// Describes the pictures so far, and what is missing.
fn state(supervisor: &Supervisor, picker: &ViewPicker) -> Value {
    let taken = picker.taken();
    let missing = taken.missing();
    json!({
        "pictures": pictures(&folder(supervisor)),
        "missing_parts": missing.parts.iter().map(|(column, row)| [*column, *row]).collect::<Vec<_>>(),
        "missing_sides": missing.sides.iter().map(|side| side.name()).collect::<Vec<_>>(),
        "next": taken.next_picture(),
        "good": taken.is_good(),
    })
}

fn look(supervisor: &Arc<Supervisor>, picking: &Picking, call: &mut Call) -> Result<Reply, Reply> {
    let size = board_of(call)?;
    let bytes = call.content(MAX_PICTURE)?;
    let picture = decode_grey(&bytes).map_err(|e| Reply::text(422, format!("the picture: {e}\n")))?;
    with_picker(supervisor, picking, size, |picker| {
        let (seen, why) = looked(supervisor, picker, call, &bytes, &picture)?;
        let corners = picker.corners().map(|corners| corners.iter().flatten().map(|c| [c.x, c.y]).collect::<Vec<_>>());
        let mut said = state(supervisor, picker);
        (said["seen"], said["why"], said["corners"]) = (seen.into(), why.into(), json!(corners));
        Ok(Reply::json(200, said.to_string()))
    })
}

/// Offers a picture to the picker, and keeps it if it is useful. Returns a word for what was seen,
/// and why there is no board.
fn looked(
    supervisor: &Supervisor,
    picker: &mut ViewPicker,
    call: &Call,
    bytes: &[u8],
    picture: &GrayImage,
) -> Result<(&'static str, Option<String>), Reply> {
    let folder = folder(supervisor);
    let names = pictures(&folder);
    if names.len() >= MAX_PICTURES {
        return Err(Reply::text(409, format!("there are {MAX_PICTURES} pictures already; delete some, or compute the lens\n")));
    }
    let number = names.last().and_then(|name| name.trim_end_matches(".jpg").parse::<u32>().ok()).unwrap_or(0) + 1;
    let name = format!("{number:03}.jpg");
    Ok(match picker.look_at(name.clone().into(), picture) {
        Look::NoBoard(reason) => ("none", Some(reason.to_string())),
        Look::Moving => ("moving", None),
        Look::Blurred => ("blurred", None),
        Look::Known => ("known", None),
        Look::Taken => {
            let unwritten =
                |e: std::io::Error| failed(&format!("{}: it cannot be written; let the daemon's user write there", folder.display()), &e);
            call.still_may()?;
            std::fs::create_dir_all(&folder).map_err(unwritten)?;
            safe_file::write_lasting(&folder.join(name), bytes).map_err(unwritten)?;
            ("taken", None)
        }
    })
}

/// Starts the job that computes the lens.
fn start(supervisor: &Arc<Supervisor>, call: &mut Call) -> Result<Reply, Reply> {
    let Wanted { columns, rows, square_mm } = call.json(LARGEST)?;
    Board::new(columns, rows, 1e-3 * square_mm).map_err(|e| Reply::text(422, format!("{e}\n")))?;
    let program = program(supervisor)?;
    let folder = folder(supervisor);
    let names = pictures(&folder);
    if names.is_empty() {
        return Err(Reply::text(409, "there are no pictures of the board yet; hold it before the camera\n"));
    }
    let lens = supervisor.keeping().folder().join(LENS);
    call.still_may()?;
    let unwritten = |e: std::io::Error| failed(&format!("{}: it cannot be written; let the daemon's user write there", lens.display()), &e);
    std::fs::create_dir_all(lens.parent().unwrap_or(Path::new("."))).map_err(unwritten)?;
    let result = folder.join(RESULT);
    let mut arguments: Vec<OsString> = vec!["calibrate".into()];
    arguments.extend(names.iter().map(|name| folder.join(name).into_os_string()));
    arguments.extend(["--board".into(), format!("{columns}x{rows}").into(), "--square-mm".into(), format!("{square_mm}").into()]);
    arguments.extend(["--json".into(), result.clone().into(), "--output".into(), lens.into()]);
    let work = move |progress: &mut Progress| {
        stand_back();
        read_recording(&program, &arguments, &result, progress)
    };
    match supervisor.jobs.start("lens", format!("{} pictures", names.len()), &supervisor.link.events, work) {
        Ok(number) => Ok(Reply::json(202, json!({"job": number, "file": LENS}).to_string())),
        Err(job) => Err(Reply::text(409, format!("job {} ({}) is under way; wait for it\n", job.job, job.kind))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::web::api::tests::{respond, supervised};

    /// A board of 9 x 6 inner corners before a grey wall, as JPEG.
    fn photograph(left: u32, top: u32) -> Vec<u8> {
        let picture = GrayImage::from_fn(640, 480, |x, y| {
            let (column, row) = ((x.wrapping_sub(left)) / 24, (y.wrapping_sub(top)) / 24);
            let is_on = x >= left && y >= top && column < 10 && row < 7;
            let is_rim = x + 20 >= left && y + 20 >= top && x < left + 260 && y < top + 188;
            image::Luma([match (is_on, is_rim) {
                (true, _) => [30, 220][((column + row) % 2) as usize],
                (false, true) => 220,
                _ => 128,
            }])
        });
        let mut bytes = std::io::Cursor::new(Vec::new());
        image::DynamicImage::ImageLuma8(picture).write_to(&mut bytes, image::ImageFormat::Png).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn a_board_held_still_is_taken_once_and_pictures_outlive_the_daemon() {
        let folder = tempfile::tempdir().unwrap();
        let supervisor = supervised(folder.path());
        let ask = |routes: &[Route], method: &str, path: &str, content: &[u8]| {
            let (status, said) = respond(routes, method, path, content);
            (status, serde_json::from_slice::<Value>(&said).unwrap_or_else(|_| String::from_utf8_lossy(&said).into_owned().into()))
        };
        let first = routes(&supervisor);
        let look = |routes: &[Route], left, top| ask(routes, "POST", "/api/v1/boards/look?columns=9&rows=6", &photograph(left, top)).1;
        assert_eq!(look(&first, 100, 100)["seen"], "moving", "one frame does not show that it is still");
        let taken = look(&first, 100, 100);
        assert_eq!((&taken["seen"], taken["corners"].as_array().unwrap().len()), (&"taken".into(), 54), "{taken}");
        assert_eq!(look(&first, 100, 100)["seen"], "known");
        assert_eq!(taken["pictures"], json!(["001.jpg"]));
        assert!(taken["missing_parts"].as_array().unwrap().len() < 12 && taken["next"].is_string() && taken["good"] == false, "{taken}");
        let second = routes(&supervisor);
        let (status, said) = ask(&second, "GET", "/api/v1/boards", b"");
        assert_eq!((status, &said["missing_parts"]), (200, &taken["missing_parts"]), "{said}");
        assert_eq!(ask(&second, "GET", "/api/v1/boards/001.jpg", b"").0, 200);
        assert_eq!(ask(&second, "DELETE", "/api/v1/boards/001.jpg", b"").0, 204);
        assert_eq!(ask(&second, "DELETE", "/api/v1/boards/001.jpg", b"").0, 404);
        assert_eq!(ask(&second, "GET", "/api/v1/boards", b"").1["missing_parts"].as_array().unwrap().len(), 12);
        assert_eq!(ask(&second, "POST", "/api/v1/boards/look", b"no picture").0, 422);
        assert_eq!(ask(&second, "POST", "/api/v1/boards/look?columns=1", &photograph(0, 0)).0, 400);
        assert_eq!(ask(&second, "POST", "/api/v1/lens", br#"{"columns":9,"rows":6,"square_mm":24}"#).0, 409);
        assert_eq!(ask(&second, "POST", "/api/v1/lens", br#"{"columns":2,"rows":6,"square_mm":24}"#).0, 422);
        assert_eq!(ask(&second, "GET", "/api/v1/lens", b"").0, 404);
    }
}
