//! What frames say of the focal length beside all else of the model that may be off.
//!
//! A picture that is stretched, sheared or cropped askew, a surface that stands elsewhere and a lens that bends more than calibrated leave displacements that look like another focal length in one
//! view. But they stay the same from frame to frame, and look different from view to view. So the equations of all of them are averaged over the last frames, each frame's pose and its motion while
//! rows were read being free, and a frame is asked for its focal length together with that mean. Each may be off as far as measures usually are (its sigma); how well a frame knows the focal length
//! is what they leave open of it.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix2xX, OMatrix, SVector, U12};

use super::focal_clue::{FocalClue, LensClue};
use super::model_study::{StudiedFrame, nuisance_normal, nuisances};
use super::model_unknowns::ModelUnknowns;
use super::reference::PreparedBody;
use crate::camera::CameraModel;

/// Surfaces that are asked at most: the equations grow with their cube. Raised, bodies of many surfaces cost more.
const MOST_SURFACES: usize = 8;
/// How far parts of the model may be off where nothing is configured, one sigma: principal point as a share of the picture's width, first radial coefficient, ratio of a surface's sides, shear and
/// keystone of its picture, place (metres) and direction (radians) beside the first surface. Raised, fewer frames tell another focal length; lowered, careless measures pass for one.
const CENTRE_SHARE: f64 = 0.002;
const RADIAL_SIGMA: f64 = 0.05;
const RATIO_SIGMA: f64 = 0.01;
const ASKEW_SIGMA: f64 = 0.003;
const PLACE_SIGMA_M: f64 = 0.01;
const DIRECTION_SIGMA: f64 = 0.01;
/// Sigma of what is held fixed (the first surface's place) and of what is free (the focal length): keep the equations regular.
const FIXED_SIGMA: f64 = 1e-6;
const FREE_SIGMA: f64 = 10.0;
/// Tiles whose displacements err together where none of the unknowns explains them: folds are larger than tiles. Raised, stages that do not fit tell less of the lens.
const TILES_TOGETHER: f64 = 8.0;
/// What earlier frames say counts so much less with each frame: half of it after ten. Raised, a slow zoom passes for the stage; lowered, fewer views are told from each other.
const REMEMBERED: f64 = 0.93;

/// Equations of the unknowns of a body that stay the same.
#[derive(Debug)]
struct Equations {
    normal: DMatrix<f64>,
    right: DVector<f64>,
}

/// Asks one body's frames for the focal length.
#[derive(Debug)]
pub struct FocalMemory {
    unknowns: ModelUnknowns,
    surfaces: usize,
    /// One sigma of each unknown.
    sigmas: DVector<f64>,
    /// Mean over the last frames, and the weight it stands for.
    usual: Equations,
    weight: f64,
    /// Of the last frame, and how much less than its noise it counts.
    frame: Equations,
    trust: f64,
    shared: OMatrix<f64, U12, Dyn>,
    row: Matrix2xX<f64>,
}

/// What is left of a frame's displacements without any of the unknowns.
struct Left {
    squared: f64,
    freedom: f64,
}

impl FocalMemory {
    /// Of a body, before any frame.
    pub fn new(body: &PreparedBody) -> Self {
        let surfaces = body.surfaces.len().min(MOST_SURFACES);
        let unknowns = ModelUnknowns::without_heights(surfaces);
        let n = unknowns.count();
        let zero = || Equations { normal: DMatrix::zeros(n, n), right: DVector::zeros(n) };
        Self {
            surfaces,
            sigmas: DVector::zeros(0),
            usual: zero(),
            weight: 0.0,
            frame: zero(),
            trust: 0.0,
            shared: OMatrix::<f64, U12, Dyn>::zeros(n),
            row: unknowns.row(),
            unknowns,
        }
    }

    /// What a frame says of the focal length; `None` where it says nothing.
    pub fn ask(&mut self, frame: &StudiedFrame, body: &PreparedBody, camera: &CameraModel) -> Option<LensClue> {
        self.trust = 0.0;
        if self.sigmas.is_empty() {
            self.sigmas = self.prior(body, camera);
        }
        let left = self.take(frame, body)?;
        let usual = self.before().filter(|usual| usual.is_clear()).map_or(0.0, |usual| usual.change);
        // Views say what earlier ones did not: the frame's own trust depends on what they leave.
        let mut whole = None;
        self.trust = 1.0;
        for _ in 0..2 {
            let (numbers, sigma) = self.solved(1.0, None)?;
            let misfit = left.after(&self.frame, &numbers) / left.freedom;
            self.trust = 1.0 / (1.0 + TILES_TOGETHER * (misfit - 1.0).max(0.0));
            whole = Some(FocalClue { change: numbers[0], sigma });
        }
        let (numbers, sigma) = self.solved(1.0, Some(usual))?;
        let changed = FocalClue { change: numbers[0] - usual, sigma };
        Some(LensClue { whole: whole?, changed, usual })
    }

    /// Remembers the frame that was asked last; `share`: how much it counts.
    pub fn remember(&mut self, share: f64) {
        let share = if self.trust > 0.0 { share } else { 0.0 };
        let kept = REMEMBERED * self.weight;
        if kept + share <= 0.0 {
            return;
        }
        let (old, new) = (kept / (kept + share), share * self.trust / (kept + share));
        self.usual.normal.zip_apply(&self.frame.normal, |mean, own| *mean = old * *mean + new * own);
        self.usual.right.zip_apply(&self.frame.right, |mean, own| *mean = old * *mean + new * own);
        self.weight = kept + share;
    }

    /// What the frames before say together.
    fn before(&self) -> Option<FocalClue> {
        let (numbers, sigma) = self.solved(0.0, None)?;
        Some(FocalClue { change: numbers[0], sigma })
    }

    fn prior(&self, body: &PreparedBody, camera: &CameraModel) -> DVector<f64> {
        let centre_px = CENTRE_SHARE * f64::from(camera.width());
        let doubt = camera.doubt().map_or([0.0; 2], |doubt| doubt.uncertainty.centre_px.map(|off| off / 3.0));
        let mut sigmas = DVector::from_element(self.unknowns.count(), FIXED_SIGMA);
        sigmas.as_mut_slice()[..4].copy_from_slice(&[FREE_SIGMA, doubt[0].max(centre_px), doubt[1].max(centre_px), RADIAL_SIGMA]);
        for (k, surface) in body.surfaces.iter().take(self.surfaces).enumerate() {
            let doubt = &surface.spec.doubt;
            let askew = ASKEW_SIGMA.max(doubt.corners_share());
            let corners = self.unknowns.corners(k);
            sigmas.rows_range_mut(corners.clone()).fill(askew);
            sigmas[corners.start] = RATIO_SIGMA.max(askew);
            if k > 0 {
                let place = self.unknowns.place(k).start;
                sigmas.rows_mut(place, 3).fill(PLACE_SIGMA_M.max(doubt.position_m));
                sigmas.rows_mut(place + 3, 3).fill(DIRECTION_SIGMA.max(doubt.rotation_rad));
            }
        }
        sigmas
    }

    /// The frame's equations, its pose and motion eliminated.
    fn take(&mut self, frame: &StudiedFrame, body: &PreparedBody) -> Option<Left> {
        let Self { unknowns, frame: Equations { normal, right }, shared, row, .. } = self;
        let mut own = nuisance_normal(frame.rows);
        let mut own_right = SVector::<f64, 12>::zeros();
        let mut squared = 0.0;
        normal.fill(0.0);
        right.fill(0.0);
        shared.fill(0.0);
        for t in frame.residuals.tiles() {
            let anchor = &frame.anchors[t.anchor];
            if anchor.surface as usize >= self.surfaces {
                continue;
            }
            unknowns.fill(row, t, anchor, frame.pose, body);
            let by_nuisance = nuisances(t, frame.rows);
            let weighted = t.information * &*row;
            let weighted_shift = t.information * t.shift_px;
            own += by_nuisance.transpose() * t.information * by_nuisance;
            own_right += by_nuisance.transpose() * weighted_shift;
            squared += t.squared();
            let columns = unknowns.columns_of(anchor.surface as usize);
            for (j, column) in columns.clone().enumerate() {
                let w = weighted.column(j);
                right[column] += row.column(j).dot(&weighted_shift);
                let mut s = shared.column_mut(column);
                s += by_nuisance.transpose() * w;
                for (i, other) in columns.clone().enumerate() {
                    normal[(other, column)] += row.column(i).dot(&w);
                }
            }
        }
        let factor = own.cholesky()?;
        let by_shared = factor.solve(&*shared);
        normal.gemm_tr(-1.0, &*shared, &by_shared, 1.0);
        right.gemv_tr(-1.0, &by_shared, &own_right, 1.0);
        let squared = squared - own_right.dot(&factor.solve(&own_right));
        let freedom = 2.0 * frame.residuals.weight() - 7.0;
        (freedom > 0.0).then_some(Left { squared, freedom })
    }

    /// The unknowns that explain the frames before, and the last frame by so much, best; and one sigma of the focal length. `usual`: where the frames before had that focal length, whatever this
    /// one has.
    fn solved(&self, own: f64, usual: Option<f64>) -> Option<(DVector<f64>, f64)> {
        let mut normal = &self.usual.normal + &self.frame.normal * (own * self.trust);
        let mut right = &self.usual.right + &self.frame.right * (own * self.trust);
        if let Some(usual) = usual {
            for k in 0..right.len() {
                let together = self.usual.normal[(k, 0)];
                if k > 0 {
                    right[k] -= together * usual;
                    normal[(k, 0)] -= together;
                    normal[(0, k)] -= together;
                } else {
                    normal[(0, 0)] -= together;
                    right[0] -= self.usual.right[0];
                }
            }
        }
        for (k, sigma) in self.sigmas.iter().enumerate() {
            normal[(k, k)] += sigma.powi(-2);
        }
        let factor = Cholesky::<f64, Dyn>::new(normal)?;
        let numbers = factor.solve(&right);
        let mut unit = DVector::zeros(right.len());
        unit[0] = 1.0;
        let variance = factor.solve(&unit)[0];
        (variance > 0.0 && numbers.iter().all(|v| v.is_finite())).then(|| (numbers, variance.sqrt()))
    }
}

impl Left {
    /// What some numbers leave, in squared sigmas of noise.
    fn after(&self, frame: &Equations, numbers: &DVector<f64>) -> f64 {
        self.squared - 2.0 * frame.right.dot(numbers) + numbers.dot(&(&frame.normal * numbers))
    }
}

#[cfg(test)]
#[path = "focal_memory_tests.rs"]
mod tests;
