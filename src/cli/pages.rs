//! The HTTP server that runs with a command: pose and state, and for `run` the daemon's whole
//! interface.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;

use super::failure::Failure;
use crate::capture::ClipEntry;
use crate::config::HttpSettings;
use crate::daemon::Supervisor;
use crate::publish::{SafetySettings, Stamps};
use crate::record::PoseSample;
use crate::tracker::{Tracker, TrackerSetup};
#[cfg(feature = "http")]
use crate::{publish::FrameClock, web};

/// The running server, if the config has one.
pub(super) struct Pages {
    #[cfg(feature = "http")]
    server: Option<web::Server>,
    #[cfg(feature = "http")]
    clock: Option<Arc<FrameClock>>,
}

/// What `run` adds to the poses: its sessions' supervisor, and the page's folder if one was given.
pub(super) type OfRun<'a> = (&'a Arc<Supervisor>, Option<&'a Path>);

impl Pages {
    /// Starts the server. It judges a pose's age by the clock of `stamps`.
    #[cfg(feature = "http")]
    pub fn start(http: Option<&HttpSettings>, safety: &SafetySettings, stamps: Stamps, run: Option<OfRun<'_>>) -> Result<Self, Failure> {
        let Some(http) = http else { return Ok(Self { server: None, clock: None }) };
        // All pages share one clock. It is read often enough to notice a suspend even while nobody
        // reads the pages.
        let clock = Arc::new(FrameClock::new(stamps));
        let events = run.map(|(supervisor, _)| supervisor.link.events.listen());
        let routes = run.map_or_else(Vec::new, |(supervisor, _)| web::routes(supervisor, &clock));
        let site = run.map_or_else(web::Site::default, |(supervisor, page_dir)| web::Site {
            state: Some(crate::daemon::state_folder()),
            page_dir: page_dir.map(Path::to_owned),
            about: Some(web::about(supervisor)),
            stage: Some(Arc::new(super::stage_files::StageOfDaemon::new(supervisor.clone()))),
            statistics: supervisor.link.statistics.clone(),
        });
        let server = web::Server::start_site(http, routes, site).map_err(|e| Failure::Publishing(e.to_string()))?;
        if let Some(events) = events {
            server.follow_events(events);
        }
        server.judge_ages(clock.clone(), safety.stale_after);
        Ok(Self { server: Some(server), clock: Some(clock) })
    }

    /// Starts a server on loopback, at a free port. It shows every pose at once, whatever its
    /// stamp, and stores nothing.
    #[cfg(feature = "http")]
    pub fn start_on_loopback() -> Result<Self, Failure> {
        let http = HttpSettings { listen: (std::net::Ipv4Addr::LOCALHOST, 0).into(), hosts: Vec::new() };
        let server = web::Server::start(&http, Vec::new()).map_err(|e| Failure::Publishing(e.to_string()))?;
        Ok(Self { server: Some(server), clock: None })
    }

    /// Starts nothing: this build has no HTTP server.
    #[cfg(not(feature = "http"))]
    pub fn start_on_loopback() -> Result<Self, Failure> {
        Ok(Self {})
    }

    /// Returns the server's address, if there is a server.
    pub fn listens(&self) -> Option<SocketAddr> {
        #[cfg(feature = "http")]
        return self.server.as_ref().map(web::Server::address);
        #[cfg(not(feature = "http"))]
        None
    }

    /// Applies a new session's age limit.
    #[cfg(feature = "http")]
    pub fn use_limits(&self, safety: &SafetySettings) {
        if let (Some(server), Some(clock)) = (&self.server, &self.clock) {
            server.judge_ages(clock.clone(), safety.stale_after);
        }
    }

    /// Does nothing: there is no server in this build.
    #[cfg(not(feature = "http"))]
    pub fn use_limits(&self, _: &SafetySettings) {}

    /// Warns that this build has no HTTP server.
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

    /// Returns what the session's pose stage calls per row, for the server's clients; `None`
    /// without a server. The tracker reports the pixels behind its poses while a client asks for
    /// them.
    pub fn observer(&self, tracker: &mut Tracker) -> Option<impl FnMut(&ClipEntry, &PoseSample) + Send + 'static> {
        #[cfg(feature = "http")]
        return self.server.as_ref().map(|server| server.observer(Some(tracker.watch_pixels_while(server.wants_pixels()))));
        #[cfg(not(feature = "http"))]
        {
            let _ = tracker;
            None::<fn(&ClipEntry, &PoseSample)>
        }
    }

    /// Returns what is called with each row of a camera that is only shown; `None` without a
    /// server.
    pub fn viewer(&self) -> Option<impl FnMut(&ClipEntry, &PoseSample) + Send + 'static> {
        #[cfg(feature = "http")]
        return self.server.as_ref().map(|server| server.observer(None));
        #[cfg(not(feature = "http"))]
        None::<fn(&ClipEntry, &PoseSample)>
    }

    /// Publishes a sample, or a stale message, to the server's clients.
    pub fn publish(&self, sample: &PoseSample) {
        #[cfg(feature = "http")]
        if let Some(server) = &self.server {
            server.publish(sample);
        }
        #[cfg(not(feature = "http"))]
        let _ = sample;
    }
}
