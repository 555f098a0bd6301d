//! What is on the virtual stage, as plain data.

use std::ops::Range;

use image::GrayImage;
use nalgebra::{Point3, Vector3};

use super::light::LightModel;
use super::path::{CameraPath, ObjectPath, Roll};
use super::person::Person;
use super::sensor::SensorNoise;
use super::spot::Spot;
use super::upright::upright;
use crate::camera::{CameraModel, Shutter};
use crate::geometry::{Body, Camera, Pose, Stage, SurfaceFrame};
use crate::light::Transfer;
use crate::track::{BodySpec, ReferenceKind, SurfaceDoubt, SurfaceShape, SurfaceSpec};
use crate::tracker::TrackerSetup;

/// A stage, its camera, and everything that affects what the camera sees.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct VirtualStage {
    /// The camera's optics.
    pub camera: CameraModel,
    /// Where the camera is.
    pub camera_path: CameraPath,
    /// Roll of the camera in addition to its path's.
    pub roll: Option<Roll>,
    /// The surfaces of the stage; its body frame is the stage frame.
    pub stage: BodySpec,
    /// Waves over surfaces of the stage, added to a surface's own shape. A tracker set up from this
    /// stage knows the shapes but not the waves.
    pub draughts: Vec<Draught>,
    /// Tracked objects.
    pub objects: Vec<MovingObject>,
    /// Painted surfaces at rest in the stage frame that the tracker does not know, such as a floor
    /// or a wall.
    pub scenery: Vec<SurfaceSpec>,
    /// People and things that pass in front.
    pub occluders: Vec<Occluder>,
    /// People in patterned clothes who walk in front.
    pub people: Vec<Person>,
    /// The quantity in which light is added up.
    pub light_model: LightModel,
    /// Lamps whose light adds to the wash. They do not light the background.
    pub spots: Vec<Spot>,
    /// Brightness over time, in time order; empty means 1 throughout.
    pub light: Vec<LightKey>,
    /// Times in seconds during which there is no light at all.
    pub blackouts: Vec<Range<f64>>,
    /// The shutter. The middle row's exposure is centred on the frame's stamp; an exposure of 0
    /// freezes motion.
    pub shutter: Shutter,
    /// The sensor's noise.
    pub noise: SensorNoise,
    /// Grey level where no surface is.
    pub background: f32,
    /// Rays per pixel, spread over its area and over the exposure: 4 suits a steady camera, 16 a
    /// fast one. Raised, rendering takes longer.
    pub samples: u32,
    /// Seed of the sensor noise.
    pub seed: u64,
}

/// Standing or running waves over a surface of the stage: folds of a cloth, or a draught that moves
/// it.
#[derive(Debug, Clone, PartialEq)]
pub struct Draught {
    /// The surface's index in the stage; an index past the last surface has no effect.
    pub surface: usize,
    /// The waves, which add up.
    pub waves: Vec<Wave>,
}

/// A wave. It displaces the face outwards by `height_m` · sin(`wave_vector` · (x, y) + 2π `rate_hz`
/// t + `phase_rad`), with x and y along the picture from its centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wave {
    /// Amplitude, metres.
    pub height_m: f64,
    /// Radians per metre along x and y.
    pub wave_vector: [f64; 2],
    /// Frequency, Hz; 0 is a standing fold.
    pub rate_hz: f64,
    /// Phase, radians.
    pub phase_rad: f64,
}

/// A tracked object and its path.
#[derive(Debug, Clone)]
pub struct MovingObject {
    /// Its surfaces, in its own frame.
    pub body: BodySpec,
    /// Where it is.
    pub path: ObjectPath,
}

/// An upright flat ellipse of one grey that sways in front of the stage, as a person would.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Occluder {
    /// Its centre at rest, in the stage.
    pub centre: Point3<f64>,
    /// Amplitude of its sway to either side, metres.
    pub swing: Vector3<f64>,
    /// Period of its sway, seconds.
    pub period_s: f64,
    /// Half its width (x) and half its height (z), metres.
    pub half_size_m: [f64; 2],
    /// Its grey level in full light.
    pub grey: f32,
}

/// The brightness at a time, interpolated linearly between keys.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LightKey {
    /// Seconds.
    pub time_s: f64,
    /// Factor on the artwork's light, or on its grey levels if those are averaged.
    pub gain: f32,
}

impl VirtualStage {
    /// Makes a scene of a body and a camera with global shutter, no blur, no noise, black
    /// surroundings and 4 rays per pixel.
    pub fn new(camera: CameraModel, camera_path: CameraPath, stage: BodySpec) -> Self {
        Self {
            camera,
            camera_path,
            roll: None,
            stage,
            draughts: Vec::new(),
            objects: Vec::new(),
            scenery: Vec::new(),
            occluders: Vec::new(),
            people: Vec::new(),
            light_model: LightModel::default(),
            spots: Vec::new(),
            light: Vec::new(),
            blackouts: Vec::new(),
            shutter: Shutter::default(),
            noise: SensorNoise::none(),
            background: 0.0,
            samples: 4,
            seed: 1,
        }
    }

    /// Returns the exact `T_stage_camera` at a time. A frame's true pose is that of its middle row
    /// at mid-exposure.
    pub fn truth(&self, time_s: f64) -> Pose<Stage, Camera> {
        let steady = self.camera_path.pose(time_s);
        match &self.roll {
            Some(roll) => steady * Pose::<Camera, Camera>::new(roll.at(time_s), Vector3::zeros()),
            None => steady,
        }
    }

    /// Returns the exact `T_stage_object` of an object at a time, or `None` if there is no such
    /// object.
    pub fn object_truth(&self, object: usize, time_s: f64) -> Option<Pose<Stage, Body>> {
        Some(self.objects.get(object)?.path.pose(time_s))
    }

    /// Returns the factor on all light at a time.
    pub fn light_gain(&self, time_s: f64) -> f32 {
        let next = self.light.partition_point(|key| key.time_s <= time_s);
        match (next.checked_sub(1).and_then(|i| self.light.get(i)), self.light.get(next)) {
            (None, None) => 1.0,
            (Some(key), None) | (None, Some(key)) => key.gain,
            (Some(a), Some(b)) => a.gain + (b.gain - a.gain) * ((time_s - a.time_s) / (b.time_s - a.time_s)) as f32,
        }
    }

    /// Whether there is no light at all.
    pub fn is_blackout(&self, time_s: f64) -> bool {
        self.blackouts.iter().any(|b| b.contains(&time_s))
    }
}

impl From<&VirtualStage> for TrackerSetup {
    /// Sets up a tracker with the scene's true values. The scenery and the waves stay unknown to
    /// it, and so does the camera's curve, unless grey levels are averaged.
    fn from(scene: &VirtualStage) -> Self {
        let mut setup = Self {
            shutter: scene.shutter.into(),
            objects: scene.objects.iter().map(|object| object.body.clone()).collect(),
            ..Self::new(scene.camera, scene.stage.clone())
        };
        if scene.light_model == LightModel::GreyAverages {
            setup.settings.transfer = Some(Transfer::Linear);
            let bodies = std::iter::once(&mut setup.stage).chain(&mut setup.objects);
            bodies.flat_map(|body| &mut body.surfaces).for_each(|surface| surface.transfer = Transfer::Linear);
        }
        setup
    }
}

impl Occluder {
    /// Returns `T_stage_surface` of its plane at a time.
    pub(super) fn pose(&self, time_s: f64) -> Pose<Stage, SurfaceFrame> {
        let phase = std::f64::consts::TAU * time_s / self.period_s;
        let centre = self.centre.coords + self.swing * phase.sin();
        Pose::new(upright(Vector3::zeros(), 0.0).rotation, centre)
    }
}

/// Makes a surface of flat artwork. The virtual stage has no requirements on the picture.
pub fn artwork_surface(name: &str, artwork: GrayImage, size_m: [f64; 2], pose: Pose<Body, SurfaceFrame>) -> SurfaceSpec {
    SurfaceSpec {
        name: name.to_owned(),
        artwork,
        size_m,
        pose,
        kind: ReferenceKind::Artwork,
        shape: SurfaceShape::Flat,
        doubt: SurfaceDoubt::default(),
        transfer: Transfer::default(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::CameraModel;

    #[test]
    fn light_is_interpolated_linearly_between_its_keys() {
        let camera = CameraModel::pinhole(8, 8, 8.0, 8.0, 3.5, 3.5).unwrap();
        let path = CameraPath::fixed(Point3::new(0.0, -1.0, 0.0), Point3::origin());
        let mut stage = VirtualStage::new(camera, path, BodySpec::new("stage", vec![]));
        assert_eq!(stage.light_gain(3.0), 1.0);
        stage.light = vec![LightKey { time_s: 1.0, gain: 0.5 }, LightKey { time_s: 3.0, gain: 1.0 }];
        assert_eq!([0.0, 1.0, 2.0, 3.0, 9.0].map(|t| stage.light_gain(t)), [0.5, 0.5, 0.75, 1.0, 1.0]);
    }
}
