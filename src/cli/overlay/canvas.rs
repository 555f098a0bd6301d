//! A picture to draw on: smooth lines with a dark seam, translucent panels, text.
//!
//! The seam keeps a line visible on pictures that are as bright as the line. Nothing here knows
//! what is drawn.

use image::RgbImage;
use nalgebra::Vector2;
use tiny_skia::{Color, FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Rect, Stroke, Transform};

use super::lettering::Lettering;

/// Red, green, blue.
pub(super) type Colour = [u8; 3];

/// Opacity of a panel, 0 to 1: white text stays readable on white pictures. Chosen for looks.
/// Raised, less of the stage shows through.
const PANEL: f32 = 0.68;
/// Opacity of a line's seam, 0 to 1. Chosen for looks. Raised, lines stand out more and hide more.
const SEAM: f32 = 0.55;

/// A picture being drawn on.
pub(super) struct Canvas {
    pixels: Pixmap,
}

impl Canvas {
    /// Copies a picture; `None` if it has no pixels.
    pub fn new(picture: &RgbImage) -> Option<Self> {
        let mut pixels = Pixmap::new(picture.width(), picture.height())?;
        for (to, from) in pixels.data_mut().chunks_exact_mut(4).zip(picture.pixels()) {
            to.copy_from_slice(&[from.0[0], from.0[1], from.0[2], 255]);
        }
        Some(Self { pixels })
    }

    /// Returns width and height, pixels.
    pub fn size(&self) -> [f32; 2] {
        [self.pixels.width() as f32, self.pixels.height() as f32]
    }

    /// Returns the drawn picture.
    pub fn finish(self) -> RgbImage {
        let mut picture = RgbImage::new(self.pixels.width(), self.pixels.height());
        // The base is opaque, so premultiplied and plain colours are equal.
        for (to, from) in picture.pixels_mut().zip(self.pixels.data().chunks_exact(4)) {
            to.0.copy_from_slice(&from[..3]);
        }
        picture
    }

    /// Draws lines through the points of each run, pixel centres at integers, `width` pixels thick
    /// without the seam.
    pub fn lines(&mut self, runs: &[Vec<Vector2<f64>>], width: f32, colour: Colour) {
        let Some(path) = path_of(runs) else { return };
        let stroke = |width| Stroke { width, line_cap: LineCap::Round, line_join: LineJoin::Round, ..Stroke::default() };
        let seam = (0.6 * width).max(1.0);
        self.pixels.stroke_path(&path, &paint([0; 3], SEAM), &stroke(width + 2.0 * seam), Transform::identity(), None);
        self.pixels.stroke_path(&path, &paint(colour, 1.0), &stroke(width), Transform::identity(), None);
    }

    /// Draws a filled disc with a seam.
    pub fn disc(&mut self, [x, y]: [f32; 2], radius: f32, seam: f32, colour: Colour) {
        for (radius, paint) in [(radius + seam, paint([0; 3], SEAM)), (radius, paint(colour, 1.0))] {
            if let Some(path) = PathBuilder::from_circle(x + 0.5, y + 0.5, radius) {
                self.pixels.fill_path(&path, &paint, FillRule::Winding, Transform::identity(), None);
            }
        }
    }

    /// Draws a dark panel to write on: left, top, width and height.
    pub fn panel(&mut self, place: [f32; 4]) {
        self.fill(place, &paint([12, 14, 18], PANEL));
    }

    /// Draws a filled rectangle: left, top, width and height.
    pub fn rect(&mut self, place: [f32; 4], colour: Colour) {
        self.fill(place, &paint(colour, 1.0));
    }

    fn fill(&mut self, [x, y, w, h]: [f32; 4], paint: &Paint<'_>) {
        if let Some(rect) = Rect::from_xywh(x, y, w, h) {
            self.pixels.fill_rect(rect, paint, Transform::identity(), None);
        }
    }

    /// Draws a frame along the picture's edge.
    pub fn border(&mut self, thickness: f32, colour: Colour) {
        let [w, h] = self.size();
        for side in
            [[0.0, 0.0, w, thickness], [0.0, h - thickness, w, thickness], [0.0, 0.0, thickness, h], [w - thickness, 0.0, thickness, h]]
        {
            self.rect(side, colour);
        }
    }

    /// Writes text at a place and clips what does not fit.
    pub fn text(&mut self, lettering: Lettering, at: (f32, f32), colour: Colour, text: &str) {
        let (width, height) = (self.pixels.width() as i32, self.pixels.height() as i32);
        let data = self.pixels.data_mut();
        lettering.draw(text, at, |x, y, share| {
            if (0..width).contains(&x) && (0..height).contains(&y) {
                let start = 4 * (y as usize * width as usize + x as usize);
                for (level, ink) in data[start..start + 3].iter_mut().zip(colour) {
                    *level = (f32::from(*level) + (f32::from(ink) - f32::from(*level)) * share).round() as u8;
                }
            }
        });
    }

    /// Writes text with a seam, for places without a panel.
    pub fn label(&mut self, lettering: Lettering, (x, baseline): (f32, f32), colour: Colour, text: &str) {
        let seam = (0.07 * lettering.size_px).max(1.0);
        for (dx, dy) in [(-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0), (-0.7, -0.7), (0.7, -0.7), (-0.7, 0.7), (0.7, 0.7)] {
            self.text(lettering, (x + seam * dx, (baseline + seam * dy).round()), [10, 12, 16], text);
        }
        self.text(lettering, (x, baseline), colour, text);
    }
}

fn paint([r, g, b]: Colour, opacity: f32) -> Paint<'static> {
    let mut paint = Paint { anti_alias: true, ..Paint::default() };
    let mut colour = Color::from_rgba8(r, g, b, 255);
    colour.set_alpha(opacity);
    paint.set_color(colour);
    paint
}

fn path_of(runs: &[Vec<Vector2<f64>>]) -> Option<Path> {
    let mut builder = PathBuilder::new();
    for run in runs {
        // Pixmap coordinates start at the pixel's corner, half a pixel before its centre.
        let mut points = run.iter().map(|p| (p.x as f32 + 0.5, p.y as f32 + 0.5));
        let Some((x, y)) = points.next() else { continue };
        builder.move_to(x, y);
        points.for_each(|(x, y)| builder.line_to(x, y));
    }
    builder.finish()
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    fn canvas(level: u8) -> Canvas {
        Canvas::new(&RgbImage::from_pixel(40, 30, Rgb([level; 3]))).unwrap()
    }

    #[test]
    fn a_line_covers_its_pixels_and_has_a_dark_seam_on_white() {
        let mut canvas = canvas(255);
        canvas.lines(&[vec![Vector2::new(-5.0, 10.0), Vector2::new(50.0, 10.0)]], 1.0, [60, 210, 80]);
        let picture = canvas.finish();
        assert_eq!(picture.get_pixel(20, 10).0, [60, 210, 80]);
        assert!(picture.get_pixel(20, 9).0[0] < 130 && picture.get_pixel(20, 11).0[0] < 130);
        assert_eq!(picture.get_pixel(20, 13).0, [255; 3]);
    }

    #[test]
    fn white_text_on_a_panel_is_readable_on_black_and_on_white() {
        for level in [0, 255] {
            let mut canvas = canvas(level);
            canvas.panel([0.0, 0.0, 40.0, 20.0]);
            canvas.text(Lettering { size_px: 16.0 }, (2.0, 15.0), [240; 3], "WH");
            let picture = canvas.finish();
            let levels: Vec<u8> = picture.pixels().take(40 * 20).map(|p| p.0[1]).collect();
            assert!(levels.iter().filter(|l| **l > 225).count() > 20, "{level}");
            assert!(levels.iter().filter(|l| **l < 100).count() > 200, "{level}");
            assert_eq!(picture.get_pixel(20, 25).0, [level; 3]);
        }
    }

    #[test]
    fn drawing_outside_the_picture_neither_writes_nor_panics() {
        let mut canvas = canvas(7);
        canvas.text(Lettering { size_px: 300.0 }, (-500.0, 10.0), [255; 3], "MMMMMMMM");
        canvas.label(Lettering { size_px: 20.0 }, (35.0, 500.0), [255; 3], "M");
        canvas.disc([1e6, -1e6], 5.0, 1.0, [1; 3]);
        canvas.panel([-10.0, -10.0, 5.0, 5.0]);
        canvas.lines(&[vec![], vec![Vector2::new(3.0, 3.0)], vec![Vector2::new(f64::NAN, 0.0), Vector2::new(1e30, 0.0)]], 1.0, [9; 3]);
        assert_eq!(canvas.finish().dimensions(), (40, 30));
        assert!(Canvas::new(&RgbImage::new(0, 3)).is_none());
    }
}
