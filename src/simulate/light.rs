//! How light becomes grey levels.
//!
//! Light adds up: what falls on one pixel, through one exposure, from several lamps. Grey levels do
//! not, for a camera writes them along a curve. [`LightModel::Linear`] decodes the artwork's sRGB
//! to light, so that samples, blur, lamps and noise add up there, and then clips and encodes as a
//! camera does. [`LightModel::GreyAverages`] adds up the grey levels themselves, which no camera
//! does, but which gives the figures of old.

/// The grey level of full light, and the light that gives it: both scales end here.
const FULL: f32 = 255.0;
/// Below this share of full light, sRGB is a straight line (IEC 61966-2-1).
const LINE_ENDS_AT: f32 = 0.003_130_8;
/// Slope of that line.
const LINE_SLOPE: f32 = 12.92;
/// Above it, sRGB is a power of the light with this exponent's inverse, shifted and scaled by the
/// offset.
const EXPONENT: f32 = 2.4;
/// See [`EXPONENT`].
const OFFSET: f32 = 0.055;

/// In what light is added up.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub enum LightModel {
    /// Grey levels are averaged and multiplied as they are.
    #[default]
    GreyAverages,
    /// Light is added up, clipped at full light, and written along the camera's curve.
    Linear(ToneCurve),
}

/// The camera's curve from light to grey levels: sRGB's, then an S.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ToneCurve {
    /// How much of the S: 0 is sRGB alone, 1 is a smooth step. Dark becomes darker, light becomes
    /// lighter.
    pub contrast: f32,
}

impl LightModel {
    /// The light, up to 255, that a surface painted with a grey level sends back in full light.
    pub(super) fn light_of(self, grey: f32) -> f32 {
        match self {
            Self::GreyAverages => grey,
            Self::Linear(_) => FULL * decoded(grey / FULL),
        }
    }

    /// The grey level, not yet rounded, that the camera writes for an amount of light.
    pub(super) fn grey_of(self, light: f32) -> f32 {
        match self {
            // Rounding clips.
            Self::GreyAverages => light,
            Self::Linear(curve) => FULL * curve.apply(encoded((light / FULL).clamp(0.0, 1.0))),
        }
    }
}

impl ToneCurve {
    /// From 0..=1 to 0..=1.
    fn apply(self, x: f32) -> f32 {
        x + self.contrast * (x * x * (3.0 - 2.0 * x) - x)
    }
}

/// sRGB to a share of full light.
fn decoded(grey: f32) -> f32 {
    if grey <= LINE_SLOPE * LINE_ENDS_AT { grey / LINE_SLOPE } else { ((grey + OFFSET) / (1.0 + OFFSET)).powf(EXPONENT) }
}

/// A share of full light to sRGB.
fn encoded(light: f32) -> f32 {
    if light <= LINE_ENDS_AT { light * LINE_SLOPE } else { (1.0 + OFFSET) * light.powf(1.0 / EXPONENT) - OFFSET }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        // Known values of the standard: the straight part and the curve.
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
