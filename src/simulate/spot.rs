//! Spots: lamps whose light adds to the wash.

use std::f64::consts::TAU;

use nalgebra::{Point3, Vector3};

/// A swinging lamp with a soft-edged cone of light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spot {
    /// Position of the lamp in the stage.
    pub lamp: Point3<f64>,
    /// The point that the beam's axis hits in the middle of the swing.
    pub aim: Point3<f64>,
    /// Displacement from there to one end of the swing, metres.
    pub swing: Vector3<f64>,
    /// Period of the swing, seconds.
    pub period_s: f64,
    /// Angle from the axis at which 61 % of the light is left (a Gaussian's sigma), radians.
    pub width_rad: f64,
    /// Light on the axis, relative to the stage's full light.
    pub gain: f32,
}

/// A spot at an instant.
#[derive(Debug, Clone, Copy)]
pub(super) struct Beam {
    lamp: Point3<f64>,
    axis: Vector3<f64>,
    /// 1 / (2 sigma²), with sigma in radians.
    sharpness: f64,
    gain: f32,
}

impl Spot {
    pub(super) fn beam(&self, time_s: f64) -> Beam {
        let aim = self.aim + self.swing * (TAU * time_s / self.period_s).sin();
        let axis = (aim - self.lamp).try_normalize(f64::MIN_POSITIVE).unwrap_or_else(Vector3::y);
        Beam { lamp: self.lamp, axis, sharpness: 0.5 / (self.width_rad * self.width_rad), gain: self.gain }
    }
}

impl Beam {
    /// Returns the light that it adds at a point of the stage, relative to full light.
    pub(super) fn light_at(&self, point: &Point3<f64>) -> f32 {
        let away = point - self.lamp;
        let along = away.dot(&self.axis);
        if along <= 0.0 {
            return 0.0;
        }
        let angle = away.cross(&self.axis).norm().atan2(along);
        self.gain * (-self.sharpness * angle * angle).exp() as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spot_is_brightest_in_its_middle_and_ends_behind_the_lamp() {
        let spot = Spot {
            lamp: Point3::new(0.0, -4.0, 3.0),
            aim: Point3::origin(),
            swing: Vector3::new(1.0, 0.0, 0.0),
            period_s: 2.0,
            width_rad: 0.1,
            gain: 0.8,
        };
        let beam = spot.beam(0.0);
        assert_eq!(beam.light_at(&Point3::origin()), 0.8);
        // One sigma aside at a distance of 5 m: exp(-1/2).
        let off_axis = beam.light_at(&Point3::new(5.0 * 0.1_f64.tan(), 0.0, 0.0));
        assert!((off_axis - 0.8 * (-0.5_f32).exp()).abs() < 1e-5, "{off_axis}");
        assert_eq!(beam.light_at(&Point3::new(0.0, -9.0, 6.0)), 0.0);
        assert_eq!(spot.beam(0.5).light_at(&Point3::new(1.0, 0.0, 0.0)), 0.8);
    }
}
