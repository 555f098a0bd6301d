//! Timecode: the hours, minutes, seconds and frames that a production's clock gives to every frame
//! of every machine.
//!
//! It arrives as sound: linear timecode (LTC, SMPTE ST 12-1), 80 bits per frame. [`LtcDecoder`]
//! turns samples into [`LtcFrame`]s, each with the sample at which its frame begins.
//! [`TimecodeTrack`] collects them on the clock of the camera's stamps and answers which timecode
//! an instant has. Through a gap it counts on (jam-sync), and says so. A recording stores the
//! answers beside its rows ([`side_file`]).

mod bits;
mod code;
mod edges;
mod ltc;
mod rate;
pub mod side_file;
mod sound;
mod source;
pub mod synthetic;
mod track;
mod word;

pub use code::Timecode;
pub use ltc::{LtcDecoder, LtcFrame};
pub use rate::TimecodeRate;
pub use sound::{MAX_CHANNELS, RawFormat, Sound, SoundError};
pub use source::TimecodeSource;
pub use track::{StampedTimecode, TimecodeMark, TimecodeRun, TimecodeState, TimecodeTrack, TrackSettings};
