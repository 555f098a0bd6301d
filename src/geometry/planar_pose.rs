//! The two poses that a view of one plane allows.
//!
//! From afar, a plane tilted one way looks almost like the same plane tilted the other way. The
//! closed form of Collins & Bartoli ("Infinitesimal plane-based pose estimation", IJCV 2014) gives
//! both poses from the homography's first derivative at one point. Refinement and the picture
//! decide between them.

use nalgebra::{Matrix2, Matrix3, Rotation3, SMatrix, Unit, Vector2, Vector3};

use super::homography::{Homography, PointPair};
use super::pose::{Camera, Pose, SurfaceFrame};

/// Returns both poses `T_camera_surface` of a plane, better fit first; poses behind the camera are
/// left out. `metric` maps metres on the plane to normalised camera coordinates, `pairs` are in the
/// same units, and the expansion is about their centroid.
pub fn planar_poses(metric: &Homography, pairs: &[PointPair]) -> Vec<Pose<Camera, SurfaceFrame>> {
    if pairs.is_empty() {
        return Vec::new();
    }
    let centre = pairs.iter().map(|p| p.from).sum::<Vector2<f64>>() / pairs.len() as f64;
    let Some(rotations) = rotations_at(metric, centre) else { return Vec::new() };
    let mut found: Vec<(f64, Pose<Camera, SurfaceFrame>)> = rotations
        .into_iter()
        .filter_map(|r| {
            let t = translation_for(&r, pairs)?;
            let pose = Pose::from_matrix(&r, t);
            let in_front = (r * centre.push(0.0) + t).z > 0.0;
            (in_front && pose.is_finite()).then(|| (reprojection_cost(&r, &t, pairs), pose))
        })
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.into_iter().map(|(_, pose)| pose).collect()
}

/// Returns the two rotations that the map's derivative at `centre` allows.
fn rotations_at(metric: &Homography, centre: Vector2<f64>) -> Option<[Matrix3<f64>; 2]> {
    let h = metric.0;
    let w = h * centre.push(1.0);
    if w.z <= 0.0 {
        return None;
    }
    let v = w.xy() / w.z;
    let rows = h.fixed_view::<2, 2>(0, 0);
    let bottom = h.fixed_view::<1, 2>(2, 0);
    let j: Matrix2<f64> = (rows - v * bottom) / w.z;

    // Rv rotates the optical axis to the ray of the centre.
    let ray = v.push(1.0).normalize();
    let axis = Vector3::z().cross(&ray);
    let rv = match Unit::try_new(axis, 1e-12) {
        Some(axis) => Rotation3::from_axis_angle(&axis, ray.z.clamp(-1.0, 1.0).acos()).into_inner(),
        None => Matrix3::identity(),
    };
    let b: Matrix2<f64> = rv.fixed_view::<2, 2>(0, 0) - v * rv.fixed_view::<1, 2>(2, 0);
    let a = b.try_inverse()? * j;
    let aat = a * a.transpose();
    let half_difference = 0.5 * (aat[(0, 0)] - aat[(1, 1)]);
    let gamma2 = 0.5 * (aat[(0, 0)] + aat[(1, 1)]) + half_difference.hypot(aat[(0, 1)]);
    if gamma2.is_nan() || gamma2 <= 0.0 {
        return None;
    }
    let r22 = a / gamma2.sqrt();
    let rest = Matrix2::identity() - r22.transpose() * r22;
    let b0 = rest[(0, 0)].max(0.0).sqrt();
    let b1 = rest[(1, 1)].max(0.0).sqrt() * if rest[(0, 1)] < 0.0 { -1.0 } else { 1.0 };
    Some([1.0, -1.0].map(|sign| {
        let c0 = Vector3::new(r22[(0, 0)], r22[(1, 0)], sign * b0);
        let c1 = Vector3::new(r22[(0, 1)], r22[(1, 1)], sign * b1);
        rv * Matrix3::from_columns(&[c0, c1, c0.cross(&c1)])
    }))
}

/// Returns the least-squares translation for a known rotation.
fn translation_for(r: &Matrix3<f64>, pairs: &[PointPair]) -> Option<Vector3<f64>> {
    let mut ata = Matrix3::zeros();
    let mut atb = Vector3::zeros();
    for pair in pairs {
        let p = r * pair.from.push(0.0);
        // x (p.z + t.z) = p.x + t.x, and the same for y.
        let a = SMatrix::<f64, 2, 3>::new(1.0, 0.0, -pair.to.x, 0.0, 1.0, -pair.to.y);
        let b = Vector2::new(pair.to.x * p.z - p.x, pair.to.y * p.z - p.y);
        ata += a.transpose() * a;
        atb += a.transpose() * b;
    }
    Some(ata.try_inverse()? * atb)
}

fn reprojection_cost(r: &Matrix3<f64>, t: &Vector3<f64>, pairs: &[PointPair]) -> f64 {
    pairs
        .iter()
        .map(|p| {
            let c = r * p.from.push(0.0) + t;
            if c.z > 0.0 { (c.xy() / c.z - p.to).norm_squared().min(1.0) } else { 1.0 }
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    fn view(pose: &Pose<Camera, SurfaceFrame>) -> Vec<PointPair> {
        let mut pairs = Vec::new();
        for i in -4..=4 {
            for k in -3..=3 {
                let from = Vector2::new(0.5 * f64::from(i), 0.4 * f64::from(k));
                let c = pose.transform(&nalgebra::Point3::new(from.x, from.y, 0.0));
                pairs.push(PointPair { from, to: c.coords.xy() / c.z });
            }
        }
        pairs
    }

    #[test]
    fn the_true_pose_comes_first_for_many_tilts() {
        for tilt in [0.0_f64, 5.0, 20.0, 45.0, 70.0] {
            for azimuth in [0.0_f64, 60.0, 200.0] {
                let rotation = UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0)
                    * UnitQuaternion::from_euler_angles(
                        tilt.to_radians() * azimuth.to_radians().cos(),
                        tilt.to_radians() * azimuth.to_radians().sin(),
                        0.3,
                    );
                let truth = Pose::<Camera, SurfaceFrame>::new(rotation, Vector3::new(0.3, -0.2, 5.0));
                let pairs = view(&truth);
                let h = Homography::from_pairs(&pairs, None).expect("regular");
                let poses = planar_poses(&h, &pairs);
                assert!(!poses.is_empty());
                // Head-on, the tilt is the square root of a vanishing difference, so rounding
                // errors grow to their square root.
                let tolerance = if tilt < 1.0 { 5e-3 } else { 1e-5 };
                assert!(poses[0].angle_to(&truth) < tolerance, "tilt {tilt}: {}", poses[0].angle_to(&truth));
                assert!((poses[0].translation - truth.translation).norm() < 10.0 * tolerance);
                if tilt >= 20.0 {
                    assert_eq!(poses.len(), 2);
                    assert!(poses[1].angle_to(&truth) > 0.1);
                }
            }
        }
    }
}
