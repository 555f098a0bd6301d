//! Common slips with the pictures and the board: each is reported together with its fix. Also
//! checks the wording of the report for its readers.

use std::io::Cursor;

use exif::{Field, In, Rational, Tag, Value};
use image::{DynamicImage, ImageFormat, imageops};

use super::scene::{Scene, view};

/// Saves view `k` as a JPEG whose EXIF names the camera and the focal length.
fn save_jpeg(scene: &Scene, name: &str, k: usize, camera: &str, focal_mm: u32) {
    let mut jpeg = Cursor::new(Vec::new());
    DynamicImage::from(view(k, 0.5)).write_to(&mut jpeg, ImageFormat::Jpeg).unwrap();
    let field = |tag, value| Field { tag, ifd_num: In::PRIMARY, value };
    let fields = [
        field(Tag::Model, Value::Ascii(vec![camera.as_bytes().to_vec()])),
        field(Tag::FocalLength, Value::Rational(vec![Rational { num: focal_mm, denom: 1 }])),
    ];
    let mut writer = exif::experimental::Writer::new();
    fields.iter().for_each(|field| writer.push_field(field));
    let mut block = Cursor::new(b"Exif\0\0".to_vec());
    let mut tiff = Cursor::new(Vec::new());
    writer.write(&mut tiff, false).unwrap();
    block.get_mut().extend_from_slice(tiff.get_ref());
    let block = block.into_inner();
    let (jpeg, length) = (jpeg.into_inner(), (block.len() as u16 + 2).to_be_bytes());
    let whole = [&jpeg[..2], &[0xFF, 0xE1], &length[..], &block, &jpeg[2..]].concat();
    std::fs::write(scene.path(&format!("pictures/{name}")), whole).unwrap();
}

#[test]
fn pictures_of_two_cameras_or_zooms_are_refused() {
    let scene = Scene::new(0, 0.0);
    for k in 0..8 {
        save_jpeg(&scene, &format!("{k}.jpg"), k, if k == 5 { "Pixel 7" } else { "Canon EOS R6" }, 24);
    }
    scene.calibrate(&["--output", "camera.toml"]).assert_refused(1, &["two cameras", "Canon EOS R6", "1 of Pixel 7", "pictures/5.jpg"]);
    assert!(!scene.path("camera.toml").exists());
    save_jpeg(&scene, "5.jpg", 5, "Canon EOS R6", 35);
    scene.calibrate(&[]).assert_refused(1, &["zoom was changed", "24 mm", "1 at 35 mm", "pictures/5.jpg", "lock the zoom"]);
    save_jpeg(&scene, "5.jpg", 5, "Canon EOS R6", 24);
    scene.calibrate(&["--report", "report.html"]).assert_success();
    assert!(scene.read("report.html").contains("Canon EOS R6"));
}

#[test]
fn a_camera_held_upright_for_some_pictures_is_named() {
    let scene = Scene::new(6, 0.5);
    imageops::rotate90(&view(2, 0.5)).save(scene.path("pictures/02.png")).unwrap();
    scene.calibrate(&[]).assert_refused(1, &["pictures/02.png is 240 x 320", "upright"]);
}

#[test]
fn blurred_pictures_are_named() {
    let scene = Scene::new(9, 0.5);
    imageops::blur(&view(3, 0.5), 2.0).save(scene.path("pictures/03.png")).unwrap();
    imageops::blur(&view(4, 0.5), 9.0).save(scene.path("pictures/04.png")).unwrap();
    let run = scene.calibrate(&[]);
    run.assert_success();
    let is_said = |words: [&str; 2]| run.stdout.lines().any(|line| words.iter().all(|word| line.contains(word)));
    assert!(is_said(["03.png", "blurred (by 2."]), "{}", run.stdout);
    assert!(is_said(["not used: pictures/04.png", "blurred"]), "{}", run.stdout);
    let all = Scene::new(0, 0.0);
    for k in 0..8 {
        imageops::blur(&view(k, 0.5), 2.6).save(all.path(&format!("pictures/{k}.png"))).unwrap();
    }
    let run = all.calibrate(&["--write-anyway"]);
    assert!(run.stdout.contains("most pictures are blurred") && run.stdout.contains("focus the lens"), "{}{}", run.stdout, run.stderr);
}

#[test]
fn squares_given_in_metres_or_centimetres_are_reported() {
    let scene = Scene::new(8, 0.5);
    let with = |mm: &str, more: &[&str]| scene.run(&[&["calibrate", "pictures", "--board", "7x5", "--square-mm", mm], more].concat());
    with("0.025", &[]).assert_refused(2, &["--square-mm is 0.025", "metres", "give 25"]);
    let centimetres = with("2.5", &["--json", "out.json"]);
    centimetres.assert_success();
    assert!(centimetres.stdout.contains("squares of 2.5 mm") && centimetres.stdout.contains("perhaps 25"), "{}", centimetres.stdout);
    // The wrong unit is no fault of the lens, so the verdict stays the same.
    let right = with("25", &["--json", "right.json"]);
    assert!(!right.stdout.contains("note:"), "{}", right.stdout);
    assert_eq!(scene.json("out.json")["verdict"], scene.json("right.json")["verdict"]);
}

#[test]
fn the_report_is_readable_for_photographers() {
    let scene = Scene::new(0, 0.0);
    for k in 1..=11 {
        view(k, 0.5).save(scene.path(&format!("pictures/view{k}.png"))).unwrap();
    }
    scene.calibrate(&["--report", "report.html", "--json", "out.json"]).assert_success();
    let html = scene.read("report.html");
    for said in [
        "320 &times; 240 pixels",
        "7 &times; 5 inner corners, squares of 25 mm",
        concat!("stagepose ", env!("CARGO_PKG_VERSION")),
        " UTC",
        "Angle of view",
        "Coverage.",
        ">pixels</text>",
        "prefers-color-scheme: dark",
    ] {
        assert!(html.contains(said), "{said}");
    }
    for unsaid in ["omc", "Tc_", "(fig.", "alpha_c", "Bouguet", "NaN"] {
        assert!(!html.contains(unsaid), "{unsaid}");
    }
    // view2 comes before view10, both in the report and when a folder is read.
    let at = |name: &str| html.find(name).unwrap_or_else(|| panic!("{name} is not there"));
    assert!(at("view1.png") < at("view2.png") && at("view2.png") < at("view10.png") && at("view9.png") < at("view10.png"));
    let json = scene.json("out.json");
    assert_eq!(
        (json["views"][1]["file"].as_str(), json["views"][9]["file"].as_str()),
        (Some("pictures/view2.png"), Some("pictures/view10.png"))
    );
}
