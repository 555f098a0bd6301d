//! Describes `[mount]` in words.

use std::time::Duration;

use crate::cli::angles::angles;
use crate::config::Settings;
use crate::publish::{BodyChoice, MountSettings, OutputSettings};

/// Describes where the filming camera sits, and its lens.
pub(super) fn lines(mount: &MountSettings, settings: &Settings) -> Vec<String> {
    let carrier = match mount.mount.carrier {
        BodyChoice::Object(index) => settings.objects.get(index).map_or("an object", |object| object.name.as_str()),
        _ => "the camera",
    };
    let o = mount.mount.pose.translation;
    let along = |metres: f64, [ahead, back]: [&str; 2]| format!("{:.3} m {}", metres.abs(), if metres < 0.0 { back } else { ahead });
    let place = [along(o.x, ["right", "left"]), along(o.y, ["forward", "back"]), along(o.z, ["up", "down"])].join(", ");
    let [pan, tilt, roll] = angles(&mount.mount.pose.rotation);
    let late = late(mount.delay);
    let mut lines = vec![format!("{} on {carrier}: {place}; pan {pan:+.2} tilt {tilt:+.2} roll {roll:+.2} degrees{late}", mount.name)];
    if let Some(camera) = &mount.camera {
        let i = camera.intrinsics();
        lines.push(format!("its lens: {} x {} pixels, focal length {:.1} x {:.1} px", i.width, i.height, i.fx, i.fy));
    }
    lines
}

/// Describes the poses' delay, starting with the comma.
pub(super) fn late(delay: Duration) -> String {
    if delay.is_zero() { String::new() } else { format!(", {} ms late", delay.as_millis()) }
}

/// Names the bodies that an output reports, if there is a `[mount]` and so a choice.
pub(super) fn bodies(output: &OutputSettings, settings: &Settings) -> String {
    let Some(mount) = &settings.mount else { return String::new() };
    let name = |body: &BodyChoice| match body {
        BodyChoice::Camera => "camera",
        BodyChoice::Mount => mount.name.as_str(),
        BodyChoice::Object(index) => settings.objects.get(*index).map_or("object", |object| object.name.as_str()),
    };
    format!(" of {}", output.bodies.iter().map(name).collect::<Vec<_>>().join(", "))
}
