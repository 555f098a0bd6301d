//! Renders a [`VirtualStage`].
//!
//! Every pixel casts a few rays, each through a different part of the pixel and at a different
//! moment of the exposure, and averages what they hit (`samples`). Each row has its own instant
//! (rolling shutter), so the camera's pose is computed anew for every row and ray. A plane seen by
//! a camera is a homography from rays to artwork pixels: finding the hit takes one division, and
//! the determinant of the derivative tells how many texels a ray covers. Bent surfaces are kept in
//! a separate list (`cloth`), so that flat stages pay nothing for them. The average is over light,
//! as defined by the stage's light model (`light`).

use image::GrayImage;
use nalgebra::{Matrix2, Matrix3, Point3, Vector2, Vector3};
use rayon::prelude::*;

use super::cloth::Cloth;
use super::light::LightModel;
use super::path::CameraPath;
use super::person::is_within_outline;
use super::samples::{Sample, sample_pattern};
use super::sensor::develop_row;
use super::spot::Beam;
use super::stage::{VirtualStage, Wave};
use super::texture::Texture;
use crate::camera::{CameraModel, Pixel};
use crate::geometry::{Camera, Pose, Stage, SurfaceFrame};
use crate::track::SurfaceSpec;

/// Minimum distance of visible things, metres: about the front of a lens. Raised, things held close
/// to the camera vanish.
const NEAREST_M: f64 = 0.02;
/// Grey level of a surface's unpainted back: dim wood, distinct from the artwork's black and white.
/// Any grey would do.
const BACK_GREY: f32 = 45.0;
/// Grey level of the sensor in a blackout: a dark frame's offset, before noise. Raised, a blackout
/// counts as dim light.
const BLACKOUT_GREY: f32 = 4.0;

/// The ray through a pixel's centre and its derivative across the pixel.
#[derive(Debug, Clone, Copy)]
struct Ray {
    /// (x / z, y / z) in the camera frame; NaN if the lens has no ray there.
    centre: Vector2<f64>,
    /// Derivative of the ray with respect to the pixel position.
    per_px: Matrix2<f64>,
    /// Area of a pixel on the plane at depth 1.
    area: f64,
}

/// What a plane shows.
#[derive(Debug)]
enum Face {
    Picture {
        texture: Texture,
        size_px: [f64; 2],
    },
    Ellipse {
        light: f32,
    },
    /// Coordinates are half sizes to the right and up; the clothes fill the box around the outline.
    Person {
        clothes: Texture,
        size_px: [f64; 2],
    },
}

/// What a plane is attached to, and in whose frame its pose is.
#[derive(Debug, Clone, Copy)]
enum Carrier {
    Stage,
    Object(usize),
    Occluder(usize),
    Person(usize),
}

/// A plane that can be hit.
#[derive(Debug)]
struct Plane {
    face: Face,
    carrier: Carrier,
    /// `T_carrier_surface`.
    pose: Pose<Stage, SurfaceFrame>,
    /// Maps metres on the surface to face coordinates: artwork pixels, or half sizes.
    h_face_metres: Matrix3<f64>,
}

/// A plane as one ray of one row sees it.
#[derive(Debug, Clone, Copy)]
struct View {
    /// Maps rays to face coordinates.
    h_face_ray: Matrix3<f64>,
    determinant: f64,
    /// The camera's height above the face, metres; negative behind it.
    height: f64,
}

/// A virtual stage prepared for rendering: lens inverted for every pixel, pictures mipmapped.
#[derive(Debug)]
pub struct Renderer {
    stage: VirtualStage,
    rays: Vec<Ray>,
    samples: Vec<Sample>,
    planes: Vec<Plane>,
    bent: Vec<(Plane, Cloth)>,
    /// Light where there is no surface.
    background: f32,
    /// Light of a surface's back.
    back: f32,
}

/// A bent surface as one ray of one row sees it: the camera in the surface's frame.
#[derive(Debug, Clone, Copy)]
struct BentView {
    eye: Vector3<f64>,
    rotation: Matrix3<f64>,
    time_s: f64,
}

/// All surfaces as one ray of one row sees them.
#[derive(Debug)]
struct Views {
    planes: Vec<View>,
    bent: Vec<BentView>,
    beams: Vec<Beam>,
    camera: Pose<Stage, Camera>,
}

impl Renderer {
    /// Inverts the lens for every pixel and prepares every picture; takes about a second for large
    /// ones.
    pub fn new(stage: VirtualStage) -> Self {
        let rays = ray_table(&stage.camera);
        let samples = sample_pattern(stage.samples.max(1) as usize);
        let (planes, bent) = faces_of(&stage);
        let [background, back] = [stage.background, BACK_GREY].map(|grey| stage.light_model.light_of(grey));
        Self { stage, rays, samples, planes, bent, background, back }
    }

    /// Films along another path, with other noise. Inverts no lens and prepares no picture anew.
    pub fn with_path(mut self, path: CameraPath, seed: u64) -> Self {
        (self.stage.camera_path, self.stage.seed) = (path, seed);
        self
    }

    /// Returns the stage that is rendered.
    pub fn stage(&self) -> &VirtualStage {
        &self.stage
    }

    /// Renders the frame whose middle row is at mid-exposure at `time_s`; `frame` selects its
    /// noise.
    pub fn render(&self, time_s: f64, frame: u64) -> GrayImage {
        let (width, height) = (self.stage.camera.width(), self.stage.camera.height());
        let mut image = GrayImage::new(width, height);
        image.par_chunks_mut(width as usize).enumerate().for_each(|(y, out)| {
            let light = self.light_of_row(time_s, y);
            develop_row(&light, self.stage.noise, self.stage.light_model, self.stage.seed, frame, y as u64, out);
        });
        image
    }

    /// Returns the light on one row before the sensor, in the frame stamped `time_s`.
    fn light_of_row(&self, time_s: f64, row: usize) -> Vec<f32> {
        let width = self.stage.camera.width() as usize;
        if self.stage.is_blackout(time_s) {
            return vec![self.stage.light_model.light_of(BLACKOUT_GREY); width];
        }
        let row_time_s = time_s + self.row_delay_s(row);
        let mut light = vec![0.0; width];
        for sample in &self.samples {
            let at_s = row_time_s + self.stage.shutter.exposure_s * sample.moment;
            let gain = self.stage.light_gain(at_s) / self.samples.len() as f32;
            let views = self.views(at_s);
            for (sum, ray) in light.iter_mut().zip(&self.rays[row * width..]) {
                *sum += gain * self.trace(ray, sample, &views);
            }
        }
        light
    }

    /// Returns by how many seconds a row is exposed after the middle row.
    fn row_delay_s(&self, row: usize) -> f64 {
        let last = f64::from(self.stage.camera.height().max(2) - 1);
        self.stage.shutter.readout_s * (row as f64 / last - 0.5)
    }

    /// Returns every surface as the camera sees it at an instant.
    fn views(&self, time_s: f64) -> Views {
        let camera = self.stage.truth(time_s);
        let planes = self.planes.iter().map(|plane| plane.view(&plane.pose_at(&self.stage, time_s), &camera)).collect();
        let bent = self.bent.iter().map(|(plane, _)| {
            let t_surface_camera = plane.pose_at(&self.stage, time_s).inverse() * camera;
            BentView { eye: t_surface_camera.translation, rotation: t_surface_camera.rotation_matrix(), time_s }
        });
        let beams = self.stage.spots.iter().map(|spot| spot.beam(time_s)).collect();
        Views { planes, bent: bent.collect(), beams, camera }
    }

    /// Returns the light along one ray of a pixel.
    fn trace(&self, ray: &Ray, sample: &Sample, views: &Views) -> f32 {
        let offset = ray.per_px * sample.offset_px;
        let direction = Vector3::new(ray.centre.x + offset.x, ray.centre.y + offset.y, 1.0);
        let mut nearest = f64::INFINITY;
        let mut light = self.background;
        let mut hit = None;
        for (plane, view) in self.planes.iter().zip(&views.planes) {
            let h = &view.h_face_ray;
            let slope = h[(2, 0)] * direction.x + h[(2, 1)] * direction.y + h[(2, 2)];
            // The ray meets the plane at this depth; NaN (no ray) fails the comparison.
            let inverse = 1.0 / slope;
            let depth = -view.height * inverse;
            if !(depth > NEAREST_M && depth < nearest) {
                continue;
            }
            let u = (h[(0, 0)] * direction.x + h[(0, 1)] * direction.y + h[(0, 2)]) * inverse;
            let v = (h[(1, 0)] * direction.x + h[(1, 1)] * direction.y + h[(1, 2)]) * inverse;
            if plane.face.covers(u, v) {
                nearest = depth;
                hit = Some((&plane.face, view, inverse, u, v));
            }
        }
        if let Some((face, view, inverse, u, v)) = hit {
            // Texels under one ray: the pixel's area on the face, divided among its rays.
            let texels = (view.determinant * inverse * inverse * inverse).abs() * ray.area / self.samples.len() as f64;
            light = if view.height > 0.0 { face.light(u, v, texels as f32) } else { self.back };
        }
        for ((plane, cloth), view) in self.bent.iter().zip(&views.bent) {
            let toward = view.rotation * direction;
            let Some(met) = cloth.meet(&view.eye, &toward, NEAREST_M, view.time_s).filter(|met| met.depth < nearest) else { continue };
            nearest = met.depth;
            let [x, y] = met.on_picture_m;
            let face = plane.h_face_metres * Vector3::new(x, y, 1.0);
            let against = -toward.dot(&met.normal);
            // The pixel's area at that depth, projected along the ray onto the cloth; then in
            // texels.
            let square_m = met.depth * met.depth * ray.area / against.abs();
            let texels = square_m * plane.texels_per_square_m() / self.samples.len() as f64;
            light = if against > 0.0 { plane.face.light(face.x, face.y, texels as f32) } else { self.back };
        }
        if views.beams.is_empty() || nearest.is_infinite() {
            return light;
        }
        let place = views.camera.transform(&Point3::from(direction * nearest));
        light * (1.0 + views.beams.iter().map(|beam| beam.light_at(&place)).sum::<f32>())
    }
}

impl Face {
    fn covers(&self, u: f64, v: f64) -> bool {
        match self {
            // Pixel centres at integers: the picture spans half a pixel beyond the outermost
            // centres.
            Face::Picture { size_px: [w, h], .. } => u >= -0.5 && v >= -0.5 && u < w - 0.5 && v < h - 0.5,
            Face::Ellipse { .. } => u * u + v * v < 1.0,
            Face::Person { .. } => is_within_outline(u, v),
        }
    }

    /// Returns the light at a face position, averaged over an area in face coordinates.
    #[inline]
    fn light(&self, u: f64, v: f64, area: f32) -> f32 {
        match self {
            // Below one texel the level is the finest: no logarithm is needed.
            Face::Picture { texture, .. } => texture.light(u, v, if area <= 1.0 { 0.0 } else { 0.5 * area.log2() }),
            Face::Ellipse { light } => *light,
            Face::Person { clothes, size_px } => {
                let [half_width, half_height] = size_px.map(|side| 0.5 * side);
                let level = 0.5 * area.log2() + 0.5 * ((half_width * half_height) as f32).log2();
                clothes.light((1.0 + u) * half_width - 0.5, (1.0 - v) * half_height - 0.5, level)
            }
        }
    }
}

impl Plane {
    fn of_surface(surface: &SurfaceSpec, carrier: Carrier, model: LightModel) -> Self {
        let size_px = [f64::from(surface.artwork.width()), f64::from(surface.artwork.height())];
        let [per_x, per_y] = [size_px[0] / surface.size_m[0], size_px[1] / surface.size_m[1]];
        let middle = surface.to_artwork(Vector2::zeros());
        Self {
            face: Face::Picture { texture: Texture::new(&surface.artwork, model), size_px },
            carrier,
            // A surface's pose is in its body's frame; `pose_at` places the body in the stage.
            pose: surface.pose.renamed(),
            h_face_metres: Matrix3::new(per_x, 0.0, middle.x, 0.0, -per_y, middle.y, 0.0, 0.0, 1.0),
        }
    }

    fn texels_per_square_m(&self) -> f64 {
        (self.h_face_metres[(0, 0)] * self.h_face_metres[(1, 1)]).abs()
    }

    fn pose_at(&self, stage: &VirtualStage, time_s: f64) -> Pose<Stage, SurfaceFrame> {
        match self.carrier {
            Carrier::Stage => self.pose,
            Carrier::Object(k) => stage.objects[k].path.pose(time_s) * self.pose.renamed(),
            Carrier::Occluder(k) => stage.occluders[k].pose(time_s),
            Carrier::Person(k) => stage.people[k].pose(time_s),
        }
    }

    fn view(&self, pose: &Pose<Stage, SurfaceFrame>, camera: &Pose<Stage, Camera>) -> View {
        let t_surface_camera = pose.inverse() * *camera;
        let (rotation, eye) = (t_surface_camera.rotation_matrix(), t_surface_camera.translation);
        // The ray eye + s R d meets z = 0 at s = -eye.z / (R d).z; its x there is (eye.x (R d).z -
        // eye.z (R d).x) / (R d).z.
        let down = rotation.row(2);
        let metres =
            Matrix3::from_rows(&[down * eye.x - rotation.row(0) * eye.z, down * eye.y - rotation.row(1) * eye.z, down.into_owned()]);
        let h_face_ray = self.h_face_metres * metres;
        View { h_face_ray, determinant: h_face_ray.determinant(), height: eye.z }
    }
}

/// Returns all surfaces that can be hit: the flat ones and the bent ones.
fn faces_of(stage: &VirtualStage) -> (Vec<Plane>, Vec<(Plane, Cloth)>) {
    let waves =
        |k: usize| -> Vec<Wave> { stage.draughts.iter().filter(|d| d.surface == k).flat_map(|d| d.waves.iter().copied()).collect() };
    let still = stage.stage.surfaces.iter().enumerate().map(|(k, s)| (s, Carrier::Stage, waves(k)));
    let scenery = stage.scenery.iter().map(|s| (s, Carrier::Stage, Vec::new()));
    let moving = stage.objects.iter().enumerate();
    let moving = moving.flat_map(|(k, object)| object.body.surfaces.iter().map(move |s| (s, Carrier::Object(k), Vec::new())));
    let (mut planes, mut bent) = (Vec::new(), Vec::new());
    for (surface, carrier, waves) in still.chain(scenery).chain(moving) {
        let plane = Plane::of_surface(surface, carrier, stage.light_model);
        match Cloth::of(surface, &waves) {
            Some(cloth) => bent.push((plane, cloth)),
            None => planes.push(plane),
        }
    }
    planes.extend(people_of(stage));
    (planes, bent)
}

/// Returns the planes of all people and occluders.
fn people_of(stage: &VirtualStage) -> impl Iterator<Item = Plane> {
    let upright = |face: Face, carrier: Carrier, [half_width, half_height]: [f64; 2]| {
        let h_face_metres = Matrix3::from_diagonal(&Vector3::new(1.0 / half_width, 1.0 / half_height, 1.0));
        Plane { face, carrier, pose: Pose::identity(), h_face_metres }
    };
    let occluders = stage.occluders.iter().enumerate().map(move |(k, occluder)| {
        upright(Face::Ellipse { light: stage.light_model.light_of(occluder.grey) }, Carrier::Occluder(k), occluder.half_size_m)
    });
    let people = stage.people.iter().enumerate().map(move |(k, person)| {
        let size_px = [f64::from(person.clothes.width()), f64::from(person.clothes.height())];
        let clothes = Texture::new(&person.clothes, stage.light_model);
        upright(Face::Person { clothes, size_px }, Carrier::Person(k), person.half_size_m)
    });
    occluders.chain(people)
}

/// Computes the exact inverse of the lens at every pixel centre, row-major.
fn ray_table(camera: &CameraModel) -> Vec<Ray> {
    let (width, height) = (camera.width(), camera.height());
    let pixels = (0..height).into_par_iter().flat_map_iter(|y| (0..width).map(move |x| (x, y)));
    let nowhere = Ray { centre: Vector2::repeat(f64::NAN), per_px: Matrix2::zeros(), area: 0.0 };
    pixels
        .map(|(x, y)| {
            let Some(ray) = camera.unproject(Pixel(Vector2::new(f64::from(x), f64::from(y)))) else { return nowhere };
            let per_ray = camera.project_with_jacobian(ray).1;
            per_ray.try_inverse().map_or(nowhere, |per_px| Ray { centre: ray.0, per_px, area: per_px.determinant().abs() })
        })
        .collect()
}

#[cfg(test)]
#[path = "render_tests.rs"]
mod tests;
