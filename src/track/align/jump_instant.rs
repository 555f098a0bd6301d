//! When the velocity jumped, and by how much: several instants are tried beside none, and their mixture is the answer.
//!
//! A camera that starts or stops while a frame is exposed and read bends the path of the picture: rows exposed after the jump are
//! shifted by it, those before are not. Pose, velocity and acceleration cannot follow that bend, and where the jump is small
//! the pose is off by a tenth of a pixel without surprising. The residuals that a step leaves still ask for the jump: for every instant
//! it has a score and, the motion being eliminated (the Schur complement), an information, and so an evidence. The mixture over
//! instants, sizes and no jump gives the pose at the stamp, the motion after the frame, and their covariances
//! (Bar-Shalom, Li and Kirubarajan 2001, section 11.6).

use nalgebra::{Matrix6, SMatrix, Vector6};

use super::Sensor;
use super::motion::{MotionError, MotionMatrix, unseen};
use super::normal::POSE_ENTRIES;
use super::tile_equations::{TileEquations, TileScore, entry};

/// Bands of rows that tiles are gathered in: about as many as a frame has rows of tiles. More would tell instants no better apart.
const BANDS: usize = 12;
/// Instants that are tried while the frame is exposed and read, and between the last frame and this one, where a jump looks like
/// another velocity. Raised, the cost of a frame grows.
const WITHIN: usize = 9;
const BEFORE: usize = 3;
/// How large a jump may be, one sigma, as shares of the velocity that is usual: a single large one would hold small jumps for unlikely.
const SIZES: [f64; 2] = [1.0, 0.25];
/// How likely a jump is in the time of a frame: one in ten seconds at 30 frames a second. Raised, the covariance of every frame grows: with
/// 0.1, that of a still camera by half, and of 625 frames near starts and stops 12 instead of 16 are further off than six sigmas.
const LIKELIHOOD: f64 = 0.003;
/// A jump less likely than this changes nothing.
const NEGLIGIBLE: f64 = 1e-6;

/// What the tiles of a band of rows say of the pose, and what of it the step left, by powers of the time from the band's middle.
#[derive(Debug, Clone, Copy)]
struct Band {
    by_pose: [[f64; POSE_ENTRIES]; 3],
    left: [[f64; 6]; 2],
    is_empty: bool,
}

/// The tiles of a frame by the time of their rows.
#[derive(Debug)]
pub struct RowBands {
    bands: [Band; BANDS],
    sensor: Sensor,
}

/// Value and slope in time of a factor of the pose, at the middle of a band.
type Profile = [f64; 2];

/// What the mixture makes of a solved motion.
#[derive(Debug, Clone, Copy)]
pub struct Mixture {
    /// Correction of the pose at the stamp.
    pub pose: Vector6<f64>,
    /// To be added to its covariance.
    pub pose_covariance: Matrix6<f64>,
    /// Correction of the motion after the frame, carried back to the stamp.
    pub motion: MotionError,
    /// To be added to its covariance.
    pub motion_covariance: MotionMatrix,
    /// Covariance of the motion without a jump, where the light is known.
    pub without_jump: MotionMatrix,
}

impl RowBands {
    /// No tiles yet.
    pub fn new(sensor: Sensor) -> Self {
        let band = Band { by_pose: [[0.0; POSE_ENTRIES]; 3], left: [[0.0; 6]; 2], is_empty: true };
        Self { bands: [band; BANDS], sensor }
    }

    /// Adds a tile whose middle is exposed `delay_s` after the stamp. `left`: what the step leaves of its equations; `weight`: inverse of
    /// the residuals' variance beyond what their whitener says.
    pub fn add(&mut self, tile: &TileEquations, left: &TileScore, delay_s: f64, weight: f64) {
        let readout_s = self.sensor.readout_s;
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

    /// The mixture over all instants and none. `known`: information of the expected motion; `error`: from the solved motion to it; `dt_s`:
    /// since the last frame. `None` where something is singular.
    pub fn mixture(&self, known: &MotionMatrix, error: &MotionError, dt_s: f64, distance_m: f64) -> Option<Mixture> {
        let without = self.without_jump(known, error)?;
        let half_s = 0.5 * (self.sensor.readout_s.abs() + self.sensor.exposure_s);
        // From the last stamp on: what came later in that frame may not have shown in it.
        let gap_s = (dt_s - half_s).max(0.0);
        let whole_s = (2.0 * half_s + gap_s).max(f64::MIN_POSITIVE);
        let [speed, turn_rate, ..] = unseen(distance_m);
        let usual = Vector6::new(speed, speed, speed, turn_rate, turn_rate, turn_rate);
        let mut tried = [None; (WITHIN + BEFORE) * SIZES.len()];
        for (k, of_instant) in tried.chunks_exact_mut(SIZES.len()).enumerate() {
            let (from_s, lasts_s, part, parts) =
                if k < WITHIN { (-half_s, 2.0 * half_s, k, WITHIN) } else { (-half_s - gap_s, gap_s, k - WITHIN, BEFORE) };
            if lasts_s <= 0.0 {
                continue;
            }
            let instant_s = from_s + lasts_s * (part as f64 + 0.5) / parts as f64;
            let likelihood = LIKELIHOOD * lasts_s / (whole_s * parts as f64 * SIZES.len() as f64);
            let sums = self.jump_sums(instant_s);
            for (slot, size) in of_instant.iter_mut().zip(SIZES) {
                *slot = sums.tried(&without, &usual.map(|sigma| (size * sigma).powi(-2)), likelihood);
            }
        }
        mix(&tried, &without)
    }

    /// Middle of a band, seconds from the stamp.
    fn middle_s(&self, band: usize) -> f64 {
        self.sensor.readout_s * ((band as f64 + 0.5) / BANDS as f64 - 0.5)
    }

    /// The bands that have tiles, with their places.
    fn filled(&self) -> impl Iterator<Item = (usize, &Band)> {
        self.bands.iter().enumerate().filter(|(_, band)| !band.is_empty)
    }

    /// How position, velocity and acceleration change the pose of a band.
    fn profiles(&self, band: usize) -> [Profile; 3] {
        let t = self.middle_s(band);
        [[1.0, 0.0], [t, 1.0], [0.5 * (t * t + self.sensor.exposure_s.powi(2) / 12.0), t]]
    }

    /// How a jump changes the pose of a band.
    fn profile_of_jump(&self, band: usize, instant_s: f64) -> Profile {
        let (t, exposure_s) = (self.middle_s(band), self.sensor.exposure_s);
        let quarter_s = 0.25 * self.sensor.readout_s / BANDS as f64;
        let at = |t: f64| mean_since(t, instant_s, exposure_s);
        let slope = if quarter_s == 0.0 { 0.0 } else { (at(t + quarter_s) - at(t - quarter_s)) / (2.0 * quarter_s) };
        [at(t), slope]
    }

    /// The motion where it did not jump, as expected and as the bands show it.
    fn without_jump(&self, known: &MotionMatrix, error: &MotionError) -> Option<WithoutJump> {
        let (mut information, mut pull) = (*known, known * error);
        for (k, band) in self.filled() {
            let profiles = self.profiles(k);
            for (a, of_a) in profiles.iter().enumerate() {
                let mut part = pull.fixed_rows_mut::<6>(6 * a);
                part += band.pull(*of_a);
                for (b, of_b) in profiles.iter().enumerate() {
                    let mut block = information.fixed_view_mut::<6, 6>(6 * a, 6 * b);
                    block += band.product(*of_a, *of_b);
                }
            }
        }
        let covariance = information.cholesky()?.inverse();
        Some(WithoutJump { correction: covariance * pull, covariance })
    }

    /// What the bands say of a jump at an instant.
    fn jump_sums(&self, instant_s: f64) -> JumpSums {
        let mut sums = JumpSums { instant_s, own: Matrix6::zeros(), shared: SMatrix::zeros(), pull: Vector6::zeros() };
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
            sums.pull += band.pull(jump);
        }
        sums
    }
}

impl Band {
    /// Information that two profiles share.
    fn product(&self, [a, da]: Profile, [b, db]: Profile) -> Matrix6<f64> {
        let [once, timed, squared] = &self.by_pose;
        let entries: [f64; POSE_ENTRIES] = std::array::from_fn(|e| a * b * once[e] + (a * db + da * b) * timed[e] + da * db * squared[e]);
        Matrix6::from_fn(|i, j| entries[entry(i, j)])
    }

    /// What is left that a profile would explain.
    fn pull(&self, [a, da]: Profile) -> Vector6<f64> {
        Vector6::from(self.left[0]) * a + Vector6::from(self.left[1]) * da
    }
}

/// Mean time since an instant over an exposure about `t`, none before it: seconds.
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
    /// Of the solved motion.
    correction: MotionError,
    covariance: MotionMatrix,
}

/// Normal equations of a jump at an instant, beside those of the motion.
#[derive(Debug)]
struct JumpSums {
    instant_s: f64,
    own: Matrix6<f64>,
    shared: SMatrix<f64, 18, 6>,
    pull: Vector6<f64>,
}

/// A jump at an instant: how well it explains the frame, and what it comes to.
#[derive(Debug, Clone, Copy)]
struct Tried {
    /// Logarithm of likelihood times evidence, against none.
    evidence: f64,
    /// Whether the frame speaks for it at all. Otherwise the next frame is asked about it again, and the motion stays as sure as it is.
    is_seen: bool,
    jump: Vector6<f64>,
    covariance: Matrix6<f64>,
    /// Of the pose at the stamp, and of the motion after the frame, by the jump.
    pose_by_jump: Matrix6<f64>,
    motion_by_jump: SMatrix<f64, 18, 6>,
}

impl JumpSums {
    /// Solves for the jump, of which `prior` is the information. That the light is free as well is left out: gains and a bend of the path
    /// hardly look alike.
    fn tried(&self, without: &WithoutJump, prior: &Vector6<f64>, likelihood: f64) -> Option<Tried> {
        let by_motion = without.covariance * self.shared;
        let pull = self.pull - self.shared.transpose() * without.correction;
        let information = self.own + Matrix6::from_diagonal(prior) - self.shared.transpose() * by_motion;
        let factor = information.cholesky()?;
        let jump = factor.solve(&pull);
        let log_determinant = 2.0 * factor.l_dirty().diagonal().map(f64::ln).sum();
        let gain = 0.5 * (pull.dot(&jump) - log_determinant + prior.map(f64::ln).sum());
        let mut motion_by_jump = -by_motion;
        let mut pose_by_jump: Matrix6<f64> = motion_by_jump.fixed_view::<6, 6>(0, 0).into_owned();
        for k in 0..6 {
            // At the stamp, only a jump before it has moved the camera.
            pose_by_jump[(k, k)] += (-self.instant_s).max(0.0);
            motion_by_jump[(k, k)] -= self.instant_s;
            motion_by_jump[(k + 6, k)] += 1.0;
        }
        Some(Tried {
            evidence: gain + likelihood.ln(),
            is_seen: gain > 0.0,
            jump,
            covariance: factor.inverse(),
            pose_by_jump,
            motion_by_jump,
        })
    }
}

/// Mean and covariance of the mixture of all that was tried, and none.
fn mix(tried: &[Option<Tried>], without: &WithoutJump) -> Option<Mixture> {
    let none = (1.0 - LIKELIHOOD).ln();
    let largest = tried.iter().flatten().map(|t| t.evidence).fold(none, f64::max);
    let total = (none - largest).exp() + tried.iter().flatten().map(|t| (t.evidence - largest).exp()).sum::<f64>();
    let (mut pose, mut pose_squares) = (Vector6::zeros(), Matrix6::zeros());
    let (mut motion, mut motion_squares) = (MotionError::zeros(), MotionMatrix::zeros());
    for t in tried.iter().flatten() {
        let weight = (t.evidence - largest).exp() / total;
        if weight < NEGLIGIBLE {
            continue;
        }
        let squares = (t.covariance + t.jump * t.jump.transpose()) * weight;
        pose += t.pose_by_jump * t.jump * weight;
        pose_squares += t.pose_by_jump * squares * t.pose_by_jump.transpose();
        if !t.is_seen {
            continue;
        }
        motion += t.motion_by_jump * t.jump * weight;
        motion_squares += t.motion_by_jump * squares * t.motion_by_jump.transpose();
    }
    let mixture = Mixture {
        pose: without.correction.fixed_rows::<6>(0) + pose,
        pose_covariance: pose_squares - pose * pose.transpose(),
        motion: without.correction + motion,
        motion_covariance: motion_squares - motion * motion.transpose(),
        without_jump: without.covariance,
    };
    let Mixture { motion, motion_covariance, pose_covariance, .. } = &mixture;
    let is_finite = motion.iter().chain(motion_covariance.iter()).chain(pose_covariance.iter()).all(|v| v.is_finite());
    is_finite.then_some(mixture)
}

#[cfg(test)]
#[path = "jump_instant_tests.rs"]
mod tests;
