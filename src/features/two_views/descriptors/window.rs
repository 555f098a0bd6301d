//! Reads the pixels of a region row by row, with Gaussian weights around its centre.

use std::ops::RangeInclusive;

use super::region::Region;

/// The rows and columns of a window, clipped to pixels with neighbours on all sides.
#[derive(Debug, Default)]
pub struct Window {
    /// Weight of each column.
    columns: Vec<f32>,
    /// First and last column.
    across: (isize, isize),
    /// First and last row.
    down: (isize, isize),
    /// Minus half the inverse variance of the weights.
    exponent: f64,
}

impl Window {
    /// Sets the window to `reach` pixels around the centre of a region, with Gaussian weights of
    /// `sigma` pixels.
    pub fn set(&mut self, region: &Region, reach: f64, sigma: f64) {
        let span = |middle: f64, side: usize| {
            ((middle - reach).ceil().max(1.0) as isize, (middle + reach).floor().min(side as f64 - 2.0) as isize)
        };
        self.across = span(region.middle.x, region.image.width);
        self.down = span(region.middle.y, region.image.height);
        self.exponent = -0.5 / (sigma * sigma);
        self.columns.clear();
        self.columns.extend((self.across.0..=self.across.1).map(|x| ((x as f64 - region.middle.x).powi(2) * self.exponent).exp() as f32));
    }

    /// Returns its rows.
    pub fn rows(&self) -> RangeInclusive<isize> {
        self.down.0..=self.down.1
    }

    /// Returns the pixels `low` to `high` columns from the centre in row `y`: the position of the
    /// first one, its row with those above and below (each with one more pixel at either end), the
    /// column weights, and the row weight. `None` if there is no pixel.
    pub fn row<'a>(&'a self, region: &Region<'a>, y: isize, low: f64, high: f64) -> Option<WindowRow<'a>> {
        let first = ((region.middle.x + low).ceil() as isize).max(self.across.0);
        let last = ((region.middle.x + high).floor() as isize).min(self.across.1);
        if first > last {
            return None;
        }
        let rows = [y - 1, y, y + 1].map(|y| &region.image.row(y as usize)[first as usize - 1..last as usize + 2]);
        let weights = &self.columns[(first - self.across.0) as usize..=(last - self.across.0) as usize];
        let weight = ((y as f64 - region.middle.y).powi(2) * self.exponent).exp() as f32;
        let place = [first as f64 - region.middle.x, y as f64 - region.middle.y].map(|v| v as f32);
        Some(WindowRow { place, rows, weights, weight })
    }
}

/// Part of a row of a window.
#[derive(Debug)]
pub struct WindowRow<'a> {
    /// Column and row of the first pixel relative to the region's centre.
    pub place: [f32; 2],
    /// The rows above, at and below, each with one more pixel at either end.
    pub rows: [&'a [f32]; 3],
    /// Weights of the columns.
    pub weights: &'a [f32],
    /// Weight of the row.
    pub weight: f32,
}
