//! Maps where a picture has trackable detail: a grid of cells, as numbers, as characters, and as a
//! picture.

use image::{GrayImage, Rgb, RgbImage, imageops};

/// Number of cells across; the number down makes them square. Chosen: about the tiles by which
/// alignment judges a picture. Raised, cells hold too few pixels.
const COLUMNS: u32 = 16;
/// Minimum side of a cell, pixels. Lowered, a few pixels of noise count as detail.
const MIN_CELL_PX: u32 = 6;
/// Maximum sigma of a cell's own position due to noise, in the worse direction, pixels, for it to
/// count as detailed: the limit for alignment's tiles. Lowered, faint and soft pictures have no
/// detail.
const DETAILED_PX: f64 = 0.15;
/// Smaller eigenvalue of the structure tensor of the best cells, (grey/px)² per pixel: more does
/// not improve a pose. Raised, all pictures look weak on the map.
const RICH: f32 = 400.0;
/// Noise of a frame, grey levels, one sigma: a typical camera's. Raised, all pictures count as
/// softer.
const NOISE: f64 = 2.0;
/// Remaining strength of a cell whose corners all resemble others. Alignment still uses it;
/// features do not. Lowered, patterns look plain.
const REPEATED: f32 = 0.25;
/// Pixels per cell in the drawn picture: enough to see the artwork through it.
const DRAWN_CELL_PX: u32 = 40;
/// Opacity of the artwork, of 256. Chosen by eye.
const SHOWN: u32 = 110;
/// Characters from no strength to full strength.
const STEPS: [char; 5] = ['.', ':', '+', '*', '#'];

/// The strength of every cell of a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct StrengthMap {
    /// Cells across and down.
    pub size: [u32; 2],
    /// Strengths from 0 to 1, row by row.
    pub strengths: Vec<f32>,
    /// One sigma of each cell's position due to noise, pixels.
    sigmas_px: Vec<f64>,
    /// The same for the whole picture.
    sigma_px: f64,
}

impl StrengthMap {
    /// Computes the map of a picture, given its corners and whether each is distinct.
    pub fn of(picture: &GrayImage, corners: impl Iterator<Item = ([f64; 2], bool)>) -> Self {
        let (width, height) = picture.dimensions();
        let across = (width / MIN_CELL_PX).clamp(1, COLUMNS);
        let down = (f64::from(across * height) / f64::from(width.max(1))).round() as u32;
        let size = [across, down.clamp(1, (height / MIN_CELL_PX).max(1))];
        let cells = (size[0] * size[1]) as usize;
        let cell_of = |x: u32, y: u32| (y * size[1] / height * size[0] + x * size[0] / width) as usize;
        let mut tensors = vec![[0.0_f64; 4]; cells];
        for y in 1..height.saturating_sub(1) {
            for x in 1..width.saturating_sub(1) {
                let at = |x: u32, y: u32| f64::from(picture.get_pixel(x, y)[0]);
                let (gx, gy) = (0.5 * (at(x + 1, y) - at(x - 1, y)), 0.5 * (at(x, y + 1) - at(x, y - 1)));
                let sums = &mut tensors[cell_of(x, y)];
                [gx * gx, gx * gy, gy * gy, 1.0].iter().zip(sums).for_each(|(more, sum)| *sum += more);
            }
        }
        let eigenvalues: Vec<f32> = tensors.iter().map(|t| (smaller_eigenvalue(t) / t[3].max(1.0)) as f32).collect();
        let all = tensors.iter().fold([0.0; 4], |sum, t| [0, 1, 2, 3].map(|k| sum[k] + t[k]));
        let mut counts = vec![[0.0_f32; 2]; cells];
        for ([x, y], is_distinct) in corners {
            let pixel = |v: f64, most: u32| (v.round().max(0.0) as u32).min(most.saturating_sub(1));
            let count = &mut counts[cell_of(pixel(x, width), pixel(y, height))];
            count[0] += 1.0;
            count[1] += f32::from(u8::from(is_distinct));
        }
        let strength = |(eigenvalue, [all, distinct]): (&f32, &[f32; 2])| {
            let detail = ((eigenvalue.max(1.0)).ln() / RICH.ln()).min(1.0);
            detail * if *all > 0.0 { REPEATED + (1.0 - REPEATED) * distinct / all } else { 1.0 }
        };
        let strengths = eigenvalues.iter().zip(&counts).map(strength).collect();
        let sigma_px = |tensor: &[f64; 4]| NOISE / smaller_eigenvalue(tensor).max(1e-6).sqrt();
        Self { size, strengths, sigmas_px: tensors.iter().map(sigma_px).collect(), sigma_px: sigma_px(&all) }
    }

    /// Returns the fraction of the cells with detail in both directions.
    pub fn share_detailed(&self) -> f64 {
        self.sigmas_px.iter().filter(|sigma| **sigma < DETAILED_PX).count() as f64 / self.sigmas_px.len().max(1) as f64
    }

    /// Returns one sigma of the picture's position in the frame due to noise, in the worse
    /// direction, pixels.
    pub fn sigma_px(&self) -> f64 {
        self.sigma_px
    }

    /// Returns a line of characters for every row of cells: `#` is strong, `.` has nothing.
    pub fn lines(&self) -> Vec<String> {
        let step = |strength: &f32| STEPS[((strength * STEPS.len() as f32) as usize).min(STEPS.len() - 1)];
        self.strengths.chunks(self.size[0].max(1) as usize).map(|row| row.iter().map(step).collect()).collect()
    }

    /// Draws the artwork in grey under colours: from red for no strength over yellow to green for
    /// full strength.
    pub fn drawn_on(&self, artwork: &GrayImage) -> RgbImage {
        let [across, down] = self.size;
        let picture = imageops::resize(artwork, across * DRAWN_CELL_PX, down * DRAWN_CELL_PX, imageops::FilterType::Triangle);
        RgbImage::from_fn(picture.width(), picture.height(), |x, y| {
            let strength = self.strengths[(y / DRAWN_CELL_PX * across + x / DRAWN_CELL_PX) as usize];
            let colour = [255.0 * (2.0 - 2.0 * strength).min(1.0), 255.0 * (2.0 * strength).min(1.0), 0.0];
            let grey = u32::from(picture.get_pixel(x, y)[0]);
            Rgb(colour.map(|c| ((grey * SHOWN + c as u32 * (256 - SHOWN)) / 256) as u8))
        })
    }
}

/// Returns the smaller eigenvalue of a structure tensor, given as sums of gx², gx gy and gy².
fn smaller_eigenvalue([xx, xy, yy, _]: &[f64; 4]) -> f64 {
    (0.5 * (xx + yy) - (0.25 * (xx - yy).powi(2) + xy * xy).sqrt()).max(0.0)
}
