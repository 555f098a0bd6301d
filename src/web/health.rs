//! `/healthz`: 200 while pictures come, 503 while they do not, and why.

use serde::Serialize;

use super::{CameraState, Page, RecorderState, Statistics};
use crate::printable::printable;

#[derive(Serialize)]
struct Health<'a> {
    status: &'a str,
    camera: &'a str,
    camera_name: &'a str,
    state: &'a str,
    fps: f64,
    frame_age_ms: Option<f64>,
    frames: u64,
    dropped: u64,
    reconnects: u64,
    recorder: &'a str,
}

/// The page. `now_ns` is monotonic. A camera that gives no pictures is the only thing that makes it 503: a stage
/// that is dark or a recorder that stopped are states, not faults of the daemon.
pub fn health(statistics: &Statistics, now_ns: i64) -> Page {
    let camera = statistics.camera();
    let good = camera == CameraState::Streaming;
    let last = statistics.last_frame_ns();
    let name = statistics.camera_name();
    let health = Health {
        status: if good { "ok" } else { "no pictures" },
        camera: match camera {
            CameraState::Waiting => "waiting",
            CameraState::Streaming => "streaming",
            CameraState::Silent => "silent",
        },
        camera_name: &name,
        state: statistics.last_state().word(),
        fps: statistics.rate(),
        frame_age_ms: (last != 0).then(|| now_ns.saturating_sub(last) as f64 * 1e-6),
        frames: statistics.frames(),
        dropped: statistics.dropped(),
        reconnects: statistics.reconnects(),
        recorder: match statistics.recorder() {
            RecorderState::Off => "off",
            RecorderState::Recording => "recording",
            RecorderState::Stopped => "stopped",
        },
    };
    // Serialising to a string fails only for non-string map keys, of which there are none.
    let body = serde_json::to_string(&health).expect("the health has only string keys");
    // A camera names itself, and the page may be read on a terminal.
    let body = printable(&body).into_owned();
    Page { status: if good { 200 } else { 503 }, content_type: "application/json", body }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::PoseSample;

    #[test]
    fn it_is_healthy_while_pictures_come() {
        let statistics = Statistics::default();
        let page = health(&statistics, 5_000_000);
        assert_eq!((page.status, page.content_type), (503, "application/json"));
        assert!(page.body.contains("\"camera\":\"waiting\"") && page.body.contains("\"frame_age_ms\":null"), "{}", page.body);

        statistics.camera_opened("Cam \"3\"", false);
        let page = health(&statistics, 5_000_000);
        let json: serde_json::Value = serde_json::from_str(&page.body).unwrap();
        assert_eq!((page.status, json["status"].as_str(), json["camera_name"].as_str()), (200, Some("ok"), Some("Cam \"3\"")));

        statistics.camera_opened("Cam\u{9b}2J\x1b\u{202e}", true);
        let page = health(&statistics, 5_000_000);
        let json: serde_json::Value = serde_json::from_str(&page.body).unwrap();
        assert!(page.body.chars().all(crate::printable::stands_for_itself), "{:?}", page.body);
        assert_eq!(json["camera_name"].as_str(), Some("Cam\u{9b}2J\x1b\u{202e}"));

        statistics.set_silent(true);
        statistics.sample(&PoseSample::stale(3, 4, 120.0));
        let page = health(&statistics, 5_000_000);
        let json: serde_json::Value = serde_json::from_str(&page.body).unwrap();
        assert_eq!((page.status, json["camera"].as_str(), json["state"].as_str()), (503, Some("silent"), Some("stale")));
    }
}
