//! The HTTP side of `run`: pose and state as the server gives them, health, metrics, and the call that saves the ring.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use crate::cli::failure::Failure;
use crate::config::Settings;
use crate::daemon::live::LiveLink;
use crate::record::PoseSample;

/// The running server, where the config has one.
pub(super) struct Pages {
    #[cfg(feature = "http")]
    server: Option<crate::web::Server>,
}

impl Pages {
    /// Starts the server; `save` is switched on by the call that asks for the ring.
    #[cfg(feature = "http")]
    pub fn start(settings: &Settings, link: &LiveLink, save: &Arc<AtomicBool>) -> Result<Self, Failure> {
        use std::sync::atomic::Ordering;

        use crate::publish::{FrameClock, Stamps};
        use crate::telemetry::{Page, health, metrics};
        use crate::web::{Reply, Route, Server};

        let reply = |page: Page| Reply { status: page.status, content_type: page.content_type, body: page.body.into_bytes() };
        let (for_health, for_metrics, save) = (link.statistics.clone(), link.statistics.clone(), save.clone());
        // One clock for all pages: it is asked often enough to notice a suspend while nobody reads them.
        let clock = Arc::new(FrameClock::new(Stamps::Live));
        let (health_clock, metrics_clock) = (clock.clone(), clock.clone());
        let routes = || {
            vec![
                Route::get("/healthz", move || reply(health(&for_health, &health_clock))),
                Route::get("/metrics", move || reply(metrics(&for_metrics, &metrics_clock))),
                Route::post("/api/v1/ring/save", move || {
                    save.store(true, Ordering::Relaxed);
                    Reply::text(202, "the last seconds will be saved\n")
                }),
            ]
        };
        let server = settings.http.as_ref().map(|http| Server::start(http, routes())).transpose();
        let server = server.map_err(|e| Failure::Publishing(e.to_string()))?;
        if let Some(server) = &server {
            server.judge_ages(clock, settings.safety.stale_after);
        }
        Ok(Self { server })
    }

    /// Says that there is no server in this build.
    #[cfg(not(feature = "http"))]
    pub fn start(settings: &Settings, _: &LiveLink, _: &Arc<AtomicBool>) -> Result<Self, Failure> {
        if settings.http.is_some() {
            tracing::warn!("[http]: this build has no HTTP server; build it with the feature `http`");
        }
        Ok(Self {})
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
