//! Pose covariance from the stated uncertainty of the surfaces' corners and places.
//!
//! Corners are read off a photograph, and places of surfaces are measured: each number may be off
//! by its sigma. To first order the pose then shifts by the least-squares answer to the pixels'
//! shifts, as for a wrong lens ([`lens_doubt`](super::lens_doubt)).

use nalgebra::{Matrix6, SMatrix, SVector, Vector3};

use crate::camera::CameraModel;
use crate::geometry::covariance::covariance_of_inverse;
use crate::geometry::resection::{MovingCamera, residual_and_jacobian};
use crate::geometry::{Body, Camera, Pose, skew};
use crate::track::patches::fitted_anchor::FittedAnchor;
use crate::track::scene::reference::PreparedSurface;

/// Ways in which a surface may be off: two numbers of each corner, its position, and its direction.
const SURFACE_WAYS: usize = 8 + 3 + 3;

/// Returns the covariance of [δp, δθ] of `T_body_camera`, body axes, from uncertain corners and
/// places of the surfaces; `None` if nothing is uncertain.
pub fn covariance_by_surfaces(
    t_body_camera: &Pose<Body, Camera>,
    camera: &CameraModel,
    surfaces: &[PreparedSurface],
    anchors: &[FittedAnchor],
) -> Option<Matrix6<f64>> {
    if surfaces.iter().all(|surface| surface.spec.doubt.is_none()) {
        return None;
    }
    let pose = t_body_camera.inverse();
    let still = MovingCamera::still(camera);
    let rotation = pose.rotation_matrix();
    let mut normal = Matrix6::zeros();
    let mut right = vec![SMatrix::<f64, 6, SURFACE_WAYS>::zeros(); surfaces.len()];
    for anchor in anchors {
        let o = &anchor.observation;
        let Some((_, j)) = residual_and_jacobian(&pose, &still, o) else { continue };
        let weighted = j.transpose() * o.information;
        normal += weighted * j;
        let surface = &surfaces[anchor.surface as usize];
        let (spec, doubt) = (&surface.spec, &surface.spec.doubt);
        if doubt.is_none() {
            continue;
        }
        // A moved point appears where a camera that moved with it would see it: the first three
        // columns.
        let by_point = weighted * (j.fixed_columns::<3>(0) * rotation);
        let own = &mut right[anchor.surface as usize];
        if let Some(corners) = &surface.corner_ways {
            let by_picture = by_point * spec.pose.rotation_matrix();
            for (k, shift) in corners.shifts(spec.to_metres(anchor.artwork)).into_iter().enumerate() {
                let mut column = own.column_mut(k);
                column += by_picture * shift.push(0.0);
            }
        }
        let mut moved = own.fixed_columns_mut::<3>(8);
        moved += by_point * doubt.position_m;
        let from_centre: Vector3<f64> = o.point.coords - spec.pose.translation;
        let mut rotated = own.fixed_columns_mut::<3>(11);
        rotated += -by_point * skew(&from_centre) * doubt.rotation_rad;
    }
    let factor = normal.cholesky()?;
    let mut covariance = Matrix6::zeros();
    for way in right.iter().flat_map(|own| own.column_iter()) {
        let step: SVector<f64, 6> = factor.solve(&way.into_owned());
        covariance += step * step.transpose();
    }
    let covariance = covariance_of_inverse(&pose, &covariance);
    covariance.iter().all(|v| v.is_finite()).then_some(covariance)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Vector2, Vector6};

    use super::*;
    use crate::camera::Pixel;
    use crate::geometry::resection::{Observation, resect};
    use crate::track::scene::surface::SurfaceSpec;
    use crate::track::synthetic::{cloth, facing, lens, prepared, seen_anchors};

    fn photographed(corners: [Vector2<f64>; 4]) -> SurfaceSpec {
        let photo = cloth(1).artwork;
        SurfaceSpec::from_photograph(
            "photo".into(),
            &photo,
            corners.map(Pixel),
            CameraModel::pinhole(640, 480, 640.0, 640.0, 319.5, 239.5).unwrap(),
            [4.0, 3.0],
            Pose::identity(),
        )
        .expect("a surface")
    }

    const CORNERS: [[f64; 2]; 4] = [[60.0, 50.0], [570.0, 70.0], [560.0, 420.0], [80.0, 440.0]];

    /// The error of the pose that the configured surface yields when the real one is seen.
    fn off(configured: &SurfaceSpec, real: &SurfaceSpec, pose: &Pose<Camera, Body>) -> Vector6<f64> {
        let camera = lens(640, 480);
        let (configured, real) = (prepared(vec![configured.clone()]), prepared(vec![real.clone()]));
        let mut anchors = seen_anchors(&real, pose, &camera, 8, |_, _| Vector2::zeros());
        for anchor in &mut anchors {
            // The same detail of the photograph.
            let raw = real.surfaces[0].spec.raw_pixel(anchor.artwork).expect("it is in the photograph");
            let artwork = configured.surfaces[0].spec.artwork_pixel(Pixel(raw)).expect("it is on the surface");
            anchor.observation.point = configured.surfaces[0].spec.body_point(artwork);
        }
        let observations: Vec<Observation> = anchors.iter().map(|anchor| anchor.observation).collect();
        let found = resect(pose, &MovingCamera::still(&camera), &observations, 30).expect("a pose").pose.inverse();
        let truth = pose.inverse();
        let (moved, rotated) = (found.translation - truth.translation, (found.rotation * truth.rotation.inverse()).scaled_axis());
        Vector6::new(moved.x, moved.y, moved.z, rotated.x, rotated.y, rotated.z)
    }

    #[test]
    fn corner_uncertainty_sums_the_effect_of_each_corner() {
        let corners = CORNERS.map(Vector2::from);
        let (configured, pose) = (photographed(corners), facing(0.1, -0.2, Vector3::new(0.2, 0.05, 5.0)));
        let mut scatter = Matrix6::zeros();
        for k in 0..8 {
            let mut real = corners;
            real[k / 2][k % 2] += 0.1;
            let step = off(&configured, &photographed(real), &pose) * 10.0;
            scatter += step * step.transpose();
        }
        let body = prepared(vec![configured]);
        let anchors = seen_anchors(&body, &pose, &lens(640, 480), 8, |_, _| Vector2::zeros());
        let found = covariance_by_surfaces(&pose.inverse(), &lens(640, 480), &body.surfaces, &anchors).expect("corners are in doubt");
        assert!((found - scatter).norm() < 0.05 * scatter.norm(), "{found}{scatter}");
    }

    #[test]
    fn position_uncertainty_carries_over_to_the_pose() {
        let mut spec = cloth(1);
        (spec.doubt.position_m, spec.doubt.rotation_rad) = (0.004, 0.0);
        let (body, pose) = (prepared(vec![spec]), facing(0.1, -0.2, Vector3::new(0.2, 0.05, 5.0)));
        let anchors = seen_anchors(&body, &pose, &lens(640, 480), 8, |_, _| Vector2::zeros());
        let found = covariance_by_surfaces(&pose.inverse(), &lens(640, 480), &body.surfaces, &anchors).expect("the place is in doubt");
        let right = Matrix6::from_diagonal(&Vector6::new(1.6e-5, 1.6e-5, 1.6e-5, 0.0, 0.0, 0.0));
        assert!((found - right).norm() < 1e-3 * right.norm(), "{found}");
    }

    #[test]
    fn flat_artwork_alone_has_no_uncertainty() {
        let (body, pose) = (prepared(vec![cloth(1)]), facing(0.1, -0.2, Vector3::new(0.2, 0.05, 5.0)));
        let anchors = seen_anchors(&body, &pose, &lens(640, 480), 8, |_, _| Vector2::zeros());
        assert_eq!(covariance_by_surfaces(&pose.inverse(), &lens(640, 480), &body.surfaces, &anchors), None);
    }
}
