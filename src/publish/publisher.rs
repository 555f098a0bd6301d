//! All outputs together: passes each sample to every output's thread without waiting.

use std::net::SocketAddr;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender, bounded};
use thiserror::Error;

use super::channel::{BodyChannel, PoseWithheld};
use super::clocks::{Clocks, SystemClocks};
use super::complaints::Complaints;
use super::encoder::Encoder;
use super::frame_clock::FrameClock;
use super::freed::FreedEncoder;
use super::json::JsonEncoder;
use super::mounted::MountSettings;
use super::opentrackio::OpenTrackIoEncoder;
use super::osc::OscEncoder;
use super::otp::OtpEncoder;
use super::psn::PsnEncoder;
use super::report::BodyChoice;
use super::rings::HeardRings;
use super::settings::{OutputSettings, Protocol, SafetySettings};
use super::stamps::{Pace, Stamps};
use super::transport::{Transport, TransportError};
use super::worker::{Arrival, Counters, Memory, USUAL_RATE_HZ, Worker, frame_time};
use crate::camera::CameraModel;
use crate::drop_oldest::{DropOldestSender, drop_oldest};
use crate::frame::Timestamp;
use crate::record::{PoseSample, State};
use crate::timecode::TimecodeSource;

/// What all outputs share.
#[derive(Debug, Clone)]
pub struct Context {
    /// The camera at the size of its pictures; its lens goes into the packets.
    pub camera: CameraModel,
    /// The objects' names, in the order of the samples.
    pub objects: Vec<String>,
    /// Settings of `[mount]`.
    pub mount: Option<MountSettings>,
    /// Settings of `[safety]`.
    pub safety: SafetySettings,
    /// Where the samples' stamps come from.
    pub stamps: Stamps,
    /// Timecode of the samples' stamps; `None` sends the time of day where a format needs one.
    pub timecode: Option<Arc<TimecodeSource>>,
    /// Zoom and focus of another device, for the outputs that pass them on.
    pub rings: Option<Arc<HeardRings>>,
    /// Frames per second if known; otherwise derived from the stamps.
    pub frame_rate: Option<f64>,
    /// Whether the poses are invented; they are marked as such if the format can.
    pub is_test: bool,
}

/// Why outputs cannot be started.
#[derive(Debug, Error)]
pub enum PublishError {
    /// An output cannot be opened.
    #[error("output {output}: {source}")]
    Open {
        /// The output's name.
        output: String,
        /// The reason.
        source: TransportError,
    },
    /// A thread cannot be started.
    #[error("output {output}: cannot start its thread ({source}); close other programs or raise the limit of processes")]
    Thread {
        /// The output's name.
        output: String,
        /// The system's error.
        source: std::io::Error,
    },
}

/// Statistics of an output so far.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OutputStatistics {
    /// The output's name.
    pub name: String,
    /// The protocol's name in the config.
    pub protocol: &'static str,
    /// Packets that a destination accepted.
    pub sent: u64,
    /// Packets that a destination did not accept.
    pub failed: u64,
    /// Poses withheld by the safety limits.
    pub withheld: u64,
    /// Samples dropped because the output was late.
    pub dropped: u64,
    /// From the sample's arrival to its last packet, microseconds: the latest value.
    pub latency_us: u64,
    /// The maximum of `latency_us`.
    pub greatest_latency_us: u64,
    /// The last packet passed to the destinations; empty before the first.
    pub last_packet: Vec<u8>,
}

/// Maximum number of samples queued for one output before the oldest is dropped: about a second at
/// 30 per second. Chosen, not tuned. Raised, a delayed output sends older poses.
const QUEUE: usize = 32;
/// Maximum number of queued safety events (chosen: far more than come between two polls). Raised,
/// it only takes memory; lowered, events may be lost.
const EVENTS: usize = 64;
/// How long to wait for outputs to end before abandoning them. Chosen, not tuned. Raised, a hung
/// output delays the daemon's exit; lowered, the last packets may not be sent.
const PATIENCE: Duration = Duration::from_secs(2);

/// The running outputs.
#[derive(Debug)]
pub struct Publisher {
    outputs: Vec<RunningOutput>,
    frame_rate: Option<f64>,
    clock: Arc<FrameClock>,
    timecode: Option<Arc<TimecodeSource>>,
    order: Mutex<Order>,
    events: Receiver<PoseWithheld>,
}

/// State for processing samples in order.
#[derive(Debug)]
struct Order {
    pace: Pace,
    last: Option<Timestamp>,
    foreign: Complaints,
}

#[derive(Debug)]
struct RunningOutput {
    name: String,
    protocol: &'static str,
    queue: DropOldestSender<Arc<Arrival>>,
    counters: Arc<Counters>,
    thread: JoinHandle<()>,
}

impl Publisher {
    /// Opens every enabled output and starts its thread.
    ///
    /// # Errors
    /// The first output that cannot be opened.
    pub fn start(outputs: &[OutputSettings], context: &Context) -> Result<Self, PublishError> {
        Self::start_with_clocks(outputs, context, Arc::new(SystemClocks))
    }

    /// Does the same with other clocks than this machine's.
    ///
    /// # Errors
    /// The first output that cannot be opened.
    pub fn start_with_clocks(outputs: &[OutputSettings], context: &Context, clocks: Arc<dyn Clocks>) -> Result<Self, PublishError> {
        let (raise, events) = bounded(EVENTS);
        let clock = Arc::new(FrameClock::with(clocks, context.stamps.clone()));
        let start = |output| RunningOutput::start(output, context, &clock, &raise);
        let outputs = outputs.iter().filter(|o| o.enabled).map(start).collect::<Result<_, _>>()?;
        let order = Mutex::new(Order { pace: Pace::default(), last: None, foreign: Complaints::new("all") });
        Ok(Self { outputs, frame_rate: context.frame_rate, clock, timecode: context.timecode.clone(), order, events })
    }

    /// Opens every enabled output and closes it again, to check whether the addresses, ports and
    /// files can be used. Addresses for which `is_held` is true are held by this process and will
    /// be free. Returns the index of the output that cannot be opened, with the reason.
    pub fn rehearse(outputs: &[OutputSettings], is_held: &dyn Fn(SocketAddr) -> bool) -> Result<(), (usize, TransportError)> {
        let rehearse = |output: &OutputSettings| Transport::rehearse(&output.name, &output.udp, output.stream(), output.listen(), is_held);
        let mut enabled = outputs.iter().enumerate().filter(|(_, o)| o.enabled);
        enabled.try_for_each(|(index, output)| rehearse(output).map_err(|e| (index, e)))
    }

    /// Passes a sample to every output; never waits. A sample whose stamp does not follow the last
    /// one (a skipped row) tells nothing about the bodies and is not sent. Neither is a message
    /// that belongs to no frame.
    pub fn send(&self, sample: &PoseSample) {
        let arrived = Instant::now();
        let t = &sample.times;
        let work = Duration::from_nanos(((t.decode_ms + t.acquire_ms + t.align_ms + t.pose_ms) * 1e6) as u64);
        let stamp = sample.timestamp;
        let mut order = self.order.lock().unwrap_or_else(PoisonError::into_inner);
        if sample.state == State::Stale || order.last.is_some_and(|last| stamp <= last) {
            return;
        }
        let Some(at) = self.clock.taken(stamp, work) else {
            let sentence = "the camera's stamps are not from the monotonic clock, so the age of its frames is unknown; they are not sent";
            order.foreign.say(|| sentence.to_owned());
            return;
        };
        if let (None, Some(timecode)) = (order.last, &self.timecode) {
            timecode.begin(stamp);
        }
        order.last = Some(stamp);
        order.pace.follow(stamp);
        let rate_hz = self.frame_rate.or(order.pace.rate_hz()).unwrap_or(USUAL_RATE_HZ);
        let interval = order.pace.interval().unwrap_or(frame_time(rate_hz));
        drop(order);
        let recorded = self.clock.recorded(stamp);
        let arrival = Arc::new(Arrival { sample: Arc::new(sample.clone()), at, recorded, rate_hz, interval, arrived });
        for output in &self.outputs {
            let dropped = output.queue.send(arrival.clone());
            output.counters.dropped.fetch_add(dropped as u64, Ordering::Relaxed);
        }
    }

    /// Returns the latest time from a sample's arrival to its last packet, microseconds, of the
    /// slowest output; `None` while nothing was sent.
    pub fn slowest_us(&self) -> Option<u64> {
        let latency = |output: &RunningOutput| {
            let has_sent = output.counters.sent.load(Ordering::Relaxed) > 0;
            has_sent.then(|| output.counters.latency_us.load(Ordering::Relaxed))
        };
        self.outputs.iter().filter_map(latency).max()
    }

    /// Returns a function with which other threads can read the outputs' statistics.
    pub fn watch(&self) -> impl Fn() -> Vec<OutputStatistics> + Send + Sync + 'static {
        let outputs: Vec<_> = self.outputs.iter().map(|o| (o.name.clone(), o.protocol, o.counters.clone())).collect();
        move || outputs.iter().map(|(name, protocol, counters)| statistics_of(name.clone(), protocol, counters)).collect()
    }

    /// Returns the channel of safety events; if nobody reads it, the newest events are lost.
    pub fn events(&self) -> &Receiver<PoseWithheld> {
        &self.events
    }

    /// Sends what is queued and ends the threads; one that hangs (a pipe that nobody reads) is
    /// abandoned after two seconds.
    pub fn close(self) -> Vec<OutputStatistics> {
        let begun = Instant::now();
        let mut statistics = Vec::new();
        let threads: Vec<_> = self.outputs.into_iter().map(|o| (o.name.clone(), o.protocol, o.counters.clone(), o.into_thread())).collect();
        for (name, protocol, counters, thread) in threads {
            while !thread.is_finished() && begun.elapsed() < PATIENCE {
                std::thread::sleep(Duration::from_millis(1));
            }
            match thread.is_finished().then(|| thread.join()) {
                None => tracing::warn!("output {name}: it accepts no more data, so the rest is dropped"),
                Some(Err(_)) => tracing::error!("output {name}: it failed; please report this"),
                Some(Ok(())) => {}
            }
            statistics.push(statistics_of(name, protocol, &counters));
        }
        statistics
    }
}

impl RunningOutput {
    fn start(
        settings: &OutputSettings,
        context: &Context,
        clock: &Arc<FrameClock>,
        events: &Sender<PoseWithheld>,
    ) -> Result<Self, PublishError> {
        let (name, protocol) = (settings.name.clone(), settings.protocol.word());
        let transport = Transport::open(&name, &settings.udp, settings.stream(), settings.listen())
            .map_err(|source| PublishError::Open { output: name.clone(), source })?;
        let (queue, inbox) = drop_oldest(QUEUE);
        let counters = Arc::new(Counters::default());
        let worker = Worker {
            inbox,
            encoder: encoder(settings, context, clock),
            transport,
            bodies: settings.bodies.iter().map(|body| channel(*body, settings, context, events)).collect(),
            rate: settings.rate,
            delay: settings.delay,
            on_loss: settings.on_loss,
            stale_after: context.safety.stale_after,
            is_test: context.is_test,
            counters: counters.clone(),
            memory: Memory::start(clock.now(), settings.rate),
            clock: clock.clone(),
            timecode: context.timecode.clone(),
            rings: context.rings.clone().filter(|_| settings.passes_rings),
        };
        let thread = std::thread::Builder::new().name(format!("out-{name}")).spawn(move || worker.run());
        let thread = thread.map_err(|source| PublishError::Thread { output: name.clone(), source })?;
        Ok(Self { name, protocol, queue, counters, thread })
    }

    /// Closes the queue; the thread ends once it is empty.
    fn into_thread(self) -> JoinHandle<()> {
        self.thread
    }
}

fn statistics_of(name: String, protocol: &'static str, counters: &Counters) -> OutputStatistics {
    let read = |counter: &std::sync::atomic::AtomicU64| counter.load(Ordering::Relaxed);
    OutputStatistics {
        name,
        protocol,
        sent: read(&counters.sent),
        failed: read(&counters.failed),
        withheld: read(&counters.withheld),
        dropped: read(&counters.dropped),
        latency_us: read(&counters.latency_us),
        greatest_latency_us: read(&counters.greatest_latency_us),
        last_packet: counters.last_packet.lock().unwrap_or_else(PoisonError::into_inner).clone(),
    }
}

fn body_name(choice: BodyChoice, context: &Context) -> &str {
    match choice {
        BodyChoice::Camera => "camera",
        BodyChoice::Object(index) => context.objects.get(index).map_or("object", String::as_str),
        BodyChoice::Mount => context.mount.as_ref().map_or("mount", |mount| &mount.name),
    }
}

fn channel(choice: BodyChoice, settings: &OutputSettings, context: &Context, events: &Sender<PoseWithheld>) -> BodyChannel {
    let name = body_name(choice, context);
    let limits = if settings.is_guarded { context.safety } else { SafetySettings::default() };
    let mount = context.mount.as_ref().map(|mount| mount.mount);
    BodyChannel::new((name.into(), choice), mount, limits, settings, events.clone())
}

fn encoder(settings: &OutputSettings, context: &Context, clock: &FrameClock) -> Box<dyn Encoder> {
    // The lens is that of the reported camera.
    let camera = match (settings.bodies.first(), &context.mount) {
        (Some(BodyChoice::Mount), Some(mount)) => mount.camera.as_ref(),
        _ => Some(&context.camera),
    };
    let names = || -> Vec<Arc<str>> { settings.bodies.iter().map(|body| body_name(*body, context).into()).collect() };
    match &settings.protocol {
        Protocol::Freed(freed) => Box::new(FreedEncoder::new(freed.clone(), camera)),
        Protocol::OpenTrackIo(otrk) => Box::new(OpenTrackIoEncoder::new(otrk, camera, &settings.name)),
        Protocol::Psn(psn) => Box::new(PsnEncoder::new(psn, &names(), clock.now().monotonic)),
        Protocol::Otp(otp) => Box::new(OtpEncoder::new(otp, &names(), &settings.name, clock.now().monotonic)),
        Protocol::Osc(osc) => Box::new(OscEncoder::new(osc, &settings.name)),
        Protocol::Json(_) => Box::new(JsonEncoder::new(settings.placement, context.mount.as_ref().map(|mount| mount.mount))),
    }
}

#[cfg(test)]
#[path = "publisher_tests.rs"]
mod tests;
