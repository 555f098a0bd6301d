//! Learns the camera's curve between light and grey levels from the residuals of its frames.
//!
//! Where the curve is wrong, all pixels of one grey show too much or too little light, whatever
//! they show. The residuals are therefore fitted as a function of grey, over many frames. What a
//! gain or a bias of the tile explains is left out, because lamps and haze do the same.

use nalgebra::{SMatrix, SVector};

use crate::light::camera_curve::{Bend, KNOTS};
use crate::track::align::tuning::TUNING;

/// Sums over pixels for the fit of the corrections at the knots.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CurveSums {
    /// Products of the knots' weights with each other, each times the information of the pixel.
    pub by_each_other: SMatrix<f64, KNOTS, KNOTS>,
    /// Products with the correction that the pixel asks for.
    pub by_correction: SVector<f64, KNOTS>,
}

/// The corrections as learnt so far.
#[derive(Debug, Clone)]
pub struct LearntCurve {
    sums: CurveSums,
    /// The corrections before any frame, and one sigma of each.
    before: Bend,
    before_sigma: f64,
    bend: Bend,
    /// Frames since one was asked, and frames asked.
    since_asked: u32,
    asked: u32,
}

impl Default for LearntCurve {
    fn default() -> Self {
        Self::from_bend([0.0; KNOTS], TUNING.initial_curve_sigma)
    }
}

impl LearntCurve {
    fn from_bend(bend: Bend, sigma: f64) -> Self {
        Self { sums: CurveSums::default(), before: bend, before_sigma: sigma, bend, since_asked: TUNING.curve_interval_frames, asked: 0 }
    }

    /// Begins with the corrections of an earlier session.
    pub fn begun_with(bend: Bend) -> Self {
        Self::from_bend(bend, TUNING.kept_curve_sigma)
    }

    /// Returns the corrections.
    pub fn bend(&self) -> &Bend {
        &self.bend
    }

    /// Returns the information that frames have given, per unit of light²: the larger, the better
    /// the curve is known.
    pub fn information(&self) -> f64 {
        self.sums.by_each_other.trace()
    }

    /// Whether the next frame is to be asked. After the first ones, neighbouring frames show nearly
    /// the same.
    pub fn is_due(&self) -> bool {
        self.asked < TUNING.first_curve_frames || self.since_asked >= TUNING.curve_interval_frames
    }

    /// Learns from an accepted frame, asked or not.
    pub fn learn(&mut self, frame: Option<&CurveSums>) {
        self.since_asked += 1;
        let Some(frame) = frame else { return };
        (self.since_asked, self.asked) = (1, self.asked + 1);
        let kept = 1.0 - TUNING.curve_forgetting_rate;
        self.sums.by_each_other = self.sums.by_each_other * kept + frame.by_each_other;
        self.sums.by_correction = self.sums.by_correction * kept + frame.by_correction;
        // Neighbouring pixels share the errors of the prediction, so that each adds less than its
        // noise says.
        let share = 1.0 / TUNING.pixels_per_curve_sample;
        let (mut a, mut b) = (self.sums.by_each_other * share, self.sums.by_correction * share);
        let prior = self.before_sigma.powi(-2);
        for k in 0..KNOTS {
            a[(k, k)] += prior;
            b[k] += prior * f64::from(self.before[k]);
        }
        // Curves are smooth: each correction is near the mean of its neighbours, which are 0 beyond
        // the ends.
        let smooth = TUNING.curve_roughness_sigma.powi(-2);
        for k in 0..KNOTS {
            let mut row = SVector::<f64, KNOTS>::zeros();
            row[k] = 1.0;
            if k > 0 {
                row[k - 1] = -0.5;
            }
            if k + 1 < KNOTS {
                row[k + 1] = -0.5;
            }
            let bent: f64 = row.iter().zip(&self.before).map(|(weight, before)| weight * f64::from(*before)).sum();
            a += row * row.transpose() * smooth;
            b += row * (smooth * bent);
        }
        if let Some(bend) = a.cholesky().map(|factor| factor.solve(&b)).filter(|bend| bend.iter().all(|v| v.is_finite())) {
            self.bend = std::array::from_fn(|k| bend[k] as f32);
            tracing::trace!(bend = ?self.bend, "camera curve");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::camera_curve::knots_at;

    /// Sums over pixels of all greys that ask for a correction.
    fn sums(bend: &Bend) -> CurveSums {
        let mut sums = CurveSums::default();
        for grey in 0..=255u8 {
            let mut row = SVector::<f64, KNOTS>::zeros();
            knots_at(f32::from(grey)).iter().for_each(|(knot, weight)| row[*knot] += f64::from(*weight));
            let correction: f64 = row.iter().zip(bend).map(|(weight, bend)| weight * f64::from(*bend)).sum();
            sums.by_each_other += row * row.transpose();
            sums.by_correction += row * correction;
        }
        sums
    }

    #[test]
    fn the_corrections_of_a_camera_are_learnt_and_kept() {
        let truth = [2.0, 6.0, 12.0, 18.0, 20.0, 14.0, 6.0];
        let mut learnt = LearntCurve::default();
        (0..40).for_each(|_| learnt.learn(Some(&sums(&truth))));
        let is_near = |learnt: &LearntCurve| learnt.bend().iter().zip(&truth).all(|(own, truth)| (own - truth).abs() < 1.0);
        assert!(is_near(&learnt), "{:?}", learnt.bend());
        let mut begun = LearntCurve::begun_with(*learnt.bend());
        begun.learn(Some(&CurveSums::default()));
        assert!(is_near(&begun), "{:?}", begun.bend());
    }

    #[test]
    fn greys_that_no_frame_shows_stay_near_their_neighbours() {
        let truth = [2.0, 6.0, 12.0, 18.0, 20.0, 14.0, 6.0];
        let mut learnt = LearntCurve::default();
        let mut shown = sums(&truth);
        for k in 4..KNOTS {
            (0..KNOTS).for_each(|j| (shown.by_each_other[(k, j)], shown.by_each_other[(j, k)]) = (0.0, 0.0));
            shown.by_correction[k] = 0.0;
        }
        (0..40).for_each(|_| learnt.learn(Some(&shown)));
        assert!(learnt.bend()[4..].iter().all(|bend| (-10.0..40.0).contains(bend)), "{:?}", learnt.bend());
    }

    #[test]
    fn one_frame_in_several_is_asked() {
        let mut learnt = LearntCurve::default();
        let mut asked = 0;
        for _ in 0..40 {
            let sums = learnt.is_due().then(CurveSums::default);
            asked += u32::from(sums.is_some());
            learnt.learn(sums.as_ref());
        }
        assert!(asked > 1 && asked <= TUNING.first_curve_frames + 40 / TUNING.curve_interval_frames, "{asked}");
    }
}
