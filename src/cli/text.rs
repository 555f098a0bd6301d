//! The smallest text renderer: an 8 x 8 bitmap font, enlarged.

use font8x8::{BASIC_FONTS, UnicodeFonts};
use image::{Rgb, RgbImage};

/// Pixels of a character's side before it is enlarged.
pub(super) const CELL_PX: u32 = 8;

/// Writes one line with its top left at (x, y); what does not fit is cut, what the font lacks becomes `?`.
pub(super) fn write(picture: &mut RgbImage, (x, y): (u32, u32), scale: u32, colour: Rgb<u8>, text: &str) {
    let (width, height) = picture.dimensions();
    for (index, character) in (0_u32..).zip(text.chars()) {
        let Some(glyph) = BASIC_FONTS.get(character).or_else(|| BASIC_FONTS.get('?')) else { continue };
        let left = x + index * CELL_PX * scale;
        if left >= width {
            return;
        }
        for (row, bits) in (0_u32..).zip(glyph) {
            for column in (0..CELL_PX).filter(|column| bits >> column & 1 == 1) {
                let (u, v) = (left + column * scale, y + row * scale);
                for (du, dv) in (0..scale).flat_map(|du| (0..scale).map(move |dv| (du, dv))) {
                    if u + du < width && v + dv < height {
                        picture.put_pixel(u + du, v + dv, colour);
                    }
                }
            }
        }
    }
}

/// Breaks a sentence into lines of at most `room` characters, between words; a word longer than that has a line of its own.
pub(super) fn wrapped(text: &str, room: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= room => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_letter_has_its_shape_and_size() {
        let mut picture = RgbImage::new(40, 20);
        write(&mut picture, (2, 2), 2, Rgb([255, 0, 0]), "I.");
        let lit = |x0: u32, x1: u32| {
            (x0..x1).flat_map(|x| (0..20).map(move |y| (x, y))).filter(|&(x, y)| picture.get_pixel(x, y).0[0] > 0).count()
        };
        assert!(lit(2, 18) > lit(18, 34) && lit(18, 34) > 0);
        assert_eq!((lit(0, 2), lit(34, 40)), (0, 0));
    }

    #[test]
    fn sentences_are_broken_between_words() {
        assert_eq!(wrapped("no pose fits the picture", 9), ["no pose", "fits the", "picture"]);
        assert!(wrapped("", 9).is_empty());
    }

    #[test]
    fn text_beyond_the_edge_is_cut() {
        let mut picture = RgbImage::new(10, 5);
        write(&mut picture, (4, 1), 3, Rgb([9, 9, 9]), "MWé😀");
        assert!(picture.pixels().any(|p| p.0 == [9, 9, 9]));
    }
}
