//! The HTTP server beside a command: pose and state as the server gives them, and what `run` adds: health, metrics, and the call that saves
//! the ring.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::failure::Failure;
use crate::capture::ClipEntry;
use crate::config::HttpSettings;
use crate::daemon::live::LiveLink;
use crate::publish::{SafetySettings, Stamps};
use crate::record::PoseSample;
use crate::tracker::TrackerSetup;
#[cfg(feature = "http")]
use crate::{publish::FrameClock, web};

/// The running server, where the config has one.
pub(super) struct Pages {
    #[cfg(feature = "http")]
    server: Option<web::Server>,
}

/// What `run` counts, and what the call that asks for the ring switches on.
pub(super) type OfRun<'a> = (&'a LiveLink, &'a Arc<AtomicBool>);

impl Pages {
    /// Starts the server; it judges the age of a pose by the clock that `stamps` are of.
    #[cfg(feature = "http")]
    pub fn start(http: Option<&HttpSettings>, safety: &SafetySettings, stamps: Stamps, run: Option<OfRun<'_>>) -> Result<Self, Failure> {
        let Some(http) = http else { return Ok(Self { server: None }) };
        // One clock for all pages: it is asked often enough to notice a suspend while nobody reads them.
        let clock = Arc::new(FrameClock::new(stamps));
        let events = run.map(|(link, _)| link.events.listen());
        let routes = run.map_or_else(Vec::new, |run| routes(run, &clock));
        let server = web::Server::start(http, routes).map_err(|e| Failure::Publishing(e.to_string()))?;
        if let Some(events) = events {
            server.follow_events(events);
        }
        server.judge_ages(clock, safety.stale_after);
        Ok(Self { server: Some(server) })
    }

    /// Says that there is no server in this build.
    #[cfg(not(feature = "http"))]
    pub fn start(http: Option<&HttpSettings>, _: &SafetySettings, _: Stamps, _: Option<OfRun<'_>>) -> Result<Self, Failure> {
        if http.is_some() {
            tracing::warn!("[http]: this build has no HTTP server; build it with the feature `http`");
        }
        Ok(Self {})
    }

    /// Describes the session's camera and surfaces to the server's clients.
    pub fn show_scene(&self, setup: &TrackerSetup) {
        #[cfg(feature = "http")]
        if let Some(server) = &self.server {
            server.show_scene(setup);
        }
        #[cfg(not(feature = "http"))]
        let _ = setup;
    }

    /// What the session's pose stage calls with every row, for those who watch; none where there is no server.
    pub fn observer(&self) -> Option<impl FnMut(&ClipEntry, &PoseSample) + Send + 'static> {
        #[cfg(feature = "http")]
        return self.server.as_ref().map(web::Server::observer);
        #[cfg(not(feature = "http"))]
        None::<fn(&ClipEntry, &PoseSample)>
    }

    /// Gives a sample, or a stale message, to the server's clients.
    pub fn publish(&self, sample: &PoseSample) {
        #[cfg(feature = "http")]
        if let Some(server) = &self.server {
            server.publish(sample);
        }
        #[cfg(not(feature = "http"))]
        let _ = sample;
    }
}

#[cfg(feature = "http")]
fn routes((link, save): OfRun<'_>, clock: &Arc<FrameClock>) -> Vec<web::Route> {
    use crate::telemetry::{Page, health, metrics};
    let reply = |page: Page| web::Reply { status: page.status, content_type: page.content_type, body: page.body.into_bytes() };
    let (for_health, for_metrics, save) = (link.statistics.clone(), link.statistics.clone(), save.clone());
    let (health_clock, metrics_clock) = (clock.clone(), clock.clone());
    vec![
        web::Route::get("/healthz", move || reply(health(&for_health, &health_clock))),
        web::Route::get("/metrics", move || reply(metrics(&for_metrics, &metrics_clock))),
        web::Route::post("/api/v1/ring/save", move || {
            save.store(true, std::sync::atomic::Ordering::Relaxed);
            web::Reply::text(202, "the last seconds will be saved\n")
        }),
    ]
}
