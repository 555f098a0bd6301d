//! What a level has to do: with which pixels, against how much noise and blur.

use nalgebra::{Vector2, Vector3};

use crate::camera::Shutter;
use crate::geometry::{Body, Camera, Pose};
use crate::motion::Motion;
use crate::track::align::learned::noise::Noise;
use crate::track::align::learned::slow_estimates::SlowEstimates;
use crate::track::align::picture::surface::AlignSurface;
use crate::track::frame::frame_levels::{FINEST, LEVELS};
use crate::track::frame::rays::CameraRays;

/// Frames with less motion blur than this, pixels of the frame, tell of the point spread, of the noise, and by what their patches leave of the model. Chosen, not tuned: such blur is
/// no wider than a pixel. Raised, blur passes for point spread; lowered, a camera that always moves never teaches its noise.
pub const SHARP_FRAME_PX: f64 = 1.0;

/// Powers of time that a motion acts by: position, velocity, acceleration.
pub const POWERS: usize = 3;

/// Times of a tile: what a change of motion means for its pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TileTime {
    /// Seconds from the stamp.
    pub delay_s: f64,
    /// Mean square of the times at which the tile's pixels were open, s².
    pub mean_square_s2: f64,
}

impl TileTime {
    /// What the powers of a motion (position, velocity, acceleration) do to the pose at the middle of the tile.
    pub fn factors(&self) -> [f64; POWERS] {
        [1.0, self.delay_s, 0.5 * self.mean_square_s2]
    }

    /// And to how it grows from row to row, per second.
    pub fn rates(&self) -> [f64; POWERS] {
        [0.0, 1.0, self.delay_s]
    }
}

/// Pixels asked at each level, from full size down, of a frame 1280 pixels wide; wider ones are asked more in proportion. Median errors
/// with 4,000 to 30,000 are in docs/alignment.md ("How many pixels"): with 8,000 instead of 15,000, d-1080p is 0.027 instead of 0.023 mm
/// off. Raised, the cost of a frame grows in proportion. Level 0 is never asked; coarser levels only lead to the basin of the next.
const PIXELS: [usize; LEVELS] = [10_000, 10_000, 4000, 1500, 500];
const USUAL_WIDTH_PX: f64 = 1280.0;
/// Samples across a pixel of the levels above the finest, and of that. With 5 instead of 3 the median error of d-dolly is 0.071 mm instead
/// of 0.083, for a fifth more time. Raised, the cost grows by the square.
const COARSE_SIDE: usize = 3;
const SIDE: usize = 5;
/// Samples along a blur path: (length below which they do, pixels of the level; their number, odd). [`MAX_PLACES`] for longer ones.
/// Chosen, from a prototype: a place to half a pixel or so. Lengths raised, the blur is predicted as ghosts; lowered, blurred frames cost
/// more.
const PLACES: [(f64, usize); 4] = [(0.4, 1), (1.5, 3), (3.0, 5), (5.5, 9)];
const MAX_PLACES: usize = 15;
/// Blur with as many places or fewer is no hindrance to a level above the finest. Raised, such a level does not come to rest under longer blur; lowered, it costs more without need.
const SHORT_BLUR_PLACES: usize = 3;

/// Time over which a picture's speed is taken, seconds: as long as usual exposures. It hardly matters, as a motion is smooth.
const SPEED_OVER_S: f64 = 0.005;

/// What a level works for.
#[derive(Clone, Copy)]
pub struct LevelSpec<'a> {
    /// The body's surfaces.
    pub surfaces: &'a [AlignSurface],
    /// The camera.
    pub rays: &'a CameraRays,
    /// Its shutter.
    pub shutter: &'a Shutter,
    /// The level.
    pub level: usize,
    /// Noise of its pixels.
    pub noise: Noise,
    /// Pixels wanted.
    pub count: usize,
    /// Whether pixels are chosen densely, so that none that is steep is passed over.
    pub is_dense: bool,
    /// Whether they are where fewer than half of those wanted are found otherwise: of a body that is seen small.
    pub fills_up: bool,
    /// Length of the motion blur, pixels of the level.
    pub blur_px: f64,
    /// Places along the blur that are sampled; 1 for none, else odd.
    pub places: usize,
    /// Samples across a sharp pixel, odd; surfaces that are tilted get more.
    pub side: usize,
    /// Whether the enlarged copies of the pictures may be used.
    pub is_enlarged: bool,
    /// What slopes over samples are multiplied with.
    pub gradient_gain: f32,
}

impl<'a> LevelSpec<'a> {
    /// What a level has to do at a motion, with what is known of the camera by now.
    pub fn new(
        surfaces: &'a [AlignSurface],
        slow: &'a SlowEstimates,
        rays: &'a CameraRays,
        is_enlarged: bool,
        level: usize,
        motion: &Motion,
    ) -> Self {
        let wider = (f64::from(rays.camera().width()) / USUAL_WIDTH_PX).max(1.0);
        let mut spec = Self {
            surfaces,
            rays,
            shutter: &slow.shutter,
            level,
            noise: slow.noise.at(level),
            count: (PIXELS[level] as f64 * wider) as usize,
            is_dense: false,
            fills_up: false,
            blur_px: 0.0,
            places: 1,
            side: if level == FINEST { SIDE } else { COARSE_SIDE },
            is_enlarged,
            gradient_gain: slow.gradient_gain.get() as f32,
        };
        spec.blur_px = spec.blur_of(motion);
        spec.with_places()
    }

    /// With as many samples along the blur as its length asks for.
    pub fn with_places(mut self) -> Self {
        let at_blur = PLACES.iter().find(|(longest_px, _)| self.blur_px < *longest_px);
        self.places = at_blur.map_or(MAX_PLACES, |(_, places)| *places);
        self
    }

    /// With as many samples as the blur of a motion asks for, where that is long, and never with fewer.
    pub fn blurred_by(&self, motion: &Motion) -> Self {
        let blurred = Self { blur_px: self.blur_of(motion), ..*self }.with_places();
        if blurred.places > self.places.max(SHORT_BLUR_PLACES) { blurred } else { *self }
    }

    /// Length of the blur of a motion, pixels of the level.
    pub fn blur_of(&self, motion: &Motion) -> f64 {
        let half = 0.5 * self.shutter.exposure_s;
        self.moved_px(&motion.after(-half), &motion.after(half))
    }

    /// How fast the picture moves through the frame, pixels of the frame per second.
    pub fn speed_px_s(&self, motion: &Motion) -> f64 {
        self.moved_px(motion, &motion.after(SPEED_OVER_S)) * self.frame_px() / SPEED_OVER_S
    }

    /// Pixels of the frame to a pixel of the level, along each axis.
    pub fn frame_px(&self) -> f64 {
        f64::from(1u32 << self.level)
    }

    /// How far a row of the level is below the upper edge of the frame, pixels of the frame.
    pub fn frame_y(&self, row: f64) -> f64 {
        f64::from(1u32 << self.level) * (row + 0.5)
    }

    /// The time of every tile, where all rows are exposed together.
    pub fn same_time(&self) -> Option<TileTime> {
        self.shutter.is_global().then(|| TileTime { delay_s: 0.0, mean_square_s2: self.shutter.exposure_s.powi(2) / 12.0 })
    }

    /// How far the picture moves between two motions, in the middle and towards the corners of the frame: the most, in pixels of the
    /// level.
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

/// How far, at depth 1, the point of a surface that a ray meets moves when the camera does; `None` where it is not in front.
pub fn moved(surface: &AlignSurface, ray: &Vector3<f64>, before: &Pose<Body, Camera>, after: &Pose<Body, Camera>) -> Option<f64> {
    let normal = surface.rectangle.rotation.column(2);
    let direction = before.rotation * ray;
    let depth = normal.dot(&(surface.rectangle.centre - before.translation)) / normal.dot(&direction);
    let seen = after.rotation.inverse() * (direction * depth + before.translation - after.translation);
    let shift = (Vector2::new(seen.x, seen.y) / seen.z - ray.xy()).norm();
    (depth > 0.0 && seen.z > 0.0 && shift.is_finite()).then_some(shift)
}
