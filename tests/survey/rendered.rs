//! A walk past a stage that differs from its measurements: the survey finds where the surfaces are,
//! and which lens filmed the walk.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde_json::Value;
use stagepose::Intrinsics;

use super::{LENS, Walk, calibration, stage};
use crate::cli::scene::Run;

fn numbers<const N: usize>(value: &Value) -> [f64; N] {
    let numbers: Vec<f64> = value.as_array().expect("numbers").iter().map(|v| v.as_f64().expect("a number")).collect();
    numbers.try_into().expect("as many as that")
}

/// Returns how far surface `k` was found from its true pose: millimetres and degrees.
pub(super) fn errors(json: &Value, k: usize) -> (f64, f64) {
    let (found, truth) = (&json["surfaces"][k], &stage().surfaces[k].pose);
    let [x, y, z, w] = numbers::<4>(&found["orientation_xyzw"]);
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    let shift = Vector3::from(numbers::<3>(&found["position_m"])) - truth.translation;
    (1e3 * shift.norm(), rotation.angle_to(&truth.rotation).to_degrees())
}

#[test]
fn a_misplaced_flat_is_surveyed_into_a_self_contained_folder() {
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
    // The output folder is self-contained, and the rest of the config is unchanged.
    for file in ["backdrop.png", "flat.png", "camera.toml", "stage.toml"] {
        std::fs::remove_file(walk.path(file)).expect("it is there");
    }
    assert!(walk.read("surveyed/stage.toml").starts_with("# As measured by tape.\n[camera]"));
    let replay = walk.run(&["replay", "walk", "--config", "surveyed/stage.toml", "--summary", "after.json"]);
    replay.assert_success();
    assert!(walk.json("after.json")["tracking"].as_u64() >= Some(35), "{}", replay.stdout);
}

#[test]
fn measured_lengths_correct_sizes_or_are_named_as_wrong() {
    let walk = Walk::new();
    // All sizes are two percent too small, and the position of the flat is off as well. The
    // measured distances are the diagonal and the width of the backdrop.
    let stage = "[camera]\ncalibration = \"camera.toml\"\n[[stage.surface]]\nimage = \"backdrop.png\"\nsize_m = [3.92, 2.94]\n\
                 [[stage.surface]]\nimage = \"flat.png\"\nsize_m = [1.176, 0.882]\nposition_m = [0.89, -0.58, -0.3]\nrotation_deg = [0.0, 0.5, 12.4]\n";
    let length = |surfaces: &str, at: &str, metres: f64| {
        format!("[[survey.distance]]\nsurfaces = {surfaces}\nat = {at}\nlength_m = {metres}\nsigma_m = 0.001\n")
    };
    let right = length("[1, 1]", "[\"bottom left\", \"top right\"]", 5.0) + &length("[1, 1]", "[\"left\", \"right\"]", 4.0);
    walk.write("small.toml", &format!("{stage}{right}"));
    let run = walk.run(&["survey", "walk", "--config", "small.toml", "--output", "surveyed", "--json", "out.json"]);
    run.assert_success();
    let json = walk.json("out.json");
    let growth = json["size"]["growth"].as_f64().expect("a number");
    assert!((growth - 1.0 / 0.98 + 1.0).abs() < 5e-4, "{growth}: {}", run.stdout);
    assert!(run.stdout.contains("[[survey.distance]], line 11: 5.0000 m as measured"), "{}", run.stdout);
    let (mm, degrees) = errors(&json, 1);
    assert!(mm < 2.0 && degrees < 0.1, "{mm} {degrees}");
    // The camera is where it is with the right sizes.
    walk.run(&["replay", "walk", "--config", "surveyed/stage.toml", "--tum", "mended.txt"]).assert_success();
    walk.run(&["replay", "walk", "--config", "stage.toml", "--tum", "right.txt"]).assert_success();
    let apart = |a: &str, b: &str| {
        let place = |line: &str| Vector3::from_iterator(line.split(' ').skip(1).take(3).map(|v| v.parse::<f64>().expect("a number")));
        (place(a) - place(b)).norm()
    };
    let (corrected, right_sizes) = (walk.read("mended.txt"), walk.read("right.txt"));
    assert!(corrected.lines().zip(right_sizes.lines()).all(|(a, b)| apart(a, b) < 0.03), "{corrected}\n{right_sizes}");
    // A third length is wrong by a decimetre.
    walk.write("slip.toml", &format!("{stage}{right}{}", length("[1, 1]", "[\"top\", \"bottom\"]", 3.1)));
    let before = walk.files("surveyed");
    walk.run(&["survey", "walk", "--config", "slip.toml", "--output", "surveyed"])
        .assert_refused(1, &["[[survey.distance]], line 21", "3.1000 m", "say 3.0", "measure it again", "nothing is written"]);
    assert_eq!(walk.files("surveyed"), before);
}

#[test]
fn a_lens_two_percent_off_is_surveyed_reproducibly() {
    let walk = Walk::new();
    let told = Intrinsics { fx: 1.02 * LENS.fx, fy: 1.02 * LENS.fy, cx: 239.5, cy: 134.5, distortion: [0.0; 5], ..LENS };
    walk.write("camera.toml", &calibration(&told));
    let survey = |folder: &str| {
        let all = ["survey", "walk", "--config", "stage.toml", "--output", folder, "--lens", "refine", "--json", "out.json"];
        // Without a cache, so that the second run also prepares the pictures.
        let output = walk.command(&all).env("CACHE_DIRECTORY", "/dev/null").output().expect("the program runs");
        Run::from(output).assert_success();
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
