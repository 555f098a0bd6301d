//! The standard curves between light and grey levels.

/// Grey level of full light, and the light that it stands for.
pub const FULL: f32 = 255.0;

/// How a picture or a camera encodes light as grey levels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Transfer {
    /// sRGB (IEC 61966-2-1): nearly all pictures and most webcams.
    #[default]
    Srgb,
    /// ITU-R BT.709: video cameras.
    Bt709,
    /// Grey levels are proportional to light.
    Linear,
}

/// A curve that is a line near black, and a power of light above: the grey is
/// `(1 + offset) light^(1 / exponent) - offset`.
struct Power {
    /// Light below which the curve is a line.
    line_ends_at: f32,
    line_slope: f32,
    offset: f32,
    exponent: f32,
}

/// IEC 61966-2-1.
const SRGB: Power = Power { line_ends_at: 0.003_130_8, line_slope: 12.92, offset: 0.055, exponent: 2.4 };
/// ITU-R BT.709.
const BT709: Power = Power { line_ends_at: 0.018, line_slope: 4.5, offset: 0.099, exponent: 1.0 / 0.45 };

impl Power {
    fn decoded(&self, grey: f32) -> f32 {
        if grey <= self.line_slope * self.line_ends_at {
            grey / self.line_slope
        } else {
            ((grey + self.offset) / (1.0 + self.offset)).powf(self.exponent)
        }
    }

    fn encoded(&self, light: f32) -> f32 {
        if light <= self.line_ends_at {
            light * self.line_slope
        } else {
            (1.0 + self.offset) * light.powf(1.0 / self.exponent) - self.offset
        }
    }
}

impl Transfer {
    /// Whether grey levels are nearly square roots of light, as those of all common encodings are;
    /// otherwise they are light itself.
    pub fn is_root(self) -> bool {
        self != Self::Linear
    }

    /// Returns the light that a grey stands for; both 0 to 1.
    pub fn decoded(self, grey: f32) -> f32 {
        match self {
            Self::Srgb => SRGB.decoded(grey),
            Self::Bt709 => BT709.decoded(grey),
            Self::Linear => grey,
        }
    }

    /// Returns the grey that stands for an amount of light; both 0 to 1.
    pub fn encoded(self, light: f32) -> f32 {
        match self {
            Self::Srgb => SRGB.encoded(light),
            Self::Bt709 => BT709.encoded(light),
            Self::Linear => light,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encoding_inverts_decoding_and_both_rise() {
        for transfer in [Transfer::Srgb, Transfer::Bt709, Transfer::Linear] {
            let mut last = -1.0;
            for grey in (0..=255u8).map(|grey| f32::from(grey) / FULL) {
                let light = transfer.decoded(grey);
                assert!(light > last, "{transfer:?} {grey}");
                assert!((transfer.encoded(light) - grey).abs() < 1e-4, "{transfer:?} {grey}");
                last = light;
            }
            assert_eq!((transfer.decoded(0.0), transfer.decoded(1.0)), (0.0, 1.0), "{transfer:?}");
        }
    }

    #[test]
    fn middle_grey_is_a_fifth_of_the_light() {
        assert!((Transfer::Srgb.decoded(128.0 / FULL) - 0.2159).abs() < 1e-4);
        assert!((Transfer::Bt709.decoded(0.5) - 0.2596).abs() < 1e-4);
    }
}
