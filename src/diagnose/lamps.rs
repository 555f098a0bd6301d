//! Finds walls of lamps: LEDs, or the pixels of a projector, with black between them.
//!
//! Lamps with one pitch across and down give a frame a line in its spectrum that the artwork does
//! not have. The spectrum is taken over places on the surface, not over pixels: perspective does
//! not smear the line there, and what the camera's pixels alias appears at its true pitch as soon
//! as the wall is seen askew or from two distances.

use std::f64::consts::TAU;

use image::GrayImage;
use nalgebra::Vector2;

use super::{Finding, Shown, written};
use crate::camera::{CameraModel, Normalized, Pixel};
use crate::frame::Frame;
use crate::geometry::robust_kernel::median;
use crate::geometry::{Body, Camera, Pose, Stage, SurfaceFrame};
use crate::track::SurfaceSpec;

/// Maximum number of frames examined for each surface. Chosen for time. Raised, an alias is taken
/// for the pitch less often.
const MAX_FRAMES: usize = 4;
/// Half the side of the window that is examined, pixels. Raised, lines in the spectrum are sharper,
/// and the work grows squared.
const HALF_PX: i32 = 80;
/// Shortest and longest pitch looked for, pixels of the frame. Below the first a pixel averages the
/// lamps out; beyond the second lamps are details of the picture like others.
const PITCHES_PX: [f64; 2] = [1.2, 12.0];
/// Minimum amplitude of a line, both across and down, in medians of the spectrum. Pictures without
/// lamps reach 4, lamps more than 20. Raised, faint lamps are missed.
const MIN_LINE: f64 = 9.0;
/// Maximum deviation of a frame's pitch from the median of the frames, as a fraction. Raised,
/// aliases count as the pitch.
const MAX_DEVIATION: f64 = 0.01;
/// Number of visible places of a surface, across and down, of which the window is the middle.
const PLACES: i32 = 9;
/// Pixels of the frame in the pitch below which the finest level, half the frame's size, averages
/// the lamps out.
const VANISHING_PX: f64 = 2.0;

/// The lamps of a wall.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Lamps {
    /// Distance from one lamp to the next, metres.
    pitch_m: f64,
    /// The same as the frame shows it, pixels.
    pitch_px: f64,
}

/// Grey at a place of a surface.
struct Sample {
    /// Metres on the surface, from its centre.
    place: Vector2<f64>,
    frame: f64,
    artwork: f64,
}

/// Reports the surfaces that are walls of lamps, from frames whose pose is known.
pub fn of_walls(shown: &Shown<'_>) -> Vec<Finding> {
    let posed: Vec<(&Frame, &Pose<Stage, Camera>)> =
        shown.frames.iter().filter_map(|frame| Some((frame, shown.travel.pose_at(frame.timestamp)?))).collect();
    let step = posed.len().div_ceil(MAX_FRAMES).max(1);
    let chosen: Vec<_> = posed.into_iter().step_by(step).collect();
    let surfaces = shown.setup.stage.surfaces.iter();
    surfaces
        .filter_map(|surface| Some(finding(surface, &shown.setup.camera, &of_surface(surface, &shown.setup.camera, &chosen)?)))
        .collect()
}

fn finding(surface: &SurfaceSpec, camera: &CameraModel, lamps: &Lamps) -> Finding {
    let (pitch_mm, vanish_m) = (1e3 * lamps.pitch_m, lamps.pitch_m * camera.intrinsics().fx / VANISHING_PX);
    Finding::note(format!(
        "{}: it is a wall of lamps {} mm apart, {:.1} pixels in this clip: beyond {} m from it they vanish; nearer, the stage is \
         followed at a coarser scale, less exactly; its content must stand still",
        surface.name,
        written((pitch_mm * 100.0).round() / 100.0),
        lamps.pitch_px,
        written((vanish_m * 10.0).round() / 10.0)
    ))
}

/// Returns the lamps on which most frames agree.
fn of_surface(surface: &SurfaceSpec, camera: &CameraModel, frames: &[(&Frame, &Pose<Stage, Camera>)]) -> Option<Lamps> {
    let samples: Vec<_> = frames.iter().filter_map(|(frame, pose)| samples(&Sight::new(surface, camera, pose), &frame.image)).collect();
    let found: Vec<Lamps> = samples.iter().filter_map(|(samples, metres_per_px)| lamps(samples, *metres_per_px)).collect();
    let pitch_m = median(&mut found.iter().map(|lamps| lamps.pitch_m).collect::<Vec<_>>())?;
    let agreeing: Vec<&Lamps> = found.iter().filter(|lamps| (lamps.pitch_m / pitch_m - 1.0).abs() < MAX_DEVIATION).collect();
    let pitch_px = median(&mut agreeing.iter().map(|lamps| lamps.pitch_px).collect::<Vec<_>>())?;
    (2 * agreeing.len() > samples.len()).then_some(Lamps { pitch_m, pitch_px })
}

/// A surface as a frame's camera sees it.
struct Sight<'a> {
    surface: &'a SurfaceSpec,
    camera: &'a CameraModel,
    surface_from_camera: Pose<SurfaceFrame, Camera>,
}

impl<'a> Sight<'a> {
    fn new(surface: &'a SurfaceSpec, camera: &'a CameraModel, pose: &Pose<Stage, Camera>) -> Self {
        Self { surface, camera, surface_from_camera: surface.pose.inverse() * pose.renamed::<Body, Camera>() }
    }

    /// Returns the place on the surface that a pixel shows.
    fn place_of(&self, pixel: [i32; 2]) -> Option<Vector2<f64>> {
        let Normalized(ray) = self.camera.unproject(Pixel(Vector2::from(pixel.map(f64::from))))?;
        let (direction, from) = (self.surface_from_camera.rotation * ray.push(1.0), self.surface_from_camera.translation);
        let place = self.surface.shape.meet(&from, &direction)?;
        let is_ahead = (self.surface.shape.at(place).place - from).dot(&direction) > 0.0;
        let is_on = [0, 1].iter().all(|axis| place[*axis].abs() < 0.5 * self.surface.size_m[*axis]);
        (is_ahead && is_on).then_some(place.into())
    }

    /// Returns the middle of what the frame shows of the surface, and the width of a pixel there,
    /// metres.
    fn middle(&self) -> Option<([i32; 2], f64)> {
        let camera_from_surface = self.surface_from_camera.inverse();
        let pixel_of = |n: i32| {
            let share = |k: i32| f64::from(k) / f64::from(PLACES - 1) - 0.5;
            let place = [share(n % PLACES) * self.surface.size_m[0], share(n / PLACES) * self.surface.size_m[1]];
            let point = camera_from_surface.transform(&self.surface.shape.at(place).place.into());
            let pixel = self.camera.project(Normalized(point.coords.xy() / point.z)).0;
            let is_inside =
                (0.0..f64::from(self.camera.width())).contains(&pixel.x) && (0.0..f64::from(self.camera.height())).contains(&pixel.y);
            (point.z > 0.0 && is_inside).then_some(pixel)
        };
        let visible: Vec<_> = (0..PLACES * PLACES).filter_map(pixel_of).collect();
        let middle = visible.iter().sum::<Vector2<f64>>() / visible.len().max(1) as f64;
        let middle = [middle.x as i32, middle.y as i32];
        let from = self.place_of(middle)?;
        let [across, down] = [self.place_of([middle[0] + 1, middle[1]])? - from, self.place_of([middle[0], middle[1] + 1])? - from];
        let metres_per_px = across.perp(&down).abs().sqrt();
        (metres_per_px > 0.0).then_some((middle, metres_per_px))
    }
}

/// Samples a window of the frame around the middle of what it shows of the surface. Returns the
/// samples and the width of a pixel there, metres. `None` if the frame shows too little.
fn samples(sight: &Sight<'_>, image: &GrayImage) -> Option<(Vec<Sample>, f64)> {
    let (middle, metres_per_px) = sight.middle()?;
    // A window without edges, so that the spectrum of the picture does not leak into its lines.
    let taper = |d: i32| 0.5 + 0.5 * (0.5 * TAU * (f64::from(d) + 0.5) / f64::from(HALF_PX)).cos();
    let artwork = &sight.surface.artwork;
    let sample = |[dx, dy]: [i32; 2]| {
        let at = [middle[0] + dx, middle[1] + dy];
        let [x, y] = [u32::try_from(at[0]).ok()?, u32::try_from(at[1]).ok()?];
        let (grey, place) = (image.get_pixel_checked(x, y)?[0], sight.place_of(at)?);
        let texel = sight.surface.to_artwork(place).map(f64::round);
        let drawn = artwork.get_pixel_checked(texel.x as u32, texel.y as u32)?[0];
        let weight = taper(dx) * taper(dy);
        Some(Sample { place, frame: weight * f64::from(grey), artwork: weight * f64::from(drawn) })
    };
    let window = (-HALF_PX..HALF_PX).flat_map(|dy| (-HALF_PX..HALF_PX).map(move |dx| [dx, dy]));
    let samples: Vec<Sample> = window.filter_map(sample).collect();
    (samples.len() as i32 >= HALF_PX * HALF_PX).then_some((samples, metres_per_px))
}

/// Finds the pitch at which the frame's spectrum has a line both across and down that the artwork's
/// does not have.
fn lamps(samples: &[Sample], metres_per_px: f64) -> Option<Lamps> {
    let step = 0.5 / (f64::from(HALF_PX) * metres_per_px);
    let [longest, shortest] = [PITCHES_PX[1], PITCHES_PX[0]].map(|pitch_px| 1.0 / (pitch_px * metres_per_px));
    let frequencies: Vec<f64> = (0..).map(|k| longest + f64::from(k) * step).take_while(|f| *f < shortest).collect();
    let of_frame = |sample: &Sample| sample.frame;
    let across = lines(samples, 0, &frequencies, of_frame);
    if across.iter().all(|line| *line < MIN_LINE) {
        return None;
    }
    let spectra = [across, lines(samples, 1, &frequencies, of_frame)];
    let strength = |k: usize| spectra[0][k].min(spectra[1][k]);
    let best = (0..frequencies.len()).max_by(|a, b| strength(*a).total_cmp(&strength(*b)))?;
    if strength(best) < MIN_LINE {
        return None;
    }
    let of_artwork = [0, 1].map(|axis| lines(samples, axis, &frequencies, |sample: &Sample| sample.artwork)[best]);
    if of_artwork[0].min(of_artwork[1]) > 0.5 * strength(best) {
        return None;
    }
    let sum = |f: f64| amplitude(samples, 0, f, of_frame) + amplitude(samples, 1, f, of_frame);
    let near = (-10..=10).map(|k| frequencies[best] + 0.1 * f64::from(k) * step);
    let frequency = near.max_by(|a, b| sum(*a).total_cmp(&sum(*b)))?;
    Some(Lamps { pitch_m: 1.0 / frequency, pitch_px: 1.0 / (frequency * metres_per_px) })
}

/// Returns the spectrum along one axis of the surface, in units of its median.
fn lines(samples: &[Sample], axis: usize, frequencies: &[f64], value: impl Fn(&Sample) -> f64) -> Vec<f64> {
    let mut spectrum: Vec<f64> = frequencies.iter().map(|f| amplitude(samples, axis, *f, &value)).collect();
    let usual = median(&mut spectrum.clone()).unwrap_or(0.0).max(f64::MIN_POSITIVE);
    spectrum.iter_mut().for_each(|amplitude| *amplitude /= usual);
    spectrum
}

/// Returns the amplitude of a frequency, cycles per metre, along one axis of the surface.
fn amplitude(samples: &[Sample], axis: usize, frequency: f64, value: impl Fn(&Sample) -> f64) -> f64 {
    let mut sum = [0.0; 2];
    for sample in samples {
        let (sin, cos) = ((TAU * frequency * sample.place[axis]) as f32).sin_cos();
        let value = value(sample);
        sum = [sum[0] + value * f64::from(cos), sum[1] + value * f64::from(sin)];
    }
    sum[0].hypot(sum[1])
}

#[cfg(test)]
mod tests {
    use image::Luma;
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;
    use crate::frame::Timestamp;
    use crate::simulate::{grey, paint, upright};

    /// A frame of a wall of 4 x 3 m from `distance_m`, lamps `pitch_m` apart if any, and its pose.
    fn view(distance_m: f64, pitch_m: Option<f64>, artwork: &GrayImage) -> (SurfaceSpec, CameraModel, Frame, Pose<Stage, Camera>) {
        let camera = CameraModel::pinhole(640, 480, 600.0, 600.0, 319.5, 239.5).expect("a camera");
        let surface =
            SurfaceSpec::from_artwork("wall".into(), artwork.clone(), [4.0, 3.0], upright(Vector3::zeros(), 0.0)).expect("a surface");
        // The camera's axes x right, y down, z ahead, at some distance before the wall, askew.
        let facing: Pose<Stage, Camera> = upright(Vector3::new(-0.3, -distance_m, 0.1), 0.0).renamed();
        let turn = UnitQuaternion::from_euler_angles(std::f64::consts::PI + 0.05, 0.08, 0.03);
        let pose = Pose::new(facing.rotation * turn, facing.translation);
        let sight = Sight::new(&surface, &camera, &pose);
        let grey_at = |x: f64, y: f64| {
            let Normalized(ray) = camera.unproject(Pixel(Vector2::new(x, y))).expect("a ray");
            let (direction, from) = (sight.surface_from_camera.rotation * ray.push(1.0), sight.surface_from_camera.translation);
            let place = Vector2::from(surface.shape.meet(&from, &direction).expect("a place"));
            let texel = surface.to_artwork(place).map(f64::round);
            let is_lit = pitch_m.is_none_or(|pitch| place.iter().all(|metres| (metres / pitch).rem_euclid(1.0) < 0.75));
            let drawn = artwork.get_pixel_checked(texel.x as u32, texel.y as u32).map_or(0, |pixel| pixel[0]);
            if is_lit { f64::from(drawn) } else { 0.0 }
        };
        let image = GrayImage::from_fn(640, 480, |x, y| {
            let part = |pixel: u32, k: u32| f64::from(pixel) + 0.25 * f64::from(k) - 0.375;
            Luma([((0..16).map(|k| grey_at(part(x, k % 4), part(y, k / 4))).sum::<f64>() / 16.0) as u8])
        });
        let frame = Frame { image, timestamp: Timestamp::default(), sequence: 0 };
        (surface, camera, frame, pose)
    }

    fn found(distances_m: &[f64], pitch_m: Option<f64>, artwork: &GrayImage) -> Option<Lamps> {
        let views: Vec<_> = distances_m.iter().map(|distance_m| view(*distance_m, pitch_m, artwork)).collect();
        let frames: Vec<_> = views.iter().map(|(_, _, frame, pose)| (frame, pose)).collect();
        of_surface(&views[0].0, &views[0].1, &frames)
    }

    #[test]
    fn the_pitch_of_lamps_is_found() {
        let artwork = grey(&paint(800, 600, 5));
        for (pitch_m, distance_m) in [(0.004, 1.5), (0.008, 2.0), (0.008, 3.0), (0.016, 3.0), (0.016, 5.0)] {
            let lamps = found(&[distance_m], Some(pitch_m), &artwork).expect("lamps");
            assert!((lamps.pitch_m / pitch_m - 1.0).abs() < 0.01, "{pitch_m} at {distance_m}: {lamps:?}");
        }
    }

    #[test]
    fn no_lamps_are_found_in_a_print() {
        for seed in [5, 6, 7] {
            assert_eq!(found(&[2.0], None, &grey(&paint(800, 600, seed))), None, "{seed}");
        }
        // A print of a grid is not lit by lamps: the artwork shows the same grid.
        let mut grid = grey(&paint(800, 600, 5));
        for (_, _, pixel) in grid.enumerate_pixels_mut().filter(|(x, y, _)| x % 4 == 3 || y % 4 == 3) {
            *pixel = Luma([0]);
        }
        assert_eq!(found(&[2.0], None, &grid), None);
    }
}
