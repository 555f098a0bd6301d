//! Examines frames as pictures: black bars and interlacing; and tries frames mirrored, in negative
//! and without the mask.

use image::{GrayImage, imageops};

use super::finding::Finding;
use super::{Travel, Trial};
use crate::frame::Frame;
use crate::geometry::robust_kernel::median;
use crate::track::SurfaceView;
use crate::tracker::TrackerSetup;

/// Maximum grey level of a black bar, limited range included (its black is 16), and maximum
/// difference within one bar: codecs keep it flat. Raised, a dark house counts as a bar; lowered,
/// bars with a codec's noise do not.
const BLACK: u8 = 24;
const FLAT: u8 = 4;
/// Minimum fraction of a side that a bar takes. Chosen: less is an edge of a few lines that many
/// cameras have. Raised, narrow bars pass.
const MIN_BAR: f64 = 0.03;
/// Ratio of the difference between neighbouring rows to that between rows two apart, above which
/// two distant fields are interlaced; it is below 1 in a progressive picture. Chosen, not tuned.
/// Raised, only faster movement shows.
const COMBED: f64 = 1.12;
/// Shift between fields, pixels, above which a picture is interlaced. In a progressive picture it
/// is 0.03 to 0.05 by noise; with two moments it is the camera's motion between them. Raised, slow
/// movements are missed.
const FIELDS_APART_PX: f64 = 0.2;
/// Side of the blocks in which the fields are compared, pixels, and minimum number of blocks with
/// vertical edges. Chosen, not tuned. With the first raised, a block's shift scatters less, but
/// there are fewer blocks; with the second raised, pictures with few edges are not judged.
const BLOCK_PX: usize = 32;
const MIN_BLOCKS: usize = 6;
/// Minimum mean square of the horizontal gradient for a block to have vertical edges, levels
/// squared: twice that of typical noise. Raised, fewer blocks are compared; lowered, noise is.
const MIN_GRADIENT: f64 = 4.0;

/// Reports how the frames were made. Black bars are not reported if the frames are tracked: they
/// are then a dark house, or harmless.
pub fn of_frames(frames: &[Frame], is_followed: bool) -> Vec<Finding> {
    let pictures: Vec<&GrayImage> = frames.iter().map(|f| &f.image).collect();
    let mut findings = Vec::new();
    let is_combed = |p: &GrayImage| comb(p) > COMBED || fields_apart_px(p).is_some_and(|px| px > FIELDS_APART_PX);
    let combed = pictures.iter().filter(|p| is_combed(p)).count();
    if 4 * combed >= pictures.len().max(1) {
        findings.push(Finding::doubt(format!(
            "the clip is interlaced: {combed} of {} frames mix two moments; switch the camera to a progressive mode, or deinterlace \
             the clip (ffmpeg -i CLIP -vf bwdif out.y4m)",
            pictures.len()
        )));
    }
    if is_followed {
        return findings;
    }
    if let Some([before, after]) = bars(&pictures, |p, line, k| p.get_pixel(k, line)[0], |p| (p.height(), p.width())) {
        findings.push(barred(before, after, "above and below"));
    }
    if let Some([before, after]) = bars(&pictures, |p, line, k| p.get_pixel(line, k)[0], |p| (p.width(), p.height())) {
        findings.push(barred(before, after, "left and right"));
    }
    findings
}

fn barred(before: u32, after: u32, where_: &str) -> Finding {
    Finding::fault(format!(
        "the clip has black bars of {before} and {after} pixels {where_}: it was fitted into another format, so the calibration does not \
         apply; record without bars at the calibrated size"
    ))
}

/// Finds lines that are flat black at both ends in all pictures, while the middle is not. `at`
/// reads pixel `k` of a line; `sides` is the number of lines and their length.
fn bars(pictures: &[&GrayImage], at: impl Fn(&GrayImage, u32, u32) -> u8, sides: impl Fn(&GrayImage) -> (u32, u32)) -> Option<[u32; 2]> {
    let (lines, length) = sides(pictures.first()?);
    let is_bar = |line: u32| {
        let levels = || pictures.iter().flat_map(|p| (0..length).step_by(3).map(|k| at(p, line, k)));
        let (low, high) = levels().fold((255, 0), |(low, high): (u8, u8), v| (low.min(v), high.max(v)));
        high <= BLACK && high - low <= FLAT
    };
    let before = (0..lines).take_while(|line| is_bar(*line)).count() as u32;
    let after = (0..lines).rev().take_while(|line| is_bar(*line)).count() as u32;
    let least = MIN_BAR * f64::from(lines);
    let even = before.abs_diff(after) * 4 <= before.max(after);
    (before < lines && even && f64::from(before.min(after)) >= least).then_some([before, after])
}

/// Returns the mean difference of neighbouring rows relative to that of rows two apart.
fn comb(picture: &GrayImage) -> f64 {
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    if height < 8 {
        return 0.0;
    }
    let row = |y: usize| &picture.as_raw()[y * width..][..width];
    let difference = |a: &[u8], b: &[u8]| a.iter().zip(b).map(|(a, b)| u64::from(a.abs_diff(*b))).sum::<u64>();
    let (mut near, mut apart) = (0, 0);
    for y in 0..height - 2 {
        near += difference(row(y), row(y + 1));
        apart += difference(row(y), row(y + 2));
    }
    near as f64 / apart.max(1) as f64
}

/// Returns the sideways shift of the odd rows relative to the even ones, pixels: the median over
/// blocks; `None` without vertical edges.
///
/// A row shifted by u differs from the mean of its neighbours by u times the horizontal gradient;
/// in a progressive picture the difference is unrelated to the gradient. Each block's u is found by
/// least squares, with opposite signs for odd and even rows.
fn fields_apart_px(picture: &GrayImage) -> Option<f64> {
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let row = |y: usize| &picture.as_raw()[y * width..][..width];
    let mut shifts = Vec::new();
    for top in (1..height.saturating_sub(BLOCK_PX)).step_by(BLOCK_PX) {
        for left in (1..width.saturating_sub(BLOCK_PX)).step_by(BLOCK_PX) {
            let (mut by_gradient, mut gradients) = (0.0, 0.0);
            for y in top..top + BLOCK_PX {
                let (above, here, below) = (row(y - 1), row(y), row(y + 1));
                let mean = |x: usize| 0.5 * (f64::from(above[x]) + f64::from(below[x]));
                let side = if y % 2 == 0 { 1.0 } else { -1.0 };
                for (x, level) in here.iter().enumerate().skip(left).take(BLOCK_PX) {
                    let gradient = 0.5 * (mean(x + 1) - mean(x - 1));
                    by_gradient += side * (f64::from(*level) - mean(x)) * gradient;
                    gradients += gradient * gradient;
                }
            }
            if gradients > MIN_GRADIENT * (BLOCK_PX * BLOCK_PX) as f64 {
                shifts.push((by_gradient / gradients).abs());
            }
        }
    }
    median(&mut shifts).filter(|_| shifts.len() >= MIN_BLOCKS)
}

/// Finds a change with which the picture is recognised; `seen` is the number of frames that show it
/// unchanged.
pub fn of_pictures(setup: &TrackerSetup, frames: &[Frame], seen: usize) -> Vec<Finding> {
    let mut trial = Trial::of(setup);
    let mut count = |change: &dyn Fn(&GrayImage) -> GrayImage| frames.iter().filter(|f| !trial.views(&change(&f.image)).is_empty()).count();
    let is_clear = |found: usize| found > 2 * seen && 10 * found >= 3 * frames.len();
    let all = frames.len();
    let mirrored = count(&|p| imageops::flip_horizontal(p));
    if is_clear(mirrored) {
        return vec![Finding::fault(format!(
            "the clip shows the picture in mirror image (recognised in {mirrored} of {all} frames when they are mirrored): if the camera \
             mirrors, as a webcam's selfie view does, switch that off (mirror or flip) in its settings or in the recording program; if not, \
             the picture's file is mirrored: flip it left to right"
        ))];
    }
    let negative = count(&|p| {
        let mut p = p.clone();
        imageops::invert(&mut p);
        p
    });
    if is_clear(negative) {
        return vec![Finding::fault(format!(
            "the picture is a negative of what the clip shows (recognised in {negative} of {all} frames when they are inverted): invert the \
             picture's file, or switch the camera's negative effect off"
        ))];
    }
    if setup.mask.is_some() {
        let mut trial = Trial::new(setup.camera, None, &setup.stage, setup);
        let unmasked = frames.iter().filter(|f| !trial.views(&f.image).is_empty()).count();
        if is_clear(unmasked) {
            return vec![Finding::fault(format!(
                "the mask hides the stage (without it the picture is recognised in {unmasked} of {all} frames): paint white what to use \
                 and black what to ignore, or remove `mask` from the config"
            ))];
        }
    }
    Vec::new()
}

/// Minimum fraction of the poses' views that a surface should fill to be reported if no frame shows
/// it: its picture or its pose is wrong. Chosen, not tuned. Raised, fewer are reported; lowered,
/// those that only passed the edge of the picture are reported, too.
const MIN_IN_VIEW: f64 = 0.5;

/// Reports surfaces that should be in view, according to the poses from other surfaces, but are
/// neither recognised nor fit those poses. Facets of a map have no picture to be mistaken.
pub fn never_recognised(setup: &TrackerSetup, frames: &[Frame], views: &[Vec<SurfaceView>], travel: &Travel) -> Vec<Finding> {
    let is_seen = |k: usize| views.iter().flatten().any(|v| v.surface as usize == k);
    let unseen =
        setup.stage.surfaces.iter().enumerate().filter(|(k, spec)| !is_seen(*k) && !spec.is_facet() && spec.check_texture().is_ok());
    unseen
        .filter(|(_, spec)| travel.share_in_view(&setup.camera, spec) > MIN_IN_VIEW)
        // A small or stretched picture may be tracked without any feature being recognised.
        .filter(|(k, _)| Trial::of(setup).fitted(frames, *k).0 == 0)
        .map(|(_, spec)| {
            Finding::warning(format!(
                "{}: it should be in view, and is recognised in none of {} frames: check that `image` or `photo` is its picture, and its \
                 position_m and orientation",
                spec.name,
                views.len()
            ))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use image::Luma;

    use super::*;

    fn frame(picture: GrayImage) -> Frame {
        Frame { image: picture, timestamp: Default::default(), sequence: 0 }
    }

    /// Waves that move sideways with time.
    fn scene(shift: u32) -> GrayImage {
        GrayImage::from_fn(160, 120, |x, y| {
            Luma([(128.0 + 90.0 * (f64::from(x + shift) * 0.35).sin() * (f64::from(y) * 0.08).cos()) as u8])
        })
    }

    #[test]
    fn a_plain_clip_has_neither_bars_nor_combs() {
        assert!(of_frames(&[frame(scene(0)), frame(scene(9))], false).is_empty());
        assert!(of_frames(&[frame(GrayImage::new(160, 120))], false).is_empty());
        assert!(of_frames(&[], false).is_empty());
    }

    #[test]
    fn bars_are_measured() {
        let mut letterbox = GrayImage::from_pixel(160, 160, Luma([16]));
        imageops::replace(&mut letterbox, &scene(0), 0, 20);
        let said = of_frames(&[frame(letterbox.clone())], false);
        assert!(said[0].message.contains("black bars of 20 and 20 pixels above and below"), "{said:?}");
        assert!(of_frames(&[frame(letterbox)], true).is_empty());
        let mut pillarbox = GrayImage::from_pixel(200, 120, Luma([0]));
        imageops::replace(&mut pillarbox, &scene(0), 20, 0);
        assert!(of_frames(&[frame(pillarbox)], false)[0].message.contains("left and right"));
    }

    #[test]
    fn two_fields_are_a_comb() {
        let (odd, even) = (scene(0), scene(9));
        let woven = GrayImage::from_fn(160, 120, |x, y| *if y % 2 == 0 { even.get_pixel(x, y) } else { odd.get_pixel(x, y) });
        assert!(of_frames(&[frame(woven)], true)[0].message.contains("interlaced"));
    }

    #[test]
    fn a_slow_movement_is_a_comb_too() {
        let (odd, even) = (scene(0), scene(1));
        let woven = GrayImage::from_fn(160, 120, |x, y| *if y % 2 == 0 { even.get_pixel(x, y) } else { odd.get_pixel(x, y) });
        let apart = fields_apart_px(&woven).unwrap();
        assert!((0.8..1.2).contains(&apart), "{apart}");
        assert!(fields_apart_px(&odd).unwrap() < 0.02);
        assert_eq!(fields_apart_px(&GrayImage::new(160, 120)), None);
        assert_eq!(fields_apart_px(&GrayImage::new(3, 2)), None);
        assert!(of_frames(&[frame(woven)], true)[0].message.contains("interlaced"));
    }
}
