//! The constant matrix that maps one camera's rotations to the other's, by generalised least
//! squares.
//!
//! Two kinds of noise are in a rotation over an interval. That of poses is the difference of two
//! errors, so neighbouring intervals have it with opposite signs. That of rotations measured from
//! picture to picture is new in each. Their ratio is a parameter, as the residuals show it.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use crate::geometry::pose::quaternion;

/// Smallest standard deviation that residuals may show, radians: 0.2 seconds of arc, below the
/// error of any interpolation. Raised, delays of exact poses get larger sigmas.
const MIN_SIGMA_RAD: f64 = 1e-6;
/// Smallest eigenvalue of the rotations' second moments that is used, as a share of the largest:
/// about axes with less motion the matrix is undetermined. Raised, small rotations are not
/// compared.
const MIN_SHARE: f64 = 1e-5;
/// Smallest motion about a second axis, as a share of the moment about the first, that determines
/// the rotation between the cameras. Chosen: a fifth of the rate. Raised, fewer pans determine it;
/// lowered, noise does.
const MIN_SECOND_AXIS: f64 = 0.04;
/// Squared residual over the median one, above which a row contradicts the others: 7 to 8 sigma.
/// Stamps that jitter have residuals in proportion to the rate, so lower values cost good frames;
/// raised, wrong poses pull the delay.
const OUTLIER: f64 = 25.0;
/// Residual below which no row does, radians: a hundredth of a degree. Raised, small wrong
/// rotations stay; lowered, frames of exact clips are left out.
const MIN_OUTLIER_RAD: f64 = 2e-4;
/// Maximum share of rows that contradict the others: more are no outliers.
const MAX_OUTLIERS: f64 = 0.1;
/// Number of times that they are chosen again with the better fit. Raised, it only takes longer.
const TRIMS: usize = 3;

/// One interval: what one camera rotated by, and the other's spline, shifted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Row {
    /// Index of the interval.
    pub index: usize,
    /// Its middle, seconds.
    pub middle_s: f64,
    /// Its length over the typical length.
    pub share: f64,
    /// Whether it begins where the row before ends.
    pub is_joined: bool,
    /// The rotation to explain, radians.
    pub wanted: Vector3<f64>,
    /// The other camera's rotation over the shifted interval, radians.
    pub predicted: Vector3<f64>,
    /// How `predicted` changes as the interval moves later, radians per second.
    pub change: Vector3<f64>,
}

/// The fitted matrix and what it leaves.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Regression {
    /// wanted = map · predicted.
    pub map: Matrix3<f64>,
    /// Sum of squared whitened residuals about each axis.
    pub squares: Vector3<f64>,
    /// Second moments of `wanted` with `predicted`, whitened.
    mixed: Matrix3<f64>,
    /// Pseudo-inverse of the whitened second moments of `predicted`.
    inverse: Matrix3<f64>,
    /// The whitened rows.
    rows: Vec<Row>,
    /// Logarithm of the determinant of the noise's correlation.
    log_determinant: f64,
}

/// Divides the correlation of the noise out. `of_poses` is the share of the pose noise, from 0 to
/// 1: the variance is (1 - of_poses) + 2 of_poses, the covariance of neighbours -of_poses. Returns
/// the logarithm of the determinant as well.
fn whitened(rows: &[Row], of_poses: f64) -> (Vec<Row>, f64) {
    let mut white: Vec<Row> = Vec::with_capacity(rows.len());
    let (mut diagonal, mut log_determinant) = (1.0_f64, 0.0);
    for row in rows {
        let variance = (1.0 - of_poses) * row.share + 2.0 * of_poses;
        let before = white.last().filter(|_| row.is_joined).copied();
        let coupling = before.map_or(0.0, |_| -of_poses / diagonal);
        // The variance exceeds twice the covariance, so this stays positive.
        diagonal = (variance - coupling * coupling).max(1e-9).sqrt();
        log_determinant += 2.0 * diagonal.ln();
        let white_of =
            |own: Vector3<f64>, of: fn(&Row) -> Vector3<f64>| (own - before.as_ref().map_or(Vector3::zeros(), of) * coupling) / diagonal;
        white.push(Row {
            wanted: white_of(row.wanted, |row| row.wanted),
            predicted: white_of(row.predicted, |row| row.predicted),
            change: white_of(row.change, |row| row.change),
            ..*row
        });
    }
    (white, log_determinant)
}

/// Returns the pseudo-inverse of second moments, without directions of hardly any motion.
fn inverse(moments: &Matrix3<f64>) -> Matrix3<f64> {
    let eigen = moments.symmetric_eigen();
    let least = eigen.eigenvalues.max() * MIN_SHARE;
    let inverted = eigen.eigenvalues.map(|v| if v > least { 1.0 / v } else { 0.0 });
    eigen.eigenvectors * Matrix3::from_diagonal(&inverted) * eigen.eigenvectors.transpose()
}

impl Regression {
    /// Returns a fit without the rows that contradict the others, and those.
    pub fn trimmed(rows: &[Row]) -> (Self, Vec<Row>) {
        let mut fit = Self::of(rows, 0.0);
        let mut left_out = Vec::new();
        for _ in 0..TRIMS {
            let square = |row: &Row| (row.wanted - fit.map * row.predicted).norm_squared();
            let mut sorted: Vec<f64> = rows.iter().map(square).collect();
            sorted.sort_by(f64::total_cmp);
            let median = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
            let limit = (OUTLIER * median).max(MIN_OUTLIER_RAD * MIN_OUTLIER_RAD);
            let (kept, far): (Vec<Row>, Vec<Row>) = rows.iter().partition(|row| square(row) <= limit);
            if far.len() as f64 > MAX_OUTLIERS * rows.len() as f64 {
                return (Self::of(rows, 0.0), Vec::new());
            }
            (fit, left_out) = (Self::of(&kept, 0.0), far);
        }
        (fit, left_out)
    }

    pub fn of(rows: &[Row], of_poses: f64) -> Self {
        let (rows, log_determinant) = whitened(rows, of_poses);
        let moments: Matrix3<f64> = rows.iter().map(|row| row.predicted * row.predicted.transpose()).sum();
        let mixed: Matrix3<f64> = rows.iter().map(|row| row.wanted * row.predicted.transpose()).sum();
        let inverse = inverse(&moments);
        let map = mixed * inverse;
        let squares = rows.iter().map(|row| (row.wanted - map * row.predicted).map(|v| v * v)).sum();
        Self { map, squares, mixed, inverse, rows, log_determinant }
    }

    /// Returns the variance of the residuals about each axis.
    pub fn variances(&self) -> Vector3<f64> {
        let freedom = (self.rows.len() as f64 - 3.0).max(1.0);
        self.squares.map(|v| (v / freedom).max(MIN_SIGMA_RAD * MIN_SIGMA_RAD))
    }

    /// Returns -2 ln of the likelihood per row, with the variance about each axis as the residuals
    /// show it.
    pub fn cost(&self) -> f64 {
        let of_variances: f64 = self.variances().iter().map(|v| v.ln()).sum();
        of_variances + 3.0 * self.log_determinant / self.rows.len().max(1) as f64
    }

    /// Returns the share of the rotation that stays unexplained, from 0 to 1.
    pub fn unexplained(&self) -> f64 {
        let wanted: f64 = self.rows.iter().map(|row| row.wanted.norm_squared()).sum();
        if wanted > 0.0 { (self.squares.sum() / wanted).min(1.0) } else { 1.0 }
    }

    /// Returns how many times the rate predicted is the rate wanted: 1 for rigid rigs and right
    /// lenses.
    pub fn gain(&self) -> f64 {
        let [of_mapped, own] = self.rows.iter().fold([0.0, 0.0], |[mapped, own], row| {
            [mapped + (self.map * row.predicted).norm_squared(), own + row.predicted.norm_squared()]
        });
        if own > 0.0 { (of_mapped / own).sqrt() } else { 0.0 }
    }

    /// Returns the rotation that maps `predicted` to `wanted` best (Kabsch 1976), `None` if motion
    /// about one axis only leaves it undetermined.
    pub fn rotation(&self) -> Option<UnitQuaternion<f64>> {
        let svd = self.mixed.svd(true, true);
        let (u, v_t) = (svd.u?, svd.v_t?);
        let mut sizes = svd.singular_values;
        sizes.as_mut_slice().sort_by(|a, b| b.total_cmp(a));
        if sizes[1] <= MIN_SECOND_AXIS * sizes[0] {
            return None;
        }
        let mut signs = Vector3::repeat(1.0);
        signs[svd.singular_values.imin()] = (u * v_t).determinant().signum();
        Some(quaternion(&(u * Matrix3::from_diagonal(&signs) * v_t)))
    }

    /// Returns the sigma of the shift, seconds: from the information of the residuals, and enlarged
    /// where large ones meet fast motion, as with stamps that jitter (White 1980), or neighbours
    /// pull the shift the same way (Newey and West 1987).
    pub fn sigma_s(&self) -> f64 {
        let variances = self.variances();
        let slope = |row: &Row| self.map * row.change;
        let mixed: Matrix3<f64> = self.rows.iter().map(|row| slope(row) * row.predicted.transpose()).sum();
        let explained = mixed * self.inverse;
        // The part of the derivative that no other matrix would explain.
        let own = |row: &Row| slope(row) - explained * row.predicted;
        let weight_of = |row: &Row| own(row).component_div(&variances).dot(&own(row));
        let information: f64 = self.rows.iter().map(weight_of).sum();
        // A row that determines the shift by itself has a small residual: MacKinnon and White's
        // (1985) correction.
        let pull = |row: &Row| {
            let residual = row.wanted - self.map * row.predicted;
            own(row).component_div(&variances).dot(&residual) / (1.0 - (weight_of(row) / information).min(0.5))
        };
        let pulls: Vec<f64> = self.rows.iter().map(pull).collect();
        // The larger of both: fewer terms scatter less.
        let apart: f64 = pulls.iter().map(|pull| pull * pull).sum();
        let ratio = long_run_variance(&pulls).max(apart) / information;
        (ratio.max(1.0) / information).sqrt()
    }
}

/// Returns the variance of the sum of a series whose neighbours are correlated, with Bartlett's
/// weights.
fn long_run_variance(series: &[f64]) -> f64 {
    let lags = 1 + (1.5 * (series.len() as f64).cbrt()) as usize;
    let product = |lag: usize| series.iter().zip(series.iter().skip(lag)).map(|(a, b)| a * b).sum::<f64>();
    let correlated: f64 = (1..=lags).map(|lag| 2.0 * (1.0 - lag as f64 / (lags + 1) as f64) * product(lag)).sum();
    product(0) + correlated
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// Rows whose noise is the difference of two errors, as that of poses.
    fn rows(n: usize, sigma: f64, random: &mut Pcg64Mcg) -> Vec<Row> {
        let mut error = Vector3::zeros();
        let mut normal = |sigma: f64| Vector3::from_fn(|_, _| (0..12).map(|_| random.random_range(-0.5..0.5)).sum::<f64>() * sigma);
        (0..n)
            .map(|index| {
                let predicted = normal(0.01);
                let next = normal(sigma);
                let wanted = predicted + next - error;
                error = next;
                Row { index, middle_s: index as f64, share: 1.0, is_joined: index > 0, wanted, predicted, change: normal(0.1) }
            })
            .collect()
    }

    #[test]
    fn whitened_pose_noise_is_uncorrelated_and_of_its_own_size() {
        let rows = rows(2000, 1e-3, &mut Pcg64Mcg::seed_from_u64(5));
        let regression = Regression::of(&rows, 1.0);
        let sigma = regression.variances().map(f64::sqrt);
        assert!(sigma.iter().all(|s| (s / 1e-3 - 1.0).abs() < 0.06), "{sigma}");
        assert!((regression.map - Matrix3::identity()).norm() < 0.02, "{}", regression.map);
        let residuals: Vec<f64> = regression.rows.iter().map(|row| (row.wanted - regression.map * row.predicted).x).collect();
        let ratio = long_run_variance(&residuals) / residuals.iter().map(|r| r * r).sum::<f64>();
        assert!((0.5..1.6).contains(&ratio), "{ratio}");
        // The likelihood knows which kind of noise it is.
        assert!(regression.cost() < Regression::of(&rows, 0.5).cost() && regression.cost() < Regression::of(&rows, 0.0).cost() - 0.5);
    }

    #[test]
    fn motion_about_one_axis_leaves_the_others_undetermined_but_explains_all() {
        let only_y = |row: Row| Row { wanted: Vector3::y() * row.predicted.y * 0.5, predicted: Vector3::y() * row.predicted.y, ..row };
        let rows: Vec<Row> = rows(50, 0.0, &mut Pcg64Mcg::seed_from_u64(6)).into_iter().map(only_y).collect();
        let regression = Regression::of(&rows, 0.0);
        assert!(regression.unexplained() < 1e-12 && (regression.gain() - 0.5).abs() < 1e-9);
    }

    #[test]
    fn no_rows_have_no_finite_sigma() {
        let nothing = Regression::of(&[], 0.5);
        assert!(!nothing.sigma_s().is_finite() && nothing.unexplained() == 1.0 && nothing.gain() == 0.0);
    }
}
