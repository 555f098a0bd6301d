//! The page beside the demo: on loopback alone, at a free port, with the picture and the outlines as for a camera.

use std::time::{Duration, Instant};

use crate::capture::ClipEntry;
use crate::cli::failure::Failure;
use crate::cli::interrupt;
use crate::cli::pages::Pages;
use crate::record::PoseSample;
use crate::tracker::{Tracker, TrackerSetup};

/// What the page is called with for every row.
type Observer = Box<dyn FnMut(&ClipEntry, &PoseSample) + Send>;

/// The running page. Frames come at the pace of their stamps, so that there is something to see.
pub(super) struct Page {
    pages: Pages,
    observer: Option<Observer>,
    begun: Instant,
}

impl Page {
    /// Serves it, before there is anything to show.
    ///
    /// # Errors
    /// Where no port can be had.
    pub(super) fn start() -> Result<Self, Failure> {
        Ok(Self { pages: Pages::start_on_loopback()?, observer: None, begun: Instant::now() })
    }

    /// From now on it shows what this tracker does, and time counts.
    pub(super) fn watch(&mut self, setup: &TrackerSetup, tracker: &mut Tracker) {
        self.pages.show_scene(setup);
        self.observer = self.pages.observer(tracker).map(|observer| Box::new(observer) as Observer);
        self.begun = Instant::now();
    }

    /// What to type into a browser; none in a build without a server.
    pub(super) fn address(&self) -> Option<String> {
        self.pages.listens().map(crate::web::page_address)
    }

    /// Waits until a frame of this stamp is due, or a signal comes.
    pub(super) fn wait_until(&self, stamp: Duration) {
        interrupt::wait_until(self.begun, stamp);
    }

    /// Shows a row and what became of it.
    pub(super) fn show(&mut self, row: &ClipEntry, sample: &PoseSample) {
        if let Some(observer) = &mut self.observer {
            observer(row, sample);
        }
        self.pages.publish(sample);
    }
}
