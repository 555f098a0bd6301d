//! Measures single frames for the survey: where each tile of a surface is seen relative to where
//! the current model puts it.
//!
//! The survey refines the model of stage and lens, and asks the frames of a walk again with each
//! better model. Nothing is tracked here: every frame is aligned by itself, starting at the motion
//! found for it before. Uses `align`, `patches` and `scene`.

use super::tuning::frame_order::TUNING;
use image::GrayImage;
use nalgebra::{Matrix2, Vector2, Vector3};

use super::align::{AlignRequest, Aligner, CameraRays, FrameLevels, Patch, PixelShift, Start};
use super::patches::registration::{Registered, SearchPicture, Target, register, visible_targets};
use super::scene::rectangle::Rectangle;
use super::scene::reference::PreparedBody;
use super::scene::surface::{BodySpec, SurfaceSpec};
use crate::camera::{CameraModel, Shutter};
use crate::features::Workers;
use crate::geometry::resection::{MovingCamera, Observation, resect, residual_and_jacobian};
use crate::geometry::{Body, Camera, Pose};
use crate::light::CameraCurve;
use crate::motion::{Motion, MotionEstimate};

/// Measures the tiles of one body in frames.
pub struct TileObserver {
    body: PreparedBody,
    aligner: Aligner,
    rays: CameraRays,
    mask: Option<GrayImage>,
    levels: FrameLevels,
    patches: Vec<Patch>,
    half: GrayImage,
    targets: Vec<Target>,
    registered: Vec<Option<Registered>>,
    workers: Workers,
}

/// A tile of a surface in a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObservedTile {
    /// Index of the surface in its body.
    pub surface: usize,
    /// The centre of its detail on the picture, metres from the picture's centre.
    pub on_picture_m: [f64; 2],
    /// Offset of where the frame shows it from where the model puts it, pixels of the frame.
    pub shift_px: Vector2<f64>,
    /// Information matrix of that offset, pixels^-2.
    pub information: Matrix2<f64>,
    /// When its rows were exposed, seconds after the frame's timestamp.
    pub delay_s: f64,
    /// Its number among the frame's tiles.
    pub number: u32,
}

/// The rates of a camera's motion, as estimated from neighbouring frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownRates {
    /// Velocity, angular velocity, acceleration and angular acceleration; axes as in [`Motion`].
    pub means: [Vector3<f64>; 4],
    /// One sigma of each, per axis.
    pub sigmas: [f64; 4],
}

impl KnownRates {
    /// Returns the motion that has these rates at `pose`.
    pub fn on(&self, pose: &Pose<Body, Camera>) -> Motion {
        let [velocity, angular_velocity, acceleration, angular_acceleration] = self.means;
        Motion { pose: *pose, velocity, angular_velocity, acceleration, angular_acceleration }
    }
}

/// What a frame shows.
#[derive(Debug, Clone)]
pub struct ObservedFrame {
    /// The camera's motion, under the current model.
    pub motion: Motion,
    /// The prior of the motion's rates, if there was one.
    pub rates: Option<KnownRates>,
    /// The tiles that fit.
    pub tiles: Vec<ObservedTile>,
}

/// What a frame shows, pixel by pixel.
#[derive(Debug, Clone)]
pub struct ObservedPixels {
    /// The camera's motion, under the current model.
    pub motion: Motion,
    /// The pixels of the tiles that fit.
    pub pixels: Vec<PixelShift>,
}

impl TileObserver {
    /// Prepares a body's pictures. `curve`: that by which the camera encodes light.
    pub fn new(camera: CameraModel, shutter: Shutter, curve: &CameraCurve, mask: Option<GrayImage>, body: &BodySpec) -> Self {
        let body = PreparedBody::new(body).with_anchors();
        let mut aligner = Aligner::new(&body, shutter);
        aligner.assume_curve(curve, false);
        let mut levels = FrameLevels::default();
        levels.set_curve(curve);
        Self {
            rays: CameraRays::new(camera, mask.clone()),
            mask,
            levels,
            patches: Vec::with_capacity(aligner.most_patches()),
            half: GrayImage::default(),
            targets: Vec::new(),
            registered: Vec::new(),
            workers: Workers::new(1),
            aligner,
            body,
        }
    }

    /// Replaces the model: the same pictures with other poses, shapes or another lens.
    pub fn take_model(&mut self, camera: &CameraModel, surfaces: &[SurfaceSpec]) {
        self.aligner.take_places(surfaces);
        for (own, surface) in self.body.surfaces.iter_mut().zip(surfaces) {
            (own.spec.pose, own.spec.shape) = (surface.pose, surface.shape.clone());
            own.rectangle = Rectangle::of(surface);
        }
        if self.rays.camera() != camera {
            self.rays = CameraRays::new(*camera, self.mask.clone());
        }
    }

    /// Sets the readout time, seconds; the exposure stays as it is.
    pub fn take_readout(&mut self, readout_s: f64) {
        self.aligner.take_readout(readout_s);
    }

    /// Registers anchors of each surface near the pose `start` and returns where the frame shows
    /// them, and the pose that explains them best; `None` if too few are found. `is_half`: search
    /// at half size, up to ten pixels around the predicted place. For surfaces that the model
    /// misplaces beyond the tiles' reach.
    pub fn observe_anchors(&mut self, image: &GrayImage, start: &Pose<Body, Camera>, is_half: bool) -> Option<ObservedFrame> {
        let camera = *self.rays.camera();
        self.levels.update(image);
        self.levels.half_into(&mut self.half);
        let (image, scale) = if is_half { (&self.half, 2.0) } else { (image, 1.0) };
        let picture = SearchPicture { image, scale, mask: self.mask.as_ref() };
        let pose = start.inverse();
        visible_targets(&self.body, &pose, &camera, &picture, TUNING.max_anchors, &mut self.targets);
        register(&self.body, &self.targets, &picture, &self.workers, &mut self.registered);
        let seen: Vec<(&Registered, Observation)> = self.registered.iter().flatten().filter_map(|r| Some((r, r.observation?))).collect();
        let observations: Vec<Observation> = seen.iter().map(|(_, o)| *o).collect();
        if observations.len() < TUNING.min_anchors {
            return None;
        }
        let still = MovingCamera::still(&camera);
        let pose = resect(&pose, &still, &observations, 15)?.pose;
        let tile = |(number, (r, o)): (usize, &(&Registered, Observation))| {
            let (residual, _) = residual_and_jacobian(&pose, &still, o)?;
            Some(ObservedTile {
                surface: r.surface as usize,
                on_picture_m: self.body.surfaces[r.surface as usize].spec.to_metres(r.artwork).into(),
                shift_px: -residual,
                information: o.information,
                delay_s: 0.0,
                number: number as u32,
            })
        };
        Some(ObservedFrame {
            motion: Motion::still(pose.inverse()),
            rates: None,
            tiles: seen.iter().enumerate().filter_map(tile).collect(),
        })
    }

    /// Aligns a frame starting at `start` and returns where it shows the tiles; `rates`: prior of
    /// the motion's rates, if known. `None` if the picture does not confirm the model.
    pub fn observe(&mut self, image: &GrayImage, start: &Motion, rates: Option<KnownRates>) -> Option<ObservedFrame> {
        let expected = self.expected(start, rates);
        self.levels.update(image);
        let solution = self.aligner.align(&mut self.levels, &self.rays, &AlignRequest::new(Start::found(&expected), false))?;
        let found = solution.alignment;
        if !found.is_credible(true) {
            return None;
        }
        solution.accept(&mut self.patches);
        let tile = |p: &Patch| ObservedTile {
            surface: p.surface as usize,
            on_picture_m: p.on_surface_m.into(),
            shift_px: p.shift_px,
            information: p.information,
            delay_s: p.delay_s,
            number: p.tile,
        };
        Some(ObservedFrame { motion: found.estimate.motion, rates, tiles: self.patches.iter().map(tile).collect() })
    }

    /// Aligns a frame as [`observe`](Self::observe) does and returns what its single pixels say,
    /// for what is narrower than a tile. Nothing is learnt from the frame.
    pub fn observe_pixels(&mut self, image: &GrayImage, start: &Motion, rates: Option<KnownRates>) -> Option<ObservedPixels> {
        let expected = self.expected(start, rates);
        self.levels.update(image);
        let mut solution = self.aligner.align(&mut self.levels, &self.rays, &AlignRequest::new(Start::found(&expected), false))?;
        if !solution.alignment.is_credible(true) {
            return None;
        }
        let mut pixels = Vec::new();
        solution.pixel_shifts(&mut pixels);
        Some(ObservedPixels { motion: solution.alignment.estimate.motion, pixels })
    }

    /// Returns the prior of a frame's motion; `rates`: that of the motion's rates, if known.
    fn expected(&self, start: &Motion, rates: Option<KnownRates>) -> MotionEstimate {
        let distance_m = self.aligner.distance_m(&start.pose);
        let unseen = MotionEstimate::unseen(start.pose, distance_m, TUNING.start_shift_sigma * distance_m, TUNING.start_rotation_sigma);
        let mut expected = MotionEstimate { motion: *start, ..unseen };
        if let Some(rates) = rates {
            expected.motion = rates.on(&start.pose);
            for axis in 6..18 {
                expected.covariance[(axis, axis)] = rates.sigmas[axis / 3 - 2].powi(2);
            }
        }
        expected
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::Transfer;
    use crate::track::synthetic::{cloth, facing, lens, view};

    #[test]
    fn tiles_are_where_they_are_if_the_cameras_curve_is_known() {
        let (surface, camera) = (cloth(1), lens(640, 480));
        let pose = facing(0.15, -0.2, Vector3::new(0.1, 0.05, 3.6));
        let bent = CameraCurve::bent(Transfer::Srgb, &[0.0, 6.0, 14.0, 20.0, 14.0, 6.0, 0.0]);
        let mut image = view(&surface, &pose, &camera);
        image.iter_mut().for_each(|grey| *grey = bent.grey_of(CameraCurve::default().light()[usize::from(*grey)]).round() as u8);
        let body = BodySpec::new("stage", vec![surface]);
        let shutter = Shutter { readout_s: 0.0, exposure_s: 1e-6 };
        let rms_px = |curve: &CameraCurve| {
            let mut observer = TileObserver::new(camera, shutter, curve, None, &body);
            let tiles = observer.observe(&image, &Motion::still(pose.inverse()), None).expect("a frame that fits").tiles;
            (tiles.iter().map(|tile| tile.shift_px.norm_squared()).sum::<f64>() / tiles.len() as f64).sqrt()
        };
        let [known, assumed] = [&bent, &CameraCurve::default()].map(rms_px);
        assert!(known < 0.8 * assumed && known < 0.02, "{known} {assumed}");
    }
}
