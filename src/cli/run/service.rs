//! Makes `run` a good service: it reports its status to the service manager and the terminal, once
//! a second.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use super::notify::Notifier;
use crate::cli::angles::angle_words;
use crate::cli::{interrupt, logging};
use crate::daemon::live::LiveLink;
use crate::geometry::{Camera, Pose, Stage};
use crate::record::{PoseSample, State};
use crate::telemetry::{CameraState, RecorderState, Statistics};

/// The service side of the daemon.
pub(super) struct Service {
    notifier: Notifier,
    line: ProgressBar,
    /// Start of the running time: the start of tracking, and before that the start of the program.
    begun: Instant,
    is_tracking: bool,
    until: Option<Duration>,
    reported_at: Instant,
    pinged: Instant,
    frames_before: u64,
    /// Count and sum of the ages reported so far.
    ages_before: (u64, f64),
    /// The pipeline's last sign of life.
    alive: Instant,
    /// The last sample's pose.
    pose: Option<Pose<Stage, Camera>>,
}

impl Service {
    /// Sends READY; `seconds` is the running time after which to end.
    pub fn start(seconds: Option<f64>) -> Self {
        let notifier = Notifier::from_environment();
        notifier.send("READY=1\nSTATUS=waiting for the camera");
        let line = if std::io::stderr().is_terminal() { ProgressBar::new_spinner() } else { ProgressBar::hidden() };
        line.set_style(ProgressStyle::with_template("{msg}").unwrap_or_else(|_| ProgressStyle::default_spinner()));
        logging::beside(&line);
        let now = Instant::now();
        let until = seconds.map(|s| Duration::try_from_secs_f64(s.max(0.0)).unwrap_or(Duration::MAX));
        Self {
            notifier,
            line,
            begun: now,
            is_tracking: false,
            until,
            reported_at: now,
            pinged: now,
            frames_before: 0,
            ages_before: (0, 0.0),
            alive: now,
            pose: None,
        }
    }

    /// Notes a sign of life from the pipeline: a sample, a stale message, or waiting for a camera.
    pub fn alive(&mut self) {
        self.alive = Instant::now();
    }

    /// Starts the running time when the camera is there and tracking begins, so that the requested
    /// part of a played clip is tracked. A later session does not restart it.
    pub fn tracking_begins(&mut self) {
        self.alive();
        if !std::mem::replace(&mut self.is_tracking, true) {
            self.begun = Instant::now();
        }
    }

    /// Notes a sample.
    pub fn seen(&mut self, sample: &PoseSample) {
        self.alive();
        self.pose = sample.pose;
    }

    /// Whether it is time to end.
    pub fn is_over(&self) -> bool {
        interrupt::is_interrupted() || self.until.is_some_and(|until| self.begun.elapsed() >= until)
    }

    /// Does what is due; call it often.
    pub fn tick(&mut self, link: &LiveLink) {
        if let Some(every) = self.notifier.watchdog
            && self.pinged.elapsed() >= every.min(Duration::from_secs(1))
            && self.alive.elapsed() < every.max(Duration::from_secs(2))
        {
            self.pinged = Instant::now();
            self.notifier.send("WATCHDOG=1");
        }
        let since = self.reported_at.elapsed();
        if since < Duration::from_secs(1) {
            return;
        }
        let frames = link.statistics.frames();
        link.statistics.set_rate((frames - self.frames_before.min(frames)) as f64 / since.as_secs_f64());
        (self.frames_before, self.reported_at) = (frames, Instant::now());
        let status = status(&link.statistics, self.ages_before, self.pose.as_ref());
        self.ages_before = (link.statistics.age().count(), link.statistics.age().sum_s());
        self.notifier.send(&format!("STATUS={status}"));
        self.line.set_message(status);
        self.line.tick();
    }

    /// Reports that a new config is being applied.
    pub fn reloading(&self) {
        self.notifier.send("STATUS=loading a new config");
    }

    /// Reports the end.
    pub fn end(&self) {
        self.notifier.send("STOPPING=1\nSTATUS=ending");
        self.line.finish_and_clear();
    }
}

/// Returns the status line: state, pose, rate, mean age since the last one, quality, losses.
fn status(s: &Statistics, ages_before: (u64, f64), pose: Option<&Pose<Stage, Camera>>) -> String {
    let mut text = match s.camera() {
        CameraState::Waiting => "waiting for the camera".to_owned(),
        CameraState::Silent => "the camera gives no pictures".to_owned(),
        CameraState::Streaming => s.last_state().word().to_owned(),
    };
    if let Some(pose) = pose.filter(|_| matches!(s.last_state(), State::Tracking | State::Coasting)) {
        let p = pose.translation;
        text += &format!(" at {:+.3} {:+.3} {:+.3} m, {}", p.x, p.y, p.z, angle_words(pose));
    }
    text += &format!(", {:.1} frames/s", s.rate());
    let (count, sum_s) = (s.age().count().saturating_sub(ages_before.0), s.age().sum_s() - ages_before.1);
    if count > 0 {
        text += &format!(", age {:.0} ms", 1e3 * sum_s / count as f64);
    }
    if s.last_state() == State::Tracking {
        text += &format!(", {} inliers, rms {:.2} px", s.inliers(), s.rms_px());
    }
    for (count, what) in [(s.dropped.get(), "dropped"), (s.undecodable.get(), "unreadable"), (s.reconnects.get(), "reconnects")] {
        if count > 0 {
            text += &format!(", {count} {what}");
        }
    }
    match s.recorder() {
        RecorderState::Off => {}
        RecorderState::Recording => text += ", recording",
        RecorderState::Stopped => text += ", RECORDING STOPPED",
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_status_line_reports_state_rate_age_and_recording() {
        let s = Statistics::default();
        assert_eq!(status(&s, (0, 0.0), None), "waiting for the camera, 0.0 frames/s");
        s.camera_opened("Cam", false);
        let mut sample = PoseSample::stale(0, crate::frame::Timestamp::from_ns(5), 12.0);
        sample.state = State::Tracking;
        s.sample(&sample);
        s.dropped.add(2);
        s.set_rate(29.97);
        s.set_recorder(RecorderState::Stopped);
        assert_eq!(status(&s, (0, 0.0), None), "tracking, 30.0 frames/s, age 12 ms, 0 inliers, rms 0.00 px, 2 dropped, RECORDING STOPPED");
        assert!(status(&s, (1, 0.012), None).starts_with("tracking, 30.0 frames/s, 0 inliers"));
        let rotation = nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
        let pose = Pose::new(rotation, nalgebra::Vector3::new(0.5, -4.0, 1.6));
        let wanted = "tracking at +0.500 -4.000 +1.600 m, pan +0.00 tilt +0.00 roll +0.00 degrees, 30.0 frames/s";
        assert!(status(&s, (0, 0.0), Some(&pose)).starts_with(wanted));
    }
}
