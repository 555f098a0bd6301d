//! How well the picture fits the pose, place by place: one small dot per cell of the frame.
//!
//! Alignment uses thousands of pixels. A mark for each would hide the picture that is to be
//! compared. So the frame is divided into cells, and the dot at the mean position of a cell's
//! pixels shows how well they fit on average.

use super::canvas::{Canvas, Colour};
use crate::track::UsedPixel;

/// Cells across the frame. Chosen for looks. Raised, the fit is resolved more finely, and the marks
/// hide more of the picture.
const ACROSS: f32 = 26.0;
/// Minimum side of a cell, pixels: dots of smaller cells would hide the picture. Raised, small
/// pictures have fewer cells.
const MIN_CELL_PX: f32 = 18.0;
/// Residuals beyond this many sigmas have no weight: the end of the aligner's kernel.
const COUNTS_NOTHING: f32 = crate::geometry::robust_kernel::TUKEY as f32;

/// Colour for pixels of rejected tiles, which show something else: grey, outside the fit's colour
/// scale.
pub(super) const LEFT_OUT: Colour = [165, 165, 170];

/// Returns the colour from fits (0) to no weight (1): green, yellow, red.
pub(super) fn fit_colour(share: f32) -> Colour {
    /// Start, middle and end of the scale: red, green and blue from 0 to 255.
    const GREEN: [f32; 3] = [60.0, 215.0, 85.0];
    const YELLOW: [f32; 3] = [250.0, 215.0, 60.0];
    const RED: [f32; 3] = [245.0, 55.0, 45.0];
    let share = share.clamp(0.0, 1.0);
    let (from, to, along) = if share < 0.5 { (GREEN, YELLOW, 2.0 * share) } else { (YELLOW, RED, 2.0 * share - 1.0) };
    std::array::from_fn(|k| (from[k] + (to[k] - from[k]) * along).round() as u8)
}

/// Accumulated pixels of a cell.
#[derive(Debug, Clone, Copy, Default)]
struct Cell {
    count: u32,
    left_out: u32,
    /// Sum of all pixels' positions.
    places: [f32; 2],
    /// Sum of the inliers' shares of the kernel's width.
    shares: f32,
}

impl Cell {
    fn add(&mut self, pixel: &UsedPixel) {
        self.count += 1;
        self.places = [self.places[0] + pixel.centre_px[0], self.places[1] + pixel.centre_px[1]];
        if pixel.takes_part {
            self.shares += (pixel.sigmas / COUNTS_NOTHING).clamp(0.0, 1.0);
        } else {
            self.left_out += 1;
        }
    }

    /// Returns the mean position of its pixels.
    fn middle(&self) -> [f32; 2] {
        self.places.map(|sum| sum / self.count.max(1) as f32)
    }

    /// Returns the dot's colour; `None` if the cell has no pixels.
    fn colour(&self) -> Option<Colour> {
        let taken = self.count - self.left_out;
        match (self.count, taken > self.left_out) {
            (0, _) => None,
            (_, true) => Some(fit_colour(self.shares / taken as f32)),
            (_, false) => Some(LEFT_OUT),
        }
    }
}

/// Draws a dot for each cell with pixels that alignment used.
pub(super) fn draw(canvas: &mut Canvas, pixels: &[UsedPixel]) {
    let [width, height] = canvas.size();
    let side = (width / ACROSS).max(MIN_CELL_PX);
    let (columns, rows) = ((width / side).ceil() as usize, (height / side).ceil() as usize);
    let mut cells = vec![Cell::default(); columns * rows];
    for pixel in pixels {
        let [column, row] = pixel.centre_px.map(|p| (p / side).floor());
        // Pixels outside the frame, or at NaN, have no cell.
        if column >= 0.0 && row >= 0.0 && (column as usize) < columns && (row as usize) < rows {
            cells[row as usize * columns + column as usize].add(pixel);
        }
    }
    let radius = dot_px(width);
    for (at, colour) in cells.iter().filter_map(|cell| Some((cell.middle(), cell.colour()?))) {
        canvas.disc(at, radius, (0.35 * radius).max(0.8), colour);
    }
}

/// Returns the radius of a cell's dot for a frame of this width.
fn dot_px(width: f32) -> f32 {
    (width / 420.0).max(1.5)
}

#[cfg(test)]
mod tests {
    use image::{Rgb, RgbImage};

    use super::*;

    fn pixel(x: f32, y: f32, sigmas: f32, takes_part: bool) -> UsedPixel {
        UsedPixel { centre_px: [x, y], sigmas, takes_part }
    }

    fn drawn(pixels: &[UsedPixel]) -> RgbImage {
        let mut canvas = Canvas::new(&RgbImage::from_pixel(640, 480, Rgb([100; 3]))).unwrap();
        draw(&mut canvas, pixels);
        canvas.finish()
    }

    fn has(picture: &RgbImage, colour: Colour) -> bool {
        picture.pixels().any(|p| p.0 == colour)
    }

    #[test]
    fn a_cell_is_coloured_by_how_its_pixels_fit() {
        assert!(has(&drawn(&[pixel(100.0, 100.0, 0.0, true)]), fit_colour(0.0)));
        assert!(has(&drawn(&[pixel(100.0, 100.0, 9.0, true)]), fit_colour(1.0)));
        let half = [pixel(100.0, 100.0, 0.0, true), pixel(102.0, 101.0, 9.0, true), pixel(101.0, 101.0, 0.0, false)];
        assert!(has(&drawn(&half), fit_colour(0.5)));
        assert!(has(&drawn(&half[1..]), LEFT_OUT));
        assert_eq!(drawn(&[pixel(f32::NAN, 0.0, 1.0, true), pixel(-1.0, 5.0, 1.0, true), pixel(1e9, 5.0, 1.0, true)]), drawn(&[]));
    }

    #[test]
    fn marks_leave_most_of_the_picture_untouched() {
        // Every pixel of the whole frame at half size was used.
        let all: Vec<UsedPixel> = (0..320 * 240).map(|k| pixel((k % 320) as f32 * 2.0, (k / 320) as f32 * 2.0, 1.0, true)).collect();
        let picture = drawn(&all);
        let untouched = picture.pixels().filter(|p| p.0 == [100; 3]).count() as f64 / f64::from(640 * 480);
        assert!(untouched > 0.93, "{untouched}");
    }
}
