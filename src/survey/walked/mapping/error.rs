//! The steps of a mapping, and why a walk yields no map.

use thiserror::Error;

use super::super::progress::{SurveyError, SurveyStep};
use super::measuring::Contradiction;
use crate::track::SurfaceError;

/// What a mapping is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MapStep {
    /// Recognising points in the keyframes, and adjusting them.
    Points,
    /// Finding the facets.
    Facets,
    /// Painting the facets, by round from 0.
    Textures(usize),
    /// Locating keyframes on a map of the others.
    HoldOut,
    /// A step of the survey of the painted stage.
    Survey(SurveyStep),
}

/// Why a walk yields no map.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum MapError {
    /// As for a survey.
    #[error(transparent)]
    Survey(#[from] SurveyError),
    /// The camera stayed in one place.
    #[error(
        "the walk spans {extent_m:.1} m at {distance_m:.1} m from the set, too little to measure depths: walk from one side of the set \
         to the other, a step to the side for each metre of distance"
    )]
    TooLittleParallax {
        /// Largest distance between two keyframes, metres.
        extent_m: f64,
        /// Median distance from the set, metres.
        distance_m: f64,
    },
    /// Too little was recognised from several places.
    #[error(
        "only {found} points of the set were recognised from several places, at least {least} are needed: film it sharper, brighter, or where \
         it has more detail"
    )]
    TooFewPoints {
        /// Number of points.
        found: usize,
        /// Minimum number.
        least: usize,
    },
    /// No two frames show enough of the set from different places.
    #[error(
        "no two frames show enough of the set from different places: put a poster (`stagepose poster`) into the set as [[stage.surface]], or \
         film it sharper, brighter, and with a step to the side for each metre of distance"
    )]
    NoStart,
    /// A named point that too few keyframes show.
    #[error(
        "{entry}: only {found} of the frames in which it was clicked could be used, two are needed: click it in other frames, sharp ones \
         from different places"
    )]
    PointUnseen {
        /// The point's place in the config.
        entry: String,
        /// Number of frames.
        found: usize,
    },
    /// Clicks that do not mean the same point.
    #[error("{entry}: its clicks are up to {off_px:.0} px from where the others put it: check the pixels and the frames (`seen`)")]
    PointScattered {
        /// The point's place in the config.
        entry: String,
        /// Largest distance, pixels.
        off_px: f64,
    },
    /// A measurement that all else contradicts.
    #[error("{}", contradiction(.0))]
    Contradicted(Contradiction),
    /// The points lie on no flat parts.
    #[error("none of the {points} points lie on flat parts that several keyframes show alike: the set may move, or have no flat parts")]
    NoFacets {
        /// Number of points.
        points: usize,
    },
    /// The pictures show too little light.
    #[error("the walk is too dark: light the set, open the iris or expose longer ({0})")]
    TooDark(Box<Self>),
    /// Motion or focus blurs the pictures.
    #[error("the walk is blurred: walk more slowly, expose more briefly, and check the focus ({0})")]
    TooBlurred(Box<Self>),
    /// A rolling shutter, whose shear the walk does not tell well enough.
    #[error(
        "the shutter rolls ({:.0} ms from the first row to the last), and the walk does not tell well enough how the camera moved while \
         its rows were read: walk more slowly, with more frames per second, and with the poster larger in the picture ({error})",
        1e3 * readout_s
    )]
    Rolling {
        /// From the first row to the last, seconds.
        readout_s: f64,
        /// What failed.
        error: Box<Self>,
    },
    /// A facet cannot be a surface.
    #[error("a facet cannot be tracked: {0}")]
    Facet(#[from] SurfaceError),
}

impl MapError {
    /// Returns why the adjustment of a walk with a rolling shutter failed.
    pub(super) fn of_rolling(self, readout_s: f64) -> Self {
        match self {
            Self::Survey(SurveyError::Undetermined) | Self::NoFacets { .. } => Self::Rolling { readout_s, error: Box::new(self) },
            error => error,
        }
    }
}

/// Describes a contradiction.
fn contradiction(of: &Contradiction) -> String {
    let Contradiction { entry, lengths_m, off_m, sigmas } = of;
    match lengths_m {
        Some([stated, others]) => format!(
            "{entry} says {stated:.4} m where the walk and everything else that was measured say {others:.4} m ({sigmas:.0} sigmas): measure it \
             again, and check which points it names, and the size of the surfaces"
        ),
        None => format!(
            "{entry} is {:.1} mm from where the walk and everything else that was measured put it ({sigmas:.0} sigmas): measure it again, \
             and check the clicks",
            1e3 * off_m
        ),
    }
}
