//! What people write without a calibration and without quaternions: angles, a guessed lens, words
//! in any case.

use tracing::level_filters::LevelFilter;

use super::tests::{CAMERA, GOOD, camera_plus, folder, load};
use super::*;
use crate::capture::camera::PixelLayout;

#[test]
fn angles_and_quaternion_state_the_same_rotation() {
    let folder = folder();
    let rotation = |line: &str| load(&folder, &format!("{GOOD}{line}")).unwrap().stage.surfaces[0].pose.rotation;
    let half = "0.7071067811865476";
    let same = [
        ("rotation_deg = [0, 0, 0]".to_owned(), String::new()),
        ("rotation_deg = [0, -90, 0]".to_owned(), "orientation_xyzw = [0, 0, 0, 1]".to_owned()),
        ("rotation_deg = [90, 0, 0]".to_owned(), "orientation_xyzw = [0.5, 0.5, 0.5, 0.5]".to_owned()),
        ("rotation_deg = [180, -90, 0]".to_owned(), "orientation_xyzw = [0, 0, 1, 0]".to_owned()),
        ("rotation_deg = [0, -90, 90]".to_owned(), format!("orientation_xyzw = [0, 0, {half}, {half}]")),
    ];
    for (angles, quaternion) in same {
        assert!(rotation(&angles).angle_to(&rotation(&quaternion)) < 1e-7, "{angles} {quaternion}");
    }
    let object = "[[object]]\nname = \"table\"\n[[object.surface]]\nimage = \"art.png\"\nsize_m = [4, 3]\nrotation_deg = [0, -90, 0]\n";
    let table = &load(&folder, &format!("{GOOD}{object}")).unwrap().objects[0].surfaces[0];
    assert!((table.pose.rotation * nalgebra::Vector3::z() - nalgebra::Vector3::z()).norm() < 1e-12, "it looks up");
}

#[test]
fn a_guessed_lens_states_its_uncertainty() {
    let folder = folder();
    let guessed = |lines: &str| load(&folder, &GOOD.replace("calibration = \"camera.toml\"", lines));
    // Without a size, the guess is for pictures of any aspect ratio.
    let settings = guessed("fov_deg = 90").unwrap();
    for (width, height) in [(640, 480), (1920, 1080), (480, 640)] {
        let (camera, note) = settings.camera_for(width, height).unwrap();
        let i = camera.intrinsics();
        assert!((i.fx - f64::from(width) / 2.0).abs() < 1e-9 && i.fx == i.fy && note.is_none());
        assert_eq!((i.cx, i.cy), ((f64::from(width) - 1.0) / 2.0, (f64::from(height) - 1.0) / 2.0));
        let uncertainty = camera.doubt().unwrap().uncertainty;
        assert!((uncertainty.focal_px[0] / i.fx - 0.09).abs() < 1e-9 && uncertainty.centre_px[0] > 0.05 * f64::from(width));
    }
    // With a size, other aspect ratios are refused and other sizes scaled, as for a calibration.
    let settings = guessed("focal_35mm_mm = 26\nwidth = 1280\nheight = 720").unwrap();
    assert_eq!((settings.camera.width(), settings.camera.height()), (1280, 720));
    assert!(settings.camera_for(640, 480).is_err() && settings.camera_for(640, 360).unwrap().1.is_some());
    // A mask whose aspect ratio differs from the clip's is refused at that point.
    let settings = guessed("fov_deg = 60\nmask = \"mask.png\"").unwrap();
    assert!(settings.camera_for(1280, 960).is_ok());
    let said = settings.camera_for(1280, 720).unwrap_err().to_string();
    assert!(
        said.contains("`mask` in [camera], line 3: the mask")
            && said.ends_with("the camera 1280 x 720; paint it on a picture of the camera"),
        "{said}"
    );
    // A photograph without its own calibration uses the camera's.
    let photo = "[[stage.surface]]\nphoto = \"photo.png\"\ncorners_px = [[10, 10], [600, 12], [590, 440], [20, 450]]\nsize_m = [4, 3]\n";
    let settings = load(&folder, &format!("[camera]\nfov_deg = 60\n{photo}")).unwrap();
    assert_eq!(settings.notes, ["photo.png: no photo_calibration; the guess for the camera's own lens is used"]);
}

#[test]
fn the_uncertainty_of_a_calibration_is_kept() {
    let folder = folder();
    assert_eq!(load(&folder, GOOD).unwrap().camera.doubt(), None);
    let uncertainty = "[uncertainty]\nfx = 3.0\nfy = 3.0\ncx = 6.0\ncy = 6.0\n";
    std::fs::write(folder.path().join("camera.toml"), format!("{CAMERA}{uncertainty}")).unwrap();
    let settings = load(&folder, GOOD).unwrap();
    assert_eq!(settings.camera.doubt().unwrap().uncertainty.centre_px[0], 6.0);
    assert_eq!(settings.camera_for(320, 240).unwrap().0.doubt().unwrap().uncertainty.centre_px[0], 3.0);
}

#[test]
fn words_may_be_written_in_any_case() {
    let folder = folder();
    let text = format!("{}[filter]\nkind = \"One_Euro\"\n[log]\nlevel = \"WARN\"\nformat = \"Json\"\n", camera_plus("format = \"MJPEG\""));
    let settings = load(&folder, &text).unwrap();
    assert_eq!(
        (settings.device.format, settings.log.level, settings.log.format),
        (Some(PixelLayout::Mjpeg), LevelFilter::WARN, LogFormat::Json)
    );
    assert!(matches!(settings.filter.kind, crate::pose::FilterKind::OneEuro(_)));
}
