//! A picture averaged over the area that one pixel of a frame covers of it.
//!
//! A camera pixel shows the mean of all texels that it covers. If it covers several, sampling one
//! of them aliases fine grain. The picture is therefore low-pass filtered first, over a square as
//! wide as a pixel, after which one sample per pixel is enough (Williams 1983, "Pyramidal
//! parametrics"; here from the next finer octave, and for the exact width). It is averaged again
//! only when the surface is seen larger or smaller.

use crate::track::scene::tuning::TUNING;
use image::GrayImage;

use super::reference::Octave;
use crate::features::resize_buffer;
use crate::light::Transfer;
use crate::light::square_root::byte;

/// A picture averaged over a square; keeps its buffers.
#[derive(Debug, Default)]
pub struct AveragedPicture {
    image: GrayImage,
    /// log2 of the texels of the full picture along the square's side; `None` before there is a
    /// copy.
    made_for: Option<f64>,
    /// Sums over the columns of a row.
    row: Vec<f32>,
}

impl AveragedPicture {
    /// Returns the picture averaged over squares of side 2^`texels_log2` texels of the full
    /// picture, at a resolution of at least two texels per side if there is such an octave.
    /// `transfer`: how the picture encodes light, which is what is averaged.
    pub fn over(&mut self, octaves: &[Octave], texels_log2: f64, transfer: Transfer) -> &GrayImage {
        if self.made_for.is_none_or(|made_for| (made_for - texels_log2).abs() > TUNING.copy_reuse_log2) {
            let octave = ((texels_log2.floor() - 1.0).max(0.0) as usize).min(octaves.len() - 1);
            let side = (texels_log2 - octave as f64).exp2().min(TUNING.max_square_texels) as f32;
            if transfer.is_root() {
                self.make::<true>(&octaves[octave].image, side);
            } else {
                self.make::<false>(&octaves[octave].image, side);
            }
            self.made_for = Some(texels_log2);
        }
        &self.image
    }

    /// `IS_ROOT`: whether grey levels are square roots of light.
    fn make<const IS_ROOT: bool>(&mut self, from: &GrayImage, side: f32) {
        let (width, height) = (from.width() as usize, from.height() as usize);
        let raw = from.as_raw();
        resize_buffer(&mut self.image, from.width(), from.height());
        let weights = weights(side);
        // Two more columns at each end, so that the square never leaves the row.
        self.row.resize(width + 4, 0.0);
        for (y, out) in self.image.chunks_exact_mut(width).enumerate() {
            let line = |dy: isize| &raw[y.saturating_add_signed(dy).min(height - 1) * width..][..width];
            average_column::<IS_ROOT>(line, weights, &mut self.row[2..][..width]);
            let (first, last) = (self.row[2], self.row[width + 1]);
            self.row[..2].fill(first);
            self.row[width + 2..].fill(last);
            average_row::<IS_ROOT>(&self.row, weights, out);
        }
    }
}

/// Returns the weights of a texel, its neighbours and the next ones in the mean over a centred
/// square with this side, texels.
fn weights(side: f32) -> [f32; 3] {
    let inside = |distance: f32| (0.5 * side - distance + 0.5).clamp(0.0, 1.0);
    let all = [1.0, inside(1.0), inside(2.0)];
    all.map(|weight| weight / (all[0] + 2.0 * (all[1] + all[2])))
}

fn average_column<'a, const IS_ROOT: bool>(line: impl Fn(isize) -> &'a [u8], [own, near, far]: [f32; 3], out: &mut [f32]) {
    let [above2, above, here, below, below2] = [-2, -1, 0, 1, 2].map(|dy| &line(dy)[..out.len()]);
    for (u, sum) in out.iter_mut().enumerate() {
        let light = |grey: u8| if IS_ROOT { u32::from(grey) * u32::from(grey) } else { u32::from(grey) };
        let pair = |a: u8, b: u8| (light(a) + light(b)) as f32;
        *sum = own * light(here[u]) as f32 + near * pair(above[u], below[u]) + far * pair(above2[u], below2[u]);
    }
}

fn average_row<const IS_ROOT: bool>(row: &[f32], [own, near, far]: [f32; 3], out: &mut [u8]) {
    let n = out.len();
    let [left2, left, here, right, right2] = [0, 1, 2, 3, 4].map(|k| &row[k..][..n]);
    for (u, grey) in out.iter_mut().enumerate() {
        let light = own * here[u] + near * (left[u] + right[u]) + far * (left2[u] + right2[u]);
        *grey = byte(if IS_ROOT { light.sqrt() } else { light });
    }
}

#[cfg(test)]
mod tests {
    use image::Luma;

    use super::super::reference::PreparedBody;
    use super::super::surface::{BodySpec, SurfaceSpec};
    use super::*;
    use crate::geometry::Pose;

    /// Octaves of white noise, the worst of all pictures for sampling single texels.
    fn noise() -> Vec<Octave> {
        let mut state = 7_u32;
        let picture = GrayImage::from_fn(300, 200, |_, _| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            Luma([(state >> 24) as u8])
        });
        let surface = SurfaceSpec::from_artwork("noise".into(), picture, [3.0, 2.0], Pose::identity()).expect("texture enough");
        PreparedBody::new(&BodySpec::new("stage", vec![surface])).surfaces.remove(0).octaves
    }

    /// The root of the mean light of a picture over a square around a place: 16 x 16 samples of
    /// whole texels.
    fn plain_mean(picture: &GrayImage, [x, y]: [f64; 2], side: f64) -> f64 {
        let at = |k: u32| ((f64::from(k) + 0.5) / 16.0 - 0.5) * side + 0.5;
        let looks = (0..16).flat_map(|j| (0..16).map(move |i| (i, j)));
        (looks.map(|(i, j)| f64::from(picture.get_pixel((x + at(i)) as u32, (y + at(j)) as u32)[0]).powi(2)).sum::<f64>() / 256.0).sqrt()
    }

    #[test]
    fn one_lookup_is_the_mean_over_a_pixel() {
        let octaves = noise();
        for side in [0.8_f64, 1.0, 1.5, 2.0, 2.8, 3.9, 5.0, 7.0] {
            let mut averaged = AveragedPicture::default();
            let image = averaged.over(&octaves, side.log2(), Transfer::default());
            let scale = f64::from(octaves[0].image.width()) / f64::from(image.width());
            let pairs = (0..600).map(|k| [20.0 + 0.37 * f64::from(k), 30.0 + 0.211 * f64::from(k)]).map(|place| {
                let [x, y] = place.map(|v| ((v + 0.5) / scale - 0.5) as f32);
                let look = super::super::bilinear::bilinear(image, x, y);
                (f64::from(look), plain_mean(&octaves[0].image, place, side))
            });
            let [n, a, b, aa, bb, ab] = pairs.fold([0.0; 6], |s, (a, b)| {
                let more = [1.0, a, b, a * a, b * b, a * b];
                std::array::from_fn(|k| s[k] + more[k])
            });
            let correlation = (ab - a * b / n) / ((aa - a * a / n) * (bb - b * b / n)).sqrt();
            // Interpolating roots between texels of noise differs a little from averaging their
            // light.
            assert!(correlation > 0.91, "{side}: {correlation}");
        }
    }

    #[test]
    fn the_averaged_picture_is_rebuilt_when_the_size_changes() {
        let octaves = noise();
        let mut averaged = AveragedPicture::default();
        let first = averaged.over(&octaves, 1.4, Transfer::default()).clone();
        assert!(averaged.over(&octaves, 1.45, Transfer::default()) == &first);
        assert!(averaged.over(&octaves, 1.52, Transfer::default()) != &first);
        assert!(averaged.over(&octaves, 1.45, Transfer::default()) != &first, "that of 1.52 is near enough");
        assert_eq!(averaged.over(&octaves, 3.2, Transfer::default()).width(), first.width() / 4);
    }

    #[test]
    fn uniform_areas_keep_their_grey_up_to_the_border() {
        let plain = [Octave { image: GrayImage::from_pixel(40, 30, Luma([200])), anchors: Vec::new() }];
        for (side, transfer) in [0.5_f64, 1.7, 3.3, 9.0].into_iter().flat_map(|side| [Transfer::Srgb, Transfer::Linear].map(|t| (side, t)))
        {
            assert!(AveragedPicture::default().over(&plain, side.log2(), transfer).iter().all(|grey| *grey == 200), "{side} {transfer:?}");
        }
    }
}
