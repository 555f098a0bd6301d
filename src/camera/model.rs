//! Brown's distortion with skew, exactly as in the source thesis (equations 5 to 10), and its exact
//! inverse.
//!
//! A point in the camera frame is divided by its depth (eq. 5), bent by the radial and tangential
//! terms (eq. 6, 7), and scaled, sheared and shifted into pixels (eq. 8-10). The radial polynomial
//! folds back on itself beyond some radius. [`CameraModel`] computes that radius once and refuses
//! to undistort anything outside it, rather than return a ray that does not exist.

use nalgebra::{Matrix2, Matrix2x3, Matrix3, SMatrix, Vector2, Vector3};
use thiserror::Error;

use super::doubt::LensDoubt;

/// A raw pixel position: distorted, pixel centres at integers, origin at the centre of the top-left
/// pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pixel(pub Vector2<f64>);

/// An undistorted point on the plane at depth 1: (x / z, y / z) in the camera frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Normalized(pub Vector2<f64>);

/// The parameters of a calibration, as a file holds them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intrinsics {
    /// Picture width in pixels.
    pub width: u32,
    /// Picture height in pixels.
    pub height: u32,
    /// Focal length along x in pixels.
    pub fx: f64,
    /// Focal length along y in pixels.
    pub fy: f64,
    /// Principal point, x, in pixels.
    pub cx: f64,
    /// Principal point, y, in pixels.
    pub cy: f64,
    /// alpha_c of equation 8: `x_p = fx (x_d + alpha_c y_d) + cx`.
    pub skew: f64,
    /// kc = [k1, k2, p1, p2, k3], Bouguet's and OpenCV's order.
    pub distortion: [f64; 5],
}

/// Why a set of intrinsics is not a camera.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum CameraError {
    /// A number is NaN or infinite.
    #[error("{name} is {value}, not a finite number")]
    NotFinite {
        /// Its name.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// A focal length is zero or negative.
    #[error("{name} is {value}; a focal length must be above 0 pixels")]
    FocalLength {
        /// `fx` or `fy`.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// The picture has no pixels.
    #[error("the picture is {width} x {height} pixels; both must be above 0")]
    Size {
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
    },
    /// A value that no camera has.
    #[error("{name} is {}, which no camera has: it can be {possible}", Plain(*value))]
    Implausible {
        /// Its name.
        name: &'static str,
        /// Its value.
        value: f64,
        /// The possible values.
        possible: String,
    },
    /// Distortion that folds the picture, or bends it more than any lens.
    #[error("distortion is {distortion:?}, which has no inverse, or bends the picture beyond any lens, over {percent:.0} % of the picture")]
    NotInvertible {
        /// k1, k2, p1, p2, k3.
        distortion: [f64; 5],
        /// Percentage of the picture that is lost.
        percent: f64,
    },
    /// The pictures have another aspect ratio than the calibration.
    #[error(
        "the calibration is for {from_width} x {from_height} pixels, the pictures are {width} x {height}: another aspect ratio; calibrate at this size"
    )]
    Aspect {
        /// Calibrated width.
        from_width: u32,
        /// Calibrated height.
        from_height: u32,
        /// Requested width.
        width: u32,
        /// Requested height.
        height: u32,
    },
}

/// Formats a number as a person would write it.
struct Plain(f64);

impl std::fmt::Display for Plain {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if (1e-4..1e9).contains(&self.0.abs()) || self.0 == 0.0 { write!(f, "{}", self.0) } else { write!(f, "{:e}", self.0) }
    }
}

/// A calibrated camera: pinhole with skew and Brown distortion, and the radius up to which it can
/// be inverted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraModel {
    intrinsics: Intrinsics,
    /// Largest undistorted radius (normalised) at which the radial map still grows.
    valid_radius: f64,
    /// Uncertainty of the parameters, if known.
    doubt: Option<LensDoubt>,
}

impl Intrinsics {
    /// Equations 5 to 10: projects a normalised point to its raw pixel.
    pub(crate) fn project(&self, n: Vector2<f64>) -> Vector2<f64> {
        self.affine(self.distort(n).0)
    }

    /// Equations 6 and 7: returns the distorted point and its derivative by the undistorted one.
    pub(crate) fn distort(&self, n: Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let (x, y) = (n.x, n.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let slope = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3); // d radial / d r2
        let point =
            Vector2::new(radial * x + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x), radial * y + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y);
        let cross = 2.0 * slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y;
        let jacobian = Matrix2::new(
            radial + 2.0 * slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
            cross,
            cross,
            radial + 2.0 * slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
        );
        (point, jacobian)
    }

    /// Equations 5 and 10: converts a distorted point to its pixel.
    pub(crate) fn affine(&self, d: Vector2<f64>) -> Vector2<f64> {
        Vector2::new(self.fx * (d.x + self.skew * d.y) + self.cx, self.fy * d.y + self.cy)
    }

    /// Converts a shift of the distorted point to a shift of the pixel.
    pub(crate) fn shift_px(&self, shift: Vector2<f64>) -> Vector2<f64> {
        Vector2::new(self.fx * (shift.x + self.skew * shift.y), self.fy * shift.y)
    }

    /// Returns the pixel's derivatives by fx, fy, cx, cy, skew, k1, k2, p1, p2, k3, one per column;
    /// `d` is the normalised point `n` distorted.
    pub(crate) fn by_numbers(&self, n: Vector2<f64>, d: Vector2<f64>) -> SMatrix<f64, 2, 10> {
        let r2 = n.norm_squared();
        SMatrix::from_columns(&[
            Vector2::new(d.x + self.skew * d.y, 0.0),
            Vector2::new(0.0, d.y),
            Vector2::x(),
            Vector2::y(),
            Vector2::new(self.fx * d.y, 0.0),
            self.shift_px(n * r2),
            self.shift_px(n * (r2 * r2)),
            self.shift_px(Vector2::new(2.0 * n.x * n.y, r2 + 2.0 * n.y * n.y)),
            self.shift_px(Vector2::new(r2 + 2.0 * n.x * n.x, 2.0 * n.x * n.y)),
            self.shift_px(n * (r2 * r2 * r2)),
        ])
    }
}

impl CameraModel {
    /// Checks the parameters and computes the valid radius.
    pub fn new(intrinsics: Intrinsics) -> Result<Self, CameraError> {
        let i = &intrinsics;
        if i.width == 0 || i.height == 0 {
            return Err(CameraError::Size { width: i.width, height: i.height });
        }
        let [k1, k2, p1, p2, k3] = i.distortion;
        let named = [
            ("fx", i.fx),
            ("fy", i.fy),
            ("cx", i.cx),
            ("cy", i.cy),
            ("skew", i.skew),
            ("distortion k1", k1),
            ("distortion k2", k2),
            ("distortion p1", p1),
            ("distortion p2", p2),
            ("distortion k3", k3),
        ];
        if let Some(&(name, value)) = named.iter().find(|(_, v)| !v.is_finite()) {
            return Err(CameraError::NotFinite { name, value });
        }
        if let Some(&(name, value)) = named[..2].iter().find(|(_, v)| *v <= 0.0) {
            return Err(CameraError::FocalLength { name, value });
        }
        Ok(Self { intrinsics, valid_radius: radial_limit(i.distortion), doubt: None })
    }

    /// Creates a camera without distortion or skew.
    pub fn pinhole(width: u32, height: u32, fx: f64, fy: f64, cx: f64, cy: f64) -> Result<Self, CameraError> {
        Self::new(Intrinsics { width, height, fx, fy, cx, cy, skew: 0.0, distortion: [0.0; 5] })
    }

    /// Returns the model's parameters.
    pub fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// Adds the uncertainty of the parameters, which enters the covariance of poses.
    pub fn with_doubt(self, doubt: Option<LensDoubt>) -> Self {
        Self { doubt, ..self }
    }

    /// Returns the uncertainty of the parameters, if known.
    pub fn doubt(&self) -> Option<LensDoubt> {
        self.doubt
    }

    /// Returns the picture width in pixels.
    pub fn width(&self) -> u32 {
        self.intrinsics.width
    }

    /// Returns the picture height in pixels.
    pub fn height(&self) -> u32 {
        self.intrinsics.height
    }

    /// Returns the largest normalised radius that the distortion maps one to one (infinite without
    /// distortion).
    pub fn valid_radius(&self) -> f64 {
        self.valid_radius
    }

    /// Returns KK of equation 10, which maps normalised coordinates to undistorted pixels.
    pub fn k_matrix(&self) -> Matrix3<f64> {
        let i = &self.intrinsics;
        Matrix3::new(i.fx, i.fx * i.skew, i.cx, 0.0, i.fy, i.cy, 0.0, 0.0, 1.0)
    }

    /// Equations 5 to 10: projects a normalised point to its raw pixel.
    pub fn project(&self, n: Normalized) -> Pixel {
        Pixel(self.intrinsics.project(n.0))
    }

    /// Projects a normalised point to its raw pixel, with the 2x2 derivative.
    pub fn project_with_jacobian(&self, n: Normalized) -> (Pixel, Matrix2<f64>) {
        let i = &self.intrinsics;
        let (d, j) = i.distort(n.0);
        let affine = Matrix2::new(i.fx, i.fx * i.skew, 0.0, i.fy);
        (Pixel(i.affine(d)), affine * j)
    }

    /// Projects a point in camera axes, metres, to its raw pixel, with the derivative by the point.
    /// It must be in front of the camera.
    pub(crate) fn project_point_with_jacobian(&self, point: &Vector3<f64>) -> (Pixel, Matrix2x3<f64>) {
        let n = point.xy() / point.z;
        let (pixel, by_ray) = self.project_with_jacobian(Normalized(n));
        (pixel, by_ray * Matrix2x3::new(1.0, 0.0, -n.x, 0.0, 1.0, -n.y) / point.z)
    }

    /// Returns the pixel that a camera with the same K and no distortion would see: the
    /// "undistorted pixel".
    pub fn undistorted_pixel(&self, n: Normalized) -> Vector2<f64> {
        self.intrinsics.affine(n.0)
    }

    /// Converts an undistorted pixel to its normalised point (K alone).
    pub fn from_undistorted_pixel(&self, p: Vector2<f64>) -> Normalized {
        let i = &self.intrinsics;
        let y = (p.y - i.cy) / i.fy;
        Normalized(Vector2::new((p.x - i.cx) / i.fx - i.skew * y, y))
    }

    /// Returns the ray of a raw pixel: the exact inverse of [`project`](Self::project) by Newton's
    /// method. `None` where the distortion has no inverse (beyond the valid radius).
    pub fn unproject(&self, pixel: Pixel) -> Option<Normalized> {
        let target = self.from_undistorted_pixel(pixel.0).0;
        if self.intrinsics.distortion == [0.0; 5] {
            return target.iter().all(|v| v.is_finite()).then_some(Normalized(target));
        }
        let mut n = self.radial_start(target)?;
        for _ in 0..30 {
            let (d, j) = self.intrinsics.distort(n);
            let step = j.try_inverse()? * (d - target);
            n -= step;
            let radius = n.norm();
            if radius.is_nan() || radius >= self.valid_radius * 1.05 {
                return None;
            }
            if step.norm_squared() < 1e-30 {
                break;
            }
        }
        let (d, j) = self.intrinsics.distort(n);
        let converged = (d - target).norm() < 1e-10 && j.determinant() > 0.0 && n.norm() <= self.valid_radius;
        converged.then_some(Normalized(n))
    }

    /// Solves the radial part alone on the growing branch, by bracketed Newton steps; the caller
    /// handles the tangential part.
    fn radial_start(&self, target: Vector2<f64>) -> Option<Vector2<f64>> {
        let [k1, k2, _, _, k3] = self.intrinsics.distortion;
        let wanted = target.norm();
        if !wanted.is_finite() {
            return None;
        }
        if wanted == 0.0 {
            return Some(target);
        }
        let grown = |r: f64| r * (1.0 + r * r * (k1 + r * r * (k2 + r * r * k3)));
        let (mut low, mut high) = (0.0, if self.valid_radius.is_finite() { self.valid_radius } else { 2.0 * wanted.max(1.0) });
        while self.valid_radius.is_infinite() && grown(high) < wanted {
            high *= 2.0;
            if high > MAX_RADIUS {
                return None;
            }
        }
        if grown(high) < wanted {
            // Tangential terms may still bring it inside: start at the rim and let Newton decide.
            return Some(target * (high / wanted));
        }
        let mut radius = wanted.min(high);
        for _ in 0..60 {
            let over = grown(radius) - wanted;
            if over < 0.0 {
                low = radius;
            } else {
                high = radius;
            }
            let next = radius - over / radial_slope(&self.intrinsics.distortion, radius * radius);
            // Near the rim the slope vanishes and Newton steps are unreliable; bisection always
            // works.
            let next = if (low..=high).contains(&next) { next } else { 0.5 * (low + high) };
            let step = next - radius;
            radius = next;
            if step.abs() < 1e-6 * radius {
                break;
            }
        }
        Some(target * (radius / wanted))
    }

    /// Converts the camera to another picture size of the same aspect ratio (binned or scaled
    /// pictures).
    ///
    /// A pixel c moves to (c + 0.5) s - 0.5. The scaled height may differ by up to 1 pixel due to
    /// rounding.
    ///
    /// # Errors
    /// [`CameraError::Aspect`] when the aspect ratios differ.
    pub fn scaled_to(&self, width: u32, height: u32) -> Result<Self, CameraError> {
        let i = self.intrinsics;
        let (sx, sy) = (f64::from(width) / f64::from(i.width), f64::from(height) / f64::from(i.height));
        let same_shape = (f64::from(i.height) * sx - f64::from(height)).abs() <= 1.0;
        if width == 0 || height == 0 || !same_shape {
            return Err(CameraError::Aspect { from_width: i.width, from_height: i.height, width, height });
        }
        let scaled = Self::new(Intrinsics {
            width,
            height,
            fx: i.fx * sx,
            fy: i.fy * sy,
            cx: (i.cx + 0.5) * sx - 0.5,
            cy: (i.cy + 0.5) * sy - 0.5,
            ..i
        })?;
        Ok(scaled.with_doubt(self.doubt.map(|doubt| doubt.scaled(sx, sy))))
    }
}

/// Maximum normalised radius at which folds are searched (89.99994 degrees off the axis, beyond any
/// lens). Raised, the powers in the polynomial lose precision with no benefit.
const MAX_RADIUS: f64 = 1e6;

/// d(r radial(r))/dr = 1 + 3 k1 s + 5 k2 s² + 7 k3 s³, with s the squared radius.
fn radial_slope([k1, k2, _, _, k3]: &[f64; 5], s: f64) -> f64 {
    1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * 7.0 * k3))
}

/// Returns the first radius at which [`radial_slope`] is no longer positive.
///
/// Between its turning points this cubic in r² is monotonic, so no change of sign is missed.
fn radial_limit(distortion: [f64; 5]) -> f64 {
    let [k1, k2, _, _, k3] = distortion;
    let slope = |s: f64| radial_slope(&distortion, s);
    let mut low = 0.0;
    for high in turning_points(3.0 * k1, 10.0 * k2, 21.0 * k3).into_iter().chain([MAX_RADIUS * MAX_RADIUS]) {
        if !(high > low && high <= MAX_RADIUS * MAX_RADIUS) {
            continue;
        }
        if slope(high) <= 0.0 {
            let mut high = high;
            for _ in 0..200 {
                let middle = 0.5 * (low + high);
                if slope(middle) > 0.0 { low = middle } else { high = middle }
            }
            return low.sqrt();
        }
        low = high;
    }
    f64::INFINITY
}

/// Returns the real roots of a + b s + c s², ascending; NaN if there are none.
fn turning_points(a: f64, b: f64, c: f64) -> [f64; 2] {
    let q = -0.5 * (b + b.signum() * (b * b - 4.0 * a * c).sqrt());
    let (one, two) = (q / c, a / q);
    if one <= two { [one, two] } else { [two, one] }
}

impl crate::geometry::resection::Projection for CameraModel {
    fn pixel_and_jacobian(&self, normalized: Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let (pixel, jacobian) = self.project_with_jacobian(Normalized(normalized));
        (pixel.0, jacobian)
    }
}

#[cfg(test)]
#[path = "model_tests.rs"]
mod tests;
