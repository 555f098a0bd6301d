//! Judges how far to trust a map, and what to film again.

use super::super::judgement::{Judgement, Verdict, graded};
use super::super::stage::Survey;
use super::hold_out::HoldOut;
use super::map::Mapped;
use crate::geometry::robust_kernel::median;

/// Minimum share of keyframes that agree with the map, to be good and to be usable.
const MIN_USED: [f64; 2] = [0.8, 0.5];
/// Maximum robust scale of the residuals, to be good and to be usable: more means a wrong lens or
/// shutter. Right ones have 0.7 to 1.2; a rolling shutter of 16 ms taken for a global one, 2.9.
const MAX_SCALE: [f64; 2] = [1.5, 2.0];
/// Minimum number of facets, to be good and to be usable.
const MIN_FACETS: [usize; 2] = [4, 1];
/// Maximum median sigma of the facets' positions, as a share of the distance, to be good and to be
/// usable.
const MAX_SIGMA: [f64; 2] = [5e-4, 2e-3];
/// Maximum median distance of a keyframe from where a map of the others locates it, as a share of
/// the distance, to be good and to be usable.
const MAX_HELD_OUT: [f64; 2] = [2e-4, 1e-3];
/// Minimum share of the keyframes held out that are located, to be good and to be usable.
const MIN_LOCATED: [f64; 2] = [0.8, 0.5];
/// Maximum sigma of the scale, as a fraction, to be good. A poster of half a metre gives a
/// twentieth of that; points clicked to half a pixel and a tape, five times as much.
const GOOD_SCALE_SIGMA: f64 = 2e-4;
/// Minimum extent of the walk, as a share of the distance, to be good.
const GOOD_EXTENT: f64 = 0.5;

/// Maximum scatter of a facet's tiles, relative to the median of all: a rectangle across the edges
/// of steps has 1.7, faces of crates have up to 1.5. Raised, wrong planes stay in the map.
const MAX_SCATTER: f64 = 1.6;
/// Maximum height of a facet's detail over its plane, root mean square, as a share of the distance:
/// a rectangle across steps has 3 to 6 times that. Raised, wrong planes stay in the map; lowered,
/// brick and mouldings go.
const MAX_HEIGHT: f64 = 2e-4;

impl Survey {
    /// Whether enough of the walk supports surface `k` as a plane; `distance_m` is the cameras'
    /// distance from the set.
    pub fn is_supported(&self, k: usize, distance_m: f64) -> bool {
        let support = self.supports[k];
        !support.is_little() && support.scatter <= MAX_SCATTER && self.unmodelled_m[k] <= MAX_HEIGHT * distance_m
    }

    /// Returns the supported surfaces from `first` on ([`is_supported`](Self::is_supported)).
    pub fn supported_from(&self, first: usize, distance_m: f64) -> Vec<usize> {
        (first..self.surfaces.len()).filter(|k| self.is_supported(*k, distance_m)).collect()
    }
}

impl Mapped {
    /// Returns the median robust scale of the facets' residuals, in units of noise.
    pub fn residual_scale(&self) -> f64 {
        let mut scales: Vec<f64> = self.kept.iter().map(|k| self.survey.scales[*k]).collect();
        median(&mut scales).unwrap_or(f64::INFINITY)
    }

    /// Returns the median sigma of the facets' positions, metres.
    pub fn sigma_m(&self) -> f64 {
        let described = self.survey.described();
        let mut sigmas: Vec<f64> = self.kept.iter().filter_map(|k| described.get(*k)).map(|facet| 1e-3 * facet.sigma_mm).collect();
        median(&mut sigmas).unwrap_or(f64::INFINITY)
    }

    /// Judges how keyframes are located on a map of the others.
    fn of_hold_out(&self) -> Vec<(Verdict, String)> {
        let Some(HoldOut { keyframes, located, median_m, .. }) = self.hold_out else {
            let bad = "four of five keyframes alone make no map: film longer, from more places";
            return vec![(Verdict::Usable, bad.to_owned())];
        };
        let share = located as f64 / keyframes.max(1) as f64;
        let located = format!("{located} of {keyframes} keyframes are located on a map of the others");
        let hint = "the set may have moved during the walk, or few places show enough of it";
        let off_mm = 1e3 * median_m;
        vec![
            graded(-share, MIN_LOCATED.map(|share| -share), located.clone(), &|| format!("only {located}: {hint}")),
            graded(median_m / self.distance_m, MAX_HELD_OUT, format!("they are {off_mm:.2} mm off there (median)"), &|| {
                format!("keyframes are {off_mm:.1} mm off on a map of the others (median): film longer, sharper, and from both sides")
            }),
        ]
    }

    /// Judges the map.
    pub fn judge(&self) -> Judgement {
        let Self { survey, kept, extent_m, distance_m, .. } = self;
        let (used, keyframes) = (survey.used, survey.keyframes);
        let share = used as f64 / keyframes.max(1) as f64;
        let mut findings = Vec::new();
        let mut below =
            |value: f64, limits: [f64; 2], good: String, bad: String| findings.push(graded(value, limits, good, &|| bad.clone()));
        below(
            -share,
            MIN_USED.map(|share| -share),
            format!("{used} of {keyframes} keyframes agree with the map"),
            format!("only {used} of {keyframes} keyframes agree with the map: the set may have moved during the walk"),
        );
        let (scale, rms_px) = (self.residual_scale(), survey.rms_px);
        below(
            scale,
            MAX_SCALE,
            format!("the residual is noise ({rms_px:.3} px)"),
            format!("the residual ({rms_px:.3} px) is {scale:.1} times the noise: the lens or the shutter is wrong, or the set moved"),
        );
        let facets = kept.len();
        below(
            -(facets as f64),
            MIN_FACETS.map(|facets| -(facets as f64)),
            format!("{facets} facets"),
            format!("only {facets} facets were found: film more of the set, sharper, and from closer"),
        );
        let (sigma_mm, relative) = (1e3 * self.sigma_m(), self.sigma_m() / distance_m);
        below(
            relative,
            MAX_SIGMA,
            format!("facets are known to {sigma_mm:.2} mm (median, one sigma)"),
            format!(
                "facets are known to {sigma_mm:.1} mm only (median, one sigma): film the set from both sides, and the poster from closer"
            ),
        );
        // A narrow walk is usable; one that is too narrow was refused before.
        below(
            -extent_m,
            [-GOOD_EXTENT * distance_m, f64::INFINITY],
            format!("the walk spans {extent_m:.1} m at {distance_m:.1} m from the set"),
            format!("the walk spans only {extent_m:.1} m at {distance_m:.1} m from the set: walk farther to both sides"),
        );
        findings.extend(self.of_hold_out());
        if let Some(sigma) = self.scale_sigma {
            let (ppm, off_mm) = (1e6 * sigma, 1e3 * sigma * distance_m);
            findings.push(graded(sigma, [GOOD_SCALE_SIGMA, f64::INFINITY], format!("the scale is known to {ppm:.0} ppm"), &|| {
                format!(
                    "the scale is known to {ppm:.0} ppm only, {off_mm:.1} mm at the cameras: click the points in more frames, measure longer \
                     lengths, or add a poster"
                )
            }));
        } else {
            let hint = "nothing is metric: put a poster into the set as [[stage.surface]], or click points ([[map.point]]) and measure a length \
                        between them ([[map.distance]])";
            findings.push((Verdict::Usable, hint.to_owned()));
        }
        if let Some(readout) = &self.readout {
            let ms = 1e3 * readout.seconds;
            let told = format!("the shutter rolls: its readout of {ms:.1} ms was learnt from the walk; `readout_s` in [camera] states it");
            findings.push((Verdict::Good, told));
        }
        if !survey.has_settled {
            findings.push((Verdict::Usable, format!("it did not converge in {} rounds", survey.rounds)));
        }
        Judgement::of(findings)
    }
}
