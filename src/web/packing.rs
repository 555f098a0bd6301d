//! Gzip compression of answers, for clients that accept it.

use std::io::Write as _;

use axum::http::{HeaderMap, header};
use flate2::Compression;
use flate2::write::GzEncoder;

/// Returns these bytes, compressed.
pub(super) fn packed(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    // Writing to memory does not fail.
    let whole = encoder.write_all(bytes).and_then(|()| encoder.finish());
    whole.unwrap_or_default()
}

/// Whether the client accepts gzip (RFC 9110, 12.5.3).
pub(super) fn unpacks(headers: &HeaderMap) -> bool {
    let values = headers.get_all(header::ACCEPT_ENCODING).iter().filter_map(|value| value.to_str().ok());
    values.flat_map(|value| value.split(',')).any(|one| {
        let (name, weight) = one.split_once(';').unwrap_or((one, "q=1"));
        let is_refused = weight.trim().strip_prefix("q=").and_then(|weight| weight.parse::<f32>().ok()) == Some(0.0);
        ["gzip", "x-gzip"].contains(&name.trim().to_ascii_lowercase().as_str()) && !is_refused
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_form_of_accept_encoding_is_understood() {
        let unpacks = |values: &str| unpacks(&HeaderMap::from_iter([(header::ACCEPT_ENCODING, values.parse().unwrap())]));
        for values in ["gzip", "br, GZIP", "deflate, gzip;q=0.5", "x-gzip"] {
            assert!(unpacks(values), "{values}");
        }
        for values in ["", "br", "gzip;q=0", "gzip; q=0.0", "identity, *;q=0"] {
            assert!(!unpacks(values), "{values}");
        }
    }
}
