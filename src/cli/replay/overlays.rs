//! `--overlay DIR`: one JPEG per frame with the tracker's result drawn on it; `--overlay FILE.mp4`:
//! the same as a video.
//!
//! The folder holds only this run's frames. Frames of an earlier run are removed first, or a
//! shorter clip would end in frames of a longer one. A marker file identifies them. A folder with
//! frames of other origin is refused, as they may be the only copies.

use std::fs::{self, create_dir_all};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crossbeam_channel::Receiver;
use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;

use super::overlay_video::{VideoFile, is_video};
use crate::capture::Received;
use crate::cli::failure::Failure;
use crate::cli::overlay::{self, Scene};
use crate::frame::Frame;
use crate::record::PoseSample;
use crate::safe_file;
use crate::track::{UsedPixel, UsedPixels};
use crate::tracker::TrackerSetup;

/// JPEG quality, 1 to 100. Chosen, not tuned. Raised, files are larger; lowered, thin lines get
/// block artefacts.
const QUALITY: u8 = 92;
/// Name and content of the marker file in folders that this module made. Nothing is written into a
/// folder with pictures but without the marker.
const MARK: &str = "stagepose-overlay.txt";
const MARK_TEXT: &str = "Pictures of stagepose replay --overlay. The next run into this folder replaces them.\n";

pub(super) struct Overlays {
    target: Target,
    setup: TrackerSetup,
    pixels: Receiver<UsedPixels>,
}

/// Where the pictures go.
enum Target {
    Folder(PathBuf),
    Video(VideoFile),
}

impl Overlays {
    /// Prepares a new video, or the folder without an earlier run's pictures; `pixels` come from
    /// the tracker.
    pub fn create(path: &Path, setup: TrackerSetup, pixels: Receiver<UsedPixels>) -> Result<Self, Failure> {
        let target = if is_video(path) {
            Target::Video(VideoFile::new(path))
        } else {
            replace_folder(path).map_err(Failure::output(path))?;
            Target::Folder(path.to_owned())
        };
        Ok(Self { target, setup, pixels })
    }

    /// Returns a frame's pixels. They arrive before its sample; those of rows that are not drawn
    /// are dropped.
    fn pixels_of(&self, sequence: u64) -> Vec<UsedPixel> {
        self.pixels.try_iter().find(|used| used.sequence == sequence).map_or_else(Vec::new, |used| used.pixels)
    }

    /// Draws and writes one frame; `received` holds its colours.
    pub fn write(&mut self, frame: &Frame, received: Option<&Received>, sample: &PoseSample) -> Result<(), Failure> {
        let pixels = self.pixels_of(frame.sequence);
        let colours = received.and_then(Received::colours);
        let TrackerSetup { camera, stage, objects, .. } = &self.setup;
        let scene = Scene { camera, stage, objects, pixels: &pixels, colours: colours.as_deref() };
        let picture = overlay::draw(frame, sample, &scene);
        match &mut self.target {
            Target::Video(video) => video.write(frame.timestamp, picture),
            Target::Folder(directory) => {
                let file = directory.join(format!("{:06}.jpg", frame.sequence));
                write_jpeg(&file, &picture).map_err(Failure::output(&file))
            }
        }
    }

    /// Finishes a video.
    pub fn finish(self) -> Result<(), Failure> {
        match self.target {
            Target::Video(video) => video.finish(),
            Target::Folder(_) => Ok(()),
        }
    }
}

/// Refuses a folder with frames that are not an earlier run's.
pub(super) fn refuse_foreign(directory: &Path) -> Result<(), Failure> {
    let Ok(mut entries) = fs::read_dir(directory) else {
        // It does not exist yet, or creating it will report the error.
        return Ok(());
    };
    let is_own = directory.join(MARK).is_file();
    let has_frames = entries.any(|entry| entry.is_ok_and(|entry| is_frame_name(&entry.path())));
    if has_frames && !is_own { Err(Failure::FolderIsUsed(directory.to_owned())) } else { Ok(()) }
}

/// Creates the folder with its marker, and removes an earlier run's pictures.
fn replace_folder(directory: &Path) -> io::Result<()> {
    create_dir_all(directory)?;
    for entry in fs::read_dir(directory)? {
        let file = entry?.path();
        if is_frame_name(&file) {
            fs::remove_file(&file)?;
        }
    }
    safe_file::replace(&directory.join(MARK))?.write_all(MARK_TEXT.as_bytes())
}

/// Whether a file is named as [`Overlays::write`] names its files.
fn is_frame_name(file: &Path) -> bool {
    let digits = file.file_name().and_then(|name| name.to_str()).and_then(|name| name.strip_suffix(".jpg"));
    digits.is_some_and(|digits| digits.len() >= 6 && digits.bytes().all(|b| b.is_ascii_digit()))
}

fn write_jpeg(file: &Path, picture: &RgbImage) -> io::Result<()> {
    let mut writer = BufWriter::new(safe_file::replace(file)?);
    JpegEncoder::new_with_quality(&mut writer, QUALITY).encode_image(picture).map_err(io::Error::other)?;
    writer.flush()
}
