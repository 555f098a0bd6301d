//! How far to trust a measured delay.

use super::measure::Delay;
use crate::calibrate::judge::Verdict;

/// Sigma of a good and of a useful delay, seconds. At 60 degrees per second and 60 degrees across
/// 1920 pixels, a millisecond shifts the picture by 2 pixels, and an eye that turns a knob finds
/// the delay to half a frame. Raised, worse delays pass.
const GOOD_S: f64 = 0.001;
const USELESS_S: f64 = 0.005;
/// How many times more must stay unexplained at every other shift, for a good and for a useful
/// delay. Chosen: pans by hand reach 20 and more. Raised, motions that nearly repeat are refused;
/// lowered, the delay may be a period off.
const GOOD_FACTOR: f64 = 10.0;
const USELESS_FACTOR: f64 = 3.0;
/// Unexplained share of the rotation above which the two motions differ by more than noise.
/// Chosen, not tuned. Raised, a loose mount goes unmentioned.
const ODD_UNEXPLAINED: f64 = 0.05;
/// Ratio of the turn rates that a lens or a loose mount may cause, and one that it cannot. Chosen:
/// guessed lenses are off by a tenth. Raised, wrong fields of view go unmentioned.
const ODD_GAIN: f64 = 1.15;
const IMPOSSIBLE_GAIN: f64 = 2.0;
/// Difference of the delay between the halves of the clip in sigmas, and the least in seconds, that
/// is no chance. Raised, clocks that drift go unmentioned.
const ODD_DRIFT: f64 = 4.0;
const MIN_DRIFT_S: f64 = 0.001;

/// What to film; ends the sentences of refusals.
const PAN: &str = "pan to and fro sharply, at 20 degrees per second or more, with halts of different lengths";

/// Returns the verdict with its reasons, one sentence each.
pub fn judge(delay: &Delay) -> (Verdict, Vec<String>) {
    let mut findings: Vec<(Verdict, String)> = Vec::new();
    let mut find = |is_useless: bool, text: String| findings.push((if is_useless { Verdict::DoNotUse } else { Verdict::Usable }, text));
    let sigma_s = worst_if_nan(delay.sigma_s);
    if sigma_s > GOOD_S {
        find(sigma_s > USELESS_S, format!("the delay is known to {:.1} ms only (one sigma): {PAN}", sigma_s * 1e3));
    }
    let near: Vec<_> = delay.rivals.iter().filter(|rival| rival.factor < GOOD_FACTOR).collect();
    if let Some(best) = near.first() {
        let all: Vec<String> = near.iter().map(|rival| format!("{:+.3} s", rival.delay_s)).collect();
        find(best.factor < USELESS_FACTOR, format!("the motion repeats itself, so {} would fit nearly as well: {PAN}", all.join(" or ")));
    }
    if delay.unexplained > ODD_UNEXPLAINED {
        let share = delay.unexplained * 100.0;
        find(false, format!("{share:.0} % of the rotation is not common to both cameras: are both bolted to the same rig?"));
    }
    let gain = worst_if_nan(delay.gain.max(1.0 / delay.gain));
    if gain > ODD_GAIN {
        let ratio = delay.gain;
        let text = format!(
            "the second camera seems to turn {ratio:.2} times as fast as the first: check `fov_deg`, the calibrations and the mount"
        );
        find(gain > IMPOSSIBLE_GAIN, text);
    }
    if let Some([drift, sigma]) = delay.drift_s.filter(|[drift, sigma]| drift.abs() > MIN_DRIFT_S.max(ODD_DRIFT * sigma)) {
        let (ms, sigma_ms) = (drift * 1e3, sigma * 1e3);
        let text = format!(
            "the delay changes by {ms:+.1} ms within the clip (sigma {sigma_ms:.1} ms): are frames lost, or are the stamps made from a frame rate?"
        );
        find(drift.abs() > USELESS_S, text);
    }
    let verdict = findings.iter().map(|(verdict, _)| *verdict).max().unwrap_or(Verdict::Good);
    (verdict, findings.into_iter().map(|(_, text)| text).collect())
}

/// Replaces what is no number by the worst one.
fn worst_if_nan(value: f64) -> f64 {
    if value.is_nan() { f64::INFINITY } else { value }
}
