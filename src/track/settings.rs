//! The tunables of the tracker, each with its meaning, default and cost.

/// How the tracker works; the defaults suit a stage camera.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct TrackerSettings {
    /// Worker threads inside one frame; the result does not depend on it. Default 1.
    pub threads: usize,
    /// Corners looked for in a frame. More find a small or dim stage sooner; cost grows in proportion. Default 1500.
    pub features: usize,
    /// Longest prediction after the last verified pose, seconds: at least to the next frame of a slow camera; 0: none. Default 0.2.
    pub coast_s: f64,
    /// Consecutive verified frames that must agree before a found pose is published as `tracking`, at least 2. Default 2.
    pub confirm_frames: u32,
    /// Seed of the robust estimators. Another seed gives another, equally good, answer in the last digits. Default 1.
    pub seed: u64,
    /// Whether covariances contain what the calibration's doubt leaves open. Without, they are what many frames average away; whether the lens was
    /// moved is judged by the doubt in any case. Default true; no cost.
    pub adds_lens_doubt: bool,
    /// Whether frames are only tried: what they say of the lens is not logged. Default false.
    pub is_trial: bool,
}

impl Default for TrackerSettings {
    fn default() -> Self {
        Self { threads: 1, features: 1500, coast_s: 0.2, confirm_frames: 2, seed: 1, adds_lens_doubt: true, is_trial: false }
    }
}
