//! A route is a plain function from a request to a reply.

use std::sync::Arc;

/// What a route hears of a request; its method is GET.
#[derive(Debug, Clone, Copy)]
pub struct Request<'a> {
    /// Path, such as "/healthz".
    pub path: &'a str,
    /// What follows the question mark.
    pub query: Option<&'a str>,
}

/// What a route answers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reply {
    /// HTTP status, such as 200 or 503.
    pub status: u16,
    /// MIME type, such as "text/plain; charset=utf-8".
    pub content_type: &'static str,
    /// Content.
    pub body: Vec<u8>,
}

impl Reply {
    /// Plain text.
    pub fn text(status: u16, body: impl Into<String>) -> Self {
        Self { status, content_type: "text/plain; charset=utf-8", body: body.into().into_bytes() }
    }

    /// JSON.
    pub fn json(status: u16, body: impl Into<String>) -> Self {
        Self { status, content_type: "application/json", body: body.into().into_bytes() }
    }

    /// A page.
    pub fn html(body: impl Into<String>) -> Self {
        Self { status: 200, content_type: "text/html; charset=utf-8", body: body.into().into_bytes() }
    }
}

/// What answers a path.
pub(super) type Handler = Arc<dyn Fn(&Request<'_>) -> Reply + Send + Sync>;

/// A path with what answers it. It is called on the server's thread: it must be quick and wait for nothing.
#[derive(Clone)]
pub struct Route {
    pub(super) path: &'static str,
    pub(super) handler: Handler,
}

impl Route {
    /// A route for one path, which begins with `/` and has no fields.
    pub fn new(path: &'static str, handler: impl Fn(&Request<'_>) -> Reply + Send + Sync + 'static) -> Self {
        Self { path, handler: Arc::new(handler) }
    }
}
