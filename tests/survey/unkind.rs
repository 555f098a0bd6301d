//! Walks that are hard but valid: people in front, few frames with a surface, a lens far from its
//! calibration, an unconfigured shutter. Also one walk that cannot determine its lens.

use image::GrayImage;
use nalgebra::Vector3;
use stagepose::diagnostics::simulate::{grey, paint};
use stagepose::{BodySpec, CameraPath, Intrinsics, Spline};

use super::rendered::errors;
use super::{LENS, Walk, calibration, filmed, frames, path, stage};

/// Draws two people who walk through a picture.
fn with_people(frame: &GrayImage, at: usize) -> GrayImage {
    let coat = grey(&paint(480, 270, 91));
    let mut picture = frame.clone();
    for (first, speed, top) in [(40, 11, 60), (430, -9, 90)] {
        let left = (first + speed * at as i64).clamp(0, 400);
        for (x, y, pixel) in picture.enumerate_pixels_mut() {
            // The clothes' pattern moves with the person.
            let across = i64::from(x) - left;
            if (0..75).contains(&across) && y >= top {
                *pixel = *coat.get_pixel(across as u32 + 100, y);
            }
        }
    }
    picture
}

#[test]
fn people_in_front_for_half_of_the_walk_are_left_out() {
    let walk = Walk::new();
    let half = frames().len() / 2;
    let crowded = |(k, frame): (usize, &GrayImage)| if k < half { with_people(frame, k) } else { frame.clone() };
    walk.save("crowded", &frames().iter().enumerate().map(crowded).collect::<Vec<_>>());
    let run = walk.run(&["survey", "crowded", "--config", "stage.toml", "--output", "surveyed", "--json", "out.json"]);
    run.assert_success();
    let json = walk.json("out.json");
    let (mm, degrees) = errors(&json, 1);
    println!("{mm:.3} mm, {degrees:.4} degrees; {}", run.stdout);
    assert!(mm < 0.7 && degrees < 0.07, "{mm} {degrees}");
}

#[test]
fn a_rarely_seen_flat_is_within_its_sigma_or_flagged() {
    let walk = Walk::new();
    let wall = BodySpec::new("stage", stage().surfaces.into_iter().take(1).collect());
    let without = filmed(path(), wall);
    for shown in [&[20][..], &[9, 26], &[4, 14, 24, 32]] {
        let frame = |k: usize| if shown.contains(&k) { &frames()[k] } else { &without[k] };
        walk.save("few", &(0..without.len()).map(|k| frame(k).clone()).collect::<Vec<_>>());
        let run = walk.run(&["survey", "few", "--config", "stage.toml", "--output", "surveyed", "--json", "out.json"]);
        run.assert_success();
        let json = walk.json("out.json");
        let ((mm, degrees), sigma) = (errors(&json, 1), |key: &str| json["surfaces"][1][key].as_f64().expect("a number"));
        let is_said = json["reasons"].to_string().contains("too few to detect a wrong position");
        println!(
            "{shown:?}: {mm:.2} mm, {degrees:.3} degrees, sigma {:.2} {:.3}; {}",
            sigma("sigma_mm"),
            sigma("sigma_deg"),
            json["reasons"]
        );
        let is_contained = mm < 4.0 * sigma("sigma_mm") && degrees < 4.0 * sigma("sigma_deg");
        assert!(is_contained, "{shown:?}: {mm} mm, {degrees} degrees; {json}");
        assert_eq!(is_said, shown.len() < 3, "{}", json["reasons"]);
    }
}

#[test]
fn a_lens_too_wrong_to_align_is_first_found_by_features() {
    let walk = Walk::new();
    let told = Intrinsics { fx: 1.3 * LENS.fx, fy: 1.3 * LENS.fy, cx: 239.5, cy: 134.5, distortion: [0.0; 5], ..LENS };
    walk.write("camera.toml", &calibration(&told));
    // With the lens kept as calibrated, the survey is refused with the fix, and nothing is written.
    walk.run(&["survey", "walk", "--config", "stage.toml", "--output", "surveyed"])
        .assert_refused(1, &["--lens refine", "nothing is written"]);
    assert!(!walk.path("surveyed").exists());
    walk.run(&["survey", "walk", "--config", "stage.toml", "--output", "surveyed", "--lens", "refine", "--json", "out.json"])
        .assert_success();
    let camera = &walk.json("out.json")["camera"];
    let share = camera["fx"].as_f64().expect("a number") / LENS.fx - 1.0;
    assert!(share.abs() < 3e-3, "{camera}");
}

#[test]
fn an_insufficient_walk_is_refused_with_the_missing_view() {
    let walk = Walk::new();
    // Along a wall and always head-on, focal length and distance cannot be told apart.
    let along = |y: f64| Spline::new(&[(-0.5, Vector3::new(-1.0, y, 0.0)), (3.5, Vector3::new(1.0, y, 0.0))]).expect("keys in order");
    let wall = BodySpec::new("stage", stage().surfaces.into_iter().take(1).collect());
    let square = filmed(CameraPath { position: along(-3.0), target: along(0.0), roll_rad: 0.0, shake: None }, wall);
    walk.save("square", &square);
    walk.write("wall.toml", "[camera]\ncalibration = \"camera.toml\"\n[[stage.surface]]\nimage = \"backdrop.png\"\nsize_m = [4.0, 3.0]\n");
    walk.run(&["survey", "square", "--config", "wall.toml", "--output", "surveyed", "--lens", "refine"])
        .assert_refused(1, &["the focal length is known to", "film the stage at an angle, from near and far", "nothing is written"]);
    assert!(!walk.path("surveyed").exists());
}
