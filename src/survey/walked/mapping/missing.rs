//! What to film for a better map.

use nalgebra::Vector3;

use super::stage_of_facets::shows;
use super::views::Views;
use crate::track::SurfaceSpec;

/// Minimum angle between the outermost keyframes that show a facet, degrees, sideways. Raised, good
/// walks are asked for more; lowered, facets whose depth is a guess are not named.
const MIN_ANGLE_DEG: f64 = 25.0;
/// Minimum number of keyframes that show a facet.
const MIN_VIEWS: usize = 6;
/// Maximum number of hints, the largest facets first.
const MAX_HINTS: usize = 5;

/// Returns the views that would help, a sentence for each facet that needs some. `facets` are in
/// the keyframes' frame.
pub fn missing(views: &Views<'_>, facets: &[&SurfaceSpec]) -> Vec<String> {
    let mut weak: Vec<(f64, String)> =
        facets.iter().filter_map(|facet| Some((facet.size_m[0] * facet.size_m[1], hint(views, facet)?))).collect();
    weak.sort_by(|a, b| b.0.total_cmp(&a.0));
    weak.into_iter().take(MAX_HINTS).map(|(_, text)| text).collect()
}

fn hint(views: &Views<'_>, facet: &SurfaceSpec) -> Option<String> {
    let angles: Vec<f64> = (0..views.views.len()).filter(|k| shows(views, *k, facet)).map(|k| sideways_deg(views, k, facet)).collect();
    let (left, right) = angles.iter().fold((0.0_f64, 0.0_f64), |(left, right), angle| (left.min(*angle), right.max(*angle)));
    let widest = angles.iter().copied().fold(f64::NEG_INFINITY, f64::max) - angles.iter().copied().fold(f64::INFINITY, f64::min);
    let side = if right < -left { "right" } else { "left" };
    if angles.len() < MIN_VIEWS {
        let times = if angles.len() == 1 { "1 keyframe" } else { &format!("{} keyframes", angles.len()) };
        return Some(format!("{} is shown by {times} only: film it from closer, from its left and its right", facet.name));
    }
    (widest < MIN_ANGLE_DEG).then(|| format!("{} is filmed from {widest:.0} degrees only: film it from farther to its {side}", facet.name))
}

/// Returns the angle at which a keyframe sees a facet, degrees to its right.
fn sideways_deg(views: &Views<'_>, view: usize, facet: &SurfaceSpec) -> f64 {
    let own: Vector3<f64> = facet.pose.inverse().transform(&views.views[view].pose.translation.into()).coords;
    own.x.atan2(own.z).to_degrees()
}

#[cfg(test)]
mod tests {
    use image::GrayImage;

    use super::super::super::synthetic::{LENS, camera_poses, stage};
    use super::super::growth::Lens;
    use super::super::views::View;
    use super::*;
    use crate::camera::{CameraModel, Shutter};
    use crate::light::CameraCurve;

    #[test]
    fn a_facet_seen_from_one_direction_is_named_with_the_side_to_film_from() {
        let picture = GrayImage::new(1280, 720);
        let lens = Lens { camera: CameraModel::new(LENS).unwrap(), shutter: Shutter::default(), curve: CameraCurve::default(), mask: None };
        let stage = stage();
        let facets: Vec<&SurfaceSpec> = stage[1..].iter().collect();
        let views = |from: usize, to: usize| {
            let poses = camera_poses(40)[from..to]
                .iter()
                .map(|pose| View { picture: &picture, pose: *pose, rates: [Vector3::zeros(); 2], is_anchored: true })
                .collect();
            lens.views(poses)
        };
        assert!(missing(&views(0, 40), &facets).is_empty());
        let narrow = missing(&views(28, 38), &facets);
        assert!(narrow.len() == 1 && narrow[0].starts_with("flat is filmed from") && narrow[0].contains("left"), "{narrow:?}");
        assert!(missing(&views(0, 3), &facets)[0].contains("3 keyframes"));
    }
}
