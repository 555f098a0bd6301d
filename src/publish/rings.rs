//! Zoom and focus of a lens as another device reports them, for outputs that pass them on.

use std::sync::{Mutex, PoisonError};

use serde_json::{Value, json};

use crate::protocols::camera_packet::Ring;

/// FreeD's 24 bits.
const MAX_RAW: f64 = 16_777_215.0;
/// Counts of a normalised ring in FreeD, which has no scale of its own: 16 bits, as most encoders
/// have.
const NORMALISED_COUNTS: f64 = 65_535.0;

/// Positions of the rings; `None` before they are known.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Rings {
    /// Zoom.
    pub zoom: Option<Ring>,
    /// Focus.
    pub focus: Option<Ring>,
}

impl Rings {
    /// Returns a ring as FreeD's raw number.
    pub(super) fn freed(ring: Ring) -> u32 {
        // The casts are in range.
        match ring {
            Ring::Raw(counts) => counts.round().clamp(0.0, MAX_RAW) as u32,
            Ring::Normalised(share) => (share.clamp(0.0, 1.0) * NORMALISED_COUNTS).round() as u32,
        }
    }

    /// Adds the rings to OpenTrackIO's lens.
    pub(super) fn add_to_lens(&self, lens: &mut Value) {
        for (name, ring) in [("zoom", self.zoom), ("focus", self.focus)] {
            match ring {
                Some(Ring::Normalised(share)) => lens["encoders"][name] = json!(share.clamp(0.0, 1.0)),
                Some(Ring::Raw(counts)) => lens["rawEncoders"][name] = json!(counts.round().max(0.0) as u64),
                None => {}
            }
        }
    }
}

/// The rings that were heard last; a device that falls silent leaves them where they are.
#[derive(Debug, Default)]
pub struct HeardRings(Mutex<Rings>);

impl HeardRings {
    /// Notes what is known now; a ring that is not known keeps its position.
    pub fn set(&self, rings: Rings) {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        *known = Rings { zoom: rings.zoom.or(known.zoom), focus: rings.focus.or(known.focus) };
    }

    /// Returns the last positions.
    pub fn get(&self) -> Rings {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rings_keep_their_position_until_another_is_heard() {
        let heard = HeardRings::default();
        assert_eq!(heard.get(), Rings::default());
        heard.set(Rings { zoom: Some(Ring::Raw(5.0)), focus: Some(Ring::Normalised(0.5)) });
        heard.set(Rings { zoom: None, focus: Some(Ring::Normalised(0.25)) });
        assert_eq!(heard.get(), Rings { zoom: Some(Ring::Raw(5.0)), focus: Some(Ring::Normalised(0.25)) });
    }

    #[test]
    fn numbers_stay_within_their_formats() {
        let raw = [Ring::Raw(70_000.4), Ring::Raw(1e9), Ring::Raw(-3.0), Ring::Normalised(0.5), Ring::Normalised(1.5)].map(Rings::freed);
        assert_eq!(raw, [70_000, 0xFF_FFFF, 0, 32_768, 65_535]);
        let mut lens = json!({"pinholeFocalLength": 5.0});
        Rings { zoom: Some(Ring::Normalised(1.5)), focus: Some(Ring::Raw(12.0)) }.add_to_lens(&mut lens);
        assert_eq!(lens, json!({"pinholeFocalLength": 5.0, "encoders": {"zoom": 1.0}, "rawEncoders": {"focus": 12}}));
    }
}
