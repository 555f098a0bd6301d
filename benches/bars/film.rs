//! A scene with its frames, and how well a tracker follows it.

use std::time::Instant;

use stagepose::diagnostics::simulate::through_jpeg;
use stagepose::diagnostics::track::rounds;
use stagepose::{Frame, LightModel, PoseSample, Renderer, SensorNoise, State, Timestamp, Tracker, TrackerSetup, VirtualStage};

use crate::score::{Figures, Found, Row, figures};

/// A stage, and the clip that is rendered from it.
pub struct Film {
    pub stage: VirtualStage,
    pub fps: f64,
    pub frames: u64,
    /// JPEG quality of the camera; `None` if it sends raw pictures.
    pub jpeg: Option<u8>,
}

/// What a tracker made of a film.
struct Tracked {
    samples: Vec<PoseSample>,
    /// Rounds of alignment, by frame and body: the stage first, then the objects.
    rounds: Vec<Vec<u64>>,
    /// Mean time per frame, milliseconds.
    ms: f64,
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

    /// Tracks the frames and scores them: a row for the camera, and one for each object.
    pub fn rows(&self, name: &str, frames: &[Frame]) -> Result<Vec<Row>, String> {
        let tracked = self.track(frames)?;
        let mut rows = vec![Row { name: name.to_owned(), figures: self.score_camera(&tracked), ms: Some(tracked.ms) }];
        for (k, object) in self.stage.objects.iter().enumerate() {
            let name = format!("{name}/{}", object.body.name);
            rows.push(Row { name, figures: self.score_object(k, &tracked), ms: None });
        }
        Ok(rows)
    }

    /// Tracks the frames with the true stage configured.
    fn track(&self, frames: &[Frame]) -> Result<Tracked, String> {
        let mut tracker = Tracker::new(TrackerSetup::from(&self.stage)).map_err(|e| e.to_string())?;
        let mut counts = vec![rounds(&tracker)];
        let start = Instant::now();
        let samples = frames.iter().map(|frame| {
            let sample = tracker.track(frame);
            counts.push(rounds(&tracker));
            sample
        });
        let samples = samples.collect::<Result<Vec<_>, _>>().map_err(|e| e.to_string())?;
        let ms = 1e3 * start.elapsed().as_secs_f64() / frames.len() as f64;
        let of_frame = |pair: &[Vec<u64>]| pair[1].iter().zip(&pair[0]).map(|(after, before)| after - before).collect();
        Ok(Tracked { samples, rounds: counts.windows(2).map(of_frame).collect(), ms })
    }

    fn score_camera(&self, tracked: &Tracked) -> Figures {
        let found = tracked.samples.iter().zip(&tracked.rounds).filter_map(|(sample, rounds)| {
            let measured = sample.measurement.as_ref().filter(|_| sample.state == State::Tracking)?;
            let truth = self.stage.truth(sample.timestamp.seconds());
            Some(Found::new(&truth, &measured.pose, Some(&measured.covariance), truth.translation.norm(), rounds[0]))
        });
        figures(tracked.samples.len(), found.collect())
    }

    /// Scores an object; position errors are relative to its distance from the camera.
    fn score_object(&self, object: usize, tracked: &Tracked) -> Figures {
        let found = tracked.samples.iter().zip(&tracked.rounds).filter_map(|(sample, rounds)| {
            let ours = sample.objects.get(object).filter(|ours| ours.state == State::Tracking)?;
            let time_s = sample.timestamp.seconds();
            let truth = self.stage.object_truth(object, time_s)?;
            let distance_m = (truth.translation - self.stage.truth(time_s).translation).norm();
            Some(Found::new(&truth, ours.pose.as_ref()?, ours.covariance.as_ref(), distance_m, rounds[1 + object]))
        });
        figures(tracked.samples.len(), found.collect())
    }
}
