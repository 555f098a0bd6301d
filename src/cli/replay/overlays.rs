//! `--overlay DIR`: one JPEG a frame with what the tracker saw drawn on it.

use std::fs::create_dir_all;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crossbeam_channel::Receiver;
use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;

use crate::camera::CameraModel;
use crate::cli::failure::Failure;
use crate::cli::overlay::{self, Scene};
use crate::daemon::TrackerSetup;
use crate::frame::Frame;
use crate::record::PoseSample;
use crate::safe_file;
use crate::track::{BodySpec, UsedPixel, UsedPixels};

const QUALITY: u8 = 92;

pub(super) struct Overlays {
    directory: PathBuf,
    camera: CameraModel,
    stage: BodySpec,
    objects: Vec<BodySpec>,
    pixels: Receiver<UsedPixels>,
}

impl Overlays {
    /// Makes the folder; `pixels` come from the tracker.
    pub fn create(directory: &Path, setup: &TrackerSetup, pixels: Receiver<UsedPixels>) -> Result<Self, Failure> {
        create_dir_all(directory).map_err(Failure::output(directory))?;
        let (stage, objects) = (setup.stage.clone(), setup.objects.clone());
        Ok(Self { directory: directory.to_owned(), camera: setup.camera, stage, objects, pixels })
    }

    /// The pixels of a frame. They are there before its sample is; those of rows that nobody draws are let go.
    fn pixels_of(&self, sequence: u64) -> Vec<UsedPixel> {
        self.pixels.try_iter().find(|used| used.sequence == sequence).map_or_else(Vec::new, |used| used.pixels)
    }

    /// Draws and writes one frame.
    pub fn write(&mut self, frame: &Frame, sample: &PoseSample) -> Result<(), Failure> {
        let pixels = self.pixels_of(frame.sequence);
        let scene = Scene { camera: &self.camera, stage: &self.stage, objects: &self.objects, pixels: &pixels };
        let picture = overlay::draw(frame, sample, &scene);
        let file = self.directory.join(format!("{:06}.jpg", frame.sequence));
        write_jpeg(&file, &picture).map_err(Failure::output(&file))
    }
}

fn write_jpeg(file: &Path, picture: &RgbImage) -> io::Result<()> {
    let mut writer = BufWriter::new(safe_file::replace(file)?);
    JpegEncoder::new_with_quality(&mut writer, QUALITY).encode_image(picture).map_err(io::Error::other)?;
    writer.flush()
}
