//! A complete calibration: estimates the lens from the boards found, refits the corners, rejects
//! bad views, and judges the result.

use std::path::PathBuf;

use image::{GrayImage, RgbImage};
use nalgebra::Vector2;
use rayon::prelude::*;
use thiserror::Error;

use super::board::Board;
use super::finder::FoundBoard;
use super::finder::window::Window;
use super::judge::{self, Judgement};
use super::lateral_colour::{self, CornerColours, LateralColour};
use super::picture::Inspected;
use super::recompute::BoardView;
use super::solve::adjust::{Observation, mean_distance, observations_of};
use super::solve::{self, Estimate, Extrinsics, MIN_VIEWS, SolveOptions};
use crate::geometry::robust_kernel::median;

/// Options of a calibration.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CalibrationOptions {
    /// Which parameters are estimated.
    pub solve: SolveOptions,
    /// Use every view that shows the board, as Bouguet's toolbox does, instead of rejecting bad
    /// ones.
    pub keep_all_views: bool,
}

/// One picture's part in the calibration.
#[derive(Debug, Clone)]
pub struct CalibrationView {
    /// Name of the picture.
    pub file: PathBuf,
    /// The board's corners as last measured, in the board's order; `None` if the board was not
    /// found.
    pub corners: Option<Vec<Option<Vector2<f64>>>>,
    /// Whether the estimate uses this view.
    pub used: bool,
    /// Why it is not used, or a remark about a used view.
    pub reason: Option<String>,
    /// Its index among the estimate's poses.
    pub index: Option<usize>,
    /// Reprojection error over its used corners, per point, pixels.
    pub rms_px: Option<f64>,
    /// Its corners that were rejected as outliers (indices in the board's order).
    pub outliers: Vec<usize>,
    /// Bouguet's omc and Tc with 3 sigma.
    pub extrinsics: Option<Extrinsics>,
    /// A small copy of the picture.
    pub thumbnail: Option<GrayImage>,
}

/// A finished calibration.
#[derive(Debug, Clone)]
pub struct CameraCalibration {
    /// The board.
    pub board: Board,
    /// Maker and model of the camera, if the pictures' files name them.
    pub camera: Option<String>,
    /// Width and height of the pictures, pixels.
    pub size: (u32, u32),
    /// Every picture, in the order given.
    pub views: Vec<CalibrationView>,
    /// Lens, poses and uncertainties.
    pub estimate: Estimate,
    /// How far to trust it.
    pub judgement: Judgement,
    /// Number of rounds in which the corners were refitted, and the largest movement of a corner in
    /// the last round, pixels.
    pub rounds: (usize, f64),
    /// How much the colours differ in size, or why this is not measured; the caller measures it
    /// with [`CameraCalibration::corner_colours`].
    pub lateral_colour: Result<LateralColour, &'static str>,
}

/// Why the calibration failed, and what to do.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("{0}")]
pub struct CalibrationError(String);

/// A view during the estimation.
struct Working<'a> {
    picture: usize,
    inspected: &'a Inspected,
    found: &'a FoundBoard,
    corners: Vec<Option<Vector2<f64>>>,
}

/// Maximum number of rounds of refitting the corners; each round moves them far less than the one
/// before. Raised, a set that does not converge takes longer.
const MAX_ROUNDS: usize = 6;
/// Maximum movement of a corner, pixels, that counts as converged: a tenth of the best corners'
/// accuracy. Raised, useful rounds are skipped; lowered, rounds are wasted.
const STILL_PX: f64 = 0.003;
/// A view is rejected if its corners fit this many times worse than the median view's. Chosen, not
/// tuned. Raised, a bent board or a changed zoom stays in; lowered, merely blurred views are
/// rejected.
const WORSE: f64 = 3.0;

/// Makes a calibration from inspected pictures.
///
/// # Errors
/// If no calibration is possible; the sentence says what to do.
pub fn calibrate(pictures: &[Inspected], board: &Board, options: &CalibrationOptions) -> Result<CameraCalibration, CalibrationError> {
    let size = common_size(pictures)?;
    let mut reasons: Vec<Option<String>> = pictures.iter().map(|p| p.board.as_ref().err().cloned()).collect();
    let shown = pictures.iter().enumerate().filter_map(|(k, inspected)| Some((k, inspected, inspected.board.as_ref().ok()?)));
    let working = shown.map(|(picture, inspected, found)| Working { picture, inspected, found, corners: found.corners.clone() });
    let mut working: Vec<Working> = working.collect();
    let nothing_found = || working.is_empty().then(|| judge::nothing_found(pictures, board));
    if let Some(sentence) = judge::mixed(pictures).or_else(nothing_found).or_else(|| judge::another_board(pictures, board)) {
        return Err(CalibrationError(sentence));
    }
    let shown = working.len();
    if !options.keep_all_views {
        drop_duplicates(&mut working, &mut reasons, size);
    }
    let repeated = (shown - working.len(), pictures.len());
    let too_few = |usable: usize| {
        let (all, hint) = (pictures.len(), judge::hint_for_few(pictures, board));
        CalibrationError(format!("only {usable} of {all} pictures can be used, at least {MIN_VIEWS} are needed; {hint}"))
    };
    if working.len() < MIN_VIEWS {
        return Err(too_few(working.len()));
    }
    let (mut estimate, mut rounds);
    loop {
        (estimate, rounds) = settle(&mut working, board, size, options)?;
        let worse = if options.keep_all_views { None } else { worst_view(&working, board, &estimate) };
        let Some((index, reason)) = worse else { break };
        reasons[working[index].picture] = Some(reason);
        working.remove(index);
        if working.len() < MIN_VIEWS {
            return Err(too_few(working.len()));
        }
    }
    let observations: Vec<Vec<Observation>> = working.iter().map(|w| observations_of(&w.corners, board)).collect();
    let views = views_of(pictures, &working, reasons, board, &estimate);
    let mut judgement = judge::judge(&observations, &estimate, size, board, &options.solve, repeated);
    judgement.remarks.extend(judge::implausible_squares(&estimate, board));
    judgement.remarks.extend(judge::all_blurred(&blurs(&working), size));
    let camera = pictures.iter().filter(|p| p.board.is_ok()).find_map(|p| p.origin.camera.clone());
    let lateral_colour = Err(lateral_colour::GREY);
    Ok(CameraCalibration { board: *board, camera, size, views, estimate, judgement, rounds, lateral_colour })
}

impl CameraCalibration {
    /// Measures where the corners of view `view` are in each colour of its picture. Returns `None`
    /// if the picture is grey, the view is not used, or the picture is not the one inspected.
    pub fn corner_colours(&self, view: usize, inspected: &Inspected, picture: &RgbImage) -> Option<Vec<CornerColours>> {
        let view = self.views.get(view)?;
        let (found, patch) = (inspected.board.as_ref().ok()?, inspected.patch.as_ref()?);
        (picture.dimensions() == self.size).then_some(())?;
        let mut corners = view.corners.clone()?;
        view.outliers.iter().for_each(|&k| corners[k] = None);
        let model = self.estimate.bundle.lens.model(self.size.0, self.size.1).ok()?;
        let pose = self.estimate.bundle.poses.get(view.index?)?;
        lateral_colour::corner_colours((&model, pose, &self.board), (found, patch), &corners, picture)
    }
}

/// Alternates estimation and refitting of the corners until nothing moves.
fn settle(
    working: &mut [Working],
    board: &Board,
    size: (u32, u32),
    options: &CalibrationOptions,
) -> Result<(Estimate, (usize, f64)), CalibrationError> {
    let undetermined = || CalibrationError(judge::one_direction());
    let observations = |working: &[Working]| working.iter().map(|w| observations_of(&w.corners, board)).collect::<Vec<_>>();
    let mut estimate = solve::estimate(&observations(working), size, &options.solve).ok_or_else(undetermined)?;
    let mut moved = 0.0;
    for round in 1..=MAX_ROUNDS {
        let Ok(model) = estimate.bundle.lens.model(size.0, size.1) else { return Ok((estimate, (round - 1, moved))) };
        moved = working
            .par_iter_mut()
            .zip(&estimate.bundle.poses)
            .map(|(view, pose)| {
                let geometry = BoardView::new(&model, pose, board, view.found);
                let (Some(patch), Some(geometry)) = (&view.inspected.patch, geometry) else {
                    return 0.0;
                };
                let (mut farthest, mut window) = (0.0_f64, Window::default());
                for (k, corner) in view.corners.iter_mut().enumerate() {
                    let Some(corner) = corner else { continue };
                    if let Some(now) = geometry.corner(patch, k, *corner, &mut window) {
                        farthest = farthest.max((now - *corner).norm());
                        *corner = now;
                    }
                }
                farthest
            })
            .reduce(|| 0.0, f64::max);
        estimate = solve::refine(estimate.bundle, &observations(working), &options.solve).ok_or_else(undetermined)?;
        if moved < STILL_PX {
            return Ok((estimate, (round, moved)));
        }
    }
    Ok((estimate, (MAX_ROUNDS, moved)))
}

/// Returns the common size of all pictures that show the board.
fn common_size(pictures: &[Inspected]) -> Result<(u32, u32), CalibrationError> {
    let mut sized = pictures.iter().filter(|p| p.board.is_ok()).filter_map(|p| Some((p, p.size?)));
    let Some((first, size)) = sized.next() else { return Ok((1, 1)) };
    match sized.find(|(_, other)| *other != size) {
        None => Ok(size),
        Some((other, other_size)) => Err(CalibrationError(format!(
            "{} is {} x {} pixels and {} is {} x {}; all pictures must come from one camera at one size{}",
            first.file.display(),
            size.0,
            size.1,
            other.file.display(),
            other_size.0,
            other_size.1,
            judge::hint_for_sizes(pictures, size, other_size)
        ))),
    }
}

/// Mean distance of the corners of two views, as a fraction of the picture's diagonal, below which
/// they count as the same view: 3 pixels of 640 x 480, as for a camera on a stand. Raised,
/// different views are dropped; lowered, copies count twice and uncertainties come out too small.
const SAME_VIEW: f64 = 0.004;

fn drop_duplicates(working: &mut Vec<Working>, reasons: &mut [Option<String>], size: (u32, u32)) {
    let limit = SAME_VIEW * f64::from(size.0).hypot(f64::from(size.1));
    let mut kept: Vec<Working> = Vec::new();
    for view in working.drain(..) {
        match kept.iter().find(|before| mean_distance(&before.corners, &view.corners) < limit) {
            Some(before) => reasons[view.picture] = Some(format!("the same view as {}", before.inspected.file.display())),
            None => kept.push(view),
        }
    }
    *working = kept;
}

/// Returns the view that fits worst, if it fits so much worse than the others that something is
/// wrong with it.
fn worst_view(working: &[Working], board: &Board, estimate: &Estimate) -> Option<(usize, String)> {
    let rms: Vec<f64> = working.iter().enumerate().map(|(v, w)| estimate.view_rms_px(v, &observations_of(&w.corners, board))).collect();
    let lost = |v: usize| estimate.used[v].iter().filter(|used| !**used).count();
    let half_lost = (0..working.len()).find(|&v| 2 * lost(v) > estimate.used[v].len());
    if let Some(v) = half_lost {
        let (lost, all) = (lost(v), estimate.used[v].len());
        // A blurred picture has large residuals too, so check that before suspecting the board.
        let why = judge::blurred(working[v].found, &blurs(working))
            .unwrap_or_else(|| "was the board bent, or the zoom or focus changed?".to_owned());
        return Some((v, format!("{lost} of its {all} corners do not fit the camera of the other pictures; {why}")));
    }
    let worst = (0..rms.len()).max_by(|&a, &b| rms[a].total_cmp(&rms[b]))?;
    let median = median(&mut rms.clone())?;
    let (worst_px, times) = (rms[worst], rms[worst] / median);
    (worst_px > WORSE * median && worst_px > 0.1).then(|| {
        let fit = format!("its corners fit {times:.1} times worse than the median picture's ({worst_px:.2} px)");
        (worst, format!("{fit}; was it moving, or the board bent?"))
    })
}

/// Minimum 3 sigma of a pose that makes its view worth a remark: rotation in rad, and position as a
/// fraction of the distance. Chosen, not tuned. Raised, fewer small or steep boards are mentioned.
const ILL_CONDITIONED: [f64; 2] = [0.05, 0.05];

/// Returns a remark about a view whose own pose is poorly determined. The view is still used, since
/// it does no harm.
fn ill_conditioned(pose: &Extrinsics) -> Option<String> {
    let (rotation, place) = (pose.rotation_uncertainty.amax(), pose.translation_uncertainty_m.norm() / pose.translation_m.norm());
    (rotation > ILL_CONDITIONED[0] || place > ILL_CONDITIONED[1]).then(|| {
        let (degrees, percent) = (rotation.to_degrees(), 100.0 * place);
        format!("ill-conditioned: its own pose is known to {degrees:.1} degrees and {percent:.0} % only; bring the board nearer, or tilt it less far")
    })
}

/// Returns the blur of each view, pixels.
fn blurs(working: &[Working]) -> Vec<f64> {
    working.iter().map(|view| view.found.blur_px).collect()
}

/// Collects the results for each picture.
fn views_of(
    pictures: &[Inspected],
    working: &[Working],
    reasons: Vec<Option<String>>,
    board: &Board,
    estimate: &Estimate,
) -> Vec<CalibrationView> {
    let blurs = blurs(working);
    pictures
        .iter()
        .zip(reasons)
        .enumerate()
        .map(|(picture, (inspected, reason))| {
            let index = working.iter().position(|w| w.picture == picture);
            let corners = index.map(|v| working[v].corners.clone()).or_else(|| inspected.board.as_ref().ok().map(|b| b.corners.clone()));
            let outliers = index.map_or(Vec::new(), |v| {
                let seen = working[v].corners.iter().enumerate().filter(|(_, c)| c.is_some()).map(|(k, _)| k);
                seen.zip(&estimate.used[v]).filter(|(_, used)| !**used).map(|(k, _)| k).collect()
            });
            let extrinsics = index.map(|v| estimate.extrinsics(v));
            CalibrationView {
                file: inspected.file.clone(),
                corners,
                used: index.is_some(),
                reason: reason
                    .or_else(|| extrinsics.as_ref().and_then(ill_conditioned))
                    .or_else(|| judge::blurred(working.get(index?)?.found, &blurs)),
                index,
                rms_px: index.map(|v| estimate.view_rms_px(v, &observations_of(&working[v].corners, board))),
                outliers,
                extrinsics,
                thumbnail: inspected.thumbnail.clone(),
            }
        })
        .collect()
}

#[cfg(test)]
#[path = "session_tests.rs"]
mod tests;
