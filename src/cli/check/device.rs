//! Tries the camera that a config names: opens it, sets its controls, reads a few pictures.

use std::fmt::Write as _;
use std::time::{Duration, Instant};

use crate::camera::{KnownShutter, Shutter};
use crate::capture::camera::{Camera, CameraFault, CameraMode, CameraOpener};
use crate::capture::decode_picture;
use crate::capture::timestamping::{DriverStamp, mid_exposure};
use crate::config::Settings;
use crate::daemon::live::{contradiction, exposure_of};
use crate::publish::SafetySettings;
use crate::telemetry::{Budget, MeanTimes};
use crate::track::LearntCamera;

/// Time to read pictures: 45 at 30 per second, enough to measure the rate and detect repeated
/// stamps. Raised, `check` takes longer.
const SPAN: Duration = Duration::from_millis(1500);
/// Maximum time for the first picture. Chosen, not measured: cameras may take a second or two to
/// start. Raised, a camera without pictures is reported later.
const FIRST: Duration = Duration::from_secs(5);

/// Returns what the camera is and does, or how to fix it. A camera that blocks does not block the
/// check.
pub(super) fn try_camera(settings: &Settings) -> Result<String, String> {
    let opener = crate::cli::run::opener(settings);
    let (shutter, size, safety) = (settings.shutter.or_zero(), settings.lens.size(&settings.camera), settings.safety);
    let (done, result) = crossbeam_channel::bounded(1);
    let tried = std::thread::Builder::new().name("camera".to_owned()).spawn(move || done.send(look(&opener, &shutter, size, &safety)));
    tried.map_err(|e| format!("cannot start a thread: {e}"))?;
    let blocked = || "it was opened and gives no picture; unplug it and plug it in again".to_owned();
    result.recv_timeout(FIRST + 2 * SPAN).unwrap_or_else(|_| Err(blocked()))
}

/// What was observed of a camera.
#[derive(Debug, Default)]
struct Seen {
    pictures: u32,
    unreadable: u32,
    unstamped: u32,
    age_ms: f64,
    span_s: f64,
}

fn look(opener: &dyn CameraOpener, shutter: &Shutter, calibrated: Option<(u32, u32)>, safety: &SafetySettings) -> Result<String, String> {
    let mut camera = opener.open().map_err(|fault| fault.to_string())?;
    let seen = watch(&mut *camera)?;
    Ok(text(camera.mode(), &seen, shutter, calibrated, safety))
}

fn watch(camera: &mut dyn Camera) -> Result<Seen, String> {
    let (mode, mut seen) = (camera.mode().clone(), Seen::default());
    let (begun, mut first) = (Instant::now(), None);
    while first.map_or(begun.elapsed() < FIRST, |first: Instant| first.elapsed() < SPAN) {
        match camera.next_picture(Duration::from_millis(200)) {
            Ok(picture) => {
                first.get_or_insert_with(Instant::now);
                seen.pictures += 1;
                seen.unreadable += u32::from(decode_picture(&picture, mode.layout, mode.size).image.is_err());
                let (at, stamped) = mid_exposure(picture.stamp, picture.arrival, &Shutter::default());
                seen.unstamped += u32::from(!stamped || picture.stamp == DriverStamp::None);
                seen.age_ms += picture.arrival.ms_since(at);
            }
            Err(CameraFault::Silent) => {}
            Err(fault) => return Err(fault.to_string()),
        }
    }
    seen.span_s = first.map_or(0.0, |first| first.elapsed().as_secs_f64());
    if seen.pictures == 0 { Err("it was opened and gives no picture; unplug it and plug it in again".to_owned()) } else { Ok(seen) }
}

fn text(mode: &CameraMode, seen: &Seen, shutter: &Shutter, calibrated: Option<(u32, u32)>, safety: &SafetySettings) -> String {
    let (n, (w, h)) = (f64::from(seen.pictures), mode.size);
    let rate = if seen.span_s > 0.0 { (n - 1.0) / seen.span_s } else { 0.0 };
    let mut text = format!("{}: {} {w}x{h}, {rate:.1} pictures a second of {}", mode.name, mode.layout.fourcc(), mode.fps);
    let mut line = |sentence: String| {
        let _ = write!(text, "\n            {sentence}");
    };
    mode.notes.iter().for_each(|note| line(note.clone()));
    if seen.unreadable > 0 {
        line(format!("{} of {} pictures cannot be read; try another cable or port", seen.unreadable, seen.pictures));
    }
    match seen.unstamped {
        0 => {
            line(format!("the driver stamps its pictures; they arrive {:.0} ms after that", seen.age_ms / n));
            line(format!("from a pose to its packet: {}; the rest is measured while it runs", budget(mode, seen.age_ms / n, shutter)));
        }
        _ => line("the driver gives no time stamps: the age of poses is unknown".to_owned()),
    }
    if rate < 0.8 * mode.fps {
        line("it is slower than the agreed rate: lock the exposure, give it more light, or another USB port".to_owned());
    }
    safety.note_on_rate(rate).into_iter().for_each(&mut line);
    match contradiction(shutter, mode, mode) {
        Some(contradiction) => line(contradiction),
        None if shutter.exposure_s == 0.0 && exposure_of(shutter, mode) > 0.0 => {
            line(format!("its exposure is locked at {:.1} ms, which the tracker will use", exposure_of(shutter, mode) * 1e3));
        }
        None => {}
    }
    if let Some((w, h)) = calibrated.filter(|calibrated| *calibrated != mode.size) {
        line(format!("the calibration is for {w} x {h} pixels and is scaled"));
    }
    text
}

/// Returns the delay budget as far as a camera's arrivals show it. `arrival_ms`: from a stamp, the
/// start of exposure, to the picture's arrival.
fn budget(mode: &CameraMode, arrival_ms: f64, shutter: &Shutter) -> Budget {
    let known = |seconds: f64| Some(seconds).filter(|s| *s > 0.0);
    let known = KnownShutter { exposure_s: known(exposure_of(shutter, mode)), readout_s: known(shutter.readout_s) };
    let halves_s = 0.5 * (known.exposure_s.unwrap_or(0.0) + known.readout_s.unwrap_or(0.0));
    let times = MeanTimes { age_s: Some(arrival_ms * 1e-3 - halves_s), ..MeanTimes::default() };
    Budget::of(&known, &LearntCamera::default(), &times)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::camera::PixelLayout;

    #[test]
    fn a_camera_without_a_calibration_gets_next_steps() {
        let mode = CameraMode {
            name: "Cam (/dev/video0)".into(),
            size: (640, 480),
            layout: PixelLayout::Mjpeg,
            fps: 30.0,
            exposure_s: Some(0.02),
            controls: vec![],
            notes: vec!["the focus is automatic".into()],
        };
        let seen = Seen { pictures: 16, unreadable: 2, unstamped: 0, age_ms: 160.0, span_s: 1.5 };
        let safety = SafetySettings { stale_after: Duration::from_millis(90), ..SafetySettings::default() };
        let text = text(&mode, &seen, &Shutter { exposure_s: 0.01, readout_s: 0.0 }, Some((1280, 960)), &safety);
        for part in [
            "10.0 pictures a second of 30",
            "focus is automatic",
            "2 of 16",
            "arrive 10 ms",
            "exposure 5.0 ms (known) + readout (unknown) + transfer 0.0 ms (at most) + decode (unknown)",
            "slower than the agreed rate",
            "stale_after_s in [safety] is 0.09 s",
            "20.0 ms, exposure_s in [camera] says 10.0 ms",
            "1280 x 960",
        ] {
            assert!(text.contains(part), "`{part}` is not in\n{text}");
        }
        let unset = super::text(&mode, &seen, &Shutter::default(), None, &SafetySettings::default());
        assert!(unset.contains("locked at 20.0 ms, which the tracker will use"), "{unset}");
    }
}
