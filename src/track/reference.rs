//! The reference pictures, prepared once at start: averaged copies of the artwork at every octave, and
//! anchors on each - places with detail in two directions, spread over the picture - at which frames are
//! registered to a fraction of a pixel.

use image::GrayImage;
use nalgebra::Vector2;

use super::rectangle::Rectangle;
use super::surface::{BodySpec, SurfaceSpec};
use crate::features::halved;
use crate::features::{CornerBuffers, CornerOptions, detect_corners};

/// A place on the artwork to register at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Anchor {
    /// Artwork pixels (of the full picture).
    pub position: Vector2<f64>,
}

/// One octave of the artwork.
#[derive(Debug, Clone)]
pub struct Octave {
    /// The picture averaged over 2^k x 2^k pixels.
    pub image: GrayImage,
    /// Anchors whose detail is of this octave's size, strongest and best spread first.
    pub anchors: Vec<Anchor>,
}

/// A surface with its octaves, full size first.
#[derive(Debug, Clone)]
pub struct PreparedSurface {
    /// What was configured.
    pub spec: SurfaceSpec,
    /// Where it is in the body.
    pub rectangle: Rectangle,
    /// Octave k is 2^k times smaller.
    pub octaves: Vec<Octave>,
}

/// A body ready for tracking.
#[derive(Debug, Clone)]
pub struct PreparedBody {
    /// Its name.
    pub name: String,
    /// Its surfaces.
    pub surfaces: Vec<PreparedSurface>,
}

/// Anchors kept per octave: more than verification asks (`FINE_ANCHORS`), as a frame may show a part of the surface. Chosen, not tuned.
/// Raised, the start takes longer; lowered, close views have few.
const ANCHORS: usize = 500;
/// Octaves end when a side falls below this many pixels: a patch with its border takes 15 of them. Raised, surfaces seen small have no
/// octave of their size; lowered, nothing is gained.
const LEAST_SIDE: u32 = 24;

impl PreparedBody {
    /// Prepares every surface of a body.
    pub fn new(spec: &BodySpec) -> Self {
        let surfaces = spec
            .surfaces
            .iter()
            .map(|s| PreparedSurface { spec: s.clone(), rectangle: Rectangle::of(s), octaves: octaves(&s.artwork) })
            .collect();
        Self { name: spec.name.clone(), surfaces }
    }
}

fn octaves(artwork: &GrayImage) -> Vec<Octave> {
    let mut all: Vec<Octave> = Vec::new();
    let mut image = artwork.clone();
    loop {
        let scale = f64::from(1u32 << all.len());
        let anchors = anchors_of(&image, scale);
        let next = halved(&image);
        all.push(Octave { image, anchors });
        if next.width() < LEAST_SIDE || next.height() < LEAST_SIDE || all.len() > 12 {
            return all;
        }
        image = next;
    }
}

fn anchors_of(image: &GrayImage, scale: f64) -> Vec<Anchor> {
    let options = CornerOptions {
        count: ANCHORS,
        threshold: 15,
        least_threshold: 5,
        border: 5,
        cell_px: (image.width().max(image.height()) / 16).max(8),
    };
    let mut corners = Vec::new();
    detect_corners(image, &options, |_, _| true, &mut CornerBuffers::default(), &mut corners);
    let place = |x: u32, y: u32| Vector2::new((f64::from(x) + 0.5) * scale - 0.5, (f64::from(y) + 0.5) * scale - 0.5);
    corners.iter().map(|c| Anchor { position: place(c.x, c.y) }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn octaves_keep_places() {
        let art = GrayImage::from_fn(401, 301, |x, y| image::Luma([if (x / 16 + y / 16) % 2 == 0 { 200 } else { 50 }]));
        let octaves = octaves(&art);
        assert_eq!(octaves[1].image.dimensions(), (200, 150));
        assert!(octaves.len() >= 4);
        // A checker's crossings are its anchors, on the octave where the detector sees them.
        let mean: u32 = octaves[1].image.iter().map(|v| u32::from(*v)).sum::<u32>() / 30_000;
        assert!((115..=135).contains(&mean));
    }
}
