//! How far to trust the delay of stamps that a filmed clock shows.

use super::lateness::Lateness;
use crate::calibrate::judge::Verdict;

/// Sigma of a good and of a useful delay, seconds: as for the delay between cameras, and a frame of
/// most cameras. Raised, worse delays pass.
const GOOD_S: f64 = 0.001;
const USELESS_S: f64 = 0.025;
/// Scatter of single stamps above which a pose is noticeably of another instant, seconds. Raised,
/// stamps made on arrival go unmentioned.
const ODD_SPREAD_S: f64 = 0.003;
/// Change of the delay in sigmas, and at least in seconds per minute, that is no chance. Raised,
/// clocks that drift go unmentioned.
const ODD_DRIFT_SIGMAS: f64 = 4.0;
const MIN_DRIFT_S_PER_MIN: f64 = 0.001;
/// Share of late frames above which they are no accident. Raised, devices that repeat frames go
/// unmentioned.
const ODD_LATE_SHARE: f64 = 0.01;

/// Returns the verdict with its reasons, one sentence each. `sigma_s`: of the delay, with that of
/// the screen's lag; `None` where the clip's clock is unknown, and the delay with it.
pub fn judge_lateness(found: &Lateness, sigma_s: Option<f64>) -> (Verdict, Vec<String>) {
    let mut findings: Vec<(Verdict, String)> = Vec::new();
    match sigma_s {
        None => findings.push((
            Verdict::DoNotUse,
            "the clip has no clip.toml that says how its clock relates to UTC: its spread and its drift are right, the delay is not known; \
             record it with `stagepose record`"
                .to_owned(),
        )),
        Some(sigma_s) if exceeds(sigma_s, GOOD_S) => {
            let verdict = if exceeds(sigma_s, USELESS_S) { Verdict::DoNotUse } else { Verdict::Usable };
            let ms = sigma_s * 1e3;
            findings.push((verdict, format!("the delay is known to {ms:.1} ms only (one sigma): enter the screen's lag, --screen-lag-ms")));
        }
        Some(_) => {}
    }
    let mut find = |text: String| findings.push((Verdict::Usable, text));
    if exceeds(found.spread_s, ODD_SPREAD_S) {
        let ms = found.spread_s * 1e3;
        find(format!("single stamps are {ms:.1} ms off (rms): they may be made on arrival, behind a device that buffers"));
    }
    let [drift, sigma] = found.drift.map(|per_s| per_s * 60.0);
    if exceeds(drift.abs(), MIN_DRIFT_S_PER_MIN.max(ODD_DRIFT_SIGMAS * sigma)) {
        let ms = drift * 1e3;
        find(format!("the delay changes by {ms:+.1} ms a minute: are stamps made from a frame rate, or do the clocks drift apart?"));
    }
    if found.late as f64 > ODD_LATE_SHARE * found.looks as f64 {
        let Lateness { late, looks, .. } = found;
        find(format!("{late} of {looks} frames show another time than their stamps say: the device repeats or holds back frames"));
    }
    let verdict = findings.iter().map(|(verdict, _)| *verdict).max().unwrap_or(Verdict::Good);
    (verdict, findings.into_iter().map(|(_, text)| text).collect())
}

/// Whether a value is above a limit, or no number.
fn exceeds(value: f64, limit: f64) -> bool {
    value.is_nan() || value > limit
}

#[cfg(test)]
mod tests {
    use super::*;

    const FOUND: Lateness =
        Lateness { delay_s: 0.04, sigma_s: 2e-5, spread_s: 0.0005, drift: [0.0, 1e-7], looks: 600, changes: 100, late: 0, hold_s: 0.05 };

    #[test]
    fn a_clean_measurement_is_good_once_the_screen_is_known() {
        assert_eq!(judge_lateness(&FOUND, Some(0.0005)), (Verdict::Good, vec![]));
        let (verdict, reasons) = judge_lateness(&FOUND, Some(0.015));
        assert!(verdict == Verdict::Usable && reasons[0].contains("--screen-lag-ms"), "{reasons:?}");
        assert_eq!(judge_lateness(&FOUND, None).0, Verdict::DoNotUse);
        assert_eq!(judge_lateness(&FOUND, Some(f64::NAN)).0, Verdict::DoNotUse);
    }

    #[test]
    fn spread_drift_and_repeated_frames_are_reasons() {
        let odd = |found: Lateness, word: &str| {
            let (verdict, reasons) = judge_lateness(&found, Some(0.0005));
            assert!(verdict == Verdict::Usable && reasons.len() == 1 && reasons[0].contains(word), "{word}: {reasons:?}");
        };
        odd(Lateness { spread_s: 0.006, ..FOUND }, "6.0 ms");
        odd(Lateness { drift: [1e-4, 1e-6], ..FOUND }, "+6.0 ms a minute");
        odd(Lateness { late: 30, ..FOUND }, "30 of 600");
        // A few frames that the system held back once are no fault of the device.
        assert_eq!(judge_lateness(&Lateness { late: 5, ..FOUND }, Some(0.0005)).0, Verdict::Good);
    }
}
