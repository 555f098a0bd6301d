//! ROS camera_info's `roi` and `binning`: which part of the sensor the pictures show, and how many
//! sensor pixels make one picture pixel.
//!
//! By the message's definition, `width`, `height` and K describe the full sensor, and the window
//! lies on it. Some drivers write the window's own size with the full sensor's K. P, which
//! describes the window, or else the picture's centre shows which K it is.

use super::problem::{CalibrationProblem, Fault};
use super::yaml::{Node, whole};
use crate::camera::Intrinsics;

/// Minimum difference, as a fraction of the window, between the two candidate principal points'
/// distances to the expected centre. Raised, more ambiguous files are refused; lowered, the wrong K
/// may be chosen.
const CLEARLY: f64 = 0.1;

/// Returns the camera of the delivered pictures, with a remark if they do not show the whole
/// sensor.
pub(super) fn applied(root: &Node, sensor: Intrinsics) -> Result<(Intrinsics, Option<String>), Fault> {
    let number = |node: &Node, key: &str| -> Result<u32, Fault> {
        let Some((name, value)) = node.find(&[key]) else { return Ok(0) };
        whole(name, value, value.number().unwrap_or(f64::NAN))
    };
    let [bin_x, bin_y] = [number(root, "binning_x")?.max(1), number(root, "binning_y")?.max(1)];
    let Some((line, [x, y, w, h])) = window(root, number, &sensor)? else { return Ok(binned(sensor, [bin_x, bin_y])) };
    let refused = |problem: String| Fault { line: Some(line), problem: CalibrationProblem::Window(problem) };
    let fits = u64::from(x) + u64::from(w) <= sensor.width.into() && u64::from(y) + u64::from(h) <= sensor.height.into();
    let has_window_size = (sensor.width, sensor.height) == (w, h);
    if !fits && !has_window_size {
        let Intrinsics { width, height, .. } = sensor;
        return Err(refused(format!(
            "`roi` is a window of {w} x {h} pixels at {x}, {y}, which does not lie within the picture of {width} x {height}"
        )));
    }
    let moved = Intrinsics { width: w, height: h, cx: sensor.cx - f64::from(x), cy: sensor.cy - f64::from(y), ..sensor };
    let is_of_window = !fits && belongs_to_window(root, &sensor, &moved).ok_or_else(|| {
        refused(format!(
            "`roi` begins at {x}, {y}, and it is unclear whether the matrix is for the whole sensor or for the window of {w} x {h} pixels"
        ))
    })?;
    let (camera, _) = binned(if is_of_window { sensor } else { moved }, [bin_x, bin_y]);
    let word = format!(
        "its pictures are a window of the sensor (roi: {w} x {h} pixels at {x}, {y}{}), so the calibration is that of pictures of {} x {}",
        if bin_x.max(bin_y) > 1 { format!(", binned {bin_x} x {bin_y}") } else { String::new() },
        camera.width,
        camera.height
    );
    Ok((camera, Some(word)))
}

/// Returns the window's line, offset and size; `None` if it is the whole picture.
fn window(
    root: &Node,
    number: impl Fn(&Node, &str) -> Result<u32, Fault>,
    sensor: &Intrinsics,
) -> Result<Option<(usize, [u32; 4])>, Fault> {
    let Some((_, roi)) = root.find(&["roi"]) else { return Ok(None) };
    let [x, y] = [number(roi, "x_offset")?, number(roi, "y_offset")?];
    // A size of 0 means the rest of the sensor.
    let rest = |size: u32, side: u32, offset: u32| if size == 0 { side.saturating_sub(offset) } else { size };
    let w = rest(number(roi, "width")?, sensor.width, x);
    let h = rest(number(roi, "height")?, sensor.height, y);
    let is_whole = [x, y, w, h] == [0, 0, sensor.width, sensor.height];
    Ok((!is_whole).then_some((roi.line, [x, y, w, h])))
}

/// For a file with the window's size: whether its matrix is the window's too; `None` if ambiguous.
fn belongs_to_window(root: &Node, sensor: &Intrinsics, moved: &Intrinsics) -> Option<bool> {
    let projection = root.find(&["P", "projection_matrix"]).and_then(|(_, node)| node.numbers()).filter(|p| p.len() == 12 && p[0] != 0.0);
    let apart = |i: &Intrinsics, [x, y]: [f64; 2]| ((i.cx - x) / f64::from(i.width.max(1))).hypot((i.cy - y) / f64::from(i.height.max(1)));
    let middle = [f64::from(sensor.width) / 2.0 - 0.5, f64::from(sensor.height) / 2.0 - 0.5];
    let centre = projection.map_or(middle, |p| [p[2], p[6]]);
    let (own, other) = (apart(sensor, centre), apart(moved, centre));
    ((own - other).abs() > CLEARLY).then_some(own < other)
}

/// Applies binning: a picture pixel is the mean of the sensor pixels it combines.
fn binned(i: Intrinsics, [across, down]: [u32; 2]) -> (Intrinsics, Option<String>) {
    if (across, down) == (1, 1) {
        return (i, None);
    }
    let (sx, sy) = (f64::from(across), f64::from(down));
    let scaled = Intrinsics {
        width: i.width / across,
        height: i.height / down,
        fx: i.fx / sx,
        fy: i.fy / sy,
        cx: (i.cx + 0.5) / sx - 0.5,
        cy: (i.cy + 0.5) / sy - 0.5,
        ..i
    };
    let word = format!(
        "{across} x {down} pixels of the sensor make one of its pictures (binning), so the calibration is that of pictures of {} x {}",
        scaled.width, scaled.height
    );
    (scaled, Some(word))
}
