//! OpenTrackIO 1.0.1: pose, lens, timing and status in one datagram, as JSON or CBOR after a
//! 16-byte header.
//!
//! Fields and frames follow SMPTE's ris-osvp-metadata-camdkit; angles are intrinsic z, x, y with
//! pan positive to the left. A sample is never split: the reference receiver and Unreal disagree on
//! how parts are numbered. The `static` part comes with the first sample and every two seconds.

use serde_json::Value;
use thiserror::Error;

/// Bytes of OpenTrackIO's header before the payload.
pub const HEADER: usize = 16;
/// Maximum bytes of a datagram that crosses an Ethernet in one piece: 1500, less 20 for IPv4 and 8
/// for UDP.
pub const ONE_FRAME: usize = 1472;
/// Maximum bytes of a payload: OpenTrackIO's length field has 15 bits.
const MAX_PAYLOAD: usize = 0x7FFF;

/// Encoding of a payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// Text, supported by every receiver.
    Json,
    /// The same, in binary.
    Cbor,
}

impl Encoding {
    fn code(self) -> u8 {
        match self {
            Self::Json => 1,
            Self::Cbor => 2,
        }
    }
}

/// Why a datagram is not an OpenTrackIO sample.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum OpenTrackIoError {
    /// Too short, or wrong first bytes.
    #[error("it does not begin with OTrk; set the sender to OpenTrackIO 1.0.1")]
    Identifier,
    /// A vendor's own encoding.
    #[error("encoding {0:#04x} is neither JSON (1) nor CBOR (2)")]
    Encoding(u8),
    /// A part of a sample.
    #[error("it is one part of a longer sample; set the sender to one datagram a sample")]
    Segment,
    /// The length differs from the announced one.
    #[error("the payload has {found} bytes, the header says {announced}")]
    Length {
        /// As received.
        found: usize,
        /// As announced.
        announced: usize,
    },
    /// The checksum does not match.
    #[error("the checksum is {found:#06x}, not {wanted:#06x}; the datagram is damaged, or of version 1.0.0")]
    Checksum {
        /// As received.
        found: u16,
        /// As computed.
        wanted: u16,
    },
    /// The payload is not valid in its encoding.
    #[error("the payload cannot be read ({0})")]
    Payload(String),
}

/// Computes Fletcher's checksum with sums modulo 256, over several pieces.
fn fletcher_16(pieces: &[&[u8]]) -> u16 {
    let (mut first, mut second) = (0_u8, 0_u8);
    for byte in pieces.iter().copied().flatten() {
        first = first.wrapping_add(*byte);
        second = second.wrapping_add(first);
    }
    u16::from_be_bytes([second, first])
}

/// Returns the datagram of a payload; `None` if it is too long for a datagram.
pub fn datagram(encoding: Encoding, sequence: u16, payload: &[u8]) -> Option<Vec<u8>> {
    let length = u16::try_from(payload.len()).ok().filter(|_| payload.len() <= MAX_PAYLOAD)?;
    let mut bytes = Vec::with_capacity(HEADER + payload.len());
    bytes.extend_from_slice(b"OTrk");
    bytes.extend_from_slice(&[0, encoding.code()]);
    bytes.extend_from_slice(&sequence.to_be_bytes());
    bytes.extend_from_slice(&0_u32.to_be_bytes());
    // The upper bit marks the last part.
    bytes.extend_from_slice(&(length | 0x8000).to_be_bytes());
    let sum = fletcher_16(&[&bytes, payload]);
    bytes.extend_from_slice(&sum.to_be_bytes());
    bytes.extend_from_slice(payload);
    Some(bytes)
}

/// Decodes a datagram into its sequence number and the sample.
///
/// # Errors
/// Anything but one whole, undamaged sample in JSON or CBOR.
pub fn decode(bytes: &[u8]) -> Result<(u16, Value), OpenTrackIoError> {
    let Some((header, payload)) = bytes.split_at_checked(HEADER).filter(|(header, _)| header.starts_with(b"OTrk")) else {
        return Err(OpenTrackIoError::Identifier);
    };
    let word = |at: usize| u16::from_be_bytes([header[at], header[at + 1]]);
    let announced = usize::from(word(12) & 0x7FFF);
    if header[8..12] != [0; 4] || word(12) & 0x8000 == 0 {
        return Err(OpenTrackIoError::Segment);
    }
    if announced != payload.len() {
        return Err(OpenTrackIoError::Length { found: payload.len(), announced });
    }
    let (found, wanted) = (word(14), fletcher_16(&[&header[..14], payload]));
    if found != wanted {
        return Err(OpenTrackIoError::Checksum { found, wanted });
    }
    let sample = match header[5] {
        1 => serde_json::from_slice(payload).map_err(|e| OpenTrackIoError::Payload(e.to_string()))?,
        2 => ciborium::from_reader(payload).map_err(|e| OpenTrackIoError::Payload(e.to_string()))?,
        other => return Err(OpenTrackIoError::Encoding(other)),
    };
    Ok((word(6), sample))
}

#[cfg(test)]
#[path = "opentrackio_tests.rs"]
mod tests;
