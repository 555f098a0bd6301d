//! Results of `calibrate` and `board` on good pictures.

use image::{DynamicImage, ImageBuffer, Luma, Rgb, Rgba};
use stagepose::{CalibrationForm, read_calibration};

use super::scene::{FX, Scene, view, view_with_large_red};

#[test]
fn table_json_report_and_file_all_say_the_same() {
    let scene = Scene::new(10, 0.5);
    let run = scene.calibrate(&["--output", "camera.toml", "--json", "out.json", "--report", "report.html"]);
    run.assert_success();
    for line in
        ["Focal Length:          fc = [ ", "Principal point:       cc = [ ", "alpha_c = [ 0.00000 ]", "kc = [ ", "err = [ ", "Verdict: "]
    {
        assert!(run.stdout.contains(line), "{line}: {}", run.stdout);
    }
    let json = scene.json("out.json");
    let file = read_calibration(&scene.path("camera.toml")).expect("it reads back");
    let (i, u) = (file.model.intrinsics(), file.uncertainty.expect("it is written"));
    // The JSON reader may differ in the last bit.
    let same = |key: &str, value: f64| json[key].as_f64().is_some_and(|v| (v - value).abs() < 1e-12 * value.abs());
    assert!(same("fx", i.fx) && same("cy", i.cy) && same("rms_px", file.rms_px.expect("it is written")), "{json}");
    assert!(
        run.stdout.contains("Lateral colour: not measured; the pictures are grey.") && json["lateral_colour"].is_null(),
        "{}",
        run.stdout
    );
    assert_eq!((json["width"].as_u64(), json["images"].as_u64()), (Some(320), Some(10)));
    assert!((i.fx - FX).abs() < 1.5 * u.focal_px[0] && u.focal_px[0] < 3.0, "{} +- {}", i.fx, u.focal_px[0]);
    assert!(run.stdout.contains(&format!("{:.5}", i.fx)));
    assert_eq!((json["skew"].as_f64(), json["distortion"][4].as_f64()), (Some(0.0), Some(0.0)));
    assert!(["good", "usable"].contains(&json["verdict"].as_str().expect("a string")), "{}", json["sentence"]);
    let view = &json["views"][3];
    assert_eq!((view["file"].as_str(), view["found"].as_bool(), view["used"].as_bool()), (Some("pictures/03.png"), Some(true), Some(true)));
    assert_eq!(view["corners"].as_array().map(Vec::len), Some(35));
    assert_eq!((view["rotation_vector"].as_array().map(Vec::len), view["translation_m"].as_array().map(Vec::len)), (Some(3), Some(3)));
    assert!(view["uncertainty"]["translation_m"][2].as_f64().is_some_and(|s| s > 0.0 && s < 0.01));
    assert!(view["rms_px"].as_f64().is_some_and(|rms| rms < 0.1));
    let html = scene.read("report.html");
    assert!(html.starts_with("<!DOCTYPE html>") && html.trim_end().ends_with("</html>"));
    assert_eq!(html.matches("data:image/jpeg;base64,").count(), 10);
    assert_eq!(html.matches("<svg").count(), 15);
    // The report is self-contained.
    for outside in ["http://", "https://", "<script", "<link"] {
        assert!(!html.contains(outside), "{outside}");
    }
}

#[test]
fn parameters_can_be_fixed_freed_or_follow_bouguet() {
    let scene = Scene::new(8, 0.5);
    scene.calibrate(&["--fix", "p1,p2,cx=161", "--k3", "--skew", "--json", "a.json"]).assert_success();
    let json = scene.json("a.json");
    assert_eq!((json["cx"].as_f64(), json["uncertainty"]["cx"].as_f64()), (Some(161.0), Some(0.0)));
    assert_eq!((json["distortion"][2].as_f64(), json["distortion"][3].as_f64()), (Some(0.0), Some(0.0)));
    assert!(json["uncertainty"]["skew"].as_f64() > Some(0.0) && json["uncertainty"]["distortion"][4].as_f64() > Some(0.0));
    scene.calibrate(&["--profile", "bouguet", "--fix", "aspect", "--json", "b.json"]).assert_success();
    let json = scene.json("b.json");
    assert_eq!(json["fx"], json["fy"]);
    assert!(json["views"].as_array().is_some_and(|all| all.iter().all(|v| v["used"] == true)));
}

#[test]
fn yaml_is_written_for_opencv_and_ros_and_compared() {
    let scene = Scene::new(8, 0.5);
    scene.calibrate(&["--output", "cv.yaml"]).assert_success();
    scene.calibrate(&["--output", "ros.yaml", "--format", "ros", "--fix", "fx=310", "--write-anyway"]).assert_success();
    let form = |name: &str| read_calibration(&scene.path(name)).expect("it reads back").form;
    assert_eq!((form("cv.yaml"), form("ros.yaml")), (CalibrationForm::OpenCv, CalibrationForm::Ros));
    let run = scene.run(&["calibrate", "cv.yaml", "--compare", "cv.yaml", "--report", "same.html"]);
    run.assert_success();
    assert!(run.stdout.contains("median 0.000 px, worst 0.000 px"), "{}", run.stdout);
    assert!(scene.read("same.html").contains("Difference to cv.yaml"));
    let run = scene.calibrate(&["--compare", "ros.yaml", "--json", "c.json"]);
    run.assert_success();
    assert!(run.stdout.contains("Difference to ros.yaml, pixels over the picture"));
    assert!(scene.json("c.json")["compare"]["px"]["worst_px"].as_f64() > Some(0.5));
}

#[test]
fn colour_sixteen_bits_and_alpha_are_read() {
    let scene = Scene::new(8, 0.5);
    let save = |k: usize, picture: DynamicImage| picture.save(scene.path(&format!("pictures/{k:02}.png"))).expect("it can be written");
    let (rgb, grey, alpha) = (view(0, 0.5), view(1, 0.5), view(2, 0.5));
    save(0, DynamicImage::ImageRgb8(ImageBuffer::from_fn(320, 240, |x, y| Rgb([rgb.get_pixel(x, y).0[0]; 3]))));
    save(1, DynamicImage::ImageLuma16(ImageBuffer::from_fn(320, 240, |x, y| Luma([u16::from(grey.get_pixel(x, y).0[0]) * 257]))));
    save(
        2,
        DynamicImage::ImageRgba8(ImageBuffer::from_fn(320, 240, |x, y| {
            let level = alpha.get_pixel(x, y).0[0];
            Rgba([level, level, level, 128])
        })),
    );
    scene.calibrate(&["--json", "out.json"]).assert_success();
    assert!(scene.json("out.json")["views"].as_array().is_some_and(|all| all.len() == 8 && all.iter().all(|v| v["used"] == true)));
}

#[test]
fn views_are_picked_from_a_clip() {
    let scene = Scene::new(0, 0.0);
    std::fs::create_dir(scene.path("clip")).expect("it is new");
    for k in 0..10 {
        // Each view is held for three frames.
        for frame in 0..3 {
            view(k, 0.5).save(scene.path(&format!("clip/{:03}.png", 3 * k + frame))).expect("it can be written");
        }
    }
    let run = scene.run(&["calibrate", "--clip", "clip", "--board", "7x5", "--square-mm", "25", "--json", "out.json"]);
    run.assert_success();
    let views = scene.json("out.json")["views"].as_array().map_or(0, Vec::len);
    assert!((6..=10).contains(&views), "{views}");
}

#[test]
fn lateral_colour_is_measured_in_pictures_and_clips() {
    let scene = Scene::new(0, 0.0);
    std::fs::create_dir(scene.path("clip")).expect("it is new");
    for k in 0..10 {
        let view = view_with_large_red(k, 0.5, 1.001);
        view.save(scene.path(&format!("pictures/{k:02}.png"))).expect("it can be written");
        for frame in 0..3 {
            view.save(scene.path(&format!("clip/{:03}.png", 3 * k + frame))).expect("it can be written");
        }
    }
    let run = scene.calibrate(&["--json", "pictures.json", "--report", "report.html"]);
    run.assert_success();
    assert!(run.stdout.contains("in red alone 0.0"), "{}", run.stdout);
    assert!(scene.read("report.html").contains("Lateral colour"));
    scene.run(&["calibrate", "--clip", "clip", "--board", "7x5", "--square-mm", "25", "--json", "clip.json"]).assert_success();
    for name in ["pictures.json", "clip.json"] {
        let red = &scene.json(name)["lateral_colour"]["red"];
        let [scale, uncertainty] = ["scale", "uncertainty"].map(|key| red[key].as_f64().expect("it is measured"));
        // Grey is 0.0003 larger too.
        assert!((scale - 1.0007).abs() < uncertainty && uncertainty < 2e-4, "{name}: {red}");
    }
}

#[test]
fn a_board_is_printed_with_its_ruler() {
    let scene = Scene::new(0, 0.0);
    scene.run(&["board", "--board", "9x6", "--square-mm", "25", "-o", "board.svg"]).assert_success();
    let svg = scene.read("board.svg");
    assert!(svg.starts_with("<svg xmlns=") && svg.contains("width=\"274mm\"") && svg.contains("9x6"));
    let run = scene.run(&["board", "--board", "9x6", "--square-mm", "25"]);
    assert_eq!(run.stdout, svg);
    scene.run(&["board", "--board", "9x6", "--square-mm", "0"]).assert_refused(2, &["--square-mm is 0"]);
}

#[test]
fn a_board_must_fit_its_paper() {
    let scene = Scene::new(0, 0.0);
    scene.run(&["board", "--board", "9x6", "--square-mm", "24", "--paper", "a4", "-o", "board.svg"]).assert_success();
    assert!(scene.read("board.svg").contains("width=\"297mm\" height=\"210mm\""));
    scene.run(&["board", "--board", "9x6", "--square-mm", "24", "--paper", "Letter", "-o", "board.pdf"]).assert_success();
    let pdf = std::fs::read(scene.path("board.pdf")).unwrap();
    assert!(pdf.starts_with(b"%PDF-") && String::from_utf8_lossy(&pdf).contains("/MediaBox [0 0 792"));
    let run = scene.run(&["board", "--board", "9x6", "--square-mm", "30", "--paper", "a4", "-o", "large.pdf"]);
    run.assert_refused(2, &["9x6 with squares of 30 mm does not fit", "--square-mm 24.5"]);
    assert!(!scene.path("large.pdf").exists());
    scene.run(&["board", "--board", "9x6", "--square-mm", "30", "--paper", "a9"]).assert_refused(2, &["--paper is \"a9\"", "letter"]);
    scene.run(&["board", "--board", "9x6", "--square-mm", "20", "-o", "board.doc"]).assert_refused(2, &["board.doc", ".pdf or .svg"]);
}
