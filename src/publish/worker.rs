//! One output's thread: takes samples from its queue, decides what is due, and sends it.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError};

use super::channel::{BodyChannel, Known};
use super::encoder::Encoder;
use super::report::{Report, Standing};
use super::settings::{OnLoss, Rate};
use super::stamps::{self, Instants};
use super::transport::Transport;
use crate::record::PoseSample;

/// A sample with the instant that it is of.
#[derive(Debug)]
pub(super) struct Arrival {
    pub sample: Arc<PoseSample>,
    pub at: Instants,
    pub recorded_ns: Option<i64>,
    /// Frames per second of the source.
    pub rate_hz: f64,
    /// When it was handed to the publisher.
    pub arrived: Instant,
}

/// What an output has done so far; shared with whoever asks.
#[derive(Debug, Default)]
pub(super) struct Counters {
    pub sent: AtomicU64,
    pub failed: AtomicU64,
    pub withheld: AtomicU64,
    pub dropped: AtomicU64,
    pub latency_us: AtomicU64,
    pub greatest_latency_us: AtomicU64,
}

/// How often a loss is said again, and how often a protocol's own repetitions are due at least.
const REPEAT: Duration = Duration::from_secs(1);
/// How often new clients are let in and repetitions looked after.
const ROUND: Duration = Duration::from_millis(100);

/// Taken for the source's rate before the second frame.
pub(super) const USUAL_RATE_HZ: f64 = 30.0;

/// Everything that one output's thread owns.
pub(super) struct Worker {
    pub inbox: Receiver<Arc<Arrival>>,
    pub encoder: Box<dyn Encoder>,
    pub transport: Transport,
    pub bodies: Vec<BodyChannel>,
    pub rate: Rate,
    pub on_loss: OnLoss,
    pub stale_after: Duration,
    pub is_test: bool,
    pub counters: Arc<Counters>,
    pub clock: Clock,
}

/// What the worker remembers of time.
pub(super) struct Clock {
    begun: Instant,
    begun_ns: i64,
    last_arrival: Instant,
    last: Option<Arc<Arrival>>,
    last_sent: Option<Instant>,
    next_round: Instant,
    next_tick: u64,
    taken: u64,
    /// How many bodies the last sample had a pose of.
    known_bodies: usize,
    had_pose: bool,
}

impl Clock {
    pub fn start() -> Self {
        let now = Instant::now();
        Self {
            begun: now,
            begun_ns: stamps::now().monotonic_ns,
            last_arrival: now,
            last: None,
            last_sent: None,
            next_round: now,
            next_tick: 0,
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
            match self.inbox.recv_deadline(self.next_wake()) {
                Ok(arrival) => self.take(arrival),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            self.tick();
            self.round();
        }
    }

    fn next_wake(&self) -> Instant {
        match self.rate {
            Rate::Fixed { rate, .. } => self.clock.next_round.min(self.clock.begun + since_start(rate.tick_ns(self.clock.next_tick))),
            Rate::Every(_) => self.clock.next_round,
        }
    }

    fn take(&mut self, arrival: Arc<Arrival>) {
        self.clock.last_arrival = Instant::now();
        let marks_coasting = self.encoder.marks_coasting();
        let known: Vec<Known> = self.bodies.iter().map(|body| body.known(&arrival.sample, marks_coasting)).collect();
        match self.rate {
            Rate::Fixed { .. } => {
                self.bodies.iter_mut().zip(known).for_each(|(body, known)| body.keep(arrival.at.monotonic_ns, known));
            }
            Rate::Every(n) => {
                let is_due = self.clock.taken.is_multiple_of(u64::from(n.max(1)));
                self.clock.taken += 1;
                // A loss does not wait for its turn.
                let known_bodies = known.iter().filter(|known| known.pose.is_some()).count();
                let is_loss = known_bodies < std::mem::replace(&mut self.clock.known_bodies, known_bodies);
                if is_due || is_loss {
                    self.say(arrival.sample.sequence, arrival.at, &known, Some(&arrival));
                }
            }
        }
        self.clock.last = Some(arrival);
    }

    /// Sends what is due on a fixed rate.
    fn tick(&mut self) {
        let Rate::Fixed { rate, delay } = self.rate else { return };
        let elapsed_ns = nanoseconds(self.clock.begun.elapsed());
        if elapsed_ns < rate.tick_ns(self.clock.next_tick) {
            return;
        }
        // Whoever is late skips ticks instead of sending a burst.
        while rate.tick_ns(self.clock.next_tick + 1) <= elapsed_ns {
            self.clock.next_tick += 1;
        }
        let tick = self.clock.next_tick;
        self.clock.next_tick += 1;
        let monotonic_ns = self.clock.begun_ns + rate.tick_ns(tick) - nanoseconds(delay);
        let now = stamps::now();
        let at = Instants { monotonic_ns, unix_ns: now.unix_ns - (now.monotonic_ns - monotonic_ns) };
        let known: Vec<Known> = match self.is_stale() {
            true => self.bodies.iter_mut().map(BodyChannel::stale).collect(),
            false => self.bodies.iter().map(|body| body.at(monotonic_ns)).collect(),
        };
        self.say(tick, at, &known, None);
    }

    fn is_stale(&self) -> bool {
        self.clock.last_arrival.elapsed() >= self.stale_after
    }

    /// What is done ten times a second.
    fn round(&mut self) {
        if Instant::now() < self.clock.next_round {
            return;
        }
        let until_stale = self.stale_after.saturating_sub(self.clock.last_arrival.elapsed());
        self.clock.next_round = Instant::now() + if until_stale.is_zero() { ROUND.min(self.stale_after) } else { ROUND.min(until_stale) };
        self.transport.attend();
        let (transport, counters) = (&mut self.transport, &self.counters);
        self.encoder.repeat(stamps::now().monotonic_ns, &mut |packet| count(counters, transport.send(packet)));
        if matches!(self.rate, Rate::Every(_)) && self.is_stale() {
            let at = self.clock.last.as_ref().map_or_else(stamps::now, |last| last.at);
            let known: Vec<Known> = self.bodies.iter_mut().map(BodyChannel::stale).collect();
            self.say(self.clock.last.as_ref().map_or(0, |last| last.sample.sequence), at, &known, None);
        }
    }

    /// Sends one report, unless there is nothing to say.
    fn say(&mut self, sequence: u64, at: Instants, known: &[Known], arrival: Option<&Arc<Arrival>>) {
        let bodies: Vec<_> = self.bodies.iter_mut().zip(known).map(|(body, known)| body.report(at.monotonic_ns, *known)).collect();
        let withheld = bodies.iter().filter(|body| matches!(body.standing, Standing::Withheld(_))).count();
        self.counters.withheld.fetch_add(withheld as u64, Ordering::Relaxed);
        let has_pose = bodies.iter().any(|body| body.pose.is_some());
        if !has_pose && !self.is_loss_due() {
            self.clock.had_pose = false;
            return;
        }
        self.clock.had_pose = has_pose;
        let latest = arrival.or(self.clock.last.as_ref());
        let report = Report {
            sequence,
            unix_ns: at.unix_ns,
            monotonic_ns: at.monotonic_ns,
            // A tick has no stamp of its own: it lies as far from the last sample on the clip's clock as on this machine's.
            recorded_ns: latest.and_then(|a| Some(a.recorded_ns?.saturating_add(at.monotonic_ns - a.at.monotonic_ns))),
            rate_hz: self.rate.hz(latest.map_or(USUAL_RATE_HZ, |a| a.rate_hz)),
            bodies,
            sample: arrival.map(|a| a.sample.clone()),
            // A clip's first frame, from which its clock counts, may have come late: those after it are not from the future.
            age_ms: (stamps::now().monotonic_ns - at.monotonic_ns).max(0) as f64 * 1e-6,
            is_test: self.is_test,
        };
        let (transport, counters) = (&mut self.transport, &self.counters);
        self.encoder.encode(&report, &mut |packet| count(counters, transport.send(packet)));
        self.clock.last_sent = Some(Instant::now());
        if let Some(arrival) = arrival {
            let us = u64::try_from(arrival.arrived.elapsed().as_micros()).unwrap_or(u64::MAX);
            self.counters.latency_us.store(us, Ordering::Relaxed);
            self.counters.greatest_latency_us.fetch_max(us, Ordering::Relaxed);
        }
    }

    /// Whether a report without any pose is to be sent now.
    fn is_loss_due(&self) -> bool {
        let is_announced =
            self.encoder.announces_loss() && (self.clock.had_pose || self.clock.last_sent.is_none_or(|t| t.elapsed() >= REPEAT));
        match self.on_loss {
            OnLoss::Flag => self.encoder.marks_loss(),
            OnLoss::Stop | OnLoss::Hold => is_announced,
        }
    }
}

fn count(counters: &Counters, (taken, failed): (u64, u64)) {
    counters.sent.fetch_add(taken, Ordering::Relaxed);
    counters.failed.fetch_add(failed, Ordering::Relaxed);
}

fn nanoseconds(duration: Duration) -> i64 {
    i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX)
}

fn since_start(ns: i64) -> Duration {
    Duration::from_nanos(u64::try_from(ns).unwrap_or(0))
}
