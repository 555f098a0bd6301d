//! Says what becomes of the timecode: an event for every change of its state, and for a wrong rate.

use crate::daemon::live::{Event, LiveLink};
use crate::frame::Timestamp;
use crate::timecode::{TimecodeRate, TimecodeSource, TimecodeState};

/// What was said last.
#[derive(Debug, Default)]
pub struct TimecodeWatch {
    state: Option<&'static str>,
    wrong_rate: Option<TimecodeRate>,
}

impl TimecodeWatch {
    /// Publishes what has changed by now.
    pub fn look(&mut self, source: &TimecodeSource, now: Timestamp, link: &LiveLink) {
        let seen = source.with_live(|track| (track.state(now), track.at(now), track.heard_rate(), track.configured_rate()));
        let Some((state, stamped, heard, configured)) = seen else { return };
        if self.state.replace(state.word()) != Some(state.word()) {
            let timecode = stamped.map(|stamped| stamped.code.to_string());
            let text = match (state, stamped) {
                (TimecodeState::Locked, Some(stamped)) => format!("timecode is locked: {} at {}", stamped.code, stamped.rate),
                (TimecodeState::FreeWheeling { .. }, Some(stamped)) => format!("no timecode comes; it counts on from {}", stamped.code),
                (TimecodeState::NeverFound, _) => "no timecode has come yet".to_owned(),
                _ => "timecode is lost; check the cable, the channel, and that the generator runs at its speed".to_owned(),
            };
            link.events.publish(Event::Timecode { state: state.word().into(), timecode, text });
        }
        let wrong = heard.zip(configured).filter(|(heard, configured)| heard != configured);
        if let Some((heard, configured)) = wrong.filter(|(heard, _)| self.wrong_rate != Some(*heard)) {
            let text = format!("timecode runs at {heard}, but `rate` in [timecode] is {configured}; set the generator or the config");
            link.events.publish(Event::TimecodeRate { heard: heard.word().into(), text });
        }
        self.wrong_rate = wrong.map(|(heard, _)| heard);
    }
}
