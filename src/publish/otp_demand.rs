//! What OTP's consumers have asked for: which modules are due, and which questions await an answer.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::time::Duration;

use rand::Rng;
use rand_pcg::Pcg64;

use crate::frame::Timestamp;
use crate::protocols::otp::{OtpMessage, OtpModule};

/// How long a module is sent after it was last asked for (table A-2 of the standard).
const ASKED_FOR: Duration = Duration::from_secs(30);
/// Maximum random wait before an answer, so that not all producers answer at once (table A-2).
const BACKOFF: Duration = Duration::from_secs(5);
/// Maximum number of questions that await an answer. Chosen: far more consumers than a stage has.
/// Raised, a flood of forged questions makes more packets.
const MAX_WAITING: usize = 64;

/// A question.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Question {
    Names,
    Systems,
}

/// What is asked for.
#[derive(Debug, Default)]
pub(super) struct Demand {
    /// When each of the standard's modules was last asked for.
    modules: BTreeMap<OtpModule, Timestamp>,
    waiting: Vec<(Timestamp, SocketAddr, Question)>,
}

impl Demand {
    /// Takes an advertisement that came from an address.
    pub fn hear(&mut self, now: Timestamp, from: SocketAddr, message: &OtpMessage, random: &mut Pcg64) {
        let question = match message {
            OtpMessage::Modules(asked) => {
                // A velocity is worth nothing without what it is the velocity of (table 16-1).
                let with = |module: OtpModule| match module {
                    OtpModule::VELOCITY => vec![module, OtpModule::POSITION],
                    OtpModule::ROTATION_VELOCITY => vec![module, OtpModule::ROTATION],
                    _ => vec![module],
                };
                let known = asked.iter().filter(|module| OtpModule::STANDARD.contains(module));
                self.modules.extend(known.flat_map(|module| with(*module)).map(|module| (module, now)));
                return;
            }
            OtpMessage::Names { is_answer: false, .. } => Question::Names,
            OtpMessage::Systems { is_answer: false, .. } => Question::Systems,
            _ => return,
        };
        let is_new = !self.waiting.iter().any(|(_, to, waiting)| (*to, *waiting) == (from, question));
        if is_new && self.waiting.len() < MAX_WAITING {
            let wait_ms = random.random_range(0..=BACKOFF.as_millis() as u64);
            self.waiting.push((now.after(Duration::from_millis(wait_ms)), from, question));
        }
    }

    /// Whether a module is asked for.
    pub fn has(&self, module: OtpModule, now: Timestamp) -> bool {
        self.modules.get(&module).is_some_and(|asked| now.duration_since(*asked) <= ASKED_FOR)
    }

    /// Takes the questions whose answer is due.
    pub fn due(&mut self, now: Timestamp) -> Vec<(SocketAddr, Question)> {
        let due = self.waiting.extract_if(.., |(at, ..)| *at <= now);
        due.map(|(_, to, question)| (to, question)).collect()
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    const CONSOLE: &str = "192.0.2.7:5568";

    fn at(s: f64) -> Timestamp {
        Timestamp::from_seconds(s)
    }

    fn heard(demand: &mut Demand, s: f64, message: &OtpMessage) {
        demand.hear(at(s), CONSOLE.parse().unwrap(), message, &mut Pcg64::seed_from_u64(1));
    }

    #[test]
    fn a_module_is_sent_for_half_a_minute_after_it_was_asked_for() {
        let mut demand = Demand::default();
        heard(&mut demand, 10.0, &OtpMessage::Modules(vec![OtpModule::VELOCITY, OtpModule(0x1234, 1)]));
        let has = |demand: &Demand, module, s| demand.has(module, at(s));
        assert!(has(&demand, OtpModule::VELOCITY, 10.0) && has(&demand, OtpModule::POSITION, 40.0), "a velocity comes with its position");
        assert!(!has(&demand, OtpModule::ROTATION, 10.0) && !has(&demand, OtpModule(0x1234, 1), 10.0));
        assert!(!has(&demand, OtpModule::VELOCITY, 40.1));
        heard(&mut demand, 50.0, &OtpMessage::Modules(vec![OtpModule::VELOCITY]));
        assert!(has(&demand, OtpModule::VELOCITY, 80.0));
    }

    #[test]
    fn questions_are_answered_once_within_five_seconds() {
        let mut demand = Demand::default();
        let (names, systems) =
            (OtpMessage::Names { is_answer: false, names: Vec::new() }, OtpMessage::Systems { is_answer: false, systems: Vec::new() });
        for message in [&names, &names, &systems] {
            heard(&mut demand, 1.0, message);
        }
        // Another producer's answer is no question.
        heard(&mut demand, 1.0, &OtpMessage::Systems { is_answer: true, systems: vec![1] });
        let to = CONSOLE.parse().unwrap();
        assert_eq!(demand.due(at(6.0)), [(to, Question::Names), (to, Question::Systems)]);
        assert_eq!(demand.due(at(6.0)), []);
    }

    #[test]
    fn a_flood_of_questions_is_bounded() {
        let mut demand = Demand::default();
        let (systems, mut random) = (OtpMessage::Systems { is_answer: false, systems: Vec::new() }, Pcg64::seed_from_u64(1));
        for port in 1..2000 {
            demand.hear(at(0.0), SocketAddr::from(([192, 0, 2, 7], port)), &systems, &mut random);
        }
        assert_eq!(demand.due(at(5.0)).len(), MAX_WAITING);
    }
}
