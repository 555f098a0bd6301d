//! What the daemon's threads count: atomics, filled where things happen, read where they are shown.

use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU8, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use super::histogram::Histogram;
use crate::frame::Timestamp;
use crate::publish::FrameClock;
use crate::record::{PoseSample, State};

/// What is known of the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraState {
    /// It has not been found yet, or is gone.
    Waiting,
    /// It is open and gives pictures.
    Streaming,
    /// It is open, or was, and gives none.
    Silent,
}

/// What is known of the recorder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecorderState {
    /// Nothing is to be recorded.
    Off,
    /// It records.
    Recording,
    /// It gave up: the disk is full, or too slow.
    Stopped,
}

/// Counts and last values of a running daemon. Every method may be called from any thread and waits for nobody.
#[derive(Debug, Default)]
pub struct Statistics {
    states: [AtomicU64; State::ALL.len()],
    last_state: AtomicU8,
    undecodable: AtomicU64,
    skipped: AtomicU64,
    dropped: AtomicU64,
    device_dropped: AtomicU64,
    reconnects: AtomicU64,
    contained_panics: AtomicU64,
    streaming: AtomicBool,
    silent: AtomicBool,
    recorder: AtomicU8,
    recorded: AtomicU64,
    inliers: AtomicU64,
    rms_bits: AtomicU64,
    rate_bits: AtomicU64,
    last_frame_ns: AtomicI64,
    /// Decode, acquire, align, pose, total.
    stages: [Histogram; 5],
    age: Histogram,
    /// The camera's name; written at an opening, read for a page.
    camera: Mutex<String>,
}

/// The stages of the latency histograms.
pub(super) const STAGES: [&str; 5] = ["decode", "acquire", "align", "pose", "total"];

fn add(counter: &AtomicU64, n: u64) {
    counter.fetch_add(n, Ordering::Relaxed);
}

fn get(counter: &AtomicU64) -> u64 {
    counter.load(Ordering::Relaxed)
}

impl Statistics {
    /// Counts a sample, its times and its quality. A stale one counts as a state only.
    pub fn sample(&self, sample: &PoseSample) {
        add(&self.states[sample.state as usize], 1);
        self.last_state.store(sample.state as u8, Ordering::Relaxed);
        if sample.state == State::Stale {
            return;
        }
        self.last_frame_ns.store(sample.timestamp.ns(), Ordering::Relaxed);
        let t = &sample.times;
        let times = [t.decode_ms, t.acquire_ms, t.align_ms, t.pose_ms, t.acquire_ms + t.align_ms + t.pose_ms];
        self.stages.iter().zip(times).for_each(|(stage, ms)| stage.observe_ms(ms));
        if let Some(age_ms) = t.age_ms {
            self.age.observe_ms(age_ms);
        }
        let (inliers, rms_px) = sample.measurement.as_ref().map_or((0, 0.0), |m| (m.inliers, m.rms_px));
        self.inliers.store(inliers as u64, Ordering::Relaxed);
        self.rms_bits.store(rms_px.to_bits(), Ordering::Relaxed);
    }

    /// Counts a row that held no readable picture.
    pub fn undecodable_row(&self) {
        add(&self.undecodable, 1);
    }

    /// Counts a row that was not tracked for its stamp or its size.
    pub fn skipped_row(&self) {
        add(&self.skipped, 1);
    }

    /// Counts frames dropped because the tracker was late.
    pub fn frames_dropped(&self, n: u64) {
        add(&self.dropped, n);
    }

    /// Counts frames that the driver's own numbers say were lost before they came here.
    pub fn device_frames_dropped(&self, n: u64) {
        add(&self.device_dropped, n);
    }

    /// Notes that the camera streams; `again` where it was open before.
    pub fn camera_opened(&self, name: &str, again: bool) {
        add(&self.reconnects, u64::from(again));
        name.clone_into(&mut self.camera.lock().unwrap_or_else(PoisonError::into_inner));
        self.streaming.store(true, Ordering::Relaxed);
    }

    /// Notes that the camera is gone.
    pub fn camera_lost(&self) {
        self.streaming.store(false, Ordering::Relaxed);
    }

    /// Notes whether pictures fail to come.
    pub fn set_silent(&self, silent: bool) {
        self.silent.store(silent, Ordering::Relaxed);
    }

    /// Counts a panic that was contained.
    pub fn panic_contained(&self) {
        add(&self.contained_panics, 1);
    }

    /// Notes what the recorder does.
    pub fn set_recorder(&self, state: RecorderState) {
        self.recorder.store(state as u8, Ordering::Relaxed);
    }

    /// Counts a recorded frame.
    pub fn frame_recorded(&self) {
        add(&self.recorded, 1);
    }

    /// Notes the frame rate as measured, frames a second.
    pub fn set_rate(&self, fps: f64) {
        self.rate_bits.store(fps.to_bits(), Ordering::Relaxed);
    }

    /// Frames tracked so far, whatever became of them.
    pub fn frames(&self) -> u64 {
        State::ALL.iter().filter(|s| **s != State::Stale).map(|s| self.in_state(*s)).sum()
    }

    /// Samples in a state so far.
    pub fn in_state(&self, state: State) -> u64 {
        get(&self.states[state as usize])
    }

    /// The state of the last sample.
    pub fn last_state(&self) -> State {
        State::ALL.into_iter().find(|s| *s as u8 == self.last_state.load(Ordering::Relaxed)).unwrap_or_default()
    }

    /// Frames a second, as last measured.
    pub fn rate(&self) -> f64 {
        f64::from_bits(get(&self.rate_bits))
    }

    /// Rows without a readable picture so far.
    pub fn undecodable(&self) -> u64 {
        get(&self.undecodable)
    }

    /// Rows not tracked for their stamp or size so far.
    pub fn skipped(&self) -> u64 {
        get(&self.skipped)
    }

    /// Frames dropped so far because the tracker was late.
    pub fn dropped(&self) -> u64 {
        get(&self.dropped)
    }

    /// Frames lost so far before they came here.
    pub fn device_dropped(&self) -> u64 {
        get(&self.device_dropped)
    }

    /// How often the camera was opened again.
    pub fn reconnects(&self) -> u64 {
        get(&self.reconnects)
    }

    /// Panics contained so far.
    pub fn contained_panics(&self) -> u64 {
        get(&self.contained_panics)
    }

    /// Frames recorded so far.
    pub fn recorded(&self) -> u64 {
        get(&self.recorded)
    }

    /// Inliers of the last frame; 0 where it was not tracked.
    pub fn inliers(&self) -> u64 {
        get(&self.inliers)
    }

    /// Residual of the last frame, pixels; 0 where it was not tracked.
    pub fn rms_px(&self) -> f64 {
        f64::from_bits(get(&self.rms_bits))
    }

    /// What is known of the camera.
    pub fn camera(&self) -> CameraState {
        match (self.streaming.load(Ordering::Relaxed), self.silent.load(Ordering::Relaxed)) {
            (false, _) => CameraState::Waiting,
            (true, true) => CameraState::Silent,
            (true, false) => CameraState::Streaming,
        }
    }

    /// The camera's name; empty before it was found.
    pub fn camera_name(&self) -> String {
        self.camera.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// What is known of the recorder.
    pub fn recorder(&self) -> RecorderState {
        match self.recorder.load(Ordering::Relaxed) {
            1 => RecorderState::Recording,
            2 => RecorderState::Stopped,
            _ => RecorderState::Off,
        }
    }

    /// How long ago the last tracked frame was taken, by the clock that the outputs judge by; none before the first.
    pub fn last_frame_age(&self, clock: &FrameClock) -> Option<Duration> {
        let stamp = Some(self.last_frame_ns.load(Ordering::Relaxed)).filter(|ns| *ns != 0).map(Timestamp::from_ns)?;
        let taken = clock.taken(stamp, Duration::ZERO)?;
        Some(clock.now().boot.duration_since(taken))
    }

    /// How old frames were when tracking them began.
    pub fn age(&self) -> &Histogram {
        &self.age
    }

    /// The stages' names and times.
    pub(super) fn stages(&self) -> impl Iterator<Item = (&'static str, &Histogram)> {
        STAGES.into_iter().zip(&self.stages)
    }
}
