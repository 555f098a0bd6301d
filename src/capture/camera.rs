//! What the live pipeline asks of a camera, whatever drives it: V4L2, a clip that plays, a fake that fails.
//!
//! A [`CameraOpener`] opens its camera again and again, for as long as the show lasts; a [`Camera`] gives pictures
//! until it fails. Both may block, fail or panic: the pipeline bears it.

use std::time::Duration;

use thiserror::Error;

use super::timestamping::DriverStamp;
use crate::frame::Timestamp;

/// How the bytes of a picture are laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PixelLayout {
    /// A JPEG.
    Mjpeg,
    /// Y U Y V, two bytes a pixel.
    Yuyv,
    /// A plane of Y, then U and V of every fourth pixel.
    Nv12,
    /// One byte a pixel.
    Grey,
    /// R G B, three bytes a pixel.
    Rgb,
    /// B G R, three bytes a pixel.
    Bgr,
}

impl PixelLayout {
    /// The name that V4L2 gives it.
    pub fn fourcc(self) -> &'static str {
        match self {
            Self::Mjpeg => "MJPG",
            Self::Yuyv => "YUYV",
            Self::Nv12 => "NV12",
            Self::Grey => "GREY",
            Self::Rgb => "RGB3",
            Self::Bgr => "BGR3",
        }
    }
}

/// What an open camera delivers.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraMode {
    /// The camera's name and place, for people: "Replay camera (/dev/video0)".
    pub name: String,
    /// Width and height, pixels.
    pub size: (u32, u32),
    /// How pictures come.
    pub layout: PixelLayout,
    /// Pictures a second, as agreed with the driver.
    pub fps: f64,
    /// The exposure in seconds, where it is locked and known.
    pub exposure_s: Option<f64>,
    /// Driver controls as read back after they were set, by name.
    pub controls: Vec<(String, i64)>,
    /// What a newcomer should know, one sentence each: why this mode, what was refused, what is still automatic.
    pub notes: Vec<String>,
}

/// A picture as the driver gave it.
#[derive(Debug, Clone, PartialEq)]
pub struct CapturedPicture {
    /// As many bytes as the driver filled; a JPEG may have stale bytes behind its end.
    pub bytes: Vec<u8>,
    /// When it was taken, in the driver's words.
    pub stamp: DriverStamp,
    /// When it was read, on the monotonic clock.
    pub arrival: Timestamp,
    /// The driver's own count, where it tells it.
    pub device_sequence: Option<u32>,
    /// True where the driver says that the bytes are damaged.
    pub is_damaged: bool,
}

/// Why there is no picture.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum CameraFault {
    /// None came in time; the camera may be alive.
    #[error("no picture came in time")]
    Silent,
    /// The camera must be opened again.
    #[error("{0}")]
    Gone(String),
    /// There will be no more pictures (a clip has been played to its end).
    #[error("the pictures are at their end")]
    End,
}

/// Why a camera cannot be opened: one sentence with the mend.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct OpenFault(pub String);

/// An open camera. It lives on one thread.
pub trait Camera {
    /// What it delivers.
    fn mode(&self) -> &CameraMode;

    /// Waits for the next picture, the newest that there is, about `patience` long.
    ///
    /// # Errors
    /// [`CameraFault::Silent`] when none came in that time; else why no more will come.
    fn next_picture(&mut self, patience: Duration) -> Result<CapturedPicture, CameraFault>;
}

/// Opens a camera, and opens it again when it was lost.
pub trait CameraOpener: Send + Sync {
    /// Opens the camera, wherever it is now; controls are set and read back.
    ///
    /// # Errors
    /// Why not, as a sentence; the pipeline tries again.
    fn open(&self) -> Result<Box<dyn Camera>, OpenFault>;
}
