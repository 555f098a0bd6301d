//! Estimates one colour's size from the displacements of its corners: a shift of the whole picture,
//! a scale about the principal point, and, where the corners show it, a displacement that grows
//! with the cube of the radius.

use nalgebra::{Matrix4, Vector2, Vector4};

use super::CornerColours;
use crate::calibrate::solve::{MEDIAN_LENGTH, OUTLIER_SIGMAS};
use crate::geometry::robust_kernel::median;

/// The size of the picture in one colour, relative to grey.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColourScale {
    /// Scale over the whole picture.
    pub scale: f64,
    /// 3 sigma of the scale.
    pub scale_uncertainty: f64,
    /// Displacement at the picture's corners, pixels, positive away from the middle.
    pub corner_px: f64,
    /// 3 sigma of this displacement.
    pub corner_uncertainty_px: f64,
    /// Shift of the whole picture in this colour, pixels.
    pub shift_px: Vector2<f64>,
    /// Whether the displacement has a part that grows with the cube of the radius.
    pub is_cubic: bool,
    /// Number of corners used.
    pub corners: usize,
}

/// Number of unknowns: shift along x and y, the part proportional to the radius, and the cubic
/// part.
const UNKNOWNS: usize = 4;
/// Index of the cubic part.
const CUBIC: usize = 3;
/// Maximum number of times that outliers are selected; it settles within a few.
const ROUNDS: usize = 8;
/// Minimum fraction of the corners that must be found in a colour: in a colour in which the board
/// has no contrast, those found are chance. Raised, pictures with damaged corners do not count.
const SEEN_SHARE: f64 = 0.5;

/// One corner's displacement; the place is in units of half the picture's diagonal.
#[derive(Debug, Clone, Copy)]
struct Row {
    view: usize,
    place: Vector2<f64>,
    moved: Vector2<f64>,
}

impl Row {
    /// Returns the displacement's derivatives by the unknowns, all in pixels.
    fn basis(&self) -> [Vector2<f64>; UNKNOWNS] {
        [Vector2::x(), Vector2::y(), self.place, self.place * self.place.norm_squared()]
    }

    fn residual(&self, unknowns: &Vector4<f64>) -> Vector2<f64> {
        self.moved - self.basis().iter().zip(unknowns.iter()).map(|(b, u)| b * *u).sum::<Vector2<f64>>()
    }
}

/// A least-squares estimate of the unknowns.
struct Solution {
    unknowns: Vector4<f64>,
    /// Covariances: from the corners' residuals, and from how the unknowns change without one of
    /// the pictures, whose corners may share errors.
    covariances: [Matrix4<f64>; 2],
    corners: usize,
}

impl Solution {
    /// Returns a linear combination of the unknowns, and its 3 sigma by the larger covariance.
    fn combined(&self, by: Vector4<f64>) -> (f64, f64) {
        let variance = self.covariances.iter().map(|c| by.dot(&(c * by))).fold(0.0, f64::max);
        (by.dot(&self.unknowns), 3.0 * variance.sqrt())
    }
}

impl ColourScale {
    /// Estimates a colour's size; `None` with too few corners or fewer than two views.
    pub(super) fn of(views: &[Vec<CornerColours>], colour: usize, (width, height): (u32, u32)) -> Option<Self> {
        let half = Vector2::new(f64::from(width), f64::from(height)) * 0.5;
        let radius = half.norm();
        let all = views.iter().map(Vec::len).sum::<usize>() as f64;
        let row = |view: usize, c: &CornerColours| Some(Row { view, place: c.place / radius, moved: c.moved[colour]? });
        let rows: Vec<Row> = views.iter().enumerate().flat_map(|(v, view)| view.iter().filter_map(move |c| row(v, c))).collect();
        if (rows.len() as f64) < SEEN_SHARE * all {
            return None;
        }
        let cubic = without_outliers(&rows, true)?;
        let (size, uncertainty) = cubic.combined(Vector4::ith(CUBIC, 1.0));
        let is_cubic = size.abs() > uncertainty;
        let solution = if is_cubic { cubic } else { without_outliers(&rows, false)? };
        // The scale that comes nearest to a r + b r^3 over the picture's rectangle is
        // a + b E[r^4] / E[r^2].
        let [x, y] = [half.x / radius, half.y / radius].map(|side| side * side);
        let per_cubic = 3.0 * (x * x / 5.0 + y * y / 5.0 + 2.0 * x * y / 9.0);
        let (scale, scale_uncertainty) = solution.combined(Vector4::new(0.0, 0.0, 1.0, per_cubic) / radius);
        let (corner_px, corner_uncertainty_px) = solution.combined(Vector4::new(0.0, 0.0, 1.0, 1.0));
        let shift_px = solution.unknowns.xy();
        let corners = solution.corners;
        Some(Self { scale: 1.0 + scale, scale_uncertainty, corner_px, corner_uncertainty_px, shift_px, is_cubic, corners })
    }
}

/// Solves by least squares, rejecting outliers as the calibration does.
fn without_outliers(rows: &[Row], is_cubic: bool) -> Option<Solution> {
    let (mut unknowns, mut kept) = (Vector4::zeros(), 0);
    for _ in 0..ROUNDS {
        let mut lengths: Vec<f64> = rows.iter().map(|row| row.residual(&unknowns).norm()).collect();
        // The floor keeps exact input from rejecting rounding errors.
        let sigma = (median(&mut lengths)? / MEDIAN_LENGTH).max(1e-6);
        let good: Vec<Row> = rows.iter().filter(|row| row.residual(&unknowns).norm() <= OUTLIER_SIGMAS * sigma).copied().collect();
        let solution = solved(&good, is_cubic)?;
        if good.len() == kept {
            return Some(solution);
        }
        (unknowns, kept) = (solution.unknowns, good.len());
    }
    solved(rows, is_cubic)
}

/// Normal equations.
#[derive(Clone, Copy)]
struct Equations {
    normal: Matrix4<f64>,
    right: Vector4<f64>,
}

impl Equations {
    /// Collects the equations of some rows; the cubic part is 0 unless `is_cubic`.
    fn of(rows: &[Row], is_cubic: bool) -> Self {
        let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
        for row in rows {
            let basis = row.basis();
            let last = if is_cubic { 1.0 } else { 0.0 };
            for (k, moved) in row.moved.iter().enumerate() {
                let by = Vector4::new(basis[0][k], basis[1][k], basis[2][k], last * basis[CUBIC][k]);
                normal += by * by.transpose();
                right += by * *moved;
            }
        }
        Self { normal, right }
    }

    /// Returns the unknowns and the inverse of the normal matrix, without `other`'s rows.
    fn solved_without(&self, other: &Self, is_cubic: bool) -> Option<(Vector4<f64>, Matrix4<f64>)> {
        let mut normal = self.normal - other.normal;
        if !is_cubic {
            normal[(CUBIC, CUBIC)] = 1.0;
        }
        let mut inverse = normal.try_inverse()?;
        if !is_cubic {
            inverse[(CUBIC, CUBIC)] = 0.0;
        }
        Some((inverse * (self.right - other.right), inverse))
    }
}

/// Solves by least squares; `None` with fewer than two pictures or too few corners.
fn solved(rows: &[Row], is_cubic: bool) -> Option<Solution> {
    let nothing = Equations { normal: Matrix4::zeros(), right: Vector4::zeros() };
    let all = Equations::of(rows, is_cubic);
    let (unknowns, inverse) = all.solved_without(&nothing, is_cubic)?;
    let free = if is_cubic { UNKNOWNS } else { UNKNOWNS - 1 };
    let freedom = (2 * rows.len()).checked_sub(free).filter(|freedom| *freedom > 0)?;
    let squares: f64 = rows.iter().map(|row| row.residual(&unknowns).norm_squared()).sum();
    let (mut spread, mut pictures) = (Matrix4::zeros(), 0.0);
    for picture in rows.chunk_by(|a, b| a.view == b.view) {
        let change = all.solved_without(&Equations::of(picture, is_cubic), is_cubic)?.0 - unknowns;
        spread += change * change.transpose();
        pictures += 1.0;
    }
    // The jackknife's factor.
    let covariances = [inverse * (squares / freedom as f64), spread * ((pictures - 1.0) / pictures)];
    (pictures > 1.0).then_some(Solution { unknowns, covariances, corners: rows.len() })
}
