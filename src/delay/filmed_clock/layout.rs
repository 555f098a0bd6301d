//! The code: the time in whole milliseconds as a Gray code of 28 bits, each bit once as it is and
//! once inverted, inside a black ring.
//!
//! ```text
//! ##################   18 x 8 cells, with a white margin around; a ring of black cells,
//! #m               #   inside it a ring of white ones with a black mark m at the top left,
//! # bbbbbbbbbbbbbb #   bits 0 to 13 and, below each, its inverse,
//! # iiiiiiiiiiiiii #   bits 14 to 27 and, below each, its inverse.
//! # bbbbbbbbbbbbbb #   A bit of 1 is a white cell.
//! # iiiiiiiiiiiiii #
//! #                #
//! ##################
//! ```
//! Between successive times few bits of a Gray code change (Gray 1953), so that a frame that sees
//! two of them has few grey cells. `src/web/page/clock.js` draws the same.

use nalgebra::Vector2;

/// Size of the code with its black ring, cells.
pub const SIZE: [usize; 2] = [18, 8];
/// Number of bits: three days of milliseconds.
pub const BITS: usize = 28;
/// Bits in a row of cells.
const BITS_PER_ROW: usize = 14;
/// The first cell of the first bit.
const FIRST: [usize; 2] = [2, 2];

/// Distance of points on the white margin from the ring, cells; the margin is one cell wide.
const MARGIN: f64 = 0.5;

/// Number of times that the code can show before it begins again.
pub const PERIOD_MS: u32 = 1 << BITS;

/// Returns the Gray code of a number.
#[cfg(test)]
pub const fn gray(number: u32) -> u32 {
    number ^ (number >> 1)
}

/// Returns the number with this Gray code.
pub fn number(gray: u32) -> u32 {
    [1, 2, 4, 8, 16].into_iter().fold(gray, |code, shift| code ^ (code >> shift))
}

/// Returns the centres of a bit's cell and of its inverse, in cells from the code's top left
/// corner.
pub fn bit_centres(bit: usize) -> [Vector2<f64>; 2] {
    let (column, row) = (FIRST[0] + bit % BITS_PER_ROW, FIRST[1] + 2 * (bit / BITS_PER_ROW));
    [row, row + 1].map(|row| Vector2::new(column as f64 + 0.5, row as f64 + 0.5))
}

/// Returns the centres of the cells of the ring `inset` cells inside the outermost one.
pub fn ring_centres(inset: usize) -> impl Iterator<Item = Vector2<f64>> {
    let [width, height] = SIZE;
    let is_on_ring = move |[column, row]: [usize; 2]| {
        let depth = column.min(width - 1 - column).min(row).min(height - 1 - row);
        depth == inset
    };
    let cells = (0..height).flat_map(move |row| (0..width).map(move |column| [column, row]));
    cells.filter(move |cell| is_on_ring(*cell)).map(|[column, row]| Vector2::new(column as f64 + 0.5, row as f64 + 0.5))
}

/// Returns points on the white margin around the code.
pub fn margin_points() -> impl Iterator<Item = Vector2<f64>> {
    let [width, height] = SIZE.map(|size| size as f64);
    let along = |length: f64| (0..=length as usize).map(|k| k as f64);
    let across = along(width).flat_map(move |x| [-MARGIN, height + MARGIN].map(|y| Vector2::new(x, y)));
    across.chain(along(height).flat_map(move |y| [-MARGIN, width + MARGIN].map(|x| Vector2::new(x, y))))
}

/// The centre of the mark that tells top from bottom.
pub fn mark_centre() -> Vector2<f64> {
    Vector2::new(1.5, 1.5)
}

/// Returns whether a cell is white while the code shows this time; `None` for cells without
/// meaning.
#[cfg(test)]
pub fn is_white([column, row]: [usize; 2], shown_ms: u32) -> Option<bool> {
    let at = Vector2::new(column as f64 + 0.5, row as f64 + 0.5);
    let bit = (0..BITS).find_map(|bit| bit_centres(bit).iter().position(|centre| *centre == at).map(|inverted| (bit, inverted == 1)));
    if let Some((bit, is_inverted)) = bit {
        return Some((gray(shown_ms % PERIOD_MS) >> bit & 1 == 1) != is_inverted);
    }
    if ring_centres(0).any(|centre| centre == at) || at == mark_centre() {
        return Some(false);
    }
    ring_centres(1).any(|centre| centre == at).then_some(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gray_codes_of_neighbours_differ_in_one_bit_and_are_inverted_exactly() {
        for k in (0..PERIOD_MS).step_by(104_729).chain(0..2000) {
            assert_eq!((gray(k) ^ gray(k + 1)).count_ones(), 1);
            assert_eq!(number(gray(k)), k);
        }
    }

    #[test]
    fn the_code_is_the_page_s() {
        // The page's test has the same rows (`tests/page/clock.test.mjs`).
        let cell = |column: usize, row: usize| if is_white([column, row], 123_456_789) == Some(true) { ' ' } else { '#' };
        let rows: Vec<String> = (0..SIZE[1]).map(|row| (0..SIZE[0]).map(|column| cell(column, row)).collect()).collect();
        assert_eq!(
            rows,
            [
                "##################",
                "##               #",
                "#      ##   # #  #",
                "# #####  ### # # #",
                "# ###  #    ## # #",
                "#    ## ####  #  #",
                "#                #",
                "##################",
            ]
        );
    }
}
