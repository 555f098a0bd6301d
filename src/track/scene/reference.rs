//! Prepares the reference pictures once at start: averaged copies of the artwork at every octave,
//! and anchors on each. Anchors are places with detail in two directions, spread over the picture,
//! at which frames are registered to a fraction of a pixel.

use crate::track::scene::tuning::TUNING;
use image::GrayImage;
use nalgebra::Vector2;

use super::corner_ways::CornerWays;
use super::rectangle::Rectangle;
use super::repetition::periods;
use super::surface::{BodySpec, SurfaceSpec};
use crate::features::{CornerBuffers, CornerOptions, detect_corners};
use crate::light::Transfer;
use crate::light::square_root::halved_in_light;

/// A place on the artwork at which frames are registered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Anchor {
    /// Pixels of the full-size artwork.
    pub position: Vector2<f64>,
}

/// One octave of the artwork.
#[derive(Debug, Clone)]
pub struct Octave {
    /// The picture averaged over 2^k x 2^k pixels.
    pub image: GrayImage,
    /// Anchors whose detail has this octave's size, strongest and best spread first; empty until
    /// they are found or taken from a cache.
    pub anchors: Vec<Anchor>,
}

/// A surface with its octaves, full size first.
#[derive(Debug, Clone)]
pub struct PreparedSurface {
    /// The configured surface.
    pub spec: SurfaceSpec,
    /// Where it is in the body.
    pub rectangle: Rectangle,
    /// Octave k is 2^k times smaller.
    pub octaves: Vec<Octave>,
    /// Shifts by which its picture repeats itself, artwork pixels; see [`periods`].
    pub periods: Vec<Vector2<f64>>,
    /// How its picture moves if its corners are off; `None` if they are certain.
    pub corner_ways: Option<CornerWays>,
    /// Whether no anchor of it counts: it no longer stands in its place.
    pub is_left_out: bool,
}

/// A body ready for tracking.
#[derive(Debug, Clone)]
pub struct PreparedBody {
    /// Its name.
    pub name: String,
    /// Its surfaces.
    pub surfaces: Vec<PreparedSurface>,
}

impl PreparedBody {
    /// Prepares every surface of a body, without the anchors.
    pub fn new(spec: &BodySpec) -> Self {
        let prepared = |s: &SurfaceSpec| {
            let octaves = octaves(&s.artwork, s.transfer);
            PreparedSurface {
                spec: s.clone(),
                rectangle: Rectangle::of(s),
                periods: periods(octaves.iter().map(|octave| &octave.image)),
                octaves,
                corner_ways: CornerWays::of(s),
                is_left_out: false,
            }
        };
        Self { name: spec.name.clone(), surfaces: spec.surfaces.iter().map(prepared).collect() }
    }

    /// Adds the anchors of its pictures.
    pub fn with_anchors(mut self) -> Self {
        for surface in &mut self.surfaces {
            surface.take_anchors(surface.find_anchors());
        }
        self
    }
}

impl PreparedSurface {
    /// Finds the anchors of its picture, octave by octave.
    pub fn find_anchors(&self) -> Vec<Vec<Anchor>> {
        let mut buffers = CornerBuffers::default();
        (0..).zip(&self.octaves).map(|(k, octave)| anchors_of(&octave.image, k, &mut buffers)).collect()
    }

    /// Sets the anchors, octave by octave.
    pub fn take_anchors(&mut self, anchors: Vec<Vec<Anchor>>) {
        self.octaves.iter_mut().zip(anchors).for_each(|(octave, own)| octave.anchors = own);
    }
}

fn octaves(artwork: &GrayImage, transfer: Transfer) -> Vec<Octave> {
    let images = std::iter::successors(Some(artwork.clone()), |image| Some(halved_in_light(image, transfer)));
    images.take(octave_count(artwork.dimensions())).map(|image| Octave { image, anchors: Vec::new() }).collect()
}

/// Returns the number of octaves of a picture of this size, at least one.
pub fn octave_count((width, height): (u32, u32)) -> usize {
    (1..TUNING.max_octaves).find(|k| width.min(height) >> k < TUNING.min_octave_side_px).unwrap_or(TUNING.max_octaves)
}

fn anchors_of(image: &GrayImage, octave: usize, buffers: &mut CornerBuffers) -> Vec<Anchor> {
    let options = CornerOptions {
        count: TUNING.max_octave_anchors,
        threshold: 15,
        least_threshold: 5,
        border: TUNING.anchor_border_px,
        cell_px: (image.width().max(image.height()) / 16).max(8),
    };
    let mut corners = Vec::new();
    detect_corners(image, &options, buffers, &mut corners);
    corners.iter().map(|c| Anchor::at([c.x, c.y], octave)).collect()
}

impl Anchor {
    /// Creates the anchor at a pixel of an octave.
    pub fn at(pixel: [u32; 2], octave: usize) -> Self {
        let scale = f64::from(1u32 << octave);
        Self { position: Vector2::from(pixel.map(|v| (f64::from(v) + 0.5) * scale - 0.5)) }
    }

    /// Returns its pixel in that octave.
    pub fn pixel(&self, octave: usize) -> [u32; 2] {
        let scale = f64::from(1u32 << octave);
        [self.position.x, self.position.y].map(|v| ((v + 0.5) / scale) as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn octaves_keep_positions() {
        let art = GrayImage::from_fn(401, 301, |x, y| image::Luma([if (x / 16 + y / 16) % 2 == 0 { 200 } else { 50 }]));
        let octaves = octaves(&art, Transfer::default());
        assert_eq!(octaves[1].image.dimensions(), (200, 150));
        assert_eq!(octaves.len(), octave_count(art.dimensions()));
        assert!(
            octaves.len() >= 4
                && octaves
                    .last()
                    .is_some_and(|last| (TUNING.min_octave_side_px..2 * TUNING.min_octave_side_px).contains(&last.image.height()))
        );
        assert_eq!(Anchor::at([7, 9], 3).pixel(3), [7, 9]);
        // A checker's crossings are its anchors, on the octave where the detector sees them.
        let mean: u32 = octaves[1].image.iter().map(|v| u32::from(*v)).sum::<u32>() / 30_000;
        assert!((115..=135).contains(&mean));
    }
}
