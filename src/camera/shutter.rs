//! The shutter: when and for how long each row is exposed.

/// The times of a camera's shutter. The default is a global or unknown shutter with unknown
/// exposure.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Shutter {
    /// Exposure time of each row, seconds. 0: unknown; the tracker estimates it while the camera
    /// moves.
    pub exposure_s: f64,
    /// Readout time from the first row to the last, seconds. 0: global shutter or unknown.
    /// Estimates may be negative: rows are read from the bottom up.
    pub readout_s: f64,
}

/// What is known of a camera's shutter beforehand. `None` values are estimated from frames while
/// the camera moves.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct KnownShutter {
    /// Exposure time of each row, seconds, above 0.
    pub exposure_s: Option<f64>,
    /// Readout time from the first row to the last, seconds. `Some(0.0)`: a global shutter, which
    /// exposes all rows together.
    pub readout_s: Option<f64>,
}

impl KnownShutter {
    /// Returns the times, with 0 for unknown ones.
    pub fn or_zero(&self) -> Shutter {
        Shutter { exposure_s: self.exposure_s.unwrap_or(0.0), readout_s: self.readout_s.unwrap_or(0.0) }
    }
}

impl From<Shutter> for KnownShutter {
    /// Treats the readout as known, even if 0. An exposure of 0 is impossible, so it means unknown.
    fn from(shutter: Shutter) -> Self {
        Self { exposure_s: Some(shutter.exposure_s).filter(|s| *s != 0.0), readout_s: Some(shutter.readout_s) }
    }
}

impl Shutter {
    /// Maximum time that a config may state, seconds. Cameras at 1 frame per second reach it;
    /// longer values are mostly milliseconds. Raised, such a mistake by a factor of 1000 passes.
    pub const MAX_S: f64 = 1.0;

    /// Whether all rows are exposed together, or the readout is unknown.
    pub(crate) fn is_global(&self) -> bool {
        self.readout_s == 0.0
    }

    /// Returns the name and value of a time that no shutter can have.
    pub fn impossible_time(&self) -> Option<(&'static str, f64)> {
        if !(self.exposure_s.is_finite() && self.exposure_s >= 0.0) {
            return Some(("exposure_s", self.exposure_s));
        }
        (!self.readout_s.is_finite()).then_some(("readout_s", self.readout_s))
    }

    /// Returns seconds from the frame's stamp to mid-exposure at `y` pixels below the upper edge of
    /// a frame of this height. Rows start `readout_s` / height apart; the middle of row r is at r +
    /// 0.5.
    pub fn delay_s(&self, y: f64, height: u32) -> f64 {
        self.readout_s * (y / f64::from(height) - 0.5)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_global_shutter_is_known_and_an_unknown_one_is_not() {
        let global = KnownShutter::from(Shutter::default());
        assert_eq!((global.readout_s, global.exposure_s), (Some(0.0), None));
        assert_ne!(global, KnownShutter::default());
        assert_eq!(global.or_zero(), KnownShutter::default().or_zero());
    }

    #[test]
    fn the_first_row_is_half_a_readout_before_the_middle_row() {
        let shutter = Shutter { exposure_s: 0.0, readout_s: 0.02 };
        assert_eq!(shutter.delay_s(180.0, 360), 0.0);
        assert!((shutter.delay_s(0.5, 360) + 0.01).abs() < 1e-4 && (shutter.delay_s(359.5, 360) - 0.01).abs() < 1e-4);
        assert_eq!(Shutter::default().delay_s(3.0, 360), 0.0);
    }

    #[test]
    fn impossible_shutter_times_are_named() {
        let named = |exposure_s, readout_s| Shutter { exposure_s, readout_s }.impossible_time().map(|(name, _)| name);
        assert_eq!([named(0.0, 0.0), named(0.01, -0.02)], [None; 2]);
        assert_eq!([-0.1, f64::NAN, f64::INFINITY].map(|exposure_s| named(exposure_s, 0.0)), [Some("exposure_s"); 3]);
        assert_eq!([f64::NAN, f64::NEG_INFINITY].map(|readout_s| named(0.0, readout_s)), [Some("readout_s"); 2]);
    }
}
