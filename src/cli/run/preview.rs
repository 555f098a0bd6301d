//! A camera's picture while nothing is tracked: someone chooses a camera, or freezes a picture of
//! the stage.

use std::path::Path;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::Receiver;

use super::camera;
use crate::camera::Shutter;
use crate::capture::FrameSource;
use crate::cli::failure::Failure;
use crate::cli::pages::Pages;
use crate::daemon::live::{LiveLink, LiveSource, LiveStop, Patience};
use crate::drop_oldest::drop_oldest;
use crate::record::{PoseSample, State};

/// Interval of tries to open what could not be opened, or to play a clip again. Lowered, a wrong
/// clip fills the log.
const TRIES_EVERY: Duration = Duration::from_secs(2);

/// Shows the wanted camera.
#[derive(Default)]
pub(super) struct Preview {
    /// The wanted device when it was last started, and when.
    tried: Option<(Option<String>, Instant)>,
    running: Option<Running>,
}

/// A camera that is open.
struct Running {
    stop: LiveStop,
    samples: Receiver<PoseSample>,
    thread: JoinHandle<()>,
}

impl Preview {
    /// Shows this camera from now on, or the clip that plays in its place. Call it several times a
    /// second.
    pub fn follow(&mut self, wanted: Option<String>, play: Option<&Path>, link: &LiveLink, pages: &Pages) {
        let is_same = self.tried.as_ref().is_some_and(|(before, _)| *before == wanted);
        if !is_same || self.running.as_ref().is_some_and(|running| running.thread.is_finished()) {
            self.close();
        }
        let is_due = self.tried.as_ref().is_none_or(|(_, at)| at.elapsed() >= TRIES_EVERY);
        if self.running.is_none() && (!is_same || is_due) {
            self.running = start(wanted.as_deref(), play, link, pages).unwrap_or_else(|failure| {
                tracing::warn!("the camera cannot be shown: {failure}");
                None
            });
            self.tried = Some((wanted, Instant::now()));
        }
        if let Some(running) = &self.running {
            running.samples.try_iter().for_each(|sample| pages.publish(&sample));
        }
    }

    /// Closes the camera, and forgets which it was.
    pub fn end(&mut self) {
        self.close();
        self.tried = None;
    }

    fn close(&mut self) {
        if let Some(running) = self.running.take() {
            running.stop.stop();
            if running.thread.join().is_err() {
                tracing::error!("showing the camera failed inside the program; please report it");
            }
        }
    }
}

/// Opens the camera; `None` if none is chosen, or there is no page to show it.
fn start(wanted: Option<&str>, play: Option<&Path>, link: &LiveLink, pages: &Pages) -> Result<Option<Running>, Failure> {
    let (Some(opener), Some(mut show)) = (camera::previewed(wanted, play)?, pages.viewer()) else { return Ok(None) };
    let mut source = LiveSource::start(opener, Shutter::default(), Patience::default(), link.clone());
    let stop = source.stopper();
    let (to, samples) = drop_oldest(1);
    let work = move || {
        while let Some(row) = source.next_entry() {
            let sample = PoseSample::new(row.sequence, row.timestamp, State::Searching);
            show(&row, &sample);
            to.send(sample);
        }
    };
    let thread = std::thread::Builder::new().name("preview".to_owned()).spawn(work);
    let thread = thread.map_err(|e| Failure::Tracking(format!("cannot start a thread ({e}); close other programs")))?;
    Ok(Some(Running { stop, samples, thread }))
}
