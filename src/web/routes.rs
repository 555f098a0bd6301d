//! A route is a path with a plain function that makes the reply. What changes something is answered a few times at once, then at a
//! steady pace.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

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

/// Changes that may come at once: a button that is pressed again and again. Raised, a program may fill the disk faster at first.
const AT_ONCE: u32 = 4;
/// Afterwards one more each time this has passed. A saved ring is a clip of its own with a copy of the config: at this pace a
/// program gone wild fills a disk in days instead of minutes.
const ONE_EACH: Duration = Duration::from_secs(5);

/// The pace of one kind of change, whoever asks for it.
#[derive(Debug, Default)]
pub(super) struct Pace {
    /// When all changes are allowed for again.
    full_at: Mutex<Option<Instant>>,
}

impl Pace {
    /// Counts a change, or says after what time it may come.
    pub fn take(&self, now: Instant) -> Result<(), Duration> {
        let mut full_at = self.full_at.lock().unwrap_or_else(PoisonError::into_inner);
        let next = full_at.unwrap_or(now).max(now) + ONE_EACH;
        let too_early = (next - now).saturating_sub(ONE_EACH * AT_ONCE);
        if too_early > Duration::ZERO {
            return Err(too_early);
        }
        *full_at = Some(next);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_at_once_then_one_at_a_time() {
        let (pace, begun) = (Pace::default(), Instant::now());
        let at = |s: f64| pace.take(begun + Duration::from_secs_f64(s));
        assert_eq!((0..10).filter(|_| at(0.0).is_ok()).count(), 4);
        assert_eq!(at(0.0), Err(Duration::from_secs(5)));
        assert_eq!(at(4.0), Err(Duration::from_secs(1)));
        assert_eq!((at(5.0).is_ok(), at(5.1).is_ok()), (true, false));
        assert_eq!((0..100).filter(|k| at(10.0 + f64::from(*k)).is_ok()).count(), 20);
        assert_eq!((0..10).filter(|_| at(1000.0).is_ok()).count(), 4);
    }
}
