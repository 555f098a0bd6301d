//! The light that each grey level of a camera stands for.
//!
//! A curve is a standard one, bent: between evenly spaced grey levels, the knots, a correction is
//! interpolated linearly. It is 0 at black and at white, because a scale of all light cannot be
//! distinguished from brighter lamps, nor an offset from haze.

use super::transfer::{FULL, Transfer};

/// Number of knots between black and white. Raised, sharper bends are followed, and each knot is
/// known less well.
pub const KNOTS: usize = 7;
/// Grey levels from one knot to the next.
const SPACING: f32 = 256.0 / (KNOTS + 1) as f32;
/// Minimum slope of a bent curve, as a fraction of the standard one's. Lowered, a curve may become
/// flat, and noise there counts for nothing.
const MIN_SLOPE_RATIO: f32 = 0.2;

/// Corrections at the knots, in units of light.
pub type Bend = [f32; KNOTS];

/// The curve of one camera, as a table over its grey levels.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraCurve {
    transfer: Transfer,
    bend: Bend,
    light: [f32; 256],
}

impl Default for CameraCurve {
    fn default() -> Self {
        Self::new(Transfer::default())
    }
}

impl CameraCurve {
    /// Creates the curve of a camera that encodes light in a standard way.
    pub fn new(transfer: Transfer) -> Self {
        Self::bent(transfer, &[0.0; KNOTS])
    }

    /// Creates a standard curve with corrections at its knots. It rises everywhere: where the
    /// corrections say otherwise, they are limited.
    pub fn bent(transfer: Transfer, bend: &Bend) -> Self {
        let standard: [f32; 256] = std::array::from_fn(|grey| FULL * transfer.decoded(grey as f32 / FULL));
        let mut light = standard;
        for grey in 1..256 {
            let correction: f32 = knots_at(grey as f32).iter().map(|(knot, weight)| weight * bend[*knot]).sum();
            let least = light[grey - 1] + MIN_SLOPE_RATIO * (standard[grey] - standard[grey - 1]);
            light[grey] = (standard[grey] + correction).max(least);
        }
        Self { transfer, bend: *bend, light }
    }

    /// Returns the same standard curve with other corrections.
    pub fn with_bend(&self, bend: &Bend) -> Self {
        Self::bent(self.transfer, bend)
    }

    /// Returns the corrections at the knots.
    pub fn bend(&self) -> &Bend {
        &self.bend
    }

    /// Returns the light of each grey level, 0 to 255.
    pub fn light(&self) -> &[f32; 256] {
        &self.light
    }

    /// Returns the grey level that stands for an amount of light, between levels.
    pub fn grey_of(&self, light: f32) -> f32 {
        let above = self.light.partition_point(|own| *own <= light).clamp(1, 255);
        let [low, high] = [self.light[above - 1], self.light[above]];
        (above - 1) as f32 + ((light - low) / (high - low)).clamp(0.0, 1.0)
    }

    /// Returns by how much light changes per grey level, at a grey level.
    pub fn slope(&self, grey: u8) -> f32 {
        let (low, high) = (grey.saturating_sub(1), grey.saturating_add(1));
        (self.light[usize::from(high)] - self.light[usize::from(low)]) / f32::from(high - low)
    }
}

/// Returns the two knots that a grey level lies between, with their weights; black and white, where
/// there is no knot, have the weight 0.
pub fn knots_at(grey: f32) -> [(usize, f32); 2] {
    let place = (grey / SPACING).clamp(0.0, KNOTS as f32 + 1.0 - 1e-3);
    let below = place as usize;
    let share = place - below as f32;
    [(below.saturating_sub(1), if below > 0 { 1.0 - share } else { 0.0 }), (below.min(KNOTS - 1), if below < KNOTS { share } else { 0.0 })]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_linear_camera_shows_light_itself() {
        let curve = CameraCurve::new(Transfer::Linear);
        assert!((0..=255u8).all(|grey| (curve.light()[usize::from(grey)] - f32::from(grey)).abs() < 1e-4));
        assert!((0..=255u8).all(|grey| (curve.slope(grey) - 1.0).abs() < 1e-4));
    }

    #[test]
    fn an_srgb_camera_spreads_dark_light_over_many_levels() {
        let curve = CameraCurve::default();
        assert!(curve.slope(0) < 0.1 && (0.9..1.0).contains(&curve.slope(128)) && curve.slope(255) > 2.2);
    }

    #[test]
    fn a_bent_curve_passes_its_knots_keeps_its_ends_and_rises() {
        let bend = [1.0, 3.0, 6.0, 10.0, 4.0, -8.0, -12.0];
        let (plain, bent) = (CameraCurve::default(), CameraCurve::bent(Transfer::Srgb, &bend));
        for (k, expected) in bend.iter().enumerate() {
            let grey = 32 * (k + 1);
            assert!((bent.light()[grey] - plain.light()[grey] - expected).abs() < 1e-3, "{grey}");
        }
        assert_eq!(bent.light()[0], 0.0);
        assert!((bent.light()[255] - 255.0).abs() < 0.5);
        for extreme in [bend, [200.0, -200.0, 200.0, -200.0, 200.0, -200.0, 200.0]] {
            let light = *CameraCurve::bent(Transfer::Srgb, &extreme).light();
            assert!(light.windows(2).all(|pair| pair[1] > pair[0]), "{extreme:?}");
        }
    }

    #[test]
    fn grey_inverts_light() {
        let curve = CameraCurve::bent(Transfer::Srgb, &[1.0, 3.0, 6.0, 10.0, 4.0, -8.0, -12.0]);
        for (grey, light) in curve.light().iter().enumerate() {
            assert!((curve.grey_of(*light) - grey as f32).abs() < 1e-2, "{grey}");
        }
        assert_eq!((curve.grey_of(-3.0), curve.grey_of(400.0)), (0.0, 255.0));
    }

    #[test]
    fn weights_of_the_knots_add_up_to_one_between_them() {
        for grey in 0..=255u8 {
            let sum: f32 = knots_at(f32::from(grey)).iter().map(|(_, weight)| weight).sum();
            let expected = if (32..=224).contains(&grey) { 1.0 } else { f32::from(grey.min(255 - grey)) / 32.0 };
            assert!((sum - expected).abs() < 0.05, "{grey}: {sum}");
        }
    }
}
