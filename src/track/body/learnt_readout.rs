//! The readout of a camera whose readout is not configured, from the frames that are tracked; and whether a configured one can be right.
//!
//! Every followed frame that moves is asked which readout its rows fit. What the last frames say is averaged robustly; from that average on the tracker uses it, with
//! a sigma: of the frames' disagreement, of what the model may be off, and of what was not linear. Until frames say enough, it is what was known before.

use std::collections::VecDeque;

use super::agreement::{Agreement, AgreementBuffers, BLOCK, MIN_FRAMES, Said};
use super::learnt_camera::LearntTime;
use super::shutter_news::ShutterNews;
use crate::track::align::ShutterClue;

/// Frames whose own answer is no better than this, one sigma in seconds, tell nothing: about the readout of a usual sensor. Raised, still frames count, which only
/// tell of the model's errors; lowered, slow clips give no answer.
pub const VAGUE_READOUT_S: f64 = 0.01;
/// What the rows of a frame may be displaced by for other reasons than the readout, in all frames alike, pixels, one sigma: fog, gels, people, a lens that is a little
/// off. Chosen: two slow clips with a global shutter seemed to be read in 1.0 and 1.3 ms, which was 0.10 and 0.08 pixels. Raised, slow clips tell
/// nothing; lowered, a config gets a readout that the camera does not have.
pub const MODEL_ERROR_PX: f64 = 0.05;
/// One sigma of a readout of which nothing is known, about 0, seconds: sensors have 0 to 33 ms. Raised, first poses of moving cameras are less sure.
const UNKNOWN_SIGMA_S: f64 = 0.02;
/// Frames that are remembered: eight seconds of motion at 30 a second. Raised, the first frames, which were solved with another readout, count for longer.
const MAX_FRAMES: usize = 240;
/// Share of a step of the readout that its linearisation may be wrong by, one sigma. Raised, the readout is known later; lowered, first answers pass for sure ones.
pub const CURVATURE: f64 = 0.25;
/// Frames in which less of a change shows tell nothing. Raised, cameras that are shaken evenly tell less; lowered, one frame's noise passes for a large change.
const MIN_SHOWN: f64 = 0.3;
/// The readout that is used follows what is found beyond this share of its sigma. Raised, it lags; lowered, poses are corrected in every frame.
const SHARE_OF_SIGMA: f64 = 0.2;
/// Share of a change that is still in the motion a frame later: it was learnt with the former readout. Raised, poses are less sure for longer after a change.
const SETTLING: f64 = 0.7;
/// Less counts as none, seconds.
const MIN_SETTLING_S: f64 = 1e-5;
/// Below this a readout counts as none, seconds: no sensor reads its rows faster. Raised, fast rolling shutters pass for global ones.
const FASTEST_READOUT_S: f64 = 5e-4;
/// A readout is known once one sigma is below this share of it, or below so many seconds. Raised, it is announced before it is sure.
const KNOWN_SHARE: f64 = 0.05;
const KNOWN_SIGMA_S: f64 = 5e-4;
/// A frame is asked where the readout's sigma displaces its rows by more, pixels. Raised, the readout stays less sure; lowered, slow frames cost more for nothing.
const ASKED_PX: f64 = 0.1;
/// Beyond this a velocity that jumps could pass for what a wrong readout does, pixels: frames are solved without. Raised, the readout is found less well; lowered,
/// starts and stops are followed less well until it is known.
const OPEN_PX: f64 = 0.1;
/// Sigmas beyond which frames contradict what was known before, and the least difference, seconds and share. A difference is itself in the sigma, by [`CURVATURE`], so that
/// these are 4.5 of the rest. Raised, wrong configs pass; lowered, right ones are blamed.
const CONTRADICTING_SIGMAS: f64 = 3.0;
const CONTRADICTING_S: f64 = 1e-3;
const CONTRADICTING_SHARE: f64 = 0.1;
/// Of a camera whose readout is configured, every so many-th frame is asked. Raised, wrong configs are noticed later; lowered, frames cost more.
const CHECKED_FRAMES: u32 = 8;
/// Such a frame is asked where it moves at least so fast, pixels per second. Lowered, slow frames are asked, which tell nothing.
const CHECKED_SPEED_PX_S: f64 = 100.0;

/// How well the readout is known when a frame comes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadoutDoubt {
    /// One sigma, seconds; 0 where it is configured.
    pub sigma_s: f64,
    /// Whether it is time to ask a frame although the readout is configured.
    pub is_check_due: bool,
}

impl ReadoutDoubt {
    /// Whether a frame that moves so fast is asked.
    pub fn asks(&self, speed_px_s: impl FnOnce() -> f64) -> Option<f64> {
        if self.sigma_s == 0.0 && !self.is_check_due {
            return None;
        }
        let speed_px_s = speed_px_s();
        let by_check = self.is_check_due && speed_px_s > CHECKED_SPEED_PX_S;
        (by_check || self.sigma_s * speed_px_s > ASKED_PX).then_some(speed_px_s)
    }

    /// Speed above which the readout's sigma displaces the rows of a frame noticeably, pixels per
    /// second; `None` where the readout is configured.
    pub fn noticed_speed_px_s(&self) -> Option<f64> {
        (self.sigma_s > 0.0).then(|| ASKED_PX / self.sigma_s)
    }

    /// Whether a velocity that jumps could explain what the readout may be wrong by, in a frame that moves so fast.
    pub fn is_open(&self, speed_px_s: f64) -> bool {
        self.sigma_s * speed_px_s > OPEN_PX
    }
}

/// A readout and one sigma of it, seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Known {
    /// Seconds; below 0: read from the bottom up.
    pub readout_s: f64,
    /// One sigma, seconds; 0 where it is configured.
    pub sigma_s: f64,
}

impl Known {
    /// The same as a time that was learnt.
    pub fn as_time(&self) -> LearntTime {
        LearntTime { seconds: self.readout_s, sigma_s: self.sigma_s }
    }

    /// Before the first frame of an unknown camera.
    const NOTHING: Self = Self { readout_s: 0.0, sigma_s: UNKNOWN_SIGMA_S };

    /// Whether it is known well enough to rely on.
    pub fn is_sure(&self) -> bool {
        self.sigma_s < KNOWN_SIGMA_S.max(KNOWN_SHARE * self.readout_s.abs())
    }
}

/// What one frame said.
#[derive(Debug, Clone, Copy)]
struct Told {
    readout_s: f64,
    variance_s2: f64,
    used_s: f64,
    speed_px_s: f64,
}

/// What the remembered frames say by themselves.
#[derive(Debug, Clone, Copy)]
struct Found {
    readout: Known,
    /// One sigma if the rows are in fact read with the readout that is in use, seconds: without
    /// the error of the linearisation, which is then zero.
    sigma_of_no_change_s: f64,
}

/// What is known of the readout, and what the last frames said of it.
#[derive(Debug, Clone)]
pub struct LearntReadout {
    /// As configured; `None` where it is learnt.
    configured_s: Option<f64>,
    before: Known,
    told: VecDeque<Told>,
    said: Vec<Said>,
    buffers: AgreementBuffers,
    used: Known,
    /// What of the last changes is still in the motion, seconds.
    settling_s: f64,
    frames: u32,
    news: Option<ShutterNews>,
    has_told_news: bool,
}

impl LearntReadout {
    /// `configured_s`: as configured; `learnt`: what an earlier session learnt, where it is not.
    pub fn new(configured_s: Option<f64>, learnt: Option<Known>) -> Self {
        let before = configured_s.map_or(learnt.unwrap_or(Known::NOTHING), |readout_s| Known { readout_s, sigma_s: 0.0 });
        Self {
            configured_s,
            before,
            told: VecDeque::with_capacity(MAX_FRAMES),
            said: Vec::with_capacity(MAX_FRAMES),
            buffers: AgreementBuffers::with_capacity(MAX_FRAMES),
            used: before,
            settling_s: 0.0,
            frames: 0,
            news: None,
            has_told_news: before.is_sure() && configured_s.is_none(),
        }
    }

    /// The same with what an earlier session learnt, where nothing is configured.
    pub fn begun_with(&self, learnt: Option<Known>) -> Self {
        Self::new(self.configured_s, learnt)
    }

    /// What is known of it by frames, of this session or an earlier one; `None` where it is configured or nothing is known.
    pub fn learnt(&self) -> Option<Known> {
        Some(self.used).filter(|used| self.configured_s.is_none() && used.sigma_s < 0.5 * UNKNOWN_SIGMA_S)
    }

    /// The readout to track with.
    pub fn used(&self) -> Known {
        self.used
    }

    /// One sigma of what the readout leaves open of poses, seconds: with what the last changes left in the motion.
    pub fn sigma_s(&self) -> f64 {
        self.used.sigma_s.hypot(self.settling_s)
    }

    /// Of the frame that comes now.
    pub fn next_doubt(&mut self) -> ReadoutDoubt {
        self.frames = self.frames.wrapping_add(1);
        self.settling_s = if self.settling_s > MIN_SETTLING_S { SETTLING * self.settling_s } else { 0.0 };
        let is_suspected = self.told.len() >= MIN_FRAMES && self.contradicts_roughly();
        let is_check_due =
            self.configured_s.is_some() && (self.frames.is_multiple_of(CHECKED_FRAMES) || is_suspected) && !self.has_told_news;
        ReadoutDoubt { sigma_s: self.sigma_s(), is_check_due }
    }

    /// What there is to say, once.
    pub fn news(&mut self) -> Option<ShutterNews> {
        self.news.take()
    }

    /// Takes what a frame says that was solved with the used readout. `interval_s`: between frames; no camera reads a frame for longer.
    pub fn hear(&mut self, clue: &ShutterClue, interval_s: f64) {
        let (used_s, readout, shown) = (self.used.readout_s, clue.readout.clue, clue.readout.shown);
        let information = readout.information * shown.powi(2);
        if information <= VAGUE_READOUT_S.powi(-2) || !readout.score.is_finite() || shown < MIN_SHOWN {
            return;
        }
        if self.told.len() == MAX_FRAMES {
            self.told.pop_front();
        }
        let readout_s = used_s + readout.score / readout.information / shown;
        self.told.push_back(Told { readout_s, variance_s2: information.recip(), used_s, speed_px_s: clue.speed_px_s });
        // Once there are many, single ones change little.
        let is_time = self.told.len() < 10 * BLOCK || self.frames.is_multiple_of(BLOCK as u32);
        if let Some(found) = is_time.then(|| self.found()).flatten() {
            match self.configured_s {
                Some(configured_s) => self.compare(configured_s, found.readout),
                None => self.learn(found, interval_s),
            }
        }
    }

    fn found(&mut self) -> Option<Found> {
        let used_s = self.used.readout_s;
        self.said.clear();
        let unlinear = |t: &Told| (CURVATURE * (t.used_s - used_s)).powi(2);
        self.said.extend(self.told.iter().map(|t| Said::new(t.readout_s, t.variance_s2 + unlinear(t))));
        if self.said.len() < BLOCK {
            return None;
        }
        let Agreement { value, sigma, frames } = self.buffers.agreement(&self.said);
        // Few blocks tell their own scatter poorly, and a single one does not.
        let blocks = frames as f64 / BLOCK as f64;
        let of_one = 1.4826 * self.buffers.weighted_median(self.said.iter().map(|s| ((s.x - value).abs(), 1.0)));
        let by_scatter = sigma.max(of_one / blocks.sqrt()) * (1.0 + 2.0 / blocks);
        let by_noise = self.said.iter().map(|s| s.y.recip()).sum::<f64>().powf(-0.5);
        let speed_px_s = self.buffers.weighted_median(self.told.iter().map(|t| (t.speed_px_s, 1.0)));
        let by_model = MODEL_ERROR_PX / speed_px_s.max(f64::MIN_POSITIVE);
        let weight = self.said.iter().map(|s| s.y.recip()).sum::<f64>();
        let mean_used_s = self.told.iter().zip(&self.said).map(|(t, s)| t.used_s / s.y).sum::<f64>() / weight;
        let by_curvature = CURVATURE * (value - mean_used_s);
        let sigma_of_no_change_s = by_scatter.max(by_noise).hypot(by_model);
        let sigma_s = sigma_of_no_change_s.hypot(by_curvature);
        tracing::trace!(value, by_scatter, by_noise, by_model, by_curvature, frames, "readout");
        (value.is_finite() && sigma_s.is_finite()).then_some(Found { readout: Known { readout_s: value, sigma_s }, sigma_of_no_change_s })
    }

    fn learn(&mut self, found: Found, interval_s: f64) {
        let Found { readout: found, sigma_of_no_change_s } = found;
        if contradict(self.before, found) {
            // Another mode, or another camera: it says nothing of this one.
            self.before = Known::NOTHING;
        }
        let [old, new] = [self.before.sigma_s, found.sigma_s].map(|sigma| sigma.powi(-2));
        let sigma_s = (old + new).powf(-0.5);
        let readout_s = (old * self.before.readout_s + new * found.readout_s) / (old + new);
        if readout_s.abs() > interval_s && interval_s > 0.0 {
            // What the rows disagree about is not the shutter: a poor calibration, a picture that bends.
            tracing::debug!(readout_s, interval_s, "no readout fits");
            (self.used, self.before) = (Known::NOTHING, Known::NOTHING);
            self.told.clear();
            return;
        }
        // Once it is used, a frame that makes it less sure again does not take it back.
        let unsure_s = if self.used.readout_s == 0.0 { 3.0 * sigma_of_no_change_s } else { 0.0 };
        let is_none = readout_s.abs() < FASTEST_READOUT_S.max(unsure_s);
        let goal_s = if is_none { 0.0 } else { readout_s };
        let step_s = goal_s - self.used.readout_s;
        if step_s.abs() > SHARE_OF_SIGMA * sigma_s {
            // At once: rows that are taken to be read in a part of their time show a velocity that is as many times too large.
            self.used.readout_s = goal_s;
            self.settling_s += step_s.abs();
        }
        // What is found and not used yet is not known.
        self.used.sigma_s = sigma_s.hypot(readout_s - self.used.readout_s);
        if self.used.is_sure() && !self.has_told_news && self.told.len() >= 2 * MIN_FRAMES {
            self.has_told_news = true;
            self.news = Some(ShutterNews::ReadoutLearnt(self.used.as_time()));
        }
    }

    fn contradicts_roughly(&self) -> bool {
        let off = |t: &Told| ((t.readout_s - t.used_s).abs() > CONTRADICTING_S, t.readout_s > t.used_s);
        let count = |above: bool| self.told.iter().filter(|t| off(t) == (true, above)).count();
        3 * count(true).max(count(false)) > 2 * self.told.len()
    }

    fn compare(&mut self, configured_s: f64, found: Known) {
        if !self.has_told_news && self.told.len() >= 2 * MIN_FRAMES && contradict(self.before, found) {
            self.has_told_news = true;
            self.news = Some(ShutterNews::ReadoutContradicted { configured_s, found: found.as_time() });
            // It is used all the same, but no longer believed.
            self.used.sigma_s = (found.readout_s - configured_s).abs();
        }
    }
}

/// Whether what is found cannot be what was known before.
fn contradict(before: Known, found: Known) -> bool {
    let off_s = (found.readout_s - before.readout_s).abs();
    off_s > CONTRADICTING_SIGMAS * found.sigma_s.hypot(before.sigma_s)
        && off_s > CONTRADICTING_S.max(CONTRADICTING_SHARE * before.readout_s.abs())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::MotionError;
    use crate::track::align::{Clue, ReadoutClue};

    const INTERVAL_S: f64 = 1.0 / 30.0;

    /// What a frame says that was read in `true_s` and solved with `used_s`, with an error; it moves by so many pixels per second.
    fn clue(true_s: f64, used_s: f64, error_s: f64, speed_px_s: f64) -> ShutterClue {
        let information = (0.1 / speed_px_s).powi(-2);
        let clue = Clue { score: 0.5 * (true_s + error_s - used_s) * information, information };
        let readout = ReadoutClue { clue, shown: 0.5, motion_by_readout: MotionError::zeros() };
        ShutterClue { readout, speed_px_s, exposure: None, is_open: true, may_teach: true }
    }

    /// After so many frames of a camera that is shaken; the errors are those of noise.
    fn shaken(learnt: &mut LearntReadout, true_s: f64, frames: u32) {
        for k in 0..frames {
            learnt.next_doubt();
            let speed_px_s = 150.0 + 100.0 * f64::from(k % 4);
            let error_s = 4e-4 * (f64::from((k * 7) % 11) / 5.0 - 1.0);
            learnt.hear(&clue(true_s, learnt.used().readout_s, error_s, speed_px_s), INTERVAL_S);
        }
    }

    #[test]
    fn a_shaken_camera_teaches_its_readout_within_its_sigma() {
        for true_s in [0.0, 0.005, 0.012, 0.02, 0.03, -0.015] {
            let mut learnt = LearntReadout::new(None, None);
            assert_eq!(learnt.learnt(), None);
            shaken(&mut learnt, true_s, 60);
            let Known { readout_s, sigma_s } = learnt.used();
            assert!(learnt.used().is_sure() && (readout_s - true_s).abs() < 3.0 * sigma_s, "{true_s}: {readout_s} +- {sigma_s}");
            assert!((readout_s - true_s).abs() < 5e-4, "{true_s}: {readout_s}");
            assert!(matches!(learnt.news(), Some(ShutterNews::ReadoutLearnt(_))) && learnt.news().is_none(), "it is said once");
        }
    }

    #[test]
    fn a_short_shake_does_not_pass_for_a_long_one() {
        let mut learnt = LearntReadout::new(None, None);
        shaken(&mut learnt, 0.02, BLOCK as u32 - 1);
        assert_eq!(learnt.used(), Known::NOTHING);
        shaken(&mut learnt, 0.02, 4);
        let Known { readout_s, sigma_s } = learnt.used();
        assert!((readout_s - 0.02).abs() < 2.0 * sigma_s && sigma_s > 5e-4, "{readout_s} +- {sigma_s}");
        assert_eq!(learnt.news(), None, "nine frames do not settle it");
    }

    #[test]
    fn a_readout_is_used_once_it_is_clearly_not_zero() {
        // Few frames agree to a tenth: what the linearisation may be wrong by does not speak for zero.
        let mut learnt = LearntReadout::new(None, None);
        for k in 0..BLOCK + 2 {
            learnt.next_doubt();
            let error_s = if k % 2 == 0 { 6e-4 } else { -6e-4 };
            learnt.hear(&clue(0.008, learnt.used().readout_s, error_s, 300.0), INTERVAL_S);
        }
        let Known { readout_s, sigma_s } = learnt.used();
        assert!(readout_s > 0.005 && sigma_s < 0.008, "{readout_s} +- {sigma_s}");
    }

    #[test]
    fn what_no_camera_has_is_not_believed() {
        let mut learnt = LearntReadout::new(None, None);
        shaken(&mut learnt, 0.06, 100);
        assert!(learnt.used().sigma_s > 0.01 && learnt.news().is_none(), "{:?}", learnt.used());
    }

    #[test]
    fn a_wrong_config_is_said_once_and_doubted_and_a_right_one_is_not() {
        let mut wrong = LearntReadout::new(Some(0.01), None);
        shaken(&mut wrong, 0.02, 60);
        let news = wrong.news();
        assert!(matches!(news, Some(ShutterNews::ReadoutContradicted { found, .. }) if (found.seconds - 0.02).abs() < 1e-3), "{news:?}");
        assert_eq!((wrong.used().readout_s, wrong.news(), wrong.learnt()), (0.01, None, None));
        assert!((wrong.used().sigma_s - 0.01).abs() < 1e-3);
        let mut right = LearntReadout::new(Some(0.02), None);
        shaken(&mut right, 0.0204, 300);
        assert_eq!((right.news(), right.used()), (None, Known { readout_s: 0.02, sigma_s: 0.0 }));
    }

    #[test]
    fn what_was_learnt_before_is_used_from_the_first_frame_until_frames_contradict_it() {
        let before = Known { readout_s: 0.02, sigma_s: 2e-4 };
        let mut learnt = LearntReadout::new(None, Some(before));
        assert_eq!((learnt.used(), learnt.learnt()), (before, Some(before)));
        shaken(&mut learnt, 0.02, 60);
        assert!((learnt.used().readout_s - 0.02).abs() < 3e-4 && learnt.news().is_none());
        let mut other = LearntReadout::new(None, Some(before));
        shaken(&mut other, 0.01, 100);
        assert!((other.used().readout_s - 0.01).abs() < 5e-4, "{:?}", other.used());
    }

    #[test]
    fn a_still_camera_is_not_asked() {
        let mut learnt = LearntReadout::new(None, None);
        assert!(learnt.next_doubt().asks(|| 2.0).is_none() && learnt.next_doubt().asks(|| 200.0).is_some());
        let mut configured = LearntReadout::new(Some(0.01), None);
        let asked = (0..80).filter(|_| configured.next_doubt().asks(|| 200.0).is_some()).count();
        assert_eq!(asked, 10);
        assert!((0..80).all(|_| configured.next_doubt().asks(|| 20.0).is_none()));
    }
}
