//! The progress of a survey, and its errors.

use thiserror::Error;

/// What a survey is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SurveyStep {
    /// Tracking the camera through a frame of a clip.
    Frame,
    /// Tracking a frame again, by its number.
    Again(usize),
    /// A round of the adjustment.
    Round(usize),
}

/// Why a survey failed.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum SurveyError {
    /// The stage is in no frame.
    #[error("the stage is found in none of the {frames} frames; `stagepose check --clip` says why")]
    NotFound {
        /// Number of frames examined.
        frames: usize,
    },
    /// The camera was in too few places.
    #[error(
        "the camera came to {found} places only, at least {least} are needed; walk around the stage, a step to the side for each metre of distance"
    )]
    TooFewPlaces {
        /// Number of places.
        found: usize,
        /// Minimum number.
        least: usize,
    },
    /// The equations have no solution.
    #[error("the walk does not determine the stage; film it from more sides")]
    Undetermined,
    /// A stop was requested.
    #[error("interrupted; nothing was written")]
    Interrupted,
}
