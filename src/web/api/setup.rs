//! `GET /api/v1/setup`, `POST /api/v1/setup/camera`: the cameras of this machine, and which of them
//! is shown while nothing is tracked.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use axum::http::Method;
use serde::{Deserialize, Serialize};

use super::answer;
use crate::daemon::Supervisor;
use crate::web::reply::Reply;
use crate::web::routes::{Access, Route};

/// Maximum size of a request here, bytes.
const LARGEST: u64 = 4096;
/// Number of changes of the camera that may come in quick succession; each opens one. Raised, a
/// runaway program opens cameras more often.
const CHANGES_AT_ONCE: u32 = 10;
/// Minimum interval of further changes. Lowered, a runaway program opens cameras more often.
const ONE_CHANGE_EACH: Duration = Duration::from_secs(2);

/// What is there to set a stage up with.
#[derive(Debug, Serialize)]
pub(super) struct Means {
    /// This machine's cameras.
    cameras: Vec<CameraFound>,
    /// The clip that is played in place of a camera.
    plays: Option<String>,
    /// The camera that is shown while nothing is tracked.
    shown: Option<String>,
    /// The page's address, for the config.
    listens: Option<String>,
}

/// A camera of this machine.
#[derive(Debug, Serialize)]
struct CameraFound {
    /// Its own name.
    name: String,
    /// The name for the config: one that stays with the camera, if it has one.
    device: PathBuf,
    /// Other programs that hold it open.
    held_by: Vec<String>,
    /// Its controls.
    controls: Vec<ControlFound>,
}

/// A control of a camera.
#[derive(Debug, Serialize)]
struct ControlFound {
    name: String,
    /// Its current value, if it can be read.
    value: Option<i64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Wanted {
    device: Option<String>,
}

pub(super) fn routes(supervisor: &Arc<Supervisor>) -> Vec<Route> {
    let (for_get, for_camera) = (supervisor.clone(), supervisor.clone());
    vec![
        Route::slow(Method::GET, "/api/v1/setup", Access::Paired, move |_| answer(&means(&for_get, cameras()))),
        Route::slow(Method::POST, "/api/v1/setup/camera", Access::Change, move |call| {
            let wanted: Wanted = call.json(LARGEST)?;
            call.still_may()?;
            for_camera.preview(wanted.device);
            Ok(Reply::text(202, "the camera is shown while nothing is tracked\n"))
        })
        .takes(LARGEST)
        .paced(CHANGES_AT_ONCE, ONE_CHANGE_EACH),
    ]
}

fn means(supervisor: &Supervisor, cameras: Vec<CameraFound>) -> Means {
    let name = |clip: PathBuf| clip.file_name().unwrap_or(clip.as_os_str()).to_string_lossy().into_owned();
    Means {
        cameras,
        plays: supervisor.played().map(name),
        shown: supervisor.previewed(),
        listens: supervisor.page().map(|address| address.to_string()),
    }
}

#[cfg(feature = "live")]
fn cameras() -> Vec<CameraFound> {
    crate::capture::v4l2::devices().into_iter().map(CameraFound::from).collect()
}

#[cfg(not(feature = "live"))]
fn cameras() -> Vec<CameraFound> {
    Vec::new()
}

#[cfg(feature = "live")]
impl From<crate::capture::v4l2::DeviceListing> for CameraFound {
    fn from(listing: crate::capture::v4l2::DeviceListing) -> Self {
        // Names that stay with the camera come first, then those of the port.
        let lasting = listing.by_id.into_iter().chain(listing.by_path).next();
        Self {
            name: listing.name,
            device: lasting.unwrap_or(listing.node),
            held_by: listing.held_by,
            controls: listing.controls.into_iter().map(|control| ControlFound { name: control.name, value: control.value }).collect(),
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use serde_json::Value;

    use super::*;
    use crate::web::api::tests::{respond, supervised};

    /// Returns answers with all fields, and with none.
    pub(in crate::web::api) fn samples() -> Vec<Value> {
        let folder = tempfile::tempdir().unwrap();
        let supervisor = supervised(folder.path());
        let none = serde_json::to_value(means(&supervisor, Vec::new())).unwrap();
        supervisor.set_played(Some("clips/walk.mjpeg".into()));
        supervisor.preview(Some("first".to_owned()));
        supervisor.set_page(Some(([127, 0, 0, 1], 8090).into()));
        let control = |value| ControlFound { name: "focus_absolute".to_owned(), value };
        let camera = CameraFound {
            name: "Cam".to_owned(),
            device: "/dev/v4l/by-id/usb-Cam".into(),
            held_by: vec!["cheese (process 7)".to_owned()],
            controls: vec![control(Some(30)), control(None)],
        };
        vec![none, serde_json::to_value(means(&supervisor, vec![camera])).unwrap()]
    }

    #[test]
    fn the_chosen_camera_is_shown_until_another_is_chosen() {
        let folder = tempfile::tempdir().unwrap();
        let supervisor = supervised(folder.path());
        let routes = routes(&supervisor);
        let choose = |content: &[u8]| respond(&routes, "POST", "/api/v1/setup/camera", content).0;
        assert_eq!(choose(br#"{"device":"/dev/v4l/by-id/usb-Cam"}"#), 202);
        assert_eq!(supervisor.previewed().as_deref(), Some("/dev/v4l/by-id/usb-Cam"));
        for bad in [&b"{"[..], b"[]", br#"{"device":7}"#, br#"{"other":"a"}"#] {
            assert_eq!(choose(bad), 400, "{}", String::from_utf8_lossy(bad));
        }
        assert_eq!(choose(&vec![b' '; 5000]), 413);
        assert_eq!(supervisor.previewed().as_deref(), Some("/dev/v4l/by-id/usb-Cam"));
        let (status, text) = respond(&routes, "GET", "/api/v1/setup", b"");
        let text: Value = serde_json::from_slice(&text).unwrap();
        assert_eq!((status, &text["shown"], &text["plays"]), (200, &"/dev/v4l/by-id/usb-Cam".into(), &Value::Null));
        assert_eq!(choose(br#"{"device":null}"#), 202);
        assert_eq!(supervisor.previewed(), None);
    }
}
