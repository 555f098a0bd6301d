//! What one frame says of an unknown that is estimated over many frames.

/// What one frame says of an unknown that it did not solve for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clue {
    /// Information times the change that the residuals ask for.
    pub score: f64,
    /// Inverse variance of that change, all other unknowns being free.
    pub information: f64,
}
