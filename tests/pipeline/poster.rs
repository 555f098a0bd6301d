//! The poster: tracked from near and far and askew, and told better than natural pictures of the same width.

use nalgebra::{Point3, Vector3};
use stagepose::camera::CameraModel;
use stagepose::frame::Frame;
use stagepose::record::Measurement;
use stagepose::simulate::{CameraPath, LightKey, Renderer, SensorNoise, VirtualStage, artwork_surface, upright};
use stagepose::targets::poster;
use stagepose::track::BodySpec;
use stagepose::{Tracker, TrackerSetup};

/// The last of four frames of a still camera with 640x480 pixels, this many widths in front and this far askew; and how far off the
/// camera's centre is, widths.
fn seen(picture: &image::GrayImage, widths: f64, askew_deg: f64, light: f32) -> Option<(Measurement, f64)> {
    let camera = CameraModel::pinhole(640, 480, 550.0, 550.0, 319.5, 239.5).unwrap();
    let size_m = [1.0, f64::from(picture.height()) / f64::from(picture.width())];
    let angle = askew_deg.to_radians();
    let at = Point3::new(angle.sin(), -angle.cos(), 0.0) * widths;
    let surface = artwork_surface("poster", picture.clone(), size_m, upright(Vector3::zeros(), 0.0));
    let stage = BodySpec { name: "stage".into(), surfaces: vec![surface] };
    let mut scene = VirtualStage::new(camera, CameraPath::fixed(at, Point3::origin()), stage);
    scene.noise = SensorNoise::webcam();
    scene.background = 90.0;
    scene.samples = 8;
    scene.light = vec![LightKey { time_s: 0.0, gain: light }];
    let mut tracker = Tracker::new(TrackerSetup::from(&scene));
    let renderer = Renderer::new(scene);
    let frame = |k: u64| Frame { image: renderer.render(0.0, k), timestamp_ns: k as i64 * 33_333_333, sequence: k };
    let last = (0..4).map(|k| tracker.track(&frame(k))).last()?;
    last.measurement.map(|m| {
        let off = (Point3::from(m.pose.translation) - at).norm();
        (m, off)
    })
}

#[test]
fn the_poster_is_tracked_near_far_askew_and_in_dim_light() {
    let picture = poster::paint(850, 1200, 7);
    for (widths, askew_deg, light) in [(0.3, 0.0, 1.0), (1.0, 60.0, 1.0), (5.0, 0.0, 1.0), (1.0, 30.0, 0.15)] {
        let (_, off) = seen(&picture, widths, askew_deg, light).unwrap_or_else(|| panic!("lost at {widths} widths, {askew_deg} degrees"));
        assert!(off < 0.01 * widths, "{widths} widths, {askew_deg} degrees: {off} widths off");
    }
}

/// Needs the pictures of ../shared/data/textures; without them nothing is compared. `cargo bench --bench poster` takes all of them, at all
/// distances; these are those that tell most.
#[test]
fn its_sigma_is_below_that_of_natural_pictures_of_the_same_width() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/textures");
    let names = ["starry_night.jpg", "astronaut.png", "Wine_by_Jakkub_Mede.jpg"];
    let pictures: Vec<_> = names.iter().filter_map(|name| Some((*name, image::open(folder.join(name)).ok()?.to_luma8()))).collect();
    let poster = poster::paint(850, 1200, 8);
    for widths in [1.0, 3.0] {
        let sigma = |picture| seen(picture, widths, 0.0, 1.0).map(|(m, _)| m.covariance.fixed_view::<3, 3>(0, 0).trace().sqrt());
        let of_poster = sigma(&poster).unwrap_or_else(|| panic!("lost at {widths} widths"));
        for (name, picture) in &pictures {
            // A picture that is not found tells nothing.
            let natural = sigma(picture).unwrap_or(f64::INFINITY);
            assert!(of_poster < natural, "{widths} widths: {of_poster} against {natural} of {name}");
        }
    }
}
