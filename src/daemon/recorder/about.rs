//! Writes clip.toml (the camera, its controls, and how the clip's clock relates to UTC) and the
//! config next to it.

use std::io;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::Serialize;

use super::disk::Disk;
use crate::capture::camera::CameraMode;
use crate::capture::timestamping::monotonic_now;
use crate::config::ConfigSource;
use crate::frame::Timestamp;
use crate::track::LearntCamera;
use crate::utc;

/// A clip's description.
#[derive(Debug, Clone)]
pub struct AboutClip {
    /// The camera as it was opened.
    pub camera: CameraMode,
    /// The config as it was read, with all files it names.
    pub config: ConfigSource,
    /// The exposure that the tracker uses, seconds; 0 = unknown. The config's copy states it if the
    /// config does not.
    pub exposure_s: f64,
}

#[derive(Serialize)]
struct ClipToml<'a> {
    program: String,
    begun_utc: String,
    /// The config for a replay.
    config: &'a str,
    /// What was known of the camera before the first row.
    #[serde(skip_serializing_if = "Option::is_none")]
    learnt: Option<String>,
    clock: Clock,
    camera: Camera<'a>,
}

/// The clip's stamps are monotonic; both clocks were read at the same moment.
#[derive(Serialize)]
struct Clock {
    monotonic_ns: Timestamp,
    utc_ns: i64,
}

#[derive(Serialize)]
struct Camera<'a> {
    name: &'a str,
    width: u32,
    height: u32,
    format: &'a str,
    fps: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    exposure_s: Option<f64>,
    controls: std::collections::BTreeMap<&'a str, i64>,
}

impl AboutClip {
    /// Writes clip.toml and config/ into a clip; `learnt` is what was known of the camera before
    /// its first row.
    pub fn write(&self, clip: &Path, learnt: &LearntCamera, disk: &mut dyn Disk) -> io::Result<()> {
        self.write_about(clip, learnt, disk)?;
        let config = clip.join("config");
        disk.make_folder(&config)?;
        let files = self.config.copy((self.exposure_s > 0.0).then_some(self.exposure_s))?;
        files.iter().try_for_each(|(name, bytes)| disk.write_file(&config.join(name), bytes))
    }

    /// Writes only clip.toml.
    pub fn write_about(&self, clip: &Path, learnt: &LearntCamera, disk: &mut dyn Disk) -> io::Result<()> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let clock = Clock { monotonic_ns: monotonic_now(), utc_ns: i64::try_from(now.as_nanos()).unwrap_or(i64::MAX) };
        let CameraMode { name, size: (width, height), layout, fps, exposure_s, controls, notes: _ } = &self.camera;
        let controls = controls.iter().map(|(name, value)| (name.as_str(), *value)).collect();
        let camera = Camera { name, width: *width, height: *height, format: layout.fourcc(), fps: *fps, exposure_s: *exposure_s, controls };
        let about = ClipToml {
            program: format!("stagepose {}", env!("CARGO_PKG_VERSION")),
            begun_utc: utc::date_and_time(now.as_secs()),
            config: "config/stage.toml",
            learnt: (!learnt.is_empty()).then(|| String::from_utf8_lossy(&learnt.to_bytes()).into_owned()),
            clock,
            camera,
        };
        let text = toml::to_string(&about).map_err(io::Error::other)?;
        disk.write_file(&clip.join("clip.toml"), text.as_bytes())
    }
}
