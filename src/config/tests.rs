//! Valid configs, and every kind of invalid one with its message.

use std::path::Path;

use image::GrayImage;
use proptest::prelude::*;
use tracing::level_filters::LevelFilter;

use super::as_typed::Config;
use super::known_keys::known_keys;
use super::settings::DeviceSettings;
use super::*;
use crate::capture::camera::PixelLayout;

pub(super) const CAMERA: &str =
    "width = 640\nheight = 480\nfx = 600.0\nfy = 600.0\ncx = 319.5\ncy = 239.5\nskew = 0.0\ndistortion = [0, 0, 0, 0, 0]\n";

/// Returns a folder with a calibration, a good picture, a photograph-sized one, a flat one and two
/// masks.
pub(super) fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fill(folder.path());
    folder
}

/// Writes these files into a folder.
pub(super) fn fill(folder: &Path) {
    let at = |name: &str| folder.join(name);
    std::fs::write(at("camera.toml"), CAMERA).unwrap();
    // A coarse random checker: plenty of corners at every scale.
    let textured = |w, h| {
        let mut state = 1_u32;
        let cells: Vec<u8> = (0..4096)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 24) as u8
            })
            .collect();
        GrayImage::from_fn(w, h, |x, y| image::Luma([cells[((x / 9) % 64 + (y / 9) % 64 * 64) as usize]]))
    };
    textured(400, 300).save(at("art.png")).unwrap();
    textured(640, 480).save(at("photo.png")).unwrap();
    GrayImage::from_pixel(400, 300, image::Luma([90])).save(at("flat.png")).unwrap();
    GrayImage::from_pixel(640, 480, image::Luma([255])).save(at("mask.png")).unwrap();
    GrayImage::new(640, 480).save(at("black.png")).unwrap();
    std::fs::write(at("broken.png"), b"\x89PNG\r\n\x1a\nno").unwrap();
}

pub(super) const GOOD: &str = "[camera]\ncalibration = \"camera.toml\"\n[[stage.surface]]\nimage = \"art.png\"\nsize_m = [4, 3]\n";

pub(super) fn load(folder: &tempfile::TempDir, text: &str) -> Result<Settings, ConfigError> {
    Settings::from_text(text, &folder.path().join("stage.toml"))
}

/// Returns the message without the folder's name.
fn message(folder: &tempfile::TempDir, text: &str) -> String {
    let prefix = format!("{}/", folder.path().display());
    load(folder, text).map(|_| ()).expect_err(text).to_string().replace(&prefix, "")
}

#[test]
fn a_configured_global_shutter_is_recognised() {
    let folder = folder();
    let with = |lines: &str| load(&folder, &GOOD.replacen("[camera]\n", &format!("[camera]\n{lines}\n"), 1));
    assert_eq!(with("shutter = \"global\"").unwrap().shutter.readout_s, Some(0.0));
    assert_eq!(with("shutter = \"rolling\"").unwrap().shutter.readout_s, None);
    assert_eq!(with("readout_s = 0.0").unwrap().shutter.readout_s, None);
    assert!(with("shutter = \"global\"\nreadout_s = 0.01").unwrap_err().to_string().contains("remove one of the two"));
    assert!(with("shutter = \"shut\"").is_err());
}

#[test]
fn defaults_match_the_documentation() {
    let folder = folder();
    let settings = load(&folder, GOOD).unwrap();
    assert_eq!((settings.shutter.exposure_s, settings.shutter.readout_s), (None, None));
    assert_eq!(settings.tracker, crate::track::TrackerSettings::default());
    assert_eq!(settings.device, DeviceSettings::default());
    assert_eq!(settings.log, LogSettings { level: LevelFilter::WARN, format: LogFormat::Text });
    assert!(settings.objects.is_empty() && settings.mask.is_none());
    assert_eq!(settings.notes, Vec::<String>::new());
    let surface = &settings.stage.surfaces[0];
    assert_eq!((surface.name.as_str(), surface.size_m), ("art.png", [4.0, 3.0]));
    // Upright, facing the audience: the picture's up is the stage's z, its face looks at the house.
    let up = surface.pose.rotation * nalgebra::Vector3::y();
    let face = surface.pose.rotation * nalgebra::Vector3::z();
    assert!((up - nalgebra::Vector3::z()).norm() < 1e-12 && (face + nalgebra::Vector3::y()).norm() < 1e-12);
}

#[test]
fn every_key_reaches_the_settings() {
    let folder = folder();
    let text = "[camera]\ncalibration = \"camera.toml\"\nexposure_s = 0.01\nreadout_s = 0.02\nmask = \"mask.png\"\ndevice = \"/dev/video1\"\n\
        width = 1280\nheight = 720\nfps = 59.94\nlatency_s = 0.12\nformat = \"grey\"\ncontrols = { gain = 3, auto = false }\n\
        [[stage.surface]]\nphoto = \"photo.png\"\ncorners_px = [[10, 10], [600, 12.5], [590, 440], [20, 450]]\nsize_m = [4, 3]\n\
        position_m = [1, 2, 3]\norientation_xyzw = [0, 0, 0, 1.0005]\n\
        [[object]]\nname = \"cart\"\n[[object.surface]]\nimage = \"art.png\"\nsize_m = [0.8, 0.6]\n\
        [tracker]\nthreads = 2\nfeatures = 800\ncoast_s = 0\nconfirm_frames = 3\nseed = 9\n\
        [recorder]\nfolder = \"takes\"\ncontinuous = true\nring_s = 20\n[log]\nlevel = \"debug\"\nformat = \"json\"\n";
    let s = load(&folder, text).unwrap();
    assert_eq!((s.shutter.exposure_s, s.shutter.readout_s), (Some(0.01), Some(0.02)));
    assert_eq!(s.mask_for(320, 240).unwrap().dimensions(), (320, 240));
    assert_eq!(
        (s.device.width, s.device.height, s.device.fps, s.device.format),
        (Some(1280), Some(720), Some(59.94), Some(PixelLayout::Grey))
    );
    assert_eq!((s.device.controls["gain"], s.device.latency.as_millis()), (3, 120));
    assert_eq!((s.tracker.threads, s.tracker.features, s.tracker.coast_s, s.tracker.confirm_frames, s.tracker.seed), (2, 800, 0.0, 3, 9));
    assert_eq!(s.recorder, RecorderSettings { folder: folder.path().join("takes"), continuous: true, ring_s: 20.0 });
    assert_eq!(s.log, LogSettings { level: LevelFilter::DEBUG, format: LogFormat::Json });
    assert_eq!(s.stage.surfaces[0].pose.translation.as_slice(), [1.0, 2.0, 3.0]);
    assert!((s.stage.surfaces[0].pose.rotation.coords.norm() - 1.0).abs() < 1e-12);
    assert_eq!((s.objects[0].name.as_str(), s.objects[0].surfaces.len()), ("cart", 1));
    assert_eq!(s.notes, ["photo.png: no photo_calibration; the photograph has the camera's size, so the camera's calibration is used"]);
}

#[test]
fn a_scaled_clip_is_noted_and_another_shape_refused() {
    let folder = folder();
    let settings = load(&folder, GOOD).unwrap();
    assert_eq!(settings.camera_for(640, 480).unwrap().1, None);
    let (camera, note) = settings.camera_for(320, 240).unwrap();
    assert_eq!(camera.intrinsics().fx, 300.0);
    assert_eq!(note.unwrap(), "the calibration for 640 x 480 pixels is scaled to the pictures' 320 x 240");
    let refusal = settings.camera_for(640, 360).unwrap_err().to_string();
    assert!(refusal.contains("the calibration is for 640 x 480 pixels, the pictures are 640 x 360"), "{refusal}");
}

/// Returns GOOD with a line after its [camera] section.
pub(super) fn camera_plus(line: &str) -> String {
    GOOD.replace("[[stage", &format!("{line}\n[[stage"))
}

#[test]
fn unknown_keys_are_reported_with_place_and_nearest_name() {
    let folder = folder();
    let cases = [
        (
            GOOD.replace("calibration", "calibraton"),
            "stage.toml: unknown key `calibraton` in [camera], line 2; did you mean `calibration`?",
        ),
        (format!("{GOOD}sizem = 1"), "stage.toml: unknown key `sizem` in [[stage.surface]], line 6; did you mean `size_m`?"),
        (camera_plus("features = 3"), "stage.toml: unknown key `features` in [camera], line 3; it belongs to [tracker]"),
        (format!("{GOOD}[log]\nx9 = 1"), "stage.toml: unknown key `x9` in [log], line 7; [log] knows level, format"),
        (format!("{GOOD}[trackr]"), "stage.toml: unknown section [trackr], line 6; did you mean `tracker`?"),
        (
            format!("a = 1\n{GOOD}"),
            "stage.toml: unknown key `a` in the config, line 1; the config knows camera, stage, object, survey, map, mount, tracker, recorder, timecode, other_tracker, filter, safety, output, http, log",
        ),
        (format!("{GOOD}[recorder]\nring = 1"), "stage.toml: unknown key `ring` in [recorder], line 7; did you mean `ring_s`?"),
        (
            GOOD.replace("\"camera.toml\"", "\"camera.toml"),
            "stage.toml: line 2 is not TOML: invalid basic string, expected `\"`; the quote is not closed; write: calibration = \"camera.toml\"",
        ),
        (
            GOOD.replace("\"camera.toml\"", "7"),
            "stage.toml: `calibration` in [camera], line 2: invalid type: integer `7`, expected a string",
        ),
        (
            GOOD.replace("[4, 3]", "[4, 3, 2]"),
            "stage.toml: `size_m` in [[stage.surface]], line 5: invalid length 3, expected an array of 2 entries",
        ),
        (
            format!("{GOOD}[tracker]\nseed = -1"),
            "stage.toml: `seed` in [tracker], line 7: invalid value: integer `-1`, expected a whole number of 0 or more",
        ),
    ];
    for (text, wanted) in cases {
        assert_eq!(message(&folder, &text), wanted, "{text}");
    }
}

#[test]
fn config_typing_slips_get_the_corrected_line() {
    let folder = folder();
    for (text, line, wanted) in [
        (GOOD.replace("[[stage.surface]]", "[stage.surface]"), "`surface` in [stage], line 3", "write [[stage.surface]]"),
        (
            format!("{}[stage.surface] # a flat\nimage = \"a.png\"\n", GOOD.replace("[[stage.surface]]", "[stage.surface]")),
            "line 6 is not TOML: duplicate key",
            "write [[stage.surface]] each time",
        ),
        (format!("{GOOD}[camera]\nfov_deg = 50.0\n"), "line 6 is not TOML: duplicate key", "[camera] already exists at line 1"),
        (format!("{GOOD}[output]\nprotocol = \"freed\""), "`output` in the config, line 6", "write [[output]]"),
        (format!("{GOOD}[object]\nname = \"a\""), "`object` in the config, line 6", "write [[object]]"),
        (GOOD.replace("[camera]", "[[camera]]"), "`camera` in the config, line 1", "write [camera]"),
        (GOOD.replace("[4, 3]", "[0,4, 0,22]"), "line 5: invalid length 4", "write: [0.4, 0.22]"),
        (camera_plus("exposure_s = 0,02"), "line 3 is not TOML", "write: exposure_s = 0.02"),
        (GOOD.replace("\"camera.toml\"", "“camera.toml”"), "line 2 is not TOML", "write: calibration = \"camera.toml\""),
        (GOOD.replace("\"camera.toml\"", "\"C:\\Users\\a.toml\""), "line 2 is not TOML", "write: calibration = \"C:/Users/a.toml\""),
    ] {
        let said = message(&folder, &text);
        assert!(said.contains(line) && said.contains(wanted), "{text}: {said}");
    }
}

#[test]
fn missing_keys_are_named_with_an_example() {
    let folder = folder();
    let calibration = "add calibration = \"camera.toml\" (width, height, fx, fy, cx, cy, skew, distortion), or for a first look fov_deg = 60 (degrees across the picture)";
    let cases = [
        (String::new(), format!("stage.toml: the config has no `camera.calibration`; {calibration}")),
        (GOOD.replace("calibration = \"camera.toml\"", ""), format!("stage.toml: [camera], line 1, has no `calibration`; {calibration}")),
        (
            GOOD.lines().take(2).map(|l| format!("{l}\n")).collect(),
            "stage.toml: the config has no `stage.surface`; add a section [[stage.surface]] with an `image` or a `photo` of the stage and its `size_m`".to_owned(),
        ),
        (
            GOOD.replace("size_m = [4, 3]", ""),
            "stage.toml: [[stage.surface]], line 3, has no `size_m`; add the width and height between the picture's outer edges in metres, such as size_m = [4.0, 3.0]".to_owned(),
        ),
        (
            GOOD.replace("image = \"art.png\"", ""),
            "stage.toml: [[stage.surface]], line 3, has no `image`; add image = \"artwork.png\", or photo = \"photo.jpg\" with corners_px".to_owned(),
        ),
        (
            GOOD.replace("image = \"art.png\"", "photo = \"photo.png\""),
            "stage.toml: [[stage.surface]], line 3, has no `corners_px`; add the surface's corners in the photograph, clockwise from the top left: corners_px = [[u, v], [u, v], [u, v], [u, v]]".to_owned(),
        ),
        (format!("{GOOD}[[object]]"), "stage.toml: [[object]], line 6, has no `name`; add a name for the records, such as name = \"prop\"".to_owned()),
        (
            format!("{GOOD}[[object]]\nname = \"a\""),
            "stage.toml: [[object]], line 6, has no `surface`; add a section [[object.surface]] below it, with its picture and size".to_owned(),
        ),
    ];
    for (text, wanted) in cases {
        assert_eq!(message(&folder, &text), wanted, "{text}");
    }
}

#[test]
fn wrong_values_are_refused() {
    let folder = folder();
    let photo = |corners: &str| GOOD.replace("image = \"art.png\"", &format!("photo = \"photo.png\"\ncorners_px = {corners}"));
    let object = |name: &str| format!("[[object]]\nname = \"{name}\"\n[[object.surface]]\nimage = \"art.png\"\nsize_m = [4, 3]\n");
    let cases = [
        (
            camera_plus("exposure_s = -0.1"),
            "`exposure_s` in [camera], line 3: -0.1 cannot be used; give seconds from 0 (unknown) to 1; 15 milliseconds are 0.015",
        ),
        (
            camera_plus("readout_s = nan"),
            "`readout_s` in [camera], line 3: NaN cannot be used; give seconds from 0 (unknown) to 1; 15 milliseconds are 0.015",
        ),
        (camera_plus("fps = 0"), "`fps` in [camera], line 3: 0 cannot be used; give frames per second, above 0, at most 1000"),
        (camera_plus("format = \"h264\""), "`format` in [camera], line 3: `h264` cannot be used; give mjpeg, yuyv, nv12, grey or rgb"),
        (
            camera_plus("mask = \"art.png\"").replace("[4, 3]", "[4, 0.0]"),
            "`size_m` in [[stage.surface]], line 6: [4.0, 0.0] cannot be used; give a width and a height above 0 metres",
        ),
        (
            camera_plus("mask = \"black.png\""),
            "`mask` in [camera], line 3: the mask black.png is black everywhere, so nothing could be tracked; leave white what to use",
        ),
        (
            GOOD.replace("[4, 3]", "[nan, 3]"),
            "`size_m` in [[stage.surface]], line 5: [NaN, 3.0] cannot be used; give a width and a height above 0 metres",
        ),
        (
            GOOD.replace("art.png", "none.png"),
            "`image` in [[stage.surface]], line 4: none.png: No such file or directory (os error 2); name a readable PNG, JPEG or PGM picture",
        ),
        (
            format!("{GOOD}position_m = [0, inf, 0]"),
            "`position_m` in [[stage.surface]], line 6: [0.0, inf, 0.0] cannot be used; give three numbers of metres between -10000 and 10000",
        ),
        (
            format!("{GOOD}orientation_xyzw = [0, 0, 0, 0]"),
            "`orientation_xyzw` in [[stage.surface]], line 6: the length of the quaternion is 0.0000, not 1; give x, y, z, w of a unit quaternion",
        ),
        (
            format!("{GOOD}orientation_xyzw = [0, 0, nan, 1]"),
            "`orientation_xyzw` in [[stage.surface]], line 6: the length of the quaternion is NaN, not 1; give x, y, z, w of a unit quaternion",
        ),
        (
            format!("{GOOD}rotation_deg = [0, 0, 0]\norientation_xyzw = [0, 0, 0, 1]"),
            "`rotation_deg` in [[stage.surface]], line 6: a surface has either `orientation_xyzw` or `rotation_deg`, this one has both; remove one",
        ),
        (
            format!("{GOOD}rotation_deg = [0, 361, 0]"),
            "`rotation_deg` in [[stage.surface]], line 6: [0.0, 361.0, 0.0] cannot be used; give [turn, tilt, roll], three angles in degrees between -360 and 360",
        ),
        (
            format!("{GOOD}rotation_deg = [nan, 0, 0]"),
            "`rotation_deg` in [[stage.surface]], line 6: [NaN, 0.0, 0.0] cannot be used; give [turn, tilt, roll], three angles in degrees between -360 and 360",
        ),
        (camera_plus("fov_deg = 60"), "`fov_deg` in [camera], line 3: [camera] has a `calibration` too, which is better; remove this one"),
        (
            GOOD.replace("calibration = \"camera.toml\"", "fov_deg = 180"),
            "`fov_deg` in [camera], line 2: 180 cannot be used; give the degrees across the picture's width, from 1 to 170",
        ),
        (
            GOOD.replace("calibration = \"camera.toml\"", "fov_deg = 60\nfocal_35mm_mm = 26"),
            "`focal_35mm_mm` in [camera], line 3: [camera] has `fov_deg` too; remove one of them",
        ),
        (
            GOOD.replace("calibration = \"camera.toml\"", "fov_deg = 60\nwidth = 640\nheight = 360\nmask = \"mask.png\""),
            "`mask` in [camera], line 5: the mask mask.png is 640 x 480 pixels, the camera 640 x 360; paint it on a picture of the camera",
        ),
        (
            camera_plus("format = \"mpeg\""),
            "`format` in [camera], line 3: `mpeg` cannot be used; give mjpeg, yuyv, nv12, grey or rgb; did you mean `mjpeg`?",
        ),
        (
            format!("{GOOD}photo = \"photo.png\""),
            "`photo` in [[stage.surface]], line 6: a surface has either `image` or `photo`, this one has both; remove one",
        ),
        (
            format!("{GOOD}corners_px = [[0, 0], [1, 0], [1, 1], [0, 1]]"),
            "`corners_px` in [[stage.surface]], line 6: it belongs to `photo`, but this surface has an `image`; remove it",
        ),
        (
            photo("[[10, 10], [20, 450], [590, 440], [600, 12]]"),
            "`corners_px` in [[stage.surface]], line 5: photo.png: corners_px is not a convex quadrilateral; give top left, top right, bottom right, bottom left, clockwise in the photograph, in pixels; these run anticlockwise or cross: write \
             corners_px = [[10.0, 10.0], [600.0, 12.0], [590.0, 440.0], [20.0, 450.0]]",
        ),
        (
            photo("[[10, 10], [600, 12], [100, 100], [20, 450]]"),
            "`corners_px` in [[stage.surface]], line 5: photo.png: corners_px is not a convex quadrilateral; give top left, top right, bottom right, bottom left, clockwise in the photograph, in pixels",
        ),
        (
            format!("{GOOD}{}{}", object("a"), object("a")),
            "`name` in [[object]], line 12: the name `a` is taken; give each object a name of its own (`stage` is the stage itself)",
        ),
        (
            format!("{GOOD}{}", object("stage")),
            "`name` in [[object]], line 7: the name `stage` is taken; give each object a name of its own (`stage` is the stage itself)",
        ),
        (
            format!("{GOOD}{}", object(" ")),
            "`name` in [[object]], line 7: an empty text cannot be used; give a name for the records, such as \"prop\"",
        ),
        (format!("{GOOD}[tracker]\nthreads = 0"), "`threads` in [tracker], line 7: 0 cannot be used; give 1 to 64 threads"),
        (format!("{GOOD}[tracker]\nconfirm_frames = 1"), "`confirm_frames` in [tracker], line 7: 1 cannot be used; give 2 to 100 frames"),
        (
            format!("{GOOD}[log]\nlevel = \"loud\""),
            "`level` in [log], line 7: `loud` cannot be used; give off, error, warn, info, debug or trace",
        ),
    ];
    for (text, wanted) in cases {
        assert_eq!(message(&folder, &text), format!("stage.toml: {wanted}"), "{text}");
    }
}

#[test]
fn invalid_referenced_files_are_named() {
    let folder = folder();
    std::fs::write(folder.path().join("nan.toml"), CAMERA.replace("fx = 600.0", "fx = nan")).unwrap();
    std::fs::write(folder.path().join("negative.toml"), CAMERA.replace("fx = 600.0", "fx = -600.0")).unwrap();
    let cases: [(String, &[&str]); 6] = [
        (GOOD.replace("camera.toml", "nan.toml"), &["`calibration` in [camera], line 2:", "nan.toml", "fx", "NaN"]),
        (GOOD.replace("camera.toml", "negative.toml"), &["negative.toml", "fx", "-600"]),
        (GOOD.replace("camera.toml", "none.toml"), &["`calibration` in [camera], line 2:", "none.toml"]),
        (GOOD.replace("art.png", "broken.png"), &["`image` in [[stage.surface]], line 4: broken.png: "]),
        (GOOD.replace("art.png", "flat.png"), &["`image` in [[stage.surface]], line 4: flat.png: the picture has too little texture"]),
        (
            camera_plus("mask = \"flat.png\"").replace("camera.toml", "wide.toml"),
            &["mask flat.png is 400 x 300 pixels, the camera 640 x 360"],
        ),
    ];
    let wide = CAMERA.replace("height = 480", "height = 360");
    std::fs::write(folder.path().join("wide.toml"), wide).unwrap();
    for (text, parts) in cases {
        let message = message(&folder, &text);
        assert!(message.starts_with("stage.toml: ") && parts.iter().all(|part| message.contains(part)), "{message}");
    }
}

#[test]
fn a_photograph_from_another_camera_is_noted() {
    let folder = folder();
    let text = "[camera]\ncalibration = \"camera.toml\"\n[[stage.surface]]\nphoto = \"art.png\"\ncorners_px = [[9, 9], [380, 9], [380, 280], [9, 280]]\nsize_m = [4, 3]\n";
    let note = &load(&folder, text).unwrap().notes[0];
    assert!(
        note.starts_with("art.png: no photo_calibration, and its size is not the camera's: no distortion and a focal length of 400 pixels"),
        "{note}"
    );
    let note = &load(&folder, &format!("{text}photo_calibration = \"camera.toml\"")).unwrap().notes[0];
    assert_eq!(note, "art.png: its calibration for 640 x 480 pixels is scaled to the photograph's 400 x 300");
}

#[test]
fn transparency_gets_a_warning_and_an_opaque_alpha_does_not() {
    let folder = folder();
    let art = image::open(folder.path().join("art.png")).unwrap().to_rgba8();
    art.save(folder.path().join("art.png")).unwrap();
    assert_eq!(load(&folder, GOOD).unwrap().warnings, Vec::<String>::new());
    let mut half_unseen = art;
    half_unseen.pixels_mut().step_by(2).for_each(|pixel| pixel.0[3] = 0);
    half_unseen.save(folder.path().join("art.png")).unwrap();
    let settings = load(&folder, GOOD).unwrap();
    assert_eq!(settings.warnings.len(), 1, "{:?}", settings.warnings);
    assert!(settings.warnings[0].starts_with("art.png: 50.0 % of it is transparent, which is treated as white paper"));
    assert!(!settings.notes.join(";").contains("transparent"), "{:?}", settings.notes);
}

#[test]
fn pixels_that_are_not_square_are_noted() {
    let note = &load(&folder(), &GOOD.replace("[4, 3]", "[4, 2]")).unwrap().notes[0];
    assert_eq!(note, "art.png: at this size_m its pixels are 1.500 times as wide as high; check size_m");
}

const EXAMPLE: &str = include_str!("../../config/stage.toml");

#[test]
fn the_example_has_every_key_and_nothing_else() {
    Config::parse(EXAMPLE, Path::new("stage.toml")).unwrap();
    for (section, keys) in known_keys() {
        let bare = section.trim_matches(['[', ']']);
        assert!(EXAMPLE.contains(section) || keys.contains(&"surface") || section == "[survey]", "{section} is not in the example");
        for key in keys.iter().filter(|key| !["surface", "map", "pose", "value", "distance", "point", "seen"].contains(*key)) {
            let there = EXAMPLE.lines().any(|line| line.trim_start_matches(['#', ' ']).starts_with(&format!("{key} = ")));
            assert!(there, "{bare}.{key} is not in the example");
        }
    }
}

#[test]
fn the_example_parses_with_every_key_uncommented() {
    let sections = [
        "[camera.pose]",
        "[mount]",
        "[stage]",
        "[[object]]",
        "[[object.surface]]",
        "[[stage.surface]]",
        "[stage.map]",
        "[[output]]",
        "[[output.value]]",
        "[[survey.distance]]",
        "[[survey.point]]",
        "[map]",
        "[[map.point]]",
        "[[map.point.seen]]",
        "[[map.distance]]",
        "[timecode]",
        "[other_tracker]",
    ];
    let keys: Vec<&str> = known_keys().flat_map(|(_, keys)| keys.iter().copied()).collect();
    let opened = |line: &str| {
        let bare = line.trim_start_matches(['#', ' ']);
        let is_key = bare.split_once(" = ").is_some_and(|(key, _)| keys.contains(&key));
        if is_key || sections.contains(&bare) { bare.to_owned() } else { line.to_owned() }
    };
    let text: String = EXAMPLE.lines().map(|line| opened(line) + "\n").collect();
    let config = Config::parse(&text, Path::new("stage.toml")).unwrap();
    assert_eq!((config.stage.unwrap().get_ref().surface.len(), config.object.len()), (2, 1));
    assert_eq!(config.camera.unwrap().get_ref().controls.as_ref().unwrap().len(), 2);
    assert!(config.mount.unwrap().get_ref().delay_s.is_some());
    assert!(config.tracker.unwrap().seed.is_some() && config.log.unwrap().level.is_some());
}

/// Generates texts that are almost configs.
fn pieces() -> impl Strategy<Value = String> {
    let keys: Vec<String> = known_keys().flat_map(|(s, keys)| keys.iter().map(move |k| format!("{s}\n{k} = "))).collect();
    let values = ["1", "-1", "nan", "[1, 2]", "[[1,2],[3,4],[5,6],[7,8]]", "\"x\"", "{ a = 1 }", "true", "[", "\"\"\"", "1979-05-27", "é"];
    prop::collection::vec((prop::sample::select(keys), prop::sample::select(values.to_vec())), 0..8)
        .prop_map(|pairs| pairs.into_iter().map(|(key, value)| format!("{key}{value}\n")).collect())
}

proptest! {
    #[test]
    fn arbitrary_text_never_panics(text in ".{0,300}") {
        let _ = Config::parse(&text, Path::new("stage.toml")).map_err(|e| e.to_string());
    }

    #[test]
    fn nearly_right_text_never_panics(text in pieces()) {
        let _ = Settings::from_text(&text, Path::new("no-such-folder/stage.toml")).map_err(|e| e.to_string());
    }
}

#[test]
fn surface_uncertainties_are_read_and_have_defaults() {
    let folder = folder();
    let second = "[[stage.surface]]\nimage = \"art.png\"\nsize_m = [1, 1]\nposition_m = [0, 0, 2]\n";
    let doubts = |text: &str| load(&folder, text).unwrap().stage.surfaces.iter().map(|s| s.doubt).collect::<Vec<_>>();
    let usual = doubts(&format!("{GOOD}{second}"));
    assert_eq!((usual[0].position_m, usual[0].rotation_rad, usual[0].corner_px), (0.0, 0.0, 0.0));
    assert_eq!((usual[1].position_m, usual[1].rotation_rad), (0.0, 0.0));
    let typed = doubts(&format!("{GOOD}{second}position_sigma_m = 0.02\nrotation_sigma_deg = 0.3\n"));
    assert_eq!((typed[1].position_m, typed[1].rotation_rad), (0.02, 0.3_f64.to_radians()));
    let cases = [
        ("corner_sigma_px = 1", "it belongs to `photo`, but this surface has an `image`; remove it"),
        ("position_sigma_m = -0.1", "metres from 0 to 10"),
        ("rotation_sigma_deg = 90", "degrees from 0 to 45"),
    ];
    for (line, wanted) in cases {
        let refusal = message(&folder, &format!("{GOOD}{line}\n"));
        let key = line.split(' ').next().unwrap();
        assert!(refusal.contains(key) && refusal.contains("line 6") && refusal.contains(wanted), "{refusal}");
    }
}

#[test]
fn too_many_surfaces_are_refused_before_reading_pictures() {
    let folder = tempfile::tempdir().unwrap();
    fill(folder.path());
    let config = |stage: usize, object: usize, image: &str| {
        let surface = |of: &str| format!("[[{of}.surface]]\nimage = \"{image}\"\nsize_m = [4, 3]\n");
        let object = if object == 0 { String::new() } else { format!("[[object]]\nname = \"a\"\n{}", surface("object").repeat(object)) };
        let text = format!("[camera]\ncalibration = \"camera.toml\"\n{}{object}", surface("stage").repeat(stage));
        Settings::from_text(&text, &folder.path().join("stage.toml"))
    };
    assert_eq!(config(6, 2, "art.png").unwrap().stage.surfaces.len(), 6);
    let said = config(70, 30, "none.png").unwrap_err().to_string();
    assert!(said.contains("none.png") && !said.contains("surfaces cannot"), "100 are not too many: {said}");
    for (stage, object, line) in [(300, 0, 303), (60, 60, 305)] {
        let said = config(stage, object, "none.png").unwrap_err().to_string();
        assert!(said.contains(&format!("line {line}: {} surfaces cannot be used; give at most 100", stage + object)), "{said}");
    }
}
