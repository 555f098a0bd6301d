//! A route's answer.

use axum::http::{HeaderName, HeaderValue};

use super::download::Download;

/// Status, type and content.
#[derive(Debug)]
pub struct Reply {
    /// HTTP status, such as 200 or 503.
    pub status: u16,
    /// MIME type, such as "text/plain; charset=utf-8".
    pub content_type: &'static str,
    /// Content.
    pub body: Vec<u8>,
    /// Additional headers.
    pub(super) headers: Vec<(HeaderName, HeaderValue)>,
    /// Content that is generated while it is sent, instead of `body`.
    pub(super) download: Option<Download>,
}

impl Reply {
    /// Makes a reply of bytes with a MIME type.
    pub fn new(status: u16, content_type: &'static str, body: impl Into<Vec<u8>>) -> Self {
        Self { status, content_type, body: body.into(), headers: Vec::new(), download: None }
    }

    /// Makes a plain text reply.
    pub fn text(status: u16, body: impl Into<String>) -> Self {
        Self::new(status, "text/plain; charset=utf-8", body.into())
    }

    /// Makes a JSON reply.
    pub fn json(status: u16, body: impl Into<String>) -> Self {
        Self::new(status, "application/json", body.into())
    }

    /// Makes an empty reply for success.
    pub fn done() -> Self {
        Self::text(204, "")
    }

    /// Adds a header; one that is not a valid header value is left out.
    pub fn with(mut self, name: &'static str, value: &str) -> Self {
        self.headers.extend(HeaderValue::from_str(value).ok().map(|value| (HeaderName::from_static(name), value)));
        self
    }
}
