//! A surface's shape file (TOML): heights over its plane, its stretch, and the modes of their
//! uncertainty.
//!
//! A shape is valid for one picture of one size only. So the file names both, and other pictures
//! are refused.

use std::fmt::Write as _;
use std::sync::Arc;

use image::GrayImage;
use nalgebra::{SVector, Vector1, Vector2};
use serde::Deserialize;
use thiserror::Error;

use crate::fingerprint::{self, fnv1a};
use crate::geometry::bspline::BicubicSpline;
use crate::track::{BentShape, ShapeWay, SurfaceShape};

/// Maximum number of spline intervals along an axis. Raised, a foreign file may take more memory.
const MAX_INTERVALS: usize = 400;
/// Maximum height or stretch in a file, metres: more is a slip of the unit. Raised, such slips
/// pass.
const MAX_M: f64 = 100.0;

/// Why a file is not a valid shape.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ShapeFileError {
    /// Not TOML, or an unknown key.
    #[error("line {line}: {reason}; survey the stage again (`stagepose survey`)")]
    Syntax {
        /// Line, counted from 1.
        line: usize,
        /// The parser's message.
        reason: String,
    },
    /// Numbers that make no shape.
    #[error("`{key}` does not match its `intervals`, or holds an impossible number; survey the stage again (`stagepose survey`)")]
    Numbers {
        /// The key with these numbers.
        key: &'static str,
    },
    /// It belongs to another picture.
    #[error("it belongs to another picture than this surface's; survey the stage again (`stagepose survey`), or take `shape` out")]
    OtherPicture,
    /// It belongs to a surface of another size: the file's, then the surface's, metres.
    #[error("it belongs to a surface of {} x {} m, this one is {} x {} m; survey the stage again (`stagepose survey`), or take `shape` out", .0[0], .0[1], .1[0], .1[1])]
    OtherSize([f64; 2], [f64; 2]),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    picture: String,
    size_m: [f64; 2],
    height: Grid<f64>,
    stretch: Grid<[f64; 2]>,
    #[serde(default)]
    way: Vec<Way>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Grid<T> {
    intervals: [usize; 2],
    metres: Vec<T>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Way {
    height_m: Vec<f64>,
    stretch_m: Vec<[f64; 2]>,
}

/// Returns a picture's fingerprint: FNV-1a over its size and grey levels.
fn picture_mark(picture: &GrayImage) -> String {
    let size = [picture.width(), picture.height()].map(u32::to_le_bytes).concat();
    let mark = fnv1a(fnv1a(fingerprint::START, &size), picture.as_raw());
    format!("{mark:016x}")
}

/// Parses a shape file's text for a surface with this picture and size.
pub(super) fn parse(text: &str, picture: &GrayImage, size_m: [f64; 2]) -> Result<SurfaceShape, ShapeFileError> {
    let file: File = toml::from_str(text).map_err(|e| ShapeFileError::Syntax {
        line: 1 + e.span().map_or(0, |span| text.as_bytes()[..span.start.min(text.len())].iter().filter(|b| **b == b'\n').count()),
        reason: e.message().trim().replace('\n', ", "),
    })?;
    if file.picture != picture_mark(picture) {
        return Err(ShapeFileError::OtherPicture);
    }
    if file.size_m.iter().zip(size_m).any(|(a, b)| (a - b).abs() > 1e-9 * b) {
        return Err(ShapeFileError::OtherSize(file.size_m, size_m));
    }
    let height = |metres: Vec<f64>, key| spline(file.height.intervals, size_m, metres.into_iter().map(Vector1::new).collect(), key);
    let stretch = |metres: Vec<[f64; 2]>, key| spline(file.stretch.intervals, size_m, metres.into_iter().map(Vector2::from).collect(), key);
    let way = |way: Way| Ok(ShapeWay { height: height(way.height_m, "way.height_m")?, stretch: stretch(way.stretch_m, "way.stretch_m")? });
    let shape = BentShape {
        height: height(file.height.metres, "height.metres")?,
        stretch: stretch(file.stretch.metres, "stretch.metres")?,
        ways: file.way.into_iter().map(way).collect::<Result<_, ShapeFileError>>()?,
    };
    Ok(SurfaceShape::Bent(Arc::new(shape)))
}

fn spline<const N: usize>(
    intervals: [usize; 2],
    size_m: [f64; 2],
    metres: Vec<SVector<f64, N>>,
    key: &'static str,
) -> Result<BicubicSpline<N>, ShapeFileError> {
    let is_possible = intervals.iter().all(|n| *n <= MAX_INTERVALS) && metres.iter().flatten().all(|v| v.abs() <= MAX_M);
    let spline = if is_possible { BicubicSpline::from_coefficients(intervals, size_m, metres) } else { None };
    spline.ok_or(ShapeFileError::Numbers { key })
}

/// Returns the text of a shape's file. Rust's shortest float form is valid TOML and reads back to
/// the same bits.
pub fn write(shape: &BentShape, picture: &GrayImage, size_m: [f64; 2]) -> String {
    let mut text = format!(
        "# How a surface hangs: coefficients of bicubic splines, row by row from the lower left, metres. Written by `stagepose survey`.\n\
         picture = \"{}\"\nsize_m = {size_m:?}\n\n",
        picture_mark(picture)
    );
    let pairs = |spline: &BicubicSpline<2>| spline.coefficients().iter().map(|c| [c.x, c.y]).collect::<Vec<_>>();
    let singles = |spline: &BicubicSpline<1>| spline.coefficients().iter().map(|c| c.x).collect::<Vec<_>>();
    // Writing to a String cannot fail.
    let _ = writeln!(text, "[height]\nintervals = {:?}\nmetres = {:?}\n", shape.height.intervals(), singles(&shape.height));
    let _ = writeln!(text, "[stretch]\nintervals = {:?}\nmetres = {:?}", shape.stretch.intervals(), pairs(&shape.stretch));
    for way in &shape.ways {
        let _ = writeln!(text, "\n[[way]] # one sigma\nheight_m = {:?}\nstretch_m = {:?}", singles(&way.height), pairs(&way.stretch));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shape() -> (BentShape, GrayImage, [f64; 2]) {
        let size_m = [4.0, 2.7];
        let mut height = BicubicSpline::<1>::zero([5, 3], size_m);
        let mut stretch = BicubicSpline::<2>::zero([2, 1], size_m);
        height.coefficients_mut().iter_mut().enumerate().for_each(|(k, c)| c.x = 1e-3 * (k as f64).sin());
        stretch.coefficients_mut().iter_mut().enumerate().for_each(|(k, c)| c.y = 1e-4 * k as f64);
        let way = ShapeWay { height: height.clone(), stretch: stretch.clone() };
        (
            BentShape { height, stretch, ways: vec![way.clone(), way] },
            GrayImage::from_fn(30, 20, |x, y| image::Luma([(x * y) as u8])),
            size_m,
        )
    }

    #[test]
    fn a_written_shape_reads_back_bit_for_bit() {
        let (shape, picture, size_m) = shape();
        let text = write(&shape, &picture, size_m);
        assert_eq!(parse(&text, &picture, size_m), Ok(SurfaceShape::Bent(Arc::new(shape))));
    }

    #[test]
    fn shape_files_that_do_not_fit_are_refused() {
        let (shape, picture, size_m) = shape();
        let text = write(&shape, &picture, size_m);
        assert_eq!(parse(&text, &GrayImage::new(30, 20), size_m), Err(ShapeFileError::OtherPicture));
        assert_eq!(parse(&text, &picture, [4.0, 3.0]), Err(ShapeFileError::OtherSize(size_m, [4.0, 3.0])));
        let fewer = text.replace("intervals = [5, 3]", "intervals = [5, 4]");
        assert_eq!(parse(&fewer, &picture, size_m), Err(ShapeFileError::Numbers { key: "height.metres" }));
        let endless = text.replace("intervals = [5, 3]", "intervals = [5, 18446744073709551615]");
        assert!(matches!(parse(&endless, &picture, size_m), Err(ShapeFileError::Syntax { .. } | ShapeFileError::Numbers { .. })));
        for broken in [text.replace("metres = [0.0", "metres = [nan"), text.replace("metres = [0.0", "metres = [1e9")] {
            assert_eq!(parse(&broken, &picture, size_m), Err(ShapeFileError::Numbers { key: "height.metres" }));
        }
        assert!(matches!(parse(&text.replace("[stretch]", "[stretched]"), &picture, size_m), Err(ShapeFileError::Syntax { .. })));
    }
}
