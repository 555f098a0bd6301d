//! Oriented binary descriptors: brightness comparisons between pairs of smoothed pixels around a
//! corner (BRIEF, Calonder et al. 2010), rotated to the direction of the patch's intensity centroid
//! (Rosin 1999; Rublee et al. 2011).

use std::sync::OnceLock;

use image::GrayImage;

use super::pattern::{DESCRIPTOR_BITS, PAIRS, PATCH_RADIUS};
use crate::simd::multiversion;

/// Number of precomputed pattern rotations: at 2.8 degree steps, no end of a pair is off by more
/// than a third of a pixel, less than the rounding. Raised, the table (128 KiB) no longer fits the
/// cache; lowered, rotated copies differ in more bits.
const DIRECTIONS: usize = 128;

/// The bits of a descriptor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Descriptor(pub [u64; 4]);

impl Descriptor {
    /// Returns the Hamming distance: the number of differing bits.
    pub fn distance(&self, other: &Self) -> u32 {
        self.0.iter().zip(other.0).map(|(a, b)| (a ^ b).count_ones()).sum()
    }
}

/// Pairs of the rotated pattern per cache line of 64 bytes. Raised, lines are skipped; lowered,
/// they are requested twice.
const PAIRS_OF_LINE: usize = 16;
/// Row stride of a copied patch, pixels: one AVX2 register of bytes.
const STRIDE: usize = 32;
/// Side of a patch, pixels.
const SIDE: usize = 2 * PATCH_RADIUS as usize + 1;

/// The square of pixels around a corner, copied to a fixed layout independent of the picture's
/// width.
struct Patch([[u8; STRIDE]; STRIDE]);

impl Patch {
    #[inline(always)]
    fn around(image: &GrayImage, x: u32, y: u32) -> Self {
        let (w, radius) = (image.width() as usize, PATCH_RADIUS as usize);
        let source = image.as_raw();
        let mut patch = [[0; STRIDE]; STRIDE];
        for (k, row) in patch[..SIDE].iter_mut().enumerate() {
            row[..SIDE].copy_from_slice(&source[(y as usize + k - radius) * w + x as usize - radius..][..SIDE]);
        }
        Self(patch)
    }

    /// Sums of (dx, dy) times brightness over the disc.
    #[inline(always)]
    fn moments(&self) -> (i32, i32) {
        // Per column: the sum, at most 31 * 255, and the moment in y, at most (1 + ... + 15) * 255
        // = 30600 either way.
        let (mut sums, mut moments) = ([0i16; STRIDE], [0i16; STRIDE]);
        for (k, (row, inside)) in self.0.iter().zip(&DISC).enumerate() {
            let dy = k as i16 - PATCH_RADIUS as i16;
            for x in 0..STRIDE {
                let v = i16::from(row[x] & inside[x]);
                sums[x] += v;
                moments[x] += dy * v;
            }
        }
        let (mut mx, mut my) = (0, 0);
        for x in 0..STRIDE {
            mx += (x as i32 - PATCH_RADIUS) * i32::from(sums[x]);
            my += i32::from(moments[x]);
        }
        (mx, my)
    }

    #[inline(always)]
    fn orientation(&self) -> f32 {
        let (mx, my) = self.moments();
        (my as f32).atan2(mx as f32)
    }

    #[inline(always)]
    fn describe(&self, angle: f32) -> Descriptor {
        let direction = (angle / std::f32::consts::TAU * DIRECTIONS as f32).round() as i32;
        let pattern = &rotated()[direction.rem_euclid(DIRECTIONS as i32) as usize];
        // The table is larger than the nearest cache: request all of its lines at once rather than
        // one by one.
        std::hint::black_box(pattern.iter().step_by(PAIRS_OF_LINE).fold(0, |all, [a, _]| all | a));
        let pixels = self.0.as_flattened();
        // Indices are always in range; the modulo shows that to the compiler.
        let at = |index: u16| pixels[index as usize % (STRIDE * STRIDE)];
        let mut bits = [0u64; 4];
        for (word, pairs) in bits.iter_mut().zip(pattern.chunks_exact(64)) {
            // From last to first, so that each bit is shifted in.
            for &[a, b] in pairs.iter().rev() {
                *word = (*word << 1) | u64::from(at(a) < at(b));
            }
        }
        Descriptor(bits)
    }
}

/// All ones inside the disc of a patch, 0 elsewhere. Half of a row is the rounded root of r² - dy².
const DISC: [[u8; STRIDE]; STRIDE] = {
    let mut disc = [[0; STRIDE]; STRIDE];
    let mut k = 0;
    while k < SIDE {
        let dy = k as i32 - PATCH_RADIUS;
        let mut x = 0;
        while x < SIDE {
            let dx = (x as i32 - PATCH_RADIUS).abs();
            // The root rounds to at least dx if it is at least dx - 1/2.
            if dx == 0 || (2 * dx - 1) * (2 * dx - 1) <= 4 * (PATCH_RADIUS * PATCH_RADIUS - dy * dy) {
                disc[k][x] = 255;
            }
            x += 1;
        }
        k += 1;
    }
    disc
};

multiversion! {
    /// Returns the direction of the intensity centroid of the disc around (x, y), radians, y down;
    /// the square around the disc must be inside the picture.
    pub fn orientation(image: &GrayImage, x: u32, y: u32) -> f32; ["avx2"] => orientation_lanes, else orientation_lanes
}

#[inline(always)]
fn orientation_lanes(image: &GrayImage, x: u32, y: u32) -> f32 {
    Patch::around(image, x, y).orientation()
}

multiversion! {
    /// Describes the corner at (x, y) of a smoothed level, rotated by `angle`; the corner must be
    /// more than `PATCH_RADIUS` + 1 from the border.
    pub fn describe(smooth: &GrayImage, x: u32, y: u32, angle: f32) -> Descriptor; ["avx2"] => describe_lanes, else describe_lanes
}

#[inline(always)]
fn describe_lanes(smooth: &GrayImage, x: u32, y: u32, angle: f32) -> Descriptor {
    Patch::around(smooth, x, y).describe(angle)
}

multiversion! {
    /// Returns the [`orientation`] and the descriptor that [`describe`] computes for it.
    pub fn oriented_descriptor(smooth: &GrayImage, x: u32, y: u32) -> (f32, Descriptor);
    ["avx2"] => oriented_descriptor_lanes, else oriented_descriptor_lanes
}

#[inline(always)]
fn oriented_descriptor_lanes(smooth: &GrayImage, x: u32, y: u32) -> (f32, Descriptor) {
    let patch = Patch::around(smooth, x, y);
    let angle = patch.orientation();
    (angle, patch.describe(angle))
}

/// Returns the pattern rotated to every direction, as pixel indices of a patch.
fn rotated() -> &'static [[[u16; 2]; DESCRIPTOR_BITS]] {
    // The rotated pattern, computed on first use.
    static ROTATED: OnceLock<Vec<[[u16; 2]; DESCRIPTOR_BITS]>> = OnceLock::new();
    ROTATED.get_or_init(|| {
        (0..DIRECTIONS)
            .map(|k| {
                let (sin, cos) = (std::f64::consts::TAU * k as f64 / DIRECTIONS as f64).sin_cos();
                let rotation = |(x, y): (i8, i8)| {
                    let (x, y) = (f64::from(x), f64::from(y));
                    let (x, y) = ((cos * x - sin * y).round() as i32, (sin * x + cos * y).round() as i32);
                    ((y + PATCH_RADIUS) * STRIDE as i32 + x + PATCH_RADIUS) as u16
                };
                PAIRS.map(|(a, b)| [rotation(a), rotation(b)])
            })
            .collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(rotation: f64) -> GrayImage {
        let (sin, cos) = rotation.sin_cos();
        GrayImage::from_fn(101, 101, |x, y| {
            let (dx, dy) = (f64::from(x) - 50.0, f64::from(y) - 50.0);
            let (u, v) = (cos * dx + sin * dy, -sin * dx + cos * dy);
            let value = 120.0 + 60.0 * (0.31 * u + 0.05 * v).sin() * (0.23 * v).cos() + 2.0 * u + 25.0 * (0.11 * u * v / 10.0).sin();
            image::Luma([value.clamp(0.0, 255.0) as u8])
        })
    }

    #[test]
    fn orientation_turns_with_the_picture() {
        let base = orientation(&picture(0.0), 50, 50);
        for degrees in [10.0_f64, 45.0, 133.0, -80.0] {
            let rotated = orientation(&picture(degrees.to_radians()), 50, 50);
            let difference = f64::from(rotated - base) - degrees.to_radians();
            let wrapped = (difference + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI;
            assert!(wrapped.abs() < 0.12, "{degrees}: {wrapped}");
        }
    }

    #[test]
    fn descriptor_survives_rotation_and_light() {
        let describe_rotated = |picture: &GrayImage| {
            let mut smooth = picture.clone();
            super::super::pyramid::smooth_into(picture, &mut smooth, &mut Vec::new());
            describe(&smooth, 50, 50, orientation(picture, 50, 50))
        };
        let base = describe_rotated(&picture(0.0));
        assert!(base.distance(&describe_rotated(&picture(1.0))) < 40);
        let mut dim = picture(0.0);
        dim.iter_mut().for_each(|v| *v = (*v as f32 * 0.6 + 10.0) as u8);
        assert!(base.distance(&describe_rotated(&dim)) < 20);
        let other = GrayImage::from_fn(101, 101, |x, y| image::Luma([((x * 7 + y * 13) % 251) as u8]));
        assert!(base.distance(&describe_rotated(&other)) > 60);
    }
}
