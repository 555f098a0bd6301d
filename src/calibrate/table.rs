//! The parameters as printed by Bouguet's toolbox.

use std::fmt::Write;

use super::session::CameraCalibration;

/// Returns fc, cc, alpha_c and kc, each with 3 sigma, and err, as lines of text.
pub fn bouguet(made: &CameraCalibration) -> String {
    let n = &made.estimate.bundle.lens.0;
    let u = made.estimate.lens_uncertainty();
    let list = |values: &[f64]| values.iter().map(|v| format!("{v:.5}")).collect::<Vec<_>>().join("   ");
    let angle = 90.0 - n[4].atan().to_degrees();
    let angle_error = u[4].atan().to_degrees();
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(text, "Focal Length:          fc = [ {} ] +/- [ {} ]", list(&[n[0], n[1]]), list(&[u[0], u[1]]));
    let _ = writeln!(text, "Principal point:       cc = [ {} ] +/- [ {} ]", list(&[n[2], n[3]]), list(&[u[2], u[3]]));
    let _ = writeln!(
        text,
        "Skew:             alpha_c = [ {:.5} ] +/- [ {:.5} ]   => angle of pixel axes = {angle:.5} +/- {angle_error:.5} degrees",
        n[4], u[4]
    );
    let kc = |v: &super::solve::lens::LensVector| list(&[v[5], v[6], v[7], v[8], v[9]]);
    let _ = writeln!(text, "Distortion:            kc = [ {} ] +/- [ {} ]", kc(n), kc(&u));
    let _ = writeln!(text, "Pixel error:          err = [ {} ]", list(&made.estimate.axis_error_px));
    text
}
