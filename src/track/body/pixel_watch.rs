//! What a frame's poses rest on, for whoever watches: pixels, and where tiles lie instead of where the pose puts them. Nothing is noted while nobody
//! does.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crossbeam_channel::{Receiver, Sender};
use nalgebra::Vector2;

use crate::track::align::UsedPixel;

/// The pixels that the poses of a frame rest on.
#[derive(Debug, Clone)]
pub struct UsedPixels {
    /// Row number of the frame.
    pub sequence: u64,
    /// Of all bodies that were aligned.
    pub pixels: Vec<UsedPixel>,
    /// The same, tile by tile: those that fit.
    pub displaced: Vec<Displaced>,
}

/// A tile that the frame shows elsewhere than the pose puts it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Displaced {
    /// Where the pose puts its middle, pixels of the frame.
    pub centre_px: Vector2<f64>,
    /// How far from there the frame shows it, pixels.
    pub shift_px: Vector2<f64>,
}

/// What the last pose of one body rests on.
#[derive(Debug, Default)]
pub struct Used {
    /// Pixels that were asked.
    pub pixels: Vec<UsedPixel>,
    /// Tiles that fit.
    pub displaced: Vec<Displaced>,
}

impl Used {
    /// It rests on nothing.
    pub fn clear(&mut self) {
        self.pixels.clear();
        self.displaced.clear();
    }
}

/// Who is shown them.
pub struct PixelWatch {
    to: Sender<UsedPixels>,
    /// Whether they are wanted now; always where there is none.
    wanted: Option<Arc<AtomicBool>>,
}

impl PixelWatch {
    /// With the channel that they come through.
    pub fn new(wanted: Option<Arc<AtomicBool>>) -> (Self, Receiver<UsedPixels>) {
        let (to, receiver) = crossbeam_channel::unbounded();
        (Self { to, wanted }, receiver)
    }

    /// Before a frame: whether its pixels are to be noted.
    pub fn is_wanted(&self) -> bool {
        self.wanted.as_ref().is_none_or(|wanted| wanted.load(Ordering::Relaxed))
    }

    /// After a frame: shows what was noted, and forgets it.
    pub fn show<'a>(&self, sequence: u64, noted: impl Iterator<Item = &'a mut Used>) {
        let mut shown = UsedPixels { sequence, pixels: Vec::new(), displaced: Vec::new() };
        for used in noted {
            shown.pixels.append(&mut used.pixels);
            shown.displaced.append(&mut used.displaced);
        }
        // Nobody may be watching any more.
        let _ = self.to.send(shown);
    }
}
