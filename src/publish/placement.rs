//! The receiver's own origin, axes and units, which an output applies to every pose before
//! encoding.
//!
//! Receivers of bare numbers (over OSC) have their own axis order: a renderer's y may be up, or its
//! x forward. [`Axes`] states which of the stage's axes each of theirs is. Protocols with defined
//! axes need none, since the receiver's decoder knows them.

use nalgebra::{UnitQuaternion, Vector3};

use crate::geometry::{Body, Pose, Stage};
use crate::protocols::PanTiltRoll;

/// Rotation, offset and scale, then reordering and inversions: p' = scale (R p + offset),
/// reordered, then with signs; R' = R R_body, then with signs on its angles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// The orientation of the stage in the receiver's world.
    pub rotation: UnitQuaternion<f64>,
    /// The stage's origin in the receiver's world, metres.
    pub offset_m: Vector3<f64>,
    /// Receiver's units per metre (1 = the protocol's own unit).
    pub scale: f64,
    /// Which of the stage's axes (0, 1, 2) becomes the receiver's first, second and third.
    pub order: [usize; 3],
    /// Signs of the receiver's x, y and z.
    pub position_signs: [f64; 3],
    /// Signs of pan, tilt and roll.
    pub angle_signs: [f64; 3],
}

impl Default for Placement {
    fn default() -> Self {
        Self {
            rotation: UnitQuaternion::identity(),
            offset_m: Vector3::zeros(),
            scale: 1.0,
            order: [0, 1, 2],
            position_signs: [1.0; 3],
            angle_signs: [1.0; 3],
        }
    }
}

/// Axes and units of a receiver of bare numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axes {
    /// Which of the stage's axes becomes the receiver's first, second and third.
    pub order: [usize; 3],
    /// Their signs.
    pub position_signs: [f64; 3],
    /// Signs of pan, tilt and roll.
    pub angle_signs: [f64; 3],
    /// The receiver's units per metre.
    pub scale: f64,
}

impl Axes {
    /// The stage's own axes, in metres: lighting desks.
    pub const STAGE: Self = Self { order: [0, 1, 2], position_signs: [1.0; 3], angle_signs: [1.0; 3], scale: 1.0 };
    /// Unreal: x forward, y right, z up, left-handed, centimetres; yaw to the right, pitch up, roll
    /// clockwise.
    pub const UNREAL: Self = Self { order: [1, 0, 2], position_signs: [1.0; 3], angle_signs: [-1.0, 1.0, 1.0], scale: 100.0 };
    /// disguise: x right, y up, z away from the audience, left-handed, metres; rotation to the
    /// right, down, and anticlockwise is positive.
    pub const DISGUISE: Self = Self { order: [0, 2, 1], position_signs: [1.0; 3], angle_signs: [-1.0; 3], scale: 1.0 };
    /// TouchDesigner: x right, y up, z towards the audience, right-handed, metres; ry to the left,
    /// rx up, rz anticlockwise (order Rz Rx Ry).
    pub const TOUCHDESIGNER: Self = Self { order: [0, 2, 1], position_signs: [1.0, 1.0, -1.0], angle_signs: [1.0, 1.0, -1.0], scale: 1.0 };
}

impl Placement {
    /// Whether nothing changes.
    pub fn is_identity(&self) -> bool {
        *self == Self::default()
    }

    /// Converts a pose to the receiver's world.
    pub fn apply(&self, pose: &Pose<Stage, Body>) -> Pose<Stage, Body> {
        let position = (self.rotation * pose.translation + self.offset_m) * self.scale;
        let position = Vector3::from(self.order.map(|axis| position[axis])).component_mul(&Vector3::from(self.position_signs));
        let rotated = self.rotation * pose.rotation;
        if self.angle_signs == [1.0; 3] {
            return Pose::new(rotated, position);
        }
        let angles = PanTiltRoll::of_rotation(&rotated, 0.0);
        let [pan, tilt, roll] = self.angle_signs;
        let inverted = PanTiltRoll { pan_deg: pan * angles.pan_deg, tilt_deg: tilt * angles.tilt_deg, roll_deg: roll * angles.roll_deg };
        Pose::new(inverted.rotation(), position)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_setting_does_what_it_says() {
        let angles = PanTiltRoll { pan_deg: 10.0, tilt_deg: -20.0, roll_deg: 5.0 };
        let pose = Pose::new(angles.rotation(), Vector3::new(1.0, 2.0, 3.0));
        assert!(Placement::default().is_identity());
        assert_eq!(Placement::default().apply(&pose), pose);
        let quarter = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        let placement = Placement {
            rotation: quarter,
            offset_m: Vector3::new(0.0, 0.0, -1.0),
            scale: 100.0,
            order: [0, 1, 2],
            position_signs: [-1.0, 1.0, 1.0],
            angle_signs: [-1.0, 1.0, -1.0],
        };
        let placed = placement.apply(&pose);
        assert!((placed.translation - Vector3::new(200.0, 100.0, 200.0)).norm() < 1e-9, "{}", placed.translation);
        let placed = PanTiltRoll::of_rotation(&placed.rotation, 0.0);
        assert!((placed.pan_deg + 100.0).abs() < 1e-9 && (placed.tilt_deg + 20.0).abs() < 1e-9 && (placed.roll_deg + 5.0).abs() < 1e-9);
    }

    /// Two metres right of the centre, five upstage, one up, looking 30 degrees to the left and 10
    /// down, rolled by 5 clockwise.
    fn placed_by(axes: Axes) -> ([f64; 3], [f64; 3]) {
        let pose = Pose::new(PanTiltRoll { pan_deg: 30.0, tilt_deg: -10.0, roll_deg: 5.0 }.rotation(), Vector3::new(2.0, 5.0, 1.0));
        let Axes { order, position_signs, angle_signs, scale } = axes;
        let placed = Placement { order, position_signs, angle_signs, scale, ..Placement::default() }.apply(&pose);
        let PanTiltRoll { pan_deg, tilt_deg, roll_deg } = PanTiltRoll::of_rotation(&placed.rotation, 0.0);
        (placed.translation.into(), [pan_deg, tilt_deg, roll_deg].map(|v| (v * 1e6).round() / 1e6))
    }

    #[test]
    fn receiver_presets_use_their_own_axes() {
        assert_eq!(placed_by(Axes::STAGE), ([2.0, 5.0, 1.0], [30.0, -10.0, 5.0]));
        assert_eq!(placed_by(Axes::UNREAL), ([500.0, 200.0, 100.0], [-30.0, -10.0, 5.0]));
        assert_eq!(placed_by(Axes::DISGUISE), ([2.0, 1.0, 5.0], [-30.0, 10.0, -5.0]));
        assert_eq!(placed_by(Axes::TOUCHDESIGNER), ([2.0, 1.0, -5.0], [30.0, -10.0, -5.0]));
    }

    /// Combined in the receiver's own axes and order, the angles point where the camera looks, with
    /// its top where the camera's is.
    #[test]
    fn angles_in_receiver_axes_yield_the_cameras_direction() {
        let about = |axis: Vector3<f64>, degrees: f64| {
            let axis = nalgebra::Unit::new_normalize(axis);
            UnitQuaternion::from_axis_angle(&axis, degrees.to_radians())
        };
        let truth = PanTiltRoll { pan_deg: 30.0, tilt_deg: -10.0, roll_deg: 5.0 }.rotation();
        let (ahead, top) = (truth * Vector3::y(), truth * Vector3::z());
        let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
        // In left-handed axes, too, a positive angle turns x to y, y to z and z to x: the matrix
        // has the same numbers.
        let (_, [pan, tilt, roll]) = placed_by(Axes::DISGUISE);
        let made = about(y, pan) * about(x, tilt) * about(z, roll);
        let stage_of = |v: Vector3<f64>| Vector3::new(v.x, v.z, v.y);
        assert!((stage_of(made * z) - ahead).norm() < 1e-6 && (stage_of(made * y) - top).norm() < 1e-6, "disguise");
        let (_, [pan, tilt, roll]) = placed_by(Axes::TOUCHDESIGNER);
        let made = about(y, pan) * about(x, tilt) * about(z, roll);
        let stage_of = |v: Vector3<f64>| Vector3::new(v.x, -v.z, v.y);
        assert!((stage_of(made * -z) - ahead).norm() < 1e-6 && (stage_of(made * y) - top).norm() < 1e-6, "TouchDesigner");
    }
}
