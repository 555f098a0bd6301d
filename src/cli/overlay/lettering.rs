//! Text in pictures, in one proportional typeface that is built into the program.
//!
//! The typeface is DejaVu Sans Condensed, reduced to Latin, Greek and Cyrillic and a few signs (its
//! licence is in this folder). Its digits have equal widths, so numbers do not jitter from one
//! video frame to the next.

use std::sync::LazyLock;

use ab_glyph::{Font, FontRef, PxScale, ScaleFont, point};

/// The captions' typeface, reduced to the letters they need.
static TYPEFACE: LazyLock<FontRef<'static>> = LazyLock::new(|| {
    FontRef::try_from_slice(include_bytes!("DejaVuSansCondensed-subset.ttf"))
        .expect("the typeface is part of the program, and a test reads it")
});

/// Line spacing as a share of the type size. Chosen for DejaVu Sans, whose letters take 1.16.
/// Raised, panels are taller.
pub(super) const LINE: f32 = 1.28;
/// Ascent of a line above its baseline, as a share of the type size: a little more than DejaVu's
/// 0.93. Raised, text sits lower in its panel.
pub(super) const ASCENT: f32 = 0.98;

/// Lettering of one size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lettering {
    /// Height of the em square, pixels.
    pub size_px: f32,
}

impl Lettering {
    /// Converts the em square's height to `ab_glyph`'s scale, the height from the lowest to the
    /// highest letter.
    fn scale(self) -> PxScale {
        let font = &*TYPEFACE;
        let per_em = font.units_per_em().unwrap_or(2048.0);
        PxScale::from(self.size_px * font.height_unscaled() / per_em)
    }

    /// Returns a text's width, pixels.
    pub fn width_px(self, text: &str) -> f32 {
        let font = TYPEFACE.as_scaled(self.scale());
        text.chars().map(|c| font.h_advance(font.glyph_id(c))).sum()
    }

    /// Calls `dot` with each pixel that a text covers and its coverage, 0 to 1; the text starts at
    /// `(x, baseline)`.
    pub fn draw(self, text: &str, (x, baseline): (f32, f32), mut dot: impl FnMut(i32, i32, f32)) {
        let scale = self.scale();
        let font = TYPEFACE.as_scaled(scale);
        let mut pen = x;
        for character in text.chars() {
            let id = font.glyph_id(character);
            // Place letters on whole rows, so that horizontal strokes stay sharp.
            let glyph = id.with_scale_and_position(scale, point(pen, baseline.round()));
            pen += font.h_advance(id);
            let Some(outline) = TYPEFACE.outline_glyph(glyph) else { continue };
            let bounds = outline.px_bounds();
            outline.draw(|u, v, share| dot(bounds.min.x as i32 + u as i32, bounds.min.y as i32 + v as i32, share.clamp(0.0, 1.0)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ink(text: &str, size_px: f32) -> (f32, [i32; 4]) {
        let (mut sum, mut bounds) = (0.0, [i32::MAX, i32::MAX, i32::MIN, i32::MIN]);
        Lettering { size_px }.draw(text, (0.0, 100.0), |x, y, share| {
            sum += share;
            if share > 0.3 {
                bounds = [bounds[0].min(x), bounds[1].min(y), bounds[2].max(x), bounds[3].max(y)];
            }
        });
        (sum, bounds)
    }

    #[test]
    fn letters_have_their_size_and_sit_on_the_baseline() {
        let (sum, [_, top, right, bottom]) = ink("H", 40.0);
        // A capital is 0.73 em high in this typeface.
        assert!((98..=100).contains(&bottom) && (28..=31).contains(&(bottom - top)), "{top} {bottom}");
        assert!(sum > 150.0 && (right as f32) < Lettering { size_px: 40.0 }.width_px("H"));
        assert_eq!(ink(" ", 40.0).0, 0.0);
    }

    #[test]
    fn digits_are_equally_wide_and_symbols_are_present() {
        let width = |text: &str| Lettering { size_px: 20.0 }.width_px(text);
        assert!("0123456789+\u{2212}".chars().all(|c| c == '+' || c == '\u{2212}' || (width(&c.to_string()) - width("0")).abs() < 1e-3));
        // A missing letter is drawn as a box. These are not.
        let lacking = ink("\u{1F600}", 30.0);
        for sign in ["\u{b0}", "\u{2212}", "é", "Ж", "Ω", "\u{b1}", "\u{2013}"] {
            assert_ne!(ink(sign, 30.0), lacking, "{sign}");
        }
    }
}
