//! The start of the adjustment: Zhang's closed form for the focal lengths, and a planar pose for
//! every view.
//!
//! Each view's homography constrains the image of the absolute conic (Zhang, "A flexible new
//! technique for camera calibration", PAMI 2000). With the principal point at the picture's centre
//! and no skew, two linear unknowns remain, 1/fx² and 1/fy². If the views do not determine even
//! those, a ladder of focal lengths is tried.

use nalgebra::{Matrix2, Matrix3, Vector2};

use super::adjust::{BoardFrame, Bundle, Loss, Observation};
use super::lens::{FreeNumbers, Held, LENS_NUMBERS, Lens};
use crate::geometry::homography::{Homography, PointPair};
use crate::geometry::planar_pose::planar_poses;
use crate::geometry::{Camera, Pose};

/// Focal lengths tried, in picture widths, from a wide lens (80 degrees across) to a long one (10
/// degrees). Each is about 1.4 to 2 times the previous one, near enough for the adjustment to
/// converge from one of them. More steps only take longer.
const LADDER: [f64; 6] = [0.6, 0.85, 1.2, 1.8, 3.0, 6.0];

/// Returns the best start for these views; `held` has the values of parameters that are not
/// estimated. `None` if a view has no pose.
pub fn start(views: &[Vec<Observation>], size: (u32, u32), free: &FreeNumbers, held: &Held) -> Option<Bundle> {
    let width = f64::from(size.0.max(size.1));
    let mut best: Option<(f64, Bundle)> = None;
    let enough = {
        let corners: usize = views.iter().map(Vec::len).sum();
        corners as f64 * (width / 640.0).powi(2)
    };
    let zhang = focal_lengths(views, size, held);
    let ladder = LADDER.iter().map(|f| [f * width; 2]);
    for focal in zhang.into_iter().chain(ladder) {
        let Some(mut bundle) = posed(views, lens_with(focal, size, free, held)) else { continue };
        let scale = 2.0 * width / 640.0;
        let cost = bundle.adjust(views, free, Loss::Cauchy(scale), 25);
        let sound = bundle.lens.0[0] > 0.0 && bundle.lens.0[1] > 0.0 && cost.is_finite();
        if sound && best.as_ref().is_none_or(|(kept, _)| cost < *kept) {
            best = Some((cost, bundle));
        }
        // Below a pixel per corner, this must be the right minimum.
        if best.as_ref().is_some_and(|(cost, _)| *cost < enough) {
            break;
        }
    }
    best.map(|(_, bundle)| bundle)
}

/// Returns the starting lens: the focal lengths, the picture's centre, no distortion, and any held
/// values.
fn lens_with(focal: [f64; 2], size: (u32, u32), free: &FreeNumbers, held: &Held) -> Lens {
    let mut lens = Lens::pinhole(focal, centre(size));
    if free.square_pixels && free.free[0] {
        (lens.0[0], lens.0[1]) = (0.5 * (focal[0] + focal[1]), 0.5 * (focal[0] + focal[1]));
    }
    for (k, value) in held.iter().enumerate() {
        if let Some(value) = value.filter(|_| !free.free[k]) {
            lens.0[k] = value;
        }
    }
    lens
}

/// Returns the centre of a picture, pixels.
pub fn centre((width, height): (u32, u32)) -> [f64; 2] {
    [0.5 * (f64::from(width) - 1.0), 0.5 * (f64::from(height) - 1.0)]
}

/// Returns Zhang's focal lengths with two unknowns, then with one for both axes, as far as they are
/// plausible.
fn focal_lengths(views: &[Vec<Observation>], size: (u32, u32), held: &Held) -> Vec<[f64; 2]> {
    let middle = centre(size);
    let at = |k: usize| held[2 + k].unwrap_or(middle[k]);
    let shift = Matrix3::new(1.0, 0.0, -at(0), 0.0, 1.0, -at(1), 0.0, 0.0, 1.0);
    let (mut two, mut two_right) = (Matrix2::zeros(), Vector2::zeros());
    let (mut one, mut one_right) = (0.0, 0.0);
    for view in views {
        let pairs: Vec<PointPair> = view.iter().map(|o| PointPair { from: o.board_m, to: o.pixel }).collect();
        let Some(h) = Homography::from_pairs(&pairs, None).map(|h| shift * h.0) else { continue };
        // The square's sides are perpendicular in space, and so are its diagonals.
        let scale = h.column(0).norm().max(h.column(1).norm());
        let (s, d) = ((h.column(0) + h.column(1)) / scale, (h.column(0) - h.column(1)) / scale);
        for (u, v) in [(h.column(0) / scale, h.column(1) / scale), (s, d)] {
            let row = Vector2::new(u.x * v.x, u.y * v.y);
            let right = -u.z * v.z;
            two += row * row.transpose();
            two_right += row * right;
            one += (row.x + row.y).powi(2);
            one_right += (row.x + row.y) * right;
        }
    }
    let width = f64::from(size.0.max(size.1));
    let plausible = |f: f64| (0.15 * width..40.0 * width).contains(&f);
    let both = two.try_inverse().map(|inverse| inverse * two_right).map(|w| [1.0 / w.x.sqrt(), 1.0 / w.y.sqrt()]);
    let single = (one / one_right).sqrt();
    let both = both.filter(|f| f.iter().all(|&f| plausible(f)) && (0.6..1.7).contains(&(f[0] / f[1])));
    both.into_iter().chain(plausible(single).then_some([single; 2])).collect()
}

/// Finds a pose for every view with a given lens: of the two that a plane allows, the one that fits
/// better.
fn posed(views: &[Vec<Observation>], lens: Lens) -> Option<Bundle> {
    let poses = views.iter().map(|view| pose_of(view, &lens));
    Some(Bundle { lens, poses: poses.collect::<Option<Vec<_>>>()? })
}

/// Finds the pose of one view with a known lens.
pub fn pose_of(view: &[Observation], lens: &Lens) -> Option<Pose<Camera, BoardFrame>> {
    let n = &lens.0;
    let model = lens.model(1, 1).ok()?;
    let normalised = |o: &Observation| {
        let ray = model.unproject(crate::camera::Pixel(o.pixel));
        // Outside the lens's valid range, the pinhole model alone is good enough for a start.
        ray.map_or_else(|| Vector2::new((o.pixel.x - n[2]) / n[0], (o.pixel.y - n[3]) / n[1]), |ray| ray.0)
    };
    let pairs: Vec<PointPair> = view.iter().map(|o| PointPair { from: o.board_m, to: normalised(o) }).collect();
    let metric = Homography::from_pairs(&pairs, None)?;
    let held = FreeNumbers { free: [false; LENS_NUMBERS], square_pixels: false };
    let one_view = [view.to_vec()];
    let refined = planar_poses(&metric, &pairs).into_iter().map(|pose| {
        // The board's plane plays the role of the surface's plane; only the frame names differ.
        let mut bundle = Bundle { lens: *lens, poses: vec![pose.renamed()] };
        let cost = bundle.adjust(&one_view, &held, Loss::Squares, 15);
        (cost, bundle.poses[0])
    });
    refined.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, pose)| pose)
}
