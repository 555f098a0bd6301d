//! glTF 2.0 as one file (`.gltf`): buffers and artwork are embedded.
//!
//! The root node turns the stage's axes, z up, to glTF's, y up. Times are seconds since the first
//! record. glTF cameras have a vertical field of view and an aspect, so fx and fy are exact; cx,
//! cy, skew and distortion cannot be expressed. Neither can a gap: the camera stands still in it.
//!
//! Source: Khronos Group, glTF 2.0 Specification.

use nalgebra::UnitQuaternion;
use serde_json::{Value, json};

use super::axes::{continuous, looking_back, y_up};
use super::film::vertical_fov;
use super::scenery::{Scenery, Sheet};
use super::shot::{Shot, ends_run};
use super::take::Key;
use crate::html_page::svg::base64;

/// Component types and buffer targets, by the numbers that the specification gives them.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const VERTICES: u32 = 34962;
const INDICES: u32 = 34963;
/// Texture wrapping that repeats the edge.
const CLAMP_TO_EDGE: u32 = 33071;
/// Nearest distance that a program draws, metres.
const NEAR_M: f64 = 0.01;
/// How long before the end of a gap the camera still stands where it was, seconds: less than a
/// frame. Lowered, single precision no longer tells the two times of a long take apart.
const JUMP_S: f64 = 1e-3;

/// Writes the stage, and with a shot the camera and the objects as they move.
pub fn write(shot: Option<&Shot<'_>>, scenery: &Scenery) -> String {
    let mut file = Gltf::default();
    let mut children: Vec<usize> = scenery.stage.iter().map(|sheet| file.sheet(sheet)).collect();
    let mut animation = json!({"name": "take", "channels": [], "samplers": []});
    if let Some(shot) = shot {
        let lens = shot.lens;
        if let Some((_, stamp, timecode)) = shot.take.timecodes().next() {
            let at_s = stamp.seconds_since(shot.take.stamp(0));
            let (code, fraction, rate) = (timecode.code.to_string(), timecode.fraction, timecode.rate.word());
            animation["extras"] = json!({"timecode": code, "fraction": fraction, "rate": rate, "at_s": at_s});
        }
        let aspect = f64::from(lens.width) / f64::from(lens.height) * lens.fy / lens.fx;
        file.cameras.push(json!({"type": "perspective", "name": "camera",
            "perspective": {"yfov": vertical_fov(lens), "aspectRatio": aspect, "znear": NEAR_M}}));
        let camera = file.node(json!({"name": "camera", "camera": 0}));
        file.motion(&mut animation, shot, camera, &shot.take.camera, |key| looking_back(&key.pose));
        children.push(camera);
        for (name, keys) in shot.take.objects.iter().filter(|(_, keys)| !keys.is_empty()) {
            let sheets: Vec<usize> = scenery.object(name).iter().map(|sheet| file.sheet(sheet)).collect();
            let node = json!({"name": name, "children": sheets});
            let node = file.node(if sheets.is_empty() { json!({"name": name}) } else { node });
            file.motion(&mut animation, shot, node, keys, |key| key.pose.rotation);
            children.push(node);
        }
    }
    let turned = numbers(&y_up());
    let root = file.node(json!({"name": "stage, z up", "rotation": turned, "children": children}));
    file.finish(root, shot.is_some().then_some(animation))
}

/// The parts of a file.
#[derive(Debug, Default)]
struct Gltf {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    nodes: Vec<Value>,
    meshes: Vec<Value>,
    materials: Vec<Value>,
    textures: Vec<Value>,
    images: Vec<Value>,
    cameras: Vec<Value>,
}

/// Returns a quaternion in glTF's order, x, y, z, w.
fn numbers(q: &UnitQuaternion<f64>) -> [f64; 4] {
    [q.i, q.j, q.k, q.w]
}

impl Gltf {
    fn node(&mut self, node: Value) -> usize {
        self.nodes.push(node);
        self.nodes.len() - 1
    }

    /// Appends bytes; returns their view.
    fn view(&mut self, bytes: &[u8], target: Option<u32>) -> usize {
        let mut view = json!({"buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len()});
        if let Some(target) = target {
            view["target"] = target.into();
        }
        self.bytes.extend_from_slice(bytes);
        // The next view begins at a multiple of four.
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(view);
        self.views.len() - 1
    }

    /// Appends rows of `N` numbers in single precision; returns their accessor.
    fn floats<const N: usize>(&mut self, kind: &str, rows: &[[f64; N]], target: Option<u32>) -> usize {
        let singles: Vec<[f32; N]> = rows.iter().map(|row| row.map(|v| v as f32)).collect();
        let view = self.view(&singles.iter().flatten().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>(), target);
        let bound = |choose: fn(f32, f32) -> f32, start: f32| -> Vec<f32> {
            (0..N).map(|k| singles.iter().map(|row| row[k]).fold(start, choose)).collect()
        };
        let (least, most) = (bound(f32::min, f32::INFINITY), bound(f32::max, f32::NEG_INFINITY));
        self.accessors
            .push(json!({"bufferView": view, "componentType": FLOAT, "count": rows.len(), "type": kind, "min": least, "max": most}));
        self.accessors.len() - 1
    }

    /// Adds a sheet with its material; returns its node.
    fn sheet(&mut self, sheet: &Sheet) -> usize {
        let mesh = &sheet.mesh;
        let points: Vec<[f64; 3]> = mesh.points.iter().map(|p| (*p).into()).collect();
        // glTF counts v from the top.
        let uvs: Vec<[f64; 2]> = mesh.uvs.iter().map(|[u, v]| [*u, 1.0 - v]).collect();
        let positions = self.floats("VEC3", &points, Some(VERTICES));
        let texcoords = self.floats("VEC2", &uvs, Some(VERTICES));
        let triangles: Vec<u32> = mesh.quads().flat_map(|[a, b, c, d]| [a, b, c, a, c, d]).map(|k| k as u32).collect();
        let view = self.view(&triangles.iter().flat_map(|k| k.to_le_bytes()).collect::<Vec<u8>>(), Some(INDICES));
        self.accessors.push(json!({"bufferView": view, "componentType": UNSIGNED_INT, "count": triangles.len(), "type": "SCALAR"}));
        let indices = self.accessors.len() - 1;
        let material = self.material(sheet);
        self.meshes.push(json!({"name": sheet.name, "primitives": [
            {"attributes": {"POSITION": positions, "TEXCOORD_0": texcoords}, "indices": indices, "material": material}]}));
        self.node(json!({"name": sheet.name, "mesh": self.meshes.len() - 1}))
    }

    fn material(&mut self, sheet: &Sheet) -> usize {
        let view = self.view(&sheet.png, None);
        self.images.push(json!({"name": sheet.label, "mimeType": "image/png", "bufferView": view}));
        self.textures.push(json!({"source": self.images.len() - 1, "sampler": 0}));
        let picture = json!({"index": self.textures.len() - 1});
        self.materials.push(json!({"name": sheet.name, "doubleSided": true,
            "pbrMetallicRoughness": {"baseColorTexture": picture, "metallicFactor": 0, "roughnessFactor": 1}}));
        self.materials.len() - 1
    }

    /// Animates a node.
    fn motion<From>(
        &mut self,
        animation: &mut Value,
        shot: &Shot<'_>,
        node: usize,
        keys: &[Key<From>],
        rotation: impl Fn(&Key<From>) -> UnitQuaternion<f64>,
    ) {
        let begin = shot.take.stamp(0);
        let rotations = continuous(keys.iter().map(rotation));
        let (mut times, mut positions, mut turns) = (Vec::<[f64; 1]>::new(), Vec::<[f64; 3]>::new(), Vec::new());
        for (k, key) in keys.iter().enumerate() {
            // A first row whose stamp lies ahead of the others gives no time before zero.
            let seconds = key.timestamp.seconds_since(begin).max(0.0);
            let mut add = |seconds: f64| {
                if times.last().is_none_or(|[last]| (seconds as f32) > (*last as f32)) {
                    times.push([seconds]);
                    positions.push(key.pose.translation.into());
                    turns.push(numbers(&rotations[k]));
                }
            };
            add(seconds);
            if ends_run(keys, k) {
                add(keys[k + 1].timestamp.seconds_since(begin) - JUMP_S);
            }
        }
        let input = self.floats("SCALAR", &times, None);
        let outputs = [("translation", self.floats("VEC3", &positions, None)), ("rotation", self.floats("VEC4", &turns, None))];
        for (path, output) in outputs {
            let sampler = animation["samplers"].as_array().map_or(0, Vec::len);
            append(&mut animation["samplers"], json!({"input": input, "output": output, "interpolation": "LINEAR"}));
            append(&mut animation["channels"], json!({"sampler": sampler, "target": {"node": node, "path": path}}));
        }
    }

    fn finish(self, root: usize, animation: Option<Value>) -> String {
        let mut whole = json!({
            "asset": {"version": "2.0", "generator": concat!("stagepose ", env!("CARGO_PKG_VERSION"))},
            "scene": 0, "scenes": [{"nodes": [root]}], "nodes": self.nodes,
        });
        let uri = format!("data:application/octet-stream;base64,{}", base64(&self.bytes));
        if !self.images.is_empty() {
            whole["samplers"] = json!([{"wrapS": CLAMP_TO_EDGE, "wrapT": CLAMP_TO_EDGE}]);
        }
        let buffers = if self.bytes.is_empty() { Vec::new() } else { vec![json!({"byteLength": self.bytes.len(), "uri": uri})] };
        // The format has no empty lists.
        let lists = [
            ("buffers", buffers),
            ("bufferViews", self.views),
            ("accessors", self.accessors),
            ("meshes", self.meshes),
            ("materials", self.materials),
            ("textures", self.textures),
            ("images", self.images),
            ("cameras", self.cameras),
            ("animations", animation.into_iter().collect()),
        ];
        for (name, list) in lists.into_iter().filter(|(_, list)| !list.is_empty()) {
            whole[name] = list.into();
        }
        whole.to_string() + "\n"
    }
}

fn append(list: &mut Value, item: Value) {
    if let Some(list) = list.as_array_mut() {
        list.push(item);
    }
}

#[cfg(test)]
#[path = "gltf_tests.rs"]
mod tests;
