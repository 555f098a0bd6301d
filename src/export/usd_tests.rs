//! Reads the text back with a small parser of its own.

use nalgebra::{Point3, Quaternion, Vector2};

use super::*;
use crate::export::rate::Rate;
use crate::export::synthetic;

/// Returns the value of the first attribute of that name.
fn number(text: &str, attribute: &str) -> f64 {
    let begin = text.find(&format!("{attribute} = ")).unwrap_or_else(|| panic!("no {attribute}")) + attribute.len() + 3;
    text[begin..].split(['\n', ',']).next().unwrap().parse().unwrap()
}

/// Returns the time samples of the first attribute of that name below a prim: codes and numbers.
fn samples(text: &str, prim: &str, attribute: &str) -> Vec<(f64, Vec<f64>)> {
    let below = &text[text.find(prim).unwrap()..];
    let begin = below.find(&format!("{attribute}.timeSamples = {{")).unwrap();
    let inside = below[begin..].split_once("{\n").unwrap().1.split_once('}').unwrap().0;
    let sample = |line: &str| {
        let (code, value) = line.trim().trim_end_matches(',').split_once(": ").unwrap();
        (code.parse().unwrap(), value.trim_matches(['(', ')']).split(", ").filter_map(|v| v.parse().ok()).collect())
    };
    inside.lines().filter(|line| !line.trim().is_empty()).map(sample).collect()
}

#[test]
fn stage_corners_lie_where_the_records_have_them() {
    let (take, lens) = (synthetic::take(), synthetic::lens());
    let shot = Shot { take: &take, lens: &lens, rate: Rate::new(29.97).unwrap() };
    let text = write(Some(&shot), &synthetic::scenery());
    // UsdGeomCamera stores them in single precision.
    let [focal, width, right, height, up] =
        ["focalLength", "horizontalAperture", "horizontalApertureOffset", "verticalAperture", "verticalApertureOffset"]
            .map(|name| f64::from(number(&text, name) as f32));
    let positions = samples(&text, "def Camera", "xformOp:translate");
    let rotations = samples(&text, "def Camera", "xformOp:orient");
    assert_eq!((positions.len(), rotations.len()), (take.camera.len(), take.camera.len()));
    for ((key, (code, position)), (_, q)) in take.camera.iter().zip(&positions).zip(&rotations) {
        let seconds = key.timestamp.seconds_since(take.stamp(0));
        assert!((code * 1001.0 / 30_000.0 - seconds).abs() < 1e-6, "{code} {seconds}");
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(q[0], q[1], q[2], q[3]));
        for corner in synthetic::corners() {
            let p = rotation.inverse() * (corner - Vector3::from_column_slice(position));
            // The film gate's lower left corner is (0, 0) of the picture, its upper right (1, 1).
            let x = (focal * p.x / -p.z - right) / width + 0.5;
            let y = (focal * p.y / -p.z - up) / height + 0.5;
            let seen = Vector2::new(x * f64::from(lens.width) - 0.5, (1.0 - y) * f64::from(lens.height) - 0.5);
            let wanted = synthetic::project(&lens, &key.pose, &Point3::from(corner));
            assert!((seen - wanted).norm() < 1e-3, "{seen} {wanted}");
        }
    }
}

#[test]
fn gaps_are_invisible_and_objects_move() {
    let (take, lens) = (synthetic::take(), synthetic::lens());
    let shot = Shot { take: &take, lens: &lens, rate: Rate::new(29.97).unwrap() };
    let text = write(Some(&shot), &synthetic::scenery());
    let camera = samples(&text, "def Camera", "token visibility");
    assert_eq!(camera.iter().map(|(code, _)| code.round()).collect::<Vec<_>>(), [0.0, 1.0, 5.0, 7.0, 11.0]);
    let prop = samples(&text, "def Xform \"prop__1_\"", "xformOp:translate");
    assert!((Vector3::from_column_slice(&prop[0].1) - synthetic::pose(21).translation).norm() < 1e-12);
    assert_eq!(prop.len(), 3);
    assert!(text.contains("displayName = \"prop \\\"1\\\"\""));
    assert!(number(&text, "timeCodesPerSecond") == 30_000.0 / 1001.0 && number(&text, "endTimeCode").round() == 11.0);
}

#[test]
fn the_stage_alone_has_no_time() {
    let scenery = synthetic::scenery();
    let text = write(None, &scenery);
    assert!(!text.contains("TimeCode") && !text.contains("def Camera") && !text.contains("Objects"));
    assert_eq!(text.matches("def Mesh").count(), 2);
    assert_eq!(text.matches("def Material").count(), 2);
    assert_eq!(text.matches('{').count(), text.matches('}').count());
    assert!(text.contains("@@@./take-cloth.png@@@") && text.contains("upAxis = \"Z\""));
}
