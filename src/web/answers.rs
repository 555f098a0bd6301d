//! From a request that may be asked to its answer: routes, methods, WebSockets.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Router;
use axum::body::{Body, HttpBody};
use axum::extract::FromRequestParts;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::http::{HeaderName, HeaderValue, Method, Request as HttpRequest, Response, StatusCode, header};
use axum::response::IntoResponse;
use axum::routing::any;
use tokio::sync::watch;
use tokio::time::timeout;

use super::feed::Feed;
use super::places::Place;
use super::routes::{Effect, Reply, Route};

/// A client that takes nothing for this long is let go. Chosen: longer than a network's hiccup. Raised, dead clients hold their places for
/// longer.
pub(super) const TAKES_WITHIN: Duration = Duration::from_secs(2);
/// A client has nothing to say on the WebSocket, so that its messages may be short, bytes. A round figure. Raised, a client may take more
/// memory.
const LONGEST_MESSAGE: usize = 4 * 1024;

/// What a request knows of its connection: its place among those that last; none where it is answered in brief.
pub(super) type Caller = Option<Arc<Place>>;

/// /ws, /api/v1/pose, /api/v1/state and the given routes.
pub(super) fn router(feed: Arc<Feed>, routes: Vec<Route>, stopped: &watch::Receiver<bool>) -> Router {
    let stopped = stopped.clone();
    let (pose, state) = (feed.clone(), feed.clone());
    let own = [Route::get("/api/v1/pose", move || pose.pose()), Route::get("/api/v1/state", move || state.state())];
    let mut router = Router::new().route("/ws", any(move |request| web_socket(request, feed.clone(), stopped.clone())));
    for route in own.into_iter().chain(routes) {
        router = router.route(route.path, any(move |request| answer(request, route.clone())));
    }
    router.fallback(|| async { response(Reply::text(404, "there is nothing here; see /api/v1/pose, /api/v1/state and /ws\n")) })
}

/// Refuses another method than the route's, and content.
fn refusal(request: &HttpRequest<Body>, effect: &Effect) -> Option<Response<Body>> {
    let (is_allowed, allow, sentence) = match effect {
        Effect::Reads => (matches!(*request.method(), Method::GET | Method::HEAD), "GET, HEAD", "only GET is answered here\n"),
        Effect::Changes(_) => (*request.method() == Method::POST, "POST", "this changes something; ask with POST\n"),
    };
    if !is_allowed {
        return Some(with(response(Reply::text(405, sentence)), header::ALLOW, HeaderValue::from_static(allow)));
    }
    (!request.body().is_end_stream()).then(|| response(Reply::text(413, "a request has no content here\n")))
}

async fn answer(request: HttpRequest<Body>, route: Route) -> Result<Response<Body>, Infallible> {
    if let Some(refused) = refusal(&request, &route.effect) {
        return Ok(refused);
    }
    if let Effect::Changes(pace) = &route.effect
        && let Err(wait) = pace.take(Instant::now())
    {
        let after = wait.as_secs() + 1;
        let sentence = format!("this was asked for too often; ask again in {after} s\n");
        return Ok(with(response(Reply::text(429, sentence)), header::RETRY_AFTER, HeaderValue::from(after)));
    }
    Ok(response((route.handler)()))
}

fn with(mut response: Response<Body>, name: HeaderName, value: HeaderValue) -> Response<Body> {
    response.headers_mut().insert(name, value);
    response
}

/// The reply with what no page of another site may do with it. What was refused also ends its connection: it may hold more.
pub(super) fn response(reply: Reply) -> Response<Body> {
    let is_refused = matches!(reply.status, 400 | 403 | 405 | 413 | 421);
    let mut response = Response::new(Body::from(reply.body));
    *response.status_mut() = StatusCode::from_u16(reply.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
    let headers = response.headers_mut();
    let fixed = [
        (header::CONTENT_TYPE, reply.content_type),
        (header::CACHE_CONTROL, "no-store"),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::CONTENT_SECURITY_POLICY, "default-src 'none'; frame-ancestors 'none'"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ];
    for (name, value) in fixed {
        headers.insert(name, HeaderValue::from_static(value));
    }
    if is_refused {
        headers.insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    response
}

/// `/ws`: every record from now on.
async fn web_socket(request: HttpRequest<Body>, feed: Arc<Feed>, stopped: watch::Receiver<bool>) -> Response<Body> {
    if let Some(refused) = refusal(&request, &Effect::Reads) {
        return refused;
    }
    // The connection's place is kept for as long as the WebSocket lasts.
    let Some(place) = request.extensions().get::<Caller>().and_then(Clone::clone) else {
        return response(Reply::text(503, "too many clients are connected; close some and try again\n"));
    };
    let (mut parts, _) = request.into_parts();
    match WebSocketUpgrade::from_request_parts(&mut parts, &()).await {
        Ok(upgrade) => upgrade.max_message_size(LONGEST_MESSAGE).max_frame_size(LONGEST_MESSAGE).on_upgrade(move |socket| async move {
            stream(socket, feed, stopped).await;
            drop(place);
        }),
        Err(rejection) => rejection.into_response(),
    }
}

async fn stream(mut socket: WebSocket, feed: Arc<Feed>, mut stopped: watch::Receiver<bool>) {
    let mut lines = feed.lines();
    loop {
        tokio::select! {
            line = lines.recv() => {
                // Behind by more than the queue holds, or the end: either way it is over.
                let Ok(line) = line else { break };
                match timeout(TAKES_WITHIN, socket.send(Message::Text(line))).await {
                    Ok(Ok(())) => {}
                    _ => return,
                }
            }
            message = socket.recv() => match message {
                // Pings are answered by the library; what a client says is not needed.
                Some(Ok(Message::Close(_))) | Some(Err(_)) | None => return,
                Some(Ok(_)) => {}
            },
            () = ended(&mut stopped) => break,
        }
    }
    let _ = timeout(Duration::from_millis(100), socket.send(Message::Close(None))).await;
}

/// Waits for the end of the server.
pub(super) async fn ended(stopped: &mut watch::Receiver<bool>) {
    // An error says that the server is gone, which is the end too.
    drop(stopped.wait_for(|stop| *stop).await);
}
