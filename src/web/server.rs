//! The server's thread: connections, limits, and WebSocket clients.

use std::convert::Infallible;
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use axum::Router;
use axum::body::{Body, HttpBody};
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::http::{Method, Request as HttpRequest, Response, StatusCode, header};
use axum::response::IntoResponse;
use axum::routing::any;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use thiserror::Error;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::time::timeout;

use super::HttpSettings;
use super::feed::Feed;
use super::routes::{Handler, Reply, Request, Route};
use crate::record::PoseSample;

/// Connections at a time; more wait to be accepted.
const MOST_CONNECTIONS: usize = 64;
/// A request's head must come within this time,
const HEAD_WITHIN: Duration = Duration::from_secs(5);
/// in this many bytes,
const LONGEST_HEAD: usize = 16 * 1024;
/// with this many header lines.
const MOST_HEADERS: usize = 64;
/// A client has nothing to say on the WebSocket, so that its messages may be short.
const LONGEST_MESSAGE: usize = 4 * 1024;
/// A client that takes nothing for this long is let go.
const TAKES_WITHIN: Duration = Duration::from_secs(2);

/// Why the server cannot run.
#[derive(Debug, Error)]
pub enum WebError {
    /// The port is taken, or the address is not this machine's.
    #[error("[http]: cannot listen on {address} ({source}); give a free port on an address of this machine")]
    Listen {
        /// Where.
        address: SocketAddr,
        /// What the system says.
        source: io::Error,
    },
    /// The system gave no thread or no event queue.
    #[error("[http]: cannot start the server ({0}); close other programs or raise the limits of processes and files")]
    Start(io::Error),
}

/// The running server; dropped, it ends.
#[derive(Debug)]
pub struct Server {
    feed: Arc<Feed>,
    address: SocketAddr,
    stop: watch::Sender<bool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Listens, and answers from now on: /ws, /api/v1/pose, /api/v1/state and the given routes.
    ///
    /// # Errors
    /// Where the address cannot be had or the thread cannot be started.
    pub fn start(settings: &HttpSettings, routes: Vec<Route>) -> Result<Self, WebError> {
        let listen = |source| WebError::Listen { address: settings.listen, source };
        let listener = TcpListener::bind(settings.listen).map_err(listen)?;
        listener.set_nonblocking(true).map_err(listen)?;
        let address = listener.local_addr().map_err(listen)?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(WebError::Start)?;
        let (feed, (stop, stopped)) = (Arc::new(Feed::new()), watch::channel(false));
        let slots = Arc::new(Semaphore::new(MOST_CONNECTIONS));
        let router = router(feed.clone(), routes, &Shared { stopped: stopped.clone(), slots: slots.clone() });
        let run = move || {
            runtime.block_on(serve(listener, router, slots, stopped));
            runtime.shutdown_timeout(Duration::from_millis(200));
        };
        let thread = std::thread::Builder::new().name("http".to_owned()).spawn(run).map_err(WebError::Start)?;
        Ok(Self { feed, address, stop, thread: Some(thread) })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Gives a sample to everybody who listens; never waits.
    pub fn publish(&self, sample: &PoseSample) {
        self.feed.publish(sample);
    }

    /// Ends the server and its connections.
    pub fn close(self) {}
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.stop.send(true);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("[http]: the server failed; please report this");
        }
    }
}

/// Accepts connections until it is stopped.
async fn serve(listener: TcpListener, router: Router, slots: Arc<Semaphore>, mut stopped: watch::Receiver<bool>) {
    let listener = match tokio::net::TcpListener::from_std(listener) {
        Ok(listener) => listener,
        Err(error) => return tracing::error!("[http]: the server cannot run ({error}); restart the program"),
    };
    loop {
        let (slot, stream) = tokio::select! {
            accepted = accept(&listener, &slots) => accepted,
            () = ended(&mut stopped) => break,
        };
        let _ = stream.set_nodelay(true);
        let service = TowerToHyperService::new(router.clone());
        let connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(HEAD_WITHIN)
            .max_buf_size(LONGEST_HEAD)
            .max_headers(MOST_HEADERS)
            .serve_connection(TokioIo::new(stream), service)
            .with_upgrades();
        tokio::spawn(async move {
            // A client that breaks off or talks nonsense is its own trouble.
            let _ = connection.await;
            drop(slot);
        });
    }
    // Clients are told the end; whoever does not listen is cut off.
    let all = u32::try_from(MOST_CONNECTIONS).unwrap_or(u32::MAX);
    let _ = timeout(Duration::from_millis(300), slots.acquire_many(all)).await;
}

/// The next connection, once there is room for one more.
async fn accept(listener: &tokio::net::TcpListener, slots: &Arc<Semaphore>) -> (Option<OwnedSemaphorePermit>, tokio::net::TcpStream) {
    // The semaphore is never closed.
    let slot = slots.clone().acquire_owned().await.ok();
    loop {
        match listener.accept().await {
            Ok((stream, _)) => return (slot, stream),
            // Out of files: others will be closed.
            Err(_) => tokio::time::sleep(Duration::from_millis(50)).await,
        }
    }
}

/// Waits for the end of the server.
async fn ended(stopped: &mut watch::Receiver<bool>) {
    // An error says that the server is gone, which is the end too.
    drop(stopped.wait_for(|stop| *stop).await);
}

/// What every WebSocket has from the server.
#[derive(Clone)]
struct Shared {
    stopped: watch::Receiver<bool>,
    slots: Arc<Semaphore>,
}

fn router(feed: Arc<Feed>, routes: Vec<Route>, shared: &Shared) -> Router {
    let shared = shared.clone();
    let (pose, state) = (feed.clone(), feed.clone());
    let own = [Route::new("/api/v1/pose", move |_| pose.pose()), Route::new("/api/v1/state", move |_| state.state())];
    let mut router = Router::new().route("/ws", any(move |request| web_socket(request, feed.clone(), shared.clone())));
    for Route { path, handler } in own.into_iter().chain(routes) {
        router = router.route(path, any(move |request| answer(request, handler.clone())));
    }
    router.fallback(|| async { response(Reply::text(404, "there is nothing here; see /api/v1/pose, /api/v1/state and /ws\n")) })
}

/// Refuses what is no plain GET.
fn refusal(request: &HttpRequest<Body>) -> Option<Reply> {
    if !matches!(*request.method(), Method::GET | Method::HEAD) {
        return Some(Reply::text(405, "only GET is answered here\n"));
    }
    (!request.body().is_end_stream()).then(|| Reply::text(413, "a request has no content here\n"))
}

async fn answer(request: HttpRequest<Body>, handler: Handler) -> Result<Response<Body>, Infallible> {
    let reply = refusal(&request).unwrap_or_else(|| {
        let uri = request.uri();
        handler(&Request { path: uri.path(), query: uri.query() })
    });
    Ok(response(reply))
}

fn response(reply: Reply) -> Response<Body> {
    let is_refused = matches!(reply.status, 405 | 413);
    let mut response = Response::new(Body::from(reply.body));
    *response.status_mut() = StatusCode::from_u16(reply.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, header::HeaderValue::from_static(reply.content_type));
    headers.insert(header::CACHE_CONTROL, header::HeaderValue::from_static("no-store"));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, header::HeaderValue::from_static("nosniff"));
    if is_refused {
        headers.insert(header::CONNECTION, header::HeaderValue::from_static("close"));
    }
    response
}

/// `/ws`: every record from now on.
async fn web_socket(request: HttpRequest<Body>, feed: Arc<Feed>, shared: Shared) -> Response<Body> {
    use axum::extract::FromRequestParts;
    if let Some(refused) = refusal(&request) {
        return response(refused);
    }
    // An upgraded connection leaves its slot; it takes one of its own.
    let Ok(slot) = shared.slots.try_acquire_owned() else {
        return response(Reply::text(503, "too many clients are connected\n"));
    };
    let (mut parts, _) = request.into_parts();
    match WebSocketUpgrade::from_request_parts(&mut parts, &()).await {
        Ok(upgrade) => upgrade.max_message_size(LONGEST_MESSAGE).max_frame_size(LONGEST_MESSAGE).on_upgrade(move |socket| async move {
            stream(socket, feed, shared.stopped).await;
            drop(slot);
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

#[cfg(test)]
#[path = "server_tests.rs"]
mod tests;
