//! The interface between the live pipeline and a camera of any kind: V4L2, a clip that plays, a
//! fake that fails.
//!
//! A [`CameraOpener`] reopens its camera as often as needed while the show lasts. A [`Camera`]
//! delivers pictures until it fails. Both may block, fail or panic: the pipeline copes with all
//! three.

use std::time::Duration;

use thiserror::Error;

use super::timestamping::DriverStamp;
use crate::frame::Timestamp;

/// Memory layout of a picture's bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PixelLayout {
    /// A JPEG.
    Mjpeg,
    /// Y U Y V, two bytes per pixel.
    Yuyv,
    /// A plane of Y, then interleaved U and V for every 2x2 pixels.
    Nv12,
    /// One byte per pixel.
    Grey,
    /// R G B, three bytes per pixel.
    Rgb,
    /// B G R, three bytes per pixel.
    Bgr,
}

impl PixelLayout {
    /// Returns V4L2's name of the layout.
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
    /// The camera's name and device, for display: "Replay camera (/dev/video0)".
    pub name: String,
    /// Width and height, pixels.
    pub size: (u32, u32),
    /// Layout of the pictures.
    pub layout: PixelLayout,
    /// Pictures per second, as agreed with the driver.
    pub fps: f64,
    /// The exposure in seconds, if it is locked and known.
    pub exposure_s: Option<f64>,
    /// Driver controls by name, as read back after they were set.
    pub controls: Vec<(String, i64)>,
    /// Remarks for the user, one sentence each: why this mode, what was refused, what is still
    /// automatic.
    pub notes: Vec<String>,
}

/// A picture as the driver delivered it.
#[derive(Debug, Clone, PartialEq)]
pub struct CapturedPicture {
    /// All bytes that the driver filled; a JPEG may be followed by stale bytes.
    pub bytes: Vec<u8>,
    /// When it was taken, as stamped by the driver.
    pub stamp: DriverStamp,
    /// When it was read, on the monotonic clock.
    pub arrival: Timestamp,
    /// The driver's own sequence number, if it has one.
    pub device_sequence: Option<u32>,
    /// Whether the driver reports the bytes as damaged.
    pub is_damaged: bool,
}

/// Why there is no picture.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum CameraFault {
    /// No picture came in time; the camera may still be alive.
    #[error("no picture came in time")]
    Silent,
    /// The camera must be opened again.
    #[error("{0}")]
    Gone(String),
    /// There will be no more pictures (a clip has played to its end).
    #[error("the pictures are at their end")]
    End,
}

/// Why a camera cannot be opened: one sentence with a hint for the fix.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct OpenFault(pub String);

/// An open camera. It stays on one thread.
pub trait Camera {
    /// Returns what the camera delivers.
    fn mode(&self) -> &CameraMode;

    /// Waits about `patience` for the next picture and returns the newest available.
    ///
    /// # Errors
    /// [`CameraFault::Silent`] if none came in that time; otherwise why no more will come.
    fn next_picture(&mut self, patience: Duration) -> Result<CapturedPicture, CameraFault>;
}

/// Opens a camera, and reopens it after it was lost.
pub trait CameraOpener: Send + Sync {
    /// Finds and opens the camera, and sets and reads back its controls.
    ///
    /// # Errors
    /// Why not, as a sentence; the pipeline tries again.
    fn open(&self) -> Result<Box<dyn Camera>, OpenFault>;
}
