//! People who walk before the stage.

use std::f64::consts::TAU;

use image::GrayImage;
use nalgebra::{Point3, Vector3};

use super::upright::upright;
use crate::geometry::{Pose, Stage, SurfaceFrame};

/// How high a walker's steps lift it, metres. Raised, people hop.
const STEP_M: f64 = 0.03;
/// Steps of a walk there and back. Raised, people trip along.
const STEPS: f64 = 8.0;
/// From this share of the half height on, the outline is rounded off.
const SHOULDER: f64 = 0.6;
/// How round it is: with 1 / (1 - [`SHOULDER`])² = 6.25 or less, head and feet end within the half
/// height.
const ROUNDNESS: f64 = 6.0;

/// A person: an upright outline with round head and feet, in patterned clothes, that walks to and
/// fro.
#[derive(Debug, Clone, PartialEq)]
pub struct Person {
    /// The middle of the walk, at half the person's height, in the stage.
    pub centre: Point3<f64>,
    /// From there to where the person turns round, metres.
    pub swing: Vector3<f64>,
    /// Seconds for the walk there and back.
    pub period_s: f64,
    /// Where in the walk time 0 is, turns.
    pub phase: f64,
    /// Half the width (x) and half the height (z), metres.
    pub half_size_m: [f64; 2],
    /// What they wear: fills the box around the outline.
    pub clothes: GrayImage,
}

impl Person {
    /// `T_stage_surface` of the outline's plane at a time.
    pub(super) fn pose(&self, time_s: f64) -> Pose<Stage, SurfaceFrame> {
        let phase = TAU * (time_s / self.period_s + self.phase);
        let step = Vector3::new(0.0, 0.0, STEP_M * (STEPS * phase).sin());
        Pose::new(upright(Vector3::zeros(), 0.0).rotation, self.centre.coords + self.swing * phase.sin() + step)
    }
}

/// True within a person's outline; half sizes to the right and up from the middle.
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
