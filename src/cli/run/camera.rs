//! The camera that a config and the arguments mean.

use std::path::Path;
use std::sync::Arc;

use crate::capture::PlayedClip;
use crate::capture::camera::CameraOpener;
use crate::cli::failure::Failure;
use crate::config::Settings;

/// What opens the camera: a clip that plays, or the config's device.
pub(super) fn camera(settings: &Settings, play: Option<&Path>) -> Result<Arc<dyn CameraOpener>, Failure> {
    match play {
        Some(clip) => Ok(Arc::new(PlayedClip::open(clip, settings.device.fps)?)),
        None => device(settings),
    }
}

#[cfg(feature = "live")]
fn device(settings: &Settings) -> Result<Arc<dyn CameraOpener>, Failure> {
    Ok(Arc::new(opener(settings)))
}

#[cfg(not(feature = "live"))]
fn device(_: &Settings) -> Result<Arc<dyn CameraOpener>, Failure> {
    Err(super::no_live_feature())
}

/// The config's V4L2 camera.
#[cfg(feature = "live")]
pub(in crate::cli) fn opener(settings: &Settings) -> crate::capture::v4l2::V4l2Opener {
    use crate::capture::camera::PixelLayout;
    use crate::capture::choice::Wanted;
    use crate::config::PixelFormat;
    use crate::config::as_typed::ControlValue;

    let device = &settings.device;
    let layout = device.format.map(|format| match format {
        PixelFormat::Mjpeg => PixelLayout::Mjpeg,
        PixelFormat::Yuyv => PixelLayout::Yuyv,
        PixelFormat::Nv12 => PixelLayout::Nv12,
        PixelFormat::Grey => PixelLayout::Grey,
        PixelFormat::Rgb => PixelLayout::Rgb,
    });
    let calibrated = settings.lens.size(&settings.camera);
    let wanted = Wanted { width: device.width, height: device.height, fps: device.fps, layout, calibrated };
    let value = |v: &ControlValue| match v {
        ControlValue::Integer(n) => *n,
        ControlValue::Switch(on) => i64::from(*on),
    };
    let controls = device.controls.iter().map(|(name, v)| (name.clone(), value(v))).collect();
    crate::capture::v4l2::V4l2Opener::new(device.device.clone().unwrap_or_else(|| "first".to_owned()), wanted, controls)
}
