//! The virtual stage as a source of frames, used by the demo and the tests.

use super::{ClipEntry, EntryContent, FrameSource};
use crate::frame::{Frame, Timestamp};
use crate::geometry::{Camera, Pose, Stage};
use crate::simulate::{Renderer, VirtualStage};

/// A camera in front of a virtual stage: a fixed number of frames at a constant rate, the first one
/// at time 0.
#[derive(Debug)]
pub struct VirtualCamera {
    renderer: Renderer,
    fps: f64,
    frames: u64,
    next: u64,
}

impl VirtualCamera {
    /// Prepares `frames` frames of a stage at `fps` frames per second (above 0).
    pub fn new(stage: VirtualStage, fps: f64, frames: u64) -> Self {
        Self { renderer: Renderer::new(stage), fps, frames, next: 0 }
    }

    /// Returns the stage in front of it.
    pub fn stage(&self) -> &VirtualStage {
        self.renderer.stage()
    }

    /// Returns the stamp of a frame; frame 0 is at 0.
    pub fn timestamp(&self, sequence: u64) -> Timestamp {
        Timestamp::from_ns((sequence as f64 * 1e9 / self.fps).round() as i64)
    }

    /// Returns the exact `T_stage_camera` at the stamp of a frame.
    pub fn truth(&self, sequence: u64) -> Pose<Stage, Camera> {
        self.stage().truth(self.time_s(sequence))
    }

    /// Returns the stamp in seconds, from the rounded nanoseconds, so that picture, truth and stamp
    /// agree exactly.
    fn time_s(&self, sequence: u64) -> f64 {
        self.timestamp(sequence).seconds()
    }
}

impl FrameSource for VirtualCamera {
    fn next_entry(&mut self) -> Option<ClipEntry> {
        let sequence = self.next;
        if sequence >= self.frames {
            return None;
        }
        self.next += 1;
        let timestamp = self.timestamp(sequence);
        let image = self.renderer.render(self.time_s(sequence), sequence);
        // Rendering stands for the world, not for decoding, so it does not count as decoding time.
        let content = EntryContent::Frame(Frame { image, timestamp, sequence });
        Some(ClipEntry::new(sequence, timestamp, content))
    }

    fn size(&self) -> (u32, u32) {
        (self.stage().camera.width(), self.stage().camera.height())
    }

    fn rows(&self) -> Option<u64> {
        Some(self.frames)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::{Dolly, dolly};

    #[test]
    fn frames_come_in_order_at_the_rate_and_then_end() {
        let scene = dolly(Dolly { width: 40, height: 30, seed: 1, duration_s: 0.1, artwork_width: 60 }).unwrap();
        let mut camera = VirtualCamera::new(scene, 30.0, 3);
        assert_eq!((camera.size(), camera.rows()), ((40, 30), Some(3)));
        for (sequence, timestamp) in [0, 33_333_333, 66_666_667].map(Timestamp::from_ns).into_iter().enumerate() {
            let sequence = sequence as u64;
            let row = camera.next_entry().unwrap();
            assert_eq!((row.sequence, row.timestamp), (sequence, timestamp));
            let EntryContent::Frame(frame) = row.content else { panic!("the virtual stage has a picture for every row") };
            assert_eq!((frame.sequence, frame.timestamp, frame.image.dimensions()), (sequence, timestamp, (40, 30)));
            assert_eq!(camera.truth(sequence), camera.stage().truth(timestamp.seconds()));
        }
        assert_eq!(camera.next_entry(), None);
    }
}
