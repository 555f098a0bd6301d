//! Integral images: rectangle sums in four reads (Crow 1984).

use image::GrayImage;

/// Sums of all pixels above and to the left of each pixel corner.
#[derive(Debug, Clone, PartialEq)]
pub struct IntegralImage {
    /// Columns of the picture.
    pub width: usize,
    /// Rows of the picture.
    pub height: usize,
    /// (`width` + 1) x (`height` + 1) sums, row-major; the first row and column are 0.
    sums: Vec<u32>,
}

impl IntegralImage {
    /// Builds the sums of a picture. They may wrap: only the sum of a requested rectangle must fit
    /// 32 bits, which holds for all of a picture of up to 16 million pixels.
    pub fn of(picture: &GrayImage) -> Self {
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        let stride = width + 1;
        let mut sums = vec![0u32; stride * (height + 1)];
        for (y, row) in picture.as_raw().chunks_exact(width.max(1)).enumerate() {
            let (above, here) = sums[y * stride..].split_at_mut(stride);
            let mut sum = 0u32;
            for (x, value) in row.iter().enumerate() {
                sum = sum.wrapping_add(u32::from(*value));
                here[x + 1] = above[x + 1].wrapping_add(sum);
            }
        }
        Self { width, height, sums }
    }

    /// Returns the sum of the pixels in columns `x.0..x.1` and rows `y.0..y.1` that are inside the
    /// picture. Differences wrap, so only the rectangle's own sum must fit.
    pub fn sum(&self, x: (isize, isize), y: (isize, isize)) -> f32 {
        let clamp = |v: isize, n: usize| v.clamp(0, n as isize) as usize;
        let (left, right) = (clamp(x.0, self.width), clamp(x.1, self.width));
        let (top, bottom) = (clamp(y.0, self.height), clamp(y.1, self.height));
        if left >= right || top >= bottom {
            return 0.0;
        }
        let at = |x: usize, y: usize| self.sums[y * (self.width + 1) + x];
        at(right, bottom).wrapping_sub(at(left, bottom)).wrapping_sub(at(right, top)).wrapping_add(at(left, top)) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn box_sums_equal_pixel_sums_and_stop_at_the_border() {
        let picture = GrayImage::from_fn(13, 7, |x, y| image::Luma([(x * 17 + y * 29) as u8]));
        let integral = IntegralImage::of(&picture);
        for (x, y) in [((0, 13), (0, 7)), ((3, 5), (2, 6)), ((-4, 4), (5, 90)), ((4, 4), (0, 7)), ((20, 30), (0, 1))] {
            let plain: f32 = picture
                .enumerate_pixels()
                .filter(|(px, py, _)| (x.0..x.1).contains(&(*px as isize)) && (y.0..y.1).contains(&(*py as isize)))
                .map(|(_, _, v)| f32::from(v[0]))
                .sum();
            assert_eq!(integral.sum(x, y), plain, "{x:?} {y:?}");
        }
        assert_eq!(IntegralImage::of(&GrayImage::new(0, 0)).sum((0, 5), (0, 5)), 0.0);
    }
}
