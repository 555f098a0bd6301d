//! A camera in front of a virtual stage that fails on schedule, or at random from a seed.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant};

use image::GrayImage;
use image::codecs::jpeg::JpegEncoder;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use stagepose::diagnostics::capture::{
    Camera, CameraFault, CameraMode, CameraOpener, CapturedPicture, DriverStamp, OpenFault, PixelLayout, VirtualCamera, mid_exposure,
    monotonic_now,
};
use stagepose::diagnostics::live::{LiveLink, LiveSource, Patience};
use stagepose::{EntryContent, FrameSource, Pose, Shutter, Stage, Timestamp, TrackerSetup, VirtualStage};

use crate::pipeline::scene::{FPS, backdrop, camera, past, quiet, setup};

pub const SIZE: (u32, u32) = (320, 240);

/// A picture that has not come out after this long is lost, even on the slowest machine.
const LOST_AFTER: Duration = Duration::from_secs(20);

/// Rendered frames of one pass along the path, as JPEGs, with their true poses.
pub struct Take {
    pub jpegs: Vec<Vec<u8>>,
    pub truths: Vec<Pose<Stage, stagepose::Camera>>,
}

pub fn scene() -> VirtualStage {
    quiet(camera(SIZE.0, SIZE.1), past(), backdrop())
}

/// Returns the tracker's setup, with fewer features than usual to save time.
pub fn tracker_setup() -> TrackerSetup {
    let mut setup = setup(&scene());
    (setup.settings.features, setup.settings.threads) = (150, 2);
    setup
}

pub fn take() -> &'static Take {
    static TAKE: OnceLock<Take> = OnceLock::new();
    TAKE.get_or_init(|| {
        let mut camera = VirtualCamera::new(scene(), FPS, 30);
        let (mut jpegs, mut truths) = (Vec::new(), Vec::new());
        while let Some(row) = camera.next_entry() {
            let EntryContent::Frame(frame) = row.content else { continue };
            jpegs.push(jpeg(&frame.image));
            truths.push(camera.truth(row.sequence));
        }
        Take { jpegs, truths }
    })
}

pub fn jpeg(image: &GrayImage) -> Vec<u8> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, 90).encode_image(image).unwrap();
    bytes
}

/// Returns the index of frame `n` of an endless ride to and fro.
pub fn ride(n: u64) -> usize {
    let last = take().jpegs.len() as u64 - 1;
    let at = n % (2 * last);
    at.min(2 * last - at) as usize
}

/// What goes wrong at one opening or in one picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    Silent,
    Stalls,
    Gone,
    ReadPanics,
    DropPanics,
    OpenFails,
    OpenPanics,
    ModePanics,
    OtherSize,
    OtherSizeAndDropPanics,
    Blocks,
    Truncated,
    Garbage,
    Empty,
    DriverSaysDamaged,
    StaleBytesBehind,
    SmallPicture,
    StampRepeats,
    StampGoesBack,
    NoStamp,
    StampOfAnotherClock,
    OtherStage,
    FramesLostInDevice,
}

impl Fault {
    const OF_PICTURES: [Fault; 18] = [
        Self::Silent,
        Self::Stalls,
        Self::Gone,
        Self::ReadPanics,
        Self::DropPanics,
        Self::Blocks,
        Self::Truncated,
        Self::Garbage,
        Self::Empty,
        Self::DriverSaysDamaged,
        Self::StaleBytesBehind,
        Self::SmallPicture,
        Self::StampRepeats,
        Self::StampGoesBack,
        Self::NoStamp,
        Self::StampOfAnotherClock,
        Self::OtherStage,
        Self::FramesLostInDevice,
    ];
    const OF_OPENINGS: [Fault; 5] = [Self::OpenFails, Self::OpenPanics, Self::ModePanics, Self::OtherSize, Self::OtherSizeAndDropPanics];
}

/// What decides on the next fault.
pub enum Plan {
    /// Scheduled faults: of openings in order, and of pictures by number.
    Told { openings: Vec<Option<Fault>>, pictures: HashMap<u64, Fault> },
    /// Random faults from a seed: one in `one_in` pictures fails.
    Random { rng: Pcg64Mcg, one_in: u32 },
}

/// The opener, with the state that the camera and the test share.
pub struct Faulty {
    plan: Mutex<Plan>,
    openings: AtomicU64,
    pictures: AtomicU64,
    most_pictures: u64,
    /// Rows that came out of the pipeline. The next picture waits for them, so that none is dropped
    /// on the way.
    pub tracked: AtomicU64,
    /// Pictures that never came out, because an abandoned reader held them.
    pub lost: AtomicU64,
    /// The last picture that was waited for, and since when.
    waited: Mutex<(u64, Instant)>,
    /// Index into the ride's frames by timestamp; frames of the other stage have no entry.
    pub shown: Mutex<HashMap<Timestamp, usize>>,
    pub faults: Mutex<HashMap<String, u64>>,
    last_stamp: Mutex<Timestamp>,
    /// While true, blocked reads do not return.
    pub blocking: AtomicBool,
}

impl Faulty {
    pub fn new(plan: Plan, most_pictures: u64) -> Arc<Self> {
        // Renders in advance, so that the rendering time does not look like a blocked driver.
        let _ = (take(), other_stage());
        Arc::new(Self {
            plan: Mutex::new(plan),
            openings: AtomicU64::new(0),
            pictures: AtomicU64::new(0),
            most_pictures,
            tracked: AtomicU64::new(0),
            lost: AtomicU64::new(0),
            waited: Mutex::new((0, Instant::now())),
            shown: Mutex::default(),
            faults: Mutex::default(),
            // Far in the future, so that a slow machine does not pull the frames' timestamps apart.
            last_stamp: Mutex::new(monotonic_now().after_s(3600.0)),
            blocking: AtomicBool::new(true),
        })
    }

    pub fn told(openings: &[Option<Fault>], pictures: &[(u64, Fault)], most_pictures: u64) -> Arc<Self> {
        Self::new(Plan::Told { openings: openings.to_vec(), pictures: pictures.iter().copied().collect() }, most_pictures)
    }

    pub fn random(seed: u64, one_in: u32, most_pictures: u64) -> Arc<Self> {
        Self::new(Plan::Random { rng: Pcg64Mcg::seed_from_u64(seed), one_in }, most_pictures)
    }

    /// Whether picture `n` will never come out because an abandoned reader took it.
    fn is_lost(&self, n: u64) -> bool {
        let mut waited = self.waited.lock().unwrap();
        if waited.0 != n {
            *waited = (n, Instant::now());
        }
        waited.1.elapsed() > LOST_AFTER
    }

    fn next_fault(&self, opening: Option<u64>, picture: u64) -> Option<Fault> {
        let fault = match (&mut *self.plan.lock().unwrap(), opening) {
            (Plan::Told { openings, .. }, Some(n)) => openings.get(n as usize).copied().flatten(),
            (Plan::Told { pictures, .. }, None) => pictures.remove(&picture),
            (Plan::Random { rng, .. }, Some(n)) => {
                (n > 0 && rng.random_range(0..4) == 0).then(|| Fault::OF_OPENINGS[rng.random_range(0..Fault::OF_OPENINGS.len())])
            }
            (Plan::Random { rng, one_in }, None) => (rng.random_range(0..*one_in) == 0).then(|| {
                let fault = Fault::OF_PICTURES[rng.random_range(0..Fault::OF_PICTURES.len())];
                // Blocks and stalls cost real time, so nine in ten are replaced.
                if matches!(fault, Fault::Blocks | Fault::Stalls) && rng.random_range(0..10) > 0 { Fault::Silent } else { fault }
            }),
        };
        if let Some(fault) = fault {
            *self.faults.lock().unwrap().entry(format!("{fault:?}")).or_default() += 1;
        }
        fault
    }
}

/// Hands the opener to the pipeline.
pub struct Opener(pub Arc<Faulty>);

impl CameraOpener for Opener {
    fn open(&self) -> Result<Box<dyn Camera>, OpenFault> {
        let n = self.0.openings.fetch_add(1, Ordering::Relaxed);
        let (mut size, mut mode_panics, mut panics_in_drop) = (SIZE, false, false);
        match self.0.next_fault(Some(n), 0) {
            Some(Fault::OpenFails) => return Err(OpenFault("the camera is in use by cheese (process 7); end that program".into())),
            Some(Fault::OpenPanics) => panic!("told to panic while opening"),
            Some(Fault::ModePanics) => mode_panics = true,
            Some(Fault::OtherSize) => size = (640, 480),
            Some(Fault::OtherSizeAndDropPanics) => (size, panics_in_drop) = ((640, 480), true),
            _ => {}
        }
        let mode = CameraMode {
            name: "faulty".into(),
            size,
            layout: PixelLayout::Mjpeg,
            fps: 10.0,
            exposure_s: None,
            controls: vec![],
            notes: vec![],
        };
        Ok(Box::new(FaultyCamera { faulty: self.0.clone(), mode, mode_panics, panics_in_drop, stalls: false }))
    }
}

struct FaultyCamera {
    faulty: Arc<Faulty>,
    mode: CameraMode,
    mode_panics: bool,
    panics_in_drop: bool,
    stalls: bool,
}

impl Camera for FaultyCamera {
    fn mode(&self) -> &CameraMode {
        assert!(!self.mode_panics, "told to panic when asked for the mode");
        &self.mode
    }

    fn next_picture(&mut self, patience: Duration) -> Result<CapturedPicture, CameraFault> {
        let begun = Instant::now();
        if self.stalls {
            std::thread::sleep(patience);
            return Err(CameraFault::Silent);
        }
        let n = self.faulty.pictures.load(Ordering::Acquire);
        while self.faulty.tracked.load(Ordering::Acquire) < n {
            if self.faulty.is_lost(n) {
                self.faulty.lost.fetch_add(1, Ordering::AcqRel);
                self.faulty.tracked.fetch_add(1, Ordering::AcqRel);
            }
            if begun.elapsed() > patience {
                return Err(CameraFault::Silent);
            }
            std::thread::sleep(Duration::from_micros(50));
        }
        if n >= self.faulty.most_pictures {
            return Err(CameraFault::End);
        }
        let fault = self.faulty.next_fault(None, n);
        match fault {
            Some(Fault::Silent) => {
                std::thread::sleep(patience);
                return Err(CameraFault::Silent);
            }
            Some(Fault::Stalls) => {
                self.stalls = true;
                return Err(CameraFault::Silent);
            }
            Some(Fault::Gone) => return Err(CameraFault::Gone("No such device (os error 19)".into())),
            Some(Fault::ReadPanics) => panic!("told to panic while reading"),
            Some(Fault::DropPanics) => {
                self.panics_in_drop = true;
                return Err(CameraFault::Gone("STREAMOFF fails".into()));
            }
            Some(Fault::Blocks) => {
                // Acts like a hanging driver: it ignores the time limit.
                while self.faulty.blocking.load(Ordering::Relaxed) && begun.elapsed() < Duration::from_millis(1500) {
                    std::thread::sleep(Duration::from_millis(5));
                }
                return Err(CameraFault::Silent);
            }
            _ => {}
        }
        self.faulty.pictures.fetch_add(1, Ordering::AcqRel);
        Ok(self.picture(n, fault))
    }
}

impl FaultyCamera {
    fn picture(&self, n: u64, fault: Option<Fault>) -> CapturedPicture {
        let which = ride(n);
        let mut bytes = take().jpegs[which].clone();
        let mut shows_stage = true;
        match fault {
            Some(Fault::Truncated) => bytes.truncate(bytes.len() / 2),
            Some(Fault::Garbage) => bytes.iter_mut().enumerate().skip(2).for_each(|(i, b)| *b = (i * 31 + n as usize) as u8),
            Some(Fault::Empty) => bytes.clear(),
            Some(Fault::StaleBytesBehind) => bytes.extend_from_slice(&take().jpegs[0][300..]),
            Some(Fault::SmallPicture) => bytes = jpeg(&GrayImage::new(160, 120)),
            Some(Fault::OtherStage) => (bytes, shows_stage) = (other_stage().clone(), false),
            _ => {}
        }
        // Timestamps follow each other regularly, whatever the pipeline's pace.
        let arrival = monotonic_now();
        let mut last = self.faulty.last_stamp.lock().unwrap();
        let at = last.after_ns(33_333_333);
        let stamp = match fault {
            Some(Fault::StampRepeats) => DriverStamp::MidExposure(*last),
            Some(Fault::StampGoesBack) => DriverStamp::MidExposure(last.after_s(-0.5)),
            Some(Fault::NoStamp) => DriverStamp::None,
            Some(Fault::StampOfAnotherClock) => DriverStamp::StartOfExposure(Timestamp::from_ns(1_795_000_000_000_000_000)),
            _ => DriverStamp::MidExposure(at),
        };
        *last = at;
        let (timestamp, _) = mid_exposure(stamp, arrival, &Shutter::default());
        if shows_stage {
            // A repeated timestamp belongs to this picture if the previous one came without it.
            self.faulty.shown.lock().unwrap().entry(timestamp).or_insert(which);
        }
        let lost = if fault == Some(Fault::FramesLostInDevice) { 3 } else { 0 };
        CapturedPicture {
            bytes,
            stamp,
            arrival,
            device_sequence: Some(n as u32 + lost),
            is_damaged: fault == Some(Fault::DriverSaysDamaged),
        }
    }
}

impl Drop for FaultyCamera {
    fn drop(&mut self) {
        if self.panics_in_drop && !std::thread::panicking() {
            panic!("told to panic while closing");
        }
    }
}

/// Renders a frame of a stage that the tracker does not know.
fn other_stage() -> &'static Vec<u8> {
    static OTHER: OnceLock<Vec<u8>> = OnceLock::new();
    OTHER.get_or_init(|| {
        let art = crate::pipeline::scene::other_art();
        let surface = crate::pipeline::scene::surface("other", art, [4.0, 3.0], nalgebra::Vector3::zeros(), 0.0);
        let stage = quiet(camera(SIZE.0, SIZE.1), past(), crate::pipeline::scene::body(vec![surface]));
        let row = VirtualCamera::new(stage, FPS, 1).next_entry().unwrap();
        let EntryContent::Frame(frame) = row.content else { panic!("the virtual stage has a picture for every row") };
        jpeg(&frame.image)
    })
}

/// Returns short limits, so that a test ends soon.
pub fn patience() -> Patience {
    let ms = Duration::from_millis;
    Patience { read: ms(20), silence: ms(1500), blocked: ms(500), between_openings: ms(5) }
}

/// Returns a source that reads the camera.
pub fn source(faulty: &Arc<Faulty>, link: &LiveLink) -> LiveSource {
    // These panics are intended.
    std::panic::set_hook(Box::new(|info| {
        if !info.to_string().contains("told to panic") {
            eprintln!("{info}");
        }
    }));
    LiveSource::start(Arc::new(Opener(faulty.clone())), Shutter::default(), patience(), link.clone())
}
