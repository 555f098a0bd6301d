//! A camera's pose from exactly three points of a body and the rays on which it sees them (P3P).
//!
//! Source: Grunert's solution as in Haralick, Lee, Ottenberg and Nölle, *Review and Analysis of
//! Solutions of the Three Point Perspective Pose Estimation Problem* (1994). Two ratios of the
//! distances to the points follow from a polynomial of degree four.

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::pose::{Body, Camera, Pose};

/// Maximum imaginary part of a root that counts as real, relative to it. Raised, poses come back
/// that do not fit; lowered, double roots are lost to rounding.
const MAX_IMAGINARY: f64 = 1e-4;
/// Minimum sine between two sides of the triangle: below it the points lie on one line.
const MIN_SINE: f64 = 1e-6;
/// Number of Newton steps that polish a root.
const POLISHING_STEPS: usize = 5;

/// Returns the up to four poses `T_camera_body` that put three points of a body on three rays.
/// `rays` are directions of unit length in camera axes. Empty for points on a line.
pub fn three_point(points: &[Vector3<f64>; 3], rays: &[Vector3<f64>; 3]) -> Vec<Pose<Camera, Body>> {
    let Some(of_points) = triangle_axes(points, MIN_SINE) else { return Vec::new() };
    let [p1, p2, p3] = points;
    let [a2, b2, c2] = [p2 - p3, p1 - p3, p1 - p2].map(|side| side.norm_squared());
    let [alpha, beta, gamma] = [rays[1].dot(&rays[2]), rays[0].dot(&rays[2]), rays[0].dot(&rays[1])];
    let (apart, both) = ((a2 - c2) / b2, (a2 + c2) / b2);
    let quartic = [
        (1.0 + apart).powi(2) - 4.0 * a2 / b2 * gamma * gamma,
        4.0 * (-apart * (1.0 + apart) * beta + 2.0 * a2 / b2 * gamma * gamma * beta - (1.0 - both) * alpha * gamma),
        2.0 * (apart * apart - 1.0 + 2.0 * apart * apart * beta * beta + 2.0 * (b2 - c2) / b2 * alpha * alpha
            - 4.0 * both * alpha * beta * gamma
            + 2.0 * (b2 - a2) / b2 * gamma * gamma),
        4.0 * (apart * (1.0 - apart) * beta - (1.0 - both) * alpha * gamma + 2.0 * c2 / b2 * alpha * alpha * beta),
        (apart - 1.0).powi(2) - 4.0 * c2 / b2 * alpha * alpha,
    ];
    let pose = |third: f64| {
        let second = ((apart - 1.0) * third * third - 2.0 * apart * beta * third + 1.0 + apart) / (2.0 * (gamma - third * alpha));
        let first_m = (b2 / (1.0 + third * third - 2.0 * third * beta)).sqrt();
        let seen = [rays[0] * first_m, rays[1] * (second * first_m), rays[2] * (third * first_m)];
        let rotation = triangle_axes(&seen, MIN_SINE)? * of_points.transpose();
        let pose = Pose::from_matrix(&rotation, seen[0] - rotation * p1);
        (second > 0.0 && third > 0.0 && pose.is_finite()).then_some(pose)
    };
    real_roots(&quartic).into_iter().filter_map(pose).collect()
}

/// Returns the axes of a triangle: along its first side, in its plane, and normal to it. `None` if
/// the sine of the angle at its first point is below `min_sine`.
pub fn triangle_axes(points: &[Vector3<f64>; 3], min_sine: f64) -> Option<Matrix3<f64>> {
    let [along, other] = [points[1] - points[0], points[2] - points[0]];
    let normal = along.cross(&other);
    // This form is also false for NaN.
    let is_wide = normal.norm() > min_sine * along.norm() * other.norm();
    let (x, z) = (along.normalize(), normal.normalize());
    is_wide.then(|| Matrix3::from_columns(&[x, z.cross(&x), z]))
}

/// Finds the real roots of a polynomial of degree four (lowest power first): eigenvalues of the
/// companion matrix, polished by Newton's method.
fn real_roots(p: &[f64; 5]) -> Vec<f64> {
    let largest = p.iter().fold(0.0_f64, |most, c| most.max(c.abs()));
    if !largest.is_finite() || p[4].abs() <= f64::EPSILON * largest {
        return Vec::new();
    }
    let mut companion = SMatrix::<f64, 4, 4>::zeros();
    for k in 0..4 {
        companion[(0, k)] = -p[3 - k] / p[4];
        if k > 0 {
            companion[(k, k - 1)] = 1.0;
        }
    }
    let Some(schur) = nalgebra::linalg::Schur::try_new(companion, 1e-14, 500) else { return Vec::new() };
    let value = |z: f64| p.iter().rev().fold(0.0, |sum, c| sum * z + c);
    let slope = |z: f64| (1..5).rev().fold(0.0, |sum, k| sum * z + k as f64 * p[k]);
    let polished = |start: f64| {
        (0..POLISHING_STEPS).fold(start, |z, _| {
            let step = value(z) / slope(z);
            if step.is_finite() { z - step } else { z }
        })
    };
    let roots = schur.complex_eigenvalues();
    roots.iter().filter(|root| root.im.abs() < MAX_IMAGINARY * (1.0 + root.re.abs())).map(|root| polished(root.re)).collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, UnitQuaternion};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    #[test]
    fn the_truth_is_among_the_poses_and_all_fit() {
        let mut random = Pcg64Mcg::seed_from_u64(3);
        let mut found = 0;
        for _ in 0..1000 {
            let mut number = |size: f64| size * random.random_range(-1.0..1.0);
            let rotation = UnitQuaternion::from_euler_angles(number(3.0), number(1.5), number(3.0));
            let truth: Pose<Camera, Body> = Pose::new(rotation, Vector3::new(number(1.0), number(1.0), 4.0 + number(1.0)));
            let points = [(); 3].map(|()| Vector3::new(number(1.0), number(1.0), number(1.0)));
            let rays = points.map(|p| truth.transform(&Point3::from(p)).coords.normalize());
            let poses = three_point(&points, &rays);
            for pose in &poses {
                for (point, ray) in points.iter().zip(&rays) {
                    assert!(pose.transform(&Point3::from(*point)).coords.normalize().angle(ray) < 1e-3);
                }
            }
            found += usize::from(poses.iter().any(|pose| pose.rotation.angle_to(&truth.rotation) < 1e-6));
        }
        // Near a double root rounding costs half of the digits.
        assert!(found > 985, "{found}");
    }

    #[test]
    fn points_on_a_line_have_no_pose() {
        let points = [0.0, 1.0, 2.0].map(|x| Vector3::new(x, 0.0, 4.0));
        assert!(three_point(&points, &points.map(|p| p.normalize())).is_empty());
        assert!(three_point(&[Vector3::zeros(); 3], &[Vector3::z(); 3]).is_empty());
        assert!(three_point(&points, &[Vector3::repeat(f64::NAN); 3]).is_empty());
    }
}
