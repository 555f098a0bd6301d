//! Judges how far to trust a calibration, beyond what residuals tell.
//!
//! Pictures that are all alike give small residuals and a wrong lens. So the uncertainty is
//! propagated to pixels in the picture, the halves of the set are compared, and the views are
//! checked for what they can determine at all. Every finding has a weight; the heaviest decides the
//! verdict.

pub mod halves;
pub mod map;
mod mixed;
mod wide;
mod words;

use super::board::{Board, Symmetry};
use super::guide::{PART_COLUMNS, PART_ROWS, TILTED_DEG, ViewSet, ViewShape};
use super::solve::adjust::Observation;
use super::solve::lens::{LENS_NAMES, LENS_NUMBERS};
use super::solve::{Estimate, SolveOptions};
use crate::camera::plausible;
use halves::Halves;
use map::PixelMap;
pub(crate) use mixed::mixed;
pub(crate) use words::{
    all_blurred, another_board, blurred, hint_for_few, hint_for_sizes, implausible_squares, nothing_found, one_direction, rounded,
};

/// The verdict, best first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// Good enough for the stage.
    Good,
    /// Works, with more error than necessary.
    Usable,
    /// Wrong, or too uncertain.
    DoNotUse,
}

impl std::fmt::Display for Verdict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Good => "good",
            Self::Usable => "usable",
            Self::DoNotUse => "do not use",
        })
    }
}

/// One argument for or against the calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// The best verdict that it allows.
    pub weight: Verdict,
    /// A clause without a full stop.
    pub text: String,
}

/// Everything known about a calibration's quality.
#[derive(Debug, Clone, PartialEq)]
pub struct Judgement {
    /// The verdict.
    pub verdict: Verdict,
    /// Everything found, heaviest first.
    pub findings: Vec<Finding>,
    /// Likely mistakes that do not affect the lens itself.
    pub remarks: Vec<String>,
    /// Which picture to take next.
    pub next_picture: String,
    /// Parameters that are not larger than their 3 sigma: they may as well be 0.
    pub insignificant: Vec<&'static str>,
    /// 3 sigma of a distant point's image position.
    pub uncertainty: PixelMap,
    /// Comparison of the two halves of the views, if there are enough.
    pub halves: Option<Halves>,
    /// Fraction of the picture's parts that corners have reached.
    pub coverage: f64,
    /// Number of tilted views.
    pub tilted_views: usize,
    /// The largest angle between two boards, degrees.
    pub widest_angle_deg: f64,
}

impl Judgement {
    /// Returns the verdict in one sentence.
    pub fn sentence(&self) -> String {
        // A good verdict is supported by two clauses; others list all their reasons.
        let most = if self.verdict == Verdict::Good { 2 } else { usize::MAX };
        let because = self.findings.iter().filter(|f| f.weight == self.verdict).take(most);
        let because: Vec<&str> = because.map(|f| f.text.as_str()).collect();
        format!("{}, because {}", self.verdict, because.join("; "))
    }

    /// Returns the findings as plain clauses, heaviest first, followed by the remarks.
    pub fn reasons(&self) -> Vec<String> {
        self.findings.iter().map(|f| &f.text).chain(&self.remarks).cloned().collect()
    }
}

/// Maximum 3 sigma of the focal length, as a fraction of it, to be good and to be usable: distances
/// err by the same fraction. Chosen for uncertainties that include errors shared by neighbouring
/// corners. Raised, sets of front-on views pass; lowered, ordinary good sets do not.
const FOCAL_SHARE: [f64; 2] = [0.008, 0.02];
/// Maximum 3 sigma over most of the picture, in 640ths of the picture's width, to be good and to be
/// usable. Chosen like [`FOCAL_SHARE`]. Raised, lenses pass that displace what is drawn; lowered,
/// sets must reach further into the corners.
const MAX_PX: [f64; 2] = [2.0, 6.0];
/// Maximum 3 sigma at the worst place, in 640ths of the picture's width, to be good: several times
/// [`MAX_PX`], since the picture's corners rarely show board corners. Raised, distortion that
/// diverges there goes unmentioned.
const WORST_PX: f64 = 15.0;
/// Difference between the halves, in joint sigma, above which it is no chance even if the corners'
/// errors are not independent: twice the limit for agreement. Raised, contradicting halves stay
/// usable; lowered, sets are refused for errors that sigma does not include.
const CONTRADICTION_SIGMAS: f64 = 6.0;
/// Maximum reprojection error, in 640ths of the picture's width, to be good and to be usable;
/// OpenCV's sample pictures of 640 pixels reach 0.16. Chosen, not tuned. Raised, bent boards and
/// lenses that the model does not fit pass; lowered, blurred pictures do not.
const RMS_PX: [f64; 2] = [0.6, 1.5];
/// Minimum coverage, as a fraction of the parts, to be good and to be usable. Chosen, not tuned:
/// below a quarter the distortion is a guess nearly everywhere. Raised, sets with good corners in
/// most parts are marked down.
const COVERAGE: [f64; 2] = [0.6, 0.25];
/// Minimum angle between the directions from which the board is seen, degrees, for Zhang's
/// equations to separate focal length from distance; below it the set must not be used. Chosen, not
/// tuned. Raised, sets of small tilts are refused although their uncertainty may be acceptable.
const MIN_ANGLE_DEG: f64 = 8.0;

/// Judges an estimate; `observations` are those of the used views, in the estimate's order.
/// `repeated` holds the number of pictures that repeat another one's view, and the number of all
/// pictures.
pub(crate) fn judge(
    observations: &[Vec<Observation>],
    estimate: &Estimate,
    size: (u32, u32),
    board: &Board,
    options: &SolveOptions,
    repeated: (usize, usize),
) -> Judgement {
    let lens = &estimate.bundle.lens;
    let mut set = ViewSet::default();
    observations.iter().filter_map(|o| ViewShape::new(o, size, Some(lens))).for_each(|shape| set.add(shape));
    let missing = set.missing();
    let all_parts = (PART_COLUMNS * PART_ROWS) as f64;
    let values = PixelMap { values_px: vec![None; map::MAP_COLUMNS * map::MAP_ROWS] };
    let uncertainty = lens.model(size.0, size.1).map_or(values, |model| map::uncertainty(&model, lens, &estimate.lens_covariance));
    let mut judgement = Judgement {
        verdict: Verdict::Good,
        findings: Vec::new(),
        remarks: Vec::new(),
        next_picture: String::new(),
        insignificant: insignificant(estimate),
        uncertainty,
        halves: halves::compare(observations, estimate, size, options),
        coverage: 1.0 - missing.parts.len() as f64 / all_parts,
        tilted_views: set.shapes().iter().filter(|s| s.tilt_deg() >= TILTED_DEG).count(),
        widest_angle_deg: set.widest_angle_deg(),
    };
    let pixel = f64::from(size.0.max(size.1)) / 640.0;
    judgement.weigh_geometry(estimate, &set);
    judgement.weigh_errors(estimate, pixel);
    judgement.weigh_lens(estimate, size, options);
    let is_too_wide = judgement.weigh_model(observations, estimate, size);
    judgement.weigh_views(repeated, board);
    judgement.conclude(&set);
    if is_too_wide {
        judgement.next_picture = "none: more pictures do not help with this lens".to_owned();
    }
    judgement
}

/// Returns the names of free distortion parameters that are not larger than their 3 sigma.
fn insignificant(estimate: &Estimate) -> Vec<&'static str> {
    let three_sigma = estimate.lens_uncertainty();
    let weak = |k: &usize| three_sigma[*k] > 0.0 && three_sigma[*k] >= estimate.bundle.lens.0[*k].abs();
    (4..LENS_NUMBERS).filter(weak).map(|k| LENS_NAMES[k]).collect()
}

impl Judgement {
    fn find(&mut self, weight: Verdict, text: String) {
        self.findings.push(Finding { weight, text });
    }

    /// Adds a finding with `text` if a value exceeds the limits.
    fn graded(&mut self, value: f64, [good, usable]: [f64; 2], text: impl Fn() -> String) {
        if value.is_nan() || value > usable {
            self.find(Verdict::DoNotUse, text());
        } else if value > good {
            self.find(Verdict::Usable, text());
        }
    }

    /// Judges what the views can determine at all.
    fn weigh_geometry(&mut self, estimate: &Estimate, set: &ViewSet) {
        let (views, angle) = (set.len(), self.widest_angle_deg);
        if angle < MIN_ANGLE_DEG {
            let text = format!(
                "all {views} views show the board from one direction (within {angle:.1} degrees): focal length and distance cannot be told apart"
            );
            self.find(Verdict::DoNotUse, text);
        }
        let share = focal_share(estimate);
        let tilted = self.tilted_views;
        let blame = if 2 * tilted < views {
            format!(
                ", because only {tilted} of {views} views are tilted by {TILTED_DEG:.0} degrees or more: nearly front-on views cannot \
                 tell focal length from distance"
            )
        } else {
            ", because the views are too few or too much alike".to_owned()
        };
        self.graded(share, FOCAL_SHARE, || format!("the focal length is known to {:.2} % only{blame}", 100.0 * share));
        if views < 6 {
            self.find(Verdict::Usable, format!("there are only {views} views"));
        }
        let (coverage, percent) = (self.coverage, 100.0 * self.coverage);
        self.graded(1.0 - coverage, COVERAGE.map(|c| 1.0 - c), || format!("corners reach only {percent:.0} % of the picture"));
    }

    /// Judges whether a real lens can have these parameters.
    fn weigh_lens(&mut self, estimate: &Estimate, (width, height): (u32, u32), options: &SolveOptions) {
        let n = &estimate.bundle.lens.0;
        let covariance = &estimate.lens_covariance;
        let off = (n[0] - n[1]).abs();
        let joint = 3.0 * (covariance[(0, 0)] + covariance[(1, 1)] - 2.0 * covariance[(0, 1)]).max(0.0).sqrt();
        let both_free = options.free.is_estimated(0) && options.free.is_estimated(1);
        if both_free && off > 0.01 * n[0] && off > joint {
            let weight = if off > 0.02 * n[0] { Verdict::DoNotUse } else { Verdict::Usable };
            let percent = 100.0 * off / n[0];
            let why = if 2 * self.tilted_views < estimate.bundle.poses.len() { ": a sign of views that are too much front-on" } else { "" };
            self.find(weight, format!("fx and fy differ by {percent:.1} %, yet a sensor's pixels are square{why} (if the board was printed out of shape, measure it)"));
        }
        let off_centre = [(n[2] + 0.5) / f64::from(width) - 0.5, (n[3] + 0.5) / f64::from(height) - 0.5];
        let off_centre = off_centre[0].hypot(off_centre[1]);
        if off_centre > 0.2 {
            let percent = 100.0 * off_centre;
            let text =
                format!("the principal point lies {percent:.0} % of the picture away from its middle (fine for a cropped picture only)");
            self.find(Verdict::Usable, text);
        }
        let folded = self.uncertainty.values_px.iter().filter(|v| v.is_none()).count();
        if folded > 0 {
            let percent = 100.0 * folded as f64 / self.uncertainty.values_px.len() as f64;
            let text = format!("the distortion folds over in {percent:.0} % of the picture, towards its rim; show the board there");
            self.find(Verdict::Usable, text);
        }
        if !self.insignificant.is_empty() {
            let names = self.insignificant.join(", ");
            self.find(Verdict::Good, format!("{names} do not differ from 0 significantly (3 sigma >= value); --fix can hold them at 0"));
        }
    }

    /// Judges whether the model can describe this lens; a model that would be refused when its file
    /// is read must not be used. Returns true if the lens is too wide for the model.
    fn weigh_model(&mut self, observations: &[Vec<Observation>], estimate: &Estimate, (width, height): (u32, u32)) -> bool {
        let refusal = estimate.bundle.lens.model(width, height).and_then(|model| plausible::judge(&model).map(|_| ())).err();
        if let Some(reason) = &refusal {
            self.find(Verdict::DoNotUse, format!("no command would accept it: {reason}"));
        }
        let Some(reach) = wide::reach(observations, estimate) else { return false };
        let is_too_wide = reach.angle_deg > wide::WIDE_DEG && (refusal.is_some() || reach.ringed > wide::RINGED);
        if is_too_wide {
            self.find(
                Verdict::DoNotUse,
                format!(
                    "this is a fisheye or a very wide lens, which is not supported: boards reach {:.0} degrees from its axis, where the \
                     model cannot follow the lens ({:.0} % of the squared residuals lie in rings); use another lens, or only the middle \
                     of the picture (cut pictures and clips alike)",
                    reach.angle_deg,
                    100.0 * reach.ringed
                ),
            );
        }
        is_too_wide
    }

    /// Judges the errors.
    fn weigh_errors(&mut self, estimate: &Estimate, pixel: f64) {
        let rms = estimate.rms_px;
        self.graded(rms / pixel, RMS_PX, || format!("the corners fit to {rms:.2} px only"));
        let (most, worst) = (self.uncertainty.quantile(map::MOST), self.uncertainty.worst());
        self.graded(most / pixel, MAX_PX, || format!("a distant point may appear {most:.1} px off over most of the picture (3 sigma)"));
        if worst / pixel > WORST_PX {
            let text = format!("a distant point may appear {worst:.1} px off near the picture's rim (3 sigma), where no corners are");
            self.find(Verdict::Usable, text);
        }
        let share = 100.0 * focal_share(estimate);
        self.find(Verdict::Good, format!("corners fit to {rms:.3} px, the focal length is known to {share:.2} %, a distant point to {most:.2} px over most of the picture (3 sigma)"));
        match self.halves.clone() {
            Some(halves) => {
                let ((name, sigmas), px) = (halves.worst_number(), halves.most_px);
                let times = sigmas / 3.0;
                if halves.agree() || px / pixel < 0.5 {
                    let how = if halves.agree() { "agree within their joint 3 sigma" } else { "agree nearly" };
                    self.find(Verdict::Good, format!("the two halves of the views {how} ({px:.2} px apart over most of the picture)"));
                } else {
                    let severe = sigmas > CONTRADICTION_SIGMAS && px / pixel > MAX_PX[1];
                    let weight = if severe { Verdict::DoNotUse } else { Verdict::Usable };
                    self.find(weight, format!("the two halves of the views differ ({name} by {times:.1} times the joint 3 sigma, {px:.1} px apart over most of the picture)"));
                }
            }
            None => self.find(Verdict::Usable, "there are too few views to compare one half with the other".to_owned()),
        }
    }

    fn weigh_views(&mut self, (duplicates, pictures): (usize, usize), board: &Board) {
        if duplicates > 0 {
            let text = format!("{duplicates} of {pictures} pictures repeat another one's view and add nothing");
            self.find(if 2 * duplicates >= pictures { Verdict::Usable } else { Verdict::Good }, text);
        }
        match board.symmetry() {
            Symmetry::None => {}
            Symmetry::Half => self.find(Verdict::Good, format!("a board of {board} looks the same turned by 180 degrees: its origin is the corner whose x axis points right and down in the picture, which may be the other end of the board from one picture to the next")),
            Symmetry::Quarter => self.find(Verdict::Good, format!("a board of {board} looks the same every 90 degrees: its origin is the corner whose x axis points right in the picture, which need not be the same one in every picture")),
        }
    }

    fn conclude(&mut self, set: &ViewSet) {
        self.findings.sort_by_key(|f| std::cmp::Reverse(f.weight));
        self.verdict = self.findings.first().map_or(Verdict::Good, |f| f.weight);
        self.next_picture = match (set.next_picture(), self.verdict) {
            (Some(next), _) => next,
            (None, Verdict::Good) => "nothing more is needed".to_owned(),
            (None, _) => {
                "more views of the same variety: the board large in the picture, each side in turn 30 to 45 degrees away".to_owned()
            }
        };
    }
}

/// Returns 3 sigma of the focal length as a fraction of it, for the worse axis; 0 if it is held
/// fixed.
fn focal_share(estimate: &Estimate) -> f64 {
    let three_sigma = estimate.lens_uncertainty();
    let n = &estimate.bundle.lens.0;
    (three_sigma[0] / n[0]).max(three_sigma[1] / n[1])
}
