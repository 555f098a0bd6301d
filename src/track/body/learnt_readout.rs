//! Learns the readout time of a camera from tracked frames if it is not configured, and checks a
//! configured one.
//!
//! Every followed frame that moves is asked which readout time its rows fit. The last frames are
//! averaged robustly (`agreement`); the tracker then uses the average with a sigma that includes
//! the frames' disagreement, the model's error and nonlinearity. Until enough frames have been
//! asked, it uses what was known before.

use crate::track::body::tuning::TUNING;
use std::collections::VecDeque;

use super::agreement::{Agreement, AgreementBuffers, FrameValue};
use super::learnt_camera::LearntTime;
use super::shutter_news::ShutterNews;
use crate::track::align::ShutterClue;

/// Sigma of a readout time about which nothing is known, around 0, seconds. Raised, first poses of
/// moving cameras are less certain; lowered, slow sensors contradict it.
const UNKNOWN_SIGMA_S: f64 = 0.02;

/// How well the readout time is known when a frame arrives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadoutDoubt {
    /// One sigma, seconds; 0 if it is configured.
    pub sigma_s: f64,
    /// Whether a frame should be asked although the readout is configured.
    pub is_check_due: bool,
}

impl ReadoutDoubt {
    /// Returns the speed of a frame if the frame is to be asked; `None` otherwise. `speed_px_s` is
    /// evaluated only if needed.
    pub fn query_speed_px_s(&self, speed_px_s: impl FnOnce() -> f64) -> Option<f64> {
        if self.sigma_s == 0.0 && !self.is_check_due {
            return None;
        }
        let speed_px_s = speed_px_s();
        let by_check = self.is_check_due && speed_px_s > TUNING.min_readout_check_speed_px_s;
        (by_check || self.sigma_s * speed_px_s > TUNING.min_readout_row_shift_px).then_some(speed_px_s)
    }

    /// Returns the speed above which the readout's sigma displaces the rows of a frame noticeably,
    /// pixels per second; `None` if the readout is configured.
    pub fn noticed_speed_px_s(&self) -> Option<f64> {
        (self.sigma_s > 0.0).then(|| TUNING.min_readout_row_shift_px / self.sigma_s)
    }

    /// Whether, at this speed, a jump in velocity could explain the possible readout error.
    pub fn is_open(&self, speed_px_s: f64) -> bool {
        self.sigma_s * speed_px_s > TUNING.max_jump_row_shift_px
    }
}

/// A readout time and its sigma, seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadoutEstimate {
    /// Seconds; negative if rows are read from the bottom up.
    pub readout_s: f64,
    /// One sigma, seconds; 0 if it is configured.
    pub sigma_s: f64,
}

impl ReadoutEstimate {
    /// Returns it as a learnt time.
    pub fn as_time(&self) -> LearntTime {
        LearntTime { seconds: self.readout_s, sigma_s: self.sigma_s }
    }

    /// State before the first frame of an unknown camera.
    const UNKNOWN: Self = Self { readout_s: 0.0, sigma_s: UNKNOWN_SIGMA_S };

    /// Whether it is known well enough to be relied on.
    pub fn is_sure(&self) -> bool {
        self.sigma_s < TUNING.max_known_readout_sigma_s.max(TUNING.max_known_readout_sigma_ratio * self.readout_s.abs())
    }
}

/// What one frame said, with the readout and speed at which it was solved.
#[derive(Debug, Clone, Copy)]
struct FrameReadout {
    readout_s: f64,
    variance_s2: f64,
    used_s: f64,
    speed_px_s: f64,
}

/// What the remembered frames alone imply.
#[derive(Debug, Clone, Copy)]
struct Found {
    readout: ReadoutEstimate,
    /// Sigma if the readout in use is the true one, seconds: excludes the linearisation error,
    /// which is then zero.
    sigma_of_no_change_s: f64,
}

/// What is known of the readout time, and what the last frames said of it.
#[derive(Debug, Clone)]
pub struct LearntReadout {
    /// The configured value; `None` if the readout is learnt.
    configured_s: Option<f64>,
    before: ReadoutEstimate,
    frame_readouts: VecDeque<FrameReadout>,
    values: Vec<FrameValue>,
    buffers: AgreementBuffers,
    used: ReadoutEstimate,
    /// The remaining effect of recent changes on the motion, seconds.
    settling_s: f64,
    frames: u32,
    news: Option<ShutterNews>,
    has_reported_news: bool,
}

impl LearntReadout {
    /// Creates the state. `configured_s`: the configured readout time, if any; `learnt`: otherwise,
    /// what an earlier session learnt.
    pub fn new(configured_s: Option<f64>, learnt: Option<ReadoutEstimate>) -> Self {
        let before =
            configured_s.map_or(learnt.unwrap_or(ReadoutEstimate::UNKNOWN), |readout_s| ReadoutEstimate { readout_s, sigma_s: 0.0 });
        Self {
            configured_s,
            before,
            frame_readouts: VecDeque::with_capacity(TUNING.max_readout_frames),
            values: Vec::with_capacity(TUNING.max_readout_frames),
            buffers: AgreementBuffers::with_capacity(TUNING.max_readout_frames),
            used: before,
            settling_s: 0.0,
            frames: 0,
            news: None,
            has_reported_news: before.is_sure() && configured_s.is_none(),
        }
    }

    /// Restarts with what an earlier session learnt; a configured value stays.
    pub fn begun_with(&self, learnt: Option<ReadoutEstimate>) -> Self {
        Self::new(self.configured_s, learnt)
    }

    /// Returns what frames of this or an earlier session taught; `None` if the readout is
    /// configured or unknown.
    pub fn learnt(&self) -> Option<ReadoutEstimate> {
        Some(self.used).filter(|used| self.configured_s.is_none() && used.sigma_s < 0.5 * UNKNOWN_SIGMA_S)
    }

    /// Returns the readout time to track with.
    pub fn used(&self) -> ReadoutEstimate {
        self.used
    }

    /// Returns the sigma of the readout's effect on poses, seconds; includes the remaining effect
    /// of recent changes.
    pub fn sigma_s(&self) -> f64 {
        self.used.sigma_s.hypot(self.settling_s)
    }

    /// Advances by one frame and returns how well the readout is known for it.
    pub fn next_doubt(&mut self) -> ReadoutDoubt {
        self.frames = self.frames.wrapping_add(1);
        self.settling_s =
            if self.settling_s > TUNING.min_readout_change_effect_s { TUNING.readout_change_decay * self.settling_s } else { 0.0 };
        let is_suspected = self.frame_readouts.len() >= TUNING.min_agreement_frames && self.contradicts_roughly();
        let is_check_due = self.configured_s.is_some()
            && (self.frames.is_multiple_of(TUNING.readout_check_interval_frames) || is_suspected)
            && !self.has_reported_news;
        ReadoutDoubt { sigma_s: self.sigma_s(), is_check_due }
    }

    /// Returns the news, once.
    pub fn news(&mut self) -> Option<ShutterNews> {
        self.news.take()
    }

    /// Takes what a frame says that was solved with the used readout time. `interval_s`: between
    /// frames, an upper bound of the readout time.
    pub fn update(&mut self, clue: &ShutterClue, interval_s: f64) {
        let (used_s, readout, shown) = (self.used.readout_s, clue.readout.clue, clue.readout.shown);
        let information = readout.information * shown.powi(2);
        // NaN where a frame has no information at all.
        let tells = information > TUNING.max_vague_readout_sigma_s.powi(-2) && information.is_finite();
        if !tells || !readout.score.is_finite() || shown < TUNING.min_shown_readout_ratio {
            return;
        }
        if self.frame_readouts.len() == TUNING.max_readout_frames {
            self.frame_readouts.pop_front();
        }
        let readout_s = used_s + readout.score / readout.information / shown;
        self.frame_readouts.push_back(FrameReadout { readout_s, variance_s2: information.recip(), used_s, speed_px_s: clue.speed_px_s });
        // Once there are many, a single frame changes little, so the average is updated once per
        // block.
        let is_time = self.frame_readouts.len() < 10 * TUNING.agreement_block_frames
            || self.frames.is_multiple_of(TUNING.agreement_block_frames as u32);
        if let Some(found) = is_time.then(|| self.found()).flatten() {
            match self.configured_s {
                Some(configured_s) => self.compare(configured_s, found.readout),
                None => self.learn(found, interval_s),
            }
        }
    }

    fn found(&mut self) -> Option<Found> {
        let used_s = self.used.readout_s;
        self.values.clear();
        let unlinear = |t: &FrameReadout| (TUNING.readout_linearisation_error * (t.used_s - used_s)).powi(2);
        self.values.extend(self.frame_readouts.iter().map(|t| FrameValue::new(t.readout_s, t.variance_s2 + unlinear(t))));
        if self.values.len() < TUNING.agreement_block_frames {
            return None;
        }
        let Agreement { value, sigma, frames } = self.buffers.agreement(&self.values);
        // With few blocks, the block scatter is unreliable; with a single one it is zero.
        let blocks = frames as f64 / TUNING.agreement_block_frames as f64;
        let of_one = 1.4826 * self.buffers.weighted_median(self.values.iter().map(|s| ((s.x - value).abs(), 1.0)));
        let by_scatter = sigma.max(of_one / blocks.sqrt()) * (1.0 + 2.0 / blocks);
        let by_noise = self.values.iter().map(|s| s.y.recip()).sum::<f64>().powf(-0.5);
        let speed_px_s = self.buffers.weighted_median(self.frame_readouts.iter().map(|t| (t.speed_px_s, 1.0)));
        let by_model = TUNING.row_model_error_px / speed_px_s.max(f64::MIN_POSITIVE);
        let weight = self.values.iter().map(|s| s.y.recip()).sum::<f64>();
        let mean_used_s = self.frame_readouts.iter().zip(&self.values).map(|(t, s)| t.used_s / s.y).sum::<f64>() / weight;
        let by_curvature = TUNING.readout_linearisation_error * (value - mean_used_s);
        let sigma_of_no_change_s = by_scatter.max(by_noise).hypot(by_model);
        let sigma_s = sigma_of_no_change_s.hypot(by_curvature);
        tracing::trace!(value, by_scatter, by_noise, by_model, by_curvature, frames, "readout");
        (value.is_finite() && sigma_s.is_finite())
            .then_some(Found { readout: ReadoutEstimate { readout_s: value, sigma_s }, sigma_of_no_change_s })
    }

    fn learn(&mut self, found: Found, interval_s: f64) {
        let Found { readout: found, sigma_of_no_change_s } = found;
        if contradict(self.before, found) {
            // Another mode or another camera: the earlier value does not apply.
            self.before = ReadoutEstimate::UNKNOWN;
        }
        let [old, new] = [self.before.sigma_s, found.sigma_s].map(|sigma| sigma.powi(-2));
        let sigma_s = (old + new).powf(-0.5);
        let readout_s = (old * self.before.readout_s + new * found.readout_s) / (old + new);
        if readout_s.abs() > interval_s && interval_s > 0.0 {
            // Readout times longer than the frame interval are impossible: something else displaces
            // the rows, such as a poor calibration or a bent picture.
            tracing::debug!(readout_s, interval_s, "no readout fits");
            (self.used, self.before) = (ReadoutEstimate::UNKNOWN, ReadoutEstimate::UNKNOWN);
            self.frame_readouts.clear();
            return;
        }
        // Once a readout time is in use, a later increase of sigma does not reset it to zero.
        let unsure_s = if self.used.readout_s == 0.0 { 3.0 * sigma_of_no_change_s } else { 0.0 };
        let is_none = readout_s.abs() < TUNING.min_rolling_readout_s.max(unsure_s);
        let goal_s = if is_none { 0.0 } else { readout_s };
        let step_s = goal_s - self.used.readout_s;
        if step_s.abs() > TUNING.readout_update_sigmas * sigma_s {
            // Changes at once: with a readout that is too short by a factor, the estimated velocity
            // is too large by that factor.
            self.used.readout_s = goal_s;
            self.settling_s += step_s.abs();
        }
        // The difference between the found and the used value counts as uncertainty.
        self.used.sigma_s = sigma_s.hypot(readout_s - self.used.readout_s);
        if self.used.is_sure() && !self.has_reported_news && self.frame_readouts.len() >= 2 * TUNING.min_agreement_frames {
            self.has_reported_news = true;
            self.news = Some(ShutterNews::ReadoutLearnt(self.used.as_time()));
        }
    }

    fn contradicts_roughly(&self) -> bool {
        let off = |t: &FrameReadout| ((t.readout_s - t.used_s).abs() > TUNING.min_readout_contradiction_s, t.readout_s > t.used_s);
        let count = |above: bool| self.frame_readouts.iter().filter(|t| off(t) == (true, above)).count();
        3 * count(true).max(count(false)) > 2 * self.frame_readouts.len()
    }

    fn compare(&mut self, configured_s: f64, found: ReadoutEstimate) {
        if !self.has_reported_news && self.frame_readouts.len() >= 2 * TUNING.min_agreement_frames && contradict(self.before, found) {
            self.has_reported_news = true;
            self.news = Some(ShutterNews::ReadoutContradicted { configured_s, found: found.as_time() });
            // The configured value stays in use, but with a sigma.
            self.used.sigma_s = (found.readout_s - configured_s).abs();
        }
    }
}

/// Whether the found value is incompatible with what was known before.
fn contradict(before: ReadoutEstimate, found: ReadoutEstimate) -> bool {
    let off_s = (found.readout_s - before.readout_s).abs();
    off_s > TUNING.min_readout_contradiction_sigmas * found.sigma_s.hypot(before.sigma_s)
        && off_s > TUNING.min_readout_contradiction_s.max(TUNING.min_readout_contradiction_ratio * before.readout_s.abs())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::MotionError;
    use crate::track::align::{Clue, ReadoutClue};

    const INTERVAL_S: f64 = 1.0 / 30.0;

    /// Returns the clue of a frame that was read in `true_s` and solved with `used_s`, with an
    /// error, at a speed in pixels per second.
    fn clue(true_s: f64, used_s: f64, error_s: f64, speed_px_s: f64) -> ShutterClue {
        let information = (0.1 / speed_px_s).powi(-2);
        let clue = Clue { score: 0.5 * (true_s + error_s - used_s) * information, information };
        let readout = ReadoutClue { clue, shown: 0.5, motion_by_readout: MotionError::zeros() };
        ShutterClue { readout, speed_px_s, exposure: None, is_open: true, may_teach: true }
    }

    /// Rows that show nothing of the readout leave 0 information, or none that is a number.
    #[test]
    fn a_frame_without_information_is_ignored() {
        let mut learnt = LearntReadout::new(None, None);
        for information in [0.0, -0.0, f64::INFINITY, f64::NAN] {
            let clue = Clue { score: 1.0, information };
            let readout = ReadoutClue { clue, shown: f64::INFINITY, motion_by_readout: MotionError::zeros() };
            learnt.update(&ShutterClue { readout, speed_px_s: 300.0, exposure: None, is_open: true, may_teach: true }, INTERVAL_S);
        }
        (0..60).for_each(|_| learnt.update(&clue(0.015, learnt.used().readout_s, 0.0, 300.0), INTERVAL_S));
        assert!((learnt.used().readout_s - 0.015).abs() < 1e-3, "{:?}", learnt.used());
    }

    /// Feeds frames of a shaken camera; the errors mimic noise.
    fn shaken(learnt: &mut LearntReadout, true_s: f64, frames: u32) {
        for k in 0..frames {
            learnt.next_doubt();
            let speed_px_s = 150.0 + 100.0 * f64::from(k % 4);
            let error_s = 4e-4 * (f64::from((k * 7) % 11) / 5.0 - 1.0);
            learnt.update(&clue(true_s, learnt.used().readout_s, error_s, speed_px_s), INTERVAL_S);
        }
    }

    #[test]
    fn a_shaken_camera_reveals_its_readout_within_its_sigma() {
        for true_s in [0.0, 0.005, 0.012, 0.02, 0.03, -0.015] {
            let mut learnt = LearntReadout::new(None, None);
            assert_eq!(learnt.learnt(), None);
            shaken(&mut learnt, true_s, 60);
            let ReadoutEstimate { readout_s, sigma_s } = learnt.used();
            assert!(learnt.used().is_sure() && (readout_s - true_s).abs() < 3.0 * sigma_s, "{true_s}: {readout_s} +- {sigma_s}");
            assert!((readout_s - true_s).abs() < 5e-4, "{true_s}: {readout_s}");
            assert!(matches!(learnt.news(), Some(ShutterNews::ReadoutLearnt(_))) && learnt.news().is_none(), "it is said once");
        }
    }

    #[test]
    fn a_short_shake_is_not_mistaken_for_a_long_one() {
        let mut learnt = LearntReadout::new(None, None);
        shaken(&mut learnt, 0.02, TUNING.agreement_block_frames as u32 - 1);
        assert_eq!(learnt.used(), ReadoutEstimate::UNKNOWN);
        shaken(&mut learnt, 0.02, 4);
        let ReadoutEstimate { readout_s, sigma_s } = learnt.used();
        assert!((readout_s - 0.02).abs() < 2.0 * sigma_s && sigma_s > 5e-4, "{readout_s} +- {sigma_s}");
        assert_eq!(learnt.news(), None, "nine frames do not settle it");
    }

    #[test]
    fn a_readout_is_used_once_it_is_clearly_not_zero() {
        // A few frames that agree to a tenth: the possible linearisation error is no evidence for
        // zero.
        let mut learnt = LearntReadout::new(None, None);
        for k in 0..TUNING.agreement_block_frames + 2 {
            learnt.next_doubt();
            let error_s = if k % 2 == 0 { 6e-4 } else { -6e-4 };
            learnt.update(&clue(0.008, learnt.used().readout_s, error_s, 300.0), INTERVAL_S);
        }
        let ReadoutEstimate { readout_s, sigma_s } = learnt.used();
        assert!(readout_s > 0.005 && sigma_s < 0.008, "{readout_s} +- {sigma_s}");
    }

    #[test]
    fn an_impossible_readout_is_not_adopted() {
        let mut learnt = LearntReadout::new(None, None);
        shaken(&mut learnt, 0.06, 100);
        assert!(learnt.used().sigma_s > 0.01 && learnt.news().is_none(), "{:?}", learnt.used());
    }

    #[test]
    fn only_a_wrong_configured_readout_is_reported_and_doubted() {
        let mut wrong = LearntReadout::new(Some(0.01), None);
        shaken(&mut wrong, 0.02, 60);
        let news = wrong.news();
        assert!(matches!(news, Some(ShutterNews::ReadoutContradicted { found, .. }) if (found.seconds - 0.02).abs() < 1e-3), "{news:?}");
        assert_eq!((wrong.used().readout_s, wrong.news(), wrong.learnt()), (0.01, None, None));
        assert!((wrong.used().sigma_s - 0.01).abs() < 1e-3);
        let mut right = LearntReadout::new(Some(0.02), None);
        shaken(&mut right, 0.0204, 300);
        assert_eq!((right.news(), right.used()), (None, ReadoutEstimate { readout_s: 0.02, sigma_s: 0.0 }));
    }

    #[test]
    fn a_learnt_readout_is_used_until_contradicted() {
        let before = ReadoutEstimate { readout_s: 0.02, sigma_s: 2e-4 };
        let mut learnt = LearntReadout::new(None, Some(before));
        assert_eq!((learnt.used(), learnt.learnt()), (before, Some(before)));
        shaken(&mut learnt, 0.02, 60);
        assert!((learnt.used().readout_s - 0.02).abs() < 3e-4 && learnt.news().is_none());
        let mut other = LearntReadout::new(None, Some(before));
        shaken(&mut other, 0.01, 100);
        assert!((other.used().readout_s - 0.01).abs() < 5e-4, "{:?}", other.used());
    }

    #[test]
    fn a_still_camera_is_not_asked_for_its_readout() {
        let mut learnt = LearntReadout::new(None, None);
        assert!(learnt.next_doubt().query_speed_px_s(|| 2.0).is_none() && learnt.next_doubt().query_speed_px_s(|| 200.0).is_some());
        let mut configured = LearntReadout::new(Some(0.01), None);
        let asked = (0..80).filter(|_| configured.next_doubt().query_speed_px_s(|| 200.0).is_some()).count();
        assert_eq!(asked, 10);
        assert!((0..80).all(|_| configured.next_doubt().query_speed_px_s(|| 20.0).is_none()));
    }
}
