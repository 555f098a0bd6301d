//! The two cameras and the points that both see, from above and from the side.

use nalgebra::Vector3;

use crate::compare::Comparison;
use crate::geometry::relative_pose::RayPair;
use crate::geometry::triangulation::depths;
use crate::html_page::svg::Drawing;

/// Side of each of the two views, figure units.
const SIDE: f64 = 400.0;
/// Fraction of the points, nearest first, that the drawing is scaled to. Raised, a few far points
/// shrink the rest to a dot.
const SHOWN: f64 = 0.95;

/// Draws the figure; `None` unless the motion has a direction.
pub(super) fn figure(made: &Comparison) -> Option<String> {
    let camera_move = made.camera_move.as_ref()?;
    let motion = camera_move.motion()?;
    let inliers = &made.essential.as_ref()?.inliers;
    let rays = made.rays.as_ref()?;
    let seen = |k: &usize| {
        let pair: &RayPair = &rays[*k];
        depths(&motion, pair).filter(|(first, second)| *first > 0.0 && *second > 0.0).map(|(first, _)| pair.first.push(1.0) * first)
    };
    let points: Vec<Vector3<f64>> = inliers.iter().filter_map(seen).collect();
    let second = -(motion.rotation.inverse() * motion.direction);
    let mut reach: Vec<f64> = points.iter().map(|p| p.amax()).collect();
    reach.sort_by(f64::total_cmp);
    let most = reach.get((SHOWN * reach.len() as f64) as usize).or(reach.last()).copied().unwrap_or(1.0).max(1.5);
    let mut drawing = Drawing::new(2.0 * SIDE, SIDE);
    // From above: x right, z up the page. From the side: z right, y down the page.
    let place = |view: usize, p: &Vector3<f64>| {
        let scale = SIDE / (2.2 * most);
        match view {
            0 => [SIDE / 2.0 + scale * p.x, SIDE * 0.9 - scale * 1.6 * p.z],
            _ => [SIDE * 1.1 + scale * 1.6 * p.z, SIDE / 2.0 + scale * p.y],
        }
    };
    for view in 0..2 {
        for p in points.iter().filter(|p| p.amax() <= most) {
            drawing.circle(place(view, p), 1.2, "none", "var(--pale)", 0.0);
        }
        let cameras = [
            (Vector3::zeros(), nalgebra::UnitQuaternion::identity(), "var(--blue)"),
            (second, motion.rotation.inverse(), "hsl(30 90% 50%)"),
        ];
        for (centre, rotation, colour) in cameras {
            let corner = |x: f64, y: f64| centre + rotation * (Vector3::new(x, y, 1.2) * 0.12 * most);
            for (x, y) in [(-0.7, -0.5), (0.7, -0.5), (0.7, 0.5), (-0.7, 0.5)] {
                drawing.line(place(view, &centre), place(view, &corner(x, y)), colour, 1.2);
            }
            let rim: Vec<[f64; 2]> =
                [(-0.7, -0.5), (0.7, -0.5), (0.7, 0.5), (-0.7, 0.5)].iter().map(|(x, y)| place(view, &corner(*x, *y))).collect();
            drawing.path(&rim, true, colour, "none", 1.2);
        }
        drawing.text([SIDE * (0.02 + view as f64), 14.0], 12.0, "start", "var(--ink)", ["from above", "from the side"][view]);
    }
    Some(drawing.finish("The two cameras and the points that both see"))
}
