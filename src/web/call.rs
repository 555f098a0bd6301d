//! A request as a route's handler sees it: path fields, query, headers, content. A malformed
//! request yields a reply that says how to ask correctly.

use std::io::Read;

use axum::http::HeaderMap;
use serde::de::DeserializeOwned;

use super::content::{Upload, not_arrived, too_large};
use super::keys::Permission;
use super::reply::Reply;

/// Maximum length of a name of a recording, a file or a client, bytes: below file systems' limits,
/// to leave room for suffixes. Raised, file systems refuse long names.
const MAX_NAME: usize = 128;

/// A request.
#[derive(Debug)]
pub struct Call {
    pub(super) fields: Vec<(String, String)>,
    pub(super) query: String,
    pub(super) headers: HeaderMap,
    pub(super) content: Upload,
    /// Who asks, and for what.
    pub(super) permission: Permission,
}

impl Call {
    /// Returns a path field that is a name: letters, digits, dots, dashes and underscores; it
    /// cannot lead out of a folder.
    pub(super) fn name(&self, field: &str) -> Result<&str, Reply> {
        let name = self.fields.iter().find(|(name, _)| name == field).map_or("", |(_, value)| value.as_str());
        if is_name(name) {
            Ok(name)
        } else {
            Err(Reply::text(
                400,
                "a name here has letters, digits, dots, dashes and underscores, does not begin with a dot, and is at most 128 long\n",
            ))
        }
    }

    /// Returns a path field that is a number.
    pub(super) fn number(&self, field: &str) -> Result<u64, Reply> {
        self.name(field)?
            .parse()
            .map_err(|_| Reply::text(400, format!("the last part of the path is not a {field}; give a whole number\n")))
    }

    /// Returns a number from the query, within these limits.
    pub(super) fn queried(&self, name: &str, default: u64, limits: std::ops::RangeInclusive<u64>) -> Result<u64, Reply> {
        let Some(value) = self.text(name) else { return Ok(default) };
        let number = value.parse().ok().filter(|number| limits.contains(number));
        number.ok_or_else(|| Reply::text(400, format!("{name} must be a whole number from {} to {}\n", limits.start(), limits.end())))
    }

    /// Returns a text from the query.
    pub(super) fn text(&self, name: &str) -> Option<&str> {
        self.query.split('&').filter_map(|pair| pair.split_once('=')).find(|(key, _)| *key == name).map(|(_, value)| value)
    }

    /// Returns a header's text.
    pub(super) fn header(&self, name: &str) -> Option<&str> {
        self.headers.get(name)?.to_str().ok()
    }

    /// Returns the whole content, if it is at most this long.
    pub(super) fn content(&mut self, most_bytes: u64) -> Result<Vec<u8>, Reply> {
        let mut bytes = Vec::new();
        (&mut self.content).take(most_bytes + 1).read_to_end(&mut bytes).map_err(|e| not_arrived(&e))?;
        if bytes.len() as u64 > most_bytes { Err(too_large(most_bytes)) } else { Ok(bytes) }
    }

    /// Parses the content as JSON.
    pub(super) fn json<T: DeserializeOwned>(&mut self, most_bytes: u64) -> Result<T, Reply> {
        let bytes = self.content(most_bytes)?;
        serde_json::from_slice(&bytes).map_err(|e| Reply::text(400, format!("the request is not the expected JSON: {e}\n")))
    }

    /// Whether the request comes from this machine.
    pub(super) fn is_here(&self) -> bool {
        self.permission.is_here()
    }

    /// Checks whether the request may still change something: the show lock may have been set, or
    /// the browser revoked, since it was sent. Call it just before the change.
    pub(super) fn still_may(&self) -> Result<(), Reply> {
        self.permission.judge()
    }
}

/// Whether the text can name a single file or folder.
pub(super) fn is_name(name: &str) -> bool {
    let is_plain = |b: u8| b.is_ascii_alphanumeric() || b"._-".contains(&b);
    !name.is_empty() && name.len() <= MAX_NAME && !name.starts_with('.') && name.bytes().all(is_plain)
}
