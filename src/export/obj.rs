//! The stage as Wavefront OBJ with its material file: metres, y up, as importers expect.

use std::fmt::Write;

use super::axes::point_y_up;
use super::scenery::{Scenery, Sheet};

/// Returns the texts of the OBJ and of its material file, which the OBJ names `materials`.
pub fn write(scenery: &Scenery, materials: &str) -> [String; 2] {
    let mut text = format!("# Written by stagepose. Metres; x right, y up, z towards the audience.\nmtllib {materials}\n");
    let mut mtl = String::from("# Written by stagepose.\n");
    let mut before = 0;
    for sheet in &scenery.stage {
        add(&mut text, sheet, before);
        before += sheet.mesh.points.len();
        // Writing to a string does not fail.
        let _ = write!(mtl, "newmtl {}\nKd 1 1 1\nillum 0\nmap_Kd {}\n", sheet.name, sheet.picture);
    }
    [text, mtl]
}

/// Adds a sheet whose points follow `before` others.
fn add(text: &mut String, sheet: &Sheet, before: usize) {
    let _ = writeln!(text, "o {0}\nusemtl {0}", sheet.name);
    for p in sheet.mesh.points.iter().map(point_y_up) {
        let _ = writeln!(text, "v {} {} {}", p.x, p.y, p.z);
    }
    for [u, v] in &sheet.mesh.uvs {
        let _ = writeln!(text, "vt {u} {v}");
    }
    for quad in sheet.mesh.quads() {
        let [a, b, c, d] = quad.map(|k| before + k + 1);
        let _ = writeln!(text, "f {a}/{a} {b}/{b} {c}/{c} {d}/{d}");
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::export::synthetic;

    #[test]
    fn faces_lie_on_the_stage_with_their_artwork() {
        let scenery = synthetic::scenery();
        let [text, mtl] = write(&scenery, "stage.mtl");
        let numbers = |kind: &str| -> Vec<Vec<f64>> {
            let lines = text.lines().filter_map(|line| line.strip_prefix(kind));
            lines.map(|line| line.split(' ').map(|v| v.parse().unwrap()).collect()).collect()
        };
        let (points, uvs) = (numbers("v "), numbers("vt "));
        let wanted: Vec<_> = scenery.stage.iter().flat_map(|sheet| sheet.mesh.points.iter().zip(&sheet.mesh.uvs)).collect();
        assert_eq!((points.len(), uvs.len()), (wanted.len(), wanted.len()));
        for ((p, uv), (point, wanted_uv)) in points.iter().zip(&uvs).zip(&wanted) {
            assert_eq!((Vector3::new(p[0], -p[2], p[1]), uv.as_slice()), (**point, wanted_uv.as_slice()));
        }
        let faces: Vec<&str> = text.lines().filter(|line| line.starts_with("f ")).collect();
        assert_eq!(faces.len(), scenery.stage.iter().map(|sheet| sheet.mesh.quads().count()).sum::<usize>());
        let last = scenery.stage[0].mesh.points.len() + 1;
        assert_eq!(faces[faces.len() - 1], format!("f {0}/{0} {1}/{1} {2}/{2} {3}/{3}", last, last + 1, last + 3, last + 2));
        assert!(text.contains("mtllib stage.mtl") && mtl.contains("newmtl flat_2\n") && mtl.contains("map_Kd take-cloth.png\n"));
    }
}
