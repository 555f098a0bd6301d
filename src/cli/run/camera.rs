//! The camera that the config and the arguments select.

use std::path::Path;
use std::sync::Arc;

use crate::capture::PlayedClip;
use crate::capture::camera::CameraOpener;
use crate::cli::failure::Failure;
use crate::config::Settings;

/// Returns what opens the camera: a clip that plays, or the config's device.
pub(super) fn camera(settings: &Settings, play: Option<&Path>) -> Result<Arc<dyn CameraOpener>, Failure> {
    match play {
        Some(clip) => {
            let played = PlayedClip::open(clip, settings.device.fps)?;
            played.notes().iter().for_each(|note| tracing::warn!("{note}"));
            Ok(Arc::new(played))
        }
        #[cfg(feature = "live")]
        None => Ok(Arc::new(opener(settings))),
        #[cfg(not(feature = "live"))]
        None => Err(super::no_live_feature()),
    }
}

/// Returns what opens a camera to look at before there is a config: a clip that plays, or the
/// device of this name; `None` if there is neither.
pub(super) fn previewed(device: Option<&str>, play: Option<&Path>) -> Result<Option<Arc<dyn CameraOpener>>, Failure> {
    match (play, device) {
        (Some(clip), _) => Ok(Some(Arc::new(PlayedClip::open(clip, None)?))),
        (None, None) => Ok(None),
        #[cfg(feature = "live")]
        (None, Some(device)) => {
            use crate::capture::choice::Wanted;
            let opener = crate::capture::v4l2::V4l2Opener::new(device.to_owned(), Wanted::default(), Default::default());
            Ok(Some(Arc::new(opener)))
        }
        #[cfg(not(feature = "live"))]
        (None, Some(_)) => Err(super::no_live_feature()),
    }
}

/// Returns the config's V4L2 camera.
#[cfg(feature = "live")]
pub(in crate::cli) fn opener(settings: &Settings) -> crate::capture::v4l2::V4l2Opener {
    use crate::capture::choice::Wanted;
    let device = &settings.device;
    let calibrated = settings.lens.size(&settings.camera);
    let wanted = Wanted { width: device.width, height: device.height, fps: device.fps, layout: device.format, calibrated };
    let name = device.device.clone().unwrap_or_else(|| "first".to_owned());
    crate::capture::v4l2::V4l2Opener::new(name, wanted, device.controls.clone())
}
