//! A frame's estimate of an unknown that it did not solve for, such as the exposure or the readout.
//! The clues of many frames together estimate the unknown.

/// A frame's estimate of an unknown that it did not solve for: it should change by `score` /
/// `information`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clue {
    /// Information times the change that the residuals ask for.
    pub score: f64,
    /// Inverse variance of that change, with all other unknowns free.
    pub information: f64,
}
