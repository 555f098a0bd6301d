//! Statistics of the daemon's threads: atomics, updated at the source and read when shown.

use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use super::budget::{Budget, MeanTimes};
use super::histogram::Histogram;
use super::other_tracker::OtherTrackerStatus;
use crate::camera::KnownShutter;
use crate::frame::Timestamp;
use crate::publish::FrameClock;
use crate::record::{PoseSample, State};
use crate::timecode::TimecodeSource;
use crate::track::LearntCamera;

/// The state of the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraState {
    /// It has not been found yet, or is gone.
    Waiting,
    /// It is open and delivers pictures.
    Streaming,
    /// It is open, or was, and delivers none.
    Silent,
}

/// The state of the recorder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecorderState {
    /// Nothing is to be recorded.
    Off,
    /// It records.
    Recording,
    /// It gave up: the disk is full, or too slow.
    Stopped,
}

/// A number that only grows.
#[derive(Debug, Default)]
pub struct Counter(AtomicU64);

impl Counter {
    /// Adds `n`.
    pub fn add(&self, n: u64) {
        self.0.fetch_add(n, Ordering::Relaxed);
    }

    /// Returns the count so far.
    pub fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// Counts and last values of a running daemon. Every method may be called from any thread and never
/// waits long.
#[derive(Debug, Default)]
pub struct Statistics {
    states: [Counter; State::ALL.len()],
    last_state: AtomicU8,
    /// Rows without a readable picture.
    pub undecodable: Counter,
    /// Rows that were not tracked because of their stamp or size.
    pub skipped: Counter,
    /// Frames dropped because the tracker was late.
    pub dropped: Counter,
    /// Frames lost before they arrived, by the driver's own numbers.
    pub device_dropped: Counter,
    /// How often the camera was reopened.
    pub reconnects: Counter,
    /// Contained panics.
    pub contained_panics: Counter,
    /// Frames recorded.
    pub recorded: Counter,
    /// Frames whose picture was copied for a viewer.
    pub viewed: Counter,
    streaming: AtomicBool,
    silent: AtomicBool,
    recorder: AtomicU8,
    inliers: AtomicU64,
    rms_bits: AtomicU64,
    rate_bits: AtomicU64,
    last_frame_ns: AtomicI64,
    /// Decode, acquire, align, pose, total.
    stages: [Histogram; 5],
    age: Histogram,
    send: Histogram,
    /// What is known of the camera's shutter, by the config and its driver.
    shutter: Mutex<KnownShutter>,
    /// The camera's name; written when it is opened, read for a page.
    camera: Mutex<String>,
    /// What has been learnt of the camera, as of the last sample.
    learnt: Mutex<LearntCamera>,
    timecode: Mutex<Option<Arc<TimecodeSource>>>,
    other_tracker: Mutex<Option<OtherTrackerStatus>>,
}

/// The stages of the latency histograms, in their storage order.
pub const STAGES: [&str; 5] = ["decode", "acquire", "align", "pose", "total"];

impl Statistics {
    /// Counts a sample, its times and its quality. A stale one counts only as a state.
    pub fn sample(&self, sample: &PoseSample) {
        self.states[sample.state as usize].add(1);
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
        let evidence = sample.measurement.as_ref().and_then(|m| m.inliers.zip(m.rms_px));
        let (inliers, rms_px) = evidence.unwrap_or_default();
        self.inliers.store(inliers as u64, Ordering::Relaxed);
        self.rms_bits.store(rms_px.to_bits(), Ordering::Relaxed);
        *self.learnt.lock().unwrap_or_else(PoisonError::into_inner) = sample.learnt;
    }

    /// Returns what has been learnt of the camera, as of the last sample.
    pub fn learnt(&self) -> LearntCamera {
        *self.learnt.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes what config and driver say of the camera's shutter.
    pub fn set_shutter(&self, shutter: KnownShutter) {
        *self.shutter.lock().unwrap_or_else(PoisonError::into_inner) = shutter;
    }

    /// Notes how long the slowest output took from a sample to its last packet, milliseconds.
    pub fn sent_after_ms(&self, ms: f64) {
        self.send.observe_ms(ms);
    }

    /// Returns where the time between a pose's instant and its packet goes.
    pub fn budget(&self) -> Budget {
        let shutter = *self.shutter.lock().unwrap_or_else(PoisonError::into_inner);
        let [decode, .., total] = &self.stages;
        let times = MeanTimes { age_s: self.age.mean_s(), decode_s: decode.mean_s(), track_s: total.mean_s(), send_s: self.send.mean_s() };
        Budget::of(&shutter, &self.learnt(), &times)
    }

    /// Notes where timecode comes from; `None` without `[timecode]`.
    pub fn set_timecode(&self, source: Option<Arc<TimecodeSource>>) {
        *self.timecode.lock().unwrap_or_else(PoisonError::into_inner) = source;
    }

    /// Returns where timecode comes from.
    pub fn timecode(&self) -> Option<Arc<TimecodeSource>> {
        self.timecode.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Notes what is known of the other tracker; `None` without `[other_tracker]`.
    pub fn set_other_tracker(&self, status: Option<OtherTrackerStatus>) {
        *self.other_tracker.lock().unwrap_or_else(PoisonError::into_inner) = status;
    }

    /// Returns what is known of the other tracker.
    pub fn other_tracker(&self) -> Option<OtherTrackerStatus> {
        self.other_tracker.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Notes that the camera streams; `again` if it had been open before.
    pub fn camera_opened(&self, name: &str, again: bool) {
        self.reconnects.add(u64::from(again));
        name.clone_into(&mut self.camera.lock().unwrap_or_else(PoisonError::into_inner));
        self.streaming.store(true, Ordering::Relaxed);
    }

    /// Notes that the camera is gone.
    pub fn camera_lost(&self) {
        self.streaming.store(false, Ordering::Relaxed);
    }

    /// Notes whether pictures are missing.
    pub fn set_silent(&self, silent: bool) {
        self.silent.store(silent, Ordering::Relaxed);
    }

    /// Notes the recorder's state.
    pub fn set_recorder(&self, state: RecorderState) {
        self.recorder.store(state as u8, Ordering::Relaxed);
    }

    /// Notes the measured frame rate, frames per second.
    pub fn set_rate(&self, fps: f64) {
        self.rate_bits.store(fps.to_bits(), Ordering::Relaxed);
    }

    /// Returns the number of frames so far, tracked or not.
    pub fn frames(&self) -> u64 {
        State::ALL.iter().filter(|s| **s != State::Stale).map(|s| self.in_state(*s)).sum()
    }

    /// Returns the number of samples in a state so far.
    pub fn in_state(&self, state: State) -> u64 {
        self.states[state as usize].get()
    }

    /// Returns the state of the last sample.
    pub fn last_state(&self) -> State {
        State::ALL.into_iter().find(|s| *s as u8 == self.last_state.load(Ordering::Relaxed)).unwrap_or_default()
    }

    /// Returns the measured frame rate, frames per second.
    pub fn rate(&self) -> f64 {
        f64::from_bits(self.rate_bits.load(Ordering::Relaxed))
    }

    /// Returns the last frame's inliers; 0 if it was not tracked.
    pub fn inliers(&self) -> u64 {
        self.inliers.load(Ordering::Relaxed)
    }

    /// Returns the last frame's residual, pixels; 0 if it was not tracked.
    pub fn rms_px(&self) -> f64 {
        f64::from_bits(self.rms_bits.load(Ordering::Relaxed))
    }

    /// Returns the state of the camera.
    pub fn camera(&self) -> CameraState {
        match (self.streaming.load(Ordering::Relaxed), self.silent.load(Ordering::Relaxed)) {
            (false, _) => CameraState::Waiting,
            (true, true) => CameraState::Silent,
            (true, false) => CameraState::Streaming,
        }
    }

    /// Returns the camera's name; empty before it was found.
    pub fn camera_name(&self) -> String {
        self.camera.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Returns the state of the recorder.
    pub fn recorder(&self) -> RecorderState {
        match self.recorder.load(Ordering::Relaxed) {
            1 => RecorderState::Recording,
            2 => RecorderState::Stopped,
            _ => RecorderState::Off,
        }
    }

    /// Returns the last tracked frame's age, by the clock that the outputs use; `None` before the
    /// first.
    pub fn last_frame_age(&self, clock: &FrameClock) -> Option<Duration> {
        let stamp = Some(self.last_frame_ns.load(Ordering::Relaxed)).filter(|ns| *ns != 0).map(Timestamp::from_ns)?;
        let taken = clock.taken(stamp, Duration::ZERO)?;
        Some(clock.now().boot.duration_since(taken))
    }

    /// Returns the frames' ages when tracking them began.
    pub fn age(&self) -> &Histogram {
        &self.age
    }

    /// Returns the stages' names and times.
    pub(super) fn stages(&self) -> impl Iterator<Item = (&'static str, &Histogram)> {
        STAGES.into_iter().zip(&self.stages)
    }
}
