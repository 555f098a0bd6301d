//! Writes a clip as a folder with frames/ and timestamps.csv, the form that keeps exact stamps.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, GrayImage, ImageEncoder, ImageError};

use super::error::CaptureError;
use crate::frame::Frame;

/// Format of a clip's pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PictureFormat {
    /// Lossless and small, but slowest to write.
    Png,
    /// Lossy.
    Jpeg {
        /// Quality, 1 to 100.
        quality: u8,
    },
}

impl PictureFormat {
    fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Jpeg { .. } => "jpg",
        }
    }

    fn encode(self, image: &GrayImage, to: impl Write) -> Result<(), ImageError> {
        let (width, height) = image.dimensions();
        match self {
            Self::Png => PngEncoder::new_with_quality(to, CompressionType::Fast, FilterType::Up).write_image(
                image,
                width,
                height,
                ExtendedColorType::L8,
            ),
            Self::Jpeg { quality } => {
                JpegEncoder::new_with_quality(to, quality.clamp(1, 100)).encode(image, width, height, ExtendedColorType::L8)
            }
        }
    }
}

/// A clip that is being written.
#[derive(Debug)]
pub struct ClipWriter {
    folder: PathBuf,
    format: PictureFormat,
    stamps: BufWriter<File>,
    pictures: u64,
}

impl ClipWriter {
    /// Creates the folder with its frames/ and an empty timestamps.csv; overwrites an earlier clip
    /// in it.
    ///
    /// # Errors
    /// When the folder or the file cannot be created.
    pub fn create(folder: impl AsRef<Path>, format: PictureFormat) -> Result<Self, CaptureError> {
        let folder = folder.as_ref().to_owned();
        let frames = folder.join("frames");
        std::fs::create_dir_all(&frames).map_err(|e| not_writable(&frames, e))?;
        let csv = folder.join("timestamps.csv");
        let file = File::create(&csv).map_err(|e| not_writable(&csv, e))?;
        let mut stamps = BufWriter::new(file);
        writeln!(stamps, "#timestamp [ns],filename").map_err(|e| not_writable(&csv, e))?;
        Ok(Self { folder, format, stamps, pictures: 0 })
    }

    /// Writes a frame's picture and its line.
    ///
    /// # Errors
    /// When one of them cannot be written.
    pub fn push(&mut self, frame: &Frame) -> Result<(), CaptureError> {
        let name = format!("{:06}.{}", self.pictures, self.format.extension());
        let path = self.folder.join("frames").join(&name);
        let mut file = BufWriter::new(File::create(&path).map_err(|e| not_writable(&path, e))?);
        self.format.encode(&frame.image, &mut file).map_err(|e| not_writable(&path, e))?;
        file.flush().map_err(|e| not_writable(&path, e))?;
        writeln!(self.stamps, "{},{name}", frame.timestamp).map_err(|e| not_writable(&self.folder.join("timestamps.csv"), e))?;
        self.pictures += 1;
        Ok(())
    }

    /// Flushes the file and returns the number of pictures.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn finish(mut self) -> Result<u64, CaptureError> {
        self.stamps.flush().map_err(|e| not_writable(&self.folder.join("timestamps.csv"), e))?;
        Ok(self.pictures)
    }
}

fn not_writable(path: &Path, reason: impl ToString) -> CaptureError {
    CaptureError::NotWritable { path: path.to_owned(), reason: reason.to_string() }
}
