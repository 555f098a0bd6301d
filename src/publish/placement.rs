//! The receiver's own origin, axes and units: what an output does to every pose before it is encoded.

use nalgebra::{UnitQuaternion, Vector3};

use super::body_pose::PanTiltRoll;
use crate::geometry::{Body, Pose, Stage};

/// Rotation, offset and scale, then inversions: p' = scale (R p + offset), then signs; R' = R R_body, then signs of its angles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// The stage's axes in the receiver's world.
    pub rotation: UnitQuaternion<f64>,
    /// The stage's origin in the receiver's world, metres.
    pub offset_m: Vector3<f64>,
    /// Receiver's units per metre of the protocol's own (1 = as the protocol has it).
    pub scale: f64,
    /// Signs of x, y and z.
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
            position_signs: [1.0; 3],
            angle_signs: [1.0; 3],
        }
    }
}

impl Placement {
    /// Nothing is done.
    pub fn is_identity(&self) -> bool {
        *self == Self::default()
    }

    /// The pose as the receiver wants it.
    pub fn apply(&self, pose: &Pose<Stage, Body>) -> Pose<Stage, Body> {
        let position = (self.rotation * pose.translation + self.offset_m) * self.scale;
        let position = position.component_mul(&Vector3::from(self.position_signs));
        let turned = self.rotation * pose.rotation;
        if self.angle_signs == [1.0; 3] {
            return Pose::new(turned, position);
        }
        let angles = PanTiltRoll::of_rotation(&turned, 0.0);
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
            position_signs: [-1.0, 1.0, 1.0],
            angle_signs: [-1.0, 1.0, -1.0],
        };
        let placed = placement.apply(&pose);
        assert!((placed.translation - Vector3::new(200.0, 100.0, 200.0)).norm() < 1e-9, "{}", placed.translation);
        let placed = PanTiltRoll::of_rotation(&placed.rotation, 0.0);
        assert!((placed.pan_deg + 100.0).abs() < 1e-9 && (placed.tilt_deg + 20.0).abs() < 1e-9 && (placed.roll_deg + 5.0).abs() < 1e-9);
    }
}
