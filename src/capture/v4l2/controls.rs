//! Sets a camera's controls to the config's values, reads them back, and reports refusals.
//!
//! Automatic exposure, focus and white balance change the picture in the middle of a show, and a
//! moving focus invalidates the calibration. Automatic modes are set before the values that they
//! lock.

use std::collections::BTreeMap;
use std::os::fd::RawFd;

use super::ioctl::{self, ControlDescription};

/// V4L2's id of the exposure mode (linux/v4l2-controls.h): 1 is manual, 3 is "aperture priority",
/// the automatic mode of most webcams.
const AUTO_EXPOSURE: u32 = 0x009a_0901;
/// V4L2's ids of the exposure time in 100 microseconds, of the automatic focus, and of the mains
/// frequency for flicker reduction.
const EXPOSURE_ABSOLUTE: u32 = 0x009a_0902;
const AUTO_FOCUS: u32 = 0x009a_090c;
const POWER_LINE: u32 = 0x0098_0918;
/// V4L2_CTRL_FLAG_INACTIVE: the control has no effect while another one, such as an automatic mode,
/// overrides it.
const INACTIVE: u32 = 0x10;

/// The state of the controls after setting.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Held {
    /// The config's controls by name, as read back.
    pub values: Vec<(String, i64)>,
    /// The exposure in seconds, if it is manual and known.
    pub exposure_s: Option<f64>,
    /// One sentence each: what was refused, and what is still automatic.
    pub warnings: Vec<String>,
}

/// Returns a control's name as written in configs: "Exposure Time, Absolute" is
/// `exposure_time_absolute`.
pub(super) fn plain_name(name: &str) -> String {
    let words = name.split(|c: char| !c.is_ascii_alphanumeric()).filter(|w| !w.is_empty());
    words.map(str::to_ascii_lowercase).collect::<Vec<_>>().join("_")
}

/// Sets the requested controls and reads them back.
pub(super) fn hold(fd: RawFd, wanted: &BTreeMap<String, i64>) -> Held {
    let there = ioctl::controls(fd);
    let mut held = Held::default();
    let mut wanted: Vec<(&String, i64)> = wanted.iter().map(|(name, value)| (name, *value)).collect();
    wanted.sort_by_key(|(name, _)| !name.contains("auto") || name.contains("absolute"));
    for (name, value) in wanted {
        let Some(control) = there.iter().find(|c| plain_name(&c.name) == *name) else {
            held.warnings.push(unknown(name, &there));
            continue;
        };
        // A camera may refuse to set a value it already has while an automatic mode is on; that is
        // no error.
        let refused = ioctl::set_control(fd, control.id, value).err();
        let now = ioctl::control_value(fd, control.id);
        match now {
            Ok(now) if now == value => held.values.push((name.clone(), now)),
            Ok(now) => {
                held.warnings.push(not_taken(name, value, Some(now), refused.map(|e| e.to_string()), control));
                held.values.push((name.clone(), now));
            }
            Err(e) => held.warnings.push(not_taken(name, value, None, Some(e.to_string()), control)),
        }
    }
    let read = |id| there.iter().find(|c| c.id == id).and_then(|c| ioctl::control_value(fd, c.id).ok());
    held.exposure_s = (read(AUTO_EXPOSURE) == Some(1)).then(|| read(EXPOSURE_ABSOLUTE)).flatten().map(|units| units as f64 * 1e-4);
    held.warnings.extend(automatic(&there, read(AUTO_EXPOSURE), read(AUTO_FOCUS)));
    held.warnings.extend(held.exposure_s.and_then(|exposure_s| flicker(exposure_s, read(POWER_LINE))));
    held
}

fn unknown(name: &str, there: &[ControlDescription]) -> String {
    let names: Vec<String> = there.iter().filter(|c| c.kind != 6).map(|c| plain_name(&c.name)).collect();
    let near = names.iter().map(|n| (strsim::jaro_winkler(n, name), n)).max_by(|a, b| a.0.total_cmp(&b.0));
    match near {
        Some((likeness, near)) if likeness > 0.8 => format!("the camera has no control `{name}`; did you mean `{near}`?"),
        _ if names.is_empty() => format!("the camera has no control `{name}`, and none at all; remove it from `controls`"),
        _ => format!("the camera has no control `{name}`; it has {}", names.join(", ")),
    }
}

fn not_taken(name: &str, wanted: i64, now: Option<i64>, reply: Option<String>, control: &ControlDescription) -> String {
    let now = now.map_or("cannot be read".to_owned(), |now| format!("stays at {now}"));
    let reply = reply.map_or(String::new(), |reply| format!(" ({reply})"));
    let hint = if !(control.minimum..=control.maximum).contains(&wanted) {
        format!("give a value from {} to {}", control.minimum, control.maximum)
    } else if control.flags & INACTIVE != 0 {
        "switch its automatic off in `controls` too".to_owned()
    } else {
        "remove it from `controls`, or set it by the camera maker's means".to_owned()
    };
    format!("the camera refuses `{name}` = {wanted}{reply} and {now}; {hint}")
}

fn automatic(there: &[ControlDescription], exposure: Option<i64>, focus: Option<i64>) -> Vec<String> {
    let mut warnings = Vec::new();
    match exposure {
        Some(1) => {}
        Some(_) => warnings.push(
            "the exposure is automatic: it blurs in the dark, lowers the rate and shifts the time of every picture; set controls = { auto_exposure = 1, exposure_time_absolute = 100 } in [camera]"
                .to_owned(),
        ),
        None if !there.iter().any(|c| c.id == EXPOSURE_ABSOLUTE) => {
            warnings.push("the camera has no exposure control; light the stage evenly, and expect blur in the dark".to_owned());
        }
        None => {}
    }
    if focus == Some(1) {
        warnings.push(
            "the focus is automatic: it changes the calibration while it moves; set focus_automatic_continuous = false in `controls`"
                .to_owned(),
        );
    }
    warnings
}

/// Returns a warning if the exposure may show bands. Lamps on the mains flicker at twice its
/// frequency: an exposure that is not a whole number of periods shows them.
fn flicker(exposure_s: f64, power_line: Option<i64>) -> Option<String> {
    let whole = |hz: f64| {
        let periods = exposure_s * hz;
        periods > 0.5 && (periods - periods.round()).abs() < 0.02
    };
    let (fits, mains, advice) = match power_line {
        Some(1) => (whole(100.0), "50 Hz", "100, 200 or 300"),
        Some(2) => (whole(120.0), "60 Hz", "83, 167 or 250"),
        _ => (whole(100.0) || whole(120.0), "50 or 60 Hz", "100 (50 Hz mains) or 83 (60 Hz)"),
    };
    (!fits).then(|| {
        let ms = exposure_s * 1e3;
        format!("an exposure of {ms:.1} ms may show bands under lamps on {mains} mains; if it does, set exposure_time_absolute to {advice}")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn control(name: &str, id: u32, flags: u32) -> ControlDescription {
        ControlDescription { id, kind: 1, name: name.into(), minimum: 3, maximum: 2047, step: 1, default: 250, flags }
    }

    #[test]
    fn names_are_those_that_v4l2_tools_print() {
        let names = ["Exposure Time, Absolute", "White Balance, Automatic", "Gain"].map(plain_name);
        assert_eq!(names, ["exposure_time_absolute", "white_balance_automatic", "gain"]);
    }

    #[test]
    fn refusals_say_what_to_do() {
        let there = [control("Gain", 1, 0), control("Exposure Time, Absolute", EXPOSURE_ABSOLUTE, INACTIVE)];
        assert_eq!(unknown("gian", &there), "the camera has no control `gian`; did you mean `gain`?");
        assert!(unknown("zoom", &there).ends_with("it has gain, exposure_time_absolute"));
        assert!(not_taken("gain", 5000, Some(64), None, &there[0]).ends_with("stays at 64; give a value from 3 to 2047"));
        assert!(not_taken("e", 100, Some(64), None, &there[1]).ends_with("switch its automatic off in `controls` too"));
    }

    #[test]
    fn automatic_controls_and_flicker_get_a_warning() {
        let there = [control("Exposure Time, Absolute", EXPOSURE_ABSOLUTE, 0)];
        assert_eq!(automatic(&there, Some(1), Some(0)), Vec::<String>::new());
        assert_eq!(automatic(&there, Some(3), Some(1)).len(), 2);
        assert!(automatic(&[], None, None)[0].contains("no exposure control"));
        assert_eq!(flicker(0.01, Some(1)), None);
        assert_eq!(flicker(1.0 / 120.0, Some(2)), None);
        assert!(flicker(0.01, Some(2)).unwrap().contains("60 Hz"));
        assert!(flicker(0.004, None).unwrap().contains("4.0 ms"));
    }
}
