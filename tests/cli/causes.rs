//! One thing on a stage is slightly off: tracking continues, and `check --clip` reports which thing
//! it is, by how much, and what to do.

use nalgebra::Vector3;
use stagepose::diagnostics::simulate::{artwork_surface, grey, paint, upright};
use stagepose::{BodySpec, CameraModel, CameraPath, Draught, Intrinsics, Renderer, SensorNoise, Spline, VirtualStage, Wave};

const FRAMES: usize = 32;
const FPS: f64 = 12.0;
const SIZE_PX: (u32, u32) = (480, 360);
const LENS: &str = "width = 480\nheight = 360\nfx = 432.0\nfy = 432.0\ncx = 241.0\ncy = 178.0\nskew = 0.0\ndistortion = [-0.11, 0.06, 0.0006, -0.0004, 0.0]\n";
const CONFIG: &str = "[camera]\ncalibration = \"camera.toml\"\nshutter = \"global\"\n\
    [[stage.surface]]\nimage = \"backdrop.png\"\nsize_m = [4.0, 3.0]\n\
    [[stage.surface]]\nimage = \"tree.png\"\nsize_m = [1.2, 1.7]\nposition_m = [0.95, -0.8, -0.4]\n\
    [[stage.surface]]\nimage = \"house.png\"\nsize_m = [1.3, 1.3]\nposition_m = [-1.0, -0.5, -0.5]\n";

/// The stage as configured, and a camera that moves past it, near and far.
fn scene() -> VirtualStage {
    let surface = |name: &str, (w, h), seed, size_m, place: [f64; 3]| {
        artwork_surface(name, grey(&paint(w, h, seed)), size_m, upright(Vector3::from(place), 0.0))
    };
    let surfaces = vec![
        surface("backdrop", (800, 600), 5, [4.0, 3.0], [0.0; 3]),
        surface("tree", (240, 340), 6, [1.2, 1.7], [0.95, -0.8, -0.4]),
        surface("house", (260, 260), 7, [1.3, 1.3], [-1.0, -0.5, -0.5]),
    ];
    let end_s = FRAMES as f64 / FPS;
    let keys =
        [(-0.2, [-2.6, -4.2, 0.9]), (0.35 * end_s, [-0.4, -5.4, 0.2]), (0.7 * end_s, [1.2, -4.0, -0.5]), (end_s + 0.2, [2.6, -4.4, 0.4])];
    let position = Spline::new(&keys.map(|(t, p)| (t, Vector3::from(p)))).unwrap();
    let path = CameraPath { position, target: Spline::fixed(Vector3::new(0.0, 0.0, 0.0)), roll_rad: 0.03, shake: None };
    let (width, height) = SIZE_PX;
    let distortion = [-0.11, 0.06, 0.0006, -0.0004, 0.0];
    let camera = CameraModel::new(Intrinsics { width, height, fx: 432.0, fy: 432.0, cx: 241.0, cy: 178.0, skew: 0.0, distortion }).unwrap();
    let mut scene = VirtualStage::new(camera, path, BodySpec::new("stage", surfaces));
    scene.noise = SensorNoise { read: 0.2, shot: 0.005 };
    scene.background = 40.0;
    scene
}

/// Returns what `check` says about the unchanged config when `change` is applied to the real stage.
fn said(change: impl FnOnce(&mut VirtualStage)) -> String {
    let told = scene();
    let mut real = scene();
    change(&mut real);
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::create_dir_all(path("clip/frames")).unwrap();
    let mut config = CONFIG.to_owned();
    // A stage with fewer surfaces keeps the first ones.
    if let Some((end, _)) = config.match_indices("[[stage.surface]]").nth(real.stage.surfaces.len()) {
        config.truncate(end);
    }
    std::fs::write(path("stage.toml"), config).unwrap();
    std::fs::write(path("camera.toml"), LENS).unwrap();
    for surface in &told.stage.surfaces {
        surface.artwork.save(path(&format!("{}.png", surface.name))).unwrap();
    }
    let mut stamps = "#timestamp [ns],filename\n".to_owned();
    let renderer = Renderer::new(real);
    for k in 0..FRAMES {
        renderer.render(k as f64 / FPS, k as u64).save(path(&format!("clip/frames/{k:06}.pgm"))).unwrap();
        stamps += &format!("{},{k:06}.pgm\n", (k as f64 / FPS * 1e9) as u64);
    }
    std::fs::write(path("clip/timestamps.csv"), stamps).unwrap();
    let mut command = crate::program();
    command.args(["check", "--config", "stage.toml", "--clip", "clip"]).current_dir(folder.path()).env_remove("RUST_LOG");
    let output = command.output().unwrap();
    let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
    println!("{text}");
    text
}

/// The beginnings of all that may be said of a part of the model.
const PARTS: [&str; 4] = [
    "the lens is not as calibrated",
    "does not have its configured shape",
    "is not at its configured position",
    "for its height than size_m says",
];

/// Asserts that the text blames only this part, and contains all of these words.
fn assert_names(text: &str, part: &str, words: &[&str]) {
    for other in PARTS {
        assert_eq!(text.contains(other), other == part, "{other}:\n{text}");
    }
    assert!(words.iter().all(|word| text.contains(word)), "{words:?}:\n{text}");
}

/// Returns the number before a word.
fn number_before(text: &str, word: &str) -> f64 {
    let before = text.split(word).next().and_then(|t| t.split_whitespace().next_back()).expect("words before");
    before.parse().unwrap_or_else(|_| panic!("`{before}` before `{word}`:\n{text}"))
}

#[test]
fn a_right_config_names_no_cause() {
    let text = said(|_| {});
    assert_names(&text, "", &["stage.toml: good"]);
}

#[test]
fn a_lens_that_is_off() {
    let text = said(|real| {
        let i = *real.camera.intrinsics();
        real.camera = CameraModel::new(Intrinsics { fx: 1.008 * i.fx, fy: 1.008 * i.fy, cx: i.cx + 2.0, ..i }).unwrap();
    });
    assert_names(&text, PARTS[0], &["--lens refine"]);
    let focal = text.split("a focal length ").nth(1).and_then(|t| t.split(' ').next()).and_then(|t| t.parse::<f64>().ok());
    assert!(focal.is_some_and(|percent| (percent - 0.8).abs() < 0.2), "{text}");
}

#[test]
fn cloth_in_folds() {
    let text = said(|real| {
        real.stage.surfaces.truncate(1);
        let wave = |height_m, wave_vector, phase_rad| Wave { height_m, wave_vector, rate_hz: 0.0, phase_rad };
        real.draughts = vec![Draught { surface: 0, waves: vec![wave(0.012, [4.0, 0.5], 0.4), wave(0.006, [-1.0, 5.0], 1.0)] }];
    });
    assert_names(&text, PARTS[1], &["backdrop.png does not have its configured shape", "stagepose survey"]);
    // The root mean square of the waves is 9.5 mm.
    let rms_mm = number_before(&text, " mm off (rms)");
    assert!((5.0..14.0).contains(&rms_mm), "{text}");
}

#[test]
fn cloth_that_moves() {
    let text = said(|real| {
        real.stage.surfaces.truncate(1);
        let wave = |height_m, wave_vector, rate_hz| Wave { height_m, wave_vector, rate_hz, phase_rad: 0.4 };
        real.draughts = vec![Draught { surface: 0, waves: vec![wave(0.015, [4.0, 0.5], 1.1), wave(0.01, [-1.0, 5.0], 0.7)] }];
    });
    assert_names(&text, "", &["no constant error of the stage or lens explains that; moving cloth would", "may be"]);
    let mm = number_before(&text, " mm off, and no constant");
    assert!((2.0..60.0).contains(&mm), "{text}");
}

#[test]
fn a_flat_that_was_moved() {
    let text = said(|real| real.stage.surfaces[2].pose.translation += Vector3::new(0.012, 0.0, 0.009));
    assert_names(&text, PARTS[2], &["house.png is not at its configured position", "stagepose survey"]);
    let mm = number_before(&text, " mm from there");
    assert!((mm - 15.0).abs() < 1.5, "{text}");
}

#[test]
fn a_print_that_is_stretched() {
    let text = said(|real| {
        real.stage.surfaces.truncate(1);
        real.stage.surfaces[0].size_m[0] = 4.036;
    });
    assert_names(&text, PARTS[3], &["size_m", "wider"]);
    let percent = number_before(&text, " % wider");
    assert!((percent - 0.9).abs() < 0.1, "{text}");
}
