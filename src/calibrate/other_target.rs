//! Recognises boards of other kinds, to tell the user that they are not supported.
//!
//! Dark spots are classified by their outlines: the ratio of extent to spread differs between an
//! ellipse and a parallelogram. A marker is a dark square with light fields inside; a chessboard's
//! squares have none.

use image::{GrayImage, Luma};
use nalgebra::{Matrix2, Vector2};

/// An unsupported target.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Target {
    /// A grid of dots.
    Circles,
    /// Square markers, alone or in the white squares of a chessboard.
    Markers,
}

/// Longer side of the downscaled picture that is examined, pixels: markers of a fortieth of it
/// still show their fields. Raised, it takes longer.
const SIDE_PX: u32 = 1024;
/// Minimum number of spots in a grid. Raised, small boards go unmentioned; lowered, lamps and
/// buttons are taken for boards.
const MIN_CIRCLES: usize = 12;
/// Maximum distance of a spot in a row from the point opposite its neighbour, as a fraction of
/// their distance. Raised, random dots pass for grids.
const ROW_SLACK: f64 = 0.2;
/// Minimum number of markers on a board: few things look like one. Raised, mostly hidden boards go
/// unmentioned.
const MIN_MARKERS: usize = 4;
/// Minimum area of a spot, pixels, for its outline to be classified. Raised, distant boards go
/// unmentioned; lowered, specks are classified.
const MIN_AREA: usize = 60;
/// How much darker than its surroundings a spot must be, grey levels. Raised, dim pictures show
/// none; lowered, noise makes spots.
const DARKER: f64 = 12.0;

impl Target {
    /// All kinds.
    pub const ALL: [Self; 2] = [Self::Circles, Self::Markers];

    /// Describes the target.
    pub fn words(self) -> &'static str {
        match self {
            Self::Circles => "a grid of circles, which is not supported",
            Self::Markers => "a board of square markers (ChArUco, ArUco or AprilTag), which is not supported",
        }
    }

    /// Returns the kind of target that a picture shows, if any.
    pub fn seen_in(picture: &GrayImage) -> Option<Self> {
        let (width, height) = picture.dimensions();
        let scale = (f64::from(SIDE_PX) / f64::from(width.max(height))).min(1.0);
        let side = |s: u32| ((f64::from(s) * scale).round() as u32).max(1);
        let small = image::imageops::thumbnail(picture, side(width), side(height));
        let spots = spots(&small);
        let markers = spots.iter().filter(|s| s.is_square() && (0.04..0.7).contains(&s.light)).count();
        if markers >= MIN_MARKERS {
            return Some(Self::Markers);
        }
        let mut round: Vec<&Spot> = spots.iter().filter(|s| s.is_round() && s.light < 0.02).collect();
        round.sort_unstable_by_key(|s| s.area);
        let usual = round.get(round.len() / 2)?.area;
        let alike: Vec<Vector2<f64>> = round.iter().filter(|s| s.area < 3 * usual && usual < 3 * s.area).map(|s| s.middle).collect();
        let in_rows = alike.iter().filter(|middle| is_in_a_row(middle, &alike)).count();
        (alike.len() >= MIN_CIRCLES && 2 * in_rows >= alike.len()).then_some(Self::Circles)
    }
}

/// Whether a spot lies halfway between its nearest neighbour and another spot, like those of a
/// grid.
fn is_in_a_row(middle: &Vector2<f64>, spots: &[Vector2<f64>]) -> bool {
    let offsets = || spots.iter().map(|other| other - middle).filter(|offset| *offset != Vector2::zeros());
    let Some(nearest) = offsets().min_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared())) else { return false };
    offsets().any(|offset| (offset + nearest).norm() < ROW_SLACK * nearest.norm())
}

/// A dark spot including what it encloses.
struct Spot {
    middle: Vector2<f64>,
    area: usize,
    /// Area over that of an ellipse with the same spread: 1 for an ellipse, 0.955 for a
    /// parallelogram, less for shapes with arms.
    filled: f64,
    /// Maximum extent from its middle, in units of its spread: 2 for an ellipse, 2.45 for a
    /// parallelogram.
    reach: f64,
    /// Fraction of the area that is light.
    light: f64,
}

impl Spot {
    fn is_round(&self) -> bool {
        self.filled > 0.95 && self.reach < 2.2
    }

    fn is_square(&self) -> bool {
        self.filled > 0.9 && (2.25..2.75).contains(&self.reach)
    }
}

fn spots(picture: &GrayImage) -> Vec<Spot> {
    let dark = dark_pixels(picture);
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let mut seen = vec![false; dark.len()];
    let mut spots = Vec::new();
    for start in 0..dark.len() {
        if !dark[start] || seen[start] {
            continue;
        }
        let region = flood(start, (width, height), &mut seen, |at| dark[at]);
        let largest = dark.len() / 20;
        if (MIN_AREA..largest).contains(&region.len()) {
            spots.extend(spot(&region, (width, height)));
        }
    }
    spots
}

/// Finds pixels that are darker than the mean of a window around them, an eighth of the picture
/// wide.
fn dark_pixels(picture: &GrayImage) -> Vec<bool> {
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let mut sums = vec![0_u64; (width + 1) * (height + 1)];
    for y in 0..height {
        let mut row = 0;
        for x in 0..width {
            let Luma([level]) = *picture.get_pixel(x as u32, y as u32);
            row += u64::from(level);
            sums[(y + 1) * (width + 1) + x + 1] = sums[y * (width + 1) + x + 1] + row;
        }
    }
    let half = (width.max(height) / 16).max(4);
    let mean = |x: usize, y: usize| {
        let (left, right) = (x.saturating_sub(half), (x + half + 1).min(width));
        let (top, bottom) = (y.saturating_sub(half), (y + half + 1).min(height));
        let at = |x: usize, y: usize| sums[y * (width + 1) + x];
        let sum = at(right, bottom) + at(left, top) - at(left, bottom) - at(right, top);
        sum as f64 / ((right - left) * (bottom - top)) as f64
    };
    let level = |x: usize, y: usize| f64::from(picture.get_pixel(x as u32, y as u32).0[0]);
    (0..width * height).map(|at| level(at % width, at / width) < mean(at % width, at / width) - DARKER).collect()
}

/// Returns all places connected to a start place by their sides.
fn flood(start: usize, (width, height): (usize, usize), seen: &mut [bool], belongs: impl Fn(usize) -> bool) -> Vec<usize> {
    seen[start] = true;
    let mut region = vec![start];
    let mut next = 0;
    while let Some(&at) = region.get(next) {
        next += 1;
        let (x, y) = (at % width, at / width);
        let around = [(x > 0, at.wrapping_sub(1)), (x + 1 < width, at + 1), (y > 0, at.wrapping_sub(width)), (y + 1 < height, at + width)];
        for (_, beside) in around.into_iter().filter(|(is_inside, _)| *is_inside) {
            if !seen[beside] && belongs(beside) {
                seen[beside] = true;
                region.push(beside);
            }
        }
    }
    region
}

/// Returns the shape of a region including its holes; `None` if it touches the picture's rim.
fn spot(region: &[usize], (width, height): (usize, usize)) -> Option<Spot> {
    let (xs, ys) = (region.iter().map(|at| at % width), region.iter().map(|at| at / width));
    let (left, right) = (xs.clone().min()?, xs.max()?);
    let (top, bottom) = (ys.clone().min()?, ys.max()?);
    if left == 0 || top == 0 || right + 1 == width || bottom + 1 == height {
        return None;
    }
    // One extra pixel on every side, so that the outside is connected.
    let (across, down) = (right - left + 3, bottom - top + 3);
    let mut own = vec![false; across * down];
    region.iter().for_each(|at| own[(at / width - top + 1) * across + at % width - left + 1] = true);
    let mut outside = vec![false; own.len()];
    flood(0, (across, down), &mut outside, |at| !own[at]);
    let inside: Vec<Vector2<f64>> =
        (0..own.len()).filter(|at| !outside[*at]).map(|at| Vector2::new((at % across) as f64, (at / across) as f64)).collect();
    let area = inside.len() as f64;
    let middle = inside.iter().sum::<Vector2<f64>>() / area;
    // A pixel is itself a small square.
    let spread = inside.iter().map(|p| (p - middle) * (p - middle).transpose()).sum::<Matrix2<f64>>() / area + Matrix2::identity() / 12.0;
    let inverse = spread.try_inverse()?;
    let reach = inside.iter().map(|p| (p - middle).dot(&(inverse * (p - middle)))).fold(0.0, f64::max).sqrt();
    let filled = area / (4.0 * std::f64::consts::PI * spread.determinant().sqrt());
    let corner = Vector2::new(left as f64 - 1.0, top as f64 - 1.0);
    Some(Spot { middle: middle + corner, area: inside.len(), filled, reach, light: 1.0 - region.len() as f64 / area })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture of 640 x 480 pixels, seen slightly from the side; `ink` tells where the board is
    /// dark, in squares.
    fn seen(ink: impl Fn(f64, f64) -> bool) -> GrayImage {
        GrayImage::from_fn(640, 480, |x, y| {
            let (x, y) = (f64::from(x), f64::from(y));
            let scale = 1.0 / (44.0 + 0.02 * x + 0.01 * y);
            let (u, v) = (((x - 60.0) + 0.2 * (y - 40.0)) * scale, ((y - 40.0) - 0.05 * (x - 60.0)) * scale);
            Luma([if ink(u, v) { 40 } else { 210 }])
        })
    }

    fn is_on_board(u: f64, v: f64) -> bool {
        (0.0..10.0).contains(&u) && (0.0..7.0).contains(&v)
    }

    /// A marker with a border of a sixth and fields that depend on its number.
    fn marker(u: f64, v: f64, number: u32) -> bool {
        let (column, row) = ((u * 6.0) as u32, (v * 6.0) as u32);
        let is_border = column.is_multiple_of(5) || row.is_multiple_of(5);
        is_border || (column * 7 + row * 5 + number * 3 + column * row).is_multiple_of(3)
    }

    #[test]
    fn circle_grids_and_markers_are_recognised_as_other_targets() {
        let dots = seen(|u, v| is_on_board(u, v) && (u.fract() - 0.5).hypot(v.fract() - 0.5) < 0.3);
        assert_eq!(Target::seen_in(&dots), Some(Target::Circles));
        let tags = seen(|u, v| {
            let (a, b) = (u.fract() / 0.75, v.fract() / 0.75);
            is_on_board(u, v) && a < 1.0 && b < 1.0 && marker(a, b, u as u32 + 10 * v as u32)
        });
        assert_eq!(Target::seen_in(&tags), Some(Target::Markers));
        let charuco = seen(|u, v| {
            let (a, b) = ((u.fract() - 0.15) / 0.7, (v.fract() - 0.15) / 0.7);
            let is_dark = (u as u32 + v as u32).is_multiple_of(2);
            is_on_board(u, v) && (is_dark || ((0.0..1.0).contains(&a) && (0.0..1.0).contains(&b) && marker(a, b, u as u32)))
        });
        assert_eq!(Target::seen_in(&charuco), Some(Target::Markers));
        assert_eq!(Target::seen_in(&seen(|u, v| is_on_board(u, v) && (u as u32 + v as u32).is_multiple_of(2))), None, "a chessboard");
        assert_eq!(Target::seen_in(&seen(|u, v| is_on_board(u, v) && u.fract() < 0.7 && v.fract() < 0.7)), None, "tiles");
        assert_eq!(Target::seen_in(&seen(|_, _| false)), None, "a wall");
        let scattered: Vec<(f64, f64)> = (0..60).map(|k| (f64::from(k * 37 % 101) / 10.1, f64::from(k * 53 % 97) / 13.9)).collect();
        let is_dot = |u: f64, v: f64| scattered.iter().any(|(x, y)| (u - x).hypot(v - y) < 0.2);
        assert_eq!(Target::seen_in(&seen(is_dot)), None, "dots at random");
        for size in [(1, 1), (3, 2), (1, 400)] {
            assert_eq!(Target::seen_in(&GrayImage::new(size.0, size.1)), None);
        }
        let noise = GrayImage::from_fn(320, 240, |x, y| Luma([(x.wrapping_mul(2_654_435_761) ^ y.wrapping_mul(40_503)).to_le_bytes()[2]]));
        assert_eq!(Target::seen_in(&noise), None, "noise");
    }
}
