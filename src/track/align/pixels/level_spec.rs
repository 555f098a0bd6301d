//! The task of one level of one frame: which surfaces and camera, how many pixels and samples, how
//! much noise and blur. The other modules here and the solver take it as their input. Also the time
//! of a tile, because a rolling shutter exposes rows one after the other.

use crate::track::align::tuning::TUNING;
use nalgebra::{Vector2, Vector3};

use crate::camera::Shutter;
use crate::geometry::{Body, Camera, Pose};
use crate::motion::Motion;
use crate::track::align::learned::noise::Noise;
use crate::track::align::learned::online_calibration::OnlineCalibration;
use crate::track::align::picture::surface::AlignSurface;
use crate::track::frame::frame_levels::FINEST;
use crate::track::frame::rays::CameraRays;

/// Powers of time in a motion: position, velocity, acceleration.
pub const POWERS: usize = 3;

/// The time of a tile, which maps a change of motion to a change of its pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TileTime {
    /// Seconds from the frame's stamp to mid-exposure at the middle of the tile.
    pub delay_s: f64,
    /// Mean square of the times at which the tile's pixels were exposed, s².
    pub mean_square_s2: f64,
}

impl TileTime {
    /// Returns the derivatives of the pose at the middle of the tile by position (1), velocity (s)
    /// and acceleration (s²).
    pub fn factors(&self) -> [f64; POWERS] {
        [1.0, self.delay_s, 0.5 * self.mean_square_s2]
    }

    /// Returns the derivatives of these factors by time, per second: how they change from row to
    /// row.
    pub fn rates(&self) -> [f64; POWERS] {
        [0.0, 1.0, self.delay_s]
    }
}

/// The task of one level of one frame.
#[derive(Clone, Copy)]
pub struct LevelSpec<'a> {
    /// The body's surfaces.
    pub surfaces: &'a [AlignSurface],
    /// The camera's rays, at all levels.
    pub rays: &'a CameraRays,
    /// The camera's shutter.
    pub shutter: &'a Shutter,
    /// The level: 0 is the frame itself, each further one has half the size.
    pub level: usize,
    /// Noise of its pixels.
    pub noise: Noise,
    /// Number of pixels wanted.
    pub count: usize,
    /// Whether pixels are chosen by texels of half the size, so that no steep pixel is missed.
    pub is_dense: bool,
    /// Whether to choose so where fewer than half of the wanted pixels are found otherwise: for a
    /// body that appears small.
    pub fills_up: bool,
    /// Length of the motion blur, pixels of the level.
    pub blur_px: f64,
    /// Sampled places along the blur: 1 for none, else odd.
    pub places: usize,
    /// Samples across a sharp pixel, odd. Tilted surfaces get more.
    pub side: usize,
    /// Whether predictions may use the enlarged copies of the pictures.
    pub is_enlarged: bool,
    /// The learnt [`GradientGain`](crate::track::align::learned::gradient_gain::GradientGain), by
    /// which gradients are multiplied.
    pub gradient_gain: f32,
}

impl<'a> LevelSpec<'a> {
    /// Returns the task of a level at a motion, with what is known of the camera so far.
    pub fn new(
        surfaces: &'a [AlignSurface],
        slow: &'a OnlineCalibration,
        rays: &'a CameraRays,
        is_enlarged: bool,
        level: usize,
        motion: &Motion,
    ) -> Self {
        let wider = (f64::from(rays.camera().width()) / TUNING.reference_width_px).max(1.0);
        let mut spec = Self {
            surfaces,
            rays,
            shutter: &slow.shutter,
            level,
            noise: slow.noise.at(level),
            count: (TUNING.pixels_per_level[level] as f64 * wider) as usize,
            is_dense: false,
            fills_up: false,
            blur_px: 0.0,
            places: 1,
            side: if level == FINEST { TUNING.fine_samples_across } else { TUNING.coarse_samples_across },
            is_enlarged,
            gradient_gain: slow.gradient_gain.get() as f32,
        };
        spec.blur_px = spec.blur_of(motion);
        spec.with_places()
    }

    /// Sets the number of samples along the blur by its length.
    pub fn with_places(mut self) -> Self {
        let at_blur = TUNING.places_by_blur.iter().find(|(longest_px, _)| self.blur_px < *longest_px);
        self.places = at_blur.map_or(TUNING.max_places, |(_, places)| *places);
        self
    }

    /// Returns the spec for the blur of a motion, where that blur is long and needs more samples;
    /// otherwise a copy of itself.
    pub fn blurred_by(&self, motion: &Motion) -> Self {
        let blurred = Self { blur_px: self.blur_of(motion), ..*self }.with_places();
        if blurred.places > self.places.max(TUNING.short_blur_places) { blurred } else { *self }
    }

    /// Returns the length of the blur of a motion, pixels of the level.
    pub fn blur_of(&self, motion: &Motion) -> f64 {
        let half = 0.5 * self.shutter.exposure_s;
        self.moved_px(&motion.after(-half), &motion.after(half))
    }

    /// Returns how fast the picture moves through the frame, pixels of the frame per second.
    pub fn speed_px_s(&self, motion: &Motion) -> f64 {
        self.moved_px(motion, &motion.after(TUNING.speed_baseline_s)) * self.frame_px() / TUNING.speed_baseline_s
    }

    /// Returns the size of a pixel of the level along each axis, pixels of the frame.
    pub fn frame_px(&self) -> f64 {
        f64::from(1u32 << self.level)
    }

    /// Returns the distance of the middle of a row of the level from the upper edge of the frame,
    /// pixels of the frame.
    pub fn frame_y(&self, row: f64) -> f64 {
        f64::from(1u32 << self.level) * (row + 0.5)
    }

    /// Returns the time that all tiles share with a global shutter; `None` with a rolling shutter.
    pub fn same_time(&self) -> Option<TileTime> {
        self.shutter.is_global().then(|| TileTime { delay_s: 0.0, mean_square_s2: self.shutter.exposure_s.powi(2) / 12.0 })
    }

    /// Returns how far the picture moves between two motions: the maximum over the middle of the
    /// frame and four points halfway to its corners, pixels of the level.
    pub fn moved_px(&self, before: &Motion, after: &Motion) -> f64 {
        let table = self.rays.table(self.level);
        let focal = self.rays.camera().intrinsics().fx / f64::from(1u32 << self.level);
        let mut most = 0.0f64;
        for (a, b) in [(2, 2), (1, 1), (3, 1), (1, 3), (3, 3)] {
            let [x, y] = table.rays[table.height * b / 4 * table.width + table.width * a / 4];
            let ray = Vector3::new(f64::from(x), f64::from(y), 1.0);
            let moved = self.surfaces.iter().filter_map(|s| moved(s, &ray, &before.pose, &after.pose));
            most = moved.fold(most, |most, m| most.max(m * focal));
        }
        most
    }
}

/// Returns how far the point of a surface that a ray meets moves in the normalised picture (at
/// depth 1) when the camera moves; `None` where it is not in front of the camera.
pub fn moved(surface: &AlignSurface, ray: &Vector3<f64>, before: &Pose<Body, Camera>, after: &Pose<Body, Camera>) -> Option<f64> {
    let normal = surface.rectangle.rotation.column(2);
    let direction = before.rotation * ray;
    let depth = normal.dot(&(surface.rectangle.centre - before.translation)) / normal.dot(&direction);
    let seen = after.rotation.inverse() * (direction * depth + before.translation - after.translation);
    let shift = (Vector2::new(seen.x, seen.y) / seen.z - ray.xy()).norm();
    (depth > 0.0 && seen.z > 0.0 && shift.is_finite()).then_some(shift)
}
