//! The keyframes of a survey and their observers, which measure features, anchors and tiles with
//! the current model.

use image::GrayImage;
use nalgebra::Matrix2;
use rayon::prelude::*;

use super::keyframes::{Keyframe, MatchedFeature};
use super::stage_model::StageModel;
use super::unmodelled::FrameCells;
use crate::camera::Shutter;
use crate::geometry::resection::{MovingCamera, Observation, resect, residual_and_jacobian};
use crate::light::CameraCurve;
use crate::motion::Motion;
use crate::track::{BodySpec, KnownRates, ObservedFrame, ObservedTile, TileObserver};

/// Minimum number of features in a frame: three times the four that a pose needs.
const MIN_FEATURES: usize = 12;
/// Number of keyframes that share one observer, which learns light and noise from one to the next.
/// Fixed, so that the number of threads does not affect the result.
const KEYFRAMES_AN_OBSERVER: usize = 30;

/// What each keyframe showed; `None` if it does not support the model.
pub type ObservedFrames = Vec<Option<ObservedFrame>>;

/// Keyframes with their observers.
pub struct Observers<'a> {
    keyframes: Vec<Keyframe>,
    observers: Vec<TileObserver>,
    body: &'a BodySpec,
    curve: CameraCurve,
    mask: Option<&'a GrayImage>,
    /// Called before each frame; false stops the work.
    goes_on: &'a (dyn Fn() -> bool + Sync),
}

impl<'a> Observers<'a> {
    /// Prepares the observers of a camera with this curve and mask.
    pub fn new(
        keyframes: Vec<Keyframe>,
        model: &StageModel,
        shutter: Shutter,
        body: &'a BodySpec,
        (curve, mask): (CameraCurve, Option<&'a GrayImage>),
        goes_on: &'a (dyn Fn() -> bool + Sync),
    ) -> Self {
        let mut observers = Self { keyframes, observers: Vec::new(), body, curve, mask, goes_on };
        observers.take_shutter(model, shutter);
        observers
    }

    /// Sets the shutter with which frames are assumed to be exposed.
    pub fn take_shutter(&mut self, model: &StageModel, shutter: Shutter) {
        let n = self.keyframes.len().div_ceil(KEYFRAMES_AN_OBSERVER).max(1);
        let (body, curve, mask) = (self.body, &self.curve, self.mask);
        self.observers = (0..n).into_par_iter().map(|_| TileObserver::new(model.camera, shutter, curve, mask.cloned(), body)).collect();
    }

    /// Aligns all keyframes with a model and updates their motions. `None` if the work was stopped
    /// meanwhile.
    pub fn tiles(&mut self, model: &StageModel) -> Option<ObservedFrames> {
        self.ask(model, |observer, keyframe| {
            let observed = observer.observe(&keyframe.frame.image, &keyframe.motion, keyframe.rates)?;
            keyframe.motion = observed.motion;
            Some(observed)
        })
    }

    /// Measures the anchors of a model in each keyframe and updates the poses. `None` as above.
    pub fn anchors(&mut self, model: &StageModel, is_half: bool) -> Option<ObservedFrames> {
        self.ask(model, |observer, keyframe| {
            let observed = observer.observe_anchors(&keyframe.frame.image, &keyframe.motion.pose, is_half)?;
            keyframe.motion.pose = observed.motion.pose;
            Some(observed)
        })
    }

    /// Aligns all keyframes once more and returns what each says about the cells of the surfaces.
    /// The motions stay. `None` as above.
    pub fn cells(&mut self, model: &StageModel) -> Option<Vec<Option<FrameCells>>> {
        self.ask(model, |observer, keyframe| {
            let pixels = observer.observe_pixels(&keyframe.frame.image, &keyframe.motion, keyframe.rates)?;
            Some(FrameCells::of(&pixels, model))
        })
    }

    /// Compares each keyframe's features with a model, at the pose that fits them best. `None` as
    /// above.
    pub fn features(&mut self, model: &StageModel) -> Option<ObservedFrames> {
        let frames = self.keyframes.par_iter_mut().map(|keyframe| observed_features(keyframe, model)).collect();
        (self.goes_on)().then_some(frames)
    }

    /// Returns the number of keyframes with rates known from neighbouring frames.
    pub fn with_rates(&self) -> usize {
        self.keyframes.iter().filter(|keyframe| keyframe.rates.is_some()).count()
    }

    /// Sets the rates of frames with these numbers, if they are keyframes.
    pub fn take_rates(&mut self, rates: &[(usize, KnownRates)]) {
        for keyframe in &mut self.keyframes {
            let own = rates.iter().find(|(number, _)| *number == keyframe.number);
            keyframe.rates = own.map(|(_, rates)| *rates).or(keyframe.rates);
        }
    }

    /// Returns the current motion of each keyframe.
    pub fn motions(&self) -> Vec<Motion> {
        self.keyframes.iter().map(|keyframe| keyframe.motion).collect()
    }

    /// Restores the keyframes' motions.
    pub fn put_back(&mut self, motions: &[Motion]) {
        for (keyframe, motion) in self.keyframes.iter_mut().zip(motions) {
            keyframe.motion = *motion;
        }
    }

    /// Whether to continue.
    pub fn go_on(&self) -> bool {
        (self.goes_on)()
    }

    /// Runs `of_frame` on every keyframe with its observer, which takes the model first.
    fn ask<T: Send>(
        &mut self,
        model: &StageModel,
        of_frame: impl Fn(&mut TileObserver, &mut Keyframe) -> Option<T> + Sync,
    ) -> Option<Vec<Option<T>>> {
        let goes_on = self.goes_on;
        let chunks = self.keyframes.par_chunks_mut(KEYFRAMES_AN_OBSERVER).zip(&mut self.observers);
        let of_chunk = |(keyframes, observer): (&mut [Keyframe], &mut TileObserver)| -> Option<Vec<Option<T>>> {
            observer.take_model(&model.camera, &model.surfaces);
            observer.take_readout(model.readout_s());
            keyframes.iter_mut().map(|keyframe| goes_on().then(|| of_frame(observer, keyframe))).collect()
        };
        Some(chunks.map(of_chunk).collect::<Option<Vec<_>>>()?.into_iter().flatten().collect())
    }
}

/// Measures a keyframe's features at the pose that fits them best; `None` if there are too few.
fn observed_features(keyframe: &mut Keyframe, model: &StageModel) -> Option<ObservedFrame> {
    let observations: Vec<Observation> = keyframe
        .features
        .iter()
        .map(|f| {
            let surface = &model.surfaces[f.surface];
            let point = surface.pose.transform(&surface.shape.at(f.on_picture_m).place.into());
            let information = Matrix2::identity() / f.sigma_px.powi(2);
            // Motion within the frame is left to the tiles, since features are not precise anyway.
            Observation { point, pixel: f.pixel, information, delay_s: 0.0, group: 0 }
        })
        .collect();
    if observations.len() < MIN_FEATURES {
        return None;
    }
    let still = MovingCamera::still(&model.camera);
    let pose = resect(&keyframe.motion.pose.inverse(), &still, &observations, 15)?.pose;
    keyframe.motion.pose = pose.inverse();
    let motion = Motion::still(pose.inverse());
    let tile = |(number, (f, o)): (usize, (&MatchedFeature, &Observation))| {
        let (residual, _) = residual_and_jacobian(&pose, &still, o)?;
        Some(ObservedTile {
            surface: f.surface,
            on_picture_m: f.on_picture_m,
            shift_px: -residual,
            information: o.information,
            delay_s: 0.0,
            number: number as u32,
        })
    };
    let tiles = keyframe.features.iter().zip(&observations).enumerate().filter_map(tile).collect();
    Some(ObservedFrame { motion, rates: None, tiles })
}
