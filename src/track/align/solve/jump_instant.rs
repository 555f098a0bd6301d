//! When the velocity jumped, and by how much: jumps at several instants are tried beside no jump,
//! and the mixture of all of them is the result.
//!
//! A camera that starts or stops while a frame is exposed and read bends the path of the picture:
//! rows exposed after the jump are shifted by it, earlier ones are not. Pose, velocity and
//! acceleration cannot follow that bend. Where the jump is small, the pose is off by a tenth of a
//! pixel although its Mahalanobis distance is small. But the residuals that a step leaves still
//! contain the jump. Each instant has a score and, with the motion eliminated (Schur complement),
//! an information, and so an evidence. The mixture over priors, instants, sizes and no jump gives
//! the pose at the stamp, the motion after the frame, and their covariances (Bar-Shalom, Li and
//! Kirubarajan 2001, section 11.6).

use crate::track::align::tuning::TUNING;
use nalgebra::{Matrix6, SMatrix, Vector6};

use crate::camera::Shutter;
use crate::motion::{MotionError, MotionMatrix, unseen};
use crate::track::align::kernel::columns::{POSE_ENTRIES, entry};
use crate::track::align::kernel::tile_equations::{TileEquations, TileScore};

/// Bands of rows in which tiles are gathered. Raised, nearby instants differ no more than before;
/// lowered, the instants of `jump_instants_within_frame` fall into the same band.
const BANDS: usize = 12;
/// Sigmas of a jump, as fractions of the usual velocity. The smaller one raised, small starts are
/// taken for noise; more sizes cost more.
const JUMP_SIZES: [f64; 2] = [1.0, 0.25];
/// Maximum number of priors in the mixture: with jerk, and with the uniform motion before.
pub const MAX_PRIORS: usize = 2;

/// The equations of the tiles in a band of rows, by powers of the time from the band's middle:
/// normal matrix of the pose, and the part of the right side that the step left.
#[derive(Debug, Clone, Copy)]
struct Band {
    by_pose: [[f64; POSE_ENTRIES]; 3],
    left: [[f64; 6]; 2],
    is_empty: bool,
}

/// The tiles of a frame, gathered by the exposure times of their rows.
#[derive(Debug)]
pub struct RowBands {
    bands: [Band; BANDS],
    shutter: Shutter,
}

/// Value and slope in time of a factor of the pose, at the middle of a band.
type Profile = [f64; 2];

/// A prior of the motion.
#[derive(Debug, Clone, Copy)]
pub struct MotionPrior {
    /// Its information.
    pub information: MotionMatrix,
    /// Error from the solved motion to its mean.
    pub error: MotionError,
    /// Its prior probability, where there is a second one.
    pub likelihood: f64,
    /// Covariance of the motion that was solved with it, without a jump; `None` if the motion was
    /// solved with another prior.
    pub covariance: Option<MotionMatrix>,
}

/// The mixture's correction of a solved motion.
#[derive(Debug, Clone, Copy)]
pub struct Mixture {
    /// Correction of the pose at the stamp.
    pub pose: Vector6<f64>,
    /// To be added to the pose's covariance.
    pub pose_covariance: Matrix6<f64>,
    /// Correction of the motion after the frame, carried back to the stamp.
    pub motion: MotionError,
    /// Covariance of the corrected motion.
    pub motion_covariance: MotionMatrix,
}

impl RowBands {
    /// Creates bands without tiles.
    pub fn new(shutter: Shutter) -> Self {
        let band = Band { by_pose: [[0.0; POSE_ENTRIES]; 3], left: [[0.0; 6]; 2], is_empty: true };
        Self { bands: [band; BANDS], shutter }
    }

    /// Adds a tile whose middle is exposed `delay_s` seconds after the stamp. `left`: the part of
    /// its right side that the step left; `weight`: inverse of the residuals' variance after
    /// whitening.
    pub fn add(&mut self, tile: &TileEquations, left: &TileScore, delay_s: f64, weight: f64) {
        let readout_s = self.shutter.readout_s;
        let share = if readout_s == 0.0 { 0.5 } else { delay_s / readout_s + 0.5 };
        let k = ((share * BANDS as f64) as usize).min(BANDS - 1);
        let off_s = delay_s - self.middle_s(k);
        let band = &mut self.bands[k];
        band.is_empty = false;
        let own = tile.sums.of_pose();
        for (e, product) in own.iter().enumerate() {
            band.by_pose[0][e] += weight * product;
            band.by_pose[1][e] += weight * product * off_s;
            band.by_pose[2][e] += weight * product * off_s * off_s;
        }
        if let Some(rows) = &tile.rows {
            let (by_time, by_squared_time) = (rows.by_time(), rows.by_squared_time());
            for e in 0..POSE_ENTRIES {
                band.by_pose[1][e] += weight * by_time[e];
                band.by_pose[2][e] += weight * (2.0 * off_s * by_time[e] + by_squared_time[e]);
            }
        }
        for i in 0..6 {
            band.left[0][i] += weight * left.columns[i];
            band.left[1][i] += weight * (left.columns[i] * off_s + left.timed[i]);
        }
    }

    /// Returns the mixture over all priors, and for each over all instants and no jump. `dt_s`:
    /// seconds since the last frame; `distance_m`: to the nearest surface, for the usual velocity.
    /// `None` where a matrix is singular or a result is not finite.
    pub fn mixture(&self, priors: [Option<MotionPrior>; MAX_PRIORS], dt_s: f64, distance_m: f64) -> Option<Mixture> {
        let is_alone = priors.iter().flatten().count() < 2;
        let part = |prior: MotionPrior| Some(self.with_jumps(&self.without_jump(&prior, is_alone)?, dt_s, distance_m));
        mix(&priors.map(|prior| prior.and_then(part)))
    }

    /// Mixes jumps of all sizes at all instants, and no jump.
    fn with_jumps(&self, without: &WithoutJump, dt_s: f64, distance_m: f64) -> Part {
        let [speed, angular_velocity, ..] = unseen(distance_m);
        let usual = Vector6::new(speed, speed, speed, angular_velocity, angular_velocity, angular_velocity);
        let priors = JUMP_SIZES.map(|size| usual.map(|sigma| (size * sigma).powi(-2)));
        let mut members = Members::none_jumped();
        for (instant_s, likelihood) in self.instants(dt_s) {
            let solved = self.jump_sums(instant_s).beside(without);
            let tried = priors.map(|prior| solved.tried(&prior, likelihood));
            members.add(&solved, &tried);
        }
        members.part(without)
    }

    /// Returns the instants that are tried, seconds from the stamp, each with the prior probability
    /// of a jump of each size there.
    fn instants(&self, dt_s: f64) -> impl Iterator<Item = (f64, f64)> {
        let half_s = 0.5 * (self.shutter.readout_s.abs() + self.shutter.exposure_s);
        // Starts at the last stamp: a jump later in that frame may not have shown in it.
        let gap_s = (dt_s - half_s).max(0.0);
        let whole_s = (2.0 * half_s + gap_s).max(f64::MIN_POSITIVE);
        let spans =
            [(-half_s, 2.0 * half_s, TUNING.jump_instants_within_frame), (-half_s - gap_s, gap_s, TUNING.jump_instants_before_frame)];
        spans.into_iter().filter(|(_, lasts_s, _)| *lasts_s > 0.0).flat_map(move |(from_s, lasts_s, parts)| {
            let likelihood = TUNING.jump_probability * lasts_s / (whole_s * parts as f64 * JUMP_SIZES.len() as f64);
            (0..parts).map(move |part| (from_s + lasts_s * (part as f64 + 0.5) / parts as f64, likelihood))
        })
    }

    /// Returns the middle of a band, seconds from the stamp.
    fn middle_s(&self, band: usize) -> f64 {
        self.shutter.readout_s * ((band as f64 + 0.5) / BANDS as f64 - 0.5)
    }

    /// Returns the bands that have tiles, with their indices.
    fn filled(&self) -> impl Iterator<Item = (usize, &Band)> {
        self.bands.iter().enumerate().filter(|(_, band)| !band.is_empty)
    }

    /// Returns how position, velocity and acceleration change the pose of a band.
    fn profiles(&self, band: usize) -> [Profile; 3] {
        let t = self.middle_s(band);
        [[1.0, 0.0], [t, 1.0], [0.5 * (t * t + self.shutter.exposure_s.powi(2) / 12.0), t]]
    }

    /// Returns how a jump changes the pose of a band.
    fn profile_of_jump(&self, band: usize, instant_s: f64) -> Profile {
        let (t, exposure_s) = (self.middle_s(band), self.shutter.exposure_s);
        let quarter_s = 0.25 * self.shutter.readout_s / BANDS as f64;
        let at = |t: f64| mean_since(t, instant_s, exposure_s);
        let slope = if quarter_s == 0.0 { 0.0 } else { (at(t + quarter_s) - at(t - quarter_s)) / (2.0 * quarter_s) };
        [at(t), slope]
    }

    /// Solves for the motion without a jump, from the prior and the bands. `is_alone`: there is no
    /// other prior, so its evidence is not needed.
    fn without_jump(&self, prior: &MotionPrior, is_alone: bool) -> Option<WithoutJump> {
        let MotionPrior { information: known, error, likelihood, covariance } = prior;
        let (mut information, mut pull) = (*known, known * error);
        for (k, band) in self.filled() {
            let profiles = self.profiles(k);
            for (a, of_a) in profiles.iter().enumerate() {
                let mut part = pull.fixed_rows_mut::<6>(6 * a);
                part += band.score(*of_a);
                for (b, of_b) in profiles.iter().enumerate().skip(a) {
                    let product = band.product(*of_a, *of_b);
                    let mut block = information.fixed_view_mut::<6, 6>(6 * a, 6 * b);
                    block += product;
                    if a != b {
                        let mut mirrored = information.fixed_view_mut::<6, 6>(6 * b, 6 * a);
                        mirrored += product;
                    }
                }
            }
        }
        let factor = information.cholesky()?;
        let solved = factor.inverse();
        let correction = solved * pull;
        let evidence = if is_alone {
            0.0
        } else {
            let half_log_determinant = |l: &MotionMatrix| l.diagonal().map(f64::ln).sum();
            likelihood.ln()
                + 0.5 * (pull.dot(&correction) - error.dot(&(known * error)))
                + half_log_determinant(known.cholesky()?.l_dirty())
                - half_log_determinant(factor.l_dirty())
        };
        Some(WithoutJump { correction, solved, covariance: covariance.unwrap_or(solved), evidence })
    }

    /// Sums what the bands say of a jump at an instant.
    fn jump_sums(&self, instant_s: f64) -> JumpSums {
        let mut sums = JumpSums { instant_s, own: Matrix6::zeros(), shared: SMatrix::zeros(), score: Vector6::zeros() };
        for (k, band) in self.filled() {
            let jump = self.profile_of_jump(k, instant_s);
            if jump == [0.0, 0.0] {
                continue;
            }
            sums.own += band.product(jump, jump);
            for (power, profile) in self.profiles(k).into_iter().enumerate() {
                let mut block = sums.shared.fixed_view_mut::<6, 6>(6 * power, 0);
                block += band.product(jump, profile);
            }
            sums.score += band.score(jump);
        }
        sums
    }
}

impl Band {
    /// Information shared by two profiles.
    fn product(&self, [a, da]: Profile, [b, db]: Profile) -> Matrix6<f64> {
        let [once, timed, squared] = &self.by_pose;
        let entries: [f64; POSE_ENTRIES] = std::array::from_fn(|e| a * b * once[e] + (a * db + da * b) * timed[e] + da * db * squared[e]);
        Matrix6::from_fn(|i, j| entries[entry(i, j)])
    }

    /// The remaining right side that a profile would explain.
    fn score(&self, [a, da]: Profile) -> Vector6<f64> {
        Vector6::from(self.left[0]) * a + Vector6::from(self.left[1]) * da
    }
}

/// Returns the mean time since an instant over an exposure about `t`, seconds; times before the
/// instant count as 0.
fn mean_since(t: f64, instant_s: f64, exposure_s: f64) -> f64 {
    let (first, last) = (t - 0.5 * exposure_s - instant_s, t + 0.5 * exposure_s - instant_s);
    if last <= 0.0 {
        0.0
    } else if first >= 0.0 {
        0.5 * (first + last)
    } else {
        last * last / (2.0 * exposure_s)
    }
}

/// A motion that did not jump.
#[derive(Debug)]
struct WithoutJump {
    /// Correction of the solved motion.
    correction: MotionError,
    /// Covariance with the light taken as known.
    solved: MotionMatrix,
    /// Covariance of the motion; with the light free where that is known.
    covariance: MotionMatrix,
    /// Logarithm of the prior probability times the evidence of the frame.
    evidence: f64,
}

/// Normal equations of a jump at an instant, beside those of the motion.
#[derive(Debug)]
struct JumpSums {
    instant_s: f64,
    own: Matrix6<f64>,
    shared: SMatrix<f64, 18, 6>,
    score: Vector6<f64>,
}

/// The same equations with the motion eliminated.
#[derive(Debug)]
struct WithoutMotion {
    instant_s: f64,
    /// How much the estimated motion gives way per unit of jump, for the same frame.
    by_motion: SMatrix<f64, 18, 6>,
    information: Matrix6<f64>,
    pull: Vector6<f64>,
}

/// A jump of a given prior size at an instant: how well it explains the frame, and its estimate.
#[derive(Debug, Clone, Copy)]
struct Tried {
    /// Logarithm of the prior probability times the evidence, relative to no jump.
    evidence: f64,
    /// Whether the frame supports it at all. If not, the motion stays as certain as it is, and the
    /// next frame tests it again.
    is_seen: bool,
    jump: Vector6<f64>,
    covariance: Matrix6<f64>,
}

impl JumpSums {
    /// Eliminates the motion. The light is free as well, which is ignored: gains and a bent path
    /// hardly look alike.
    fn beside(&self, without: &WithoutJump) -> WithoutMotion {
        let by_motion = without.solved * self.shared;
        WithoutMotion {
            instant_s: self.instant_s,
            by_motion,
            information: self.own - self.shared.tr_mul(&by_motion),
            pull: self.score - self.shared.tr_mul(&without.correction),
        }
    }
}

impl WithoutMotion {
    /// Solves for the jump. `prior`: its information.
    fn tried(&self, prior: &Vector6<f64>, likelihood: f64) -> Option<Tried> {
        let factor = (self.information + Matrix6::from_diagonal(prior)).cholesky()?;
        let jump = factor.solve(&self.pull);
        let log_determinant = 2.0 * factor.l_dirty().diagonal().map(f64::ln).sum();
        let gain = 0.5 * (self.pull.dot(&jump) - log_determinant + prior.map(f64::ln).sum());
        Some(Tried { evidence: gain + likelihood.ln(), is_seen: gain > 0.0, jump, covariance: factor.inverse() })
    }

    /// Returns the derivative of the pose at the stamp by the jump.
    fn pose_by_jump(&self) -> Matrix6<f64> {
        // At the stamp, only an earlier jump has moved the camera.
        Matrix6::from_diagonal_element((-self.instant_s).max(0.0)) - self.by_motion.fixed_rows::<6>(0)
    }

    /// Returns the derivative of the motion after the frame by the jump.
    fn motion_by_jump(&self) -> SMatrix<f64, 18, 6> {
        let mut motion_by_jump = -self.by_motion;
        for k in 0..6 {
            motion_by_jump[(k, k)] -= self.instant_s;
            motion_by_jump[(k + 6, k)] += 1.0;
        }
        motion_by_jump
    }
}

/// Weighted sums over the members of a mixture, about the motion that did not jump.
#[derive(Debug)]
struct Members {
    /// Logarithm of the evidence that has weight 1: the largest so far, relative to no jump.
    largest: f64,
    weight: f64,
    pose: Vector6<f64>,
    pose_squares: Matrix6<f64>,
    motion: MotionError,
    motion_squares: MotionMatrix,
}

/// Moments of the jumps at an instant.
struct Moments {
    sum: Vector6<f64>,
    squares: Matrix6<f64>,
}

impl Moments {
    /// Sums of nothing.
    fn zero() -> Self {
        Self { sum: Vector6::zeros(), squares: Matrix6::zeros() }
    }

    fn add(&mut self, tried: &Tried, weight: f64) {
        self.sum += tried.jump * weight;
        self.squares += (tried.covariance + tried.jump * tried.jump.transpose()) * weight;
    }
}

impl Members {
    /// Starts with the motion that did not jump as the only member.
    fn none_jumped() -> Self {
        Self {
            largest: (1.0 - TUNING.jump_probability).ln(),
            weight: 1.0,
            pose: Vector6::zeros(),
            pose_squares: Matrix6::zeros(),
            motion: MotionError::zeros(),
            motion_squares: MotionMatrix::zeros(),
        }
    }

    /// Adds the jumps at an instant, one per size. Those less likely than `negligible_likelihood`,
    /// relative to the likeliest so far, are dropped.
    fn add(&mut self, at: &WithoutMotion, tried: &[Option<Tried>; JUMP_SIZES.len()]) {
        self.rescale(tried.iter().flatten().map(|t| t.evidence).fold(self.largest, f64::max));
        let (mut all, mut seen) = (Moments::zero(), None);
        for t in tried.iter().flatten() {
            let weight = (t.evidence - self.largest).exp();
            if weight <= TUNING.negligible_likelihood {
                continue;
            }
            self.weight += weight;
            all.add(t, weight);
            if t.is_seen {
                seen.get_or_insert_with(Moments::zero).add(t, weight);
            }
        }
        let pose_by_jump = at.pose_by_jump();
        self.pose += pose_by_jump * all.sum;
        self.pose_squares += pose_by_jump * all.squares * pose_by_jump.transpose();
        if let Some(seen) = seen {
            let motion_by_jump = at.motion_by_jump();
            self.motion += motion_by_jump * seen.sum;
            self.motion_squares += motion_by_jump * seen.squares * motion_by_jump.transpose();
        }
    }

    /// Makes `largest` the evidence that has weight 1.
    fn rescale(&mut self, largest: f64) {
        if largest == self.largest {
            return;
        }
        let factor = (self.largest - largest).exp();
        self.largest = largest;
        self.weight *= factor;
        self.pose *= factor;
        self.pose_squares *= factor;
        self.motion *= factor;
        self.motion_squares *= factor;
    }

    /// Returns mean and covariance of all members. Dropped members count as the mean of the others.
    fn part(&self, without: &WithoutJump) -> Part {
        let (pose, motion) = (self.pose / self.weight, self.motion / self.weight);
        Part {
            evidence: without.evidence + self.largest + self.weight.ln(),
            pose: without.correction.fixed_rows::<6>(0) + pose,
            pose_covariance: self.pose_squares / self.weight - pose * pose.transpose(),
            motion: without.correction + motion,
            motion_covariance: without.covariance + self.motion_squares / self.weight - motion * motion.transpose(),
        }
    }
}

/// One prior's result for the pose at the stamp and the motion after it, each with its covariance.
#[derive(Debug)]
struct Part {
    evidence: f64,
    pose: Vector6<f64>,
    pose_covariance: Matrix6<f64>,
    motion: MotionError,
    motion_covariance: MotionMatrix,
}

/// Returns mean and covariance of the mixture of all priors.
fn mix(parts: &[Option<Part>; MAX_PRIORS]) -> Option<Mixture> {
    let parts = || parts.iter().flatten();
    let largest = parts().map(|part| part.evidence).fold(f64::NEG_INFINITY, f64::max);
    let total: f64 = parts().map(|part| (part.evidence - largest).exp()).sum();
    let weighted = || parts().map(|part| ((part.evidence - largest).exp() / total, part));
    let pose: Vector6<f64> = weighted().map(|(weight, part)| part.pose * weight).sum();
    let motion: MotionError = weighted().map(|(weight, part)| part.motion * weight).sum();
    let (mut pose_covariance, mut motion_covariance) = (Matrix6::zeros(), MotionMatrix::zeros());
    for (weight, part) in weighted() {
        let (pose_off, motion_off) = (part.pose - pose, part.motion - motion);
        pose_covariance += (part.pose_covariance + pose_off * pose_off.transpose()) * weight;
        motion_covariance += (part.motion_covariance + motion_off * motion_off.transpose()) * weight;
    }
    let is_finite = motion.iter().chain(motion_covariance.iter()).chain(pose_covariance.iter()).all(|v| v.is_finite());
    (is_finite && total > 0.0).then_some(Mixture { pose, pose_covariance, motion, motion_covariance })
}

#[cfg(test)]
#[path = "jump_instant_tests.rs"]
mod tests;
