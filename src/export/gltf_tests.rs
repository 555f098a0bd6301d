//! Reads the file back: JSON, base64, and accessors.

use nalgebra::{Point3, Quaternion, Vector2, Vector3};

use super::*;
use crate::export::rate::Rate;
use crate::export::synthetic;

fn decode(text: &str) -> Vec<u8> {
    let digit = |c: u8| match c {
        b'A'..=b'Z' => u32::from(c - b'A'),
        b'a'..=b'z' => u32::from(c - b'a') + 26,
        b'0'..=b'9' => u32::from(c - b'0') + 52,
        b'+' => 62,
        _ => 63,
    };
    let digits: Vec<u8> = text.bytes().filter(|c| *c != b'=').collect();
    let group = |group: &[u8]| {
        let bits = group.iter().fold(0_u32, |bits, c| bits << 6 | digit(*c)) << (6 * (4 - group.len()));
        bits.to_be_bytes()[1..group.len()].to_vec()
    };
    digits.chunks(4).flat_map(group).collect()
}

struct Read {
    json: Value,
    bytes: Vec<u8>,
}

impl Read {
    fn new(text: &str) -> Self {
        let json: Value = serde_json::from_str(text).unwrap();
        let uri = json["buffers"][0]["uri"].as_str().unwrap();
        let bytes = decode(uri.split_once("base64,").unwrap().1);
        assert_eq!(json["buffers"][0]["byteLength"], bytes.len());
        Self { json, bytes }
    }

    fn view(&self, view: &Value) -> &[u8] {
        let view = &self.json["bufferViews"][view.as_u64().unwrap() as usize];
        let [begin, length] = ["byteOffset", "byteLength"].map(|key| view[key].as_u64().unwrap() as usize);
        assert_eq!(begin % 4, 0);
        &self.bytes[begin..begin + length]
    }

    fn rows(&self, accessor: &Value, width: usize) -> Vec<Vec<f64>> {
        let accessor = &self.json["accessors"][accessor.as_u64().unwrap() as usize];
        let floats: Vec<f64> =
            self.view(&accessor["bufferView"]).chunks(4).map(|b| f64::from(f32::from_le_bytes(b.try_into().unwrap()))).collect();
        assert_eq!(accessor["count"], floats.len() / width);
        floats.chunks(width).map(<[f64]>::to_vec).collect()
    }

    /// Returns times and values of a node's animated path.
    fn animated(&self, name: &str, path: &str, width: usize) -> (Vec<f64>, Vec<Vec<f64>>) {
        let node = self.json["nodes"].as_array().unwrap().iter().position(|node| node["name"] == name).unwrap();
        let channels = self.json["animations"][0]["channels"].as_array().unwrap();
        let channel = channels.iter().find(|c| c["target"]["node"] == node && c["target"]["path"] == path).unwrap();
        let sampler = &self.json["animations"][0]["samplers"][channel["sampler"].as_u64().unwrap() as usize];
        (self.rows(&sampler["input"], 1).concat(), self.rows(&sampler["output"], width))
    }
}

fn shot_text() -> String {
    let (take, lens) = (synthetic::take(), synthetic::lens());
    write(Some(&Shot { take: &take, lens: &lens, rate: Rate::new(29.97).unwrap() }), &synthetic::scenery())
}

#[test]
fn stage_corners_lie_where_the_records_have_them() {
    let (take, read) = (synthetic::take(), Read::new(&shot_text()));
    // The format has no principal point: it is in the middle.
    let lens = crate::camera::Intrinsics { cx: 479.5, cy: 269.5, ..synthetic::lens() };
    let perspective = &read.json["cameras"][0]["perspective"];
    let [fov, aspect] = ["yfov", "aspectRatio"].map(|key| perspective[key].as_f64().unwrap());
    let (times, positions) = read.animated("camera", "translation", 3);
    let (_, rotations) = read.animated("camera", "rotation", 4);
    for key in &take.camera {
        let seconds = key.timestamp.seconds_since(take.stamp(0));
        let k = times.iter().position(|time| (time - seconds).abs() < 1e-6).unwrap();
        let q = &rotations[k];
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(q[3], q[0], q[1], q[2]));
        for corner in synthetic::corners() {
            let p = rotation.inverse() * (corner - Vector3::from_column_slice(&positions[k]));
            let scale = 1.0 / (0.5 * fov).tan();
            let (x, y) = (scale / aspect * p.x / -p.z, scale * p.y / -p.z);
            let seen = Vector2::new(480.0 * (1.0 + x) - 0.5, 270.0 * (1.0 - y) - 0.5);
            let wanted = synthetic::project(&lens, &key.pose, &Point3::from(corner));
            assert!((seen - wanted).norm() < 2e-3, "{seen} {wanted}");
        }
    }
}

#[test]
fn the_camera_stands_still_in_a_gap() {
    let (take, read) = (synthetic::take(), Read::new(&shot_text()));
    let (times, positions) = read.animated("camera", "translation", 3);
    assert_eq!(times.len(), take.camera.len() + 1);
    assert!(times.windows(2).all(|pair| pair[0] < pair[1]));
    assert_eq!(positions[3], positions[4]);
    assert!((times[5] - times[4] - JUMP_S).abs() < 1e-5);
    assert_eq!(read.animated("prop \"1\"", "rotation", 4).0.len(), 3);
}

#[test]
fn meshes_and_pictures_are_embedded_and_y_is_up() {
    let scenery = synthetic::scenery();
    let read = Read::new(&write(None, &scenery));
    assert!(read.json.get("animations").is_none() && read.json.get("cameras").is_none());
    let root = read.json["nodes"].as_array().unwrap().last().unwrap();
    let q: Vec<f64> = serde_json::from_value(root["rotation"].clone()).unwrap();
    let turned = UnitQuaternion::from_quaternion(Quaternion::new(q[3], q[0], q[1], q[2])) * Vector3::z();
    assert!((turned - Vector3::y()).norm() < 1e-12);
    for (k, sheet) in scenery.stage.iter().enumerate() {
        let primitive = &read.json["meshes"][k]["primitives"][0];
        let points = read.rows(&primitive["attributes"]["POSITION"], 3);
        let uvs = read.rows(&primitive["attributes"]["TEXCOORD_0"], 2);
        for (j, point) in sheet.mesh.points.iter().enumerate() {
            assert!((Vector3::from_column_slice(&points[j]) - point).norm() < 1e-6);
            assert!((uvs[j][0] - sheet.mesh.uvs[j][0]).abs() + (1.0 - uvs[j][1] - sheet.mesh.uvs[j][1]).abs() < 1e-6);
        }
        assert_eq!(read.view(&read.json["images"][k]["bufferView"]), sheet.png);
        assert_eq!(primitive["material"], k);
    }
}
