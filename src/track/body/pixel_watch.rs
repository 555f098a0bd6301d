//! Reports what a frame's poses rest on to an observer: the pixels used, and tiles whose observed
//! place differs from the predicted one. Nothing is recorded while nobody observes.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crossbeam_channel::{Receiver, Sender};
use nalgebra::Vector2;

use crate::track::align::UsedPixel;

/// The pixels on which the poses of a frame rest.
#[derive(Debug, Clone)]
pub struct UsedPixels {
    /// Row number of the frame.
    pub sequence: u64,
    /// Pixels of all bodies that were aligned.
    pub pixels: Vec<UsedPixel>,
    /// Tiles of these bodies that fit.
    pub displaced: Vec<Displaced>,
}

/// A tile's predicted and observed place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Displaced {
    /// The centre of the tile as predicted by the pose, pixels of the frame.
    pub centre_px: Vector2<f64>,
    /// Offset of the observed from the predicted place, pixels.
    pub shift_px: Vector2<f64>,
}

/// What the last pose of one body rests on.
#[derive(Debug, Default)]
pub struct Used {
    /// Pixels that were used.
    pub pixels: Vec<UsedPixel>,
    /// Tiles that fit.
    pub displaced: Vec<Displaced>,
}

impl Used {
    /// Clears the record.
    pub fn clear(&mut self) {
        self.pixels.clear();
        self.displaced.clear();
    }
}

/// The channel to the observer.
pub struct PixelWatch {
    to: Sender<UsedPixels>,
    /// Whether pixels are wanted now; always if `None`.
    wanted: Option<Arc<AtomicBool>>,
}

impl PixelWatch {
    /// Creates the watch and the channel's receiver.
    pub fn new(wanted: Option<Arc<AtomicBool>>) -> (Self, Receiver<UsedPixels>) {
        let (to, receiver) = crossbeam_channel::unbounded();
        (Self { to, wanted }, receiver)
    }

    /// Whether pixels of the coming frame are to be recorded.
    pub fn is_wanted(&self) -> bool {
        self.wanted.as_ref().is_none_or(|wanted| wanted.load(Ordering::Relaxed))
    }

    /// Sends what was recorded of a frame, and clears it.
    pub fn show<'a>(&self, sequence: u64, noted: impl Iterator<Item = &'a mut Used>) {
        let mut shown = UsedPixels { sequence, pixels: Vec::new(), displaced: Vec::new() };
        for used in noted {
            shown.pixels.append(&mut used.pixels);
            shown.displaced.append(&mut used.displaced);
        }
        // The observer may be gone.
        let _ = self.to.send(shown);
    }
}
