//! What was learnt of cameras, kept between sessions: one small file per camera and mode. Also
//! reads what a recording says was known before its first row.

use std::io;
use std::path::{Path, PathBuf};

use super::own_folders::state_folder;
use crate::camera::Shutter;
use crate::capture::camera::CameraMode;
use crate::safe_file;
use crate::track::LearntCamera;

/// Maximum size of a snapshot that is read, bytes. Raised, foreign files cost more to refuse;
/// lowered, later snapshots may not fit.
pub const MAX_LEARNT_BYTES: u64 = 64 << 10;

/// Maximum size of a `clip.toml`, bytes. A round figure above any. Raised, a foreign file takes
/// more memory.
const MAX_ABOUT: u64 = 1 << 20;
/// Maximum characters of a camera's name in a file name. Raised, file systems refuse long names.
const MAX_NAME: usize = 80;

/// The file with what was learnt of a camera: named by its name, format, size, rate, and whether
/// its exposure is locked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LearntFile(PathBuf);

impl LearntFile {
    /// Returns the file for a camera as it was opened.
    pub fn of(mode: &CameraMode) -> Self {
        Self::within(&state_folder(), mode)
    }

    fn within(folder: &Path, mode: &CameraMode) -> Self {
        let is_locked = mode.exposure_s.is_some_and(|s| s > 0.0 && s <= Shutter::MAX_S);
        let (width, height) = mode.size;
        let name: String = mode.name.chars().map(|c| if c.is_alphanumeric() { c } else { '-' }).take(MAX_NAME).collect();
        let exposure = if is_locked { "locked" } else { "automatic" };
        let file = format!("{name}-{}-{width}x{height}-{:.2}-{exposure}.learnt", mode.layout.fourcc().trim(), mode.fps);
        Self(folder.join("cameras").join(file))
    }

    /// Loads what was learnt; empty if there is no file. An unusable file is logged once, and the
    /// camera is learnt anew.
    pub fn load(&self) -> LearntCamera {
        let bytes = match safe_file::read(&self.0, MAX_LEARNT_BYTES) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == io::ErrorKind::NotFound => return LearntCamera::default(),
            Err(e) => {
                tracing::warn!("{}: {e}; the camera is learnt again", self.0.display());
                return LearntCamera::default();
            }
        };
        LearntCamera::from_bytes(&bytes).unwrap_or_else(|e| {
            tracing::warn!("{}: {e}", self.0.display());
            LearntCamera::default()
        })
    }

    /// Stores what was learnt, if anything.
    pub fn store(&self, learnt: &LearntCamera) {
        if learnt.is_empty() {
            return;
        }
        let made = self.0.parent().map_or(Ok(()), std::fs::create_dir_all);
        if let Err(e) = made.and_then(|()| safe_file::write_whole(&self.0, &learnt.to_bytes())) {
            tracing::warn!("{}: what was learnt about the camera cannot be saved ({e}); the next start learns it again", self.0.display());
        }
    }
}

/// Returns what a recording says was known of the camera before its first row; empty if it says
/// nothing.
///
/// # Errors
/// Why its statement cannot be used.
pub fn learnt_of_clip(clip: &Path) -> Result<LearntCamera, String> {
    let about = about_clip(clip);
    let Some(text) = about.as_ref().and_then(|about| about.get("learnt")) else { return Ok(LearntCamera::default()) };
    let learnt = LearntCamera::from_bytes(text.as_str().unwrap_or_default().as_bytes());
    learnt.map_err(|e| format!("`learnt` in {}: {e}", clip.join("clip.toml").display()))
}

/// Returns how far UTC is ahead of a recording's clock, nanoseconds; `None` if its clip.toml does
/// not say.
pub fn utc_ahead_of_clip_ns(clip: &Path) -> Option<i64> {
    let about = about_clip(clip)?;
    let clock = about.get("clock")?;
    clock.get("utc_ns")?.as_integer()?.checked_sub(clock.get("monotonic_ns")?.as_integer()?)
}

/// Reads a recording's clip.toml; `None` if there is none, or it cannot be read.
fn about_clip(clip: &Path) -> Option<toml::Table> {
    let bytes = safe_file::read(&clip.join("clip.toml"), MAX_ABOUT).ok()?;
    String::from_utf8(bytes).ok()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::camera::PixelLayout;
    use crate::track::LearntTime;

    fn mode(name: &str, exposure_s: Option<f64>) -> CameraMode {
        CameraMode {
            name: name.to_owned(),
            size: (8, 6),
            layout: PixelLayout::Grey,
            fps: 30.0,
            exposure_s,
            controls: vec![],
            notes: vec![],
        }
    }

    fn learnt() -> LearntCamera {
        LearntCamera { readout: Some(LearntTime { seconds: 0.02, sigma_s: 1e-4 }), ..LearntCamera::default() }
    }

    #[test]
    fn each_camera_and_mode_has_its_own_learnt_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = LearntFile::within(folder.path(), &mode("../Cam: é/1", None));
        assert_eq!(file.load(), LearntCamera::default());
        file.store(&learnt());
        assert_eq!(file.load(), learnt());
        assert!(file.0.starts_with(folder.path().join("cameras")) && file.0.parent() == Some(&folder.path().join("cameras")));
        assert_eq!(LearntFile::within(folder.path(), &mode("../Cam: é/1", Some(0.01))).load(), LearntCamera::default());
        std::fs::write(&file.0, "stagepose learnt camera 9\n").unwrap();
        assert_eq!(file.load(), LearntCamera::default());
    }

    #[test]
    fn a_clip_restores_the_learnt_state_or_the_default() {
        let clip = tempfile::tempdir().unwrap();
        assert_eq!(learnt_of_clip(clip.path()), Ok(LearntCamera::default()));
        let about = |text: &str| std::fs::write(clip.path().join("clip.toml"), text).unwrap();
        about("program = \"stagepose\"\n");
        assert_eq!(learnt_of_clip(clip.path()), Ok(LearntCamera::default()));
        about(&format!("learnt = {:?}\n", String::from_utf8(learnt().to_bytes()).unwrap()));
        assert_eq!(learnt_of_clip(clip.path()), Ok(learnt()));
        for damaged in ["learnt = 7\n", "learnt = \"stagepose learnt camera 3\"\n"] {
            about(damaged);
            assert!(learnt_of_clip(clip.path()).unwrap_err().contains("learnt anew"), "{damaged}");
        }
    }
}
