//! `PUT`, `GET /api/v1/pictures/NAME`, `PUT /api/v1/calibrations/NAME`: files that a config names,
//! from the browser. They are kept next to the config, each in its folder, and only if they can be
//! read.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use axum::http::Method;
use serde::Serialize;

use super::{answer, failed};
use crate::camera::parse_calibration;
use crate::capture::decode_oriented;
use crate::daemon::Supervisor;
use crate::safe_file;
use crate::web::call::Call;
use crate::web::reply::Reply;
use crate::web::routes::{Access, Route};

/// Maximum size of a picture, bytes: a camera's largest PNG. Raised, an upload takes more memory.
const MAX_PICTURE: u64 = 64 << 20;
/// Maximum size of a calibration, bytes: a thousand times one. A round figure.
const MAX_CALIBRATION: u64 = 1 << 20;
/// Maximum number of files in each folder. Raised, uploads may take more of the disk.
const MAX_FILES: usize = 64;
/// Number of files that may come in quick succession. Raised, a runaway program keeps a thread busy
/// with decoding for longer.
const AT_ONCE: u32 = 20;
/// Minimum interval of further files. Lowered, a runaway program decodes more.
const ONE_EACH: Duration = Duration::from_secs(2);

/// The folder of pictures.
const PICTURES: &str = "pictures";
/// The folder of calibrations.
const CALIBRATIONS: &str = "calibrations";

/// A file that is kept.
#[derive(Debug, Serialize)]
struct Kept {
    /// Its name for the config.
    file: PathBuf,
    /// Width of the picture, or of the camera's pictures, pixels.
    width: u32,
    /// Height likewise.
    height: u32,
    /// Degrees across the calibrated camera's picture.
    fov_deg: Option<f64>,
}

pub(super) fn routes(supervisor: &Arc<Supervisor>) -> Vec<Route> {
    let route = |method, path, access, handler: fn(&Supervisor, &mut Call) -> Result<Reply, Reply>| {
        let supervisor = supervisor.clone();
        Route::slow(method, path, access, move |call| handler(&supervisor, call))
    };
    vec![
        route(Method::GET, "/api/v1/pictures/{name}", Access::Paired, picture),
        route(Method::PUT, "/api/v1/pictures/{name}", Access::Change, put_picture).takes_a_file().paced(AT_ONCE, ONE_EACH),
        route(Method::PUT, "/api/v1/calibrations/{name}", Access::Change, put_calibration).takes(MAX_CALIBRATION).paced(AT_ONCE, ONE_EACH),
    ]
}

/// Returns the content type of a picture's name; `None` if it is not one of a picture.
fn content_type(name: &str) -> Option<&'static str> {
    match Path::new(name).extension()?.to_str()? {
        "png" => Some("image/png"),
        "jpg" | "jpeg" => Some("image/jpeg"),
        _ => None,
    }
}

fn picture(supervisor: &Supervisor, call: &mut Call) -> Result<Reply, Reply> {
    let none = || Reply::text(404, "there is no such picture; PUT it here\n");
    let name = call.name("name")?;
    let kind = content_type(name).ok_or_else(none)?;
    let bytes = safe_file::read_below(&supervisor.keeping().folder(), &Path::new(PICTURES).join(name), MAX_PICTURE);
    Ok(Reply::new(200, kind, bytes.map_err(|_| none())?))
}

fn put_picture(supervisor: &Supervisor, call: &mut Call) -> Result<Reply, Reply> {
    let name = call.name("name")?.to_owned();
    if content_type(&name).is_none() {
        return Err(Reply::text(400, "a picture is called NAME.png or NAME.jpg, in small letters\n"));
    }
    let bytes = call.content(MAX_PICTURE)?;
    let (picture, _) = decode_oriented(&bytes).map_err(|e| Reply::text(422, format!("{name}: {e}\n")))?;
    let (width, height) = picture.dimensions();
    let file = keep(supervisor, call, PICTURES, &name, &bytes)?;
    answer(&Kept { file, width, height, fov_deg: None })
}

fn put_calibration(supervisor: &Supervisor, call: &mut Call) -> Result<Reply, Reply> {
    let name = call.name("name")?.to_owned();
    let bytes = call.content(MAX_CALIBRATION)?;
    let calibration = parse_calibration(&bytes, Path::new(&name)).map_err(|e| Reply::text(422, format!("{e}\n")))?;
    let lens = calibration.model.intrinsics();
    let fov_deg = 2.0 * (f64::from(lens.width) / (2.0 * lens.fx)).atan().to_degrees();
    let file = keep(supervisor, call, CALIBRATIONS, &name, &bytes)?;
    answer(&Kept { file, width: lens.width, height: lens.height, fov_deg: Some(fov_deg) })
}

/// Keeps a file in this folder, and returns its name for the config.
fn keep(supervisor: &Supervisor, call: &Call, folder: &str, name: &str, bytes: &[u8]) -> Result<PathBuf, Reply> {
    let keeping = supervisor.keeping();
    let below = Path::new(folder).join(name);
    let whole = keeping.folder().join(&below);
    let unwritten =
        |e: std::io::Error| failed(&format!("{}: it cannot be written; let the daemon's user write there", whole.display()), &e);
    let _alone = supervisor.alone();
    let parent = keeping.folder().join(folder);
    std::fs::create_dir_all(&parent).map_err(unwritten)?;
    let count = std::fs::read_dir(&parent).map_err(unwritten)?.count();
    if count >= MAX_FILES && !whole.exists() {
        return Err(Reply::text(
            409,
            format!("there are {count} files in {} already; delete those that no config names\n", parent.display()),
        ));
    }
    call.still_may()?;
    safe_file::write_lasting(&whole, bytes).map_err(unwritten)?;
    // A config's names are relative to its own folder, which may be another one.
    Ok(if keeping.is_elsewhere() { whole } else { below })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::web::api::tests::{respond, supervised};

    #[test]
    fn a_picture_is_decoded_before_it_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let routes = routes(&supervised(folder.path()));
        let put = |name: &str, content: &[u8]| respond(&routes, "PUT", &format!("/api/v1/pictures/{name}"), content);
        let good = std::fs::read(folder.path().join("backdrop.png")).unwrap();
        let (status, text) = put("stage.png", &good);
        let text: serde_json::Value = serde_json::from_slice(&text).unwrap();
        assert_eq!((status, &text["file"], &text["width"], &text["height"]), (200, &"pictures/stage.png".into(), &128.into(), &96.into()));
        assert_eq!(respond(&routes, "GET", "/api/v1/pictures/stage.png", b""), (200, good.clone()));
        let heic = b"\0\0\0\x18ftypheic\0\0\0\0mif1heic\0\0\0\x08free";
        for (bad, word) in [(&heic[..], "HEIC"), (b"no picture", "JPEG, PNG"), (b"", "empty"), (&good[..good.len() / 2], "cut off")] {
            let (status, text) = put("stage.png", bad);
            let text = String::from_utf8(text).unwrap();
            assert!(status == 422 && text.contains(word), "{status} {text}");
        }
        for name in ["stage.gif", "stage.PNG", "..%2fstage.png", ".png", "stage", "a%2fb.png"] {
            assert_eq!(put(name, &good).0, 400, "{name}");
        }
        assert_eq!(respond(&routes, "GET", "/api/v1/pictures/stage.png", b"").1, good, "the good one stays");
        assert_eq!(respond(&routes, "GET", "/api/v1/pictures/none.png", b"").0, 404);
    }

    #[test]
    fn a_calibration_of_any_known_form_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let routes = routes(&supervised(folder.path()));
        let put = |name: &str, content: &[u8]| respond(&routes, "PUT", &format!("/api/v1/calibrations/{name}"), content);
        let good = std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/dolly/camera.toml")).unwrap();
        let (status, text) = put("camera.toml", &good);
        let text: serde_json::Value = serde_json::from_slice(&text).unwrap();
        assert_eq!((status, &text["file"], &text["width"]), (200, &"calibrations/camera.toml".into(), &640.into()));
        assert!((text["fov_deg"].as_f64().unwrap() - 58.11).abs() < 0.01, "{text}");
        let (status, text) = put("camera.toml", b"fx = 1\n");
        assert!(status == 422 && text.starts_with(b"camera.toml"), "{status} {}", String::from_utf8_lossy(&text));
        assert_eq!(std::fs::read(folder.path().join("calibrations/camera.toml")).unwrap(), good, "the good one stays");
        assert_eq!(put("..%2fcamera.toml", &good).0, 400);
        assert_eq!(put("camera.toml", &vec![b' '; 2 << 20]).0, 413);
    }

    #[test]
    fn a_full_folder_takes_no_more_names() {
        let folder = tempfile::tempdir().unwrap();
        let routes = routes(&supervised(folder.path()));
        let good = std::fs::read(folder.path().join("backdrop.png")).unwrap();
        let kept = folder.path().join(PICTURES);
        std::fs::create_dir(&kept).unwrap();
        (0..MAX_FILES).for_each(|k| std::fs::write(kept.join(format!("{k}.png")), b"").unwrap());
        let put = |name: &str| respond(&routes, "PUT", &format!("/api/v1/pictures/{name}"), &good).0;
        assert_eq!((put("more.png"), put("7.png")), (409, 200));
    }
}
