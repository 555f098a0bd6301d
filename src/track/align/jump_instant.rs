//! When the velocity jumped, and by how much: several instants are tried beside none, and their mixture is the answer.
//!
//! A camera that starts or stops while a frame is exposed and read bends the path of the picture: rows exposed after the jump are
//! shifted by it, those before are not. Pose, velocity and acceleration cannot follow that bend, and where the jump is small
//! the pose is off by a tenth of a pixel at a small Mahalanobis distance. The residuals that a step leaves still ask for the jump: for every instant
//! it has a score and, the motion being eliminated (the Schur complement), an information, and so an evidence. The mixture over expectations,
//! instants, sizes and no jump gives the pose at the stamp, the motion after the frame, and their covariances
//! (Bar-Shalom, Li and Kirubarajan 2001, section 11.6).

use nalgebra::{Matrix6, SMatrix, Vector6};

use super::columns::{POSE_ENTRIES, entry};
use super::tile_equations::{TileEquations, TileScore};
use crate::camera::Shutter;
use crate::motion::{MotionError, MotionMatrix, unseen};

/// Bands of rows that tiles are gathered in: about as many as a frame has rows of tiles. Raised, nearby instants differ no more than
/// before; lowered, the instants of `WITHIN` fall into the same band.
const BANDS: usize = 12;
/// Instants that are tried while the frame is exposed and read, and between the last frame and this one, where a jump looks like another
/// velocity. Chosen: fewer than `BANDS`, which cannot tell more apart. Raised, the cost of a frame grows.
const WITHIN: usize = 9;
const BEFORE: usize = 3;
/// How large a jump may be, one sigma, as shares of the velocity that is usual: a single large one would hold small jumps for unlikely.
/// Chosen, not tuned. The smaller one raised, small starts are taken for noise again; more sizes cost more.
const SIZES: [f64; 2] = [1.0, 0.25];
/// How likely a jump is in the time of a frame: one in ten seconds at 30 frames a second. Raised, the covariance of every frame grows: with
/// 0.1, that of a still camera by half, and of 625 frames near starts and stops 12 instead of 16 are further off than six sigmas.
const LIKELIHOOD: f64 = 0.003;
/// Expectations that are mixed at most: with jerk, and with the even motion before.
pub const EXPECTATIONS: usize = 2;
/// Jumps that are tried: every size at every instant.
const JUMPS: usize = (WITHIN + BEFORE) * SIZES.len();
/// Members of the mixture less likely than this, beside the likeliest, are left out. A round figure far below `LIKELIHOOD`. Raised, jumps
/// that the covariance should allow for are dropped; lowered, frames cost more and nothing changes.
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
    shutter: Shutter,
}

/// Value and slope in time of a factor of the pose, at the middle of a band.
type Profile = [f64; 2];

/// A motion that may be expected.
#[derive(Debug, Clone, Copy)]
pub struct Expectation {
    /// Its information.
    pub information: MotionMatrix,
    /// From the solved motion to it.
    pub error: MotionError,
    /// How likely it is beforehand, where there is another.
    pub likelihood: f64,
    /// Covariance of the motion that was solved with it and without a jump; `None` where that was solved with another.
    pub covariance: Option<MotionMatrix>,
}

/// What the mixture makes of a solved motion.
#[derive(Debug, Clone, Copy)]
pub struct Mixture {
    /// Correction of the pose at the stamp.
    pub pose: Vector6<f64>,
    /// To be added to its covariance.
    pub pose_covariance: Matrix6<f64>,
    /// Correction of the motion after the frame, carried back to the stamp.
    pub motion: MotionError,
    /// Its covariance.
    pub motion_covariance: MotionMatrix,
}

impl RowBands {
    /// No tiles yet.
    pub fn new(shutter: Shutter) -> Self {
        let band = Band { by_pose: [[0.0; POSE_ENTRIES]; 3], left: [[0.0; 6]; 2], is_empty: true };
        Self { bands: [band; BANDS], shutter }
    }

    /// Adds a tile whose middle is exposed `delay_s` after the stamp. `left`: what the step leaves of its equations; `weight`: inverse of
    /// the residuals' variance beyond what their whitener says.
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

    /// The mixture over all expectations, and for each over all instants and none. `dt_s`: since the last frame. `None` where something is
    /// singular.
    pub fn mixture(&self, expectations: [Option<Expectation>; EXPECTATIONS], dt_s: f64, distance_m: f64) -> Option<Mixture> {
        let is_alone = expectations.iter().flatten().count() < 2;
        let part = |expected: Expectation| {
            let without = self.without_jump(&expected, is_alone)?;
            let jumps = self.jumps(&without, dt_s, distance_m);
            Some(Part { without, jumps })
        };
        mix(&expectations.map(|expected| expected.and_then(part)))
    }

    /// What the bands say of jumps at all instants, of all sizes.
    fn jumps(&self, without: &WithoutJump, dt_s: f64, distance_m: f64) -> [Option<Tried>; JUMPS] {
        let half_s = 0.5 * (self.shutter.readout_s.abs() + self.shutter.exposure_s);
        // From the last stamp on: what came later in that frame may not have shown in it.
        let gap_s = (dt_s - half_s).max(0.0);
        let whole_s = (2.0 * half_s + gap_s).max(f64::MIN_POSITIVE);
        let [speed, turn_rate, ..] = unseen(distance_m);
        let usual = Vector6::new(speed, speed, speed, turn_rate, turn_rate, turn_rate);
        let mut tried = [None; JUMPS];
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
                *slot = sums.tried(without, &usual.map(|sigma| (size * sigma).powi(-2)), likelihood);
            }
        }
        tried
    }

    /// Middle of a band, seconds from the stamp.
    fn middle_s(&self, band: usize) -> f64 {
        self.shutter.readout_s * ((band as f64 + 0.5) / BANDS as f64 - 0.5)
    }

    /// The bands that have tiles, with their places.
    fn filled(&self) -> impl Iterator<Item = (usize, &Band)> {
        self.bands.iter().enumerate().filter(|(_, band)| !band.is_empty)
    }

    /// How position, velocity and acceleration change the pose of a band.
    fn profiles(&self, band: usize) -> [Profile; 3] {
        let t = self.middle_s(band);
        [[1.0, 0.0], [t, 1.0], [0.5 * (t * t + self.shutter.exposure_s.powi(2) / 12.0), t]]
    }

    /// How a jump changes the pose of a band.
    fn profile_of_jump(&self, band: usize, instant_s: f64) -> Profile {
        let (t, exposure_s) = (self.middle_s(band), self.shutter.exposure_s);
        let quarter_s = 0.25 * self.shutter.readout_s / BANDS as f64;
        let at = |t: f64| mean_since(t, instant_s, exposure_s);
        let slope = if quarter_s == 0.0 { 0.0 } else { (at(t + quarter_s) - at(t - quarter_s)) / (2.0 * quarter_s) };
        [at(t), slope]
    }

    /// The motion where it did not jump, as expected and as the bands show it. `is_alone`: there is no other to weigh it against.
    fn without_jump(&self, expected: &Expectation, is_alone: bool) -> Option<WithoutJump> {
        let Expectation { information: known, error, likelihood, covariance } = expected;
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

    /// What the bands say of a jump at an instant.
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
    /// Information that two profiles share.
    fn product(&self, [a, da]: Profile, [b, db]: Profile) -> Matrix6<f64> {
        let [once, timed, squared] = &self.by_pose;
        let entries: [f64; POSE_ENTRIES] = std::array::from_fn(|e| a * b * once[e] + (a * db + da * b) * timed[e] + da * db * squared[e]);
        Matrix6::from_fn(|i, j| entries[entry(i, j)])
    }

    /// What is left that a profile would explain.
    fn score(&self, [a, da]: Profile) -> Vector6<f64> {
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
    /// Covariance where the light is known.
    solved: MotionMatrix,
    /// Covariance of the motion.
    covariance: MotionMatrix,
    /// Logarithm of likelihood times evidence of the frame.
    evidence: f64,
}

/// An expectation and the jumps from it.
#[derive(Debug)]
struct Part {
    without: WithoutJump,
    jumps: [Option<Tried>; JUMPS],
}

/// Normal equations of a jump at an instant, beside those of the motion.
#[derive(Debug)]
struct JumpSums {
    instant_s: f64,
    own: Matrix6<f64>,
    shared: SMatrix<f64, 18, 6>,
    score: Vector6<f64>,
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
        let by_motion = without.solved * self.shared;
        let pull = self.score - self.shared.transpose() * without.correction;
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

/// One member of a mixture: what it makes of the pose at the stamp and of the motion after it, each with its covariance.
struct Member {
    evidence: f64,
    pose: Vector6<f64>,
    pose_covariance: Matrix6<f64>,
    motion: MotionError,
    motion_covariance: MotionMatrix,
}

impl Part {
    /// Logarithms of likelihood times evidence: without a jump, then of every jump.
    fn evidences(&self) -> impl Iterator<Item = f64> {
        let none = self.without.evidence + (1.0 - LIKELIHOOD).ln();
        std::iter::once(none).chain(self.jumps.iter().flatten().map(|t| self.without.evidence + t.evidence))
    }

    /// All members more likely than [`NEGLIGIBLE`] beside the largest.
    fn members(&self, largest: f64) -> impl Iterator<Item = Member> {
        let WithoutJump { correction, covariance, .. } = &self.without;
        let own: Vector6<f64> = correction.fixed_rows::<6>(0).into_owned();
        let all = std::iter::once(None).chain(self.jumps.iter().map(Option::as_ref).filter(Option::is_some));
        self.evidences().zip(all).filter(move |(evidence, _)| (evidence - largest).exp() > NEGLIGIBLE).map(move |(evidence, jump)| {
            let mut member =
                Member { evidence, pose: own, pose_covariance: Matrix6::zeros(), motion: *correction, motion_covariance: *covariance };
            if let Some(t) = jump {
                member.pose += t.pose_by_jump * t.jump;
                member.pose_covariance = t.pose_by_jump * t.covariance * t.pose_by_jump.transpose();
                if t.is_seen {
                    member.motion += t.motion_by_jump * t.jump;
                    member.motion_covariance += t.motion_by_jump * t.covariance * t.motion_by_jump.transpose();
                }
            }
            member
        })
    }
}

/// Mean and covariance of the mixture of all expectations, with their jumps and without.
fn mix(parts: &[Option<Part>; EXPECTATIONS]) -> Option<Mixture> {
    let evidences = || parts.iter().flatten().flat_map(Part::evidences);
    let largest = evidences().fold(f64::NEG_INFINITY, f64::max);
    let total: f64 = evidences().map(|e| (e - largest).exp()).sum();
    let (mut pose, mut pose_squares) = (Vector6::zeros(), Matrix6::zeros());
    let (mut motion, mut motion_squares) = (MotionError::zeros(), MotionMatrix::zeros());
    let mut weights = 0.0;
    for member in parts.iter().flatten().flat_map(|part| part.members(largest)) {
        let weight = (member.evidence - largest).exp() / total;
        weights += weight;
        pose += member.pose * weight;
        pose_squares += (member.pose_covariance + member.pose * member.pose.transpose()) * weight;
        motion += member.motion * weight;
        motion_squares += (member.motion_covariance + member.motion * member.motion.transpose()) * weight;
    }
    // The negligible ones are as the mean of the others.
    let (pose, pose_squares, motion, motion_squares) = (pose / weights, pose_squares / weights, motion / weights, motion_squares / weights);
    let mixture = Mixture {
        pose,
        pose_covariance: pose_squares - pose * pose.transpose(),
        motion,
        motion_covariance: motion_squares - motion * motion.transpose(),
    };
    let Mixture { motion, motion_covariance, pose_covariance, .. } = &mixture;
    let is_finite = motion.iter().chain(motion_covariance.iter()).chain(pose_covariance.iter()).all(|v| v.is_finite());
    is_finite.then_some(mixture)
}

#[cfg(test)]
#[path = "jump_instant_tests.rs"]
mod tests;
