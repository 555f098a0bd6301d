//! Judges the result, and finds the view that would improve it most.

use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3};

use super::residual::Unknowns;
use super::sight::ObservationModel;
use super::solve::Solution;
use super::views::{Stages, View, ViewPair};
use crate::calibrate::judge::Verdict;
use crate::geometry::{Pose, Stage};

/// One sigma in the worst direction that is invisible to a renderer: of the shift, metres, and of
/// the rotation, radians. Chosen: with 60 degrees across 1920 pixels they amount to 0.8 pixels at
/// two metres, and 1.5 at any distance. Raised, mounts with visible errors are good; lowered, views
/// are requested that change nothing.
const GOOD_M: f64 = 1e-3;
const GOOD_RAD: f64 = 0.05 * std::f64::consts::PI / 180.0;
/// The same for a useless mount: a tape measure and an eye do better. Raised, worse mounts pass as
/// usable.
const USELESS_M: f64 = 0.05;
const USELESS_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;
/// Minimum number of pairs for a good mount: if two disagree, it is unknown which is wrong. Raised,
/// more views are requested.
const ENOUGH_PAIRS: usize = 3;
/// Scatter relative to the covariances, as a ratio of sigmas, above which some assumption fails:
/// the rig moved, or the stage differs from its config. Chosen, not tuned. Raised, such mistakes go
/// unmentioned; lowered, slightly small covariances raise the alarm.
const ODD_EXCESS: f64 = 2.5;

/// Returns one sigma of shift (metres) and of rotation (radians), each in its worst direction.
pub fn worst_sigmas(covariance: &Matrix6<f64>) -> [f64; 2] {
    [0, 3].map(|at| covariance.fixed_view::<3, 3>(at, at).into_owned().symmetric_eigenvalues().max().max(0.0).sqrt())
}

/// Whether the lenses contribute more uncertainty than the views.
pub fn is_doubt_of_lenses(solution: &Solution, by_lenses: &Matrix6<f64>) -> bool {
    worst_sigmas(by_lenses)[0] > worst_sigmas(&solution.covariance)[0]
}

/// Returns the verdict with its reasons, one sentence each. `by_lenses` is the mount's covariance
/// caused by the lenses' uncertainty.
pub fn judge(solution: &Solution, by_lenses: &Matrix6<f64>) -> (Verdict, Vec<String>) {
    let [shift, turn] = worst_sigmas(&(solution.covariance + by_lenses));
    let used = solution.views.iter().filter(|view| view.is_used).count();
    let mut reasons = Vec::new();
    if used == 1 {
        reasons.push("one pair of views only: nothing verifies it".to_owned());
    } else if used < ENOUGH_PAIRS {
        reasons.push(format!("{used} pairs of views only: if they disagree, it is unknown which one is wrong"));
    }
    if shift > GOOD_M {
        reasons.push(format!("the offset is known to {:.1} mm only (one sigma in the worst direction)", shift * 1e3));
    }
    if turn > GOOD_RAD {
        reasons.push(format!("the rotation is known to {:.2} degrees only (one sigma in the worst direction)", turn.to_degrees()));
    }
    if solution.excess > ODD_EXCESS {
        reasons.push(format!(
            "the views scatter {:.1} times as much as their noise explains: was the rig still, are both cameras bolted to it, are size_m \
             and the calibrations correct?",
            solution.excess
        ));
    }
    if is_doubt_of_lenses(solution, by_lenses) {
        reasons.push("most of the uncertainty is the calibrations', which more views do not reduce: calibrate both cameras".to_owned());
    }
    let verdict = match reasons.is_empty() {
        _ if shift > USELESS_M || turn > USELESS_RAD => Verdict::DoNotUse,
        true => Verdict::Good,
        false => Verdict::Usable,
    };
    (verdict, reasons)
}

/// The view that would improve the mount most.
#[derive(Debug, Clone, PartialEq)]
pub struct NextView {
    /// What to do with the rig.
    pub words: String,
    /// Expected one sigma afterwards in the worst direction: shift, metres, and rotation, radians;
    /// `None` if it cannot be predicted.
    pub sigmas: Option<[f64; 2]>,
}

/// Moves that are tried as advice: rotate the rig around the stage's middle by (turn, tilt)
/// degrees, and scale its distance; with the words to say. They are about as far as a rig in a
/// house can go; larger ones would constrain more but are rarely possible.
const MOVES: [([f64; 2], f64, &str); 8] = [
    ([-35.0, 0.0], 1.0, "from about 35 degrees further to the house's left"),
    ([35.0, 0.0], 1.0, "from about 35 degrees further to the house's right"),
    ([0.0, -25.0], 1.0, "from about 25 degrees higher"),
    ([0.0, 25.0], 1.0, "from about 25 degrees lower"),
    ([0.0, 0.0], 0.5, "from half the distance"),
    ([0.0, 0.0], 0.7, "from two thirds of the distance"),
    ([-25.0, 0.0], 0.7, "from two thirds of the distance and about 25 degrees further to the house's left"),
    ([25.0, 0.0], 0.7, "from two thirds of the distance and about 25 degrees further to the house's right"),
];

/// Returns the view to take next. `models` are the cameras' observation models: the tracking one,
/// then the filming one.
pub fn next_view(models: [ObservationModel<'_>; 2], pairs: &[ViewPair], solution: &Solution, stages: Stages) -> Option<NextView> {
    if stages == Stages::Apart {
        return least_rotated(pairs).map(|words| NextView { words, sigmas: None });
    }
    let scales = [models[0].scale(pairs.iter().map(|p| &p.tracking))?, models[1].scale(pairs.iter().map(|p| &p.filming))?];
    let unknowns = Unknowns { mount: solution.mount, between: Pose::identity() };
    let known = solution.covariance.cholesky()?.inverse();
    let surfaces = &models[0].stage.surfaces;
    let middle = surfaces.iter().map(|s| s.pose.translation).sum::<Vector3<f64>>() / surfaces.len().max(1) as f64;
    let candidate = |pair: &ViewPair, ([turn, tilt], share, words): ([f64; 2], f64, &'static str)| {
        let moved = gone_round(&pair.tracking.pose, &middle, turn, tilt, share);
        let filming: Pose<Stage, crate::geometry::Camera> = (moved * solution.mount).renamed();
        let view = |k: usize, pose| Some(View { pose, covariance: models[k].covariance(&pose)? * scales[k] });
        let pair = ViewPair { tracking: view(0, moved)?, filming: view(1, filming)? };
        let (_, jacobian) = unknowns.residual(&pair);
        let jacobian = jacobian.fixed_columns::<6>(0);
        let more = jacobian.transpose() * unknowns.covariance(&pair).cholesky()?.inverse() * jacobian;
        let sigmas = worst_sigmas(&(known + more).cholesky()?.inverse());
        Some((sigmas, words))
    };
    // From every existing view, since the rig may not be able to go further.
    let all = pairs.iter().flat_map(|pair| MOVES.iter().filter_map(move |step| candidate(pair, *step)));
    let rated = all.min_by(|(a, _), (b, _)| worth(a).total_cmp(&worth(b)));
    rated.map(|(sigmas, words)| NextView { words: format!("take a pair of views {words}"), sigmas: Some(sigmas) })
}

/// Returns the distance from good; smaller is better.
fn worth([shift, turn]: &[f64; 2]) -> f64 {
    (shift / GOOD_M).hypot(turn / GOOD_RAD)
}

/// Rotates a pose around a point: about the x axis (the house's right), then about the vertical,
/// and scales the distance.
fn gone_round(
    pose: &Pose<Stage, crate::geometry::Camera>,
    middle: &Vector3<f64>,
    turn_deg: f64,
    tilt_deg: f64,
    share: f64,
) -> Pose<Stage, crate::geometry::Camera> {
    let about = |axis, degrees: f64| UnitQuaternion::from_axis_angle(&axis, degrees.to_radians());
    let rotated = about(Vector3::z_axis(), turn_deg) * about(Vector3::x_axis(), tilt_deg);
    Pose::new(rotated * pose.rotation, middle + rotated * (pose.translation - middle) * share)
}

/// Advises to rotate the rig about the one of its axes about which it rotated least.
fn least_rotated(pairs: &[ViewPair]) -> Option<String> {
    let first = pairs.first()?.tracking.pose.rotation;
    let rotations: Vec<Vector3<f64>> = pairs.iter().map(|pair| (first.inverse() * pair.tracking.pose.rotation).scaled_axis()).collect();
    let mean = rotations.iter().sum::<Vector3<f64>>() / rotations.len() as f64;
    let scatter: Matrix3<f64> = rotations.iter().map(|t| (t - mean) * (t - mean).transpose()).sum();
    Some(match scatter.diagonal().imin() {
        0 => "take views with the rig tilted up and down by 20 degrees or more".to_owned(),
        1 => "take views with the rig panned to both sides by 20 degrees or more".to_owned(),
        _ => "take views with the rig rolled to both sides by 20 degrees or more".to_owned(),
    })
}
