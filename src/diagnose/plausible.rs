//! Checks what no picture shows and no rule forbids: states sizes, distances and speeds in words,
//! and warns of values that are absurd for a stage.
//!
//! A picture shows shape, never scale: a stage whose size is given in millimetres tracks as well as
//! one in metres, a thousand times too large.

use nalgebra::Vector3;

use super::finding::{Finding, list, written};
use crate::camera::{CameraModel, Normalized, Shutter};
use crate::frame::Timestamp;
use crate::geometry::robust_kernel::median;
use crate::geometry::{Camera, Pose, Stage};
use crate::track::{BodySpec, SurfaceSpec};

/// Plausible sides of a surface, metres: from a postage stamp to an opera's cyclorama. Wider, wrong
/// units pass.
const SIDES_M: std::ops::RangeInclusive<f64> = 0.02..=60.0;
/// Maximum distance of a surface from the first one, in metres and in sizes of the larger. Chosen:
/// larger than stages are. Raised, wrong units pass.
const FARTHEST_M: f64 = 60.0;
const FARTHEST_SIZES: f64 = 20.0;
/// Maximum distance from which a camera tracks a stage, metres (chosen: a stadium's far side).
/// Raised, wrong units pass.
const MAX_DISTANCE_M: f64 = 150.0;
/// Maximum speed of a camera, metres per second, a sprinter's: no dolly, crane or runner is faster
/// on a stage; a camera on a wire may be. Raised, sizes that are too large pass.
const MAX_SPEED: f64 = 12.0;
/// Maximum tangential distortion of a real lens: more moves the picture's corner by percents.
/// Raised, calibrations from too few views pass.
const MAX_TANGENTIAL: f64 = 0.02;

/// Minimum cosine of a surface's angle to the camera, and minimum shorter side in pixels, for it to
/// be expected in view: below 60 px it counts as too small for a pose, and a third more is safe.
/// Lowered, surfaces are reported that could not be seen.
const MIN_FACING: f64 = 0.4;
const MIN_SIDE_PX: f64 = 80.0;

/// Formats lengths as if they had been meant in other units.
fn in_other_units(values: &[f64]) -> String {
    let tenth = |by: f64| list(&values.iter().map(|v| v / by).collect::<Vec<_>>());
    format!("{} if those are millimetres, {} if centimetres", tenth(1000.0), tenth(100.0))
}

/// Formats a length or speed for a sentence: tenths, or hundredths below one.
fn in_words(value: f64) -> String {
    if value < 1.0 { format!("{value:.2}") } else { format!("{value:.1}") }
}

/// Checks the sizes and positions of a body's surfaces, in metres.
pub fn of_layout(body: &BodySpec) -> Vec<Finding> {
    let mut findings = Vec::new();
    let Some(first) = body.surfaces.first() else { return findings };
    for surface in &body.surfaces {
        let [w, h] = surface.size_m;
        if !SIDES_M.contains(&w) || !SIDES_M.contains(&h) {
            findings.push(Finding::doubt(format!(
                "{}: {} m wide and {} m high is absurd for a stage; size_m is in metres: write size_m = {}",
                surface.name,
                written(w),
                written(h),
                in_other_units(&[w, h])
            )));
        }
        let apart = surface.pose.translation - first.pose.translation;
        let largest = w.max(h).max(first.size_m[0]).max(first.size_m[1]);
        if apart.norm() > FARTHEST_M || apart.norm() > FARTHEST_SIZES * largest {
            let p = surface.pose.translation;
            findings.push(Finding::doubt(format!(
                "{}: it stands {} m away from {}; position_m is in metres: write position_m = {}",
                surface.name,
                written(apart.norm()),
                first.name,
                in_other_units(&[p.x, p.y, p.z])
            )));
        }
    }
    findings
}

/// Checks the distortion of a lens; its other parameters were checked when they were read
/// (`camera::plausible`).
pub fn of_lens(camera: &CameraModel) -> Vec<Finding> {
    let mut findings = Vec::new();
    let [k1, k2, p1, p2, k3] = camera.intrinsics().distortion;
    if p1.abs().max(p2.abs()) > MAX_TANGENTIAL {
        findings.push(Finding::doubt(format!(
            "the calibration's tangential distortion p1 = {}, p2 = {} is larger than that of any lens; distortion is [k1, k2, p1, p2, \
             k3]: if your numbers are in the order k1, k2, k3, p1, p2, write distortion = {}",
            written(p1),
            written(p2),
            list(&[k1, k2, p2, k3, p1])
        )));
    }
    findings
}

/// Checks the shutter's times against the clip's frame interval.
pub fn of_shutter(shutter: &Shutter, frame_s: f64) -> Vec<Finding> {
    let long = |key: &str, value: f64| {
        (value > 1.1 * frame_s).then(|| {
            Finding::doubt(format!(
                "{key} = {} is longer than the {:.1} ms between two frames; it is in seconds: write {key} = {} if {} is milliseconds, else 0.0",
                written(value),
                frame_s * 1e3,
                written(value * 1e-3),
                written(value)
            ))
        })
    };
    [long("exposure_s", shutter.exposure_s), long("readout_s", shutter.readout_s)].into_iter().flatten().collect()
}

/// The camera's path: poses with their stamps.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Travel {
    poses: Vec<(Timestamp, Pose<Stage, Camera>)>,
}

impl Travel {
    /// Adds a pose.
    pub fn add(&mut self, timestamp: Timestamp, pose: &Pose<Stage, Camera>) {
        self.poses.push((timestamp, *pose));
    }

    /// Returns the pose at an instant, if one was added for it.
    pub fn pose_at(&self, timestamp: Timestamp) -> Option<&Pose<Stage, Camera>> {
        self.poses.iter().find(|(at, _)| *at == timestamp).map(|(_, pose)| pose)
    }

    /// Returns the minimum and maximum distance from a point, metres.
    fn distances(&self, place: &Vector3<f64>) -> Option<[f64; 2]> {
        let all = || self.poses.iter().map(|(_, pose)| (pose.translation - place).norm());
        Some([all().reduce(f64::min)?, all().reduce(f64::max)?])
    }

    /// Returns the speed that a twentieth of the steps exceed, metres per second, over steps of a
    /// tenth of a second, which keeps noise small.
    fn speed(&self) -> Option<f64> {
        let mut speeds = Vec::new();
        let mut from = *self.poses.first()?;
        for (stamp, pose) in &self.poses {
            let dt_s = stamp.seconds_since(from.0);
            if dt_s >= 0.1 {
                if dt_s < 0.3 {
                    speeds.push((pose.translation - from.1.translation).norm() / dt_s);
                }
                from = (*stamp, *pose);
            }
        }
        speeds.sort_by(f64::total_cmp);
        speeds.get((speeds.len() * 95 / 100).min(speeds.len().saturating_sub(1))).copied()
    }

    /// Returns the fraction of the poses in which a surface's centre is in the picture, its face is
    /// turned to the camera, and it is not tiny.
    pub fn share_in_view(&self, camera: &CameraModel, surface: &SurfaceSpec) -> f64 {
        let (centre, normal) = (surface.pose.translation, surface.pose.rotation * Vector3::z());
        let side_m = surface.size_m[0].min(surface.size_m[1]);
        let is_in_view = |pose: &Pose<Stage, Camera>| {
            let away = pose.translation - centre;
            let seen = pose.inverse().transform(&centre.into());
            let pixel = camera.project(Normalized(seen.coords.xy() / seen.z)).0;
            let is_inside = (0.0..f64::from(camera.width())).contains(&pixel.x) && (0.0..f64::from(camera.height())).contains(&pixel.y);
            let side_px = camera.intrinsics().fx * side_m / away.norm();
            seen.z > 0.0 && is_inside && normal.dot(&away) > MIN_FACING * away.norm() && side_px > MIN_SIDE_PX
        };
        let in_view = self.poses.iter().filter(|(_, pose)| is_in_view(pose)).count();
        in_view as f64 / self.poses.len().max(1) as f64
    }

    /// Returns the camera's median roll about its line of sight, degrees, over poses that do not
    /// look straight up or down.
    pub fn roll_deg(&self) -> Option<f64> {
        let roll = |pose: &Pose<Stage, Camera>| {
            let (right, down, ahead) = (pose.rotation * Vector3::x(), pose.rotation * Vector3::y(), pose.rotation * Vector3::z());
            (ahead.z.abs() < 0.8).then(|| right.z.atan2(-down.z).to_degrees())
        };
        let mut rolls: Vec<f64> = self.poses.iter().filter_map(|(_, pose)| roll(pose)).collect();
        // Plus and minus half a turn are the same.
        rolls.iter_mut().filter(|r| **r < -150.0).for_each(|r| *r += 360.0);
        median(&mut rolls)
    }

    /// States size, distance and speed in words, and what is absurd about them.
    pub fn findings(&self, stage: &BodySpec) -> Vec<Finding> {
        let Some(first) = stage.surfaces.first() else { return Vec::new() };
        let [w, h] = first.size_m;
        let mut words = format!("by size_m, {} is {} m wide and {} m high", first.name, written(w), written(h));
        let mut findings = Vec::new();
        if let Some([near, far]) = self.distances(&first.pose.translation) {
            words += &match far - near < 0.1 * far {
                true => format!("; the camera is {} m away", in_words(far)),
                false => format!("; the camera is {} to {} m away", in_words(near), in_words(far)),
            };
            if far > MAX_DISTANCE_M {
                findings.push(Finding::doubt(format!(
                    "the camera is {far:.0} m away from the stage, which is absurd; check that size_m is in metres: write size_m = {}",
                    in_other_units(&[w, h])
                )));
            }
        }
        if let Some(speed) = self.speed() {
            words += &format!(" and moves at up to {} m/s", in_words(speed));
            if speed > MAX_SPEED {
                findings.push(Finding::doubt(format!(
                    "the camera moves at {speed:.0} m/s, too fast for a stage camera; check that size_m is in metres (size_m = {}), and \
                     the clip's stamps or --fps",
                    in_other_units(&[w, h])
                )));
            }
        }
        words += ": if that is wrong, size_m is not in metres or belongs to another picture";
        findings.push(Finding::note(words));
        findings
    }
}

#[cfg(test)]
mod tests {
    use image::GrayImage;
    use nalgebra::UnitQuaternion;

    use super::super::finding::Grade;
    use super::*;
    use crate::camera::Intrinsics;
    use crate::track::{ReferenceKind, SurfaceShape};

    fn surface(size_m: [f64; 2], position: [f64; 3]) -> SurfaceSpec {
        let pose = Pose::new(UnitQuaternion::identity(), position.into());
        SurfaceSpec {
            name: "a.png".to_owned(),
            artwork: GrayImage::new(4, 3),
            size_m,
            pose,
            kind: ReferenceKind::Artwork,
            shape: SurfaceShape::Flat,
            doubt: crate::track::SurfaceDoubt::default(),
            transfer: crate::light::Transfer::default(),
        }
    }

    fn stage(surfaces: Vec<SurfaceSpec>) -> BodySpec {
        BodySpec::new("stage", surfaces)
    }

    #[test]
    fn millimetres_are_absurd_and_a_postcard_is_not() {
        assert!(of_layout(&stage(vec![surface([0.1, 0.135], [0.0; 3]), surface([40.0, 12.0], [3.0, 8.0, 0.0])])).is_empty());
        let findings = of_layout(&stage(vec![surface([100.0, 135.0], [0.0; 3])]));
        assert!(
            findings[0].message.contains("write size_m = [0.1, 0.135] if those are millimetres, [1.0, 1.35] if centimetres"),
            "{findings:?}"
        );
        let findings = of_layout(&stage(vec![surface([4.0, 3.0], [0.0; 3]), surface([1.0, 2.0], [950.0, -800.0, 0.0])]));
        assert!(findings[0].message.contains("position_m = [0.95, -0.8, 0.0] if those are millimetres"), "{findings:?}");
    }

    fn lens(fx: f64, cx: f64, distortion: [f64; 5]) -> CameraModel {
        CameraModel::new(Intrinsics { width: 640, height: 480, fx, fy: fx, cx, cy: 239.5, skew: 0.0, distortion }).unwrap()
    }

    #[test]
    fn implausible_lenses_are_reported() {
        assert!(of_lens(&lens(600.0, 319.5, [-0.3, 0.1, 0.001, -0.002, 0.0])).is_empty());
        let said = |lens: &CameraModel| of_lens(lens).pop().map(|f| f.message).unwrap_or_default();
        let swapped = said(&lens(600.0, 319.5, [-0.3, 0.1, 0.05, 0.001, -0.002]));
        assert!(swapped.contains("distortion = [-0.3, 0.1, 0.001, -0.002, 0.05]"), "{swapped}");
    }

    #[test]
    fn shutter_times_longer_than_a_frame_are_reported() {
        assert!(of_shutter(&Shutter { exposure_s: 0.01, readout_s: 0.03 }, 1.0 / 30.0).is_empty());
        assert!(
            of_shutter(&Shutter { exposure_s: 0.5, readout_s: 0.0 }, 1.0 / 30.0)[0]
                .message
                .contains("write exposure_s = 0.0005 if 0.5 is milliseconds")
        );
    }

    #[test]
    fn implausible_distance_speed_and_roll_are_reported() {
        let mut travel = Travel::default();
        for k in 0..60_i64 {
            // Looking upstage, upside down, moving sideways at 30 m/s.
            let level = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
            let turned = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::PI) * level;
            travel.add(Timestamp::from_ns(k * 33_333_333), &Pose::new(turned, Vector3::new(k as f64, -40.0, 0.0)));
        }
        assert!((travel.roll_deg().unwrap().abs() - 180.0).abs() < 1.0, "{:?}", travel.roll_deg());
        let findings = travel.findings(&stage(vec![surface([10.0, 13.5], [0.0; 3])]));
        assert!(findings[0].message.contains("moves at 30 m/s") && findings[0].grade == Grade::Doubt, "{findings:?}");
        assert!(findings[1].message.contains("10.0 m wide and 13.5 m high; the camera is 40.0 to"), "{findings:?}");
    }

    #[test]
    fn only_surfaces_facing_the_camera_are_expected_in_view() {
        let mut travel = Travel::default();
        let level = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
        travel.add(Timestamp::default(), &Pose::new(level, Vector3::new(0.0, -4.0, 0.0)));
        let standing = |rotation: f64, position: [f64; 3]| {
            let upright = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
            let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rotation) * upright;
            travel.share_in_view(
                &lens(600.0, 319.5, [0.0; 5]),
                &SurfaceSpec { pose: Pose::new(rotation, position.into()), ..surface([1.0, 1.0], [0.0; 3]) },
            )
        };
        assert_eq!(standing(0.3, [0.5, 0.0, 0.5]), 1.0);
        let hidden = [(0.0, [9.0, 0.0, 0.0]), (0.0, [0.0, -8.0, 0.0]), (std::f64::consts::PI, [0.0; 3]), (0.0, [0.0, 30.0, 0.0])];
        assert!(hidden.iter().all(|(rotation, position)| standing(*rotation, *position) == 0.0));
    }
}
