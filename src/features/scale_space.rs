//! The Gaussian scale space of a picture: octaves of ever smoother copies, each octave half as large as the one before (Lowe 2004, section 3).

use super::float_image::FloatImage;

/// Ever smoother copies of a picture.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ScaleSpace {
    /// Largest pictures first.
    pub octaves: Vec<Vec<FloatImage>>,
}

impl ScaleSpace {
    /// Of a picture.
    pub fn of(picture: &FloatImage) -> Self {
        Self { octaves: vec![vec![picture.clone()]] }
    }
}
