//! Publishes poses while a command runs: to the config's outputs and to the HTTP server's clients.

use std::sync::Arc;

use super::failure::Failure;
use super::pages::Pages;
use crate::camera::CameraModel;
use crate::config::{HttpSettings, Settings};
use crate::publish::{Context, HeardRings, OutputSettings, OutputStatistics, PoseWithheld, Publisher, Stamps};
use crate::record::PoseSample;
use crate::timecode::TimecodeSource;

/// The running outputs and the HTTP server.
pub(super) struct Outputs {
    publisher: Publisher,
    pages: Pages,
}

impl Outputs {
    /// Starts the config's outputs, and an HTTP server if requested, for samples of this camera.
    pub fn start(
        settings: &Settings,
        http: Option<&HttpSettings>,
        camera: CameraModel,
        stamps: Stamps,
        timecode: Option<Arc<TimecodeSource>>,
        rings: Option<Arc<HeardRings>>,
        frame_rate: Option<f64>,
    ) -> Result<Self, Failure> {
        let objects = settings.objects.iter().map(|object| object.name.clone()).collect();
        let (mount, safety) = (settings.mount.clone(), settings.safety);
        Self::open(
            &settings.outputs,
            http,
            &Context { camera, objects, mount, safety, stamps, timecode, rings, frame_rate, is_test: false },
        )
    }

    /// As [`start`](Self::start), from what sending needs.
    pub fn open(outputs: &[OutputSettings], http: Option<&HttpSettings>, context: &Context) -> Result<Self, Failure> {
        let publisher = Publisher::start(outputs, context)?;
        Ok(Self { publisher, pages: Pages::start(http, &context.safety, context.stamps.clone(), None)? })
    }

    /// Sends a sample to all; never waits.
    pub fn send(&self, sample: &PoseSample) {
        self.publisher.send(sample);
        self.pages.publish(sample);
    }

    /// Returns how long the slowest output last took to send a sample, milliseconds.
    pub fn slowest_ms(&self) -> Option<f64> {
        self.publisher.slowest_us().map(|us| us as f64 * 1e-3)
    }

    /// Returns a function that reports the outputs' statistics to the HTTP server.
    pub fn watch(&self) -> impl Fn() -> Vec<OutputStatistics> + Send + Sync + 'static {
        self.publisher.watch()
    }

    /// Returns the poses that the safety limits have withheld since the last call.
    pub fn withheld(&self) -> impl Iterator<Item = PoseWithheld> + '_ {
        self.publisher.events().try_iter()
    }

    /// Sends what is queued and logs each output's statistics.
    pub fn close(self) {
        for output in self.publisher.close() {
            let (name, sent, failed) = (&output.name, output.sent, output.failed);
            let (dropped, withheld, late) = (output.dropped, output.withheld, output.greatest_latency_us);
            tracing::info!(
                "output {name}: {sent} packets sent, {failed} failed, {dropped} samples dropped, {withheld} poses withheld, at most {late} µs late"
            );
        }
    }
}
