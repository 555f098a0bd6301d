//! USD as text (`.usda`): metres, z up, one `Camera`, the stage as meshes with its artwork.
//!
//! Source: OpenUSD's schemas `UsdGeomCamera`, `UsdGeomXformable`, `UsdGeomMesh` and
//! `UsdPreviewSurface` (openusd.org). A USD camera looks along -z with y up; its aperture offsets
//! move the film gate, so cx and cy are exact.

use std::fmt::{Display, Write};

use nalgebra::{UnitQuaternion, Vector3};

use super::axes::{continuous, looking_back};
use super::film::Film;
use super::identifiers::Identifiers;
use super::scenery::{Scenery, Sheet};
use super::shot::Shot;
use super::take::Key;
use crate::timecode::StampedTimecode;

/// The root prim.
const ROOT: &str = "Stagepose";
/// Nearest and farthest distance that a program draws, metres: all of a hall. Only drawing depends
/// on it.
const CLIPPING_M: [f64; 2] = [0.01, 1000.0];

/// Writes the stage, and with a shot the camera and the objects as they move.
pub fn write(shot: Option<&Shot<'_>>, scenery: &Scenery) -> String {
    let mut file = Usd::default();
    file.head(shot);
    file.open("def Xform", ROOT, &["kind = \"component\""]);
    if let Some(shot) = shot {
        file.camera(shot);
    }
    file.open("def Xform", "Stage", &[]);
    scenery.stage.iter().for_each(|sheet| file.mesh(sheet));
    file.close();
    if let Some(shot) = shot {
        file.objects(shot, scenery);
    }
    file.open("def Scope", "Materials", &[]);
    scenery.shown(shot.map(|shot| shot.take)).for_each(|sheet| file.material(sheet));
    file.close();
    file.close();
    file.text
}

/// A file that grows.
#[derive(Debug, Default)]
struct Usd {
    text: String,
    depth: usize,
}

impl Usd {
    fn line(&mut self, line: impl Display) {
        // Writing to a string does not fail.
        let _ = writeln!(self.text, "{:indent$}{line}", "", indent = 4 * self.depth);
    }

    /// Begins a prim.
    fn open(&mut self, kind: &str, name: &str, metadata: &[&str]) {
        if metadata.is_empty() {
            self.line(format_args!("{kind} \"{name}\""));
        } else {
            self.line(format_args!("{kind} \"{name}\" ("));
            metadata.iter().for_each(|line| self.line(format_args!("    {line}")));
            self.line(")");
        }
        self.line("{");
        self.depth += 1;
    }

    fn close(&mut self) {
        self.depth -= 1;
        self.line("}");
    }

    fn head(&mut self, shot: Option<&Shot<'_>>) {
        self.line("#usda 1.0\n(");
        self.depth += 1;
        self.line(format_args!("defaultPrim = \"{ROOT}\""));
        self.line("doc = \"Written by stagepose. Metres, z up, y upstage. Time code 0 is the first record.\"");
        if let Some(shot) = shot {
            let fps = shot.rate.fps();
            self.line(format_args!("endTimeCode = {}", shot.last_code()));
            self.line(format_args!("framesPerSecond = {fps}"));
            self.line("metersPerUnit = 1");
            self.line("startTimeCode = 0");
            self.line(format_args!("timeCodesPerSecond = {fps}"));
        } else {
            self.line("metersPerUnit = 1");
        }
        self.line("upAxis = \"Z\"");
        self.depth -= 1;
        self.line(")\n");
    }

    fn camera(&mut self, shot: &Shot<'_>) {
        let (lens, film) = (shot.lens, Film::new(shot.lens));
        self.open("def Camera", "Camera", &[]);
        self.line(format_args!("float2 clippingRange = ({}, {})", CLIPPING_M[0], CLIPPING_M[1]));
        self.line(format_args!("float focalLength = {}", film.focal_mm));
        self.line(format_args!("float horizontalAperture = {}", film.width_mm));
        self.line(format_args!("float horizontalApertureOffset = {}", film.right_mm));
        self.line("token projection = \"perspective\"");
        self.line(format_args!("float verticalAperture = {}", film.height_mm));
        self.line(format_args!("float verticalApertureOffset = {}", film.up_mm));
        for (name, value) in [("fx", lens.fx), ("fy", lens.fy), ("cx", lens.cx), ("cy", lens.cy), ("skew", lens.skew)] {
            self.line(format_args!("custom double stagepose:{name} = {value}"));
        }
        self.line(format_args!("custom int2 stagepose:pictureSize = ({}, {})", lens.width, lens.height));
        let [k1, k2, p1, p2, k3] = lens.distortion;
        self.line("# k1, k2, p1, p2, k3 of Brown's model, as OpenCV has them");
        self.line(format_args!("custom double[] stagepose:distortion = [{k1}, {k2}, {p1}, {p2}, {k3}]"));
        self.timecode(shot);
        self.motion(shot, &shot.take.camera, looking_back_at);
        self.close();
    }

    /// Writes the timecode of every row that has one.
    fn timecode(&mut self, shot: &Shot<'_>) {
        let mut rising: Vec<(f64, &StampedTimecode)> = Vec::new();
        for (_, stamp, timecode) in shot.take.timecodes() {
            let code = shot.code(stamp);
            // Rows without a pose may have stamps out of order.
            if rising.last().is_none_or(|(last, _)| code > *last) {
                rising.push((code, timecode));
            }
        }
        let Some((_, first)) = rising.first() else { return };
        self.line(format_args!("custom string stagepose:timecodeRate = \"{}\"", first.rate));
        self.samples("custom string stagepose:timecode", rising.iter().map(|(code, timecode)| (*code, format!("\"{}\"", timecode.code))));
    }

    /// Writes samples of position and rotation, and where there are none.
    fn motion<From>(&mut self, shot: &Shot<'_>, keys: &[Key<From>], rotation: impl Fn(&Key<From>) -> UnitQuaternion<f64>) {
        let changes = shot.changes(keys);
        if !changes.is_empty() {
            let word = |has_pose: bool| if has_pose { "\"inherited\"" } else { "\"invisible\"" };
            self.samples("token visibility", changes.iter().map(|change| (change.code, word(change.has_pose))));
        }
        let codes = || keys.iter().map(|key| shot.code(key.timestamp));
        let rotations = continuous(keys.iter().map(rotation)).into_iter();
        let quaternions = rotations.map(|q| format!("({}, {}, {}, {})", q.w, q.i, q.j, q.k));
        self.samples("quatd xformOp:orient", codes().zip(quaternions));
        self.samples("double3 xformOp:translate", codes().zip(keys.iter().map(|key| tuple(&key.pose.translation))));
        self.line("uniform token[] xformOpOrder = [\"xformOp:translate\", \"xformOp:orient\"]");
    }

    fn samples(&mut self, attribute: &str, samples: impl Iterator<Item = (f64, impl Display)>) {
        self.line(format_args!("{attribute}.timeSamples = {{"));
        samples.for_each(|(code, value)| self.line(format_args!("    {code}: {value},")));
        self.line("}");
    }

    fn objects(&mut self, shot: &Shot<'_>, scenery: &Scenery) {
        self.open("def Xform", "Objects", &[]);
        let mut identifiers = Identifiers::default();
        for (name, keys) in shot.take.objects.iter().filter(|(_, keys)| !keys.is_empty()) {
            self.open("def Xform", &identifiers.of(name), &[&format!("displayName = {}", quoted(name))]);
            self.motion(shot, keys, |key| key.pose.rotation);
            scenery.object(name).iter().for_each(|sheet| self.mesh(sheet));
            self.close();
        }
        self.close();
    }

    fn mesh(&mut self, sheet: &Sheet) {
        let (mesh, [least, most]) = (&sheet.mesh, sheet.mesh.bounds());
        let quads: Vec<[usize; 4]> = mesh.quads().collect();
        self.open("def Mesh", &sheet.name, &["prepend apiSchemas = [\"MaterialBindingAPI\"]"]);
        self.line("uniform bool doubleSided = 1");
        self.line(format_args!("float3[] extent = [{}, {}]", tuple(&least), tuple(&most)));
        self.line(format_args!("int[] faceVertexCounts = [{}]", list(quads.iter().map(|_| 4))));
        self.line(format_args!("int[] faceVertexIndices = [{}]", list(quads.iter().flatten())));
        self.line(format_args!("rel material:binding = </{ROOT}/Materials/{}>", sheet.name));
        self.line(format_args!("point3f[] points = [{}]", list(mesh.points.iter().map(tuple))));
        let uvs = list(mesh.uvs.iter().map(|[u, v]| format!("({u}, {v})")));
        self.line(format_args!("texCoord2f[] primvars:st = [{uvs}] ("));
        self.line("    interpolation = \"vertex\"");
        self.line(")");
        self.line("uniform token subdivisionScheme = \"none\"");
        self.close();
    }

    fn material(&mut self, sheet: &Sheet) {
        let place = format!("/{ROOT}/Materials/{}", sheet.name);
        self.open("def Material", &sheet.name, &[]);
        self.line(format_args!("token outputs:surface.connect = <{place}/Surface.outputs:surface>"));
        self.open("def Shader", "Surface", &[]);
        self.line("uniform token info:id = \"UsdPreviewSurface\"");
        self.line(format_args!("color3f inputs:diffuseColor.connect = <{place}/Picture.outputs:rgb>"));
        self.line("float inputs:roughness = 1");
        self.line("token outputs:surface");
        self.close();
        self.open("def Shader", "Picture", &[]);
        self.line("uniform token info:id = \"UsdUVTexture\"");
        self.line(format_args!("asset inputs:file = @@@./{}@@@", sheet.picture.replace("@@@", "\\@@@")));
        self.line(format_args!("token inputs:sourceColorSpace = \"{}\"", if sheet.is_linear { "raw" } else { "sRGB" }));
        self.line(format_args!("float2 inputs:st.connect = <{place}/Coordinates.outputs:result>"));
        self.line("token inputs:wrapS = \"clamp\"");
        self.line("token inputs:wrapT = \"clamp\"");
        self.line("float3 outputs:rgb");
        self.close();
        self.open("def Shader", "Coordinates", &[]);
        self.line("uniform token info:id = \"UsdPrimvarReader_float2\"");
        self.line("string inputs:varname = \"st\"");
        self.line("float2 outputs:result");
        self.close();
        self.close();
    }
}

fn looking_back_at(key: &Key<crate::geometry::Camera>) -> UnitQuaternion<f64> {
    looking_back(&key.pose)
}

fn tuple(v: &Vector3<f64>) -> String {
    format!("({}, {}, {})", v.x, v.y, v.z)
}

fn list(items: impl Iterator<Item = impl Display>) -> String {
    let mut text = String::new();
    for (k, item) in items.enumerate() {
        // Writing to a string does not fail.
        let _ = write!(text, "{}{item}", if k > 0 { ", " } else { "" });
    }
    text
}

/// Returns a string as USD writes it; control characters become spaces.
fn quoted(text: &str) -> String {
    let plain: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    format!("\"{}\"", plain.replace('\\', "\\\\").replace('"', "\\\""))
}

#[cfg(test)]
#[path = "usd_tests.rs"]
mod tests;
