//! `--overlay DIR`: one JPEG a frame with what the tracker saw drawn on it; `--overlay FILE.mp4`: the same as a video.
//!
//! The folder's frames are this run's alone: those of an earlier run are removed first, or a shorter clip would end in frames of a longer one.
//! They are known by a file that lies beside them. A folder with frames of other origin is refused, for they may be the only copies.

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

/// Quality of the pictures' JPEG, 1 to 100. Chosen, not tuned. Raised, files are larger; lowered, thin lines get blocks around them.
const QUALITY: u8 = 92;
/// Name of a file that lies in a folder which this module made, and what it says. A folder without it that has pictures is not written
/// into.
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
    /// Makes the folder anew where it is one; `pixels` come from the tracker.
    pub fn create(path: &Path, setup: TrackerSetup, pixels: Receiver<UsedPixels>) -> Result<Self, Failure> {
        let target = if is_video(path) {
            Target::Video(VideoFile::new(path))
        } else {
            replace_folder(path).map_err(Failure::output(path))?;
            Target::Folder(path.to_owned())
        };
        Ok(Self { target, setup, pixels })
    }

    /// The pixels of a frame. They are there before its sample is; those of rows that nobody draws are let go.
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

    /// Ends a video.
    pub fn finish(self) -> Result<(), Failure> {
        match self.target {
            Target::Video(video) => video.finish(),
            Target::Folder(_) => Ok(()),
        }
    }
}

/// Refuses a folder that holds frames of another origin than an earlier run.
pub(super) fn refuse_foreign(directory: &Path) -> Result<(), Failure> {
    let Ok(mut entries) = fs::read_dir(directory) else {
        // It is not there yet, or making it will say what is the matter.
        return Ok(());
    };
    let is_own = directory.join(MARK).is_file();
    let has_frames = entries.any(|entry| entry.is_ok_and(|entry| is_frame_name(&entry.path())));
    if has_frames && !is_own { Err(Failure::FolderIsUsed(directory.to_owned())) } else { Ok(()) }
}

/// Makes the folder, marked, without the pictures of an earlier run.
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

/// Whether a file is called as [`Overlays::write`] calls them.
fn is_frame_name(file: &Path) -> bool {
    let digits = file.file_name().and_then(|name| name.to_str()).and_then(|name| name.strip_suffix(".jpg"));
    digits.is_some_and(|digits| digits.len() >= 6 && digits.bytes().all(|b| b.is_ascii_digit()))
}

fn write_jpeg(file: &Path, picture: &RgbImage) -> io::Result<()> {
    let mut writer = BufWriter::new(safe_file::replace(file)?);
    JpegEncoder::new_with_quality(&mut writer, QUALITY).encode_image(picture).map_err(io::Error::other)?;
    writer.flush()
}
