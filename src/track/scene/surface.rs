//! Surfaces and bodies: the textured rectangles that the camera is compared with.
//!
//! A [`SurfaceSpec`] is one picture of known size, placed in the frame of its body. A body (the
//! stage, or a tracked object) is a rigid set of them. A photograph becomes artwork once, at load:
//! the part between its four corners is undistorted and rectified, so that all code after this file
//! sees one kind of picture.

use crate::track::scene::tuning::TUNING;
use image::GrayImage;
use nalgebra::{Matrix3, Point3, Vector2};
use thiserror::Error;

use super::shape::SurfaceShape;
use crate::camera::{CameraModel, Normalized, Pixel};
use crate::features::{CornerBuffers, CornerOptions, detect_corners};
use crate::geometry::planar_pose::planar_poses;
use crate::geometry::{Body, Homography, PointPair, Pose, ReferenceCamera, SurfaceFrame, catmull_rom};
use crate::light::Transfer;

/// One textured rectangle of a body, ready for tracking.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct SurfaceSpec {
    /// Its name in messages (the picture's file name).
    pub name: String,
    /// The flat artwork as grey levels; for a photograph, its rectified part.
    pub artwork: GrayImage,
    /// Width and height between the artwork's outer edges, metres.
    pub size_m: [f64; 2],
    /// `T_body_surface`: the pose of the surface in its body.
    pub pose: Pose<Body, SurfaceFrame>,
    /// Where the artwork came from; decides the reference camera and the pixels that `homography`
    /// starts from.
    pub kind: ReferenceKind,
    /// How it hangs: where the points of its picture are.
    pub shape: SurfaceShape,
    /// How far it may be from its configured place.
    pub doubt: SurfaceDoubt,
    /// How the artwork's grey levels encode light.
    pub transfer: Transfer,
}

/// Uncertainty of a surface's configured place, one sigma of each number.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct SurfaceDoubt {
    /// Of each corner of its photograph along each axis, pixels of the photograph.
    pub corner_px: f64,
    /// Of its position along each axis, metres.
    pub position_m: f64,
    /// Of its direction about each axis, radians.
    pub rotation_rad: f64,
    /// Shorter side of the photographed surface, pixels of the photograph.
    shorter_px: f64,
}

impl SurfaceDoubt {
    /// Creates the uncertainty of a photographed surface. `shorter_px`: its shorter side in the
    /// photograph.
    fn of_corners(corner_px: f64, shorter_px: f64) -> Self {
        Self { corner_px, shorter_px, ..Self::default() }
    }

    /// Returns the sigma of a corner as a fraction of half the shorter side; 0 for flat artwork.
    pub fn corners_share(&self) -> f64 {
        if self.shorter_px > 0.0 { 2.0 * self.corner_px / self.shorter_px } else { 0.0 }
    }

    /// Whether nothing is uncertain.
    pub(in crate::track) fn is_none(&self) -> bool {
        self.corners_share() == 0.0 && self.position_m == 0.0 && self.rotation_rad == 0.0
    }
}

/// Whether a surface was configured as flat artwork or as a photograph, or belongs to a map.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub enum ReferenceKind {
    /// Flat artwork: its own pixels are the reference pixels.
    Artwork,
    /// A photograph of the surface.
    Photograph {
        /// Maps artwork pixels (of [`SurfaceSpec::artwork`]) to undistorted pixels of the
        /// photograph.
        h_photo_artwork: Matrix3<f64>,
        /// The camera that took it.
        camera: Box<CameraModel>,
        /// `T_reference_surface`: the pose of the surface as that camera saw it, from its four
        /// corners.
        pose: Pose<ReferenceCamera, SurfaceFrame>,
    },
    /// A facet of a map, painted from a walk.
    Facet {
        /// `T_reference_surface`: the pose of the surface as the walk's first keyframe saw it.
        pose: Pose<ReferenceCamera, SurfaceFrame>,
    },
}

/// The stage, or a tracked object: a rigid body made of surfaces.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct BodySpec {
    /// `stage`, or the object's name.
    pub name: String,
    /// Its surfaces; at least one.
    pub surfaces: Vec<SurfaceSpec>,
}

impl BodySpec {
    /// Creates a body with this name.
    pub fn new(name: impl Into<String>, surfaces: Vec<SurfaceSpec>) -> Self {
        Self { name: name.into(), surfaces }
    }

    /// Whether it has facets of a map.
    pub fn has_map(&self) -> bool {
        self.surfaces.iter().any(SurfaceSpec::is_facet)
    }
}

/// Why a picture cannot be tracked.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum SurfaceError {
    /// Width or height in metres is not a positive number.
    #[error("size_m is [{}, {}]; both must be above 0 metres", .0[0], .0[1])]
    Size([f64; 2]),
    /// The picture has too few pixels.
    #[error("the picture is {width} x {height} pixels; at least {least} x {least} are needed to find it again")]
    TooSmall {
        /// Pixels across.
        width: u32,
        /// Pixels down.
        height: u32,
        /// The minimum side.
        least: u32,
    },
    /// The picture has too little texture.
    #[error(
        "the picture has too little texture: {found} distinct corners were found, at least {least} are needed; use a picture with more detail"
    )]
    Textureless {
        /// Corners found.
        found: usize,
        /// Corners needed.
        least: usize,
    },
    /// The four corners do not form a convex quadrilateral, clockwise from the top left. Contains
    /// the corners in the right order if one exists.
    #[error(
        "corners_px is not a convex quadrilateral; give top left, top right, bottom right, bottom left, clockwise in the photograph, in pixels{}",
        .0.map_or(String::new(), |c| format!("; these run anticlockwise or cross: write corners_px = {c:?}"))
    )]
    Corners(Option<[[f64; 2]; 4]>),
    /// A corner lies where the photograph's calibration cannot be inverted, or outside of the
    /// photograph.
    #[error(
        "corner {number} at [{u}, {v}] lies outside of the photograph or of its calibration's valid field; corner 1 is the top left one"
    )]
    CornerOutside {
        /// Number of the corner as users count: from 1, the top left one.
        number: usize,
        /// Pixel column.
        u: f64,
        /// Pixel row.
        v: f64,
    },
}

impl SurfaceSpec {
    /// Whether it is a facet of a map.
    pub fn is_facet(&self) -> bool {
        matches!(self.kind, ReferenceKind::Facet { .. })
    }

    /// Creates a surface from its flat artwork. Errors: a bad size, too few pixels, or too little
    /// texture.
    pub fn from_artwork(name: String, picture: GrayImage, size_m: [f64; 2], pose: Pose<Body, SurfaceFrame>) -> Result<Self, SurfaceError> {
        let spec = Self::from_any_artwork(name, picture, size_m, pose)?;
        spec.check_texture().map(|()| spec)
    }

    /// As [`from_artwork`](Self::from_artwork), but accepts a plain picture: see
    /// [`check_texture`](Self::check_texture).
    pub fn from_any_artwork(
        name: String,
        picture: GrayImage,
        size_m: [f64; 2],
        pose: Pose<Body, SurfaceFrame>,
    ) -> Result<Self, SurfaceError> {
        check_size(size_m)?;
        check_sides(&picture)?;
        Ok(Self {
            name,
            artwork: picture,
            size_m,
            pose,
            kind: ReferenceKind::Artwork,
            shape: SurfaceShape::Flat,
            doubt: SurfaceDoubt::default(),
            transfer: Transfer::default(),
        })
    }

    /// Creates a surface from a photograph of it. `corners`: raw pixels of its four corners,
    /// clockwise from the top left, which become +- size / 2; `camera`: the camera that took it.
    /// Errors: as [`from_artwork`](Self::from_artwork), or bad corners.
    pub fn from_photograph(
        name: String,
        photo: &GrayImage,
        corners: [Pixel; 4],
        camera: CameraModel,
        size_m: [f64; 2],
        pose: Pose<Body, SurfaceFrame>,
    ) -> Result<Self, SurfaceError> {
        let spec = Self::from_any_photograph(name, photo, corners, camera, size_m, pose)?;
        spec.check_texture().map(|()| spec)
    }

    /// As [`from_photograph`](Self::from_photograph), but accepts a plain surface: see
    /// [`check_texture`](Self::check_texture).
    pub fn from_any_photograph(
        name: String,
        photo: &GrayImage,
        corners: [Pixel; 4],
        camera: CameraModel,
        size_m: [f64; 2],
        pose: Pose<Body, SurfaceFrame>,
    ) -> Result<Self, SurfaceError> {
        check_size(size_m)?;
        let rays = corner_rays(photo, &corners, &camera)?;
        let seen = rays.map(|n| camera.undistorted_pixel(n));
        if !is_convex_clockwise(&seen) {
            return Err(SurfaceError::Corners(clockwise(&corners)));
        }
        let length = |a: usize, b: usize| (seen[a] - seen[b]).norm();
        let sides = [length(0, 1).max(length(3, 2)), length(0, 3).max(length(1, 2))];
        let shrink = (TUNING.max_rectified_side_px / sides[0].max(sides[1])).min(1.0);
        let [w, h] = sides.map(|s| ((s * shrink).round() as u32).max(1));
        let (wf, hf) = (f64::from(w), f64::from(h));
        let outer = [(-0.5, -0.5), (wf - 0.5, -0.5), (wf - 0.5, hf - 0.5), (-0.5, hf - 0.5)].map(|(x, y)| Vector2::new(x, y));
        let flat: [PointPair; 4] = std::array::from_fn(|k| PointPair { from: outer[k], to: seen[k] });
        let h_photo_artwork = Homography::from_four(&flat).ok_or(SurfaceError::Corners(None))?;
        let half = Vector2::new(0.5 * size_m[0], 0.5 * size_m[1]);
        let metres = [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)].map(|(x, y)| Vector2::new(x * half.x, y * half.y));
        let metric: [PointPair; 4] = std::array::from_fn(|k| PointPair { from: metres[k], to: rays[k].0 });
        let homography = Homography::from_four(&metric).ok_or(SurfaceError::Corners(None))?;
        let seen_from = planar_poses(&homography, &metric).into_iter().next().ok_or(SurfaceError::Corners(None))?;
        let artwork = rectified(photo, &h_photo_artwork, &camera, w, h);
        check_sides(&artwork)?;
        let kind = ReferenceKind::Photograph { h_photo_artwork: h_photo_artwork.0, camera: Box::new(camera), pose: seen_from.renamed() };
        let shorter_px = length(0, 1).min(length(1, 2)).min(length(2, 3)).min(length(3, 0));
        let doubt = SurfaceDoubt::of_corners(TUNING.corner_sigma_px, shorter_px);
        Ok(Self { name, artwork, size_m, pose, kind, shape: SurfaceShape::Flat, doubt, transfer: Transfer::default() })
    }

    /// Refuses a picture that no camera could find again.
    pub fn check_texture(&self) -> Result<(), SurfaceError> {
        let found = corners_to_find(&self.artwork);
        if found < TUNING.min_corners { Err(SurfaceError::Textureless { found, least: TUNING.min_corners }) } else { Ok(()) }
    }

    /// Checks that there is a picture, and a size to place it with.
    pub(crate) fn check(&self) -> Result<(), SurfaceError> {
        let (width, height) = self.artwork.dimensions();
        if width == 0 || height == 0 {
            return Err(SurfaceError::TooSmall { width, height, least: TUNING.min_picture_side_px });
        }
        check_size(self.size_m)
    }

    /// Returns the surface with an empty picture, so that it is never searched for. It keeps its
    /// index, and the first surface remains the reference of the others.
    pub fn left_out(mut self) -> Self {
        self.artwork.fill(128);
        self
    }

    /// Converts artwork pixels (centres at integers) to metres on the surface: x right, y up,
    /// origin at the centre.
    pub fn to_metres(&self, p: Vector2<f64>) -> Vector2<f64> {
        let (w, h) = (f64::from(self.artwork.width()), f64::from(self.artwork.height()));
        Vector2::new(((p.x + 0.5) / w - 0.5) * self.size_m[0], (0.5 - (p.y + 0.5) / h) * self.size_m[1])
    }

    /// Converts a raw pixel of the configured file (artwork or photograph) to a pixel of the
    /// artwork; `None` if the photograph's lens or corners do not map it.
    pub fn artwork_pixel(&self, raw: Pixel) -> Option<Vector2<f64>> {
        let ReferenceKind::Photograph { h_photo_artwork, camera, .. } = &self.kind else { return Some(raw.0) };
        let seen = camera.undistorted_pixel(camera.unproject(raw)?);
        let flat = h_photo_artwork.try_inverse()? * seen.push(1.0);
        (flat.z.abs() > f64::EPSILON).then(|| flat.xy() / flat.z)
    }

    /// Converts an artwork pixel to a raw pixel of the configured file; `None` if the corners do
    /// not map it.
    pub fn raw_pixel(&self, p: Vector2<f64>) -> Option<Vector2<f64>> {
        let ReferenceKind::Photograph { h_photo_artwork, camera, .. } = &self.kind else { return Some(p) };
        Some(camera.project(camera.from_undistorted_pixel(Homography(*h_photo_artwork).map(p)?)).0)
    }

    /// Converts metres on the surface to artwork pixels.
    pub fn to_artwork(&self, p: Vector2<f64>) -> Vector2<f64> {
        let (w, h) = (f64::from(self.artwork.width()), f64::from(self.artwork.height()));
        Vector2::new((p.x / self.size_m[0] + 0.5) * w - 0.5, (0.5 - p.y / self.size_m[1]) * h - 0.5)
    }

    /// Returns the body point of an artwork pixel, metres.
    pub fn body_point(&self, p: Vector2<f64>) -> Point3<f64> {
        let m = self.to_metres(p);
        self.pose.transform(&Point3::from(self.shape.at([m.x, m.y]).place))
    }
}

fn check_size(size_m: [f64; 2]) -> Result<(), SurfaceError> {
    let positive = size_m.iter().all(|v| v.is_finite() && *v > 0.0);
    positive.then_some(()).ok_or(SurfaceError::Size(size_m))
}

fn check_sides(picture: &GrayImage) -> Result<(), SurfaceError> {
    let (width, height) = picture.dimensions();
    let is_small = width < TUNING.min_picture_side_px || height < TUNING.min_picture_side_px;
    if is_small { Err(SurfaceError::TooSmall { width, height, least: TUNING.min_picture_side_px }) } else { Ok(()) }
}

/// Returns the number of corners of a picture that a camera could find again, in all octaves,
/// because detail may have any size.
fn corners_to_find(picture: &GrayImage) -> usize {
    let cell_px = (picture.width().max(picture.height()) / 8).max(8);
    let options = CornerOptions { count: 4 * TUNING.min_corners, threshold: 15, least_threshold: 8, border: 5, cell_px };
    let mut corners = Vec::new();
    let mut found = 0;
    let mut octave = picture.clone();
    while octave.width() >= TUNING.min_picture_side_px / 2 && octave.height() >= TUNING.min_picture_side_px / 2 {
        detect_corners(&octave, &options, &mut CornerBuffers::default(), &mut corners);
        found += corners.iter().filter(|c| c.strength >= TUNING.min_corner_strength).count();
        octave = crate::features::halved(&octave);
    }
    found
}

fn corner_rays(photo: &GrayImage, corners: &[Pixel; 4], camera: &CameraModel) -> Result<[Normalized; 4], SurfaceError> {
    let (w, h) = (f64::from(photo.width()), f64::from(photo.height()));
    let mut rays = [Normalized(Vector2::zeros()); 4];
    for (index, (ray, corner)) in rays.iter_mut().zip(corners).enumerate() {
        let (u, v) = (corner.0.x, corner.0.y);
        let inside = (-0.5..=w - 0.5).contains(&u) && (-0.5..=h - 0.5).contains(&v);
        *ray = camera.unproject(*corner).filter(|_| inside).ok_or(SurfaceError::CornerOutside { number: index + 1, u, v })?;
    }
    Ok(rays)
}

/// Whether the corners are convex and in clockwise order as seen (y down).
fn is_convex_clockwise(p: &[Vector2<f64>; 4]) -> bool {
    (0..4).all(|k| (p[(k + 1) % 4] - p[k]).perp(&(p[(k + 2) % 4] - p[(k + 1) % 4])) > 1.0)
}

/// Returns the corners clockwise from the top left one, if that order makes a convex quadrilateral.
fn clockwise(corners: &[Pixel; 4]) -> Option<[[f64; 2]; 4]> {
    let mut around = corners.map(|c| c.0);
    let centre = around.iter().sum::<Vector2<f64>>() / 4.0;
    around.sort_by(|a, b| (a - centre).y.atan2((a - centre).x).total_cmp(&(b - centre).y.atan2((b - centre).x)));
    let first = (0..4).min_by(|a, b| around[*a].sum().total_cmp(&around[*b].sum()))?;
    around.rotate_left(first);
    is_convex_clockwise(&around).then(|| around.map(|c| [c.x, c.y]))
}

/// Resamples the photograph onto the flat rectangle.
fn rectified(photo: &GrayImage, h_photo_artwork: &Homography, camera: &CameraModel, width: u32, height: u32) -> GrayImage {
    GrayImage::from_fn(width, height, |x, y| {
        let undistorted = h_photo_artwork.map(Vector2::new(f64::from(x), f64::from(y)));
        let raw = undistorted.map(|p| camera.project(camera.from_undistorted_pixel(p)).0);
        image::Luma([raw.map_or(0, |p| cubic(photo, p))])
    })
}

/// Catmull-Rom interpolation of a picture, with the border repeated.
fn cubic(picture: &GrayImage, p: Vector2<f64>) -> u8 {
    let (i, k) = (p.x.floor(), p.y.floor());
    let (wx, wy) = (catmull_rom::weights(p.x - i), catmull_rom::weights(p.y - k));
    let (w, h) = (picture.width() as i64, picture.height() as i64);
    let mut sum = 0.0;
    for (dy, wy) in wy.iter().enumerate() {
        for (dx, wx) in wx.iter().enumerate() {
            let x = (i as i64 + dx as i64 - 1).clamp(0, w - 1) as u32;
            let y = (k as i64 + dy as i64 - 1).clamp(0, h - 1) as u32;
            sum += wx * wy * f64::from(picture.get_pixel(x, y)[0]);
        }
    }
    sum.round().clamp(0.0, 255.0) as u8
}

#[cfg(test)]
#[path = "surface_tests.rs"]
mod tests;
