//! Pairs rendered by the virtual stage, with exactly known camera motion and homography.

use std::path::Path;

use nalgebra::{Matrix3, Point3, Quaternion, UnitQuaternion, Vector2, Vector3};
use stagepose::diagnostics::simulate::{artwork_surface, grey, look_at, paint, upright};
use stagepose::{BodySpec, Camera, CameraModel, CameraPath, Pose, Renderer, Stage, VirtualStage};

use super::{Compared, compare, numbers};

const CAMERA: &str =
    "width = 640\nheight = 480\nfx = 560.0\nfy = 560.0\ncx = 319.5\ncy = 239.5\nskew = 0.0\ndistortion = [0.0, 0.0, 0.0, 0.0, 0.0]\n";

fn camera() -> CameraModel {
    CameraModel::pinhole(640, 480, 560.0, 560.0, 319.5, 239.5).expect("a camera")
}

/// A camera's position, its target and its roll.
type Station = ([f64; 3], [f64; 3], f64);

/// Renders a backdrop, and two flats in front of it if the scene has depth, from both stations.
/// Returns the camera's motion.
fn rendered(folder: &Path, stations: [Station; 2], has_depth: bool) -> Pose<Camera, Camera> {
    let picture = |seed| grey(&paint(900, 675, seed));
    let mut surfaces = vec![artwork_surface("backdrop", picture(3), [4.0, 3.0], upright(Vector3::zeros(), 0.0))];
    if has_depth {
        surfaces.push(artwork_surface("left", picture(4), [1.2, 0.9], upright(Vector3::new(-0.9, -1.4, -0.4), 0.3)));
        surfaces.push(artwork_surface("right", picture(5), [1.2, 0.9], upright(Vector3::new(0.9, -0.9, 0.5), -0.4)));
    }
    let poses = stations.map(|(position, target, roll)| look_at(Point3::from(position), Point3::from(target), roll));
    for (k, (position, target, roll)) in stations.into_iter().enumerate() {
        let path = CameraPath { roll_rad: roll, ..CameraPath::fixed(position.into(), target.into()) };
        let mut stage = VirtualStage::new(camera(), path, BodySpec::new("stage", surfaces.clone()));
        stage.samples = 9;
        stage.seed = k as u64;
        Renderer::new(stage).render(0.0, k as u64).save(folder.join(["a.png", "b.png"][k])).expect("it can be written");
    }
    std::fs::write(folder.join("camera.toml"), CAMERA).expect("it can be written");
    let [a, b]: [Pose<Stage, Camera>; 2] = poses;
    b.inverse() * a
}

/// Returns the errors of the rotation and of the direction, degrees.
fn off_deg(found: &Compared, truth: &Pose<Camera, Camera>) -> (f64, f64) {
    let [x, y, z, w] = numbers::<4>(&found.json["rotation_xyzw"]);
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    let direction = Vector3::from(numbers::<3>(&found.json["translation_direction"]));
    (rotation.angle_to(&truth.rotation).to_degrees(), direction.angle(&truth.translation).to_degrees())
}

const FROM_LEFT: Station = ([-0.5, -4.0, 0.1], [0.0, 0.0, 0.0], 0.0);
const FROM_RIGHT: Station = ([0.5, -3.7, -0.2], [0.2, 0.0, 0.1], 0.0);

#[test]
fn a_scene_with_depth_yields_essential_matrix_and_motion() {
    let folder = tempfile::tempdir().expect("a folder");
    let truth = rendered(folder.path(), [FROM_LEFT, FROM_RIGHT], true);
    let baseline = truth.translation.norm().to_string();
    let found = compare(folder.path(), "a.png", "b.png", &["--camera", "camera.toml", "--baseline-m", &baseline, "--report", "out.html"]);
    assert_eq!((found.code, &found.json["model"]), (Some(0), &"essential".into()), "{} {}", found.stderr, found.stdout);
    let (rotation, direction) = off_deg(&found, &truth);
    assert!(rotation < 0.1 && direction < 0.6, "{rotation} {direction}");
    // With the distance between the two places, the motion has its true length.
    let metres = Vector3::from(numbers::<3>(&found.json["translation_m"]));
    assert!((metres - truth.translation).norm() < 0.02, "{metres} {}", truth.translation);
    // F and E relate the same points: F = K^-T E K^-1.
    let e = Matrix3::from_row_slice(&numbers::<9>(&found.json["E"]));
    assert!((e.norm() - 1.0).abs() < 1e-9 && e.determinant().abs() < 1e-9);
    // Leaves out the pictures' bytes, which may spell anything.
    let report = std::fs::read_to_string(folder.path().join("out.html")).expect("a report");
    let report: String = report.split('"').filter(|part| !part.starts_with("data:")).collect();
    for figure in ["Matches that fit", "Epipolar lines", "Homography", "The two cameras", "How near"] {
        assert!(report.contains(figure), "{figure}");
    }
    assert!(!report.contains("NaN") && !report.contains("http://") && !report.contains("https://"));
}

/// Thesis error E31: the source takes the translation's sign from one hand-picked point.
#[test]
fn e31_the_move_is_never_reversed() {
    let folder = tempfile::tempdir().expect("a folder");
    let middle = ([0.0, -4.0, 0.0], [0.0, 0.0, 0.0], 0.0);
    for to in [FROM_LEFT, FROM_RIGHT, ([0.1, -3.0, 0.1], [0.0, 0.0, 0.0], 0.0), ([0.0, -4.0, 0.7], [0.1, 0.0, 0.0], 0.0)] {
        for stations in [[middle, to], [to, middle]] {
            for has_depth in [true, false] {
                let truth = rendered(folder.path(), stations, has_depth);
                let found = compare(folder.path(), "a.png", "b.png", &["--camera", "camera.toml"]);
                let (rotation, direction) = off_deg(&found, &truth);
                assert!(rotation < 1.0 && direction < 6.0, "{stations:?} {has_depth}: {rotation} {direction}\n{}", found.stdout);
            }
        }
    }
}

#[test]
fn a_flat_scene_gives_the_homography() {
    let folder = tempfile::tempdir().expect("a folder");
    rendered(folder.path(), [FROM_LEFT, FROM_RIGHT], false);
    let found = compare(folder.path(), "a.png", "b.png", &[]);
    assert_eq!((found.code, &found.json["model"]), (Some(0), &"homography".into()), "{}", found.stderr);
    assert!(found.json["E"].is_null() && found.json["rotation_xyzw"].is_null());
    // The ground truth is a backdrop point as both cameras see it.
    let h = Matrix3::from_row_slice(&numbers::<9>(&found.json["H"]));
    assert_eq!(h[(2, 2)], 1.0);
    let seen = |(position, target, roll): Station, p: Point3<f64>| {
        let q = look_at(position.into(), target.into(), roll).inverse().transform(&p);
        Vector2::new(560.0 * q.x / q.z + 319.5, 560.0 * q.y / q.z + 239.5)
    };
    for (x, z) in [(-1.5, -1.0), (1.5, -1.0), (1.5, 1.0), (-1.5, 1.0)] {
        let p = Point3::new(x, 0.0, z);
        let mapped = h * seen(FROM_LEFT, p).push(1.0);
        let off = (mapped.xy() / mapped.z - seen(FROM_RIGHT, p)).norm();
        assert!(off < 0.3, "{off}");
    }
}

#[test]
fn a_pure_rotation_has_no_translation_direction() {
    let folder = tempfile::tempdir().expect("a folder");
    let rotated = (FROM_LEFT.0, [0.5, 0.0, 0.2], 0.0);
    let truth = rendered(folder.path(), [FROM_LEFT, rotated], true);
    let found = compare(folder.path(), "a.png", "b.png", &["--camera", "camera.toml"]);
    assert_eq!(found.json["model"], "homography", "{}", found.stdout);
    assert!(found.json["translation_direction"].is_null() && found.json["E"].is_null(), "{}", found.stdout);
    let [x, y, z, w] = numbers::<4>(&found.json["rotation_xyzw"]);
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    assert!(rotation.angle_to(&truth.rotation).to_degrees() < 0.1);
}

#[test]
fn every_detector_relates_an_easy_pair_reproducibly() {
    let folder = tempfile::tempdir().expect("a folder");
    let near = ([-0.4, -3.9, 0.1], [0.0, 0.0, 0.0], 0.0);
    rendered(folder.path(), [FROM_LEFT, near], false);
    for detector in ["live", "harris", "noble", "shi-tomasi", "sift", "surf", "mser", "harris-affine", "hessian-affine", "asift"] {
        let more = ["--detector", detector, "--nfeat", "800"];
        let found = compare(folder.path(), "a.png", "b.png", &more);
        assert_eq!(found.json["model"], "homography", "{detector}: {}", found.stdout);
        assert_eq!(found.json, compare(folder.path(), "a.png", "b.png", &more).json, "{detector}");
    }
}
