//! What a route answers.

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
    /// Further headers.
    pub(super) headers: Vec<(HeaderName, HeaderValue)>,
    /// Content that is made while it is sent, instead of `body`.
    pub(super) download: Option<Download>,
}

impl Reply {
    /// Bytes of a MIME type.
    pub fn new(status: u16, content_type: &'static str, body: impl Into<Vec<u8>>) -> Self {
        Self { status, content_type, body: body.into(), headers: Vec::new(), download: None }
    }

    /// Plain text.
    pub fn text(status: u16, body: impl Into<String>) -> Self {
        Self::new(status, "text/plain; charset=utf-8", body.into())
    }

    /// JSON.
    pub fn json(status: u16, body: impl Into<String>) -> Self {
        Self::new(status, "application/json", body.into())
    }

    /// Nothing but that it was done.
    pub fn done() -> Self {
        Self::text(204, "")
    }

    /// With one more header; one that no header can hold is left out.
    pub fn with(mut self, name: &'static str, value: &str) -> Self {
        self.headers.extend(HeaderValue::from_str(value).ok().map(|value| (HeaderName::from_static(name), value)));
        self
    }
}
