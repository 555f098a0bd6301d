//! From a request that may be asked to its answer: routes, methods, WebSockets.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Instant;

use axum::Router;
use axum::body::Body;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{FromRequestParts, Path};
use axum::http::{HeaderValue, Request as HttpRequest, Response, header};
use axum::response::IntoResponse;
use axum::routing::any;
use tokio::sync::watch;
use tokio::time::timeout;

use super::assets::with_page;
use super::events::{Events, tell};
use super::feed::Feed;
use super::hub::Hub;
use super::lifetime::{TAKES_WITHIN, close, ended};
use super::places::Place;
use super::replies::{refusal, response, with};
use super::routes::{Effect, Reply, Route};
use super::scene::Scene;
use super::view::show;

/// A client has nothing to say on the WebSocket, so that its messages may be short, bytes. A round figure. Raised, a client may take more
/// memory.
const LONGEST_MESSAGE: usize = 4 * 1024;

/// What a request knows of its connection: its place among those that last; none where it is answered in brief.
pub(super) type Caller = Option<Arc<Place>>;

/// The page, /ws, /ws/events, /ws/view, /api/v1/pose, /api/v1/state, /api/v1/scene, the stage's pictures and the given routes.
pub(super) fn router(
    feed: &Arc<Feed>,
    hub: &Arc<Hub>,
    events: &Arc<Events>,
    scene: &Arc<Scene>,
    routes: Vec<Route>,
    stopped: &watch::Receiver<bool>,
) -> Router {
    let (pose, state, described) = (feed.clone(), feed.clone(), scene.clone());
    let own = [
        Route::get("/api/v1/pose", move || pose.pose()),
        Route::get("/api/v1/state", move || state.state()),
        Route::get("/api/v1/scene", move || described.reply()),
    ];
    let of_records = {
        let (feed, stopped) = (feed.clone(), stopped.clone());
        move |socket| stream(socket, feed.clone(), stopped.clone())
    };
    let of_frames = {
        let (feed, hub, stopped) = (feed.clone(), hub.clone(), stopped.clone());
        move |socket| show(socket, hub.clone(), feed.clone(), stopped.clone())
    };
    let of_events = {
        let (events, stopped) = (events.clone(), stopped.clone());
        move |socket| tell(socket, events.clone(), stopped.clone())
    };
    let mut router = Router::new()
        .route("/ws", any(move |request| web_socket(request, of_records)))
        .route("/ws/events", any(move |request| web_socket(request, of_events)))
        .route("/ws/view", any(move |request| web_socket(request, of_frames)))
        .route("/api/v1/surfaces/{number}/picture", {
            let scene = scene.clone();
            any(move |number: Path<String>, request: HttpRequest<Body>| async move {
                refusal(&request, &Effect::Reads).unwrap_or_else(|| response(scene.picture(&number)))
            })
        });
    for route in own.into_iter().chain(routes) {
        router = router.route(route.path, any(move |request| answer(request, route.clone())));
    }
    with_page(router).fallback(|| async { response(Reply::text(404, "there is nothing here; the page is at /\n")) })
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

/// A connection that becomes a WebSocket, and is then served by `serve`.
async fn web_socket<F>(request: HttpRequest<Body>, serve: impl FnOnce(WebSocket) -> F + Send + 'static) -> Response<Body>
where
    F: Future<Output = ()> + Send,
{
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
            serve(socket).await;
            drop(place);
        }),
        Err(rejection) => rejection.into_response(),
    }
}

/// `/ws`: every record from now on.
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
    close(socket).await;
}
