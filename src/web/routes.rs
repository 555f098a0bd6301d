//! A route is a method and a path with a handler that makes the reply. Changes are rate-limited: a
//! few at once, then at a steady pace. The router is built from one list of routes, which
//! `GET /api/v1/routes` shows, so that the rules can be tested on each.

use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use axum::body::Body;
use axum::http::{Method, Request, Response};
use serde_json::json;

use super::call::Call;
pub use super::keys::Access;
use super::lanes::Lane;
use super::reply::Reply;

/// A quick handler, which needs nothing of the request.
type Quick = Arc<dyn Fn() -> Reply + Send + Sync>;
/// A handler that may take its time: it may read, write and compute, and runs on a thread with
/// lower priority than the tracker's.
pub(super) type Slow = Arc<dyn Fn(&mut Call) -> Result<Reply, Reply> + Send + Sync>;

/// A handler that gets the whole request and makes the whole response: a WebSocket, or a file of
/// the page.
type Whole = Arc<dyn Fn(Request<Body>) -> Pin<Box<dyn Future<Output = Response<Body>> + Send>> + Send + Sync>;

/// What answers a path.
#[derive(Clone)]
pub(super) enum Handler {
    Quick(Quick),
    Slow(Slow),
    Whole(Whole),
}

/// A method and a path with their handler.
#[derive(Clone)]
pub struct Route {
    pub(super) method: Method,
    pub(super) path: &'static str,
    pub(super) access: Access,
    /// The lane in which its requests wait.
    pub(super) lane: Lane,
    /// Maximum bytes of content, which arrive before the handler starts; `None` if the handler
    /// reads them as they arrive.
    pub(super) content: Option<u64>,
    /// Its rate limit, if any.
    pub(super) pace: Option<Arc<Pace>>,
    /// A query with which it changes nothing and has no rate limit.
    pub(super) free_query: Option<&'static str>,
    pub(super) handler: Handler,
}

impl Route {
    /// Returns a route that changes nothing. Its path starts with `/` and has no fields. The
    /// handler runs on the server's thread: it must be quick and must not wait.
    pub fn get(path: &'static str, handler: impl Fn() -> Reply + Send + Sync + 'static) -> Self {
        Self::new(Method::GET, path, Access::Anyone, Handler::Quick(Arc::new(handler)))
    }

    /// Returns a route that changes something, a few times at once and then at most every few
    /// seconds. As for [`get`](Self::get), the handler must be quick.
    pub fn post(path: &'static str, handler: impl Fn() -> Reply + Send + Sync + 'static) -> Self {
        Self::new(Method::POST, path, Access::Change, Handler::Quick(Arc::new(handler))).seldom()
    }

    /// Returns a route that may take its time, with fields such as `{id}` in its path.
    pub(super) fn slow(
        method: Method,
        path: &'static str,
        access: Access,
        handler: impl Fn(&mut Call) -> Result<Reply, Reply> + Send + Sync + 'static,
    ) -> Self {
        Self::new(method, path, access, Handler::Slow(Arc::new(handler)))
    }

    /// Returns a route that changes nothing and gets the whole request.
    pub(super) fn whole<F>(path: &'static str, answer: impl Fn(Request<Body>) -> F + Send + Sync + 'static) -> Self
    where
        F: Future<Output = Response<Body>> + Send + 'static,
    {
        Self::new(Method::GET, path, Access::Anyone, Handler::Whole(Arc::new(move |request| Box::pin(answer(request)))))
    }

    /// Returns a route without content and without a rate limit.
    fn new(method: Method, path: &'static str, access: Access, handler: Handler) -> Self {
        let lane = if method == Method::GET { Lane::Look } else { Lane::Change };
        Self { method, path, access, lane, content: Some(0), pace: None, free_query: None, handler }
    }

    /// Makes it a quick status query that waits for no other request.
    pub(super) fn probe(self) -> Self {
        Self { lane: Lane::Probe, ..self }
    }

    /// Allows content of at most this many bytes. It is kept in memory until it is the handler's
    /// turn.
    pub(super) fn takes(self, most_bytes: u64) -> Self {
        Self { content: Some(most_bytes), ..self }
    }

    /// Allows a large file as content, which the handler reads as it arrives.
    pub(super) fn takes_a_file(self) -> Self {
        Self { lane: Lane::File, content: None, ..self }
    }

    /// Limits the rate as for [`post`](Self::post).
    pub(super) fn seldom(self) -> Self {
        self.paced(AT_ONCE, ONE_EACH)
    }

    /// Limits the rate: this many at once, then one per interval.
    pub(super) fn paced(self, at_once: u32, one_each: Duration) -> Self {
        Self { pace: Some(Arc::new(Pace::new(at_once, one_each))), ..self }
    }

    /// Limits the rate except with this query.
    pub(super) fn seldom_unless(self, query: &'static str) -> Self {
        Self { free_query: Some(query), ..self.seldom() }
    }
}

/// Returns these routes and one more that lists them all.
pub(super) fn listed(mut routes: Vec<Route>) -> Vec<Route> {
    let path = "/api/v1/routes";
    let entry = |method: &Method, path: &str, access: Access| json!({"method": method.as_str(), "path": path, "access": access.word()});
    let mut list: Vec<_> = routes.iter().map(|route| entry(&route.method, route.path, route.access)).collect();
    list.push(entry(&Method::GET, path, Access::Anyone));
    let list = json!({"routes": list}).to_string();
    routes.push(Route::get(path, move || Reply::json(200, list.clone())));
    routes
}

/// Number of changes that may come at once: a button that is pressed repeatedly. Raised, a program
/// may fill the disk faster at first.
const AT_ONCE: u32 = 4;
/// Minimum interval of changes after that. A saved ring is a separate clip with a copy of the
/// config: at this pace a runaway program fills a disk in days, not minutes. Raised, honest changes
/// are refused more often.
const ONE_EACH: Duration = Duration::from_secs(5);

/// The rate limit of one kind of change, for all clients together.
#[derive(Debug)]
pub(super) struct Pace {
    at_once: u32,
    one_each: Duration,
    /// When the full number of changes is allowed again.
    full_at: Mutex<Option<Instant>>,
}

impl Pace {
    fn new(at_once: u32, one_each: Duration) -> Self {
        Self { at_once, one_each, full_at: Mutex::default() }
    }

    /// Counts a change, or refuses it.
    pub fn allow(&self) -> Result<(), Reply> {
        self.take(Instant::now()).map_err(|wait| {
            let after = wait.as_secs() + 1;
            let sentence = format!("too many requests; ask again in {after} s\n");
            Reply::text(429, sentence).with("retry-after", &after.to_string())
        })
    }

    /// Counts a change, or returns how long to wait for it.
    pub fn take(&self, now: Instant) -> Result<(), Duration> {
        let mut full_at = self.full_at.lock().unwrap_or_else(PoisonError::into_inner);
        let next = full_at.unwrap_or(now).max(now) + self.one_each;
        let too_early = (next - now).saturating_sub(self.one_each * self.at_once);
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
    fn a_burst_is_allowed_then_one_request_at_a_time() {
        let (pace, begun) = (Pace::new(AT_ONCE, ONE_EACH), Instant::now());
        let at = |s: f64| pace.take(begun + Duration::from_secs_f64(s));
        assert_eq!((0..10).filter(|_| at(0.0).is_ok()).count(), 4);
        assert_eq!(at(0.0), Err(Duration::from_secs(5)));
        assert_eq!(at(4.0), Err(Duration::from_secs(1)));
        assert_eq!((at(5.0).is_ok(), at(5.1).is_ok()), (true, false));
        assert_eq!((0..100).filter(|k| at(10.0 + f64::from(*k)).is_ok()).count(), 20);
        assert_eq!((0..10).filter(|_| at(1000.0).is_ok()).count(), 4);
    }
}
