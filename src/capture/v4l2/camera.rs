//! An open V4L2 camera on top of nokhwa, with a timeout for reading and a drop that contains
//! panics.

use std::collections::HashSet;
use std::mem::ManuallyDrop;
use std::os::fd::RawFd;
use std::time::Duration;

use nokhwa::Camera as Nokhwa;
use nokhwa::utils::{ApiBackend, CameraFormat, CameraIndex, FrameFormat, RequestedFormat, RequestedFormatType, Resolution};

use super::ioctl::{self, contained};
use crate::capture::camera::{Camera, CameraFault, CameraMode, CapturedPicture, PixelLayout};
use crate::capture::choice::Offer;
use crate::capture::timestamping::{DriverStamp, monotonic_now};
use crate::frame::Timestamp;

/// Number of buffers that nokhwa requests from the driver. If this is smaller than nokhwa's number,
/// the newest picture may be missed behind older ones.
const BUFFERS: u32 = 4;

/// A streaming camera.
pub(super) struct V4l2Camera {
    nokhwa: ManuallyDrop<Nokhwa>,
    fd: RawFd,
    mode: CameraMode,
    /// Whether the first picture has been read. STREAMON happens inside the first read, so polling
    /// before it is useless.
    streaming: bool,
}

/// Opens node `number` in the offered mode, to which the device has already been set.
pub(super) fn open(number: u32, offer: &Offer, mode: CameraMode) -> Result<V4l2Camera, String> {
    let format = match offer.layout {
        PixelLayout::Mjpeg => FrameFormat::MJPEG,
        PixelLayout::Yuyv => FrameFormat::YUYV,
        PixelLayout::Nv12 => FrameFormat::NV12,
        PixelLayout::Grey => FrameFormat::GRAY,
        PixelLayout::Rgb => FrameFormat::RAWRGB,
        PixelLayout::Bgr => FrameFormat::RAWBGR,
    };
    let exact = CameraFormat::new(Resolution::new(offer.width, offer.height), format, offer.fps);
    let formats = [format];
    let request = RequestedFormat::with_formats(RequestedFormatType::Exact(exact), &formats);
    let before = descriptors(number);
    let nokhwa = Nokhwa::with_backend(CameraIndex::Index(number), request, ApiBackend::Video4Linux).map_err(|e| e.to_string())?;
    let mut camera = V4l2Camera { nokhwa: ManuallyDrop::new(nokhwa), fd: -1, mode, streaming: false };
    camera.nokhwa.open_stream().map_err(|e| e.to_string())?;
    // Of two new ones, one belongs to another thread, and they cannot be told apart.
    let after = descriptors(number);
    let mut new = after.difference(&before);
    match (new.next(), new.next()) {
        (Some(fd), None) => camera.fd = *fd,
        (None, _) => return Err("its file descriptor cannot be found below /proc/self/fd".to_owned()),
        (Some(_), Some(_)) => return Err("it was opened twice at the same moment; open it again".to_owned()),
    }
    Ok(camera)
}

/// Returns this process's file descriptors of a node; nokhwa does not expose its own.
fn descriptors(number: u32) -> HashSet<RawFd> {
    let node = format!("/dev/video{number}");
    let entries = std::fs::read_dir("/proc/self/fd").into_iter().flatten().flatten();
    let of_node = entries.filter(|e| std::fs::read_link(e.path()).is_ok_and(|link| link.as_os_str() == node.as_str()));
    of_node.filter_map(|e| e.file_name().to_str()?.parse().ok()).collect()
}

impl V4l2Camera {
    fn read(&mut self) -> Result<CapturedPicture, CameraFault> {
        let buffer = self.nokhwa.frame().map_err(|e| CameraFault::Gone(reading_fault(&e.to_string())))?;
        let arrival = monotonic_now();
        self.streaming = true;
        let dequeued = ioctl::last_dequeued(self.fd, BUFFERS);
        let whole = buffer.buffer();
        let (stamp, device_sequence, used, is_damaged) = match dequeued {
            Some(d) => (d.stamp, Some(d.sequence), d.bytes_used, d.is_damaged),
            None => (wall_clock_stamp(buffer.capture_timestamp(), arrival), None, whole.len(), false),
        };
        // Some drivers leave bytesused at 0 for whole buffers.
        let used = if used == 0 && !is_damaged { whole.len() } else { used.min(whole.len()) };
        Ok(CapturedPicture { bytes: whole[..used].to_vec(), stamp, arrival, device_sequence, is_damaged })
    }
}

/// Describes why a picture could not be read; nokhwa reports the system's error as text.
fn reading_fault(message: &str) -> String {
    if message.contains("os error 19") {
        "it was unplugged".to_owned()
    } else if message.contains("os error 4)") {
        // The daemon interrupts blocking reads: before the stream runs, nothing else can limit
        // them.
        "it was opened and gave no picture".to_owned()
    } else {
        format!("its driver says: {message}")
    }
}

/// Recovers the monotonic stamp from the picture's age: nokhwa converts stamps to wall-clock time.
fn wall_clock_stamp(stamp: Option<Duration>, arrival: Timestamp) -> DriverStamp {
    let wall = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    match stamp.and_then(|stamp| wall.checked_sub(stamp)) {
        Some(age) if age < Duration::from_secs(5) => DriverStamp::EndOfFrame(arrival.before(age)),
        _ => DriverStamp::None,
    }
}

impl Camera for V4l2Camera {
    fn mode(&self) -> &CameraMode {
        &self.mode
    }

    fn next_picture(&mut self, patience: Duration) -> Result<CapturedPicture, CameraFault> {
        let waited = |e: std::io::Error| CameraFault::Gone(format!("cannot wait for the camera: {e}"));
        if self.streaming && !ioctl::wait_readable(self.fd, patience).map_err(waited)? {
            return Err(CameraFault::Silent);
        }
        let mut newest = self.read()?;
        // The driver delivers its oldest buffer first: drain to the newest.
        for _ in 0..BUFFERS {
            if !ioctl::wait_readable(self.fd, Duration::ZERO).map_err(waited)? {
                break;
            }
            newest = self.read()?;
        }
        Ok(newest)
    }
}

impl Drop for V4l2Camera {
    fn drop(&mut self) {
        let nokhwa = &mut self.nokhwa;
        // SAFETY: it is dropped only here and not used afterwards. The V4L crate panics in its drop
        // if the driver refuses to stop the stream, hence `contained`.
        let dropped = contained(|| unsafe { ManuallyDrop::drop(nokhwa) });
        if dropped.is_none() {
            tracing::warn!("the camera's driver did not stop its stream; the device is abandoned without stopping it");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn camera_faults_are_described_in_plain_words() {
        let message = |system: &str| reading_fault(&format!("Could not capture frame: {system}"));
        assert_eq!(message("No such device (os error 19)"), "it was unplugged");
        assert_eq!(message("Interrupted system call (os error 4)"), "it was opened and gave no picture");
        assert!(message("Input/output error (os error 5)").ends_with("Input/output error (os error 5)"));
    }
}
