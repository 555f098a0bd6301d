//! Reads walks for the commands that make a stage from one, `survey` and `map`: opens the clips,
//! tracks the configured surfaces through them, shows the progress, and continues interrupted work.

use std::cell::Cell;
use std::path::PathBuf;

use super::failure::Failure;
use super::interrupt;
use super::learnt::LearntArguments;
use super::replay::progress::Progress;
use super::replay::tracker_setup;
use super::walk_file::WalkFile;
use crate::capture::{ClipOptions, EntryContent, FrameSource, open_clip};
use crate::config::Settings;
use crate::frame::Frame;
use crate::survey::walked::progress::{SurveyError, SurveyStep};
use crate::survey::walked::walk::{Walk, WalkOptions};
use crate::tracker::TrackerSetup;

/// Opened clips, in order.
pub(super) type Sources = Vec<Box<dyn FrameSource>>;

/// The clips of a walk.
pub(super) struct Clips<'a> {
    files: &'a [PathBuf],
    options: ClipOptions,
}

impl<'a> Clips<'a> {
    /// Names the clips; `fps` is for those without stamps.
    pub(super) fn new(files: &'a [PathBuf], fps: Option<f64>, settings: &Settings) -> Self {
        let calibrated = settings.lens.size(&settings.camera);
        Self { files, options: ClipOptions { fps, calibrated, ..ClipOptions::default() } }
    }

    /// Opens all clips.
    pub(super) fn open(&self) -> Result<Sources, Failure> {
        self.files.iter().map(|clip| open_clip(clip, self.options).map_err(Failure::from)).collect()
    }

    /// Returns the name of a clip, that of its file or folder.
    pub(super) fn name(&self, index: usize) -> String {
        let clip = self.files.get(index).map(|clip| std::path::absolute(clip).unwrap_or_else(|_| clip.clone()));
        clip.and_then(|clip| Some(clip.file_name()?.to_string_lossy().into_owned())).unwrap_or_else(|| format!("clip{index}"))
    }

    /// Returns the index of the clip with a name, that of its file or folder. `None` if there is
    /// none, or several have it.
    pub(super) fn named(&self, name: &str) -> Option<usize> {
        let has_name = |clip: &&PathBuf| {
            let own = std::path::absolute(clip).unwrap_or_else(|_| (*clip).clone());
            [own.file_name(), own.file_stem()].into_iter().flatten().any(|own| own == name)
        };
        let mut named = self.files.iter().enumerate().filter(|(_, clip)| has_name(clip)).map(|(index, _)| index);
        named.next().filter(|_| named.next().is_none())
    }

    /// Returns the size of the clips' frames, which they must share, and shows what is odd about
    /// them.
    pub(super) fn size(&self, sources: &Sources) -> Result<(u32, u32), Failure> {
        for (clip, source) in self.files.iter().zip(sources) {
            source.notes().iter().for_each(|note| tracing::warn!("{}: {note}", clip.display()));
        }
        let size = sources[0].size();
        let Some((clip, source)) = self.files.iter().zip(sources).find(|(_, source)| source.size() != size) else { return Ok(size) };
        let (w, h) = source.size();
        Err(Failure::Usage(format!(
            "{}: its frames have {w} x {h} pixels, those of the first clip {} x {}; take the clips of one camera at a time",
            clip.display(),
            size.0,
            size.1
        )))
    }

    /// Returns the setup of a tracker of the stage alone, with the readout time that the first clip
    /// brings unless it is configured.
    pub(super) fn setup(&self, settings: &Settings, size: (u32, u32), learnt: &LearntArguments) -> Result<TrackerSetup, Failure> {
        let mut setup = TrackerSetup { objects: Vec::new(), ..tracker_setup(settings, size, None)? };
        let (learnt, _) = learnt.of(&self.files[0])?;
        setup.shutter.readout_s = setup.shutter.readout_s.or(learnt.readout.map(|readout| readout.seconds));
        Ok(setup)
    }
}

/// Reads a walk from clips.
pub(super) struct WalkReader<'a> {
    setup: &'a TrackerSetup,
    frames_read: Cell<u64>,
    /// The bar: frames, then what is being done.
    pub(super) progress: Progress,
}

impl<'a> WalkReader<'a> {
    /// Starts the progress bar.
    pub(super) fn new(setup: &'a TrackerSetup, sources: &Sources) -> Self {
        let total = sources.iter().map(|source| source.rows()).sum::<Option<u64>>();
        let progress = Progress::with(total, ["{bar:32} {pos}/{len} frames {msg}", "{spinner} {pos} frames {msg}"]);
        Self { setup, frames_read: Cell::new(0), progress }
    }

    /// Returns the walk that an interrupted run left, or reads it from the clips, which `again`
    /// opens anew.
    pub(super) fn walk(
        &self,
        file: &WalkFile,
        sources: Sources,
        again: impl FnOnce() -> Result<Sources, Failure>,
        options: &WalkOptions,
    ) -> Result<Result<Walk, SurveyError>, Failure> {
        Ok(match self.recalled(file, sources) {
            Ok(None) => self.taken_in(file, again()?, options),
            Ok(Some(walk)) => Ok(walk),
            Err(e) => Err(e),
        })
    }

    /// Returns the walk left by an interrupted run, with its clips' pictures.
    fn recalled(&self, file: &WalkFile, sources: Sources) -> Result<Option<Walk>, SurveyError> {
        let Some(record) = file.read() else { return Ok(None) };
        tracing::info!("an interrupted run has already read the clips; continuing from there");
        let clips = sources.into_iter().map(frames);
        Walk::recall(&record, clips, &self.setup.stage, |step| self.show(step), &goes_on)
    }

    /// Reads the walk from the clips and stores it, so that an interrupted run need not read them
    /// again.
    fn taken_in(&self, file: &WalkFile, sources: Sources, options: &WalkOptions) -> Result<Walk, SurveyError> {
        // It is another command's, or does not fit its clips.
        file.remove();
        self.frames_read.set(0);
        let clips = sources.into_iter().map(frames);
        let walk = Walk::take_in(clips, self.setup, options, |step| self.show(step), &goes_on)?;
        file.keep(walk.record());
        Ok(walk)
    }

    /// Shows a step of a survey.
    pub(super) fn show(&self, step: SurveyStep) {
        match step {
            SurveyStep::Frame => {
                self.frames_read.set(self.frames_read.get() + 1);
                self.progress.advance();
            }
            SurveyStep::Again(number) => self.show_words(format!("second pass, frame {number}")),
            SurveyStep::Round(round) => self.show_words(format!("adjusting, round {}", round + 1)),
        }
    }

    /// Shows what is being done after the frames are read.
    pub(super) fn show_words(&self, words: String) {
        self.progress.at(self.frames_read.get(), words);
    }
}

/// Whether the user has not interrupted the command.
pub(super) fn goes_on() -> bool {
    !interrupt::is_interrupted()
}

/// Returns a clip's readable frames.
pub(super) fn frames(mut source: Box<dyn FrameSource>) -> impl Iterator<Item = Frame> {
    std::iter::from_fn(move || source.next_entry()).filter_map(|row| match row.content {
        EntryContent::Frame(frame) => Some(frame),
        _ => None,
    })
}

/// Returns the failure of unfinished work; an interrupted one says how to continue.
pub(super) fn unfinished(error: &SurveyError, file: &WalkFile) -> Failure {
    match error {
        SurveyError::Interrupted if file.is_there() => {
            Failure::Survey(format!("{error}. The clips have been read: run the same command again to continue from there"))
        }
        error => Failure::Survey(error.to_string()),
    }
}
