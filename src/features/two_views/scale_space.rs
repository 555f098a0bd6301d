//! The Gaussian scale space of a picture: octaves of increasingly smoothed copies, each octave half
//! as large as the previous (Lowe, Distinctive Image Features from Scale-Invariant Keypoints, IJCV
//! 2004, section 3).
//!
//! The first octave is the picture doubled, which finds four times as many keypoints (section 3.3).
//! Doubling puts the centre of the first pixel a quarter of a picture pixel before the picture's,
//! and taking every second pixel keeps the first one's centre. So each octave's pixel c is at
//! `c * step - 0.25` in the picture.

use nalgebra::Vector2;

use super::watch::Watch;
use crate::features::float_image::FloatImage;

/// Scales per octave: 3 gives the most repeatable keypoints (Lowe 2004, figure 3). Raised, more and
/// less stable ones are found, and it takes longer.
pub const SCALES: usize = 3;
/// Copies per octave: an extremum of [`SCALES`] differences has a neighbour on either side, and a
/// difference has two copies.
pub const LEVELS: usize = SCALES + 3;
/// Sigma of the first copy of an octave, its own pixels (Lowe 2004, section 3.3). Raised,
/// repeatability improves a little and it costs more.
pub const BASE_SIGMA: f64 = 1.6;
/// Blur already present in a camera's picture, sigma in pixels (Lowe 2004, section 3.3: at least
/// this against aliasing). Raised, less is added.
const CAMERA_SIGMA: f64 = 0.5;
/// Minimum side of an octave, pixels; a smaller one has hardly any pixels inside the border that
/// extrema keep.
const MIN_SIDE: usize = 12;
/// Position of the first pixel of every octave in the picture, pixels across and down.
const ORIGIN: f64 = -0.25;

/// Copies of one size, increasingly smoothed.
#[derive(Debug, Clone, PartialEq)]
pub struct Octave {
    /// Pixel spacing in picture pixels: 0.5, 1, 2, ….
    pub step: f64,
    /// [`LEVELS`] copies.
    pub levels: Vec<FloatImage>,
}

impl Octave {
    /// Returns the sigma of a copy in the octave's own pixels, also between two copies.
    pub fn sigma(level: f64) -> f64 {
        BASE_SIGMA * (level / SCALES as f64).exp2()
    }

    /// Converts a position in the octave to the picture.
    pub fn in_picture(&self, place: Vector2<f64>) -> Vector2<f64> {
        place.map(|c| c * self.step + ORIGIN)
    }

    /// Converts a position in the picture to the octave.
    pub fn in_octave(&self, place: Vector2<f64>) -> Vector2<f64> {
        place.map(|c| (c - ORIGIN) / self.step)
    }
}

/// Increasingly smoothed copies of a picture.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ScaleSpace {
    /// Largest octave first; empty if the picture is too small.
    pub octaves: Vec<Octave>,
}

impl ScaleSpace {
    /// Builds the scale space of a picture.
    #[cfg(test)]
    pub fn of(picture: &FloatImage) -> Self {
        Self::watched(picture, &Watch::NONE)
    }

    /// Builds the scale space of a picture; returns the octaves so far if the work was stopped.
    pub(super) fn watched(picture: &FloatImage, watch: &Watch) -> Self {
        let mut octaves: Vec<Octave> = Vec::new();
        let mut row = Vec::new();
        let enough = |side: usize| side >= MIN_SIDE;
        if picture.width == 0 || !enough(2 * picture.width.min(picture.height)) {
            return Self { octaves };
        }
        let mut base = FloatImage::default();
        // Variances add up; the picture's counts four times in the doubled one. The variance added
        // by interpolation (3/16) is ignored, as Lowe does: counting it loses structures at the
        // limit of the finest scale, a sixth of the true matches between photographs.
        picture.doubled().blur_into((BASE_SIGMA.powi(2) - 4.0 * CAMERA_SIGMA.powi(2)).sqrt(), &mut base, &mut row);
        let mut step = 0.5;
        loop {
            let Some(levels) = smoothed(base, &mut row, watch) else { return Self { octaves } };
            let octave = Octave { step, levels };
            base = octave.levels[SCALES].decimated();
            octaves.push(octave);
            step *= 2.0;
            if !enough(base.width.min(base.height)) {
                return Self { octaves };
            }
        }
    }

    /// Returns the copy with smoothing nearest to `sigma` picture pixels; `None` if there are no
    /// octaves.
    pub fn nearest(&self, sigma: f64) -> Option<SmoothedCopy<'_>> {
        self.copy(self.level(sigma)?.round())
    }

    /// Returns the smoothest copy of at most `sigma` picture pixels, else the first; `None` if
    /// there are no octaves.
    pub fn at_most(&self, sigma: f64) -> Option<SmoothedCopy<'_>> {
        self.copy(self.level(sigma)?.floor())
    }

    /// Returns the fractional index of the copy with this smoothing, counted from the first one of
    /// the first octave.
    fn level(&self, sigma: f64) -> Option<f64> {
        let first = self.octaves.first()?.step * BASE_SIGMA;
        // A rounding error must not select the previous copy.
        Some((sigma / first).max(1.0).log2() * SCALES as f64 + 1e-6)
    }

    fn copy(&self, level: f64) -> Option<SmoothedCopy<'_>> {
        // The first copy of an octave has the same smoothing as one of the previous octave, which
        // is larger: use that.
        let number = (((level - 1.0) / SCALES as f64).floor().max(0.0) as usize).min(self.octaves.len() - 1);
        let within = (level as usize).saturating_sub(number * SCALES).min(SCALES);
        let octave = self.octaves.get(number)?;
        Some(SmoothedCopy { octave, image: octave.levels.get(within)?, sigma: Octave::sigma(within as f64) * octave.step })
    }
}

/// One copy of a scale space.
#[derive(Debug, Clone)]
pub struct SmoothedCopy<'a> {
    /// Its octave.
    pub octave: &'a Octave,
    /// Its pixels.
    pub image: &'a FloatImage,
    /// Its smoothing, sigma in picture pixels.
    pub sigma: f64,
}

/// Builds the copies of an octave from its first; `None` if the work was stopped.
fn smoothed(base: FloatImage, row: &mut Vec<f32>, watch: &Watch) -> Option<Vec<FloatImage>> {
    let mut levels = vec![base];
    for level in watch.over(1..LEVELS) {
        // Each is computed from the previous: variances add up, so a small kernel suffices.
        let [before, after] = [level - 1, level].map(|l| Octave::sigma(l as f64).powi(2));
        let mut next = FloatImage::default();
        levels[level - 1].blur_into((after - before).sqrt(), &mut next, row);
        levels.push(next);
    }
    (levels.len() == LEVELS).then_some(levels)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A Gaussian blob on grey.
    fn blob(width: usize, height: usize, middle: [f64; 2], sigma: f64) -> FloatImage {
        let value = |k: usize| {
            let [x, y] = [(k % width) as f64 - middle[0], (k / width) as f64 - middle[1]];
            (50.0 + 150.0 * (-0.5 * (x * x + y * y) / (sigma * sigma)).exp()) as f32
        };
        FloatImage { width, height, values: (0..width * height).map(value).collect() }
    }

    #[test]
    fn every_level_has_its_stated_position_and_smoothing() {
        let (middle, own) = ([70.3, 58.8], 3.0);
        let space = ScaleSpace::of(&blob(141, 120, middle, own));
        assert!(space.octaves.len() >= 4, "{}", space.octaves.len());
        for octave in &space.octaves[..3] {
            for (level, image) in octave.levels.iter().enumerate() {
                let mut sums = [0.0; 4];
                for (k, value) in image.values.iter().enumerate() {
                    let at = octave.in_picture(Vector2::new((k % image.width) as f64, (k / image.width) as f64));
                    let (weight, [x, y]) = (f64::from(value - 50.0), [at.x - middle[0], at.y - middle[1]]);
                    for (sum, term) in sums.iter_mut().zip([1.0, x, y, 0.5 * (x * x + y * y)]) {
                        *sum += weight * term;
                    }
                }
                let [x, y, variance] = [1, 2, 3].map(|k| sums[k] / sums[0]);
                assert!(x.abs() < 0.01 && y.abs() < 0.01, "step {}, level {level}: {x} {y}", octave.step);
                // The scale includes a camera's blur, which this picture lacks; it does not include
                // interpolation's.
                let smoothing = (variance - own * own + CAMERA_SIGMA * CAMERA_SIGMA - 3.0 / 16.0).sqrt();
                let expected = Octave::sigma(level as f64) * octave.step;
                assert!((smoothing / expected - 1.0).abs() < 0.02, "step {}, level {level}: {smoothing} not {expected}", octave.step);
            }
        }
    }

    #[test]
    fn positions_convert_to_the_picture_and_back() {
        let space = ScaleSpace::of(&FloatImage::new(64, 50));
        let place = Vector2::new(10.0, 20.0);
        assert_eq!(space.octaves[0].in_picture(Vector2::new(21.0, 0.0)), Vector2::new(10.25, -0.25));
        for octave in &space.octaves {
            assert!((octave.in_picture(octave.in_octave(place)) - place).norm() < 1e-12);
        }
    }

    #[test]
    fn the_nearest_level_has_the_requested_smoothing() {
        let space = ScaleSpace::of(&FloatImage::new(200, 160));
        for (sigma, step, level) in [(0.1, 0.5, 0), (0.8, 0.5, 0), (1.0, 0.5, 1), (1.6, 0.5, 3), (2.0, 1.0, 1), (12.8, 4.0, 3)] {
            let copy = space.nearest(sigma).unwrap();
            assert_eq!(copy.octave.step, step, "{sigma}");
            assert!(std::ptr::eq(copy.image, &copy.octave.levels[level]), "{sigma}");
            assert!((copy.sigma / sigma.max(0.8)).log2().abs() <= 0.5 / SCALES as f64, "{sigma}: {}", copy.sigma);
            let lower = space.at_most(1.2 * sigma).unwrap().sigma;
            assert!(lower <= (1.2 * sigma).max(0.8) * 1.0001 && lower > 0.75 * 1.2 * sigma.min(12.0), "{sigma}: {lower}");
        }
        assert!(space.nearest(1e9).is_some() && space.nearest(f64::NAN).is_some());
    }

    #[test]
    fn pictures_too_small_have_no_scale_space() {
        for (width, height) in [(0, 0), (0, 50), (50, 1), (5, 5)] {
            let space = ScaleSpace::of(&FloatImage::new(width, height));
            assert!(space.octaves.is_empty() && space.nearest(2.0).is_none(), "{width} x {height}");
        }
        assert!(!ScaleSpace::of(&FloatImage::new(6, 6)).octaves.is_empty());
    }
}
