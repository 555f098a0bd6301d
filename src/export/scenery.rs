//! Surfaces as they hang, as meshes with texture coordinates on their artwork.

use nalgebra::{Point3, Vector3};

use super::identifiers::Identifiers;
use super::take::Take;
use crate::light::Transfer;
use crate::track::{BodySpec, SurfaceShape, SurfaceSpec};

/// Mesh cells per knot interval of a bent shape. Chosen: a fold as narrow as the shape can have,
/// 12 mm deep over intervals of 0.2 m, is then followed to 0.25 mm, and usual folds to 0.05 mm.
/// Raised, larger files.
const CELLS_PER_INTERVAL: usize = 8;
/// Maximum number of mesh cells along a side. Keeps the file of a very fine shape below 100 MB.
const MAX_CELLS: usize = 512;

/// A grid of points on a surface, in its body's frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    /// Points along the picture's width and height; at least two each.
    pub points_along: [usize; 2],
    /// The points, metres: rows from the picture's bottom, each from the left.
    pub points: Vec<Vector3<f64>>,
    /// Their places on the artwork: 0 to 1 from its left edge, and from its bottom edge.
    pub uvs: Vec<[f64; 2]>,
}

/// A surface of the stage or of an object.
#[derive(Debug, Clone, PartialEq)]
pub struct Sheet {
    /// Its name, an identifier that no other sheet has.
    pub name: String,
    /// The name it has in messages.
    pub label: String,
    /// The file of its artwork, relative to the exported file.
    pub picture: String,
    /// The artwork, as PNG.
    pub png: Vec<u8>,
    /// Whether the artwork's levels are proportional to light; otherwise they are sRGB.
    pub is_linear: bool,
    /// Where it hangs.
    pub mesh: Mesh,
}

/// The stage's and the objects' surfaces.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Scenery {
    /// The stage's, in stage axes.
    pub stage: Vec<Sheet>,
    /// The objects' by name, in the axes of each object.
    pub objects: Vec<(String, Vec<Sheet>)>,
}

impl Mesh {
    /// Samples a surface: its corners if it is flat, otherwise finely enough for its folds.
    pub fn of(surface: &SurfaceSpec) -> Self {
        let cells = match &surface.shape {
            SurfaceShape::Flat => [1, 1],
            SurfaceShape::Bent(shape) => {
                let intervals = [shape.height.intervals(), shape.stretch.intervals()];
                [0, 1].map(|axis| (CELLS_PER_INTERVAL * intervals[0][axis].max(intervals[1][axis])).min(MAX_CELLS))
            }
        };
        let [columns, rows] = cells.map(|cells| cells + 1);
        let uvs: Vec<[f64; 2]> =
            (0..columns * rows).map(|k| [(k % columns) as f64 / cells[0] as f64, (k / columns) as f64 / cells[1] as f64]).collect();
        let [width, height] = surface.size_m;
        let hanging = |[u, v]: &[f64; 2]| {
            let place = surface.shape.at([(u - 0.5) * width, (v - 0.5) * height]).place;
            surface.pose.transform(&Point3::from(place)).coords
        };
        Self { points_along: [columns, rows], points: uvs.iter().map(hanging).collect(), uvs }
    }

    /// Returns the cells as indices of their points, anticlockwise as seen from the front.
    pub fn quads(&self) -> impl Iterator<Item = [usize; 4]> + use<> {
        let [columns, rows] = self.points_along;
        (0..rows.saturating_sub(1)).flat_map(move |j| {
            (0..columns.saturating_sub(1)).map(move |i| {
                let first = j * columns + i;
                [first, first + 1, first + columns + 1, first + columns]
            })
        })
    }

    /// Returns the corners: top left, top right, bottom right, bottom left.
    pub fn corners(&self) -> [Vector3<f64>; 4] {
        let [columns, rows] = self.points_along;
        let top = (rows - 1) * columns;
        [top, top + columns - 1, columns - 1, 0].map(|k| self.points[k])
    }

    /// Returns the smallest and the largest coordinates.
    pub fn bounds(&self) -> [Vector3<f64>; 2] {
        let first = self.points.first().copied().unwrap_or_default();
        self.points.iter().fold([first, first], |[least, most], p| [least.inf(p), most.sup(p)])
    }
}

impl Scenery {
    /// Builds the meshes. `stage_png`, `object_png`: each surface's artwork as PNG, in the same
    /// order. `stem`: with what the names of the pictures' files begin.
    pub fn new(stage: &BodySpec, objects: &[BodySpec], stage_png: Vec<Vec<u8>>, object_png: Vec<Vec<Vec<u8>>>, stem: &str) -> Self {
        let mut identifiers = Identifiers::default();
        let mut sheet = |surface: &SurfaceSpec, png: Vec<u8>| {
            let base = surface.name.rsplit_once('.').map_or(surface.name.as_str(), |(base, _)| base);
            let name = identifiers.of(base);
            Sheet {
                picture: format!("{stem}-{name}.png"),
                label: surface.name.clone(),
                png,
                is_linear: surface.transfer == Transfer::Linear,
                mesh: Mesh::of(surface),
                name,
            }
        };
        let mut sheets = |body: &BodySpec, png: Vec<Vec<u8>>| -> Vec<Sheet> {
            body.surfaces.iter().zip(png).map(|(surface, png)| sheet(surface, png)).collect()
        };
        let stage = sheets(stage, stage_png);
        Self { stage, objects: objects.iter().zip(object_png).map(|(object, png)| (object.name.clone(), sheets(object, png))).collect() }
    }

    /// Returns the sheets that are shown with a take: the stage's, and those of the objects that
    /// have a pose in it. Without a take, the stage's.
    pub fn shown(&self, take: Option<&Take>) -> impl Iterator<Item = &Sheet> {
        let has_pose = move |name: &str| take.and_then(|take| take.objects.get(name)).is_some_and(|keys| !keys.is_empty());
        self.stage.iter().chain(self.objects.iter().filter(move |(name, _)| has_pose(name)).flat_map(|(_, sheets)| sheets))
    }

    /// Returns an object's sheets; none if it is unknown.
    pub fn object(&self, name: &str) -> &[Sheet] {
        self.objects.iter().find(|(own, _)| own == name).map_or(&[], |(_, sheets)| sheets.as_slice())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::synthetic;

    #[test]
    fn meshes_lie_on_their_surfaces() {
        for surface in synthetic::stage().surfaces {
            let mesh = Mesh::of(&surface);
            let [width, height] = surface.size_m;
            // Middles of cells are where a mesh is farthest from a bent surface.
            for quad in mesh.quads() {
                let middle = quad.iter().map(|k| mesh.points[*k]).sum::<Vector3<f64>>() / 4.0;
                let uv = quad.iter().fold([0.0, 0.0], |sum, k| [0, 1].map(|axis| sum[axis] + 0.25 * mesh.uvs[*k][axis]));
                let place = surface.shape.at([(uv[0] - 0.5) * width, (uv[1] - 0.5) * height]).place;
                let true_middle = surface.pose.transform(&Point3::from(place)).coords;
                assert!((middle - true_middle).norm() < 0.25e-3, "{}: {:e}", surface.name, (middle - true_middle).norm());
            }
            let [top_left, _, bottom_right, _] = mesh.corners();
            let corner = |x: f64, y: f64| surface.pose.transform(&Point3::from(surface.shape.at([x, y]).place)).coords;
            assert!((top_left - corner(-0.5 * width, 0.5 * height)).norm() < 1e-12);
            assert!((bottom_right - corner(0.5 * width, -0.5 * height)).norm() < 1e-12);
        }
    }

    #[test]
    fn cells_turn_anticlockwise_about_the_surfaces_normal() {
        let surface = &synthetic::stage().surfaces[0];
        let mesh = Mesh::of(surface);
        let normal = surface.pose.rotation * Vector3::z();
        for [a, b, c, _] in mesh.quads().map(|quad| quad.map(|k| mesh.points[k])) {
            assert!((b - a).cross(&(c - b)).dot(&normal) > 0.0);
        }
    }
}
