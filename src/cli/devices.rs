//! `devices`: lists this machine's cameras with every name, mode and control that a config may use.

use super::failure::Failure;

/// List the cameras with their names, formats, sizes, rates and controls.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  stagepose devices --json\n\nIn a config, name a camera by its by-id name: it lasts when cameras are plugged elsewhere."
)]
pub(super) struct DevicesArguments {
    /// Print JSON instead of text
    #[arg(long)]
    json: bool,
}

#[cfg(not(feature = "live"))]
pub(super) fn run(_: &DevicesArguments) -> Result<(), Failure> {
    Err(super::run::no_live_feature())
}

#[cfg(feature = "live")]
pub(super) fn run(arguments: &DevicesArguments) -> Result<(), Failure> {
    use std::io::Write as _;

    let devices = crate::capture::v4l2::devices();
    let text = match arguments.json {
        // Serialising to a string fails only for non-string map keys, and a listing has none.
        true => serde_json::to_string_pretty(&devices).expect("a listing has only string keys"),
        false if devices.is_empty() => "no camera is plugged in, or none may be opened by this user (group video)".to_owned(),
        false => devices.iter().map(text::of_device).collect::<Vec<_>>().join("\n"),
    };
    // Camera names come from the devices and may hold control characters.
    let text = crate::printable::printable_lines(&text);
    writeln!(std::io::stdout(), "{text}").map_err(Failure::output(std::path::Path::new("stdout")))
}

#[cfg(feature = "live")]
mod text {
    use std::fmt::Write as _;

    use crate::capture::v4l2::{ControlListing, DeviceListing, FormatListing};

    pub(super) fn of_device(device: &DeviceListing) -> String {
        let mut text = format!("{}  {}  ({}, {})\n", device.node.display(), device.name, device.driver, device.bus);
        for link in device.by_id.iter().chain(&device.by_path) {
            let _ = writeln!(text, "  {}", link.display());
        }
        if !device.held_by.is_empty() {
            let _ = writeln!(text, "  in use by {}", device.held_by.join(", "));
        }
        device.formats.iter().for_each(|f| format_lines(&mut text, f));
        device.controls.iter().for_each(|c| text += &control_line(c));
        text
    }

    fn format_lines(text: &mut String, format: &FormatListing) {
        let unusable = if format.usable { "" } else { ", not usable here" };
        let _ = writeln!(text, "  {} ({}{unusable})", format.fourcc, format.description);
        for size in &format.sizes {
            let rates: Vec<String> = size.fps.iter().map(|fps| format!("{}", (fps * 100.0).round() / 100.0)).collect();
            let _ = writeln!(text, "    {} x {} at {} a second", size.width, size.height, rates.join(", "));
        }
    }

    fn control_line(control: &ControlListing) -> String {
        let value = control.value.map_or("?".to_owned(), |v| v.to_string());
        let range = match control.kind {
            "menu" => control.menu.iter().map(|(n, entry)| format!("{n} {entry}")).collect::<Vec<_>>().join(", "),
            "boolean" => "false or true".to_owned(),
            "button" => "a button".to_owned(),
            _ => format!("{} to {} by {}", control.minimum, control.maximum, control.step),
        };
        let held = if control.active { "" } else { ", held by an automatic" };
        format!("  {:<34} = {value:<7} {range}, default {}{held}\n", control.name, control.default)
    }

    #[cfg(test)]
    mod tests {
        use super::*;
        use crate::capture::v4l2::SizeListing;

        #[test]
        fn a_listed_camera_is_readable() {
            let control = ControlListing {
                name: "auto_exposure".into(),
                id: 1,
                kind: "menu",
                minimum: 0,
                maximum: 3,
                step: 1,
                default: 3,
                value: Some(1),
                active: false,
                menu: vec![(1, "Manual Mode".into()), (3, "Aperture Priority Mode".into())],
            };
            let size = SizeListing { width: 640, height: 480, fps: vec![29.97, 30.0] };
            let device = DeviceListing {
                node: "/dev/video0".into(),
                name: "Cam".into(),
                driver: "uvcvideo".into(),
                bus: "usb-1".into(),
                by_id: vec!["/dev/v4l/by-id/usb-Cam".into()],
                by_path: vec![],
                formats: vec![FormatListing { fourcc: "GREY".into(), description: "8-bit".into(), usable: false, sizes: vec![size] }],
                controls: vec![control],
                held_by: vec!["cheese (process 7)".into()],
            };
            let text = of_device(&device);
            for part in [
                "/dev/video0  Cam",
                "by-id/usb-Cam",
                "in use by cheese (process 7)",
                "GREY (8-bit, not usable here)",
                "640 x 480 at 29.97, 30",
                "= 1       1 Manual Mode, 3 Aperture Priority Mode, default 3, held by an automatic",
            ] {
                assert!(text.contains(part), "`{part}` is not in\n{text}");
            }
        }
    }
}
