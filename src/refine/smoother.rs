//! A Kalman filter with white jerk over a stretch of rows, and the pass backwards.

use nalgebra::{Matrix6, SMatrix};

use crate::geometry::{Body, Camera, Pose};
use crate::motion::{Motion, MotionEstimate, MotionMatrix, ProcessNoise, unseen};

/// Distance for which the prior of an unobserved velocity is taken, metres. Raised, starts and
/// stops of a camera are followed faster and averaged less.
const DISTANCE_M: f64 = 4.0;
/// Prior probability that the velocity jumps from one row to the next (a start, stop or push).
/// Raised, more rows are taken for jumps, and noise averages less.
const JUMP_PROBABILITY: f64 = 0.003;
/// Ratio of successive jerk densities that are tried. Lowered, takes are read more often; raised,
/// the density is coarser than what a minute of a take tells.
const DENSITY_STEP: f64 = 3.0;
/// Limits of the jerk's densities, as factors of the usual ones. Wider, densities may leave the
/// range of doubles in covariances.
const DENSITY_FACTORS: [f64; 2] = [1e-5, 1e4];

/// A row of a stretch: its time in seconds, and what was measured in it.
#[derive(Debug, Clone, Copy)]
pub struct Sighting {
    /// Its time, seconds from any origin.
    pub at_s: f64,
    /// The measured pose, with the covariance of [δp, δθ] by noise: p_true = p + δp, R_true =
    /// Exp(δθ) R, in stage axes.
    pub seen: Option<(Pose<Body, Camera>, Matrix6<f64>)>,
}

/// A smoothed pose, with its covariance as in [`Sighting::seen`].
pub type Smoothed = (Pose<Body, Camera>, Matrix6<f64>);

/// The jerk's densities, as factors of the usual ones: shift, rotation.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Densities([f64; 2]);

/// A row after the pass forward.
struct Filtered {
    estimate: MotionEstimate,
    /// Whether the velocity jumped right after the row before.
    has_jumped: bool,
}

/// Smooths a stretch whose first and last rows are seen. `None` if it is empty or a covariance is
/// singular.
pub fn smooth(rows: &[Sighting]) -> Option<Vec<Smoothed>> {
    let densities = likeliest(rows)?;
    let (filtered, _) = filter(rows, densities)?;
    let mut later = filtered.last()?.estimate;
    let mut smoothed = vec![of_pose(&later)];
    for k in (0..filtered.len() - 1).rev() {
        let dt_s = rows[k + 1].at_s - rows[k].at_s;
        later = corrected_by_later(&filtered[k].estimate, &later, dt_s, filtered[k + 1].has_jumped, densities)?;
        smoothed.push(of_pose(&later));
    }
    smoothed.reverse();
    Some(smoothed)
}

/// Returns the densities with which the rows are likeliest, by coordinate ascent from the usual
/// ones.
fn likeliest(rows: &[Sighting]) -> Option<Densities> {
    let mut best = Densities([1.0; 2]);
    let (_, mut likelihood) = filter(rows, best)?;
    loop {
        let before = best;
        for axis in 0..2 {
            for factor in [DENSITY_STEP, DENSITY_STEP.recip()] {
                loop {
                    let mut tried = best;
                    tried.0[axis] = (tried.0[axis] * factor).clamp(DENSITY_FACTORS[0], DENSITY_FACTORS[1]);
                    match filter(rows, tried) {
                        Some((_, of_tried)) if of_tried > likelihood => (best, likelihood) = (tried, of_tried),
                        _ => break,
                    }
                }
            }
        }
        if best == before {
            return Some(best);
        }
    }
}

/// Runs the filter over a stretch; also returns the logarithm of the rows' likelihood.
fn filter(rows: &[Sighting], densities: Densities) -> Option<(Vec<Filtered>, f64)> {
    let (first, rest) = rows.split_first()?;
    let (pose, noise) = first.seen?;
    let mut estimate = MotionEstimate::unseen(pose, DISTANCE_M, 0.0, 0.0);
    estimate.covariance.fixed_view_mut::<6, 6>(0, 0).copy_from(&in_camera_axes(&pose, &noise));
    let (mut filtered, mut before_s, mut log_likelihood) = (vec![Filtered { estimate, has_jumped: false }], first.at_s, 0.0);
    for row in rest {
        let dt_s = row.at_s - std::mem::replace(&mut before_s, row.at_s);
        let predicted = predict(&estimate, dt_s, false, densities);
        let Some((pose, noise)) = &row.seen else {
            estimate = predicted;
            filtered.push(Filtered { estimate, has_jumped: false });
            continue;
        };
        let (updated, likelihood) = update(&predicted, pose, noise)?;
        let (by_jump, likelihood_of_jump) = update(&predict(&estimate, dt_s, true, densities), pose, noise)?;
        let [without, with] = [likelihood + (1.0 - JUMP_PROBABILITY).ln(), likelihood_of_jump + JUMP_PROBABILITY.ln()];
        let has_jumped = with > without;
        log_likelihood += without.max(with);
        estimate = if has_jumped { by_jump } else { updated };
        filtered.push(Filtered { estimate, has_jumped });
    }
    log_likelihood.is_finite().then_some((filtered, log_likelihood))
}

/// Predicts an estimate `dt_s` ahead. `has_jumped`: its velocity jumped at the beginning.
fn predict(estimate: &MotionEstimate, dt_s: f64, has_jumped: bool, Densities([shift, rotation]): Densities) -> MotionEstimate {
    let mut start = *estimate;
    if has_jumped {
        let [speed, angular_velocity, ..] = unseen(DISTANCE_M);
        for k in 0..3 {
            start.covariance[(6 + k, 6 + k)] += speed * speed;
            start.covariance[(9 + k, 9 + k)] += angular_velocity * angular_velocity;
        }
    }
    start.after(dt_s, DISTANCE_M, &ProcessNoise::with_factors(shift, rotation))
}

/// Updates a prediction by a measured pose; also returns the logarithm of its likelihood, up to a
/// constant.
fn update(predicted: &MotionEstimate, pose: &Pose<Body, Camera>, noise: &Matrix6<f64>) -> Option<(MotionEstimate, f64)> {
    let innovation = predicted.motion.pose_error_to(&Motion::still(*pose));
    let of_pose = predicted.covariance.fixed_columns::<6>(0).into_owned();
    let expected = of_pose.fixed_rows::<6>(0) + in_camera_axes(pose, noise);
    let expected = expected.cholesky()?;
    let gain = expected.solve(&of_pose.transpose()).transpose();
    let covariance = predicted.covariance - gain * of_pose.transpose();
    let log_root = expected.l().diagonal().iter().map(|pivot| pivot.ln()).sum::<f64>();
    let log_likelihood = -0.5 * innovation.dot(&expected.solve(&innovation)) - log_root;
    let updated = MotionEstimate {
        motion: predicted.motion.corrected(&(gain * innovation)),
        covariance: (covariance + covariance.transpose()) * 0.5,
    };
    Some((updated, log_likelihood))
}

/// Returns a filtered estimate corrected by the smoothed one of the next row (Rauch, Tung and
/// Striebel 1965).
fn corrected_by_later(
    filtered: &MotionEstimate,
    later: &MotionEstimate,
    dt_s: f64,
    has_jumped: bool,
    densities: Densities,
) -> Option<MotionEstimate> {
    let predicted = predict(filtered, dt_s, has_jumped, densities);
    let step = filtered.transition(dt_s);
    // Scaled to a unit diagonal: variances of poses and of accelerations differ by 1e12.
    let scale = MotionMatrix::from_diagonal(&predicted.covariance.diagonal().map(|variance| variance.sqrt().recip()));
    let scaled = (scale * predicted.covariance * scale).cholesky()?;
    let gain: SMatrix<f64, 18, 18> = (scale * scaled.solve(&(scale * step * filtered.covariance))).transpose();
    let covariance = filtered.covariance + gain * (later.covariance - predicted.covariance) * gain.transpose();
    let motion = filtered.motion.corrected(&(gain * predicted.motion.error_to(&later.motion)));
    motion.is_finite().then_some(MotionEstimate { motion, covariance: (covariance + covariance.transpose()) * 0.5 })
}

/// Returns a pose's covariance with the rotation's error in the axes of the camera, where it is in
/// those of the stage.
fn in_camera_axes(pose: &Pose<Body, Camera>, covariance: &Matrix6<f64>) -> Matrix6<f64> {
    let mut turn = Matrix6::identity();
    turn.fixed_view_mut::<3, 3>(3, 3).copy_from(&pose.rotation_matrix().transpose());
    turn * covariance * turn.transpose()
}

/// Returns the pose of an estimate, with its covariance in stage axes.
fn of_pose(estimate: &MotionEstimate) -> Smoothed {
    let pose = estimate.motion.pose;
    let mut turn = Matrix6::identity();
    turn.fixed_view_mut::<3, 3>(3, 3).copy_from(&pose.rotation_matrix());
    (pose, turn * estimate.covariance.fixed_view::<6, 6>(0, 0) * turn.transpose())
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3, Vector6};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    const FPS: f64 = 30.0;
    const ROWS: usize = 240;

    fn noise() -> Matrix6<f64> {
        Matrix6::from_diagonal(&Vector6::new(1e-4, 2e-4, 3e-4, 1e-5, 1e-4, 5e-5).map(|sigma: f64| sigma * sigma))
    }

    /// A camera that sways while it turns.
    fn sway(t: f64) -> Pose<Body, Camera> {
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.1 * (1.3 * t).sin(), 0.4 * t, 0.05 * (2.1 * t).cos()));
        Pose::new(rotation, Vector3::new((1.7 * t).sin(), -3.0 + 0.2 * t, 0.3 * (0.9 * t).cos()))
    }

    /// A camera that rests, turns and moves at a constant rate from 3 s to 4 s, and rests again.
    fn whip(t: f64) -> Pose<Body, Camera> {
        let along = (t - 3.0).clamp(0.0, 1.0);
        Pose::new(UnitQuaternion::from_scaled_axis(Vector3::y() * along), Vector3::new(0.5 * along, -3.0, 0.0))
    }

    fn error(found: &Pose<Body, Camera>, truth: &Pose<Body, Camera>) -> Vector6<f64> {
        let (shift, rotation) = (truth.translation - found.translation, (truth.rotation * found.rotation.inverse()).scaled_axis());
        Vector6::from_iterator(shift.iter().chain(rotation.iter()).copied())
    }

    /// Measures a path with this noise; rows in `hidden` show nothing.
    fn measured(path: impl Fn(f64) -> Pose<Body, Camera>, hidden: std::ops::Range<usize>, seed: u64) -> Vec<Sighting> {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut normal = move || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let root = noise().cholesky().expect("positive").l();
        let row = |k: usize| {
            let (at_s, truth) = (k as f64 / FPS, path(k as f64 / FPS));
            let off = root * Vector6::from_fn(|_, _| normal());
            let rotation = UnitQuaternion::from_scaled_axis(off.fixed_rows::<3>(3).into_owned()) * truth.rotation;
            let pose = Pose::new(rotation, truth.translation + off.fixed_rows::<3>(0));
            Sighting { at_s, seen: (!hidden.contains(&k)).then_some((pose, noise())) }
        };
        (0..ROWS).map(row).collect()
    }

    /// Returns the ratio of the smoothed errors to the measured ones (RMS of the shift), and the
    /// mean squared error in sigmas per degree of freedom.
    fn scores(path: impl Fn(f64) -> Pose<Body, Camera> + Copy) -> [f64; 2] {
        let (mut before, mut after, mut squared, mut n) = (0.0, 0.0, 0.0, 0.0);
        for seed in 0..4 {
            let rows = measured(path, 0..0, seed);
            for (row, (pose, covariance)) in rows.iter().zip(smooth(&rows).expect("smoothed")) {
                let truth = path(row.at_s);
                let off = error(&pose, &truth);
                before += error(&row.seen.expect("seen").0, &truth).fixed_rows::<3>(0).norm_squared();
                after += off.fixed_rows::<3>(0).norm_squared();
                squared += off.dot(&covariance.cholesky().expect("positive").solve(&off)) / 6.0;
                n += 1.0;
            }
        }
        [(after / before).sqrt(), squared / n]
    }

    #[test]
    fn noise_averages_out_and_the_covariance_says_by_how_much() {
        for (path, max_ratio) in [(sway as fn(f64) -> _, 0.6), (whip as fn(f64) -> _, 0.6)] {
            let [ratio, squared] = scores(path);
            println!("{ratio:.3} of the error, {squared:.2} squared sigmas");
            assert!(ratio < max_ratio && (0.6..1.6).contains(&squared), "{ratio} {squared}");
        }
    }

    #[test]
    fn a_gap_is_bridged_within_its_covariance() {
        let hidden = 100..112;
        let rows = measured(sway, hidden.clone(), 3);
        let smoothed = smooth(&rows).expect("smoothed");
        for k in hidden {
            let (pose, covariance) = &smoothed[k];
            let off = error(pose, &sway(rows[k].at_s));
            let squared = off.dot(&covariance.cholesky().expect("positive").solve(&off)) / 6.0;
            assert!(squared < 4.0 && off.fixed_rows::<3>(0).norm() < 0.01, "{k}: {squared}");
            assert!(covariance.trace() > smoothed[99].1.trace(), "{k}");
        }
    }

    #[test]
    fn what_cannot_be_smoothed_is_refused() {
        assert!(smooth(&[]).is_none());
        assert!(smooth(&[Sighting { at_s: 0.0, seen: None }]).is_none());
        let nothing = Sighting { at_s: 0.0, seen: Some((sway(0.0), Matrix6::zeros())) };
        assert_eq!(smooth(&[nothing]).map(|smoothed| smoothed.len()), Some(1));
        let worthless = Sighting { at_s: 0.1, seen: Some((sway(0.1), Matrix6::repeat(f64::NAN))) };
        assert!(smooth(&[nothing, worthless]).is_none());
    }
}
