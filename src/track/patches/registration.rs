//! Registration: locates each anchor of the reference pictures in the frame to a fraction of a
//! pixel.
//!
//! It starts from a pose that is right to a few pixels. Around every visible anchor a small patch
//! of the artwork is drawn as the camera should see it, and moved over the frame until it fits
//! (Lucas-Kanade in Baker and Matthews' inverse compositional form, with a free gain and bias per
//! patch). Each patch has its own covariance, from its gradients and from how well it fits. A pose
//! is verified by the number of patches that fit.

use crate::track::patches::tuning::TUNING;
use image::GrayImage;
use nalgebra::{Matrix2, Matrix4, Point3, Vector2, Vector3, Vector4};

use crate::camera::CameraModel;
use crate::features::Workers;
use crate::geometry::resection::Observation;
use crate::geometry::{Body, Camera, Pose};
use crate::simd::multiversion;
use crate::track::scene::bilinear::look_at;
use crate::track::scene::rectangle::SeenPoint;
use crate::track::scene::reference::{Octave, PreparedBody, PreparedSurface};

/// Half side of a patch, pixels of the searched picture; the side and area follow. Raised, patches
/// cost more (squared) and overlap borders and people; lowered, they fit in wrong places.
const PATCH_RADIUS: i32 = 6;
const PATCH_SIDE: usize = 2 * PATCH_RADIUS as usize + 1;
const PATCH_AREA: usize = PATCH_SIDE * PATCH_SIDE;
/// Side with a border of one pixel, which gradients need.
const BORDERED_SIDE: usize = PATCH_SIDE + 2;
/// Columns processed together, two registers of eight: a row of a patch, padded with columns that
/// count for nothing. Raised, more of them are padding.
const PATCH_LANES: usize = 16;

/// The result of searching one anchor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Registered {
    /// Index of the surface in its body.
    pub surface: u32,
    /// Position of the anchor on the artwork, full-size pixels.
    pub artwork: Vector2<f64>,
    /// Position predicted by the pose, raw frame pixels.
    pub predicted: Vector2<f64>,
    /// Where it was seen, if the patch fitted.
    pub observation: Option<Observation>,
    /// Correlation of the patch at its best place.
    pub correlation: f32,
}

/// A picture in which patches are searched: the frame or its half-size copy.
#[derive(Debug, Clone, Copy)]
pub struct SearchPicture<'a> {
    /// Grey levels.
    pub image: &'a GrayImage,
    /// Frame pixels per pixel of this picture: 1 or 2.
    pub scale: f64,
    /// Pixels to leave out (0), at full frame size.
    pub mask: Option<&'a GrayImage>,
}

/// A patch to search for.
#[derive(Debug, Clone, Copy)]
pub struct Target {
    /// Index of the surface in its body.
    pub surface: u32,
    octave: u32,
    artwork: Vector2<f64>,
    point: Point3<f64>,
    predicted: Vector2<f64>,
    /// Derivative of artwork pixels by frame pixels.
    artwork_by_frame: Matrix2<f64>,
}

/// Lists the anchors that the pose (`T_camera_body`) predicts in the frame, facing the camera and
/// not hidden by another surface of the body: at most `count`, shared among the surfaces in
/// proportion to their visible anchors.
pub fn visible_targets(
    body: &PreparedBody,
    pose: &Pose<Camera, Body>,
    camera: &CameraModel,
    picture: &SearchPicture,
    count: usize,
    targets: &mut Vec<Target>,
) {
    targets.clear();
    let t_body_camera = pose.inverse();
    for (index, surface) in body.surfaces.iter().enumerate().filter(|(_, surface)| !surface.is_left_out) {
        let Some(octave) = best_octave(surface, &t_body_camera, camera, picture.scale) else { continue };
        for anchor in &surface.octaves[octave].anchors {
            let Some(mut target) = project_anchor(surface, &t_body_camera, camera, anchor.position, picture) else { continue };
            if occluded(body, index, &t_body_camera.translation, &target.point) {
                continue;
            }
            target.surface = index as u32;
            target.octave = octave as u32;
            targets.push(target);
        }
    }
    thin(targets, count);
}

/// Keeps the first anchors of every surface, in proportion to its visible ones. They are sorted so
/// that the first ones are well spread.
fn thin(targets: &mut Vec<Target>, count: usize) {
    let all = targets.len();
    if all <= count {
        return;
    }
    let (mut from, mut kept) = (0, 0);
    while let Some(first) = targets.get(from) {
        let surface = first.surface;
        let own = targets[from..].iter().take_while(|t| t.surface == surface).count();
        let keep = (own * count).div_ceil(all);
        targets.copy_within(from..from + keep, kept);
        (from, kept) = (from + own, kept + keep);
    }
    targets.truncate(kept);
}

/// Returns the octave whose pixel size is closest to that of the searched picture, at the median of
/// the visible points of the surface.
fn best_octave(surface: &PreparedSurface, t_body_camera: &Pose<Body, Camera>, camera: &CameraModel, scale: f64) -> Option<usize> {
    let size = [f64::from(camera.width()), f64::from(camera.height())];
    let log2 =
        surface.rectangle.texels_log2(size, |point| surface.rectangle.see(t_body_camera, camera, point, TUNING.min_registration_cosine))?
            + scale.log2();
    Some((log2.round().max(0.0) as usize).min(surface.octaves.len() - 1))
}

fn project_anchor(
    surface: &PreparedSurface,
    t_body_camera: &Pose<Body, Camera>,
    camera: &CameraModel,
    artwork: Vector2<f64>,
    picture: &SearchPicture,
) -> Option<Target> {
    let metres = surface.spec.to_metres(artwork);
    let SeenPoint { pixel: predicted, by_metres } =
        surface.rectangle.see(t_body_camera, camera, [metres.x, metres.y], TUNING.min_registration_cosine)?;
    let margin = (f64::from(PATCH_RADIUS) + 4.0) * picture.scale;
    let (w, h) = (f64::from(camera.width()), f64::from(camera.height()));
    if predicted.x < margin || predicted.y < margin || predicted.x > w - 1.0 - margin || predicted.y > h - 1.0 - margin {
        return None;
    }
    let masked = |mask: &GrayImage| mask.get_pixel_checked(predicted.x as u32, predicted.y as u32).is_none_or(|p| p[0] == 0);
    if picture.mask.is_some_and(masked) {
        return None;
    }
    // Rows of the artwork run down, y on the surface runs up.
    let [across, down] = surface.rectangle.texels_per_m();
    let artwork_by_frame = Matrix2::new(across, 0.0, 0.0, -down) * by_metres.try_inverse()?;
    Some(Target { surface: 0, octave: 0, artwork, point: surface.spec.body_point(artwork), predicted, artwork_by_frame })
}

/// Whether another surface of the body stands between the camera and the point.
fn occluded(body: &PreparedBody, own: usize, camera: &Vector3<f64>, point: &Point3<f64>) -> bool {
    let others = body.surfaces.iter().enumerate().filter(|(index, _)| *index != own);
    others.into_iter().any(|(_, other)| other.rectangle.hides_any(&[point.coords], camera))
}

/// Searches for every target in the picture. `registered` has one entry per target: `None` if its
/// patch cannot be drawn or is plain.
pub fn register(
    body: &PreparedBody,
    targets: &[Target],
    picture: &SearchPicture,
    workers: &Workers,
    registered: &mut Vec<Option<Registered>>,
) {
    workers.map_into(targets, registered, |t| {
        let octaves = &body.surfaces[t.surface as usize].octaves;
        search(t, octaves, picture)
    });
}

/// The drawn patch, and the terms of its linear fit.
struct Template {
    /// Grey levels minus their mean, row by row; padded with 0, like the gradients.
    value: [[f32; PATCH_LANES]; PATCH_SIDE],
    gx: [[f32; PATCH_LANES]; PATCH_SIDE],
    gy: [[f32; PATCH_LANES]; PATCH_SIDE],
    inverse: Matrix4<f64>,
    /// Information of the position per unit of grey variance, with gain and bias eliminated.
    structure: Matrix2<f64>,
}

/// Draws the patch as the camera should see it: each pixel is the mean of 2x2 samples from the
/// octave whose pixels are half as wide.
fn draw(target: &Target, octaves: &[Octave], scale: f64) -> Option<[f32; BORDERED_SIDE * BORDERED_SIDE]> {
    let m = target.artwork_by_frame * scale;
    let footprint = m.determinant().abs().sqrt();
    let octave = ((0.5 * footprint).log2().round().max(0.0) as usize).min(octaves.len() - 1);
    let image = &octaves[octave].image;
    let (w, h) = (image.width() as usize, image.height() as usize);
    let s = 1.0 / f64::from(1u32 << octave);
    let centre = (target.artwork + Vector2::new(0.5, 0.5)) * s - Vector2::new(0.5, 0.5);
    let m = m * s;
    let reach = f64::from(PATCH_RADIUS) + 1.5;
    let (rx, ry) = (reach * (m[(0, 0)].abs() + m[(0, 1)].abs()), reach * (m[(1, 0)].abs() + m[(1, 1)].abs()));
    if centre.x - rx < -0.5 || centre.y - ry < -0.5 || centre.x + rx > w as f64 - 0.5 || centre.y + ry > h as f64 - 0.5 {
        return None;
    }
    let m = m.cast::<f32>();
    let (cx, cy) = (centre.x as f32, centre.y as f32);
    let mut out = [0.0; BORDERED_SIDE * BORDERED_SIDE];
    for (v, row) in out.chunks_exact_mut(BORDERED_SIDE).enumerate() {
        // All first samples of the row, then all second ones, and so on.
        let (mut xs, mut ys) = ([0.0; SUBPIXEL_OFFSETS.len() * BORDERED_SIDE], [0.0; SUBPIXEL_OFFSETS.len() * BORDERED_SIDE]);
        for (look, [ox, oy]) in SUBPIXEL_OFFSETS.into_iter().enumerate() {
            let py = v as f32 - (PATCH_RADIUS + 1) as f32 + oy;
            for u in 0..BORDERED_SIDE {
                let px = u as f32 - (PATCH_RADIUS + 1) as f32 + ox;
                xs[look * BORDERED_SIDE + u] = cx + m[(0, 0)] * px + m[(0, 1)] * py;
                ys[look * BORDERED_SIDE + u] = cy + m[(1, 0)] * px + m[(1, 1)] * py;
            }
        }
        let seen = look_at(image.as_raw(), [w, h], &xs, &ys);
        for (u, value) in row.iter_mut().enumerate() {
            *value = 0.25 * (0..SUBPIXEL_OFFSETS.len()).map(|look| seen[look * BORDERED_SIDE + u]).sum::<f32>();
        }
    }
    Some(out)
}

/// Sample positions within a pixel, relative to its centre, pixels.
const SUBPIXEL_OFFSETS: [[f32; 2]; 4] = [[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]];

fn template(wide: &[f32; BORDERED_SIDE * BORDERED_SIDE]) -> Option<Template> {
    let none = [[0.0; PATCH_LANES]; PATCH_SIDE];
    let mut t = Template { value: none, gx: none, gy: none, inverse: Matrix4::zeros(), structure: Matrix2::zeros() };
    for (v, u) in (0..PATCH_SIDE).flat_map(|v| (0..PATCH_SIDE).map(move |u| (v, u))) {
        let at = (v + 1) * BORDERED_SIDE + u + 1;
        t.value[v][u] = wide[at];
        t.gx[v][u] = 0.5 * (wide[at + 1] - wide[at - 1]);
        t.gy[v][u] = 0.5 * (wide[at + BORDERED_SIDE] - wide[at - BORDERED_SIDE]);
    }
    // With the mean removed, gain and bias are better decoupled.
    let mean = t.value.iter().flatten().sum::<f32>() / PATCH_AREA as f32;
    t.value.iter_mut().for_each(|row| row[..PATCH_SIDE].iter_mut().for_each(|v| *v -= mean));
    let mut normal = [0.0f32; 10];
    for (v, u) in (0..PATCH_SIDE).flat_map(|v| (0..PATCH_SIDE).map(move |u| (v, u))) {
        let row = [t.value[v][u], t.gx[v][u], t.gy[v][u], 1.0];
        let mut n = 0;
        for i in 0..4 {
            for j in i..4 {
                normal[n] += row[i] * row[j];
                n += 1;
            }
        }
    }
    let n = normal.map(f64::from);
    let full = Matrix4::new(n[0], n[1], n[2], n[3], n[1], n[4], n[5], n[6], n[2], n[5], n[7], n[8], n[3], n[6], n[8], n[9]);
    if (n[0] / PATCH_AREA as f64).sqrt() < f64::from(TUNING.min_patch_contrast) {
        return None;
    }
    t.inverse = full.try_inverse()?;
    t.structure = t.inverse.fixed_view::<2, 2>(1, 1).try_inverse()?;
    Some(t)
}

multiversion! {
    /// Returns sums over a patch of the frame whose first pixel is the first of `frame`: of its
    /// grey, of the grey's square, and of the grey's products with the template and its two
    /// gradients. `weights`: bilinear weights of a pixel, its right neighbour, and the two below.
    fn template_products(t: &Template, frame: &[u8], width: usize, weights: &[f32; 4]) -> [f32; 5];
    ["avx2"] => template_products_plain, else template_products_plain
}

#[inline(always)]
fn template_products_plain(t: &Template, frame: &[u8], width: usize, weights: &[f32; 4]) -> [f32; 5] {
    let [w00, w10, w01, w11] = *weights;
    let mut sums = [[0.0f32; PATCH_LANES]; 5];
    for v in 0..PATCH_SIDE {
        // Padded with zeros after the row and its right neighbour.
        let [top, bottom] = [v, v + 1].map(|v| {
            let mut padded = [0; PATCH_LANES + 1];
            padded[..=PATCH_SIDE].copy_from_slice(&frame[v * width..][..=PATCH_SIDE]);
            padded
        });
        for u in 0..PATCH_LANES {
            let f = w00 * f32::from(top[u]) + w10 * f32::from(top[u + 1]) + w01 * f32::from(bottom[u]) + w11 * f32::from(bottom[u + 1]);
            let f = if u < PATCH_SIDE { f } else { 0.0 };
            sums[0][u] += f;
            sums[1][u] += f * f;
            sums[2][u] += f * t.value[v][u];
            sums[3][u] += f * t.gx[v][u];
            sums[4][u] += f * t.gy[v][u];
        }
    }
    sums.map(|lanes| lanes.iter().sum())
}

/// Solves one linear step: returns [gain, gain ex, gain ey, bias] that best map the template to the
/// frame at (x, y), the correlation and the residual variance.
fn fit(t: &Template, image: &GrayImage, x: f64, y: f64) -> (Vector4<f64>, f32, f32) {
    let (w, h) = (image.width() as usize, image.height() as usize);
    let raw = image.as_raw();
    let (i, j) = (x.floor() as i32 - PATCH_RADIUS, y.floor() as i32 - PATCH_RADIUS);
    let (a, b) = ((x - x.floor()) as f32, (y - y.floor()) as f32);
    let (i, j) = (i.clamp(0, w as i32 - PATCH_SIDE as i32 - 1) as usize, j.clamp(0, h as i32 - PATCH_SIDE as i32 - 1) as usize);
    let weights = [(1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b];
    let [s, ss, st, sx, sy] = template_products(t, &raw[j * w + i..], w, &weights);
    let right = Vector4::new(f64::from(st), f64::from(sx), f64::from(sy), f64::from(s));
    let solution = t.inverse * right;
    let n = PATCH_AREA as f64;
    let (s, ss) = (f64::from(s), f64::from(ss));
    let explained = solution.dot(&right);
    let total = (ss - s * s / n).max(1e-6);
    let residual = (ss - explained).max(0.0) / (n - 4.0);
    let correlation = (1.0 - residual * (n - 4.0) / total).max(0.0).sqrt() * solution[0].signum();
    (solution, correlation as f32, residual as f32)
}

fn search(target: &Target, octaves: &[Octave], picture: &SearchPicture) -> Option<Registered> {
    let scale = picture.scale;
    let t = template(&draw(target, octaves, scale)?)?;
    let start = (target.predicted + Vector2::new(0.5, 0.5)) / scale - Vector2::new(0.5, 0.5);
    let (w, h) = (f64::from(picture.image.width()), f64::from(picture.image.height()));
    let mut at = start;
    let mut converged = false;
    let (mut correlation, mut variance, mut gain) = (0.0, 0.0, 0.0);
    for _ in 0..8 {
        let (solution, c, v) = fit(&t, picture.image, at.x, at.y);
        (correlation, variance, gain) = (c, v, solution[0]);
        if gain.abs() < 1e-3 {
            break;
        }
        // The frame at `at` shows the template's point e, so the centre lies at at - e. Long steps
        // are shortened because the linear fit is only local.
        let e = Vector2::new(solution[1], solution[2]) / gain;
        let e = e * (1.5 / e.norm()).min(1.0);
        at -= e;
        let margin = f64::from(PATCH_RADIUS) + 1.0;
        if (at - start).norm() > 5.0 || at.x < margin || at.y < margin || at.x > w - margin - 2.0 || at.y > h - margin - 2.0 {
            break;
        }
        if e.norm() < 0.01 {
            converged = true;
            break;
        }
    }
    let fits = converged && correlation > TUNING.min_patch_correlation && gain > 0.02;
    let observation = fits.then(|| {
        let noise = f64::from(variance.max(TUNING.min_grey_noise * TUNING.min_grey_noise));
        let covariance = t.structure.try_inverse().unwrap_or_default() * (noise / (gain * gain))
            + Matrix2::identity() * TUNING.patch_model_error_px.powi(2);
        let information = covariance.try_inverse().unwrap_or_default() / (scale * scale);
        let pixel = (at + Vector2::new(0.5, 0.5)) * scale - Vector2::new(0.5, 0.5);
        Observation { point: target.point, pixel, information, delay_s: 0.0, group: 0 }
    });
    Some(Registered { surface: target.surface, artwork: target.artwork, predicted: target.predicted, observation, correlation })
}

#[cfg(test)]
#[path = "registration_tests.rs"]
mod tests;
