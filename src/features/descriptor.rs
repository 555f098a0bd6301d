//! Oriented binary descriptors: brightness comparisons between pairs of smoothed pixels around a corner
//! (BRIEF, Calonder et al. 2010), turned by the direction of the patch's intensity centroid (Rosin 1999;
//! Rublee et al. 2011).

use std::sync::OnceLock;

use image::GrayImage;

use super::pattern::{DESCRIPTOR_BITS, PAIRS, PATCH_RADIUS, Pair};

/// Directions that the pattern is turned to ahead of time: at 2.8 degrees apart, no end of a pair is more than a third of a pixel off, less
/// than the rounding. Raised, the table (128 KiB) leaves the cache; lowered, turned copies differ in more bits.
const DIRECTIONS: usize = 128;

/// The bits of a descriptor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Descriptor(pub [u64; 4]);

/// Direction of the intensity centroid of the disc around (x, y), radians, y down; the disc must lie inside.
pub fn orientation(image: &GrayImage, x: u32, y: u32) -> f32 {
    let w = image.width() as usize;
    let source = image.as_raw();
    let (mut mx, mut my) = (0i32, 0i32);
    for (k, half) in disc().iter().enumerate() {
        let dy = k as i32 - PATCH_RADIUS;
        let start = (y as i32 + dy) as usize * w + (x as i32 - half) as usize;
        let row = &source[start..start + 2 * *half as usize + 1];
        let (mut sum, mut moment) = (0i32, 0i32);
        for (i, v) in row.iter().enumerate() {
            sum += i32::from(*v);
            moment += i as i32 * i32::from(*v);
        }
        mx += moment - half * sum;
        my += dy * sum;
    }
    (my as f32).atan2(mx as f32)
}

/// Half-widths of the disc's rows.
fn disc() -> &'static [i32; 2 * PATCH_RADIUS as usize + 1] {
    // Computed at the first call.
    static DISC: OnceLock<[i32; 2 * PATCH_RADIUS as usize + 1]> = OnceLock::new();
    DISC.get_or_init(|| {
        std::array::from_fn(|k| {
            let dy = k as i32 - PATCH_RADIUS;
            f64::from(PATCH_RADIUS * PATCH_RADIUS - dy * dy).sqrt().round() as i32
        })
    })
}

/// The pattern turned to every direction.
fn turned() -> &'static [[Pair; DESCRIPTOR_BITS]] {
    // Computed at the first call.
    static TURNED: OnceLock<Vec<[Pair; DESCRIPTOR_BITS]>> = OnceLock::new();
    TURNED.get_or_init(|| {
        (0..DIRECTIONS)
            .map(|k| {
                let (sin, cos) = (std::f64::consts::TAU * k as f64 / DIRECTIONS as f64).sin_cos();
                let turn = |(x, y): (i8, i8)| {
                    let (x, y) = (f64::from(x), f64::from(y));
                    ((cos * x - sin * y).round() as i8, (sin * x + cos * y).round() as i8)
                };
                PAIRS.map(|(a, b)| (turn(a), turn(b)))
            })
            .collect()
    })
}

/// Describes the corner at (x, y) of a smoothed level, turned by `angle`; the corner must lie more than
/// `PATCH_RADIUS` + 1 from the border.
pub fn describe(smooth: &GrayImage, x: u32, y: u32, angle: f32) -> Descriptor {
    let w = smooth.width() as isize;
    let source = smooth.as_raw();
    let direction = (angle / std::f32::consts::TAU * DIRECTIONS as f32).round() as i32;
    let pattern = &turned()[direction.rem_euclid(DIRECTIONS as i32) as usize];
    let centre = (y as usize * smooth.width() as usize + x as usize) as isize;
    let at = |(dx, dy): (i8, i8)| source[(centre + isize::from(dy) * w + isize::from(dx)) as usize];
    let mut bits = [0u64; 4];
    for (word, pairs) in bits.iter_mut().zip(pattern.chunks_exact(64)) {
        for (k, (a, b)) in pairs.iter().enumerate() {
            *word |= u64::from(at(*a) < at(*b)) << k;
        }
    }
    Descriptor(bits)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(turn: f64) -> GrayImage {
        let (sin, cos) = turn.sin_cos();
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
            let turned = orientation(&picture(degrees.to_radians()), 50, 50);
            let difference = f64::from(turned - base) - degrees.to_radians();
            let wrapped = (difference + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI;
            assert!(wrapped.abs() < 0.12, "{degrees}: {wrapped}");
        }
    }

    #[test]
    fn descriptor_survives_rotation_and_light() {
        let describe_turned = |picture: &GrayImage| {
            let mut smooth = picture.clone();
            super::super::pyramid::smooth_into(picture, &mut smooth, &mut Vec::new());
            describe(&smooth, 50, 50, orientation(picture, 50, 50))
        };
        let distance = |a: Descriptor, b: Descriptor| a.0.iter().zip(b.0).map(|(a, b)| (a ^ b).count_ones()).sum::<u32>();
        let base = describe_turned(&picture(0.0));
        assert!(distance(base, describe_turned(&picture(1.0))) < 40);
        let mut dim = picture(0.0);
        dim.iter_mut().for_each(|v| *v = (*v as f32 * 0.6 + 10.0) as u8);
        assert!(distance(base, describe_turned(&dim)) < 20);
        let other = GrayImage::from_fn(101, 101, |x, y| image::Luma([((x * 7 + y * 13) % 251) as u8]));
        assert!(distance(base, describe_turned(&other)) > 60);
    }
}
