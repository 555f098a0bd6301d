//! `POST /api/v1/mode`, `ring/save`, `recordings/start`, `stop`, `mark`: commands to the running
//! daemon.

use std::sync::Arc;
use std::time::Duration;

use axum::http::Method;
use serde::Deserialize;

use crate::daemon::live::Event;
use crate::daemon::recorder::may_record;
use crate::daemon::{Mode, RecordingWish, Supervisor, unwritten};
use crate::printable::printable;
use crate::web::reply::Reply;
use crate::web::routes::{Access, Route};

/// Maximum size of a request here, bytes.
const LARGEST: u64 = 4096;
/// Maximum length of a mark's text, characters: a line in a list. Raised, lists become wide.
const MAX_MARK: usize = 200;

/// Number of marks that may come in quick succession. Raised, a runaway program fills the list and
/// the disk sooner.
const MARKS_AT_ONCE: u32 = 30;
/// Minimum interval of further marks: faster than any hand. Lowered, a runaway program fills the
/// list and the disk sooner.
const ONE_MARK_EACH: Duration = Duration::from_millis(500);
/// Number of mode changes that may come in quick succession; each opens or closes the camera.
/// Raised, a runaway program switches the camera more often.
const MODES_AT_ONCE: u32 = 10;
/// Minimum interval of further mode changes. Lowered, a runaway program switches the camera more
/// often.
const ONE_MODE_EACH: Duration = Duration::from_secs(2);

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Wanted {
    mode: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Mark {
    #[serde(default)]
    text: String,
}

pub(super) fn routes(supervisor: &Arc<Supervisor>) -> Vec<Route> {
    let of = |supervisor: &Arc<Supervisor>| supervisor.clone();
    let (for_mode, for_start, for_stop, for_mark) = (of(supervisor), of(supervisor), of(supervisor), of(supervisor));
    let for_ring = of(supervisor);
    let record = |supervisor: Arc<Supervisor>, path, wish, reply: &'static str| {
        Route::slow(Method::POST, path, Access::Change, move |_| {
            if supervisor.settings().is_none() || supervisor.mode() != Mode::Track {
                return Err(Reply::text(409, "nothing is tracked, so nothing can be recorded; start tracking first\n"));
            }
            if let (RecordingWish::Start, Some(settings)) = (wish, supervisor.settings()) {
                // Report the error to the client that asks, rather than later in an event.
                let folder = &settings.recorder.folder;
                may_record(folder)
                    .map_err(|e| Reply::text(409, format!("recordings cannot go to {}: {}\n", folder.display(), unwritten(&e))))?;
            }
            supervisor.record(wish);
            Ok(Reply::text(202, reply))
        })
    };
    vec![
        Route::slow(Method::POST, "/api/v1/mode", Access::Change, move |call| {
            let wanted: Wanted = call.json(LARGEST)?;
            let mode = Mode::ALL.into_iter().find(|mode| mode.word() == wanted.mode);
            let mode = mode.ok_or_else(|| Reply::text(422, "there is no such mode; give track or setup\n"))?;
            if mode == Mode::Track && for_mode.settings().is_none() {
                return Err(Reply::text(
                    409,
                    "there is no good config to track with; put one first, GET /api/v1/session says what is wrong\n",
                ));
            }
            for_mode.set_mode(mode);
            Ok(Reply::text(202, format!("the camera goes to: {}\n", mode.word())))
        })
        .takes(LARGEST)
        .paced(MODES_AT_ONCE, ONE_MODE_EACH),
        Route::post("/api/v1/ring/save", move || {
            for_ring.save_ring();
            Reply::text(202, "the last seconds will be saved\n")
        }),
        record(for_start, "/api/v1/recordings/start", RecordingWish::Start, "a recording begins\n").seldom(),
        record(for_stop, "/api/v1/recordings/stop", RecordingWish::Stop, "the recording ends\n"),
        Route::slow(Method::POST, "/api/v1/recordings/mark", Access::Change, move |call| {
            let mark: Mark = call.json(LARGEST)?;
            if mark.text.chars().count() > MAX_MARK {
                return Err(Reply::text(422, format!("a mark has at most {MAX_MARK} characters\n")));
            }
            for_mark.link.events.publish(Event::Marked { text: printable(&mark.text).into_owned() });
            Ok(Reply::text(202, "marked\n"))
        })
        .takes(LARGEST)
        .paced(MARKS_AT_ONCE, ONE_MARK_EACH),
    ]
}
