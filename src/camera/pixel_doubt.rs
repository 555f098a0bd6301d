//! Effect of lens uncertainty on a pixel: one column of shifts for each error mode of the lens.

use nalgebra::SMatrix;

use super::doubt::{LENS_WAYS, LensDoubt};
use super::model::{CameraModel, Normalized};

impl CameraModel {
    /// Returns the pixel's shift for one sigma of each lens error mode, one per column; `None`
    /// without lens uncertainty.
    pub fn pixel_doubt(&self, normalized: Normalized) -> Option<SMatrix<f64, 2, LENS_WAYS>> {
        let LensDoubt { uncertainty: u, has_square_pixels } = self.doubt()?;
        let (i, n) = (self.intrinsics(), normalized.0);
        let [k1, k2, p1, p2, k3] = u.distortion;
        let three_sigma = [u.focal_px[0], u.focal_px[1], u.centre_px[0], u.centre_px[1], u.skew, k1, k2, p1, p2, k3];
        let mut ways = i.by_numbers(n, i.distort(n).0);
        ways.column_iter_mut().zip(three_sigma).for_each(|(mut by_number, uncertainty)| by_number *= uncertainty / 3.0);
        // If the aspect ratio is not known to be 1, this equals two independent focal lengths.
        let against = if has_square_pixels { 0.0 } else { std::f64::consts::FRAC_1_SQRT_2 };
        let [by_fx, by_fy] = [0, 1].map(|k| ways.column(k).into_owned());
        ways.set_column(0, &(by_fx + by_fy));
        ways.set_column(1, &((by_fx - by_fy) * against));
        Some(ways)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::super::doubt::IntrinsicsUncertainty;
    use super::super::model::Intrinsics;
    use super::*;

    #[test]
    fn each_uncertainty_mode_moves_the_pixel_as_stated() {
        let i = Intrinsics {
            width: 640,
            height: 480,
            fx: 600.0,
            fy: 580.0,
            cx: 310.0,
            cy: 250.0,
            skew: 0.002,
            distortion: [-0.2, 0.1, 0.001, -0.002, 0.03],
        };
        let u = IntrinsicsUncertainty {
            focal_px: [6.0, 3.0],
            centre_px: [9.0, 12.0],
            skew: 0.003,
            distortion: [0.03, 0.06, 0.003, 0.006, 0.09],
        };
        let camera = CameraModel::new(i).unwrap().with_doubt(Some(LensDoubt { uncertainty: u, has_square_pixels: false }));
        let n = Normalized(Vector2::new(0.31, -0.22));
        let columns = camera.pixel_doubt(n).unwrap();
        let at = camera.project(n).0;
        let moved = |change: &dyn Fn(&mut Intrinsics)| {
            let mut other = i;
            change(&mut other);
            CameraModel::new(other).unwrap().project(n).0 - at
        };
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let ways: [&dyn Fn(&mut Intrinsics); LENS_WAYS] = [
            &|i| (i.fx, i.fy) = (i.fx + 2.0, i.fy + 1.0),
            &|i| (i.fx, i.fy) = (i.fx + 2.0 * half, i.fy - half),
            &|i| i.cx += 3.0,
            &|i| i.cy += 4.0,
            &|i| i.skew += 0.001,
            &|i| i.distortion[0] += 0.01,
            &|i| i.distortion[1] += 0.02,
            &|i| i.distortion[2] += 0.001,
            &|i| i.distortion[3] += 0.002,
            &|i| i.distortion[4] += 0.03,
        ];
        for (k, way) in ways.iter().enumerate() {
            assert!((columns.column(k) - moved(way)).norm() < 1e-9, "{k}: {} {}", columns.column(k), moved(way));
        }
    }

    #[test]
    fn lens_uncertainty_scales_with_the_picture_or_is_absent() {
        let camera = CameraModel::pinhole(640, 480, 600.0, 600.0, 319.5, 239.5).unwrap();
        assert_eq!(camera.pixel_doubt(Normalized(Vector2::new(0.1, 0.1))), None);
        let uncertainty = IntrinsicsUncertainty { focal_px: [6.0; 2], centre_px: [3.0; 2], ..Default::default() };
        let camera = camera.with_doubt(LensDoubt::of_calibration(Some(uncertainty)));
        let half = camera.scaled_to(320, 240).unwrap().doubt().unwrap();
        assert_eq!((half.uncertainty.focal_px[0], half.uncertainty.centre_px[1]), (3.0, 1.5));
        assert_eq!(LensDoubt::of_calibration(Some(IntrinsicsUncertainty::default())), None);
    }
}
