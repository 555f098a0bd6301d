//! The poster: tracked from near, from far and askew, with a lower sigma than natural pictures of
//! the same width.

use nalgebra::Point3;
use stagepose::diagnostics::calibrate::paint_poster;
use stagepose::{CameraPath, Frame, Measurement, Renderer, Timestamp, Tracker, TrackerSetup};

use super::one_picture::{in_front, one_picture, walk};

/// Tracks four frames of a still 640x480 camera, this many widths in front and this far askew.
/// Returns the last measurement, and the error of the camera's centre in widths.
fn seen(picture: &image::GrayImage, widths: f64, askew_deg: f64, light: f32) -> Option<(Measurement, f64)> {
    let at = in_front(widths, askew_deg);
    let scene = one_picture(picture.clone(), CameraPath::fixed(at, Point3::origin()), light);
    let mut tracker = Tracker::new(TrackerSetup::from(&scene)).expect("a setup that fits");
    let renderer = Renderer::new(scene);
    let frame = |k: u64| Frame::new(renderer.render(0.0, k), Timestamp::from_ns(k as i64 * 33_333_333), k);
    let last = (0..4).filter_map(|k| tracker.track(&frame(k)).ok()).last()?;
    last.measurement.map(|m| {
        let off = (Point3::from(m.pose.translation) - at).norm();
        (m, off)
    })
}

#[test]
fn the_poster_is_tracked_near_far_askew_and_in_dim_light() {
    let picture = paint_poster(850, 1200, 7);
    for (widths, askew_deg, light) in [(0.3, 0.0, 1.0), (1.0, 60.0, 1.0), (5.0, 0.0, 1.0), (1.0, 30.0, 0.15)] {
        let (_, off) = seen(&picture, widths, askew_deg, light).unwrap_or_else(|| panic!("lost at {widths} widths, {askew_deg} degrees"));
        assert!(off < 0.01 * widths, "{widths} widths, {askew_deg} degrees: {off} widths off");
    }
}

/// At ten widths, the poster is 55 pixels wide. The camera stops abruptly there, which no motion
/// filter predicts.
#[test]
fn the_poster_is_followed_to_ten_widths_and_75_degrees() {
    let picture = paint_poster(850, 1200, 7);
    for (from, to) in [((5.0, 0.0), (10.0, 0.0)), ((1.0, 45.0), (1.0, 75.0))] {
        let scene = one_picture(picture.clone(), walk(from, to, 1.0), 1.0);
        let mut tracker = Tracker::new(TrackerSetup::from(&scene)).expect("a setup that fits");
        let renderer = Renderer::new(scene);
        for k in 0..40_u64 {
            let time_s = k as f64 / 30.0;
            let frame = Frame::new(renderer.render(time_s, k), Timestamp::from_seconds(time_s), k);
            let sample = tracker.track(&frame).expect("a frame in order");
            // The first two frames confirm each other.
            assert!(sample.measurement.is_some() || k < 2, "{to:?}: lost in frame {k}");
            if let Some(m) = sample.measurement.filter(|_| k >= 30) {
                let off = (m.pose.translation - in_front(to.0, to.1).coords).norm();
                let sigma = m.covariance.fixed_view::<3, 3>(0, 0).trace().sqrt();
                println!("{to:?}: {off:.2e} widths off, sigma {sigma:.2e}");
                // An abrupt stop from 7 widths a second could also be a zoom, and the covariance
                // includes that.
                let limit = if to.1 == 0.0 { 0.03 } else { 0.02 };
                assert!(sigma < limit * to.0 && off < 5.0 * sigma, "{to:?}: {off} widths off, sigma {sigma}, in frame {k}");
            }
        }
    }
}

/// Needs the pictures in ../shared/data/textures; without them, nothing is compared.
/// `cargo bench --bench poster` takes all pictures at all distances; these are the most telling
/// ones.
#[test]
fn a_poster_has_smaller_sigma_than_natural_pictures() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/textures");
    let names = ["starry_night.jpg", "astronaut.png", "Wine_by_Jakkub_Mede.jpg"];
    let pictures: Vec<_> = names.iter().filter_map(|name| Some((*name, image::open(folder.join(name)).ok()?.to_luma8()))).collect();
    let poster = paint_poster(850, 1200, 8);
    for widths in [1.0, 3.0] {
        let sigma = |picture| seen(picture, widths, 0.0, 1.0).map(|(m, _)| m.covariance.fixed_view::<3, 3>(0, 0).trace().sqrt());
        let of_poster = sigma(&poster).unwrap_or_else(|| panic!("lost at {widths} widths"));
        for (name, picture) in &pictures {
            // A picture that is not found counts as an infinite sigma.
            let natural = sigma(picture).unwrap_or(f64::INFINITY);
            assert!(of_poster < natural, "{widths} widths: {of_poster} against {natural} of {name}");
        }
    }
}

#[test]
fn a_walk_ends_where_it_should() {
    let path = walk((1.0, 0.0), (10.0, 60.0), 3.0);
    for (time_s, place) in [(0.0, in_front(1.0, 0.0)), (3.0, in_front(10.0, 60.0)), (9.0, in_front(10.0, 60.0))] {
        assert!((path.pose(time_s).translation - place.coords).norm() < 1e-9, "{time_s}");
    }
    assert!((path.pose(1.5).translation.norm() - 10.0_f64.sqrt()).abs() < 0.01);
}
