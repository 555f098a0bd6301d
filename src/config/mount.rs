//! `[mount]`: the filming camera on the tracking camera's rig, or on an object.

use std::time::Duration;

use nalgebra::{Matrix6, Vector3, Vector6};
use toml::Spanned;

use super::as_typed;
use super::origin::Origin;
use super::rotation::Turned;
use super::typed_values::{Exactly, Number};
use super::values::Section;
use super::{ConfigError, Problem};
use crate::camera::LensDoubt;
use crate::geometry::Pose;
use crate::publish::{BodyChoice, Mount, MountSettings};

/// The section's name in messages.
const MOUNT: &str = "[mount]";
/// The filming camera's default name.
const USUAL_NAME: &str = "film";
/// Maximum offset, metres: a crane's arm. Longer ones are slips of the unit. Raised, offsets in
/// centimetres pass.
const MAX_M: f64 = 30.0;
/// Offset above which a note reminds that the unit is metres. Chosen: rigs are shorter. Raised,
/// fewer slips are noticed; lowered, correct offsets get the note.
const ODD_M: f64 = 3.0;

/// Reads the mount, if there is one; `objects` are names that are taken and may carry it.
pub(super) fn mount(
    origin: &Origin<'_>,
    typed: Option<&Spanned<as_typed::Mount>>,
    objects: &[String],
    notes: &mut Vec<String>,
) -> Result<Option<MountSettings>, ConfigError> {
    let Some(typed) = typed else { return Ok(None) };
    let section = Section { origin, name: MOUNT };
    let (span, typed) = (typed.span(), typed.get_ref());
    let Some(typed_offset) = &typed.offset_m else {
        let hint = "where the filming camera's lens is, seen from the tracking camera's: metres to its right, forward and up, such as offset_m = [0.0, 0.05, 0.12]";
        return Err(origin.missing(origin.section_at(MOUNT, &span), "offset_m", hint));
    };
    let offset = section.position("offset_m", typed.offset_m.as_ref())?;
    if offset.norm() > MAX_M {
        let wanted = "metres to the right, forward and up of the tracking camera, together at most 30";
        let value = format!("{:?}", typed_offset.get_ref().values());
        return Err(section.refuse("offset_m", &typed_offset.span(), Problem::Range { value, wanted }));
    }
    if offset.norm() > ODD_M {
        notes.push(format!("[mount]: the cameras are {:.2} m apart; offset_m is in metres", offset.norm()));
    }
    let rotation = Turned::Mount.typed(&section, typed.orientation_xyzw.as_ref(), typed.rotation_deg.as_ref())?;
    let name = name(&section, typed, objects)?;
    let carrier = carrier(&section, typed, objects)?;
    let read = typed.calibration.as_ref().map(|file| section.calibration("calibration", file)).transpose()?;
    if read.is_none() {
        notes.push(format!("[mount]: no calibration; outputs that send {name} have no lens data"));
    }
    let delay = section.number("delay_s", typed.delay_s.as_ref(), 0.0, |v| (0.0..=0.5).contains(&v), "seconds from 0 to 0.5")?;
    Ok(Some(MountSettings {
        name,
        mount: Mount { carrier, pose: Pose::new(rotation, offset), covariance: covariance(&section, typed)? },
        camera: read.map(|read| read.model.with_doubt(LensDoubt::of_calibration(read.uncertainty))),
        delay: Duration::from_secs_f64(delay),
    }))
}

fn name(section: &Section<'_>, typed: &as_typed::Mount, objects: &[String]) -> Result<String, ConfigError> {
    let Some(typed) = &typed.name else { return Ok(USUAL_NAME.to_owned()) };
    let name = section.text("name", typed, "a name for the outputs, such as \"film\"")?;
    if name.eq_ignore_ascii_case("camera") || objects.contains(&name) {
        let other =
            "this name is another body's (`camera` is the tracking camera); give the filming camera a name of its own, such as \"film\"";
        return Err(section.conflict("name", typed, other));
    }
    Ok(name)
}

fn carrier(section: &Section<'_>, typed: &as_typed::Mount, objects: &[String]) -> Result<BodyChoice, ConfigError> {
    let Some(typed) = &typed.on else { return Ok(BodyChoice::Camera) };
    if let Some(index) = objects.iter().position(|name| name == typed.get_ref()) {
        return Ok(BodyChoice::Object(index));
    }
    if typed.get_ref().eq_ignore_ascii_case("camera") {
        return Ok(BodyChoice::Camera);
    }
    let wanted = "\"camera\" or the `name` of the [[object]] that carries it";
    Err(section.unusable("on", typed, wanted))
}

/// Returns the mount's covariance, from its sigmas: turn is about the carrier's z, tilt about its
/// x, roll about its y.
fn covariance(section: &Section<'_>, typed: &as_typed::Mount) -> Result<Matrix6<f64>, ConfigError> {
    let sigma = |key: &'static str, typed: Option<&Spanned<Exactly<Number, 3>>>, most: f64, wanted: &'static str| {
        let Some(typed) = typed else { return Ok(Vector3::zeros()) };
        let values = typed.get_ref().values();
        if values.iter().all(|v| (0.0..=most).contains(v)) {
            return Ok(Vector3::from(values));
        }
        Err(section.refuse(key, &typed.span(), Problem::Range { value: format!("{values:?}"), wanted }))
    };
    let metres = sigma("offset_sigma_m", typed.offset_sigma_m.as_ref(), 10.0, "three numbers of metres from 0 to 10")?;
    let degrees = sigma("rotation_sigma_deg", typed.rotation_sigma_deg.as_ref(), 180.0, "three numbers of degrees from 0 to 180")?;
    let [turn, tilt, roll] = [degrees.x, degrees.y, degrees.z].map(f64::to_radians);
    Ok(Matrix6::from_diagonal(&Vector6::new(metres.x, metres.y, metres.z, tilt, roll, turn).map(|v| v * v)))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::config::Settings;
    use crate::config::settings::SendingSettings;
    use crate::publish::Rate;

    const OUTPUTS: &str = "[[output]]\nkind = \"freed\"\nto = \"127.0.0.1:40000\"\n[[output]]\nkind = \"psn\"\nto = \"127.0.0.1:56565\"\n\
        [[output]]\nkind = \"osc\"\nto = \"127.0.0.1:7000\"\nrate_hz = 50\nbodies = [\"film\", \"cart\"]\n\
        [[output]]\nkind = \"freed\"\nto = \"127.0.0.1:40001\"\nbodies = \"camera\"\n[[object]]\nname = \"cart\"\n";

    fn load(mount: &str, outputs: &str) -> Result<SendingSettings, ConfigError> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("stage.toml");
        let lens = "width = 1920\nheight = 1080\nfx = 1500\nfy = 1500\ncx = 960\ncy = 540\nskew = 0\ndistortion = [0, 0, 0, 0, 0]\n";
        std::fs::write(folder.path().join("film.toml"), lens).unwrap();
        std::fs::write(&file, format!("{mount}{outputs}")).unwrap();
        Settings::load_outputs(&file)
    }

    #[test]
    fn outputs_report_the_filming_camera_by_default() {
        let settings = load("[mount]\noffset_m = [0.1, 0.2, 0.3]\nrotation_deg = [0, 90, 0]\ndelay_s = 0.12\n", OUTPUTS).unwrap();
        let mount = settings.mount.unwrap();
        assert_eq!((mount.name.as_str(), mount.mount.carrier, mount.camera), ("film", BodyChoice::Camera, None));
        // Tilted up by 90 degrees, the filming camera's forward direction is the rig's up.
        let ahead = mount.mount.pose.transform(&nalgebra::Point3::new(0.0, 1.0, 0.0));
        assert!((ahead - nalgebra::Point3::new(0.1, 0.2, 1.3)).norm() < 1e-12);
        let bodies: Vec<_> = settings.outputs.iter().map(|o| o.bodies.clone()).collect();
        let (camera, cart, film) = (BodyChoice::Camera, BodyChoice::Object(0), BodyChoice::Mount);
        assert_eq!(bodies, [vec![film], vec![camera, cart, film], vec![film, cart], vec![camera]]);
        let delays: Vec<_> = settings.outputs.iter().map(|o| o.delay.as_millis()).collect();
        assert_eq!(delays, [120, 120, 120, 0]);
        assert!(matches!(settings.outputs[2].rate, Rate::Fixed { delay, .. } if delay.as_millis() == 120));
        // An output's own delay takes precedence.
        let own = OUTPUTS.replace("rate_hz = 50", "rate_hz = 50\ndelay_s = 0.3");
        let settings = load("[mount]\noffset_m = [0, 0, 0]\ndelay_s = 0.12\n", &own).unwrap();
        assert!(matches!(settings.outputs[2].rate, Rate::Fixed { delay, .. } if delay.as_millis() == 300));
    }

    #[test]
    fn an_object_may_carry_the_mount_and_its_sigmas_are_kept() {
        let text = "[mount]\nname = \"crane\"\non = \"cart\"\noffset_m = [0, 0, 1]\ncalibration = \"film.toml\"\n\
            offset_sigma_m = [0.001, 0.002, 0.003]\nrotation_sigma_deg = [1, 2, 3]\n";
        let mount = load(text, &OUTPUTS.replace("film", "crane")).unwrap().mount.unwrap();
        assert_eq!((mount.mount.carrier, mount.camera.map(|camera| camera.width())), (BodyChoice::Object(0), Some(1920)));
        let sigmas = mount.mount.covariance.diagonal().map(f64::sqrt);
        let wanted = [0.001, 0.002, 0.003, 2.0_f64.to_radians(), 3.0_f64.to_radians(), 1.0_f64.to_radians()];
        assert!(sigmas.iter().zip(wanted).all(|(found, wanted)| (found - wanted).abs() < 1e-12), "{sigmas}");
    }

    #[test]
    fn mount_errors_are_reported_with_their_line() {
        let cases = [
            ("[mount]\n", "[mount], line 1, has no `offset_m`; add where the filming camera's lens is"),
            ("[mount]\noffset_m = [0, 50, 120]\n", "`offset_m` in [mount], line 2: [0.0, 50.0, 120.0] cannot be used; give metres"),
            ("[mount]\noffset_m = [0, 0]\n", "`offset_m` in [mount], line 2"),
            ("[mount]\noffset_m = [0, 0, 0]\nname = \"Camera\"\n", "`name` in [mount], line 3: this name is another body's"),
            ("[mount]\noffset_m = [0, 0, 0]\nname = \"cart\"\n", "`name` in [mount], line 3: this name is another body's"),
            ("[mount]\noffset_m = [0, 0, 0]\non = \"dolly\"\n", "`on` in [mount], line 3: `dolly` cannot be used; give \"camera\" or"),
            ("[mount]\noffset_m = [0, 0, 0]\ndelay_s = 12\n", "`delay_s` in [mount], line 3: 12 cannot be used; give seconds"),
            ("[mount]\noffset_m = [0, 0, 0]\nrotation_sigma_deg = [1, -1, 0]\n", "`rotation_sigma_deg` in [mount], line 3"),
            (
                "[mount]\noffset_m = [0, 0, 0]\nrotation_deg = [0, 0, 0]\norientation_xyzw = [0, 0, 0, 1]\n",
                "`rotation_deg` in [mount], line 3: a mount has either",
            ),
            ("[mount]\noffset_m = [0, 0, 0]\noffset = 1\n", "unknown key `offset` in [mount], line 3; did you mean `offset_m`?"),
            ("[mount]\noffset_m = [0, 0, 0]\ncalibration = \"none.toml\"\n", "`calibration` in [mount], line 3"),
            ("", "`bodies` in [[output]], line 11: `film` cannot be used; give \"camera\" or the `name` of an [[object]] or of [mount]"),
        ];
        for (mount, wanted) in cases {
            let said = load(mount, OUTPUTS).map(|_| ()).expect_err(mount).to_string();
            let said = said.split_once(&format!("{}: ", Path::new("stage.toml").display())).unwrap().1;
            assert!(said.starts_with(wanted), "{mount}: {said}");
        }
    }
}
