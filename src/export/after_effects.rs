//! A script for After Effects (`.jsx`): the numbers of the take, then what After Effects shall make
//! of them.
//!
//! After Effects cameras have one focal length, in pixels, and look at the centre of their
//! composition. So the camera stands in a composition of its own, the room, whose centre is the
//! principal point, and the composition of the picture shows the part of the room that the camera
//! saw, scaled in height by fy / fx. One metre is 1000 pixels; x right, y down, z away: the stage's
//! x, -z, y. Row k of the clip, from 0, is at k / rate seconds.

use nalgebra::{UnitQuaternion, Vector3};
use serde_json::{Value, json};

use super::axes::{angles_zyx, point_y_down, y_down};
use super::blender::gaps;
use super::scenery::Scenery;
use super::shot::{Shot, ends_run};
use super::take::Key;
use crate::camera::Intrinsics;

/// Pixels per metre in the room: one per millimetre. Any value would do; positions are shown with
/// one decimal.
const SCALE: f64 = 1000.0;

/// What After Effects does with the numbers.
const STEPS: &str = include_str!("after_effects.jsx");

/// Writes the script.
pub fn write(shot: &Shot<'_>, scenery: &Scenery) -> String {
    let (take, lens) = (shot.take, shot.lens);
    let objects: Vec<Value> = take
        .objects
        .iter()
        .filter(|(_, keys)| !keys.is_empty())
        .map(|(name, keys)| {
            // A layer's own axes are y down too.
            let mut object = motion(keys, |key| y_down() * key.pose.rotation * y_down().inverse());
            object["name"] = name.as_str().into();
            object
        })
        .collect();
    let corner = |name: &str, k: usize, p: &Vector3<f64>| json!({"name": format!("{name} {}", k + 1), "position": place(p)});
    let corners = scenery.stage.iter().flat_map(|sheet| {
        let corners = sheet.mesh.corners();
        (0..4).map(move |k| corner(&sheet.name, k, &corners[k]))
    });
    let mut numbers = json!({
        "size": [lens.width, lens.height],
        "room": room(lens),
        "zoom": lens.fx,
        // After Effects counts pixels from the picture's edge.
        "principal": [lens.cx + 0.5, lens.cy + 0.5],
        "height_percent": 100.0 * lens.fy / lens.fx,
        "rate": shot.rate.fps(),
        "rows": take.rows(),
        "gaps": gaps(take.rows(), &take.camera).into_iter().map(|frame| frame - 1).collect::<Vec<_>>(),
        "camera": motion(&take.camera, |key| y_down() * key.pose.rotation),
        "corners": corners.collect::<Vec<_>>(),
        "objects": objects,
    });
    if let Some((frames, rate)) = shot.first_frame_of_day() {
        numbers["start"] = json!({"seconds": f64::from(frames) / shot.rate.fps(), "is_drop": rate.is_drop()});
    }
    let head = "// Written by stagepose: a take for After Effects; run it by File > Scripts > Run Script File.\n";
    format!("{head}var TAKE = {};\n{STEPS}", ascii(&numbers.to_string()))
}

/// Returns the size of a composition that has the principal point in its centre and contains the
/// whole picture, in pixels of fx.
fn room(lens: &Intrinsics) -> [f64; 2] {
    let half = |centre: f64, size: u32| centre.max(f64::from(size) - centre);
    let across = half(lens.cx + 0.5, lens.width);
    let down = half(lens.cy + 0.5, lens.height) * lens.fx / lens.fy;
    [across, down].map(|half| 2.0 * half.ceil())
}

fn place(p: &Vector3<f64>) -> [f64; 3] {
    (point_y_down(p) * SCALE).into()
}

fn motion<From>(keys: &[Key<From>], rotation: impl Fn(&Key<From>) -> UnitQuaternion<f64>) -> Value {
    let placed = keys.iter().map(|key| {
        let ([x, y, z], turn) = (place(&key.pose.translation), angles_zyx(&rotation(key)).map(f64::to_degrees));
        json!([key.row, x, y, z, turn.x, turn.y, turn.z])
    });
    let ends: Vec<usize> = (0..keys.len()).filter(|k| ends_run(keys, *k)).collect();
    json!({"keys": placed.collect::<Vec<_>>(), "ends": ends})
}

/// Escapes what is not ASCII: scripts are read in an encoding that depends on the system.
fn ascii(json: &str) -> String {
    let mut text = String::with_capacity(json.len());
    for c in json.chars() {
        if c.is_ascii() {
            text.push(c);
        } else {
            text.extend(c.encode_utf16(&mut [0; 2]).iter().map(|unit| format!("\\u{unit:04x}")));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Vector2};

    use super::*;
    use crate::export::rate::Rate;
    use crate::export::synthetic;

    fn numbers(lens: &Intrinsics) -> Value {
        let take = synthetic::take();
        let text = write(&Shot { take: &take, lens, rate: Rate::new(29.97).unwrap() }, &synthetic::scenery());
        let (_, rest) = text.split_once("\nvar TAKE = ").unwrap();
        serde_json::from_str(rest.split_once(";\n").unwrap().0).unwrap()
    }

    fn list(value: &Value) -> Vec<f64> {
        serde_json::from_value(value.clone()).unwrap()
    }

    #[test]
    fn stage_corners_lie_where_the_records_have_them() {
        let (take, lens) = (synthetic::take(), synthetic::lens());
        let numbers = numbers(&lens);
        let (room, principal) = (list(&numbers["room"]), list(&numbers["principal"]));
        let (zoom, height) = (numbers["zoom"].as_f64().unwrap(), numbers["height_percent"].as_f64().unwrap() / 100.0);
        let corners: Vec<Vector3<f64>> =
            numbers["corners"].as_array().unwrap().iter().map(|c| Vector3::from_vec(list(&c["position"]))).collect();
        assert_eq!(corners.len(), 8);
        for (key, row) in take.camera.iter().zip(numbers["camera"]["keys"].as_array().unwrap()) {
            let v = list(row);
            assert_eq!(v[0], key.row as f64);
            let turn = |axis: Vector3<f64>, degrees: f64| UnitQuaternion::from_scaled_axis(axis * degrees.to_radians());
            let rotation = turn(Vector3::x(), v[4]) * turn(Vector3::y(), v[5]) * turn(Vector3::z(), v[6]);
            for (in_room, corner) in corners.iter().zip(synthetic::corners()) {
                let p = rotation.inverse() * (in_room - Vector3::new(v[1], v[2], v[3]));
                let seen_in_room = Vector2::new(0.5 * room[0] + zoom * p.x / p.z, 0.5 * room[1] + zoom * p.y / p.z);
                // The room's layer: its centre on the principal point, scaled in height.
                let from_centre = seen_in_room - Vector2::new(0.5 * room[0], 0.5 * room[1]);
                let seen = Vector2::new(principal[0] + from_centre.x, principal[1] + height * from_centre.y) - Vector2::new(0.5, 0.5);
                let wanted = synthetic::project(&lens, &key.pose, &Point3::from(corner));
                assert!((seen - wanted).norm() < 1e-6, "{seen} {wanted}");
            }
        }
        // The room covers the picture.
        assert!(principal[0] - 0.5 * room[0] <= 0.0 && principal[0] + 0.5 * room[0] >= 960.0);
        assert!(principal[1] - 0.5 * room[1] * height <= 0.0 && principal[1] + 0.5 * room[1] * height >= 540.0);
        assert_eq!(super::room(&synthetic::centred_lens()), [960.0, 540.0]);
    }

    #[test]
    fn gaps_hold_the_pose_and_are_marked() {
        let numbers = numbers(&synthetic::lens());
        assert_eq!((&numbers["gaps"], &numbers["camera"]["ends"]), (&json!([0, 5, 11]), &json!([3])));
        assert_eq!((&numbers["rows"], numbers["rate"].as_f64().unwrap()), (&json!(12), 30_000.0 / 1001.0));
        assert_eq!(numbers["objects"][0]["keys"].as_array().unwrap().len(), 3);
    }

    #[test]
    fn the_script_is_ascii() {
        let text = synthetic::text().replace("prop", "Bühne 😀");
        let take = crate::export::take::Take::parse(text.into_bytes()).unwrap();
        let lens = synthetic::lens();
        let script = write(&Shot { take: &take, lens: &lens, rate: Rate::new(25.0).unwrap() }, &synthetic::scenery());
        assert!(script.is_ascii() && script.contains("B\\u00fchne \\ud83d\\ude00"));
    }
}
