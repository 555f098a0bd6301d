//! `/metrics`: the daemon's counters and gauges in Prometheus' text format (0.0.4).

use std::fmt::Write as _;

use super::Page;
use super::budget::BudgetPart;
use super::histogram::{EDGES_S, Histogram};
use super::other_tracker::STATES as OTHER_TRACKER_STATES;
use super::statistics::{CameraState, RecorderState, Statistics};
use super::timecode::{STATES, TimecodeStatus};
use crate::publish::{ClockQuality, FrameClock};
use crate::record::State;

/// Returns the page; ages are by `clock`.
pub fn metrics(statistics: &Statistics, clock: &FrameClock) -> Page {
    let mut text = String::with_capacity(8 << 10);
    states(&mut text, statistics);
    counters(&mut text, statistics);
    gauges(&mut text, statistics, clock);
    timecode(&mut text, statistics, clock);
    other_tracker(&mut text, statistics);
    system_clock(&mut text);
    budget(&mut text, statistics);
    head(&mut text, "stagepose_stage_seconds", "histogram", "Compute time of a frame by stage.");
    for (stage, histogram) in statistics.stages() {
        buckets(&mut text, "stagepose_stage_seconds", &format!("stage=\"{stage}\""), histogram);
    }
    head(&mut text, "stagepose_frame_age_seconds", "histogram", "Age of a frame when tracking it began.");
    buckets(&mut text, "stagepose_frame_age_seconds", "", statistics.age());
    Page { status: 200, content_type: "text/plain; version=0.0.4; charset=utf-8", body: text }
}

fn head(text: &mut String, name: &str, kind: &str, help: &str) {
    let _ = writeln!(text, "# HELP {name} {help}\n# TYPE {name} {kind}");
}

fn one(text: &mut String, name: &str, kind: &str, help: &str, value: impl std::fmt::Display) {
    head(text, name, kind, help);
    let _ = writeln!(text, "{name} {value}");
}

fn states(text: &mut String, statistics: &Statistics) {
    head(text, "stagepose_samples_total", "counter", "Samples published, by state.");
    for state in State::ALL {
        let _ = writeln!(text, "stagepose_samples_total{{state=\"{}\"}} {}", state.word(), statistics.in_state(state));
    }
    head(text, "stagepose_state", "gauge", "1 for the state of the last sample.");
    let last = statistics.last_state();
    for state in State::ALL {
        let _ = writeln!(text, "stagepose_state{{state=\"{}\"}} {}", state.word(), u8::from(state == last));
    }
}

fn counters(text: &mut String, s: &Statistics) {
    let counters = [
        ("stagepose_frames_total", "Frames processed, whatever the result.", s.frames()),
        ("stagepose_frames_undecodable_total", "Frames whose picture could not be read.", s.undecodable.get()),
        ("stagepose_frames_skipped_total", "Frames skipped because of their stamp or size.", s.skipped.get()),
        ("stagepose_frames_dropped_total", "Frames dropped because the tracker was late.", s.dropped.get()),
        ("stagepose_frames_lost_in_device_total", "Frames lost before arrival, by the driver's sequence numbers.", s.device_dropped.get()),
        ("stagepose_camera_reconnects_total", "How often the camera was opened again.", s.reconnects.get()),
        ("stagepose_panics_contained_total", "Panics that were contained.", s.contained_panics.get()),
        ("stagepose_frames_recorded_total", "Frames recorded.", s.recorded.get()),
        ("stagepose_frames_viewed_total", "Frames copied for clients that watch the page.", s.viewed.get()),
    ];
    counters.iter().for_each(|(name, help, value)| one(text, name, "counter", help, value));
}

fn gauges(text: &mut String, s: &Statistics, clock: &FrameClock) {
    one(text, "stagepose_frame_rate", "gauge", "Frames tracked a second.", s.rate());
    let age = s.last_frame_age(clock).map_or("NaN".to_owned(), |age| age.as_secs_f64().to_string());
    one(text, "stagepose_last_frame_age_seconds", "gauge", "Age of the last tracked frame.", age);
    one(text, "stagepose_inliers", "gauge", "Inliers of the last frame.", s.inliers());
    one(text, "stagepose_rms_pixels", "gauge", "Residual of the last frame.", s.rms_px());
    one(text, "stagepose_camera_up", "gauge", "1 while the camera gives pictures.", u8::from(s.camera() == CameraState::Streaming));
    one(text, "stagepose_recording", "gauge", "1 while frames are recorded.", u8::from(s.recorder() == RecorderState::Recording));
    one(text, "stagepose_recorder_stopped", "gauge", "1 if recording gave up.", u8::from(s.recorder() == RecorderState::Stopped));
}

/// Writes the timecode's state: all four are 0 without `[timecode]`.
fn timecode(text: &mut String, statistics: &Statistics, clock: &FrameClock) {
    let status = statistics.timecode().and_then(|source| TimecodeStatus::of(&source, clock.now().monotonic));
    head(text, "stagepose_timecode_state", "gauge", "1 for the state of the timecode.");
    for state in STATES {
        let is_state = status.as_ref().is_some_and(|status| status.state == state);
        let _ = writeln!(text, "stagepose_timecode_state{{state=\"{state}\"}} {}", u8::from(is_state));
    }
    let speed = status.and_then(|status| status.speed).map_or("NaN".to_owned(), |speed| speed.to_string());
    one(text, "stagepose_timecode_speed", "gauge", "Speed of the timecode, 1 for its rate.", speed);
}

/// Writes the other tracker's state, all 0 without `[other_tracker]`, and how the two differ.
fn other_tracker(text: &mut String, statistics: &Statistics) {
    let status = statistics.other_tracker();
    head(text, "stagepose_other_tracker_state", "gauge", "1 for the state of the other tracker.");
    for state in OTHER_TRACKER_STATES {
        let is_state = status.as_ref().is_some_and(|status| status.state == state);
        let _ = writeln!(text, "stagepose_other_tracker_state{{state=\"{state}\"}} {}", u8::from(is_state));
    }
    let difference = status.and_then(|status| status.difference);
    let number = |value: Option<f64>| value.map_or("NaN".to_owned(), |value| value.to_string());
    let (metres, degrees) = (difference.as_ref().map(|d| d.rms_m), difference.as_ref().map(|d| d.rms_deg));
    one(text, "stagepose_other_tracker_difference_meters", "gauge", "Difference to the other tracker, rms.", number(metres));
    one(text, "stagepose_other_tracker_difference_degrees", "gauge", "The same in rotation.", number(degrees));
}

/// Writes what the system's clock is worth; NaN where the kernel does not tell.
fn system_clock(text: &mut String) {
    let quality = ClockQuality::read();
    let is_synchronised = quality.is_some_and(|quality| quality.is_synchronised);
    one(text, "stagepose_clock_synchronised", "gauge", "1 while a time service keeps the clock.", u8::from(is_synchronised));
    let error = quality.map_or("NaN".to_owned(), |quality| quality.max_error_s.to_string());
    one(text, "stagepose_clock_max_error_seconds", "gauge", "Maximum error of the clock.", error);
}

/// Writes where the time from a pose's instant to its packet goes; NaN for what is not known.
fn budget(text: &mut String, statistics: &Statistics) {
    head(text, "stagepose_delay_budget_seconds", "gauge", "Parts of the delay from a pose's instant to its packet.");
    for BudgetPart { name, seconds, origin } in statistics.budget().0 {
        let seconds = seconds.map_or("NaN".to_owned(), |seconds| seconds.to_string());
        let _ = writeln!(text, "stagepose_delay_budget_seconds{{part=\"{name}\",origin=\"{}\"}} {seconds}", origin.word());
    }
}

fn buckets(text: &mut String, name: &str, labels: &str, histogram: &Histogram) {
    let comma = if labels.is_empty() { "" } else { "," };
    let counts = histogram.cumulative();
    for (edge, count) in EDGES_S.iter().zip(counts) {
        let _ = writeln!(text, "{name}_bucket{{{labels}{comma}le=\"{edge}\"}} {count}");
    }
    let total = counts[EDGES_S.len()];
    let _ = writeln!(text, "{name}_bucket{{{labels}{comma}le=\"+Inf\"}} {total}");
    let braces = if labels.is_empty() { String::new() } else { format!("{{{labels}}}") };
    let _ = writeln!(text, "{name}_sum{braces} {}\n{name}_count{braces} {total}", histogram.sum_s());
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;
    use std::sync::Arc;

    use super::*;
    use crate::publish::Stamps;
    use crate::publish::stepped::{START, SteppedClocks};
    use crate::record::{PoseSample, StageTimes};

    /// The Grafana dashboard uses only existing metrics, and every counter.
    #[test]
    fn the_dashboard_shows_each_metric_and_no_other() {
        let text = include_str!("../../packaging/grafana.json");
        let dashboard: serde_json::Value = serde_json::from_str(text).unwrap();
        let clock = FrameClock::with(Arc::new(SteppedClocks::new()), Stamps::Live);
        let page = metrics(&Statistics::default(), &clock);
        let families: HashSet<&str> = page.body.lines().filter_map(|line| line.strip_prefix("# TYPE ")?.split(' ').next()).collect();
        let mut queried = HashSet::new();
        let targets = dashboard["panels"].as_array().unwrap().iter().flat_map(|panel| panel["targets"].as_array().unwrap());
        for target in targets {
            let words = target["expr"].as_str().unwrap().split(|c: char| !c.is_ascii_alphanumeric() && c != '_');
            for name in words.filter(|word| word.starts_with("stagepose_")) {
                let family = ["_bucket", "_sum", "_count"].iter().find_map(|end| name.strip_suffix(end)).unwrap_or(name);
                assert!(families.contains(family), "the dashboard asks for {name}, which /metrics does not have");
                queried.insert(family);
            }
        }
        assert_eq!(queried, families);
    }

    #[test]
    fn metrics_lines_are_valid_and_every_metric_is_typed() {
        let statistics = Statistics::default();
        let mut sample = PoseSample::stale(0, START.monotonic.after_ns(-2_000_000), 0.0);
        sample.state = State::Searching;
        sample.times = StageTimes { decode_ms: 2.0, acquire_ms: 20.0, align_ms: 5.0, pose_ms: 0.1, age_ms: Some(7.0) };
        statistics.sample(&sample);
        statistics.dropped.add(3);
        let clock = FrameClock::with(Arc::new(SteppedClocks::new()), Stamps::Live);
        let page = metrics(&statistics, &clock);
        let mut typed = HashSet::new();
        for line in page.body.lines() {
            if let Some(rest) = line.strip_prefix("# TYPE ") {
                assert!(typed.insert(rest.split(' ').next().unwrap().to_owned()), "twice: {rest}");
            } else if !line.starts_with("# HELP ") {
                let (name, value) = line.rsplit_once(' ').unwrap();
                assert!(value.parse::<f64>().is_ok(), "{line}");
                let family = name.split('{').next().unwrap();
                let family = ["_bucket", "_sum", "_count"].iter().find_map(|s| family.strip_suffix(s)).unwrap_or(family);
                assert!(typed.contains(family), "{line}");
            }
        }
        for wanted in [
            "stagepose_samples_total{state=\"searching\"} 1",
            "stagepose_frames_dropped_total 3",
            "stagepose_stage_seconds_bucket{stage=\"acquire\",le=\"0.02\"} 1",
            "stagepose_stage_seconds_bucket{stage=\"acquire\",le=\"0.015\"} 0",
            "stagepose_stage_seconds_count{stage=\"total\"} 1",
            "stagepose_frame_age_seconds_sum 0.007",
            "stagepose_last_frame_age_seconds 0.002",
        ] {
            assert!(page.body.lines().any(|l| l == wanted), "{wanted} is not in\n{}", page.body);
        }
    }
}
