//! Counts and times of a whole replay: the summary (contract C4) and the table at the end.

use std::fmt::Write as _;
use std::io::{self, Write};
use std::path::Path;
use std::time::Instant;

use nix::sys::resource::{UsageWho, getrusage};
use nix::sys::time::TimeValLike;
use serde::Serialize;

use crate::camera::KnownShutter;
use crate::cli::angles::camera_words;
use crate::cli::failure::Failure;
use crate::cli::outcome::{ByWord, Outcome};
use crate::geometry::{Camera, Pose, Stage};
use crate::record::{PoseSample, StageTimes, State};
use crate::telemetry::STAGES;
use crate::track::{LearntCamera, LearntTime};

/// The result of a replay, accumulated by sample.
pub(super) struct Tally {
    started: Instant,
    states: [u64; 5],
    outcome: Outcome,
    undecodable: u64,
    skipped: u64,
    first_pose_ms: Option<f64>,
    shutter: KnownShutter,
    learnt_from: &'static str,
    /// What is known of the camera so far.
    learnt: LearntCamera,
    /// The last measured pose and its row.
    last: Option<(u64, Pose<Stage, Camera>)>,
    /// Decode, acquire, align, pose and total times of every row, milliseconds.
    times: [Vec<f64>; 5],
}

#[derive(Serialize)]
struct Summary {
    frames: u64,
    tracking: u64,
    searching: u64,
    coasting: u64,
    lost: u64,
    undecodable: u64,
    skipped: u64,
    /// Number of untracked frames by reason.
    reasons: ByWord<u64>,
    stage_ms: ByWord<Percentiles>,
    /// The shutter in use at the end.
    learnt: Learnt,
    cpu_s: f64,
    first_pose_ms: Option<f64>,
    peak_rss_mb: f64,
}

/// The shutter as configured (sigma 0) or learnt; `None` if unknown.
#[derive(Serialize)]
struct Learnt {
    readout_s: Option<f64>,
    readout_sigma_s: Option<f64>,
    exposure_s: Option<f64>,
    exposure_sigma_s: Option<f64>,
    /// The source of what was known before the first row: `nothing`, `clip` or `file`.
    from: &'static str,
}

/// Nearest-rank percentiles in milliseconds; `None` without values.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub(super) struct Percentiles {
    p50: Option<f64>,
    p95: Option<f64>,
    p99: Option<f64>,
    max: Option<f64>,
}

impl Percentiles {
    fn of(values: &[f64]) -> Self {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let rank = |percent: usize| sorted.get((sorted.len() * percent).div_ceil(100).saturating_sub(1)).copied();
        Self { p50: rank(50), p95: rank(95), p99: rank(99), max: sorted.last().copied() }
    }
}

impl Tally {
    /// Starts with no samples; `started` is when the process began.
    pub fn new(started: Instant, shutter: KnownShutter, learnt_from: &'static str) -> Self {
        Self {
            started,
            shutter,
            learnt_from,
            learnt: LearntCamera::default(),
            states: [0; 5],
            outcome: Outcome::default(),
            undecodable: 0,
            skipped: 0,
            first_pose_ms: None,
            last: None,
            times: Default::default(),
        }
    }

    /// Counts one sample.
    pub fn add(&mut self, sample: &PoseSample) {
        self.states[sample.state as usize] += 1;
        self.outcome.add(sample);
        self.learnt = sample.learnt;
        if sample.state == State::Tracking && self.first_pose_ms.is_none() {
            self.first_pose_ms = Some(self.started.elapsed().as_secs_f64() * 1e3);
        }
        if let (State::Tracking, Some(pose)) = (sample.state, sample.pose) {
            self.last = Some((sample.sequence, pose));
        }
        let StageTimes { decode_ms, acquire_ms, align_ms, pose_ms, .. } = sample.times;
        let row = [decode_ms, acquire_ms, align_ms, pose_ms, acquire_ms + align_ms + pose_ms];
        self.times.iter_mut().zip(row).for_each(|(times, ms)| times.push(ms));
    }

    /// Sets the number of rows without a frame to track.
    pub fn set_rows(&mut self, undecodable: u64, skipped: u64) {
        (self.undecodable, self.skipped) = (undecodable, skipped);
    }

    /// Returns the number of rows so far.
    pub fn frames(&self) -> u64 {
        self.states.iter().sum()
    }

    fn state(&self, state: State) -> u64 {
        self.states[state as usize]
    }

    fn summary(&self) -> Summary {
        let (cpu_s, peak_rss_mb) = usage();
        Summary {
            frames: self.frames(),
            tracking: self.state(State::Tracking),
            searching: self.state(State::Searching),
            coasting: self.state(State::Coasting),
            lost: self.state(State::Lost),
            undecodable: self.undecodable,
            skipped: self.skipped,
            reasons: self.outcome.counts(),
            stage_ms: ByWord(STAGES.into_iter().zip(self.times.iter().map(|times| Percentiles::of(times))).collect()),
            learnt: self.learnt(),
            cpu_s,
            first_pose_ms: self.first_pose_ms,
            peak_rss_mb,
        }
    }

    fn learnt(&self) -> Learnt {
        let known = |configured_s: Option<f64>, learnt: Option<LearntTime>| {
            let configured = configured_s.map(|seconds| LearntTime { seconds, sigma_s: 0.0 });
            configured.or(learnt).map_or((None, None), |time| (Some(time.seconds), Some(time.sigma_s)))
        };
        let (readout_s, readout_sigma_s) = known(self.shutter.readout_s, self.learnt.readout);
        let (exposure_s, exposure_sigma_s) = known(self.shutter.exposure_s, self.learnt.exposure);
        Learnt { readout_s, readout_sigma_s, exposure_s, exposure_sigma_s, from: self.learnt_from }
    }

    /// Returns the summary as JSON (contract C4).
    pub fn summary_json(&self) -> String {
        // Serialising to a string fails only for non-string map keys, and a summary has none.
        serde_json::to_string_pretty(&self.summary()).expect("a summary has only string keys")
    }

    fn table(&self) -> String {
        let summary = self.summary();
        let share = |n: u64| 100.0 * n as f64 / summary.frames.max(1) as f64;
        let mut table = format!("frames    {:>7}", summary.frames);
        if summary.undecodable + summary.skipped > 0 {
            let _ = write!(table, "   ({} undecodable, {} skipped)", summary.undecodable, summary.skipped);
        }
        let states =
            [("tracking", summary.tracking), ("coasting", summary.coasting), ("searching", summary.searching), ("lost", summary.lost)];
        for (name, count) in states {
            let _ = write!(table, "\n{name:<10}{count:>7} {:>6.1} %", share(count));
        }
        let _ = write!(table, "\n\nms a frame    p50      p95      p99      max");
        for (name, p) in &summary.stage_ms.0 {
            let _ = write!(table, "\n{name:<8}");
            for value in [p.p50, p.p95, p.p99, p.max] {
                let _ = write!(table, "{:>9}", value.map_or("-".to_owned(), |ms| format!("{ms:.2}")));
            }
        }
        let first = summary.first_pose_ms.map_or("never".to_owned(), |ms| format!("after {ms:.0} ms"));
        let _ = write!(table, "\n\nfirst pose {first}, {:.1} s of processor time, {:.0} MB at most", summary.cpu_s, summary.peak_rss_mb);
        if let Some((sequence, pose)) = &self.last {
            let [x, y, z, w] = pose.orientation_xyzw();
            let _ = write!(table, "\nlast pose {} (frame {sequence}; quaternion {x:.4} {y:.4} {z:.4} {w:.4})", camera_words(pose));
        }
        let _ = write!(table, "\n\n{}", self.outcome.sentences());
        table
    }
}

/// Returns this process's CPU seconds and peak memory in megabytes so far.
fn usage() -> (f64, f64) {
    let Ok(usage) = getrusage(UsageWho::RUSAGE_SELF) else { return (0.0, 0.0) };
    let cpu_us = usage.user_time().num_microseconds() + usage.system_time().num_microseconds();
    // Linux counts the peak in KiB.
    (cpu_us as f64 / 1e6, usage.max_rss() as f64 * 1024.0 / 1e6)
}

/// Prints the table to stdout, or to stderr if stdout holds records.
pub(super) fn print_table(tally: &Tally, stdout_taken: bool) -> Result<(), Failure> {
    let table = tally.table();
    let (written, name) = match stdout_taken {
        true => (writeln!(io::stderr(), "{table}"), "stderr"),
        false => (writeln!(io::stdout(), "{table}"), "stdout"),
    };
    written.map_err(Failure::output(Path::new(name)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::Reason;

    fn sample(state: State, ms: f64) -> PoseSample {
        let times = StageTimes { decode_ms: 1.0, acquire_ms: ms, align_ms: 2.0, pose_ms: 0.5, age_ms: None };
        PoseSample {
            sequence: 0,
            timestamp: Default::default(),
            state,
            pose: None,
            measurement: None,
            objects: Vec::new(),
            reason: None,
            learnt: Default::default(),
            times,
        }
    }

    #[test]
    fn percentiles_are_nearest_rank() {
        let values: Vec<f64> = (1..=100).rev().map(f64::from).collect();
        let wanted = Percentiles { p50: Some(50.0), p95: Some(95.0), p99: Some(99.0), max: Some(100.0) };
        assert_eq!(Percentiles::of(&values), wanted);
        assert_eq!(Percentiles::of(&[7.0]), Percentiles { p50: Some(7.0), p95: Some(7.0), p99: Some(7.0), max: Some(7.0) });
        assert_eq!(Percentiles::of(&[]), Percentiles::default());
    }

    #[test]
    fn the_summary_has_every_field_of_the_contract() {
        let mut tally = Tally::new(Instant::now(), KnownShutter::default(), "nothing");
        [State::Searching, State::Searching, State::Tracking, State::Coasting, State::Lost]
            .iter()
            .for_each(|s| tally.add(&sample(*s, 10.0)));
        tally.set_rows(1, 2);
        let json: serde_json::Value = serde_json::from_str(&tally.summary_json()).unwrap();
        let counts = [("frames", 5), ("tracking", 1), ("searching", 2), ("coasting", 1), ("lost", 1), ("undecodable", 1), ("skipped", 2)];
        for (key, count) in counts {
            assert_eq!(json[key], count, "{key}");
        }
        for stage in STAGES {
            for percentile in ["p50", "p95", "p99", "max"] {
                assert!(json["stage_ms"][stage][percentile].is_f64(), "{stage} {percentile}");
            }
        }
        assert_eq!(json["stage_ms"]["total"]["max"], 12.5);
        assert!(json["first_pose_ms"].as_f64().unwrap() > 0.0 && json["peak_rss_mb"].as_f64().unwrap() > 1.0 && json["cpu_s"].is_f64());
    }

    #[test]
    fn the_summary_reports_the_shutter_used_for_the_poses() {
        let configured = KnownShutter { readout_s: Some(0.01), exposure_s: None };
        let mut tally = Tally::new(Instant::now(), configured, "clip");
        let mut learnt = sample(State::Tracking, 1.0);
        learnt.learnt.exposure = Some(LearntTime { seconds: 0.012, sigma_s: 0.001 });
        tally.add(&learnt);
        let json: serde_json::Value = serde_json::from_str(&tally.summary_json()).unwrap();
        let wanted = serde_json::json!({
            "readout_s": 0.01, "readout_sigma_s": 0.0, "exposure_s": 0.012, "exposure_sigma_s": 0.001, "from": "clip"
        });
        assert_eq!(json["learnt"], wanted);
    }

    #[test]
    fn every_untracked_frame_is_counted_under_its_reason() {
        let mut tally = Tally::new(Instant::now(), KnownShutter::default(), "nothing");
        tally.add(&sample(State::Tracking, 1.0));
        for reason in [Reason::TooDark, Reason::Covered, Reason::TooDark] {
            tally.add(&PoseSample { reason: Some(reason), ..sample(State::Lost, 1.0) });
        }
        let json: serde_json::Value = serde_json::from_str(&tally.summary_json()).unwrap();
        assert_eq!(json["reasons"], serde_json::json!({"too_dark": 2, "covered": 1}));
        assert!(tally.table().contains("The picture is recognised in 2 of 4 frames and tracked in 1. In 2 frames the frame is too dark"));
    }

    #[test]
    fn without_a_pose_the_first_one_is_null() {
        let tally = Tally::new(Instant::now(), KnownShutter::default(), "nothing");
        let json: serde_json::Value = serde_json::from_str(&tally.summary_json()).unwrap();
        assert!(json["first_pose_ms"].is_null());
        assert!(tally.table().contains("first pose never") && !tally.table().contains("last pose"));
    }

    #[test]
    fn the_last_pose_is_reported_in_degrees_and_as_a_quaternion() {
        let mut tally = Tally::new(Instant::now(), KnownShutter::default(), "nothing");
        let mut tracked = sample(State::Tracking, 1.0);
        let rotation = nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
        tracked.pose = Some(Pose::new(rotation, nalgebra::Vector3::new(0.5, -4.0, 1.6)));
        tally.add(&tracked);
        let wanted = "last pose at +0.5000 -4.0000 +1.6000 m, pan +0.00 tilt +0.00 roll +0.00 degrees (frame 0; quaternion -0.7071 0.0000 0.0000 0.7071)";
        assert!(tally.table().contains(wanted), "{}", tally.table());
    }
}
