//! What comes with a request and goes with a reply, piece by piece: a large file is never in memory as a whole.

use std::io::{self, Read, Write};
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use axum::body::{Body, Bytes, HttpBody};
use hyper::body::Frame;
use tokio::sync::mpsc;
use tokio::time::timeout;

use super::reply::Reply;

/// The next piece of a request's content must come within this time. Chosen: longer than a wireless network's hiccup. Raised, who sends
/// nothing holds a thread for longer.
const ARRIVES_WITHIN: Duration = Duration::from_secs(5);
/// The whole content must come within this time, and a second more for each [`SLOWEST`] bytes of it. Chosen: a bad wireless network is
/// faster. Raised, who sends a byte now and then holds a connection for longer; lowered, slow honest clients are cut off.
const ARRIVES_WHOLE_WITHIN: Duration = Duration::from_secs(20);
/// Bytes a second below which a content is cut off in the end: a telephone line. Raised, honest uploads over bad networks fail.
const SLOWEST: u64 = 8 * 1024;
/// Pieces that may wait between the connection and who reads or writes them. A round figure; raised, more memory.
const PIECES: usize = 4;
/// Bytes of one piece of a download. Chosen: few system calls, little memory. Raised, more memory for each download.
const PIECE_BYTES: usize = 64 * 1024;

/// A request's content, read on another thread than it arrives on.
#[derive(Debug)]
pub(super) struct Upload {
    /// What is still to come.
    pieces: Option<mpsc::Receiver<io::Result<Bytes>>>,
    rest: Bytes,
}

impl Upload {
    /// With what fills it.
    pub fn channel() -> (mpsc::Sender<io::Result<Bytes>>, Self) {
        let (to, pieces) = mpsc::channel(PIECES);
        (to, Self { pieces: Some(pieces), rest: Bytes::new() })
    }

    /// One that is here already.
    pub fn whole(content: Vec<u8>) -> Self {
        Self { pieces: None, rest: content.into() }
    }
}

/// How long a content may take from when it began, by what has come.
struct Deadline {
    begun: Instant,
    bytes: u64,
}

impl Deadline {
    fn begin() -> Self {
        Self { begun: Instant::now(), bytes: 0 }
    }

    /// Time that is left for the next piece; none is zero.
    fn left(&self) -> Duration {
        let whole = ARRIVES_WHOLE_WITHIN + Duration::from_secs(self.bytes / SLOWEST);
        whole.saturating_sub(self.begun.elapsed()).min(ARRIVES_WITHIN)
    }
}

/// The next bytes of a content in time; none at its end.
async fn next_piece(body: &mut Body, deadline: &mut Deadline) -> io::Result<Option<Bytes>> {
    loop {
        let next = std::future::poll_fn(|cx| Pin::new(&mut *body).poll_frame(cx));
        match timeout(deadline.left(), next).await {
            Ok(None) => return Ok(None),
            Ok(Some(Ok(frame))) => {
                // Trailers say nothing here.
                if let Ok(bytes) = frame.into_data() {
                    deadline.bytes += bytes.len() as u64;
                    return Ok(Some(bytes));
                }
            }
            Ok(Some(Err(error))) => return Err(io::Error::other(error)),
            Err(_) => return Err(io::ErrorKind::TimedOut.into()),
        }
    }
}

/// All of a content that is not longer than this; one that is longer is not waited for.
///
/// # Errors
/// The reply where it is longer, broke off, or did not come in time.
pub(super) async fn gathered(mut body: Body, most_bytes: u64) -> Result<Vec<u8>, Reply> {
    if body.size_hint().lower() > most_bytes {
        return Err(too_large(most_bytes));
    }
    let (mut whole, mut deadline) = (Vec::new(), Deadline::begin());
    while let Some(piece) = next_piece(&mut body, &mut deadline).await.map_err(|e| not_arrived(&e))? {
        if deadline.bytes > most_bytes {
            return Err(too_large(most_bytes));
        }
        whole.extend_from_slice(&piece);
    }
    Ok(whole)
}

impl Read for Upload {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        while self.rest.is_empty() {
            match self.pieces.as_mut().and_then(mpsc::Receiver::blocking_recv) {
                Some(piece) => self.rest = piece?,
                None => return Ok(0),
            }
        }
        let n = self.rest.len().min(into.len());
        into[..n].copy_from_slice(&self.rest.split_to(n));
        Ok(n)
    }
}

/// Content beyond its limit.
pub(super) fn too_large(most_bytes: u64) -> Reply {
    if most_bytes == 0 {
        return Reply::text(413, "this request has no content\n");
    }
    let limit = if most_bytes >= 1 << 20 { format!("{} MB", most_bytes >> 20) } else { format!("{most_bytes} bytes") };
    Reply::text(413, format!("the content is larger than {limit}, which is the most that is taken here\n"))
}

/// Content that did not come.
pub(super) fn not_arrived(error: &io::Error) -> Reply {
    match error.kind() {
        io::ErrorKind::TimedOut => Reply::text(408, "the content did not come in time; send it again\n"),
        _ => Reply::text(400, "the content broke off; send it again\n"),
    }
}

/// Brings a request's content to who reads it, until either ends.
pub(super) async fn pump(mut body: Body, to: mpsc::Sender<io::Result<Bytes>>) {
    let mut deadline = Deadline::begin();
    loop {
        let piece = match next_piece(&mut body, &mut deadline).await {
            Ok(None) => return,
            Ok(Some(bytes)) => Ok(bytes),
            Err(error) => Err(error),
        };
        let is_over = piece.is_err();
        if to.send(piece).await.is_err() || is_over {
            return;
        }
    }
}

/// Counts what a connection carries that may last: such a connection is not ended for its age.
#[derive(Debug, Clone, Default)]
pub(super) struct Transfers(Arc<AtomicUsize>);

impl Transfers {
    /// Counts one until it is dropped.
    pub fn begin(&self) -> Transfer {
        self.0.fetch_add(1, Ordering::Relaxed);
        Transfer(self.0.clone())
    }

    /// Whether there are any.
    pub fn any(&self) -> bool {
        self.0.load(Ordering::Relaxed) > 0
    }
}

/// One of them.
#[derive(Debug)]
pub(super) struct Transfer(Arc<AtomicUsize>);

impl Drop for Transfer {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

/// A reply's content that is made on a thread of its own while it is sent, as fast as it is taken.
#[derive(Debug)]
pub struct Download {
    pieces: mpsc::Receiver<io::Result<Bytes>>,
    transfer: Option<Transfer>,
}

impl Download {
    /// Starts `make`, which writes the content. Where it fails, the connection breaks off, so that half a file is not taken for a whole one.
    ///
    /// # Errors
    /// Where the system gives no thread.
    pub fn start(make: impl FnOnce(&mut dyn Write) -> io::Result<()> + Send + 'static) -> io::Result<Self> {
        let (to, pieces) = mpsc::channel(PIECES);
        let work = move || {
            super::priority::stand_back();
            let mut sink = Sink { to: to.clone(), buffer: Vec::new() };
            if let Err(error) = make(&mut sink).and_then(|()| sink.flush()) {
                let _ = to.blocking_send(Err(error));
            }
        };
        std::thread::Builder::new().name("download".to_owned()).spawn(work)?;
        Ok(Self { pieces, transfer: None })
    }

    /// As a response's content, which counts among the connection's transfers.
    pub(super) fn into_body(mut self, transfers: Option<&Transfers>) -> Body {
        self.transfer = transfers.map(Transfers::begin);
        Body::new(self)
    }
}

impl HttpBody for Download {
    type Data = Bytes;
    type Error = io::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<io::Result<Frame<Bytes>>>> {
        self.pieces.poll_recv(cx).map(|piece| piece.map(|piece| piece.map(Frame::data)))
    }
}

/// Where a download is written to.
struct Sink {
    to: mpsc::Sender<io::Result<Bytes>>,
    buffer: Vec<u8>,
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.buffer.extend_from_slice(bytes);
        if self.buffer.len() >= PIECE_BYTES {
            self.flush()?;
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.buffer.is_empty() {
            return Ok(());
        }
        let piece = Bytes::from(std::mem::take(&mut self.buffer));
        // Who asked is gone.
        self.to.blocking_send(Ok(piece)).map_err(|_| io::ErrorKind::BrokenPipe.into())
    }
}
