//! What all steps of a mapping share: the camera, what was configured and measured, and whether to
//! go on.

use super::super::keyframes::Keyframe;
use super::super::walk::Walk;
use super::stage_of_facets;
use super::views::Views;
use crate::light::CameraCurve;
use crate::light::camera_curve::Bend;
use crate::survey::named_points::NamedPoints;
use crate::tracker::TrackerSetup;

/// What all steps share.
pub struct Job<'a> {
    /// The camera, and the configured surfaces.
    pub setup: &'a TrackerSetup,
    /// Points and lengths that were measured.
    pub named: &'a NamedPoints,
    /// Numbers of the frames in which points were clicked; `None` if the clips have no such frame.
    pub clicked: Vec<Option<usize>>,
    /// The light that grey levels stand for.
    pub curve: CameraCurve,
    /// Bend of the curve.
    pub bend: Bend,
    /// Number of frames of the walk.
    pub frames: usize,
    /// Number of those in which a configured surface was found.
    pub found: usize,
    /// Returns false to stop the work.
    pub goes_on: &'a (dyn Fn() -> bool + Sync),
}

impl<'a> Job<'a> {
    /// Creates the job of mapping a walk.
    pub fn of(walk: &Walk, setup: &'a TrackerSetup, named: &'a NamedPoints, goes_on: &'a (dyn Fn() -> bool + Sync)) -> Self {
        let curve = CameraCurve::bent(setup.settings.transfer.unwrap_or_default(), &walk.bend);
        let (clicked, bend, frames, found) = (walk.named.clone(), walk.bend, walk.frames, walk.found);
        Self { setup, named, clicked, curve, bend, frames, found, goes_on }
    }

    /// Returns keyframes as the mapping looks at them.
    pub fn views<'b>(&'b self, keyframes: &'b [Keyframe]) -> Views<'b> {
        stage_of_facets::views(keyframes, self.setup, &self.curve)
    }

    /// Whether surfaces are configured, which give frame and scale.
    pub fn has_surfaces(&self) -> bool {
        !self.setup.stage.surfaces.is_empty()
    }
}
