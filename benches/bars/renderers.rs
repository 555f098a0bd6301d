//! Compares the virtual stage with the independent renderer of `../shared/bench`. Both render the
//! same scenes without noise, and the pictures are compared.
//!
//! `cargo bench --bench bars -- --renderers PYTHON`, where PYTHON has what
//! `../shared/bench/requirements.txt` lists.

use std::path::{Path, PathBuf};
use std::process::Command;

use image::GrayImage;
use image::imageops::{self, FilterType};
use nalgebra::{Point3, Vector3};
use serde_json::{Value, json};
use stagepose::diagnostics::simulate::{artwork_surface, grey, paint, upright};
use stagepose::{
    BodySpec, CameraModel, CameraPath, Draught, Intrinsics, LightKey, LightModel, Person, Renderer, Spline, ToneCurve, VirtualStage, Wave,
};

/// Maximum root mean square difference, grey levels: below a webcam's noise. Pictures at rest
/// differ by 0.3 to 0.5 and a moving one by 1.1, because the other renderer exposes bands of rows
/// together. Raised, an error of the light or of the lens passes.
const MAX_RMS: f64 = 1.5;
/// Maximum mean difference, grey levels. Raised, one picture may be brighter.
const MAX_MEAN: f64 = 0.1;
/// Rays per pixel: enough that their positions within the pixel do not matter.
const SAMPLES: u32 = 64;
/// The camera of all cases.
const CAMERA: Intrinsics = Intrinsics {
    width: 640,
    height: 360,
    fx: 452.5,
    fy: 451.6,
    cx: 325.1,
    cy: 176.4,
    skew: 0.0,
    distortion: [-0.19, 0.07, -0.0008, 0.0011, 0.0],
};
/// Metres and texels of the backdrop: a texel is about a pixel.
const BACKDROP: ([f64; 2], [u32; 2]) = ([3.2, 2.2], [640, 440]);
/// Texels of a person's clothes: the other renderer brings them to this size.
const CLOTHES: [u32; 2] = [256, 512];
/// Clothes are painted this many times smaller than that. Lowered, the renderers' ways to lay them
/// differ.
const BLOWN_UP: u32 = 8;
/// Where the camera is and what it looks at.
const VIEW: [[f64; 3]; 2] = [[-0.7, -2.9, 0.25], [0.1, 0.0, 0.0]];

/// A scene, described for both renderers.
struct Case {
    name: &'static str,
    stage: VirtualStage,
    house: Value,
}

/// Compares all cases and prints a line for each; true where both agree.
pub fn agree(python: &str) -> Result<bool, String> {
    let project = Path::new(env!("CARGO_MANIFEST_DIR"));
    let script = project.join("../shared/bench/render.py");
    if !script.exists() {
        return Err(format!("NOT RUN: {} is not there", script.display()));
    }
    let folder = project.join("target/bars-renderers");
    let fault = |e: &dyn std::fmt::Display| format!("{}: {e}", folder.display());
    std::fs::create_dir_all(&folder).map_err(|e| fault(&e))?;
    println!("{:<10} {:>8} {:>8} {:>8}", "case", "mean", "rms", "largest");
    let mut do_agree = true;
    for case in cases(&folder)? {
        let scene = folder.join(format!("{}.json", case.name));
        std::fs::write(&scene, case.house.to_string()).map_err(|e| fault(&e))?;
        let out = folder.join(case.name);
        let mut command = Command::new(python);
        command.arg(&script).arg(&scene).arg(&out).args(["--noiseless", "--frames", "1"]);
        let status = command.status().map_err(|e| format!("{python}: {e}"))?;
        if !status.success() {
            return Err(format!("{}: render.py ended with {status}", case.name));
        }
        let theirs = image::open(out.join("frames/000000.png")).map_err(|e| fault(&e))?.into_luma8();
        let ours = Renderer::new(case.stage).render(0.0, 0);
        ours.save(out.join("ours.png")).map_err(|e| fault(&e))?;
        let [mean, rms, largest] = difference(&ours, &theirs);
        let is_near = mean.abs() <= MAX_MEAN && rms <= MAX_RMS;
        println!("{:<10} {mean:>8.3} {rms:>8.3} {largest:>8.0}{}", case.name, if is_near { "" } else { "   TOO FAR" });
        do_agree &= is_near;
    }
    println!("{}: mean {MAX_MEAN}, rms {MAX_RMS} grey levels at most", if do_agree { "both agree" } else { "MISSED" });
    Ok(do_agree)
}

/// Mean, root mean square and largest of the difference.
fn difference(ours: &GrayImage, theirs: &GrayImage) -> [f64; 3] {
    let differences = || ours.iter().zip(theirs.iter()).map(|(a, b)| f64::from(*a) - f64::from(*b));
    let count = ours.len() as f64;
    let rms = (differences().map(|d| d * d).sum::<f64>() / count).sqrt();
    [differences().sum::<f64>() / count, rms, differences().map(f64::abs).fold(0.0, f64::max)]
}

/// x right, y up, z towards the audience, as the other renderer has it.
fn house([x, y, z]: [f64; 3]) -> Value {
    json!([x, z, -y])
}

fn cases(folder: &Path) -> Result<Vec<Case>, String> {
    let (size_m, [width, height]) = BACKDROP;
    let (backdrop, picture) = picture(folder, "backdrop", [width, height], 21)?;
    let plain = |name: &'static str, model: LightModel| {
        let surface = artwork_surface("backdrop", picture.clone(), size_m, upright(Vector3::zeros(), 0.0));
        let [at, target] = VIEW.map(Point3::from);
        let mut stage = VirtualStage::new(
            CameraModel::new(CAMERA).expect("a camera"),
            CameraPath { roll_rad: 3.0_f64.to_radians(), ..CameraPath::fixed(at, target) },
            BodySpec::new("stage", vec![surface]),
        );
        (stage.light_model, stage.samples, stage.background) = (model, SAMPLES, 25.0);
        let Intrinsics { width, height, fx, fy, cx, cy, distortion, .. } = CAMERA;
        let mut house = json!({
            "frames": 1, "samples": SAMPLES, "background": 25.0,
            "camera": { "width": width, "height": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy, "dist": distortion },
            "planes": [{ "texture": backdrop, "size": size_m }],
            "path": [{ "t": 0, "p": house(VIEW[0]), "target": house(VIEW[1]), "roll": 3 }],
        });
        if let LightModel::Linear(curve) = model {
            house["linear"] = json!({ "contrast": curve.contrast });
        }
        Case { name, stage, house }
    };
    let linear = LightModel::Linear(ToneCurve::default());
    Ok(vec![
        plain("grey", LightModel::GreyAverages),
        plain("linear", linear),
        dimmed(plain("tone", LightModel::Linear(ToneCurve { contrast: 0.6 }))),
        clipped(plain("clipped", linear)),
        moving(plain("moving", linear)),
        folded(plain("folds", linear)),
        peopled(plain("people", linear), folder)?,
    ])
}

/// A painted picture, and its file for the other renderer.
fn picture(folder: &Path, name: &str, [width, height]: [u32; 2], seed: u64) -> Result<(PathBuf, GrayImage), String> {
    kept(folder, name, grey(&paint(width, height, seed)))
}

fn kept(folder: &Path, name: &str, picture: GrayImage) -> Result<(PathBuf, GrayImage), String> {
    let file = folder.join(format!("{name}.png"));
    picture.save(&file).map_err(|e| format!("{}: {e}", file.display()))?;
    Ok((file, picture))
}

fn dimmed(mut case: Case) -> Case {
    case.stage.light = vec![LightKey { time_s: 0.0, gain: 0.6 }];
    case.house["light"] = json!([[0, 0.6]]);
    case
}

fn clipped(mut case: Case) -> Case {
    case.stage.light = vec![LightKey { time_s: 0.0, gain: 2.5 }];
    case.house["light"] = json!([[0, 2.5]]);
    case
}

/// Sideways at 1.5 m/s: blur and rolling shutter.
fn moving(mut case: Case) -> Case {
    let moved = |at: [f64; 3], by: f64| [at[0] + by, at[1], at[2]];
    let along = |at: [f64; 3]| {
        Spline::new(&[-1.0, 1.0].map(|time_s| (time_s, Vector3::from(moved(at, 1.5 * time_s))))).expect("keys in order of time")
    };
    (case.stage.camera_path.position, case.stage.camera_path.target) = (along(VIEW[0]), along(VIEW[1]));
    (case.stage.shutter.exposure_s, case.stage.shutter.readout_s) = (0.012, 0.012);
    let key = |t: f64| json!({ "t": t, "p": house(moved(VIEW[0], 1.5 * t)), "target": house(moved(VIEW[1], 1.5 * t)), "roll": 3 });
    case.house["path"] = json!([key(-1.0), key(1.0)]);
    (case.house["exposure_s"], case.house["readout_s"]) = (json!(0.012), json!(0.012));
    case
}

fn folded(mut case: Case) -> Case {
    let height_m = 0.011;
    let waves = [[4.2, -0.4, 0.9], [9.0, 0.8, 2.1]];
    let ours = waves.map(|[x, y, phase_rad]| Wave { height_m, wave_vector: [x, y], rate_hz: 0.0, phase_rad });
    case.stage.draughts = vec![Draught { surface: 0, waves: ours.to_vec() }];
    case.house["planes"][0]["billow"] = json!({ "m": height_m, "waves": waves.map(|[x, y, phase]| [x, y, 0.0, phase]) });
    case
}

/// Adds a person and a rotated flat in front of the backdrop.
fn peopled(mut case: Case, folder: &Path) -> Result<Case, String> {
    // Blown up, so that they have no fine detail: the other renderer lays texels half a texel
    // further out at the sides of the clothes.
    let [width, height] = CLOTHES;
    let coarse = grey(&paint(width / BLOWN_UP, height / BLOWN_UP, 22));
    let (clothes_file, clothes) = kept(folder, "clothes", imageops::resize(&coarse, width, height, FilterType::Triangle))?;
    let (flat_file, flat) = picture(folder, "flat", [180, 320], 23)?;
    let (at, turn_deg, size_m) = ([0.8, -0.7, -0.3], 25.0_f64, [0.9, 1.6]);
    case.stage.stage.surfaces.push(artwork_surface("flat", flat, size_m, upright(Vector3::from(at), turn_deg.to_radians())));
    let flat = json!({ "texture": flat_file, "size": size_m, "p": house(at), "euler": [0.0, turn_deg, 0.0] });
    let planes = case.house["planes"].as_array_mut().ok_or("a scene has planes")?;
    planes.push(flat);
    let (at, half_size_m) = ([-0.4, -1.2, -0.2], [0.3, 0.9]);
    let swing = Vector3::new(0.5, 0.0, 0.0);
    case.stage.people = vec![Person { centre: Point3::from(at), swing, period_s: 3.0, phase: 0.0, half_size_m, clothes }];
    case.house["actors"] = json!([{
        "texture": clothes_file, "x0": at[0], "dx": swing.x, "y": at[2], "z": -at[1], "period": 3.0, "half": half_size_m, "albedo": 1.0,
    }]);
    Ok(case)
}
