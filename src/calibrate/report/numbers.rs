//! The parameters of a calibration, first in photographers' terms, then in those of calibration
//! programs.

use nalgebra::{Rotation3, Vector2, Vector3};

use super::figures::shape;
use super::short_name;
use crate::calibrate::judge::map::MOST;
use crate::calibrate::session::{CalibrationView, CameraCalibration};
use crate::calibrate::solve::lens::LENS_NAMES;
use crate::camera::{CameraModel, Pixel};

/// Width of a full-frame sensor, millimetres: the usual reference for focal lengths.
const FULL_FRAME_MM: f64 = 36.0;

/// Returns both tables.
pub(super) fn part(made: &CameraCalibration) -> String {
    let mut rows = String::new();
    for (name, value) in plain(made) {
        rows += &format!("<tr><th>{name}</th><td>{value}</td></tr>\n");
    }
    format!(
        "<h2>The lens in numbers</h2>\n<div class=\"wide\"><table>\n{rows}</table></div>\n<p>The number after &plusmn; is 3 sigma: the \
         true value lies within it in 997 of 1000 cases, as far as the pictures can tell.</p>\n{}",
        programs(made)
    )
}

/// Returns each value with its name, as HTML text.
fn plain(made: &CameraCalibration) -> Vec<(&'static str, String)> {
    let n = &made.estimate.bundle.lens.0;
    let u = made.estimate.lens_uncertainty();
    let (w, h) = (f64::from(made.size.0), f64::from(made.size.1));
    let mut rows = Vec::new();
    let model = made.estimate.bundle.lens.model(made.size.0, made.size.1).ok();
    if let Some([across, down]) = model.as_ref().and_then(view_deg) {
        rows.push(("Angle of view", format!("{across:.1}&deg; across, {down:.1}&deg; down")));
    }
    let mm = n[0] / w * FULL_FRAME_MM;
    let focal =
        format!("{:.1} px &plusmn; {:.1} across, {:.1} px &plusmn; {:.1} down; as {mm:.1} mm on full frame", n[0], u[0], n[1], u[1]);
    rows.push(("Focal length", focal));
    let side = |v: f64, [low, high]: [&'static str; 2]| format!("{:.1} px {}", v.abs(), if v < 0.0 { low } else { high });
    let [across, down] = [side(n[2] + 0.5 - 0.5 * w, ["left of", "right of"]), side(n[3] + 0.5 - 0.5 * h, ["above", "below"])];
    let ahead = format!("{across} and {down} the picture's middle, &plusmn; {:.1} and {:.1} px", u[2], u[3]);
    rows.push(("Where the lens looks straight ahead", ahead));
    if let Some(bending) = model.as_ref().and_then(bending) {
        rows.push(("Distortion", bending));
    }
    let corners = made.estimate.used.iter().flatten().filter(|used| **used).count();
    rows.push(("How well corners fit", format!("{:.2} px (root of the mean square over {corners} corners)", made.estimate.rms_px)));
    if let Ok(colours) = &made.lateral_colour {
        let text = format!("{}. {}", colours.sizes(), colours.meaning()).replace("+/-", "&plusmn;");
        rows.push(("Lateral colour", text));
    }
    let map = &made.judgement.uncertainty;
    if map.quantile(MOST).is_finite() {
        let (most, worst) = (map.quantile(MOST), map.worst());
        let places = format!("{most:.2} px over most of the picture, {worst:.2} px at the worst place");
        rows.push(("How precisely places in the picture are known", places));
    }
    rows
}

/// Returns the angles between the middles of opposite sides of the picture, degrees.
fn view_deg(model: &CameraModel) -> Option<[f64; 2]> {
    let (w, h) = (f64::from(model.width()), f64::from(model.height()));
    let i = model.intrinsics();
    let ray = |x: f64, y: f64| model.unproject(Pixel(Vector2::new(x, y))).map(|n| n.0.push(1.0));
    let angle = |a: Option<Vector3<f64>>, b: Option<Vector3<f64>>| Some(a?.angle(&b?).to_degrees());
    Some([angle(ray(-0.5, i.cy), ray(w - 0.5, i.cy))?, angle(ray(i.cx, -0.5), ray(i.cx, h - 0.5))?])
}

/// Describes how straight lines bend, from how far the picture's corners are moved.
fn bending(model: &CameraModel) -> Option<String> {
    let (w, h) = (f64::from(model.width()), f64::from(model.height()));
    let i = model.intrinsics();
    let centre = Vector2::new(i.cx, i.cy);
    let corners = [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h)].map(|(x, y)| Vector2::new(x - 0.5, y - 0.5));
    let moved = corners.map(|corner| {
        let straight = model.undistorted_pixel(model.unproject(Pixel(corner))?);
        Some((corner - centre).norm() - (straight - centre).norm())
    });
    let farthest = moved.into_iter().flatten().max_by(|a, b| a.abs().total_cmp(&b.abs()))?;
    let way =
        if farthest < 0.0 { "inwards (barrel: straight lines bow outwards)" } else { "outwards (pincushion: straight lines bow inwards)" };
    let moves = format!("moves the picture's corners by up to {:.0} px {way}", farthest.abs());
    Some(if farthest.abs() < 0.5 { "almost none".to_owned() } else { moves })
}

/// Returns the parameters as in calibration files.
fn programs(made: &CameraCalibration) -> String {
    let n = &made.estimate.bundle.lens.0;
    let u = made.estimate.lens_uncertainty();
    let mut rows = String::new();
    for (k, name) in LENS_NAMES.iter().enumerate() {
        let sigma = if u[k] > 0.0 { format!("{:.5}", u[k]) } else { "held".to_owned() };
        rows += &format!("<tr><td>{name}</td><td class=\"number\">{:.5}</td><td class=\"number\">{sigma}</td></tr>\n", n[k]);
    }
    let (rounds, moved) = made.rounds;
    format!(
        "<details><summary>The same for calibration programs</summary>\n<div class=\"wide\"><table><tr><th></th><th class=\"number\">value</th>\
         <th class=\"number\">&plusmn;</th></tr>\n{rows}</table></div>\n<p>Corners were measured again with the lens {rounds} time(s); the last time none moved \
         by more than {moved:.4} px.</p></details>\n"
    )
}

/// Returns the table of the boards' positions relative to the camera.
pub(super) fn poses(made: &CameraCalibration, views: &[&CalibrationView]) -> String {
    let mut rows = String::new();
    for (number, view) in (1..).zip(views) {
        let (Some(pose), Some(corners)) = (&view.extrinsics, &view.corners) else { continue };
        let tilt = shape(made, corners).map_or("-".to_owned(), |shape| {
            let side = shape.side().map_or(String::new(), |side| format!(", {} side away", side.name()));
            format!("{:.0}&deg;{side}", shape.tilt_deg())
        });
        let middle = Vector2::new(f64::from(made.board.columns() - 1), f64::from(made.board.rows() - 1)) * (0.5 * made.board.square_m());
        let centre = Rotation3::from_scaled_axis(pose.rotation_vector) * middle.push(0.0) + pose.translation_m;
        rows += &format!(
            "<tr><td>{number}: {}</td><td class=\"number\">{:.3} m</td><td class=\"number\">&plusmn; {:.1} mm</td><td>{tilt}</td><td class=\"number\">{:.2} px</td></tr>\n",
            short_name(view),
            centre.norm(),
            1e3 * pose.translation_uncertainty_m.norm(),
            view.rms_px.unwrap_or(0.0)
        );
    }
    format!(
        "<h2>Where the boards were</h2>\n<div class=\"wide\"><table><tr><th>picture</th><th class=\"number\">distance</th><th></th><th>tilt</th>\
         <th class=\"number\">fits to</th></tr>\n{rows}</table></div>\n"
    )
}
