//! A Python script for Blender: the numbers of the take, then what Blender shall make of them.
//!
//! Frame n is row n of the clip, counted from 1, so that the clip's pictures lie behind the view
//! (`blender --python FILE -- CLIP`). Sensor, shift and pixel aspect give fx, fy, cx and cy
//! exactly. Blender's world has the stage's axes; its camera looks along -z with y up.

use serde_json::{Value, json};

use super::axes::{continuous, looking_back};
use super::film::{GATE_WIDTH_MM, principal_offset_px};
use super::scenery::{Scenery, Sheet};
use super::shot::{Shot, ends_run};
use super::take::Key;

/// What Blender does with the numbers.
const STEPS: &str = include_str!("blender.py");

/// Writes the script.
pub fn write(shot: &Shot<'_>, scenery: &Scenery) -> String {
    let take = shot.take;
    let fps = shot.rate.fps();
    let whole = fps.round().max(1.0);
    let objects: Vec<Value> = take
        .objects
        .iter()
        .filter(|(_, keys)| !keys.is_empty())
        .map(|(name, keys)| {
            let mut object = motion(keys, continuous(keys.iter().map(|key| key.pose.rotation)));
            object["name"] = name.as_str().into();
            object["sheets"] = scenery.object(name).iter().map(sheet).collect();
            object
        })
        .collect();
    let mut numbers = json!({
        "lens": lens(shot),
        "rows": take.rows(),
        // An integer: Blender takes no other number.
        "fps": whole as u32,
        "fps_base": whole / fps,
        "gaps": gaps(take.rows(), &take.camera),
        "camera": motion(&take.camera, continuous(take.camera.iter().map(|key| looking_back(&key.pose)))),
        "stage": scenery.stage.iter().map(sheet).collect::<Vec<_>>(),
        "objects": objects,
    });
    if let Some((row, _, timecode)) = take.timecodes().next() {
        numbers["timecode"] = json!({"frame": row + 1, "code": timecode.code.to_string(), "rate": timecode.rate.word()});
    }
    format!(
        "# Written by stagepose: a take for Blender. Metres, z up.\n# blender --python THIS_FILE -- CLIP\nimport os\nimport sys\n\nimport bpy\n\nTAKE = {numbers}\n{STEPS}"
    )
}

/// Returns the first frame of each run of rows without a pose.
pub(super) fn gaps<From>(rows: usize, keys: &[Key<From>]) -> Vec<usize> {
    let first = keys.first().filter(|key| key.row > 0).map(|_| 1);
    let later = keys.iter().enumerate().filter(|(k, key)| key.row + 1 < keys.get(k + 1).map_or(rows, |next| next.row));
    first.into_iter().chain(later.map(|(_, key)| key.row + 2)).collect()
}

fn motion<From>(keys: &[Key<From>], rotations: Vec<nalgebra::UnitQuaternion<f64>>) -> Value {
    let placed = keys.iter().zip(rotations).map(|(key, q)| {
        let p = key.pose.translation;
        json!([key.row + 1, p.x, p.y, p.z, q.w, q.i, q.j, q.k])
    });
    let ends: Vec<usize> = (0..keys.len()).filter(|k| ends_run(keys, *k)).map(|k| keys[k].row + 1).collect();
    json!({"keys": placed.collect::<Vec<_>>(), "ends": ends})
}

fn lens(shot: &Shot<'_>) -> Value {
    let lens = shot.lens;
    let w = f64::from(lens.width);
    // Blender measures heights in pixels of the picture's width: fx / fy is a pixel's height.
    let height = lens.fx / lens.fy;
    let [right, down] = principal_offset_px(lens);
    json!({
        "width": lens.width, "height": lens.height, "sensor_width": GATE_WIDTH_MM, "lens": GATE_WIDTH_MM * lens.fx / w,
        "shift_x": -right / w, "shift_y": down * height / w,
        // Neither may be below 1.
        "pixel_aspect": if height >= 1.0 { [1.0, height] } else { [1.0 / height, 1.0] },
    })
}

fn sheet(sheet: &Sheet) -> Value {
    let points: Vec<[f64; 3]> = sheet.mesh.points.iter().map(|p| (*p).into()).collect();
    let faces: Vec<[usize; 4]> = sheet.mesh.quads().collect();
    // Python has no `true`.
    let is_linear = u8::from(sheet.is_linear);
    json!({"name": sheet.name, "picture": sheet.picture, "is_linear": is_linear, "points": points, "uvs": sheet.mesh.uvs, "faces": faces})
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Quaternion, UnitQuaternion, Vector2, Vector3};

    use super::*;
    use crate::camera::Intrinsics;
    use crate::export::rate::Rate;
    use crate::export::synthetic;

    fn numbers(lens: &Intrinsics) -> Value {
        let take = synthetic::take();
        let text = write(&Shot { take: &take, lens, rate: Rate::new(29.97).unwrap() }, &synthetic::scenery());
        let (_, rest) = text.split_once("\nTAKE = ").unwrap();
        // The numbers are JSON without words that Python does not know.
        let line = rest.lines().next().unwrap();
        assert!(!["true", "false", "null"].iter().any(|word| line.contains(word)));
        serde_json::from_str(line).unwrap()
    }

    #[test]
    fn stage_corners_lie_where_the_records_have_them() {
        let take = synthetic::take();
        for lens in [synthetic::lens(), Intrinsics { fy: 820.0, ..synthetic::lens() }] {
            let numbers = numbers(&lens);
            let of = |name: &str| numbers["lens"][name].as_f64().unwrap();
            let aspect = [0, 1].map(|k| numbers["lens"]["pixel_aspect"][k].as_f64().unwrap());
            assert!(aspect[0] >= 1.0 && aspect[1] >= 1.0);
            // BKE_camera_params_compute_viewplane for a horizontal sensor fit: the view is as wide
            // as the picture has pixels, and its heights are scaled by the pixel aspect.
            let (w, h, scale) = (of("width"), of("height"), aspect[1] / aspect[0]);
            let focal_px = of("lens") / of("sensor_width") * w;
            for (key, row) in take.camera.iter().zip(numbers["camera"]["keys"].as_array().unwrap()) {
                let v: Vec<f64> = serde_json::from_value(row.clone()).unwrap();
                assert_eq!(v[0], key.row as f64 + 1.0);
                let rotation = UnitQuaternion::from_quaternion(Quaternion::new(v[4], v[5], v[6], v[7]));
                for corner in synthetic::corners() {
                    let p = rotation.inverse() * (corner - Vector3::new(v[1], v[2], v[3]));
                    let x = focal_px * p.x / -p.z - of("shift_x") * w;
                    let y = (focal_px * p.y / -p.z - of("shift_y") * w) / scale;
                    let seen = Vector2::new(0.5 * w + x - 0.5, 0.5 * h - y - 0.5);
                    let wanted = synthetic::project(&lens, &key.pose, &Point3::from(corner));
                    assert!((seen - wanted).norm() < 1e-6, "{seen} {wanted}");
                }
            }
        }
    }

    #[test]
    fn rates_gaps_and_objects_are_there() {
        let numbers = numbers(&synthetic::lens());
        assert_eq!((&numbers["fps"], &numbers["rows"]), (&json!(30), &json!(12)));
        assert!((numbers["fps_base"].as_f64().unwrap() - 1.001).abs() < 1e-12);
        assert_eq!((&numbers["gaps"], &numbers["camera"]["ends"]), (&json!([1, 6, 12]), &json!([5])));
        assert_eq!((&numbers["objects"][0]["name"], numbers["objects"][0]["keys"].as_array().unwrap().len()), (&json!("prop \"1\""), 3));
        assert_eq!(numbers["objects"][0]["sheets"][0]["faces"], json!([[0, 1, 3, 2]]));
    }
}
