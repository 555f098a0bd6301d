//! Runs the tracker in your own camera loop: your code supplies the frames, the tracker runs in
//! your thread, and you handle the frames that it refuses.
//!
//! A virtual stage replaces the camera here, and provides the true pose for comparison. This needs
//! only the core and the feature `simulate`: no files, no sockets, and no threads except the
//! workers inside a frame.
//!
//! ```sh
//! cargo run --example own_camera_loop --no-default-features --features simulate
//! ```

use std::error::Error;

use image::GrayImage;
use stagepose::{Dolly, Frame, FrameError, Renderer, Timestamp, Tracker, TrackerSetup, VirtualStage, dolly};

const FRAMES: u64 = 30;
const FRAMES_PER_SECOND: f64 = 30.0;

/// Your camera. It delivers frame 10 as a thumbnail, and frame 20 with the stamp of frame 19.
fn grab(camera: &Renderer, sequence: u64) -> Frame {
    let time_s = sequence as f64 / FRAMES_PER_SECOND;
    let image = if sequence == 10 { GrayImage::new(160, 120) } else { camera.render(time_s, sequence) };
    let stamp_s = if sequence == 20 { 19.0 / FRAMES_PER_SECOND } else { time_s };
    Frame::new(image, Timestamp::from_seconds(stamp_s), sequence)
}

fn main() -> Result<(), Box<dyn Error>> {
    let stage: VirtualStage = dolly(Dolly { width: 640, height: 480, seed: 1, duration_s: 2.0, artwork_width: 1200 })?;
    // With a real camera, fill in TrackerSetup yourself: the calibration, the surfaces of the stage
    // and their pictures.
    let setup = TrackerSetup::from(&stage);
    let camera = Renderer::new(stage);

    let mut tracker = Tracker::new(setup)?;
    let mut worst_mm: f64 = 0.0;
    for sequence in 0..FRAMES {
        let frame = grab(&camera, sequence);
        let sample = match tracker.track(&frame) {
            Ok(sample) => sample,
            // The tracker ignores a refused frame; continue with the next one.
            Err(e @ (FrameError::Size { .. } | FrameError::Stamp { .. })) => {
                println!("frame {sequence:2} refused: {e}");
                continue;
            }
            Err(e) => return Err(e.into()),
        };
        let Some(measured) = &sample.measurement else {
            println!("frame {sequence:2} {}", sample.state.word());
            continue;
        };
        let truth = camera.stage().truth(sequence as f64 / FRAMES_PER_SECOND);
        let error_mm = 1e3 * (measured.pose.translation - truth.translation).norm();
        let [x, y, z]: [f64; 3] = measured.pose.translation.into();
        println!("frame {sequence:2} {} at [{x:.4}, {y:.4}, {z:.4}] m, {error_mm:.2} mm off", sample.state.word());
        worst_mm = worst_mm.max(error_mm);
    }
    println!("the worst error is {worst_mm:.2} mm");
    Ok(())
}
