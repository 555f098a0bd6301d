//! Relates two pictures step by step with the library's parts: features, matches, homography and
//! fundamental matrix. `stagepose::two_views::compare` (feature `compare`) does all of it in one
//! call, judges the result, and with a calibrated camera also finds the camera's motion.
//!
//! ```sh
//! cargo run --release --example two_pictures                # first and last frame of the fixture
//! cargo run --release --example two_pictures -- a.png b.png # your own two pictures
//! ```
//!
//! The library parts need the feature `two-views`; `capture` adds the decoders of the crate
//! `image`, for the files.

use std::error::Error;
use std::path::Path;
use std::process::ExitCode;

use stagepose::image::GrayImage;
use stagepose::two_views::features::{DetectorKind, FeatureSettings, extract};
use stagepose::two_views::geometry::{PointPair, RobustOptions, robust_fundamental, robust_homography};
use stagepose::two_views::matching::{ExactOptions, match_exactly};

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("{e}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Box<dyn Error>> {
    let frames = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dolly/frames");
    let mut given = std::env::args_os().skip(1);
    let first = given.next().map_or_else(|| frames.join("000000.jpg"), Into::into);
    let second = given.next().map_or_else(|| frames.join("000039.jpg"), Into::into);
    let [a, b] = [read(&first)?, read(&second)?];

    // Any detector works with any descriptor; `of` chooses the detector's usual one.
    let settings = FeatureSettings::of(DetectorKind::Sift);
    let features = [extract(&a, &settings), extract(&b, &settings)];
    println!("{} and {} keypoints", features[0].keypoints.len(), features[1].keypoints.len());

    // The best matches come first, which speeds up the search for a model.
    let matches = match_exactly(&features[0], &features[1], &ExactOptions::default());
    let place = |k: usize, index: u32| features[k].keypoints[index as usize].position;
    let pairs: Vec<PointPair> = matches.iter().map(|m| PointPair { from: place(0, m.first), to: place(1, m.second) }).collect();
    println!("{} matches", pairs.len());

    let options = RobustOptions { threshold: 2.0, ..RobustOptions::default() };
    match robust_homography(&pairs, &options) {
        Some(h) => println!("homography: {} matches agree, to {:.2} px{}", h.inliers.len(), h.sigma, h.model.0),
        None => println!("no homography"),
    }
    match robust_fundamental(&pairs, &options) {
        Some(f) => println!("fundamental matrix: {} matches agree, to {:.2} px{:.3e}", f.inliers.len(), f.sigma, f.model),
        None => println!("no fundamental matrix"),
    }
    Ok(())
}

fn read(file: &Path) -> Result<GrayImage, Box<dyn Error>> {
    let bytes = std::fs::read(file).map_err(|e| format!("{}: {e}", file.display()))?;
    Ok(stagepose::image::load_from_memory(&bytes).map_err(|e| format!("{}: {e}", file.display()))?.into_luma8())
}
