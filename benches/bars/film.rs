//! A scene with its frames, and how well a tracker follows it.

use std::time::Instant;

use stagepose::diagnostics::simulate::through_jpeg;
use stagepose::{Frame, LightModel, PoseSample, Renderer, SensorNoise, State, Timestamp, Tracker, TrackerSetup, VirtualStage};

use crate::score::{Figures, Found, figures};

/// A stage, and the clip that is rendered from it.
pub struct Film {
    pub stage: VirtualStage,
    pub fps: f64,
    pub frames: u64,
    /// JPEG quality of the camera; `None` if it sends raw pictures.
    pub jpeg: Option<u8>,
}

impl Film {
    fn stamp(&self, sequence: u64) -> Timestamp {
        Timestamp::from_seconds(sequence as f64 / self.fps)
    }

    /// Adds up grey levels as if they were light, to reproduce earlier figures.
    pub fn in_grey_averages(mut self) -> Self {
        self.stage.light_model = LightModel::GreyAverages;
        self.stage.noise = SensorNoise::webcam();
        self
    }

    /// Renders all frames; the first one is at time 0.
    pub fn render(&self) -> Result<Vec<Frame>, String> {
        let renderer = Renderer::new(self.stage.clone());
        let frame = |k: u64| {
            // Seconds of the rounded stamp, so that picture, truth and stamp agree exactly.
            let taken = renderer.render(self.stamp(k).seconds(), k);
            let picture = match self.jpeg {
                Some(quality) => through_jpeg(&taken, quality).map_err(|e| e.to_string())?,
                None => taken,
            };
            Ok(Frame::new(picture, self.stamp(k), k))
        };
        (0..self.frames).map(frame).collect()
    }

    /// Tracks the frames with the true stage configured. Returns the samples and the mean
    /// milliseconds per frame.
    pub fn track(&self, frames: &[Frame]) -> Result<(Vec<PoseSample>, f64), String> {
        let mut tracker = Tracker::new(TrackerSetup::from(&self.stage)).map_err(|e| e.to_string())?;
        let start = Instant::now();
        let samples: Result<Vec<_>, _> = frames.iter().map(|frame| tracker.track(frame)).collect();
        let ms = 1e3 * start.elapsed().as_secs_f64() / frames.len() as f64;
        Ok((samples.map_err(|e| e.to_string())?, ms))
    }

    pub fn score_camera(&self, samples: &[PoseSample]) -> Figures {
        let found = samples.iter().filter(|sample| sample.state == State::Tracking).filter_map(|sample| {
            let measured = sample.measurement.as_ref()?;
            let truth = self.stage.truth(sample.timestamp.seconds());
            Some(Found::new(&truth, &measured.pose, Some(&measured.covariance), truth.translation.norm()))
        });
        figures(samples.len(), found.collect())
    }

    /// Scores an object; position errors are relative to its distance from the camera.
    pub fn score_object(&self, object: usize, samples: &[PoseSample]) -> Figures {
        let found = samples.iter().filter_map(|sample| {
            let ours = sample.objects.get(object).filter(|ours| ours.state == State::Tracking)?;
            let time_s = sample.timestamp.seconds();
            let truth = self.stage.object_truth(object, time_s)?;
            let distance_m = (truth.translation - self.stage.truth(time_s).translation).norm();
            Some(Found::new(&truth, ours.pose.as_ref()?, ours.covariance.as_ref(), distance_m))
        });
        figures(samples.len(), found.collect())
    }
}
