//! The newest frame with its record, for viewers; nothing is copied or encoded while no viewer
//! waits for a frame.
//!
//! ```text
//! pose stage --row, sample--> Hub (a viewer waits?)
//!     --newest only--> threads `view` (joins) or `encode` (encodes, joins)
//!     --newest only--> /ws/view, one per viewer
//! ```
//! A camera's own JPEGs are joined with their records on the thread `view`; other pictures are
//! encoded and joined on a second thread, `encode`. All viewers share a message's memory, and each
//! holds at most the message being sent to it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};

use axum::body::Bytes;
use crossbeam_channel::Receiver;
use image::GrayImage;
use jpeg_encoder::{ColorType, Encoder};
use serde::Serialize;
use tokio::sync::watch;

use super::camera_motion::{CameraMotion, MotionFollower};
use crate::capture::{ClipEntry, EntryContent, Received, with_huffman_tables};
use crate::daemon::stand_back;
use crate::drop_oldest::{DropOldestSender, drop_oldest};
use crate::record::{PoseSample, State};
use crate::telemetry::Statistics;
use crate::track::{Displaced, UsedPixel, UsedPixels};

/// Quality of JPEGs encoded here, 1 to 100. Chosen: no visible blocks, at a third of the size
/// of 95. Raised, messages are larger.
const QUALITY: u8 = 80;
/// Maximum pixels sent per frame, used and hidden together: they show where the stage is seen, and
/// where it is occluded. Raised, messages are larger.
const MAX_PIXELS: usize = 600;
/// Maximum displaced tiles sent per frame: arrows that do not overlap. Raised, messages are larger.
const MAX_DISPLACED: usize = 300;
/// Residuals beyond this many robust standard deviations have no weight in the alignment, so such
/// pixels are not shown. Raised, pixels without weight are shown.
const COUNTS_BELOW: f32 = 4.7;

/// What is copied of a row.
#[derive(Debug)]
struct Taken {
    epoch: u64,
    picture: Picture,
    size: (u32, u32),
    sample: PoseSample,
    motion: Option<CameraMotion>,
    used: Option<Shown>,
}

/// What a frame's poses rest on, as it is sent.
#[derive(Debug, PartialEq)]
struct Shown {
    /// Columns and rows of pixels, alternating.
    pixels: Vec<u16>,
    /// The same, of pixels whose tiles show something else.
    hidden: Vec<u16>,
    /// Tiles, four numbers each: column, row, and the picture's displacement along both, pixels.
    displaced: Vec<f64>,
}

#[derive(Debug)]
enum Picture {
    /// The camera's own.
    Jpeg(Arc<[u8]>),
    /// The luma of a raw picture.
    Grey(GrayImage),
}

/// Connects the pose stage with the viewers.
#[derive(Debug)]
pub(super) struct Hub {
    /// Viewers that could take a frame now.
    waiting: AtomicUsize,
    /// Where copied rows are counted.
    statistics: Arc<Statistics>,
    /// Number of sessions so far: row numbers restart with each.
    epochs: AtomicU64,
    /// Viewers that request the pixels behind the poses, and whether there are any, for the
    /// tracker.
    asking: AtomicUsize,
    wants_pixels: Arc<AtomicBool>,
    /// The camera's own JPEGs are forwarded; pictures that must be encoded first go to another
    /// thread.
    to_view: DropOldestSender<Taken>,
    to_encode: DropOldestSender<Taken>,
    newest: Arc<watch::Sender<Bytes>>,
}

/// A viewer's request for pixels, until it is dropped.
#[derive(Debug)]
pub(super) struct Asking(Arc<Hub>);

impl Drop for Asking {
    fn drop(&mut self) {
        if self.0.asking.fetch_sub(1, Ordering::Relaxed) == 1 {
            self.0.wants_pixels.store(false, Ordering::Relaxed);
        }
    }
}

/// A viewer's wait for a frame, until it is dropped.
#[derive(Debug)]
pub(super) struct Waiting(Arc<Hub>);

impl Drop for Waiting {
    fn drop(&mut self) {
        self.0.waiting.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Hub {
    /// Starts a hub with its threads, which end when it is dropped.
    ///
    /// # Errors
    /// When the system provides no thread.
    pub fn start(statistics: Arc<Statistics>) -> std::io::Result<Arc<Self>> {
        let newest = Arc::new(watch::Sender::new(Bytes::new()));
        // Joining a message takes a tenth of a millisecond: at low priority it would wait for the
        // tracker's next pause, and so would all viewers. Encoding takes long, so it runs at low
        // priority.
        let to_view = worker("view", newest.clone(), || {})?;
        let to_encode = worker("encode", newest.clone(), stand_back)?;
        Ok(Arc::new(Self {
            waiting: 0.into(),
            statistics,
            epochs: 0.into(),
            asking: 0.into(),
            wants_pixels: Arc::default(),
            to_view,
            to_encode,
            newest,
        }))
    }

    /// Returns a flag that is true while a viewer requests the pixels behind the poses.
    pub fn wants_pixels(&self) -> Arc<AtomicBool> {
        self.wants_pixels.clone()
    }

    /// Registers a viewer that requests them.
    pub fn ask_pixels(self: &Arc<Self>) -> Asking {
        self.asking.fetch_add(1, Ordering::Relaxed);
        self.wants_pixels.store(true, Ordering::Relaxed);
        Asking(self.clone())
    }

    /// Returns what a new session's pose stage calls with every row; it never waits. `pixels` come
    /// from its tracker while they are wanted.
    pub fn observer(self: &Arc<Self>, pixels: Option<Receiver<UsedPixels>>) -> impl FnMut(&ClipEntry, &PoseSample) + Send + 'static {
        let (hub, epoch) = (self.clone(), self.epochs.fetch_add(1, Ordering::Relaxed) + 1);
        let (mut follower, mut pixels) = (MotionFollower::default(), PixelsByRow { pixels, next: None });
        move |row, sample| {
            let motion = follower.after(sample);
            let used = pixels.of(row.sequence);
            if hub.waiting.load(Ordering::Relaxed) > 0
                && let Some(taken) = taken(epoch, row, sample, motion)
            {
                hub.statistics.viewed.add(1);
                hub.show(Taken { used: used.map(|used| shown(&used)), ..taken });
            }
        }
    }

    /// Passes a row to the thread that makes its message.
    fn show(&self, taken: Taken) {
        let to = match &taken.picture {
            Picture::Jpeg(_) => &self.to_view,
            Picture::Grey(_) => &self.to_encode,
        };
        to.send(taken);
    }

    /// Registers a viewer that waits for a frame.
    pub fn wait(self: &Arc<Self>) -> Waiting {
        self.waiting.fetch_add(1, Ordering::Relaxed);
        Waiting(self.clone())
    }

    /// Returns a channel with the newest message.
    pub fn messages(&self) -> watch::Receiver<Bytes> {
        self.newest.subscribe()
    }

    /// Returns the number of rows copied so far.
    #[cfg(test)]
    pub fn copied(&self) -> u64 {
        self.statistics.viewed.get()
    }

    /// Returns the number of viewers that could take a frame now.
    #[cfg(test)]
    pub fn waiting(&self) -> usize {
        self.waiting.load(Ordering::Relaxed)
    }

    /// Returns the number of viewers.
    #[cfg(test)]
    pub fn viewers(&self) -> usize {
        self.newest.receiver_count()
    }
}

/// Returns a row's picture with its sample; `None` if the row has no picture.
fn taken(epoch: u64, row: &ClipEntry, sample: &PoseSample, motion: Option<CameraMotion>) -> Option<Taken> {
    let EntryContent::Frame(frame) = &row.content else { return None };
    let picture = match &row.received {
        Some(Received::Jpeg(bytes)) => Picture::Jpeg(bytes.clone()),
        _ => Picture::Grey(frame.image.clone()),
    };
    Some(Taken { epoch, picture, size: frame.image.dimensions(), sample: sample.clone(), motion, used: None })
}

/// The tracker's pixels. They come in the order of the rows and before the row's sample; not every
/// row has some.
struct PixelsByRow {
    pixels: Option<Receiver<UsedPixels>>,
    /// Pixels of a row still to come.
    next: Option<UsedPixels>,
}

impl PixelsByRow {
    fn of(&mut self, sequence: u64) -> Option<UsedPixels> {
        let pixels = self.pixels.as_ref()?;
        loop {
            let used = self.next.take().or_else(|| pixels.try_recv().ok())?;
            match used.sequence.cmp(&sequence) {
                std::cmp::Ordering::Less => {}
                std::cmp::Ordering::Equal => return Some(used),
                std::cmp::Ordering::Greater => {
                    self.next = Some(used);
                    return None;
                }
            }
        }
    }
}

/// Returns an even selection of the pixels behind the poses, of those that are hidden, and of the
/// displaced tiles; raw pixels of the frame.
fn shown(used: &UsedPixels) -> Shown {
    let counted: Vec<&UsedPixel> = used.pixels.iter().filter(|pixel| !pixel.takes_part || pixel.sigmas < COUNTS_BELOW).collect();
    // One selection for both keeps their ratio in each part of the picture.
    let (used_pixels, hidden): (Vec<&UsedPixel>, Vec<&UsedPixel>) = evenly(&counted, MAX_PIXELS).partition(|pixel| pixel.takes_part);
    // A frame has fewer than 65536 columns and rows, or it would not fit a JPEG.
    let places = |pixels: &[&UsedPixel]| pixels.iter().flat_map(|pixel| pixel.centre_px.map(|px| px.round().max(0.0) as u16)).collect();
    // Round to thousandths of a pixel, the noise of a tile.
    let rounded = |px: f64| (px * 1e3).round() / 1e3;
    let arrow = |tile: &Displaced| [tile.centre_px.x, tile.centre_px.y, tile.shift_px.x, tile.shift_px.y].map(rounded);
    Shown {
        pixels: places(&used_pixels),
        hidden: places(&hidden),
        displaced: evenly(&used.displaced, MAX_DISPLACED).flat_map(arrow).collect(),
    }
}

/// Returns at most this many items, evenly spaced.
fn evenly<T>(all: &[T], most: usize) -> impl Iterator<Item = &T> {
    all.iter().step_by(all.len().div_ceil(most).max(1))
}

/// Starts a thread that makes messages of the newest rows; it ends when the sender is dropped. It
/// calls `begin` first.
fn worker(name: &str, to: Arc<watch::Sender<Bytes>>, begin: impl FnOnce() + Send + 'static) -> std::io::Result<DropOldestSender<Taken>> {
    let (sender, rows) = drop_oldest(1);
    let work = move || {
        begin();
        for row in rows {
            if let Some(message) = message(&row) {
                to.send_replace(message);
            }
        }
    };
    std::thread::Builder::new().name(name.to_owned()).spawn(work)?;
    Ok(sender)
}

/// The part of a message before the picture.
#[derive(Debug, Serialize)]
struct Head<'a> {
    epoch: u64,
    size: [u32; 2],
    /// Why the stage is not tracked, as a word, a sentence and a fix; all null while it is.
    reason: Option<&'static str>,
    says: Option<&'static str>,
    mend: Option<&'static str>,
    /// The camera's motion at the frame's stamp, in its own axes; null if unknown.
    motion: Option<CameraMotion>,
    /// The pixels behind the poses, if a viewer requested them.
    #[serde(skip_serializing_if = "Option::is_none")]
    used: Option<&'a [u16]>,
    /// Occluded pixels, likewise.
    #[serde(skip_serializing_if = "Option::is_none")]
    hidden: Option<&'a [u16]>,
    /// The displacements of the picture from the poses there, likewise.
    #[serde(skip_serializing_if = "Option::is_none")]
    displaced: Option<&'a [f64]>,
    record: &'a PoseSample,
}

/// Builds a message: the head's length in bytes (u32, little-endian), the head as JSON, a JPEG.
/// `None` for a picture that does not fit a JPEG.
fn message(row: &Taken) -> Option<Bytes> {
    let sample = &row.sample;
    let reason = sample.reason.filter(|_| sample.state != State::Tracking);
    let head = Head {
        epoch: row.epoch,
        size: row.size.into(),
        reason: reason.map(|reason| reason.word()),
        says: reason.map(|reason| reason.message()),
        mend: reason.map(|reason| reason.hint()),
        motion: row.motion,
        used: row.used.as_ref().map(|used| &*used.pixels),
        hidden: row.used.as_ref().map(|used| &*used.hidden),
        displaced: row.used.as_ref().map(|used| &*used.displaced),
        record: sample,
    };
    // Serialising fails only for non-string map keys, of which there are none.
    let head = serde_json::to_vec(&head).ok()?;
    let mut whole = Vec::from(u32::try_from(head.len()).ok()?.to_le_bytes());
    whole.extend_from_slice(&head);
    match &row.picture {
        Picture::Jpeg(bytes) => whole.extend_from_slice(&with_huffman_tables(bytes)),
        Picture::Grey(picture) => {
            let (width, height) = (u16::try_from(row.size.0).ok()?, u16::try_from(row.size.1).ok()?);
            whole = grey_jpeg(picture, width, height, whole)?;
        }
    }
    Some(whole.into())
}

/// Appends a grey picture as a JPEG.
pub(super) fn grey_jpeg(picture: &[u8], width: u16, height: u16, mut behind: Vec<u8>) -> Option<Vec<u8>> {
    Encoder::new(&mut behind, QUALITY).encode(picture, width, height, ColorType::Luma).ok()?;
    Some(behind)
}

#[cfg(test)]
#[path = "hub_tests.rs"]
pub(super) mod tests;
