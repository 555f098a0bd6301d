//! Finds real clips beside the project, or skips them with a message. Also writes the config of a
//! stage that is a photograph.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Returns the path of a data set, or `None` with a message if it is absent.
pub fn data_set(name: &str) -> Option<PathBuf> {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data")).join(name);
    if !path.is_dir() {
        eprintln!("skipped: the clip {name} is not beside this project");
        return None;
    }
    Some(path)
}

/// Whether ffmpeg is installed; prints a message if it is not.
pub fn has_ffmpeg() -> bool {
    let found = Command::new("ffmpeg").arg("-version").stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok_and(|s| s.success());
    if !found {
        eprintln!("skipped: ffmpeg is not installed");
    }
    found
}

/// Extracts the first frame of a video as a picture.
pub fn extract_first_frame(video: &Path, picture: &Path) {
    let run = Command::new("ffmpeg").args(["-v", "error", "-i"]).arg(video).args(["-frames:v", "1"]).arg(picture).output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
}

/// A stage of one surface, seen in a photograph taken by the stage camera itself. That camera is
/// otherwise unknown.
pub struct PhotographedStage<'a> {
    pub photo: &'a Path,
    /// Clockwise from the top left.
    pub corners_px: [[f64; 2]; 4],
    /// Height over width.
    pub size_ratio: f64,
    pub frame_size: (u32, u32),
    /// Further sections for the config.
    pub more: &'a str,
}

impl PhotographedStage<'_> {
    /// Writes the config and a calibration: focal length 1.1 picture widths, no distortion, a
    /// surface one metre wide.
    pub fn write(&self, folder: &Path) -> PathBuf {
        let (width, height) = self.frame_size;
        let (w, h) = (f64::from(width), f64::from(height));
        let (focal, cx, cy) = (1.1 * w, (w - 1.0) / 2.0, (h - 1.0) / 2.0);
        let camera = format!(
            "width = {width}\nheight = {height}\nfx = {focal:?}\nfy = {focal:?}\ncx = {cx:?}\ncy = {cy:?}\nskew = 0.0\n\
             distortion = [0.0, 0.0, 0.0, 0.0, 0.0]\n"
        );
        std::fs::write(folder.join("camera.toml"), camera).unwrap();
        let stage = format!(
            "[camera]\ncalibration = \"camera.toml\"\n[[stage.surface]]\nphoto = {:?}\ncorners_px = {:?}\nsize_m = [1.0, {:?}]\n{}",
            self.photo, self.corners_px, self.size_ratio, self.more
        );
        let config = folder.join("stage.toml");
        std::fs::write(&config, stage).unwrap();
        config
    }
}
