//! Expresses the calibration in OpenTrackIO's terms: millimetres on a sensor instead of pixels.
//!
//! A webcam's sensor size is rarely known, and only ratios matter to a renderer: a width is
//! assumed, and the height follows so that both focal lengths hold. With F the focal length in mm
//! and OpenCV's k and p: radial l1..l6 = k1/F², k4/F², k2/F⁴, k5/F⁴, k3/F⁶, k6/F⁶, tangential q =
//! p/F (the published p/F² contradicts the model's own equations), model "Brown-Conrady U-D".

use serde_json::{Value, json};

use crate::camera::CameraModel;

/// Which field holds the principal point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PrincipalPoint {
    /// `projectionOffset`, as in the standard.
    Projection,
    /// Also `distortionOffset`, which is the one that Unreal reads.
    Both,
}

/// Returns width and height of the assumed sensor in mm, and the focal length in mm.
fn on_sensor(camera: &CameraModel, width_mm: f64) -> ([f64; 2], f64) {
    let i = camera.intrinsics();
    let focal_mm = i.fx * width_mm / f64::from(i.width);
    ([width_mm, focal_mm * f64::from(i.height) / i.fy], focal_mm)
}

/// Returns `static.camera`: the sensor's size.
pub fn sensor(camera: &CameraModel, width_mm: f64) -> Value {
    let ([width, height], _) = on_sensor(camera, width_mm);
    json!({
        "activeSensorPhysicalDimensions": {"width": width, "height": height},
        "activeSensorResolution": {"width": camera.width(), "height": camera.height()},
    })
}

/// Returns `lens`.
pub fn lens(camera: &CameraModel, width_mm: f64, principal_point: PrincipalPoint) -> Value {
    let i = camera.intrinsics();
    let ([width, height], focal_mm) = on_sensor(camera, width_mm);
    // Relative to the picture's middle; pixel centres are at integers.
    let (pixels_wide, pixels_high) = (f64::from(i.width), f64::from(i.height));
    let (x, y) = ((i.cx + 0.5 - pixels_wide / 2.0) * width / pixels_wide, (i.cy + 0.5 - pixels_high / 2.0) * height / pixels_high);
    let offset = json!({"x": x, "y": y});
    let [k1, k2, p1, p2, k3] = i.distortion;
    let (f2, f4, f6) = (focal_mm.powi(2), focal_mm.powi(4), focal_mm.powi(6));
    let mut lens = json!({
        "pinholeFocalLength": focal_mm,
        "projectionOffset": offset,
        // Unreal reads radial terms only if there are six, tangential ones only if there are two.
        "distortion": [{
            "model": "Brown-Conrady U-D",
            "radial": [k1 / f2, 0.0, k2 / f4, 0.0, k3 / f6, 0.0],
            "tangential": [p1 / focal_mm, p2 / focal_mm],
        }],
    });
    if principal_point == PrincipalPoint::Both {
        lens["distortionOffset"] = offset;
    }
    lens
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{CameraModel, Intrinsics, Normalized};
    use nalgebra::Vector2;

    /// A receiver that knows only the sample: millimetres on the sensor by the standard's own
    /// equations.
    fn as_a_receiver(lens: &Value, sensor: &Value, x: f64, y: f64) -> [f64; 2] {
        let number = |v: &Value| v.as_f64().unwrap();
        let (f, model) = (number(&lens["pinholeFocalLength"]), &lens["distortion"][0]);
        let (xm, ym) = (f * x, f * y);
        let r2 = xm * xm + ym * ym;
        let l: Vec<f64> = model["radial"].as_array().unwrap().iter().map(number).collect();
        let q: Vec<f64> = model["tangential"].as_array().unwrap().iter().map(number).collect();
        let radial = (1.0 + l[0] * r2 + l[2] * r2.powi(2) + l[4] * r2.powi(3)) / (1.0 + l[1] * r2 + l[3] * r2.powi(2) + l[5] * r2.powi(3));
        let xd = xm * radial + 2.0 * q[0] * xm * ym + q[1] * (r2 + 2.0 * xm * xm);
        let yd = ym * radial + q[0] * (r2 + 2.0 * ym * ym) + 2.0 * q[1] * xm * ym;
        let size = &sensor["activeSensorPhysicalDimensions"];
        let resolution = &sensor["activeSensorResolution"];
        let pixel = |mm: f64, offset: &Value, mm_wide: &Value, px: &Value| {
            (mm + number(offset)) * number(px) / number(mm_wide) + number(px) / 2.0 - 0.5
        };
        let offset = &lens["projectionOffset"];
        [pixel(xd, &offset["x"], &size["width"], &resolution["width"]), pixel(yd, &offset["y"], &size["height"], &resolution["height"])]
    }

    #[test]
    fn a_receiver_projects_to_the_same_pixel() {
        let distortion = [-0.19, 0.07, -0.0008, 0.0011, 0.01];
        let i = Intrinsics { width: 1280, height: 720, fx: 905.0, fy: 893.2, cx: 650.1, cy: 352.4, skew: 0.0, distortion };
        let camera = CameraModel::new(i).unwrap();
        for width_mm in [4.8, 23.76] {
            let (lens, sensor) = (lens(&camera, width_mm, PrincipalPoint::Both), sensor(&camera, width_mm));
            for (x, y) in [(0.0, 0.0), (0.3, -0.2), (-0.5, 0.35)] {
                let wanted = camera.project(Normalized(Vector2::new(x, y))).0;
                let found = as_a_receiver(&lens, &sensor, x, y);
                assert!((found[0] - wanted.x).abs() < 1e-9 && (found[1] - wanted.y).abs() < 1e-9, "{found:?} {wanted}");
            }
            assert_eq!(lens["projectionOffset"], lens["distortionOffset"]);
        }
        let centred = CameraModel::pinhole(640, 480, 600.0, 600.0, 319.5, 239.5).unwrap();
        assert_eq!(lens(&centred, 4.8, PrincipalPoint::Projection)["projectionOffset"], json!({"x": 0.0, "y": 0.0}));
    }
}
