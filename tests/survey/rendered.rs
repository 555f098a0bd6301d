//! A walk past a stage that stands otherwise than it was measured: the survey finds where, and with which lens it was filmed.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde_json::Value;
use stagepose::Intrinsics;

use super::{LENS, Walk, calibration, stage};

fn numbers<const N: usize>(value: &Value) -> [f64; N] {
    let numbers: Vec<f64> = value.as_array().expect("numbers").iter().map(|v| v.as_f64().expect("a number")).collect();
    numbers.try_into().expect("as many as that")
}

/// How far surface `k` is from where it stands: millimetres and degrees.
fn errors(json: &Value, k: usize) -> (f64, f64) {
    let (found, truth) = (&json["surfaces"][k], &stage().surfaces[k].pose);
    let [x, y, z, w] = numbers::<4>(&found["orientation_xyzw"]);
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    let shift = Vector3::from(numbers::<3>(&found["position_m"])) - truth.translation;
    (1e3 * shift.norm(), rotation.angle_to(&truth.rotation).to_degrees())
}

#[test]
fn a_flat_that_stands_elsewhere_is_found_and_the_folder_is_complete_by_itself() {
    let walk = Walk::new();
    let run =
        walk.run(&["survey", "walk", "--config", "stage.toml", "--output", "surveyed", "--json", "out.json", "--report", "report.html"]);
    run.assert_success();
    let json = walk.json("out.json");
    let (mm, degrees) = errors(&json, 1);
    println!("{mm:.3} mm, {degrees:.4} degrees; {}", run.stdout);
    assert!(mm < 0.5 && degrees < 0.05, "{mm} {degrees}");
    assert!(json["surfaces"][1]["sigma_mm"].as_f64().expect("a number") > 0.1 * mm);
    assert!(errors(&json, 0).0 < 1e-6, "the first surface stays where it is");
    assert!(["good", "usable"].contains(&json["verdict"].as_str().expect("words")), "{}", json["verdict"]);
    assert!(json["rms_px"]["surveyed"].as_f64() < Some(0.1), "{}", json["rms_px"]);
    assert_eq!(json["camera"]["fx"], LENS.fx);
    assert!(walk.read("report.html").contains("Heights of flat.png"));
    // The folder needs nothing else: the rest of the config is as it was.
    for file in ["backdrop.png", "flat.png", "camera.toml", "stage.toml"] {
        std::fs::remove_file(walk.path(file)).expect("it is there");
    }
    assert!(walk.read("surveyed/stage.toml").starts_with("# As measured by tape.\n[camera]"));
    let replay = walk.run(&["replay", "walk", "--config", "surveyed/stage.toml", "--summary", "after.json"]);
    replay.assert_success();
    assert!(walk.json("after.json")["tracking"].as_u64() >= Some(35), "{}", replay.stdout);
}

#[test]
fn a_lens_that_is_two_percent_off_is_found_from_the_stage_alone_and_the_same_bytes_come_twice() {
    let walk = Walk::new();
    let told = Intrinsics { fx: 1.02 * LENS.fx, fy: 1.02 * LENS.fy, cx: 239.5, cy: 134.5, distortion: [0.0; 5], ..LENS };
    walk.write("camera.toml", &calibration(&told));
    let survey = |folder: &str| {
        let run = walk.run(&["survey", "walk", "--config", "stage.toml", "--output", folder, "--lens", "refine", "--json", "out.json"]);
        run.assert_success();
        (walk.read("out.json"), walk.files(folder))
    };
    let (text, files) = survey("surveyed");
    assert_eq!((text, files), survey("again"));
    let camera = &walk.json("out.json")["camera"];
    let number = |key: &str| camera[key].as_f64().expect("a number");
    println!("{camera}");
    assert!((number("fx") / LENS.fx - 1.0).abs() < 2e-3 && (number("fy") / LENS.fy - 1.0).abs() < 2e-3, "{camera}");
    assert!((number("cx") - LENS.cx).abs() < 1.0 && (number("cy") - LENS.cy).abs() < 1.0, "{camera}");
    assert!(camera["uncertainty"]["fx"].as_f64() > Some(0.0));
    let (mm, degrees) = errors(&walk.json("out.json"), 1);
    assert!(mm < 1.0 && degrees < 0.1, "{mm} {degrees}");
}
