//! The anchors of a body's last verified pose.

use crate::track::patches::fitted_anchor::FittedAnchor;

/// How a pose was verified.
#[derive(Debug, Clone, Copy, Default)]
enum VerifiedBy {
    /// By alignment: its patches are the anchors, and all of them fit.
    #[default]
    Alignment,
    /// By registration: anchors were searched for near the pose, and some do not fit.
    Registration,
}

/// The anchors of a verified pose. Its buffers are reused from frame to frame.
#[derive(Debug, Default)]
pub struct PoseAnchors {
    verified_by: VerifiedBy,
    fitting: Vec<FittedAnchor>,
    /// All anchors that registration found, fitting or not.
    registered: Vec<FittedAnchor>,
}

impl PoseAnchors {
    /// Creates an empty list with room for the patches of an alignment.
    pub fn with_capacity(patches: usize) -> Self {
        Self { fitting: Vec::with_capacity(patches), ..Self::default() }
    }

    /// Returns the anchors that fit the pose.
    pub fn fitting(&self) -> &[FittedAnchor] {
        &self.fitting
    }

    /// Returns all anchors that were found near the pose. Includes those that do not fit: a wrong
    /// lens or shape may be why they do not.
    pub fn all(&self) -> &[FittedAnchor] {
        match self.verified_by {
            VerifiedBy::Alignment => &self.fitting,
            VerifiedBy::Registration => &self.registered,
        }
    }

    /// Replaces the anchors with the patches of an aligned pose.
    pub fn set_aligned(&mut self, patches: impl Iterator<Item = FittedAnchor>) {
        self.verified_by = VerifiedBy::Alignment;
        self.fitting.clear();
        self.fitting.extend(patches);
    }

    /// Replaces the anchors with those of a registered pose: the fitting ones, and all.
    pub fn set_registered(&mut self, fitting: &[FittedAnchor], all: &[FittedAnchor]) {
        self.verified_by = VerifiedBy::Registration;
        self.fitting.clear();
        self.fitting.extend_from_slice(fitting);
        self.registered.clear();
        self.registered.extend_from_slice(all);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::synthetic::{cloth, facing, lens, prepared, seen_anchors};
    use nalgebra::{Vector2, Vector3};

    #[test]
    fn all_anchors_are_those_of_the_last_verification() {
        let pose = facing(0.2, -0.3, Vector3::new(0.1, 0.05, 3.4));
        let found = seen_anchors(&prepared(vec![cloth(1)]), &pose, &lens(480, 360), 4, |_, _| Vector2::zeros());
        let mut anchors = PoseAnchors::default();
        anchors.set_registered(&found[..3], &found);
        assert_eq!((anchors.fitting().len(), anchors.all().len()), (3, found.len()));
        // An aligned pose after it has no others, even if it has no anchor at all.
        anchors.set_aligned(found[..2].iter().copied());
        assert_eq!((anchors.fitting(), anchors.all()), (&found[..2], &found[..2]));
        anchors.set_aligned(std::iter::empty());
        assert!(anchors.all().is_empty());
    }
}
