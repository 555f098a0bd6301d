//! The saved clip: a folder that `stagepose replay` reads like a recorded one, plus the true poses.
//!
//! `frames/` and `timestamps.csv` are the clip (contract C2). `stage.toml`, `camera.toml` and the
//! artwork are the tracker's input. `groundtruth.txt` has the exact poses in TUM format, at the
//! same stamps.

use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{GrayImage, ImageError};

use super::DemoError;
use crate::camera::Calibration;
use crate::capture::{ClipWriter, PictureFormat};
use crate::frame::Frame;
use crate::geometry::{Camera, Pose, Stage};
use crate::safe_file::first_taken;
use crate::simulate::VirtualStage;
use crate::track::SurfaceSpec;

/// A clip that is being written.
#[derive(Debug)]
pub(super) struct SavedClip {
    folder: PathBuf,
    clip: ClipWriter,
    truth: BufWriter<File>,
}

impl SavedClip {
    /// Creates the folder and writes everything but the frames; `jpeg` is a quality from 1 to 100,
    /// `None` for PNG.
    pub(super) fn create(folder: &Path, stage: &VirtualStage, jpeg: Option<u8>) -> Result<Self, DemoError> {
        let frames = folder.join("frames");
        // Mixed with another clip's frames, neither clip would be usable; and a config or
        // calibration of that name may be hours of work.
        let artwork: Vec<String> = stage.stage.surfaces.iter().map(picture_of).collect();
        let names = ["frames", "timestamps.csv", CAMERA, STAGE, TRUTH].into_iter().chain(artwork.iter().map(String::as_str));
        if let Some(taken) = first_taken(folder, names) {
            return Err(DemoError::Exists(taken));
        }
        fs::create_dir_all(&frames).map_err(at(&frames))?;
        for (surface, name) in stage.stage.surfaces.iter().zip(&artwork) {
            save_picture(&folder.join(name), &surface.artwork)?;
        }
        let texts = [(CAMERA, Calibration::new(stage.camera).to_toml()), (STAGE, stage_toml(stage))];
        for (name, text) in texts {
            let file = folder.join(name);
            fs::write(&file, text).map_err(at(&file))?;
        }
        let clip = ClipWriter::create(folder, jpeg.map_or(PictureFormat::Png, |quality| PictureFormat::Jpeg { quality }))?;
        let truth = started(&folder.join(TRUTH), "# timestamp tx ty tz qx qy qz qw (camera in the stage, metres, seconds)")?;
        Ok(Self { folder: folder.to_owned(), clip, truth })
    }

    /// Writes one frame, its stamp and its true pose.
    pub(super) fn add(&mut self, frame: &Frame, truth: &Pose<Stage, Camera>) -> Result<(), DemoError> {
        self.clip.push(frame)?;
        let (p, [x, y, z, w]) = (truth.translation, truth.orientation_xyzw());
        writeln!(self.truth, "{} {:.9} {:.9} {:.9} {x:.9} {y:.9} {z:.9} {w:.9}", frame.timestamp.decimal_seconds(), p.x, p.y, p.z)
            .map_err(at(&self.folder.join(TRUTH)))
    }

    /// Flushes the buffers.
    pub(super) fn finish(mut self) -> Result<(), DemoError> {
        self.clip.finish()?;
        self.truth.flush().map_err(at(&self.folder.join(TRUTH)))
    }
}

/// Names of the files next to a saved clip's frames: the true poses (TUM format), the calibration,
/// the config.
const TRUTH: &str = "groundtruth.txt";
const CAMERA: &str = "camera.toml";
const STAGE: &str = "stage.toml";

/// Returns the file name of a surface's artwork.
fn picture_of(surface: &SurfaceSpec) -> String {
    format!("{}.png", surface.name)
}

fn at(file: &Path) -> impl FnOnce(io::Error) -> DemoError + '_ {
    move |source| DemoError::Save { file: file.to_owned(), source }
}

fn started(file: &Path, first_line: &str) -> Result<BufWriter<File>, DemoError> {
    let mut out = BufWriter::new(File::create(file).map_err(at(file))?);
    writeln!(out, "{first_line}").map_err(at(file))?;
    Ok(out)
}

fn save_picture(file: &Path, picture: &GrayImage) -> Result<(), DemoError> {
    let mut out = BufWriter::new(File::create(file).map_err(at(file))?);
    let encoded = picture.write_with_encoder(PngEncoder::new_with_quality(&mut out, CompressionType::Best, FilterType::Adaptive));
    let written = encoded.map_err(|error| match error {
        ImageError::IoError(error) => error,
        other => io::Error::other(other),
    });
    written.and_then(|()| out.flush()).map_err(at(file))
}

/// Returns the config (contract C5).
fn stage_toml(stage: &VirtualStage) -> String {
    let mut text = format!(
        "# A virtual stage, written by `stagepose demo --save`; groundtruth.txt has the true poses.\n[camera]\ncalibration = \"{CAMERA}\"\nexposure_s = {:?}\n{}\n",
        stage.shutter.exposure_s,
        match stage.shutter.readout_s {
            0.0 => "shutter = \"global\"".to_owned(),
            readout_s => format!("readout_s = {readout_s:?}"),
        }
    );
    for surface in &stage.stage.surfaces {
        let position: [f64; 3] = surface.pose.translation.into();
        let (image, size, orientation) = (picture_of(surface), surface.size_m, surface.pose.orientation_xyzw());
        // Writing to a string cannot fail.
        let _ = write!(
            text,
            "\n[[stage.surface]]\nimage = \"{image}\"\nsize_m = {size:?}\nposition_m = {position:?}\norientation_xyzw = {orientation:?}\n"
        );
    }
    text
}
