//! Judges how far to trust a survey, and what to film again.

use super::scales::Support;
use super::stage::Survey;
use super::stage_model::bent;
use super::unmodelled::narrowest_wrinkle_m;

/// Points across and down a surface at which its shape is evaluated.
const POINTS: [usize; 2] = [24, 18];
/// Maximum robust scale of the residuals to be good and to be usable: near 1 with the right model,
/// larger with a wrong lens or shutter.
const MAX_SCALE: [f64; 2] = [2.0, 5.0];
/// Minimum fraction of keyframes that support the result, to be good and to be usable.
const MIN_USED: [f64; 2] = [0.8, 0.5];
/// Maximum sigma of a surface's heights, as a fraction of its longer side: the first limit, for
/// each of its parts, to be good; the second, for the median of the whole, to be usable.
const MAX_HEIGHT_SIGMA: [f64; 2] = [1e-3, 5e-3];
/// Maximum sigma of a surface's position, as the same fraction, to be good and to be usable: a
/// surface that no frame shows stays where the config has it, and is reported.
const MAX_PLACE_SIGMA: [f64; 2] = [2e-3, f64::INFINITY];
/// Maximum 3 sigma of a refined focal length, as a fraction, to be good and to be usable.
const MAX_FOCAL: [f64; 2] = [2e-3, 1e-2];
/// Maximum 3 sigma of a refined lens at its least known place, in 640ths of the picture's width, to
/// be good and to be usable: the limits of a calibration over most of the picture
/// (`calibrate::judge`).
const MAX_PIXEL: [f64; 2] = [2.0, 6.0];

/// The verdict, best first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// Good enough for the stage.
    Good,
    /// Better than none, with more error than necessary.
    Usable,
    /// Wrong, or too uncertain.
    DoNotUse,
}

impl Verdict {
    /// Returns the verdict in words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Usable => "usable",
            Self::DoNotUse => "do not use",
        }
    }
}

/// Describes a surface whose pose has too little support.
fn little(name: &str, support: Support, sigma_mm: f64) -> String {
    let (tiles, keyframes) = (support.tiles, support.keyframes);
    let hint = "film it from closer and from two sides, or measure its position";
    if keyframes == 0 {
        return format!("no keyframe shows {name} well enough to locate it ({sigma_mm:.0} mm, one sigma): {hint}");
    }
    let within = if keyframes == 1 { "1 keyframe" } else { &format!("{keyframes} keyframes") };
    if !support.is_little() {
        let scatter = support.scatter;
        return format!(
            "the residuals of {tiles} tiles of {name} scatter {scatter:.1} times as much as the others': its position may be wrong; {hint}"
        );
    }
    format!("only {tiles} tiles in {within} show {name}, too few to detect a wrong position: {hint}")
}

/// Grades a value: good up to the first limit, usable up to the second.
pub(super) fn graded(value: f64, limits: [f64; 2], good: String, bad: &dyn Fn() -> String) -> (Verdict, String) {
    if value <= limits[0] { (Verdict::Good, good) } else { (if value <= limits[1] { Verdict::Usable } else { Verdict::DoNotUse }, bad()) }
}

/// The assessment of a survey.
#[derive(Debug, Clone, PartialEq)]
pub struct Judgement {
    /// The verdict.
    pub verdict: Verdict,
    /// Clauses, heaviest first.
    pub reasons: Vec<String>,
}

impl Judgement {
    /// Returns the worst verdict of some findings, with the texts of those that reach it.
    pub(super) fn of(mut findings: Vec<(Verdict, String)>) -> Self {
        findings.sort_by_key(|(verdict, _)| std::cmp::Reverse(*verdict));
        let verdict = findings.first().map_or(Verdict::DoNotUse, |(verdict, _)| *verdict);
        let reasons = findings.into_iter().filter(|(of, _)| *of == verdict).map(|(_, text)| text).collect();
        Self { verdict, reasons }
    }

    /// Returns the verdict in one sentence.
    pub fn sentence(&self) -> String {
        format!("{}: {}", self.verdict.words(), self.reasons.join("; "))
    }
}

/// A surveyed surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceDescription {
    /// One sigma of its position relative to the first surface, millimetres; 0 for the first one.
    pub sigma_mm: f64,
    /// One sigma of its rotation, degrees.
    pub sigma_deg: f64,
    /// Root mean square height above its plane, millimetres.
    pub height_rms_mm: f64,
    /// Largest height, millimetres.
    pub height_max_mm: f64,
    /// Median over the surface of one sigma of the heights, millimetres, including what the spline
    /// does not show.
    pub height_sigma_mm: f64,
    /// Root mean square height that the spline does not show, millimetres.
    pub unmodelled_mm: f64,
    /// Length of the narrowest wrinkle that the spline follows, millimetres.
    pub narrowest_wrinkle_mm: f64,
}

impl Survey {
    /// Describes the surveyed surfaces, in the config's order.
    pub fn described(&self) -> Vec<SurfaceDescription> {
        (0..self.surfaces.len()).filter_map(|k| self.description(k)).collect()
    }

    /// Returns one sigma of the height of surface `k` at a point of its picture, metres: of the
    /// spline, and of what it does not show.
    pub fn height_sigma_m(&self, k: usize, point: [f64; 2]) -> f64 {
        let Some(shape) = bent(&self.surfaces[k]) else { return 0.0 };
        let weights = shape.height.support(point).weights().map(|(n, w)| (self.places.heights[k] + n, w));
        let variance: f64 = weights.iter().flat_map(|(i, a)| weights.iter().map(move |(j, b)| a * b * self.covariance[(*i, *j)])).sum();
        variance.max(0.0).sqrt().hypot(self.unmodelled_m[k])
    }

    fn description(&self, k: usize) -> Option<SurfaceDescription> {
        let surface = &self.surfaces[k];
        let shape = bent(surface)?;
        let share = |n: usize, of: usize| (n as f64 + 0.5) / of as f64 - 0.5;
        let points = (0..POINTS[0] * POINTS[1])
            .map(|n| [share(n % POINTS[0], POINTS[0]) * surface.size_m[0], share(n / POINTS[0], POINTS[1]) * surface.size_m[1]]);
        let (mut squared, mut most, mut sigmas) = (0.0, 0.0_f64, Vec::new());
        for point in points {
            let height = shape.height.at(point).value.x;
            squared += height * height;
            most = most.max(height.abs());
            sigmas.push(self.height_sigma_m(k, point));
        }
        sigmas.sort_by(f64::total_cmp);
        let sigma = |first: usize| {
            self.places.poses[k]
                .map_or(0.0, |at| (0..3).map(|n| self.covariance[(at + first + n, at + first + n)]).sum::<f64>().max(0.0).sqrt())
        };
        Some(SurfaceDescription {
            sigma_mm: 1e3 * sigma(0),
            sigma_deg: sigma(3).to_degrees(),
            height_rms_mm: 1e3 * (squared / sigmas.len() as f64).sqrt(),
            height_max_mm: 1e3 * most,
            height_sigma_mm: 1e3 * sigmas[sigmas.len() / 2],
            unmodelled_mm: 1e3 * self.unmodelled_m[k],
            narrowest_wrinkle_mm: 1e3 * narrowest_wrinkle_m(surface),
        })
    }

    /// Judges the survey.
    pub fn judge(&self) -> Judgement {
        let mut findings: Vec<(Verdict, String)> = Vec::new();
        let mut below = |value, limits, good, bad: &dyn Fn() -> String| findings.push(graded(value, limits, good, bad));
        let used = self.used as f64 / self.keyframes.max(1) as f64;
        below(-used, MIN_USED.map(|share| -share), format!("{} of {} keyframes agree with the result", self.used, self.keyframes), &|| {
            format!(
                "only {} of {} keyframes agree with the result; check that the clip shows this stage and the config matches",
                self.used, self.keyframes
            )
        });
        below(self.scale, MAX_SCALE, format!("the residual is noise ({:.3} px)", self.rms_px), &|| {
            format!(
                "the residual ({:.3} px) is {:.1} times the noise: the lens or the shutter is wrong, or the stage moved; try --lens \
                 refine, and check the shutter with `stagepose check --clip`",
                self.rms_px, self.scale
            )
        });
        findings.extend(self.of_surfaces());
        findings.extend(self.of_lens());
        // One wrong length makes others look wrong: report the worst, to be measured again.
        let contradicted = self.checks.iter().filter(|check| check.is_contradicted());
        if let Some(worst) = contradicted.max_by(|a, b| a.sigmas.total_cmp(&b.sigmas)) {
            findings.push((Verdict::DoNotUse, worst.contradiction()));
        }
        if !self.has_settled {
            findings.push((Verdict::Usable, format!("it did not converge in {} rounds", self.rounds)));
        }
        Judgement::of(findings)
    }

    /// Judges the surfaces; returns one summary if all are good.
    fn of_surfaces(&self) -> Vec<(Verdict, String)> {
        let (mut places_mm, mut shapes_mm) = (0.0_f64, 0.0_f64);
        let mut findings = Vec::new();
        for (k, (description, surface)) in self.described().iter().zip(&self.surfaces).enumerate() {
            let side_mm = 1e3 * surface.size_m[0].max(surface.size_m[1]);
            let parts = self.parts(k);
            let (place_mm, worst_mm) = (description.sigma_mm, 1e3 * parts.worst_m());
            (places_mm, shapes_mm) = (places_mm.max(place_mm), shapes_mm.max(worst_mm));
            let support = self.supports[k];
            if self.places.poses[k].is_some() && (support.is_little() || support.is_outlier()) {
                findings.push((Verdict::Usable, little(&surface.name, support, place_mm)));
            } else {
                findings.push(graded(place_mm / side_mm, MAX_PLACE_SIGMA, String::new(), &|| {
                    format!("the position of {} is known to {place_mm:.0} mm only: film it from closer and from two sides", surface.name)
                }));
            }
            let [good, usable] = MAX_HEIGHT_SIGMA.map(|share| share * side_mm);
            // If one part was not filmed, the rest is still usable; if half of them were not, it is
            // not. What the spline leaves out was there before the survey too, so it refuses none.
            let by_spline_mm = (description.height_sigma_mm.powi(2) - description.unmodelled_mm.powi(2)).max(0.0).sqrt();
            let unknown_mm = if by_spline_mm > usable { f64::INFINITY } else { worst_mm.min(usable) };
            findings.push(graded(unknown_mm, [good, usable], String::new(), &|| {
                let (wrinkles_mm, parts) = (description.narrowest_wrinkle_mm, parts.beyond(1e-3 * good));
                if description.unmodelled_mm > good && by_spline_mm <= usable {
                    return format!(
                        "the shape of {} is known to {worst_mm:.1} mm only: its residuals show wrinkles narrower than {wrinkles_mm:.0} mm, \
                         which a survey cannot measure, or a lens that is off; stretch it, or try --lens refine",
                        surface.name
                    );
                }
                format!(
                    "the shape of {} is known to {worst_mm:.1} mm only ({parts}): film it from two sides, 20 degrees or more apart",
                    surface.name
                )
            }));
        }
        findings.retain(|(verdict, _)| *verdict != Verdict::Good);
        findings.push((Verdict::Good, format!("shapes are known to {shapes_mm:.2} mm and positions to {places_mm:.2} mm at worst")));
        findings
    }

    /// Judges the lens; empty if it was not refined.
    fn of_lens(&self) -> Vec<(Verdict, String)> {
        let (Some(doubt), Some(weakest)) = (self.camera.doubt(), self.weakest_pixel()) else { return Vec::new() };
        let share = doubt.uncertainty.focal_px[0] / self.camera.intrinsics().fx;
        let focal = graded(share, MAX_FOCAL, format!("the focal length is known to {:.3} %", 100.0 * share), &|| {
            format!(
                "the focal length is known to {:.1} % only: film the stage at an angle, from near and far, and with the camera turned on \
                 its side",
                100.0 * share
            )
        });
        let (px, part) = (weakest.three_sigma_px, weakest.part);
        let of_640ths = px * 640.0 / f64::from(self.camera.width());
        let picture = graded(of_640ths, MAX_PIXEL, format!("the lens is known to {px:.2} px over the whole picture"), &|| {
            format!(
                "in the {part} of the picture the lens is known to {px:.1} px only: film so that the stage fills that part, and turn the \
                 camera on its side"
            )
        });
        vec![focal, picture]
    }
}
