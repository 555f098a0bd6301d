//! Checks whether a clip's stamps can be nanoseconds: files with milliseconds or microseconds under
//! that header are common.

use crate::frame::Timestamp;

/// Median step, nanoseconds, below which stamps are reported as suspect (2000 pictures per second).
/// Raised, high-speed cameras are reported; lowered, slow clips stamped in microseconds are missed.
const MIN_NS: i64 = 500_000;
/// Median step, nanoseconds, above which stamps are reported if a thousandth of it would be a
/// video's step. Raised, fast clips stamped in picoseconds are missed; lowering it alone has no
/// effect, since [`VIDEO_NS`] begins at a thousandth of it.
const MAX_NS: i64 = 5_000_000_000;
/// Range of a camera's step, nanoseconds, used to guess the unit. Widened, impossible units are
/// suggested.
const CAMERA_NS: std::ops::RangeInclusive<i64> = 900_000..=2_000_000_000;
/// Range of a video's step, nanoseconds: 10 to 200 pictures per second. Widened, pictures taken
/// every few minutes are reported.
const VIDEO_NS: std::ops::RangeInclusive<i64> = 5_000_000..=100_000_000;
/// Units that are mistaken for nanoseconds, with their length in nanoseconds.
const UNITS: [(&str, i64); 3] = [("milliseconds", 1_000_000), ("microseconds", 1000), ("whole seconds", 1_000_000_000)];

/// Returns a sentence about stamps that cannot be nanoseconds.
pub(super) fn doubt(stamps: &[Timestamp]) -> Option<String> {
    let steps = stamps.windows(2).map(|pair| pair[1].ns_since(pair[0]));
    let (mut steps, others): (Vec<i64>, Vec<i64>) = steps.partition(|step| *step > 0);
    let repeated = others.iter().filter(|step| **step == 0).count();
    let read = "they are read as nanoseconds, so times, speeds and the shutter will be wrong";
    steps.sort_unstable();
    let step = *steps.get(steps.len() / 2)?;
    if repeated > steps.len() && step <= MIN_NS {
        let unit = if step == 1 { "whole seconds" } else { "a unit that is too coarse" };
        return Some(format!("most stamps repeat the previous row's; are they {unit}? {read}: write nanoseconds"));
    }
    if stamps.len() < 3 {
        return None;
    }
    if step < MIN_NS {
        let fps = 1e9 / step as f64;
        let unit = UNITS.iter().find(|(_, ns)| CAMERA_NS.contains(&step.saturating_mul(*ns)));
        let (guess, hint) = match unit {
            Some((unit, ns)) => (format!("are they {unit}? "), format!("multiply them by {ns}")),
            None => (String::new(), "write nanoseconds".to_owned()),
        };
        return Some(format!("stamps lie {step} ns apart, {fps:.0} frames a second; {guess}{read}: {hint}"));
    }
    let is_too_fine = step > MAX_NS && VIDEO_NS.contains(&(step / 1000));
    is_too_fine.then(|| {
        format!(
            "stamps lie {:.1} s apart; are they a thousandth of nanoseconds? {read}: divide them by 1000, or ignore this",
            step as f64 / 1e9
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(stamps: impl Iterator<Item = i64>) -> Option<String> {
        doubt(&stamps.map(Timestamp::from_ns).collect::<Vec<_>>())
    }

    #[test]
    fn other_units_are_named_and_nanoseconds_are_not() {
        let clip = || (0..40).map(|n| 1_403_636_579_763_555_584 + n * 33_333_333);
        assert_eq!(of(clip()), None);
        let said = of(clip().map(|t| t / 1_000_000)).unwrap();
        assert!(said.contains("are they milliseconds?") && said.ends_with("multiply them by 1000000"), "{said}");
        let said = of(clip().map(|t| t / 1000)).unwrap();
        assert!(said.contains("are they microseconds?") && said.ends_with("multiply them by 1000"), "{said}");
        assert!(of(clip().map(|t| t / 1_000_000_000)).unwrap().contains("are they whole seconds?"));
        assert!(of((0..9).map(|n| n * 33_333_333_000)).unwrap().contains("divide them by 1000"));
        // One second apart, stamped in seconds; then with a few bad rows.
        assert!(of(0..9).unwrap().contains("are they"));
        assert!(of([0, 33, 66, 5, 100, i64::MAX, 133, 166].into_iter()).unwrap().contains("are they milliseconds?"));
    }

    #[test]
    fn stamps_of_slow_and_fast_cameras_are_accepted() {
        for step in [1_000_000, 2_000_000, 33_333_333, 1_000_000_000, 4_000_000_000, 600_000_000_000, 86_400_000_000_000] {
            assert_eq!(of((0..20).map(|n| n * step)), None, "{step}");
        }
        // Pauses, repeats and rows out of order.
        assert_eq!(of([0, 33_333_333, 33_333_333, 66_666_666, 3_600_000_000_000, 50_000_000, 3_600_033_333_333].into_iter()), None);
        assert_eq!((of([5].into_iter()), of([].into_iter()), of([0, 10].into_iter())), (None, None, None));
        assert_eq!(of([10, 10, 10].into_iter()), None, "a clip of one instant has no unit");
    }
}
