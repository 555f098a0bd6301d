//! Surfaces and bodies: the textured rectangles that the camera is compared with.
//!
//! A [`SurfaceSpec`] is one flat picture of known size, placed in the frame of its body. A body (the
//! stage, or a tracked object) is a rigid set of them. A photograph becomes artwork once, at load: the
//! part between its four corners is undistorted and laid flat, so that everything behind this file sees
//! one kind of picture.

use image::GrayImage;
use nalgebra::{Matrix3, Point3, Vector2};
use thiserror::Error;

use crate::camera::CameraModel;
use crate::geometry::{Body, Pose, ReferenceCamera, SurfaceFrame};

/// One textured rectangle of a body, ready for tracking.
#[derive(Debug, Clone)]
pub struct SurfaceSpec {
    /// What to call it in messages (the picture's file name).
    pub name: String,
    /// The flat artwork as grey levels; for a photograph, its rectified part.
    pub artwork: GrayImage,
    /// Width and height in metres between the artwork's outer edges.
    pub size_m: [f64; 2],
    /// `T_body_surface`: where the surface stands in its body.
    pub pose: Pose<Body, SurfaceFrame>,
    /// Where the artwork came from; decides the reference camera and the pixels `homography` starts from.
    pub kind: ReferenceKind,
}

/// Whether a surface was given as flat artwork or as a photograph.
#[derive(Debug, Clone)]
pub enum ReferenceKind {
    /// Flat artwork: its own pixels are the reference pixels.
    Artwork,
    /// A photograph of the surface.
    Photograph {
        /// Maps artwork pixels (of [`SurfaceSpec::artwork`]) to undistorted pixels of the photograph.
        photo_from_artwork: Matrix3<f64>,
        /// The camera that took it.
        camera: CameraModel,
        /// `T_reference_surface`: the surface as that camera saw it, from its four corners.
        pose: Pose<ReferenceCamera, SurfaceFrame>,
    },
}

/// The stage, or a tracked object: a rigid body made of surfaces.
#[derive(Debug, Clone)]
pub struct BodySpec {
    /// `stage`, or the object's name.
    pub name: String,
    /// Its surfaces; at least one.
    pub surfaces: Vec<SurfaceSpec>,
}

/// Why a picture cannot be tracked.
#[derive(Debug, Clone, PartialEq, Error)]
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
        /// The least side.
        least: u32,
    },
    /// The picture has nothing to hold on to.
    #[error(
        "the picture has too little texture: {found} distinct corners were found, at least {least} are needed; use a picture with more detail"
    )]
    Textureless {
        /// Corners found.
        found: usize,
        /// Corners needed.
        least: usize,
    },
    /// The four corners do not make a convex quadrilateral, clockwise from the top left.
    #[error("corners_px is not a convex quadrilateral; give top left, top right, bottom right, bottom left, clockwise in the photograph")]
    Corners,
    /// A corner lies where the photograph's calibration cannot be inverted, or outside of the photograph.
    #[error("corner {index} at [{u}, {v}] lies outside of the photograph or of its calibration's valid field")]
    CornerOutside {
        /// 0-based.
        index: usize,
        /// Pixel column.
        u: f64,
        /// Pixel row.
        v: f64,
    },
}

impl SurfaceSpec {
    /// Artwork pixels (centres at integers) to metres on the surface: x right, y up, origin at the centre.
    pub fn metres_from_artwork(&self, p: Vector2<f64>) -> Vector2<f64> {
        let (w, h) = (f64::from(self.artwork.width()), f64::from(self.artwork.height()));
        Vector2::new(((p.x + 0.5) / w - 0.5) * self.size_m[0], (0.5 - (p.y + 0.5) / h) * self.size_m[1])
    }

    /// Metres on the surface to artwork pixels.
    pub fn artwork_from_metres(&self, p: Vector2<f64>) -> Vector2<f64> {
        let (w, h) = (f64::from(self.artwork.width()), f64::from(self.artwork.height()));
        Vector2::new((p.x / self.size_m[0] + 0.5) * w - 0.5, (0.5 - p.y / self.size_m[1]) * h - 0.5)
    }

    /// An artwork pixel as a point of the body, metres.
    pub fn body_point(&self, p: Vector2<f64>) -> Point3<f64> {
        let m = self.metres_from_artwork(p);
        self.pose.transform(&Point3::new(m.x, m.y, 0.0))
    }
}
