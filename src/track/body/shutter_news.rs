//! News about the shutter; each item is reported once per session.

use super::learnt_camera::LearntTime;

/// What frames showed about the shutter.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum ShutterNews {
    /// The readout time was not configured, and is now known.
    ReadoutLearnt(LearntTime),
    /// Frames contradict the configured readout time.
    ReadoutContradicted {
        /// As configured, seconds.
        configured_s: f64,
        /// What the frames fit.
        found: LearntTime,
    },
    /// The blur of moving frames contradicts the configured exposure time.
    ExposureContradicted {
        /// As configured, seconds.
        configured_s: f64,
        /// What the frames fit, seconds.
        found_s: f64,
    },
}

impl ShutterNews {
    /// Returns a sentence that includes the fix.
    pub fn text(&self) -> String {
        match self {
            Self::ReadoutLearnt(LearntTime { seconds: 0.0, .. }) => {
                "the shutter is known now: all rows are exposed together (shutter = \"global\")".to_owned()
            }
            Self::ReadoutLearnt(LearntTime { seconds: readout_s, sigma_s }) => {
                let [readout_ms, sigma_ms] = [readout_s, sigma_s].map(|s| 1e3 * s);
                format!("the shutter is known now: rows are read in {readout_ms:.2} ms +- {sigma_ms:.2} (readout_s = {readout_s:.5})")
            }
            Self::ReadoutContradicted { configured_s, found: LearntTime { seconds: readout_s, sigma_s } } => format!(
                "readout_s is configured as {configured_s}, but the rows of the frames fit {readout_s:.5} +- {sigma_s:.5}: poses of a \
                 moving camera are less sure; correct readout_s, or remove it so that it is learnt"
            ),
            Self::ExposureContradicted { configured_s, found_s } => format!(
                "exposure_s is configured as {configured_s}, but the blur of moving frames fits about {found_s:.4}: poses of a moving \
                 camera are less sure; correct exposure_s, or remove it so that it is learnt"
            ),
        }
    }

    /// Whether the user should act on it.
    pub fn is_warning(&self) -> bool {
        !matches!(self, Self::ReadoutLearnt(_))
    }
}
