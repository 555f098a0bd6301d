//! Renders what a camera should see of surfaces whose poses are known, at one level of the frame:
//! the grey value of the nearest surface, and which surface it is.
//!
//! It is rendered in every frame in which a body is missing, so it is fast: it computes places on
//! the picture for a row of pixels at once, then samples each that lies on the picture. Used by
//! `unexplained`.

use nalgebra::Matrix3;

use crate::geometry::{Body, Camera, Pose};
use crate::simd::multiversion;
use crate::track::align::CameraRays;
use crate::track::scene::averaged_picture::AveragedPicture;
use crate::track::scene::bilinear::RowOfTexels;
use crate::track::scene::reference::PreparedSurface;

/// Every `ROW_STEP`th row of the level is rendered. Raised, small props have too few pixels;
/// lowered, the cost doubles for no gain.
pub const ROW_STEP: usize = 2;

/// A picture of what should be seen; keeps its buffers between frames.
#[derive(Debug, Default)]
pub struct ExpectedView {
    /// Level of the frame.
    level: usize,
    /// Columns, and rendered rows: the first and every [`ROW_STEP`]th after it.
    size: [usize; 2],
    /// Depth of the nearest surface; infinite where none should be seen.
    depth: Vec<f32>,
    grey: Vec<f32>,
    owners: Vec<u16>,
    drawn: u16,
    /// By the numbers of the surfaces.
    averaged: Vec<AveragedPicture>,
    /// For a row: depths, x and y on the picture, and grey values there.
    row: [Vec<f32>; 4],
    texels: RowOfTexels,
}

impl ExpectedView {
    /// Clears the picture for a level of the frame.
    pub fn clear(&mut self, rays: &CameraRays, level: usize) {
        let table = rays.table(level);
        (self.level, self.size, self.drawn) = (level, [table.width, table.height.div_ceil(ROW_STEP)], 0);
        let pixels = self.size[0] * self.size[1];
        self.depth.clear();
        self.depth.resize(pixels, f32::INFINITY);
        // The grey value is arbitrary where no surface is.
        self.grey.resize(pixels, 0.0);
        self.owners.clear();
        self.owners.resize(pixels, 0);
        self.row.iter_mut().for_each(|values| values.resize(table.width, 0.0));
        self.texels.make_room(table.width);
    }

    /// Returns the columns and the rendered rows.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// Returns the expected grey values, pixel by pixel; arbitrary where no surface is.
    pub fn grey(&self) -> &[f32] {
        &self.grey
    }

    /// Returns the number of the expected surface per pixel, from 1 in the order in which they were
    /// drawn; 0 where none is.
    pub fn owners(&self) -> &[u16] {
        &self.owners
    }

    /// Draws a surface as the camera should see it; the nearest surface wins. A bent one is drawn
    /// as its plane: folds are small at this size. `number`: its number among all surfaces, the
    /// same in every frame.
    pub fn draw(&mut self, number: usize, surface: &PreparedSurface, t_body_camera: &Pose<Body, Camera>, rays: &CameraRays) {
        self.drawn += 1;
        let rectangle = &surface.rectangle;
        let to_surface = rectangle.rotation.transpose();
        let rotation: Matrix3<f32> = (to_surface * t_body_camera.rotation_matrix()).cast();
        let from = (to_surface * (t_body_camera.translation - rectangle.centre)).cast::<f32>();
        // A surface seen from behind is not drawn.
        if from.z <= 0.0 {
            return;
        }
        let table = rays.table(self.level);
        let size = [table.width, table.height];
        let Some([columns, rows]) = extent(surface, t_body_camera, rays, self.level, size) else { return };
        let scale = f64::from(1u32 << self.level);
        let see = |place| rectangle.see(t_body_camera, rays.camera(), place, 0.0).map(|seen| seen.in_smaller(scale));
        let texels = rectangle.texels_log2(size.map(|n| n as f64), see).unwrap_or(0.0);
        if self.averaged.len() <= number {
            self.averaged.resize_with(number + 1, AveragedPicture::default);
        }
        let image = self.averaged[number].over(&surface.octaves, texels, surface.spec.transfer);
        let (raw, size) = (image.as_raw(), [image.width() as usize, image.height() as usize]);
        let texels_per_m = [0, 1].map(|k| size[k] as f32 / rectangle.size_m[k] as f32);
        let plane = Plane {
            rotation: std::array::from_fn(|k| rotation[(k / 3, k % 3)]),
            from: from.into(),
            texels_per_m: [texels_per_m[0], -texels_per_m[1]],
            centre: size.map(|n| 0.5 * n as f32 - 0.5),
        };
        let last = size.map(|n| n as f32 - 0.5);
        for row in rows.start.div_ceil(ROW_STEP)..rows.end.div_ceil(ROW_STEP) {
            let [pixels, seen_along] = [row, row * ROW_STEP].map(|v| {
                let first = v * table.width + columns.start;
                first..first + columns.len()
            });
            let [depths, xs, ys, greys] = self.row.each_mut().map(|values| &mut values[..columns.len()]);
            see_row(&table.rays[seen_along], &plane, depths, xs, ys);
            self.texels.look(raw, size, xs, ys, greys);
            let seen = Seen { depths, xs, ys, greys, last, owner: self.drawn };
            keep_nearest(&seen, &mut self.depth[pixels.clone()], &mut self.grey[pixels.clone()], &mut self.owners[pixels]);
        }
    }
}

/// A surface's plane in the camera's view.
struct Plane {
    /// Rotation from the camera's axes to the surface's, row by row.
    rotation: [f32; 9],
    /// The camera's position relative to the surface's centre, metres, surface axes.
    from: [f32; 3],
    /// Texels of the picture per metre; negative for y, which points down there.
    texels_per_m: [f32; 2],
    /// The texel at the surface's centre.
    centre: [f32; 2],
}

multiversion! {
    /// Computes the depth of the plane along rays, and the texels that they hit.
    fn see_row(rays: &[[f32; 2]], plane: &Plane, depths: &mut [f32], xs: &mut [f32], ys: &mut [f32]); ["avx2"] => see_row_plain, else see_row_plain
}

#[inline(always)]
fn see_row_plain(rays: &[[f32; 2]], plane: &Plane, depths: &mut [f32], xs: &mut [f32], ys: &mut [f32]) {
    let Plane { rotation: t, from, texels_per_m, centre } = plane;
    let out = depths.iter_mut().zip(xs).zip(ys);
    for ([x, y], ((depth, u), v)) in rays.iter().zip(out) {
        let along = |row: usize| t[3 * row] * x + t[3 * row + 1] * y + t[3 * row + 2];
        *depth = -from[2] / along(2);
        *u = centre[0] + (from[0] + *depth * along(0)) * texels_per_m[0];
        *v = centre[1] + (from[1] + *depth * along(1)) * texels_per_m[1];
    }
}

/// What a row of pixels may show of a surface.
struct Seen<'a> {
    depths: &'a [f32],
    /// Places on its picture.
    xs: &'a [f32],
    ys: &'a [f32],
    greys: &'a [f32],
    /// The last place on its picture, across and down.
    last: [f32; 2],
    owner: u16,
}

multiversion! {
    /// Keeps whatever is nearer than what was drawn before.
    fn keep_nearest(seen: &Seen, depths: &mut [f32], greys: &mut [f32], owners: &mut [u16]); ["avx2"] => keep_nearest_plain, else keep_nearest_plain
}

#[inline(always)]
fn keep_nearest_plain(seen: &Seen, depths: &mut [f32], greys: &mut [f32], owners: &mut [u16]) {
    let n = depths.len();
    let Seen { owner, last: [last_x, last_y], .. } = *seen;
    let (depth, x, y, grey) = (&seen.depths[..n], &seen.xs[..n], &seen.ys[..n], &seen.greys[..n]);
    let (greys, owners) = (&mut greys[..n], &mut owners[..n]);
    for k in 0..n {
        // NaN where the lens has no ray; negative depth behind the camera.
        let is_in = (x[k] >= -0.5) & (x[k] <= last_x) & (y[k] >= -0.5) & (y[k] <= last_y);
        let is_nearer = is_in & (depth[k] > 0.0) & (depth[k] < depths[k]);
        // Writes every element unconditionally, so that the compiler vectorises the loop.
        greys[k] = if is_nearer { grey[k] } else { greys[k] };
        owners[k] = if is_nearer { owner } else { owners[k] };
        depths[k] = if is_nearer { depth[k] } else { depths[k] };
    }
}

/// Returns the columns and rows of the level that a surface may cover: all of them if a corner is
/// behind the camera or beyond the lens; `None` if it lies outside.
fn extent(
    surface: &PreparedSurface,
    t_body_camera: &Pose<Body, Camera>,
    rays: &CameraRays,
    level: usize,
    size: [usize; 2],
) -> Option<[std::ops::Range<usize>; 2]> {
    let [x, y] = surface.rectangle.size_m.map(|m| 0.5 * m);
    let corner = |place| surface.rectangle.see(t_body_camera, rays.camera(), place, 0.0);
    // Includes the middles of the sides: a lens may bend them outwards.
    let places = [[-x, -y], [0.0, -y], [x, -y], [x, 0.0], [x, y], [0.0, y], [-x, y], [-x, 0.0]];
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for place in places {
        let Some(seen) = corner(place) else { return Some(size.map(|n| 0..n)) };
        for k in 0..2 {
            low[k] = low[k].min(seen.pixel[k]);
            high[k] = high[k].max(seen.pixel[k]);
        }
    }
    let scale = f64::from(1u32 << level);
    let range = |k: usize| {
        // Two pixels of margin, and a hundredth of the extent for what the lens bends between the
        // points.
        let more = 2.0 + 0.01 * (high[k] - low[k]) / scale;
        let at = |v: f64| v.clamp(0.0, size[k] as f64) as usize;
        at(low[k] / scale - more)..at(high[k] / scale + more)
    };
    let both = [range(0), range(1)];
    both.iter().all(|r| !r.is_empty()).then_some(both)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::track::synthetic::{cloth, facing, lens, prepared, view};

    #[test]
    fn a_cloth_is_drawn_as_the_camera_sees_it() {
        let (size, level, pose) = ([640, 480], 2, facing(0.2, -0.3, Vector3::new(0.1, 0.05, 3.4)));
        let (rays, body) = (CameraRays::new(lens(size[0], size[1]), None), prepared(vec![cloth(1)]));
        let mut expected = ExpectedView::default();
        expected.clear(&rays, level);
        expected.draw(0, &body.surfaces[0], &pose.inverse(), &rays);
        let seen = view(&cloth(1), &pose, &lens(size[0], size[1]));
        let mean = |u: u32, v: u32| (0..16).map(|k| f32::from(seen.get_pixel(4 * u + k % 4, 4 * v + k / 4)[0])).sum::<f32>() / 16.0;
        let (mut squared, mut count) = (0.0, 0.0);
        for (k, owner) in expected.owners().iter().enumerate() {
            let (u, v) = (k % expected.size()[0], k / expected.size()[0] * ROW_STEP);
            let is_inside = expected.owners().get(k + 1) == Some(&1) && k > 0 && expected.owners()[k - 1] == 1;
            if *owner == 1 && is_inside {
                squared += (expected.grey()[k] - mean(u as u32, v as u32)).powi(2);
                count += 1.0;
            }
        }
        assert!(count > 2500.0 && (squared / count).sqrt() < 12.0, "{count} pixels, off by {}", (squared / count).sqrt());
    }

    #[test]
    fn the_back_of_a_cloth_is_not_drawn() {
        let rays = CameraRays::new(lens(640, 480), None);
        let body = prepared(vec![cloth(1)]);
        let behind = facing(0.2 + std::f64::consts::PI, -0.3, Vector3::new(0.1, 0.05, 3.4));
        let mut expected = ExpectedView::default();
        expected.clear(&rays, 2);
        expected.draw(0, &body.surfaces[0], &behind.inverse(), &rays);
        assert!(expected.owners().iter().all(|owner| *owner == 0));
    }
}
