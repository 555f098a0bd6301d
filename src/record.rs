//! The pose record: the tracker's result for one frame, and its JSON line (contract C3).

use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3};
use serde::Serialize;
use serde::ser::{SerializeMap, SerializeSeq, SerializeStruct, Serializer};

use crate::frame::Timestamp;
use crate::geometry::{Body, Camera, Pose, Stage};
pub use crate::track::State;
use crate::track::{LearntCamera, Reason};

/// Which two-view model explains the frame's correspondences better.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum TwoViewModel {
    /// One plane.
    Homography,
    /// A scene with depth.
    Essential,
}

/// The essential matrix as a motion: `x_frame ∝ R x_ref + t`.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct EssentialMotion {
    /// R, from the reference camera's axes to the frame's.
    pub rotation: UnitQuaternion<f64>,
    /// t / |t| in the frame's camera axes.
    pub translation_direction: Vector3<f64>,
    /// Number of inlier correspondences.
    pub inliers: usize,
}

/// What was measured in one frame; present only in state `tracking`.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Measurement {
    /// `T_stage_camera` before any filter.
    pub pose: Pose<Stage, Camera>,
    /// Covariance of [δp, δθ] in stage axes, m and rad: p_true = p + δp, R_true = Exp(δθ) R.
    pub covariance: Matrix6<f64>,
    /// The part of `covariance` that is the same error in all frames (lens, layout, map, shutter);
    /// the rest is noise, new in every frame. Not in the record.
    pub common: Matrix6<f64>,
    /// The better two-view model; `None` for a camera whose pose is configured.
    pub model: Option<TwoViewModel>,
    /// Maps reference pixels of the first stage surface to undistorted frame pixels, h33 = 1.
    pub homography: Option<Matrix3<f64>>,
    /// Motion from the reference camera.
    pub essential: Option<EssentialMotion>,
    /// Number of correspondences used; `None` as for `model`.
    pub inliers: Option<usize>,
    /// Their RMS residual, pixels; `None` as for `model`.
    pub rms_px: Option<f64>,
}

impl Measurement {
    /// Creates the measurement of a pose that no picture is evidence for, yet without a covariance.
    pub fn without_evidence(pose: Pose<Stage, Camera>) -> Self {
        let none = Matrix6::zeros();
        Self { pose, covariance: none, common: none, model: None, homography: None, essential: None, inliers: None, rms_px: None }
    }
}

/// A tracked object in one frame.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ObjectSample {
    /// Its name in the config.
    pub name: String,
    /// Its tracking state.
    pub state: State,
    /// `T_stage_object`; present while tracking or coasting.
    pub pose: Option<Pose<Stage, Body>>,
    /// Covariance of the object's pose, as in [`Measurement::covariance`]; present while tracking.
    pub covariance: Option<Matrix6<f64>>,
    /// As in [`Measurement::common`]; present with the covariance.
    pub common: Option<Matrix6<f64>>,
}

impl ObjectSample {
    /// Creates a sample without a pose.
    pub fn new(name: impl Into<String>, state: State) -> Self {
        Self { name: name.into(), state, pose: None, covariance: None, common: None }
    }
}

/// Compute time spent on a frame, milliseconds; never part of the record.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct StageTimes {
    /// Decoding the picture.
    pub decode_ms: f64,
    /// Acquiring bodies from scratch.
    pub acquire_ms: f64,
    /// Aligning with the reference pictures, including verification.
    pub align_ms: f64,
    /// States, prediction, record.
    pub pose_ms: f64,
    /// Live only: the frame's age when tracking began. In a stale sample, the age of the last
    /// frame.
    pub age_ms: Option<f64>,
}

/// The tracker's result for one row of a clip or one frame of a camera.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PoseSample {
    /// Row number from 0.
    pub sequence: u64,
    /// Mid-exposure time of the middle row.
    pub timestamp: Timestamp,
    /// The camera's tracking state.
    pub state: State,
    /// `T_stage_camera` to use: filtered, or predicted while coasting.
    pub pose: Option<Pose<Stage, Camera>>,
    /// This frame's measurement; present while tracking.
    pub measurement: Option<Measurement>,
    /// The tracked objects, in config order.
    pub objects: Vec<ObjectSample>,
    /// Why the camera is not tracked in this frame; not written. `None` while tracking and in stale
    /// samples.
    pub reason: Option<Reason>,
    /// What the tracker had learnt about the camera before this frame; not written.
    pub learnt: LearntCamera,
    /// Compute times; not written.
    pub times: StageTimes,
}

/// What a covariance is made of, row by row; nulls without a covariance.
#[derive(Serialize)]
struct CovarianceParts {
    noise: Option<Vec<f64>>,
    common: Option<Vec<f64>>,
}

impl CovarianceParts {
    fn of(covariance: Option<&Matrix6<f64>>, common: Option<&Matrix6<f64>>) -> Self {
        let noise = covariance.zip(common).map(|(covariance, common)| row_major(&(covariance - common)));
        Self { noise, common: common.map(row_major) }
    }
}

#[derive(Serialize)]
struct ObjectParts {
    name: String,
    #[serde(flatten)]
    parts: CovarianceParts,
}

#[derive(Serialize)]
struct PartsLine {
    sequence: u64,
    timestamp_ns: Timestamp,
    #[serde(flatten)]
    parts: CovarianceParts,
    objects: Vec<ObjectParts>,
}

struct Numbers<'a>(&'a [f64]);

impl Serialize for Numbers<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut seq = serializer.serialize_seq(Some(self.0.len()))?;
        for v in self.0 {
            seq.serialize_element(v)?;
        }
        seq.end()
    }
}

fn row_major<const R: usize, const C: usize>(m: &nalgebra::SMatrix<f64, R, C>) -> Vec<f64> {
    m.row_iter().flat_map(|row| row.iter().copied().collect::<Vec<_>>()).collect()
}

impl<To, From> Serialize for Pose<To, From> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(2))?;
        map.serialize_entry("position_m", self.translation.as_slice())?;
        map.serialize_entry("orientation_xyzw", &self.orientation_xyzw())?;
        map.end()
    }
}

impl Serialize for EssentialMotion {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let as_pose = Pose::<Camera, Camera>::new(self.rotation, self.translation_direction);
        let mut map = serializer.serialize_map(Some(3))?;
        map.serialize_entry("rotation_xyzw", &as_pose.orientation_xyzw())?;
        map.serialize_entry("translation_direction", self.translation_direction.as_slice())?;
        map.serialize_entry("inliers", &self.inliers)?;
        map.end()
    }
}

impl Serialize for ObjectSample {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_struct("ObjectSample", 4)?;
        map.serialize_field("name", &self.name)?;
        map.serialize_field("state", &self.state)?;
        map.serialize_field("pose", &self.pose)?;
        map.serialize_field("covariance", &self.covariance.as_ref().map(row_major))?;
        map.end()
    }
}

impl Serialize for PoseSample {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if self.state == State::Stale {
            let mut map = serializer.serialize_struct("Stale", 3)?;
            map.serialize_field("state", &self.state)?;
            map.serialize_field("pose", &self.pose)?;
            map.serialize_field("age_ms", &self.times.age_ms)?;
            return map.end();
        }
        self.serialize_with(self.measurement.as_ref().map(|m| &m.covariance), serializer)
    }
}

/// A record whose covariance is of its pose, not of the measurement.
struct RefinedRecord<'a> {
    sample: &'a PoseSample,
    covariance: Option<&'a Matrix6<f64>>,
}

impl Serialize for RefinedRecord<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.sample.serialize_with(self.covariance, serializer)
    }
}

impl PoseSample {
    /// Serialises the record of a frame with this covariance.
    fn serialize_with<S: Serializer>(&self, covariance: Option<&Matrix6<f64>>, serializer: S) -> Result<S::Ok, S::Error> {
        let m = self.measurement.as_ref();
        let homography = m.and_then(|m| m.homography.as_ref()).map(row_major);
        let covariance = covariance.map(row_major);
        let mut map = serializer.serialize_struct("PoseSample", 12)?;
        map.serialize_field("sequence", &self.sequence)?;
        map.serialize_field("timestamp_ns", &self.timestamp)?;
        map.serialize_field("state", &self.state)?;
        map.serialize_field("pose", &self.pose)?;
        map.serialize_field("measured", &m.map(|m| m.pose))?;
        map.serialize_field("covariance", &covariance.as_deref().map(Numbers))?;
        map.serialize_field("model", &m.and_then(|m| m.model))?;
        map.serialize_field("homography", &homography.as_deref().map(Numbers))?;
        map.serialize_field("essential", &m.and_then(|m| m.essential))?;
        map.serialize_field("inliers", &m.and_then(|m| m.inliers))?;
        map.serialize_field("rms_px", &m.and_then(|m| m.rms_px))?;
        map.serialize_field("objects", &self.objects)?;
        map.end()
    }

    /// Creates a sample without a pose.
    pub fn new(sequence: u64, timestamp: Timestamp, state: State) -> Self {
        let times = StageTimes::default();
        Self {
            sequence,
            timestamp,
            state,
            pose: None,
            measurement: None,
            objects: Vec::new(),
            reason: None,
            learnt: Default::default(),
            times,
        }
    }

    /// Creates the sample that says that the camera has delivered no picture for `age_ms` since its
    /// last one, which had this number and stamp.
    pub fn stale(sequence: u64, timestamp: Timestamp, age_ms: f64) -> Self {
        let times = StageTimes { age_ms: Some(age_ms), ..StageTimes::default() };
        Self { times, ..Self::new(sequence, timestamp, State::Stale) }
    }

    /// Returns the record as one line of JSON, without the line end.
    pub fn to_json_line(&self) -> String {
        // Serialising to a string fails only for non-string map keys, and there are none.
        serde_json::to_string(self).expect("a pose record has only string keys")
    }

    /// Returns the record as one line of JSON, without the line end, with the covariance of its
    /// pose instead of the measurement's: a pose that later frames have refined, or bridged
    /// (contract C14).
    pub fn to_refined_line(&self, covariance: Option<&Matrix6<f64>>) -> String {
        // As in `to_json_line`.
        serde_json::to_string(&RefinedRecord { sample: self, covariance }).expect("a pose record has only string keys")
    }

    /// Returns what the record's covariances are made of, as one line of JSON without the line end:
    /// `noise`, new in every frame, and `common`, the same error in all frames (contract C14).
    pub fn to_parts_line(&self) -> String {
        let m = self.measurement.as_ref();
        let parts = CovarianceParts::of(m.map(|m| &m.covariance), m.map(|m| &m.common));
        let of_object = |object: &ObjectSample| ObjectParts {
            name: object.name.clone(),
            parts: CovarianceParts::of(object.covariance.as_ref(), object.common.as_ref()),
        };
        let objects = self.objects.iter().map(of_object).collect();
        let line = PartsLine { sequence: self.sequence, timestamp_ns: self.timestamp, parts, objects };
        // As in `to_json_line`.
        serde_json::to_string(&line).expect("a line of parts has only string keys")
    }

    /// Returns the line of a TUM trajectory (seconds, position, quaternion); only for `tracking`
    /// frames.
    pub fn to_tum_line(&self) -> Option<String> {
        let pose = self.pose.filter(|_| self.state == State::Tracking)?;
        let (p, q) = (pose.translation, pose.orientation_xyzw());
        let stamp = self.timestamp.decimal_seconds();
        Some(format!("{stamp} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9}", p.x, p.y, p.z, q[0], q[1], q[2], q[3]))
    }
}
