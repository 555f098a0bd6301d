//! The server's thread: connections and their limits.

use std::convert::Infallible;
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener};
use std::path::PathBuf;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::thread::JoinHandle;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::http::{Method, Request as HttpRequest, Response};
use crossbeam_channel::Receiver;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service as _, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use socket2::{Domain, Protocol, Socket, Type};
use thiserror::Error;
use tokio::net::TcpStream;
use tokio::sync::watch;
use tokio::task::yield_now;
use tokio::time::{sleep, timeout};
use tokio_io_timeout::TimeoutStream;

use super::answers::{Caller, Streams, router};
use super::connection::Connection;
use super::download::Transfers;
use super::entrance::{self, About};
use super::events::Events;
use super::feed::Feed;
use super::guard::judge;
use super::hosts::AllowedHosts;
use super::hub::Hub;
use super::keys::Keys;
use super::lanes::most_threads;
use super::lifetime::{TAKES_WITHIN, ended};
use super::packing::unpacks;
use super::places::{BriefOnes, Place, Places};
use super::replies::response;
use super::reply::Reply;
use super::routes::{Access, Route};
use super::scene::Scene;
use super::stage_files::{StageFiles, StageSource};
use crate::capture::ClipEntry;
use crate::config::HttpSettings;
use crate::daemon::live::EventListener;
use crate::daemon::stand_back;
use crate::publish::FrameClock;
use crate::record::PoseSample;
use crate::telemetry::Statistics;
use crate::track::UsedPixels;
use crate::tracker::TrackerSetup;

/// Maximum time for a request's head, also while a connection waits for its next request. Chosen,
/// not tuned. Raised, silent clients hold their places longer.
const HEAD_WITHIN: Duration = Duration::from_secs(5);
/// Maximum size of a request's head, bytes. Chosen: more than browsers send. Raised, a client may
/// take more memory.
const MAX_HEAD: usize = 16 * 1024;
/// Maximum number of header lines. Chosen: more than browsers send. Raised, a client may take more
/// memory.
const MAX_HEADERS: usize = 64;
/// Lifetime of a connection that is not a WebSocket; clients then reconnect. A client that reads
/// one byte a second must not keep it. Raised, such clients hold places longer; lowered, large
/// answers to slow clients are cut.
const LASTS: Duration = Duration::from_secs(60);
/// Maximum connections waiting to be accepted. If the queue is full, the system ignores the next
/// one, which retries only after a second. A round figure, which Linux limits to
/// net.core.somaxconn.
const MAX_WAITING: i32 = 1024;
/// Maximum connections accepted in a row; far fewer than the number of brief connections. Raised to
/// that, a flood pushes them out before they are heard.
const AT_ONCE: u32 = 16;
/// Lifetime of a connection without a place, answered or not. Chosen: enough for one page. Raised,
/// a flood keeps others out longer.
const BRIEFLY: Duration = Duration::from_secs(2);
/// Maximum time for a connection to end properly. Chosen, not tuned. Raised, the daemon's end waits
/// longer for clients that do not listen.
const ENDS_WITHIN: Duration = Duration::from_millis(250);

/// Threads for slow work in addition to the lanes': for the page's folder. Raised, more memory.
const EXTRA_THREADS: usize = 2;

/// Interval of checks of the newest frame's age and of the events; clients learn when a frame has
/// become too old. Chosen: shorter than a person notices. Raised, they learn later.
const WATCH_EVERY: Duration = Duration::from_millis(100);

/// Why the server cannot run.
#[derive(Debug, Error)]
pub enum WebError {
    /// The port is taken, or the address is not this machine's.
    #[error("[http]: cannot listen on {address} ({source}); give a free port on an address of this machine")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The system's error.
        source: io::Error,
    },
    /// The system provided no thread or no event queue.
    #[error("[http]: cannot start the server ({0}); close other programs or raise the limits of processes and files")]
    Start(io::Error),
    /// Pairings cannot be stored.
    #[error("[http]: pairings cannot be saved ({0}); make room in the state folder, or make it writable")]
    State(io::Error),
}

/// Optional parts of a server besides its routes.
#[derive(Default)]
pub struct Site {
    /// The folder for pairings; without it they end with the server.
    pub state: Option<PathBuf>,
    /// The page's files, for developing it; by default those built into the program.
    pub page_dir: Option<PathBuf>,
    /// The caller's description in /api/v1/session.
    pub about: Option<About>,
    /// The stage for other programs, as files of /api/v1/scene.
    pub stage: Option<Arc<dyn StageSource>>,
    /// Where frames copied for viewers are counted.
    pub statistics: Arc<Statistics>,
}

/// The running server; it ends when dropped.
#[derive(Debug)]
pub struct Server {
    feed: Arc<Feed>,
    hub: Arc<Hub>,
    events: Arc<Events>,
    scene: Arc<Scene>,
    address: SocketAddr,
    stop: watch::Sender<bool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Starts a server with the page, /ws, /ws/events, /ws/view, /api/v1/pose, /api/v1/state,
    /// /api/v1/scene, the stage's pictures and the given routes.
    ///
    /// # Errors
    /// When the address is not available or the thread cannot be started.
    pub fn start(settings: &HttpSettings, routes: Vec<Route>) -> Result<Self, WebError> {
        Self::start_site(settings, routes, Site::default())
    }

    /// As [`start`](Self::start), with optional parts.
    ///
    /// # Errors
    /// When the address is not available, the thread cannot be started, or the state folder cannot
    /// be written.
    pub fn start_site(settings: &HttpSettings, mut routes: Vec<Route>, site: Site) -> Result<Self, WebError> {
        let listen = |source| WebError::Listen { address: settings.listen, source };
        let listener = bound(settings.listen).map_err(listen)?;
        let address = listener.local_addr().map_err(listen)?;
        // This thread answers; slow work runs on others, at low priority.
        let mut runtime = tokio::runtime::Builder::new_current_thread();
        let runtime = runtime
            .enable_all()
            .max_blocking_threads(most_threads() + EXTRA_THREADS)
            .on_thread_start(stand_back)
            .build()
            .map_err(WebError::Start)?;
        let keys = Keys::open(site.state.as_deref(), address.port()).or_else(|e| {
            // Without a folder for pairings tracking still works, and this machine's own page needs
            // none.
            tracing::warn!("[http]: pairings end with the program, because they cannot be saved ({e}); make the state folder writable");
            Keys::open(None, address.port())
        });
        let keys = Arc::new(keys.map_err(WebError::State)?);
        if !address.ip().is_loopback() {
            tracing::info!("[http]: to let a browser on another machine change something, pair it with the code {}", keys.code());
        }
        let (feed, (stop, stopped)) = (Arc::new(Feed::new()), watch::channel(false));
        let hub = Hub::start(site.statistics).map_err(WebError::Start)?;
        let (events, scene) = (Arc::new(Events::new()), Arc::<Scene>::default());
        let (described, pictured) = (scene.clone(), scene.clone());
        let files = site.stage.map(StageFiles::new);
        routes.push(Route::slow(Method::GET, "/api/v1/scene", Access::Anyone, move |call| match (call.text("format"), &files) {
            (None, _) => Ok(described.reply(unpacks(&call.headers))),
            (Some(format), Some(files)) => Ok(files.reply(format)),
            (Some(_), None) => Err(Reply::text(404, "this program offers no files of its stage; `stagepose run` does\n")),
        }));
        routes.push(Route::slow(Method::GET, "/api/v1/surfaces/{number}/picture", Access::Anyone, move |call| {
            Ok(pictured.picture(call.name("number")?))
        }));
        routes.extend(entrance::routes(&keys, site.about));
        let streams = Streams { feed: feed.clone(), hub: hub.clone(), events: events.clone(), stopped: stopped.clone() };
        let router = router(streams, routes, keys, site.page_dir);
        let site = Arc::new(Answering { router, hosts: AllowedHosts::new(&settings.hosts) });
        let watched = (feed.clone(), events.clone());
        runtime.spawn(async move {
            loop {
                sleep(WATCH_EVERY).await;
                watched.0.watch();
                watched.1.watch();
            }
        });
        let run = move || {
            runtime.block_on(serve(listener, site, stopped));
            runtime.shutdown_timeout(Duration::from_millis(200));
        };
        let thread = std::thread::Builder::new().name("http".to_owned()).spawn(run).map_err(WebError::Start)?;
        Ok(Self { feed, hub, events, scene, address, stop, thread: Some(thread) })
    }

    /// Returns the address on which it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Sends frames older than `most` by this clock as stale from now on. Without it every record
    /// is sent as it comes.
    pub fn judge_ages(&self, clock: Arc<FrameClock>, most: Duration) {
        self.feed.judge_ages(clock, most);
    }

    /// Sends a sample to all listeners; never waits.
    pub fn publish(&self, sample: &PoseSample) {
        self.feed.publish(sample);
    }

    /// Sends these events to clients from now on.
    pub fn follow_events(&self, events: EventListener) {
        self.events.follow(events);
    }

    /// Shows this session's scene from now on.
    pub fn show_scene(&self, setup: &TrackerSetup) {
        self.scene.set(setup);
    }

    /// Returns what a session's pose stage calls with every row and its sample, for viewers. It
    /// never waits, and copies nothing while no viewer waits for a frame. Each call starts another
    /// session, whose rows are numbered anew. `pixels` are its tracker's, for the frames for which
    /// [`wants_pixels`](Self::wants_pixels) is true.
    pub fn observer(&self, pixels: Option<Receiver<UsedPixels>>) -> impl FnMut(&ClipEntry, &PoseSample) + Send + 'static {
        self.hub.observer(pixels)
    }

    /// Returns a flag that is true while a viewer requests the pixels behind the poses.
    pub fn wants_pixels(&self) -> Arc<AtomicBool> {
        self.hub.wants_pixels()
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

/// Binds as the standard library does, with a longer queue.
fn bound(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = Socket::new(Domain::for_address(address), Type::STREAM, Some(Protocol::TCP))?;
    socket.set_reuse_address(true)?;
    socket.set_nonblocking(true)?;
    socket.bind(&address.into())?;
    socket.listen(MAX_WAITING)?;
    Ok(socket.into())
}

/// What every connection is answered from.
struct Answering {
    router: Router,
    hosts: AllowedHosts,
}

/// Accepts connections until it is stopped.
async fn serve(listener: TcpListener, site: Arc<Answering>, mut stopped: watch::Receiver<bool>) {
    let listener = match tokio::net::TcpListener::from_std(listener) {
        Ok(listener) => listener,
        Err(error) => return tracing::error!("[http]: the server cannot run ({error}); restart the program"),
    };
    let (places, mut brief, mut since_a_look) = (Places::new(), BriefOnes::default(), 0);
    loop {
        let (stream, peer) = tokio::select! {
            accepted = accept(&listener) => accepted,
            () = ended(&mut stopped) => break,
        };
        let _ = stream.set_nodelay(true);
        let place = places.take(peer.ip()).map(Arc::new);
        let is_brief = place.is_none();
        let task = tokio::spawn(converse((stream, peer.ip()), place, site.clone(), stopped.clone()));
        if is_brief {
            brief.admit(peer.ip(), task.abort_handle());
        }
        // Let accepted connections run before more come, or the newest would push them out unheard.
        since_a_look += 1;
        if since_a_look == AT_ONCE {
            since_a_look = 0;
            yield_now().await;
        }
    }
    // Clients get a last message; those that do not listen are cut off.
    let _ = timeout(ENDS_WITHIN + Duration::from_millis(50), places.empty()).await;
}

async fn accept(listener: &tokio::net::TcpListener) -> (TcpStream, SocketAddr) {
    loop {
        match listener.accept().await {
            Ok(accepted) => return accepted,
            // Out of files: other connections will be closed.
            Err(_) => sleep(Duration::from_millis(50)).await,
        }
    }
}

/// Serves one connection until it ends or its time is over. A WebSocket continues on its own, with
/// the place.
async fn converse(
    (stream, peer): (TcpStream, IpAddr),
    place: Option<Arc<Place>>,
    site: Arc<Answering>,
    mut stopped: watch::Receiver<bool>,
) {
    let reached = stream.local_addr().map_or(IpAddr::V4(Ipv4Addr::UNSPECIFIED), |address| address.ip());
    let connection = Connection::new(stream);
    let mut stream = TimeoutStream::new(connection.clone());
    stream.set_write_timeout(Some(TAKES_WITHIN));
    let is_brief = place.is_none();
    let caller = Caller { place, peer, connection: Some(connection), transfers: Transfers::default() };
    let routes = TowerToHyperService::new(site.router.clone());
    let service = service_fn(|mut request: HttpRequest<Incoming>| {
        let judged = judge(&site.hosts, &request, reached).map(|()| {
            request.extensions_mut().insert(caller.clone());
            routes.call(request)
        });
        async move {
            // One request per turn: a client that pipelines hundreds lets others run in between.
            yield_now().await;
            match judged {
                Ok(answer) => answer.await,
                Err(refused) => Ok::<Response<Body>, Infallible>(response(refused)),
            }
        }
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(if is_brief { BRIEFLY } else { HEAD_WITHIN })
        .keep_alive(!is_brief)
        // A client may close its sending side and wait for the answer.
        .half_close(true)
        .max_buf_size(MAX_HEAD)
        .max_headers(MAX_HEADERS)
        .serve_connection(TokioIo::new(Box::pin(stream)), service)
        .with_upgrades();
    let mut connection = pin!(connection);
    tokio::select! {
        // A client's broken or malformed connection is not our error.
        _ = connection.as_mut() => return,
        () = grown_old(if is_brief { BRIEFLY } else { LASTS }, &caller.transfers) => {}
        () = ended(&mut stopped) => {}
    }
    connection.as_mut().graceful_shutdown();
    let _ = timeout(ENDS_WITHIN, connection).await;
}

/// Waits for the end of a connection's time. A transfer in progress is not cut off: its reader
/// finishes or times out on its own.
async fn grown_old(time: Duration, transfers: &Transfers) {
    sleep(time).await;
    while transfers.any() {
        sleep(BRIEFLY).await;
    }
}

#[cfg(test)]
#[path = "server_tests.rs"]
mod tests;
