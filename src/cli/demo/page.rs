//! The demo's page: on loopback only, at a free port, with picture and outlines as for a camera.

use std::time::{Duration, Instant};

use crate::capture::ClipEntry;
use crate::cli::failure::Failure;
use crate::cli::interrupt;
use crate::cli::pages::Pages;
use crate::record::PoseSample;
use crate::tracker::{Tracker, TrackerSetup};

/// Called with every row, for the page.
type Observer = Box<dyn FnMut(&ClipEntry, &PoseSample) + Send>;

/// The running page. Frames come at the pace of their stamps, so that they can be watched.
pub(super) struct Page {
    pages: Pages,
    observer: Option<Observer>,
    begun: Instant,
}

impl Page {
    /// Starts the server, before there is anything to show.
    ///
    /// # Errors
    /// When no port is available.
    pub(super) fn start() -> Result<Self, Failure> {
        Ok(Self { pages: Pages::start_on_loopback()?, observer: None, begun: Instant::now() })
    }

    /// Shows this tracker's output from now on, and starts the clock.
    pub(super) fn watch(&mut self, setup: &TrackerSetup, tracker: &mut Tracker) {
        self.pages.show_scene(setup);
        self.observer = self.pages.observer(tracker).map(|observer| Box::new(observer) as Observer);
        self.begun = Instant::now();
    }

    /// Returns the address for a browser; `None` in a build without a server.
    pub(super) fn address(&self) -> Option<String> {
        self.pages.listens().map(crate::web::page_address)
    }

    /// Waits until a frame of this stamp is due, or a signal comes.
    pub(super) fn wait_until(&self, stamp: Duration) {
        interrupt::wait_until(self.begun, stamp);
    }

    /// Shows a row and its sample.
    pub(super) fn show(&mut self, row: &ClipEntry, sample: &PoseSample) {
        if let Some(observer) = &mut self.observer {
            observer(row, sample);
        }
        self.pages.publish(sample);
    }
}
