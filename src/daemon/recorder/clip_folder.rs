//! A clip that is being recorded: `frames/` in folders of 10,000, `timestamps.csv`, `poses.jsonl`,
//! `events.jsonl`, `dropped.csv`, with timecode `timecode.csv`.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use image::codecs::pnm::{PnmEncoder, PnmSubtype, SampleEncoding};
use image::{ExtendedColorType, GrayImage, ImageEncoder};

use super::disk::Disk;
use crate::daemon::live::{Event, StampedEvent};
use crate::frame::Timestamp;
use crate::safe_file::first_taken;
use crate::timecode::{StampedTimecode, side_file};
use crate::track::LearntCamera;
use crate::utc;

/// A row as it is stored.
#[derive(Debug, Clone)]
pub(super) struct Recorded {
    pub timestamp: Timestamp,
    pub picture: Picture,
    /// The C3 record, without the line end.
    pub line: String,
    /// What was known of the camera before this row.
    pub learnt: LearntCamera,
    /// The timecode of its stamp, if there is one.
    pub timecode: Option<StampedTimecode>,
}

/// What is stored of a picture.
#[derive(Debug, Clone)]
pub(super) enum Picture {
    /// As received.
    Jpeg(Arc<[u8]>),
    /// Luma.
    Grey(GrayImage),
    /// There was none; an empty file replays to the same.
    Nothing,
}

impl Recorded {
    /// Returns the number of bytes to write.
    pub fn bytes(&self) -> usize {
        let picture = match &self.picture {
            Picture::Jpeg(bytes) => bytes.len(),
            Picture::Grey(image) => image.as_raw().len(),
            Picture::Nothing => 0,
        };
        picture + self.line.len()
    }
}

/// Maximum pictures in one folder: five minutes at 30 per second. Chosen: file managers and simple
/// file systems are slow with more.
const PER_FOLDER: u64 = 10_000;
/// The first line of an index, as in EuRoC's data sets.
pub(super) const INDEX_HEAD: &[u8] = b"#timestamp [ns],filename\n";

/// Names of everything that a recording writes into its folder.
const PARTS: [&str; 8] = ["frames", "timestamps.csv", "poses.jsonl", side_file::NAME, "events.jsonl", "dropped.csv", "clip.toml", "config"];

/// Returns the files and folders of a recording in a folder.
pub fn parts(folder: &Path) -> impl Iterator<Item = PathBuf> {
    PARTS.into_iter().map(|name| folder.join(name))
}

/// Returns the first part of an earlier recording that a new one in this folder would overwrite or
/// extend.
pub fn taken_by_earlier(folder: &Path) -> Option<PathBuf> {
    first_taken(folder, PARTS)
}

/// Returns a new folder in `folder`: clip-20261121T074500Z, with a number appended if needed. It is
/// created at once, so that a recording and a ring that is saved in the same second do not take one
/// name. If it cannot be created, only the name is returned, and the recorder will report why.
pub fn new_clip_folder(folder: &Path) -> PathBuf {
    let plain: String = utc::date_and_time(utc::now_s()).chars().filter(|c| *c != '-' && *c != ':').collect();
    let first = folder.join(format!("clip-{plain}"));
    let others = (2..).map(|n: u32| folder.join(format!("clip-{plain}-{n}")));
    if std::fs::create_dir_all(folder).is_err() {
        return first;
    }
    let is_taken = |clip: &PathBuf| std::fs::create_dir(clip).is_err_and(|e| e.kind() == io::ErrorKind::AlreadyExists);
    std::iter::once(first.clone()).chain(others).find(|clip| !is_taken(clip)).unwrap_or(first)
}

/// A clip's folder.
#[derive(Debug)]
pub(super) struct ClipFolder {
    pub folder: PathBuf,
    pictures: u64,
    dropped_begun: bool,
    timecode_begun: bool,
}

impl ClipFolder {
    /// Creates the folder, which may exist but must hold nothing of a clip.
    pub fn create(folder: &Path, disk: &mut dyn Disk) -> io::Result<Self> {
        if let Some(taken) = taken_by_earlier(folder) {
            let reason = format!("{} exists already; give a new folder", taken.display());
            return Err(io::Error::new(io::ErrorKind::AlreadyExists, reason));
        }
        disk.make_folder(&folder.join("frames"))?;
        disk.append(&folder.join("timestamps.csv"), INDEX_HEAD)?;
        Ok(Self::of(folder))
    }

    /// Returns the object for an existing folder.
    pub fn of(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), pictures: 0, dropped_begun: false, timecode_begun: false }
    }

    /// Returns the number of rows written.
    pub fn rows(&self) -> u64 {
        self.pictures
    }

    /// Writes a row: the picture, then its line in the index, then its record.
    pub fn push(&mut self, row: &Recorded, disk: &mut dyn Disk) -> io::Result<()> {
        let (n, subfolder) = (self.pictures, format!("{:04}", self.pictures / PER_FOLDER));
        if n.is_multiple_of(PER_FOLDER) {
            disk.make_folder(&self.folder.join("frames").join(&subfolder))?;
        }
        let (extension, bytes) = match &row.picture {
            Picture::Jpeg(bytes) => ("jpg", bytes.to_vec()),
            Picture::Grey(image) => ("pgm", pgm(image)?),
            Picture::Nothing => ("pgm", Vec::new()),
        };
        let name = format!("{subfolder}/{n:08}.{extension}");
        disk.write_file(&self.folder.join("frames").join(&name), &bytes)?;
        disk.append(&self.folder.join("timestamps.csv"), format!("{},{name}\n", row.timestamp).as_bytes())?;
        self.pictures += 1;
        disk.append(&self.folder.join("poses.jsonl"), format!("{}\n", row.line).as_bytes())?;
        let Some(timecode) = &row.timecode else { return Ok(()) };
        let head = if self.timecode_begun { "" } else { side_file::HEAD };
        self.timecode_begun = true;
        let line = head.to_owned() + &side_file::line(row.timestamp, timecode);
        disk.append(&self.folder.join(side_file::NAME), line.as_bytes())
    }

    /// Writes an event; dropped frames go to their own index.
    pub fn event(&mut self, event: &StampedEvent, disk: &mut dyn Disk) -> io::Result<()> {
        if let Event::FrameDropped { timestamp } = event.event {
            let head = if self.dropped_begun { "" } else { "#timestamp [ns] of frames that were not tracked\n" };
            self.dropped_begun = true;
            return disk.append(&self.folder.join("dropped.csv"), format!("{head}{timestamp}\n").as_bytes());
        }
        if event.event.is_progress() {
            return Ok(());
        }
        disk.append(&self.folder.join("events.jsonl"), format!("{}\n", event.to_json_line()).as_bytes())
    }
}

fn pgm(image: &GrayImage) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::with_capacity(image.as_raw().len() + 32);
    let encoder = PnmEncoder::new(&mut bytes).with_subtype(PnmSubtype::Graymap(SampleEncoding::Binary));
    encoder.write_image(image, image.width(), image.height(), ExtendedColorType::L8).map_err(io::Error::other)?;
    Ok(bytes)
}
