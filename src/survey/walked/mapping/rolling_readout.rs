//! The readout of a rolling shutter that nothing configures, as the walk's points show it.
//!
//! Within a frame only the product of readout and rates is seen: how far the rows are sheared. The
//! poses of the frames before and after tell the rates without it. So the points are adjusted with
//! an assumed readout, and it is off by the factor between both. Where frames are too slow for a
//! shaking hand, the factor errs, but the shear, on which the map depends, does not.

use nalgebra::Vector6;

use super::bundle::{Cloud, row};
use super::views::Views;
use crate::frame::Timestamp;
use crate::survey::shutter::ShutterTime;
use crate::track::agreement::{AgreementBuffers, FrameValue};

/// The readout that is assumed first, seconds.
pub const ASSUMED_S: f64 = 0.015;
/// Maximum time between two frames, seconds: longer ones tell nothing of a hand's motion.
const MAX_STEP_S: f64 = 0.2;
/// Minimum number of frames that tell it. Raised, short walks are taken with a global shutter.
const MIN_FRAMES: usize = 12;
/// Minimum readout, seconds, and minimum share of sigmas: less is a global shutter.
const MIN_S: f64 = 1.5e-3;
const MIN_SIGMAS: f64 = 5.0;
/// Maximum sigma, seconds: a walk that knows it no better tells nothing.
const MAX_SIGMA_S: f64 = 3e-3;

/// Returns the readout of a cloud that was adjusted with an assumed one, if it rolls; `stamps` are
/// those of the views.
pub fn readout(views: &Views<'_>, cloud: &Cloud, stamps: &[Timestamp]) -> Option<ShutterTime> {
    let mut products = vec![[0.0; 2]; cloud.poses.len()];
    let by_poses: Vec<Option<Vector6<f64>>> = (0..stamps.len()).map(|k| rates_by_poses(cloud, stamps, k)).collect();
    for (point, seen) in cloud.points.iter().flat_map(|point| point.sightings.iter().map(move |seen| (point, seen))) {
        let (Some(by_poses), Some(row)) = (by_poses[seen.view], row(views, cloud, &point.place, seen)) else { continue };
        let [velocity, angular_velocity] = cloud.rates[seen.view];
        let found = Vector6::from_fn(|k, _| if k < 3 { velocity[k] } else { angular_velocity[k - 3] });
        let [found, expected] = [found, by_poses].map(|rates| row.by_pose * rates * row.delay_s);
        products[seen.view][0] += found.dot(&expected);
        products[seen.view][1] += expected.norm_squared();
    }
    let told: Vec<FrameValue> = products
        .iter()
        .filter(|[_, squared]| *squared > 0.0)
        .map(|[product, squared]| FrameValue::new(views.shutter.readout_s * product / squared, views.shutter.readout_s.powi(2) / squared))
        .collect();
    if told.len() < MIN_FRAMES {
        return None;
    }
    let agreed = AgreementBuffers::default().agreement(&told);
    tracing::debug!(?agreed, "readout by the points");
    let is_rolling = agreed.value.abs() > MIN_S.max(MIN_SIGMAS * agreed.sigma) && agreed.sigma < MAX_SIGMA_S;
    is_rolling.then_some(ShutterTime { seconds: agreed.value, sigma_s: agreed.sigma, frames: agreed.frames })
}

/// Returns the rates of a view by the poses before and after it: of the parabola through all three.
fn rates_by_poses(cloud: &Cloud, stamps: &[Timestamp], k: usize) -> Option<Vector6<f64>> {
    let step = |to: usize| {
        let (pose, dt_s) = (cloud.poses.get(to)?, stamps.get(to)?.seconds_since(stamps[k]).abs());
        let [shift, rotation] = cloud.poses[k].step_to(pose);
        let step = Vector6::from_fn(|axis, _| if axis < 3 { shift[axis] } else { rotation[axis - 3] });
        (dt_s > 0.0 && dt_s < MAX_STEP_S).then_some((step, dt_s))
    };
    let ((back, before_s), (on, after_s)) = (step(k.checked_sub(1)?)?, step(k + 1)?);
    Some((on * (before_s / after_s) - back * (after_s / before_s)) / (before_s + after_s))
}

#[cfg(test)]
mod tests {
    use image::GrayImage;
    use nalgebra::{UnitQuaternion, Vector3};

    use super::super::super::synthetic::LENS;
    use super::super::bundle::CloudPoint;
    use super::super::growth::Lens;
    use super::super::tracks::Sighting;
    use super::super::views::View;
    use super::*;
    use crate::camera::{CameraModel, Shutter};
    use crate::geometry::{Body, Camera, Pose};
    use crate::light::CameraCurve;

    /// A camera that sways before points, ten frames a second, and the cloud that an assumed
    /// readout gives where `readout_s` is the real one.
    fn found(readout_s: f64) -> Option<ShutterTime> {
        let picture = GrayImage::new(LENS.width, LENS.height);
        let pose = |t: f64| -> Pose<Body, Camera> {
            let (sway, turn) = (0.05 * (3.0 * t).sin(), 0.04 * (2.0 * t).cos());
            Pose::new(UnitQuaternion::from_scaled_axis(Vector3::new(turn, -turn, 0.0)), Vector3::new(0.5 * t + sway, sway, -3.0))
        };
        let times: Vec<f64> = (0..30).map(|k| 0.1 * f64::from(k)).collect();
        let poses: Vec<_> = times.iter().map(|t| pose(*t)).collect();
        // Only the product of readout and rates is seen.
        let share = readout_s / ASSUMED_S;
        let rates: Vec<_> = times.iter().map(|t| pose(*t).step_to(&pose(t + 1e-4)).map(|step| step / 1e-4 * share)).collect();
        let shutter = Shutter { readout_s: ASSUMED_S, ..Shutter::default() };
        let lens = Lens { camera: CameraModel::new(LENS).unwrap(), shutter, curve: CameraCurve::default(), mask: None };
        let view = |(pose, rates): (&Pose<Body, Camera>, &_)| View { picture: &picture, pose: *pose, rates: *rates, is_anchored: false };
        let views = lens.views(poses.iter().zip(&rates).map(view).collect());
        let point = |k: usize| {
            let place = Vector3::new(0.3 * (k % 9) as f64 - 0.5, 0.25 * (k / 9) as f64 - 1.0, 0.1 * (k % 4) as f64);
            let seen = (0..poses.len()).filter_map(|view| Some((view, views.pixel(view, &place)?)));
            let sightings = seen.map(|(view, pixel)| Sighting { view, feature: k, pixel, sigma_px: 0.5 }).collect();
            CloudPoint { place, sightings }
        };
        let cloud = Cloud { points: (0..81).map(point).collect(), poses: poses.clone(), rates: rates.clone(), scale: 1.0 };
        readout(&views, &cloud, &times.iter().map(|t| Timestamp::from_seconds(*t)).collect::<Vec<_>>())
    }

    #[test]
    fn a_readout_is_told_by_shear_and_poses_and_a_global_shutter_has_none() {
        for real in [0.012, 0.025, -0.008] {
            let found = found(real).expect("it rolls");
            assert!((found.seconds / real - 1.0).abs() < 0.03 && found.frames > 20, "{real}: {found:?}");
        }
        assert_eq!(found(0.0), None);
        assert_eq!(found(4e-4), None);
    }
}
