//! A pinhole in the terms of film cameras: focal length and film gate.

use crate::camera::Intrinsics;

/// Width of the film gate, millimetres: 35 mm photography. Only ratios to it are known from a
/// calibration in pixels, so any width would do.
pub const GATE_WIDTH_MM: f64 = 36.0;

/// Focal length and film gate that give fx, fy, cx and cy of a lens.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Film {
    /// Focal length, millimetres.
    pub focal_mm: f64,
    /// Width of the gate, millimetres.
    pub width_mm: f64,
    /// Height of the gate, millimetres; its aspect differs from the picture's where fx and fy do.
    pub height_mm: f64,
    /// How far the gate's centre lies right of the axis, millimetres.
    pub right_mm: f64,
    /// How far the gate's centre lies above the axis, millimetres.
    pub up_mm: f64,
}

impl Film {
    /// Converts a lens; skew and distortion are left out.
    pub fn new(lens: &Intrinsics) -> Self {
        let (w, h) = (f64::from(lens.width), f64::from(lens.height));
        let focal_mm = GATE_WIDTH_MM * lens.fx / w;
        let height_mm = h * focal_mm / lens.fy;
        // Pixel centres are at integers, so the picture begins at -0.5.
        Self {
            focal_mm,
            width_mm: GATE_WIDTH_MM,
            height_mm,
            right_mm: GATE_WIDTH_MM * (0.5 - (lens.cx + 0.5) / w),
            up_mm: height_mm * ((lens.cy + 0.5) / h - 0.5),
        }
    }
}

/// Returns the angle between the upper and the lower edge of a centred picture, radians.
pub fn vertical_fov(lens: &Intrinsics) -> f64 {
    2.0 * (0.5 * f64::from(lens.height) / lens.fy).atan()
}

/// Returns how far the principal point lies right of and below the picture's centre, pixels.
pub fn principal_offset_px(lens: &Intrinsics) -> [f64; 2] {
    [lens.cx + 0.5 - 0.5 * f64::from(lens.width), lens.cy + 0.5 - 0.5 * f64::from(lens.height)]
}
