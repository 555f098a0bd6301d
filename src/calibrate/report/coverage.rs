//! Where in the picture the board has been: every corner used, and the parts that none has reached.

use super::INK;
use super::scale::{self, BAR_HEIGHT};
use super::svg::Drawing;
use crate::calibrate::guide::{PART_COLUMNS, PART_ROWS, ViewSet, ViewShape, observations_of};
use crate::calibrate::session::CameraCalibration;

/// The corners of all pictures used, coloured by how far each lies from where the calibration expects it.
pub(super) fn figure(made: &CameraCalibration) -> String {
    let (w, h) = (f64::from(made.size.0), f64::from(made.size.1));
    let width = 480.0;
    let (scale, height) = (width / w, width * h / w);
    let mut drawing = Drawing::new(width, height + BAR_HEIGHT);
    drawing.rect([0.5, 0.5], [width - 1.0, height - 1.0], "var(--faint)", "var(--panel)");
    let part = [width / PART_COLUMNS as f64, height / PART_ROWS as f64];
    for (column, row) in missing_parts(made) {
        let [x, y] = [column as f64 * part[0], row as f64 * part[1]];
        drawing.rect([x, y], part, "none", "var(--hatch)");
        drawing.text([x + 0.5 * part[0], y + 0.5 * part[1] + 5.0], 14.0, "middle", INK, "no board here");
    }
    for (pixel, residual) in residuals(made) {
        let at = [(pixel.x + 0.5) * scale, (pixel.y + 0.5) * scale];
        drawing.circle(at, 2.4, "var(--ink)", scale::colour(residual.norm()), 0.35);
    }
    scale::bar(&mut drawing, width, height);
    drawing.finish("Where in the picture the board has been")
}

/// Every corner used: where it is seen, and how far that is from where it is expected.
pub(super) fn residuals(made: &CameraCalibration) -> impl Iterator<Item = (nalgebra::Vector2<f64>, nalgebra::Vector2<f64>)> + '_ {
    let used = made.views.iter().filter_map(|view| Some((view, view.index?, view.corners.as_ref()?)));
    used.flat_map(move |(view, index, corners)| {
        let counted = corners.iter().enumerate().filter(|(k, _)| !view.outliers.contains(k));
        counted.filter_map(move |(k, corner)| {
            let seen = crate::calibrate::solve::adjust::Observation { board_m: made.board.corner(k), pixel: (*corner)? };
            Some((seen.pixel, made.estimate.bundle.residual(index, &seen)?))
        })
    })
}

/// What the views' own shapes say of each picture, in the order of the views.
pub(super) fn shape(made: &CameraCalibration, corners: &[Option<nalgebra::Vector2<f64>>]) -> Option<ViewShape> {
    ViewShape::new(&observations_of(corners, &made.board), made.size, Some(&made.estimate.bundle.lens))
}

fn missing_parts(made: &CameraCalibration) -> Vec<(usize, usize)> {
    let mut set = ViewSet::default();
    let used = made.views.iter().filter(|view| view.used).filter_map(|view| view.corners.as_ref());
    used.filter_map(|corners| shape(made, corners)).for_each(|shape| set.add(shape));
    set.missing().parts
}
