//! Tests of all calibration formats, of refusals and their messages, and of arbitrary text.

use proptest::prelude::*;

use super::*;

fn read(name: &str, text: &str) -> Result<Calibration, CalibrationFileError> {
    parse_calibration(text.as_bytes(), Path::new(name))
}

fn intrinsics(name: &str, text: &str) -> Intrinsics {
    *read(name, text).unwrap().model.intrinsics()
}

/// The message of a refused file; it must be one line that starts with the file's name.
#[track_caller]
fn refusal(name: &str, text: &str) -> String {
    let message = read(name, text).unwrap_err().to_string();
    assert!(message.starts_with(name) && !message.contains('\n'), "{message}");
    message
}

const STAGEPOSE: &str = "width = 1280\nheight = 720\nfx = 900.5\nfy = 901\ncx = 640.25\ncy = 359.0\nskew = 0.001\n\
    distortion = [-0.1, 0.05, 0.001, -0.002, 0.0]\nrms_px = 0.2\nimages = 20\ndate = \"2026-01-02\"\n\n\
    [uncertainty]\nfx = 1.0\nfy = 1.5\ncx = 2.0\ncy = 2.5\nskew = 0.0\ndistortion = [0.01, 0.02, 0.001, 0.001, 0.0]\n";

const OPENCV: &str = "%YAML:1.0\n---\ncalibration_time: \"Mon 1 Jan 2024\"\nnframes: 13\nimage_width: 640\nimage_height: 480\n\
    camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 5.34e+02, 1.068, 3.42e+02, 0.,\n       5.36e+02, 2.35e+02, 0., 0., 1. ]\n\
    distortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ -2.6e-01, -3.8e-02,\n       1.7e-03, -2.8e-04, .5 ]\n\
    avg_reprojection_error: 3.9e-01\n";

const ROS: &str = "image_width: 752\nimage_height: 480\ncamera_name: cam\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [435.2, 0, 367.4, 0, 435.3, 252.2, 0, 0, 1]\n\
    distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.36, 0.15, 0.001, 0.002, 0]\n\
    rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n";

const BOUGUET: &str = "% Intrinsic and Extrinsic Camera Parameters\n%-- Focal length:\nfc = [ 657.462 ; 657.945 ];\ncc = [ 303.137 ; 242.569 ];\n\
    alpha_c = 0.0004;\nkc = [ -0.2553 ; 0.1275 ; -0.0002 ; 0.00003 ; 0.000 ]; % distortion\nfc_error = [ 0.317 ; 0.340 ];\n\
    cc_error = [ 0.645 ; 0.591 ];\nalpha_c_error = 0.0001;\nkc_error = [ 0.0027 ; 0.0107 ; 0.0001 ; 0.0001 ; 0.0 ];\nnx = 640;\nny = 480;\nn_ima = 20;\n\
    omc_1 = [ 1.654 ; NaN ; -0.669 ];\nTc_1  = [ -1.77 ; -8.3 ; 8.5 ];\n";

#[test]
fn every_field_of_a_stagepose_toml_is_read() {
    let c = read("camera.toml", STAGEPOSE).unwrap();
    let i = c.model.intrinsics();
    assert_eq!((i.width, i.height, i.fx, i.fy, i.cx, i.cy, i.skew), (1280, 720, 900.5, 901.0, 640.25, 359.0, 0.001));
    assert_eq!(i.distortion, [-0.1, 0.05, 0.001, -0.002, 0.0]);
    let u = c.uncertainty.unwrap();
    assert_eq!((u.focal_px, u.centre_px, u.skew, u.distortion[1]), ([1.0, 1.5], [2.0, 2.5], 0.0, 0.02));
    assert_eq!((c.rms_px, c.images, c.date.as_deref(), c.form), (Some(0.2), Some(20), Some("2026-01-02"), CalibrationForm::Stagepose));
}

#[test]
fn opencv_yaml_is_read_with_its_skew() {
    let c = read("camera.yml", OPENCV).unwrap();
    let i = c.model.intrinsics();
    assert_eq!((i.width, i.height, i.fx, i.fy, i.cx, i.cy), (640, 480, 534.0, 536.0, 342.0, 235.0));
    assert_eq!(i.distortion, [-0.26, -0.038, 0.0017, -0.00028, 0.5]);
    assert!((i.skew - 1.068 / 534.0).abs() < 1e-15);
    assert!((c.model.k_matrix()[(0, 1)] - 1.068).abs() < 1e-12, "K[0][1] = fx alpha_c");
    assert_eq!((c.images, c.rms_px, c.form), (Some(13), Some(0.39), CalibrationForm::OpenCv));
}

#[test]
fn other_spellings_of_opencv_files_are_read() {
    for (matrix, distortion) in [("Camera_Matrix", "Distortion_Coefficients"), ("cameraMatrix", "distCoeffs"), ("K", "D")] {
        let text = OPENCV.replace("camera_matrix", matrix).replace("distortion_coefficients", distortion);
        assert_eq!(intrinsics("camera.yml", &text), intrinsics("camera.yml", OPENCV), "{matrix} {distortion}");
    }
    let sizes = OPENCV.replace("image_width", "image_Width").replace("image_height", "image_Height");
    assert_eq!(intrinsics("camera.yml", &sizes).height, 480);
    let nested = "image_width: 64\nimage_height: 48\nK: [[50, 0, 32], [0, 51, 24], [0, 0, 1]]\nD: [0.1, 0.2, 0, 0]\n";
    assert_eq!(intrinsics("camera", nested).fy, 51.0);
}

#[test]
fn coefficients_beyond_the_fifth_must_be_zero() {
    let with = |data: &str| {
        let matrix = "image_width: 64\nimage_height: 48\nK: [50, 0, 32, 0, 51, 24, 0, 0, 1]\n";
        format!("{matrix}D: [{data}]\n")
    };
    assert_eq!(intrinsics("c.yml", &with("0.1, 0.2, 0.3, 0.4")).distortion, [0.1, 0.2, 0.3, 0.4, 0.0]);
    assert_eq!(intrinsics("c.yml", &with("0.1, 0.2, 0.3, 0.4, 0.5, 0, 0, 0")).distortion[4], 0.5);
    assert_eq!(intrinsics("c.yml", &with("")).distortion, [0.0; 5]);
    let message = refusal("c.yml", &with("0.1, 0.2, 0.3, 0.4, 0.5, 0.01, 0, 0"));
    assert!(message.contains("line 4") && message.contains("rational") && message.contains("not supported"), "{message}");
    assert!(refusal("c.yml", &with("0.1, 0.2")).contains("`D` has 2 numbers"));
    assert!(refusal("c.yml", &with("0.1, x, 0, 0")).contains("`D` holds a list that is not all numbers"));
}

#[test]
fn ros_camera_info_is_read_and_other_lenses_refused() {
    let c = read("cam.yaml", ROS).unwrap();
    assert_eq!((c.form, c.model.intrinsics().fx, c.model.intrinsics().skew), (CalibrationForm::Ros, 435.2, 0.0));
    let sheared = ROS.replace("[435.2, 0, 367.4", "[435.2, 0.8704, 367.4");
    assert!((intrinsics("cam.yaml", &sheared).skew - 0.002).abs() < 1e-15);
    let rational = ROS.replace("plumb_bob", "rational_polynomial");
    assert_eq!(intrinsics("cam.yaml", &rational.replace("0.002, 0]", "0.002, 0, 0, 0, 0]")).distortion[3], 0.002);
    assert!(refusal("cam.yaml", &rational.replace("0.002, 0]", "0.002, 0, 0.1, 0, 0]")).contains("not supported"));
    let message = refusal("cam.yaml", &ROS.replace("plumb_bob", "equidistant"));
    assert!(message.contains("line 8") && message.contains("equidistant"), "{message}");
    assert!(refusal("cam.yml", &format!("{OPENCV}fisheye_model: 1\n")).contains("fisheye"));
    assert!(read("cam.yml", &format!("{OPENCV}fisheye_model: 0\n")).is_ok());
}

/// A camera_info of a 960 x 540 sensor.
const SENSOR: &str = "image_width: 960\nimage_height: 540\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [576, 0, 481.92, 0, 580, 267.84, 0, 0, 1]\n\
    distortion_model: plumb_bob\nD: [-0.11, 0.06, 0.0006, -0.0004, 0]\n";

#[test]
fn roi_and_binning_are_applied_in_both_conventions() {
    let plain = intrinsics("c.yaml", SENSOR);
    let roi =
        |[x, y, w, h]: [u32; 4]| format!("roi:\n  x_offset: {x}\n  y_offset: {y}\n  height: {h}\n  width: {w}\n  do_rectify: false\n");
    for same in [roi([0; 4]), roi([0, 0, 960, 540]), "binning_x: 0\nbinning_y: 0\n".to_owned(), "binning_x: 1\nbinning_y: 1\n".to_owned()] {
        let c = read("c.yaml", &format!("{SENSOR}{same}")).unwrap();
        assert_eq!((*c.model.intrinsics(), c.notes.len()), (plain, 0), "{same}");
    }
    let window = format!("{SENSOR}{}", roi([160, 90, 640, 360]));
    let c = read("c.yaml", &window).unwrap();
    let i = c.model.intrinsics();
    assert_eq!((i.width, i.height, i.fx, i.fy), (640, 360, 576.0, 580.0));
    assert!((i.cx - 321.92).abs() < 1e-9 && (i.cy - 177.84).abs() < 1e-9);
    assert!(c.notes[0].contains("a window of the sensor (roi: 640 x 360 pixels at 160, 90)"), "{:?}", c.notes);
    // The window's size with the sensor's matrix: P or the picture's centre shows it.
    let baxter = window.replace("image_width: 960", "image_width: 640").replace("image_height: 540", "image_height: 360");
    for text in [baxter.clone(), format!("{baxter}P: [576, 0, 321.92, 0, 0, 580, 177.84, 0, 0, 0, 1, 0]\n")] {
        assert_eq!(intrinsics("c.yaml", &text), *i, "{text}");
    }
    // The window's size with the window's matrix.
    let own = baxter.replace("481.92", "321.92").replace("267.84", "177.84");
    for text in [own.clone(), format!("{own}P: [576, 0, 321.92, 0, 0, 580, 177.84, 0, 0, 0, 1, 0]\n")] {
        let same = intrinsics("c.yaml", &text);
        assert_eq!((same.width, same.cx, same.cy), (640, 321.92, 177.84), "{text}");
    }
    // A window offset by a few pixels, and nothing shows whether the matrix is the sensor's or the
    // window's.
    let unsure = own.replace("x_offset: 160", "x_offset: 8").replace("y_offset: 90", "y_offset: 8");
    let message = refusal("c.yaml", &unsure);
    assert!(message.contains("line 9: `roi` begins at 8, 8, and it is unclear") && message.contains("a `roi` of zeros"), "{message}");
    let outside = refusal("c.yaml", &format!("{SENSOR}{}", roi([800, 90, 640, 360])));
    assert!(outside.contains("does not lie within the picture of 960 x 540"), "{outside}");
    assert!(refusal("c.yaml", &format!("{SENSOR}binning_x: -2\n")).contains("`binning_x` is -2; write a whole number"));
}

#[test]
fn binning_scales_the_intrinsics_by_the_half_pixel_rule() {
    let c = read("c.yaml", &format!("{SENSOR}binning_x: 2\nbinning_y: 2\n")).unwrap();
    let i = c.model.intrinsics();
    assert_eq!((i.width, i.height, i.fx, i.fy, i.cx, i.cy), (480, 270, 288.0, 290.0, 240.71, 133.67));
    assert!(c.notes[0].contains("2 x 2 pixels of the sensor make one"), "{:?}", c.notes);
    let both = format!("{SENSOR}binning_x: 2\nbinning_y: 1\nroi: {{x_offset: 160, y_offset: 90, height: 360, width: 640}}\n");
    let i = intrinsics("c.yaml", &both);
    assert_eq!((i.width, i.height, i.fx, i.fy), (320, 360, 288.0, 580.0));
    assert!((i.cx - (321.92 + 0.5) / 2.0 + 0.5).abs() < 1e-9 && (i.cy - 177.84).abs() < 1e-9);
}

#[test]
fn other_lens_models_are_refused_under_every_known_key() {
    for (word, model) in [
        ("fisheye: 1", "fisheye"),
        ("fisheye: true", "fisheye"),
        ("xi: 0.8", "omnidirectional"),
        ("camera_type: fisheye", "fisheye"),
        ("model: kannala_brandt", "kannala_brandt"),
        ("model_type: MEI", "MEI"),
        ("lens_model: OPENCV_FISHEYE", "OPENCV_FISHEYE"),
        ("projection_type: equidistant", "equidistant"),
        ("camera_model: ds", "ds"),
        ("distortion_model: fov", "fov"),
        ("model: eucm", "eucm"),
    ] {
        let message = refusal("c.yml", &format!("{OPENCV}{word}\n"));
        assert!(message.contains("line 20") && message.contains(model) && message.contains("not supported"), "{word}: {message}");
    }
    for word in [
        "fisheye: 0",
        "fisheye: false",
        "xi: 0",
        "model: Logitech C920",
        "type: usb",
        "camera_type: pinhole",
        "model: opencv",
        "camera_model: pinhole",
    ] {
        assert!(read("c.yml", &format!("{OPENCV}{word}\n")).is_ok(), "{word}");
    }
}

#[test]
fn ambiguous_or_ignored_entries_are_reported() {
    let four = "image_width: 64\nimage_height: 48\nK: [50, 0, 32, 0, 51, 24, 0, 0, 1]\nD: [0.01, 0.02, 0.003, 0.004]\n";
    assert!(read("c.yml", four).unwrap().notes[0].contains("`D` has four numbers"));
    assert_eq!(read("c.yml", &format!("{four}distortion_model: plumb_bob\n")).unwrap().notes, [""; 0]);
    assert_eq!(read("c.yml", &four.replace("0.01, 0.02, 0.003, 0.004", "0, 0, 0, 0")).unwrap().notes, [""; 0]);
    let camera = "  camera_model: pinhole\n  intrinsics: [50, 51, 32, 24]\n  distortion_model: radtan\n  distortion_coeffs: [0.01, 0.02, 0, 0]\n  resolution: [64, 48]\n";
    let one = read("c.yaml", &format!("cam0:\n{camera}")).unwrap();
    let two = read("c.yaml", &format!("cam0:\n{camera}cam1:\n{camera}")).unwrap();
    assert_eq!((one.notes.len(), two.notes.len()), (0, 1));
    assert!(two.notes[0].contains("2 cameras (cam0, cam1), of which cam0 is read"), "{:?}", two.notes);
    let boof = "pinhole:\n  fx: 500\n  fy: 500\n  cx: 320\n  cy: 240\n  width: 640\n  height: 480\n  skew: 0\nradial_tangential:\n  radial: [0.1, 0.2]\n  t1: 0\n  t2: 0\nmodel: pinhole_radial_tangential\n";
    let message = refusal("c.yaml", boof);
    assert!(message.contains("this is a file of BoofCV") && message.contains("distortion = [radial 1"), "{message}");
    let uncalibrated = "image_width: 640\nimage_height: 360\nD: []\nK: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]\n";
    assert!(
        refusal("c.yaml", uncalibrated)
            .contains("line 4: `K` is all zeros, which is how ROS says that this camera has not been calibrated")
    );
}

#[test]
fn utf_16_is_read_in_every_form() {
    for (name, text) in [("c.toml", STAGEPOSE), ("c.yml", OPENCV), ("c.yaml", ROS), ("c.m", BOUGUET)] {
        let units = |of: fn(u16) -> [u8; 2]| text.encode_utf16().flat_map(of).collect::<Vec<u8>>();
        for bytes in [[&b"\xFF\xFE"[..], &units(u16::to_le_bytes)].concat(), units(u16::to_le_bytes), units(u16::to_be_bytes)] {
            assert_eq!(parse_calibration(&bytes, Path::new(name)).unwrap(), read(name, text).unwrap(), "{name}");
        }
    }
}

#[test]
fn bouguet_is_read_with_its_errors_and_without_its_boards() {
    for name in ["Calib_Results.m", "noextension"] {
        let c = read(name, BOUGUET).unwrap();
        let i = c.model.intrinsics();
        assert_eq!((i.width, i.height, i.fx, i.fy, i.cx, i.cy, i.skew), (640, 480, 657.462, 657.945, 303.137, 242.569, 0.0004));
        assert_eq!(i.distortion, [-0.2553, 0.1275, -0.0002, 0.00003, 0.0]);
        let u = c.uncertainty.unwrap();
        assert_eq!((u.focal_px[0], u.centre_px[1], u.skew, u.distortion[0]), (0.317, 0.591, 0.0001, 0.0027));
        assert_eq!((c.images, c.form), (Some(20), CalibrationForm::Bouguet));
    }
    let spread = BOUGUET.replace("[ 657.462 ; 657.945 ]", "[ 657.462\n 657.945 ]");
    assert_eq!(intrinsics("c.m", &spread).fy, 657.945);
    assert!(refusal("c.m", &BOUGUET.replace("[ 657.462 ; 657.945 ]", "[ 657.462 ]")).contains("line 3: `fc` has 1 numbers"));
    assert!(refusal("c.m", &BOUGUET.replace("657.462 ;", "six ;")).contains("`fc` holds \"six\""));
    assert!(refusal("c.m", &BOUGUET.replace("fc = [ 657.462", "fc = [ -657.462")).contains("line 3: fx is -657.462"));
    assert!(refusal("c.m", &BOUGUET.replace("nx = 640;", "")).contains("`nx` is missing"));
}

#[test]
fn unknown_keys_are_named_with_the_nearest() {
    let message = refusal("camera.toml", &STAGEPOSE.replace("distortion = [-0.1", "distorsion = [-0.1"));
    assert!(message.contains("line 8: `distorsion`") && message.contains("`distortion`?"), "{message}");
    let message = refusal("camera.toml", &format!("{STAGEPOSE}widht = 3\n"));
    assert!(message.contains("line 20: `uncertainty.widht`"), "{message}");
}

#[test]
fn wrong_values_are_named_with_key_and_line() {
    let changed = |from: &str, to: &str| refusal("camera.toml", &STAGEPOSE.replacen(from, to, 1));
    assert!(changed("fx = 900.5", "fx = nan").contains("line 3: fx is NaN"));
    assert!(changed("fx = 900.5", "fx = -3").contains("line 3: fx is -3"));
    assert!(changed("fx = 900.5", "fx = \"a\"").contains("line 3: `fx` holds a string; write a number"));
    assert!(changed("width = 1280\n", "").contains("`width` is missing"));
    assert!(changed("width = 1280", "width = 12.5").contains("line 1: `width` holds a float"));
    assert!(changed("width = 1280", "width = 0").contains("line 1: the picture is 0 x 720"));
    assert!(changed("-0.002, 0.0]", "-0.002]").contains("line 8: `distortion` has 4 numbers"));
    assert!(changed("-0.002, 0.0]", "-0.002, inf]").contains("line 8: distortion k3"));
    assert!(changed("-0.002, 0.0]", "-0.002, true]").contains("line 8: `distortion` holds a boolean"));
    assert!(changed("rms_px = 0.2", "rms_px = -1").contains("line 9: `rms_px` is -1"));
    assert!(changed("cx = 2.0\n", "").contains("`uncertainty.cx` is missing"));
    assert!(changed("fy = 901", "fy = ").contains("line 4"));
    assert!(changed("fy = 901\n", "fx = 901\n").contains("line 4"));
}

#[test]
fn duplicate_keys_are_refused_unless_the_last_one_wins() {
    let message = refusal("c.yml", &format!("{OPENCV}image_width: 320\n"));
    assert!(message.contains("line 20: `image_width` is repeated here, after `image_width` in line 5; remove one"), "{message}");
    let message = refusal("c.yaml", &format!("{ROS}Image_Height: 320\n"));
    assert!(message.contains("`Image_Height` is repeated here, after `image_height` in line 2"), "{message}");
    assert!(refusal("c.yml", &OPENCV.replacen("rows: 3", "rows: 3\n   rows: 3", 1)).contains("line 9: `rows` is repeated here"));
}

#[test]
fn impossible_camera_numbers_are_refused_in_every_format() {
    for (name, text, from, to, wanted) in [
        ("c.toml", STAGEPOSE, "fx = 900.5", "fx = 1e300", "c.toml line 3: fx is 1e300, which no camera has"),
        ("c.toml", STAGEPOSE, "cx = 640.25", "cx = 5000", "c.toml line 5: cx is 5000"),
        ("c.toml", STAGEPOSE, "[-0.1,", "[1e6,", "c.toml line 8: distortion is [1000000.0"),
        ("c.toml", STAGEPOSE, "width = 1280", "width = 4000000000", "c.toml line 1: width is 4e9"),
        ("c.toml", STAGEPOSE, "fx = 1.0", "fx = 1e300", "`uncertainty.fx` is 1000"),
        ("c.yml", OPENCV, "3.42e+02", "3.42e+08", "c.yml line 7: cx is 342000000"),
        ("c.yaml", ROS, "-0.36,", "-36,", "c.yaml line 9: distortion is [-36.0"),
        ("c.m", BOUGUET, "657.462 ;", "6.57462 ;", "c.m line 3: fx is 6.57462"),
        ("c.m", BOUGUET, "-0.2553 ;", "2553e6 ;", "c.m line 6: distortion is [2553000000.0"),
        ("c.m", BOUGUET, "0.317 ;", "1e300 ;", "c.m line 7: `fc_error` is 1000"),
    ] {
        let message = refusal(name, &text.replacen(from, to, 1));
        assert!(message.contains(wanted), "{message}");
    }
}

#[test]
fn missing_keys_and_invalid_utf8_are_reported_with_a_line() {
    for key in ["width", "fx", "cy", "distortion"] {
        let text: String = STAGEPOSE.lines().filter(|line| !line.starts_with(key)).map(|line| format!("{line}\n")).collect();
        assert!(refusal("c.toml", &text).contains(&format!("c.toml line 1: `{key}` is missing; add it")), "{key}");
    }
    let bytes = [&STAGEPOSE.as_bytes()[..20], b"\xe9", &STAGEPOSE.as_bytes()[20..]].concat();
    let message = parse_calibration(&bytes, Path::new("c.toml")).unwrap_err().to_string();
    assert_eq!(message, "c.toml line 2: there is a character that is not UTF-8; fix the file's syntax");
    let latin = [b"% Kalibrierung f\xfcr B\xfchne\n", BOUGUET.as_bytes()].concat();
    assert!(parse_calibration(&latin, Path::new("c.m")).is_ok(), "comments of other programs' files");
}

#[test]
fn broken_yaml_and_unknown_formats_are_reported() {
    assert!(refusal("c.yml", "image_width: [1, 2\nfoo: }\n").contains("fix the file's syntax"));
    assert!(refusal("c.yml", "").contains("is missing"));
    assert!(refusal("c.yml", &OPENCV.replace("5.34e+02", ".Nan")).contains("line 7: fx is NaN"));
    assert!(refusal("c.yml", &OPENCV.replace("0., 0., 1. ]", "0., 0., 2. ]")).contains("`camera_matrix` is 2"));
    assert!(refusal("c.yml", &OPENCV.replace("image_width: 640", "image_width: wide")).contains("line 5: `image_width` holds \"wide\""));
    assert!(refusal("c.yml", &"- ".repeat(100_000)).contains("nested too deeply"));
    assert!(refusal("c.yml", "a: &a [1]\nb: *a\n").contains("aliases"));
    assert!(refusal("picture.png", "\u{1}\u{2}").contains("not a known kind of calibration file"));
}

#[test]
fn real_files_are_read() {
    let data = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data"));
    let (opencv, euroc) = (data.join("calib-opencv-leftright/left_intrinsics.yml"), data.join("static-euroc-v101/sensor.yaml"));
    if !opencv.exists() || !euroc.exists() {
        eprintln!("skipped: the shared calibration files are not here");
        return;
    }
    let read = |file: &Path| parse_calibration(&std::fs::read(file).unwrap(), file).unwrap();
    let c = read(&opencv);
    assert_eq!((c.form, c.images, c.model.intrinsics().fx), (CalibrationForm::OpenCv, Some(13), 535.915_733_961_632));
    let c = read(&euroc);
    assert_eq!((c.form, c.model.width(), c.model.intrinsics().cy), (CalibrationForm::Euroc, 752, 248.375));
}

prop_compose! {
    fn calibrations()(
        width in 1u32..9000, height in 1u32..9000, f in 1.2..10.0f64, pixel in 0.5..2.0f64, c in prop::array::uniform2(0.0..1.0f64),
        skew in -1.0..1.0f64, distortion in prop::array::uniform5(-0.01..0.01f64), rms_px in prop::option::of(0.0..9.0f64),
        images in prop::option::of(any::<u32>()), date in prop::option::of(".*"),
        sigma in prop::option::of(prop::array::uniform10(0.0..1e3f64)),
    ) -> Calibration {
        let (w, h) = (f64::from(width), f64::from(height));
        // Focal length above the longer side: such distortions are invertible within 60 degrees;
        // wider ones may be refused on reading.
        let fx = f * w.max(h) / pixel.min(1.0);
        let intrinsics = Intrinsics { width, height, fx, fy: pixel * fx, cx: c[0] * w, cy: c[1] * h, skew, distortion };
        let uncertainty = sigma.map(|s| IntrinsicsUncertainty {
            focal_px: [s[0], s[1]], centre_px: [s[2], s[3]], skew: s[4], distortion: [s[5], s[6], s[7], s[8], s[9]],
        });
        Calibration { uncertainty, rms_px, images, date, ..Calibration::new(CameraModel::new(intrinsics).unwrap()) }
    }
}

proptest! {
    #[test]
    fn written_toml_reads_back_to_the_bit(calibration in calibrations()) {
        let text = calibration.to_toml();
        prop_assert_eq!(read("camera.toml", &text).map_err(|e| TestCaseError::fail(format!("{e}\n{text}")))?, calibration);
    }

    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        for name in ["c.toml", "c.yml", "c.m", "c"] {
            let _ = parse_calibration(&bytes, Path::new(name));
        }
    }

    #[test]
    fn damaged_files_end_without_panic(which in 0usize..4, at in any::<prop::sample::Index>(), with in "[\\[\\]{}=:;%.0-9a-z \n-]{0,6}", cut in 0usize..20) {
        let (name, text) = [("c.toml", STAGEPOSE), ("c.yml", OPENCV), ("c.yaml", ROS), ("c.m", BOUGUET)][which];
        let at = at.index(text.len());
        let damaged = format!("{}{with}{}", &text[..at], &text[(at + cut).min(text.len())..]);
        let _ = read(name, &damaged);
    }
}

#[test]
fn written_yaml_reads_back() {
    let intrinsics = Intrinsics {
        width: 640,
        height: 480,
        fx: 533.421,
        fy: 534.5,
        cx: 342.1,
        cy: 234.0,
        skew: 0.002,
        distortion: [-0.29, 0.1, 0.001, -0.0002, 0.03],
    };
    let mut written = Calibration::new(CameraModel::new(intrinsics).unwrap());
    written.date = Some("2026-11-21 \"noon\"".to_owned());
    written.images = Some(13);
    written.rms_px = Some(0.1635);
    for (text, form) in [(written.to_opencv_yaml(), CalibrationForm::OpenCv), (written.to_ros_yaml("stage left"), CalibrationForm::Ros)] {
        let read = parse_calibration(text.as_bytes(), Path::new("camera.yaml")).unwrap();
        assert_eq!(read.form, form);
        let i = read.model.intrinsics();
        assert!((i.skew - 0.002).abs() < 1e-15);
        assert_eq!(Intrinsics { skew: 0.002, ..*i }, intrinsics);
    }
    let read = parse_calibration(written.to_opencv_yaml().as_bytes(), Path::new("camera.yml")).unwrap();
    assert_eq!((read.rms_px, read.images), (Some(0.1635), Some(13)));
}
