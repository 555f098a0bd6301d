//! Where poses go while a command runs: the config's outputs, and the clients of the HTTP server.

#[cfg(feature = "http")]
use std::sync::Arc;

use super::failure::Failure;
use crate::camera::CameraModel;
use crate::config::{SendingSettings, Settings};
#[cfg(feature = "http")]
use crate::publish::FrameClock;
use crate::publish::{Context, PoseWithheld, Publisher, Stamps};
use crate::record::PoseSample;
#[cfg(feature = "http")]
use crate::web::Server;

/// The running outputs, and the HTTP server beside them.
pub(super) struct Outputs {
    publisher: Publisher,
    #[cfg(feature = "http")]
    server: Option<Server>,
}

impl Outputs {
    /// Starts what the config has, for samples of this camera.
    pub fn start(settings: &Settings, camera: CameraModel, stamps: Stamps, frame_rate: Option<f64>) -> Result<Self, Failure> {
        let sending = SendingSettings {
            camera: Some(camera),
            missing_calibration: None,
            outputs: settings.outputs.clone(),
            objects: settings.objects.iter().map(|object| object.name.clone()).collect(),
            mount: settings.mount.clone(),
            safety: settings.safety,
            http: settings.http.clone(),
            log: settings.log,
        };
        let (objects, mount) = (sending.objects.clone(), sending.mount.clone());
        let context = Context { camera, objects, mount, safety: sending.safety, stamps, frame_rate, is_test: false };
        Self::open(&sending, &context)
    }

    /// The outputs alone, for a live camera: its server is started before it is found.
    pub fn live(settings: &Settings, camera: CameraModel, frame_rate: f64) -> Result<Self, Failure> {
        let outputs_only = Settings { http: None, ..settings.clone() };
        Self::start(&outputs_only, camera, Stamps::Live, Some(frame_rate))
    }

    /// The same, from what belongs to sending alone.
    pub fn open(settings: &SendingSettings, context: &Context) -> Result<Self, Failure> {
        let publisher = Publisher::start(&settings.outputs, context)?;
        #[cfg(feature = "http")]
        let server = {
            let started = settings.http.as_ref().map(|http| Server::start(http, Vec::new())).transpose();
            let server = started.map_err(|e| Failure::Publishing(e.to_string()))?;
            if let Some(server) = &server {
                server.judge_ages(Arc::new(FrameClock::new(context.stamps.clone())), context.safety.stale_after);
            }
            server
        };
        #[cfg(not(feature = "http"))]
        if settings.http.is_some() {
            tracing::warn!("[http]: this build has no HTTP server; build it with the feature `http`");
        }
        Ok(Self {
            publisher,
            #[cfg(feature = "http")]
            server,
        })
    }

    /// Tells everybody; never waits.
    pub fn send(&self, sample: &PoseSample) {
        self.publisher.send(sample);
        #[cfg(feature = "http")]
        if let Some(server) = &self.server {
            server.publish(sample);
        }
    }

    /// Poses that the safety limits began to hold back since the last call.
    pub fn withheld(&self) -> impl Iterator<Item = PoseWithheld> + '_ {
        self.publisher.events().try_iter()
    }

    /// Sends what is left and says how it went.
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
