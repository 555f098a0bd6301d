//! Detects frames that show two moments. Interlaced video weaves the rows of two fields, frame rate
//! conversion blends two frames, and torn frames show one moment above a line and another below.
//! The pose of such a frame belongs to no moment. It is off by as much as the camera moves in half
//! a frame interval.
//!
//! [`MixtureWatch`] draws cells of the reference pictures as they should look at some moments about
//! the frame's own, and compares them with the frame (`evidence`). A mixture has a share of 1 of a
//! second moment; an exposure, which is at most as long as the frame interval, has at most a third.
//! In a torn frame, cells above a line show another moment than those below it (`tear`). The
//! evidence is summed over frames, as cameras and capture cards that mix frames mix all of them.

mod evidence;
mod tear;

use crate::track::model_error::tuning::TUNING;
use image::GrayImage;
use nalgebra::{Matrix2, Point3, SVector, Vector2};

use self::evidence::{CELL_COLUMNS, CELL_ROWS, Cell, Evidence, Greys, MIDDLES, MOMENTS};
use self::tear::{Displaced, torn_by};
use crate::camera::{CameraModel, Normalized};
use crate::geometry::{Body, Camera, Pose, skew};
use crate::motion::Motion;
use crate::track::align::{FrameLevels, LEVELS};
use crate::track::patches::fitted_anchor::FittedAnchor;
use crate::track::scene::averaged_picture::AveragedPicture;
use crate::track::scene::bilinear::look_at;
use crate::track::scene::reference::{PreparedBody, PreparedSurface};
use crate::track::scene::shape::ShapePoint;

/// How a frame mixes moments.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mixture {
    /// Rows of two moments alternate.
    Woven,
    /// Two pictures are blended.
    Blended,
    /// The upper rows show another moment than the lower ones.
    Torn,
}

impl Mixture {
    /// Returns what is wrong, and how to fix it.
    pub fn text(self) -> &'static str {
        match self {
            Self::Woven => {
                "frames are woven of two fields (interlaced video): poses are withheld while the camera moves; set the \
                 camera and the capture card to progressive video"
            }
            Self::Blended => {
                "each frame is a blend of two moments, as interlaced video and converted frame rates have it: poses are withheld while \
                 the camera moves; set the capture card to the camera's own frame rate and to progressive video, without conversion"
            }
            Self::Torn => {
                "the upper rows of frames are of another moment than the lower ones: poses are withheld while the camera moves; \
                 set the capture card or the player to whole frames (vertical sync)"
            }
        }
    }
}

/// A frame in which the body was found.
pub struct Found<'a> {
    /// The whole frame.
    pub image: &'a GrayImage,
    /// The body.
    pub body: &'a PreparedBody,
    /// Anchors found in the frame: the places whose cells are tested.
    pub anchors: &'a [FittedAnchor],
    /// The lens model.
    pub camera: &'a CameraModel,
    /// The motion at the frame's stamp, from the last two poses.
    pub motion: Motion,
    /// The motion before that, if known.
    pub motion_before: Option<Motion>,
    /// Frame interval, seconds.
    pub interval_s: f64,
}

/// What to do with a frame's pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Report it: the frame shows one moment, or no mixture is known.
    Whole,
    /// Report it with a wider covariance: the frame is a mixture, but moves so slowly that half the
    /// motion of a frame interval covers the error.
    Slow,
    /// Withhold it: the frame is a mixture and moves.
    Withheld,
}

/// Watches whether frames are mixtures.
#[derive(Debug, Default)]
pub struct MixtureWatch {
    evidence: Evidence,
    /// Running ratio of tested frames that were torn.
    torn: f64,
    mixture: Option<Mixture>,
    /// Frames tested, frames passed over since the last test, and tested frames in a row with the
    /// same mixture.
    tested: u32,
    passed: u32,
    agreeing: u32,
    is_reported: bool,
    averaged: Vec<AveragedPicture>,
    /// log2 of each surface's texels per pixel of the copy.
    texels: Vec<f64>,
    displaced: Vec<Displaced>,
}

impl MixtureWatch {
    /// Tests a frame if a test is due, and judges its pose.
    pub fn look(&mut self, found: &Found, levels: &mut FrameLevels) -> Verdict {
        let way_px = found.way_px(&found.motion);
        // A mixture's pose may alternate between both moments and stand still in between, so the
        // motion before counts as well.
        let longest_px = found.motion_before.map_or(way_px, |before| way_px.max(found.way_px(&before)));
        if way_px >= TUNING.min_test_motion_px && self.is_due() {
            self.ask(found, way_px, levels);
        }
        match self.mixture {
            None => Verdict::Whole,
            Some(_) if longest_px >= TUNING.min_withheld_motion_px => Verdict::Withheld,
            Some(_) => Verdict::Slow,
        }
    }

    /// Returns the mixture to announce, once.
    pub fn news(&mut self) -> Option<Mixture> {
        let mixture = self.mixture.filter(|_| self.agreeing >= TUNING.frames_to_announce && !self.is_reported)?;
        self.is_reported = true;
        Some(mixture)
    }

    /// Whether frames are known to be mixtures.
    pub fn is_mixing(&self) -> bool {
        self.mixture.is_some()
    }

    fn is_due(&mut self) -> bool {
        self.passed += 1;
        self.tested < TUNING.first_tested_frames || self.mixture.is_some() || self.passed >= TUNING.test_interval_frames
    }

    fn ask(&mut self, found: &Found, way_px: f64, levels: &mut FrameLevels) {
        let mut level = 0;
        while way_px / f64::from(1u32 << level) > TUNING.max_test_motion_px && level + 1 < LEVELS {
            level += 1;
        }
        // Fields are not visible in smaller copies.
        if level > 0 && self.mixture == Some(Mixture::Woven) {
            return;
        }
        let copy = FrameCopy::at(level, found.image, levels);
        let poses = MOMENTS.map(|moment| found.motion.after(moment * found.interval_s).pose);
        self.prepare(found, &copy, &poses);
        self.find_moments(found, &copy, &poses);
        let is_torn = torn_by(&self.displaced).is_some();
        self.torn += (1.0 - TUNING.moment_evidence_kept) * (f64::from(u8::from(is_torn)) - self.torn);
        // If the motion changes, a frame's cells show more or less motion than its own.
        if found.is_steady()
            && let Some(of_frame) = self.evidence_of(found, &copy, &poses)
        {
            self.evidence.fade(TUNING.moment_evidence_kept);
            self.evidence.add(&of_frame);
        }
        let shares = self.evidence.shares();
        let mixture = match shares {
            Some(shares) if shares.alternating.abs() > TUNING.min_woven_share => Some(Mixture::Woven),
            _ if is_torn || self.torn > 0.5 => Some(Mixture::Torn),
            Some(shares) if shares.both > TUNING.min_blended_share => Some(Mixture::Blended),
            _ => None,
        };
        self.agreeing = if mixture.is_some() && mixture == self.mixture { self.agreeing + 1 } else { u32::from(mixture.is_some()) };
        (self.mixture, self.tested, self.passed) = (mixture, self.tested.saturating_add(1), 0);
        tracing::debug!(way_px, ?shares, self.torn, ?mixture, "moments");
    }

    /// Determines how many texels a pixel of the copy covers on each surface, for averaging the
    /// pictures.
    fn prepare(&mut self, found: &Found, copy: &FrameCopy, poses: &Poses) {
        let surfaces = &found.body.surfaces;
        let (frame, scale) = (copy.size.map(|n| n as f64), copy.scale());
        self.texels.clear();
        self.texels.extend(surfaces.iter().map(|surface| {
            let see = |place| Some(surface.rectangle.see(&poses[OWN_MOMENT], found.camera, place, 0.0)?.in_smaller(scale));
            surface.rectangle.texels_log2(frame, see).unwrap_or(0.0)
        }));
        if self.averaged.len() < surfaces.len() {
            self.averaged.resize_with(surfaces.len(), AveragedPicture::default);
        }
    }

    /// Returns the cell about a place of a surface, where the frame shows it (`shown`) or should
    /// show it.
    fn cell(
        &mut self,
        found: &Found,
        number: usize,
        share: [f64; 2],
        shown: Option<Vector2<f64>>,
        copy: &FrameCopy,
        poses: &Poses,
    ) -> Option<Cell> {
        let surface = &found.body.surfaces[number];
        let picture = self.averaged[number].over(&surface.octaves, self.texels[number], surface.spec.transfer);
        draw_cell(surface, share, shown, picture, poses, found.camera, copy)
    }

    /// Sums the evidence of cells at anchors that were found. `None` where too few cells have any.
    fn evidence_of(&mut self, found: &Found, copy: &FrameCopy, poses: &Poses) -> Option<Evidence> {
        let stride = found.anchors.len().div_ceil(TUNING.cells_per_frame).max(1);
        let (mut sums, mut left, mut cells) = ([Evidence::default(); MIDDLES.len()], [0.0; MIDDLES.len()], 0);
        for anchor in found.anchors.iter().step_by(stride) {
            let number = anchor.surface as usize;
            let size_px = found.body.surfaces[number].rectangle.size_px;
            let share = [0, 1].map(|k| (anchor.artwork[k] + 0.5) / size_px[k]);
            let cell = self.cell(found, number, share, Some(anchor.observation.pixel), copy, poses);
            let Some(evidence) = cell.and_then(|cell| cell.evidence()) else { continue };
            for ((sum, left), of_middle) in sums.iter_mut().zip(&mut left).zip(evidence) {
                sum.add(&of_middle.evidence);
                *left += of_middle.left;
            }
            cells += 1;
        }
        let best = (0..MIDDLES.len()).min_by(|a, b| left[*a].total_cmp(&left[*b]))?;
        (cells >= TUNING.min_moment_cells).then_some(sums[best])
    }

    /// Finds the moment that the frame shows at places all over the pictures.
    fn find_moments(&mut self, found: &Found, copy: &FrameCopy, poses: &Poses) {
        let mut displaced = std::mem::take(&mut self.displaced);
        displaced.clear();
        let surfaces = found.body.surfaces.len();
        let side = ((TUNING.tear_places / surfaces.max(1)) as f64).sqrt().floor().max(2.0) as usize;
        for (number, at) in (0..surfaces).flat_map(|number| (0..side * side).map(move |at| (number, at))) {
            let share = [at % side, at / side].map(|k| (k as f64 + 0.5) / side as f64);
            let moment = self.cell(found, number, share, None, copy, poses).and_then(|cell| cell.moment());
            displaced.extend(moment.and_then(|moment| found.displaced(number, share, moment)));
        }
        self.displaced = displaced;
    }
}

impl Found<'_> {
    /// Returns the displacement of a point's picture per frame interval, pixels.
    fn way(&self, point: &Point3<f64>, motion: &Motion) -> Option<Vector2<f64>> {
        let see = |pose: &Pose<Body, Camera>| {
            let seen = pose.inverse().transform(point);
            (seen.z > 0.0).then(|| self.camera.project(Normalized(seen.coords.xy() / seen.z)).0)
        };
        Some(see(&motion.pose)? - see(&motion.after(-self.interval_s).pose)?)
    }

    /// Returns the same, root mean square over all anchors.
    fn way_px(&self, motion: &Motion) -> f64 {
        let ways = self.anchors.iter().filter_map(|anchor| self.way(&anchor.observation.point, motion));
        let (sum, n) = ways.fold((0.0, 0), |(sum, n), way| (sum + way.norm_squared(), n + 1));
        (sum / f64::from(n.max(1))).sqrt()
    }

    /// Whether the motion continues as in the frame before.
    fn is_steady(&self) -> bool {
        let Some(before) = &self.motion_before else { return false };
        let points = self.anchors.iter().map(|anchor| anchor.observation.point);
        let both = points.filter_map(|point| Some([self.way(&point, &self.motion)?, self.way(&point, before)?]));
        let (change, way) =
            both.fold((0.0, 0.0), |(change, way), [now, then]| (change + (now - then).norm_squared(), way + now.norm_squared()));
        change <= TUNING.max_motion_change.powi(2) * way
    }

    /// Returns a place of a surface that is shown as it looked at `moment`; `None` where it is not
    /// visible or does not move.
    fn displaced(&self, number: usize, share: [f64; 2], moment: f64) -> Option<Displaced> {
        let rectangle = &self.body.surfaces[number].rectangle;
        let ShapePoint { place, .. } = rectangle.shape.at(metres(share, rectangle.size_m));
        let point = Point3::from(rectangle.rotation * place + rectangle.centre);
        let seen = self.motion.pose.inverse().transform(&point);
        let (pixel, by_point) = self.camera.project_point_with_jacobian(&seen.coords);
        let way = self.way(&point, &self.motion)?;
        let along = way.try_normalize(1e-6)?;
        let (by_shift, by_rotation) = (by_point.transpose() * along, (by_point * -skew(&seen.coords)).transpose() * along);
        let by_pose = SVector::from([by_shift.x, by_shift.y, by_shift.z, by_rotation.x, by_rotation.y, by_rotation.z]);
        let (row, way) = (pixel.0.y / f64::from(self.camera.height()), way.norm());
        Some(Displaced { row, off: moment * way, way, by_pose })
    }
}

/// Converts a place of a picture, as fractions of its size, to metres from its centre.
fn metres(share: [f64; 2], size_m: [f64; 2]) -> [f64; 2] {
    [(share[0] - 0.5) * size_m[0], (0.5 - share[1]) * size_m[1]]
}

/// The camera's pose at each of the [`MOMENTS`].
type Poses = [Pose<Body, Camera>; MOMENTS.len()];
/// Index of the frame's own moment in [`MOMENTS`].
const OWN_MOMENT: usize = 2;

/// A copy of the frame at a pyramid level; level 0 is the frame itself.
struct FrameCopy<'a> {
    level: usize,
    size: [usize; 2],
    of: Greyscale<'a>,
}

enum Greyscale<'a> {
    Bytes(&'a [u8]),
    /// Sums of pixels, and the factor from a sum to a grey level.
    Sums(&'a [u16], f32),
}

impl<'a> FrameCopy<'a> {
    fn at(level: usize, image: &'a GrayImage, levels: &'a mut FrameLevels) -> Self {
        let size = [image.width() as usize >> level, image.height() as usize >> level];
        let of = match level {
            0 => Greyscale::Bytes(image.as_raw()),
            _ => Greyscale::Sums(levels.level(level).sums(), 1.0 / (1u32 << (2 * level)) as f32),
        };
        Self { level, size, of }
    }

    fn scale(&self) -> f64 {
        f64::from(1u32 << self.level)
    }

    fn cell(&self, [x, y]: [usize; 2]) -> Greys {
        std::array::from_fn(|v| {
            let at = (y + v) * self.size[0] + x;
            match self.of {
                Greyscale::Bytes(bytes) => std::array::from_fn(|u| f32::from(bytes[at + u])),
                Greyscale::Sums(sums, grey) => std::array::from_fn(|u| f32::from(sums[at + u]) * grey),
            }
        })
    }
}

/// Draws the cell about a place of a surface; `None` where it leaves the frame or the picture.
/// `shown`: where the frame shows it, if known, so that a displacement by folds does not count as a
/// second moment.
fn draw_cell(
    surface: &PreparedSurface,
    share: [f64; 2],
    shown: Option<Vector2<f64>>,
    image: &GrayImage,
    poses: &Poses,
    camera: &CameraModel,
    copy: &FrameCopy,
) -> Option<Cell> {
    let rectangle = &surface.rectangle;
    let size_m = rectangle.size_m;
    let place = rectangle.shape.at(metres(share, size_m));
    let scale = copy.scale();
    let see = |pose| Some(rectangle.see_place(pose, camera, &place, 0.2)?.in_smaller(scale));
    let now = see(&poses[OWN_MOMENT])?;
    let half = Vector2::new(0.5, 0.5);
    let shown = shown.map_or(now.pixel, |shown| (shown + half) / scale - half);
    let first = shown - Vector2::new(0.5 * CELL_COLUMNS as f64, 0.5 * CELL_ROWS as f64);
    let last = [copy.size[0].checked_sub(CELL_COLUMNS)?, copy.size[1].checked_sub(CELL_ROWS)?];
    let origin = [first.x.round(), first.y.round()];
    if origin.iter().zip(last).any(|(at, last)| *at < 0.0 || *at > last as f64) {
        return None;
    }
    let image_size = [image.width() as usize, image.height() as usize];
    let texel = [0, 1].map(|k| share[k] * image_size[k] as f64 - 0.5);
    let per_m = Matrix2::new(image_size[0] as f64 / size_m[0], 0.0, 0.0, -(image_size[1] as f64) / size_m[1]);
    let mut drawn = [[[0.0; CELL_COLUMNS]; CELL_ROWS]; MOMENTS.len()];
    for (drawn, pose) in drawn.iter_mut().zip(poses) {
        let seen = see(pose)?;
        let by_pixel = per_m * seen.by_metres.try_inverse()?;
        let from = Vector2::from(origin) - (shown + seen.pixel - now.pixel);
        draw(image.as_raw(), image_size, texel, &by_pixel, from, drawn)?;
    }
    Some(Cell { seen: copy.cell(origin.map(|at| at as usize)), drawn, begins_even: (origin[1] as usize).is_multiple_of(2) })
}

/// Draws the cell whose first pixel lies `from` the one at which `texel` is seen; `None` where it
/// leaves the picture.
fn draw(picture: &[u8], size: [usize; 2], texel: [f64; 2], by_pixel: &Matrix2<f64>, from: Vector2<f64>, drawn: &mut Greys) -> Option<()> {
    let place = |u: usize, v: usize| Vector2::from(texel) + by_pixel * (from + Vector2::new(u as f64, v as f64));
    let corners = [(0, 0), (CELL_COLUMNS - 1, 0), (0, CELL_ROWS - 1), (CELL_COLUMNS - 1, CELL_ROWS - 1)];
    let is_in = |(u, v)| {
        let at = place(u, v);
        at.x >= 0.0 && at.y >= 0.0 && at.x <= (size[0] - 1) as f64 && at.y <= (size[1] - 1) as f64
    };
    if !corners.into_iter().all(is_in) {
        return None;
    }
    for (v, row) in drawn.iter_mut().enumerate() {
        let first: Vector2<f32> = place(0, v).cast();
        let step: [f32; 2] = [by_pixel[(0, 0)] as f32, by_pixel[(1, 0)] as f32];
        let [xs, ys] = [0, 1].map(|k| std::array::from_fn(|u| first[k] + u as f32 * step[k]));
        *row = look_at::<CELL_COLUMNS>(picture, size, &xs, &ys);
    }
    Some(())
}
