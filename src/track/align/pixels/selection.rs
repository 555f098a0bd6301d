//! Chooses the pixels of a level: those where the reference, seen from the predicted pose, is
//! steepest.
//!
//! Candidates were ranked block by block when the picture was loaded. Each block in view
//! contributes its best ones, so that the pixels are spread over the frame as the stage is. Each
//! candidate is put at its nearest pixel. The choice never depends on the camera's picture: what
//! stands in front of the stage must not choose.

use crate::track::align::tuning::TUNING;
use nalgebra::Vector3;

use super::level_spec::LevelSpec;
use crate::geometry::{Body, Camera, Pose};
use crate::motion::Motion;
use crate::track::align::lanes::resize_with_room;
use crate::track::align::picture::surface::AlignSurface;
use crate::track::align::picture::texture::BLOCK;
use crate::track::frame::rays::RayTable;
use crate::track::frame::tile_grid::Chosen;
use crate::track::scene::rectangle::SeenPoint;

/// Chooses pixels; reuses its buffers.
#[derive(Debug, Default)]
pub struct Selector {
    blocks: Vec<VisibleBlock>,
    /// One bit per pixel of the level: set where it is masked or already chosen.
    taken: Vec<u64>,
    chosen: Vec<Chosen>,
}

/// A block of texels in view, and the affine map of its texels to pixels of the level.
#[derive(Debug, Clone, Copy)]
struct VisibleBlock {
    surface: u32,
    texture_level: u32,
    column: u32,
    row: u32,
    /// Pixel of the block's first texel; then pixels per texel of a column step and of a row step.
    origin: [f32; 2],
    by_column: [f32; 2],
    by_row: [f32; 2],
    /// First and last offsets that stay clear of the surface's border.
    columns: [u8; 2],
    rows: [u8; 2],
}

impl Selector {
    /// Reserves room for all blocks of the surfaces that may come into view at once.
    pub fn with_room_for(surfaces: &[AlignSurface]) -> Self {
        let most = |s: &AlignSurface| s.texture.candidates.iter().map(|c| c.columns * c.rows).max().unwrap_or(0);
        Self { blocks: Vec::with_capacity(surfaces.iter().map(most).sum()), ..Self::default() }
    }

    /// Chooses about `count` different pixels at most.
    pub fn choose(&mut self, spec: &LevelSpec, motion: &Motion) -> &[Chosen] {
        self.choose_by(spec, motion);
        if spec.fills_up && !spec.is_dense && self.chosen.len() < spec.count / 2 {
            self.choose_by(&LevelSpec { is_dense: true, ..*spec }, motion);
        }
        &self.chosen
    }

    fn choose_by(&mut self, spec: &LevelSpec, motion: &Motion) {
        let Self { blocks, taken, chosen } = self;
        chosen.clear();
        blocks.clear();
        for index in (0..spec.surfaces.len()).filter(|k| !spec.surfaces[*k].is_left_out) {
            list_blocks(spec, index, motion, blocks);
        }
        if blocks.is_empty() {
            return;
        }
        let table = spec.rays.table(spec.level);
        taken.clone_from(&table.closed);
        let (mut first, mut count) = (0, 0);
        let mut share = spec.count / blocks.len() + 1;
        // Blocks with little detail leave room, which the others fill in further rounds.
        for _ in 0..3 {
            // Room for all that the blocks may contribute.
            resize_with_room(chosen, count + share * blocks.len(), Chosen::default());
            for block in &*blocks {
                count += take(block, spec.surfaces, first..first + share, table, taken, &mut chosen[count..]);
            }
            first += share;
            let missing = spec.count.saturating_sub(count);
            if missing < spec.count / 8 {
                break;
            }
            share = missing / blocks.len() + 1;
        }
        chosen.truncate(count);
    }

    /// Returns the last choice.
    pub fn chosen(&self) -> &[Chosen] {
        &self.chosen
    }
}

/// Chooses the free pixels of a range of a block's candidates, and returns their number; `chosen`
/// has room for the whole range.
///
/// Whether a pixel is free is unpredictable, and a mispredicted branch costs more than the rest of
/// the loop. So there is none: every pixel is written, and the next one overwrites it if it does
/// not count.
fn take(
    block: &VisibleBlock,
    surfaces: &[AlignSurface],
    range: std::ops::Range<usize>,
    table: &RayTable,
    taken: &mut [u64],
    chosen: &mut [Chosen],
) -> usize {
    let texture = &surfaces[block.surface as usize].texture;
    let offsets = texture.candidates[block.texture_level as usize].of_block(block.column as usize, block.row as usize);
    let (right, bottom) = (table.width as f32, table.height as f32);
    let mut count = 0;
    for &[dx, dy] in &offsets[range.start.min(offsets.len())..range.end.min(offsets.len())] {
        let is_clear = (dx >= block.columns[0]) & (dx <= block.columns[1]) & (dy >= block.rows[0]) & (dy <= block.rows[1]);
        let (fx, fy) = (f32::from(dx), f32::from(dy));
        let u = block.origin[0] + block.by_column[0] * fx + block.by_row[0] * fy + 0.5;
        let v = block.origin[1] + block.by_column[1] * fx + block.by_row[1] * fy + 0.5;
        let is_seen = is_clear & (u >= 0.0) & (v >= 0.0) & (u < right) & (v < bottom);
        let [u, v] = [u, v].map(|at| at as i32 as usize);
        let index = if is_seen { v * table.width + u } else { 0 };
        let (word, bit) = (&mut taken[index / 64], u64::from(is_seen) << (index % 64));
        let is_free = *word & bit != bit;
        *word |= bit;
        chosen[count] = Chosen { surface: block.surface as u16, place: [u as u16, v as u16] };
        count += usize::from(is_free);
    }
    count
}

/// Appends the blocks of a surface that are in view, clear of its border, and not occluded.
fn list_blocks(spec: &LevelSpec, index: usize, motion: &Motion, blocks: &mut Vec<VisibleBlock>) {
    let (surface, table) = (&spec.surfaces[index], spec.rays.table(spec.level));
    let Some(level) = texture_level(surface, motion, spec) else { return };
    let level = if spec.is_dense { level.max(surface.texture.own_level() + 1) - 1 } else { level };
    let texture = &surface.texture;
    let scale = 1.0 / f64::from(surface.texture.scale[level]);
    let [tw, th] = surface.rectangle.texels_per_m();
    let candidates = &texture.candidates[level];
    let half = surface.rectangle.size_m.map(|side| 0.5 * side);
    for row in 0..candidates.rows {
        for column in 0..candidates.columns {
            let middle = |k: usize| ((k as f64 + 0.5) * BLOCK as f64) * scale;
            let (x, y) = (middle(column) / tw - half[0], half[1] - middle(row) / th);
            let Some((seen, camera)) = see(surface, motion, spec, [x, y]) else { continue };
            let (by_x, by_y) = (seen.by_metres.column(0) * (scale / tw), seen.by_metres.column(1) * (-scale / th));
            let centre = 0.5 * (BLOCK as f64 - 1.0);
            let origin = seen.pixel - by_x * centre - by_y * centre;
            let reach = BLOCK as f64 * (by_x.abs() + by_y.abs());
            let outside = seen.pixel.x + reach.x < 0.0
                || seen.pixel.y + reach.y < 0.0
                || seen.pixel.x - reach.x > table.width as f64
                || seen.pixel.y - reach.y > table.height as f64;
            if outside {
                continue;
            }
            // Maximum metres that one pixel covers, along each axis of the surface.
            let Some(inverse) = seen.by_metres.try_inverse() else { continue };
            let margin = [0, 1].map(|k| (TUNING.surface_border_px + 0.5 * spec.blur_px) * (inverse[(k, 0)].abs() + inverse[(k, 1)].abs()));
            let reach_m = [0.5 * BLOCK as f64 * scale / tw, 0.5 * BLOCK as f64 * scale / th];
            if occluded(spec.surfaces, index, &camera, [x, y], [reach_m[0] + margin[0], reach_m[1] + margin[1]]) {
                continue;
            }
            let Some(columns) = clear_offsets(x, half[0] - margin[0], scale / tw) else { continue };
            let Some(rows) = clear_offsets(-y, half[1] - margin[1], scale / th) else { continue };
            blocks.push(VisibleBlock {
                surface: index as u32,
                texture_level: level as u32,
                column: column as u32,
                row: row as u32,
                origin: [origin.x as f32, origin.y as f32],
                by_column: [by_x.x as f32, by_x.y as f32],
                by_row: [by_y.x as f32, by_y.y as f32],
                columns,
                rows,
            });
        }
    }
}

/// Returns the first and last offset in a block centred at `middle` whose texels (of size `step`)
/// stay within +- `limit`.
fn clear_offsets(middle: f64, limit: f64, step: f64) -> Option<[u8; 2]> {
    let centre = 0.5 * (BLOCK as f64 - 1.0);
    let first = (((-limit - middle) / step + centre).ceil()).max(0.0);
    let last = (((limit - middle) / step + centre).floor()).min(BLOCK as f64 - 1.0);
    (first <= last).then_some([first as u8, last as u8])
}

/// Returns the texture level whose texels are nearest in size to a pixel of the level, at the
/// middle of what is seen.
fn texture_level(surface: &AlignSurface, motion: &Motion, spec: &LevelSpec) -> Option<usize> {
    let (own, most) = (surface.texture.own_level(), surface.texture.candidates.len() - 1);
    let table = spec.rays.table(spec.level);
    let size = [table.width as f64, table.height as f64];
    let Some(log2) = surface.rectangle.texels_log2(size, |point| see(surface, motion, spec, point).map(|(seen, _)| seen)) else {
        // The surface is seen in part at most: any visible block will do, at the picture's own
        // level.
        return see(surface, motion, spec, [0.0, 0.0]).map(|_| own);
    };
    Some((log2.round().max(0.0) as usize + own).min(most))
}

/// Returns where a point of a surface is seen in the level at the time of its row, and the camera's
/// centre then (body axes, metres).
fn see(surface: &AlignSurface, motion: &Motion, spec: &LevelSpec, point: [f64; 2]) -> Option<(SeenPoint, Vector3<f64>)> {
    let scale = spec.frame_px();
    let place = surface.at(point);
    let from = |pose: &Pose<Body, Camera>| {
        let seen = surface.rectangle.see_place(pose, spec.rays.camera(), &place, TUNING.min_tilt_cosine)?;
        Some((seen.in_smaller(scale), pose.translation))
    };
    let at_rest = from(&motion.pose)?;
    let tau = spec.shutter.delay_s(spec.frame_y(at_rest.0.pixel.y), spec.rays.camera().height());
    if tau == 0.0 { Some(at_rest) } else { from(&motion.after(tau).pose) }
}

/// Whether another surface of the body hides the middle or a corner of a patch of +- `reach` around
/// a point from the camera.
fn occluded(surfaces: &[AlignSurface], own: usize, camera: &Vector3<f64>, middle: [f64; 2], reach: [f64; 2]) -> bool {
    if surfaces.len() == 1 {
        return false;
    }
    let me = &surfaces[own].rectangle;
    let corners = [(0.0, 0.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)].map(|(sx, sy)| {
        let on_surface = Vector3::new(middle[0] + sx * reach[0], middle[1] + sy * reach[1], 0.0);
        me.rotation * on_surface + me.centre
    });
    let others = surfaces.iter().enumerate().filter(|(k, _)| *k != own);
    others.into_iter().any(|(_, other)| other.rectangle.hides_any(&corners, camera))
}

#[cfg(test)]
mod tests {
    use image::{GrayImage, Luma};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::track::align::CameraRays;
    use crate::track::synthetic::{cloth, lens};

    /// Does the same as [`take`], in plain code.
    fn take_plainly(block: &VisibleBlock, offsets: &[[u8; 2]], table: &RayTable, taken: &mut [u64], chosen: &mut Vec<Chosen>) {
        for [dx, dy] in offsets.iter().copied() {
            let [x, y] = [dx, dy].map(f32::from);
            let [u, v] = [0, 1].map(|axis| block.origin[axis] + block.by_column[axis] * x + block.by_row[axis] * y + 0.5);
            let is_clear = (block.columns[0]..=block.columns[1]).contains(&dx) && (block.rows[0]..=block.rows[1]).contains(&dy);
            if !is_clear || !(0.0..table.width as f32).contains(&u) || !(0.0..table.height as f32).contains(&v) {
                continue;
            }
            let index = v as usize * table.width + u as usize;
            if taken[index / 64] & (1 << (index % 64)) == 0 {
                taken[index / 64] |= 1 << (index % 64);
                chosen.push(Chosen { surface: block.surface as u16, place: [u as u16, v as u16] });
            }
        }
    }

    #[test]
    fn block_selection_matches_the_scalar_twin() {
        let mask = GrayImage::from_fn(640, 480, |x, y| Luma([if (x / 40 + y / 40) % 3 == 0 { 0 } else { 255 }]));
        let rays = CameraRays::new(lens(640, 480), Some(mask));
        let table = rays.table(1);
        let surfaces = [AlignSurface::new(&cloth(1))];
        let mut random = Pcg64Mcg::seed_from_u64(7);
        let (mut taken, mut plainly_taken) = (table.closed.clone(), table.closed.clone());
        let (mut chosen, mut plainly_chosen) = (Vec::new(), Vec::new());
        for _ in 0..2000 {
            let level = surfaces[0].texture.own_level();
            let candidates = &surfaces[0].texture.candidates[level];
            let mut within = |from: f32, to: f32| from + (to - from) * random.random::<f32>();
            let block = VisibleBlock {
                surface: 0,
                texture_level: level as u32,
                column: within(0.0, candidates.columns as f32) as u32,
                row: within(0.0, candidates.rows as f32) as u32,
                // Some lie partly or wholly outside.
                origin: [within(-30.0, 350.0), within(-30.0, 270.0)],
                by_column: [within(-1.0, 1.0), within(-1.0, 1.0)],
                by_row: [within(-1.0, 1.0), within(-1.0, 1.0)],
                columns: [within(0.0, 8.0) as u8, within(8.0, 16.0) as u8],
                rows: [0, 15],
            };
            let first = within(0.0, 30.0) as usize;
            let range = first..first + 12;
            let offsets = candidates.of_block(block.column as usize, block.row as usize);
            let own = &offsets[range.start.min(offsets.len())..range.end.min(offsets.len())];
            take_plainly(&block, own, table, &mut plainly_taken, &mut plainly_chosen);
            let count = chosen.len();
            chosen.resize(count + range.len(), Chosen::default());
            let free = take(&block, &surfaces, range, table, &mut taken, &mut chosen[count..]);
            chosen.truncate(count + free);
        }
        assert!(plainly_chosen.len() > 3000, "{}", plainly_chosen.len());
        assert!(chosen == plainly_chosen && taken == plainly_taken);
    }
}
