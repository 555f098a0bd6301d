//! `/healthz`: 200 while pictures come, 503 with the reason while they do not.

use serde::Serialize;

use super::Page;
use super::other_tracker::OtherTrackerStatus;
use super::statistics::{CameraState, RecorderState, Statistics};
use super::timecode::TimecodeStatus;
use crate::printable::printable;
use crate::publish::{ClockQuality, FrameClock};

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
    /// Null if the kernel does not tell.
    clock: Option<Clock>,
    /// Null without `[timecode]`.
    timecode: Option<TimecodeStatus>,
    /// Null without `[other_tracker]`.
    other_tracker: Option<OtherTrackerStatus>,
}

/// What the system's clock is worth.
#[derive(Serialize)]
struct Clock {
    /// Whether a time service keeps it.
    synchronised: bool,
    /// Maximum error, milliseconds.
    max_error_ms: f64,
    /// Correction of its rate, parts per million.
    frequency_ppm: f64,
}

impl From<ClockQuality> for Clock {
    fn from(quality: ClockQuality) -> Self {
        let ClockQuality { is_synchronised, max_error_s, frequency_ppm, .. } = quality;
        Self { synchronised: is_synchronised, max_error_ms: 1e3 * max_error_s, frequency_ppm }
    }
}

/// Returns the page; ages are by `clock`. Only a camera without pictures makes it 503: a dark stage
/// or a stopped recorder is a state, not a fault of the daemon.
pub fn health(statistics: &Statistics, clock: &FrameClock) -> Page {
    let camera = statistics.camera();
    let good = camera == CameraState::Streaming;
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
        frame_age_ms: statistics.last_frame_age(clock).map(|age| age.as_nanos() as f64 * 1e-6),
        frames: statistics.frames(),
        dropped: statistics.dropped.get(),
        reconnects: statistics.reconnects.get(),
        recorder: match statistics.recorder() {
            RecorderState::Off => "off",
            RecorderState::Recording => "recording",
            RecorderState::Stopped => "stopped",
        },
        clock: ClockQuality::read().map(Clock::from),
        timecode: statistics.timecode().and_then(|source| TimecodeStatus::of(&source, clock.now().monotonic)),
        other_tracker: statistics.other_tracker(),
    };
    // Serialising to a string fails only for non-string map keys, and the health has none.
    let body = serde_json::to_string(&health).expect("the health has only string keys");
    // A camera's name may hold control characters, and the page may be read on a terminal.
    let body = printable(&body).into_owned();
    Page { status: if good { 200 } else { 503 }, content_type: "application/json", body }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::super::metrics;
    use super::*;
    use crate::frame::Timestamp;
    use crate::publish::Stamps;
    use crate::publish::stepped::{START, SteppedClocks};
    use crate::record::{PoseSample, State};
    use crate::timecode::{Timecode, TimecodeMark, TimecodeRate, TimecodeSource, TimecodeTrack, TrackSettings};

    #[test]
    fn health_is_ok_while_pictures_arrive() {
        let statistics = Statistics::default();
        let clock = FrameClock::new(Stamps::Live);
        let page = health(&statistics, &clock);
        assert_eq!((page.status, page.content_type), (503, "application/json"));
        assert!(page.body.contains("\"camera\":\"waiting\"") && page.body.contains("\"frame_age_ms\":null"), "{}", page.body);

        statistics.camera_opened("Cam \"3\"", false);
        let page = health(&statistics, &clock);
        let json: serde_json::Value = serde_json::from_str(&page.body).unwrap();
        assert_eq!((page.status, json["status"].as_str(), json["camera_name"].as_str()), (200, Some("ok"), Some("Cam \"3\"")));

        statistics.camera_opened("Cam\u{9b}2J\x1b\u{202e}", true);
        let page = health(&statistics, &clock);
        let json: serde_json::Value = serde_json::from_str(&page.body).unwrap();
        assert!(page.body.chars().all(crate::printable::stands_for_itself), "{:?}", page.body);
        assert_eq!(json["camera_name"].as_str(), Some("Cam\u{9b}2J\x1b\u{202e}"));

        statistics.set_silent(true);
        statistics.sample(&PoseSample::stale(3, Timestamp::from_ns(4), 120.0));
        let page = health(&statistics, &clock);
        let json: serde_json::Value = serde_json::from_str(&page.body).unwrap();
        assert_eq!((page.status, json["camera"].as_str(), json["state"].as_str()), (503, Some("silent"), Some("stale")));
    }

    #[test]
    fn health_and_metrics_have_the_timecode_and_the_clock() {
        let (statistics, clocks) = (Statistics::default(), SteppedClocks::new());
        let clock = FrameClock::with(Arc::new(clocks.clone()), Stamps::Live);
        let timecode = || -> serde_json::Value {
            serde_json::from_str::<serde_json::Value>(&health(&statistics, &clock).body).unwrap()["timecode"].clone()
        };
        let metric = |line: &str| metrics(&statistics, &clock).body.lines().any(|l| l == line);
        assert!(timecode().is_null() && metric("stagepose_timecode_state{state=\"locked\"} 0"));
        let settings = TrackSettings { rate: Some(TimecodeRate::Fps30), free_wheel_s: 5.0 };
        let source = Arc::new(TimecodeSource::live(TimecodeTrack::live(settings)));
        statistics.set_timecode(Some(source.clone()));
        assert_eq!(timecode()["state"], "never found");
        for k in 0..60 {
            let at = START.monotonic.after_ns(40_000_000 * k);
            source.with_live(|track| track.push(TimecodeMark { at, code: Timecode::of_number(k, TimecodeRate::Fps25), is_reverse: false }));
        }
        clocks.advance_ms(59 * 40);
        let now = timecode();
        assert_eq!((&now["state"], &now["timecode"]), (&"locked".into(), &"00:00:02:09".into()));
        assert_eq!((&now["rate"], &now["configured_rate"]), (&"25".into(), &"30".into()));
        assert!(metric("stagepose_timecode_state{state=\"locked\"} 1") && metric("stagepose_timecode_state{state=\"lost\"} 0"));
        // It counts on as it was heard.
        clocks.advance_ms(2_000);
        let now = timecode();
        assert_eq!((&now["state"], &now["timecode"], &now["without_s"]), (&"free-wheeling".into(), &"00:00:04:09".into(), &2.0.into()));
        let clock: serde_json::Value = serde_json::from_str(&health(&statistics, &clock).body).unwrap();
        assert!(clock["clock"]["synchronised"].is_boolean() && clock["clock"]["max_error_ms"].is_number(), "{clock}");
    }

    #[test]
    fn a_suspend_makes_the_last_frame_old() {
        let (statistics, clocks) = (Statistics::default(), SteppedClocks::new());
        let clock = FrameClock::with(Arc::new(clocks.clone()), Stamps::Live);
        statistics.sample(&PoseSample { state: State::Tracking, ..PoseSample::stale(3, START.monotonic.after_ns(-20_000_000), 0.0) });
        let assert_age = |wanted_s: f64| {
            let health: serde_json::Value = serde_json::from_str(&health(&statistics, &clock).body).unwrap();
            assert_eq!(health["frame_age_ms"].as_f64(), Some(wanted_s * 1e3));
            let line = format!("stagepose_last_frame_age_seconds {wanted_s}");
            let page = metrics(&statistics, &clock);
            assert!(page.body.lines().any(|l| l == line), "{line} is not in\n{}", page.body);
        };
        assert_age(0.02);
        clocks.suspend_ms(3_600_000);
        assert_age(3_600.02);
        clocks.step_wall_ms(-86_400_000);
        clocks.advance_ms(100);
        assert_age(3_600.12);
    }
}
