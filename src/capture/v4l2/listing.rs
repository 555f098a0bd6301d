//! The listing of all cameras that `stagepose devices` prints.

use std::os::fd::RawFd;
use std::path::PathBuf;

use serde::Serialize;
use v4l::frameinterval::FrameIntervalEnum;
use v4l::framesize::FrameSizeEnum;
use v4l::video::Capture;
use v4l::{Device, FourCC};

use super::controls::plain_name;
use super::ioctl::{self, contained};
use super::nodes::{Node, camera_nodes, programs_that_hold};
use crate::capture::camera::PixelLayout;
use crate::capture::choice::Offer;

/// A camera.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DeviceListing {
    /// /dev/videoN.
    pub node: PathBuf,
    /// The camera's own name.
    pub name: String,
    /// The driver's name.
    pub driver: String,
    /// The bus address where it is plugged in.
    pub bus: String,
    /// Names that stay with the camera.
    pub by_id: Vec<PathBuf>,
    /// Names that stay with the port.
    pub by_path: Vec<PathBuf>,
    /// Formats with sizes and rates.
    pub formats: Vec<FormatListing>,
    /// Controls with ranges.
    pub controls: Vec<ControlListing>,
    /// Other programs that hold the camera open.
    pub held_by: Vec<String>,
}

/// A pixel format of a camera.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FormatListing {
    /// Four-letter code.
    pub fourcc: String,
    /// The driver's description.
    pub description: String,
    /// Whether this program can track from this format.
    pub usable: bool,
    /// Sizes with their rates.
    pub sizes: Vec<SizeListing>,
}

/// A size of a format.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SizeListing {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Pictures per second.
    pub fps: Vec<f64>,
}

/// A control of a camera.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ControlListing {
    /// Name as written in configs.
    pub name: String,
    /// V4L2's id.
    pub id: u32,
    /// integer, boolean, menu, button, bitmask or other.
    pub kind: &'static str,
    /// Minimum value.
    pub minimum: i64,
    /// Maximum value.
    pub maximum: i64,
    /// Step between values.
    pub step: u64,
    /// Factory default.
    pub default: i64,
    /// Current value, if it can be read.
    pub value: Option<i64>,
    /// False while an automatic mode overrides it.
    pub active: bool,
    /// Entries of a menu.
    pub menu: Vec<(u32, String)>,
}

/// Lists all cameras.
pub fn devices() -> Vec<DeviceListing> {
    camera_nodes().into_iter().filter_map(listing).collect()
}

fn listing(node: Node) -> Option<DeviceListing> {
    let device = Device::with_path(node.path()).ok()?;
    let formats = formats(&device);
    let controls = controls(device.handle().fd());
    let held_by = programs_that_hold(&node.path());
    let Node { card, driver, bus, by_id, by_path, .. } = node.clone();
    Some(DeviceListing { node: node.path(), name: card, driver, bus, by_id, by_path, formats, controls, held_by })
}

/// Returns the supported modes of a device with integer rates.
pub(super) fn offers(device: &Device) -> Vec<Offer> {
    let mut offers = Vec::new();
    for format in formats(device) {
        let Some(layout) = layout_of(&format.fourcc) else { continue };
        for size in &format.sizes {
            let rates = size.fps.iter().filter(|fps| (**fps - fps.round()).abs() < 1e-6 && **fps >= 1.0);
            offers.extend(rates.map(|fps| Offer { layout, width: size.width, height: size.height, fps: fps.round() as u32 }));
        }
    }
    offers
}

/// Returns the layout if nokhwa can read it. Grey is missing because nokhwa uses a name for it that
/// V4L2 does not know.
fn layout_of(fourcc: &str) -> Option<PixelLayout> {
    use PixelLayout::{Bgr, Mjpeg, Nv12, Rgb, Yuyv};
    [Mjpeg, Yuyv, Nv12, Rgb, Bgr].into_iter().find(|l| l.fourcc() == fourcc)
}

fn formats(device: &Device) -> Vec<FormatListing> {
    // Contained because the crate panics on names that are not UTF-8.
    let there = contained(|| device.enum_formats()).and_then(Result::ok).unwrap_or_default();
    let listing = |format: &v4l::format::Description| {
        let fourcc = String::from_utf8_lossy(&format.fourcc.repr).into_owned();
        let usable = layout_of(&fourcc).is_some();
        FormatListing { fourcc, description: format.description.clone(), usable, sizes: sizes(device, format.fourcc) }
    };
    there.iter().map(listing).collect()
}

/// Common camera sizes, listed for drivers that accept any size in a range, which would otherwise
/// be thousands.
const USUAL_SIZES: [(u32, u32); 8] = [(320, 240), (640, 360), (640, 480), (800, 600), (1280, 720), (1280, 960), (1920, 1080), (3840, 2160)];

fn sizes(device: &Device, fourcc: FourCC) -> Vec<SizeListing> {
    let there = contained(|| device.enum_framesizes(fourcc)).and_then(Result::ok).unwrap_or_default();
    let mut sizes: Vec<(u32, u32)> = Vec::new();
    for size in there {
        match size.size {
            FrameSizeEnum::Discrete(d) => sizes.push((d.width, d.height)),
            FrameSizeEnum::Stepwise(s) => {
                let fits = |(w, h): &(u32, u32)| (s.min_width..=s.max_width).contains(w) && (s.min_height..=s.max_height).contains(h);
                sizes.extend(USUAL_SIZES.iter().filter(|size| fits(size)));
                sizes.push((s.max_width, s.max_height));
            }
        }
    }
    sizes.sort_unstable();
    sizes.dedup();
    sizes.into_iter().map(|(width, height)| SizeListing { width, height, fps: rates(device, fourcc, width, height) }).collect()
}

/// Common integer rates, frames per second, listed for drivers that accept any rate in a range.
const USUAL_RATES: [f64; 8] = [5.0, 10.0, 15.0, 24.0, 25.0, 30.0, 50.0, 60.0];

fn rates(device: &Device, fourcc: FourCC, width: u32, height: u32) -> Vec<f64> {
    let there = contained(|| device.enum_frameintervals(fourcc, width, height)).and_then(Result::ok).unwrap_or_default();
    let rate = |f: &v4l::Fraction| f64::from(f.denominator) / f64::from(f.numerator.max(1));
    let mut rates: Vec<f64> = Vec::new();
    for interval in &there {
        match &interval.interval {
            FrameIntervalEnum::Discrete(f) => rates.push(rate(f)),
            FrameIntervalEnum::Stepwise(s) => {
                let (slowest, fastest) = (rate(&s.max), rate(&s.min));
                rates.extend(USUAL_RATES.iter().filter(|r| (slowest..=fastest).contains(*r)));
            }
        }
    }
    rates.sort_by(f64::total_cmp);
    rates.dedup();
    rates
}

fn controls(fd: RawFd) -> Vec<ControlListing> {
    /// V4L2_CTRL_FLAG_DISABLED and V4L2_CTRL_FLAG_WRITE_ONLY (linux/videodev2.h).
    const DISABLED: u32 = 0x1;
    const WRITE_ONLY: u32 = 0x40;
    let usable = |c: &ioctl::ControlDescription| c.kind != 6 && c.kind < 0x100 && c.flags & DISABLED == 0;
    let listing = |c: ioctl::ControlDescription| {
        let kind = match c.kind {
            1 | 5 => "integer",
            2 => "boolean",
            3 | 9 => "menu",
            4 => "button",
            8 => "bitmask",
            _ => "other",
        };
        let last = c.maximum.min(c.minimum.saturating_add(64));
        let entries = (c.minimum..=last).filter(|_| kind == "menu").filter_map(|i| u32::try_from(i).ok());
        let menu = entries.filter_map(|i| Some((i, ioctl::menu_entry(fd, c.id, i)?))).collect();
        let readable = c.kind != 4 && c.flags & WRITE_ONLY == 0;
        ControlListing {
            name: plain_name(&c.name),
            id: c.id,
            kind,
            minimum: c.minimum,
            maximum: c.maximum,
            step: c.step,
            default: c.default,
            value: readable.then(|| ioctl::control_value(fd, c.id).ok()).flatten(),
            active: c.flags & 0x10 == 0,
            menu,
        }
    };
    ioctl::controls(fd).into_iter().filter(usable).map(listing).collect()
}
