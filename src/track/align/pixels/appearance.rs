//! Predicts what the camera should see at each chosen pixel, and how that changes with its pose.
//! This is the kernel in which alignment spends most of its time.
//!
//! A pixel's ray meets its surface at a texel, and the pixel's square covers a small quadrilateral
//! of texels there. Five by five samples (three by three above the finest level), from the copy of
//! the picture whose texels are a seventh of a pixel wide, yield the mean light over that square,
//! its gradient, and, by the curvature of the best-fitting parabola, its change with a wider point
//! spread. (Fewer samples or larger texels leave errors of a grey level and more, which bias the
//! pose of a still camera by more than its noise; measured in docs/alignment.md.) While the shutter
//! is open the texel moves along a short curve; under motion blur the samples are distributed along
//! it.

use super::level_spec::LevelSpec;
use super::runs::Pixels;
use super::touching_planes::MapLanes;
use crate::light::transfer::FULL;
use crate::motion::Motion;
use crate::track::align::lanes::{LANES, Lanes, TILE_COLUMNS, Tile, dispatch, load_at, resize_with_room, store_at};
use crate::track::align::picture::sight::{Sight, SightPath};
use crate::track::align::picture::surface::AlignSurface;
use crate::track::align::picture::texture::TILE_STEP;
use crate::track::align::tuning::TUNING;
use crate::track::scene::rectangle::Rectangle;

/// Unit of the point spread: variance that it adds across and down, pixels². Estimates and sigmas
/// of the point spread are multiples of it.
const PSF_VARIANCE_UNIT: f32 = 1.0 / 12.0;

/// The prediction at each pixel, in the order of [`Pixels`]. Light is that of the
/// reference, up to 255, before the gain.
#[derive(Debug, Default)]
pub struct Appearance {
    /// Light of the reference.
    pub intensity: Vec<f32>,
    /// Derivative of light by the variance of the point spread, per unit of a twelfth of a square
    /// pixel.
    pub psf_variance: Vec<f32>,
    /// Light without motion blur minus light with it.
    pub sharper: Vec<f32>,
    /// Derivative of light by the camera's position (3, body axes, per metre) and rotation (3,
    /// camera axes, per radian).
    pub by_pose: [Vec<f32>; 6],
    /// Derivative of light across, per pixel of the level.
    pub across: Vec<f32>,
    /// Derivative of light down, per pixel of the level.
    pub down: Vec<f32>,
    /// Derivative of light by the camera's velocity and angular velocity about the instant of the
    /// pixel's row (axes as in `by_pose`, per m/s and rad/s): only the effect through motion blur.
    /// Only [`predict_by_velocity`] fills it.
    pub by_velocity: [Vec<f32>; 6],
}

impl Appearance {
    /// Makes room for `n` pixels, a whole number of lanes.
    pub fn resize(&mut self, n: usize) {
        let by_pose = self.by_pose.iter_mut();
        for v in by_pose.chain([&mut self.intensity, &mut self.psf_variance, &mut self.sharper, &mut self.across, &mut self.down]) {
            resize_with_room(v, n, 0.0);
        }
    }

    /// Makes room for `by_velocity`, for as many pixels as the other lists have.
    pub fn make_room_for_velocity(&mut self) {
        let n = self.intensity.len();
        self.by_velocity.iter_mut().for_each(|v| resize_with_room(v, n, 0.0));
    }
}

/// A surface as one frame sees it, in `f32` as the kernel needs it.
struct View {
    path: SightPath,
    /// Rotation from surface axes to body axes, row-major.
    to_body: [f32; 9],
    texels_per_m: [f32; 2],
    middle_texel: [f32; 2],
    first_level: f32,
    last_level: f32,
    /// Texture level, as a real number, that suits a pixel which covers one pixel of the picture.
    level_offset: f32,
    /// Half of the exposure, seconds; 0 where blur is not predicted.
    half_exposure_s: f32,
    /// Samples across a sharp pixel.
    side: usize,
    /// See [`LevelSpec::gradient_gain`].
    gradient_gain: f32,
}

impl View {
    fn new(what: &Predicted) -> Self {
        let Predicted { surface, motion, spec, .. } = *what;
        let exposure_s = if spec.places > 1 { spec.shutter.exposure_s } else { 0.0 };
        let Rectangle { rotation, size_px: [w, h], .. } = &surface.rectangle;
        let is_tilted = (rotation.transpose() * motion.pose.rotation_matrix())[(2, 2)].abs() < TUNING.tilted_cosine;
        let texel_log2 = match (exposure_s > 0.0, is_tilted) {
            (true, _) => TUNING.blurred_texel_log2,
            (false, false) => TUNING.sharp_texel_log2,
            (false, true) => TUNING.tilted_texel_log2,
        };
        Self {
            side: if is_tilted { TUNING.tilted_samples_across.max(spec.side) } else { spec.side },
            path: SightPath::new(&surface.rectangle, motion),
            to_body: std::array::from_fn(|k| rotation[(k / 3, k % 3)] as f32),
            texels_per_m: surface.rectangle.texels_per_m().map(|texels| texels as f32),
            middle_texel: [(0.5 * w - 0.5) as f32, (0.5 * h - 0.5) as f32],
            first_level: if spec.is_enlarged { 0.0 } else { surface.texture.own_level() as f32 },
            last_level: surface.texture.levels as f32 - 0.999,
            level_offset: surface.texture.own_level() as f32 + texel_log2,
            half_exposure_s: (0.5 * exposure_s) as f32,
            gradient_gain: spec.gradient_gain,
        }
    }
}

/// Which pixels to predict, and how.
#[derive(Clone, Copy)]
pub struct Predicted<'a> {
    /// The surface that they lie on.
    pub surface: &'a AlignSurface,
    /// The camera's motion.
    pub motion: &'a Motion,
    /// The task of the level.
    pub spec: &'a LevelSpec<'a>,
    /// The pixels of the level.
    pub pixels: &'a Pixels,
    /// First of these, and one past the last: whole lanes.
    pub range: [usize; 2],
}

dispatch! {
    /// Predicts the pixels of one surface.
    predict, predict_lanes, (what: &Predicted, out: &mut Appearance)
}

dispatch! {
    /// Predicts the pixels of one surface, and their derivatives by the velocity that blurs them,
    /// for which there must be room.
    predict_by_velocity, predict_by_velocity_lanes, (what: &Predicted, out: &mut Appearance)
}

/// Where a ray meets the surface, and how that point moves with the ray.
#[derive(Clone, Copy)]
struct Hit<L> {
    texel: [L; 2],
    /// Ray in surface axes, divided by its depth component.
    slope: [L; 2],
    depth: L,
}

/// Returns the camera's pose at `t` in the frame of the surface or, with a map, in the frames of
/// the planes that touch it.
#[inline(always)]
fn sight_at<L: Lanes>(view: &View, t: L, map: Option<&MapLanes<L>>) -> Sight<L> {
    let sight = view.path.at(t);
    match map {
        Some(map) => map.sight(&sight),
        None => sight,
    }
}

#[inline(always)]
fn hit<L: Lanes>(view: &View, sight: &Sight<L>, x: L, y: L) -> Hit<L> {
    let (centre, direction) = (&sight.centre, sight.direction(x, y));
    let inverse = L::splat(1.0).div(direction[2]);
    let depth = L::splat(0.0).sub(centre[2]).mul(inverse);
    let px = depth.mul_add(direction[0], centre[0]);
    let py = depth.mul_add(direction[1], centre[1]);
    Hit {
        texel: [
            px.mul_add(L::splat(view.texels_per_m[0]), L::splat(view.middle_texel[0])),
            py.mul_add(L::splat(-view.texels_per_m[1]), L::splat(view.middle_texel[1])),
        ],
        slope: [direction[0].mul(inverse), direction[1].mul(inverse)],
        depth,
    }
}

/// A level of the texture, one for each lane.
struct LevelLanes<L: Lanes> {
    scale: L,
    last_column: L,
    last_row: L,
    stride: L::Index,
    base: L::Index,
}

/// Returns the copy of the picture whose texels are nearest in size to what suits a sample.
#[inline(always)]
fn level_for<L: Lanes>(surface: &AlignSurface, view: &View, by_pixel: &[L; 4]) -> LevelLanes<L> {
    let area = by_pixel[0].mul(by_pixel[3]).sub(by_pixel[1].mul(by_pixel[2]));
    let area = area.max(L::splat(0.0).sub(area)).max(L::splat(1e-9));
    // One half more, so that truncation rounds to nearest.
    let level = area.rough_log2().mul_add(L::splat(0.5), L::splat(view.level_offset + 0.5));
    let l = level.max(L::splat(view.first_level)).min(L::splat(view.last_level)).to_index();
    let t = &surface.texture;
    LevelLanes {
        scale: L::lookup(&t.scale, l),
        last_column: L::lookup(&t.last_column, l),
        last_row: L::lookup(&t.last_row, l),
        stride: L::lookup_index(&t.stride, l),
        base: L::lookup_index(&t.base, l),
    }
}

/// Returns the address of the texel above and left of picture pixel (u, v), and the offset from
/// that texel, texels.
#[inline(always)]
fn address<L: Lanes>(level: &LevelLanes<L>, u: L, v: L) -> (L::Index, [L; 2]) {
    let (half, zero) = (L::splat(0.5), L::splat(0.0));
    let u = u.add(half).mul_add(level.scale, L::splat(-0.5)).max(zero).min(level.last_column);
    let v = v.add(half).mul_add(level.scale, L::splat(-0.5)).max(zero).min(level.last_row);
    let (i, j) = (u.floor(), v.floor());
    let step = TILE_STEP.map(|step| 1.0 / step as f32);
    // Half a texel more keeps whole numbers clear of the rounding error of the division.
    let column = i.mul_add(L::splat(step[0]), L::splat(0.5 * step[0])).floor();
    let row = j.mul_add(L::splat(step[1]), L::splat(0.5 * step[1])).floor();
    let in_row = column.mul_add(L::splat((size_of::<Tile>() - TILE_STEP[0]) as f32), j.mul_add(L::splat(TILE_COLUMNS as f32), i));
    (L::address(row.to_index(), level.stride, in_row.to_index(), level.base), [u.sub(i), v.sub(j)])
}

/// Returns 255 times the light at picture pixel (u, v), interpolated linearly.
#[inline(always)]
fn sample<L: Lanes>(tiles: &[Tile], level: &LevelLanes<L>, u: L, v: L) -> L {
    let (address, [a, b]) = address(level, u, v);
    let [q00, q10, q01, q11] = L::gather_squares(tiles, address);
    let upper = q10.sub(q00).mul_add(a, q00);
    let lower = q11.sub(q01).mul_add(a, q01);
    lower.sub(upper).mul_add(b, upper)
}

/// Prefetches the tiles that the samples at later pixels will need: the middles and corners of
/// squares like `by_pixel`.
#[inline(always)]
fn prefetch<L: Lanes>(tiles: &[Tile], level: &LevelLanes<L>, middle: [L; 2], by_pixel: &[L; 4]) {
    for [x, y] in [[0.0, 0.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]] {
        let [x, y] = [L::splat(TUNING.prefetch_reach_px * x), L::splat(TUNING.prefetch_reach_px * y)];
        let u = by_pixel[0].mul_add(x, by_pixel[1].mul_add(y, middle[0]));
        let v = by_pixel[2].mul_add(x, by_pixel[3].mul_add(y, middle[1]));
        L::prefetch_quads(tiles, address(level, u, v).0);
    }
}

/// Returns the derivative of picture pixels by pixels of the level: [uu, uv, vu, vv].
#[inline(always)]
fn footprint<L: Lanes>(view: &View, a: &[L; 9], middle: &Hit<L>, pixels: &Pixels, k: usize) -> [L; 4] {
    let across = L::splat(view.texels_per_m[0]).mul(middle.depth);
    let down = L::splat(-view.texels_per_m[1]).mul(middle.depth);
    let ux = a[0].sub(a[6].mul(middle.slope[0])).mul(across);
    let uy = a[1].sub(a[7].mul(middle.slope[0])).mul(across);
    let vx = a[3].sub(a[6].mul(middle.slope[1])).mul(down);
    let vy = a[4].sub(a[7].mul(middle.slope[1])).mul(down);
    let (xu, xv) = (load_at::<L>(&pixels.x_across, k), load_at::<L>(&pixels.x_down, k));
    let (yu, yv) = (load_at::<L>(&pixels.y_across, k), load_at::<L>(&pixels.y_down, k));
    [ux.mul_add(xu, uy.mul(yu)), ux.mul_add(xv, uy.mul(yv)), vx.mul_add(xu, vy.mul(yu)), vx.mul_add(xv, vy.mul(yv))]
}

/// The results of a pixel's samples. Gradients are slopes fitted over all samples: gradients inside
/// single texels vary from texel to texel, and their scatter would pass for information.
struct Sampled<L> {
    intensity: L,
    psf_variance: L,
    sharper: L,
    /// Derivative of light by pixels of the level.
    across: L,
    down: L,
    /// Means of the gradient times the instant of its place, in halves of the exposure. Not
    /// computed where unused, because all this is inlined into its caller.
    by_instant: [L; 2],
}

/// Takes `side` x `side` samples at a sharp pixel.
#[inline(always)]
fn sharp_samples<L: Lanes>(tiles: &[Tile], level: &LevelLanes<L>, middle: [L; 2], by_pixel: &[L; 4], side: usize) -> Sampled<L> {
    let zero = L::splat(0.0);
    let (mut sum, mut across, mut down, mut squared) = (zero, zero, zero, zero);
    let n = side as f32;
    // Mean and variance of the squared offsets.
    let (mut mean, mut variance) = (0.0, 0.0);
    for j in 0..side {
        let y = (j as f32 + 0.5) / n - 0.5;
        let (u, v) = (by_pixel[1].mul_add(L::splat(y), middle[0]), by_pixel[3].mul_add(L::splat(y), middle[1]));
        let mut row = zero;
        for i in 0..side {
            let x = (i as f32 + 0.5) / n - 0.5;
            let intensity = sample(tiles, level, by_pixel[0].mul_add(L::splat(x), u), by_pixel[2].mul_add(L::splat(x), v));
            row = row.add(intensity);
            across = intensity.mul_add(L::splat(x), across);
            squared = intensity.mul_add(L::splat(x * x), squared);
        }
        sum = sum.add(row);
        down = row.mul_add(L::splat(y), down);
        squared = row.mul_add(L::splat(y * y), squared);
        mean += y * y / n;
        variance += y.powi(4) / n;
    }
    variance -= mean * mean;
    let samples = n * n;
    let intensity = sum.mul(L::splat(1.0 / samples));
    let slope = L::splat(1.0 / (samples * mean));
    // Curvature of the best-fitting parabola: a wider point spread adds half of it per variance.
    let curved = squared.sub(sum.mul(L::splat(2.0 * mean)));
    Sampled {
        intensity,
        psf_variance: curved.mul(L::splat(PSF_VARIANCE_UNIT / (samples * variance))),
        sharper: zero,
        across: across.mul(slope),
        down: down.mul(slope),
        by_instant: [zero; 2],
    }
}

/// The path of a pixel's middle over the picture while the shutter is open, a parabola in time.
#[derive(Clone, Copy)]
struct BlurPath<L> {
    middle: [L; 2],
    slope: [L; 2],
    bend: [L; 2],
}

impl<L: Lanes> BlurPath<L> {
    #[inline(always)]
    fn through(first: [L; 2], middle: [L; 2], last: [L; 2]) -> Self {
        let half = L::splat(0.5);
        Self {
            middle,
            slope: [last[0].sub(first[0]).mul(half), last[1].sub(first[1]).mul(half)],
            bend: [first[0].add(last[0]).mul(half).sub(middle[0]), first[1].add(last[1]).mul(half).sub(middle[1])],
        }
    }

    /// Returns the `n`th of several places along the path.
    #[inline(always)]
    fn place(&self, n: usize, places: usize) -> [L; 2] {
        let e = L::splat(instant(n, places));
        [
            self.bend[0].mul_add(e, self.slope[0]).mul_add(e, self.middle[0]),
            self.bend[1].mul_add(e, self.slope[1]).mul_add(e, self.middle[1]),
        ]
    }
}

/// Returns the instant of the `n`th of several places along a blur, in halves of the exposure from
/// its middle. Their spacing gives them the variance of the whole path: a third.
fn instant(n: usize, places: usize) -> f32 {
    (2.0 * n as f32 + 1.0 - places as f32) / ((places * places - 1) as f32).sqrt()
}

/// Takes samples at `places` (odd, at least 3) along the blur: nine or five at each where these are
/// few, else three.
#[inline(always)]
fn blurred_samples<L: Lanes>(tiles: &[Tile], level: &LevelLanes<L>, way: &BlurPath<L>, by_pixel: &[L; 4], places: usize) -> Sampled<L> {
    if places > TUNING.max_places_with_five_samples {
        return diagonal_samples(tiles, level, way, by_pixel, places);
    }
    let zero = L::splat(0.0);
    let mut unblurred = zero;
    let mut mean = Sampled { intensity: zero, psf_variance: zero, sharper: zero, across: zero, down: zero, by_instant: [zero; 2] };
    let share = L::splat(1.0 / places as f32);
    for n in 0..places {
        let at = way.place(n, places);
        let sampled = if places > TUNING.max_places_with_nine_samples {
            five_samples(tiles, level, at, by_pixel)
        } else {
            sharp_samples(tiles, level, at, by_pixel, 3)
        };
        mean.intensity = sampled.intensity.mul_add(share, mean.intensity);
        mean.psf_variance = sampled.psf_variance.mul_add(share, mean.psf_variance);
        mean.across = sampled.across.mul_add(share, mean.across);
        mean.down = sampled.down.mul_add(share, mean.down);
        let timed = L::splat(instant(n, places) / places as f32);
        mean.by_instant = [sampled.across.mul_add(timed, mean.by_instant[0]), sampled.down.mul_add(timed, mean.by_instant[1])];
        if 2 * n + 1 == places {
            unblurred = sampled.intensity;
        }
    }
    mean.sharper = unblurred.sub(mean.intensity);
    mean
}

/// Takes one sample at the middle of a pixel and four towards its corners.
#[inline(always)]
fn five_samples<L: Lanes>(tiles: &[Tile], level: &LevelLanes<L>, [u, v]: [L; 2], by_pixel: &[L; 4]) -> Sampled<L> {
    let step = L::splat(TUNING.corner_sample_px);
    let falling = [by_pixel[0].add(by_pixel[1]).mul(step), by_pixel[2].add(by_pixel[3]).mul(step)];
    let rising = [by_pixel[0].sub(by_pixel[1]).mul(step), by_pixel[2].sub(by_pixel[3]).mul(step)];
    let centre = sample(tiles, level, u, v);
    let right_below = sample(tiles, level, u.add(falling[0]), v.add(falling[1]));
    let left_above = sample(tiles, level, u.sub(falling[0]), v.sub(falling[1]));
    let right_above = sample(tiles, level, u.add(rising[0]), v.add(rising[1]));
    let left_below = sample(tiles, level, u.sub(rising[0]), v.sub(rising[1]));
    let corners = right_below.add(left_above).add(right_above.add(left_below));
    let intensity = corners.add(centre).mul(L::splat(0.2));
    let (along_falling, along_rising) = (right_below.sub(left_above), right_above.sub(left_below));
    let slope = L::splat(0.25 / TUNING.corner_sample_px);
    Sampled {
        intensity,
        psf_variance: corners
            .mul(L::splat(0.25))
            .sub(centre)
            .mul(L::splat(PSF_VARIANCE_UNIT / (TUNING.corner_sample_px * TUNING.corner_sample_px))),
        sharper: L::splat(0.0),
        across: along_falling.add(along_rising).mul(slope),
        down: along_falling.sub(along_rising).mul(slope),
        by_instant: [L::splat(0.0); 2],
    }
}

/// Takes three samples at each of `places`, on alternating diagonals.
#[inline(always)]
fn diagonal_samples<L: Lanes>(tiles: &[Tile], level: &LevelLanes<L>, way: &BlurPath<L>, by_pixel: &[L; 4], places: usize) -> Sampled<L> {
    let step = L::splat(TUNING.diagonal_sample_px);
    let diagonals = [
        [by_pixel[0].add(by_pixel[1]).mul(step), by_pixel[2].add(by_pixel[3]).mul(step)],
        [by_pixel[0].sub(by_pixel[1]).mul(step), by_pixel[2].sub(by_pixel[3]).mul(step)],
    ];
    let zero = L::splat(0.0);
    let (mut outer, mut middles, mut unblurred) = (zero, zero, zero);
    let mut differences = [zero; 2];
    // Differences times their instants, and the squares of the instants, of each diagonal.
    let (mut by_instant, mut squared_instants) = ([zero; 2], [0.0; 2]);
    for n in 0..places {
        let [u, v] = way.place(n, places);
        let [du, dv] = diagonals[n % 2];
        let centre = sample(tiles, level, u, v);
        let (ahead, behind) = (sample(tiles, level, u.add(du), v.add(dv)), sample(tiles, level, u.sub(du), v.sub(dv)));
        middles = middles.add(centre);
        outer = outer.add(ahead.add(behind));
        differences[n % 2] = differences[n % 2].add(ahead.sub(behind));
        let e = instant(n, places);
        by_instant[n % 2] = ahead.sub(behind).mul_add(L::splat(e), by_instant[n % 2]);
        squared_instants[n % 2] += e * e;
        if 2 * n + 1 == places {
            unblurred = centre;
        }
    }
    let intensity = outer.add(middles).mul(L::splat(1.0 / (3.0 * places as f32)));
    let middles = middles.mul(L::splat(1.0 / places as f32));
    // From slopes along both diagonals: half the sum is across, half the difference is down.
    let [falling, rising] = [differences[0], differences[1]];
    let falling = falling.mul(L::splat(0.25 / (TUNING.diagonal_sample_px * places.div_ceil(2) as f32)));
    let rising = rising.mul(L::splat(0.25 / (TUNING.diagonal_sample_px * (places / 2) as f32)));
    // Each diagonal has every other place. The line fitted through its differences yields the mean
    // over all places, because the instants have a variance of a third.
    let [falling_by_instant, rising_by_instant] = std::array::from_fn(|d| {
        by_instant[d].mul(L::splat(0.25 / (3.0 * TUNING.diagonal_sample_px * squared_instants[d].max(f32::MIN_POSITIVE))))
    });
    Sampled {
        intensity,
        psf_variance: intensity
            .sub(middles)
            .mul(L::splat(1.5 * PSF_VARIANCE_UNIT / (TUNING.diagonal_sample_px * TUNING.diagonal_sample_px))),
        // From middle samples only: the outer ones alternate between diagonals.
        sharper: unblurred.sub(middles),
        across: falling.add(rising),
        down: falling.sub(rising),
        by_instant: [falling_by_instant.add(rising_by_instant), falling_by_instant.sub(rising_by_instant)],
    }
}

/// Does the work of [`predict`], for one type of lanes.
#[inline(always)]
pub fn predict_lanes<L: Lanes>(what: &Predicted, out: &mut Appearance) {
    predict_surface::<L, false>(what, out);
}

/// Does the work of [`predict_by_velocity`], for one type of lanes.
#[inline(always)]
pub fn predict_by_velocity_lanes<L: Lanes>(what: &Predicted, out: &mut Appearance) {
    predict_surface::<L, true>(what, out);
}

#[inline(always)]
fn predict_surface<L: Lanes, const BY_VELOCITY: bool>(what: &Predicted, out: &mut Appearance) {
    // Compiled separately, so that a flat surface does not pay for a bent one.
    if what.surface.rectangle.shape.is_flat() || what.pixels.planes.is_empty() {
        predict_pixels::<L, false, BY_VELOCITY>(what, out);
    } else {
        predict_pixels::<L, true, BY_VELOCITY>(what, out);
    }
}

#[inline(always)]
fn predict_pixels<L: Lanes, const IS_BENT: bool, const BY_VELOCITY: bool>(what: &Predicted, out: &mut Appearance) {
    let Predicted { surface, spec, pixels, range, .. } = *what;
    let view = &View::new(what);
    let tiles = &surface.texture.tiles[..];
    let mut k = range[0];
    while k < range[1] {
        let (x, y, t) = (load_at::<L>(&pixels.x, k), load_at::<L>(&pixels.y, k), load_at::<L>(&pixels.delay_s, k));
        let map = if IS_BENT { Some(pixels.planes.load::<L>(k)) } else { None };
        let sight = sight_at(view, t, map.as_ref());
        let middle = hit(view, &sight, x, y);
        let by_pixel = footprint(view, &sight.rotation, &middle, pixels, k);
        let level = level_for(surface, view, &by_pixel);
        let ahead = k + TUNING.prefetch_groups * LANES;
        if ahead < range[1] {
            // The plane of the surface is accurate enough to prefetch by.
            let later = view.path.at(load_at::<L>(&pixels.delay_s, ahead));
            let later = hit(view, &later, load_at::<L>(&pixels.x, ahead), load_at::<L>(&pixels.y, ahead));
            prefetch(tiles, &level, later.texel, &by_pixel);
        }
        let sampled = if spec.places <= 1 {
            sharp_samples(tiles, &level, middle.texel, &by_pixel, view.side)
        } else {
            let half = L::splat(view.half_exposure_s);
            let (before, after) = (t.sub(half), t.add(half));
            let first = hit(view, &sight_at(view, before, map.as_ref()), x, y).texel;
            let last = hit(view, &sight_at(view, after, map.as_ref()), x, y).texel;
            blurred_samples(tiles, &level, &BlurPath::through(first, middle.texel, last), &by_pixel, spec.places)
        };
        let unit = L::splat(1.0 / FULL);
        store_at(&mut out.intensity, k, sampled.intensity.mul(unit));
        store_at(&mut out.psf_variance, k, sampled.psf_variance.mul(unit));
        store_at(&mut out.sharper, k, sampled.sharper.mul(unit));
        let gradient_gain = L::splat(view.gradient_gain).mul(unit);
        let (across, down) = (sampled.across.mul(gradient_gain), sampled.down.mul(gradient_gain));
        store_at(&mut out.across, k, across);
        store_at(&mut out.down, k, down);
        let derivatives = by_pose(view, &sight.rotation, &middle, [x, y], by_texel(&by_pixel, across, down), map.as_ref());
        for n in 0..6 {
            store_at(&mut out.by_pose[n], k, derivatives[n]);
        }
        if BY_VELOCITY {
            // A place is where the velocity has taken the camera since the instant of its row.
            let gain = gradient_gain.mul(L::splat(view.half_exposure_s));
            let [across, down] = sampled.by_instant.map(|slope| slope.mul(gain));
            let by_velocity = by_pose(view, &sight.rotation, &middle, [x, y], by_texel(&by_pixel, across, down), map.as_ref());
            for n in 0..6 {
                store_at(&mut out.by_velocity[n], k, by_velocity[n]);
            }
        }
        k += LANES;
    }
}

/// Converts a gradient by pixels of the level to one by picture pixels.
#[inline(always)]
fn by_texel<L: Lanes>(by_pixel: &[L; 4], across: L, down: L) -> [L; 2] {
    let [uu, uv, vu, vv] = *by_pixel;
    let inverse = L::splat(1.0).div(uu.mul(vv).sub(uv.mul(vu)));
    [across.mul(vv).sub(down.mul(vu)).mul(inverse), down.mul(uu).sub(across.mul(uv)).mul(inverse)]
}

/// Returns the derivative by the pose: dP/dp = R_s q and dP/dθ = depth (ray x Aᵀ q), where q is the
/// gradient by a motion of the camera in the surface's frame.
#[inline(always)]
fn by_pose<L: Lanes>(view: &View, a: &[L; 9], hit: &Hit<L>, ray: [L; 2], gradient: [L; 2], map: Option<&MapLanes<L>>) -> [L; 6] {
    let gx = gradient[0].mul(L::splat(view.texels_per_m[0]));
    let gy = gradient[1].mul(L::splat(-view.texels_per_m[1]));
    let gz = L::splat(0.0).sub(gx.mul_add(hit.slope[0], gy.mul(hit.slope[1])));
    let mut out = [gx; 6];
    // No `map_or`: its closure would not be compiled for the wider registers of the function around
    // it.
    let [sx, sy, sz] = match map {
        Some(map) => map.gradient([gx, gy, gz]),
        None => [gx, gy, gz],
    };
    for r in 0..3 {
        let m = [L::splat(view.to_body[3 * r]), L::splat(view.to_body[3 * r + 1]), L::splat(view.to_body[3 * r + 2])];
        out[r] = sx.mul_add(m[0], sy.mul_add(m[1], sz.mul(m[2])));
    }
    let mut b = [gx; 3];
    for c in 0..3 {
        b[c] = a[c].mul_add(gx, a[3 + c].mul_add(gy, a[6 + c].mul(gz)));
    }
    out[3] = ray[1].mul(b[2]).sub(b[1]).mul(hit.depth);
    out[4] = b[0].sub(ray[0].mul(b[2])).mul(hit.depth);
    out[5] = ray[0].mul(b[1]).sub(ray[1].mul(b[0])).mul(hit.depth);
    out
}
