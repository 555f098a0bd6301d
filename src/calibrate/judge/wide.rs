//! Detects lenses that are too wide for Brown's model: fisheyes.
//!
//! Brown's polynomial in the tangent of the angle from the axis diverges where that tangent does.
//! Fitted to a fisheye it leaves rings of residuals that point alternately outwards and inwards, or
//! folds over in the corners.

use super::super::solve::Estimate;
use super::super::solve::adjust::Observation;

/// How far the boards reach, and how much of the residuals forms rings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reach {
    /// The angle from the axis that one corner in fifty exceeds, degrees.
    pub angle_deg: f64,
    /// Fraction of the squared residuals explained by the mean radial residual of each ring, 0 to
    /// 1.
    pub ringed: f64,
}

/// Number of rings with equal numbers of corners. Raised, noise explains more; lowered, a pattern
/// of several periods averages out.
const RINGS: usize = 10;
/// Minimum number of corners per ring for its mean to be significant. Raised, small sets are not
/// checked.
const MIN_A_RING: usize = 12;
/// Angle from the axis, degrees, above which a lens is very wide: 90 degrees in total. Raised,
/// fisheyes with the board only in the middle are not reported; lowered, ordinary wide lenses are
/// suspected.
pub(super) const WIDE_DEG: f64 = 45.0;
/// Fraction of the squared residuals in rings above which the model does not fit. Noise of as many
/// corners explains a hundredth. Raised, fisheyes pass; lowered, bent boards are taken for them.
pub(super) const RINGED: f64 = 0.1;

/// Measures the residuals of all corners; `None` if there are too few. Residuals are capped at the
/// largest of the used corners: beyond a fold of the polynomial they are as large as the picture
/// and in arbitrary directions, and would hide the pattern.
pub(super) fn reach(observations: &[Vec<Observation>], estimate: &Estimate) -> Option<Reach> {
    let bundle = &estimate.bundle;
    let centre = bundle.lens.0.fixed_rows::<2>(2).into_owned();
    let residual = |view: usize, o: &Observation| bundle.residual(view, o);
    let used = observations.iter().enumerate().flat_map(|(view, seen)| {
        let of_view = seen.iter().zip(&estimate.used[view]).filter(|(_, used)| **used);
        of_view.filter_map(move |(o, _)| residual(view, o))
    });
    let farthest = used.map(|r| r.norm()).fold(0.0, f64::max);
    let mut corners: Vec<(f64, f64, f64)> = Vec::new();
    for (view, seen) in observations.iter().enumerate() {
        let pose = bundle.poses.get(view)?;
        for o in seen {
            let at = pose.rotation * nalgebra::Vector3::new(o.board_m.x, o.board_m.y, 0.0) + pose.translation;
            let (Some(residual), outwards) = (residual(view, o), o.pixel - centre) else { continue };
            let residual = residual.cap_magnitude(farthest);
            let radial = outwards.try_normalize(1e-6).map_or(0.0, |unit| residual.dot(&unit));
            corners.push((at.xy().norm().atan2(at.z).to_degrees(), radial, residual.norm_squared()));
        }
    }
    if corners.len() < RINGS * MIN_A_RING {
        return None;
    }
    corners.sort_by(|a, b| a.0.total_cmp(&b.0));
    let all: f64 = corners.iter().map(|(.., squared)| squared).sum();
    let in_rings = corners.chunks(corners.len().div_ceil(RINGS)).map(|ring| {
        let sum: f64 = ring.iter().map(|(_, radial, _)| radial).sum();
        sum * sum / ring.len() as f64
    });
    Some(Reach { angle_deg: corners[corners.len() * 49 / 50].0, ringed: in_rings.sum::<f64>() / all.max(1e-12) })
}
