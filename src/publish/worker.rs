//! An output's thread: takes samples from its queue, decides what is due, and sends it.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError};

use super::channel::BodyChannel;
use super::clocks::Reading;
use super::encoder::Encoder;
use super::frame_clock::FrameClock;
use super::report::{Report, ReportedTimecode};
use super::resample::Known;
use super::rings::{HeardRings, Rings};
use super::settings::{OnLoss, Rate, TickPhase};
use super::system_clock::{ClockQuality, tai_offset_s};
use super::ticks::Ticks;
use super::transport::Transport;
use crate::frame::Timestamp;
use crate::record::{PoseSample, State};
use crate::timecode::TimecodeSource;

/// A sample with its instant.
#[derive(Debug)]
pub(super) struct Arrival {
    pub sample: Arc<PoseSample>,
    /// When the frame was taken, on the boot clock.
    pub at: Timestamp,
    pub recorded: Option<Timestamp>,
    /// Frames per second of the source.
    pub rate_hz: f64,
    /// Interval between its frames, as measured.
    pub interval: Duration,
    /// When it was passed to the publisher.
    pub arrived: Instant,
}

/// Statistics of an output, shared with readers.
#[derive(Debug, Default)]
pub(super) struct Counters {
    pub sent: AtomicU64,
    pub failed: AtomicU64,
    pub withheld: AtomicU64,
    pub dropped: AtomicU64,
    pub latency_us: AtomicU64,
    pub greatest_latency_us: AtomicU64,
    /// Its memory is reused.
    pub last_packet: Mutex<Vec<u8>>,
}

/// Interval at which a loss is repeated if the format can announce it. Chosen, not tuned. Raised, a
/// receiver that starts later learns of it later.
const REPEAT: Duration = Duration::from_secs(1);
/// Interval at which clients are accepted, repetitions sent and the age of the newest frame
/// checked. Chosen, not tuned. Raised, a client waits longer to be accepted; lowered, idle outputs
/// use processor time.
const ROUND: Duration = Duration::from_millis(100);

/// Assumed rate of the source before a few frames have come, frames per second: a webcam's.
pub(super) const USUAL_RATE_HZ: f64 = 30.0;

/// Everything owned by an output's thread.
pub(super) struct Worker {
    pub inbox: Receiver<Arc<Arrival>>,
    pub encoder: Box<dyn Encoder>,
    pub transport: Transport,
    pub bodies: Vec<BodyChannel>,
    pub rate: Rate,
    /// For `Rate::Every`: the poses sent are those of this long before the frame.
    pub delay: Duration,
    pub on_loss: OnLoss,
    pub stale_after: Duration,
    pub is_test: bool,
    pub counters: Arc<Counters>,
    pub clock: Arc<FrameClock>,
    pub timecode: Option<Arc<TimecodeSource>>,
    /// Zoom and focus that are passed on.
    pub rings: Option<Arc<HeardRings>>,
    pub memory: Memory,
}

/// The worker's state; instants are on the boot clock.
pub(super) struct Memory {
    /// When the newest frame was taken; before the first one, when the output started.
    newest: Timestamp,
    last: Option<Arc<Arrival>>,
    last_sent: Option<Timestamp>,
    next_round: Timestamp,
    /// For `Rate::Fixed`.
    ticks: Option<Ticks>,
    /// The system clock's quality, and when it was asked for.
    quality: Option<(Timestamp, Option<ClockQuality>)>,
    taken: u64,
    /// For how many bodies the last sample had a pose.
    known_bodies: usize,
    had_pose: bool,
}

impl Memory {
    pub fn start(now: Reading, rate: Rate) -> Self {
        let ticks = match rate {
            Rate::Fixed { rate, phase, .. } => Some(Ticks::new(rate, phase, tai_offset_s(), now)),
            Rate::Every(_) => None,
        };
        Self {
            newest: now.boot,
            last: None,
            last_sent: None,
            next_round: now.boot,
            ticks,
            quality: None,
            taken: 0,
            known_bodies: 0,
            had_pose: false,
        }
    }
}

impl Worker {
    /// Runs until the publisher is closed and the queue is empty.
    pub fn run(mut self) {
        loop {
            match self.inbox.recv_timeout(self.wait()) {
                Ok(arrival) => self.take(arrival),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            self.tick();
            self.round();
        }
    }

    /// Returns the time until something is due, at most one round, since the clock may have jumped
    /// by then.
    fn wait(&self) -> Duration {
        let now = self.clock.now();
        let until_tick = self.memory.ticks.as_ref().map_or(ROUND, |ticks| ticks.wait(now));
        self.memory.next_round.duration_since(now.boot).min(until_tick).min(ROUND)
    }

    fn take(&mut self, arrival: Arc<Arrival>) {
        let now = self.clock.now();
        self.memory.newest = arrival.at;
        // The frame's current age decides, including its time in the queue.
        let is_late = self.is_stale(now);
        let known = |body: &BodyChannel| if is_late { Known::nothing(State::Stale) } else { body.known(&arrival.sample) };
        let known: Vec<Known> = self.bodies.iter().map(known).collect();
        let keep = |(body, known): (&mut BodyChannel, Known)| body.keep(arrival.at, known);
        match self.rate {
            Rate::Fixed { .. } => self.bodies.iter_mut().zip(known).for_each(keep),
            Rate::Every(n) => {
                let at = arrival.at.before(self.delay);
                let known = if self.delay.is_zero() || is_late {
                    known
                } else {
                    self.bodies.iter_mut().zip(known).for_each(keep);
                    self.bodies.iter().map(|body| body.at(at, arrival.interval)).collect()
                };
                let is_due = self.memory.taken.is_multiple_of(u64::from(n.max(1)));
                self.memory.taken += 1;
                // A loss is sent at once, not only with every n-th sample.
                let known_bodies = known.iter().filter(|known| self.sendable(**known).pose.is_some()).count();
                let is_loss = known_bodies < std::mem::replace(&mut self.memory.known_bodies, known_bodies);
                if is_due || is_loss {
                    // A delayed pose is not this frame's measurement, so the sample is left out.
                    self.say(arrival.sample.sequence, at, known, Some(&arrival).filter(|_| self.delay.is_zero()));
                }
            }
        }
        self.memory.last = Some(arrival);
    }

    /// Sends what is due on a fixed rate.
    fn tick(&mut self) {
        let (Rate::Fixed { delay, .. }, now) = (self.rate, self.clock.now()) else { return };
        let Some((tick, at)) = self.memory.ticks.as_mut().and_then(|ticks| ticks.due(now)) else { return };
        let at = at.before(delay);
        let interval = self.memory.last.as_ref().map_or(frame_time(USUAL_RATE_HZ), |last| last.interval);
        let is_stale = self.is_stale(now);
        let known = |body: &BodyChannel| if is_stale { Known::nothing(State::Stale) } else { body.at(at, interval) };
        let known = self.bodies.iter().map(known).collect();
        self.say(tick, at, known, None);
    }

    /// Whether the newest frame is too old.
    fn is_stale(&self, now: Reading) -> bool {
        now.boot.duration_since(self.memory.newest) >= self.stale_after
    }

    /// Does the periodic work, about ten times a second.
    fn round(&mut self) {
        let now = self.clock.now();
        if now.boot < self.memory.next_round {
            return;
        }
        let until_stale = self.memory.newest.after(self.stale_after).duration_since(now.boot);
        let pause = if until_stale.is_zero() { self.stale_after } else { until_stale };
        self.memory.next_round = now.boot.after(ROUND.min(pause));
        self.transport.attend();
        for (from, packet) in self.transport.heard() {
            self.encoder.hear(now.monotonic, from, &packet);
        }
        for (to, packet) in self.encoder.answers(now.monotonic) {
            count(&self.counters, &packet, self.transport.answer(to, &packet));
        }
        let (transport, counters) = (&mut self.transport, &self.counters);
        self.encoder.repeat(now.monotonic, &mut |packet| count(counters, packet, transport.send(packet)));
        if matches!(self.rate, Rate::Every(_)) && self.is_stale(now) {
            let known = vec![Known::nothing(State::Stale); self.bodies.len()];
            let sequence = self.memory.last.as_ref().map_or(0, |last| last.sample.sequence);
            self.say(sequence, self.memory.newest, known, None);
        }
    }

    /// Drops the pose of a mere prediction if the format cannot mark it.
    fn sendable(&self, known: Known) -> Known {
        let is_usable = known.state != State::Coasting || self.encoder.marks_coasting();
        Known { pose: known.pose.filter(|_| is_usable), ..known }
    }

    /// Sends a report of the bodies at an instant, if one is due.
    fn say(&mut self, sequence: u64, at: Timestamp, known: Vec<Known>, arrival: Option<&Arc<Arrival>>) {
        let known: Vec<Known> = known.into_iter().map(|known| self.sendable(known)).collect();
        let encoder = &self.encoder;
        let report = |(body, known): (&mut BodyChannel, Known)| body.report(at, known, &|pose| encoder.holds(pose));
        let bodies: Vec<_> = self.bodies.iter_mut().zip(known).map(report).collect();
        let withheld = bodies.iter().filter(|body| body.withheld.is_some()).count();
        self.counters.withheld.fetch_add(withheld as u64, Ordering::Relaxed);
        let now = self.clock.now();
        let has_pose = bodies.iter().any(|body| body.pose.is_some());
        if !has_pose && !self.is_loss_due(now) {
            self.memory.had_pose = false;
            return;
        }
        self.memory.had_pose = has_pose;
        let since_now_ns = at.ns_since(now.boot);
        let monotonic = now.monotonic.after_ns(since_now_ns);
        let clock = self.quality(now);
        let latest = arrival.or(self.memory.last.as_ref());
        // A tick has no stamp of its own: it is as far from the last sample on the clip's clock as
        // on this machine's.
        let recorded = latest.and_then(|a| Some(a.recorded?.after_ns(at.ns_since(a.at))));
        let report = Report {
            sequence,
            unix: now.unix.after_ns(since_now_ns),
            monotonic,
            sent_monotonic: now.monotonic,
            recorded,
            timecode: self.timecode.as_ref().map_or(ReportedTimecode::TimeOfDay, |timecode| {
                timecode.at(recorded.unwrap_or(monotonic)).map_or(ReportedTimecode::Unknown, ReportedTimecode::Known)
            }),
            rings: self.rings.as_ref().map_or_else(Rings::default, |rings| rings.get()),
            clock,
            is_on_clock: matches!(self.rate, Rate::Fixed { phase: TickPhase::Clock, .. }),
            rate_hz: self.rate.hz(latest.map_or(USUAL_RATE_HZ, |a| a.rate_hz)),
            bodies,
            sample: arrival.map(|a| a.sample.clone()),
            // A clip's first frame, which sets its clock, may have come late; later frames must not
            // seem to come from the future.
            age_ms: now.boot.ms_since(at).max(0.0),
            is_test: self.is_test,
        };
        self.send(&report);
        self.memory.last_sent = Some(now.boot);
        if let Some(arrival) = arrival {
            let us = u64::try_from(arrival.arrived.elapsed().as_micros()).unwrap_or(u64::MAX);
            self.counters.latency_us.store(us, Ordering::Relaxed);
            self.counters.greatest_latency_us.fetch_max(us, Ordering::Relaxed);
        }
    }

    /// Returns the system clock's quality, which is asked for once a second.
    fn quality(&mut self, now: Reading) -> Option<ClockQuality> {
        match self.memory.quality {
            Some((asked, quality)) if now.boot.duration_since(asked) < REPEAT => quality,
            _ => self.memory.quality.insert((now.boot, ClockQuality::read())).1,
        }
    }

    /// Sends a report's packets. If the process was stopped since the age was checked, they would
    /// present an old frame as good: they are dropped, and the next round reports that it is stale.
    fn send(&mut self, report: &Report) {
        let is_reported_stale = report.bodies.iter().all(|body| body.state == State::Stale);
        let stale_at = self.memory.newest.after(self.stale_after);
        let (transport, counters, clock) = (&mut self.transport, &self.counters, &self.clock);
        self.encoder.encode(report, &mut |packet| {
            if is_reported_stale || clock.now().boot < stale_at {
                count(counters, packet, transport.send(packet));
            } else {
                counters.dropped.fetch_add(1, Ordering::Relaxed);
            }
        });
    }

    /// Whether a report without any pose must be sent now.
    fn is_loss_due(&self, now: Reading) -> bool {
        let is_repeated = self.memory.last_sent.is_none_or(|sent| now.boot.duration_since(sent) >= REPEAT);
        match self.on_loss {
            OnLoss::Flag => self.encoder.marks_loss(),
            OnLoss::Stop | OnLoss::Hold => self.encoder.announces_loss() && (self.memory.had_pose || is_repeated),
        }
    }
}

fn count(counters: &Counters, packet: &[u8], (taken, failed): (u64, u64)) {
    let mut last = counters.last_packet.lock().unwrap_or_else(PoisonError::into_inner);
    last.clear();
    last.extend_from_slice(packet);
    drop(last);
    counters.sent.fetch_add(taken, Ordering::Relaxed);
    counters.failed.fetch_add(failed, Ordering::Relaxed);
}

/// Returns the time between frames at a rate.
pub(super) fn frame_time(rate_hz: f64) -> Duration {
    Duration::from_nanos((1e9 / rate_hz) as u64)
}

#[cfg(test)]
mod tests {
    use std::net::UdpSocket;

    use super::super::clocks::stepped::SteppedClocks;
    use super::super::report::BodyChoice;
    use super::super::settings::{OutputSettings, Protocol, SafetySettings};
    use super::super::stamps::Stamps;
    use super::super::transport::UdpSettings;
    use super::super::{JsonSettings, Placement};
    use super::*;
    use crate::protocols::golden::golden_camera;
    use crate::record::StageTimes;

    /// Sends the bodies' states; the process is stopped for some time meanwhile.
    struct Stopped {
        clocks: SteppedClocks,
        stop_ms: i64,
    }

    impl Encoder for Stopped {
        fn encode(&mut self, report: &Report, send: &mut dyn FnMut(&[u8])) {
            self.clocks.advance_ms(std::mem::take(&mut self.stop_ms));
            send(report.bodies[0].state.word().as_bytes());
        }
    }

    /// Returns what is sent about a frame if the process is stopped for `stop_ms` while its packet
    /// is made, and the number of packets dropped.
    fn received(stop_ms: i64) -> (Vec<String>, u64) {
        let ear = UdpSocket::bind("127.0.0.1:0").unwrap();
        ear.set_nonblocking(true).unwrap();
        let settings = OutputSettings {
            name: "desk".to_owned(),
            enabled: true,
            protocol: Protocol::Json(JsonSettings::default()),
            udp: UdpSettings { to: vec![ear.local_addr().unwrap()], ..UdpSettings::default() },
            bodies: vec![BodyChoice::Camera],
            rate: Rate::Every(1),
            delay: Duration::ZERO,
            on_loss: OnLoss::Flag,
            placement: Placement::default(),
            is_guarded: false,
            passes_rings: false,
        };
        let clocks = SteppedClocks::new();
        let clock = Arc::new(FrameClock::with(Arc::new(clocks.clone()), Stamps::Live));
        let counters = Arc::new(Counters::default());
        let (events, _) = crossbeam_channel::unbounded();
        let body = BodyChannel::new(("camera".into(), BodyChoice::Camera), None, SafetySettings::default(), &settings, events);
        let mut worker = Worker {
            inbox: crossbeam_channel::never(),
            encoder: Box::new(Stopped { clocks, stop_ms }),
            transport: Transport::open("desk", &settings.udp, None, None).unwrap(),
            bodies: vec![body],
            rate: settings.rate,
            delay: settings.delay,
            on_loss: settings.on_loss,
            stale_after: Duration::from_millis(500),
            is_test: false,
            counters: counters.clone(),
            memory: Memory::start(clock.now(), settings.rate),
            clock: clock.clone(),
            timecode: None,
            rings: None,
        };
        let sample = PoseSample {
            sequence: 7,
            timestamp: clock.now().monotonic,
            state: State::Tracking,
            pose: Some(golden_camera()),
            measurement: None,
            objects: Vec::new(),
            reason: None,
            learnt: Default::default(),
            times: StageTimes::default(),
        };
        let at = clock.taken(sample.timestamp, Duration::ZERO).unwrap();
        let (rate_hz, interval) = (30.0, frame_time(30.0));
        worker.take(Arc::new(Arrival { sample: Arc::new(sample), at, recorded: None, rate_hz, interval, arrived: Instant::now() }));
        worker.round();
        let mut buffer = [0; 64];
        let received = std::iter::from_fn(|| ear.recv(&mut buffer).ok().map(|n| String::from_utf8_lossy(&buffer[..n]).into_owned()));
        (received.collect(), counters.dropped.load(Ordering::Relaxed))
    }

    #[test]
    fn a_pause_during_encoding_sends_stale_not_tracking() {
        assert_eq!(received(0), (vec!["tracking".to_owned()], 0));
        assert_eq!(received(499), (vec!["tracking".to_owned()], 0));
        assert_eq!(received(2_500), (vec!["stale".to_owned()], 1));
    }
}
