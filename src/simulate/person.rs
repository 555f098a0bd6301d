//! People who walk in front of the stage.

use std::f64::consts::TAU;

use image::GrayImage;
use nalgebra::{Point3, Vector3};

use super::upright::upright;
use crate::geometry::{Pose, Stage, SurfaceFrame};

/// Amplitude of the vertical motion of a walker's steps, metres. Raised, people hop.
const STEP_M: f64 = 0.03;
/// Steps of a walk there and back. Raised, people take quicker, shorter steps.
const STEPS: f64 = 8.0;
/// Fraction of the half height above which the outline is rounded off. Raised, head and feet are
/// more angular.
const SHOULDER: f64 = 0.6;
/// How strongly it is rounded. Up to 1 / (1 - [`SHOULDER`])² = 6.25 the outline spans the full
/// height, cut flat at head and feet; raised further, it ends before.
const ROUNDNESS: f64 = 6.0;

/// A person: an upright outline with round head and feet, in patterned clothes, that walks back and
/// forth.
#[derive(Debug, Clone, PartialEq)]
pub struct Person {
    /// The middle of the walk, at half the person's height, in the stage.
    pub centre: Point3<f64>,
    /// Displacement from there to where the person turns round, metres.
    pub swing: Vector3<f64>,
    /// Period of the walk there and back, seconds.
    pub period_s: f64,
    /// Phase of the walk at time 0, turns.
    pub phase: f64,
    /// Half the width (x) and half the height (z), metres.
    pub half_size_m: [f64; 2],
    /// Picture of the clothes, which fills the box around the outline.
    pub clothes: GrayImage,
}

impl Person {
    /// Returns `T_stage_surface` of the outline's plane at a time.
    pub(super) fn pose(&self, time_s: f64) -> Pose<Stage, SurfaceFrame> {
        let phase = TAU * (time_s / self.period_s + self.phase);
        let step = Vector3::new(0.0, 0.0, STEP_M * (STEPS * phase).sin());
        Pose::new(upright(Vector3::zeros(), 0.0).rotation, self.centre.coords + self.swing * phase.sin() + step)
    }
}

/// Whether a point is within a person's outline; coordinates are half sizes to the right and up
/// from the middle.
pub(super) fn is_within_outline(right: f64, up: f64) -> bool {
    let beyond = (up.abs() - SHOULDER).max(0.0);
    up.abs() < 1.0 && right * right + ROUNDNESS * beyond * beyond < 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_person_walks_there_and_back() {
        let person = Person {
            centre: Point3::new(0.5, -1.0, 0.2),
            swing: Vector3::new(1.2, 0.0, 0.0),
            period_s: 4.0,
            phase: 0.25,
            half_size_m: [0.3, 0.9],
            clothes: GrayImage::new(1, 1),
        };
        let x = |time_s: f64| person.pose(time_s).translation.x;
        assert!((x(0.0) - 1.7).abs() < 1e-9 && (x(1.0) - 0.5).abs() < 1e-9 && (x(2.0) + 0.7).abs() < 1e-9);
        assert!((person.pose(0.1).translation.z - 0.2).abs() > 0.005, "nobody floats");
    }

    #[test]
    fn the_outline_is_round_at_head_and_feet() {
        assert!(is_within_outline(0.99, 0.0) && is_within_outline(0.99, -0.6) && is_within_outline(0.0, 0.99));
        assert!(!is_within_outline(1.01, 0.0) && !is_within_outline(0.8, 0.9) && !is_within_outline(0.0, 1.01));
    }
}
