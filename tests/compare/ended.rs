//! Slow work reports progress while it runs, and stops when it is no longer wanted.

use std::cell::{Cell, RefCell};

use image::GrayImage;
use stagepose::diagnostics::simulate::{grey, paint};
use stagepose::two_views::features::{DetectorKind, FeatureSettings, Share};
use stagepose::two_views::{CompareOptions, Comparison, Step, View, compare};

fn compared(picture: &GrayImage, detector: DetectorKind, goes_on: &dyn Fn(Step, Share) -> bool) -> Option<Comparison> {
    let view = View { picture, camera: None };
    let mut options = CompareOptions::default();
    options.features = FeatureSettings::of(detector);
    compare(&view, &view, &options, goes_on)
}

#[test]
fn asift_reports_progress_view_by_view() {
    let picture = grey(&paint(200, 150, 1));
    let heard = RefCell::new(Vec::new());
    let hear = |step, share| {
        let mut heard = heard.borrow_mut();
        if heard.last() != Some(&(step, share)) {
            heard.push((step, share));
        }
        true
    };
    assert!(compared(&picture, DetectorKind::Asift, &hear).is_some());
    let views = |step: Step| (0..41).map(move |done| (step, Share { done, of: 41 }));
    let mut expected = Vec::new();
    for step in [Step::FirstFeatures, Step::SecondFeatures] {
        expected.push((step, Share::NOTHING));
        expected.extend(views(step));
    }
    expected.extend([(Step::Matching, Share::NOTHING), (Step::Geometry, Share::NOTHING)]);
    assert_eq!(heard.into_inner(), expected);
}

/// Wherever it is stopped, there is no result, and the callback is not called again.
#[test]
fn every_detector_stops_at_once_when_cancelled() {
    let picture = grey(&paint(200, 150, 1));
    for (name, detector) in DetectorKind::ALL {
        let asked_until = |end: usize| {
            let asked = Cell::new(0);
            let ask = |_, _| {
                asked.set(asked.get() + 1);
                asked.get() < end
            };
            (compared(&picture, detector, &ask).is_some(), asked.get())
        };
        let (is_done, all) = asked_until(usize::MAX);
        assert!(is_done && all > 6, "{name}: asked {all} times");
        for end in [1, 2, all / 3, all / 2, all - 4, all - 3, all - 2, all - 1, all] {
            assert_eq!(asked_until(end), (false, end), "{name}, of {all}");
        }
    }
}
