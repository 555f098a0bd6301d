//! Nuke's channel file (`.chan`): one line per row of the clip that has a pose.
//!
//! `frame tx ty tz rx ry rz vfov`: the frame of the clip's picture, from 1; metres, y up; degrees
//! in Nuke's own rotation order ZXY; the vertical field of view in degrees where the lens is known.
//! The format has no header and no comments, so `docs/export.md` says what to enter in the Camera
//! node.

use std::fmt::Write;

use nalgebra::Vector3;

use super::axes::{angles_zxy, looking_back, point_y_up, y_up};
use super::film::vertical_fov;
use super::take::Take;
use crate::camera::Intrinsics;

/// Writes the camera's poses.
pub fn write(take: &Take, lens: Option<&Intrinsics>) -> String {
    let mut text = String::new();
    let mut angles = Vector3::zeros();
    for key in &take.camera {
        let p = point_y_up(&key.pose.translation);
        angles = angles_zxy(&(y_up() * looking_back(&key.pose)), &angles);
        let [x, y, z] = <[f64; 3]>::from(angles).map(f64::to_degrees);
        // Writing to a string does not fail.
        let _ = write!(text, "{}\t{:.9}\t{:.9}\t{:.9}\t{x:.9}\t{y:.9}\t{z:.9}", key.row + 1, p.x, p.y, p.z);
        let _ = match lens {
            Some(lens) => writeln!(text, "\t{:.9}", vertical_fov(lens).to_degrees()),
            None => writeln!(text),
        };
    }
    text
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, UnitQuaternion, Vector2};

    use super::*;
    use crate::export::synthetic;

    #[test]
    fn stage_corners_lie_where_the_records_have_them() {
        let take = synthetic::take();
        // The format has one focal length and no principal point.
        let lens = synthetic::centred_lens();
        let text = write(&take, Some(&lens));
        let lines: Vec<Vec<f64>> = text.lines().map(|line| line.split('\t').map(|v| v.parse().unwrap()).collect()).collect();
        assert_eq!(lines.iter().map(|line| line[0]).collect::<Vec<_>>(), [2.0, 3.0, 4.0, 5.0, 8.0, 9.0, 10.0, 11.0]);
        for (line, key) in lines.iter().zip(&take.camera) {
            let turn = |axis: Vector3<f64>, k: usize| UnitQuaternion::from_scaled_axis(axis * line[k].to_radians());
            let rotation = turn(Vector3::y(), 5) * turn(Vector3::x(), 4) * turn(Vector3::z(), 6);
            let focal = 0.5 * f64::from(lens.height) / (0.5 * line[7].to_radians()).tan();
            for corner in synthetic::corners() {
                let in_nuke = Vector3::new(corner.x, corner.z, -corner.y) - Vector3::new(line[1], line[2], line[3]);
                let p = rotation.inverse() * in_nuke;
                let [w, h] = [lens.width, lens.height].map(f64::from);
                // Nuke counts pixels from the picture's edge.
                let seen = Vector2::new(0.5 * w - focal * p.x / p.z, 0.5 * h + focal * p.y / p.z) - Vector2::new(0.5, 0.5);
                let wanted = synthetic::project(&lens, &key.pose, &Point3::from(corner));
                assert!((seen - wanted).norm() < 1e-3, "{seen} {wanted}");
            }
        }
        assert!(write(&take, None).lines().all(|line| line.split('\t').count() == 7));
    }
}
