//! Answers a request that has passed the guard: routes, methods, WebSockets.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::net::{IpAddr, Ipv4Addr};
use std::path::PathBuf;
use std::sync::Arc;

use axum::Router;
use axum::body::Body;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{FromRequestParts, RawPathParams};
use axum::http::{Method, Request as HttpRequest, Response};
use axum::response::IntoResponse as _;
use axum::routing::any;
use tokio::sync::watch;
use tokio::time::timeout;

use super::assets;
use super::call::Call;
use super::connection::Connection;
use super::content::{Upload, gathered, pump};
use super::download::Transfers;
use super::events::{Events, tell};
use super::feed::Feed;
use super::hub::Hub;
use super::keys::{Keys, Permission};
use super::lanes::Lanes;
use super::lifetime::{TAKES_WITHIN, close, ended};
use super::places::Place;
use super::replies::{refused_content, response};
use super::reply::Reply;
use super::routes::{Handler, Route, listed};
use super::view::show;

/// Maximum size of a client's WebSocket message, bytes; clients only send single letters. A round
/// figure. Raised, a client may take more memory.
const MAX_MESSAGE: usize = 4 * 1024;

/// The peer of a request without a connection.
const NOBODY: IpAddr = IpAddr::V4(Ipv4Addr::UNSPECIFIED);

/// What a request knows about its connection.
#[derive(Debug, Clone)]
pub(super) struct Caller {
    /// Its place among the lasting connections; `None` if it is answered briefly.
    pub place: Option<Arc<Place>>,
    /// Address of the client.
    pub peer: IpAddr,
    /// Its connection; `None` in a test.
    pub connection: Option<Connection>,
    /// The transfers on it, which may take long.
    pub transfers: Transfers,
}

/// What all routes need to answer.
struct Desk {
    keys: Arc<Keys>,
    lanes: Lanes,
}

/// Sources of the streams.
pub(super) struct Streams {
    pub feed: Arc<Feed>,
    pub hub: Arc<Hub>,
    pub events: Arc<Events>,
    pub stopped: watch::Receiver<bool>,
}

impl Streams {
    /// Returns the routes /ws, /ws/events, /ws/view, /api/v1/pose and /api/v1/state.
    fn routes(self) -> Vec<Route> {
        let Self { feed, hub, events, stopped } = self;
        let (pose, state) = (feed.clone(), feed.clone());
        let of_records = {
            let (feed, stopped) = (feed.clone(), stopped.clone());
            move |socket| stream(socket, feed.clone(), stopped.clone())
        };
        let of_frames = {
            let stopped = stopped.clone();
            move |socket| show(socket, hub.clone(), feed.clone(), stopped.clone())
        };
        let of_events = move |socket| tell(socket, events.clone(), stopped.clone());
        vec![
            Route::whole("/ws", move |request| web_socket(request, of_records.clone())),
            Route::whole("/ws/events", move |request| web_socket(request, of_events.clone())),
            Route::whole("/ws/view", move |request| web_socket(request, of_frames.clone())),
            Route::get("/api/v1/pose", move || pose.pose()),
            Route::get("/api/v1/state", move || state.state()),
        ]
    }
}

/// Builds the router: the streams, the given routes, a list of all of them, and the page, from a
/// folder if one is given.
pub(super) fn router(streams: Streams, routes: Vec<Route>, keys: Arc<Keys>, page_dir: Option<PathBuf>) -> Router {
    let of_page = if page_dir.is_some() { Vec::new() } else { assets::routes() };
    let mut by_path: BTreeMap<&'static str, Vec<Route>> = BTreeMap::new();
    for route in listed([streams.routes(), routes, of_page].concat()) {
        by_path.entry(route.path).or_default().push(route);
    }
    let desk = Arc::new(Desk { keys, lanes: Lanes::new() });
    let mut router = Router::new();
    for (path, of_path) in by_path {
        let (of_path, desk): (Arc<[Route]>, _) = (of_path.into(), desk.clone());
        router = router.route(path, any(move |request| answer(request, of_path.clone(), desk.clone())));
    }
    match page_dir {
        None => router.fallback(|| async { assets::nothing_here() }),
        Some(folder) => router.fallback(move |request: HttpRequest<Body>| assets::from_folder(request, folder.clone())),
    }
}

async fn answer(request: HttpRequest<Body>, of_path: Arc<[Route]>, desk: Arc<Desk>) -> Result<Response<Body>, Infallible> {
    let method = if *request.method() == Method::HEAD { Method::GET } else { request.method().clone() };
    let Some(route) = of_path.iter().find(|route| route.method == method) else { return Ok(wrong_method(&of_path)) };
    let caller = request.extensions().get::<Caller>().cloned();
    let peer = caller.as_ref().map_or(NOBODY, |caller| caller.peer);
    if let Err(refused) = desk.keys.judge(route.access, &method, request.headers(), peer) {
        return Ok(response(refused));
    }
    if let Handler::Quick(_) | Handler::Whole(_) = &route.handler
        && let Some(refused) = refused_content(&request)
    {
        return Ok(refused);
    }
    if let Some(pace) = &route.pace
        && (route.free_query.is_none() || route.free_query != request.uri().query())
        && let Err(refused) = pace.allow()
    {
        return Ok(response(refused));
    }
    match &route.handler {
        Handler::Quick(handler) => Ok(response(handler())),
        Handler::Whole(handler) => Ok(handler(request).await),
        Handler::Slow(_) => Ok(answer_slowly(request, route, caller, &desk).await.unwrap_or_else(response)),
    }
}

/// Answers on another thread when it is the request's turn. Its content has arrived by then, except
/// a large file, which is read in pieces.
async fn answer_slowly(request: HttpRequest<Body>, route: &Route, caller: Option<Caller>, desk: &Desk) -> Result<Response<Body>, Reply> {
    let peer = caller.as_ref().map_or(NOBODY, |caller| caller.peer);
    let connection = caller.as_ref().and_then(|caller| caller.connection.clone());
    let transfers = caller.map(|caller| caller.transfers).unwrap_or_default();
    let _transfer = transfers.begin();
    let Handler::Slow(handler) = route.handler.clone() else { return Err(Reply::text(500, "this path has no handler\n")) };
    let (mut parts, body) = request.into_parts();
    let fields = fields(&mut parts).await;
    let (content, to_come) = match route.content {
        Some(most_bytes) => (Upload::whole(gathered(body, most_bytes).await?), None),
        None => {
            let (to, content) = Upload::channel();
            (content, Some((body, to)))
        }
    };
    let turn = desk.lanes.turn(route.lane, peer, connection.as_ref()).await?;
    let query = parts.uri.query().unwrap_or_default().to_owned();
    let (access, headers) = (route.access, parts.headers.clone());
    let permission = Permission { keys: desk.keys.clone(), access, method: parts.method, headers, peer };
    // The show lock may have been set, or the browser revoked, while the request waited.
    permission.judge()?;
    let mut call = Call { fields, query, headers: parts.headers, content, permission };
    let work = tokio::task::spawn_blocking(move || {
        let reply = handler(&mut call).unwrap_or_else(|refused| refused);
        drop(turn);
        reply
    });
    let arrives = async {
        if let Some((body, to)) = to_come {
            pump(body, to).await;
        }
    };
    let (reply, ()) = tokio::join!(work, arrives);
    // A handler that panics is a defect; the message is in the log.
    let reply = reply.unwrap_or_else(|_| Reply::text(500, "this failed inside the program; please report it with the log\n"));
    Ok(with_download(reply, &transfers))
}

fn with_download(mut reply: Reply, transfers: &Transfers) -> Response<Body> {
    let download = reply.download.take();
    let mut response = response(reply);
    if let Some(download) = download {
        *response.body_mut() = download.into_body(Some(transfers));
    }
    response
}

async fn fields(parts: &mut axum::http::request::Parts) -> Vec<(String, String)> {
    let named = RawPathParams::from_request_parts(parts, &()).await;
    named.map(|named| named.iter().map(|(name, value)| (name.to_owned(), value.to_owned())).collect()).unwrap_or_default()
}

/// Returns the reply that lists a path's methods.
fn wrong_method(of_path: &[Route]) -> Response<Body> {
    let mut methods: Vec<&str> = of_path.iter().map(|route| route.method.as_str()).collect();
    if methods.contains(&"GET") {
        methods.push("HEAD");
    }
    let sentence = match methods[..] {
        ["GET", "HEAD"] => "only GET is answered here\n".to_owned(),
        ["POST"] => "this changes something; ask with POST\n".to_owned(),
        _ => format!("this path has {}\n", methods.join(", ")),
    };
    response(Reply::text(405, sentence).with("allow", &methods.join(", ")))
}

/// Turns a connection into a WebSocket, which `serve` then serves.
async fn web_socket<F>(request: HttpRequest<Body>, serve: impl FnOnce(WebSocket) -> F + Send + 'static) -> Response<Body>
where
    F: Future<Output = ()> + Send,
{
    // The WebSocket keeps the connection's place as long as it lasts.
    let Some(place) = request.extensions().get::<Caller>().and_then(|caller| caller.place.clone()) else {
        return response(Reply::text(503, "too many clients are connected; close some and try again\n"));
    };
    let (mut parts, _) = request.into_parts();
    match WebSocketUpgrade::from_request_parts(&mut parts, &()).await {
        Ok(upgrade) => upgrade.max_message_size(MAX_MESSAGE).max_frame_size(MAX_MESSAGE).on_upgrade(move |socket| async move {
            serve(socket).await;
            drop(place);
        }),
        Err(rejection) => {
            let sentence = "this path is a WebSocket; ask for it as one (RFC 6455: GET with Upgrade: websocket, version 13 and a key)\n";
            response(Reply::text(rejection.into_response().status().as_u16(), sentence).with("upgrade", "websocket"))
        }
    }
}

/// Serves `/ws`: every record from now on.
async fn stream(mut socket: WebSocket, feed: Arc<Feed>, mut stopped: watch::Receiver<bool>) {
    let mut lines = feed.lines();
    loop {
        tokio::select! {
            line = lines.recv() => {
                // The client is further behind than the queue holds, or the server ends: either way
                // the stream is over.
                let Ok(line) = line else { break };
                match timeout(TAKES_WITHIN, socket.send(Message::Text(line))).await {
                    Ok(Ok(())) => {}
                    _ => return,
                }
            }
            message = socket.recv() => match message {
                // The library answers pings; a client's messages are not needed.
                Some(Ok(Message::Close(_))) | Some(Err(_)) | None => return,
                Some(Ok(_)) => {}
            },
            () = ended(&mut stopped) => break,
        }
    }
    close(socket).await;
}
