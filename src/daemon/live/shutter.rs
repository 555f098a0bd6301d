//! The camera's exposure and readout: as configured, as reported by the camera, and contradictions
//! between the two.

use crate::camera::Shutter;
use crate::capture::camera::CameraMode;

/// Exposures are equal within this many seconds (drivers count in units of 0.1 ms) or this share of
/// the longer one. Chosen: an error that the tracker does not notice. Raised, wrong settings pass;
/// lowered, rounding is reported.
const SAME_EXPOSURE_S: f64 = 1.5e-4;
const SAME_EXPOSURE_SHARE: f64 = 0.02;

/// Returns the exposure for stamps and tracking: the configured one, else the camera's locked one;
/// 0 if neither is known.
pub fn exposure_of(shutter: &Shutter, mode: &CameraMode) -> f64 {
    if shutter.exposure_s > 0.0 { shutter.exposure_s } else { locked(mode).unwrap_or(0.0) }
}

/// Describes a contradiction between the exposure that poses are based on and the one that the
/// camera has locked now; `first` is the mode that the tracker was made for.
pub fn contradiction(shutter: &Shutter, first: &CameraMode, now: &CameraMode) -> Option<String> {
    let (used, real) = (exposure_of(shutter, first), locked(now).unwrap_or(0.0));
    let (used_ms, real_ms) = (used * 1e3, real * 1e3);
    if (used - real).abs() <= SAME_EXPOSURE_S.max(SAME_EXPOSURE_SHARE * used.max(real)) {
        None
    } else if shutter.exposure_s == 0.0 && used == 0.0 {
        Some(format!("its exposure is now locked at {real_ms:.1} ms, which the tracker does not know; send SIGHUP or restart"))
    } else if shutter.exposure_s == 0.0 && real == 0.0 {
        Some(format!("its exposure is no longer locked, but the tracker uses {used_ms:.1} ms; lock it in `controls`"))
    } else if shutter.exposure_s == 0.0 {
        Some(format!("its exposure is now {real_ms:.1} ms, but the tracker uses {used_ms:.1} ms; send SIGHUP or restart"))
    } else if real > 0.0 {
        Some(format!(
            "its exposure is {real_ms:.1} ms, exposure_s in [camera] says {used_ms:.1} ms, which is used; make them equal or remove exposure_s"
        ))
    } else {
        None
    }
}

/// Returns the exposure that a camera has locked, if it is plausible.
fn locked(mode: &CameraMode) -> Option<f64> {
    mode.exposure_s.filter(|s| *s > 0.0 && *s <= Shutter::MAX_S)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::camera::PixelLayout;

    fn mode(exposure_s: Option<f64>) -> CameraMode {
        let (name, notes, controls) = ("Cam".to_owned(), vec![], vec![]);
        CameraMode { name, size: (8, 6), layout: PixelLayout::Grey, fps: 30.0, exposure_s, controls, notes }
    }

    #[test]
    fn the_cameras_locked_exposure_is_the_default() {
        let (set, unset) = (Shutter { exposure_s: 0.01, readout_s: 0.0 }, Shutter::default());
        assert_eq!(exposure_of(&unset, &mode(Some(0.0083))), 0.0083);
        assert_eq!(exposure_of(&set, &mode(Some(0.0083))), 0.01);
        for impossible in [None, Some(0.0), Some(-1.0), Some(f64::NAN), Some(204.7)] {
            assert_eq!(exposure_of(&unset, &mode(impossible)), 0.0, "{impossible:?}");
        }
    }

    #[test]
    fn exposures_that_contradict_each_other_are_said() {
        let (set, unset) = (Shutter { exposure_s: 0.01, readout_s: 0.0 }, Shutter::default());
        let said = |shutter: Shutter, first: Option<f64>, now: Option<f64>| contradiction(&shutter, &mode(first), &mode(now));
        assert_eq!(said(unset, Some(0.01), Some(0.01)), None);
        assert_eq!(said(unset, None, None), None);
        assert_eq!(said(set, None, None), None, "an automatic exposure is warned of elsewhere");
        assert_eq!(said(set, Some(0.0101), Some(0.0101)), None, "within the driver's unit");
        assert!(said(set, Some(0.02), Some(0.02)).unwrap().starts_with("its exposure is 20.0 ms, exposure_s in [camera] says 10.0 ms"));
        assert!(said(unset, Some(0.01), Some(0.02)).unwrap().contains("now 20.0 ms, but the tracker uses 10.0 ms"));
        assert!(said(unset, Some(0.01), None).unwrap().contains("no longer locked"));
        assert!(said(unset, None, Some(0.01)).unwrap().contains("now locked at 10.0 ms"));
    }
}
