//! The unknowns of a tile: the columns of its normal equations, and the sums of the products of
//! these columns.

/// Columns of a tile: those of the pose, then those of the light.
pub const COLUMNS: usize = POSE + LIGHT;
/// Columns of the pose, which come first: position, then rotation.
pub const POSE: usize = 6;
/// Columns of the light: point spread, bias, and the gains at the four corners of the tile's cell.
pub const LIGHT: usize = 6;
/// Column of the variance of the point spread.
pub const PSF_VARIANCE: usize = POSE;
/// Column of the bias.
pub const BIAS: usize = POSE + 1;
/// First of the four columns of the gains.
pub const GAINS: usize = POSE + 2;
/// Number of the columns and the residual, which comes last.
pub const ALL: usize = COLUMNS + 1;
/// Entries of the upper triangle of the pose's columns.
pub const POSE_ENTRIES: usize = POSE * (POSE + 1) / 2;

/// Weighted sums of products of columns, over one run of pixels.
#[derive(Debug, Clone, Copy)]
pub struct TileSums {
    sums: [f32; Self::ENTRIES],
}

impl Default for TileSums {
    fn default() -> Self {
        Self { sums: [0.0; Self::ENTRIES] }
    }
}

impl TileSums {
    /// Entries of the upper triangle of the columns and the residual.
    pub const ENTRIES: usize = ALL * (ALL + 1) / 2;

    /// Takes the upper triangle, row by row.
    pub fn new(sums: [f32; Self::ENTRIES]) -> Self {
        Self { sums }
    }

    /// Returns the index of the product of columns i <= j.
    pub const fn entry(i: usize, j: usize) -> usize {
        i * ALL - i * (i + 1) / 2 + j
    }

    /// Returns the sum of w a_i a_j; column [`COLUMNS`] is the residual.
    #[inline(always)]
    pub fn product(&self, i: usize, j: usize) -> f64 {
        f64::from(self.sums[if i <= j { Self::entry(i, j) } else { Self::entry(j, i) }])
    }

    /// Returns [`product`](Self::product) for the columns of the pose: the upper triangle, row by
    /// row.
    #[inline(always)]
    pub fn of_pose(&self) -> [f64; POSE_ENTRIES] {
        let mut triangle = [0.0; POSE_ENTRIES];
        let (mut to, mut from) = (0, 0);
        for i in 0..POSE {
            for j in 0..POSE - i {
                triangle[to + j] = f64::from(self.sums[from + j]);
            }
            (to, from) = (to + POSE - i, from + ALL - i);
        }
        triangle
    }

    /// Returns the normal matrix times a step: the part of the right side that the step explains.
    pub fn by_step(&self, step: &[f32; COLUMNS]) -> [f64; COLUMNS] {
        let step = step.map(f64::from);
        let mut sums = [0.0; COLUMNS];
        let mut first = 0;
        for i in 0..COLUMNS {
            // An entry off the diagonal stands for two of the full matrix.
            let row = &self.sums[first..first + COLUMNS - i];
            sums[i] += f64::from(row[0]) * step[i];
            for (j, product) in (i + 1..COLUMNS).zip(&row[1..]) {
                let product = f64::from(*product);
                sums[i] += product * step[j];
                sums[j] += product * step[i];
            }
            first += ALL - i;
        }
        sums
    }
}

/// Returns the index of entry (i, j) of a symmetric matrix of the pose's columns in its upper
/// triangle, row by row.
pub const fn entry(i: usize, j: usize) -> usize {
    let (i, j) = if i <= j { (i, j) } else { (j, i) };
    i * POSE - i * (i + 1) / 2 + j
}
