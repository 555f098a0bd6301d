//! What a survey does at the moment, and why there is none.

use thiserror::Error;

/// What a survey does at the moment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SurveyStep {
    /// Following the camera through a frame of a clip.
    Frame,
    /// Looking at a frame once more, by its number.
    Again(usize),
    /// A round of the adjustment.
    Round(usize),
}

/// Why there is no survey.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum SurveyError {
    /// No stage in any frame.
    #[error("the stage is found in none of the {frames} frames; `stagepose check --clip` says why")]
    NotFound {
        /// Frames looked at.
        frames: usize,
    },
    /// Too few places.
    #[error(
        "the camera came to {found} places only, at least {least} are needed; walk around the stage, a step to the side for each metre of distance"
    )]
    TooFewPlaces {
        /// Places.
        found: usize,
        /// Needed.
        least: usize,
    },
    /// The equations have no solution.
    #[error("the walk does not determine the stage; film it from more sides")]
    Undetermined,
    /// The end was asked for.
    #[error("interrupted; nothing was written")]
    Interrupted,
}
