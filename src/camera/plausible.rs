//! Plausibility checks of a calibration's parameters.
//!
//! Finite numbers may still be nonsense: a misplaced decimal point, a line from another file,
//! another picture size. A tracker with such a camera finds nothing, or something wrong, and never
//! says why. Impossible values are errors; unusual ones are remarks. The bounds are wide: they
//! should catch mistakes, not judge lenses.

use std::ops::RangeInclusive;

use nalgebra::Vector2;

use super::model::{CameraError, CameraModel, Intrinsics, Pixel};
use super::size::MAX_SIDE;

/// Possible focal lengths, in units of the picture's longer side. 0.1 is 157 degrees across, too
/// wide for Brown's model; 100 is half a degree, the longest broadcast lenses. Wider, misplaced
/// decimal points pass; narrower, real lenses are refused.
const FOCAL_SIDES: RangeInclusive<f64> = 0.1..=100.0;
/// Focal lengths outside this range (122 to 3 degrees) get a remark. Narrower, calibrations of good
/// lenses get remarks.
const USUAL_FOCAL_SIDES: RangeInclusive<f64> = 0.28..=20.0;
/// Possible fx / fy. Anamorphic lenses and halved lines reach 2; this allows twice that. Wider, a
/// line from another file passes for fy.
const PIXEL_SHAPE: RangeInclusive<f64> = 0.25..=4.0;
/// Pixel aspect ratios outside this range get a remark; square pixels come out equal to about one
/// percent. Narrower, calibrations from few views get remarks too.
const USUAL_PIXEL_SHAPE: RangeInclusive<f64> = 0.9..=1.1;
/// Possible principal points, as a fraction of the picture. Cropped pictures may have it outside,
/// by at most half their size. Wider, the centre of another picture size passes.
const CENTRE: RangeInclusive<f64> = -0.5..=1.5;
/// Principal points outside this range get a remark; full pictures have it within a few hundredths
/// of the middle. Narrower, slightly cropped pictures get remarks.
const USUAL_CENTRE: RangeInclusive<f64> = 0.25..=0.75;
/// Maximum alpha_c: a sensor skewed by 45 degrees, far beyond any camera. Raised, a number from
/// another line passes.
const MAX_SKEW: f64 = 1.0;
/// Skew (3 degrees) above which there is a remark; real sensors have no measurable skew. Raised,
/// wrong numbers go unmentioned.
const USUAL_SKEW: f64 = 0.05;
/// Possible ratio of the undistorted to the distorted radius. Barrel distortion of the widest
/// lenses reaches 4, pincushion 0.7. Wider, coefficients in a wrong order pass; narrower, fisheyes
/// that the model just fits are refused.
const BENT: RangeInclusive<f64> = 0.5..=8.0;
/// Minimum fraction of the picture whose pixels have plausible rays. Fitted polynomials fold in the
/// corners of good calibrations too. Raised, those are refused; lowered, cameras pass for which
/// half the picture is unusable.
const MIN_INVERTIBLE: f64 = 0.75;
/// Number of test points along each side of the picture, edges included. A fold is a ring around
/// the axis, so a coarse grid finds it. Raised, reading a calibration takes longer.
const POINTS_PER_SIDE: u32 = 17;

/// Refuses impossible calibrations; returns remarks on unusual ones, one sentence each.
///
/// # Errors
/// [`CameraError::Implausible`] with what is wrong and what is possible, or
/// [`CameraError::NotInvertible`].
pub fn judge(model: &CameraModel) -> Result<Vec<String>, CameraError> {
    let i = model.intrinsics();
    let longer = f64::from(i.width.max(i.height));
    let side = |name, side: u32| allow(name, side.into(), side <= MAX_SIDE, || format!("at most {MAX_SIDE} pixels"));
    side("width", i.width)?;
    side("height", i.height)?;
    for (name, focal) in [("fx", i.fx), ("fy", i.fy)] {
        let possible =
            || format!("from {} to {} pixels for pictures of this size", FOCAL_SIDES.start() * longer, FOCAL_SIDES.end() * longer);
        allow(name, focal, FOCAL_SIDES.contains(&(focal / longer)), possible)?;
    }
    allow("fy", i.fy, PIXEL_SHAPE.contains(&(i.fx / i.fy)), || format!("within a factor of {} of fx, {}", PIXEL_SHAPE.end(), i.fx))?;
    for (name, centre, side) in [("cx", i.cx, i.width), ("cy", i.cy, i.height)] {
        let side = f64::from(side);
        let possible = || format!("from {} to {}, half a picture outside of it at most", CENTRE.start() * side, CENTRE.end() * side);
        allow(name, centre, CENTRE.contains(&(centre / side)), possible)?;
    }
    allow("skew", i.skew, i.skew.abs() <= MAX_SKEW, || format!("from -{MAX_SKEW} to {MAX_SKEW}"))?;
    let mut odd = unusual(i);
    odd.extend(judge_distortion(model)?);
    Ok(odd)
}

fn allow(name: &'static str, value: f64, is_possible: bool, possible: impl Fn() -> String) -> Result<(), CameraError> {
    if is_possible { Ok(()) } else { Err(CameraError::Implausible { name, value, possible: possible() }) }
}

fn unusual(i: &Intrinsics) -> Vec<String> {
    let longer = f64::from(i.width.max(i.height));
    let mut odd = Vec::new();
    if !USUAL_FOCAL_SIDES.contains(&(i.fx / longer)) {
        let across = 2.0 * (0.5 * f64::from(i.width) / i.fx).atan().to_degrees();
        odd.push(format!("its focal length of {} pixels is rare: {across:.1} degrees across the picture", i.fx));
    }
    if !USUAL_PIXEL_SHAPE.contains(&(i.fx / i.fy)) {
        odd.push(format!("its pixels are {:.3} times as wide as high (fy / fx)", i.fy / i.fx));
    }
    for (name, centre, side) in [("cx", i.cx, i.width), ("cy", i.cy, i.height)] {
        if !USUAL_CENTRE.contains(&(centre / f64::from(side))) {
            odd.push(format!(
                "its {name} of {centre} is far from the middle of {side} pixels; was the picture cut after it was calibrated?"
            ));
        }
    }
    if i.skew.abs() > USUAL_SKEW {
        odd.push(format!("its skew of {} is that of a sensor that leans by {:.0} degrees", i.skew, i.skew.atan().to_degrees()));
    }
    odd
}

/// Checks that enough of the picture's pixels have rays that a lens could produce.
fn judge_distortion(model: &CameraModel) -> Result<Option<String>, CameraError> {
    let i = model.intrinsics();
    if i.distortion == [0.0; 5] {
        return Ok(None);
    }
    let at = |k: u32, side: u32| f64::from(side) * f64::from(k) / f64::from(POINTS_PER_SIDE - 1) - 0.5;
    let (mut rays, mut sound) = (0, 0);
    for (row, column) in (0..POINTS_PER_SIDE).flat_map(|row| (0..POINTS_PER_SIDE).map(move |column| (row, column))) {
        let pixel = Vector2::new(at(column, i.width), at(row, i.height));
        let Some(ray) = model.unproject(Pixel(pixel)) else { continue };
        rays += 1;
        let straight = model.from_undistorted_pixel(pixel).0.norm();
        // Near the axis the tangential terms dominate, and the ratio is meaningless.
        sound += u32::from(straight < 0.05 || BENT.contains(&(ray.0.norm() / straight)));
    }
    let share = f64::from(sound) / f64::from(POINTS_PER_SIDE * POINTS_PER_SIDE);
    if share < MIN_INVERTIBLE {
        return Err(CameraError::NotInvertible { distortion: i.distortion, percent: 100.0 * (1.0 - share) });
    }
    let without = 100.0 * (1.0 - f64::from(rays) / f64::from(POINTS_PER_SIDE * POINTS_PER_SIDE));
    Ok((without > 0.0).then(|| format!("its distortion folds over {without:.0} % of the picture, at the edges, which are not used")))
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: Intrinsics = Intrinsics {
        width: 160,
        height: 120,
        fx: 150.0,
        fy: 151.0,
        cx: 79.0,
        cy: 60.0,
        skew: 0.0,
        distortion: [-0.3, 0.1, 0.001, -0.001, 0.0],
    };

    fn judged(change: impl Fn(&mut Intrinsics)) -> Result<Vec<String>, String> {
        let mut numbers = GOOD;
        change(&mut numbers);
        judge(&CameraModel::new(numbers).unwrap()).map_err(|e| e.to_string())
    }

    #[test]
    fn impossible_values_are_refused_with_the_possible_range() {
        assert_eq!(judged(|_| {}), Ok(vec![]));
        let message = |change: fn(&mut Intrinsics)| judged(change).unwrap_err();
        assert_eq!(
            message(|i| i.fx = 1e300).split("; ").next().unwrap_or_default(),
            "fx is 1e300, which no camera has: it can be from 16 to 16000 pixels for pictures of this size"
        );
        assert!(message(|i| i.fy = 1e-3).starts_with("fy is 0.001, which no camera has"));
        assert!(message(|i| i.cx = 5000.0).starts_with("cx is 5000, which no camera has: it can be from -80 to 240"));
        assert!(message(|i| i.cy = -61.0).starts_with("cy is -61, "));
        assert!(message(|i| i.skew = 2.0).starts_with("skew is 2, "));
        assert!(message(|i| (i.fx, i.fy) = (100.0, 1000.0)).starts_with("fy is 1000, "));
        assert!(message(|i| (i.width, i.fx, i.fy, i.cx) = (70_000, 1e5, 1e5, 35_000.0)).starts_with("width is 70000, "));
    }

    #[test]
    fn implausible_distortion_is_refused() {
        for at in 0..5 {
            for k in [1e6, -1e6, 1e300, -1e300] {
                let refused = judged(|i| i.distortion[at] = k).unwrap_err();
                assert!(refused.contains("% of the picture"), "{at} {k}: {refused}");
            }
        }
    }

    #[test]
    fn rare_values_are_reported() {
        let said = |change: fn(&mut Intrinsics)| judged(change).unwrap().join("; ");
        assert!(said(|i| (i.fx, i.fy) = (8000.0, 8000.0)).contains("1.1 degrees across"));
        assert!(said(|i| i.cx = 20.0).contains("far from the middle"));
        assert!(said(|i| i.fy = 200.0).contains("1.333 times as wide as high"));
        assert!(said(|i| i.skew = 0.1).contains("leans by 6 degrees"));
        assert!(said(|i| i.distortion = [-0.55, 0.0, 0.0, 0.0, 0.0]).contains("of the picture, at the edges"));
    }

    #[test]
    fn real_wide_lenses_are_good() {
        // Webcams and action cameras from OpenCV's and ROS's samples, and the thesis' camera.
        let lens = |width, height, f, c: [f64; 2], distortion| {
            let [cx, cy] = c;
            judge(&CameraModel::new(Intrinsics { width, height, fx: f, fy: f, cx, cy, skew: 0.0, distortion }).unwrap())
        };
        for judged in [
            lens(640, 480, 535.9, [342.3, 235.6], [-0.2664, -0.0386, 0.0018, -0.0003, 0.2385]),
            lens(752, 480, 458.7, [367.2, 248.4], [-0.2834, 0.0740, 0.0002, 1.8e-5, 0.0]),
            lens(4288, 2848, 4178.8, [2191.2, 1412.2], [-0.1317, 0.2129, -0.0006, 0.0026, 0.0]),
        ] {
            assert_eq!(judged, Ok(vec![]));
        }
    }
}
