//! Rotations as configs state them: a quaternion, or three angles.
//!
//! The angles are `[turn, tilt, roll]` in degrees, applied in this order, each about an axis of the
//! already rotated frame, right-handed:
//! - turn is about the vertical (positive: anticlockwise seen from above);
//! - tilt is about the frame's x, to its right (positive: a surface looks down, a receiver's or a
//!   body's front goes up);
//! - roll is about a surface's normal (positive: anticlockwise as seen by someone facing the
//!   surface); for a frame, about its y.
//!
//! [0, 0, 0] is a surface's default, upright with its face to the audience; for a frame it is the
//! identity.

use std::f64::consts::FRAC_1_SQRT_2;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use toml::Spanned;

use super::typed_values::{Exactly, Number};
use super::values::Section;
use super::{ConfigError, Problem};

/// What is rotated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Turned {
    /// A surface: its frame has x right and y up in its picture, z out of its face.
    Surface,
    /// The filming camera's frame: x right, y forward, z up.
    Mount,
    /// A receiver's frame: x right, y forward, z up.
    Output,
    /// A camera in the stage: the quaternion is that of its optical frame (x right, y down, z
    /// forward), the angles are pan, tilt and roll.
    Camera,
}

impl Turned {
    fn default(self) -> UnitQuaternion<f64> {
        match self {
            Self::Surface => UnitQuaternion::from_quaternion(Quaternion::new(FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0, 0.0)),
            Self::Mount | Self::Output => UnitQuaternion::identity(),
            Self::Camera => UnitQuaternion::from_quaternion(Quaternion::new(FRAC_1_SQRT_2, -FRAC_1_SQRT_2, 0.0, 0.0)),
        }
    }

    /// Returns the rotation for three angles in degrees.
    fn by_angles(self, [turn, tilt, roll]: [f64; 3]) -> UnitQuaternion<f64> {
        let about = |axis, degrees: f64| UnitQuaternion::from_axis_angle(&axis, degrees.to_radians());
        let (turn, tilt) = (about(Vector3::z_axis(), turn), about(Vector3::x_axis(), tilt));
        match self {
            Self::Surface => turn * self.default() * tilt * about(Vector3::z_axis(), roll),
            Self::Mount | Self::Output => turn * tilt * about(Vector3::y_axis(), roll),
            Self::Camera => turn * tilt * about(Vector3::y_axis(), roll) * self.default(),
        }
    }

    /// Returns the rotation as typed, by its quaternion or its angles (`rotation_deg`); at most one
    /// may be present.
    pub fn typed(
        self,
        section: &Section<'_>,
        quaternion: Option<&Spanned<Exactly<Number, 4>>>,
        angles: Option<&Spanned<Exactly<Number, 3>>>,
    ) -> Result<UnitQuaternion<f64>, ConfigError> {
        let (key, both) = match self {
            Self::Surface => {
                ("orientation_xyzw", "a surface has either `orientation_xyzw` or `rotation_deg`, this one has both; remove one")
            }
            Self::Mount => ("orientation_xyzw", "a mount has either `orientation_xyzw` or `rotation_deg`, this one has both; remove one"),
            Self::Camera => ("orientation_xyzw", "a camera has either `orientation_xyzw` or `rotation_deg`, this one has both; remove one"),
            Self::Output => ("rotation_xyzw", "an output has either `rotation_xyzw` or `rotation_deg`, this one has both; remove one"),
        };
        match (quaternion, angles) {
            (None, None) => Ok(self.default()),
            (Some(typed), None) => unit_quaternion(section, key, typed),
            (Some(_), Some(typed)) => Err(section.conflict("rotation_deg", typed, both)),
            (None, Some(typed)) => {
                let angles = typed.get_ref().values();
                if angles.iter().all(|angle| angle.abs() <= MAX_DEG) {
                    return Ok(self.by_angles(angles));
                }
                let wanted = "[turn, tilt, roll], three angles in degrees between -360 and 360";
                Err(section.refuse("rotation_deg", &typed.span(), Problem::Range { value: format!("{angles:?}"), wanted }))
            }
        }
    }
}

/// Maximum absolute value of an angle, degrees: one full turn; more is a slip.
const MAX_DEG: f64 = 360.0;

fn unit_quaternion(section: &Section<'_>, key: &str, typed: &Spanned<Exactly<Number, 4>>) -> Result<UnitQuaternion<f64>, ConfigError> {
    let [x, y, z, w] = typed.get_ref().values();
    let quaternion = Quaternion::new(w, x, y, z);
    let length = quaternion.norm();
    // A NaN length fails the comparison too.
    if (length - 1.0).abs() <= 1e-3 {
        return Ok(UnitQuaternion::from_quaternion(quaternion));
    }
    Err(section.refuse(key, &typed.span(), Problem::Quaternion(length)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the stage directions of a surface's right, its picture's up and its face.
    fn axes(angles: [f64; 3]) -> [[f64; 3]; 3] {
        let rotation = Turned::Surface.by_angles(angles);
        let rounded = |axis: Vector3<f64>| (rotation * axis).map(|v| (v * 1e4).round() / 1e4 + 0.0).into();
        [rounded(Vector3::x()), rounded(Vector3::y()), rounded(Vector3::z())]
    }

    #[test]
    fn the_documented_rotation_examples_are_right() {
        let (right, upstage, up) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
        let back = |[x, y, z]: [f64; 3]| [0.0 - x, 0.0 - y, 0.0 - z];
        assert_eq!(axes([0.0, 0.0, 0.0]), [right, up, back(upstage)], "upright, its face to the audience");
        let (sin, cos) = (0.342, 0.9397);
        assert_eq!(axes([20.0, 0.0, 0.0]), [[cos, sin, 0.0], up, [sin, -cos, 0.0]], "a flat turned 20 degrees looks to the house's right");
        assert_eq!(axes([0.0, -90.0, 0.0]), [right, upstage, up], "a floor cloth or a table: looks up, its picture's top is upstage");
        assert_eq!(axes([180.0, -90.0, 0.0]), [back(right), back(upstage), up], "a floor cloth to be read from upstage");
        assert_eq!(axes([90.0, 0.0, 0.0]), [upstage, up, right], "a wing on the left, facing across the stage");
        assert_eq!(axes([0.0, 10.0, 0.0])[2], [0.0, -0.9848, -0.1736], "a ceiling piece that tips forward looks down");
        assert_eq!(axes([0.0, 0.0, 90.0])[..2], [up, back(right)], "a picture on its side: its right edge is on top");
    }

    #[test]
    fn mount_angles_are_pan_tilt_and_roll() {
        let angles = [30.0, -20.0, 10.0];
        let as_receivers_mean = crate::protocols::PanTiltRoll { pan_deg: 30.0, tilt_deg: -20.0, roll_deg: 10.0 };
        assert!(Turned::Mount.by_angles(angles).angle_to(&as_receivers_mean.rotation()) < 1e-12);
        assert_eq!(Turned::Mount.by_angles([0.0; 3]), UnitQuaternion::identity());
    }
}
