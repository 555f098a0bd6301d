//! A route is a path and a plain function that gives its reply.

use std::sync::Arc;

use super::pace::Pace;

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
}

/// What answers a path.
pub(super) type Handler = Arc<dyn Fn() -> Reply + Send + Sync>;

/// What a request for a path does.
#[derive(Clone)]
pub(super) enum Effect {
    /// It changes nothing: GET and HEAD.
    Reads,
    /// It changes something: POST, and not too often.
    Changes(Arc<Pace>),
}

/// A path with what answers it. It is called on the server's thread: it must be quick and wait for nothing.
#[derive(Clone)]
pub struct Route {
    pub(super) path: &'static str,
    pub(super) effect: Effect,
    pub(super) handler: Handler,
}

impl Route {
    /// A route that changes nothing, for one path, which begins with `/` and has no fields.
    pub fn get(path: &'static str, handler: impl Fn() -> Reply + Send + Sync + 'static) -> Self {
        Self { path, effect: Effect::Reads, handler: Arc::new(handler) }
    }

    /// A route that changes something; it is called a few times at once and then every few seconds at most.
    pub fn post(path: &'static str, handler: impl Fn() -> Reply + Send + Sync + 'static) -> Self {
        Self { path, effect: Effect::Changes(Arc::default()), handler: Arc::new(handler) }
    }
}
