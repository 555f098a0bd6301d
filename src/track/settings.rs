//! The tracker's settings, each with its meaning, default and cost.

use crate::light::Transfer;

/// How the tracker works; the defaults suit a stage camera.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct TrackerSettings {
    /// Worker threads within one frame; the result does not depend on it. Default 1.
    pub threads: usize,
    /// Maximum corners extracted from a frame. Raised, a small or dim stage is found sooner; the
    /// cost grows in proportion. Default 1500.
    pub features: usize,
    /// Maximum time to predict after the last verified pose, seconds; extended to the next frame of
    /// a slow camera; 0 disables prediction. Default 0.2.
    pub coast_s: f64,
    /// Consecutive verified frames that must agree before a found pose is published as `tracking`,
    /// at least 2. Default 2.
    pub confirm_frames: u32,
    /// Seed of the robust estimators. Another seed yields an equally good result that differs in
    /// the last digits. Default 1.
    pub seed: u64,
    /// Whether covariances include the calibration's uncertainty. Without it they describe only the
    /// noise that many frames average away. Detection of a moved lens uses that uncertainty in any
    /// case. Default true; no cost.
    pub adds_lens_doubt: bool,
    /// How the camera encodes light. Default `None`: unknown, taken to be sRGB.
    pub transfer: Option<Transfer>,
    /// Whether frames are only tried: findings about the lens are then not logged. Default false.
    pub is_trial: bool,
}

impl Default for TrackerSettings {
    fn default() -> Self {
        Self {
            threads: 1,
            features: 1500,
            coast_s: 0.2,
            confirm_frames: 2,
            seed: 1,
            adds_lens_doubt: true,
            transfer: None,
            is_trial: false,
        }
    }
}
