//! What is heard of another tracker on a port: packets of the source that is followed become poses;
//! everything else becomes a sentence that says what to set.

use crate::delay::log::LoggedPose;
use crate::frame::Timestamp;
use crate::protocols::camera_packet::{CameraSource, Ring, Spoken};

/// Time without a packet after which the other tracker is stale, seconds. Chosen: a dozen packets
/// at 25 per second. Raised, a pulled cable is reported later.
const STALE_AFTER_S: f64 = 0.5;
/// Time without a packet after which it is lost, seconds. Chosen: longer than a switch takes to
/// start. Raised, a tracker that was switched off counts as stale for longer.
const LOST_AFTER_S: f64 = 5.0;
/// Maximum number of foreign sources that are remembered: what a message can list. Raised, only
/// longer messages.
const MAX_FOREIGN: usize = 4;
/// Weight of the newest interval in the packet rate. Chosen: a second at 25 per second. Raised, the
/// rate fluctuates; lowered, it follows slowly.
const RATE_WEIGHT: f64 = 0.04;

/// What is known of the other tracker at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum HeardState {
    /// No packet has come yet.
    NeverHeard,
    /// Packets come, and none can be read.
    Unreadable,
    /// Packets come, and none is of the configured source.
    OtherSource,
    /// Poses come.
    Heard,
    /// Packets come without a pose.
    NoPose,
    /// Packets came until this many seconds ago.
    Stale(f64),
    /// The same, for long.
    Lost(f64),
}

impl HeardState {
    /// All states by their words.
    pub const WORDS: [&'static str; 7] = ["never heard", "unreadable", "other source", "heard", "no pose", "stale", "lost"];

    /// Returns its word.
    pub fn word(self) -> &'static str {
        let place = match self {
            Self::NeverHeard => 0,
            Self::Unreadable => 1,
            Self::OtherSource => 2,
            Self::Heard => 3,
            Self::NoPose => 4,
            Self::Stale(_) => 5,
            Self::Lost(_) => 6,
        };
        Self::WORDS[place]
    }
}

/// What has been heard so far.
#[derive(Debug)]
pub struct Heard {
    spoken: Spoken,
    /// Raw zoom at the wide and at the long end.
    zoom_range: Option<[f64; 2]>,
    followed: Option<CameraSource>,
    /// Other sources, the first ones.
    foreign: Vec<CameraSource>,
    /// Why the last packet could not be read.
    unreadable: Option<String>,
    packet_at: Option<Timestamp>,
    has_pose: bool,
    /// Mean interval between packets, seconds.
    interval_s: Option<f64>,
    zoom: Option<Ring>,
    focus: Option<Ring>,
}

impl Heard {
    /// Starts before the first packet.
    pub fn new(spoken: Spoken, zoom_range: Option<[f64; 2]>) -> Self {
        Self {
            spoken,
            zoom_range,
            followed: None,
            foreign: Vec::new(),
            unreadable: None,
            packet_at: None,
            has_pose: false,
            interval_s: None,
            zoom: None,
            focus: None,
        }
    }

    /// Takes a packet that arrived at a time; returns the pose of the source that is followed.
    pub fn packet(&mut self, bytes: &[u8], at: Timestamp) -> Option<LoggedPose> {
        let packet = match self.spoken.decode(bytes) {
            Ok(packet) => packet,
            Err(reason) => {
                let other = self.spoken.mistaken_for(bytes);
                self.unreadable =
                    Some(other.map_or(reason, |word| {
                        format!("they are {word}; set protocol = \"{word}\", or the sender to {}", self.spoken.word())
                    }));
                return None;
            }
        };
        let is_followed =
            self.spoken.selects(&packet.source).unwrap_or_else(|| self.followed.as_ref().is_none_or(|own| *own == packet.source));
        if !is_followed {
            if self.foreign.len() < MAX_FOREIGN && !self.foreign.contains(&packet.source) {
                self.foreign.push(packet.source);
            }
            return None;
        }
        self.followed.get_or_insert(packet.source);
        let step_s =
            self.packet_at.replace(at).map(|before| at.seconds_since(before)).filter(|step_s| (0.0..STALE_AFTER_S).contains(step_s));
        self.interval_s = step_s.map(|step_s| self.interval_s.map_or(step_s, |mean| mean + RATE_WEIGHT * (step_s - mean)));
        self.has_pose = packet.pose.is_some();
        (self.zoom, self.focus) = (packet.zoom, packet.focus);
        self.unreadable = None;
        packet.pose.map(|pose| LoggedPose { at, rotation: pose.rotation, position: pose.translation })
    }

    /// Returns the state at a time.
    pub fn state(&self, now: Timestamp) -> HeardState {
        let Some(at) = self.packet_at else {
            return match (&self.unreadable, self.foreign.is_empty()) {
                (_, false) => HeardState::OtherSource,
                (Some(_), true) => HeardState::Unreadable,
                (None, true) => HeardState::NeverHeard,
            };
        };
        match now.seconds_since(at) {
            age_s if age_s > LOST_AFTER_S => HeardState::Lost(age_s),
            age_s if age_s > STALE_AFTER_S => HeardState::Stale(age_s),
            _ if self.has_pose => HeardState::Heard,
            _ => HeardState::NoPose,
        }
    }

    /// Returns the source that is followed.
    pub fn source(&self) -> Option<&CameraSource> {
        self.followed.as_ref()
    }

    /// Returns the packets per second.
    pub fn rate_hz(&self) -> Option<f64> {
        self.interval_s.filter(|s| *s > 0.0).map(|s| 1.0 / s)
    }

    /// Returns the zoom, from 0 at the wide end to 1 at the long end; `None` without it, or without
    /// the range of its raw values.
    pub fn zoom(&self) -> Option<f64> {
        match (self.zoom?, self.zoom_range) {
            (Ring::Normalised(share), _) => Some(share),
            (Ring::Raw(raw), Some([wide, long])) => Some((raw - wide) / (long - wide)),
            (Ring::Raw(_), None) => None,
        }
    }

    /// Returns zoom and focus as the last packet had them.
    pub fn rings(&self) -> [Option<Ring>; 2] {
        [self.zoom, self.focus]
    }

    /// Returns zoom and focus in the sender's raw counts.
    pub fn raw(&self) -> [Option<f64>; 2] {
        [self.zoom, self.focus].map(|ring| match ring {
            Some(Ring::Raw(raw)) => Some(raw),
            _ => None,
        })
    }

    /// Says what is wrong, and what to set; `None` while poses come.
    pub fn complaint(&self, now: Timestamp) -> Option<[String; 2]> {
        let key = self.spoken.key();
        let foreign = || self.foreign.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
        let both = |said: String, hint: &str| Some([said, hint.to_owned()]);
        let cable = "check its cable and power, and that it sends to this machine's address and to the port of `listen`";
        match self.state(now) {
            HeardState::NeverHeard => both("no packet has come yet".to_owned(), cable),
            HeardState::Unreadable => both(
                "packets come that cannot be read".to_owned(),
                self.unreadable.as_deref().unwrap_or("check `protocol` in [other_tracker]"),
            ),
            HeardState::OtherSource => both(
                format!("packets come from {} only", foreign()),
                &format!("set {key} in [other_tracker] to the sender's, or remove it"),
            ),
            HeardState::NoPose => both("its packets have no pose".to_owned(), "check the other tracker: it says itself that it is lost"),
            HeardState::Stale(age_s) => both(format!("no packet for {age_s:.1} s"), cable),
            HeardState::Lost(age_s) => {
                let unreadable = self.unreadable.as_ref().map(|reason| format!("; other packets cannot be read: {reason}"));
                let others = (!self.foreign.is_empty()).then(|| format!("; {} was heard too", foreign()));
                both(format!("no packet for {age_s:.0} s{}", unreadable.or(others).unwrap_or_default()), cable)
            }
            HeardState::Heard => self.complaint_of_a_heard_one(),
        }
    }

    fn complaint_of_a_heard_one(&self) -> Option<[String; 2]> {
        if let (Some(Ring::Raw(raw)), Some([wide, long]), Some(zoom)) = (self.zoom, self.zoom_range, self.zoom())
            && !(0.0..=1.0).contains(&zoom)
        {
            return Some([
                format!("its zoom is {raw}, outside `zoom_range` = [{wide}, {long}]"),
                "zoom to both ends, and write the raw values there".to_owned(),
            ]);
        }
        let followed = self.followed.as_ref().filter(|_| !self.foreign.is_empty() && self.spoken.selects_none())?;
        let others = self.foreign.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
        Some([
            format!("{followed} is followed, because it came first; {others} comes too"),
            format!("set {} in [other_tracker]", self.spoken.key()),
        ])
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::protocols::freed::FreedPacket;
    use crate::protocols::opentrackio;

    fn at(seconds: f64) -> Timestamp {
        Timestamp::from_seconds(100.0 + seconds)
    }

    fn freed(camera_id: u8, zoom: u32) -> [u8; 29] {
        FreedPacket { camera_id, zoom, position_mm: [1000.0, 0.0, 0.0], ..FreedPacket::default() }.encode().0
    }

    fn sample(text: &str) -> Vec<u8> {
        opentrackio::datagram(opentrackio::Encoding::Json, 1, text.as_bytes()).unwrap()
    }

    #[test]
    fn it_is_never_heard_heard_stale_lost_and_heard_again() {
        let mut heard = Heard::new(Spoken::Freed(None), None);
        assert_eq!(heard.state(at(0.0)), HeardState::NeverHeard);
        assert!(heard.complaint(at(0.0)).unwrap()[1].contains("`listen`"));
        for k in 0..100 {
            let row = heard.packet(&freed(1, 0), at(0.02 * f64::from(k))).unwrap();
            assert!((row.position.x - 1.0).abs() < 1e-9 && row.at == at(0.02 * f64::from(k)));
        }
        assert!(heard.state(at(2.0)) == HeardState::Heard && heard.complaint(at(2.0)).is_none());
        assert!((heard.rate_hz().unwrap() - 50.0).abs() < 0.1, "{:?}", heard.rate_hz());
        assert_eq!(heard.state(at(3.0)).word(), "stale");
        assert_eq!(heard.state(at(30.0)).word(), "lost");
        assert!(heard.packet(&freed(1, 0), at(31.0)).is_some());
        assert_eq!(heard.state(at(31.1)), HeardState::Heard);
    }

    #[test]
    fn another_camera_is_named_with_the_key_to_set() {
        let mut heard = Heard::new(Spoken::Freed(Some(2)), None);
        assert_eq!((heard.packet(&freed(1, 0), at(0.0)), heard.packet(&freed(7, 0), at(0.1))), (None, None));
        let [said, hint] = heard.complaint(at(0.2)).unwrap();
        assert!(said.contains("FreeD camera 1, FreeD camera 7 only") && hint.contains("camera_id"), "{said}; {hint}");
        assert!(heard.packet(&freed(2, 0), at(0.3)).is_some() && heard.complaint(at(0.4)).is_none());
        // Without a configured one, the first is followed, and the others are named.
        let mut heard = Heard::new(Spoken::Freed(None), None);
        assert!(heard.packet(&freed(1, 0), at(0.0)).is_some() && heard.packet(&freed(7, 0), at(0.1)).is_none());
        let [said, _] = heard.complaint(at(0.2)).unwrap();
        assert!(said.contains("FreeD camera 1 is followed") && said.contains("camera 7 comes too"), "{said}");
    }

    #[test]
    fn the_wrong_protocol_is_named() {
        let mut heard = Heard::new(Spoken::Freed(None), None);
        heard.packet(&sample(r#"{"sourceId":"a"}"#), at(0.0));
        let [said, hint] = heard.complaint(at(0.1)).unwrap();
        assert!(said.contains("cannot be read") && hint.contains("protocol = \"opentrackio\""), "{said}; {hint}");
        let mut heard = Heard::new(Spoken::OpenTrackIo(None), None);
        heard.packet(&freed(1, 0), at(0.0));
        assert!(heard.complaint(at(0.1)).unwrap()[1].contains("protocol = \"freed\""));
        heard.packet(b"hello", at(0.2));
        assert!(heard.complaint(at(0.3)).unwrap()[1].contains("does not begin with OTrk"));
    }

    #[test]
    fn a_sample_without_a_pose_is_no_pose() {
        let mut heard = Heard::new(Spoken::OpenTrackIo(Some("a".to_owned())), None);
        assert_eq!(heard.packet(&sample(r#"{"sourceId":"a","lens":{"encoders":{"zoom":0.5}}}"#), at(0.0)), None);
        assert_eq!((heard.state(at(0.1)), heard.zoom()), (HeardState::NoPose, Some(0.5)));
    }

    #[test]
    fn raw_zoom_is_scaled_and_a_wrong_range_is_named() {
        let mut heard = Heard::new(Spoken::Freed(None), Some([0.0, 4095.0]));
        heard.packet(&freed(1, 1365), at(0.0));
        assert!((heard.zoom().unwrap() - 1.0 / 3.0).abs() < 1e-9 && heard.raw()[0] == Some(1365.0) && heard.complaint(at(0.1)).is_none());
        heard.packet(&freed(1, 65_000), at(0.1));
        assert!(heard.complaint(at(0.2)).unwrap()[0].contains("65000, outside `zoom_range` = [0, 4095]"));
        // Counts may fall towards the long end.
        let mut heard = Heard::new(Spoken::Freed(None), Some([4000.0, 0.0]));
        heard.packet(&freed(1, 1000), at(0.0));
        assert_eq!(heard.zoom(), Some(0.75));
        let mut heard = Heard::new(Spoken::Freed(None), None);
        heard.packet(&freed(1, 1000), at(0.0));
        assert_eq!((heard.zoom(), heard.raw()), (None, [Some(1000.0), Some(0.0)]));
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_pose_or_a_sentence(bytes in proptest::collection::vec(any::<u8>(), 0..100), is_freed in any::<bool>()) {
            let spoken = if is_freed { Spoken::Freed(None) } else { Spoken::OpenTrackIo(None) };
            let mut heard = Heard::new(spoken, None);
            let row = heard.packet(&bytes, at(0.0));
            prop_assert!(row.is_some() || heard.complaint(at(0.0)).is_some());
        }
    }
}
