//! Conversion between light and grey levels.
//!
//! Light is additive: over a pixel, over an exposure, and from several lamps. Grey levels are not,
//! because a camera encodes light along a curve. [`LightModel::Linear`] decodes the artwork's sRGB
//! to light, adds up samples, blur, lamps and noise there, and then clips and encodes as a camera
//! does. [`LightModel::GreyAverages`] adds up the grey levels themselves. No camera does that, but
//! it reproduces earlier figures.

use crate::light::Transfer;
use crate::light::transfer::FULL;

/// The quantity in which light is added up.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum LightModel {
    /// Grey levels are averaged and multiplied directly.
    GreyAverages,
    /// Light is added up, clipped at full light, and encoded along the camera's curve.
    Linear(ToneCurve),
}

/// The camera's curve from light to grey levels: sRGB followed by an S-curve.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ToneCurve {
    /// Strength of the S-curve: 0 is sRGB alone, 1 is a smooth step. Raised, dark becomes darker
    /// and light becomes lighter.
    pub contrast: f32,
}

impl Default for LightModel {
    fn default() -> Self {
        Self::Linear(ToneCurve::default())
    }
}

impl LightModel {
    /// Returns the light, up to 255, that a surface painted with a grey level reflects in full
    /// light.
    pub(super) fn light_of(self, grey: f32) -> f32 {
        match self {
            Self::GreyAverages => grey,
            Self::Linear(_) => FULL * Transfer::Srgb.decoded(grey / FULL),
        }
    }

    /// Returns the grey level, not yet rounded, that the camera writes for an amount of light.
    pub(super) fn grey_of(self, light: f32) -> f32 {
        match self {
            // The later rounding clips.
            Self::GreyAverages => light,
            Self::Linear(curve) => FULL * curve.apply(Transfer::Srgb.encoded((light / FULL).clamp(0.0, 1.0))),
        }
    }
}

impl ToneCurve {
    /// Maps 0..=1 to 0..=1.
    fn apply(self, x: f32) -> f32 {
        x + self.contrast * (x * x * (3.0 - 2.0 * x) - x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Linear light without contrast.
    const SRGB: LightModel = LightModel::Linear(ToneCurve { contrast: 0.0 });

    #[test]
    fn half_of_full_light_is_grey_level_188() {
        assert_eq!(SRGB.grey_of(0.5 * (SRGB.light_of(0.0) + SRGB.light_of(255.0))).round(), 188.0);
        assert_eq!(LightModel::GreyAverages.grey_of(0.5 * (0.0 + 255.0)), 127.5);
    }

    #[test]
    fn every_grey_level_comes_back() {
        for grey in 0..=255_u8 {
            let grey = f32::from(grey);
            assert!((SRGB.grey_of(SRGB.light_of(grey)) - grey).abs() < 0.01, "{grey}");
        }
        // Known values of the standard: the linear part and the curve.
        assert!((SRGB.light_of(5.0) - 5.0 / 12.92).abs() < 1e-3);
        assert!((SRGB.light_of(128.0) - 55.04).abs() < 0.05, "{}", SRGB.light_of(128.0));
    }

    #[test]
    fn more_than_full_light_is_clipped() {
        assert_eq!([400.0, 255.0, -3.0].map(|light| SRGB.grey_of(light).round()), [255.0, 255.0, 0.0]);
    }

    #[test]
    fn contrast_bends_the_middle_and_keeps_the_ends() {
        let tone = LightModel::Linear(ToneCurve { contrast: 0.6 });
        let grey = |of: f32| tone.grey_of(tone.light_of(of));
        assert!(grey(64.0) < 50.0 && grey(192.0) > 205.0, "{} {}", grey(64.0), grey(192.0));
        assert!(grey(0.0).abs() < 1e-3 && (grey(255.0) - 255.0).abs() < 1e-3 && (grey(127.5) - 127.5).abs() < 0.05);
    }
}
